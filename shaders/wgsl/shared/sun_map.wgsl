//! use shared/shape
// Lookups in the map of stage `sun_map`. The twin is cpu/light/sun_map.rs. The module that uses it binds `frame`, the uniform `shape`, and `shadow`, behind whose share lie, at
// `map_at`, the mean extinction of all cloud and then the map's planes.

/// A number of the four rays around a place.
fn rays_around(n: vec4<u32>, number: u32) -> vec4<f32> {
    let at = n + frame.map_at + 1u + number * frame.map_side * frame.map_side;
    return vec4<f32>(shadow[at.x], shadow[at.y], shadow[at.z], shadow[at.w]);
}

/// Optical depth towards the sun.
fn map_depth(p: vec3<f32>) -> f32 {
    let sun = frame.map_sun.xyz;
    let height = clamp(p.z, shape.bottom_m, shape.top_m);
    let back = (height - shape.bottom_m) / sun.z;
    let distance = (shape.top_m - height) / sun.z;
    let side = frame.map_side;
    let g = fract((p.xy - back * sun.xy) * vec2<f32>(shape.per_period_x, shape.per_period_y)) * f32(side) + (f32(side) - 0.5);
    let whole = floor(g);
    let f = g - whole;
    let i = vec2<u32>(whole);
    let x = vec2<u32>(i.x, i.x + 1u) % side;
    let y = (vec2<u32>(i.y, i.y + 1u) % side) * side;
    let n = vec4<u32>(x.x + y.x, x.y + y.x, x.x + y.y, x.y + y.y);
    let weights = vec4<f32>((1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y);
    if (frame.map_numbers == 1u) {
        let within = max(vec4<f32>(distance) - rays_around(n, 0u), vec4<f32>(0.0)) * shadow[frame.map_at];
        return -log(clamp(dot(weights, exp(-within)), 1e-30, 1.0));
    }
    if (frame.map_numbers == 3u) {
        let within = max(vec4<f32>(distance) - rays_around(n, 0u), vec4<f32>(0.0));
        return dot(weights, min(rays_around(n, 1u) * within, rays_around(n, 2u)));
    }
    let share = distance / frame.map_sun.w;
    let whole_depth = 0.5 * dot(weights, rays_around(n, 0u));
    var depth = whole_depth * share;
    for (var k = 1u; k < 4u; k++) {
        let turn = 2.0 * PI * f32(k);
        depth += (dot(weights, rays_around(n, k)) * sin(share * turn) + dot(weights, rays_around(n, k + 3u)) * (1.0 - cos(share * turn))) / turn;
    }
    // A series of few terms swings below nothing and above the whole.
    return min(max(depth, 0.0), whole_depth);
}
