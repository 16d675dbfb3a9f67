//! Scenes: every preset holds, every bad value is refused at its place, every field is read by something.

use serde_json::{Value, json};
use welkin_proto::scene::Scene;
use welkin_proto::validate::{self, Limits, parse_scene};
use welkin_proto::wire::Command;
use welkin_proto::{ApiError, presets};

#[path = "scene_fields/methods.rs"]
mod methods;
#[path = "scene_fields/ranges.rs"]
mod ranges;
#[path = "scene_fields/reading.rs"]
mod reading;

/// A scene that names every effect, to be spoilt in one place.
fn full() -> Value {
    let mut scene: Value = serde_json::from_str(presets::all()[0].json).expect("the default preset is JSON");
    scene["effects"]["bubble"] = json!({
        "centre_m": [3200.0, 3200.0, 900.0], "radius_m": [800.0, 800.0, 800.0],
        "potential_temperature_k": 2.0, "total_water_kg_per_kg": 0.001, "temperature_k": 0.1,
        "virtual_potential_temperature_share": 0.001
    });
    scene["effects"]["body_force"] = json!({
        "lower_m": [0.0, 0.0, 0.0], "upper_m": [500.0, 6400.0, 3000.0],
        "acceleration_m_s2": [0.01, 0.0, 0.0], "drag_per_s": 0.001
    });
    scene["effects"]["moon"] = json!({ "from": "fixed", "elevation_deg": 30.0, "azimuth_deg": 200.0 });
    scene["effects"]["light_shafts"] = json!({ "samples": 24 });
    scene["effects"]["multiple_scattering"] = json!({ "octaves": 6 });
    scene["effects"]["stars"] = json!({ "faintest_magnitude": 5.5 });
    scene["sun"] = json!({ "from": "fixed", "elevation_deg": 45.0, "azimuth_deg": 120.0 });
    scene
}

/// The same with the effect that excludes one of the others.
fn full_of_viscosity() -> Value {
    let mut scene = full();
    scene["effects"]
        .as_object_mut()
        .expect("an object")
        .remove("turbulence");
    scene["effects"]["constant_viscosity"] =
        json!({ "viscosity_m2_s": 75.0, "diffusivity_m2_s": 75.0, "scheme": "explicit" });
    scene
}

/// The full scene that has something at `pointer`.
fn full_with(pointer: &str) -> Value {
    if pointer.contains("constant_viscosity") {
        full_of_viscosity()
    } else {
        full()
    }
}

/// The document with one value set (or, with `null`, removed) at a pointer.
fn spoilt(mut document: Value, pointer: &str, value: Value) -> Value {
    let (parent, key) = pointer.rsplit_once('/').expect("a pointer");
    let parent = document
        .pointer_mut(parent)
        .unwrap_or_else(|| panic!("{pointer}: no such parent"));
    match parent {
        Value::Object(object) if value.is_null() => {
            object
                .remove(key)
                .unwrap_or_else(|| panic!("{pointer}: nothing there to remove"));
        }
        Value::Object(object) => {
            object.insert(key.to_owned(), value);
        }
        Value::Array(list) => list[key.parse::<usize>().expect("an index")] = value,
        _ => panic!("{pointer}: not in a container"),
    }
    document
}

fn refusal(document: &Value) -> ApiError {
    parse_scene(&document.to_string(), &Limits::default()).expect_err("must be refused")
}

fn check(document: &Value, code: &str, pointer: &str, part: &str) {
    let error = refusal(document);
    assert_eq!(error.code, code, "{pointer}: {error}");
    assert_eq!(error.pointer.as_deref(), Some(pointer), "{error}");
    assert!(error.message.contains(part), "{pointer}: {part:?} is not in {error}");
}

