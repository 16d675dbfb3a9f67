//! use shared/shape
//! use shared/light_words
// Stage `diffusion`: the fluence of sunlight that cloud has scattered often. The twins are cpu/light/diffusion.rs (`sources`, `conduct`, `flow`, `surface`),
// cpu/light/between_clouds.rs (`meetings`, `between_clouds`) and cpu/light/diffusion_grids.rs (the others, a grid's step each).
//
// Numbers of all grids lie in planes one after the other: the finest grid's cells first, then the next one's.

@group(0) @binding(0) var<uniform> shape: ShapeGrid;
@group(0) @binding(1) var<uniform> grid: DiffusionGrid;
@group(0) @binding(2) var<storage, read> shape_words: array<u32>;
@group(0) @binding(3) var<storage, read> occupancy_words: array<u32>;
@group(0) @binding(4) var<storage, read> light_words: array<u32>;
// Conductances to the next cell east, north and up, and to the outside; at the end -3 F and the fluence at cells' centres.
@group(0) @binding(5) var<storage, read_write> conductance: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> numbers: array<f32>;
// The shadow map and the share behind it, and behind that fluence and flux, packed.
@group(0) @binding(7) var<storage, read_write> shadow: array<f32>;

// Planes of `numbers`.
const SOURCE = 0u;
const FLUENCE = 1u;
const SPARE = 2u;
const TRANSPORT = 3u;

/// Where a cell of this grid stands in its plane.
fn cell(x: u32, y: u32, z: u32) -> u32 {
    return grid.first + (z * grid.cells_y + y) * grid.cells_x + x;
}

fn other_cell(x: u32, y: u32, z: u32) -> u32 {
    return grid.other_first + (z * grid.other_y + y) * grid.other_x + x;
}

fn place_of(plane: u32, n: u32) -> u32 {
    return plane * grid.total + n;
}

fn beyond(id: vec3<u32>) -> bool {
    return id.x >= grid.cells_x || id.y >= grid.cells_y || id.z >= grid.levels;
}

@compute @workgroup_size(32, 2, 2)
fn sources(@builtin(global_invocation_id) id: vec3<u32>) {
    if (beyond(id)) {
        return;
    }
    let size = vec3<f32>(grid.cell_size_x_m, grid.cell_size_y_m, grid.cell_size_z_m);
    let p = (vec3<f32>(id) + 0.5) * size + vec3<f32>(0.0, 0.0, shape.bottom_m);
    var thick = 0.0;
    var given = 0.0;
    if (empty_distance_m(p) <= 0.0) {
        let s = shape_sample(p);
        let depth = depth_towards_beam(p);
        let kept = select(s.x, smooth_ramp((s.x - CARVE_EDGE) / CARVE_MEAN_RAMP), grid.carved != 0u);
        thick = s.y * kept * grid.similarity;
        // Depths are followed to about this one only: behind it the source would not fall any more and make light.
        given = select(0.0, thick * size.x * size.y * size.z * exp(-grid.similarity * depth), depth < SUN_MARCH_DEEP);
    }
    let n = cell(id.x, id.y, id.z);
    numbers[place_of(SOURCE, n)] = given;
    numbers[place_of(FLUENCE, n)] = 0.0;
    numbers[place_of(TRANSPORT, n)] = thick;
}

/// Half a cell's resistance to diffuse light, times its face's area.
fn half_resistance(transport_per_m: f32, size_m: f32) -> f32 {
    return max(1.5 * transport_per_m * size_m, DIFFUSION_RESISTANCE_LEAST);
}

/// Resistance from the middle of a cell, of which `half` is half a cell's, to the outside.
fn to_outside(half: f32) -> f32 {
    return half * RIM_SHARE + DIFFUSION_SURFACE_RESISTANCE;
}

/// How far a cell counts as cloud, 0 to 1.
fn substance(transport_per_m: f32, mean_m: f32) -> f32 {
    return min(transport_per_m * mean_m * (1.5 / SUBSTANCE_RESISTANCE), 1.0);
}

/// Conductance from a cell to another and to the outside, where the other is cloud or not.
fn to_other(here: f32, other: f32, size_m: f32, face_m2: f32) -> vec2<f32> {
    let half = half_resistance(here, size_m);
    if (other > 0.0) {
        return vec2<f32>(face_m2 / (half + half_resistance(other, size_m)), 0.0);
    }
    return vec2<f32>(0.0, face_m2 / to_outside(half));
}

