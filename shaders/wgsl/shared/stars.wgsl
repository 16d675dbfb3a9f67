// Stars from the table of stage `stars`. The twin is cpu/light/stars.rs, which says how the words are packed. The module that uses it binds `star_words`.

/// Light of a colour index over the sun's, with green 1.
fn colour_of(colour_index: f32) -> vec3<f32> {
    let redder = MAGNITUDE_LOG2 * (colour_index - SUN_COLOUR_INDEX);
    return vec3<f32>(exp2(STAR_RED_SLOPE * redder), 1.0, exp2(-redder));
}

fn star_word(n: u32) -> u32 {
    return star_words[n >> 2u][n & 3u];
}

fn star_direction(word: u32) -> vec3<f32> {
    let x = f32(word & 0xffffu) * (2.0 / 65535.0) - 1.0;
    let y = f32(word >> 16u) * (2.0 / 65535.0) - 1.0;
    let z = 1.0 - abs(x) - abs(y);
    let fold = max(-z, 0.0);
    return normalize(vec3<f32>(select(x - fold, x + fold, x < 0.0), select(y - fold, y + fold, y < 0.0), z));
}

fn star_tile(coordinate: f32) -> u32 {
    return min(u32(max((coordinate * 0.5 + 0.5) * f32(STAR_TILES), 0.0)), STAR_TILES - 1u);
}

/// Radiance along a direction in the equator's frame of date before the air, in pixels of so many radians.
fn star_radiance(q: vec3<f32>, pixel: f32) -> vec3<f32> {
    let size = abs(q);
    var face = 4u + select(0u, 1u, q.z < 0.0);
    var at = q.xy / size.z;
    if (size.x >= size.y && size.x >= size.z) {
        face = select(0u, 1u, q.x < 0.0);
        at = q.yz / size.x;
    } else if (size.y >= size.z) {
        face = 2u + select(0u, 1u, q.y < 0.0);
        at = q.xz / size.y;
    }
    let head = star_word((face * STAR_TILES + star_tile(at.y)) * STAR_TILES + star_tile(at.x));
    let first = 6u * STAR_TILES * STAR_TILES + 2u * (head & 0xffffu);
    let width = pixel * STAR_SPOT_PIXELS;
    let reach = min(width * STAR_SPOT_END, STAR_MARGIN);
    var light = vec3<f32>(0.0);
    let count = head >> 16u;
    for (var n = 0u; n < count; n++) {
        let away = q - star_direction(star_word(first + 2u * n));
        let squared = dot(away, away);
        if (squared < reach * reach) {
            let word = star_word(first + 2u * n + 1u);
            let magnitude = f32(word & 0xffffu) / STAR_STEPS + STAR_LEAST;
            let irradiance = exp2(MAGNITUDE_LOG2 * (SUN_MAGNITUDE - magnitude));
            let spot = exp(-0.5 * squared / (width * width)) / (2.0 * PI * width * width);
            light += irradiance * spot * colour_of(f32(word >> 16u) / STAR_STEPS + STAR_LEAST);
        }
    }
    return light;
}
