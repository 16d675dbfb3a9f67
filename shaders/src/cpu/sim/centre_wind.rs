//! Stage `centre_wind`: the wind at cell centres, from the faces around.
//!
//! Reads the three velocities (m/s, at their faces); writes three velocities at centres: the mean of the two faces across. Second order.
//! It is what trajectories follow, and nothing else reads it. w at the lid is 0. Errors: none; NaN in, NaN out. Bytes a cell: 24.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::slab::{ahead, row};

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn level(parameters: &Parameters, velocity: [&[f32]; 3], z: usize, out: [&mut [f32]; 3]) {
    let grid = &parameters.grid;
    let [nx, ny, levels] = grid.cells;
    let [u, v, w] = velocity;
    let [out_x, out_y, out_z] = out;
    // Above the last level is the lid.
    let (z_above, there) = if z + 1 < levels { (z + 1, 0.5) } else { (z, 0.0) };
    for y in 0..ny {
        let at = y * nx;
        let (west, south, north) = (row(grid, u, y, z), row(grid, v, y, z), row(grid, v, ahead(y, 1, ny), z));
        let (below, above) = (row(grid, w, y, z), row(grid, w, y, z_above));
        let (west, south, north) = (&west[..nx], &south[..nx], &north[..nx]);
        let (below, above) = (&below[..nx], &above[..nx]);
        let (ox, oy, oz) = (&mut out_x[at..][..nx], &mut out_y[at..][..nx], &mut out_z[at..][..nx]);
        for i in 0..nx - 1 {
            ox[i] = 0.5 * (west[i] + west[i + 1]);
        }
        ox[nx - 1] = 0.5 * (west[nx - 1] + west[0]);
        for i in 0..nx {
            oy[i] = 0.5 * (south[i] + north[i]);
            oz[i] = 0.5 * below[i] + there * above[i];
        }
    }
}

/// Runs the stage over all levels.
pub fn run(parameters: &Parameters, velocity: [&[f32]; 3], out: [&mut [f32]; 3]) {
    let plane = parameters.grid.plane();
    let [x, y, z] = out;
    x.par_chunks_mut(plane)
        .zip(y.par_chunks_mut(plane))
        .zip(z.par_chunks_mut(plane))
        .enumerate()
        .for_each(|(level_z, ((x, y), z))| level(parameters, velocity, level_z, [x, y, z]));
}
