//! Stage `tone_map`: from radiance to the bytes of a picture.
//!
//! Reads: radiance of red, green and blue relative to the exposure. Writes: sRGB bytes. Scheme: bright colours are drawn a little
//! towards grey; each channel goes through a filmic S-curve x^n (1 + (m/w)^n) / (x^n + m^n) (Naka and Rushton 1966,
//! scaled so that w becomes 1), which keeps gradation up to w = 12 times the exposure's white; then the sRGB transfer function (IEC
//! 61966-2-1); then ordered noise of half a step against bands in the sky.

use super::lanes::Lanes;

const CONTRAST: f32 = 1.22;
const MIDDLE: f32 = 0.62;
const WHITE: f32 = 12.0;

/// Bytes 0 to 255 as floats, before rounding down; `dither` from 0 to 1.
#[inline(always)]
pub(crate) fn tone_map(radiance: [Lanes; 3], exposure: f32, dither: Lanes) -> [Lanes; 3] {
    let mut x = radiance;
    for v in &mut x {
        *v = (*v * exposure).clamp(0.0, 1e4);
    }
    let luminance = x[0] * 0.2126 + x[1] * 0.7152 + x[2] * 0.0722;
    let grey = luminance / (luminance + 4.0) * 0.6 + 0.06;
    let scale = 1.0 + (MIDDLE / WHITE).powf(CONTRAST);
    let middle = MIDDLE.powf(CONTRAST);
    for v in &mut x {
        let drawn = v.lerp(luminance, grey).powf(CONTRAST);
        let film = (drawn / (drawn + middle) * scale).clamp(0.0, 1.0);
        let curve = film.powf(1.0 / 2.4) * 1.055 - 0.055;
        let srgb = Lanes::select_less(film, Lanes::splat(0.003_130_8), film * 12.92, curve);
        *v = (srgb * 255.0 + dither).clamp(0.0, 255.0);
    }
    x
}

/// Exposure for a scene whose level ground receives `irradiance` (relative to the sun's above the air). Follows dusk only in part, so
/// that it gets darker as it does to the eye.
pub fn exposure(irradiance: f32, compensation_ev: f32) -> f32 {
    let ev = if compensation_ev.is_finite() {
        compensation_ev.clamp(-20.0, 20.0)
    } else {
        0.0
    };
    let seen = irradiance.max(0.0) + 2e-4;
    7.6 * ev.exp2() / seen.powf(0.66)
}
