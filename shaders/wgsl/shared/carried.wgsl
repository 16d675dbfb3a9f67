//! use shared/semi_lagrangian
// What the semi-Lagrangian stages have in common: a quantity, and how far away the air at each centre was (or will be), in cells.

// The quantity, the substep's tendencies in it.
@group(0) @binding(3) var<storage, read> carried: array<f32>;
@group(0) @binding(4) var<storage, read> displacement_x: array<f32>;
@group(0) @binding(5) var<storage, read> displacement_y: array<f32>;
@group(0) @binding(6) var<storage, read> displacement_z: array<f32>;

// Where the quantity lies. Always a constant where it is passed, so that the choice is made when the shader is compiled.
const CENTRE = 0u;
const X_FACE = 1u;
const Y_FACE = 2u;
const Z_FACE = 3u;

fn displacement_at(i: u32) -> vec3<f32> {
    return vec3<f32>(displacement_x[i], displacement_y[i], displacement_z[i]);
}

// The displacement at a place: at a face the mean of the two centres beside it. Not to be asked for at the ground's faces.
fn displacement_of(place: u32, x: u32, y: u32, z: u32) -> vec3<f32> {
    let i = row_of(y, z) + x;
    let here = displacement_at(i);
    switch place {
        case X_FACE: { return 0.5 * (displacement_at(row_of(y, z) + back(x, 1u, sim.cells.x)) + here); }
        case Y_FACE: { return 0.5 * (displacement_at(row_of(back(y, 1u, sim.cells.y), z) + x) + here); }
        case Z_FACE: { return 0.5 * (displacement_at(i - sim.cells.w) + here); }
        default: { return here; }
    }
}

// The last level of a place's lattice, stored or not.
fn top_of(place: u32) -> u32 {
    return select(sim.cells.z - 1u, sim.cells.z, place == Z_FACE);
}

fn four(at: vec4<u32>) -> vec4<f32> {
    return vec4<f32>(carried[at.x], carried[at.y], carried[at.z], carried[at.w]);
}
