//! Stage `ground`: the land or the sea under the clouds.
//!
//! Reads: the place a ray meets the ground, [`SkyLight`], the shadow map of [`SunLight`], [`DetailNoise`] for patches. Writes: radiance towards the
//! camera. Scheme: Lambert's law; sunlight times the share that passes the clouds: exp(-t) straight through and a part of
//! the rest diffusely (two-stream); sky light. Patches of fields and woods change the land's albedo by a third, less with distance; the sea
//! mirrors the sky besides. No glint of the sun's disc on the sea.

use std::f32::consts::PI;

use super::detail_noise::DetailNoise;
use super::lanes::Lanes;
use super::shape::Shape;
use crate::cpu::light::sky_light::SkyLight;
use crate::cpu::light::sky_visibility::DIFFUSE_VISIBILITY;
use crate::cpu::light::sun_optical_depth::{SunLight, marched_direction};

crate::constants! {
    /// Rise of the facets of ruffled water that are seen at grazing angles.
    const SEA_FACET_TILT: f32 = 0.12;
    /// Share of light that water mirrors at right angles, and what grazing angles add.
    const SEA_MIRROR_LEAST: f32 = 0.02;
    const SEA_MIRROR_GRAZING: f32 = 0.43;
    /// Share of the diffuse light under cloud that comes down in the shadow.
    pub(crate) const GROUND_DIFFUSE_SHARE: f32 = 0.45;
    /// Share of the sky's light that clouds can take.
    const GROUND_SKY_COVERED: f32 = 0.2;
    /// Edges of the tiles of patches, m, and the levels of the noise that they show.
    const GROUND_BROAD_TILE_M: f32 = 21_000.0;
    const GROUND_FIELD_TILE_M: f32 = 3_700.0;
    const GROUND_BROAD_LEVEL: f32 = 0.3;
    const GROUND_FIELD_LEVEL: f32 = 0.7;
    /// Strength of broad patches, fields and grain.
    const GROUND_BROAD: f32 = 0.7;
    const GROUND_FIELDS: f32 = 0.6;
    const GROUND_GRAIN: f32 = 0.35;
    /// Distance at which fields fade, m.
    const GROUND_NEAR_M: f32 = 8_000.0;
    /// Bounds of a patch's albedo against the mean.
    const GROUND_DARKEST: f32 = 0.4;
    const GROUND_LIGHTEST: f32 = 1.8;
}

/// What lies under the clouds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ground {
    /// Fields and woods.
    #[default]
    Land,
    /// Water under a breeze.
    Sea,
}

impl Ground {
    /// Share of light that is given back from below the surface, on average; red, green, blue.
    pub fn albedo(self) -> [f32; 3] {
        match self {
            Ground::Land => [0.070, 0.088, 0.048],
            Ground::Sea => [0.010, 0.026, 0.042],
        }
    }
    /// How strongly a patch changes each colour: drier patches are lighter and browner, wooded ones darker and greener.
    pub fn tint(self) -> [f32; 3] {
        match self {
            Ground::Land => [1.15, 0.85, 0.6],
            Ground::Sea => [0.0; 3],
        }
    }
}

/// Where ruffled water mirrors a ray that comes down along `d`: up again, and higher the flatter it came, since it
/// is the facets tilted towards the viewer that are seen.
#[inline(always)]
pub(crate) fn mirrored(d: &[Lanes; 3]) -> [Lanes; 3] {
    let up = Lanes::splat(SEA_FACET_TILT) - d[2];
    let length = (d[0] * d[0] + d[1] * d[1] + up * up).sqrt();
    [d[0] / length, d[1] / length, up / length]
}

/// Share of light that water mirrors, by the sine of the ray's elevation: Schlick's approximation for the index 1.33, with the rise
/// towards grazing cut to 0.45 by the waves' slopes.
#[inline(always)]
pub(crate) fn mirror_share(rise: Lanes) -> Lanes {
    let flat = (rise + 1.0).clamp(0.0, 1.0);
    let squared = flat * flat;
    squared * squared * flat * SEA_MIRROR_GRAZING + SEA_MIRROR_LEAST
}

