//! use shared/grid
// Stage `coriolis`; see the CPU twin for what it computes. Bytes a cell: 24.

@group(0) @binding(3) var<storage, read> u: array<f32>;
@group(0) @binding(4) var<storage, read> v: array<f32>;
@group(0) @binding(5) var<storage, read_write> slow_u: array<f32>;
@group(0) @binding(6) var<storage, read_write> slow_v: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sim.cells.w {
        return;
    }
    let nx = sim.cells.x;
    let x = id.x % nx;
    let y = id.x / nx;
    let here = row_of(y, id.z);
    let north = row_of(ahead(y, 1u, sim.cells.y), id.z);
    let south = row_of(back(y, 1u, sim.cells.y), id.z);
    let west = back(x, 1u, nx);
    let east = ahead(x, 1u, nx);
    let f = sim.coriolis_parameter_per_s;
    let i = here + x;
    let v_at_u = 0.25 * (v[here + west] + v[i] + v[north + west] + v[north + x]);
    let u_at_v = 0.25 * (u[i] + u[here + east] + u[south + x] + u[south + east]);
    slow_u[i] += f * (v_at_u - profile(PROFILE_GEOSTROPHIC_Y, id.z));
    slow_v[i] -= f * (u_at_v - profile(PROFILE_GEOSTROPHIC_X, id.z));
}
