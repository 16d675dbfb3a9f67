//! Hard cases: a catalogue that only grows. Each runs on every rung of a ladder and must stay finite and bounded, with no negative water.

use welkin_proto::scene::{Advection, BaseState, Pressure, ProfileLevel};
use welkin_proto::wire::HealthState;
use welkin_proto::{Scene, presets};
use welkin_server::machine::{Compute, Machine};
use welkin_server::world::World;
use welkin_shaders::catalogue::{Field, Ladder};

struct Case {
    name: &'static str,
    preset: &'static str,
    change: fn(&mut Scene),
    seconds: f64,
    /// No air may move faster than this, m/s.
    speed_max_m_s: f64,
}

const CASES: &[Case] = &[
    Case {
        name: "one column",
        preset: "fair-weather-cumulus",
        change: |s| s.domain.cells = [1, 1, 75],
        seconds: 1800.0,
        speed_max_m_s: 30.0,
    },
    Case {
        name: "two cells",
        preset: "fair-weather-cumulus",
        change: |s| s.domain.cells = [2, 2, 2],
        seconds: 3600.0,
        speed_max_m_s: 30.0,
    },
    Case {
        name: "three cells",
        preset: "warm-bubble",
        change: |s| s.domain.cells = [3, 3, 3],
        seconds: 3600.0,
        speed_max_m_s: 60.0,
    },
    Case {
        name: "cells a thousand times wider than high",
        preset: "fair-weather-cumulus",
        change: |s| {
            s.domain.cells = [8, 8, 75];
            s.domain.cell_size_m = [40_000.0, 40_000.0, 40.0];
        },
        seconds: 7200.0,
        speed_max_m_s: 60.0,
    },
    Case {
        name: "tick of ten minutes",
        preset: "fair-weather-cumulus",
        change: |s| {
            small(s);
            s.time.tick_s = 600.0;
        },
        seconds: 3600.0,
        speed_max_m_s: 40.0,
    },
    Case {
        name: "tick of ten milliseconds",
        preset: "fair-weather-cumulus",
        change: |s| {
            small(s);
            s.time.tick_s = 0.01;
            s.time.spin_up_s = 0.0;
        },
        seconds: 0.5,
        speed_max_m_s: 20.0,
    },
    Case {
        name: "heating a hundred times too strong",
        preset: "fair-weather-cumulus",
        change: |s| {
            small(s);
            if let Some(f) = &mut s.effects.surface {
                f.heat_flux_k_m_s *= 100.0;
                f.moisture_flux_m_s *= 100.0;
            }
        },
        seconds: 900.0,
        speed_max_m_s: 150.0,
    },
    Case {
        name: "bubble of 60 K",
        preset: "warm-bubble",
        change: |s| {
            s.domain.cells = [24, 24, 32];
            if let Some(b) = &mut s.effects.bubble {
                b.potential_temperature_k = 60.0;
            }
        },
        seconds: 300.0,
        speed_max_m_s: 300.0,
    },
    Case {
        name: "cold pool of 15 K touches down",
        preset: "density-current",
        change: |s| s.domain.cells = [128, 1, 32],
        seconds: 600.0,
        speed_max_m_s: 80.0,
    },
    Case {
        name: "wind of 150 m/s",
        preset: "clear-sky-wind",
        change: |s| {
            s.domain.cells = [16, 16, 8];
            if let BaseState::Isentropic { wind_x_m_s, .. } = &mut s.base_state {
                *wind_x_m_s = 150.0;
            }
        },
        seconds: 600.0,
        speed_max_m_s: 160.0,
    },
    Case {
        name: "noise of 5 K from cell to cell",
        preset: "fair-weather-cumulus",
        change: |s| {
            small(s);
            if let Some(n) = &mut s.effects.noise {
                n.potential_temperature_k = 5.0;
                n.total_water_kg_per_kg = 3e-3;
            }
        },
        seconds: 600.0,
        speed_max_m_s: 80.0,
    },
    Case {
        name: "three times as much water as saturates",
        preset: "warm-bubble",
        change: |s| {
            s.domain.cells = [24, 24, 32];
            if let Some(b) = &mut s.effects.bubble {
                b.total_water_kg_per_kg = 0.04;
            }
        },
        seconds: 300.0,
        speed_max_m_s: 120.0,
    },
    Case {
        name: "absolutely dry air with the moist passes on",
        preset: "warm-bubble",
        change: |s| {
            s.domain.cells = [24, 24, 32];
            if let BaseState::ConstantStability { relative_humidity, .. } = &mut s.base_state {
                *relative_humidity = 0.0;
            }
            if let Some(b) = &mut s.effects.bubble {
                b.total_water_kg_per_kg = 0.0;
            }
        },
        seconds: 300.0,
        speed_max_m_s: 60.0,
    },
    Case {
        name: "deep convection",
        preset: "deep-convection",
        change: |s| s.domain.cells = [32, 32, 60],
        seconds: 1800.0,
        speed_max_m_s: 120.0,
    },
    Case {
        name: "air of -80 C at the ground",
        preset: "warm-bubble",
        change: |s| {
            warmth(s, 193.0);
            // The preset's bubble holds a thousand times the water that such air can: that would be another case.
            if let Some(b) = &mut s.effects.bubble {
                b.total_water_kg_per_kg = 0.0;
            }
        },
        seconds: 300.0,
        speed_max_m_s: 60.0,
    },
    Case {
        name: "air of +60 C at the ground",
        preset: "warm-bubble",
        change: |s| warmth(s, 333.0),
        seconds: 300.0,
        speed_max_m_s: 120.0,
    },
    Case {
        name: "wind shear of 100 m/s a kilometre",
        preset: "fair-weather-cumulus",
        change: |s| {
            small(s);
            levels(s, |l| l.wind_x_m_s = 0.1 * l.height_m);
        },
        seconds: 300.0,
        speed_max_m_s: 400.0,
    },
    Case {
        name: "superadiabatic air, 10 K a kilometre",
        preset: "fair-weather-cumulus",
        change: |s| {
            small(s);
            levels(s, |l| {
                l.liquid_water_potential_temperature_k = 310.0 - 0.01 * l.height_m
            });
        },
        seconds: 600.0,
        speed_max_m_s: 80.0,
    },
    Case {
        name: "inversion of 20 K within a cell",
        preset: "fair-weather-cumulus",
        change: |s| {
            small(s);
            levels(s, |l| {
                if l.height_m > 1480.0 {
                    l.liquid_water_potential_temperature_k += 20.0;
                }
            });
            if let BaseState::Profile { levels, .. } = &mut s.base_state {
                let mut above = levels[2].clone();
                above.height_m += 1.0;
                above.liquid_water_potential_temperature_k += 20.0;
                levels.insert(3, above);
            }
        },
        seconds: 900.0,
        speed_max_m_s: 60.0,
    },
];

