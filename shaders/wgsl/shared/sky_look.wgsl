// Lookups in the table of stage `sky_table`. The module that uses them binds `sky_table` and the uniform `frame`.

/// The clear sky's radiance in a direction by one source: `source` is east and north of it, `layer` the table's texels before its own.
fn sky_layer(d: vec3<f32>, source: vec2<f32>, layer: u32) -> vec3<f32> {
    let horizon = frame.horizon_sine;
    let side = length(d.xy);
    let cosine = dot(d.xy, source) / max(side, 1e-5);
    let x = clamp(sqrt(max((1.0 - cosine) * 0.5, 0.0)), 0.0, 1.0) * f32(SKY_COLUMNS - 1u);
    let s = d.z - horizon;
    let bent = select(s / (1.0 - horizon), -s / (1.0 + horizon), s < 0.0);
    let v = clamp(sqrt(max(bent, 0.0)), 0.0, 1.0) * f32(SKY_HALF_ROWS - 1u);
    let i = min(u32(x), SKY_COLUMNS - 2u);
    let j = min(u32(v), SKY_HALF_ROWS - 2u);
    let at = layer + i + (j + select(SKY_HALF_ROWS, 0u, s < 0.0)) * SKY_COLUMNS;
    let fx = x - f32(i);
    let low = mix(sky_table[at].rgb, sky_table[at + 1u].rgb, fx);
    let high = mix(sky_table[at + SKY_COLUMNS].rgb, sky_table[at + SKY_COLUMNS + 1u].rgb, fx);
    return mix(low, high, v - f32(j));
}

/// The clear sky's radiance in a direction, by sun and moon.
fn sky_look(d: vec3<f32>) -> vec3<f32> {
    var light = sky_layer(d, frame.sky_sun.xy, 0u);
    if (frame.moon_sky != 0u) {
        light += sky_layer(d, frame.sky_sun.zw, 2u * SKY_HALF_ROWS * SKY_COLUMNS);
    }
    return light;
}
