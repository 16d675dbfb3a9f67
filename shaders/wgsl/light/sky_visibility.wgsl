// Stage `sky_visibility`: light of sky and ground inside clouds. The twin is cpu/light/sky_visibility.rs.
//
// `straight` starts both fields with the vertical direction. `slanted` then carries optical depth level by level in the
// two directions along one axis, which leave each line of cells to itself: a workgroup takes a tile of whole lines, keeps
// their depth in workgroup memory and walks through the levels. It runs for x, then for y, and adds; the last run divides.
// Each invocation alone writes its cells, so nothing races.

@group(0) @binding(0) var<uniform> sweep: VisibilitySweep;
@group(0) @binding(1) var<storage, read> extinction_per_m: array<f32>;
@group(0) @binding(2) var<storage, read_write> above: array<f32>;
@group(0) @binding(3) var<storage, read_write> below: array<f32>;

fn passed(before: f32, own: f32) -> f32 {
    return 1.0 / (1.0 + DIFFUSE_VISIBILITY * (before + 0.5 * own));
}

@compute @workgroup_size(64)
fn straight(@builtin(global_invocation_id) id: vec3<u32>) {
    let plane = sweep.cells_x * sweep.cells_y;
    if (id.x >= plane) {
        return;
    }
    var before = 0.0;
    if (id.y == 0u) {
        for (var level = sweep.levels; level > 0u; level--) {
            let at = (level - 1u) * plane + id.x;
            let own = extinction_per_m[at] * sweep.path_m;
            above[at] = passed(before, own);
            before += own;
        }
    } else {
        for (var level = 0u; level < sweep.levels; level++) {
            let at = level * plane + id.x;
            let own = extinction_per_m[at] * sweep.path_m;
            below[at] = passed(before, own);
            before += own;
        }
    }
}

const THREADS = 256u;
// Depth of the level before and of this one, towards either side: 16 KiB.
var<workgroup> depth: array<f32, 4u * VISIBILITY_TILE>;

@compute @workgroup_size(256)
fn slanted(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let plane = sweep.cells_x * sweep.cells_y;
    let along_x = sweep.axis == 0u;
    let n = select(sweep.cells_y, sweep.cells_x, along_x);
    let lines_in_all = select(sweep.cells_x, sweep.cells_y, along_x);
    let lines = sweep.lines_per_tile;
    let tile = lines * n;
    let from_above = group.y == 0u;
    let near = i32(floor(sweep.reach));
    let fraction = sweep.reach - floor(sweep.reach);
    for (var e = thread; e < 2u * VISIBILITY_TILE; e += THREADS) {
        depth[e] = 0.0;
    }
    workgroupBarrier();
    var old = 0u;
    for (var step = 0u; step < sweep.levels; step++) {
        let level = select(step, sweep.levels - 1u - step, from_above);
        let fresh = 2u * VISIBILITY_TILE - old;
        for (var e = thread; e < tile; e += THREADS) {
            // Neighbouring invocations take neighbours in x either way.
            let along = select(e / lines, e % n, along_x);
            let line = select(e % lines, e / n, along_x);
            let whole_line = group.x * lines + line;
            if (whole_line < lines_in_all) {
                let cell = level * plane + select(along * sweep.cells_x + whole_line, whole_line * n + along, along_x);
                let own = extinction_per_m[cell] * sweep.path_m;
                var seen = 0.0;
                for (var side = 0u; side < 2u; side++) {
                    let way = 1 - 2 * i32(side);
                    let size = i32(n);
                    let first = u32(((i32(along) + near * way) % size + size) % size);
                    let second = u32(((i32(along) + (near + 1) * way) % size + size) % size);
                    let base = old + side * VISIBILITY_TILE;
                    let before = depth[base + select(first * lines + line, line * n + first, along_x)] * (1.0 - fraction)
                        + depth[base + select(second * lines + line, line * n + second, along_x)] * fraction;
                    depth[fresh + side * VISIBILITY_TILE + e] = before + own;
                    seen += passed(before, own);
                }
                if (from_above) {
                    above[cell] = (above[cell] + seen) * sweep.scale;
                } else {
                    below[cell] = (below[cell] + seen) * sweep.scale;
                }
            }
        }
        workgroupBarrier();
        old = fresh;
    }
}