fn transport(x: u32, y: u32, z: u32) -> f32 {
    return numbers[place_of(TRANSPORT, cell(x, y, z))];
}

@compute @workgroup_size(32, 2, 2)
fn conduct(@builtin(global_invocation_id) id: vec3<u32>) {
    if (beyond(id)) {
        return;
    }
    let here = transport(id.x, id.y, id.z);
    var through = vec4<f32>(0.0);
    if (here > 0.0) {
        let size = vec3<f32>(grid.cell_size_x_m, grid.cell_size_y_m, grid.cell_size_z_m);
        let face = size.yxx * size.zzy;
        // What the faces across each axis lose: a surface that stands aslant is as large as they make as a vector.
        var lost = vec3<f32>(0.0);
        if (grid.cells_x > 1u) {
            let east = to_other(here, transport((id.x + 1u) % grid.cells_x, id.y, id.z), size.x, face.x);
            let west = to_other(here, transport((id.x + grid.cells_x - 1u) % grid.cells_x, id.y, id.z), size.x, face.x);
            through.x = east.x;
            lost.x = west.y + east.y;
        }
        if (grid.cells_y > 1u) {
            let north = to_other(here, transport(id.x, (id.y + 1u) % grid.cells_y, id.z), size.y, face.y);
            let south = to_other(here, transport(id.x, (id.y + grid.cells_y - 1u) % grid.cells_y, id.z), size.y, face.y);
            through.y = north.x;
            lost.y = north.y + south.y;
        }
        // Light leaves under the ground and above the lid too.
        var below = to_other(here, 0.0, size.z, face.z);
        var above = below;
        if (id.z > 0u) {
            below = to_other(here, transport(id.x, id.y, id.z - 1u), size.z, face.z);
        }
        if (id.z + 1u < grid.levels) {
            above = to_other(here, transport(id.x, id.y, id.z + 1u), size.z, face.z);
        }
        through.z = above.x;
        lost.z = below.y + above.y;
        through.w = sqrt(lost.x * lost.x + lost.y * lost.y + lost.z * lost.z);
    }
    conductance[cell(id.x, id.y, id.z)] = through;
}

/// How many cells of the finer of this grid and the other make one of the coarser, along each axis.
fn joined() -> vec3<u32> {
    let cells = vec3<u32>(grid.cells_x, grid.cells_y, grid.levels);
    let other = vec3<u32>(grid.other_x, grid.other_y, grid.other_levels);
    return select(vec3<u32>(1u), vec3<u32>(2u), cells != other);
}

/// Conductances from the other, finer grid's.
@compute @workgroup_size(32, 2, 2)
fn join(@builtin(global_invocation_id) id: vec3<u32>) {
    if (beyond(id)) {
        return;
    }
    let by = joined();
    let first = id * by;
    let last = min(first + by - 1u, vec3<u32>(grid.other_x, grid.other_y, grid.other_levels) - 1u);
    var sums = vec3<f32>(0.0);
    var lost = 0.0;
    for (var z = first.z; z <= last.z; z++) {
        for (var y = first.y; y <= last.y; y++) {
            for (var x = first.x; x <= last.x; x++) {
                let through = conductance[other_cell(x, y, z)];
                lost += through.w;
                sums += select(vec3<f32>(0.0), through.xyz, vec3<u32>(x, y, z) == last);
            }
        }
    }
    sums *= select(vec3<f32>(1.0), vec3<f32>(0.5), by == vec3<u32>(2u));
    let several = vec3<u32>(grid.cells_x, grid.cells_y, 2u) > vec3<u32>(1u);
    conductance[cell(id.x, id.y, id.z)] = vec4<f32>(select(vec3<f32>(0.0), sums, several), lost);
}

