//! Stage `departure`: where the air at each cell centre was a substep ago, or (with the time turned round) where it will be.
//!
//! Reads the wind at centres (m/s, from `centre_wind`); writes three displacements in cells at centres: the air at index `i` came from
//! `i - displacement`. Scheme: the explicit midpoint rule, `dt v(x - dt/2 v(x))`, with trilinear interpolation at the midpoint, which
//! stays in the box; the wind is that of the substep's start. A displacement may lead out of the box: who reads it moves its end onto the lattice.
//! Order: second in space and, for a steady wind, in the length of the substep; first where the wind changes in time.
//! Errors: none; NaN in, NaN out. Bytes a cell: 24, and 24 values read out of order. Source: Staniforth and Cote (1991), equation
//! (14) with one iteration.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::semi_lagrangian::{CHUNK, Lattice, around, eight, trilinear};
use super::slab::{SLAB_LEVELS, slab_len};
use crate::catalogue::Place;

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn slab(parameters: &Parameters, wind: [&[f32]; 3], dt_s: f32, first: usize, out: [&mut [f32]; 3]) {
    let grid = &parameters.grid;
    let [nx, ny, levels] = grid.cells;
    let lattice = Lattice::new(grid, Place::Centre);
    let per_cell = grid.cell_size_m.map(|d| dt_s / d);
    let [out_x, out_y, out_z] = out;
    let mut half = [[0.0f32; CHUNK]; 3];
    for z in first..(first + SLAB_LEVELS).min(levels) {
        for y in 0..ny {
            for begin in (0..nx).step_by(CHUNK) {
                let n = CHUNK.min(nx - begin);
                let at = grid.index(begin, y, z);
                for c in 0..3 {
                    let (half, wind) = (&mut half[c][..n], &wind[c][at..][..n]);
                    for i in 0..n {
                        half[i] = 0.5 * per_cell[c] * wind[i];
                    }
                }
                let at = at - first * grid.plane();
                let (ox, oy, oz) = (&mut out_x[at..][..n], &mut out_y[at..][..n], &mut out_z[at..][..n]);
                around!(grid, lattice, [y, z], begin, half, n, |i, corners, t| {
                    ox[i] = per_cell[0] * trilinear(eight(wind[0], &corners), t);
                    oy[i] = per_cell[1] * trilinear(eight(wind[1], &corners), t);
                    oz[i] = per_cell[2] * trilinear(eight(wind[2], &corners), t);
                });
            }
        }
    }
}

/// Runs the stage; `dt_s` is negative to look ahead in time.
pub fn run(parameters: &Parameters, wind: [&[f32]; 3], dt_s: f32, out: [&mut [f32]; 3]) {
    let len = slab_len(&parameters.grid);
    let [x, y, z] = out;
    x.par_chunks_mut(len)
        .zip(y.par_chunks_mut(len))
        .zip(z.par_chunks_mut(len))
        .enumerate()
        .for_each(|(s, ((x, y), z))| slab(parameters, wind, dt_s, s * SLAB_LEVELS, [x, y, z]));
}
