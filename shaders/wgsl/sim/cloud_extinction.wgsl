//! use shared/grid
// Stage `cloud_extinction`; see the CPU twin for what it computes. Bytes a cell: 8.

@group(0) @binding(3) var<storage, read> cloud: array<f32>;
@group(0) @binding(4) var<storage, read_write> extinction: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sim.cells.w {
        return;
    }
    let i = id.z * sim.cells.w + id.x;
    let q = cloud[i];
    var e = 0.0;
    if q > CLOUD_WATER_MIN {
        e = profile(PROFILE_EXTINCTION_SCALE, id.z) * pow(q, 2.0 / 3.0);
    }
    extinction[i] = e;
}
