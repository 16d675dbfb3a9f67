//! Stage `moon`: the moon as a lamp and as a disc.
//!
//! Reads: where sun and moon stand. Writes: [`MoonLook`], what the sky table, the light on clouds and ground and the march are told of it; radiance of the disc in the
//! march. Scheme: irradiance by the law of phases V = -12.73 + 0.026 |a| + 4e-9 a^4 (a in degrees, at the mean distance; Allen 1976 as in Krisciunas and
//! Schaefer 1991), falling with the square of the distance; the disc by Lommel and Seeliger's law, which makes a full moon flat, scaled so that its mean gives the law of phases; its night side
//! in the Earth's light. The moon is lit by the scene's sun, so its phase follows from where both stand.
//!
//! Errors: no seas and no rays on the disc, no surge within some degrees of opposition (up to a third), no eclipses. The moon takes over the beam, the light that casts shadows, while
//! the sun sinks from 4 to 6 degrees below the horizon: no place below 15 km sees the sun then.

use super::stars::colour_of;
use super::transmittance_table::TransmittanceTable;
use crate::cpu::view::lanes::Lanes;

crate::constants! {
    /// Radius of the moon, m.
    pub const MOON_RADIUS_M: f32 = 1_737_400.0;
    /// Distance that the law of phases is for, m.
    pub const MOON_LAW_DISTANCE_M: f32 = 384_400_000.0;
    /// Irradiance of the full moon over the sun's: magnitudes -12.73 and -26.74.
    const MOON_FULL_IRRADIANCE: f32 = 2.489e-6;
    /// Its law of phases, magnitudes a degree, and magnitudes a degree to the fourth.
    const MOON_PHASE_SLOPE: f32 = 0.026;
    const MOON_PHASE_QUARTIC: f32 = 4e-9;
    /// Its colour index B-V.
    const MOON_COLOUR_INDEX: f32 = 0.92;
    /// The Earth's geometric albedo, 0.37, times the square of its radius over the moon's distance: the full Earth's irradiance on the moon over the sun's.
    const EARTHLIGHT: f32 = 1.0e-4;
    /// Sines of the sun's elevation between which the moon takes over the beam: -4 and -6 degrees.
    pub const MOON_BEAM_FROM: f32 = -0.069_756;
    /// See [`MOON_BEAM_FROM`].
    pub const MOON_BEAM_WHOLE: f32 = -0.104_528;
    /// Sine of the moon's elevation from which it lights anything: its light reaches 10 km up when it stands 3 degrees below the horizon.
    pub const MOON_LIGHTS_FROM: f32 = -0.06;
    /// Least of the phase integral: beyond 177 degrees of phase nothing of the disc is seen.
    const MOON_PHASE_LEAST: f32 = 1e-3;
}

/// What pictures are told of the moon.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MoonLook {
    /// Unit vector towards it.
    pub direction: [f32; 3],
    /// Half its angular width, rad.
    pub angular_radius: f32,
    /// Its irradiance above the air, red, green, blue, over the sun's.
    pub irradiance: [f32; 3],
    /// Share of its beam that is let in, 0 to 1: none while the sun still shines on something.
    pub beam_share: f32,
    /// Whether its light is worth a sky of its own.
    pub lights_sky: bool,
}

impl MoonLook {
    /// Of unit vectors towards moon and sun, and the moon's distance in m.
    pub fn new(direction: [f32; 3], distance_m: f32, sun_direction: [f32; 3]) -> MoonLook {
        let distance_m = if distance_m.is_finite() {
            distance_m.clamp(1e8, 1e9)
        } else {
            MOON_LAW_DISTANCE_M
        };
        let irradiance = irradiance(phase_cosine(direction, sun_direction), distance_m);
        let risen = direction[2] > MOON_LIGHTS_FROM;
        let dark = ((MOON_BEAM_FROM - sun_direction[2]) / (MOON_BEAM_FROM - MOON_BEAM_WHOLE)).clamp(0.0, 1.0);
        MoonLook {
            direction,
            angular_radius: MOON_RADIUS_M / distance_m,
            irradiance: colour_of(MOON_COLOUR_INDEX).map(|c| c * irradiance),
            beam_share: if risen { dark * dark * (3.0 - 2.0 * dark) } else { 0.0 },
            lights_sky: risen && sun_direction[2] < 0.0,
        }
    }
}

