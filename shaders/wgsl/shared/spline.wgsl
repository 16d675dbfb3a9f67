// Quadratic B-splines between cell centres. The twin is in cpu/view/shape.rs.

/// Weights of the cells before, at and after for point `sub` of `finer` in a cell: quadratic B-splines.
fn spline(sub: u32, finer: u32) -> vec3<f32> {
    let d = (f32(sub) + 0.5) / f32(finer) - 0.5;
    return vec3<f32>(0.5 * (0.5 - d) * (0.5 - d), 0.75 - d * d, 0.5 * (0.5 + d) * (0.5 + d));
}
