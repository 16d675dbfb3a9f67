//! use shared/grid
// Stage `large_scale`; see the CPU twin for what it computes. Bytes a cell: 12.

@group(0) @binding(3) var<storage, read> field: array<f32>;
@group(0) @binding(4) var<storage, read_write> slow: array<f32>;

fn force(id: vec3<u32>, source: f32) {
    if id.x >= sim.cells.w {
        return;
    }
    let z = id.z;
    let w = profile(PROFILE_SUBSIDENCE, z);
    let upper = select(max(z, 1u), min(z + 1u, sim.cells.z - 1u), w < 0.0);
    let rise = field[upper * sim.cells.w + id.x] - field[(upper - 1u) * sim.cells.w + id.x];
    slow[z * sim.cells.w + id.x] += source - w * rise * sim.per_cell_size_m.z;
}

@compute @workgroup_size(64)
fn heat(@builtin(global_invocation_id) id: vec3<u32>) {
    force(id, profile(PROFILE_HEATING, id.z));
}

@compute @workgroup_size(64)
fn water(@builtin(global_invocation_id) id: vec3<u32>) {
    force(id, profile(PROFILE_MOISTENING, id.z));
}

@compute @workgroup_size(64)
fn momentum(@builtin(global_invocation_id) id: vec3<u32>) {
    force(id, 0.0);
}
