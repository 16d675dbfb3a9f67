//! use view/march
// Stage `impostors`: a viewer's far clouds from tiles of directions that are kept while they fit. The twin is cpu/view/impostors.rs, whose host code also chooses here which tiles are marched.
//
// Three kernels: `mark` tells which tiles the picture looks at, `tiles` marches those that the host names, `impostors` draws the picture. Behind the picture lie a word a tile (which slot
// holds it), the tiles to be marched (number, slot), and the slots. Marks lie where the picture is drawn later.

@group(0) @binding(13) var<uniform> far: FarClouds;

const NOWHERE = 0xffffffffu;

/// A tile, and a place in it in directions from its first one; the tile is `NOWHERE` where nothing far can be.
struct FarPlace {
    tile: u32,
    place: vec2<f32>,
}

fn far_place(d: vec3<f32>) -> FarPlace {
    let by_x = abs(d.x) >= abs(d.y);
    let ahead = select(d.y, d.x, by_x);
    let side = select(2u, 0u, by_x) + select(1u, 0u, ahead >= 0.0);
    let slopes = vec2<f32>(select(d.x, d.y, by_x), d.z) / abs(ahead);
    // Also false where the ray goes straight up.
    if (!(abs(slopes.y) < FAR_SLOPE_MOST)) {
        return FarPlace(NOWHERE, vec2<f32>(0.0));
    }
    let place = (slopes + vec2<f32>(1.0, FAR_SLOPE_MOST)) / far.step;
    let cell = min(vec2<u32>(place / f32(FAR_TILE)), vec2<u32>(far.tiles_x, far.tiles_y) - 1u);
    return FarPlace((side * far.tiles_y + cell.y) * far.tiles_x + cell.x, place - vec2<f32>(cell * FAR_TILE));
}

/// Unit vector of a direction of a tile.
fn far_direction(number: u32, column: u32, row: u32) -> vec3<f32> {
    let rest = number / far.tiles_x;
    let side = rest / far.tiles_y;
    let u = f32(number % far.tiles_x * FAR_TILE + column) * far.step - 1.0;
    let v = f32(rest % far.tiles_y * FAR_TILE + row) * far.step - FAR_SLOPE_MOST;
    let ahead = select(1.0, -1.0, side % 2u == 1u);
    let level = select(vec2<f32>(u, ahead), vec2<f32>(ahead, u), side < 2u);
    return vec3<f32>(level, v) / sqrt(1.0 + u * u + v * v);
}

@compute @workgroup_size(8, 8)
fn mark(@builtin(global_invocation_id) id: vec3<u32>) {
    let y = id.y + frame.first_row;
    if (id.x >= frame.width || y >= frame.height) {
        return;
    }
    let at = far_place(ray_of(vec2<f32>(f32(id.x), f32(y)) + 0.5).d);
    if (at.tile != NOWHERE) {
        // All who write here write the same.
        picture[at.tile] = 1u;
    }
}

@compute @workgroup_size(8, 8)
fn tiles(@builtin(global_invocation_id) id: vec3<u32>) {
    let line = id.y + frame.first_row;
    let n = line / FAR_SIDE;
    if (id.x >= FAR_SIDE || n >= far.fresh) {
        return;
    }
    let row = line % FAR_SIDE;
    let number = picture[far.fresh_at + 2u * n];
    let slot = picture[far.fresh_at + 2u * n + 1u];
    let ray = ray_along(far_direction(number, id.x, row), vec2<f32>(f32(id.x), f32(row)) + 0.5);
    let met = march_between(ray, far.far_m, NEVER);
    let at = far.numbers_at + ((slot * FAR_SIDE + row) * FAR_SIDE + id.x) * SAMPLE_NUMBERS;
    picture[at] = bitcast<u32>(met.light.r);
    picture[at + 1u] = bitcast<u32>(met.light.g);
    picture[at + 2u] = bitcast<u32>(met.light.b);
    picture[at + 3u] = bitcast<u32>(met.through);
    picture[at + 4u] = bitcast<u32>(met.distance_m);
}

/// What is near, and behind it what a slot has at a place.
fn behind_near(near: Met, slot: u32, place: vec2<f32>) -> Met {
    let first = min(vec2<u32>(place), vec2<u32>(FAR_TILE - 1u));
    let f = place - vec2<f32>(first);
    let shares = vec4<f32>((1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y);
    var numbers = vec4<f32>(0.0);
    var weighted = 0.0;
    for (var n = 0u; n < 4u; n++) {
        let at = far.numbers_at + ((slot * FAR_SIDE + first.y + n / 2u) * FAR_SIDE + first.x + n % 2u) * SAMPLE_NUMBERS;
        let here = bitcast<vec4<f32>>(vec4<u32>(picture[at], picture[at + 1u], picture[at + 2u], picture[at + 3u]));
        numbers += shares[n] * here;
        weighted += shares[n] * (1.0 - here.w) * bitcast<f32>(picture[at + 4u]);
    }
    let near_hides = 1.0 - near.through;
    let hides = near_hides + near.through * (1.0 - numbers.w);
    let distance = near_hides * near.distance_m + near.through * weighted;
    return Met(near.light + near.through * numbers.rgb, near.through * numbers.w, distance / max(hides, 1e-6));
}

@compute @workgroup_size(8, 8)
fn impostors(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let y = id.y + frame.first_row;
    tile[thread] = 0u;
    if (id.x < frame.width && y < frame.height) {
        let ray = ray_of(vec2<f32>(f32(id.x), f32(y)) + 0.5);
        let at = far_place(ray.d);
        var slot = NOWHERE;
        if (at.tile != NOWHERE) {
            slot = picture[far.slots_at + at.tile];
        }
        // A ray on a tile's border may be rounded to the one side here and to the other in `mark`: it is marched to its end.
        let unmarked = at.tile != NOWHERE && slot == NOWHERE;
        var met = march_before(ray, select(far.far_m, NEVER, unmarked));
        if (slot != NOWHERE) {
            met = behind_near(met, slot, at.place);
        } else if (!unmarked) {
            // As the twin has it where nothing is far.
            let hides = 1.0 - met.through;
            met.distance_m = hides * met.distance_m / max(hides, 1e-6);
        }
        tile[thread] = in_word(shown(ray, met));
    }
    pack(group, thread);
}
