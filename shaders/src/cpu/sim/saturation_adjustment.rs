//! Stage `saturation_adjustment`: what water is cloud, and how buoyant the air is.
//!
//! Reads `Heat` (K over the reference) and `Water` (kg/kg) at centres; writes `CloudWater` (kg/kg) and `Buoyancy` (m/s2) at centres.
//! Solves `T = T_l + (L / c_p) q_c`, `q_c = max(0, q_t - q_s(T, p))` by Newton's method from the linearised start;
//! saturation after Bolton (1980), pressure that of the reference state. Buoyancy is `g (theta_v - theta_v0) / theta_v0` with
//! `theta_v = theta (1 + 0.608 q_v - q_c)`. Keeps liquid-water potential temperature and total water exactly (neither is
//! written). Residual after the four steps: below 1e-3 K for supersaturations up to a factor of three.
//! Rows with no saturated cell skip the iteration. Errors: none; negative water counts as none. Bytes a cell: 16.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::slab::{SLAB_LEVELS, slab_len};
use crate::constants as c;
use crate::cpu::math::exp;

crate::constants! {
    /// Latent heat over the heat capacity, K.
    pub const LATENT_OVER_CP: f32 = (c::LATENT_HEAT_VAPORISATION / c::HEAT_CAPACITY_DRY_AIR) as f32;
    /// How much lighter vapour is than air.
    const VAPOUR_LIGHTNESS: f32 = (1.0 / c::EPSILON - 1.0) as f32;
    /// 1 less the ratio of the gas constants.
    const ONE_LESS_EPSILON: f32 = (1.0 - c::EPSILON) as f32;
    /// Steps of Newton's method, the linearised start counted.
    const NEWTON_STEPS: usize = 4;
}

/// Saturation specific humidity (kg/kg) and its slope by temperature (1/K), by Bolton's vapour pressure.
#[inline(always)]
fn saturation(pressure_pa: f32, temperature_k: f32) -> (f32, f32) {
    let t = (temperature_k - 29.65).max(50.0);
    let vapour_pressure = (611.2 * exp(17.67 * (temperature_k - 273.15) / t)).min(0.5 * pressure_pa);
    let dry = 1.0 / (pressure_pa - ONE_LESS_EPSILON * vapour_pressure);
    let q = c::EPSILON as f32 * vapour_pressure * dry;
    (q, q * pressure_pa * dry * (17.67 * 243.5) / (t * t))
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn level(parameters: &Parameters, z: usize, heat: &[f32], water: &[f32], cloud: &mut [f32], buoyancy: &mut [f32]) {
    let pressure = parameters.pressure_pa[z];
    let exner = parameters.exner[z];
    let per_exner = 1.0 / exner;
    let reference = parameters.heat_reference_k;
    let theta_v0 = parameters.virtual_potential_temperature_k[z];
    let lift = c::GRAVITY_M_S2 as f32 / theta_v0;
    let nx = parameters.grid.cells[0];
    for (((heat, water), cloud), buoyancy) in heat
        .chunks_exact(nx)
        .zip(water.chunks_exact(nx))
        .zip(cloud.chunks_exact_mut(nx))
        .zip(buoyancy.chunks_exact_mut(nx))
    {
        let (heat, water) = (&heat[..nx], &water[..nx]);
        let (cloud, buoyancy) = (&mut cloud[..nx], &mut buoyancy[..nx]);
        let mut saturated = 0u32;
        for i in 0..nx {
            let (q, _) = saturation(pressure, exner * (reference + heat[i]));
            saturated |= u32::from(water[i] > q);
        }
        if saturated != 0 {
            for i in 0..nx {
                let water = water[i].max(0.0);
                let cold = exner * (reference + heat[i]);
                let (q, slope) = saturation(pressure, cold);
                let mut t = cold + LATENT_OVER_CP * (water - q).max(0.0) / (1.0 + LATENT_OVER_CP * slope);
                for _ in 1..NEWTON_STEPS {
                    let (q, slope) = saturation(pressure, t);
                    let residual = t - cold - LATENT_OVER_CP * (water - q);
                    t -= residual / (1.0 + LATENT_OVER_CP * slope);
                    t = t.max(cold);
                }
                cloud[i] = (t - cold) / LATENT_OVER_CP;
            }
        } else {
            cloud.fill(0.0);
        }
        for i in 0..nx {
            let condensed = LATENT_OVER_CP * per_exner * cloud[i];
            let theta_excess = heat[i] + condensed;
            let theta = reference + theta_excess;
            let vapour = (water[i] - cloud[i]).max(0.0);
            // Differences first: 300 K would swallow the millikelvins that matter.
            buoyancy[i] =
                lift * (theta_excess + (reference - theta_v0) + theta * (VAPOUR_LIGHTNESS * vapour - cloud[i]));
        }
    }
}

/// Runs the stage over all levels.
pub fn run(parameters: &Parameters, heat: &[f32], water: &[f32], cloud: &mut [f32], buoyancy: &mut [f32]) {
    let plane = parameters.grid.plane();
    let len = slab_len(&parameters.grid);
    cloud
        .par_chunks_mut(len)
        .zip(buoyancy.par_chunks_mut(len))
        .enumerate()
        .for_each(|(s, (cloud, buoyancy))| {
            for (l, (cloud, buoyancy)) in cloud
                .chunks_exact_mut(plane)
                .zip(buoyancy.chunks_exact_mut(plane))
                .enumerate()
            {
                let z = s * SLAB_LEVELS + l;
                level(
                    parameters,
                    z,
                    &heat[z * plane..(z + 1) * plane],
                    &water[z * plane..(z + 1) * plane],
                    cloud,
                    buoyancy,
                );
            }
        });
}
