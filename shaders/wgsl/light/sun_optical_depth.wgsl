//! use shared/shape
//! use shared/spline
// Stage `sun_optical_depth`: a march towards the sun from every point near cloud. The twin is cpu/light/sun_optical_depth.rs.

@group(0) @binding(0) var<uniform> shape: ShapeGrid;
@group(0) @binding(1) var<uniform> sun: SunMarch;
@group(0) @binding(2) var<storage, read> shape_words: array<u32>;
@group(0) @binding(3) var<storage, read> occupancy_words: array<u32>;
@group(0) @binding(4) var<storage, read> above: array<f32>;
@group(0) @binding(5) var<storage, read> below: array<f32>;
@group(0) @binding(6) var<storage, read_write> light_words: array<u32>;
// The shadow map, and after its last point the mean share of sunlight that passes.
@group(0) @binding(7) var<storage, read_write> shadow: array<f32>;

fn optical_depth(from_m: vec3<f32>) -> f32 {
    let direction = sun.direction.xyz;
    let end = min((shape.top_m - from_m.z) / direction.z, SUN_MARCH_REACH_M);
    var depth = 0.0;
    var t = 0.0;
    for (var n = 0u; n < SUN_MARCH_STEPS && t < end; n++) {
        let step = t * SUN_MARCH_STEP_GROWTH + SUN_MARCH_STEP_M;
        let at = t + step * 0.5;
        let p = from_m + at * direction;
        let empty = empty_distance_m(p);
        if (empty <= 0.0 && at < end) {
            let s = shape_sample(p);
            let kept = select(s.x, smooth_ramp((s.x - CARVE_EDGE) / CARVE_MEAN_RAMP), sun.carved != 0u);
            depth += s.y * kept * step;
        }
        t += max(step, empty);
        if (depth > SUN_MARCH_DEEP) {
            break;
        }
    }
    return depth;
}

fn point_m(x: u32, y: u32, z_m: f32) -> vec3<f32> {
    return vec3<f32>((f32(x) - 0.5) * shape.point_spacing_x_m, (f32(y) - 0.5) * shape.point_spacing_y_m, z_m);
}

/// Visibility from above and from below at a point, smoothed from the cells as the shape is.
fn visibility(x: u32, y: u32, level: u32) -> vec2<f32> {
    let finer = shape.finer;
    let px = (x + shape.points_x - 1u) % shape.points_x;
    let py = (y + shape.points_y - 1u) % shape.points_y;
    let cx = px / finer;
    let cy = py / finer;
    let wx = spline(px % finer, finer);
    let wy = spline(py % finer, finer);
    let wz = spline(level % finer, finer);
    var seen = vec2<f32>(0.0);
    for (var c = 0u; c < 3u; c++) {
        let z = min(max(level / finer + c, 1u) - 1u, shape.levels - 1u);
        for (var b = 0u; b < 3u; b++) {
            let row = (z * shape.cells_y + (cy + shape.cells_y + b - 1u) % shape.cells_y) * shape.cells_x;
            for (var a = 0u; a < 3u; a++) {
                let cell = row + (cx + shape.cells_x + a - 1u) % shape.cells_x;
                seen += wz[c] * wy[b] * wx[a] * vec2<f32>(above[cell], below[cell]);
            }
        }
    }
    return seen;
}

@compute @workgroup_size(32, 2, 2)
fn points(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= shape.stride_x || id.y >= shape.stride_y || id.z >= shape.points_z) {
        return;
    }
    let p = point_m(id.x, id.y, shape.bottom_m + (f32(id.z) + 0.5) * shape.point_spacing_z_m);
    var word = 0u;
    if (empty_distance_m(p) < sun.margin_m) {
        let depth = u32(min(optical_depth(p) / DEPTH_UNIT, 65535.0));
        let share = vec2<u32>(clamp(visibility(id.x, id.y, id.z), vec2<f32>(0.0), vec2<f32>(1.0)) * 255.0 + 0.5);
        word = depth | (share.x << 16u) | (share.y << 24u);
    }
    light_words[(id.z * shape.stride_y + id.y) * shape.stride_x + id.x] = word;
}

@compute @workgroup_size(32, 2)
fn ground_shadow(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= shape.stride_x || id.y >= shape.stride_y) {
        return;
    }
    shadow[id.y * shape.stride_x + id.x] = optical_depth(point_m(id.x, id.y, shape.bottom_m));
}

var<workgroup> partial: array<f32, 256>;

@compute @workgroup_size(256)
fn sunlit_share(@builtin(local_invocation_index) thread: u32) {
    let count = shape.stride_x * shape.stride_y;
    var sum = 0.0;
    for (var n = thread; n < count; n += 256u) {
        sum += exp(-shadow[n]);
    }
    partial[thread] = sum;
    workgroupBarrier();
    for (var span = 128u; span > 0u; span /= 2u) {
        if (thread < span) {
            partial[thread] += partial[thread + span];
        }
        workgroupBarrier();
    }
    if (thread == 0u) {
        shadow[count] = partial[0] / f32(count);
    }
}