/// Radiance of the ground at `x`, `y` (m), seen from `distance_m`.
#[inline(always)]
pub(crate) fn radiance(
    ground: Ground,
    light: &SkyLight,
    cloud: Option<(&Shape, &SunLight)>,
    noise: &DetailNoise,
    sun_direction: [f32; 3],
    x: Lanes,
    y: Lanes,
    distance_m: Lanes,
) -> [Lanes; 3] {
    let one = Lanes::splat(1.0);
    let (passed, sky_share) = match cloud {
        Some((shape, sun_light)) => {
            let sun = marched_direction(sun_direction);
            let reach = shape.bottom_m.max(0.0) / sun[2];
            let depth = shadow_depth(shape, sun_light, x + reach * sun[0], y + reach * sun[1]);
            let straight = (Lanes::splat(0.0) - depth).exp();
            let diffuse = one / (depth * DIFFUSE_VISIBILITY + 1.0);
            (
                straight + (one - straight) * diffuse * GROUND_DIFFUSE_SHARE,
                1.0 - GROUND_SKY_COVERED + GROUND_SKY_COVERED * sun_light.sunlit_share,
            )
        }
        None => (one, 1.0),
    };
    let albedo = albedo(ground, noise, x, y, distance_m);
    let lit = sun_direction[2].max(0.0) / PI;
    let mut radiance = [one; 3];
    for c in 0..3 {
        radiance[c] = albedo[c] * (passed * (light.sun_at_ground[c] * lit) + light.sky_irradiance[c] * sky_share / PI);
    }
    radiance
}

/// Share of light that the ground gives back at `x`, `y` (m), seen from `distance_m`.
#[inline(always)]
pub(crate) fn albedo(ground: Ground, noise: &DetailNoise, x: Lanes, y: Lanes, distance_m: Lanes) -> [Lanes; 3] {
    let one = Lanes::splat(1.0);
    let (broad, _) = noise.look(
        x * (1.0 / GROUND_BROAD_TILE_M),
        y * (1.0 / GROUND_BROAD_TILE_M),
        Lanes::splat(GROUND_BROAD_LEVEL),
    );
    let (fields, grain) = noise.look(
        x * (1.0 / GROUND_FIELD_TILE_M),
        y * (1.0 / GROUND_FIELD_TILE_M),
        Lanes::splat(GROUND_FIELD_LEVEL),
    );
    let albedo_mean = ground.albedo();
    let near = one / (distance_m * distance_m * (1.0 / (GROUND_NEAR_M * GROUND_NEAR_M)) + 1.0);
    let patch = (broad - 0.5) * GROUND_BROAD
        + (fields - 0.5) * GROUND_FIELDS * near
        + (grain - 0.5) * GROUND_GRAIN * near * near;
    let tint = ground.tint();
    let mut albedo = [one; 3];
    for c in 0..3 {
        albedo[c] = (patch * tint[c] + 1.0).clamp(GROUND_DARKEST, GROUND_LIGHTEST) * albedo_mean[c];
    }
    albedo
}

/// Optical depth towards the beam from the shape's lowest level, at a place there in m.
#[inline(always)]
pub(crate) fn shadow_depth(shape: &Shape, sun_light: &SunLight, x: Lanes, y: Lanes) -> Lanes {
    let (index, f) = shape.place(x, y, Lanes::splat(shape.bottom_m));
    let row = shape.stride[0] as u32;
    let map = &sun_light.shadow;
    let south = index.gather_f32(map).lerp(index.plus(1).gather_f32(map), f[0]);
    let north = index
        .plus(row)
        .gather_f32(map)
        .lerp(index.plus(row + 1).gather_f32(map), f[0]);
    south.lerp(north, f[1])
}
