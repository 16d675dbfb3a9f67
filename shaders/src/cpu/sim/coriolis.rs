//! Stage `coriolis`: turns the wind's departure from the geostrophic wind.
//!
//! Reads u at x faces and v at y faces (m/s); adds to their held tendencies (m/s2): `du/dt += f (v - v_g)`, `dv/dt -= f (u - u_g)`, with the
//! other velocity averaged over its four nearest places. Keeps no energy exactly (explicit), its error is of order `(f dt)^2`, below 1e-6
//! a substep. Errors: none.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::slab::{PIECE, Piece, ahead, back, row};

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
            let (mut u_here, mut u_south, mut v_here, mut v_north) =
                (Piece::new(), Piece::new(), Piece::new(), Piece::new());
            for y in 0..ny {
                for at in (0..nx).step_by(PIECE) {
                    let cells = PIECE.min(nx - at);
                    u_here.load(row(grid, u, y, z), at, cells);
                    u_south.load(row(grid, u, back(y, 1, ny), z), at, cells);
                    v_here.load(row(grid, v, y, z), at, cells);
                    v_north.load(row(grid, v, ahead(y, 1, ny), z), at, cells);
                    let (u0, u_east) = (u_here.from(1, cells), u_here.from(2, cells));
                    let (us, us_east) = (u_south.from(1, cells), u_south.from(2, cells));
                    let (v0, v_west) = (v_here.from(1, cells), v_here.from(0, cells));
                    let (vn, vn_west) = (v_north.from(1, cells), v_north.from(0, cells));
                    let here = y * nx + at..y * nx + at + cells;
                    let (slow_u, slow_v) = (&mut slow_u[here.clone()], &mut slow_v[here]);
                    for i in 0..cells {
                        slow_u[i] += f * (0.25 * (v_west[i] + v0[i] + vn_west[i] + vn[i]) - v_g);
                        slow_v[i] -= f * (0.25 * (u0[i] + u_east[i] + us[i] + us_east[i]) - u_g);
                    }
                }
            }
        });
}
