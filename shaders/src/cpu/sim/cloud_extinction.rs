//! Stage `cloud_extinction`: from cloud water to what light meets.
//!
//! Reads `CloudWater` (kg/kg) at centres; writes `Extinction` (1/m) at centres. Geometric optics, extinction efficiency 2:
//! the effective radius is that of N droplets holding the liquid water content `rho q_c`, with k = (r_v / r_e)^3 = 0.8
//! (Martin et al. 1994, maritime air), written as
//! `beta = 3 rho q_c / (2 rho_w r_e)`, `r_e = (3 rho q_c / (4 pi rho_w k N))^(1/3)`. Errors: none; negative cloud water gives 0. Bytes a cell: 8.

use rayon::prelude::*;

use super::parameters::Parameters;
use crate::constants::WATER_DENSITY_KG_M3;

crate::constants! {
    /// Cube of volume-mean over effective radius.
    const RADIUS_RATIO_CUBED: f64 = 0.8;
    /// Cloud water below this is not drawn: less than a thousandth of a thin cloud's, rounding of the adjustment.
    pub const CLOUD_WATER_MIN: f32 = 1e-7;
}

/// Effective radius over the cube root of the cloud water at level `z`, m: `r_e = (a q)^(1/3)`.
pub fn radius_scale(parameters: &Parameters, z: usize) -> f64 {
    let density = parameters.density_kg_m3[z] as f64;
    let number = parameters.droplet_number_per_m3 as f64;
    let a = 3.0 * density / (4.0 * std::f64::consts::PI * WATER_DENSITY_KG_M3 * RADIUS_RATIO_CUBED * number);
    a.cbrt()
}

/// Extinction over (cloud water)^(2/3) at level `z`, 1/m: `beta = b q / r_e`.
pub fn scale(parameters: &Parameters, z: usize) -> f32 {
    let b = 1.5 * parameters.density_kg_m3[z] as f64 / WATER_DENSITY_KG_M3;
    (b / radius_scale(parameters, z)) as f32
}

/// Runs the stage over all levels.
pub fn run(parameters: &Parameters, cloud_water: &[f32], extinction: &mut [f32]) {
    let plane = parameters.grid.plane();
    extinction
        .par_chunks_mut(plane)
        .zip(cloud_water.par_chunks(plane))
        .enumerate()
        .for_each(|(z, (extinction, cloud_water))| {
            let scale = scale(parameters, z);
            for (e, &q) in extinction.iter_mut().zip(cloud_water) {
                *e = if q > CLOUD_WATER_MIN {
                    let root = q.cbrt();
                    scale * root * root
                } else {
                    0.0
                };
            }
        });
}
