//! use shared/sky_radiance
// Stage `sky_table`: one texel an invocation; the moon's stand behind the sun's.

@group(0) @binding(0) var<uniform> air: Air;
@group(0) @binding(1) var<uniform> view: SkyView;
@group(0) @binding(2) var<storage, read> transmittance_table: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> multiple_scattering_table: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> table: array<vec4<f32>>;

@compute @workgroup_size(64)
fn sky(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = id.x;
    if (n >= 2u * SKY_HALF_ROWS * SKY_COLUMNS) {
        return;
    }
    let row = n / SKY_COLUMNS;
    let x = f32(n % SKY_COLUMNS) / f32(SKY_COLUMNS - 1u);
    let below = row < SKY_HALF_ROWS;
    let v = f32(row % SKY_HALF_ROWS) / f32(SKY_HALF_ROWS - 1u);
    let horizon = view.horizon_sine;
    let sine = select(horizon + v * v * (1.0 - horizon), horizon - v * v * (1.0 + horizon), below);
    let side = sqrt(max(1.0 - sine * sine, 0.0));
    let cosine = 1.0 - 2.0 * x * x;
    let direction = vec3<f32>(side * cosine, side * sqrt(max(1.0 - cosine * cosine, 0.0)), sine);
    // Azimuths are counted from the source's.
    let turned = vec3<f32>(length(view.direction.xy), 0.0, view.direction.z);
    let source = SkySource(turned, view.strength.rgb, view.scattered_glow.rgb, view.layer_glow.rgb);
    table[n + view.first_texel] = vec4<f32>(sky_radiance(air, view.height_m, direction, source, below), 0.0);
}
