//! use shared/atmosphere
//! use shared/phase
//! use shared/air_transmittance
// The clear sky's radiance along a ray. The twin is `radiance` in cpu/light/sky_table.rs. The module that uses it binds
// `transmittance_table` and `multiple_scattering_table`.

fn multiple_scattering_at(height_m: f32, mu: f32) -> vec3<f32> {
    let y = min(sqrt(max(height_m, 0.0) / AIR_DEPTH_M), 1.0) * f32(MULTIPLE_HEIGHTS - 1u);
    let bent = select(-1.0, 1.0, mu >= 0.0) * sqrt(min(abs(mu), 1.0));
    let x = (0.5 + 0.5 * bent) * f32(MULTIPLE_SUNS - 1u);
    let i = min(u32(x), MULTIPLE_SUNS - 2u);
    let j = min(u32(y), MULTIPLE_HEIGHTS - 2u);
    let at = j * MULTIPLE_SUNS + i;
    let fx = x - f32(i);
    let low = mix(multiple_scattering_table[at].rgb, multiple_scattering_table[at + 1u].rgb, fx);
    let next = at + MULTIPLE_SUNS;
    let high = mix(multiple_scattering_table[next].rgb, multiple_scattering_table[next + 1u].rgb, fx);
    return mix(low, high, y - f32(j));
}

/// What lights a sky.
struct SkySource {
    direction: vec3<f32>,
    strength: vec3<f32>,
    scattered_glow: vec3<f32>,
    layer_glow: vec3<f32>,
}

/// Radiance over the sun's irradiance from a height, light from the ground left out. `to_ground`: the ray ends at the
/// ground, or at the horizon if it just misses.
fn sky_radiance(air: Air, height_m: f32, direction: vec3<f32>, source: SkySource, to_ground: bool) -> vec3<f32> {
    let sun = source.direction;
    let mu = direction.z;
    var whole = distance_to_shell_m(height_m, mu, AIR_DEPTH_M);
    if (to_ground) {
        let hit = distance_to_ground_m(height_m, mu);
        whole = select(horizon_distance_m(height_m), hit, hit >= 0.0);
    }
    let turn = dot(direction, sun);
    let molecules = rayleigh(turn);
    let aerosol = henyey_greenstein(AEROSOL_ASYMMETRY, turn);
    var light = vec3<f32>(0.0);
    var through = vec3<f32>(1.0);
    var before = 0.0;
    let steps = select(SKY_STEPS, SKY_STEPS_DUSK, sun.z < 0.0);
    for (var s = 0u; s < steps; s++) {
        let f = f32(s + 1u) / f32(steps);
        let after = whole * f * f;
        let at = 0.5 * (before + after);
        let h = max(height_along_m(height_m, mu, at), 0.0);
        let local_mu = local_sun_cosine(height_m, direction, sun, at, h);
        let c = coefficients_at(air, h);
        let lit = transmittance_of_sun(h, local_mu);
        let higher = multiple_scattering_at(h, local_mu) + source.scattered_glow;
        let lit_up = lit * (c.rayleigh_per_m * molecules + c.aerosol_per_m * aerosol)
            + higher * (c.rayleigh_per_m + c.aerosol_per_m);
        let kept = exp(-c.extinction_per_m * (after - before));
        light += through * lit_up * (1.0 - kept) / max(c.extinction_per_m, vec3<f32>(1e-12));
        through *= kept;
        before = after;
    }
    if (!to_ground) {
        let nearer = (EARTH_RADIUS_M + height_m) / (EARTH_RADIUS_M + GLOW_HEIGHT_M);
        light += source.layer_glow * through * inverseSqrt(max(1.0 - nearer * nearer * (1.0 - mu * mu), 1e-3));
    }
    return source.strength * light;
}
