//! use shared/light_words
//! use shared/octaves
// Stage `octave_balance`: octaves bring what clouds have left of the sun's beam. The twin is cpu/light/octave_balance.rs.
//
// `sums` takes a column of cells an invocation. Four kernels then give what columns have left to the octaves around them, by two sums along x and two along y.

@group(0) @binding(0) var<uniform> shape: ShapeGrid;
@group(0) @binding(1) var<uniform> balance: OctaveBalancing;
@group(0) @binding(2) var<uniform> phase: MarchPhase;
@group(0) @binding(3) var<storage, read> shape_words: array<u32>;
@group(0) @binding(4) var<storage, read> occupancy_words: array<u32>;
@group(0) @binding(5) var<storage, read> light_words: array<u32>;
// A number a column each: what is left, what octaves bring, sums along one axis.
@group(0) @binding(6) var<storage, read_write> columns: array<f32>;
// The factors go behind the shadow map and its share, with one more column on each side.
@group(0) @binding(7) var<storage, read_write> shadow: array<f32>;

const LOG2_E = 1.44269504088896;
const TURN = 6.283185307179586;

fn mean_extinction(p: vec3<f32>) -> f32 {
    let s = shape_sample(p);
    return s.y * select(s.x, smooth_ramp((s.x - CARVE_EDGE) / CARVE_MEAN_RAMP), balance.carved != 0u);
}

/// Optical depth along a direction to where no cloud is near.
fn way_out(p: vec3<f32>, along: vec3<f32>) -> f32 {
    let least = min(min(shape.cell_size_x_m, shape.cell_size_y_m), shape.cell_size_z_m) * BALANCE_STEP_OF_CELL;
    var depth = 0.0;
    var t = 0.0;
    for (var n = 0u; n < BALANCE_STEPS; n++) {
        let step = least + t * BALANCE_STEP_GROWTH;
        let q = p + along * (t + 0.5 * step);
        if (empty_distance_m(q) > 0.0 || depth > BALANCE_DARK) {
            break;
        }
        depth += mean_extinction(q) * step;
        t += step;
    }
    return depth;
}

/// What the first scattering leaves in its cloud of what is taken from the beam at a place of a cell, and what octaves bring from there out of the cloud, 1/m.
fn left_and_brought(cell: vec3<u32>) -> vec2<f32> {
    let size = vec3<f32>(shape.cell_size_x_m, shape.cell_size_y_m, shape.cell_size_z_m);
    let spread = vec3<u32>(BALANCE_SPREAD_X, BALANCE_SPREAD_Y, BALANCE_SPREAD_Z);
    let x = cell * spread;
    let y = cell * spread.yzx;
    let z = cell * spread.zxy;
    let mixed = vec3<u32>(x.x + x.y + x.z, y.x + y.y + y.z, z.x + z.y + z.z);
    let within = vec3<f32>(mixed >> vec3<u32>(8u)) / 16777216.0;
    let p = (vec3<f32>(cell) + within) * size + vec3<f32>(0.0, 0.0, shape.bottom_m);
    if (empty_distance_m(p) > 0.0) {
        return vec2<f32>(0.0);
    }
    let here = mean_extinction(p);
    if (here <= 0.0) {
        return vec2<f32>(0.0);
    }
    let around_p = light_around(p);
    let depth = beam_depth(around_p);

    // Two unit vectors across the beam (Duff et al. 2017; the beam never comes from below).
    let sun = balance.beam.xyz;
    let a = -1.0 / (1.0 + sun.z);
    let b = sun.x * sun.y * a;
    let first = vec3<f32>(1.0 + sun.x * sun.x * a, b, -sun.x);
    let second = vec3<f32>(b, 1.0 + sun.y * sun.y * a, -sun.y);
    let slowest = exp2(depth * -LOG2_E / f32(1u << balance.octaves));
    var once = 0.0;
    var more = 0.0;
    for (var n = 0u; n < BALANCE_RINGS; n++) {
        let ring = balance.rings[n];
        let turned = ((mixed.y << 16u) | (mixed.y >> 16u)) + BALANCE_SPREAD_RING * n;
        let turn = f32((turned >> 26u) % BALANCE_TURNS) * (TURN / f32(BALANCE_TURNS));
        // Towards where the light goes.
        let along = -((first * cos(turn) + second * sin(turn)) * ring.y + sun * ring.x);
        let out = exp(-way_out(p, along));
        var passed = slowest;
        var scattered = 0.0;
        for (var octave = balance.octaves; octave > 0u; octave--) {
            scattered += phase_of_octave(octave, ring.x) * passed;
            passed *= passed;
        }
        once += out * ring.w;
        more += out * scattered * ring.z;
    }
    let sky = sky_share(around_p);
    let left = here * exp2(depth * -LOG2_E) * max(1.0 - once, 0.0);
    return vec2<f32>(left, here * more * level_share(sun.z, depth, sky, passage_of(sky, ground_share(around_p))));
}

