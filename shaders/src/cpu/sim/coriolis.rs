//! Stage `coriolis`: turns the wind's departure from the geostrophic wind.
//!
//! Reads u at x faces and v at y faces (m/s); adds to their held tendencies (m/s2): `du/dt += f (v - v_g)`, `dv/dt -= f (u - u_g)`, with the
//! other velocity averaged over its four nearest places. Keeps no energy exactly (explicit), its error is of order `(f dt)^2`, below 1e-6
//! a substep. Errors: none.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::slab::{ahead, back, for_row, row};

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
            for y in 0..ny {
                let (u_here, u_south) = (row(grid, u, y, z), row(grid, u, back(y, 1, ny), z));
                let (v_here, v_north) = (row(grid, v, y, z), row(grid, v, ahead(y, 1, ny), z));
                let at = y * nx;
                let (slow_u, slow_v) = (&mut slow_u[at..at + nx], &mut slow_v[at..at + nx]);
                for_row!(nx, |i, west, east| {
                    slow_u[i] += f * (0.25 * (v_here[west] + v_here[i] + v_north[west] + v_north[i]) - v_g);
                    slow_v[i] -= f * (0.25 * (u_here[i] + u_here[east] + u_south[i] + u_south[east]) - u_g);
                });
            }
        });
}
