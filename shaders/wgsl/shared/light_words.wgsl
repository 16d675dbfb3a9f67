//! use shared/shape
// Lookups in the words of stage `sun_optical_depth`. The module that uses it binds the uniform `shape`, and `light_words`.

/// The words around a place: those of the level below and those above, and where between them it is.
struct LightAround {
    low: vec4<u32>,
    high: vec4<u32>,
    fraction: vec3<f32>,
}

fn light_around(p: vec3<f32>) -> LightAround {
    let place = shape_place(p);
    let row = shape.stride_x;
    let i = place.index;
    let j = i + row * shape.stride_y;
    let low = vec4<u32>(light_words[i], light_words[i + 1u], light_words[i + row], light_words[i + row + 1u]);
    let high = vec4<u32>(light_words[j], light_words[j + 1u], light_words[j + row], light_words[j + row + 1u]);
    return LightAround(low, high, place.fraction);
}

/// Optical depth towards the beam.
fn beam_depth(around: LightAround) -> f32 {
    let deep = vec4<u32>(0xffffu);
    return DEPTH_UNIT * trilinear(vec4<f32>(around.low & deep), vec4<f32>(around.high & deep), around.fraction);
}

/// Share of diffuse light that comes from above.
fn sky_share(around: LightAround) -> f32 {
    let byte = vec4<u32>(0xffu);
    let low = (around.low >> vec4<u32>(16u)) & byte;
    let high = (around.high >> vec4<u32>(16u)) & byte;
    return (1.0 / 255.0) * trilinear(vec4<f32>(low), vec4<f32>(high), around.fraction);
}

/// Share of diffuse light that comes from below.
fn ground_share(around: LightAround) -> f32 {
    return (1.0 / 255.0) * trilinear(vec4<f32>(around.low >> vec4<u32>(24u)), vec4<f32>(around.high >> vec4<u32>(24u)), around.fraction);
}

/// Optical depth towards the beam at a place.
fn depth_towards_beam(p: vec3<f32>) -> f32 {
    return beam_depth(light_around(p));
}
