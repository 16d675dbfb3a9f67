//! Flux-form advection on the C grid: the one loop that all carried quantities share.
//!
//! Scheme: `d(rho q)/dt = -div(rho v q)`, the face value of q by a fifth-order upwind-biased polynomial (Wicker and Skamarock
//! 2002) or by WENO5 with the Z weights of Borges et al. (2008). Towards the ground and the lid the order falls to
//! third and then second (upwind first for WENO), so that no value outside the box is needed. The flux through ground and lid is 0.
//! Keeps: the mass-weighted sum of q, to rounding. Does not keep: extrema exactly (WENO overshoots by rounding-sized to small
//! amounts at unresolved jumps, the linear scheme by a few per cent).
//! Bytes moved a cell and stage, fields not in cache: q, start, slow, three velocities read, one written: 28.

use super::slab::{SLAB_LEVELS, ahead, back, row};
use crate::grid::Grid;

/// How face values are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaceScheme {
    /// Fifth-order upwind-biased, linear: for momentum.
    Upwind5,
    /// Essentially non-oscillatory, fifth order where smooth: for scalars.
    Weno5,
}

/// Mass fluxes that carry a quantity, per reference density of the quantity's own level: `rho v / rho`.
/// Each fills a whole row and is asked for in the quantity's own indices.
pub trait Carrier: Sync {
    /// Speed through the west faces of row `(y, z)`, m/s.
    fn west(&self, y: usize, z: usize, out: &mut [f32]);
    /// Speed through the south faces of row `(y, z)`, m/s.
    fn south(&self, y: usize, z: usize, out: &mut [f32]);
    /// Mass flux through the lower faces of row `(y, z)`, kg/m2/s; `z` may be one past the last level.
    fn below(&self, y: usize, z: usize, out: &mut [f32]);
    /// One over the reference density at level `z` of the quantity, m3/kg.
    fn volume_per_mass(&self, z: usize) -> f32;
}

/// What one slab needs beside fields; made once, so that a tick allocates nothing.
#[derive(Clone, Debug)]
pub struct Scratch {
    padded: Vec<f32>,
    speed: Vec<f32>,
    flux_x: Vec<f32>,
    flux_y: [Vec<f32>; 2],
    flux_z: Vec<f32>,
    flux_above: Vec<f32>,
    zeros: Vec<f32>,
}

impl Scratch {
    /// For rows of `grid`.
    pub fn new(grid: &Grid) -> Self {
        let nx = grid.cells[0];
        Self {
            padded: vec![0.0; nx + 5],
            speed: vec![0.0; nx],
            flux_x: vec![0.0; nx + 1],
            flux_y: [vec![0.0; nx], vec![0.0; nx]],
            flux_z: vec![0.0; grid.plane()],
            flux_above: vec![0.0; nx],
            zeros: vec![0.0; nx],
        }
    }
}

/// A quantity to carry: its state, the substep's start and the held tendency (empty for none), and its extent in z.
pub struct Carried<'a> {
    /// State that is carried.
    pub state: &'a [f32],
    /// State at the substep's start.
    pub start: &'a [f32],
    /// Held tendency, or empty.
    pub slow: &'a [f32],
    /// First level that changes: 0, or 1 for what sits on lower faces (the ground's stays 0).
    pub first_level: usize,
    /// Whether the level above the last one exists and holds 0 (w at the lid).
    pub zero_at_lid: bool,
}

crate::constants! {
    /// Keeps 0/0 away in WENO's weights where the carried field is constant.
    const ROUGHNESS_FLOOR: f32 = 1e-20;
    /// Keeps the square of WENO's ratio inside f32, and still weighs a rough stencil out.
    const ROUGHNESS_RATIO_MAX: f32 = 1e6;
}

/// Fifth-order upwind-biased flux; `q` are the six values around the face, from the west.
#[inline(always)]
fn upwind5(q: [f32; 6], speed: f32) -> f32 {
    let even = (37.0 * (q[3] + q[2]) - 8.0 * (q[4] + q[1]) + (q[5] + q[0])) * (1.0 / 60.0);
    let odd = (10.0 * (q[3] - q[2]) - 5.0 * (q[4] - q[1]) + (q[5] - q[0])) * (1.0 / 60.0);
    speed * even - speed.abs() * odd
}

/// Third-order upwind-biased flux from the four inner values.
#[inline(always)]
fn upwind3(q: [f32; 6], speed: f32) -> f32 {
    let even = (7.0 * (q[3] + q[2]) - (q[4] + q[1])) * (1.0 / 12.0);
    let odd = (3.0 * (q[3] - q[2]) - (q[4] - q[1])) * (1.0 / 12.0);
    speed * even - speed.abs() * odd
}

