//! Stage `pressure_jacobi`: the pressure that frees the mass flux of divergence, by sweeps of Jacobi's method.
//!
//! Reads the velocities at their faces (m/s) and `Pressure` (m2/s2) at centres as a first guess; writes `Pressure`. The discrete problem is that of
//! `pressure_solve`, second order; see `pressure_source` for its right side. A sweep gives each cell the value that its six neighbours of the sweep before ask
//! for: every cell by itself, in any order. On a grid of even extents plain Jacobi turns the sign of a checkerboard at each sweep and
//! never shrinks it; so the last sweep goes half the way, which removes the checkerboard and costs nothing.
//!
//! What n sweeps leave: a wave of length l keeps the share `(1 - 2 c)^n` of its error, `c = sum_i sin2(pi d_i / l_i) / d_i2 / sum_i 1 / d_i2`. Forty sweeps
//! take away what is shorter than about eight cells and hardly touch what is longer than thirty; that is left to the first guess, the
//! pressure of the stage before, which is why `Pressure` is part of the state with this rung. In flat cells almost all of
//! `1 / d2` is vertical, and nothing but the mean column is solved in any useful number of sweeps; choose another rung there.
//! Divergence left in a running cumulus field: see `tests/physics/pressure.rs`. Errors: none.
//!
//! Source: seed 004, chapter 7 (after Stam 2003). Different here: C grid and density; there cells hold all three velocities, and the divergence
//! that is removed is that of central differences over two cells, which does not see a checkerboard at all.
//! Bytes a cell: 20 for the right side, 12 a sweep, 8 for the mean column. Holds 8 bytes a cell.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::pressure_source::{Source, centre_level, level_mean};
use super::slab::{PIECE, Piece, SLAB_LEVELS, ahead, back, row, slab_len};

/// Weights of the neighbours west and east, south and north, below, above, and of the source; one set a level.
pub fn weights(parameters: &Parameters) -> Vec<[f32; 5]> {
    let grid = &parameters.grid;
    let levels = grid.cells[2];
    let [hx, hy, hz] = [0, 1, 2].map(|a| (grid.cell_size_m[a] as f64).powi(-2));
    // An axis of one cell is its own neighbour on both sides: no gradient there.
    let [hx, hy] = [(hx, grid.cells[0]), (hy, grid.cells[1])].map(|(h, n)| if n > 1 { h } else { 0.0 });
    (0..levels)
        .map(|z| {
            let density = parameters.density_kg_m3[z] as f64;
            let face = |z: usize| parameters.density_at_z_face_kg_m3[z] as f64 * hz / density;
            let below = if z > 0 { face(z) } else { 0.0 };
            let above = if z + 1 < levels { face(z + 1) } else { 0.0 };
            let diagonal = 2.0 * (hx + hy) + below + above;
            [hx, hy, below, above, 1.0 / density].map(|w| (w / diagonal) as f32)
        })
        .collect()
}

/// Buffers and weights, made once for a grid.
pub struct Solver {
    source: Source,
    /// `div(rho v) / dt`, `[z][y][x]`.
    source_field: Vec<f32>,
    /// The other side of a sweep.
    other: Vec<f32>,
    /// Weights of the neighbours west and east, south and north, below, above, and of the source; one set a level.
    weights: Vec<[f32; 5]>,
}

impl Solver {
    /// Makes room for `parameters.grid`.
    pub fn new(parameters: &Parameters) -> Self {
        let grid = &parameters.grid;
        let levels = grid.cells[2];
        Self {
            source: Source::new(levels),
            source_field: vec![0.0; grid.len()],
            other: vec![0.0; grid.len()],
            weights: weights(parameters),
        }
    }

    /// Bytes that the solver holds.
    pub fn bytes(&self) -> usize {
        4 * (self.source_field.len() + self.other.len() + 5 * self.weights.len())
    }

    /// Improves `pressure` by `sweeps` sweeps for a stage of length `dt_s`.
    pub fn run(
        &mut self,
        parameters: &Parameters,
        velocity: [&[f32]; 3],
        dt_s: f32,
        sweeps: u32,
        pressure: &mut [f32],
    ) {
        let grid = &parameters.grid;
        let plane = grid.plane();
        self.source.measure(parameters, velocity[2], dt_s);
        let source = &self.source;
        self.source_field
            .par_chunks_mut(plane)
            .zip(pressure.par_chunks_mut(plane))
            .enumerate()
            .for_each(|(z, (out, pressure))| {
                source_level(source, parameters, velocity, 1.0 / dt_s, z, out);
                centre_level(pressure);
            });
        let (source_field, weights) = (&self.source_field, &self.weights);
        for sweep in 0..sweeps {
            let share = if sweep + 1 == sweeps { 0.5 } else { 1.0 };
            let (from, to): (&[f32], &mut [f32]) = if sweep % 2 == 0 {
                (pressure, &mut self.other)
            } else {
                (&self.other, pressure)
            };
            to.par_chunks_mut(slab_len(grid)).enumerate().for_each(|(s, slab)| {
                for (l, out) in slab.chunks_exact_mut(plane).enumerate() {
                    let z = s * SLAB_LEVELS + l;
                    sweep_level(parameters, &weights[z], share, from, source_field, z, out);
                }
            });
        }
        let other = &self.other;
        // Sweeps leave the constant where it happens to end.
        let end: &[f32] = if sweeps % 2 == 1 { other } else { pressure };
        let constant = level_mean(&end[end.len() - plane..]);
        pressure.par_chunks_mut(plane).enumerate().for_each(|(z, pressure)| {
            let mean = source.mean_pressure(z) - constant;
            if sweeps % 2 == 1 {
                pressure.copy_from_slice(&other[z * plane..(z + 1) * plane]);
            }
            pressure.iter_mut().for_each(|p| *p += mean);
        });
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn source_level(
    source: &Source,
    parameters: &Parameters,
    velocity: [&[f32]; 3],
    per_dt: f32,
    z: usize,
    out: &mut [f32],
) {
    for (y, out) in out.chunks_exact_mut(parameters.grid.cells[0]).enumerate() {
        source.row(parameters, velocity, per_dt, y, z, out);
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn sweep_level(
    parameters: &Parameters,
    weights: &[f32; 5],
    share: f32,
    from: &[f32],
    source: &[f32],
    z: usize,
    out: &mut [f32],
) {
    let grid = &parameters.grid;
    let [nx, ny, levels] = grid.cells;
    let [wx, wy, below, above, ws] = weights.map(|w| share * w);
    let keep = 1.0 - share;
    let (z_below, z_above) = (z.saturating_sub(1), (z + 1).min(levels - 1));
    let mut piece = Piece::new();
    for y in 0..ny {
        for at in (0..nx).step_by(PIECE) {
            let cells = PIECE.min(nx - at);
            let end = at + cells;
            piece.load(row(grid, from, y, z), at, cells);
            let (west, p, east) = (piece.from(0, cells), piece.from(1, cells), piece.from(2, cells));
            let s = &row(grid, from, back(y, 1, ny), z)[at..end];
            let n = &row(grid, from, ahead(y, 1, ny), z)[at..end];
            let (b, a) = (
                &row(grid, from, y, z_below)[at..end],
                &row(grid, from, y, z_above)[at..end],
            );
            let f = &row(grid, source, y, z)[at..end];
            let out = &mut out[y * nx + at..y * nx + end];
            for i in 0..cells {
                out[i] = keep * p[i] + wx * (west[i] + east[i]) + wy * (s[i] + n[i]) + (below * b[i] + above * a[i])
                    - ws * f[i];
            }
        }
    }
}
