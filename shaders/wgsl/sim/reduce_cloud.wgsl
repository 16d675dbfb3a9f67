//! use shared/grid
// Stage `reduce_cloud`; see the CPU twin for what it computes. Bytes a cell: 24.
// `levels` sums each level by one workgroup, in f32 and in a fixed order; the few sums are joined by the host in f64. `columns` counts the columns with
// cloud.

@group(0) @binding(3) var<storage, read> cloud: array<f32>;
@group(0) @binding(4) var<storage, read> water: array<f32>;
@group(0) @binding(5) var<storage, read> extinction: array<f32>;
@group(0) @binding(6) var<storage, read> u: array<f32>;
@group(0) @binding(7) var<storage, read> v: array<f32>;
// Per level: water, cloud water, its momentum east and north, largest cloud water, largest extinction.
@group(0) @binding(8) var<storage, read_write> sums: array<f32>;
@group(0) @binding(9) var<storage, read_write> cloudy_columns: array<atomic<u32>>;

var<workgroup> partial: array<vec4<f32>, 256>;
var<workgroup> largest: array<vec2<f32>, 256>;

@compute @workgroup_size(256)
fn levels(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let level = group.x * sim.cells.w;
    var sum = vec4<f32>(0.0);
    var most = vec2<f32>(0.0);
    for (var n = thread; n < sim.cells.w; n += 256u) {
        let i = level + n;
        let liquid = max(cloud[i], 0.0);
        sum += vec4<f32>(water[i], liquid, liquid * u[i], liquid * v[i]);
        most = max(most, vec2<f32>(liquid, extinction[i]));
    }
    partial[thread] = sum;
    largest[thread] = most;
    for (var half = 128u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if thread < half {
            partial[thread] += partial[thread + half];
            largest[thread] = max(largest[thread], largest[thread + half]);
        }
    }
    if thread == 0u {
        let at = group.x * CLOUD_SUMS;
        sums[at] = partial[0].x;
        sums[at + 1u] = partial[0].y;
        sums[at + 2u] = partial[0].z;
        sums[at + 3u] = partial[0].w;
        sums[at + 4u] = largest[0].x;
        sums[at + 5u] = largest[0].y;
    }
}

@compute @workgroup_size(64)
fn columns(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sim.cells.w {
        return;
    }
    for (var z = 0u; z < sim.cells.z; z++) {
        if cloud[z * sim.cells.w + id.x] > CLOUDY_KG_PER_KG {
            atomicAdd(&cloudy_columns[0], 1u);
            return;
        }
    }
}
