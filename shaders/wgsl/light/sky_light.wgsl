//! use shared/sky_radiance
// Stage `sky_light`: one workgroup, an invocation a direction from the ground and one from the clouds' middle; with `adds` the moon's light is added to what the sun has left.

const LOOKS = SKY_LIGHT_RINGS * SKY_LIGHT_AROUND;

@group(0) @binding(0) var<uniform> air: Air;
@group(0) @binding(1) var<uniform> ask: SkyLightAsk;
@group(0) @binding(2) var<storage, read> transmittance_table: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> multiple_scattering_table: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> light: array<SkyLightValues>;

// First those from the ground.
var<workgroup> looks: array<vec3<f32>, 2u * LOOKS>;

@compute @workgroup_size(2u * LOOKS)
fn sky_light(@builtin(local_invocation_index) look: u32) {
    let n = look % LOOKS;
    let sine = (f32(n / SKY_LIGHT_AROUND) + 0.5) / f32(SKY_LIGHT_RINGS);
    let azimuth = (f32(n % SKY_LIGHT_AROUND) + 0.5) / f32(SKY_LIGHT_AROUND) * 2.0 * PI;
    let side = sqrt(1.0 - sine * sine);
    let direction = vec3<f32>(side * cos(azimuth), side * sin(azimuth), sine);
    let source = SkySource(ask.direction.xyz, ask.strength.rgb, ask.scattered_glow.rgb, ask.layer_glow.rgb);
    let height_m = select(SKY_LIGHT_HEIGHT_M, 0.5 * (ask.base_m + ask.top_m), look >= LOOKS);
    looks[look] = sky_radiance(air, height_m, direction, source, false);
    workgroupBarrier();
    if (look != 0u) {
        return;
    }
    var mean = vec3<f32>(0.0);
    var irradiance = vec3<f32>(0.0);
    for (var i = 0u; i < LOOKS; i++) {
        mean += looks[LOOKS + i];
        irradiance += looks[i] * (2.0 * PI * (f32(i / SKY_LIGHT_AROUND) + 0.5) / f32(SKY_LIGHT_RINGS));
    }
    mean /= f32(LOOKS);
    irradiance /= f32(LOOKS);
    let mu = ask.direction.z;
    let strength = ask.strength.rgb;
    let at_base = transmittance_of_sun(ask.base_m, mu) * strength;
    let at_top = transmittance_of_sun(ask.top_m, mu) * strength;
    let at_ground = transmittance_of_sun(1.0, mu) * strength;
    if (ask.adds != 0u) {
        irradiance += light[0].sky_irradiance.rgb;
        light[0].sky_radiance += vec4<f32>(mean, 0.0);
        if (ask.beam_share > 0.0) {
            let beam = at_ground * ask.beam_share;
            light[0].sun_at_base = vec4<f32>(at_base * ask.beam_share, 0.0);
            light[0].sun_at_top = vec4<f32>(at_top * ask.beam_share, 0.0);
            light[0].sun_at_ground = vec4<f32>(beam, 0.0);
            light[0].ground_radiance = vec4<f32>(ask.ground_albedo.rgb / PI * (beam * max(mu, 0.0) + irradiance), 0.0);
        } else {
            let own = irradiance - light[0].sky_irradiance.rgb;
            light[0].ground_radiance += vec4<f32>(ask.ground_albedo.rgb / PI * (at_ground * max(mu, 0.0) + own), 0.0);
        }
        light[0].sky_irradiance = vec4<f32>(irradiance, 0.0);
        return;
    }
    let from_ground = ask.ground_albedo.rgb / PI * (at_ground * max(mu, 0.0) + irradiance);
    light[0].sun_at_base = vec4<f32>(at_base, 0.0);
    light[0].sun_at_top = vec4<f32>(at_top, 0.0);
    light[0].sun_at_ground = vec4<f32>(at_ground, 0.0);
    light[0].sky_radiance = vec4<f32>(mean, 0.0);
    light[0].sky_irradiance = vec4<f32>(irradiance, 0.0);
    light[0].ground_radiance = vec4<f32>(from_ground, 0.0);
}
