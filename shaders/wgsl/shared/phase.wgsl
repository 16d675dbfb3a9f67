// How light is turned, 1/sr. The twin is cpu/light/phase.rs.

const PI = 3.14159265358979;

fn rayleigh(mu: f32) -> f32 {
    return 3.0 / (16.0 * PI) * (1.0 + mu * mu);
}

fn henyey_greenstein(g: f32, mu: f32) -> f32 {
    let d = max(1.0 + g * g - 2.0 * g * mu, 1e-6);
    return (1.0 - g * g) / (4.0 * PI * d * sqrt(d));
}
