//! use shared/grid
// Stage `pressure_red_black_sor`; see the CPU twin for what it computes and `pressure_source` for what comes before and after the sweeps. Bytes a cell: 24 a
// sweep (pressure read by the other colour, read and written; source; scratch written and read).
// A thread solves a column by Thomas' algorithm; the threads of a workgroup take every second column of rows, so that they read together. Where an extent
// is odd its last column or row has a neighbour of its own colour across the seam and is relaxed after both colours, in the order of the CPU twin.

@group(0) @binding(3) var<storage, read> source: array<f32>;
@group(0) @binding(4) var<storage, read_write> pressure: array<f32>;
// [z][the thread's number].
@group(0) @binding(5) var<storage, read_write> scratch: array<f32>;

fn solve(x: u32, y: u32, number: u32) {
    let nx = sim.cells.x;
    let levels = sim.cells.z;
    let west = row_of(y, 0u) + back(x, 1u, nx);
    let east = row_of(y, 0u) + ahead(x, 1u, nx);
    let south = row_of(back(y, 1u, sim.cells.y), 0u) + x;
    let north = row_of(ahead(y, 1u, sim.cells.y), 0u) + x;
    let here = row_of(y, 0u) + x;
    let h = sim.columns;
    var done = 0.0;
    for (var z = 0u; z < levels; z++) {
        let level = z * sim.cells.w;
        let pull = h.x * (pressure[level + west] + pressure[level + east]) + h.y * (pressure[level + south] + pressure[level + north]);
        // Nothing comes from below the ground: the weight is 0 there.
        done = (profile(PROFILE_DENSITY, z) * pull - source[level + here] + profile(PROFILE_COLUMN_BELOW, z) * done)
            * profile(PROFILE_COLUMN_PIVOT, z);
        scratch[level + number] = done;
    }
    for (var up = 1u; up <= levels; up++) {
        let z = levels - up;
        let level = z * sim.cells.w;
        if up > 1u {
            done = scratch[level + number] + profile(PROFILE_COLUMN_ABOVE, z) * profile(PROFILE_COLUMN_PIVOT, z) * done;
        }
        let was = pressure[level + here];
        pressure[level + here] = was + h.z * (done - was);
    }
}

// Extents without the last column or row of an odd one.
fn pairs() -> vec2<u32> {
    return sim.cells.xy / 2u;
}

// A colour: columns of even x in rows of even y and of odd x in rows of odd y, or the others.
fn colour(number: u32, odd: u32) {
    let half = pairs();
    if number >= half.x * 2u * half.y {
        return;
    }
    let y = number / half.x;
    solve(2u * (number % half.x) + ((y + odd) & 1u), y, number);
}

@compute @workgroup_size(64)
fn red(@builtin(global_invocation_id) id: vec3<u32>) {
    colour(id.x, 0u);
}

@compute @workgroup_size(64)
fn black(@builtin(global_invocation_id) id: vec3<u32>) {
    colour(id.x, 1u);
}

// The last column of an odd extent: of every second row.
fn last_column(number: u32, odd: u32) {
    if number < pairs().y {
        solve(sim.cells.x - 1u, 2u * number + odd, number);
    }
}

@compute @workgroup_size(64)
fn last_column_even(@builtin(global_invocation_id) id: vec3<u32>) {
    last_column(id.x, 0u);
}

@compute @workgroup_size(64)
fn last_column_odd(@builtin(global_invocation_id) id: vec3<u32>) {
    last_column(id.x, 1u);
}

// The last row of an odd extent: every second column.
fn last_row(number: u32, odd: u32) {
    if number < pairs().x {
        solve(2u * number + odd, sim.cells.y - 1u, number);
    }
}

@compute @workgroup_size(64)
fn last_row_even(@builtin(global_invocation_id) id: vec3<u32>) {
    last_row(id.x, 0u);
}

@compute @workgroup_size(64)
fn last_row_odd(@builtin(global_invocation_id) id: vec3<u32>) {
    last_row(id.x, 1u);
}

// Where both extents are odd.
@compute @workgroup_size(1)
fn corner() {
    solve(sim.cells.x - 1u, sim.cells.y - 1u, 0u);
}
