//! Stage `surface_flux`: what the ground gives to and takes from the lowest level.
//!
//! Reads u and v of the lowest level (m/s); adds to the held tendencies there: heat and moisture fluxes (kinematic, times the density at the
//! ground over that of the level) over the cell's height, and the drag `-u*^2 v / |v|` with |v| no less than 0.1 m/s. Any of
//! the tendencies may be unplanned (empty). Errors: none.

use super::parameters::Parameters;
use super::slab::{Crosswind, PIECE, row};

crate::constants! {
    /// Wind below which the drag falls linearly to 0, m/s.
    const CALM_M_S: f32 = 0.1;
}

/// Runs the stage; nothing if the parameters have no surface.
pub fn run(
    parameters: &Parameters,
    u: &[f32],
    v: &[f32],
    slow_u: &mut [f32],
    slow_v: &mut [f32],
    slow_heat: &mut [f32],
    slow_water: &mut [f32],
) {
    let Some(surface) = &parameters.surface else { return };
    let grid = &parameters.grid;
    let [nx, ny, _] = grid.cells;
    let plane = grid.plane();
    let per_height = parameters.density_at_z_face_kg_m3[0] / parameters.density_kg_m3[0] / grid.cell_size_m[2];
    for (slow, flux) in [
        (slow_heat, surface.heat_flux_k_m_s),
        (slow_water, surface.moisture_flux_m_s),
    ] {
        slow.iter_mut().take(plane).for_each(|s| *s += flux * per_height);
    }
    let drag = surface.friction_velocity_m_s * surface.friction_velocity_m_s * per_height;
    let mut across = Crosswind::new();
    for y in 0..ny {
        for at in (0..nx).step_by(PIECE) {
            let cells = PIECE.min(nx - at);
            across.load(grid, [u, v], [y, 0], at, cells);
            let (u, v) = (&row(grid, u, y, 0)[at..at + cells], &row(grid, v, y, 0)[at..at + cells]);
            let here = y * nx + at..y * nx + at + cells;
            let (slow_u, slow_v) = (&mut slow_u[here.clone()], &mut slow_v[here]);
            for i in 0..cells {
                let (v_at_u, u_at_v) = (across.v_at_u[i], across.u_at_v[i]);
                slow_u[i] -= drag * u[i] / (u[i] * u[i] + v_at_u * v_at_u).sqrt().max(CALM_M_S);
                slow_v[i] -= drag * v[i] / (u_at_v * u_at_v + v[i] * v[i]).sqrt().max(CALM_M_S);
            }
        }
    }
}
