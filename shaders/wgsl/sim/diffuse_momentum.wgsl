//! use shared/grid
// Stage `diffuse_momentum`; see the CPU twin for what it computes. Bytes a cell: 40.

@group(0) @binding(3) var<storage, read> u: array<f32>;
@group(0) @binding(4) var<storage, read> v: array<f32>;
@group(0) @binding(5) var<storage, read> w: array<f32>;
@group(0) @binding(6) var<storage, read> viscosity: array<f32>;
@group(0) @binding(7) var<storage, read_write> slow_u: array<f32>;
@group(0) @binding(8) var<storage, read_write> slow_v: array<f32>;
@group(0) @binding(9) var<storage, read_write> slow_w: array<f32>;

// The sum of four viscosities around an edge.
fn around(a: u32, b: u32, c: u32, d: u32) -> f32 {
    return viscosity[a] + viscosity[b] + viscosity[c] + viscosity[d];
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
    let sb = row_of(y_south, z_below);
    let nb = row_of(y_north, z_below);
    let a = row_of(y, z_above);
    let sa = row_of(y_south, z_above);
    let r = sim.per_cell_size_m;
    let density = profile(PROFILE_DENSITY, z);
    let face_density = profile(PROFILE_FACE_DENSITY, z);
    let inside = z + 1u < sim.cells.z;
    let below = select(0.0, 0.25 * face_density * r.z / density, z > 0u);
    let above = select(0.0, 0.25 * profile(PROFILE_FACE_DENSITY, z + 1u) * r.z / density, inside);
    let i = h + x;

    // u at the west face of the cell.
    {
        let xx = 2.0 * r.x * r.x * (viscosity[i] * (u[h + east] - u[i]) - viscosity[h + west] * (u[i] - u[h + west]));
        let north = 0.25 * around(h + west, i, n + west, n + x)
            * ((u[n + x] - u[i]) * r.y + (v[n + x] - v[n + west]) * r.x);
        let south = 0.25 * around(h + west, i, s + west, s + x)
            * ((u[i] - u[s + x]) * r.y + (v[i] - v[h + west]) * r.x);
        let up = above * around(h + west, i, a + west, a + x)
            * ((u[a + x] - u[i]) * r.z + (w[a + x] - w[a + west]) * r.x);
        let down = below * around(h + west, i, b + west, b + x)
            * ((u[i] - u[b + x]) * r.z + (w[i] - w[h + west]) * r.x);
        slow_u[i] += xx + r.y * (north - south) + (up - down);
    }
    // v at the south face of the cell.
    {
        let yy = 2.0 * r.y * r.y * (viscosity[i] * (v[n + x] - v[i]) - viscosity[s + x] * (v[i] - v[s + x]));
        let e = 0.25 * around(i, h + east, s + x, s + east)
            * ((v[h + east] - v[i]) * r.x + (u[h + east] - u[s + east]) * r.y);
        let f = 0.25 * around(h + west, i, s + west, s + x)
            * ((v[i] - v[h + west]) * r.x + (u[i] - u[s + x]) * r.y);
        let up = above * around(i, s + x, a + x, sa + x)
            * ((v[a + x] - v[i]) * r.z + (w[a + x] - w[sa + x]) * r.y);
        let down = below * around(i, s + x, b + x, sb + x)
            * ((v[i] - v[b + x]) * r.z + (w[i] - w[s + x]) * r.y);
        slow_v[i] += yy + r.x * (e - f) + (up - down);
    }
    // w at the lower face of the cell.
    if z > 0u {
        let e = 0.25 * around(i, h + east, b + x, b + east)
            * ((w[h + east] - w[i]) * r.x + (u[h + east] - u[b + east]) * r.z);
        let f = 0.25 * around(h + west, i, b + west, b + x)
            * ((w[i] - w[h + west]) * r.x + (u[i] - u[b + x]) * r.z);
        let north = 0.25 * around(i, n + x, b + x, nb + x)
            * ((w[n + x] - w[i]) * r.y + (v[n + x] - v[nb + x]) * r.z);
        let south = 0.25 * around(i, s + x, b + x, sb + x)
            * ((w[i] - w[s + x]) * r.y + (v[i] - v[b + x]) * r.z);
        let scale = 2.0 * r.z * r.z / face_density;
        let w_above = select(0.0, w[a + x], inside);
        let zz = scale * density * viscosity[i] * (w_above - w[i])
            - scale * profile(PROFILE_DENSITY, z_below) * viscosity[b + x] * (w[i] - w[b + x]);
        slow_w[i] += r.x * (e - f) + r.y * (north - south) + zz;
    }
}
