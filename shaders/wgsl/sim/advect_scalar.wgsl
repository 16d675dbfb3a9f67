//! use shared/advect
// Stage `advect_scalar`; see the CPU twin for what it computes. Bytes a cell: 28 where neighbours come from cache.
// A thread climbs LEVELS_PER_THREAD levels of its column: the flux through a cell's top is its upper neighbour's through the bottom, and the
// values along z stay in registers.

@group(0) @binding(3) var<storage, read> u: array<f32>;
@group(0) @binding(4) var<storage, read> v: array<f32>;
@group(0) @binding(5) var<storage, read> w: array<f32>;
@group(0) @binding(6) var<storage, read> state: array<f32>;
@group(0) @binding(7) var<storage, read> start: array<f32>;
@group(0) @binding(8) var<storage, read> slow: array<f32>;
@group(0) @binding(9) var<storage, read_write> next: array<f32>;

fn level(column: u32, z: i32) -> f32 {
    return state[u32(clamp(z, 0, i32(sim.cells.z) - 1)) * sim.cells.w + column];
}

fn flux_below(q: array<f32, 6>, column: u32, z: u32) -> f32 {
    if z == 0u || z >= sim.cells.z {
        return 0.0;
    }
    let speed = profile(PROFILE_FACE_DENSITY, z) * w[z * sim.cells.w + column];
    switch order_at(z, sim.cells.z - 1u) {
        case 5u: { return weno5(q, speed); }
        case 3u: { return upwind3(q, speed); }
        default: { return speed * select(q[3], q[2], speed >= 0.0); }
    }
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sim.cells.w {
        return;
    }
    let nx = sim.cells.x;
    let ny = sim.cells.y;
    let column = id.x;
    let x = column % nx;
    let y = column / nx;
    let west3 = back(x, 3u, nx);
    let west2 = back(x, 2u, nx);
    let west1 = back(x, 1u, nx);
    let east1 = ahead(x, 1u, nx);
    let east2 = ahead(x, 2u, nx);
    let east3 = ahead(x, 3u, nx);
    let first = id.z * LEVELS_PER_THREAD;
    let last = min(first + LEVELS_PER_THREAD, sim.cells.z);
    let z0 = i32(first);
    var q = array<f32, 6>(
        level(column, z0 - 3), level(column, z0 - 2), level(column, z0 - 1),
        level(column, z0), level(column, z0 + 1), level(column, z0 + 2));
    var below = flux_below(q, column, first);
    for (var z = first; z < last; z++) {
        let here = row_of(y, z);
        let i = here + x;
        let qx = array<f32, 7>(
            state[here + west3], state[here + west2], state[here + west1], state[i],
            state[here + east1], state[here + east2], state[here + east3]);
        let west = weno5(array<f32, 6>(qx[0], qx[1], qx[2], qx[3], qx[4], qx[5]), u[i]);
        let east = weno5(array<f32, 6>(qx[1], qx[2], qx[3], qx[4], qx[5], qx[6]), u[here + east1]);
        let north_row = row_of(ahead(y, 1u, ny), z);
        let qy = array<f32, 7>(
            state[row_of(back(y, 3u, ny), z) + x], state[row_of(back(y, 2u, ny), z) + x],
            state[row_of(back(y, 1u, ny), z) + x], state[i], state[north_row + x],
            state[row_of(ahead(y, 2u, ny), z) + x], state[row_of(ahead(y, 3u, ny), z) + x]);
        let south = weno5(array<f32, 6>(qy[0], qy[1], qy[2], qy[3], qy[4], qy[5]), v[i]);
        let north = weno5(array<f32, 6>(qy[1], qy[2], qy[3], qy[4], qy[5], qy[6]), v[north_row + x]);
        q = array<f32, 6>(q[1], q[2], q[3], q[4], q[5], level(column, i32(z) + 3));
        let above = flux_below(q, column, z + 1u);
        let r = sim.per_cell_size_m;
        let divergence = (east - west) * r.x + (north - south) * r.y
            + (above - below) * (r.z / profile(PROFILE_DENSITY, z));
        var held = 0.0;
        if (sim.holds & HOLDS_SLOW) != 0u {
            held = slow[i];
        }
        next[i] = start[i] + substep.stage_s * (held - divergence);
        below = above;
    }
}
