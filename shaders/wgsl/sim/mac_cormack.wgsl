//! use shared/carried
// Stage `mac_cormack`; see the CPU twin for what it computes. Three kernels, so that eight storage buffers suffice: `there` writes the forward result and
// its bounds, `back_again` corrects it by the way back, `limit` holds it within the bounds and adds buoyancy to w. Bytes a cell: 28, 24 and 16,
// for w 4 more, and 16 values read out of order. One entry point a place.

// Of `there`.
@group(0) @binding(7) var<storage, read_write> there: array<f32>;
@group(0) @binding(8) var<storage, read_write> there_low: array<f32>;
@group(0) @binding(9) var<storage, read_write> there_high: array<f32>;
// Of `back_again`, whose displacements are those ahead in time.
@group(0) @binding(7) var<storage, read_write> corrected: array<f32>;
@group(0) @binding(8) var<storage, read> forward: array<f32>;
// Of `limit`.
@group(0) @binding(3) var<storage, read_write> next: array<f32>;
@group(0) @binding(4) var<storage, read> low: array<f32>;
@group(0) @binding(5) var<storage, read> high: array<f32>;
@group(0) @binding(6) var<storage, read> buoyancy: array<f32>;

fn go(id: vec3<u32>, place: u32) {
    if id.x >= sim.cells.w {
        return;
    }
    let x = id.x % sim.cells.x;
    let y = id.x / sim.cells.x;
    let i = id.z * sim.cells.w + id.x;
    if place == Z_FACE && id.z == 0u {
        // w at the ground stays 0.
        there[i] = 0.0;
        there_low[i] = 0.0;
        there_high[i] = 0.0;
        return;
    }
    let corners = around(x, y, id.z, displacement_of(place, x, y, id.z), top_of(place));
    let below = four(corners.low) * corners.there.x;
    let above = four(corners.high) * corners.there.y;
    let bounds = extrema(below, above);
    there[i] = trilinear(below, above, corners.t);
    there_low[i] = bounds.x;
    there_high[i] = bounds.y;
}

fn come_back(id: vec3<u32>, place: u32) {
    if id.x >= sim.cells.w {
        return;
    }
    let x = id.x % sim.cells.x;
    let y = id.x / sim.cells.x;
    let i = id.z * sim.cells.w + id.x;
    if place == Z_FACE && id.z == 0u {
        corrected[i] = 0.0;
        return;
    }
    let corners = around(x, y, id.z, displacement_of(place, x, y, id.z), top_of(place));
    let l = corners.low;
    let h = corners.high;
    let below = vec4<f32>(forward[l.x], forward[l.y], forward[l.z], forward[l.w]) * corners.there.x;
    let above = vec4<f32>(forward[h.x], forward[h.y], forward[h.z], forward[h.w]) * corners.there.y;
    corrected[i] = forward[i] + 0.5 * (carried[i] - trilinear(below, above, corners.t));
}

fn hold(id: vec3<u32>, place: u32) {
    if id.x >= sim.cells.w {
        return;
    }
    let i = id.z * sim.cells.w + id.x;
    var value = bounded(next[i], low[i], high[i]);
    if place == Z_FACE && id.z > 0u && (sim.holds & HOLDS_BUOYANCY) != 0u {
        value += substep.stage_s * 0.5 * (buoyancy[i - sim.cells.w] + buoyancy[i]);
    }
    next[i] = value;
}

@compute @workgroup_size(64)
fn there_centre(@builtin(global_invocation_id) id: vec3<u32>) {
    go(id, CENTRE);
}

@compute @workgroup_size(64)
fn there_x_face(@builtin(global_invocation_id) id: vec3<u32>) {
    go(id, X_FACE);
}

@compute @workgroup_size(64)
fn there_y_face(@builtin(global_invocation_id) id: vec3<u32>) {
    go(id, Y_FACE);
}

@compute @workgroup_size(64)
fn there_z_face(@builtin(global_invocation_id) id: vec3<u32>) {
    go(id, Z_FACE);
}

@compute @workgroup_size(64)
fn back_again_centre(@builtin(global_invocation_id) id: vec3<u32>) {
    come_back(id, CENTRE);
}

@compute @workgroup_size(64)
fn back_again_x_face(@builtin(global_invocation_id) id: vec3<u32>) {
    come_back(id, X_FACE);
}

@compute @workgroup_size(64)
fn back_again_y_face(@builtin(global_invocation_id) id: vec3<u32>) {
    come_back(id, Y_FACE);
}

@compute @workgroup_size(64)
fn back_again_z_face(@builtin(global_invocation_id) id: vec3<u32>) {
    come_back(id, Z_FACE);
}

@compute @workgroup_size(64)
fn limit(@builtin(global_invocation_id) id: vec3<u32>) {
    hold(id, CENTRE);
}

@compute @workgroup_size(64)
fn limit_z_face(@builtin(global_invocation_id) id: vec3<u32>) {
    hold(id, Z_FACE);
}