/// A cell's fluence, what its neighbours and its source give it, and the sum of its conductances.
fn balance(id: vec3<u32>, plane: u32) -> vec3<f32> {
    let n = cell(id.x, id.y, id.z);
    let west = cell((id.x + grid.cells_x - 1u) % grid.cells_x, id.y, id.z);
    let east = cell((id.x + 1u) % grid.cells_x, id.y, id.z);
    let south = cell(id.x, (id.y + grid.cells_y - 1u) % grid.cells_y, id.z);
    let north = cell(id.x, (id.y + 1u) % grid.cells_y, id.z);
    let own = conductance[n];
    let from_west = conductance[west].x;
    let from_south = conductance[south].y;
    let base = plane * grid.total;
    var given = numbers[place_of(SOURCE, n)];
    given += from_south * numbers[base + south];
    given += own.y * numbers[base + north];
    var sum = own.w + own.x + from_west;
    sum = sum + own.y + from_south + own.z;
    if (id.z > 0u) {
        let below = cell(id.x, id.y, id.z - 1u);
        let from_below = conductance[below].z;
        given += from_below * numbers[base + below];
        sum += from_below;
    }
    if (id.z + 1u < grid.levels) {
        given += own.z * numbers[base + cell(id.x, id.y, id.z + 1u)];
    }
    given += from_west * numbers[base + west];
    given += own.x * numbers[base + east];
    return vec3<f32>(numbers[base + n], given, sum);
}

@compute @workgroup_size(32, 2, 2)
fn sweep(@builtin(global_invocation_id) id: vec3<u32>) {
    if (beyond(id)) {
        return;
    }
    let to_spare = grid.to_spare != 0u;
    let b = balance(id, select(SPARE, FLUENCE, to_spare));
    let settled = select(0.0, b.y / b.z, b.z > 0.0);
    numbers[place_of(select(FLUENCE, SPARE, to_spare), cell(id.x, id.y, id.z))] = b.x + grid.weight * (settled - b.x);
}

/// What the equation leaves over, into the spare plane.
@compute @workgroup_size(32, 2, 2)
fn leave_over(@builtin(global_invocation_id) id: vec3<u32>) {
    if (beyond(id)) {
        return;
    }
    let b = balance(id, FLUENCE);
    numbers[place_of(SPARE, cell(id.x, id.y, id.z))] = b.y - b.x * b.z;
}

/// Takes as its source what the other, finer grid left over, and begins with no fluence.
@compute @workgroup_size(32, 2, 2)
fn take_up(@builtin(global_invocation_id) id: vec3<u32>) {
    if (beyond(id)) {
        return;
    }
    let first = id * joined();
    let end = min(first + joined(), vec3<u32>(grid.other_x, grid.other_y, grid.other_levels));
    var sum = 0.0;
    for (var z = first.z; z < end.z; z++) {
        for (var y = first.y; y < end.y; y++) {
            for (var x = first.x; x < end.x; x++) {
                sum += numbers[place_of(SPARE, other_cell(x, y, z))];
            }
        }
    }
    let n = cell(id.x, id.y, id.z);
    numbers[place_of(SOURCE, n)] = sum;
    numbers[place_of(FLUENCE, n)] = 0.0;
}

/// The coarsest grid's one cell, solved.
@compute @workgroup_size(1)
fn bottom() {
    let lost = conductance[grid.first].w;
    numbers[place_of(FLUENCE, grid.first)] = select(0.0, numbers[place_of(SOURCE, grid.first)] / lost, lost > 0.0);
}

/// Adds the other, coarser grid's fluence.
@compute @workgroup_size(32, 2, 2)
fn add(@builtin(global_invocation_id) id: vec3<u32>) {
    if (beyond(id)) {
        return;
    }
    let above = id / joined();
    numbers[place_of(FLUENCE, cell(id.x, id.y, id.z))] += numbers[place_of(FLUENCE, other_cell(above.x, above.y, above.z))];
}

