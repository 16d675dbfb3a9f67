//! use shared/grid
// Stage `eddy_viscosity`; see the CPU twin for what it computes. Bytes a cell: 20.

@group(0) @binding(3) var<storage, read> u: array<f32>;
@group(0) @binding(4) var<storage, read> v: array<f32>;
@group(0) @binding(5) var<storage, read> w: array<f32>;
@group(0) @binding(6) var<storage, read> buoyancy: array<f32>;
@group(0) @binding(7) var<storage, read_write> viscosity: array<f32>;

fn squares(a: f32, b: f32) -> f32 {
    return a * a + b * b;
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
    let west = back(x, 1u, nx);
    let east = ahead(x, 1u, nx);
    let y_south = back(y, 1u, sim.cells.y);
    let y_north = ahead(y, 1u, sim.cells.y);
    let z_below = max(z, 1u) - 1u;
    let z_above = min(z + 1u, sim.cells.z - 1u);
    let h = row_of(y, z);
    let s = row_of(y_south, z);
    let n = row_of(y_north, z);
    let b = row_of(y, z_below);
    let a = row_of(y, z_above);
    let nb = row_of(y_north, z_below);
    let na = row_of(y_north, z_above);
    let sa = row_of(y_south, z_above);
    let lid = select(0.0, 1.0, z + 1u < sim.cells.z);
    let r = sim.per_cell_size_m;

    let xx = (u[h + east] - u[h + x]) * r.x;
    let yy = (v[n + x] - v[h + x]) * r.y;
    let zz = (lid * w[a + x] - w[h + x]) * r.z;
    // Four edges each: xy at the corners of the level, xz and yz at the edges of the side faces.
    var shear = 0.0;
    for (var side = 0u; side < 2u; side++) {
        let p = select(x, west, side == 0u);
        let q = select(east, x, side == 0u);
        shear += squares(
            (u[h + q] - u[s + q]) * r.y + (v[h + q] - v[h + p]) * r.x,
            (u[n + q] - u[h + q]) * r.y + (v[n + q] - v[n + p]) * r.x);
        shear += squares(
            (u[h + q] - u[b + q]) * r.z + (w[h + q] - w[h + p]) * r.x,
            (u[a + q] - u[h + q]) * r.z + lid * (w[a + q] - w[a + p]) * r.x);
    }
    shear += squares(
        (v[h + x] - v[b + x]) * r.z + (w[h + x] - w[s + x]) * r.y,
        (v[a + x] - v[h + x]) * r.z + lid * (w[a + x] - w[sa + x]) * r.y);
    shear += squares(
        (v[n + x] - v[nb + x]) * r.z + (w[n + x] - w[h + x]) * r.y,
        (v[na + x] - v[n + x]) * r.z + lid * (w[na + x] - w[a + x]) * r.y);
    let strain_squared = 2.0 * (xx * xx + yy * yy + zz * zz) + 0.25 * shear;

    // Across the ground and the lid the shear counts as 0: what the ground does is another stage's.
    var stability = 0.0;
    if (sim.holds & HOLDS_BUOYANCY) != 0u {
        let per_two_dz = sim.per_cell_size_m.z / f32(max(z_above - z_below, 1u));
        stability = GRAVITY_M_S2 / profile(PROFILE_THETA_V, z)
            * (profile(PROFILE_THETA_V, z_above) - profile(PROFILE_THETA_V, z_below)) * per_two_dz
            + (buoyancy[a + x] - buoyancy[b + x]) * per_two_dz;
    }
    viscosity[h + x] = profile(PROFILE_LENGTH_SQUARED, z) * sqrt(max(strain_squared - stability / sim.prandtl, 0.0));
}
