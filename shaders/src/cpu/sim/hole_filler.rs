//! Stage `hole_filler`: takes what a carried quantity is short of below zero from its own column.
//!
//! Reads and writes the carried result at centres (kg/kg), once a substep, after its last stage. A cell below zero is set to zero and its
//! want, as mass, is taken from the next cell above, and so on; what the top still wants is taken on the way down. Fluxes of fifth order
//! undershoot by a permille of a jump, which is below zero only where air with hardly any water lies beside moist air; held tendencies may dry
//! a dry cell too. Keeps: the column's mass, to rounding, and every value that is not negative in a column without negative ones, bit for bit.
//! Does not keep: extrema above zero in the cells that give. A column that holds less than nothing in all keeps that in its lowest level: no water
//! is made. Rows side by side, each column by itself in one order: bit-identical for any number of threads. Errors: none. Bytes a cell: 4 to look;
//! where something is negative another 16 for the levels from there to the top and back.
//! Source: vertical borrowing, as general circulation models do it (Rasch and Williamson 1990).

use rayon::prelude::*;

use super::parameters::Parameters;

/// Cells that one task takes from a level.
const CHUNK: usize = 1 << 12;

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn any_negative(values: &[f32]) -> bool {
    let mut found = false;
    for eights in values.chunks(64) {
        found |= eights.iter().fold(false, |any, &q| any | (q < 0.0));
    }
    found
}

/// Settles one level: `want` is what the level before was short of, as mass, then what this one is.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn settle(density: f32, want: &mut [f32], values: &mut [f32]) {
    let n = values.len();
    let want = &mut want[..n];
    for i in 0..n {
        let q = values[i] + want[i] / density;
        let short = if q < 0.0 { q } else { 0.0 };
        values[i] = q - short;
        want[i] = short * density;
    }
}

/// Runs the stage; `want` is scratch, one a column.
pub fn run(parameters: &Parameters, want: &mut [f32], out: &mut [f32]) {
    let plane = parameters.grid.plane();
    let Some(lowest) = out.par_chunks(plane).position_first(any_negative) else {
        return;
    };
    want.fill(0.0);
    let density = &parameters.density_kg_m3;
    let top = parameters.grid.cells[2];
    let mut pass = |z: usize| {
        let level = &mut out[z * plane..(z + 1) * plane];
        level
            .par_chunks_mut(CHUNK)
            .zip(want.par_chunks_mut(CHUNK))
            .for_each(|(values, want)| settle(density[z], want, values));
    };
    (lowest..top).for_each(&mut pass);
    (0..top).rev().for_each(&mut pass);
    // Nobody has it: it stays, so that nothing is made.
    let ground = &mut out[..plane];
    ground
        .par_chunks_mut(CHUNK)
        .zip(want.par_chunks(CHUNK))
        .for_each(|(values, want)| values.iter_mut().zip(want).for_each(|(q, w)| *q += w / density[0]));
}
