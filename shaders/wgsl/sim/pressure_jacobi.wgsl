//! use shared/grid
// Stage `pressure_jacobi`; see the CPU twin for what it computes and `pressure_source` for what comes before and after the sweeps. Bytes a cell: 12 a sweep.

@group(0) @binding(3) var<storage, read> before: array<f32>;
@group(0) @binding(4) var<storage, read> source: array<f32>;
@group(0) @binding(5) var<storage, read_write> pressure: array<f32>;

fn relax(id: vec3<u32>, share: f32) {
    if id.x >= sim.cells.w {
        return;
    }
    let nx = sim.cells.x;
    let z = id.z;
    let x = id.x % nx;
    let y = id.x / nx;
    let here = row_of(y, z);
    let i = here + x;
    var asked = profile(PROFILE_JACOBI_X, z) * (before[here + back(x, 1u, nx)] + before[here + ahead(x, 1u, nx)])
        + profile(PROFILE_JACOBI_Y, z)
            * (before[row_of(back(y, 1u, sim.cells.y), z) + x] + before[row_of(ahead(y, 1u, sim.cells.y), z) + x]);
    // The weights through ground and lid are 0.
    asked += profile(PROFILE_JACOBI_BELOW, z) * before[row_of(y, max(z, 1u) - 1u) + x]
        + profile(PROFILE_JACOBI_ABOVE, z) * before[row_of(y, min(z + 1u, sim.cells.z - 1u)) + x];
    asked -= profile(PROFILE_JACOBI_SOURCE, z) * source[i];
    pressure[i] = (1.0 - share) * before[i] + share * asked;
}

@compute @workgroup_size(64)
fn sweep(@builtin(global_invocation_id) id: vec3<u32>) {
    relax(id, 1.0);
}

// Half the way, which removes the checkerboard.
@compute @workgroup_size(64)
fn last_sweep(@builtin(global_invocation_id) id: vec3<u32>) {
    relax(id, 0.5);
}
