//! use shared/shape
// Lookups in the fluence of stage `diffusion`. The twin is cpu/light/diffusion.rs. The module that uses it binds `frame`, the uniform `shape`, and `shadow`, behind whose
// share the fluence lies.

/// Fluence at a place.
fn fluence(p: vec3<f32>) -> f32 {
    let cells = vec2<f32>(f32(shape.cells_x), f32(shape.cells_y));
    let gxy = fract(p.xy * vec2<f32>(shape.per_period_x, shape.per_period_y)) * cells + 0.5;
    let gz = clamp((p.z - shape.bottom_m) / shape.cell_size_z_m - 0.5, 0.0, f32(shape.levels) - 1.001);
    let g = vec3<f32>(gxy, gz);
    let whole = floor(g);
    let c = vec3<u32>(whole);
    let row = shape.cells_x + 2u;
    let i = shape.stride_x * shape.stride_y + 1u + (c.z * (shape.cells_y + 2u) + c.y) * row + c.x;
    let j = i + row * (shape.cells_y + 2u);
    let low = vec4<f32>(shadow[i], shadow[i + 1u], shadow[i + row], shadow[i + row + 1u]);
    let high = vec4<f32>(shadow[j], shadow[j + 1u], shadow[j + row], shadow[j + row + 1u]);
    return trilinear(low, high, g - whole);
}

/// What diffuse light brings towards a camera that looks along `d`, times 4 pi.
fn diffuse_towards(p: vec3<f32>, d: vec3<f32>) -> f32 {
    let ahead_m = shape.cell_size_z_m;
    let here = fluence(p);
    let ahead = fluence(p + d * ahead_m);
    let asymmetry = 1.0 - frame.similarity;
    let s = shape_sample(p + d * (0.5 * ahead_m));
    let kept = select(s.x, smooth_ramp((s.x - CARVE_EDGE) / CARVE_MEAN_RAMP), frame.detail_blend != 0.0);
    let flux = (ahead - here) * asymmetry / max(s.y * kept * (frame.similarity * ahead_m), 1e-6);
    return here + min(max(flux, here * (-FLUX_INWARD * asymmetry)), here * (FLUX_OUTWARD * asymmetry));
}
