//! use shared/advect
// Stage `advect_momentum`; see the CPU twin for what it computes. One entry point a component, so that eight storage buffers suffice; bytes a cell:
// 24 for u and v each, 28 for w where neighbours come from cache.
// A thread climbs LEVELS_PER_THREAD levels of its column, as in `advect_scalar`.

@group(0) @binding(3) var<storage, read> u: array<f32>;
@group(0) @binding(4) var<storage, read> v: array<f32>;
@group(0) @binding(5) var<storage, read> w: array<f32>;
@group(0) @binding(6) var<storage, read> start: array<f32>;
@group(0) @binding(7) var<storage, read> slow: array<f32>;
@group(0) @binding(8) var<storage, read> buoyancy: array<f32>;
@group(0) @binding(9) var<storage, read_write> next: array<f32>;

// Which velocity is carried. Always a constant where it is passed, so that the choice is made when the shader is compiled.
const X = 0u;
const Y = 1u;
const Z = 2u;

fn carried(which: u32, i: u32) -> f32 {
    switch which {
        case X: { return u[i]; }
        case Y: { return v[i]; }
        default: { return w[i]; }
    }
}

// The carried velocity of a column at level z; w is 0 at the lid and above it.
fn level(which: u32, column: u32, z: i32) -> f32 {
    let levels = i32(sim.cells.z);
    if which == Z && z >= levels {
        return 0.0;
    }
    return carried(which, u32(clamp(z, 0, levels - 1)) * sim.cells.w + column);
}

// Weights of the levels below and at z for a horizontal velocity at the lower face: half the densities over the face's.
fn face_weights(z: u32) -> vec2<f32> {
    let half = 0.5 / profile(PROFILE_FACE_DENSITY, z);
    return vec2<f32>(half * profile(PROFILE_DENSITY, z - 1u), half * profile(PROFILE_DENSITY, z));
}

// Speed through the west side of the control volume whose centre is the velocity at (x, y, z); `west` is x - 1.
fn speed_west(which: u32, x: u32, west: u32, y: u32, z: u32) -> f32 {
    let here = row_of(y, z);
    switch which {
        case X: { return 0.5 * (u[here + west] + u[here + x]); }
        case Y: { return 0.5 * u[row_of(back(y, 1u, sim.cells.y), z) + x] + 0.5 * u[here + x]; }
        default: {
            let weights = face_weights(z);
            return weights.x * u[here - sim.cells.w + x] + weights.y * u[here + x];
        }
    }
}

// As `speed_west`, through the south side.
fn speed_south(which: u32, x: u32, west: u32, y: u32, z: u32) -> f32 {
    let here = row_of(y, z);
    switch which {
        case X: { return 0.5 * (v[here + west] + v[here + x]); }
        case Y: { return 0.5 * v[row_of(back(y, 1u, sim.cells.y), z) + x] + 0.5 * v[here + x]; }
        default: {
            let weights = face_weights(z);
            return weights.x * v[here - sim.cells.w + x] + weights.y * v[here + x];
        }
    }
}

// Mass flux through the lower side; z may be the lid's.
fn mass_below(which: u32, x: u32, west: u32, y: u32, z: u32) -> f32 {
    let half = 0.5 * profile(PROFILE_FACE_DENSITY, z);
    switch which {
        case X: {
            let here = row_of(y, z);
            return half * (w[here + west] + w[here + x]);
        }
        case Y: {
            return half * w[row_of(back(y, 1u, sim.cells.y), z) + x] + half * w[row_of(y, z) + x];
        }
        default: {
            let i = row_of(y, z - 1u) + x;
            var mass = 0.5 * profile(PROFILE_FACE_DENSITY, z - 1u) * w[i];
            if z < sim.cells.z {
                mass += half * w[i + sim.cells.w];
            }
            return mass;
        }
    }
}

