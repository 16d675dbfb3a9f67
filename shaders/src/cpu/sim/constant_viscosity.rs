//! Stage `constant_viscosity`: mixing by one viscosity and one diffusivity everywhere.
//!
//! Reads a field at its place (u, v, w in m/s; heat in K; water in kg/kg); adds to its held tendency `(1/rho) div(rho K grad q)`, K the viscosity or
//! the diffusivity (m2/s), the seven-point Laplacian, second order. Ground and lid slip freely and let nothing through: no gradient of
//! u, v and scalars there, and w is 0. Flux form: keeps the mass-weighted sums of u, v and scalars to rounding.
//!
//! Two schemes in time, first order both (the tendency is held over the substep):
//! - explicit: the Laplacian of the state. Stable for `K dt (1/dx2 + 1/dy2 + 1/dz2) <= 1/2`, axes of one cell left out; the world's
//!   substeps keep to half of that, so that no wave changes its sign.
//! - implicit: `(I - dt K Laplacian) q1 = q`, the tendency is `(q1 - q) / dt`. Solved by Jacobi's iteration,
//!   `q1 <- (q + A q1 + dt L q1) / (1 + A)`, A the largest sum of a cell's couplings times dt. Each sweep is a weighted mean of values of the field
//!   and of the sweep before, so nothing can grow whatever K, dt or the number of sweeps; and with the same A in every cell each sweep keeps the
//!   mass-weighted sum. The error falls at least by A / (1 + A) a sweep; sweeps are as many as bring it to 1/1000, 40 at
//!   most (A up to 5.3). Beyond that it mixes less than asked, not wrongly. The last sweep goes half the way: a checkerboard, whose
//!   error turns its sign at each sweep and hardly shrinks where A is large, would stay otherwise.
//!
//! Source: seed 004, equations 7.8 to 7.12, algorithm 7.2, listing 7.5 (after Stam 2003). For equal cells of size h and constant density the sweep above
//! is `(q + a (sum of six neighbours)) / (1 + 6 a)`, `a = K dt / h2`, which is listing 7.4. Derived anew, because the print slips: 7.11 and 7.12 divide
//! by h3 and listing 7.5 multiplies by the third power of the cells a side, where a Laplacian asks for h2; 7.12 adds the cell itself as a
//! seventh neighbour, and its denominator lacks the 6; algorithm 7.2 divides the neighbours alone by c, and calls the kernel with x in the place of c; 7.9
//! is called a Poisson equation and explicit: it is Helmholtz's and implicit.
//! Errors: none. Bytes a cell: 12 explicit, 20 and 12 a sweep implicit, which holds 8 bytes a cell.

use rayon::prelude::*;

use super::parameters::{DiffusionScheme, Parameters};
use super::slab::{PIECE, Piece, SLAB_LEVELS, ahead, back, row, slab_len};

/// Share of the error that the implicit scheme's sweeps may leave.
const ERROR_LEFT: f64 = 1e-3;
/// Most sweeps of the implicit scheme.
const SWEEPS_MAX: f64 = 40.0;

/// How strongly a cell of one level is coupled to its neighbours, 1/s (or, times dt, 1).
#[derive(Clone, Copy)]
struct Couplings {
    x: f32,
    y: f32,
    below: f32,
    above: f32,
    /// 0 where the value above is that at the lid, which is not stored and 0.
    lid: f32,
}

impl Couplings {
    fn new(parameters: &Parameters, coefficient: f32, at_z_face: bool, z: usize) -> Self {
        let grid = &parameters.grid;
        let [_, _, levels] = grid.cells;
        let [hx, hy, hz] = grid.cell_size_m.map(|d| coefficient / (d * d));
        let (centre, face) = (&parameters.density_kg_m3, &parameters.density_at_z_face_kg_m3);
        let top = z + 1 == levels;
        let (below, above) = if at_z_face {
            (centre[z.saturating_sub(1)] / face[z], centre[z] / face[z])
        } else {
            (
                if z > 0 { face[z] / centre[z] } else { 0.0 },
                if top { 0.0 } else { face[z + 1] / centre[z] },
            )
        };
        Self {
            x: hx,
            y: hy,
            below: hz * below,
            above: hz * above,
            lid: if at_z_face && top { 0.0 } else { 1.0 },
        }
    }

    /// Sum of the couplings, without axes of one cell.
    fn sum(&self, parameters: &Parameters) -> f32 {
        let [nx, ny, _] = parameters.grid.cells;
        let along = |h: f32, n: usize| if n > 1 { 2.0 * h } else { 0.0 };
        along(self.x, nx) + along(self.y, ny) + self.below + self.above
    }
}

