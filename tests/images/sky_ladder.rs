//! The sky ladder: formulas against published values, and every rung beside the scattering tables: light of the sky on level ground, error over the sky, milliseconds.
//!
//! `cargo test -p welkin-tests --test sky_ladder -- --nocapture` prints the table that stands in tests/validation/sky.txt.

use std::time::Instant;

use welkin_server::clouds::{cumulus_field, settings, sun};
use welkin_shaders::cpu::light::Atmosphere;
use welkin_shaders::cpu::light::analytic_sky::{AnalyticSky, SkyMethod, turbidity};
use welkin_shaders::cpu::light::hosek_wilkie::HosekWilkie;
use welkin_shaders::cpu::light::multiple_scattering_table::MultipleScatteringTable;
use welkin_shaders::cpu::light::preetham::{Preetham, zenith_luminance_cd_m2};
use welkin_shaders::cpu::light::sky_table::{SkySource, SkyTable, radiance};
use welkin_shaders::cpu::light::transmittance_table::TransmittanceTable;
use welkin_shaders::cpu::view::{Ground, Prepared, ViewSettings, render};

const METHODS: [(SkyMethod, &str); 2] = [
    (SkyMethod::Preetham, "preetham"),
    (SkyMethod::HosekWilkie, "hosek_wilkie"),
];

/// Air with a turbidity.
fn air(wanted: f32) -> Atmosphere {
    // Molecules take 0.1085 of a vertical beam in green, aerosol its extinction times 1200 m.
    let aerosol_per_m = (wanted - 1.0) * 13.558e-6 * 8_000.0 / 1_200.0;
    Atmosphere::new(0.0, Some(3.0 / (aerosol_per_m + 13.558e-6)))
}

/// Directions of the upper half of the sky, of equal solid angle.
fn directions() -> Vec<[f32; 3]> {
    let (rings, around) = (24, 48);
    (0..rings * around)
        .map(|n| {
            let sine = ((n / around) as f32 + 0.5) / rings as f32;
            sun(sine.asin().to_degrees(), (n % around) as f32 * 360.0 / around as f32)
        })
        .collect()
}

/// Irradiance of level ground by a sky, in green.
fn on_ground(sky: &[[f32; 3]], directions: &[[f32; 3]]) -> f32 {
    let sum: f32 = sky.iter().zip(directions).map(|(l, d)| l[1] * d[2]).sum();
    sum * 2.0 * std::f32::consts::PI / sky.len() as f32
}

struct Tables {
    air: Atmosphere,
    transmittance: TransmittanceTable,
    multiple: MultipleScatteringTable,
}

impl Tables {
    fn new(air: Atmosphere) -> Tables {
        let transmittance = TransmittanceTable::new(&air);
        let multiple = MultipleScatteringTable::new(&air, &transmittance);
        Tables {
            air,
            transmittance,
            multiple,
        }
    }
    fn sky(&self, sun: [f32; 3], directions: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let source = SkySource::sun(sun, false);
        let look = |d: &[f32; 3]| {
            radiance(
                &self.air,
                &self.transmittance,
                &self.multiple,
                2.0,
                *d,
                &source,
                Some(false),
            )
        };
        directions.iter().map(look).collect()
    }
}

#[test]
fn turbidity_is_that_of_the_air() {
    for wanted in [1.5f32, 3.0, 8.0] {
        let got = turbidity(&air(wanted));
        assert!((got - wanted).abs() < 0.01, "{got} wanted {wanted}");
    }
}

/// The formulas in the paper's own terms: the zenith's luminance and chromaticity come out where one looks up, whatever the form.
#[test]
fn preethams_zenith() {
    for turbidity in [2.0f32, 4.0, 6.0] {
        for elevation_deg in [5.0f32, 30.0, 60.0, 85.0] {
            let sine = elevation_deg.to_radians().sin();
            let sky = Preetham::new(turbidity, sine);
            let [luminance, x, y] = sky.luminance_xy(1.0, sine);
            let wanted = zenith_luminance_cd_m2(turbidity, (90.0 - elevation_deg).to_radians());
            assert!((luminance / wanted - 1.0).abs() < 1e-4, "{luminance} wanted {wanted}");
            // A clear zenith is bluer than white (0.333) and on the side of daylight.
            assert!(
                (0.22..0.34).contains(&x) && (0.22..0.35).contains(&y),
                "{turbidity} {elevation_deg}: {x} {y}"
            );
        }
    }
    // Clearer air than the fit was made for has its clearest sky: beyond, the form runs to a pole, and the horizon of a visibility of 40 km (turbidity 1.68) was 35 times the zenith.
    let sine = 45f32.to_radians().sin();
    for turbidity in [1.0f32, 1.645, 1.68, 2.0] {
        let sky = Preetham::new(turbidity, sine);
        // 3 degrees high, a quarter of the circle from the sun.
        let horizon = sky.luminance_xy(0.05, 0.05 * sine)[0];
        let ratio = horizon / sky.luminance_xy(1.0, sine)[0];
        assert!((1.5..6.0).contains(&ratio), "{turbidity}: {ratio}");
    }
    // Equation of appendix A.2 worked by hand: T = 2, the sun 30 degrees from the zenith: chi = 0.8960, tan chi = 1.2500, 3.1196 x 1.2500 + 1.9882 = 5.888 kcd/m2.
    let zenith = zenith_luminance_cd_m2(2.0, 30f32.to_radians());
    assert!((zenith - 5_888.0).abs() < 10.0, "{zenith}");
}

