//! use shared/atmosphere
// Lookups in the table of stage `transmittance_table`. The module that uses them binds `transmittance_table`, three colours a
// texel and the fourth number unused.

fn transmittance_to_space(height_m: f32, mu: f32) -> vec3<f32> {
    let height = clamp(height_m, 0.0, AIR_DEPTH_M - 1.0);
    let top = horizon_distance_m(AIR_DEPTH_M);
    let rho = horizon_distance_m(height);
    let d = distance_to_shell_m(height, mu, AIR_DEPTH_M);
    let least = AIR_DEPTH_M - height;
    let x = clamp((d - least) / (rho + top - least), 0.0, 1.0) * f32(TRANSMITTANCE_DIRECTIONS - 1u);
    let y = clamp(rho / top, 0.0, 1.0) * f32(TRANSMITTANCE_HEIGHTS - 1u);
    let i = min(u32(x), TRANSMITTANCE_DIRECTIONS - 2u);
    let j = min(u32(y), TRANSMITTANCE_HEIGHTS - 2u);
    let at = j * TRANSMITTANCE_DIRECTIONS + i;
    let fx = x - f32(i);
    let low = mix(transmittance_table[at].rgb, transmittance_table[at + 1u].rgb, fx);
    let next = at + TRANSMITTANCE_DIRECTIONS;
    let high = mix(transmittance_table[next].rgb, transmittance_table[next + 1u].rgb, fx);
    return mix(low, high, y - f32(j));
}

/// Share of the sun's light that reaches a height; falls to 0 as the disc sets.
fn transmittance_of_sun(height_m: f32, mu: f32) -> vec3<f32> {
    let r = EARTH_RADIUS_M + max(height_m, 0.0);
    let dip = horizon_distance_m(max(height_m, 0.0)) / r;
    let risen = clamp((mu + dip) / (2.0 * SUN_ANGULAR_RADIUS) + 0.5, 0.0, 1.0);
    if (risen == 0.0) {
        return vec3<f32>(0.0);
    }
    return transmittance_to_space(height_m, mu) * (risen * risen * (3.0 - 2.0 * risen));
}
