//! Stage `coriolis`: turns the wind's departure from the geostrophic wind.
//!
//! Reads u at x faces and v at y faces (m/s); adds to their held tendencies (m/s2): `du/dt += f (v - v_g)`, `dv/dt -= f (u - u_g)`, with the
//! other velocity averaged over its four nearest places. Keeps no energy exactly (explicit), its error is of order `(f dt)^2`, below 1e-6
//! a substep. Errors: none.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::slab::{Crosswind, PIECE};

/// Runs the stage; nothing if the parameters have no rotation.
pub fn run(parameters: &Parameters, u: &[f32], v: &[f32], slow_u: &mut [f32], slow_v: &mut [f32]) {
    let Some(rotation) = &parameters.coriolis else { return };
    let grid = &parameters.grid;
    let [nx, ny, _] = grid.cells;
    let f = rotation.parameter_per_s;
    slow_u
        .par_chunks_mut(grid.plane())
        .zip(slow_v.par_chunks_mut(grid.plane()))
        .enumerate()
        .for_each(|(z, (slow_u, slow_v))| {
            let (u_g, v_g) = (rotation.wind_x_m_s[z], rotation.wind_y_m_s[z]);
            let mut across = Crosswind::new();
            for y in 0..ny {
                for at in (0..nx).step_by(PIECE) {
                    let cells = PIECE.min(nx - at);
                    across.load(grid, [u, v], [y, z], at, cells);
                    let here = y * nx + at..y * nx + at + cells;
                    let (slow_u, slow_v) = (&mut slow_u[here.clone()], &mut slow_v[here]);
                    let (u_at_v, v_at_u) = (&across.u_at_v[..cells], &across.v_at_u[..cells]);
                    for i in 0..cells {
                        slow_u[i] += f * (v_at_u[i] - v_g);
                        slow_v[i] -= f * (u_at_v[i] - u_g);
                    }
                }
            }
        });
}
