// The cloud's shape at any place. The twin is cpu/view/shape.rs. The module that uses it binds the uniform `shape`, and
// `shape_words` and `occupancy_words`.

struct Place {
    index: u32,
    fraction: vec3<f32>,
}

/// Index in the table of points and the three fractions; heights are bounded to the slab.
fn shape_place(p: vec3<f32>) -> Place {
    let period = fract(p.xy * vec2<f32>(shape.per_period_x, shape.per_period_y));
    let gxy = period * vec2<f32>(f32(shape.points_x), f32(shape.points_y)) + 0.5;
    let gz = clamp((p.z - shape.bottom_m) / shape.point_spacing_z_m - 0.5, 0.0, f32(shape.points_z) - 1.001);
    let g = vec3<f32>(gxy, gz);
    let whole = floor(g);
    let i = vec3<u32>(whole);
    var place: Place;
    place.index = (i.z * shape.stride_y + i.y) * shape.stride_x + i.x;
    place.fraction = g - whole;
    return place;
}

/// Trilinear mix of numbers at the eight corners, those of the level below and those above: west-south, east-south, west-north, east-north.
fn trilinear(low: vec4<f32>, high: vec4<f32>, f: vec3<f32>) -> f32 {
    let south_north = mix(vec4<f32>(low.xz, high.xz), vec4<f32>(low.yw, high.yw), f.x);
    let levels = mix(south_north.xz, south_north.yw, f.y);
    return mix(levels.x, levels.y, f.z);
}

/// Cover (0 to 1) and amplitude (1/m).
fn shape_sample(p: vec3<f32>) -> vec2<f32> {
    let place = shape_place(p);
    let row = shape.stride_x;
    let i = place.index;
    let j = i + shape.stride_x * shape.stride_y;
    let low = vec4<u32>(shape_words[i], shape_words[i + 1u], shape_words[i + row], shape_words[i + row + 1u]);
    let high = vec4<u32>(shape_words[j], shape_words[j + 1u], shape_words[j + row], shape_words[j + row + 1u]);
    let mask = vec4<u32>(0xffffu);
    let shift = vec4<u32>(16u);
    let cover = trilinear(vec4<f32>(low & mask), vec4<f32>(high & mask), place.fraction) * (1.0 / 65535.0);
    let amplitude = trilinear(vec4<f32>(low >> shift), vec4<f32>(high >> shift), place.fraction);
    return vec2<f32>(cover, amplitude * shape.amplitude_unit_per_m);
}

/// Distance that holds no cloud whatever the direction, m; 0 in and beside cloud.
fn empty_distance_m(p: vec3<f32>) -> f32 {
    let period = fract(p.xy * vec2<f32>(shape.per_period_x, shape.per_period_y));
    let share = vec3<f32>(period, (p.z - shape.bottom_m) / (shape.top_m - shape.bottom_m));
    let cells = vec3<f32>(f32(shape.cells_x), f32(shape.cells_y), f32(shape.levels));
    let c = vec3<u32>(clamp(share * cells, vec3<f32>(0.0), cells - 0.01));
    let n = (c.z * shape.cells_y + c.y) * shape.cells_x + c.x;
    let byte = (occupancy_words[n / 4u] >> (8u * (n % 4u))) & 0xffu;
    let outside = max(shape.bottom_m - p.z, p.z - shape.top_m);
    return max(f32(byte) * OCCUPANCY_UNIT_M, outside);
}

fn smooth_ramp(x: f32) -> f32 {
    let t = clamp(x, 0.0, 1.0);
    return t * t * (3.0 - 2.0 * t);
}
