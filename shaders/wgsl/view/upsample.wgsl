//! use view/march
// Stage `upsample`: a picture of which one pixel in four is marched, and more only where those disagree. The twin is cpu/view/upsample.rs.
//
// Two kernels: `samples` marches every second pixel of every second row, or others that stage `reproject` wants, `upsampled` draws the picture. Samples lie behind the picture in the
// same buffer, since the march binds all eight storage buffers that WebGPU grants.

@group(0) @binding(13) var<uniform> sampling: Sampling;

@compute @workgroup_size(8, 8)
fn samples(@builtin(global_invocation_id) id: vec3<u32>) {
    let row = id.y + frame.first_row;
    if (id.x >= sampling.columns || row >= sampling.rows) {
        return;
    }
    let pixel = vec2<i32>(vec2<u32>(id.x, row) * sampling.stride) + vec2<i32>(sampling.origin_x, sampling.origin_y);
    let met = march(ray_of(vec2<f32>(pixel) + 0.5));
    keep(met, sampling.samples_at + row * sampling.columns * SAMPLE_NUMBERS + id.x, sampling.columns);
}

/// Stores what a ray met, its numbers `apart` words from each other.
fn keep(met: Met, at: u32, apart: u32) {
    picture[at] = bitcast<u32>(met.light.r);
    picture[at + apart] = bitcast<u32>(met.light.g);
    picture[at + 2u * apart] = bitcast<u32>(met.light.b);
    picture[at + 3u * apart] = bitcast<u32>(met.through);
    picture[at + 4u * apart] = bitcast<u32>(met.distance_m);
}

/// A number at four places, `offset` words behind these.
fn taps(at: vec4<u32>, offset: u32) -> vec4<f32> {
    let n = at + vec4<u32>(offset);
    return bitcast<vec4<f32>>(vec4<u32>(picture[n.x], picture[n.y], picture[n.z], picture[n.w]));
}

/// In pairs, so that the mean of four equal numbers is that number.
fn mean(taps: vec4<f32>) -> f32 {
    return ((taps.x + taps.y) + (taps.z + taps.w)) * 0.25;
}

fn least(taps: vec4<f32>) -> f32 {
    return min(min(taps.x, taps.y), min(taps.z, taps.w));
}

fn most(taps: vec4<f32>) -> f32 {
    return max(max(taps.x, taps.y), max(taps.z, taps.w));
}

/// What the samples around a pixel say, or what it meets itself where they disagree.
fn met_between(x: u32, y: u32, ray: Ray) -> Met {
    let columns = min(vec2<u32>(x, x + 1u) / 2u, vec2<u32>(sampling.columns - 1u));
    let rows = min(vec2<u32>(y, y + 1u) / 2u, vec2<u32>(sampling.rows - 1u)) * (sampling.columns * SAMPLE_NUMBERS);
    let at = vec4<u32>(rows.xx, rows.yy) + columns.xyxy + vec4<u32>(sampling.samples_at);
    let red = taps(at, 0u);
    let green = taps(at, sampling.columns);
    let blue = taps(at, 2u * sampling.columns);
    let through = taps(at, 3u * sampling.columns);
    let distance = taps(at, 4u * sampling.columns);
    let brightness = (red + green + blue) * (exposed() / 3.0);
    let hidden = 1.0 - through;
    let opacity = mean(hidden);
    let nearest = least(distance);
    let farthest = most(distance);
    if (most(brightness) - least(brightness) > (mean(brightness) + AGREES_FLOOR) * AGREES_LIGHT
        || most(through) - least(through) > AGREES_THROUGH
        || (farthest - nearest) * opacity > farthest * AGREES_DISTANCE) {
        return march(ray);
    }
    let distance_m = select(nearest, mean(hidden * distance) / max(opacity, 1e-6), nearest < farthest);
    return Met(vec3<f32>(mean(red), mean(green), mean(blue)), mean(through), distance_m);
}

@compute @workgroup_size(8, 8)
fn upsampled(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let y = id.y + frame.first_row;
    tile[thread] = 0u;
    if (id.x < frame.width && y < frame.height) {
        let ray = ray_of(vec2<f32>(f32(id.x), f32(y)) + 0.5);
        tile[thread] = in_word(shown(ray, met_between(id.x, y, ray)));
    }
    pack(group, thread);
}
