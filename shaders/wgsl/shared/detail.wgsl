// Lookups in the tile of stage `detail_noise`. The module that uses them binds `detail_words`.

/// Large and small billows, 0 to 1, at a place in units of the tile's edge.
fn detail_look(p: vec3<f32>) -> vec2<f32> {
    let q = p * f32(TILE_POINTS);
    let whole = floor(q);
    let f = q - whole;
    const MASK = TILE_POINTS - 1u;
    let i = bitcast<vec3<u32>>(vec3<i32>(whole)) & vec3<u32>(MASK);
    let j = (i.y + 1u) & MASK;
    let level = i.z * TILE_POINTS;
    let level_above = ((i.z + 1u) & MASK) * TILE_POINTS;
    // A point holds both numbers and, behind them, its eastern neighbour's.
    let a = unpack4x8unorm(detail_words[(level + i.y) * TILE_POINTS + i.x]);
    let b = unpack4x8unorm(detail_words[(level + j) * TILE_POINTS + i.x]);
    let c = unpack4x8unorm(detail_words[(level_above + i.y) * TILE_POINTS + i.x]);
    let d = unpack4x8unorm(detail_words[(level_above + j) * TILE_POINTS + i.x]);
    let low = mix(mix(a.xy, a.zw, f.x), mix(b.xy, b.zw, f.x), f.y);
    let high = mix(mix(c.xy, c.zw, f.x), mix(d.xy, d.zw, f.x), f.y);
    return mix(low, high, f.z);
}
