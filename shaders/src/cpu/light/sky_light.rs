//! Stage `sky_light`: what the sky as a whole gives to clouds and ground.
//!
//! Reads: [`Atmosphere`] and its tables, the sun's direction, two heights. Writes: [`SkyLight`]. Scheme: the sky's radiance
//! summed over 8 rings of equal solid angle by 12 azimuths.

use std::f32::consts::PI;

use rayon::prelude::*;

use super::atmosphere::Atmosphere;
use super::multiple_scattering_table::MultipleScatteringTable;
use super::sky_table::radiance;
use super::transmittance_table::TransmittanceTable;

crate::constants! {
    /// Rings of directions.
    const SKY_LIGHT_RINGS: usize = 8;
    /// Directions a ring.
    const SKY_LIGHT_AROUND: usize = 12;
    /// Height that the sky is seen from, m.
    const SKY_LIGHT_HEIGHT_M: f32 = 10.0;
}

/// Light for clouds and ground, relative to the sun's irradiance above the atmosphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkyLight {
    /// The sun's irradiance across its beam at the clouds' base.
    pub sun_at_base: [f32; 3],
    /// The same at the clouds' top.
    pub sun_at_top: [f32; 3],
    /// The same at the ground.
    pub sun_at_ground: [f32; 3],
    /// Mean radiance of the upper half of the sky.
    pub sky_radiance: [f32; 3],
    /// Irradiance of level ground by the sky without the sun.
    pub sky_irradiance: [f32; 3],
    /// Mean radiance that comes up from ground without clouds.
    pub ground_radiance: [f32; 3],
}

impl SkyLight {
    /// Computes the sums; `ground_albedo` is the share of light that the ground gives back.
    pub fn new(
        air: &Atmosphere,
        transmittance: &TransmittanceTable,
        multiple: &MultipleScatteringTable,
        ground_albedo: [f32; 3],
        sun_direction: [f32; 3],
        base_top_m: [f32; 2],
    ) -> SkyLight {
        let (rings, around) = (SKY_LIGHT_RINGS, SKY_LIGHT_AROUND);
        let looks: Vec<([f32; 3], f32)> = (0..rings * around)
            .into_par_iter()
            .map(|n| {
                let sine = ((n / around) as f32 + 0.5) / rings as f32;
                let azimuth = ((n % around) as f32 + 0.5) / around as f32 * 2.0 * PI;
                let side = (1.0 - sine * sine).sqrt();
                let direction = [side * azimuth.cos(), side * azimuth.sin(), sine];
                (
                    radiance(
                        air,
                        transmittance,
                        multiple,
                        SKY_LIGHT_HEIGHT_M,
                        direction,
                        sun_direction,
                        Some(false),
                    ),
                    sine,
                )
            })
            .collect();
        let n = looks.len() as f32;
        let sum = |weight: &dyn Fn(f32) -> f32| {
            [0, 1, 2].map(|c| looks.iter().map(|(light, sine)| light[c] * weight(*sine)).sum::<f32>() / n)
        };
        let sky_radiance = sum(&|_| 1.0);
        let sky_irradiance = sum(&|sine| 2.0 * PI * sine);
        let mu = sun_direction[2];
        let sun_at_ground = transmittance.of_sun(1.0, mu);
        SkyLight {
            sun_at_base: transmittance.of_sun(base_top_m[0], mu),
            sun_at_top: transmittance.of_sun(base_top_m[1], mu),
            sun_at_ground,
            sky_radiance,
            sky_irradiance,
            ground_radiance: [0, 1, 2]
                .map(|c| ground_albedo[c] / PI * (sun_at_ground[c] * mu.max(0.0) + sky_irradiance[c])),
        }
    }
}
