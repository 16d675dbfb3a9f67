//! Constant viscosity and body force against analytic solutions: waves that decay, a vortex that decays, air that is pushed.

mod common;

use std::f64::consts::PI;

use common::noise;
use welkin_proto::scene::{BodyForce, ConstantViscosity, DiffusionScheme as Scheme};
use welkin_proto::{Scene, presets};
use welkin_server::world::World;
use welkin_shaders::Grid;
use welkin_shaders::catalogue::{Field, Rung};
use welkin_shaders::cpu::sim::parameters::{ConstantViscosity as Mixing, DiffusionScheme, PressureMethod};
use welkin_shaders::cpu::sim::{Parameters, constant_viscosity};

fn air(cells: [usize; 3], cell_size_m: [f32; 3], scale_height_m: Option<f64>, scheme: DiffusionScheme) -> Parameters {
    Parameters {
        constant_viscosity: Some(Mixing {
            viscosity_m2_s: 1.0,
            diffusivity_m2_s: 1.0,
            scheme,
        }),
        ..common::air(Grid { cells, cell_size_m }, scale_height_m)
    }
}

/// The field after one step of `dt_s` with `diffusivity_m2_s`.
fn step(air: &Parameters, diffusivity_m2_s: f32, field: &[f32], at_z_face: bool, dt_s: f32) -> Vec<f32> {
    let mut slow = vec![0.0; field.len()];
    let mut scratch = [vec![f32::NAN; field.len()], vec![f32::NAN; field.len()]];
    constant_viscosity::run(air, diffusivity_m2_s, field, at_z_face, dt_s, &mut scratch, &mut slow);
    field.iter().zip(&slow).map(|(f, s)| f + dt_s * s).collect()
}

/// Mass-weighted sum.
fn mass(air: &Parameters, field: &[f32]) -> f64 {
    let plane = air.grid.plane();
    field
        .iter()
        .enumerate()
        .map(|(i, &v)| v as f64 * air.density_kg_m3[i / plane] as f64)
        .sum()
}

/// Waves that are modes of the discrete Laplacian, each with its rate over the diffusivity, 1/m2: along x, y, z at centres, along z at lower faces.
fn modes(grid: &Grid) -> Vec<(&'static str, bool, Vec<f32>, f64, f64)> {
    let [nx, ny, nz] = grid.cells;
    let values = |f: &dyn Fn(usize, usize, usize) -> f64| {
        (0..grid.len())
            .map(|i| f(i % nx, i / nx % ny, i / grid.plane()) as f32)
            .collect::<Vec<f32>>()
    };
    // The discrete rate of a wave of wave number k, and the continuous one.
    let rates = |a: usize, k_cells: f64| {
        let d = grid.cell_size_m[a] as f64;
        (4.0 * (0.5 * k_cells).sin().powi(2) / (d * d), (k_cells / d).powi(2))
    };
    let of = |a: usize| {
        if a == 2 {
            PI / nz as f64
        } else {
            2.0 * PI / grid.cells[a] as f64
        }
    };
    [
        ("x", false, 0, values(&|x, _, _| (of(0) * x as f64).sin())),
        ("y", false, 1, values(&|_, y, _| (of(1) * y as f64).sin())),
        // No gradient at ground and lid.
        ("z", false, 2, values(&|_, _, z| (of(2) * (z as f64 + 0.5)).cos())),
        // 0 at ground and lid.
        ("w along z", true, 2, values(&|_, _, z| (of(2) * z as f64).sin())),
        (
            "w along x",
            true,
            0,
            values(&|x, _, z| if z > 0 { (of(0) * x as f64).sin() } else { 0.0 }),
        ),
    ]
    .into_iter()
    .map(|(name, at_z_face, axis, values)| {
        let (discrete, continuous) = rates(axis, of(axis));
        (name, at_z_face, values, discrete, continuous)
    })
    .collect()
}

#[test]
fn waves_decay_at_the_laplacians_rate() {
    let grid_of = |n: usize| [n, n, n];
    let error = |n: usize, mode: usize| {
        let size = 160.0 / n as f32;
        let air = air(grid_of(n), [size; 3], None, DiffusionScheme::Explicit);
        let (name, at_z_face, wave, discrete, continuous) = modes(&air.grid)[mode].clone();
        let after = step(&air, 2.0, &wave, at_z_face, 0.5);
        for (i, (a, b)) in after.iter().zip(&wave).enumerate() {
            // `w along x` is no mode beside ground and lid, where w is 0.
            let z = i / air.grid.plane();
            if name == "w along x" && (z <= 1 || z + 1 == n) {
                continue;
            }
            let expected = *b as f64 * (1.0 - 2.0 * 0.5 * discrete);
            assert!((*a as f64 - expected).abs() < 1e-6, "{name}: {a} for {expected}");
        }
        (discrete - continuous).abs() / continuous
    };
    for mode in 0..5 {
        let ratio = error(12, mode) / error(24, mode);
        assert!((3.9..4.1).contains(&ratio), "mode {mode}: not of second order, {ratio}");
    }
}

