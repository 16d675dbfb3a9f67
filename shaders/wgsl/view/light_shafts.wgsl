//! use shared/atmosphere
//! use shared/phase
//! use shared/shape
//! use shared/light_words
//! use view/haze
//! use view/ground
// Stage `light_shafts`: the shadows that clouds throw into hazy air. The twin is cpu/view/light_shafts.rs.
// The module that uses it binds the uniforms `frame`, `light` and `shape`, and `light_words` and `shadow`, and has `slab`.

/// Radiance that shadows take from a ray whose cloud is `cloud_m` off and lets `through` pass.
fn shafts_taken(d: vec3<f32>, curve: f32, end_m: f32, turn: f32, pattern: f32, cloud_m: f32, through: f32) -> vec3<f32> {
    let o = frame.position_m.xyz;
    let reach = slab(o.z, d.z, curve, 0.0);
    let last = min(min(reach.y, end_m), SHAFT_REACH_M);
    let first = min(reach.x, max(last, 0.0));
    var sum = vec3<f32>(0.0);
    if (first >= last) {
        return sum;
    }
    let way = last - first;
    let once = rayleigh(turn);
    let droplets = henyey_greenstein(AEROSOL_ASYMMETRY, turn);
    let sun = frame.marched_beam.xyz;
    let bottom_m = max(shape.bottom_m, 1.0);
    // Diffuse light from above of irradiance 1 is a fluence of 2, of which a share 1 / 4 pi goes each way.
    let even = GROUND_DIFFUSE_SHARE * 2.0 * max(frame.beam_direction.z, 0.0) / (4.0 * PI);
    let part = 1.0 / f32(frame.shaft_samples);
    for (var n = 0u; n < frame.shaft_samples; n++) {
        let u = (pattern + f32(n)) * part;
        let t = first + way * u * u;
        let length = way * u * (2.0 * part);
        let p = vec3<f32>(d.xy * t + o.xy, t * (d.z + curve * t) + o.z);
        let below = shape.bottom_m - p.z;
        var depth = 0.0;
        if (below > 0.0) {
            depth = shadow_depth(p.xy + below / sun.z * sun.xy);
        } else {
            depth = depth_towards_beam(p);
        }
        let blocked = 1.0 - exp(-depth);
        let spread = blocked * even / (depth * DIFFUSE_VISIBILITY + 1.0);
        let climb = p.z - o.z;
        let air = exp(-climb / RAYLEIGH_HEIGHT_M) * (once * blocked - spread);
        let aerosol = exp(-climb / AEROSOL_HEIGHT_M) * (droplets * blocked - spread) * (frame.haze_per_m.w * AEROSOL_ALBEDO);
        let low = clamp(p.z / bottom_m, 0.0, 1.0);
        let high = clamp((p.z - shape.bottom_m) / (shape.top_m - shape.bottom_m), 0.0, 1.0);
        let beam = low * (light.sun_at_base.rgb - light.sun_at_ground.rgb)
            + high * (light.sun_at_top.rgb - light.sun_at_base.rgb) + light.sun_at_ground.rgb;
        sum += (air * frame.haze_per_m.rgb + aerosol) * haze_transmittance(t, d.z) * beam
            * (select(through, 1.0, t < cloud_m) * length);
    }
    return sum;
}
