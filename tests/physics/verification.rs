//! Verification of the dynamics as a whole: order in time, rest, budgets with every named source, the moist adiabat.

mod common;

use common::{air, noise};
use welkin_proto::scene::BaseState as SceneBase;
use welkin_proto::{Scene, presets};
use welkin_server::base_state::{self, Adiabat};
use welkin_server::world::World;
use welkin_server::{parameters, plan::Plan};
use welkin_shaders::catalogue::{Field, Pass};
use welkin_shaders::constants as c;
use welkin_shaders::cpu::Cpu;
use welkin_shaders::cpu::sim::parameters::Methods;
use welkin_shaders::cpu::sim::{hole_filler, saturation_adjustment};
use welkin_shaders::{Device, Grid, Substep};

const OMAHA: &str = include_str!("../fixtures/soundings/oax_2014-06-16_19z.spc.txt");
const NORMAN: &str = include_str!("../fixtures/soundings/oun_2018-12-22_12z.uwyo.html");

fn preset(name: &str) -> Scene {
    presets::find(name).expect("a preset")
}

fn field(world: &World, field: Field) -> Vec<f32> {
    world.device().read(field).expect("a planned field").to_vec()
}

/// Mass-weighted sum over the box, kg/m2 of a column times the field's unit.
fn sum(world: &World, which: Field) -> f64 {
    let p = world.parameters();
    let (plane, dz) = (p.grid.plane(), f64::from(p.grid.cell_size_m[2]));
    field(world, which)
        .iter()
        .enumerate()
        .map(|(i, &v)| f64::from(v) * f64::from(p.density_kg_m3[i / plane]) * dz / plane as f64)
        .sum()
}

/// A wave of small amplitude in stably stratified air that flows through the box: smooth in space and time.
fn gravity_wave() -> World {
    let mut scene = preset("dry-bubble");
    scene.domain.cells = [32, 1, 32];
    scene.domain.cell_size_m = [1000.0, 1000.0, 300.0];
    scene.base_state = SceneBase::ConstantStability {
        surface_pressure_pa: 1e5,
        surface_potential_temperature_k: 300.0,
        buoyancy_frequency_per_s: 0.01,
        relative_humidity: 0.0,
        wind_x_m_s: 10.0,
        wind_y_m_s: 0.0,
    };
    scene.effects.bubble = None;
    let mut world = World::new(scene, None).expect("a world");
    let grid = world.parameters().grid;
    let base = world.parameters().base_heat_k.clone();
    let heat: Vec<f32> = (0..grid.len())
        .map(|i| {
            let (x, z) = (i % 32, i / 32);
            let along = 2.0 * std::f64::consts::PI * (x as f64 + 0.5) / 32.0;
            let up = std::f64::consts::PI * (z as f64 + 0.5) / 32.0;
            base[z] + (0.5 * along.sin() * up.sin()) as f32
        })
        .collect();
    world.write_field(Field::Heat, &heat).expect("planned");
    world
}

#[test]
fn the_time_scheme_converges_at_third_order_on_a_gravity_wave() {
    // One substep a tick: at 10 m/s over 1 km and N = 0.01 1/s stability would allow more than 50 s.
    let after = |substep_s: f64| {
        let mut world = gravity_wave();
        let steps = (800.0 / substep_s).round() as usize;
        for _ in 0..steps {
            world.advance_by(substep_s);
            assert_eq!(
                world.numbers().substeps,
                1,
                "a tick of {substep_s} s must be one substep"
            );
        }
        [
            field(&world, Field::Heat),
            field(&world, Field::VelocityZ),
            field(&world, Field::VelocityX),
        ]
    };
    let truth = after(3.125);
    let error = |substep_s: f64| {
        let run = after(substep_s);
        let mut parts = [0.0; 3];
        for ((part, run), truth) in parts.iter_mut().zip(&run).zip(&truth) {
            let squares: f64 = run.iter().zip(truth).map(|(a, b)| f64::from(a - b).powi(2)).sum();
            *part = (squares / run.len() as f64).sqrt();
        }
        parts
    };
    let errors = [error(50.0), error(25.0), error(12.5)];
    println!("errors of theta, w, u at 50, 25 and 12.5 s: {errors:?}");
    for quantity in 0..3 {
        let order = (errors[0][quantity] / errors[1][quantity]).log2();
        let next = (errors[1][quantity] / errors[2][quantity]).log2();
        println!("observed order {order:.2}, then {next:.2}");
        // Third order for linear terms, second for products (Wicker and Skamarock 2002); the wave is all but linear.
        assert!(
            order > 2.8 && next > 2.8,
            "quantity {quantity}: order {order}, then {next}"
        );
    }
}

