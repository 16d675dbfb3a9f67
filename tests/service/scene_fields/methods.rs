//! Methods by name: which are read, and which are refused where.

use serde_json::{Value, json};
use welkin_proto::validate::{Limits, parse_scene};

use super::{check, full};

#[test]
fn methods_are_read_and_judged() {
    let with = |methods: Value| {
        let mut scene = full();
        scene["methods"] = methods;
        scene
    };
    let good = with(
        json!({ "advection": "flux_form", "pressure": { "solver": "red_black_sor", "sweeps": 20, "relaxation": 1.7 } }),
    );
    parse_scene(&good.to_string(), &Limits::default()).expect("good methods");
    for good in [
        json!({ "scattering": "diffusion", "sun_occlusion": { "method": "beer_shadow_map", "side": 512 } }),
        json!({ "view_steps": { "steps": "by_optical_depth", "optical_depth": 0.25 }, "phase": { "function": "ice", "aspect_ratio": 2 } }),
        json!({ "scattering": "slab" }),
        json!({ "scattering": "slab_collector" }),
        json!({ "sun_occlusion": { "method": "secondary_march", "steps": 8 }, "phase": { "function": "mie", "effective_radius_um": 9 } }),
        json!({ "view_sampling": "half_resolution" }),
        json!({ "phase": { "function": "double_henyey_greenstein", "forward_asymmetry": 0.9, "backward_asymmetry": -0.4, "forward_share": 0.8 } }),
    ] {
        parse_scene(&with(good).to_string(), &Limits::default()).expect("good methods of light");
    }
    for (methods, code, pointer, part) in [
        (
            json!({ "advection": "upwind" }),
            "bad_scene",
            "/methods/advection",
            "semi_lagrangian_linear",
        ),
        (
            json!({ "viscosity": 1 }),
            "bad_scene",
            "/methods/viscosity",
            "unknown field",
        ),
        (
            json!({ "pressure": { "solver": "jacobi" } }),
            "bad_scene",
            "/methods/pressure",
            "`sweeps`",
        ),
        (
            json!({ "pressure": { "solver": "cg" } }),
            "bad_scene",
            "/methods/pressure/solver",
            "`multigrid`",
        ),
        (
            json!({ "pressure": { "solver": "direct", "sweeps": 3 } }),
            "bad_scene",
            "/methods/pressure/sweeps",
            "unknown field",
        ),
        (
            json!({ "pressure": { "solver": "jacobi", "sweeps": 0 } }),
            "out_of_range",
            "/methods/pressure/sweeps",
            "1 to 10000",
        ),
        (
            json!({ "pressure": { "solver": "red_black_sor", "sweeps": 10_001, "relaxation": 1.7 } }),
            "out_of_range",
            "/methods/pressure/sweeps",
            "1 to 10000",
        ),
        (
            json!({ "pressure": { "solver": "red_black_sor", "sweeps": 20, "relaxation": 2.0 } }),
            "out_of_range",
            "/methods/pressure/relaxation",
            "0.1 to 1.99",
        ),
        (
            json!({ "pressure": { "solver": "multigrid", "cycles": 101 } }),
            "out_of_range",
            "/methods/pressure/cycles",
            "1 to 100",
        ),
        (
            json!({ "scattering": "radiosity" }),
            "bad_scene",
            "/methods/scattering",
            "diffusion",
        ),
        (
            json!({ "sun_occlusion": { "method": "light_grid", "side": 512 } }),
            "bad_scene",
            "/methods/sun_occlusion/side",
            "unknown field",
        ),
        (
            json!({ "sun_occlusion": { "method": "secondary_march", "steps": 0 } }),
            "out_of_range",
            "/methods/sun_occlusion/steps",
            "1 to 512",
        ),
        (
            json!({ "sun_occlusion": { "method": "fourier_opacity_map", "side": 5000 } }),
            "out_of_range",
            "/methods/sun_occlusion/side",
            "16 to 4096",
        ),
        (
            json!({ "view_sampling": "quarter_resolution" }),
            "bad_scene",
            "/methods/view_sampling",
            "half_resolution",
        ),
        (
            json!({ "phase": { "function": "henyey_greenstein", "asymmetry": 1.0 } }),
            "out_of_range",
            "/methods/phase/asymmetry",
            "-0.999 to 0.999",
        ),
        (
            json!({ "phase": { "function": "mie", "effective_radius_um": 0.1 } }),
            "out_of_range",
            "/methods/phase/effective_radius_um",
            "1 to 50",
        ),
        (
            json!({ "view_steps": { "steps": "logarithmic_segments", "segments": 1 } }),
            "out_of_range",
            "/methods/view_steps/segments",
            "2 to 512",
        ),
        (
            json!({ "view_steps": { "steps": "by_optical_depth", "optical_depth": 5.0 } }),
            "out_of_range",
            "/methods/view_steps/optical_depth",
            "0.02 to 4",
        ),
        (
            json!({ "phase": { "function": "ice", "aspect_ratio": 30 } }),
            "out_of_range",
            "/methods/phase/aspect_ratio",
            "0.05 to 20",
        ),
        (
            json!({ "phase": { "function": "droplets", "diameter_um": 60 } }),
            "out_of_range",
            "/methods/phase/diameter_um",
            "5 to 50",
        ),
    ] {
        check(&with(methods), code, pointer, part);
    }
    let mut scene = full();
    scene["accuracy"] = json!("best");
    check(&scene, "bad_scene", "/accuracy", "fast");
    // A method of what the scene does not have is refused like any knob that nothing reads.
    let mut still = full();
    still["effects"] = json!({});
    for (methods, pointer, need) in [
        (json!({ "advection": "flux_form" }), "/methods/advection", "`flow`"),
        (
            json!({ "pressure": { "solver": "direct" } }),
            "/methods/pressure",
            "`flow`",
        ),
        (
            json!({ "scattering": "octaves" }),
            "/methods/scattering",
            "`multiple_scattering`",
        ),
        (
            json!({ "sun_occlusion": { "method": "light_grid" } }),
            "/methods/sun_occlusion",
            "`moisture`",
        ),
        (
            json!({ "phase": { "function": "rayleigh" } }),
            "/methods/phase",
            "`moisture`",
        ),
        (
            json!({ "view_sampling": "every_pixel" }),
            "/methods/view_sampling",
            "`moisture`",
        ),
    ] {
        still["methods"] = methods;
        check(&still, "effect_needs", pointer, need);
    }
}
