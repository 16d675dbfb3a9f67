//! Stage `project`: subtracts the pressure gradient.
//!
//! Reads `Pressure` (m2/s2) at centres; changes the three velocities at their faces in place: `v -= dt grad phi`. Second order, the exact
//! counterpart of `pressure_solve`: afterwards `div(rho v)` is 0 to rounding. w at the ground is left alone (it is 0). Errors:
//! none. Bytes a cell: 28.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::slab::{back, row};

/// Runs the stage.
pub fn run(parameters: &Parameters, pressure: &[f32], dt_s: f32, velocity: [&mut [f32]; 3]) {
    let grid = &parameters.grid;
    let [nx, ny, _] = grid.cells;
    let plane = grid.plane();
    let [rx, ry, rz] = grid.cell_size_m.map(|d| dt_s / d);
    let [u, v, w] = velocity;
    u.par_chunks_mut(plane)
        .zip(v.par_chunks_mut(plane))
        .zip(w.par_chunks_mut(plane))
        .enumerate()
        .for_each(|(z, ((u, v), w))| {
            for y in 0..ny {
                let here = &row(grid, pressure, y, z)[..nx];
                let south = &row(grid, pressure, back(y, 1, ny), z)[..nx];
                let at = y * nx;
                let (u, v, w) = (&mut u[at..at + nx], &mut v[at..at + nx], &mut w[at..at + nx]);
                u[0] -= rx * (here[0] - here[nx - 1]);
                for i in 1..nx {
                    u[i] -= rx * (here[i] - here[i - 1]);
                }
                for i in 0..nx {
                    v[i] -= ry * (here[i] - south[i]);
                }
                if z > 0 {
                    let below = &row(grid, pressure, y, z - 1)[..nx];
                    for i in 0..nx {
                        w[i] -= rz * (here[i] - below[i]);
                    }
                }
            }
        });
}
