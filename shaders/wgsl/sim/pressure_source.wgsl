//! use shared/grid
// What the iterative pressure rungs share; see `pressure_source` of the CPU device. In order: `means`, `column`, `load`; then the rung's sweeps; then `top` and
// `store` (or `store_in_place`). Bytes a cell: 8 for the means, 24 to load, 8 to store.

@group(0) @binding(3) var<storage, read> u: array<f32>;
@group(0) @binding(4) var<storage, read> v: array<f32>;
@group(0) @binding(5) var<storage, read> w: array<f32>;
// Per level: mean of w, m/s, mean of the pressure (or a number that is not finite), and the mean column of the pressure that is made of the former,
// m2/s2; behind the levels the mean that the sweeps left in the topmost level.
@group(0) @binding(6) var<storage, read_write> numbers: array<f32>;
@group(0) @binding(7) var<storage, read_write> pressure: array<f32>;
// `div(rho v) / dt` less its level's mean, kg/m3/s2.
@group(0) @binding(8) var<storage, read_write> source: array<f32>;
// Where the last sweep left the pressure.
@group(0) @binding(3) var<storage, read> swept: array<f32>;

const NUMBERS_A_LEVEL = 3u;

var<workgroup> partial: array<vec2<f32>, 256>;

// Sums the threads' parts in a fixed order; the result is in the first.
fn join(thread: u32) {
    for (var half = 128u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if thread < half {
            partial[thread] += partial[thread + half];
        }
    }
}

@compute @workgroup_size(256)
fn means(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let level = group.x * sim.cells.w;
    var sum = vec2<f32>(0.0);
    for (var n = thread; n < sim.cells.w; n += 256u) {
        sum += vec2<f32>(w[level + n], pressure[level + n]);
    }
    partial[thread] = sum;
    join(thread);
    if thread == 0u {
        let mean = partial[0] / f32(sim.cells.w);
        let at = NUMBERS_A_LEVEL * group.x;
        numbers[at] = select(0.0, mean.x, group.x > 0u);
        numbers[at + 1u] = mean.y;
    }
}

// One thread: a sum over the levels, from the topmost down.
@compute @workgroup_size(1)
fn column() {
    let per_dt = sim.cell_size_m.z / substep.stage_s;
    var mean = 0.0;
    for (var up = 1u; up <= sim.cells.z; up++) {
        let z = sim.cells.z - up;
        if up > 1u {
            mean -= per_dt * numbers[NUMBERS_A_LEVEL * (z + 1u)];
        }
        numbers[NUMBERS_A_LEVEL * z + 2u] = mean;
    }
}

fn is_finite(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7f800000u) != 0x7f800000u;
}

@compute @workgroup_size(64)
fn load(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sim.cells.w {
        return;
    }
    let nx = sim.cells.x;
    let z = id.z;
    let x = id.x % nx;
    let y = id.x / nx;
    let here = row_of(y, z);
    let i = here + x;
    let r = sim.per_cell_size_m;
    // What rises through the lower and the upper face beside the level's mean.
    var up = -profile(PROFILE_FACE_DENSITY, z) * (w[i] - numbers[NUMBERS_A_LEVEL * z]);
    if z + 1u < sim.cells.z {
        up += profile(PROFILE_FACE_DENSITY, z + 1u) * (w[i + sim.cells.w] - numbers[NUMBERS_A_LEVEL * (z + 1u)]);
    }
    let across = profile(PROFILE_DENSITY, z)
        * ((u[here + ahead(x, 1u, nx)] - u[i]) * r.x + (v[row_of(ahead(y, 1u, sim.cells.y), z) + x] - v[i]) * r.y);
    source[i] = (across + up * r.z) / substep.stage_s;
    // A first guess must not keep what a spoilt substep left.
    let mean = numbers[NUMBERS_A_LEVEL * z + 1u];
    if is_finite(mean) {
        pressure[i] -= mean;
    } else {
        pressure[i] = 0.0;
    }
}

@compute @workgroup_size(256)
fn top(@builtin(local_invocation_index) thread: u32) {
    let level = (sim.cells.z - 1u) * sim.cells.w;
    var sum = 0.0;
    for (var n = thread; n < sim.cells.w; n += 256u) {
        sum += swept[level + n];
    }
    partial[thread] = vec2<f32>(sum, 0.0);
    join(thread);
    if thread == 0u {
        numbers[NUMBERS_A_LEVEL * sim.cells.z] = partial[0].x / f32(sim.cells.w);
    }
}

// The mean column, its constant such that the topmost level's mean is 0: sweeps leave the constant where it happens to end.
fn mean_at(z: u32) -> f32 {
    return numbers[NUMBERS_A_LEVEL * z + 2u] - numbers[NUMBERS_A_LEVEL * sim.cells.z];
}

@compute @workgroup_size(64)
fn store(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sim.cells.w {
        return;
    }
    let i = id.z * sim.cells.w + id.x;
    pressure[i] = swept[i] + mean_at(id.z);
}

@compute @workgroup_size(64)
fn store_in_place(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sim.cells.w {
        return;
    }
    pressure[id.z * sim.cells.w + id.x] += mean_at(id.z);
}
