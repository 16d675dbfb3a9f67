// Stage `occupancy`: distance to the next cell with cloud, direction by direction. The twin is cpu/view/occupancy.rs.

@group(0) @binding(0) var<uniform> shape: ShapeGrid;
@group(0) @binding(1) var<storage, read> largest_per_m: array<f32>;
// Squared distances along x, then along x and y, m2.
@group(0) @binding(2) var<storage, read_write> along_x: array<f32>;
@group(0) @binding(3) var<storage, read_write> along_xy: array<f32>;
// Four cells a word.
@group(0) @binding(4) var<storage, read_write> words: array<u32>;

const FAR_M = OCCUPANCY_UNIT_M * 255.0;

/// Square of the gap between cells that many apart; a little more, so that only cloud itself is at 0.
fn gap(apart: u32, size_m: f32) -> f32 {
    let free = f32(apart - 1u) * size_m;
    return free * free + 1.0;
}

@compute @workgroup_size(64)
fn nearest_x(@builtin(global_invocation_id) id: vec3<u32>) {
    let nx = shape.cells_x;
    if (id.x >= nx || id.y >= shape.cells_y || id.z >= shape.levels) {
        return;
    }
    let row = (id.z * shape.cells_y + id.y) * nx;
    var least = FAR_M * FAR_M;
    if (largest_per_m[row + id.x] > 0.0) {
        least = 0.0;
    } else {
        let reach = min(u32(FAR_M / shape.cell_size_x_m) + 1u, nx / 2u);
        for (var n = 1u; n <= reach; n++) {
            if (largest_per_m[row + (id.x + n) % nx] > 0.0 || largest_per_m[row + (id.x + nx - n) % nx] > 0.0) {
                least = min(least, gap(n, shape.cell_size_x_m));
                break;
            }
        }
    }
    along_x[row + id.x] = least;
}

@compute @workgroup_size(64)
fn nearest_xy(@builtin(global_invocation_id) id: vec3<u32>) {
    let nx = shape.cells_x;
    let ny = shape.cells_y;
    if (id.x >= nx || id.y >= ny || id.z >= shape.levels) {
        return;
    }
    let level = id.z * ny;
    let own = (level + id.y) * nx + id.x;
    var least = along_x[own];
    let reach = min(u32(FAR_M / shape.cell_size_y_m) + 1u, ny / 2u);
    for (var n = 1u; n <= reach; n++) {
        let add = gap(n, shape.cell_size_y_m);
        if (add >= least) {
            break;
        }
        let north = (level + (id.y + n) % ny) * nx + id.x;
        let south = (level + (id.y + ny - n) % ny) * nx + id.x;
        least = min(least, min(along_x[north], along_x[south]) + add);
    }
    along_xy[own] = least;
}

fn nearest(cell: u32) -> u32 {
    let plane = shape.cells_x * shape.cells_y;
    let level = cell / plane;
    var least = along_xy[cell];
    if (least == 0.0) {
        return 0u;
    }
    let reach = min(u32(FAR_M / shape.cell_size_z_m) + 1u, shape.levels);
    for (var n = 1u; n <= reach; n++) {
        let add = gap(n, shape.cell_size_z_m);
        if (add >= least) {
            break;
        }
        if (level >= n) {
            least = min(least, along_xy[cell - n * plane] + add);
        }
        if (level + n < shape.levels) {
            least = min(least, along_xy[cell + n * plane] + add);
        }
    }
    return u32(clamp(sqrt(least) / OCCUPANCY_UNIT_M, 1.0, 255.0));
}

@compute @workgroup_size(64)
fn nearest_xyz(@builtin(global_invocation_id) id: vec3<u32>) {
    let cells = shape.cells_x * shape.cells_y * shape.levels;
    let word = id.y * shape.occupancy_row + id.x;
    if (id.x >= shape.occupancy_row || word * 4u >= cells) {
        return;
    }
    var packed = 0u;
    for (var b = 0u; b < 4u; b++) {
        let cell = word * 4u + b;
        if (cell < cells) {
            packed |= nearest(cell) << (8u * b);
        }
    }
    words[word] = packed;
}
