//! use shared/shape
//! use shared/detail
// The cloud's extinction with its detail. The twin is in cpu/view/march.rs. The module that uses it binds `frame` with what the detail is told.

/// Extinction with detail, 1/m, `t` from the camera; `near` looks the small billows up a second time.
fn extinction(p: vec3<f32>, t: f32, near: bool) -> f32 {
    return carved_extinction(shape_sample(p), p, t, near);
}

/// The same where cover and amplitude are known.
fn carved_extinction(s: vec2<f32>, p: vec3<f32>, t: f32, near: bool) -> f32 {
    let plain = s.y * s.x;
    if (frame.detail_blend == 0.0) {
        return plain;
    }
    let q = (p + frame.detail_offset_m.xyz) * frame.detail_tiles_per_m;
    let noise = detail_look(q) - 0.5;
    let far = clamp(t / DETAIL_SMALL_REACH_M, 0.0, 1.0);
    var push = noise.x + noise.y * DETAIL_SMALL * (1.0 - far);
    if (near) {
        let finer = detail_look(q.yzx * DETAIL_FINER) - 0.5;
        push += (finer.x * DETAIL_FINE + finer.y * DETAIL_FINEST) * clamp(1.0 - t / NEAR_DETAIL_M, 0.0, 1.0);
    }
    let held = clamp(s.x * DETAIL_HELD, 0.0, 1.0);
    let level = s.x + push * frame.detail_push * held - CARVE_EDGE;
    return mix(plain, s.y * smooth_ramp(level / CARVE_RAMP), frame.detail_blend);
}
