//! Stage `multiple_scattering_table`: light in clear air that was scattered more than once.
//!
//! Reads: [`Atmosphere`], [`TransmittanceTable`]. Writes: table of radiance per unit of sun irradiance, `[height 12][sun 24]`,
//! three colours. Scheme: second-order radiance and the share that is scattered on, summed over 32 directions by 16 steps, then the
//! geometric series of all orders (Hillaire 2020, equations 5 to 10), isotropic. Ground albedo 0.15.

use rayon::prelude::*;

use super::atmosphere::{
    AIR_DEPTH_M, Atmosphere, EARTH_RADIUS_M, distance_to_ground_m, distance_to_shell_m, height_along_m,
};
use super::transmittance_table::{TransmittanceTable, bilinear};

crate::constants! {
    /// Rows of the table.
    pub const MULTIPLE_HEIGHTS: usize = 12;
    /// Columns of the table.
    pub const MULTIPLE_SUNS: usize = 24;
    const MULTIPLE_STEPS: usize = 16;
    /// Rings of directions.
    const MULTIPLE_RINGS: usize = 8;
    /// Directions a ring.
    const MULTIPLE_AROUND: usize = 4;
    const MULTIPLE_GROUND_ALBEDO: f32 = 0.15;
    /// Most that is taken to be scattered on, so that the series ends.
    const MULTIPLE_SHARE_MAX: f32 = 0.95;
}

/// See the module.
#[derive(Clone, Debug)]
pub struct MultipleScatteringTable {
    values: Vec<[f32; 3]>,
}

impl MultipleScatteringTable {
    /// Computes the table; a few ms.
    pub fn new(air: &Atmosphere, transmittance: &TransmittanceTable) -> MultipleScatteringTable {
        let values = (0..MULTIPLE_HEIGHTS * MULTIPLE_SUNS)
            .into_par_iter()
            .map(|n| {
                let (j, i) = (n / MULTIPLE_SUNS, n % MULTIPLE_SUNS);
                let y = j as f32 / (MULTIPLE_HEIGHTS - 1) as f32;
                let mu = sun_cosine(i as f32 / (MULTIPLE_SUNS - 1) as f32);
                one(
                    air,
                    transmittance,
                    (y * y * AIR_DEPTH_M).clamp(1.0, AIR_DEPTH_M - 10.0),
                    mu,
                )
            })
            .collect();
        MultipleScatteringTable { values }
    }
    /// All texels, `[height][sun]`.
    pub fn texels(&self) -> &[[f32; 3]] {
        &self.values
    }
    /// Radiance per unit of sun irradiance at `height_m` with the sun's zenith cosine `mu`.
    pub fn at(&self, height_m: f32, mu: f32) -> [f32; 3] {
        let y = (height_m.max(0.0) / AIR_DEPTH_M).sqrt().min(1.0) * (MULTIPLE_HEIGHTS - 1) as f32;
        let x = (0.5 + 0.5 * mu.signum() * mu.abs().min(1.0).sqrt()) * (MULTIPLE_SUNS - 1) as f32;
        bilinear(&self.values, MULTIPLE_SUNS, MULTIPLE_HEIGHTS, x, y)
    }
}

/// The table is finest around the horizon.
fn sun_cosine(x: f32) -> f32 {
    let s = 2.0 * x - 1.0;
    s.signum() * s * s
}

fn one(air: &Atmosphere, transmittance: &TransmittanceTable, height_m: f32, sun_mu: f32) -> [f32; 3] {
    let mut second = [0.0f32; 3];
    let mut passed_on = [0.0f32; 3];
    let (rings, around) = (MULTIPLE_RINGS, MULTIPLE_AROUND);
    let sun = [(1.0 - sun_mu * sun_mu).max(0.0).sqrt(), 0.0, sun_mu];
    for ring in 0..rings {
        for a in 0..around {
            let mu = (2.0 * (ring as f32 + 0.5) / rings as f32) - 1.0;
            let azimuth = (a as f32 + 0.5) / around as f32 * std::f32::consts::PI;
            let side = (1.0 - mu * mu).sqrt();
            let direction = [side * azimuth.cos(), side * azimuth.sin(), mu];
            let ground = distance_to_ground_m(height_m, mu);
            let whole = ground.unwrap_or_else(|| distance_to_shell_m(height_m, mu, AIR_DEPTH_M));
            let mut through = [1.0f32; 3];
            let mut before = 0.0;
            for s in 0..MULTIPLE_STEPS {
                let f = (s + 1) as f32 / MULTIPLE_STEPS as f32;
                let after = whole * f * f;
                let at = 0.5 * (before + after);
                let h = height_along_m(height_m, mu, at).max(0.0);
                let local_mu = local_sun_cosine(height_m, direction, sun, at, h);
                let c = air.at(h);
                let lit = transmittance.of_sun(h, local_mu);
                for k in 0..3 {
                    let scattering = c.rayleigh_per_m[k] + c.aerosol_per_m;
                    let kept = (-c.extinction_per_m[k] * (after - before)).exp();
                    let share = through[k] * scattering * (1.0 - kept) / c.extinction_per_m[k].max(1e-12);
                    second[k] += share * lit[k] / (4.0 * std::f32::consts::PI);
                    passed_on[k] += share;
                    through[k] *= kept;
                }
                before = after;
            }
            if let Some(distance) = ground {
                let local_mu = local_sun_cosine(height_m, direction, sun, distance, 0.0);
                let lit = transmittance.of_sun(0.0, local_mu);
                for k in 0..3 {
                    second[k] +=
                        through[k] * lit[k] * local_mu.max(0.0) * MULTIPLE_GROUND_ALBEDO / std::f32::consts::PI;
                }
            }
        }
    }
    let n = (rings * around) as f32;
    [0, 1, 2].map(|k| (second[k] / n) / (1.0 - (passed_on[k] / n).min(MULTIPLE_SHARE_MAX)))
}

/// Cosine of the sun's zenith angle at `distance_m` along `direction` from `height_m`, where the height is `h`.
pub(crate) fn local_sun_cosine(height_m: f32, direction: [f32; 3], sun: [f32; 3], distance_m: f32, h: f32) -> f32 {
    let r = EARTH_RADIUS_M + height_m;
    let along = direction[0] * sun[0] + direction[1] * sun[1] + direction[2] * sun[2];
    ((r * sun[2] + distance_m * along) / (EARTH_RADIUS_M + h)).clamp(-1.0, 1.0)
}
