//! use shared/grid
// Stage `cloudy_ascent`; see the CPU twin for what it computes. Bytes a cell: 16.

@group(0) @binding(3) var<storage, read> cloud: array<f32>;
@group(0) @binding(4) var<storage, read> w: array<f32>;
@group(0) @binding(5) var<storage, read_write> heat: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sim.cells.w {
        return;
    }
    let i = id.z * sim.cells.w + id.x;
    let half = 0.5 * substep.stage_s;
    var rise = half * profile(PROFILE_CLOUDY_ASCENT, id.z) * w[i];
    if id.z + 1u < sim.cells.z {
        rise += half * profile(PROFILE_CLOUDY_ASCENT, id.z + 1u) * w[i + sim.cells.w];
    }
    heat[i] -= cloud[i] * rise;
}
