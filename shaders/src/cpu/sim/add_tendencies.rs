//! Stage `add_tendencies`: adds what was held over a substep to the state, so that both are carried together.
//!
//! Reads a field of the state and its held tendency (per second); overwrites the tendency's memory by `state + dt tendency`, which is
//! what a semi-Lagrangian stage carries. Scheme: Euler forward, at the departure points. Why there and not at the arrival: mixing takes water from
//! a cell that has it, and must not take it from the drier air that has come in meanwhile. Keeps signs where the tendency by itself does.
//! Order: first in time. Errors: none. Bytes a cell: 12.

use rayon::prelude::*;

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn chunk(state: &[f32], dt_s: f32, tendency: &mut [f32]) {
    for (t, &q) in tendency.iter_mut().zip(state) {
        *t = q + dt_s * *t;
    }
}

/// Runs the stage on one quantity.
pub fn run(state: &[f32], dt_s: f32, tendency: &mut [f32]) {
    const CHUNK: usize = 1 << 14;
    tendency
        .par_chunks_mut(CHUNK)
        .zip(state.par_chunks(CHUNK))
        .for_each(|(tendency, state)| chunk(state, dt_s, tendency));
}
