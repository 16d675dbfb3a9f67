//! use shared/phase
//! use shared/shape
//! use shared/detail
// Stage `ground`: the land or the sea under the clouds. The twin is cpu/view/ground.rs.
// The module that uses it binds the uniforms `frame` and `light`, and `shadow`.

/// Where ruffled water mirrors a ray that comes down along `d`.
fn mirrored(d: vec3<f32>) -> vec3<f32> {
    return normalize(vec3<f32>(d.xy, SEA_FACET_TILT - d.z));
}

/// Share of light that water mirrors, by the sine of the ray's elevation.
fn mirror_share(rise: f32) -> f32 {
    let flatness = clamp(rise + 1.0, 0.0, 1.0);
    let squared = flatness * flatness;
    return squared * squared * flatness * SEA_MIRROR_GRAZING + SEA_MIRROR_LEAST;
}

fn shadow_depth(at: vec2<f32>) -> f32 {
    let place = shape_place(vec3<f32>(at, shape.bottom_m));
    let i = place.index;
    let row = shape.stride_x;
    let south = mix(shadow[i], shadow[i + 1u], place.fraction.x);
    let north = mix(shadow[i + row], shadow[i + row + 1u], place.fraction.x);
    return mix(south, north, place.fraction.y);
}

/// Mean share of sunlight that passes the clouds.
fn sunlit_share() -> f32 {
    return shadow[shape.stride_x * shape.stride_y];
}

/// Radiance of the ground at a place, seen from a distance.
fn ground_radiance(at: vec2<f32>, distance_m: f32) -> vec3<f32> {
    var passed = 1.0;
    var sky_share = 1.0;
    if (frame.shadow != 0u) {
        let sun = frame.marched_beam.xyz;
        let depth = shadow_depth(at + max(shape.bottom_m, 0.0) / sun.z * sun.xy);
        let straight = exp(-depth);
        let diffuse = 1.0 / (depth * DIFFUSE_VISIBILITY + 1.0);
        passed = straight + (1.0 - straight) * diffuse * GROUND_DIFFUSE_SHARE;
        sky_share = 1.0 - GROUND_SKY_COVERED + GROUND_SKY_COVERED * sunlit_share();
    }
    let broad = detail_look(vec3<f32>(at / GROUND_BROAD_TILE_M, GROUND_BROAD_LEVEL)).x;
    let fields = detail_look(vec3<f32>(at / GROUND_FIELD_TILE_M, GROUND_FIELD_LEVEL));
    let near = 1.0 / (distance_m * distance_m / (GROUND_NEAR_M * GROUND_NEAR_M) + 1.0);
    let patch_size = (broad - 0.5) * GROUND_BROAD + (fields.x - 0.5) * GROUND_FIELDS * near
        + (fields.y - 0.5) * GROUND_GRAIN * near * near;
    let lit = max(frame.beam_direction.z, 0.0) / PI;
    let albedo = clamp(patch_size * frame.ground_tint.rgb + 1.0, vec3<f32>(GROUND_DARKEST), vec3<f32>(GROUND_LIGHTEST))
        * frame.ground_albedo.rgb;
    return albedo * (passed * (light.sun_at_ground.rgb * lit) + light.sky_irradiance.rgb * (sky_share / PI));
}
