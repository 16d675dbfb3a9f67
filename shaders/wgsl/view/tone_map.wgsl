// Stage `tone_map`: from radiance to bytes. The twin is cpu/view/tone_map.rs.

/// Exposure for level ground that receives `irradiance`; `gain` is the compensation, `night` lets it adapt to the dark.
fn exposure(irradiance: f32, gain: f32, night: bool) -> f32 {
    let received = max(irradiance, 0.0);
    if (night) {
        let bright = EXPOSURE_SCALE * gain / pow(received + ADAPTS_BELOW, EXPOSURE_FOLLOWS);
        return bright * pow((received + ADAPTS_BELOW) / (received + ADAPTS_DOWN_TO), ADAPTS_BY);
    }
    return EXPOSURE_SCALE * gain / pow(received + EXPOSURE_NIGHT, EXPOSURE_FOLLOWS);
}

fn luminance_of(c: vec3<f32>) -> f32 {
    return dot(c, vec3<f32>(LUMINANCE_RED, LUMINANCE_GREEN, LUMINANCE_BLUE));
}

/// Bytes as floats, before rounding down; `dither` from 0 to 1.
fn tone_map(radiance: vec3<f32>, by: f32, dither: f32) -> vec3<f32> {
    let x = clamp(radiance * by, vec3<f32>(0.0), vec3<f32>(1e4));
    let luminance = luminance_of(x);
    let grey = luminance / (luminance + TONE_GREY_AT) * TONE_GREY_MOST + TONE_GREY_LEAST;
    let scale = 1.0 + pow(TONE_MIDDLE / TONE_WHITE, TONE_CONTRAST);
    let drawn = pow(max(mix(x, vec3<f32>(luminance), grey), vec3<f32>(1e-30)), vec3<f32>(TONE_CONTRAST));
    let film = clamp(drawn / (drawn + pow(TONE_MIDDLE, TONE_CONTRAST)) * scale, vec3<f32>(0.0), vec3<f32>(1.0));
    let curve = pow(max(film, vec3<f32>(1e-30)), vec3<f32>(1.0 / 2.4)) * 1.055 - 0.055;
    let srgb = select(curve, film * 12.92, film < vec3<f32>(0.0031308));
    return clamp(srgb * 255.0 + dither, vec3<f32>(0.0), vec3<f32>(255.0));
}
