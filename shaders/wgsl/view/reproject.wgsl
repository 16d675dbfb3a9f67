//! use view/upsample
// Stage `reproject`: a viewer's picture of which one pixel in 4 or 16 is marched (by the kernel `samples`) and the others are looked up in the last one. The twin is cpu/view/reproject.rs.
//
// Behind the picture lie the samples, then what the last picture's pixels met, then room for what those of a band of rows meet, which the host takes from there.

@group(0) @binding(14) var<uniform> recall: Recall;

/// What is found in the last picture.
struct Found {
    met: Met,
    /// Whether the pixel is to be marched.
    open: bool,
}

/// The pixel of the last picture along one axis that is taken, or the first of two, and the share of the second.
fn place_of(v: f32, most: u32) -> vec2<f32> {
    let nearest = u32(v + 0.5);
    if (abs(v - f32(nearest)) <= RECALL_SNAP) {
        return vec2<f32>(f32(min(nearest, most)), 0.0);
    }
    let first = f32(min(u32(v), most));
    return vec2<f32>(first, v - first);
}

/// What the last picture has at a place within it, linear between its pixels.
fn looked_up(x: f32, y: f32) -> Met {
    let last = vec2<u32>(frame.width, frame.height) - 1u;
    let across = place_of(x, last.x);
    let down = place_of(y, last.y);
    let first = vec2<u32>(u32(across.x), u32(down.x));
    let next = min(first + 1u, last);
    let row_numbers = frame.width * SAMPLE_NUMBERS;
    let at = vec4<u32>(vec2<u32>(first.y * row_numbers), vec2<u32>(next.y * row_numbers))
        + vec4<u32>(first.x, next.x, first.x, next.x) + vec4<u32>(recall.last_at);
    let shares = vec4<f32>(
        (1.0 - across.y) * (1.0 - down.y), across.y * (1.0 - down.y), (1.0 - across.y) * down.y, across.y * down.y,
    );
    let through = taps(at, 3u * frame.width);
    let weights = shares * (1.0 - through);
    let light = vec3<f32>(
        dot(taps(at, 0u), shares),
        dot(taps(at, frame.width), shares),
        dot(taps(at, 2u * frame.width), shares),
    );
    let distance_m = dot(weights, taps(at, 4u * frame.width)) / max(weights.x + weights.y + weights.z + weights.w, 1e-6);
    return Met(light, dot(through, shares), distance_m);
}

/// What the last picture says of a pixel, judged by the samples around it.
fn found(at: vec4<u32>, ray: Ray) -> Found {
    let columns = sampling.columns;
    let through = taps(at, 3u * columns);
    let distance = taps(at, 4u * columns);
    let brightness = (taps(at, 0u) + taps(at, columns) + taps(at, 2u * columns)) * (exposed() / 3.0);
    let hidden = 1.0 - through;
    let weights = hidden.x + hidden.y + hidden.z + hidden.w;
    let distance_m = select(RECALL_FAR_M, dot(hidden, distance) / max(weights, 1e-6), 0.02 < weights);

    // The place in the world, carried back with the wind, as the last camera saw it.
    let offset = frame.position_m.xyz - recall.position_m.xyz;
    let level = ray.d.xy * distance_m;
    let place = level + offset.xy;
    // Rays bend up by d^2 / 2R for the one camera as for the other.
    let up = ray.d.z * distance_m + offset.z + (dot(level, level) - dot(place, place)) * (0.5 / EARTH_RADIUS_M);
    let seen = vec3<f32>(place, up);
    let ahead = dot(seen, recall.ahead.xyz);
    let scale = recall.per_pixel / max(ahead, 1e-3);
    let size = vec2<f32>(f32(frame.width), f32(frame.height));
    let pixel = vec2<f32>(dot(seen, recall.right.xyz), -dot(seen, recall.up.xyz)) * scale + (size * 0.5 - 0.5);
    let most_of = size - 1.0;
    var open = ahead < 1e-3 || any(pixel < vec2<f32>(-RECALL_SNAP)) || any(pixel > most_of + RECALL_SNAP);
    let within = clamp(pixel, vec2<f32>(0.0), most_of);
    let was = looked_up(within.x, within.y);

    let seen_m = length(seen);
    open = open || seen_m * RECALL_DISTANCE < abs(was.distance_m - seen_m) * (1.0 - was.through);
    let darkest = least(brightness);
    let brightest = most(brightness);
    let shone = (was.light.r + was.light.g + was.light.b) * (exposed() / 3.0);
    let slack = (darkest + brightest + 2.0 * RECALL_FLOOR) * (0.5 * RECALL_LIGHT);
    open = open || shone < darkest - slack || brightest + slack < shone;
    open = open || was.through < least(through) - RECALL_THROUGH || most(through) + RECALL_THROUGH < was.through;
    return Found(was, open);
}

/// What a pixel meets: what was marched there, or what the last picture says, or what it meets itself.
fn met_again(x: u32, y: u32, ray: Ray) -> Met {
    let place = vec2<u32>(vec2<i32>(i32(x), i32(y)) - vec2<i32>(sampling.origin_x, sampling.origin_y));
    let cell = place / sampling.stride;
    let columns = min(vec2<u32>(cell.x, cell.x + 1u), vec2<u32>(sampling.columns - 1u));
    let rows = min(vec2<u32>(cell.y, cell.y + 1u), vec2<u32>(sampling.rows - 1u)) * (sampling.columns * SAMPLE_NUMBERS);
    let at = vec4<u32>(rows.xx, rows.yy) + columns.xyxy + vec4<u32>(sampling.samples_at);
    if (all(place % sampling.stride == vec2<u32>(0u))) {
        let light = vec3<f32>(taps(at, 0u).x, taps(at, sampling.columns).x, taps(at, 2u * sampling.columns).x);
        return Met(light, taps(at, 3u * sampling.columns).x, taps(at, 4u * sampling.columns).x);
    }
    if (recall.last != 0u) {
        let found = found(at, ray);
        if (!found.open) {
            return found.met;
        }
    }
    return march(ray);
}

@compute @workgroup_size(8, 8)
fn reprojected(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let y = id.y + frame.first_row;
    tile[thread] = 0u;
    if (id.x < frame.width && y < frame.height) {
        let ray = ray_of(vec2<f32>(f32(id.x), f32(y)) + 0.5);
        let met = met_again(id.x, y, ray);
        keep(met, recall.next_at + id.y * frame.width * SAMPLE_NUMBERS + id.x, frame.width);
        tile[thread] = in_word(shown(ray, met));
    }
    pack(group, thread);
}
