//! Stage `sky_light`: what the sky as a whole gives to clouds and ground.
//!
//! Reads: [`Atmosphere`] and its tables, a [`SkySource`], the heights of the clouds' base and top. Writes: [`SkyLight`]. Scheme: the sky's radiance
//! summed over 8 rings of equal solid angle by 12 azimuths, as level ground sees it and as it is midway between the clouds' base and top, where less haze lies above.

use std::f32::consts::PI;

use rayon::prelude::*;

use super::analytic_sky::AnalyticSky;
use super::atmosphere::Atmosphere;
use super::multiple_scattering_table::MultipleScatteringTable;
use super::sky_table::{SkySource, radiance};
use super::transmittance_table::TransmittanceTable;

crate::constants! {
    /// Rings of directions.
    const SKY_LIGHT_RINGS: usize = 8;
    /// Directions a ring.
    const SKY_LIGHT_AROUND: usize = 12;
    /// Height that the ground sees the sky from, m.
    pub(crate) const SKY_LIGHT_HEIGHT_M: f32 = 10.0;
}

/// Light for clouds and ground, relative to the sun's irradiance above the atmosphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkyLight {
    /// Irradiance of the sun, or by night of the moon, across its beam at the clouds' base.
    pub sun_at_base: [f32; 3],
    /// The same at the clouds' top.
    pub sun_at_top: [f32; 3],
    /// The same at the ground.
    pub sun_at_ground: [f32; 3],
    /// Mean radiance of the upper half of the sky, midway between the clouds' base and top.
    pub sky_radiance: [f32; 3],
    /// Irradiance of level ground by the sky without the sun.
    pub sky_irradiance: [f32; 3],
    /// Mean radiance that comes up from ground without clouds.
    pub ground_radiance: [f32; 3],
}

impl SkyLight {
    /// A beam of irradiance 1 on clouds alone: no air, no sky, and dark ground.
    pub const BEAM_ON_CLOUDS: SkyLight = SkyLight {
        sun_at_base: [1.0; 3],
        sun_at_top: [1.0; 3],
        sun_at_ground: [0.0; 3],
        sky_radiance: [0.0; 3],
        sky_irradiance: [0.0; 3],
        ground_radiance: [0.0; 3],
    };
    /// Computes the sums; `ground_albedo` is the share of light that the ground gives back.
    pub fn new(
        air: &Atmosphere,
        transmittance: &TransmittanceTable,
        multiple: &MultipleScatteringTable,
        ground_albedo: [f32; 3],
        source: &SkySource,
        analytic: Option<&AnalyticSky>,
        base_top_m: [f32; 2],
    ) -> SkyLight {
        let (rings, around) = (SKY_LIGHT_RINGS, SKY_LIGHT_AROUND);
        let count = rings * around;
        // From the ground, and from the clouds' middle.
        let heights_m = [SKY_LIGHT_HEIGHT_M, 0.5 * (base_top_m[0] + base_top_m[1])];
        let looks: Vec<([f32; 3], f32)> = (0..2 * count)
            .into_par_iter()
            .map(|look| {
                let n = look % count;
                let sine = ((n / around) as f32 + 0.5) / rings as f32;
                let azimuth = ((n % around) as f32 + 0.5) / around as f32 * 2.0 * PI;
                let side = (1.0 - sine * sine).sqrt();
                let direction = [side * azimuth.cos(), side * azimuth.sin(), sine];
                let scattered = radiance(
                    air,
                    transmittance,
                    multiple,
                    heights_m[look / count],
                    direction,
                    source,
                    Some(false),
                );
                (analytic.map_or(scattered, |a| a.over(scattered, direction)), sine)
            })
            .collect();
        let (at_ground, at_clouds) = looks.split_at(count);
        let sum = |looks: &[([f32; 3], f32)], weight: &dyn Fn(f32) -> f32| {
            [0, 1, 2].map(|c| looks.iter().map(|(light, sine)| light[c] * weight(*sine)).sum::<f32>() / count as f32)
        };
        let sky_radiance = sum(at_clouds, &|_| 1.0);
        let sky_irradiance = sum(at_ground, &|sine| 2.0 * PI * sine);
        let mu = source.direction[2];
        let beam_at = |height_m: f32| {
            let passed = transmittance.of_sun(height_m, mu);
            [0, 1, 2].map(|c| passed[c] * source.strength[c])
        };
        let mut light = SkyLight {
            sun_at_base: beam_at(base_top_m[0]),
            sun_at_top: beam_at(base_top_m[1]),
            sun_at_ground: beam_at(1.0),
            sky_radiance,
            sky_irradiance,
            ground_radiance: [0.0; 3],
        };
        light.ground_radiance = light.ground_gives(ground_albedo, mu);
        light
    }
    fn ground_gives(&self, albedo: [f32; 3], beam_sine: f32) -> [f32; 3] {
        [0, 1, 2].map(|c| albedo[c] / PI * (self.sun_at_ground[c] * beam_sine.max(0.0) + self.sky_irradiance[c]))
    }
    /// The same with the moon's light added: its sky whole, and where its beam is let in, that in place of the sun's, which is down then. `moon_sine` is the sine of the
    /// moon's elevation.
    pub fn with_moon(&self, moon: &SkyLight, beam_share: f32, ground_albedo: [f32; 3], moon_sine: f32) -> SkyLight {
        let sum = |a: [f32; 3], b: [f32; 3]| [0, 1, 2].map(|c| a[c] + b[c]);
        let beam = |sun: [f32; 3], moon: [f32; 3]| {
            if beam_share > 0.0 {
                moon.map(|m| m * beam_share)
            } else {
                sun
            }
        };
        let mut light = SkyLight {
            sun_at_base: beam(self.sun_at_base, moon.sun_at_base),
            sun_at_top: beam(self.sun_at_top, moon.sun_at_top),
            sun_at_ground: beam(self.sun_at_ground, moon.sun_at_ground),
            sky_radiance: sum(self.sky_radiance, moon.sky_radiance),
            sky_irradiance: sum(self.sky_irradiance, moon.sky_irradiance),
            ground_radiance: sum(self.ground_radiance, moon.ground_radiance),
        };
        if beam_share > 0.0 {
            light.ground_radiance = light.ground_gives(ground_albedo, moon_sine);
        }
        light
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Higher clouds have less air above them: their sky is darker, red most of all, for haze scatters all colours; what the ground gets does not hang on the clouds' height.
    #[test]
    fn the_sky_is_darker_from_higher_clouds() {
        let air = Atmosphere::new(1.0, None);
        let transmittance = TransmittanceTable::new(&air);
        let multiple = MultipleScatteringTable::new(&air, &transmittance);
        let source = SkySource::sun([0.0, 0.6, 0.8], false);
        let of = |base_top_m| SkyLight::new(&air, &transmittance, &multiple, [0.2; 3], &source, None, base_top_m);
        let [low, high] = [of([10.0, 10.0]), of([2_000.0, 4_000.0])];
        assert_eq!(low.sky_irradiance, high.sky_irradiance);
        let ratio = [0, 1, 2].map(|c| high.sky_radiance[c] / low.sky_radiance[c]);
        assert!(
            ratio[0] < ratio[1] && ratio[1] < ratio[2] && ratio[2] < 1.0,
            "{ratio:?}"
        );
        assert!(ratio[0] > 0.2, "{ratio:?}");
    }
}