#[test]
fn the_implicit_scheme_solves_its_equation() {
    let air = air([12, 10, 8], [10.0, 12.0, 9.0], None, DiffusionScheme::Implicit);
    // Sum of couplings about 0.6, 4 and, beyond what its sweeps can follow, 200.
    for (diffusivity, within) in [(0.5, 1e-3), (3.0, 1e-3), (200.0, 1.0)] {
        let dt_s = 20.0;
        for (name, at_z_face, wave, discrete, _) in modes(&air.grid).into_iter().take(4) {
            let after = step(&air, diffusivity, &wave, at_z_face, dt_s);
            let expected = 1.0 / (1.0 + diffusivity as f64 * dt_s as f64 * discrete);
            for (a, b) in after.iter().zip(&wave) {
                let error = *a as f64 - *b as f64 * expected;
                assert!(error.abs() < within, "{name} with {diffusivity}: {error}");
                // Never more than asked, never past 0.
                assert!(a.abs() <= b.abs() + 1e-6, "{name} with {diffusivity}: {b} grew to {a}");
            }
        }
    }
}

#[test]
fn no_viscosity_and_no_step_makes_the_implicit_scheme_grow() {
    for scale_height in [None, Some(60.0)] {
        let air = air([9, 1, 7], [10.0, 12.0, 9.0], scale_height, DiffusionScheme::Implicit);
        for at_z_face in [false, true] {
            let mut field: Vec<f32> = (0..air.grid.len()).map(noise).collect();
            if at_z_face {
                field[..air.grid.plane()].fill(0.0);
            }
            for diffusivity in [0.0, 1e-3, 1.0, 1e3, 1e5] {
                for dt_s in [0.01, 10.0, 600.0] {
                    let after = step(&air, diffusivity, &field, at_z_face, dt_s);
                    let most = after.iter().fold(0.0f32, |m, v| m.max(v.abs()));
                    // dt / dt rounds the value once more.
                    assert!(most <= 1.0 + 1e-6, "{diffusivity} m2/s for {dt_s} s: {most}");
                }
            }
        }
    }
}

#[test]
fn both_schemes_keep_the_mass_weighted_sum() {
    for scheme in [DiffusionScheme::Explicit, DiffusionScheme::Implicit] {
        let air = air([16, 11, 9], [10.0, 12.0, 9.0], Some(80.0), scheme);
        let field: Vec<f32> = (0..air.grid.len()).map(|i| 3.0 + noise(i)).collect();
        for diffusivity in [
            0.5,
            if scheme == DiffusionScheme::Implicit {
                500.0
            } else {
                1.5
            },
        ] {
            let after = step(&air, diffusivity, &field, false, 10.0);
            let moved = after.iter().zip(&field).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(moved > 0.1, "{scheme:?} did nothing");
            let change = mass(&air, &after) / mass(&air, &field) - 1.0;
            // A value is rounded by up to 6e-8 of itself, at random: 1584 of them, less as a sum.
            assert!(change.abs() < 5e-8, "{scheme:?} with {diffusivity}: {change:e}");
        }
    }
}

fn windy(cells: [u32; 3], size_m: [f64; 3], viscosity_m2_s: f64, scheme: Scheme) -> Scene {
    let mut scene = presets::find("clear-sky-wind").expect("a preset");
    scene.domain.cells = cells;
    scene.domain.cell_size_m = size_m;
    if let welkin_proto::scene::BaseState::Isentropic {
        wind_x_m_s, wind_y_m_s, ..
    } = &mut scene.base_state
    {
        (*wind_x_m_s, *wind_y_m_s) = (0.0, 0.0);
    }
    scene.effects.constant_viscosity = Some(ConstantViscosity {
        viscosity_m2_s,
        diffusivity_m2_s: 0.0,
        scheme,
    });
    scene
}

/// So slow that the advection's own diffusion, which goes with the speed, hardly counts.
const SLOW_M_S: f64 = 0.05;

