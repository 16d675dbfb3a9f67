//! use shared/grid
// Stage `surface_flux`; see the CPU twin for what it computes. Only the lowest level is touched.

@group(0) @binding(3) var<storage, read> u: array<f32>;
@group(0) @binding(4) var<storage, read> v: array<f32>;
@group(0) @binding(5) var<storage, read_write> slow_u: array<f32>;
@group(0) @binding(6) var<storage, read_write> slow_v: array<f32>;
@group(0) @binding(7) var<storage, read_write> slow_heat: array<f32>;
@group(0) @binding(8) var<storage, read_write> slow_water: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sim.cells.w {
        return;
    }
    let nx = sim.cells.x;
    let x = id.x % nx;
    let y = id.x / nx;
    let i = id.x;
    let north = row_of(ahead(y, 1u, sim.cells.y), 0u);
    let south = row_of(back(y, 1u, sim.cells.y), 0u);
    let here = y * nx;
    let west = back(x, 1u, nx);
    let east = ahead(x, 1u, nx);
    let per_height = profile(PROFILE_FACE_DENSITY, 0u) / profile(PROFILE_DENSITY, 0u) * sim.per_cell_size_m.z;
    if (sim.holds & HOLDS_HEAT) != 0u {
        slow_heat[i] += sim.heat_flux_k_m_s * per_height;
    }
    if (sim.holds & HOLDS_WATER) != 0u {
        slow_water[i] += sim.moisture_flux_m_s * per_height;
    }
    let drag = sim.friction_velocity_squared_m2_s2 * per_height;
    let a = u[i];
    let b = v[i];
    let v_at_u = 0.25 * (v[here + west] + b + v[north + west] + v[north + x]);
    let u_at_v = 0.25 * (a + u[here + east] + u[south + x] + u[south + east]);
    slow_u[i] -= drag * a / max(sqrt(a * a + v_at_u * v_at_u), CALM_M_S);
    slow_v[i] -= drag * b / max(sqrt(u_at_v * u_at_v + b * b), CALM_M_S);
}
