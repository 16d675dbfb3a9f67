//! Every number of a scene has a range, and is refused outside of it at its place.

use serde_json::{Value, json};
use welkin_proto::validate::{Limits, parse_scene};

use super::{check, full, full_of_viscosity, full_with, spoilt};

#[test]
fn every_number_has_a_range() {
    // Pointer, a value just below and just above what is allowed, and a part of the range that the message must name.
    let ranges = [
        ("/domain/cells/0", json!(0), json!(1025), "1 to 1024"),
        ("/domain/cells/1", json!(0), json!(4_000_000_000_u32), "1 to 1024"),
        ("/domain/cells/2", json!(1), json!(1025), "two levels"),
        ("/domain/cell_size_m/0", json!(0.0), json!(100_001.0), "0.1 to 100000"),
        ("/domain/cell_size_m/1", json!(-100.0), json!(1e300), "0.1 to 100000"),
        ("/domain/cell_size_m/2", json!(0.09), json!(1000.0), "0."),
        ("/domain/latitude_deg", json!(-90.1), json!(91.0), "-90 to 90"),
        ("/domain/longitude_deg", json!(-181.0), json!(360.0), "-180 to 180"),
        (
            "/domain/surface_altitude_m",
            json!(-501.0),
            json!(9001.0),
            "-500 to 9000",
        ),
        ("/time/tick_s", json!(0.0), json!(601.0), "0.01 to 600"),
        ("/time/time_scale", json!(-1.0), json!(1001.0), "0.01 to 1000"),
        ("/time/spin_up_s", json!(-1.0), json!(1e7), "0 to 1000000"),
        (
            "/base_state/surface_pressure_pa",
            json!(0.0),
            json!(120_000.0),
            "30000 to 110000",
        ),
        ("/base_state/levels/1/height_m", json!(-1.0), json!(1e6), "0 to 100000"),
        (
            "/base_state/levels/1/liquid_water_potential_temperature_k",
            json!(25.0),
            json!(3000.0),
            "150 to 2000",
        ),
        (
            "/base_state/levels/1/total_water_kg_per_kg",
            json!(-0.001),
            json!(16.3),
            "0 to 0.05",
        ),
        (
            "/base_state/levels/1/wind_x_m_s",
            json!(-151.0),
            json!(151.0),
            "-150 to 150",
        ),
        (
            "/base_state/levels/1/wind_y_m_s",
            json!(-151.0),
            json!(151.0),
            "-150 to 150",
        ),
        ("/effects/flow/courant_max", json!(0.0), json!(50.1), "0.05 to 50"),
        (
            "/effects/moisture/droplet_number_per_m3",
            json!(0.0),
            json!(1e12),
            "1000000 to 10000000000",
        ),
        (
            "/effects/turbulence/smagorinsky_coefficient",
            json!(-0.1),
            json!(0.6),
            "0 to 0.5",
        ),
        (
            "/effects/turbulence/turbulent_prandtl_number",
            json!(0.0),
            json!(11.0),
            "0.1 to 10",
        ),
        (
            "/effects/constant_viscosity/viscosity_m2_s",
            json!(-1.0),
            json!(2e5),
            "0 to 100000",
        ),
        (
            "/effects/constant_viscosity/diffusivity_m2_s",
            json!(-1.0),
            json!(2e5),
            "0 to 100000",
        ),
        (
            "/effects/body_force/lower_m/0",
            json!(-2e6),
            json!(2e6),
            "-1000000 to 1000000",
        ),
        (
            "/effects/body_force/upper_m/2",
            json!(-2e6),
            json!(2e6),
            "-1000000 to 1000000",
        ),
        (
            "/effects/body_force/acceleration_m_s2/1",
            json!(-11.0),
            json!(11.0),
            "-10 to 10",
        ),
        ("/effects/body_force/drag_per_s", json!(-0.1), json!(11.0), "0 to 10"),
        ("/effects/surface/heat_flux_k_m_s", json!(-1.1), json!(15.0), "-1 to 1"),
        (
            "/effects/surface/moisture_flux_m_s",
            json!(-0.1),
            json!(115.0),
            "-0.001 to 0.001",
        ),
        (
            "/effects/surface/friction_velocity_m_s",
            json!(-0.1),
            json!(4.0),
            "0 to 3",
        ),
        (
            "/effects/coriolis/parameter_per_s",
            json!(-1.0),
            json!(1.0),
            "-0.001 to 0.001",
        ),
        (
            "/effects/coriolis/geostrophic_wind_x_m_s/0/1",
            json!(-151.0),
            json!(151.0),
            "-150 to 150",
        ),
        (
            "/effects/coriolis/geostrophic_wind_y_m_s/0/1",
            json!(-151.0),
            json!(151.0),
            "-150 to 150",
        ),
        (
            "/effects/coriolis/geostrophic_wind_y_m_s/0/0",
            json!(-1.0),
            json!(1e6),
            "0 to 100000",
        ),
        (
            "/effects/large_scale/vertical_wind_m_s/1/1",
            json!(-2.0),
            json!(2.0),
            "-1 to 1",
        ),
        (
            "/effects/large_scale/heating_k_per_s/1/1",
            json!(-2.0),
            json!(2.0),
            "-0.01 to 0.01",
        ),
        (
            "/effects/large_scale/moistening_per_s/1/1",
            json!(-1.0),
            json!(1.0),
            "-0.00001 to 0.00001",
        ),
        ("/effects/sponge/depth_m", json!(0.0), json!(3001.0), "to 3000"),
        ("/effects/sponge/rate_per_s", json!(-0.1), json!(2.0), "0 to 1"),
        ("/effects/noise/depth_m", json!(-1.0), json!(1e6), "0 to 100000"),
        (
            "/effects/noise/potential_temperature_k",
            json!(-0.1),
            json!(11.0),
            "0 to 10",
        ),
        (
            "/effects/noise/total_water_kg_per_kg",
            json!(-1e-5),
            json!(0.025),
            "0 to 0.01",
        ),
        (
            "/effects/bubble/centre_m/0",
            json!(-2e6),
            json!(2e6),
            "-1000000 to 1000000",
        ),
        ("/effects/bubble/radius_m/1", json!(0.0), json!(2e6), "0.1 to 1000000"),
        (
            "/effects/bubble/potential_temperature_k",
            json!(-51.0),
            json!(300.0),
            "-50 to 50",
        ),
        ("/effects/bubble/temperature_k", json!(-51.0), json!(51.0), "-50 to 50"),
        (
            "/effects/bubble/virtual_potential_temperature_share",
            json!(-0.3),
            json!(0.3),
            "-0.2 to 0.2",
        ),
        (
            "/effects/bubble/total_water_kg_per_kg",
            json!(-1.0),
            json!(1.0),
            "-0.05 to 0.05",
        ),
        ("/effects/cloud_detail/strength", json!(-0.1), json!(1.1), "0 to 1"),
        ("/effects/cloud_detail/scale_m", json!(0.0), json!(1e6), "1 to 100000"),
        ("/effects/multiple_scattering/octaves", json!(0), json!(9), "1 to 8"),
        ("/effects/light_shafts/samples", json!(3), json!(129), "4 to 128"),
        (
            "/effects/aerial_perspective/visibility_m",
            json!(0.0),
            json!(1e9),
            "50 to 1000000",
        ),
        ("/effects/moon/elevation_deg", json!(-91.0), json!(91.0), "-90 to 90"),
        ("/effects/moon/azimuth_deg", json!(-721.0), json!(721.0), "-720 to 720"),
        ("/effects/stars/faintest_magnitude", json!(-2.1), json!(6.1), "-2 to 6"),
        ("/sun/elevation_deg", json!(-91.0), json!(91.0), "-90 to 90"),
        ("/sun/azimuth_deg", json!(-721.0), json!(721.0), "-720 to 720"),
        ("/camera/position_m/0", json!(-2e6), json!(2e6), "-1000000 to 1000000"),
        ("/camera/position_m/1", json!(-2e6), json!(2e6), "-1000000 to 1000000"),
        ("/camera/position_m/2", json!(-2e6), json!(2e6), "-1000000 to 1000000"),
        ("/camera/azimuth_deg", json!(-721.0), json!(721.0), "-720 to 720"),
        ("/camera/elevation_deg", json!(-91.0), json!(91.0), "-90 to 90"),
        ("/camera/vertical_fov_deg", json!(0.0), json!(180.0), "1 to 150"),
        ("/camera/exposure_ev", json!(-21.0), json!(21.0), "-20 to 20"),
    ];
    for (pointer, below, above, part) in &ranges {
        for value in [below, above] {
            let document = spoilt(full_with(pointer), pointer, value.clone());
            check(&document, "out_of_range", pointer, part);
        }
    }
    // Nothing numeric is left out: every number of the full scene lies at a pointer above, but for those judged elsewhere.
    let mut numbers = Vec::new();
    collect_numbers(&full(), String::new(), &mut numbers);
    collect_numbers(&full_of_viscosity(), String::new(), &mut numbers);
    let covered: Vec<String> = ranges.iter().map(|(pointer, ..)| without_indices(pointer)).collect();
    for pointer in numbers {
        let place = without_indices(&pointer);
        assert!(
            covered.contains(&place) || ["/version", "/seed"].contains(&place.as_str()),
            "{pointer} has no range tested"
        );
    }
}