#[test]
fn presets_hold() {
    let names: Vec<&str> = presets::all().iter().map(|preset| preset.name).collect();
    for wanted in ["fair-weather-cumulus", "warm-bubble", "stratocumulus", "clear-sky-wind"] {
        assert!(names.contains(&wanted), "{wanted} is not among {names:?}");
    }
    assert_eq!(names[0], presets::DEFAULT);
    for preset in presets::all() {
        let scene =
            parse_scene(preset.json, &Limits::default()).unwrap_or_else(|error| panic!("{}: {error}", preset.name));
        assert_eq!(scene.name, preset.name);
        assert!(
            !scene.description.is_empty(),
            "{} needs a line for the list",
            preset.name
        );
        assert_eq!(presets::find(preset.name).expect("it is there"), scene);
        let text = serde_json::to_string(&scene).expect("a scene is JSON");
        assert_eq!(parse_scene(&text, &Limits::default()).expect("our own text"), scene);
    }
    let error = presets::find("no such sky").expect_err("unknown");
    assert_eq!(error.code, "unknown_preset");
    assert!(names.iter().all(|name| error.message.contains(name)), "{error}");
}

#[test]
fn the_full_scene_is_good() {
    let scene = parse_scene(&full().to_string(), &Limits::default()).expect("a good scene");
    let other = parse_scene(&full_of_viscosity().to_string(), &Limits::default()).expect("a good scene");
    let [effects, others] = [scene, other].map(|s| serde_json::to_value(&s.effects).expect("JSON"));
    for (name, block) in effects.as_object().expect("an object") {
        let there = !block.is_null() || !others[name].is_null();
        assert!(there, "{name} is missing: its bad values would go untested");
    }
}

#[test]
fn the_shape_is_judged_place_by_place() {
    let cases = [
        ("/domian", json!({}), "/domian", "unknown field `domian`"),
        ("/domain/cells", Value::Null, "/domain", "lacks the field `cells`"),
        ("/domain/cells", json!([64, 64]), "/domain/cells", "3 values"),
        ("/domain/cells/0", json!(64.5), "/domain/cells/0", "whole number"),
        ("/domain/cells/0", json!(-64), "/domain/cells/0", "whole number"),
        ("/domain/cells/0", json!(1e12 as u64), "/domain/cells/0", "whole number"),
        ("/domain/cell_size_m/1", json!("100"), "/domain/cell_size_m/1", "number"),
        ("/seed", json!(-1), "/seed", "whole number"),
        ("/name", json!(7), "/name", "a text"),
        ("/time/tick_s", json!([2]), "/time/tick_s", "a number"),
        (
            "/base_state/kind",
            json!("anelastic"),
            "/base_state/kind",
            "`weisman_klemp`",
        ),
        ("/base_state/kind", Value::Null, "/base_state", "lacks `kind`"),
        (
            "/base_state/levels/2/height_m",
            json!("high"),
            "/base_state/levels/2/height_m",
            "number",
        ),
        (
            "/base_state/levels/2/height_m",
            Value::Null,
            "/base_state/levels/2",
            "`height_m`",
        ),
        (
            "/base_state/levels/2/hieght_m",
            json!(1.0),
            "/base_state/levels/2/hieght_m",
            "unknown field",
        ),
        ("/effects/rain", json!({}), "/effects/rain", "unknown field `rain`"),
        (
            "/effects/heat",
            json!({ "a/b~c": 1 }),
            "/effects/heat/a~1b~0c",
            "unknown field",
        ),
        ("/effects/heat", json!(true), "/effects/heat", "an object"),
        (
            "/effects/flow/courant_max",
            Value::Null,
            "/effects/flow",
            "lacks the field",
        ),
        (
            "/effects/large_scale/heating_k_per_s/1",
            json!([1.0]),
            "/effects/large_scale/heating_k_per_s/1",
            "2 values",
        ),
        ("/sun/from", json!("moon"), "/sun/from", "`clock`"),
        ("/camera", json!([]), "/camera", "an object"),
        ("/camera/roll_deg", json!(3.0), "/camera/roll_deg", "unknown field"),
    ];
    for (place, value, pointer, part) in cases {
        check(&spoilt(full(), place, value), "bad_scene", pointer, part);
    }
    check(&json!([]), "bad_scene", "", "an object");
}

