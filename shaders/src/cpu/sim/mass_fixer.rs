//! Stage `mass_fixer`: gives a carried quantity the mass-weighted sum again that it had before it was carried.
//!
//! Reads what was carried (the state with its tendencies) and the carried result, at centres; multiplies the result everywhere by the one
//! factor that makes the sums equal. For water: a factor keeps its sign, and dry air stays dry. A semi-Lagrangian step changes the sum by
//! some 1e-6; the fixer spreads that over the whole box in proportion to what is there, which is no transport but is small. It undoes no source: those
//! are in the sum before. Keeps: the sum, to rounding. Does not keep: extrema, by the same 1e-6. Does nothing where either sum is not positive.
//! The sums are taken level by level in f64 and joined in order: bit-identical for any number of threads. Errors: none. Bytes a cell: 16.
//! Source: the proportional mass fixer, as described by Diamantakis and Flemming (2014).

use rayon::prelude::*;

use super::parameters::Parameters;

/// The sum of a level. Eight running sums side by side, for SIMD.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn level_sum(values: &[f32]) -> f64 {
    let mut sums = [0.0f64; 8];
    let (eights, rest) = values.as_chunks::<8>();
    for eight in eights {
        for k in 0..8 {
            sums[k] += f64::from(eight[k]);
        }
    }
    sums.iter().sum::<f64>() + rest.iter().map(|&v| f64::from(v)).sum::<f64>()
}

/// Runs the stage; `levels` is scratch, one a level.
pub fn run(parameters: &Parameters, before: &[f32], levels: &mut [[f64; 2]], out: &mut [f32]) {
    let plane = parameters.grid.plane();
    let after = &*out;
    levels.par_iter_mut().enumerate().for_each(|(z, sums)| {
        let density = f64::from(parameters.density_kg_m3[z]);
        let at = z * plane..(z + 1) * plane;
        *sums = [&before[at.clone()], &after[at]].map(|level| density * level_sum(level));
    });
    let [before, after] = levels.iter().fold([0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
    if !(before > 0.0 && after > 0.0) {
        return;
    }
    let factor = (before / after) as f32;
    out.par_chunks_mut(plane)
        .for_each(|level| level.iter_mut().for_each(|q| *q *= factor));
}
