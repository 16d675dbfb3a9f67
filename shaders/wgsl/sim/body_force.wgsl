//! use shared/grid
// Stage `body_force`; see the CPU twin for what it computes. Bytes a cell and velocity: 12 within the region.

@group(0) @binding(3) var<storage, read> velocity: array<f32>;
@group(0) @binding(4) var<storage, read_write> slow: array<f32>;

// Whether place `i` along `axis` lies in the region: a face along its own axis, a centre along the others.
fn within(i: u32, axis: u32, at_face: bool) -> bool {
    let region = sim.force_region[axis];
    let ends = select(region.xy, region.zw, at_face);
    return i >= ends.x && i < ends.y;
}

fn push(id: vec3<u32>, axis: u32, acceleration_m_s2: f32) {
    if id.x >= sim.cells.w {
        return;
    }
    let x = id.x % sim.cells.x;
    let y = id.x / sim.cells.x;
    if within(x, 0u, axis == 0u) && within(y, 1u, axis == 1u) && within(id.z, 2u, axis == 2u) {
        let i = id.z * sim.cells.w + id.x;
        let share = 1.0 / (1.0 + sim.force.w * substep.substep_s);
        slow[i] += share * (acceleration_m_s2 - sim.force.w * velocity[i]);
    }
}

@compute @workgroup_size(64)
fn velocity_x(@builtin(global_invocation_id) id: vec3<u32>) {
    push(id, 0u, sim.force.x);
}

@compute @workgroup_size(64)
fn velocity_y(@builtin(global_invocation_id) id: vec3<u32>) {
    push(id, 1u, sim.force.y);
}

@compute @workgroup_size(64)
fn velocity_z(@builtin(global_invocation_id) id: vec3<u32>) {
    push(id, 2u, sim.force.z);
}
