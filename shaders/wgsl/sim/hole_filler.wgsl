//! use shared/grid
// Stage `hole_filler`; see the CPU twin for what it computes. A thread climbs a column and comes down again only if the top still wants something.
// Bytes a cell: 4.

@group(0) @binding(3) var<storage, read_write> filled: array<f32>;

// Lets a cell give the mass `want` (0 or less) that the one before is short of; returns the mass that it is short of itself.
fn settle(i: u32, density: f32, want: f32) -> f32 {
    let held = filled[i];
    if want == 0.0 && held >= 0.0 {
        return 0.0;
    }
    let q = held + want / density;
    let short = min(q, 0.0);
    filled[i] = q - short;
    return short * density;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sim.cells.w {
        return;
    }
    var want = 0.0;
    for (var z = 0u; z < sim.cells.z; z++) {
        want = settle(z * sim.cells.w + id.x, profile(PROFILE_DENSITY, z), want);
    }
    for (var up = 0u; want < 0.0 && up < sim.cells.z; up++) {
        let z = sim.cells.z - 1u - up;
        want = settle(z * sim.cells.w + id.x, profile(PROFILE_DENSITY, z), want);
    }
    if want < 0.0 {
        filled[id.x] += want / profile(PROFILE_DENSITY, 0u);
    }
}
