//! use shared/grid
// Stage `sponge`; see the CPU twin for what it computes. Bytes a cell and field: 12.

@group(0) @binding(3) var<storage, read> field: array<f32>;
@group(0) @binding(4) var<storage, read_write> slow: array<f32>;

fn damp(id: vec3<u32>, rate_per_s: f32, base: f32) {
    if id.x >= sim.cells.w || rate_per_s <= 0.0 {
        return;
    }
    let i = id.z * sim.cells.w + id.x;
    slow[i] -= rate_per_s / (1.0 + rate_per_s * substep.substep_s) * (field[i] - base);
}

@compute @workgroup_size(64)
fn velocity_x(@builtin(global_invocation_id) id: vec3<u32>) {
    damp(id, profile(PROFILE_SPONGE, id.z), profile(PROFILE_BASE_WIND_X, id.z));
}

@compute @workgroup_size(64)
fn velocity_y(@builtin(global_invocation_id) id: vec3<u32>) {
    damp(id, profile(PROFILE_SPONGE, id.z), profile(PROFILE_BASE_WIND_Y, id.z));
}

@compute @workgroup_size(64)
fn velocity_z(@builtin(global_invocation_id) id: vec3<u32>) {
    damp(id, profile(PROFILE_SPONGE_FACE, id.z), 0.0);
}

@compute @workgroup_size(64)
fn heat(@builtin(global_invocation_id) id: vec3<u32>) {
    damp(id, profile(PROFILE_SPONGE, id.z), profile(PROFILE_BASE_HEAT, id.z));
}
