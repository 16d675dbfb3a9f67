// Stage `haze`: what the air between the camera and a place takes away. The twin is cpu/view/haze.rs.
// The module that uses it binds the uniform `frame`.

/// Integral of exp(-climb / scale height) over the path, m.
fn haze_path_m(distance_m: f32, rise: f32, scale_height_m: f32) -> f32 {
    let x = clamp(distance_m * rise / scale_height_m, -20.0, 1e6);
    if (x * x < 1e-4) {
        return distance_m * (1.0 - x * 0.5);
    }
    return distance_m * (1.0 - exp(-x)) / x;
}

/// Transmittance over a distance along a ray whose elevation has the sine `rise`.
fn haze_transmittance(distance_m: f32, rise: f32) -> vec3<f32> {
    let molecules = haze_path_m(distance_m, rise, RAYLEIGH_HEIGHT_M);
    let aerosol = haze_path_m(distance_m, rise, AEROSOL_HEIGHT_M) * frame.haze_per_m.w;
    return exp(-molecules * frame.haze_per_m.rgb - aerosol);
}
