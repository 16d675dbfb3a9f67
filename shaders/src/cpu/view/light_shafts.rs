//! Stage `light_shafts`: the shadows that clouds throw into hazy air.
//!
//! Reads: the ray, [`Frame`]'s haze and light, the optical depths towards the beam of [`SunLight`] (its map below the clouds' lowest level, its points, filled everywhere for this, beside
//! the clouds), how far off the ray's cloud is and what passes it. Writes: radiance to be taken from the ray's, three colours. Scheme: the sky's radiance holds the light of air that
//! the beam reaches everywhere; where cloud takes a share 1 - exp(-t) of the beam, the light that molecules and aerosol turn once towards the camera is less by that share, and more by
//! what the cloud lets through diffusely (the ground's two-stream share), which the air turns evenly. Samples lie at random within equal parts of the square root of the way
//! (midpoints moved by the pixel's pattern), from the camera to the ground or out of the clouds' slab, [`SHAFT_REACH_M`] at most. Behind the cloud's mean distance they
//! count by what passes it.
//!
//! Order: the samples' error falls as 1 / samples inside a beam and is grain at its edges. Keeps: without cloud nothing changes. It does not follow light that was scattered twice in air: air
//! in shadow keeps all of that. A formula sky is no sum of single scatterings, so it may lose too much; no pixel goes below zero. Source: the visibility term of
//! single scattering, as by Nishita et al. (1987); positions after Tóth and Umenhoffer (2009), who march it.

use std::f32::consts::PI;

use super::ground::{GROUND_DIFFUSE_SHARE, shadow_depth};
use super::lanes::Lanes;
use super::march::{Frame, Met, Rays, slab};
use super::shape::{Shape, trilinear};
use crate::cpu::light::atmosphere::{AEROSOL_ALBEDO, AEROSOL_ASYMMETRY, AEROSOL_HEIGHT_M, RAYLEIGH_HEIGHT_M};
use crate::cpu::light::phase::{henyey_greenstein, rayleigh};
use crate::cpu::light::sky_visibility::DIFFUSE_VISIBILITY;
use crate::cpu::light::sun_optical_depth::{DEPTH_UNIT, SunLight, marched_direction};

crate::constants! {
    /// Samples of a ray at most.
    pub const SHAFT_SAMPLES_MAX: u32 = 128;
    /// Shadows farther than this from the camera are not seen, m.
    pub(crate) const SHAFT_REACH_M: f32 = 40_000.0;
}

/// Radiance that shadows take from sixteen rays to `end_m` that have met `cloud`, in the frame of a cloud; less than zero where cloud sends more than it takes.
#[inline(always)]
pub(super) fn taken(
    frame: &Frame<'_>,
    (shape, sun_light): (&Shape, &SunLight),
    rays: &Rays,
    cloud: &Met,
    end_m: Lanes,
) -> [Lanes; 3] {
    let (zero, one) = (Lanes::splat(0.0), Lanes::splat(1.0));
    let [ox, oy, oz] = frame.position_m;
    let (haze, light, beam_direction) = (&frame.haze, frame.light, frame.beam_direction);
    let (d, rise, samples) = (&rays.d, rays.d[2], frame.shaft_samples);
    let mut sum = [zero; 3];
    let (first, last) = slab(oz, rise, rays.curve, 0.0, shape.top_m);
    let last = last.min(end_m).min(Lanes::splat(SHAFT_REACH_M));
    // Rays that never meet the slab take part from a finite place.
    let first = first.min(last.max(zero));
    let way = last - first;
    if !way.any_above(0.0) {
        return sum;
    }
    let (mut once, mut droplets) = (zero, zero);
    for l in 0..once.0.len() {
        once.0[l] = rayleigh(rays.turn.0[l]);
        droplets.0[l] = henyey_greenstein(AEROSOL_ASYMMETRY, rays.turn.0[l]);
    }
    let sun = marched_direction(beam_direction);
    let bottom_m = shape.bottom_m.max(1.0);
    let per_depth = 1.0 / (shape.top_m - shape.bottom_m);
    // Diffuse light from above of irradiance 1 is a fluence of 2, of which a share 1 / 4 pi goes each way.
    let even = GROUND_DIFFUSE_SHARE * 2.0 * beam_direction[2].max(0.0) / (4.0 * PI);
    let part = 1.0 / samples as f32;
    for n in 0..samples {
        let u = (rays.pattern + n as f32) * part;
        let t = first + way * u * u;
        let length = (way * u * (2.0 * part)).max(zero);
        let z = t * (rise + rays.curve * t) + oz;
        let (x, y) = (d[0] * t + ox, d[1] * t + oy);
        let below = Lanes::splat(shape.bottom_m) - z;
        let mut depth = zero;
        if below.any_above(0.0) {
            let reach = below.max(zero) * (1.0 / sun[2]);
            depth = shadow_depth(shape, sun_light, x + reach * sun[0], y + reach * sun[1]);
        }
        if (zero - below).any_above(0.0) {
            let (index, f) = shape.place(x, y, z);
            let beside = trilinear(&shape.corners(&sun_light.words, index), 0, 0xffff, &f) * DEPTH_UNIT;
            depth = Lanes::select_less(zero, below, depth, beside);
        }
        let blocked = one - (zero - depth).exp();
        let spread = blocked * even / (depth * DIFFUSE_VISIBILITY + 1.0);
        let climb = z - oz;
        let air = (climb * (-1.0 / RAYLEIGH_HEIGHT_M)).exp() * (once * blocked - spread);
        let aerosol = (climb * (-1.0 / AEROSOL_HEIGHT_M)).exp()
            * (droplets * blocked - spread)
            * (haze.aerosol_per_m * AEROSOL_ALBEDO);
        let passed = haze.transmittance(t, rise);
        let seen = Lanes::select_less(t, cloud.distance_m, one, cloud.through) * length;
        let (low, high) = (
            (z * (1.0 / bottom_m)).clamp(0.0, 1.0),
            ((z - shape.bottom_m) * per_depth).clamp(0.0, 1.0),
        );
        for c in 0..3 {
            let beam = low * (light.sun_at_base[c] - light.sun_at_ground[c])
                + high * (light.sun_at_top[c] - light.sun_at_base[c])
                + light.sun_at_ground[c];
            sum[c] = sum[c] + (air * haze.rayleigh_per_m[c] + aerosol) * passed[c] * beam * seen;
        }
    }
    sum
}
