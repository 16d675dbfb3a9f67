//! use shared/grid
// Stage `add_tendencies`; see the CPU twin for what it computes. Bytes a cell and field: 12.

@group(0) @binding(3) var<storage, read> state: array<f32>;
@group(0) @binding(4) var<storage, read_write> slow: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sim.cells.w {
        return;
    }
    let i = id.z * sim.cells.w + id.x;
    slow[i] = state[i] + substep.substep_s * slow[i];
}
