// How light is turned, 1/sr. The twin is cpu/light/phase.rs.

const PI = 3.14159265358979;

fn rayleigh(mu: f32) -> f32 {
    return 3.0 / (16.0 * PI) * (1.0 + mu * mu);
}

fn henyey_greenstein(g: f32, mu: f32) -> f32 {
    let d = max(1.0 + g * g - 2.0 * g * mu, 1e-6);
    return (1.0 - g * g) / (4.0 * PI * d * sqrt(d));
}

fn draine(g: f32, a: f32, mu: f32) -> f32 {
    return henyey_greenstein(g, mu) * (1.0 + a * mu * mu) / (1.0 + a * (1.0 + 2.0 * g * g) / 3.0);
}

/// Droplets as (asymmetry of the peak, of the rest, Draine's parameter, weight of the rest), both asymmetries scaled.
fn droplets_phase(droplets: vec4<f32>, eccentricity: f32, mu: f32) -> f32 {
    return (1.0 - droplets.w) * henyey_greenstein(droplets.x * eccentricity, mu)
        + droplets.w * draine(droplets.y * eccentricity, droplets.z * eccentricity, mu);
}
