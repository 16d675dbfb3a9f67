//! Stage `tone_map`: from radiance to the bytes of a picture.
//!
//! Reads: radiance of red, green and blue relative to the exposure. Writes: sRGB bytes. Scheme: bright colours are drawn a little
//! towards grey; each channel goes through a filmic S-curve x^n (1 + (m/w)^n) / (x^n + m^n) (Naka and Rushton 1966,
//! scaled so that w becomes 1), which keeps gradation up to w = 12 times the exposure's white; then the sRGB transfer function (IEC
//! 61966-2-1); then ordered noise of half a step against bands in the sky.

use super::lanes::Lanes;

crate::constants! {
    /// Exponent of the curve.
    const TONE_CONTRAST: f32 = 1.22;
    /// Light that becomes one half.
    const TONE_MIDDLE: f32 = 0.62;
    /// Light that becomes 1.
    const TONE_WHITE: f32 = 12.0;
    /// Share towards grey: the least, what bright colours add at most, and the luminance at which half of that is added.
    const TONE_GREY_LEAST: f32 = 0.06;
    const TONE_GREY_MOST: f32 = 0.6;
    const TONE_GREY_AT: f32 = 4.0;
    /// Shares of luminance (ITU-R BT.709).
    const LUMINANCE_RED: f32 = 0.2126;
    const LUMINANCE_GREEN: f32 = 0.7152;
    const LUMINANCE_BLUE: f32 = 0.0722;
    /// Exposure under an irradiance of 1.
    const EXPOSURE_SCALE: f32 = 7.6;
    /// Irradiance that is added: the darkest night.
    const EXPOSURE_NIGHT: f32 = 2e-4;
    /// How far exposure follows the irradiance: 1 would make night as bright as day.
    const EXPOSURE_FOLLOWS: f32 = 0.66;
    /// With an effect of the night, below the first irradiance exposure follows by this share, down to the second: a landscape under the full moon is a twentieth as bright
    /// in a picture as by day, and the sky of a moonless night just above black.
    const ADAPTS_BELOW: f32 = 1e-3;
    const ADAPTS_DOWN_TO: f32 = 1.2e-7;
    const ADAPTS_BY: f32 = 0.92;
}

/// Bytes 0 to 255 as floats, before rounding down; `dither` from 0 to 1.
#[inline(always)]
pub(crate) fn tone_map(radiance: [Lanes; 3], exposure: f32, dither: Lanes) -> [Lanes; 3] {
    let mut x = radiance;
    for v in &mut x {
        *v = (*v * exposure).clamp(0.0, 1e4);
    }
    let luminance = x[0] * LUMINANCE_RED + x[1] * LUMINANCE_GREEN + x[2] * LUMINANCE_BLUE;
    let grey = luminance / (luminance + TONE_GREY_AT) * TONE_GREY_MOST + TONE_GREY_LEAST;
    let scale = 1.0 + (TONE_MIDDLE / TONE_WHITE).powf(TONE_CONTRAST);
    let middle = TONE_MIDDLE.powf(TONE_CONTRAST);
    for v in &mut x {
        let drawn = v.lerp(luminance, grey).powf(TONE_CONTRAST);
        let film = (drawn / (drawn + middle) * scale).clamp(0.0, 1.0);
        let curve = film.powf(1.0 / 2.4) * 1.055 - 0.055;
        let srgb = Lanes::select_less(film, Lanes::splat(0.003_130_8), film * 12.92, curve);
        *v = (srgb * 255.0 + dither).clamp(0.0, 255.0);
    }
    x
}

/// Exposure for a scene whose level ground receives `irradiance` (relative to the sun's above the air). Follows dusk only in part, so
/// that it gets darker as it does to the eye; `night` lets it adapt to the dark.
pub fn exposure(irradiance: f32, gain: f32, night: bool) -> f32 {
    let received = irradiance.max(0.0);
    if night {
        let bright = EXPOSURE_SCALE * gain / (received + ADAPTS_BELOW).powf(EXPOSURE_FOLLOWS);
        return bright * ((received + ADAPTS_BELOW) / (received + ADAPTS_DOWN_TO)).powf(ADAPTS_BY);
    }
    EXPOSURE_SCALE * gain / (received + EXPOSURE_NIGHT).powf(EXPOSURE_FOLLOWS)
}

/// Factor of a compensation in stops; bounded, 1 for what is not a number.
pub fn exposure_gain(compensation_ev: f32) -> f32 {
    let ev = if compensation_ev.is_finite() {
        compensation_ev.clamp(-20.0, 20.0)
    } else {
        0.0
    };
    ev.exp2()
}

/// Luminance of red, green and blue.
pub fn luminance(c: [f32; 3]) -> f32 {
    LUMINANCE_RED * c[0] + LUMINANCE_GREEN * c[1] + LUMINANCE_BLUE * c[2]
}