/// Values of the authors' sample implementation, as the crate hw-skymodel 0.1.1 gives them for the same data.
#[test]
fn hosek_and_wilkies_values() {
    let cases = [
        (0.6f32, 3.0, 0.2, 0.0f32, 0.97f32, [1.8832139, 3.4775476, 7.0104403]),
        (0.1, 2.3, 0.0, 1.2, 0.5, [6.0098624, 6.79916, 6.6768837]),
        (1.3, 9.5, 1.0, 0.8, 0.6, [31.418005, 32.93808, 35.721123]),
    ];
    for (elevation, turbidity, albedo, zenith_angle, sun_angle, wanted) in cases {
        let sky = HosekWilkie::new(turbidity, [albedo; 3], elevation.sin());
        let got = sky.watts(zenith_angle.cos(), sun_angle.cos());
        for c in 0..3 {
            assert!((got[c] / wanted[c] - 1.0).abs() < 2e-3, "{got:?} wanted {wanted:?}");
        }
    }
    // A brighter ground makes a brighter sky.
    let sky = |albedo| HosekWilkie::new(3.0, [albedo; 3], 0.5).watts(0.7, 0.2)[1];
    assert!(sky(1.0) > 1.02 * sky(0.0));
}

#[test]
fn every_rung_beside_the_tables() {
    let directions = directions();
    println!(
        "The light of a clear sky by each rung of the sky ladder, green, over the sun's irradiance above the air; ground albedo that of land."
    );
    println!(
        "Error: of radiance against scattering_tables in the mean square over the upper half of the sky, relative, leaving out 10 degrees around the sun."
    );
    println!(
        "{:>9} {:>9} | {:>16} | {:>9} {:>7} | {:>12} {:>7}",
        "turbidity", "sun, deg", "tables, ground", "preetham", "error", "hosek_wilkie", "error"
    );
    for turbidity in [2.0f32, 3.0, 6.0] {
        let tables = Tables::new(air(turbidity));
        for elevation in [5.0f32, 15.0, 30.0, 60.0, 90.0] {
            let at = sun(elevation, 200.0);
            let truth = tables.sky(at, &directions);
            let ground = on_ground(&truth, &directions);
            let mut line = format!("{turbidity:>9} {elevation:>9} | {ground:>16.4} |");
            for (method, name) in METHODS {
                let sky = AnalyticSky::new(method, &tables.air, Ground::Land.albedo(), at).unwrap();
                let own: Vec<[f32; 3]> = directions.iter().map(|d| sky.radiance(*d)).collect();
                assert!(own.iter().flatten().all(|v| v.is_finite() && *v >= 0.0));
                let ratio = on_ground(&own, &directions) / ground;
                let far = |d: &[f32; 3]| (0..3).map(|a| d[a] * at[a]).sum::<f32>() < 10f32.to_radians().cos();
                let (mut off, mut all) = (0.0f64, 0.0f64);
                for ((a, b), d) in own.iter().zip(&truth).zip(&directions) {
                    if far(d) {
                        off += f64::from(a[1] - b[1]).powi(2);
                        all += f64::from(b[1]).powi(2);
                    }
                }
                let error = (off / all).sqrt();
                let width = if method == SkyMethod::Preetham { 9 } else { 12 };
                line += &format!(" {ratio:>width$.2} {error:>7.2} |");
                // Measured (tests/validation/sky.txt): Preetham is too bright everywhere, most near sunset, where its zenith keeps 2 kcd/m2; Hosek and Wilkie lie on both
                // sides of the tables. Beyond these bounds it would be a fault of units or of signs.
                let bounds = match (method, elevation >= 15.0) {
                    (SkyMethod::Preetham, true) => 1.0..2.6,
                    (SkyMethod::Preetham, false) => 1.0..5.5,
                    (_, true) => 0.6..1.5,
                    (_, false) => 0.6..3.2,
                };
                assert!(
                    bounds.contains(&ratio),
                    "{name}, turbidity {turbidity}, sun {elevation}: {ratio}"
                );
            }
            println!("{}", line.trim_end_matches('|'));
        }
    }
    // What a new sun costs, one table after the other in turn.
    let tables = Tables::new(air(3.0));
    let at = sun(40.0, 200.0);
    let source = SkySource::sun(at, false);
    let mut fastest = [f64::INFINITY; 3];
    for _ in 0..5 {
        let began = Instant::now();
        let _ = SkyTable::new(&tables.air, &tables.transmittance, &tables.multiple, &source, None, 2.0);
        fastest[0] = fastest[0].min(began.elapsed().as_secs_f64() * 1e3);
        for (n, (method, _)) in METHODS.into_iter().enumerate() {
            // The formula alone at as many places as the table's upper half has.
            let began = Instant::now();
            let sky = AnalyticSky::new(method, &tables.air, [0.1; 3], at).unwrap();
            let sum: f32 = (0..3)
                .flat_map(|_| &directions)
                .take(2688)
                .map(|d| sky.radiance(*d)[1])
                .sum();
            assert!(sum > 0.0);
            fastest[n + 1] = fastest[n + 1].min(began.elapsed().as_secs_f64() * 1e3);
        }
    }
    println!(
        "Milliseconds: scattering_tables, both halves of the sky {:.2}; the upper half by preetham {:.2}, by hosek_wilkie {:.2} on one thread.",
        fastest[0], fastest[1], fastest[2]
    );
}