/// Cosine of the phase angle, 1 at full moon: the sun is so far away that it shines on the moon as it shines here.
pub fn phase_cosine(moon_direction: [f32; 3], sun_direction: [f32; 3]) -> f32 {
    let along: f32 = (0..3).map(|a| moon_direction[a] * sun_direction[a]).sum();
    (-along).clamp(-1.0, 1.0)
}

/// Irradiance of the moon over the sun's, both above the air.
pub fn irradiance(phase_cosine: f32, distance_m: f32) -> f32 {
    let degrees = phase_cosine.acos().to_degrees();
    let fainter = MOON_PHASE_SLOPE * degrees + MOON_PHASE_QUARTIC * degrees.powi(4);
    let nearer = MOON_LAW_DISTANCE_M / distance_m;
    MOON_FULL_IRRADIANCE * 10f32.powf(-0.4 * fainter) * nearer * nearer
}

/// The disc in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MoonDisc {
    look: MoonLook,
    sun_direction: [f32; 3],
    phase_cosine: f32,
    /// Radiance for a reflection of one half, and of the night side.
    lit: [f32; 3],
    ashen: [f32; 3],
}

impl MoonDisc {
    /// Seen from `height_m`.
    pub fn new(look: MoonLook, sun_direction: [f32; 3], transmittance: &TransmittanceTable, height_m: f32) -> MoonDisc {
        let phase_cosine = phase_cosine(look.direction, sun_direction);
        let solid_angle = std::f32::consts::PI * look.angular_radius * look.angular_radius;
        let passed = transmittance.of_sun(height_m, look.direction[2]);
        let per_half = 2.0 / phase_integral(phase_cosine).max(MOON_PHASE_LEAST);
        let full = colour_of(MOON_COLOUR_INDEX).map(|c| c * MOON_FULL_IRRADIANCE);
        let earthlight = EARTHLIGHT * earth_phase(phase_cosine);
        // Radiance does not depend on the distance: the night side's is that of the full moon at the law's distance.
        let law_radius = MOON_RADIUS_M / MOON_LAW_DISTANCE_M;
        let full_solid_angle = std::f32::consts::PI * law_radius * law_radius;
        MoonDisc {
            look,
            sun_direction,
            phase_cosine,
            lit: [0, 1, 2].map(|c| passed[c] * look.irradiance[c] / solid_angle * per_half),
            ashen: [0, 1, 2].map(|c| passed[c] * full[c] / full_solid_angle * earthlight),
        }
    }
    /// Radiance along unit vectors, with an edge so wide (rad), and the share of the disc in it.
    #[inline(always)]
    pub(crate) fn radiance(&self, d: &[Lanes; 3], edge: f32) -> ([Lanes; 3], Lanes) {
        let (zero, one) = (Lanes::splat(0.0), Lanes::splat(1.0));
        let m = self.look.direction;
        let e = [d[0] - m[0], d[1] - m[1], d[2] - m[2]];
        let angle = (e[0] * e[0] + e[1] * e[1] + e[2] * e[2]).sqrt();
        let disc = ((Lanes::splat(self.look.angular_radius + edge * 0.5) - angle) * (1.0 / edge)).clamp(0.0, 1.0);
        let mut light = [zero; 3];
        if disc.any_above(0.0) {
            let per_radius = 1.0 / self.look.angular_radius;
            let out = angle * per_radius;
            let up = (one - out * out).max(zero).sqrt();
            let s = self.sun_direction;
            let sunlit = ((e[0] * s[0] + e[1] * s[1] + e[2] * s[2]) * per_radius + up * self.phase_cosine).max(zero);
            let reflected = sunlit / (sunlit + up).max(Lanes::splat(1e-4));
            for c in 0..3 {
                light[c] = (reflected * self.lit[c] + self.ashen[c]) * disc;
            }
        }
        (light, disc)
    }
}

/// What a disc by Lommel and Seeliger's law reflects at a phase, over what it does when full.
fn phase_integral(phase_cosine: f32) -> f32 {
    let half = 0.5 * phase_cosine.clamp(-1.0, 1.0).acos();
    if half < 1e-3 {
        return 1.0;
    }
    1.0 - half.sin() * half.tan() * (1.0 / (0.5 * half).tan()).ln()
}