/// A scene without anything that moves, mixes or forces air; what is left must stay as it is.
fn quiet(mut scene: Scene) -> Scene {
    scene.effects.turbulence = None;
    scene.effects.constant_viscosity = None;
    scene.effects.body_force = None;
    scene.effects.surface = None;
    scene.effects.coriolis = None;
    scene.effects.large_scale = None;
    scene.effects.noise = None;
    scene.effects.bubble = None;
    scene.domain.cells[0] = scene.domain.cells[0].min(6);
    scene.domain.cells[1] = scene.domain.cells[1].min(6);
    scene
}

#[test]
fn every_sounding_rests_for_an_hour() {
    let mut cases: Vec<(String, Scene)> = presets::all()
        .iter()
        .map(|preset| {
            (
                preset.name.to_owned(),
                quiet(presets::find(preset.name).expect("a preset")),
            )
        })
        .collect();
    for (name, text) in [("Omaha", OMAHA), ("Norman", NORMAN)] {
        let mut scene = quiet(preset("fair-weather-cumulus"));
        scene.base_state = SceneBase::Sounding { text: text.to_owned() };
        cases.push((name.to_owned(), scene));
    }
    for (name, scene) in cases {
        let mut world = World::new(scene, None).expect("a world");
        let before = field(&world, Field::VelocityX);
        let most = |values: &[f32]| values.iter().map(|v| v.abs()).fold(0.0, f32::max);
        let heat_before = world.device().read(Field::Heat).map(|h| h.into_owned());
        world.advance_to(3600.0, |_| true);
        let up = most(&field(&world, Field::VelocityZ));
        let wind: Vec<f32> = field(&world, Field::VelocityX)
            .iter()
            .zip(&before)
            .map(|(a, b)| a - b)
            .collect();
        let warmed = heat_before.map_or(0.0, |before| {
            let after = field(&world, Field::Heat);
            most(&after.iter().zip(&before).map(|(a, b)| a - b).collect::<Vec<_>>())
        });
        println!(
            "{name}: w {up:e} m/s, u changed by {:e} m/s, theta_l by {warmed:e} K",
            most(&wind)
        );
        // A level's buoyancy is one number, which the pressure takes up; wind that differs from level to level only carries what is
        // alike along it. What is left is the rounding of what the solve makes of equal numbers; 1e-10 m/s is the worst of these.
        assert!(up < 1e-8, "{name} rises at {up} m/s");
        assert!(most(&wind) < 1e-6, "{name}: wind changed by {} m/s", most(&wind));
        assert!(warmed < 1e-6, "{name}: warmed by {warmed} K");
    }
}

