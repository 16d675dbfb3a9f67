//! use shared/grid
// Stage `project`; see the CPU twin for what it computes. Bytes a cell: 28.

@group(0) @binding(3) var<storage, read> pressure: array<f32>;
@group(0) @binding(4) var<storage, read_write> u: array<f32>;
@group(0) @binding(5) var<storage, read_write> v: array<f32>;
@group(0) @binding(6) var<storage, read_write> w: array<f32>;

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
    let r = substep.stage_s * sim.per_cell_size_m;
    let p = pressure[i];
    u[i] -= r.x * (p - pressure[here + back(x, 1u, nx)]);
    v[i] -= r.y * (p - pressure[row_of(back(y, 1u, sim.cells.y), id.z) + x]);
    if id.z > 0u {
        w[i] -= r.z * (p - pressure[i - sim.cells.w]);
    }
}
