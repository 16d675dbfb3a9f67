//! use shared/grid
// Stage `dry_buoyancy`; see the CPU twin for what it computes. Bytes a cell: 8.

@group(0) @binding(3) var<storage, read> heat: array<f32>;
@group(0) @binding(4) var<storage, read_write> buoyancy: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sim.cells.w {
        return;
    }
    let i = id.z * sim.cells.w + id.x;
    let theta_v0 = profile(PROFILE_THETA_V, id.z);
    buoyancy[i] = GRAVITY_M_S2 / theta_v0 * (heat[i] + (sim.heat_reference_k - theta_v0));
}