@compute @workgroup_size(8, 8)
fn sums(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= shape.cells_x || id.y >= shape.cells_y) {
        return;
    }
    var sum = vec2<f32>(BALANCE_TRACE);
    for (var level = 0u; level < shape.levels; level++) {
        sum += left_and_brought(vec3<u32>(id.xy, level));
    }
    let plane = shape.cells_x * shape.cells_y;
    let at = id.y * shape.cells_x + id.x;
    columns[at] = sum.x;
    columns[plane + at] = sum.y;
}

/// Sum of what columns have around `at` along one axis, of `n` columns that lie `apart`, by their weights; periodic.
fn around(from_at: u32, at: u32, n: u32, apart: u32, size_m: f32) -> f32 {
    let own = at / apart % n;
    let first = from_at + at - own * apart;
    let reached = min(u32(BALANCE_REACH_M / size_m), (n - 1u) / 2u);
    var sum = columns[from_at + at];
    for (var d = 1u; d <= reached; d++) {
        let share = f32(d) * size_m / BALANCE_REACH_M;
        sum += (1.0 - share * share) * (columns[first + (own + n - d) % n * apart] + columns[first + (own + d) % n * apart]);
    }
    return sum;
}

fn along_x(from_at: u32, at: u32) -> f32 {
    return around(from_at, at, shape.cells_x, 1u, shape.cell_size_x_m);
}

fn along_y(from_at: u32, at: u32) -> f32 {
    return around(from_at, at, shape.cells_y, shape.cells_x, shape.cell_size_y_m);
}

@compute @workgroup_size(64)
fn brought_along_x(@builtin(global_invocation_id) id: vec3<u32>) {
    let plane = shape.cells_x * shape.cells_y;
    if (id.x < plane) {
        columns[2u * plane + id.x] = along_x(plane, id.x);
    }
}

/// What a column has left, over what octaves bring around it.
@compute @workgroup_size(64)
fn left_over_brought(@builtin(global_invocation_id) id: vec3<u32>) {
    let plane = shape.cells_x * shape.cells_y;
    if (id.x < plane) {
        columns[id.x] /= along_y(2u * plane, id.x);
    }
}

@compute @workgroup_size(64)
fn shares_along_x(@builtin(global_invocation_id) id: vec3<u32>) {
    let plane = shape.cells_x * shape.cells_y;
    if (id.x < plane) {
        columns[2u * plane + id.x] = along_x(0u, id.x);
    }
}

@compute @workgroup_size(8, 8)
fn factors(@builtin(global_invocation_id) id: vec3<u32>) {
    let row = shape.cells_x + 2u;
    if (id.x >= row || id.y >= shape.cells_y + 2u) {
        return;
    }
    let column = vec2<u32>((id.x + shape.cells_x - 1u) % shape.cells_x, (id.y + shape.cells_y - 1u) % shape.cells_y);
    let plane = shape.cells_x * shape.cells_y;
    let factor = along_y(2u * plane, column.y * shape.cells_x + column.x);
    shadow[shape.stride_x * shape.stride_y + 1u + id.y * row + id.x] = clamp(factor, 0.0, BALANCE_MOST);
}