/// The larger weather's own formula, in f64: upwind subsidence and a source, summed over the column with its mass.
fn large_scale_source(world: &World, which: Field, source: &[f32]) -> f64 {
    let p = world.parameters();
    let weather = p.large_scale.as_ref().expect("a scene with larger weather");
    let (plane, levels, dz) = (p.grid.plane(), p.grid.cells[2], f64::from(p.grid.cell_size_m[2]));
    let values = field(world, which);
    let mean = |z: usize| {
        values[z * plane..(z + 1) * plane]
            .iter()
            .map(|&v| f64::from(v))
            .sum::<f64>()
            / plane as f64
    };
    (0..levels)
        .map(|z| {
            let w = f64::from(weather.vertical_wind_m_s[z]);
            let upper = if w < 0.0 { (z + 1).min(levels - 1) } else { z.max(1) };
            let gradient = (mean(upper) - mean(upper - 1)) / dz;
            (f64::from(source[z]) - w * gradient) * f64::from(p.density_kg_m3[z]) * dz
        })
        .sum()
}

#[test]
fn budgets_close_with_every_named_source() {
    let mut scene = preset("fair-weather-cumulus");
    scene.domain.cells = [16, 16, 75];
    // The sponge draws heat to the base state: a source of its own, which would be counted like the others.
    scene.effects.sponge = None;
    let mut world = World::new(scene, None).expect("a world");
    let p = world.parameters().clone();
    let weather = p.large_scale.clone().expect("larger weather");
    let surface = p.surface.clone().expect("a surface");
    let at_ground = f64::from(p.density_at_z_face_kg_m3[0]);
    let before = [sum(&world, Field::Heat), sum(&world, Field::Water)];
    let mut expected = [0.0f64; 2];
    // What the ground gives in an hour, K kg/m2 and kg/m2, to judge what is left over.
    let size = [surface.heat_flux_k_m_s, surface.moisture_flux_m_s].map(|flux| 3600.0 * at_ground * f64::from(flux));
    let mut cloud_at_s = None;
    while world.simulated_s() < 3600.0 {
        let rates = [
            at_ground * f64::from(surface.heat_flux_k_m_s)
                + large_scale_source(&world, Field::Heat, &weather.heating_k_per_s),
            at_ground * f64::from(surface.moisture_flux_m_s)
                + large_scale_source(&world, Field::Water, &weather.moistening_per_s),
        ];
        world.advance_by(4.0);
        // Held tendencies are computed once a substep: only ticks of one substep can be summed from outside.
        assert_eq!(world.numbers().substeps, 1);
        for (i, rate) in rates.iter().enumerate() {
            expected[i] += 4.0 * rate;
        }
        if cloud_at_s.is_none() && world.numbers().liquid_water_path_kg_m2 > Some(0.0) {
            cloud_at_s = Some(world.simulated_s());
            // Until the first cloud theta_l has no source but these; from then on `cloudy_ascent` is one more.
            let change = sum(&world, Field::Heat) - before[0];
            println!(
                "heat until {} s: {change} against {} K kg/m2",
                world.simulated_s(),
                expected[0]
            );
            // Rounding: 3e-7 K (of values up to 13 K) a cell and substep at random signs. Above the mixed layer the cells of a level are alike and so
            // are their errors: some 40 levels of 44 kg/m2 in 287 substeps walk to 1.3e-3 K kg/m2, 4e-5 of what the ground gives in an hour.
            assert!((change - expected[0]).abs() < 1e-4 * size[0], "heat");
        }
    }
    let change = sum(&world, Field::Water) - before[1];
    println!(
        "water in an hour: {change} against {} kg/m2, first cloud at {cloud_at_s:?} s",
        expected[1]
    );
    // Rounding again: 1e-9 kg/kg a cell and substep, at random signs.
    assert!(
        cloud_at_s.is_some(),
        "the hour must see cloud for water's budget to mean anything"
    );
    assert!((change - expected[1]).abs() < 1e-5 * size[1], "water");
}

/// Saturated air of a temperature at 1000 hPa that just holds its water, lifted reversibly.
fn lifted_from(celsius: f64) -> Adiabat {
    let kelvin = celsius + c::ZERO_CELSIUS_K;
    Adiabat::new(1.0, kelvin, c::saturation_specific_humidity(1e5, kelvin))
}