/// What becomes of a level.
#[derive(Clone, Copy)]
enum Step {
    /// The flux is added to what stands there.
    Add,
    /// A sweep, which goes by `weight` from the sweep before to where the substep's start and the flux draw.
    Sweep { weight: f32 },
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn level(
    parameters: &Parameters,
    couplings: Couplings,
    step: Step,
    start: &[f32],
    state: &[f32],
    z: usize,
    to: &mut [f32],
) {
    let grid = &parameters.grid;
    let [nx, ny, levels] = grid.cells;
    let Couplings {
        x,
        y: along_y,
        below,
        above,
        lid,
    } = couplings;
    let (z_below, z_above) = (z.saturating_sub(1), (z + 1).min(levels - 1));
    let (mut piece, mut flux) = (Piece::new(), [0.0; PIECE]);
    for y in 0..ny {
        for at in (0..nx).step_by(PIECE) {
            let cells = PIECE.min(nx - at);
            let end = at + cells;
            piece.load(row(grid, state, y, z), at, cells);
            let (west, q, east) = (piece.from(0, cells), piece.from(1, cells), piece.from(2, cells));
            let s = &row(grid, state, back(y, 1, ny), z)[at..end];
            let n = &row(grid, state, ahead(y, 1, ny), z)[at..end];
            let (b, a) = (
                &row(grid, state, y, z_below)[at..end],
                &row(grid, state, y, z_above)[at..end],
            );
            let flux = &mut flux[..cells];
            for i in 0..cells {
                let sideways = x * ((east[i] - q[i]) + (west[i] - q[i])) + along_y * ((n[i] - q[i]) + (s[i] - q[i]));
                flux[i] = sideways + above * (lid * a[i] - q[i]) + below * (b[i] - q[i]);
            }
            let to = &mut to[y * nx + at..y * nx + end];
            match step {
                Step::Add => {
                    for i in 0..cells {
                        to[i] += flux[i];
                    }
                }
                // As a difference, so that what is constant stays so to the bit: rounded weights would let the sum drift.
                Step::Sweep { weight } => {
                    let q0 = &row(grid, start, y, z)[at..end];
                    for i in 0..cells {
                        to[i] = q[i] + weight * ((q0[i] - q[i]) + flux[i]);
                    }
                }
            }
        }
    }
}

/// Runs `level` on all levels of `to`; the ground's faces are left alone.
fn levels(
    parameters: &Parameters,
    coefficient: f32,
    at_z_face: bool,
    step: Step,
    start: &[f32],
    state: &[f32],
    to: &mut [f32],
) {
    let plane = parameters.grid.plane();
    to.par_chunks_mut(slab_len(&parameters.grid))
        .enumerate()
        .for_each(|(s, slab)| {
            for (l, to) in slab.chunks_exact_mut(plane).enumerate() {
                let z = s * SLAB_LEVELS + l;
                if z > 0 || !at_z_face {
                    let couplings = Couplings::new(parameters, coefficient, at_z_face, z);
                    level(parameters, couplings, step, start, state, z, to);
                }
            }
        });
}

/// The largest sum of a cell's couplings over `substep_s`, and the sweeps that the implicit scheme makes for it.
pub fn implicit_sweeps(
    parameters: &Parameters,
    coefficient_m2_s: f32,
    at_z_face: bool,
    substep_s: f32,
) -> (f32, usize) {
    let largest = (0..parameters.grid.cells[2])
        .map(|z| Couplings::new(parameters, coefficient_m2_s * substep_s, at_z_face, z).sum(parameters))
        .fold(0.0, f32::max);
    let a = largest as f64;
    let wanted = if a > 0.0 {
        // One more than the theory's, since the last one goes half the way.
        (ERROR_LEFT.ln() / (a / (1.0 + a)).ln()).ceil() + 1.0
    } else {
        1.0
    };
    (largest, wanted.min(SWEEPS_MAX) as usize)
}

/// Runs the stage on one field with `coefficient_m2_s`; nothing if the parameters have no constant viscosity or the field is unplanned (empty).
///
/// `scratch` are two fields, or empty for the explicit scheme.
pub fn run(
    parameters: &Parameters,
    coefficient_m2_s: f32,
    field: &[f32],
    at_z_face: bool,
    substep_s: f32,
    scratch: &mut [Vec<f32>; 2],
    slow: &mut [f32],
) {
    let Some(mixing) = &parameters.constant_viscosity else {
        return;
    };
    match mixing.scheme {
        DiffusionScheme::Explicit => {
            levels(parameters, coefficient_m2_s, at_z_face, Step::Add, field, field, slow);
        }
        DiffusionScheme::Implicit => {
            let (a, sweeps) = implicit_sweeps(parameters, coefficient_m2_s, at_z_face, substep_s);
            let per = 1.0 / (1.0 + a);
            let [here, there] = scratch;
            let plane = parameters.grid.plane();
            if at_z_face {
                // Sweeps pass over the ground's faces and read them.
                here[..plane].copy_from_slice(&field[..plane]);
                there[..plane].copy_from_slice(&field[..plane]);
            }
            let (mut from, mut to): (&mut Vec<f32>, &mut Vec<f32>) = (here, there);
            let coefficient = coefficient_m2_s * substep_s;
            for i in 0..sweeps {
                let share = if i + 1 == sweeps { 0.5 } else { 1.0 };
                let sweep = Step::Sweep { weight: share * per };
                let state: &[f32] = if i == 0 { field } else { from };
                levels(parameters, coefficient, at_z_face, sweep, field, state, to);
                std::mem::swap(&mut from, &mut to);
            }
            let per_s = 1.0 / substep_s;
            slow.par_chunks_mut(plane)
                .zip(field.par_chunks(plane))
                .zip(from.par_chunks(plane))
                .for_each(|((slow, start), end)| {
                    for ((s, a), b) in slow.iter_mut().zip(start).zip(end) {
                        *s += per_s * (b - a);
                    }
                });
        }
    }
}
