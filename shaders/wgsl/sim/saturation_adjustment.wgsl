//! use shared/grid
// Stage `saturation_adjustment`; see the CPU twin for what it computes. Bytes a cell: 16.

@group(0) @binding(3) var<storage, read> heat: array<f32>;
@group(0) @binding(4) var<storage, read> water: array<f32>;
@group(0) @binding(5) var<storage, read_write> cloud: array<f32>;
@group(0) @binding(6) var<storage, read_write> buoyancy: array<f32>;

// Saturation specific humidity (kg/kg) and its slope by temperature (1/K).
fn saturation(pressure_pa: f32, temperature_k: f32) -> vec2<f32> {
    let t = max(temperature_k - 29.65, 50.0);
    let exponent = clamp(17.67 * (temperature_k - 273.15) / t, -87.0, 88.0);
    let vapour_pressure = min(611.2 * exp(exponent), 0.5 * pressure_pa);
    let dry = 1.0 / (pressure_pa - ONE_LESS_EPSILON * vapour_pressure);
    let q = EPSILON * vapour_pressure * dry;
    return vec2<f32>(q, q * pressure_pa * dry * (17.67 * 243.5) / (t * t));
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sim.cells.w {
        return;
    }
    let i = id.z * sim.cells.w + id.x;
    let pressure = profile(PROFILE_PRESSURE, id.z);
    let exner = profile(PROFILE_EXNER, id.z);
    let theta_v0 = profile(PROFILE_THETA_V, id.z);
    let excess = heat[i];
    let total = water[i];
    let cold = exner * (sim.heat_reference_k + excess);
    let first = saturation(pressure, cold);
    var condensed = 0.0;
    if total > first.x {
        var t = cold + LATENT_OVER_CP * (total - first.x) / (1.0 + LATENT_OVER_CP * first.y);
        for (var n = 1u; n < NEWTON_STEPS; n++) {
            let s = saturation(pressure, t);
            let residual = t - cold - LATENT_OVER_CP * (total - s.x);
            t = max(t - residual / (1.0 + LATENT_OVER_CP * s.y), cold);
        }
        condensed = (t - cold) / LATENT_OVER_CP;
    }
    cloud[i] = condensed;
    let theta_excess = excess + LATENT_OVER_CP / exner * condensed;
    let theta = sim.heat_reference_k + theta_excess;
    let vapour = max(total - condensed, 0.0);
    // Differences first: 300 K would swallow the millikelvins that matter.
    buoyancy[i] = GRAVITY_M_S2 / theta_v0
        * (theta_excess + (sim.heat_reference_k - theta_v0) + theta * (VAPOUR_LIGHTNESS * vapour - condensed));
}
