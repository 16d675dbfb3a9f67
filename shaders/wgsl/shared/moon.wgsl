// The moon's disc. The twin is cpu/light/moon.rs, which says by what laws.

/// What a disc by Lommel and Seeliger's law reflects at a phase, over what it does when full.
fn moon_phase_integral(phase_cosine: f32) -> f32 {
    let half_angle = 0.5 * acos(clamp(phase_cosine, -1.0, 1.0));
    if (half_angle < 1e-3) {
        return 1.0;
    }
    return 1.0 - sin(half_angle) * tan(half_angle) * log(1.0 / tan(0.5 * half_angle));
}

/// How full the Earth is from the moon, by Lambert's law.
fn earth_phase(moon_phase_cosine: f32) -> f32 {
    let angle = acos(clamp(-moon_phase_cosine, -1.0, 1.0));
    return (sin(angle) + (PI - angle) * cos(angle)) / PI;
}

/// Radiance of the disc before the air along `d`, and the share of the disc in it; `moon` is the direction and the angular radius, `light` the irradiance.
fn moon_radiance(d: vec3<f32>, moon: vec4<f32>, light: vec3<f32>, sun: vec3<f32>, edge: f32) -> vec4<f32> {
    let e = d - moon.xyz;
    let angle = length(e);
    let disc = clamp((moon.w + edge * 0.5 - angle) / edge, 0.0, 1.0);
    if (disc <= 0.0) {
        return vec4<f32>(0.0);
    }
    let phase_cosine = clamp(-dot(moon.xyz, sun), -1.0, 1.0);
    let outwards = angle / moon.w;
    let up = sqrt(max(1.0 - outwards * outwards, 0.0));
    let sunlit = max(dot(e, sun) / moon.w + up * phase_cosine, 0.0);
    let reflected = sunlit / max(sunlit + up, 1e-4);
    let lit = light / (PI * moon.w * moon.w) * (2.0 / max(moon_phase_integral(phase_cosine), MOON_PHASE_LEAST));
    let law_radius = MOON_RADIUS_M / MOON_LAW_DISTANCE_M;
    let ashen = colour_of(MOON_COLOUR_INDEX) * (MOON_FULL_IRRADIANCE * EARTHLIGHT * earth_phase(phase_cosine) / (PI * law_radius * law_radius));
    return vec4<f32>((reflected * lit + ashen) * disc, disc);
}
