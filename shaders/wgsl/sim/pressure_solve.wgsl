//! use shared/grid
// Stage `pressure_solve`: the direct solver; see the CPU twin for the system that it solves. Five entry points in order: forward_x, forward_y, solve_z,
// inverse_y, inverse_x. Bytes a cell: about 58 (three velocities and the pressure; the half spectrum, 4 bytes a cell, written five times, read
// five times, and its pivots, 2 bytes, read twice).
//
// Transforms work on whole lines in workgroup memory, several lines at once, by Stockham's self-sorting scheme with any factors: before a pass
// with factor r the line holds l-point transforms X[p][k] at p l + k; the pass makes L = l r point transforms,
// X'[p][k] = sum over q of exp(-2 pi i q k / L) X[p + m q][k mod l], m = n / L. A thread makes one number of the output at a time and reads r; twiddles
// come from a table, made in f64. Real rows are transformed two at once, as the parts of one complex line.

@group(0) @binding(3) var<storage, read> u: array<f32>;
@group(0) @binding(4) var<storage, read> v: array<f32>;
@group(0) @binding(5) var<storage, read> w: array<f32>;
// exp(-2 pi i j / n): for x, then for y.
@group(0) @binding(6) var<storage, read> twiddles: array<vec2<f32>>;
// One over the pivots, [z][y][wave number in x].
@group(0) @binding(7) var<storage, read> pivots: array<f32>;
// [z][y][wave number in x].
@group(0) @binding(8) var<storage, read_write> spectrum: array<vec2<f32>>;
@group(0) @binding(9) var<storage, read_write> pressure: array<f32>;
@group(0) @binding(10) var<uniform> transforms: Transforms;

var<workgroup> line_a: array<vec2<f32>, TRANSFORM_LENGTH_MAX>;
var<workgroup> line_b: array<vec2<f32>, TRANSFORM_LENGTH_MAX>;

