//! use shared/grid
// Stage `constant_viscosity`; see the CPU twin for what it computes. Explicit: `add_*`, bytes a cell 12. Implicit: `sweep_*` as often as the host counts,
// 12 each (the first 8), `last_*`, which goes half the way, and `finish`, 16.

// The substep's start.
@group(0) @binding(3) var<storage, read> start: array<f32>;
// The sweep before; with `add_*` the start, with `finish` the last sweep.
@group(0) @binding(4) var<storage, read> state: array<f32>;
@group(0) @binding(5) var<storage, read_write> to: array<f32>;

// What is mixed, and the place in `sim.mixing` and `sim.mixing_rate_per_s`. Always a constant where it is passed, so that the choice is made when the
// shader is compiled.
const VELOCITY = 0u;
const VELOCITY_Z = 1u;
const SCALAR = 2u;

// What flows into the cell, in the field's unit a second.
fn flux_at(which: u32, x: u32, y: u32, z: u32) -> f32 {
    let here = row_of(y, z);
    let i = here + x;
    let q = state[i];
    let h = sim.mixing[which] * sim.per_cell_size_m.xyz * sim.per_cell_size_m.xyz;
    let sideways = h.x * ((state[here + ahead(x, 1u, sim.cells.x)] - q) + (state[here + back(x, 1u, sim.cells.x)] - q))
        + h.y * ((state[row_of(ahead(y, 1u, sim.cells.y), z) + x] - q) + (state[row_of(back(y, 1u, sim.cells.y), z) + x] - q));
    let density = profile(PROFILE_DENSITY, z);
    let face_density = profile(PROFILE_FACE_DENSITY, z);
    let top = z + 1u == sim.cells.z;
    var upright = 0.0;
    if which == VELOCITY_Z {
        // Not asked for at the ground's faces. At the lid w is 0 and not stored.
        var above = 0.0;
        if !top {
            above = state[i + sim.cells.w];
        }
        upright = h.z * (density / face_density) * (above - q)
            + h.z * (profile(PROFILE_DENSITY, z - 1u) / face_density) * (state[i - sim.cells.w] - q);
    } else {
        if !top {
            upright = h.z * (profile(PROFILE_FACE_DENSITY, z + 1u) / density) * (state[i + sim.cells.w] - q);
        }
        if z > 0u {
            upright += h.z * (face_density / density) * (state[i - sim.cells.w] - q);
        }
    }
    return sideways + upright;
}

fn add(id: vec3<u32>, which: u32) {
    if id.x >= sim.cells.w || (which == VELOCITY_Z && id.z == 0u) {
        return;
    }
    to[id.z * sim.cells.w + id.x] += flux_at(which, id.x % sim.cells.x, id.x / sim.cells.x, id.z);
}

fn sweep(id: vec3<u32>, which: u32, share: f32) {
    if id.x >= sim.cells.w {
        return;
    }
    let i = id.z * sim.cells.w + id.x;
    if which == VELOCITY_Z && id.z == 0u {
        to[i] = start[i];
        return;
    }
    let weight = share / (1.0 + substep.substep_s * sim.mixing_rate_per_s[which]);
    let flux = substep.substep_s * flux_at(which, id.x % sim.cells.x, id.x / sim.cells.x, id.z);
    let q = state[i];
    // As a difference, so that what is constant stays so to the bit.
    to[i] = q + weight * ((start[i] - q) + flux);
}

@compute @workgroup_size(64)
fn finish(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sim.cells.w {
        return;
    }
    let i = id.z * sim.cells.w + id.x;
    to[i] += (state[i] - start[i]) / substep.substep_s;
}

@compute @workgroup_size(64)
fn add_velocity(@builtin(global_invocation_id) id: vec3<u32>) {
    add(id, VELOCITY);
}

@compute @workgroup_size(64)
fn sweep_velocity(@builtin(global_invocation_id) id: vec3<u32>) {
    sweep(id, VELOCITY, 1.0);
}

@compute @workgroup_size(64)
fn last_velocity(@builtin(global_invocation_id) id: vec3<u32>) {
    sweep(id, VELOCITY, 0.5);
}

@compute @workgroup_size(64)
fn add_velocity_z(@builtin(global_invocation_id) id: vec3<u32>) {
    add(id, VELOCITY_Z);
}

@compute @workgroup_size(64)
fn sweep_velocity_z(@builtin(global_invocation_id) id: vec3<u32>) {
    sweep(id, VELOCITY_Z, 1.0);
}

@compute @workgroup_size(64)
fn last_velocity_z(@builtin(global_invocation_id) id: vec3<u32>) {
    sweep(id, VELOCITY_Z, 0.5);
}

@compute @workgroup_size(64)
fn add_scalar(@builtin(global_invocation_id) id: vec3<u32>) {
    add(id, SCALAR);
}

@compute @workgroup_size(64)
fn sweep_scalar(@builtin(global_invocation_id) id: vec3<u32>) {
    sweep(id, SCALAR, 1.0);
}

@compute @workgroup_size(64)
fn last_scalar(@builtin(global_invocation_id) id: vec3<u32>) {
    sweep(id, SCALAR, 0.5);
}
