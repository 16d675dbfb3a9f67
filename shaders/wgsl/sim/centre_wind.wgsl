//! use shared/grid
// Stage `centre_wind`; see the CPU twin for what it computes. Bytes a cell: 24.

@group(0) @binding(3) var<storage, read> u: array<f32>;
@group(0) @binding(4) var<storage, read> v: array<f32>;
@group(0) @binding(5) var<storage, read> w: array<f32>;
@group(0) @binding(6) var<storage, read_write> centre_x: array<f32>;
@group(0) @binding(7) var<storage, read_write> centre_y: array<f32>;
@group(0) @binding(8) var<storage, read_write> centre_z: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sim.cells.w {
        return;
    }
    let nx = sim.cells.x;
    let x = id.x % nx;
    let y = id.x / nx;
    let here = row_of(y, id.z);
    let i = here + x;
    centre_x[i] = 0.5 * (u[i] + u[here + ahead(x, 1u, nx)]);
    centre_y[i] = 0.5 * (v[i] + v[row_of(ahead(y, 1u, sim.cells.y), id.z) + x]);
    var up = 0.5 * w[i];
    // Above the last level is the lid.
    if id.z + 1u < sim.cells.z {
        up += 0.5 * w[i + sim.cells.w];
    }
    centre_z[i] = up;
}