#[test]
fn what_is_not_json() {
    let text = full().to_string();
    let limits = Limits::default();
    for (bad, place) in [
        (String::new(), "line 1, column 0"),
        ("{".to_owned(), "line 1, column 1"),
        (text[..text.len() / 2].to_owned(), "line 1"),
        (text.replace("\"spin_up_s\":3600.0", "\"spin_up_s\":NaN"), "line 1"),
        (text.replace("\"spin_up_s\":3600.0", "\"spin_up_s\":1e999"), "line 1"),
        (text.replace("\"spin_up_s\":3600.0", "\"spin_up_s\":Infinity"), "line 1"),
        (format!("{text}x"), "line 1"),
        ("[".repeat(100_000), "line 1"),
        ("{\n  \"version\": 1,\n  oops\n}".to_owned(), "line 3, column 3"),
    ] {
        let error = parse_scene(&bad, &limits).expect_err("not JSON");
        assert_eq!(error.code, "bad_json", "{error}");
        assert!(error.message.contains(place), "{place}: {error}");
    }
    // JSON lets a key stand twice; a scene does not.
    let twice = text.replacen("\"seed\":1", "\"seed\":1,\"seed\":2", 1);
    assert_ne!(twice, text);
    let error = parse_scene(&twice, &limits).expect_err("which seed?");
    assert!(
        error.code == "bad_scene" && error.message.contains("duplicate field `seed`"),
        "{error}"
    );
    let large = format!("{text}{}", " ".repeat(limits.max_scene_bytes));
    assert_eq!(parse_scene(&large, &limits).expect_err("too large").code, "too_large");
}

#[test]
fn versions_orders_times_and_sizes() {
    check(
        &spoilt(full(), "/version", json!(2)),
        "unknown_version",
        "/version",
        "reads version 1",
    );
    check(
        &spoilt(full(), "/version", json!(0)),
        "unknown_version",
        "/version",
        "version 0",
    );
    check(
        &json!({ "version": 9, "sky": "blue" }),
        "unknown_version",
        "/version",
        "version 9",
    );
    for time in ["yesterday", "2026-06-21T16:00:00", "2026-02-30T16:00:00Z"] {
        check(
            &spoilt(full(), "/time/start_utc", json!(time)),
            "bad_time",
            "/time/start_utc",
            time,
        );
    }
    for (place, value) in [
        ("/base_state/levels/2/height_m", json!(520.0)),
        ("/base_state/levels/3/height_m", json!(1.0)),
        ("/effects/coriolis/geostrophic_wind_x_m_s/1/0", json!(0.0)),
        ("/effects/large_scale/vertical_wind_m_s/2/0", json!(1500.0)),
        ("/effects/large_scale/heating_k_per_s/2/0", json!(3.0)),
        ("/effects/large_scale/moistening_per_s/1/0", json!(0.0)),
    ] {
        check(&spoilt(full(), place, value), "not_rising", place, "must be above");
    }
    check(
        &spoilt(full(), "/domain/cells", json!([512, 512, 512])),
        "out_of_range",
        "/domain/cells",
        "16777216",
    );
    let one_level = json!([full()["base_state"]["levels"][0]]);
    check(
        &spoilt(full(), "/base_state/levels", one_level),
        "out_of_range",
        "/base_state/levels",
        "1 rows",
    );
    let place = "/effects/coriolis/geostrophic_wind_x_m_s";
    check(&spoilt(full(), place, json!([])), "out_of_range", place, "0 rows");
    check(&spoilt(full(), "/name", json!("")), "out_of_range", "/name", "1 to 100");
    check(
        &spoilt(full(), "/description", json!("x".repeat(2001))),
        "out_of_range",
        "/description",
        "2000",
    );
}

