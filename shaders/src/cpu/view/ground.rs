//! Stage `ground`: the land under the clouds.
//!
//! Reads: the place a ray meets the ground, [`SkyLight`], the shadow map of [`SunLight`], [`DetailNoise`] for patches. Writes: radiance towards the
//! camera. Scheme: Lambert's law; sunlight times the share that passes the clouds: exp(-t) straight through and a part of
//! the rest diffusely (two-stream); sky light. Patches of fields and woods change the albedo by a third, less with distance.

use std::f32::consts::PI;

use super::detail_noise::DetailNoise;
use super::lanes::Lanes;
use super::shape::Shape;
use crate::cpu::light::sky_light::{LAND_ALBEDO, SkyLight};
use crate::cpu::light::sun_optical_depth::{SunLight, marched_direction};

/// Radiance of the ground at `x`, `y` (m), seen from `distance_m`.
#[inline(always)]
pub(crate) fn radiance(
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
            let diffuse = one / (depth * 0.105 + 1.0);
            (straight + (one - straight) * diffuse * 0.45, 0.8 + 0.2 * sun_light.sunlit_share)
        }
        None => (one, 1.0),
    };
    let (broad, _) = noise.look(x * (1.0 / 21_000.0), y * (1.0 / 21_000.0), Lanes::splat(0.3));
    let (fields, grain) = noise.look(x * (1.0 / 3_700.0), y * (1.0 / 3_700.0), Lanes::splat(0.7));
    let near = one / (distance_m * distance_m * (1.0 / 64e6) + 1.0);
    let patch = (broad - 0.5) * 0.7 + (fields - 0.5) * 0.6 * near + (grain - 0.5) * 0.35 * near * near;
    let lit = sun_direction[2].max(0.0) / PI;
    // Drier patches are lighter and browner, wooded ones darker and greener.
    let tint = [1.15, 0.85, 0.6];
    let mut radiance = [one; 3];
    for c in 0..3 {
        let albedo = (patch * tint[c] + 1.0).clamp(0.4, 1.8) * LAND_ALBEDO[c];
        radiance[c] = albedo * (passed * (light.sun_at_ground[c] * lit) + light.sky_irradiance[c] * sky_share / PI);
    }
    radiance
}

#[inline(always)]
fn shadow_depth(shape: &Shape, sun_light: &SunLight, x: Lanes, y: Lanes) -> Lanes {
    let (index, f) = shape.place(x, y, Lanes::splat(shape.bottom_m));
    let row = shape.stride[0] as u32;
    let map = &sun_light.shadow;
    let south = index.gather_f32(map).lerp(index.plus(1).gather_f32(map), f[0]);
    let north = index.plus(row).gather_f32(map).lerp(index.plus(row + 1).gather_f32(map), f[0]);
    south.lerp(north, f[1])
}
