//! use shared/grid
// Stage `pressure_solve`: the direct solver; see the CPU twin for the system that it solves. Five entry points in order: forward_x, forward_y, solve_z,
// inverse_y, inverse_x. Bytes a cell: about 58 (three velocities and the pressure; the half spectrum, 4 bytes a cell, written five times, read
// five times, and its pivots, 2 bytes, read twice).
//
// Transforms work on whole lines in workgroup memory, several lines at once, by Stockham's self-sorting scheme with any factors: before a pass
// with factor r the line holds l-point transforms X[p][k] at p l + k; the pass makes L = l r point transforms,
// X'[p][k + l s] = sum over q of exp(-2 pi i q (k / L + s / r)) X[p + m q][k], m = n / L. A thread makes one such butterfly at a time, for fours and twos
// written out; twiddles come from a table, made in f64. Real rows are transformed two at once, as the parts of one complex line.

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

// The lines before and after a pass, one half each.
var<workgroup> lines_held: array<vec2<f32>, 2 * TRANSFORM_LENGTH_MAX>;

fn times(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> {
    return vec2<f32>(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
}

// exp(sign 2 pi i angle / n), of the table that begins at `table`.
fn twiddle(table: u32, angle: u32, sign: f32) -> vec2<f32> {
    let t = twiddles[table + angle];
    return vec2<f32>(t.x, sign * t.y);
}

// Transforms `lines` lines of `n` that lie in the first half; says where the result begins.
// `table` is where the twiddles of this length begin; `along_y` chooses the factors; `sign` is 1 forward and -1 back.
fn transform(thread: u32, n: u32, lines: u32, along_y: bool, sign: f32) -> u32 {
    let table = select(0u, sim.cells.x, along_y);
    let passes = select(transforms.x.y, transforms.y.y, along_y);
    var source = 0u;
    var l = 1u;
    for (var number = 0u; number < passes; number++) {
        let r = select(transforms.factors_x[number / 4u][number % 4u], transforms.factors_y[number / 4u][number % 4u], along_y);
        // Numbers of a line that a butterfly takes lie `apart`; its results lie l apart.
        let apart = n / r;
        let turn = apart / l;
        let result = TRANSFORM_LENGTH_MAX - source;
        workgroupBarrier();
        for (var b = thread; b < apart * lines; b += TRANSFORM_THREADS) {
            let line = b / apart;
            let j = b - line * apart;
            let p = j / l;
            let k = j - p * l;
            let at = source + line * n + j;
            let to = result + line * n + p * l * r + k;
            if r == 4u {
                let angle = k * turn;
                let x0 = lines_held[at];
                let x1 = times(lines_held[at + apart], twiddle(table, angle, sign));
                let x2 = times(lines_held[at + 2u * apart], twiddle(table, 2u * angle, sign));
                let x3 = times(lines_held[at + 3u * apart], twiddle(table, 3u * angle, sign));
                let even = x0 + x2;
                let odd = x1 + x3;
                let across = x0 - x2;
                let turned = sign * vec2<f32>(x1.y - x3.y, x3.x - x1.x);
                lines_held[to] = even + odd;
                lines_held[to + l] = across + turned;
                lines_held[to + 2u * l] = even - odd;
                lines_held[to + 3u * l] = across - turned;
            } else if r == 2u {
                let x0 = lines_held[at];
                let x1 = times(lines_held[at + apart], twiddle(table, k * turn, sign));
                lines_held[to] = x0 + x1;
                lines_held[to + l] = x0 - x1;
            } else {
                for (var s = 0u; s < r; s++) {
                    // The angle of input q: q (k turn + s n / r), a whole turn being n.
                    let step_angle = (k * turn + s * apart) % n;
                    var sum = vec2<f32>(0.0);
                    var angle = 0u;
                    for (var q = 0u; q < r; q++) {
                        sum += times(lines_held[at + q * apart], twiddle(table, angle, sign));
                        angle += step_angle;
                        angle -= select(0u, n, angle >= n);
                    }
                    lines_held[to + s * l] = sum;
                }
            }
        }
        source = result;
        l *= r;
    }
    workgroupBarrier();
    return source;
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
        lines_held[o] = pair;
    }
    let done = transform(thread, n, lines, false, 1.0);
    for (var o = thread; o < half * lines; o += TRANSFORM_THREADS) {
        let line = o / half;
        let k = o - line * half;
        let row = 2u * (first + line);
        let here = lines_held[done + line * n + k];
        let mirror = lines_held[done + line * n + (n - k) % n];
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
        lines_held[o] = pair;
    }
    let done = transform(thread, n, lines, false, -1.0);
    for (var o = thread; o < n * lines; o += TRANSFORM_THREADS) {
        let row = 2u * (first + o / n);
        let pair = lines_held[done + o];
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
        lines_held[(o % lines) * n + o / lines] = number;
    }
    let done = transform(thread, n, lines, true, sign);
    for (var o = thread; o < n * lines; o += TRANSFORM_THREADS) {
        let k = first + o % lines;
        if k < half {
            spectrum[level + (o / lines) * half + k] = lines_held[done + (o % lines) * n + o / lines];
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
