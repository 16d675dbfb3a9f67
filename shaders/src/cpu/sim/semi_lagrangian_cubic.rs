//! Stage `semi_lagrangian_cubic`: carries one quantity through a whole substep by cubic interpolation with a limiter.
//!
//! Reads the quantity (with its tendencies, see `add_tendencies`), its three displacements (cells) from `departure` and for w the
//! buoyancy at centres; writes the next value: Lagrange's cubic through four values along each axis, 64 in all, bounded by the eight values around the departure
//! point (Bermejo and Staniforth 1992). Beside ground and lid the four levels are those next to the wall; a box of fewer than four levels is
//! linear upwards. Order: fourth in space for one interpolation, so third for a run at a fixed Courant number, second in time through the
//! trajectories; at extrema the limiter leaves second. Keeps extrema. Does not keep sums. Stable at any Courant number.
//! Errors: none; NaN in, NaN out. Bytes a cell: 20, and 72 values read out of order, four by four in a row: SIMD runs along those four.
//! Source: Staniforth and Cote (1991); Bermejo and Staniforth (1992).

use rayon::prelude::*;

use super::parameters::Parameters;
use super::semi_lagrangian::{
    CHUNK, Carried, Lattice, around, bounded, bounds_z, displacements, eight, extrema, index_of, split, wrapped,
};
use super::slab::{SLAB_LEVELS, slab_len};

/// Lagrange's weights of the nodes -1, 0, 1, 2 at `t`.
#[inline(always)]
fn lagrange(t: f32) -> [f32; 4] {
    let (a, b, c) = (t + 1.0, t - 1.0, t - 2.0);
    [
        -t * b * c * (1.0 / 6.0),
        a * b * c * 0.5,
        -a * t * c * 0.5,
        a * t * b * (1.0 / 6.0),
    ]
}

