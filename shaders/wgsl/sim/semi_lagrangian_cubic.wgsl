//! use shared/carried
// Stage `semi_lagrangian_cubic`; see the CPU twin for what it computes. Bytes a cell: 20, for w 24, and 72 values read out of order.
// One entry point a place.

@group(0) @binding(7) var<storage, read_write> next: array<f32>;
@group(0) @binding(8) var<storage, read> buoyancy: array<f32>;

// Lagrange's weights of the nodes -1, 0, 1, 2 at `t`.
fn lagrange(t: f32) -> vec4<f32> {
    let a = t + 1.0;
    let b = t - 1.0;
    let c = t - 2.0;
    return vec4<f32>(-t * b * c * (1.0 / 6.0), a * b * c * 0.5, -a * t * c * 0.5, a * t * b * (1.0 / 6.0));
}

fn carry(id: vec3<u32>, place: u32) {
    if id.x >= sim.cells.w {
        return;
    }
    let x = id.x % sim.cells.x;
    let y = id.x / sim.cells.x;
    let i = id.z * sim.cells.w + id.x;
    if place == Z_FACE && id.z == 0u {
        // w at the ground stays 0.
        next[i] = 0.0;
        return;
    }
    let top = top_of(place);
    let stored = sim.cells.z;
    let displacement = displacement_of(place, x, y, id.z);
    let corners = around(x, y, id.z, displacement, top);
    let t = corners.t;
    // The level at or below the place, as `around` finds it.
    let height = f32(id.z);
    let inner = u32(clamp(i32(id.z) + i32(floor(-bounded(displacement.z, height - f32(top), height))), 0, i32(top)));
    var base = inner;
    var weights_z = vec4<f32>(1.0 - t.z, t.z, 0.0, 0.0);
    if top >= 3u {
        // Next to a wall the four levels stay in the box, and the point lies off their middle.
        base = min(max(inner, 1u) - 1u, top - 3u);
        weights_z = lagrange(t.z + (f32(inner) - (f32(base) + 1.0)));
    }
    let west = i32(x) + i32(floor(-displacement.x)) - 1;
    let south = i32(y) + i32(floor(-displacement.y)) - 1;
    let columns = vec4<u32>(wrapped(west, sim.cells.x), wrapped(west + 1, sim.cells.x), wrapped(west + 2, sim.cells.x), wrapped(west + 3, sim.cells.x));
    let rows = array<u32, 4>(
        wrapped(south, sim.cells.y), wrapped(south + 1, sim.cells.y), wrapped(south + 2, sim.cells.y), wrapped(south + 3, sim.cells.y));
    let weights_y = lagrange(t.y);
    var sum = vec4<f32>(0.0);
    for (var k = 0u; k < 4u; k++) {
        // The lid's level of w holds 0.
        let level = base + k;
        if level < stored {
            var along = vec4<f32>(0.0);
            for (var j = 0u; j < 4u; j++) {
                along += weights_y[j] * four(row_of(rows[j], level) + columns);
            }
            sum += weights_z[k] * along;
        }
    }
    let weights_x = lagrange(t.x);
    let bounds = extrema(four(corners.low) * corners.there.x, four(corners.high) * corners.there.y);
    var value = (weights_x.x * sum.x + weights_x.y * sum.y) + (weights_x.z * sum.z + weights_x.w * sum.w);
    value = bounded(value, bounds.x, bounds.y);
    if place == Z_FACE && (sim.holds & HOLDS_BUOYANCY) != 0u {
        value += substep.stage_s * 0.5 * (buoyancy[i - sim.cells.w] + buoyancy[i]);
    }
    next[i] = value;
}

@compute @workgroup_size(64)
fn centre(@builtin(global_invocation_id) id: vec3<u32>) {
    carry(id, CENTRE);
}

@compute @workgroup_size(64)
fn x_face(@builtin(global_invocation_id) id: vec3<u32>) {
    carry(id, X_FACE);
}

@compute @workgroup_size(64)
fn y_face(@builtin(global_invocation_id) id: vec3<u32>) {
    carry(id, Y_FACE);
}

@compute @workgroup_size(64)
fn z_face(@builtin(global_invocation_id) id: vec3<u32>) {
    carry(id, Z_FACE);
}
