//! Stage `sponge`: damps waves before the lid throws them back.
//!
//! Reads the velocities (m/s) and `Heat` (K); adds to their held tendencies `-r(z) (field - base)`, r rising as sin2 from the sponge's
//! bottom to the lid, w to 0, the others to the base state. The rate is bounded by the substep, `r / (1 + r dt)`, so that it never
//! overshoots however long the substep is. Errors: none.

use rayon::prelude::*;

use super::parameters::Parameters;

/// Damps one field to a profile (empty for 0); `at_face` chooses the rates of lower faces; `slow` may be empty.
pub fn run(parameters: &Parameters, field: &[f32], base: &[f32], at_face: bool, substep_s: f32, slow: &mut [f32]) {
    let Some(rates) = &parameters.sponge else { return };
    let plane = parameters.grid.plane();
    let rates = &rates[usize::from(at_face)];
    slow.par_chunks_mut(plane)
        .zip(field.par_chunks(plane))
        .enumerate()
        .for_each(|(z, (slow, field))| {
            let rate = rates[z] / (1.0 + rates[z] * substep_s);
            if rate > 0.0 {
                let base = base.get(z).copied().unwrap_or(0.0);
                for (s, f) in slow.iter_mut().zip(field) {
                    *s -= rate * (f - base);
                }
            }
        });
}
