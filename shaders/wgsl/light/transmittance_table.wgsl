//! use shared/atmosphere
// Stage `transmittance_table`: one texel an invocation.

@group(0) @binding(0) var<uniform> air: Air;
@group(0) @binding(1) var<storage, read_write> table: array<vec4<f32>>;

@compute @workgroup_size(64)
fn transmittance(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = id.x;
    if (n >= TRANSMITTANCE_HEIGHTS * TRANSMITTANCE_DIRECTIONS) {
        return;
    }
    let j = n / TRANSMITTANCE_DIRECTIONS;
    let i = n % TRANSMITTANCE_DIRECTIONS;
    let top = horizon_distance_m(AIR_DEPTH_M);
    let rho = top * f32(j) / f32(TRANSMITTANCE_HEIGHTS - 1u);
    let r = sqrt(rho * rho + EARTH_RADIUS_M * EARTH_RADIUS_M);
    // r - R without cancellation.
    let height_m = rho * rho / (r + EARTH_RADIUS_M);
    let least = AIR_DEPTH_M - height_m;
    let d = max(least + (rho + top - least) * f32(i) / f32(TRANSMITTANCE_DIRECTIONS - 1u), 1.0);
    let mu = clamp(((top - rho) * (top + rho) - d * d) / (2.0 * r * d), -1.0, 1.0);
    table[n] = vec4<f32>(through_air(height_m, mu), 0.0);
}

fn through_air(height_m: f32, mu: f32) -> vec3<f32> {
    let whole = distance_to_shell_m(height_m, mu, AIR_DEPTH_M);
    var depth = vec3<f32>(0.0);
    var before = 0.0;
    for (var s = 0u; s < TRANSMITTANCE_STEPS; s++) {
        let f = f32(s + 1u) / f32(TRANSMITTANCE_STEPS);
        let after = whole * f * f;
        let c = coefficients_at(air, max(height_along_m(height_m, mu, 0.5 * (before + after)), 0.0));
        depth += c.extinction_per_m * (after - before);
        before = after;
    }
    return exp(-depth);
}
