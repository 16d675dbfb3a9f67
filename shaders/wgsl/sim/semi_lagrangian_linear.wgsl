//! use shared/carried
// Stage `semi_lagrangian_linear`; see the CPU twin for what it computes. Bytes a cell: 20, for w 24, and eight values read out of order.
// One entry point a place.

@group(0) @binding(7) var<storage, read_write> next: array<f32>;
@group(0) @binding(8) var<storage, read> buoyancy: array<f32>;

fn carry(id: vec3<u32>, place: u32) {
    if id.x >= sim.cells.w {
        return;
    }
    let x = id.x % sim.cells.x;
    let y = id.x / sim.cells.x;
    let i = id.z * sim.cells.w + id.x;
    if place == Z_FACE && id.z == 0u {
        // w at the ground stays 0.
        next[i] = 0.0;
        return;
    }
    let corners = around(x, y, id.z, displacement_of(place, x, y, id.z), top_of(place));
    var value = trilinear(four(corners.low) * corners.there.x, four(corners.high) * corners.there.y, corners.t);
    if place == Z_FACE && (sim.holds & HOLDS_BUOYANCY) != 0u {
        value += substep.stage_s * 0.5 * (buoyancy[i - sim.cells.w] + buoyancy[i]);
    }
    next[i] = value;
}

@compute @workgroup_size(64)
fn centre(@builtin(global_invocation_id) id: vec3<u32>) {
    carry(id, CENTRE);
}

@compute @workgroup_size(64)
fn x_face(@builtin(global_invocation_id) id: vec3<u32>) {
    carry(id, X_FACE);
}

@compute @workgroup_size(64)
fn y_face(@builtin(global_invocation_id) id: vec3<u32>) {
    carry(id, Y_FACE);
}

@compute @workgroup_size(64)
fn z_face(@builtin(global_invocation_id) id: vec3<u32>) {
    carry(id, Z_FACE);
}