fn warmth(scene: &mut Scene, potential_temperature_k: f64) {
    scene.domain.cells = [16, 16, 32];
    if let BaseState::ConstantStability {
        surface_potential_temperature_k,
        ..
    } = &mut scene.base_state
    {
        *surface_potential_temperature_k = potential_temperature_k;
    }
}

fn levels(scene: &mut Scene, change: impl Fn(&mut ProfileLevel)) {
    let BaseState::Profile { levels, .. } = &mut scene.base_state else {
        panic!("the preset's air is no table")
    };
    levels.iter_mut().for_each(change);
}

fn small(scene: &mut Scene) {
    scene.domain.cells = [12, 12, 75];
}

/// A way to run every case: it changes the scene, once the case has.
struct Rung {
    name: &'static str,
    choose: fn(&mut Scene),
    /// Largest divergence of the mass flux that the pressure may leave, 1/s.
    divergence_max_per_s: f64,
}

/// What the direct solver leaves.
const ROUNDING_PER_S: f64 = 1e-4;

fn pressure(scene: &mut Scene, solver: Pressure) {
    if scene.effects.flow.is_some() {
        scene.methods.pressure = Some(solver);
    }
}

fn advection(scene: &mut Scene, rung: Advection, courant_max: f64) {
    if let Some(flow) = &mut scene.effects.flow {
        scene.methods.advection = Some(rung);
        flow.courant_max = courant_max;
    }
}

