//! use shared/shape
// Lookups in the fluence and flux of stage `diffusion`. The twin is cpu/light/diffusion.rs. The module that uses it binds `frame`, the uniform `shape`, and `shadow`, behind whose
// share they lie, a word a cell.

/// What diffuse light brings towards a camera at the centres of four cells, times 4 pi; `along` is the ray's direction in the flux's codes.
fn brought(numbers: vec4<f32>, along: vec3<f32>) -> vec4<f32> {
    let words = bitcast<vec4<u32>>(numbers);
    let code = vec4<u32>(127u);
    let none = (along.x + along.y + along.z) * f32(FLUX_NONE);
    let x = vec4<f32>((words >> vec4<u32>(10u)) & code);
    let y = vec4<f32>((words >> vec4<u32>(17u)) & code);
    let z = vec4<f32>((words >> vec4<u32>(24u)) & code);
    let flux = x * along.x + y * along.y + z * along.z - none;
    let asymmetry = 1.0 - frame.similarity;
    let more = clamp(flux, vec4<f32>(-FLUX_INWARD * asymmetry), vec4<f32>(FLUX_OUTWARD * asymmetry)) + 1.0;
    let bits = ((words & vec4<u32>(0x3ffu)) << vec4<u32>(FLUENCE_DROPPED_BITS)) + FLUENCE_LEAST_BITS;
    return (bitcast<vec4<f32>>(bits) - FLUENCE_LEAST) * more;
}

/// What diffuse light brings towards a camera that looks along `d`, times 4 pi.
fn diffuse_towards(p: vec3<f32>, d: vec3<f32>) -> f32 {
    let cells = vec2<f32>(f32(shape.cells_x), f32(shape.cells_y));
    let gxy = fract(p.xy * vec2<f32>(shape.per_period_x, shape.per_period_y)) * cells + 0.5;
    let gz = clamp((p.z - shape.bottom_m) / shape.cell_size_z_m - 0.5, 0.0, f32(shape.levels) - 1.001);
    let g = vec3<f32>(gxy, gz);
    let whole = floor(g);
    let c = vec3<u32>(whole);
    let row = shape.cells_x + 2u;
    let i = shape.stride_x * shape.stride_y + 1u + (c.z * (shape.cells_y + 2u) + c.y) * row + c.x;
    let j = i + row * (shape.cells_y + 2u);
    let along = d * ((1.0 - frame.similarity) * FLUX_OUTWARD / f32(FLUX_CODES));
    let low = brought(vec4<f32>(shadow[i], shadow[i + 1u], shadow[i + row], shadow[i + row + 1u]), along);
    let high = brought(vec4<f32>(shadow[j], shadow[j + 1u], shadow[j + row], shadow[j + row + 1u]), along);
    return trilinear(low, high, g - whole);
}
