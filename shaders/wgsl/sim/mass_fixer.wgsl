//! use shared/grid
// Stage `mass_fixer`; see the CPU twin for what it computes. Three kernels: `levels` sums each level by one workgroup in a fixed order, `join` the levels by
// one thread, `main` multiplies. Bytes a cell: 8 and 8.
// In single precision, so what is summed is not the two sums but one of them and the difference, cell by cell: its rounding is that of
// the small change, not that of the whole.

@group(0) @binding(3) var<storage, read> before: array<f32>;
@group(0) @binding(4) var<storage, read> after: array<f32>;
// Per level: mass-weighted sum of before less after, and of after; behind the levels the factor less 1.
@group(0) @binding(5) var<storage, read_write> sums: array<f32>;
@group(0) @binding(6) var<storage, read_write> fixed: array<f32>;

var<workgroup> partial: array<vec2<f32>, 256>;

@compute @workgroup_size(256)
fn levels(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let level = group.x * sim.cells.w;
    var sum = vec2<f32>(0.0);
    for (var n = thread; n < sim.cells.w; n += 256u) {
        let now = after[level + n];
        sum += vec2<f32>(before[level + n] - now, now);
    }
    partial[thread] = sum;
    for (var half = 128u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if thread < half {
            partial[thread] += partial[thread + half];
        }
    }
    if thread == 0u {
        let density = profile(PROFILE_DENSITY, group.x);
        sums[2u * group.x] = density * partial[0].x;
        sums[2u * group.x + 1u] = density * partial[0].y;
    }
}

@compute @workgroup_size(1)
fn join() {
    var sum = vec2<f32>(0.0);
    for (var z = 0u; z < sim.cells.z; z++) {
        sum += vec2<f32>(sums[2u * z], sums[2u * z + 1u]);
    }
    var excess = 0.0;
    if sum.y > 0.0 && sum.x + sum.y > 0.0 {
        excess = sum.x / sum.y;
    }
    sums[2u * sim.cells.z] = excess;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sim.cells.w {
        return;
    }
    let i = id.z * sim.cells.w + id.x;
    fixed[i] += fixed[i] * sums[2u * sim.cells.z];
}