/// WENO5-Z flux, written in the five differences of neighbours, seen from upwind: value, bends and slopes follow from them with fewer
/// operations and less rounding than from the values.
#[inline(always)]
fn weno5(q: [f32; 6], speed: f32) -> f32 {
    let positive = speed >= 0.0;
    let (west2, west1, middle, east1, east2) = (q[1] - q[0], q[2] - q[1], q[3] - q[2], q[4] - q[3], q[5] - q[4]);
    let value = if positive { q[2] } else { q[3] };
    let d0 = if positive { west2 } else { -east2 };
    let d1 = if positive { west1 } else { -east1 };
    let d2 = if positive { middle } else { -middle };
    let d3 = if positive { east1 } else { -west1 };
    let (bend0, bend1, bend2) = (d1 - d0, d2 - d1, d3 - d2);
    let (slope0, slope1, slope2) = (d1 + d1 + bend0, d1 + d2, bend2 - (d2 + d2));
    // Four times the usual measure: only ratios count.
    const BEND: f32 = 13.0 / 3.0;
    let rough0 = BEND * (bend0 * bend0) + slope0 * slope0;
    let rough1 = BEND * (bend1 * bend1) + slope1 * slope1;
    let rough2 = BEND * (bend2 * bend2) + slope2 * slope2;
    let tau = (rough0 - rough2).abs();
    let ratio0 = (tau / (rough0 + ROUGHNESS_FLOOR)).min(ROUGHNESS_RATIO_MAX);
    let ratio1 = (tau / (rough1 + ROUGHNESS_FLOOR)).min(ROUGHNESS_RATIO_MAX);
    let ratio2 = (tau / (rough2 + ROUGHNESS_FLOOR)).min(ROUGHNESS_RATIO_MAX);
    let w0 = 1.0 + ratio0 * ratio0;
    let w1 = 6.0 + 6.0 * (ratio1 * ratio1);
    let w2 = 3.0 + 3.0 * (ratio2 * ratio2);
    let face0 = 3.0 * d1 + 2.0 * bend0;
    let face1 = slope1 + d2;
    let face2 = 3.0 * d2 - bend2;
    speed * (value + (w0 * face0 + w1 * face1 + w2 * face2) / (6.0 * (w0 + w1 + w2)))
}

/// Fluxes along a row: `q[s][i]` are the six values around face `i`; `order` 5, 3 or 1.
#[inline(always)]
fn flux_row(scheme: FaceScheme, order: usize, q: [&[f32]; 6], speed: &[f32], out: &mut [f32]) {
    let n = out.len();
    let [q0, q1, q2, q3, q4, q5] = q;
    let (q0, q1, q2, q3, q4, q5) = (&q0[..n], &q1[..n], &q2[..n], &q3[..n], &q4[..n], &q5[..n]);
    let speed = &speed[..n];
    macro_rules! each {
        ($f:expr) => {
            for i in 0..n {
                out[i] = $f([q0[i], q1[i], q2[i], q3[i], q4[i], q5[i]], speed[i]);
            }
        };
    }
    match (scheme, order) {
        (FaceScheme::Weno5, 5) => each!(weno5),
        (FaceScheme::Upwind5, 5) => each!(upwind5),
        (_, 3) => each!(upwind3),
        (FaceScheme::Weno5, _) => each!(|q: [f32; 6], s: f32| s * if s >= 0.0 { q[2] } else { q[3] }),
        (FaceScheme::Upwind5, _) => each!(|q: [f32; 6], s: f32| s * 0.5 * (q[2] + q[3])),
    }
}

/// The six rows around the south faces of row `(y, z)`.
#[inline(always)]
fn around<'a>(grid: &Grid, state: &'a [f32], y: usize, z: usize) -> [&'a [f32]; 6] {
    let ny = grid.cells[1];
    [
        row(grid, state, back(y, 3, ny), z),
        row(grid, state, back(y, 2, ny), z),
        row(grid, state, back(y, 1, ny), z),
        row(grid, state, y, z),
        row(grid, state, ahead(y, 1, ny), z),
        row(grid, state, ahead(y, 2, ny), z),
    ]
}

/// Row `(y, z)` of the carried quantity, `z` up to the first level past the last one.
#[inline(always)]
fn level_row<'a>(grid: &Grid, carried: &Carried<'a>, zeros: &'a [f32], y: usize, z: usize) -> &'a [f32] {
    let levels = grid.cells[2];
    if z < levels {
        row(grid, carried.state, y, z)
    } else if carried.zero_at_lid {
        zeros
    } else {
        row(grid, carried.state, y, levels - 1)
    }
}

