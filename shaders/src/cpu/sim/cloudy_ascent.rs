//! Stage `cloudy_ascent`: what liquid-water potential temperature loses as cloudy air rises.
//!
//! Reads `CloudWater` (kg/kg) at centres and w (m/s) at lower faces, both of the Runge-Kutta stage's state; adds to the next `Heat` (K)
//! at centres, after it has been carried. `theta_l = theta - (L / (c_p Pi)) q_c` is conserved only where Pi is: on a reversible ascent
//! `c_p Pi dtheta = L dq_c`, which leaves `dtheta_l = -(L / c_p) q_c d(1/Pi)` (the definition differentiated; Betts 1973 notes that the
//! linear form holds for shallow cloud). In a shallow cumulus that is a few hundredths of a kelvin; saturated air of 20 C lifted from
//! 1000 to 300 hPa would end 5.6 K too warm without it.
//! Scheme: q_c times the mean of w d(1/Pi)/dz at the cell's two faces, second order; `d(1/Pi)/dz = g / (c_p theta_v0 Pi2)` by the
//! hydrostatic reference state. Keeps: total water (not written); 0 without cloud. The mass-weighted sum of theta_l changes: this is
//! one of its named sources. Subsidence of `large_scale` is left out (below 1 cm/s). Errors: none. Bytes a cell: 16.

use rayon::prelude::*;

use super::parameters::Parameters;
use crate::constants as c;

/// `(L / c_p) d(1/Pi)/dz` at the lower face of level `z`, K/m; 0 at ground and lid, where w is 0.
pub fn rate_at_face(parameters: &Parameters, z: usize) -> f32 {
    if z == 0 || z == parameters.grid.cells[2] {
        return 0.0;
    }
    let (exner, theta_v) = (&parameters.exner, &parameters.virtual_potential_temperature_k);
    let mean_theta_v = 0.5 * (theta_v[z - 1] + theta_v[z]);
    let latent = (c::LATENT_HEAT_VAPORISATION / c::HEAT_CAPACITY_DRY_AIR) as f32;
    let lapse = (c::GRAVITY_M_S2 / c::HEAT_CAPACITY_DRY_AIR) as f32;
    latent * lapse / (mean_theta_v * exner[z - 1] * exner[z])
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn level(below: f32, above: f32, cloud: &[f32], w: &[f32], w_above: &[f32], heat: &mut [f32]) {
    let n = heat.len();
    let (cloud, w, w_above) = (&cloud[..n], &w[..n], &w_above[..n]);
    for i in 0..n {
        heat[i] -= cloud[i] * (below * w[i] + above * w_above[i]);
    }
}

/// Runs the stage over all levels; `heat` is the next value, changed in place by `dt_s` seconds of the source.
pub fn run(parameters: &Parameters, cloud: &[f32], velocity_z: &[f32], dt_s: f32, heat: &mut [f32]) {
    let (plane, levels) = (parameters.grid.plane(), parameters.grid.cells[2]);
    heat.par_chunks_mut(plane).enumerate().for_each(|(z, heat)| {
        let at = |z: usize| z * plane..(z + 1) * plane;
        let half = 0.5 * dt_s;
        level(
            half * rate_at_face(parameters, z),
            half * rate_at_face(parameters, z + 1),
            &cloud[at(z)],
            &velocity_z[at(z)],
            &velocity_z[at((z + 1).min(levels - 1))],
            heat,
        );
    });
}
