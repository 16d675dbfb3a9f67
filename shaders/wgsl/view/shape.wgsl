//! use shared/spline
// Stage `shape`: smooth cover and amplitude at points. The twin is cpu/view/shape.rs.
//
// `neighbours` finds the largest extinction of each cell and its 26 neighbours; `points` smooths both fields. A workgroup of
// `points` loads a tile of cells with its rim once; an invocation makes all points of one cell.

@group(0) @binding(0) var<uniform> shape: ShapeGrid;
@group(0) @binding(1) var<storage, read> extinction_per_m: array<f32>;
@group(0) @binding(2) var<storage, read_write> largest_per_m: array<f32>;
@group(0) @binding(3) var<storage, read_write> words: array<u32>;

fn west_east(x: u32) -> vec3<u32> {
    return vec3<u32>((x + shape.cells_x - 1u) % shape.cells_x, x, (x + 1u) % shape.cells_x);
}

fn south_north(y: u32) -> vec3<u32> {
    return vec3<u32>((y + shape.cells_y - 1u) % shape.cells_y, y, (y + 1u) % shape.cells_y);
}

fn below_above(z: u32) -> vec3<u32> {
    return vec3<u32>(max(z, 1u) - 1u, z, min(z + 1u, shape.levels - 1u));
}

@compute @workgroup_size(32, 2, 2)
fn neighbours(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= shape.cells_x || id.y >= shape.cells_y || id.z >= shape.levels) {
        return;
    }
    let xs = west_east(id.x);
    let ys = south_north(id.y);
    let zs = below_above(id.z);
    var most = 0.0;
    for (var c = 0u; c < 3u; c++) {
        for (var b = 0u; b < 3u; b++) {
            let row = (zs[c] * shape.cells_y + ys[b]) * shape.cells_x;
            most = max(most, max(extinction_per_m[row + xs.x], max(extinction_per_m[row + xs.y], extinction_per_m[row + xs.z])));
        }
    }
    largest_per_m[(id.z * shape.cells_y + id.y) * shape.cells_x + id.x] = most;
}

const TILE = vec3<u32>(16u, 4u, 4u);
const RIM = vec3<u32>(18u, 6u, 6u);
var<workgroup> tile: array<vec2<f32>, 648>;

@compute @workgroup_size(16, 4, 4)
fn points(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let cells = vec3<u32>(shape.cells_x, shape.cells_y, shape.levels);
    let corner = group * TILE;
    for (var e = thread; e < 648u; e += 256u) {
        let at = corner + vec3<u32>(e % RIM.x, e / RIM.x % RIM.y, e / (RIM.x * RIM.y));
        let x = (at.x + cells.x - 1u) % cells.x;
        let y = (at.y + cells.y - 1u) % cells.y;
        let z = min(max(at.z, 1u) - 1u, cells.z - 1u);
        let n = (z * cells.y + y) * cells.x + x;
        tile[e] = vec2<f32>(extinction_per_m[n], largest_per_m[n]);
    }
    workgroupBarrier();
    let cell = corner + local;
    if (any(cell >= cells)) {
        return;
    }
    let finer = shape.finer;
    for (var sz = 0u; sz < finer; sz++) {
        let wz = spline(sz, finer);
        // Level smoothed upwards: rows of three columns.
        var rows: array<vec2<f32>, 9>;
        for (var b = 0u; b < 3u; b++) {
            for (var a = 0u; a < 3u; a++) {
                let e = (local.z * RIM.y + local.y + b) * RIM.x + local.x + a;
                let up = RIM.x * RIM.y;
                rows[b * 3u + a] = wz.x * tile[e] + wz.y * tile[e + up] + wz.z * tile[e + 2u * up];
            }
        }
        for (var sy = 0u; sy < finer; sy++) {
            let wy = spline(sy, finer);
            let west = wy.x * rows[0] + wy.y * rows[3] + wy.z * rows[6];
            let middle = wy.x * rows[1] + wy.y * rows[4] + wy.z * rows[7];
            let east = wy.x * rows[2] + wy.y * rows[5] + wy.z * rows[8];
            for (var sx = 0u; sx < finer; sx++) {
                let wx = spline(sx, finer);
                let both = wx.x * west + wx.y * middle + wx.z * east;
                let cover = min(both.x / max(both.y, 1e-12), 1.0);
                let amplitude = min(both.y / shape.amplitude_unit_per_m, 65535.0);
                store(cell * finer + vec3<u32>(sx, sy, sz), (u32(amplitude) << 16u) | u32(cover * 65535.0));
            }
        }
    }
}

/// Writes a point and, at the seams, its copies in the rim: stored column i is point i - 1.
fn store(point: vec3<u32>, word: u32) {
    let copy_x = select(select(point.x + 1u, 0u, point.x + 1u == shape.points_x), shape.points_x + 1u, point.x == 0u);
    let copy_y = select(select(point.y + 1u, 0u, point.y + 1u == shape.points_y), shape.points_y + 1u, point.y == 0u);
    let level = point.z * shape.stride_y;
    let row = (level + point.y + 1u) * shape.stride_x;
    let copied_row = (level + copy_y) * shape.stride_x;
    words[row + point.x + 1u] = word;
    words[row + copy_x] = word;
    words[copied_row + point.x + 1u] = word;
    words[copied_row + copy_x] = word;
    // A single point is the neighbour of itself on both sides.
    if (shape.points_x == 1u) {
        words[row] = word;
        words[copied_row] = word;
    }
    if (shape.points_y == 1u) {
        words[level * shape.stride_x + point.x + 1u] = word;
        words[level * shape.stride_x + copy_x] = word;
        if (shape.points_x == 1u) {
            words[level * shape.stride_x] = word;
        }
    }
}
