//! use shared/semi_lagrangian
// Stage `departure`; see the CPU twin for what it computes. Bytes a cell: 24, and 24 values read out of order. `main` looks back,
// `ahead_in_time` ahead.

@group(0) @binding(3) var<storage, read> wind_x: array<f32>;
@group(0) @binding(4) var<storage, read> wind_y: array<f32>;
@group(0) @binding(5) var<storage, read> wind_z: array<f32>;
@group(0) @binding(6) var<storage, read_write> out_x: array<f32>;
@group(0) @binding(7) var<storage, read_write> out_y: array<f32>;
@group(0) @binding(8) var<storage, read_write> out_z: array<f32>;

fn wind_at(i: u32) -> vec3<f32> {
    return vec3<f32>(wind_x[i], wind_y[i], wind_z[i]);
}

fn trace(id: vec3<u32>, dt_s: f32) {
    if id.x >= sim.cells.w {
        return;
    }
    let i = id.z * sim.cells.w + id.x;
    let per_cell = dt_s * sim.per_cell_size_m.xyz;
    let half_way = 0.5 * per_cell * wind_at(i);
    let corners = around(id.x % sim.cells.x, id.x / sim.cells.x, id.z, half_way, sim.cells.z - 1u);
    // The three winds at the eight corners; centres are all stored.
    let a = wind_at(corners.low.x);
    let b = wind_at(corners.low.y);
    let c = wind_at(corners.low.z);
    let d = wind_at(corners.low.w);
    let e = wind_at(corners.high.x);
    let f = wind_at(corners.high.y);
    let g = wind_at(corners.high.z);
    let h = wind_at(corners.high.w);
    let t = corners.t;
    let south_low = a + t.x * (b - a);
    let north_low = c + t.x * (d - c);
    let south_high = e + t.x * (f - e);
    let north_high = g + t.x * (h - g);
    let low = south_low + t.y * (north_low - south_low);
    let high = south_high + t.y * (north_high - south_high);
    let displacement = per_cell * (low + t.z * (high - low));
    out_x[i] = displacement.x;
    out_y[i] = displacement.y;
    out_z[i] = displacement.z;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    trace(id, substep.stage_s);
}

@compute @workgroup_size(64)
fn ahead_in_time(@builtin(global_invocation_id) id: vec3<u32>) {
    trace(id, -substep.stage_s);
}
