//! use shared/grid
// Places between values; see `semi_lagrangian` of the CPU device. Values are read from storage buffers and weighed here, not by a texture unit,
// which knows only 256 fractions of a cell.

// The eight values around a place, x fastest and z slowest: where they lie, whether the lower and the upper four are there (1) or hold 0, and the
// place's fractions of a cell.
struct Corners {
    low: vec4<u32>,
    high: vec4<u32>,
    there: vec2<f32>,
    t: vec3<f32>,
}

// A whole number on the periodic axis of `n` places.
fn wrapped(whole: i32, n: u32) -> u32 {
    let rest = whole % i32(n);
    return u32(select(rest, rest + i32(n), rest < 0));
}

// `value` not below `low` and not above `high`. NaN stays, where `clamp` may give a bound: what is spoilt must be noticed.
fn bounded(value: f32, low: f32, high: f32) -> f32 {
    let raised = select(value, low, value < low);
    return select(raised, high, raised > high);
}

// The corners around the place that is `displacement` cells back from (x, y, z). `top` is the lattice's last level, stored or not: a place beyond it
// or below the first is moved onto it.
fn around(x: u32, y: u32, z: u32, displacement: vec3<f32>, top: u32) -> Corners {
    let height = f32(z);
    let back_by = vec3<f32>(displacement.xy, bounded(displacement.z, height - f32(top), height));
    let below = floor(-back_by);
    let whole = vec3<i32>(below);
    let x0 = wrapped(i32(x) + whole.x, sim.cells.x);
    let x1 = select(0u, x0 + 1u, x0 + 1u < sim.cells.x);
    let y0 = wrapped(i32(y) + whole.y, sim.cells.y);
    let y1 = select(0u, y0 + 1u, y0 + 1u < sim.cells.y);
    let z0 = u32(clamp(i32(z) + whole.z, 0, i32(top)));
    let z1 = min(z0 + 1u, top);
    // A level above the stored ones holds 0: any index serves.
    let last = sim.cells.z - 1u;
    let south0 = row_of(y0, min(z0, last));
    let north0 = row_of(y1, min(z0, last));
    let south1 = row_of(y0, min(z1, last));
    let north1 = row_of(y1, min(z1, last));
    return Corners(
        vec4<u32>(south0 + x0, south0 + x1, north0 + x0, north0 + x1),
        vec4<u32>(south1 + x0, south1 + x1, north1 + x0, north1 + x1),
        vec2<f32>(select(0.0, 1.0, z0 <= last), select(0.0, 1.0, z1 <= last)),
        -back_by - below,
    );
}

// The trilinear mean of eight values.
fn trilinear(low: vec4<f32>, high: vec4<f32>, t: vec3<f32>) -> f32 {
    let four = vec4<f32>(low.xz, high.xz);
    let along_x = four + t.x * (vec4<f32>(low.yw, high.yw) - four);
    let along_y = along_x.xz + t.y * (along_x.yw - along_x.xz);
    return along_y.x + t.z * (along_y.y - along_y.x);
}

// The smallest and the largest of eight values.
fn extrema(low: vec4<f32>, high: vec4<f32>) -> vec2<f32> {
    let least = min(low, high);
    let most = max(low, high);
    return vec2<f32>(min(min(least.x, least.y), min(least.z, least.w)), max(max(most.x, most.y), max(most.z, most.w)));
}