/// What the lines through the slab from a column's lowest cell meet, weighted by the cosine, the share of them that meets cloud and how often they do, and what the column's cells are given; in place of the lowest cell's conductances, which have served.
@compute @workgroup_size(32, 2, 1)
fn meetings(@builtin(global_invocation_id) id: vec3<u32>) {
    if (beyond(id)) {
        return;
    }
    let cells = vec2<u32>(grid.cells_x, grid.cells_y);
    var met = vec2<f32>(0.0);
    for (var line = 0u; line < 8u; line++) {
        let cosine = select(LINE_FLAT, LINE_STEEP, line < 4u);
        let path_m = grid.cell_size_z_m / cosine;
        let axis = line / 2u % 2u;
        let across = sqrt(1.0 - cosine * cosine) * path_m / select(grid.cell_size_x_m, grid.cell_size_y_m, axis == 1u);
        var whole = 0.0;
        var own = 0.0;
        var often = 0.0;
        for (var k = 0u; k < grid.levels; k++) {
            let by = u32(across * f32(k) + 0.5) % cells[axis];
            var at = id.xy;
            at[axis] = (at[axis] + select(cells[axis] - by, by, line % 2u == 0u)) % cells[axis];
            let thick = transport(at.x, at.y, k) * path_m;
            if (thick <= 0.0) {
                often += 1.0 - exp(-own);
                own = 0.0;
            }
            whole += thick;
            own += thick;
        }
        often += 1.0 - exp(-own);
        met += cosine * vec2<f32>(1.0 - exp(-whole), often);
    }
    var given = 0.0;
    for (var k = 0u; k < grid.levels; k++) {
        given += numbers[place_of(SOURCE, cell(id.x, id.y, k))];
    }
    conductance[cell(id.x, id.y, 0u)] = vec4<f32>(met, given, 0.0);
}

var<workgroup> sums: array<vec3<f32>, 64>;

/// The fluence between clouds, of all columns, to the first place of the spare plane.
@compute @workgroup_size(64)
fn between_clouds(@builtin(local_invocation_index) n: u32) {
    let columns = grid.cells_x * grid.cells_y;
    var sum = vec3<f32>(0.0);
    for (var i = n; i < columns; i += 64u) {
        sum += conductance[grid.first + i].xyz;
    }
    sums[n] = sum;
    workgroupBarrier();
    if (n != 0u) {
        return;
    }
    sum = vec3<f32>(0.0);
    for (var i = 0u; i < 64u; i++) {
        sum += sums[i];
    }
    // Four azimuths; the cosines add up to 1.
    let met = sum.xy / (4.0 * f32(columns));
    let area_m2 = f32(columns) * grid.cell_size_x_m * grid.cell_size_y_m;
    let again = max(1.0 - met.x / max(met.y, 1e-9), 0.0);
    numbers[place_of(SPARE, grid.first)] = select(0.0, 2.0 * sum.z / area_m2 * again / met.x, met.x > 0.0);
}

/// What goes into a cell through its face to another, over the face's area.
fn through_face(here: f32, fluence: f32, other: vec3<u32>, size_m: f32) -> f32 {
    let half = half_resistance(here, size_m);
    let thick = transport(other.x, other.y, other.z);
    if (thick > 0.0) {
        return (fluence_at(other) - fluence) / (half + half_resistance(thick, size_m));
    }
    return -fluence / to_outside(half);
}

fn fluence_at(id: vec3<u32>) -> f32 {
    return max(numbers[place_of(FLUENCE, cell(id.x, id.y, id.z))], 0.0);
}

/// -3 F in a cell, the mean of what passes both faces across each axis, and the fluence at its centre; in place of the conductances, which have served.
@compute @workgroup_size(32, 2, 2)
fn flow(@builtin(global_invocation_id) id: vec3<u32>) {
    if (beyond(id)) {
        return;
    }
    let here = transport(id.x, id.y, id.z);
    let fluence = fluence_at(id);
    // Through the face after and the one before along each axis.
    var after = vec3<f32>(0.0);
    var before = vec3<f32>(0.0);
    var centre = fluence;
    if (here > 0.0) {
        let size = vec3<f32>(grid.cell_size_x_m, grid.cell_size_y_m, grid.cell_size_z_m);
        if (grid.cells_x > 1u) {
            after.x = through_face(here, fluence, vec3<u32>((id.x + 1u) % grid.cells_x, id.yz), size.x);
            before.x = through_face(here, fluence, vec3<u32>((id.x + grid.cells_x - 1u) % grid.cells_x, id.yz), size.x);
        }
        if (grid.cells_y > 1u) {
            after.y = through_face(here, fluence, vec3<u32>(id.x, (id.y + 1u) % grid.cells_y, id.z), size.y);
            before.y = through_face(here, fluence, vec3<u32>(id.x, (id.y + grid.cells_y - 1u) % grid.cells_y, id.z), size.y);
        }
        // Under the ground and above the lid nothing is.
        let out = -fluence / to_outside(half_resistance(here, size.z));
        after.z = out;
        before.z = out;
        if (id.z + 1u < grid.levels) {
            after.z = through_face(here, fluence, id + vec3<u32>(0u, 0u, 1u), size.z);
        }
        if (id.z > 0u) {
            before.z = through_face(here, fluence, id - vec3<u32>(0u, 0u, 1u), size.z);
        }
        let half = vec3<f32>(half_resistance(here, size.x), half_resistance(here, size.y), half_resistance(here, size.z));
        centre = max(fluence + SOURCE_NEARER * dot(half, after + before), 0.0);
    }
    conductance[cell(id.x, id.y, id.z)] = vec4<f32>(1.5 * (after - before), centre);
}

