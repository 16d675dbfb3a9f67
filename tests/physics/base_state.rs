//! The base state against analytic profiles, published parcels and two real soundings.

use welkin_proto::report::BaseStateReport;
use welkin_proto::scene::{BaseState as SceneBase, Scene};
use welkin_proto::{presets, sounding};
use welkin_server::base_state::{self, BaseState, lifting_condensation_level, saturated_ascent};
use welkin_shaders::constants as c;

const OMAHA: &str = include_str!("../fixtures/soundings/oax_2014-06-16_19z.spc.txt");
const NORMAN: &str = include_str!("../fixtures/soundings/oun_2018-12-22_12z.uwyo.html");

/// The default scene with other air and levels.
fn scene(base_state: SceneBase, levels: u32, level_m: f64) -> Scene {
    let mut scene = presets::find(presets::DEFAULT).expect("the default preset");
    scene.base_state = base_state;
    scene.domain.cells[2] = levels;
    scene.domain.cell_size_m[2] = level_m;
    scene
}

fn from_sounding(text: &str) -> BaseState {
    base_state::build(&scene(SceneBase::Sounding { text: text.to_owned() }, 100, 40.0)).expect("a real sounding")
}

fn report(text: &str) -> BaseStateReport {
    from_sounding(text).report
}

fn near(name: &str, value: f64, expected: f64, tolerance: f64) {
    assert!(
        (value - expected).abs() <= tolerance,
        "{name}: {value}, expected {expected} within {tolerance}"
    );
}

#[test]
fn neutral_air_has_the_analytic_pressure() {
    let base = SceneBase::Isentropic {
        surface_pressure_pa: 1e5,
        potential_temperature_k: 300.0,
        wind_x_m_s: 3.0,
        wind_y_m_s: -1.0,
    };
    let built = base_state::build(&scene(base, 150, 100.0)).expect("valid");
    for k in 0..150 {
        let z = (k as f64 + 0.5) * 100.0;
        let exner = 1.0 - c::GRAVITY_M_S2 * z / (c::HEAT_CAPACITY_DRY_AIR * 300.0);
        // The Exner function falls linearly, which the scheme integrates exactly: only rounding is left.
        near(
            "pressure, Pa",
            built.pressure_pa[k],
            1e5 * exner.powf(1.0 / c::KAPPA),
            1e-6,
        );
        near("temperature, K", built.temperature_k[k], 300.0 * exner, 1e-9);
        assert_eq!((built.wind_x_m_s[k], built.wind_y_m_s[k]), (3.0, -1.0));
    }
    assert_eq!(built.report.surface_dewpoint_k, None, "dry air has no dew point");
    assert_eq!(built.report.surface_condensation_level, None);
    assert_eq!(built.report.cape_j_kg, 0.0);
}

#[test]
fn stable_dry_air_has_the_analytic_pressure() {
    let (n, theta_0) = (0.01, 300.0);
    let base = SceneBase::ConstantStability {
        surface_pressure_pa: 1e5,
        surface_potential_temperature_k: theta_0,
        buoyancy_frequency_per_s: n,
        relative_humidity: 0.0,
        wind_x_m_s: 0.0,
        wind_y_m_s: 0.0,
    };
    let built = base_state::build(&scene(base, 150, 100.0)).expect("valid");
    let scale = c::GRAVITY_M_S2.powi(2) / (c::HEAT_CAPACITY_DRY_AIR * theta_0 * n * n);
    for k in 0..150 {
        let z = (k as f64 + 0.5) * 100.0;
        let exner = 1.0 - scale * (1.0 - (-n * n * z / c::GRAVITY_M_S2).exp());
        // Fourth order at 10 m over a scale of 100 km: far below a thousandth of a pascal.
        near(
            "pressure, Pa",
            built.pressure_pa[k],
            1e5 * exner.powf(1.0 / c::KAPPA),
            1e-3,
        );
    }
}