const PRESSURES_PA: [f64; 5] = [925e2, 850e2, 700e2, 500e2, 300e2];
const PUBLISHED_C: [(f64, [f64; 5]); 2] = [
    (10.0, [6.547, 2.657, -6.935, -25.967, -57.655]),
    (20.0, [17.148, 13.984, 6.370, -8.485, -36.685]),
];

#[test]
fn lifted_air_follows_the_published_adiabat_on_the_device() {
    let latent = c::LATENT_HEAT_VAPORISATION / c::HEAT_CAPACITY_DRY_AIR;
    for (start_c, published_c) in PUBLISHED_C {
        let adiabat = lifted_from(start_c);
        let mut scene = preset("moist-bubble");
        scene.domain.cells = [8, 1, 5];
        let base = base_state::build(&scene).expect("valid");
        let mut p = parameters::parameters(&scene, &base, Methods::default());
        let mut heat = vec![0.0; 40];
        for (z, pressure) in PRESSURES_PA.into_iter().enumerate() {
            let exner = (pressure / 1e5).powf(c::KAPPA);
            (p.pressure_pa[z], p.exner[z]) = (pressure as f32, exner as f32);
            heat[z * 8..(z + 1) * 8].fill((adiabat.theta_l_at(exner) - f64::from(p.heat_reference_k)) as f32);
        }
        let water = vec![adiabat.total_water_kg_per_kg() as f32; 40];
        let (mut cloud, mut buoyancy) = (vec![f32::NAN; 40], vec![f32::NAN; 40]);
        saturation_adjustment::run(&p, &heat, &water, &mut cloud, &mut buoyancy);
        for (z, published) in published_c.into_iter().enumerate() {
            let theta_l = f64::from(p.heat_reference_k) + f64::from(heat[z * 8]);
            let t = f64::from(p.exner[z]) * theta_l + latent * f64::from(cloud[z * 8]) - c::ZERO_CELSIUS_K;
            println!(
                "from {start_c} C to {} Pa: {t:.3} C, published {published}",
                PRESSURES_PA[z]
            );
            // The published parcel loses its condensate, ours keeps it (but not its heat capacity); latent heat and heat capacity are
            // constants here. Together 0.21 K at 500 hPa. Carrying theta_l unchanged would be 5.5 K off at 300 hPa.
            assert!((t - published).abs() < 0.25, "{t} C, published {published} C");
        }
    }
}

#[test]
fn a_moist_adiabat_is_steady_in_rising_air() {
    // Air that rises everywhere with one mass flux through a column that is an adiabat already: what is carried in from below and what
    // the ascent takes must cancel, level by level.
    let mut scene = preset("moist-bubble");
    scene.domain.cells = [8, 1, 100];
    let plan = Plan::new(&scene).expect("a plan");
    let base = base_state::build(&scene).expect("valid");
    let p = parameters::parameters(&scene, &base, Methods::default());
    let mut device = Cpu::new(p.clone(), &plan.fields);
    let plane = p.grid.plane();
    let by_level = |value: &dyn Fn(usize) -> f32| (0..p.grid.len()).map(|i| value(i / plane)).collect::<Vec<f32>>();
    let start = by_level(&|z| p.base_heat_k[z]);
    let w = |z: usize| {
        if z == 0 {
            0.0
        } else {
            1.0 / p.density_at_z_face_kg_m3[z]
        }
    };
    assert!(device.write(Field::VelocityZ, &by_level(&w)));
    assert!(device.write(Field::Heat, &start));
    assert!(device.write(Field::Water, &by_level(&|z| base.total_water_kg_per_kg[z] as f32)));
    // The first stage of three: it advances from the state itself, by a third.
    let substep = Substep {
        substep_s: 10.0,
        stage: 0,
        stages: 3,
    };
    device.run(Pass::Saturation, &substep);
    device.run(Pass::AdvectHeat, &substep);
    let carried = device.read(Field::NextHeat).expect("planned").to_vec();
    device.run(Pass::CloudyAscent, &substep);
    let both = device.read(Field::NextHeat).expect("planned").to_vec();
    for z in 5..95 {
        let i = z * plane + 3;
        let (alone, left) = (f64::from(carried[i] - start[i]), f64::from(both[i] - start[i]));
        // 3 mK a stage; f32 near -60 K resolves 4 uK, second-order faces leave a permille.
        assert!(
            alone.abs() > 1e-3,
            "level {z}: {alone} K is too little to mean anything"
        );
        assert!(
            left.abs() < 0.01 * alone.abs(),
            "level {z}: {left} K is left of {alone} K"
        );
    }
}

