//! Stage `dry_buoyancy`: how buoyant air without water is.
//!
//! Reads `Heat` (K over the reference) at centres; writes `Buoyancy` (m/s2) at centres: `g (theta - theta_v0) / theta_v0`. Errors:
//! none. Bytes a cell: 8.

use rayon::prelude::*;

use super::parameters::Parameters;
use crate::constants::GRAVITY_M_S2;

/// Runs the stage over all levels.
pub fn run(parameters: &Parameters, heat: &[f32], buoyancy: &mut [f32]) {
    let plane = parameters.grid.plane();
    buoyancy
        .par_chunks_mut(plane)
        .zip(heat.par_chunks(plane))
        .enumerate()
        .for_each(|(z, (buoyancy, heat))| {
            let theta_v0 = parameters.virtual_potential_temperature_k[z];
            let lift = GRAVITY_M_S2 as f32 / theta_v0;
            let offset = parameters.heat_reference_k - theta_v0;
            for (b, h) in buoyancy.iter_mut().zip(heat) {
                *b = lift * (h + offset);
            }
        });
}