/// The rungs that every case is run on: of the advection ladder each at its claimed limit, and flux form at the presets' Courant number; of the
/// pressure ladder each at its default setting.
const RUNGS: &[Rung] = &[
    Rung {
        name: "flux form",
        choose: |s| advection(s, Advection::FluxForm, 1.0),
        divergence_max_per_s: ROUNDING_PER_S,
    },
    Rung {
        name: "flux form at its limit",
        choose: |s| advection(s, Advection::FluxForm, 1.4),
        divergence_max_per_s: ROUNDING_PER_S,
    },
    Rung {
        name: "linear at its limit",
        choose: |s| advection(s, Advection::SemiLagrangianLinear, 50.0),
        divergence_max_per_s: ROUNDING_PER_S,
    },
    Rung {
        name: "MacCormack at its limit",
        choose: |s| advection(s, Advection::MacCormack, 50.0),
        divergence_max_per_s: ROUNDING_PER_S,
    },
    Rung {
        name: "cubic at its limit",
        choose: |s| advection(s, Advection::SemiLagrangianCubic, 50.0),
        divergence_max_per_s: ROUNDING_PER_S,
    },
    Rung {
        name: "multigrid",
        choose: |s| pressure(s, Pressure::Multigrid { cycles: 4 }),
        divergence_max_per_s: ROUNDING_PER_S,
    },
    Rung {
        name: "red-black SOR",
        choose: |s| {
            pressure(
                s,
                Pressure::RedBlackSor {
                    sweeps: 20,
                    relaxation: 1.7,
                },
            );
        },
        divergence_max_per_s: 1e-3,
    },
    Rung {
        name: "Jacobi",
        choose: |s| pressure(s, Pressure::Jacobi { sweeps: 40 }),
        divergence_max_per_s: 1e-2,
    },
];

/// What is wrong with a world at the end of a case, or nothing.
fn complaint(world: &World, case: &Case, rung: &Rung) -> Result<(), String> {
    let numbers = world.numbers();
    let speed = numbers.wind_max_m_s.max(numbers.updraught_max_m_s);
    if speed.is_nan() || speed >= case.speed_max_m_s {
        return Err(format!("{speed} m/s"));
    }
    let divergence = numbers.divergence_max_per_s;
    if divergence.is_nan() || divergence >= rung.divergence_max_per_s {
        return Err(format!("divergence {:e}", numbers.divergence_max_per_s));
    }
    for field in [
        Field::VelocityX,
        Field::VelocityY,
        Field::VelocityZ,
        Field::Heat,
        Field::Water,
    ] {
        let values = world.device().read(field).unwrap_or_default();
        if !values.iter().all(|v| v.is_finite()) {
            return Err(format!("{} is not finite", field.name()));
        }
    }
    let heat = world.device().read(Field::Heat).unwrap_or_default();
    if !heat.iter().all(|t| t.abs() < 150.0) {
        return Err("potential temperature out of bounds".to_owned());
    }
    let water = world.device().read(Field::Water).unwrap_or_default();
    let least = water.iter().copied().fold(f32::MAX, f32::min);
    if least < 0.0 {
        return Err(format!("total water {least:e} kg/kg"));
    }
    let cloud = world.device().read(Field::CloudWater).unwrap_or_default();
    if !cloud.iter().all(|&q| (0.0..0.2).contains(&q)) {
        return Err("cloud water out of bounds".to_owned());
    }
    Ok(())
}

/// Runs every case on the rung of that name, on the CPU device.
fn run_all(name: &str) {
    run_on(name, &None.into(), 1.0);
}

/// Runs every case on the rung of that name for a share of its time.
fn run_on(name: &str, machine: &Machine, share: f64) {
    let rung = RUNGS.iter().find(|r| r.name == name).expect("a rung of that name");
    let mut complaints = Vec::new();
    for case in CASES {
        let mut scene = presets::find(case.preset).expect("a preset");
        (case.change)(&mut scene);
        (rung.choose)(&mut scene);
        let tick_s = scene.time.tick_s;
        let mut world = World::new(scene, machine.clone()).unwrap_or_else(|e| panic!("{}: {e}", case.name));
        let seconds = share * case.seconds;
        while world.simulated_s() < seconds - 1e-6 && !world.is_halted() {
            world.advance_by(tick_s.max(seconds / 60.0).min(seconds));
        }
        let numbers = world.numbers();
        if numbers.retries > 0 {
            println!(
                "{name}, {}: {} retries, {:?}",
                case.name, numbers.retries, numbers.trouble_message
            );
        }
        // The watchdog's bounds are no tighter than what a healthy run does on any rung.
        if numbers.restores > 0 {
            complaints.push(format!("{}: went back, {:?}", case.name, numbers.trouble_message));
        }
        if let Err(what) = complaint(&world, case, rung) {
            complaints.push(format!("{}: {what}", case.name));
        }
    }
    assert!(complaints.is_empty(), "{name}: {complaints:#?}");
}