#[test]
fn holes_are_filled_from_their_own_column() {
    let grid = Grid {
        cells: [37, 5, 19],
        cell_size_m: [100.0; 3],
    };
    let p = air(grid, Some(800.0));
    let plane = grid.plane();
    // A third of the cells is below zero; every fifth column has none, every seventh nothing else.
    let before: Vec<f32> = (0..grid.len())
        .map(|i| match (i % plane % 5, i % plane % 7) {
            (0, _) => 1e-3 * noise(i).abs(),
            (_, 0) => -1e-3 * noise(i).abs(),
            _ => 1e-3 * (noise(i) + 0.3),
        })
        .collect();
    let mut after = before.clone();
    hole_filler::run(&p, &mut vec![0.0; plane], &mut after);
    let column = |values: &[f32], at: usize| -> Vec<f32> { values.iter().skip(at).step_by(plane).copied().collect() };
    let mass = |values: &[f32]| -> f64 {
        let cells = values.iter().zip(&p.density_kg_m3);
        cells.map(|(&q, &density)| f64::from(q) * f64::from(density)).sum()
    };
    let mut filled = 0;
    for at in 0..plane {
        let (old, new) = (column(&before, at), column(&after, at));
        // 19 cells of 1e-3 at most and densities near 1: the rounding of as many sums.
        assert!(
            (mass(&new) - mass(&old)).abs() < 3e-9,
            "column {at} gained {:e}",
            mass(&new) - mass(&old)
        );
        if old.iter().all(|&q| q >= 0.0) {
            assert_eq!(old, new, "column {at} had nothing to fill");
        } else if mass(&old) > 0.0 {
            filled += 1;
            assert!(new.iter().all(|&q| q >= 0.0), "column {at}: {new:?}");
        } else {
            assert!(
                new[1..].iter().all(|&q| q == 0.0) && new[0] < 0.0,
                "column {at}: {new:?}"
            );
        }
    }
    assert!(filled > plane / 3, "only {filled} columns were tried");
}

#[test]
fn dry_air_beside_moist_air_stays_without_negative_water() {
    let mut scene = preset("warm-bubble");
    scene.domain.cells = [24, 24, 32];
    if let SceneBase::ConstantStability { relative_humidity, .. } = &mut scene.base_state {
        *relative_humidity = 0.0;
    }
    let mut world = World::new(scene, None).expect("a world");
    let before = sum(&world, Field::Water);
    let (mut least, mut updraught_m_s) = (f32::MAX, 0.0f64);
    for _ in 0..20 {
        world.advance_by(20.0);
        updraught_m_s = updraught_m_s.max(world.numbers().updraught_max_m_s);
        least = field(&world, Field::Water).into_iter().fold(least, f32::min);
    }
    assert!(updraught_m_s > 1.0, "{updraught_m_s} m/s: nothing moves");
    assert_eq!(least, 0.0, "the driest air");
    // Every column gives for itself, so the sum changes by rounding alone: 32-bit values, some hundred stages.
    let drift = sum(&world, Field::Water) / before - 1.0;
    assert!(drift.abs() < 1e-5, "water drifts by {drift:e}");
}
