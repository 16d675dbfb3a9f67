// What the clear air is made of. The twin is cpu/light/atmosphere.rs, which says what the numbers are and whose.
// Distances are written without cancellation, so that 32 bits do where the twin takes 64.

const RAYLEIGH_PER_M = vec3<f32>(RAYLEIGH_RED_PER_M, RAYLEIGH_GREEN_PER_M, RAYLEIGH_BLUE_PER_M);
const OZONE_PER_M = vec3<f32>(OZONE_RED_PER_M, OZONE_GREEN_PER_M, OZONE_BLUE_PER_M);

/// Coefficients at one height, 1/m.
struct Coefficients {
    rayleigh_per_m: vec3<f32>,
    aerosol_per_m: f32,
    extinction_per_m: vec3<f32>,
}

fn coefficients_at(air: Air, height_m: f32) -> Coefficients {
    let altitude_m = air.surface_altitude_m + height_m;
    let aerosol = exp(-max(height_m, 0.0) / AEROSOL_HEIGHT_M) * air.aerosol_per_m;
    let ozone = max(1.0 - abs(altitude_m - OZONE_MIDDLE_M) / OZONE_HALF_DEPTH_M, 0.0);
    var c: Coefficients;
    c.rayleigh_per_m = RAYLEIGH_PER_M * exp(-altitude_m / RAYLEIGH_HEIGHT_M);
    c.aerosol_per_m = aerosol * AEROSOL_ALBEDO;
    c.extinction_per_m = c.rayleigh_per_m + aerosol + OZONE_PER_M * ozone;
    return c;
}

/// Distance from a height along a ray to the sphere above, m: the far crossing.
fn distance_to_shell_m(height_m: f32, mu: f32, shell_height_m: f32) -> f32 {
    let along = (EARTH_RADIUS_M + height_m) * mu;
    let gap = (shell_height_m - height_m) * (2.0 * EARTH_RADIUS_M + shell_height_m + height_m);
    let root = sqrt(max(gap + along * along, 0.0));
    if (along > 0.0) {
        return max(gap / max(along + root, 1e-6), 0.0);
    }
    return max(root - along, 0.0);
}

/// Distance to the ground, m; negative if the ray passes over the horizon.
fn distance_to_ground_m(height_m: f32, mu: f32) -> f32 {
    let along = (EARTH_RADIUS_M + height_m) * mu;
    let gap = height_m * (2.0 * EARTH_RADIUS_M + height_m);
    let under_root = along * along - gap;
    if (mu < 0.0 && under_root >= 0.0) {
        return max(gap / (sqrt(under_root) - along), 0.0);
    }
    return -1.0;
}

/// Height above the ground after a distance along a ray, m.
fn height_along_m(height_m: f32, mu: f32, distance_m: f32) -> f32 {
    let r = EARTH_RADIUS_M + height_m;
    let rise = distance_m * (2.0 * r * mu + distance_m);
    return height_m + rise / (sqrt(max(r * r + rise, 0.0)) + r);
}

/// Distance to the horizon of a place, m.
fn horizon_distance_m(height_m: f32) -> f32 {
    return sqrt(max(height_m * (2.0 * EARTH_RADIUS_M + height_m), 0.0));
}

/// Cosine of the sun's zenith angle at a distance along a ray from `height_m`, where the height is `h`.
fn local_sun_cosine(height_m: f32, direction: vec3<f32>, sun: vec3<f32>, distance_m: f32, h: f32) -> f32 {
    let r = EARTH_RADIUS_M + height_m;
    return clamp((r * sun.z + distance_m * dot(direction, sun)) / (EARTH_RADIUS_M + h), -1.0, 1.0);
}