#[test]
fn every_rung_has_its_test() {
    let source = include_str!("hard_cases.rs");
    for rung in RUNGS {
        assert!(source.contains(&format!("run_all(\"{}\")", rung.name)), "{}", rung.name);
    }
    for rung in Ladder::Advection.rungs().filter(|r| r.is_there()) {
        let on = |r: &&Rung| {
            let mut scene = presets::find("clear-sky-wind").expect("a preset");
            (r.choose)(&mut scene);
            let chosen = welkin_server::methods::choose(&scene).expect("a choice");
            let limit = rung.info().advance.expect("advection").courant_max;
            chosen.methods.advection == rung && chosen.courant_max == Some(limit)
        };
        assert!(
            RUNGS.iter().any(|r| on(&r)),
            "{} is not tried at its limit",
            rung.info().name
        );
    }
}

#[test]
fn flux_form_survives() {
    run_all("flux form");
}

#[test]
fn flux_form_survives_at_its_limit() {
    run_all("flux form at its limit");
}

#[test]
fn linear_survives_at_its_limit() {
    run_all("linear at its limit");
}

#[test]
fn mac_cormack_survives_at_its_limit() {
    run_all("MacCormack at its limit");
}

#[test]
fn cubic_survives_at_its_limit() {
    run_all("cubic at its limit");
}

#[test]
fn multigrid_survives() {
    run_all("multigrid");
}

#[test]
fn red_black_sor_survives() {
    run_all("red-black SOR");
}

#[test]
fn jacobi_survives() {
    run_all("Jacobi");
}

#[test]
fn what_is_not_finite_is_undone_and_shows() {
    for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut scene = presets::find("fair-weather-cumulus").expect("a preset");
        small(&mut scene);
        let mut world = World::new(scene, None).expect("a world");
        let mut velocity = world.device().read(Field::VelocityZ).expect("planned").to_vec();
        velocity[500] = poison;
        world.write_field(Field::VelocityZ, &velocity).expect("planned");
        // Must come back, and with a state that can be run on.
        world.advance_by(20.0);
        assert_eq!(
            world.watchdog().health(),
            HealthState::Degraded,
            "{poison} went unnoticed"
        );
        let finite = |values: &[f32]| values.iter().all(|v| v.is_finite());
        assert!(
            finite(&world.device().read(Field::VelocityZ).expect("planned")),
            "{poison} is still there"
        );
        world.advance_by(20.0);
        assert_eq!((world.simulated_s(), world.watchdog().restores()), (20.0, 1));
    }
}

#[test]
fn every_case_is_survived_on_a_gpu() {
    let compute = match Compute::choose("gpu") {
        Ok(compute) => compute,
        Err(error) => {
            welkin_tests::skip("every_case_is_survived_on_a_gpu", "gpu", error);
            return;
        }
    };
    let machine = Machine { threads: None, compute };
    // A share of the time: a software adapter takes twenty times as long. Multigrid has no shaders.
    for rung in RUNGS.iter().filter(|r| r.name != "multigrid") {
        run_on(rung.name, &machine, 0.03);
    }
}

#[test]
fn a_checkerboard_and_a_jump_are_survived_by_every_rung() {
    for rung in RUNGS {
        let mut scene = presets::find("fair-weather-cumulus").expect("a preset");
        small(&mut scene);
        (rung.choose)(&mut scene);
        let mut world = World::new(scene, None).expect("a world");
        let [nx, ny, _] = world.parameters().grid.cells;
        let place = |i: usize| [i % nx, i / nx % ny, i / (nx * ny)];
        let add = |world: &mut World, field: Field, amount: &dyn Fn([usize; 3]) -> f32| {
            let mut values = world.device().read(field).expect("planned").to_vec();
            values.iter_mut().enumerate().for_each(|(i, v)| *v += amount(place(i)));
            world.write_field(field, &values).expect("planned");
        };
        // From cell to cell 20 m/s and 4 K to and fro; half of the box 10 K warmer than the other.
        let sign = |[x, y, z]: [usize; 3]| if (x + y + z).is_multiple_of(2) { 1.0f32 } else { -1.0 };
        add(&mut world, Field::VelocityX, &|p| 10.0 * sign(p));
        add(&mut world, Field::VelocityY, &|p| -10.0 * sign(p));
        add(&mut world, Field::Heat, &|p| {
            2.0 * sign(p) + if p[0] < nx / 2 { 10.0 } else { 0.0 }
        });
        for _ in 0..30 {
            world.advance_by(5.0);
        }
        let numbers = world.numbers();
        assert_eq!(numbers.restores, 0, "{}: {:?}", rung.name, numbers.trouble_message);
        let case = Case {
            name: "checkerboard",
            preset: "fair-weather-cumulus",
            change: |_| {},
            seconds: 150.0,
            speed_max_m_s: 100.0,
        };
        if let Err(what) = complaint(&world, &case, rung) {
            panic!("{}: {what}", rung.name);
        }
    }
}