#[test]
fn every_preset_and_sounding_is_hydrostatic() {
    let mut cases: Vec<(String, BaseState, f64)> = Vec::new();
    for preset in presets::all() {
        let scene = presets::find(preset.name).expect(preset.name);
        let built = base_state::build(&scene).expect(preset.name);
        cases.push((preset.name.to_owned(), built, scene.domain.cell_size_m[2]));
    }
    cases.push(("Omaha".to_owned(), from_sounding(OMAHA), 40.0));
    cases.push(("Norman".to_owned(), from_sounding(NORMAN), 40.0));
    for (name, built, dz) in cases {
        let nz = built.pressure_pa.len();
        let mut worst = 0.0_f64;
        assert_eq!(built.density_at_z_face_kg_m3.len(), nz + 1);
        for k in 1..nz {
            // Density at the face against the pressure across it. What is left is the midpoint rule's error: dz2/24 of the density's
            // curvature, and where a profile bends or jumps within a cell, dz/8 of its slope's jump. Measured: 4e-6 in smooth air,
            // 2e-4 at the kinks of tables and soundings, 1.2e-3 over 300 m cells, 6e-3 at the stratocumulus inversion of 10 K.
            let weight = built.density_at_z_face_kg_m3[k] * c::GRAVITY_M_S2 * dz;
            let residual = (built.pressure_pa[k - 1] - built.pressure_pa[k]) / weight - 1.0;
            let allowed = match name.as_str() {
                "stratocumulus" => 1e-2,
                "deep-convection" => 2e-3,
                _ => 3e-4,
            };
            worst = worst.max(residual.abs());
            assert!(residual.abs() < allowed, "{name}, level {k}: residual {residual}");
            assert!(
                built.density_at_z_face_kg_m3[k] < built.density_at_z_face_kg_m3[k - 1],
                "{name}: density falls"
            );
            assert!(
                built.exner[k] < built.exner[k - 1] && built.density_kg_m3[k] > 0.0,
                "{name}, level {k}"
            );
        }
        println!("{name}: largest residual {worst:.1e}");
        for k in 0..nz {
            let (p, t, q) = (
                built.pressure_pa[k],
                built.temperature_k[k],
                built.total_water_kg_per_kg[k],
            );
            let liquid = (t - built.exner[k] * built.liquid_water_potential_temperature_k[k])
                * c::HEAT_CAPACITY_DRY_AIR
                / c::LATENT_HEAT_VAPORISATION;
            assert!(liquid > -1e-12, "{name}: {liquid}");
            assert!(
                q - liquid <= c::saturation_specific_humidity(p, t) + 1e-9,
                "{name}, level {k}: supersaturated"
            );
        }
    }
}

#[test]
fn saturation_vapour_pressure_at_twenty_degrees() {
    // Bolton's fit claims 0.3 %; here it is 0.08 % above the published 2335 Pa.
    near(
        "e_s(20 C), Pa",
        c::saturation_vapour_pressure_pa(293.15),
        2335.0,
        2335.0 * 0.0015,
    );
}

#[test]
fn saturated_parcels_follow_the_published_table() {
    let pressures = [925e2, 850e2, 700e2, 500e2, 300e2];
    for (start_c, expected_c) in [
        (10.0, [6.547, 2.657, -6.935, -25.967, -57.655]),
        (20.0, [17.148, 13.984, 6.370, -8.485, -36.685]),
    ] {
        for (p, expected) in pressures.into_iter().zip(expected_c) {
            let t = saturated_ascent(1e5, start_c + 273.15, p) - 273.15;
            println!(
                "from {start_c} C to {p} Pa: {t:.3} C, published {expected} C, difference {:+.3} K",
                t - expected
            );
            // The table's own vapour pressure, latent heat and heat capacity differ from ours by tenths of a percent, which
            // adds up to 0.033 K at 300 hPa.
            near("temperature, C", t, expected, 0.05);
        }
    }
    // The example in MetPy's documentation of `moist_lapse`: from 5 C at 925 hPa, with its own constants.
    for (p, expected) in [
        (850e2, 0.99635104),
        (700e2, -8.88958079),
        (500e2, -28.38862857),
        (300e2, -60.12003999),
    ] {
        near(
            "temperature, C",
            saturated_ascent(925e2, 278.15, p) - 273.15,
            expected,
            0.05,
        );
    }
    let there_and_back = saturated_ascent(3e4, saturated_ascent(1e5, 293.15, 3e4), 1e5);
    near("back at the start, K", there_and_back, 293.15, 1e-6);
}

#[test]
fn condensation_level_of_a_published_parcel() {
    let q = c::saturation_specific_humidity(1e5, 291.15);
    let (p, t) = lifting_condensation_level(1e5, 298.15, q).expect("humid air condenses");
    println!("lifting condensation level: {:.2} hPa, {:.3} C", p / 100.0, t - 273.15);
    // R_d / c_p and the vapour pressure formula of the published figure are not ours: about 1 hPa.
    near("pressure, Pa", p, 90_200.0, 100.0);
    near("temperature, K", t, 16.37 + 273.15, 0.1);
    assert_eq!(
        lifting_condensation_level(1e5, 298.15, 0.0),
        None,
        "dry air never condenses"
    );
    assert_eq!(
        lifting_condensation_level(1e5, 291.15, q),
        Some((1e5, 291.15)),
        "saturated air is there already"
    );
}