fn times(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> {
    return vec2<f32>(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
}

fn value(of_a: bool, i: u32) -> vec2<f32> {
    if of_a {
        return line_a[i];
    }
    return line_b[i];
}

// Transforms `lines` lines of `n` in workgroup memory, from line_a. Returns whether the result is in line_a.
// `table` is where the twiddles of this length begin; `along_y` chooses the factors.
fn transform(thread: u32, n: u32, lines: u32, along_y: bool, sign: f32) -> bool {
    let table = select(0u, sim.cells.x, along_y);
    let passes = select(transforms.x.y, transforms.y.y, along_y);
    var in_a = true;
    var l = 1u;
    for (var pass_n = 0u; pass_n < passes; pass_n++) {
        let r = select(transforms.factors_x[pass_n / 4u][pass_n % 4u], transforms.factors_y[pass_n / 4u][pass_n % 4u], along_y);
        let wide = l * r;
        let m = n / wide;
        workgroupBarrier();
        for (var o = thread; o < n * lines; o += TRANSFORM_THREADS) {
            let line = o / n;
            let place = o - line * n;
            let p = place / wide;
            let k = place - p * wide;
            let from_k = k % l;
            let turn = k * m;
            var sum = vec2<f32>(0.0);
            var angle = 0u;
            for (var q = 0u; q < r; q++) {
                var t = twiddles[table + angle];
                t.y *= sign;
                sum += times(value(in_a, line * n + (p + m * q) * l + from_k), t);
                angle += turn;
                angle -= select(0u, n, angle >= n);
            }
            if in_a {
                line_b[o] = sum;
            } else {
                line_a[o] = sum;
            }
        }
        in_a = !in_a;
        l = wide;
    }
    workgroupBarrier();
    return in_a;
}

// `scale * div(rho v)` of a cell.
fn mass_divergence(x: u32, row: u32) -> f32 {
    let y = row % sim.cells.y;
    let z = row / sim.cells.y;
    let i = row * sim.cells.x + x;
    let r = sim.per_cell_size_m;
    let density = profile(PROFILE_DENSITY, z);
    let across = density * ((u[row * sim.cells.x + ahead(x, 1u, sim.cells.x)] - u[i]) * r.x
        + (v[row_of(ahead(y, 1u, sim.cells.y), z) + x] - v[i]) * r.y);
    var up = -profile(PROFILE_FACE_DENSITY, z) * w[i];
    if z + 1u < sim.cells.z {
        up += profile(PROFILE_FACE_DENSITY, z + 1u) * w[i + sim.cells.w];
    }
    return substep.divergence_scale_per_s * (across + up * r.z);
}

@compute @workgroup_size(TRANSFORM_THREADS)
fn forward_x(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let n = sim.cells.x;
    let half = n / 2u + 1u;
    let lines = transforms.x.z;
    let rows = sim.cells.y * sim.cells.z;
    let first = (group.y * transforms.x.w + group.x) * lines;
    for (var o = thread; o < n * lines; o += TRANSFORM_THREADS) {
        let row = 2u * (first + o / n);
        var pair = vec2<f32>(0.0);
        if row < rows {
            pair.x = mass_divergence(o % n, row);
        }
        if row + 1u < rows {
            pair.y = mass_divergence(o % n, row + 1u);
        }
        line_a[o] = pair;
    }
    let in_a = transform(thread, n, lines, false, 1.0);
    for (var o = thread; o < half * lines; o += TRANSFORM_THREADS) {
        let line = o / half;
        let k = o - line * half;
        let row = 2u * (first + line);
        let here = value(in_a, line * n + k);
        let mirror = value(in_a, line * n + (n - k) % n);
        if row < rows {
            spectrum[row * half + k] = 0.5 * vec2<f32>(here.x + mirror.x, here.y - mirror.y);
        }
        if row + 1u < rows {
            spectrum[(row + 1u) * half + k] = 0.5 * vec2<f32>(here.y + mirror.y, mirror.x - here.x);
        }
    }
}

@compute @workgroup_size(TRANSFORM_THREADS)
fn inverse_x(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let n = sim.cells.x;
    let half = n / 2u + 1u;
    let lines = transforms.x.z;
    let rows = sim.cells.y * sim.cells.z;
    let first = (group.y * transforms.x.w + group.x) * lines;
    for (var o = thread; o < n * lines; o += TRANSFORM_THREADS) {
        let row = 2u * (first + o / n);
        let k = o % n;
        let wave = min(k, n - k);
        // The row is real: what is imaginary in its mean and its shortest wave is rounding; other waves appear twice.
        let single = k == 0u || 2u * k == n;
        let flip = select(select(1.0, -1.0, k > wave), 0.0, single);
        var pair = vec2<f32>(0.0);
        if row < rows {
            let a = spectrum[row * half + wave];
            pair += vec2<f32>(a.x, flip * a.y);
        }
        if row + 1u < rows {
            let b = spectrum[(row + 1u) * half + wave];
            pair += vec2<f32>(-flip * b.y, b.x);
        }
        line_a[o] = pair;
    }
    let in_a = transform(thread, n, lines, false, -1.0);
    for (var o = thread; o < n * lines; o += TRANSFORM_THREADS) {
        let row = 2u * (first + o / n);
        let pair = value(in_a, o);
        if row < rows {
            pressure[row * n + o % n] = pair.x;
        }
        if row + 1u < rows {
            pressure[(row + 1u) * n + o % n] = pair.y;
        }
    }
}

fn along_y(group: vec3<u32>, thread: u32, sign: f32) {
    let n = sim.cells.y;
    let half = sim.cells.x / 2u + 1u;
    let lines = transforms.y.z;
    let first = group.x * lines;
    let level = group.y * n * half;
    // Neighbouring threads take neighbouring wave numbers, which lie side by side in memory.
    for (var o = thread; o < n * lines; o += TRANSFORM_THREADS) {
        let k = first + o % lines;
        var number = vec2<f32>(0.0);
        if k < half {
            number = spectrum[level + (o / lines) * half + k];
        }
        line_a[(o % lines) * n + o / lines] = number;
    }
    let in_a = transform(thread, n, lines, true, sign);
    for (var o = thread; o < n * lines; o += TRANSFORM_THREADS) {
        let k = first + o % lines;
        if k < half {
            spectrum[level + (o / lines) * half + k] = value(in_a, (o % lines) * n + o / lines);
        }
    }
}

@compute @workgroup_size(TRANSFORM_THREADS)
fn forward_y(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    along_y(group, thread, 1.0);
}

@compute @workgroup_size(TRANSFORM_THREADS)
fn inverse_y(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    along_y(group, thread, -1.0);
}

// Thomas' algorithm, one wave number a thread.
@compute @workgroup_size(64)
fn solve_z(@builtin(global_invocation_id) id: vec3<u32>) {
    let wide = (sim.cells.x / 2u + 1u) * sim.cells.y;
    if id.x >= wide {
        return;
    }
    let rz = sim.per_cell_size_m.z * sim.per_cell_size_m.z;
    var below = spectrum[id.x] * pivots[id.x];
    spectrum[id.x] = below;
    for (var z = 1u; z < sim.cells.z; z++) {
        let i = z * wide + id.x;
        let couple = profile(PROFILE_FACE_DENSITY, z) * rz;
        below = (spectrum[i] - below * couple) * pivots[i];
        spectrum[i] = below;
    }
    var above = below;
    for (var up = 1u; up < sim.cells.z; up++) {
        let z = sim.cells.z - 1u - up;
        let i = z * wide + id.x;
        let couple = profile(PROFILE_FACE_DENSITY, z + 1u) * rz;
        above = spectrum[i] - above * (couple * pivots[i]);
        spectrum[i] = above;
    }
}
