//! use shared/sky_radiance
// Stage `sky_light`: one workgroup, an invocation a direction.

const LOOKS = SKY_LIGHT_RINGS * SKY_LIGHT_AROUND;

@group(0) @binding(0) var<uniform> air: Air;
@group(0) @binding(1) var<uniform> ask: SkyLightAsk;
@group(0) @binding(2) var<storage, read> transmittance_table: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> multiple_scattering_table: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> light: array<SkyLightValues>;

var<workgroup> looks: array<vec3<f32>, LOOKS>;

@compute @workgroup_size(LOOKS)
fn sky_light(@builtin(local_invocation_index) n: u32) {
    let sine = (f32(n / SKY_LIGHT_AROUND) + 0.5) / f32(SKY_LIGHT_RINGS);
    let azimuth = (f32(n % SKY_LIGHT_AROUND) + 0.5) / f32(SKY_LIGHT_AROUND) * 2.0 * PI;
    let side = sqrt(1.0 - sine * sine);
    let direction = vec3<f32>(side * cos(azimuth), side * sin(azimuth), sine);
    looks[n] = sky_radiance(air, SKY_LIGHT_HEIGHT_M, direction, ask.sun_direction.xyz, false);
    workgroupBarrier();
    if (n != 0u) {
        return;
    }
    var mean = vec3<f32>(0.0);
    var irradiance = vec3<f32>(0.0);
    for (var i = 0u; i < LOOKS; i++) {
        mean += looks[i];
        irradiance += looks[i] * (2.0 * PI * (f32(i / SKY_LIGHT_AROUND) + 0.5) / f32(SKY_LIGHT_RINGS));
    }
    mean /= f32(LOOKS);
    irradiance /= f32(LOOKS);
    let mu = ask.sun_direction.z;
    let at_ground = transmittance_of_sun(1.0, mu);
    let from_ground = ask.ground_albedo.rgb / PI * (at_ground * max(mu, 0.0) + irradiance);
    light[0].sun_at_base = vec4<f32>(transmittance_of_sun(ask.base_m, mu), 0.0);
    light[0].sun_at_top = vec4<f32>(transmittance_of_sun(ask.top_m, mu), 0.0);
    light[0].sun_at_ground = vec4<f32>(at_ground, 0.0);
    light[0].sky_radiance = vec4<f32>(mean, 0.0);
    light[0].sky_irradiance = vec4<f32>(irradiance, 0.0);
    light[0].ground_radiance = vec4<f32>(from_ground, 0.0);
}