#[test]
fn effects_need_each_other() {
    // With one effect taken away, the first that needs it is named.
    for (gone, pointer, need) in [
        ("flow", "/effects/heat", "`flow`"),
        ("heat", "/effects/moisture", "`heat`"),
        ("moisture", "/effects/cloud_detail", "`moisture`"),
    ] {
        check(
            &spoilt(full(), &format!("/effects/{gone}"), Value::Null),
            "effect_needs",
            pointer,
            need,
        );
    }
    // And each alone, without what it needs.
    for (alone, need) in [
        ("heat", "flow"),
        ("moisture", "heat"),
        ("turbulence", "flow"),
        ("surface", "flow"),
        ("coriolis", "flow"),
        ("large_scale", "heat"),
        ("sponge", "flow"),
        ("noise", "heat"),
        ("bubble", "heat"),
        ("cloud_detail", "moisture"),
        ("multiple_scattering", "moisture"),
        ("cloud_shadow", "moisture"),
        ("light_shafts", "moisture"),
    ] {
        let mut scene = full();
        scene["effects"] = json!({ alone: full()["effects"][alone] });
        check(
            &scene,
            "effect_needs",
            &format!("/effects/{alone}"),
            &format!("`{need}`"),
        );
    }
    // A number that would do nothing.
    for (effect, field, keep) in [
        ("surface", "heat_flux_k_m_s", vec!["flow"]),
        ("surface", "moisture_flux_m_s", vec!["flow", "heat"]),
        ("large_scale", "moistening_per_s", vec!["flow", "heat"]),
        ("noise", "total_water_kg_per_kg", vec!["flow", "heat"]),
        ("bubble", "total_water_kg_per_kg", vec!["flow", "heat"]),
    ] {
        let mut scene = full();
        scene["effects"] = json!({ effect: full()["effects"][effect] });
        for name in keep {
            scene["effects"][name] = full()["effects"][name].clone();
        }
        check(
            &scene,
            "effect_needs",
            &format!("/effects/{effect}/{field}"),
            "needs the effect",
        );
    }
}

#[test]
fn values_that_json_cannot_say() {
    // A scene made in code can hold what a text cannot.
    let good: Scene = serde_json::from_value(full()).expect("a scene");
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut scene = good.clone();
        scene.camera.position_m[1] = value;
        let error = validate::validate(&scene, &Limits::default()).expect_err("not finite");
        assert_eq!(
            (error.code.as_str(), error.pointer.as_deref()),
            ("out_of_range", Some("/camera/position_m/1"))
        );
    }
}

#[test]
fn commands_have_ranges() {
    for (command, pointer) in [
        (json!({ "command": "time_scale", "time_scale": 0.0 }), "/time_scale"),
        (
            json!({ "command": "wind", "add_x_m_s": 0.0, "add_y_m_s": 1e9 }),
            "/add_y_m_s",
        ),
        (
            json!({ "command": "sun", "sun": { "from": "fixed", "elevation_deg": 100.0, "azimuth_deg": 0.0 } }),
            "/sun/elevation_deg",
        ),
    ] {
        let command: Command = serde_json::from_value(command).expect("a command");
        let error = validate::command(&command).expect_err("out of range");
        assert_eq!(
            (error.code.as_str(), error.pointer.as_deref()),
            ("out_of_range", Some(pointer))
        );
    }
    validate::command(&Command::Pause {}).expect("nothing to refuse");
}

#[test]
fn only_one_effect_may_mix_and_a_region_has_a_size() {
    let mut both = full_of_viscosity();
    both["effects"]["turbulence"] = full()["effects"]["turbulence"].clone();
    check(&both, "effect_conflict", "/effects/constant_viscosity", "`turbulence`");
    let mut cold = full_of_viscosity();
    cold["effects"] =
        json!({ "flow": { "courant_max": 1.0 }, "constant_viscosity": cold["effects"]["constant_viscosity"] });
    check(
        &cold,
        "effect_needs",
        "/effects/constant_viscosity/diffusivity_m2_s",
        "`heat`",
    );
    cold["effects"]["constant_viscosity"] = json!({ "viscosity_m2_s": 75.0, "scheme": "implicit" });
    parse_scene(&cold.to_string(), &Limits::default()).expect("a viscosity alone is good");
    for effect in ["constant_viscosity", "body_force"] {
        let mut still = full_with(effect);
        still["effects"] = json!({ effect: still["effects"][effect] });
        check(&still, "effect_needs", &format!("/effects/{effect}"), "`flow`");
    }
    let scheme = "/effects/constant_viscosity/scheme";
    check(
        &spoilt(full_of_viscosity(), scheme, json!("crank_nicolson")),
        "bad_scene",
        scheme,
        "implicit",
    );
    let upper = "/effects/body_force/upper_m/1";
    check(&spoilt(full(), upper, json!(0.0)), "not_rising", upper, "lower");
}