/// Fluxes through the lower faces of row `(y, z)`.
#[inline(always)]
fn flux_below<C: Carrier>(
    scheme: FaceScheme,
    grid: &Grid,
    carrier: &C,
    carried: &Carried<'_>,
    zeros: &[f32],
    speed: &mut [f32],
    y: usize,
    z: usize,
    out: &mut [f32],
) {
    let levels = grid.cells[2];
    let top = if carried.zero_at_lid { levels } else { levels - 1 };
    if z == 0 || z > top {
        out.fill(0.0);
        return;
    }
    carrier.below(y, z, speed);
    let room = z.min(top + 1 - z);
    let order = if room >= 3 {
        5
    } else if room == 2 {
        3
    } else {
        1
    };
    let q = [
        level_row(grid, carried, zeros, y, z.saturating_sub(3)),
        level_row(grid, carried, zeros, y, z.saturating_sub(2)),
        level_row(grid, carried, zeros, y, z - 1),
        level_row(grid, carried, zeros, y, z),
        level_row(grid, carried, zeros, y, z + 1),
        level_row(grid, carried, zeros, y, z + 2),
    ];
    flux_row(scheme, order, q, speed, out);
}

/// Computes `out = start + dt (slow - div flux)` for the slab whose first level is `first`; `out` is that slab.
#[inline(always)]
pub fn carry_slab<C: Carrier>(
    scheme: FaceScheme,
    grid: &Grid,
    carrier: &C,
    carried: &Carried,
    dt_s: f32,
    first: usize,
    out: &mut [f32],
    scratch: &mut Scratch,
) {
    let [nx, ny, levels] = grid.cells;
    let [dx, dy, dz] = grid.cell_size_m;
    let last = (first + SLAB_LEVELS).min(levels);
    let Scratch {
        padded,
        speed,
        flux_x,
        flux_y,
        flux_z,
        flux_above,
        zeros,
    } = scratch;
    let [south, north] = flux_y;
    let begin = first.max(carried.first_level);
    for level in first..begin {
        out[(level - first) * nx * ny..][..nx * ny].fill(0.0);
    }
    for y in 0..ny {
        flux_below(
            scheme,
            grid,
            carrier,
            carried,
            zeros,
            speed,
            y,
            begin,
            &mut flux_z[y * nx..(y + 1) * nx],
        );
    }
    for z in begin..last {
        let to_z = carrier.volume_per_mass(z) / dz;
        let (to_x, to_y) = (1.0 / dx, 1.0 / dy);
        carrier.south(0, z, speed);
        flux_row(scheme, 5, around(grid, carried.state, 0, z), speed, south);
        for y in 0..ny {
            let state = row(grid, carried.state, y, z);
            for (i, p) in padded.iter_mut().take(3).enumerate() {
                *p = state[back(i, 3, nx)];
            }
            padded[3..3 + nx].copy_from_slice(state);
            for i in 0..2 {
                padded[3 + nx + i] = state[i % nx];
            }
            carrier.west(y, z, speed);
            let along = [
                &padded[..nx],
                &padded[1..1 + nx],
                &padded[2..2 + nx],
                &padded[3..3 + nx],
                &padded[4..4 + nx],
                &padded[5..5 + nx],
            ];
            flux_row(scheme, 5, along, speed, &mut flux_x[..nx]);
            flux_x[nx] = flux_x[0];

            let y_north = ahead(y, 1, ny);
            carrier.south(y_north, z, speed);
            flux_row(scheme, 5, around(grid, carried.state, y_north, z), speed, north);

            flux_below(scheme, grid, carrier, carried, zeros, speed, y, z + 1, flux_above);

            let below = &mut flux_z[y * nx..(y + 1) * nx];
            let start = row(grid, carried.start, y, z);
            let slow = if carried.slow.is_empty() {
                &zeros[..]
            } else {
                row(grid, carried.slow, y, z)
            };
            let out = &mut out[((z - first) * ny + y) * nx..][..nx];
            let (slow, above) = (&slow[..nx], &flux_above[..nx]);
            let (west, east) = (&flux_x[..nx], &flux_x[1..nx + 1]);
            let (s, n) = (&south[..nx], &north[..nx]);
            for i in 0..nx {
                let divergence = (east[i] - west[i]) * to_x + (n[i] - s[i]) * to_y + (above[i] - below[i]) * to_z;
                out[i] = start[i] + dt_s * (slow[i] - divergence);
            }
            below.copy_from_slice(above);
            std::mem::swap(south, north);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn face_values_of_a_smooth_wave_converge_at_fifth_order() {
        for face in [upwind5, weno5] {
            let error = |n: usize| {
                let h = 1.0 / n as f64;
                // Cell means of sin at the six cells around the face at x = 0.3, so that the exact face value is sin(0.3).
                let q = [-3, -2, -1, 0, 1, 2].map(|c| {
                    let (a, b) = (0.3 + c as f64 * h, 0.3 + (c + 1) as f64 * h);
                    ((a.cos() - b.cos()) / h) as f32
                });
                (face(q, 1.0) as f64 - 0.3f64.sin()).abs()
            };
            // f32 leaves room for one halving between truncation and rounding.
            let ratio = error(2) / error(4);
            assert!(ratio > 20.0, "error falls only {ratio} times a halving");
        }
    }
}