#[test]
fn omaha_before_the_storm() {
    let report = report(OMAHA);
    println!("{report:#?}");
    near("surface pressure, Pa", report.surface_pressure_pa, 96_500.0, 1e-6);
    near(
        "surface temperature, K",
        report.surface_temperature_k,
        27.8 + 273.15,
        1e-6,
    );
    near(
        "surface dew point, K",
        report.surface_dewpoint_k.expect("humid"),
        23.8 + 273.15,
        1e-6,
    );
    near("ground above the sea, m", report.surface_altitude_m, 350.0, 1e-9);
    let level = report.surface_condensation_level.expect("humid");
    // Bolton's (1980) equation 15, an independent fit good to 0.1 K, for 27.8 and 23.8 C.
    let (t, dewpoint) = (300.95_f64, 296.95_f64);
    let bolton_k = 1.0 / (1.0 / (dewpoint - 56.0) + (t / dewpoint).ln() / 800.0) + 56.0;
    near("condensation temperature, K", level.temperature_k, bolton_k, 0.1);
    // Dry-adiabatic lift, 9.77 K/km; the environment is within a few kelvin of the parcel, so heights agree to 2 %.
    near(
        "condensation height, m",
        level.height_m,
        (t - level.temperature_k) / 9.765e-3,
        15.0,
    );
    let mixed = report.mixed_layer_condensation_level.expect("humid");
    assert!(
        mixed.height_m > level.height_m && mixed.height_m < 1500.0,
        "the mean air is drier: {mixed:?}"
    );
    // A day of violent tornadoes in Nebraska: surface parcels of 4000 J/kg and more, a cap, tops at the tropopause.
    assert!(
        (3500.0..7500.0).contains(&report.cape_j_kg),
        "CAPE {}",
        report.cape_j_kg
    );
    assert!((-200.0..=0.0).contains(&report.cin_j_kg), "CIN {}", report.cin_j_kg);
    let top_m = report.equilibrium_level_m.expect("unstable");
    assert!((11_000.0..16_000.0).contains(&top_m), "equilibrium level {top_m}");
    assert!(
        report.notes.iter().any(|note| note.contains("below ground")),
        "{:?}",
        report.notes
    );
}

#[test]
fn norman_on_a_winter_morning() {
    let report = report(NORMAN);
    println!("{report:#?}");
    near("surface pressure, Pa", report.surface_pressure_pa, 96_600.0, 1e-6);
    near(
        "surface temperature, K",
        report.surface_temperature_k,
        3.6 + 273.15,
        1e-6,
    );
    // The page itself gives 0.00 J/kg.
    assert!(report.cape_j_kg < 1.0, "CAPE {}", report.cape_j_kg);
    assert!(report.source.contains("Norman"), "{}", report.source);
    // The page also gives the condensation level of its mixed layer, the mean of the lowest 500 m as here: 818.54 hPa, 268.77 K.
    // Means by mass on our levels against means on theirs: 2 hPa, 0.2 K.
    let mixed = report.mixed_layer_condensation_level.expect("humid");
    near(
        "mixed-layer condensation pressure, Pa",
        mixed.pressure_pa,
        81_854.0,
        200.0,
    );
    near(
        "mixed-layer condensation temperature, K",
        mixed.temperature_k,
        268.77,
        0.2,
    );
}

#[test]
fn a_sounding_comes_back_at_its_own_levels() {
    // Heights in the file come from its own hydrostatic sum: our pressure at a level's height must agree with the file's.
    for (name, text) in [("Omaha", OMAHA), ("Norman", NORMAN)] {
        let read = sounding::parse(text).expect(name);
        let ground_m = read.levels[0].height_m;
        let built = base_state::build(&scene(SceneBase::Sounding { text: text.to_owned() }, 300, 40.0)).expect(name);
        for level in &read.levels {
            let k = (level.height_m - ground_m) / 40.0 - 0.5;
            if !(1.0..298.0).contains(&k) {
                continue;
            }
            let (low, share) = (k as usize, k.fract());
            let log = |k: usize| built.pressure_pa[k].ln();
            let pressure = (log(low) + share * (log(low + 1) - log(low))).exp();
            // Geopotential metres against g = 9.81, rounded heights, and potential temperature linear where the file has temperature
            // so: 1.5 hPa over 12 km.
            near(
                &format!("{name} at {} m, Pa", level.height_m),
                pressure,
                level.pressure_pa,
                150.0,
            );
            let mixed = |list: &[f64]| list[low] + share * (list[low + 1] - list[low]);
            near(
                &format!("{name} at {} m, K", level.height_m),
                mixed(&built.temperature_k),
                level.temperature_k,
                1.0,
            );
        }
    }
}

