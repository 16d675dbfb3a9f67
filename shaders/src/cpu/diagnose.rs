//! What a state says of its air in the words of its readers: temperature, humidity, turbulence, visibility.
//!
//! No stage of a tick: these run on the host when somebody asks, over a copy of the state that either device gave. Each reads fields at
//! cell centres `[z][y][x]` and the reference state, and writes one field of the same shape. Nothing is kept and nothing fails;
//! NaN in, NaN out. Levels go to rayon's threads, cells of a level are independent, so results do not depend on the threads.

use rayon::prelude::*;

use super::light::atmosphere::Atmosphere;
use super::math::exp;
use super::sim::Parameters;
use super::sim::cloud_extinction::{CLOUD_WATER_MIN, radius_scale};
use super::sim::eddy_viscosity::length_squared_m2;
use super::sim::saturation_adjustment::LATENT_OVER_CP;
use crate::constants as c;
use crate::grid::Grid;

/// Runs `level(z, out)` over the levels of `out`.
fn by_level(grid: &Grid, out: &mut [f32], level: impl Fn(usize, &mut [f32]) + Sync) {
    out.par_chunks_mut(grid.plane())
        .enumerate()
        .for_each(|(z, out)| level(z, out));
}

/// The part of `field` that is level `z`; empty where the field is.
fn level_of<'a>(grid: &Grid, field: &'a [f32], z: usize) -> &'a [f32] {
    let plane = grid.plane();
    field.get(z * plane..(z + 1) * plane).unwrap_or_default()
}

/// Temperature, K: `exner theta_l + (L / c_p) q_c`. `heat` is liquid-water potential temperature less the reference, K; `cloud_water` (kg/kg) is
/// empty where there is no moisture.
pub fn temperature(parameters: &Parameters, heat: &[f32], cloud_water: &[f32], out: &mut [f32]) {
    let grid = &parameters.grid;
    by_level(grid, out, |z, out| {
        let (exner, reference) = (parameters.exner[z], parameters.heat_reference_k);
        let heat = level_of(grid, heat, z);
        for (t, h) in out.iter_mut().zip(heat) {
            *t = exner * (reference + h);
        }
        for (t, q) in out.iter_mut().zip(level_of(grid, cloud_water, z)) {
            *t += LATENT_OVER_CP * q;
        }
    });
}

/// Vapour, kg/kg: total water less cloud water, never below 0.
pub fn vapour(grid: &Grid, total_water: &[f32], cloud_water: &[f32], out: &mut [f32]) {
    by_level(grid, out, |z, out| {
        let total = level_of(grid, total_water, z);
        for ((v, t), q) in out.iter_mut().zip(total).zip(level_of(grid, cloud_water, z)) {
            *v = (t - q).max(0.0);
        }
    });
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn relative_humidity_level(pressure_pa: f32, temperature: &[f32], vapour: &[f32], out: &mut [f32]) {
    let epsilon = c::EPSILON as f32;
    for ((r, &t), &q) in out.iter_mut().zip(temperature).zip(vapour) {
        let saturated = 611.2 * exp(17.67 * (t - 273.15) / (t - 29.65).max(50.0));
        *r = q * pressure_pa / ((epsilon + (1.0 - epsilon) * q) * saturated);
    }
}

/// Relative humidity over water, 1: vapour pressure `q p / (epsilon + (1 - epsilon) q)` over saturation vapour pressure (Bolton 1980,
/// equation 10), from temperature (K) and vapour (kg/kg).
pub fn relative_humidity(parameters: &Parameters, temperature: &[f32], vapour: &[f32], out: &mut [f32]) {
    let grid = &parameters.grid;
    by_level(grid, out, |z, out| {
        let (temperature, vapour) = (level_of(grid, temperature, z), level_of(grid, vapour, z));
        relative_humidity_level(parameters.pressure_pa[z], temperature, vapour, out);
    });
}

/// Effective radius of droplets, m, from cloud water (kg/kg), as the stage `cloud_extinction` has it; 0 where that draws nothing.
pub fn effective_radius(parameters: &Parameters, cloud_water: &[f32], out: &mut [f32]) {
    let grid = &parameters.grid;
    by_level(grid, out, |z, out| {
        let scale = radius_scale(parameters, z) as f32;
        for (r, &q) in out.iter_mut().zip(level_of(grid, cloud_water, z)) {
            *r = if q > CLOUD_WATER_MIN { scale * q.cbrt() } else { 0.0 };
        }
    });
}

/// Cube root of the eddy dissipation rate, m^(2/3)/s, from the Smagorinsky-Lilly viscosity (m2/s) in place.
///
/// Subgrid production by shear and buoyancy, `nu |S|^2 - (nu / Pr) N^2`, balances dissipation (Lilly 1967). The stage `eddy_viscosity` has
/// `nu = l^2 sqrt(|S|^2 - N^2 / Pr)`, so `epsilon = nu^3 / l^4` and its cube root is `nu / l^(4/3)`, with the same mixing length
/// l, damped at the wall. 0 where stability lets no eddy live. Nothing without turbulence.
pub fn eddy_dissipation_rate(parameters: &Parameters, viscosity: &mut [f32]) {
    let Some(turbulence) = &parameters.turbulence else {
        return;
    };
    let grid = &parameters.grid;
    by_level(grid, viscosity, |z, viscosity| {
        let length_squared = f64::from(length_squared_m2(grid, turbulence.coefficient, z));
        let per_length = length_squared.powf(-2.0 / 3.0) as f32;
        viscosity.iter_mut().for_each(|nu| *nu *= per_length);
    });
}

/// Horizontal visibility by day, m: see [`visibility_m`]. `extinction` (1/m) is empty where there is no moisture.
pub fn visibility(air: &Atmosphere, grid: &Grid, extinction: &[f32], out: &mut [f32]) {
    by_level(grid, out, |z, out| {
        let clear_per_m = clear_air_per_m(air, grid.centre_height_m(z) as f32);
        out.fill(CONTRAST / clear_per_m);
        for (v, cloud) in out.iter_mut().zip(level_of(grid, extinction, z)) {
            *v = CONTRAST / (clear_per_m + cloud);
        }
    });
}

/// Koschmieder's numerator at 5 % contrast, ln 20, rounded as the scene's `aerial_perspective.visibility_m` is read.
const CONTRAST: f32 = 3.0;

/// Extinction of green light by molecules and aerosol at a height, 1/m.
fn clear_air_per_m(air: &Atmosphere, height_m: f32) -> f32 {
    air.at(height_m).extinction_per_m[1]
}

/// Horizontal visibility, m, at a height (m above the ground) with so much extinction by cloud (1/m): 3 over all extinction of green light.
pub fn visibility_m(air: &Atmosphere, height_m: f32, cloud_per_m: f32) -> f32 {
    CONTRAST / (clear_air_per_m(air, height_m) + cloud_per_m)
}