/// Where the points of a chunk read, and with what weights.
struct Stencil {
    /// First of the four columns, which may wrap.
    column: [u32; CHUNK],
    /// Beginnings of the four rows within a level.
    row: [[u32; 4]; CHUNK],
    /// Beginnings of the four levels.
    level: [[u32; 4]; CHUNK],
    weight_x: [[f32; 4]; CHUNK],
    weight_y: [[f32; 4]; CHUNK],
    weight_z: [[f32; 4]; CHUNK],
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn slab(parameters: &Parameters, carried: &Carried, first: usize, out: &mut [f32]) {
    let grid = &parameters.grid;
    let [nx, ny, levels] = grid.cells;
    let plane = nx * ny;
    let (nx_f, ny_f) = (nx as f32, ny as f32);
    let lattice = Lattice::new(grid, carried.place);
    let field = carried.state;
    let mut stencil = Stencil {
        column: [0; CHUNK],
        row: [[0; 4]; CHUNK],
        level: [[0; 4]; CHUNK],
        weight_x: [[0.0; 4]; CHUNK],
        weight_y: [[0.0; 4]; CHUNK],
        weight_z: [[0.0; 4]; CHUNK],
    };
    let mut departure = [[0.0f32; CHUNK]; 3];
    // Levels of the lattice, stored or not.
    let count = lattice.top + 1;
    for z in first..(first + SLAB_LEVELS).min(levels) {
        let (lowest, highest) = bounds_z(&lattice, z);
        for y in 0..ny {
            let out = &mut out[((z - first) * ny + y) * nx..][..nx];
            if carried.is_wall(z) {
                out.fill(0.0);
                continue;
            }
            for begin in (0..nx).step_by(CHUNK) {
                let n = CHUNK.min(nx - begin);
                let out = &mut out[begin..][..n];
                displacements(grid, carried.place, carried.departure, [y, z], begin, n, &mut departure);
                let (dx, dy, dz) = (&departure[0][..n], &departure[1][..n], &departure[2][..n]);
                for i in 0..n {
                    let (below, t) = split(dx[i]);
                    stencil.column[i] = index_of(wrapped((begin as i32 + i as i32) as f32 + below - 1.0, nx_f));
                    stencil.weight_x[i] = lagrange(t);
                    let (below, t) = split(dy[i]);
                    for j in 0..4 {
                        let y = wrapped(y as f32 + below + (j as f32 - 1.0), ny_f);
                        stencil.row[i][j] = index_of(y).wrapping_mul(nx as u32);
                    }
                    stencil.weight_y[i] = lagrange(t);
                    let (below, t) = split(bounded(dz[i], lowest, highest));
                    let inner = index_of(z as f32 + below) as usize;
                    if count >= 4 {
                        // Next to a wall the four levels stay in the box, and the point lies off their middle.
                        let base = inner.saturating_sub(1).min(count - 4);
                        let weight = lagrange(t + (inner as f32 - (base as f32 + 1.0)));
                        for j in 0..4 {
                            let there = base + j < lattice.stored;
                            stencil.level[i][j] = if there { ((base + j) * plane) as u32 } else { 0 };
                            stencil.weight_z[i][j] = if there { weight[j] } else { 0.0 };
                        }
                    } else {
                        let inner = inner.min(lattice.top);
                        let next = (inner + 1).min(lattice.top);
                        let stored = |level: usize| if level < lattice.stored { 1.0 } else { 0.0 };
                        stencil.level[i] =
                            [inner, next.min(lattice.stored - 1), 0, 0].map(|l| (l.min(levels - 1) * plane) as u32);
                        stencil.weight_z[i] = [(1.0 - t) * stored(inner), t * stored(next), 0.0, 0.0];
                    }
                }
                for i in 0..n {
                    let column = stencil.column[i] as usize;
                    let mut sum = [0.0f32; 4];
                    for (&level, &weight_z) in stencil.level[i].iter().zip(&stencil.weight_z[i]) {
                        let mut along = [0.0f32; 4];
                        for (&row, &weight_y) in stencil.row[i].iter().zip(&stencil.weight_y[i]) {
                            let start = level as usize + row as usize;
                            let four: [f32; 4] = match field.get(start + column..start + column + 4) {
                                Some(four) if column + 4 <= nx => [four[0], four[1], four[2], four[3]],
                                _ => [0, 1, 2, 3].map(|j| field[(start + (column + j) % nx).min(field.len() - 1)]),
                            };
                            for j in 0..4 {
                                along[j] += weight_y * four[j];
                            }
                        }
                        for j in 0..4 {
                            sum[j] += weight_z * along[j];
                        }
                    }
                    let w = stencil.weight_x[i];
                    out[i] = (w[0] * sum[0] + w[1] * sum[1]) + (w[2] * sum[2] + w[3] * sum[3]);
                }
                around!(grid, lattice, [y, z], begin, departure, n, |i, corners, _t| {
                    let (low, high) = extrema(eight(field, &corners));
                    out[i] = bounded(out[i], low, high);
                });
            }
            carried.add_buoyancy(grid, y, z, out);
        }
    }
}

/// Runs the stage; `out` is overwritten whole.
pub fn run(parameters: &Parameters, carried: &Carried, out: &mut [f32]) {
    out.par_chunks_mut(slab_len(&parameters.grid))
        .enumerate()
        .for_each(|(s, out)| slab(parameters, carried, s * SLAB_LEVELS, out));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weights_reproduce_cubics_also_off_the_middle() {
        for t in [-1.0f32, -0.4, 0.0, 0.3, 1.0, 1.7, 2.0] {
            let w = lagrange(t);
            for power in 0..4 {
                let got: f32 = [-1.0f32, 0.0, 1.0, 2.0]
                    .iter()
                    .zip(w)
                    .map(|(x, w)| w * x.powi(power))
                    .sum();
                assert!((got - t.powi(power)).abs() < 1e-5, "t {t}, power {power}: {got}");
            }
        }
    }
}
