//! Stage `mac_cormack`: carries one quantity through a whole substep, there and back, and corrects by half of what came back wrong.
//!
//! Reads the quantity (with its tendencies, see `add_tendencies`), its displacements back (`departure`) and ahead in time (`departure`
//! with the time turned round) and for w the buoyancy at centres; writes the forward
//! result and its bounds (three fields of scratch) and the next value. Scheme: forward
//! and backward steps are linear semi-Lagrangian ones; the correction is `(q - q there and back) / 2` at the point of arrival; the
//! result is bounded by the eight values around the departure point. Where a trajectory ends beyond the first or last level the way back is not
//! the way there, and the bounds alone keep the correction small. Order: second in space and time for a steady wind, away from extrema (there the
//! limiter leaves first). Keeps extrema. Does not keep sums. Stable at any Courant number, thanks to the limiter.
//! Errors: none; NaN in, NaN out. Bytes a cell: 64, and 16 values read out of order. Source: Selle, Fedkiw, Kim, Liu and Rossignac (2008).

use rayon::prelude::*;

use super::parameters::Parameters;
use super::semi_lagrangian::{CHUNK, Carried, Lattice, around, bounded, displacements, eight, extrema, trilinear};
use super::slab::{SLAB_LEVELS, slab_len};

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn forward_slab(
    parameters: &Parameters,
    carried: &Carried,
    first: usize,
    forward: &mut [f32],
    low: &mut [f32],
    high: &mut [f32],
) {
    let grid = &parameters.grid;
    let [nx, ny, levels] = grid.cells;
    let lattice = Lattice::new(grid, carried.place);
    let mut departure = [[0.0f32; CHUNK]; 3];
    for z in first..(first + SLAB_LEVELS).min(levels) {
        for y in 0..ny {
            let row = ((z - first) * ny + y) * nx;
            if carried.is_wall(z) {
                for field in [&mut *forward, &mut *low, &mut *high] {
                    field[row..][..nx].fill(0.0);
                }
                continue;
            }
            for begin in (0..nx).step_by(CHUNK) {
                let n = CHUNK.min(nx - begin);
                let at = row + begin;
                let (forward, low, high) = (&mut forward[at..][..n], &mut low[at..][..n], &mut high[at..][..n]);
                displacements(grid, carried.place, carried.departure, [y, z], begin, n, &mut departure);
                around!(grid, lattice, [y, z], begin, departure, n, |i, corners, t| {
                    let q = eight(carried.state, &corners);
                    forward[i] = trilinear(q, t);
                    (low[i], high[i]) = extrema(q);
                });
            }
        }
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn correct_slab(
    parameters: &Parameters,
    carried: &Carried,
    arrival: [&[f32]; 3],
    [forward, low, high]: [&[f32]; 3],
    first: usize,
    out: &mut [f32],
) {
    let grid = &parameters.grid;
    let [nx, ny, levels] = grid.cells;
    let lattice = Lattice::new(grid, carried.place);
    let mut ahead = [[0.0f32; CHUNK]; 3];
    for z in first..(first + SLAB_LEVELS).min(levels) {
        for y in 0..ny {
            let out = &mut out[((z - first) * ny + y) * nx..][..nx];
            if carried.is_wall(z) {
                out.fill(0.0);
                continue;
            }
            for begin in (0..nx).step_by(CHUNK) {
                let n = CHUNK.min(nx - begin);
                let at = grid.index(begin, y, z);
                let out = &mut out[begin..][..n];
                displacements(grid, carried.place, arrival, [y, z], begin, n, &mut ahead);
                around!(grid, lattice, [y, z], begin, ahead, n, |i, corners, t| {
                    out[i] = trilinear(eight(forward, &corners), t);
                });
                let (there, old) = (&forward[at..][..n], &carried.state[at..][..n]);
                let (low, high) = (&low[at..][..n], &high[at..][..n]);
                for i in 0..n {
                    out[i] = bounded(there[i] + 0.5 * (old[i] - out[i]), low[i], high[i]);
                }
            }
            carried.add_buoyancy(grid, y, z, out);
        }
    }
}

/// Runs the stage; `arrival` are the displacements of the way ahead in time (negative where `departure` is positive); `scratch` is
/// three fields, overwritten whole like `out`.
pub fn run(
    parameters: &Parameters,
    carried: &Carried,
    arrival: [&[f32]; 3],
    scratch: [&mut [f32]; 3],
    out: &mut [f32],
) {
    let len = slab_len(&parameters.grid);
    let [forward, low, high] = scratch;
    forward
        .par_chunks_mut(len)
        .zip(low.par_chunks_mut(len))
        .zip(high.par_chunks_mut(len))
        .enumerate()
        .for_each(|(s, ((forward, low), high))| {
            forward_slab(parameters, carried, s * SLAB_LEVELS, forward, low, high);
        });
    let made = [&*forward, &*low, &*high];
    out.par_chunks_mut(len)
        .enumerate()
        .for_each(|(s, out)| correct_slab(parameters, carried, arrival, made, s * SLAB_LEVELS, out));
}