/// -3 F and the fluence, packed.
fn packed(flow: vec4<f32>) -> u32 {
    let most = FLUX_OUTWARD / max(sqrt(flow.x * flow.x + flow.y * flow.y + flow.z * flow.z), 1e-20);
    let scale = min(1.0 / max(flow.w, 1e-9), most) * (f32(FLUX_CODES) / FLUX_OUTWARD);
    let codes = vec3<u32>(flow.xyz * scale + (f32(FLUX_NONE) + 0.5));
    let bits = bitcast<u32>(min(flow.w, FLUENCE_MOST) + FLUENCE_LEAST) - FLUENCE_LEAST_BITS;
    let fluence = (bits + (1u << (FLUENCE_DROPPED_BITS - 1u))) >> FLUENCE_DROPPED_BITS;
    return fluence | (codes.x << 10u) | (codes.y << 17u) | (codes.z << 24u);
}

/// Fluence, what is between clouds with it, and flux as they are looked up: one more cell on each side in x and y, and in cells beside cloud what is at their neighbours' surface.
@compute @workgroup_size(32, 2, 2)
fn surface(@builtin(global_invocation_id) id: vec3<u32>) {
    let stride = vec2<u32>(grid.cells_x, grid.cells_y) + 2u;
    if (id.x >= stride.x || id.y >= stride.y || id.z >= grid.levels) {
        return;
    }
    // Stored cell i is cell i - 1; periodic.
    let x = (id.x + grid.cells_x - 1u) % grid.cells_x;
    let y = (id.y + grid.cells_y - 1u) % grid.cells_y;
    let mean_m = (grid.cell_size_x_m + grid.cell_size_y_m + grid.cell_size_z_m) / 3.0;
    let own = substance(transport(x, y, id.z), mean_m);
    var flow = conductance[cell(x, y, id.z)];
    let between = numbers[place_of(SPARE, grid.first)];
    if (own < 1.0) {
        var sum = vec4<f32>(0.0);
        var weights = 0.0;
        for (var c = 0u; c < 27u; c++) {
            let level = id.z + c / 9u;
            if (level == 0u || level > grid.levels) {
                continue;
            }
            let n = cell((x + grid.cells_x + c % 3u - 1u) % grid.cells_x, (y + grid.cells_y + c / 3u % 3u - 1u) % grid.cells_y, level - 1u);
            let thick = numbers[place_of(TRANSPORT, n)];
            if (thick > 0.0 && c != 13u) {
                // Behind the surface light meets nothing more: the fluence is the surface's.
                let half = half_resistance(thick, mean_m);
                let middle = vec3<u32>(c % 3u, c / 3u % 3u, c / 9u) == vec3<u32>(1u);
                let near = select(vec3<f32>(1.0), vec3<f32>(SURFACE_MIDDLE), middle);
                let weight = near.x * near.y * near.z * substance(thick, mean_m);
                let kept = DIFFUSION_SURFACE_RESISTANCE / to_outside(half);
                sum += weight * vec4<f32>(1.0, 1.0, 1.0, kept) * conductance[n];
                weights += weight;
            }
        }
        if (weights > 0.0) {
            flow = own * flow + ((1.0 - own) / weights) * sum;
        }
    }
    shadow[shape.stride_x * shape.stride_y + 1u + (id.z * stride.y + id.y) * stride.x + id.x] = bitcast<f32>(packed(flow + vec4<f32>(0.0, 0.0, 0.0, between)));
}