/// Mean square of u and v after `seconds` over that before, of Taylor's and Green's vortex in x and y on n by n cells.
fn vortex(n: u32, scheme: Scheme, seconds: f64) -> f64 {
    let length = 800.0;
    let d = length / n as f64;
    let mut world = World::new(windy([n, n, 2], [d, d, 50.0], 5.0, scheme), None).expect("a world");
    let k = 2.0 * PI / n as f64;
    let cells = (n * n * 2) as usize;
    let at = |i: usize| ((i as u32 % n) as f64, (i as u32 / n % n) as f64);
    let u = (0..cells).map(|i| SLOW_M_S * (k * at(i).0).sin() * (k * (at(i).1 + 0.5)).cos());
    let v = (0..cells).map(|i| -SLOW_M_S * (k * (at(i).0 + 0.5)).cos() * (k * at(i).1).sin());
    world
        .write_field(Field::VelocityX, &u.map(|u| u as f32).collect::<Vec<_>>())
        .expect("planned");
    world
        .write_field(Field::VelocityY, &v.map(|v| v as f32).collect::<Vec<_>>())
        .expect("planned");
    let energy = |world: &World| {
        [Field::VelocityX, Field::VelocityY]
            .map(|f| {
                world
                    .device()
                    .read(f)
                    .expect("planned")
                    .iter()
                    .map(|&v| (v as f64).powi(2))
                    .sum::<f64>()
            })
            .iter()
            .sum::<f64>()
    };
    let before = energy(&world);
    // Ticks so short that the first order in time hardly counts.
    while world.simulated_s() < seconds - 1e-6 {
        world.advance_by(1.0);
    }
    energy(&world) / before
}

#[test]
fn the_vortex_of_taylor_and_green_decays_as_it_must() {
    let k = 2.0 * PI / 800.0;
    let seconds = 600.0;
    let truth = (-4.0 * 5.0 * k * k * seconds).exp();
    for scheme in [Scheme::Explicit, Scheme::Implicit] {
        let error = |n: u32| (vortex(n, scheme, seconds) - truth).abs();
        let (coarse, fine) = (error(12), error(24));
        let ratio = coarse / fine;
        eprintln!(
            "{scheme:?}: energy left {truth:.5}; error on 12 cells {coarse:.1e}, on 24 {fine:.1e}, ratio {ratio:.2}"
        );
        // Second order; a second of the first-order step in time shifts it a little, down or up by scheme.
        assert!(
            (3.4..4.8).contains(&ratio) && fine < 4e-3,
            "{scheme:?}: {coarse:e} to {fine:e}"
        );
    }
}

#[test]
fn a_thick_fluid_in_long_steps_is_stable_with_either_scheme() {
    for scheme in [Scheme::Explicit, Scheme::Implicit] {
        let mut scene = windy([12, 9, 10], [50.0, 50.0, 20.0], 2000.0, scheme);
        scene.effects.sponge = None;
        let mut world = World::new(scene, None).expect("a world");
        let len = world.parameters().grid.len();
        let plane = world.parameters().grid.plane();
        for (a, field) in [Field::VelocityX, Field::VelocityY, Field::VelocityZ]
            .into_iter()
            .enumerate()
        {
            let mut values: Vec<f32> = (0..len).map(|i| 10.0 * noise(3 * i + a)).collect();
            if field == Field::VelocityZ {
                values[..plane].fill(0.0);
            }
            world.write_field(field, &values).expect("planned");
        }
        let tick_s = if scheme == Scheme::Implicit { 60.0 } else { 1.0 };
        for _ in 0..10 {
            world.advance_by(tick_s);
        }
        let numbers = world.numbers();
        eprintln!(
            "{scheme:?}: {} m/s after {} s, substeps of {} s",
            numbers.wind_max_m_s,
            world.simulated_s(),
            numbers.substep_s
        );
        assert!(
            numbers.restores == 0 && numbers.wind_max_m_s < 1.0,
            "{scheme:?}: {} m/s",
            numbers.wind_max_m_s
        );
        // The explicit bound: a quarter over the viscosity times the sum of the inverse squares.
        let bound = 0.25 / (2000.0 * (2.0 / 2500.0 + 1.0 / 400.0));
        if scheme == Scheme::Explicit {
            assert!(numbers.substep_s <= bound, "{} s above {bound} s", numbers.substep_s);
        } else {
            assert!(numbers.substep_s > 10.0 * bound, "{} s", numbers.substep_s);
        }
    }
}