fn flux_below(which: u32, q: array<f32, 6>, x: u32, west: u32, y: u32, z: u32) -> f32 {
    let top = select(sim.cells.z - 1u, sim.cells.z, which == Z);
    if z == 0u || z > top {
        return 0.0;
    }
    let speed = mass_below(which, x, west, y, z);
    switch order_at(z, top) {
        case 5u: { return upwind5(q, speed); }
        case 3u: { return upwind3(q, speed); }
        default: { return speed * 0.5 * (q[2] + q[3]); }
    }
}

fn carry(which: u32, id: vec3<u32>) {
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
    let y_north = ahead(y, 1u, ny);
    var first = id.z * LEVELS_PER_THREAD;
    let last = min(first + LEVELS_PER_THREAD, sim.cells.z);
    if which == Z && first == 0u {
        // w at the ground stays 0.
        next[column] = 0.0;
        first = 1u;
    }
    let z0 = i32(first);
    var q = array<f32, 6>(
        level(which, column, z0 - 3), level(which, column, z0 - 2), level(which, column, z0 - 1),
        level(which, column, z0), level(which, column, z0 + 1), level(which, column, z0 + 2));
    var below = flux_below(which, q, x, west1, y, first);
    for (var z = first; z < last; z++) {
        let here = row_of(y, z);
        let i = here + x;
        let qx = array<f32, 7>(
            carried(which, here + west3), carried(which, here + west2), carried(which, here + west1), carried(which, i),
            carried(which, here + east1), carried(which, here + east2), carried(which, here + east3));
        let west = upwind5(array<f32, 6>(qx[0], qx[1], qx[2], qx[3], qx[4], qx[5]), speed_west(which, x, west1, y, z));
        let east = upwind5(array<f32, 6>(qx[1], qx[2], qx[3], qx[4], qx[5], qx[6]), speed_west(which, east1, x, y, z));
        let qy = array<f32, 7>(
            carried(which, row_of(back(y, 3u, ny), z) + x), carried(which, row_of(back(y, 2u, ny), z) + x),
            carried(which, row_of(back(y, 1u, ny), z) + x), carried(which, i), carried(which, row_of(y_north, z) + x),
            carried(which, row_of(ahead(y, 2u, ny), z) + x), carried(which, row_of(ahead(y, 3u, ny), z) + x));
        let south = upwind5(array<f32, 6>(qy[0], qy[1], qy[2], qy[3], qy[4], qy[5]), speed_south(which, x, west1, y, z));
        let north = upwind5(array<f32, 6>(qy[1], qy[2], qy[3], qy[4], qy[5], qy[6]),
            speed_south(which, x, west1, y_north, z));
        q = array<f32, 6>(q[1], q[2], q[3], q[4], q[5], level(which, column, i32(z) + 3));
        let above = flux_below(which, q, x, west1, y, z + 1u);
        let density = profile(select(PROFILE_DENSITY, PROFILE_FACE_DENSITY, which == Z), z);
        let r = sim.per_cell_size_m;
        let divergence = (east - west) * r.x + (north - south) * r.y + (above - below) * (r.z / density);
        var held = 0.0;
        if (sim.holds & HOLDS_SLOW) != 0u {
            held = slow[i];
        }
        var carried_on = start[i] + substep.stage_s * (held - divergence);
        if which == Z && (sim.holds & HOLDS_BUOYANCY) != 0u {
            carried_on += substep.stage_s * 0.5 * (buoyancy[i - sim.cells.w] + buoyancy[i]);
        }
        next[i] = carried_on;
        below = above;
    }
}

@compute @workgroup_size(64)
fn velocity_x(@builtin(global_invocation_id) id: vec3<u32>) {
    carry(X, id);
}

@compute @workgroup_size(64)
fn velocity_y(@builtin(global_invocation_id) id: vec3<u32>) {
    carry(Y, id);
}

@compute @workgroup_size(64)
fn velocity_z(@builtin(global_invocation_id) id: vec3<u32>) {
    carry(Z, id);
}
