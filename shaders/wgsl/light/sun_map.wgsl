//! use shared/shape
//! use shared/detail
//! use shared/extinction
// Stage `sun_map`: the cloud on the sun's rays in a few numbers each. The twin is cpu/light/sun_map.rs.

@group(0) @binding(0) var<uniform> shape: ShapeGrid;
@group(0) @binding(1) var<uniform> frame: SunMapping;
@group(0) @binding(2) var<storage, read> shape_words: array<u32>;
@group(0) @binding(3) var<storage, read> occupancy_words: array<u32>;
@group(0) @binding(4) var<storage, read> detail_words: array<u32>;
// The shadow map and the share behind it; behind that, at `map_at`, the mean extinction of all cloud, and the map's planes. An exponential map's second and third plane are the rays'
// optical depths and lengths in cloud.
@group(0) @binding(5) var<storage, read_write> shadow: array<f32>;

const TURN = 6.283185307179586;

@compute @workgroup_size(8, 8)
fn rays(@builtin(global_invocation_id) id: vec3<u32>) {
    let side = frame.map_side;
    if (id.x >= side || id.y >= side) {
        return;
    }
    let sun = frame.map_sun.xyz;
    let length_m = frame.map_sun.w;
    let steps = u32(clamp(ceil(length_m / MAP_STEP_M), 1.0, f32(MAP_STEPS_MAX)));
    let step = length_m / f32(steps);
    let start = (vec2<f32>(id.xy) + 0.5) / (vec2<f32>(shape.per_period_x, shape.per_period_y) * f32(side));
    var begins = length_m;
    var ends = 0.0;
    var depth = 0.0;
    var length = 0.0;
    var cosines = vec4<f32>(0.0);
    var sines = vec3<f32>(0.0);
    var n = 0u;
    while (n < steps) {
        let from_top = (f32(n) + 0.5) * step;
        let back = length_m - from_top;
        let p = vec3<f32>(start + back * sun.xy, shape.bottom_m + back * sun.z);
        let clear = empty_distance_m(p);
        if (clear > 0.0) {
            n += max(u32(clear / step), 1u);
            continue;
        }
        let met = extinction(p, MAP_DETAIL_DISTANCE_M, false) * step;
        if (met > 0.0) {
            begins = min(begins, from_top - 0.5 * step);
            ends = from_top + 0.5 * step;
            depth += met;
            length += step;
            let turns = TURN * (from_top / length_m) * vec3<f32>(1.0, 2.0, 3.0);
            cosines += 2.0 * met * vec4<f32>(1.0, cos(turns));
            sines += 2.0 * met * sin(turns);
        }
        n += 1u;
    }
    var kept: array<f32, 7>;
    if (frame.map_numbers == 7u) {
        kept = array<f32, 7>(cosines.x, cosines.y, cosines.z, cosines.w, sines.x, sines.y, sines.z);
    } else if (frame.map_numbers == 3u) {
        kept = array<f32, 7>(begins, depth / max(ends - begins, 0.5 * step), depth, 0.0, 0.0, 0.0, 0.0);
    } else {
        kept = array<f32, 7>(begins, depth, length, 0.0, 0.0, 0.0, 0.0);
    }
    let plane = side * side;
    let at = frame.map_at + 1u + id.y * side + id.x;
    for (var k = 0u; k < max(frame.map_numbers, MAP_PLANES_LEAST); k++) {
        shadow[at + k * plane] = clamp(kept[k], -MAP_DEPTH_MAX, MAP_DEPTH_MAX);
    }
}

var<workgroup> partial: array<vec2<f32>, 256>;

/// The mean extinction of all cloud that an exponential map's rays met; 0 of other maps.
@compute @workgroup_size(256)
fn mean_extinction(@builtin(local_invocation_index) thread: u32) {
    let plane = frame.map_side * frame.map_side;
    var sum = vec2<f32>(0.0);
    if (frame.map_numbers == 1u) {
        for (var n = thread; n < plane; n += 256u) {
            sum += vec2<f32>(shadow[frame.map_at + 1u + plane + n], shadow[frame.map_at + 1u + 2u * plane + n]);
        }
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
        shadow[frame.map_at] = select(0.0, partial[0].x / partial[0].y, partial[0].y > 0.0);
    }
}