#[test]
fn a_push_with_drag_brings_the_air_to_its_speed() {
    let mut scene = windy([8, 6, 5], [50.0; 3], 0.0, Scheme::Explicit);
    scene.effects.body_force = Some(BodyForce {
        lower_m: [-1.0; 3],
        upper_m: [1e4; 3],
        acceleration_m_s2: [0.02, -0.01, 0.0],
        drag_per_s: 0.004,
    });
    let mut world = World::new(scene.clone(), None).expect("a world");
    let seconds = 300.0;
    while world.simulated_s() < seconds - 1e-6 {
        world.advance_by(1.0);
    }
    // Uniform air pushed everywhere moves as one: u = a / r (1 - exp(-r t)).
    let share = 1.0 - (-0.004f64 * seconds).exp();
    for (field, a) in [(Field::VelocityX, 0.02), (Field::VelocityY, -0.01)] {
        let expected = a / 0.004 * share;
        for v in world.device().read(field).expect("planned").iter() {
            // First order in time: half a step of 1 s times the drag.
            assert!(
                (*v as f64 - expected).abs() < 0.005 * expected.abs(),
                "{v} for {expected}"
            );
        }
    }
    // A push on a part gives the whole what it gives the part: momentum of the box grows by force times mass.
    if let Some(force) = &mut scene.effects.body_force {
        force.lower_m = [100.0, 0.0, 50.0];
        force.upper_m = [200.0, 150.0, 150.0];
        force.drag_per_s = 0.0;
    }
    let mut world = World::new(scene, None).expect("a world");
    for _ in 0..10 {
        world.advance_by(1.0);
    }
    let u = world.device().read(Field::VelocityX).expect("planned");
    let p = world.parameters();
    let plane = p.grid.plane();
    let momentum: f64 = u
        .iter()
        .enumerate()
        .map(|(i, &u)| u as f64 * p.density_kg_m3[i / plane] as f64)
        .sum();
    // Two faces east, three rows, two levels.
    let pushed = 6.0 * (p.density_kg_m3[1] + p.density_kg_m3[2]) as f64 * 0.02 * 10.0;
    assert!((momentum / pushed - 1.0).abs() < 1e-4, "{momentum} for {pushed}");
    assert!(u.iter().any(|&u| u > 0.05) && world.numbers().divergence_max_per_s < 1e-5);
}

/// Where the cloud is along the periodic x axis, m, and the wind that carries it, m/s; both weighted by cloud water.
fn cloud_and_its_wind(world: &World) -> (f64, f64) {
    let grid = world.parameters().grid;
    let nx = grid.cells[0];
    let cloud = world.device().read(Field::CloudWater).expect("planned");
    let u = world.device().read(Field::VelocityX).expect("planned");
    let (mut sine, mut cosine, mut water, mut flux) = (0.0, 0.0, 0.0, 0.0);
    for (i, &q) in cloud.iter().enumerate() {
        let angle = 2.0 * PI * ((i % nx) as f64 + 0.5) / nx as f64;
        sine += q as f64 * angle.sin();
        cosine += q as f64 * angle.cos();
        water += q as f64;
        flux += (q * u[i]) as f64;
    }
    assert!(water > 0.0, "no cloud after {} s", world.simulated_s());
    let turn = f64::atan2(sine, cosine) / (2.0 * PI);
    (turn.rem_euclid(1.0) * grid.size_m()[0] as f64, flux / water)
}

#[test]
fn a_cloud_drifts_through_the_wind_tunnel_of_seed_004() {
    let scene = presets::find("wind-tunnel").expect("a preset");
    assert_eq!(scene.domain.cells, [100, 40, 40]);
    let mut world = World::new(scene, None).expect("a world");
    // The seed's solver: linear semi-Lagrangian, implicit diffusion, Jacobi.
    let methods = &world.parameters().methods;
    assert_eq!(methods.advection, Rung::SemiLagrangianLinear);
    assert_eq!(methods.pressure, PressureMethod::Jacobi { sweeps: 40 });
    let mixing = world.parameters().constant_viscosity.as_ref().expect("viscosity");
    assert_eq!(mixing.scheme, DiffusionScheme::Implicit);
    let mean = |world: &World| {
        let u = world.device().read(Field::VelocityX).expect("planned");
        u.iter().map(|&u| u as f64).sum::<f64>() / u.len() as f64
    };
    let start = mean(&world);
    world.advance_to(120.0, |_| true);
    let (from, wind_then) = cloud_and_its_wind(&world);
    world.advance_to(300.0, |_| true);
    let (to, wind_now) = cloud_and_its_wind(&world);
    let drift = (to - from).rem_euclid(5000.0);
    let carried = 180.0 * 0.5 * (wind_then + wind_now);
    eprintln!(
        "the cloud drifts {drift:.0} m in 180 s, its wind ({wind_then:.2}, then {wind_now:.2} m/s) carries {carried:.0} m"
    );
    // It grows and dissolves at its edges on the way, and so is not carried as a whole.
    assert!(
        (0.5..1.6).contains(&(drift / carried)) && carried > 200.0,
        "{drift} m for {carried} m"
    );
    // The fan: 0.05 m/s2 on a tenth of the air for 300 s, less its drag.
    let gained = mean(&world) - start;
    assert!((0.3..1.5).contains(&gained), "the fan gave {gained} m/s");
    let numbers = world.numbers();
    eprintln!(
        "divergence {:.1e} per s, substep {} s",
        numbers.divergence_max_per_s, numbers.substep_s
    );
    // A hundredth of a cell's air a substep, at the worst place: what forty sweeps leave.
    assert!(numbers.divergence_max_per_s * numbers.substep_s < 0.03);
}