/// From the tables' dusk to the formula's day no picture jumps; below the horizon the rungs are one.
#[test]
fn formulas_give_way_at_the_horizon() {
    let view = |sky, elevation: f32| ViewSettings {
        sky,
        sun_direction: sun(elevation, 130.0),
        ..settings(48, 27)
    };
    let draw = |view: &ViewSettings| render(None, view, &mut Prepared::new());
    let apart =
        |a: &[u8], b: &[u8]| a.iter().zip(b).map(|(a, b)| f32::from(a.abs_diff(*b))).sum::<f32>() / a.len() as f32;
    for (method, name) in METHODS {
        for elevation in [0.0, -0.2, -5.0, -30.0] {
            let (own, tables) = (
                draw(&view(method, elevation)),
                draw(&view(SkyMethod::ScatteringTables, elevation)),
            );
            assert!(own == tables, "{name} with the sun at {elevation}");
        }
        assert!(
            apart(
                &draw(&view(method, 30.0)),
                &draw(&view(SkyMethod::ScatteringTables, 30.0))
            ) > 1.0,
            "{name} draws what the tables draw"
        );
        let mut before = draw(&view(method, 0.0));
        for step in 1..=8 {
            let now = draw(&view(method, 0.5 * step as f32));
            let jump = apart(&now, &before);
            // Half a degree nearer to Preetham's bright dusk changes most: 19 levels as measured.
            assert!(
                jump < 25.0,
                "{name}: {jump} levels from {} to {} degrees",
                0.5 * (step - 1) as f32,
                0.5 * step as f32
            );
            before = now;
        }
    }
}

#[test]
fn hard_skies() {
    let directions = directions();
    for (method, name) in METHODS {
        for visibility_m in [None, Some(500.0), Some(2_000.0), Some(1e6)] {
            for elevation in [90.0f32, 89.999, 45.0, 3.0, 0.01] {
                let air = Atmosphere::new(8_000.0, visibility_m);
                let at = sun(elevation, 10.0);
                let Some(sky) = AnalyticSky::new(method, &air, [0.0, 0.5, 1.0], at) else {
                    continue;
                };
                for d in directions
                    .iter()
                    .chain(&[at, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [1.0, 0.0, -0.5]])
                {
                    let light = sky.radiance(*d);
                    // Forward peaks of thick haze reach some tens: a disc's radiance is 15,000.
                    assert!(
                        light.iter().all(|v| v.is_finite() && (0.0..200.0).contains(v)),
                        "{name} {visibility_m:?} {elevation} {d:?}: {light:?}"
                    );
                }
            }
        }
        // With cloud, from high up, over the sea, in haze; kept tables do not show.
        let cloud = cumulus_field(7, 6);
        let mut kept = Prepared::new();
        for change in 0..3 {
            let mut view = settings(33, 19);
            view.sky = method;
            match change {
                0 => view.camera_position_m[2] = 9_000.0,
                1 => view.ground = Ground::Sea,
                _ => view.visibility_m = Some(3_000.0),
            }
            let picture = render(Some(&cloud), &view, &mut kept);
            assert!(
                picture == render(Some(&cloud), &view, &mut Prepared::new()),
                "{name}: kept tables show"
            );
            let mean = picture.iter().map(|b| f32::from(*b)).sum::<f32>() / picture.len() as f32;
            assert!((30.0..240.0).contains(&mean), "{name}: mean level {mean}");
        }
    }
}
