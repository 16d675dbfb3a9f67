//! use shared/constants
// The grid as every stage of the simulation sees it: what each is told, and where cells and their neighbours are.
// Arrays are [z][y][x], x fastest; a thread takes one place of a level, so that neighbours in a workgroup lie side by side in memory
// whatever the number of cells along x.

@group(0) @binding(0) var<uniform> sim: Sim;
@group(0) @binding(1) var<uniform> substep: Step;
@group(0) @binding(2) var<storage, read> profiles: array<f32>;

// One level's value of a profile; lower-face profiles have one more, the lid's.
fn profile(which: u32, z: u32) -> f32 {
    return profiles[which * (sim.cells.z + 1u) + z];
}

// The base of row (y, z).
fn row_of(y: u32, z: u32) -> u32 {
    return (z * sim.cells.y + y) * sim.cells.x;
}

// `i - by` and `i + by` on a periodic axis of `n` cells; `by` up to 3, `n` from 1.
fn back(i: u32, by: u32, n: u32) -> u32 {
    return (i + n * by - by) % n;
}
fn ahead(i: u32, by: u32, n: u32) -> u32 {
    return (i + by) % n;
}