/// How full the Earth is from the moon, by Lambert's law.
fn earth_phase(moon_phase_cosine: f32) -> f32 {
    let angle = (-moon_phase_cosine).clamp(-1.0, 1.0).acos();
    (angle.sin() + (std::f32::consts::PI - angle) * angle.cos()) / std::f32::consts::PI
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::light::Atmosphere;

    fn magnitude(irradiance: f32) -> f32 {
        -26.74 - 2.5 * irradiance.log10()
    }

    #[test]
    fn the_law_of_phases() {
        // Krisciunas and Schaefer (1991), equation 9, at full moon, at quarter, and 30 degrees before new.
        for (phase_deg, wanted) in [(0.0f32, -12.73), (90.0, -10.13), (150.0, -6.805)] {
            let v = magnitude(irradiance(phase_deg.to_radians().cos(), MOON_LAW_DISTANCE_M));
            assert!((v - wanted).abs() < 0.01, "{phase_deg}: {v} wanted {wanted}");
        }
        // At perigee the same moon is brighter by the square of the distance.
        let ratio = irradiance(1.0, 356_500_000.0) / irradiance(1.0, 406_700_000.0);
        assert!((ratio - 1.3015).abs() < 0.001, "{ratio}");
    }

    /// The disc's mean radiance over its solid angle is the law's irradiance, whatever the phase; a full moon is even, a half moon is half dark.
    #[test]
    fn the_disc_gives_what_the_law_says() {
        let air = Atmosphere::new(0.0, None);
        let table = TransmittanceTable::new(&air);
        let moon = [0.0, 0.0, 1.0];
        for phase_deg in [0.0f32, 40.0, 90.0, 140.0] {
            let angle = std::f32::consts::PI - phase_deg.to_radians();
            let sun = [angle.sin(), 0.0, angle.cos()];
            let look = MoonLook::new(moon, MOON_LAW_DISTANCE_M, sun);
            let disc = MoonDisc::new(look, sun, &table, 0.0);
            let radius = look.angular_radius;
            let (n, mut sum, mut dark) = (256, 0.0f64, 0);
            for y in 0..n {
                for x in 0..n / 16 {
                    let at = |i: usize| (2.0 * (i as f32 + 0.5) / n as f32 - 1.0) * radius;
                    let dx = Lanes::from_fn(|l| at(x * 16 + l));
                    let dy = Lanes::splat(at(y));
                    let up = (Lanes::splat(1.0) - dx * dx - dy * dy).sqrt();
                    let (light, inside) = disc.radiance(&[dx, dy, up], 1e-7);
                    for l in 0..16 {
                        // The earthlight is not part of the law.
                        let own = (light[1].0[l] - disc.ashen[1] * inside.0[l]).max(0.0);
                        sum += own as f64;
                        dark += (inside.0[l] > 0.5 && own < 1e-3 * disc.lit[1]) as usize;
                    }
                }
            }
            let pixel = (2.0 * radius / n as f32).powi(2) as f64;
            let got = sum * pixel / table.of_sun(0.0, 1.0)[1] as f64;
            let wanted = look.irradiance[1] as f64;
            assert!((got / wanted - 1.0).abs() < 0.02, "{phase_deg}: {got} wanted {wanted}");
            // Within the terminator's ellipse.
            let share = dark as f32 / (n * n) as f32 / (0.25 * std::f32::consts::PI);
            let wanted = 0.5 * (1.0 - phase_deg.to_radians().cos());
            assert!(
                (share - wanted).abs() < 0.03,
                "{phase_deg}: {share} of the disc is dark"
            );
        }
    }

    /// The beam passes from sun to moon without either being there twice, and only at night.
    #[test]
    fn the_moon_takes_over_at_night() {
        let moon = [0.0, 0.6, 0.8];
        let share = |sun_deg: f32| {
            let e = sun_deg.to_radians();
            MoonLook::new(moon, MOON_LAW_DISTANCE_M, [0.0, -e.cos(), e.sin()]).beam_share
        };
        assert_eq!([share(30.0), share(0.0), share(-3.9)], [0.0; 3]);
        assert!(share(-5.0) > 0.3 && share(-5.0) < 0.7);
        assert_eq!([share(-6.1), share(-60.0)], [1.0; 2]);
        let set = MoonLook::new([0.0, 0.99, -0.1], MOON_LAW_DISTANCE_M, [0.0, 0.0, -1.0]);
        assert!(set.beam_share == 0.0 && !set.lights_sky);
    }
}
