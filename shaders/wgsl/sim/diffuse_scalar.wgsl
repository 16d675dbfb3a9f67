//! use shared/grid
// Stage `diffuse_scalar`; see the CPU twin for what it computes. Bytes a cell: 16.

@group(0) @binding(3) var<storage, read> field: array<f32>;
@group(0) @binding(4) var<storage, read> viscosity: array<f32>;
@group(0) @binding(5) var<storage, read_write> slow: array<f32>;

// Viscosity times difference between a cell and a neighbour, twice the flux.
fn flux(i: u32, j: u32) -> f32 {
    return (viscosity[i] + viscosity[j]) * (field[j] - field[i]);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sim.cells.w {
        return;
    }
    let nx = sim.cells.x;
    let z = id.z;
    let x = id.x % nx;
    let y = id.x / nx;
    let here = row_of(y, z);
    let i = here + x;
    let half = 0.5 / sim.prandtl;
    let k = half * sim.per_cell_size_m * sim.per_cell_size_m;
    let kz = k.z / profile(PROFILE_DENSITY, z);
    var change = k.x * (flux(i, here + ahead(x, 1u, nx)) + flux(i, here + back(x, 1u, nx)));
    change += k.y * (flux(i, row_of(ahead(y, 1u, sim.cells.y), z) + x) + flux(i, row_of(back(y, 1u, sim.cells.y), z) + x));
    if z + 1u < sim.cells.z {
        change += kz * profile(PROFILE_FACE_DENSITY, z + 1u) * flux(i, i + sim.cells.w);
    }
    if z > 0u {
        change += kz * profile(PROFILE_FACE_DENSITY, z) * flux(i, i - sim.cells.w);
    }
    slow[i] += change;
}