#[test]
fn bomex_starts_as_the_paper_says() {
    let scene = presets::find("fair-weather-cumulus").expect("a preset");
    let built = base_state::build(&scene).expect("valid");
    println!("{:#?}", built.report);
    near(
        "surface pressure, Pa",
        built.report.surface_pressure_pa,
        101_500.0,
        1e-6,
    );
    near(
        "surface temperature, K",
        built.report.surface_temperature_k,
        298.7 * 1.015_f64.powf(c::KAPPA),
        1e-9,
    );
    // Siebesma et al. (2003): cloud base between 500 and 600 m, fed by the well mixed layer below.
    let mixed = built.report.mixed_layer_condensation_level.expect("humid");
    assert!((450.0..700.0).contains(&mixed.height_m), "{mixed:?}");
    // Level 36 has its centre at 1460 m: between 520 m (298.7 K) and 1480 m (302.4 K).
    let expected = 298.7 + (1460.0 - 520.0) / 960.0 * 3.7;
    near(
        "theta_l at 1460 m, K",
        built.liquid_water_potential_temperature_k[36],
        expected,
        1e-6,
    );
    near(
        "q_t at 1460 m",
        built.total_water_kg_per_kg[36],
        0.0163 - (1460.0 - 520.0) / 960.0 * 0.0056,
        1e-9,
    );
    near(
        "u at 1460 m, m/s",
        built.wind_x_m_s[36],
        -8.75 + (1460.0 - 700.0) * 1.8e-3,
        1e-6,
    );
}

#[test]
fn stratocumulus_starts_with_a_cloud_under_the_inversion() {
    let scene = presets::find("stratocumulus").expect("a preset");
    let built = base_state::build(&scene).expect("valid");
    let liquid: Vec<f64> = (0..built.exner.len())
        .map(|k| {
            (built.temperature_k[k] - built.exner[k] * built.liquid_water_potential_temperature_k[k])
                * c::HEAT_CAPACITY_DRY_AIR
                / c::LATENT_HEAT_VAPORISATION
        })
        .collect();
    let base = liquid.iter().position(|q| *q > 1e-6).expect("a cloud") as f64 * 25.0;
    let top = (liquid.iter().rposition(|q| *q > 1e-6).expect("a cloud") + 1) as f64 * 25.0;
    println!(
        "cloud from {base} to {top} m, largest {} kg/kg",
        liquid.iter().copied().fold(0.0, f64::max)
    );
    // Stevens et al. (2005): cloud from about 600 to 840 m, 0.45 g/kg at its top.
    assert!(
        (550.0..=650.0).contains(&base) && (815.0..=850.0).contains(&top),
        "{base} to {top}"
    );
    near(
        "largest cloud water",
        liquid.iter().copied().fold(0.0, f64::max),
        4.5e-4,
        1.0e-4,
    );
}

#[test]
fn weisman_and_klemp_are_unstable_as_in_their_paper() {
    let scene = presets::find("deep-convection").expect("a preset");
    let report = base_state::build(&scene).expect("valid").report;
    println!("{report:#?}");
    // About 2000 J/kg is usually quoted for a cap of 14 g/kg; virtual temperature, parcel and latent heat move it by a few hundred.
    assert!(
        (1700.0..2900.0).contains(&report.cape_j_kg),
        "CAPE {}",
        report.cape_j_kg
    );
}

#[test]
fn air_that_cannot_be_is_refused() {
    // Neutral air of 300 K ends 30.7 km up.
    let base = SceneBase::Isentropic {
        surface_pressure_pa: 1e5,
        potential_temperature_k: 300.0,
        wind_x_m_s: 0.0,
        wind_y_m_s: 0.0,
    };
    let error = base_state::build(&scene(base, 100, 400.0)).expect_err("no air at 40 km");
    assert_eq!(
        (error.code.as_str(), error.pointer.as_deref()),
        ("out_of_range", Some("/base_state")),
        "{error}"
    );
    let error = base_state::build(&scene(SceneBase::Sounding { text: "nothing".into() }, 10, 40.0));
    assert_eq!(error.expect_err("no sounding").code, "bad_sounding");
}

#[test]
fn a_short_sounding_is_extended_isothermally() {
    let text = "%RAW%\n1000.0,10,20,10,180,10\n900.0,902,12,5,200,20\n%END%\n";
    let built = base_state::build(&scene(SceneBase::Sounding { text: text.into() }, 100, 40.0)).expect("valid");
    // The data end 892 m above their ground; their heights are good to a few metres, 0.01 K each.
    near("temperature at 900 m, K", built.temperature_k[22], 12.0 + 273.15, 0.1);
    near(
        "temperature at 3980 m, K",
        built.temperature_k[99],
        built.temperature_k[22],
        0.05,
    );
    assert!(
        built.report.notes.iter().any(|note| note.contains("isothermal above")),
        "{:?}",
        built.report.notes
    );
}
