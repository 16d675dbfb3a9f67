//! Stage `semi_lagrangian_linear`: carries one quantity, at centres or at one kind of face, through a whole substep by linear interpolation.
//!
//! Reads the quantity (with its tendencies, see `add_tendencies`), its three displacements (cells) from `departure` and for w the
//! buoyancy at centres; writes the next value: the trilinear mean of the eight values around the departure point, and for w the buoyancy
//! of the substep's end at the point of arrival: w after heat, forward and backward, is stable for oscillations up to `N dt = 2`. Order: first in space (its error is a diffusion of `t (1 - t) dx^2 / (2 dt)`, t the departure point's fraction of a cell),
//! none in time of its own. Keeps extrema. Does not keep sums: the mean over the box drifts. Stable at any Courant number.
//! Errors: none; NaN in, NaN out. Bytes a cell: 20, and eight values read out of order. Source: Stam (1999), seed 004 chapter 7.1.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::semi_lagrangian::{CHUNK, Carried, Lattice, around, displacements, eight, trilinear};
use super::slab::{SLAB_LEVELS, slab_len};

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn slab(parameters: &Parameters, carried: &Carried, first: usize, out: &mut [f32]) {
    let grid = &parameters.grid;
    let [nx, ny, levels] = grid.cells;
    let lattice = Lattice::new(grid, carried.place);
    let mut departure = [[0.0f32; CHUNK]; 3];
    for z in first..(first + SLAB_LEVELS).min(levels) {
        for y in 0..ny {
            let out = &mut out[((z - first) * ny + y) * nx..][..nx];
            if carried.is_wall(z) {
                out.fill(0.0);
                continue;
            }
            for begin in (0..nx).step_by(CHUNK) {
                let n = CHUNK.min(nx - begin);
                let out = &mut out[begin..][..n];
                displacements(grid, carried.place, carried.departure, [y, z], begin, n, &mut departure);
                around!(grid, lattice, [y, z], begin, departure, n, |i, corners, t| {
                    out[i] = trilinear(eight(carried.state, &corners), t);
                });
            }
            carried.add_buoyancy(grid, y, z, out);
        }
    }
}

/// Runs the stage; `out` is overwritten whole.
pub fn run(parameters: &Parameters, carried: &Carried, out: &mut [f32]) {
    out.par_chunks_mut(slab_len(&parameters.grid))
        .enumerate()
        .for_each(|(s, out)| slab(parameters, carried, s * SLAB_LEVELS, out));
}