fn collect_numbers(value: &Value, at: String, found: &mut Vec<String>) {
    match value {
        Value::Number(_) => found.push(at),
        Value::Object(object) => object
            .iter()
            .for_each(|(key, inner)| collect_numbers(inner, format!("{at}/{key}"), found)),
        Value::Array(list) => {
            list.iter()
                .enumerate()
                .for_each(|(i, inner)| collect_numbers(inner, format!("{at}/{i}"), found));
        }
        _ => {}
    }
}

fn without_indices(pointer: &str) -> String {
    pointer
        .split('/')
        .filter(|part| part.parse::<usize>().is_err())
        .collect::<Vec<_>>()
        .join("/")
}

#[test]
fn other_base_states_have_ranges_too() {
    let with = |base: Value| spoilt(full(), "/base_state", base);
    let stable = json!({
        "kind": "constant_stability", "surface_pressure_pa": 1e5, "surface_potential_temperature_k": 300.0,
        "buoyancy_frequency_per_s": 0.01, "relative_humidity": 0.5, "wind_x_m_s": 0.0, "wind_y_m_s": 0.0
    });
    let neutral = json!({
        "kind": "isentropic", "surface_pressure_pa": 1e5, "potential_temperature_k": 300.0, "wind_x_m_s": 0.0, "wind_y_m_s": 0.0
    });
    let deep = json!({
        "kind": "weisman_klemp", "surface_pressure_pa": 1e5, "mixing_ratio_cap_kg_per_kg": 0.014, "wind_shear_m_s": 10.0
    });
    let cloud = json!({
        "kind": "saturated_neutral", "surface_pressure_pa": 1e5, "surface_equivalent_potential_temperature_k": 320.0,
        "total_water_mixing_ratio_kg_per_kg": 0.02, "wind_x_m_s": 0.0, "wind_y_m_s": 0.0
    });
    for (base, field, below, above) in [
        (&cloud, "surface_pressure_pa", 1013.0, 1e6),
        (&cloud, "surface_equivalent_potential_temperature_k", 20.0, 500.0),
        (&cloud, "total_water_mixing_ratio_kg_per_kg", -0.01, 20.0),
        (&cloud, "wind_x_m_s", -200.0, 200.0),
        (&cloud, "wind_y_m_s", -200.0, 200.0),
        (&stable, "surface_pressure_pa", -1.0, 1e6),
        (&stable, "surface_potential_temperature_k", 20.0, 500.0),
        (&stable, "buoyancy_frequency_per_s", -0.01, 1.0),
        (&stable, "relative_humidity", -0.1, 80.0),
        (&stable, "wind_x_m_s", -200.0, 200.0),
        (&stable, "wind_y_m_s", -200.0, 200.0),
        (&neutral, "surface_pressure_pa", 1013.0, 1e6),
        (&neutral, "potential_temperature_k", 20.0, 500.0),
        (&neutral, "wind_x_m_s", -200.0, 200.0),
        (&neutral, "wind_y_m_s", -200.0, 200.0),
        (&deep, "surface_pressure_pa", 0.0, 1e6),
        (&deep, "mixing_ratio_cap_kg_per_kg", -0.1, 14.0),
        (&deep, "wind_shear_m_s", -200.0, 200.0),
    ] {
        parse_scene(&with(base.clone()).to_string(), &Limits::default()).expect("good before it is spoilt");
        for value in [below, above] {
            let pointer = format!("/base_state/{field}");
            check(
                &spoilt(with(base.clone()), &pointer, json!(value)),
                "out_of_range",
                &pointer,
                &value.to_string(),
            );
        }
    }
    check(
        &with(json!({ "kind": "sounding", "text": "" })),
        "bad_sounding",
        "/base_state/text",
        "empty",
    );
}
