//! use shared/atmosphere
//! use shared/phase
//! use shared/air_transmittance
// Stage `multiple_scattering_table`: a workgroup a texel, an invocation a direction.

const DIRECTIONS = MULTIPLE_RINGS * MULTIPLE_AROUND;

@group(0) @binding(0) var<uniform> air: Air;
@group(0) @binding(1) var<storage, read> transmittance_table: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> table: array<vec4<f32>>;

var<workgroup> second_order: array<vec3<f32>, DIRECTIONS>;
var<workgroup> scattered_on: array<vec3<f32>, DIRECTIONS>;

@compute @workgroup_size(DIRECTIONS)
fn multiple_scattering(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) look: u32) {
    let n = group.x;
    let y = f32(n / MULTIPLE_SUNS) / f32(MULTIPLE_HEIGHTS - 1u);
    let s = 2.0 * f32(n % MULTIPLE_SUNS) / f32(MULTIPLE_SUNS - 1u) - 1.0;
    let sun_mu = select(-1.0, 1.0, s >= 0.0) * s * s;
    let height_m = clamp(y * y * AIR_DEPTH_M, 1.0, AIR_DEPTH_M - 10.0);
    let sun = vec3<f32>(sqrt(max(1.0 - sun_mu * sun_mu, 0.0)), 0.0, sun_mu);

    let mu = 2.0 * (f32(look / MULTIPLE_AROUND) + 0.5) / f32(MULTIPLE_RINGS) - 1.0;
    let azimuth = (f32(look % MULTIPLE_AROUND) + 0.5) / f32(MULTIPLE_AROUND) * PI;
    let side = sqrt(1.0 - mu * mu);
    let direction = vec3<f32>(side * cos(azimuth), side * sin(azimuth), mu);
    let ground = distance_to_ground_m(height_m, mu);
    let whole = select(distance_to_shell_m(height_m, mu, AIR_DEPTH_M), ground, ground >= 0.0);
    var second = vec3<f32>(0.0);
    var passed_on = vec3<f32>(0.0);
    var through = vec3<f32>(1.0);
    var before = 0.0;
    for (var step = 0u; step < MULTIPLE_STEPS; step++) {
        let f = f32(step + 1u) / f32(MULTIPLE_STEPS);
        let after = whole * f * f;
        let at = 0.5 * (before + after);
        let h = max(height_along_m(height_m, mu, at), 0.0);
        let local_mu = local_sun_cosine(height_m, direction, sun, at, h);
        let c = coefficients_at(air, h);
        let lit = transmittance_of_sun(h, local_mu);
        let kept = exp(-c.extinction_per_m * (after - before));
        let share = through * (c.rayleigh_per_m + c.aerosol_per_m) * (1.0 - kept)
            / max(c.extinction_per_m, vec3<f32>(1e-12));
        second += share * lit / (4.0 * PI);
        passed_on += share;
        through *= kept;
        before = after;
    }
    if (ground >= 0.0) {
        let local_mu = local_sun_cosine(height_m, direction, sun, ground, 0.0);
        let lit = transmittance_of_sun(0.0, local_mu);
        second += through * lit * (max(local_mu, 0.0) * MULTIPLE_GROUND_ALBEDO / PI);
    }
    second_order[look] = second;
    scattered_on[look] = passed_on;
    workgroupBarrier();
    for (var span = DIRECTIONS / 2u; span > 0u; span /= 2u) {
        if (look < span) {
            second_order[look] += second_order[look + span];
            scattered_on[look] += scattered_on[look + span];
        }
        workgroupBarrier();
    }
    if (look == 0u) {
        // The geometric series of all orders.
        let share = 1.0 / f32(DIRECTIONS);
        let all = second_order[0] * share / (1.0 - min(scattered_on[0] * share, vec3<f32>(MULTIPLE_SHARE_MAX)));
        table[n] = vec4<f32>(all, 0.0);
    }
}
