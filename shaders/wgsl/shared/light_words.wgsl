//! use shared/shape
// Lookups in the words of stage `sun_optical_depth`. The module that uses it binds the uniform `shape`, and `light_words`.

/// Optical depth towards the beam.
fn depth_towards_beam(p: vec3<f32>) -> f32 {
    let place = shape_place(p);
    let row = shape.stride_x;
    let i = place.index;
    let j = i + row * shape.stride_y;
    let deep = vec4<u32>(0xffffu);
    let low = vec4<u32>(light_words[i], light_words[i + 1u], light_words[i + row], light_words[i + row + 1u]);
    let high = vec4<u32>(light_words[j], light_words[j + 1u], light_words[j + row], light_words[j + row + 1u]);
    return DEPTH_UNIT * trilinear(vec4<f32>(low & deep), vec4<f32>(high & deep), place.fraction);
}
