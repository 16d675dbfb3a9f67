//! Whole worlds on both devices: a tick, two hundred ticks, two worlds on one adapter, a device that is lost.

mod common;

use std::sync::Arc;

use common::adapter;
use welkin_proto::scene::{Advection, ConstantViscosity, DiffusionScheme, Pressure};
use welkin_proto::{Scene, presets};
use welkin_server::machine::{Compute, Machine};
use welkin_server::world::World;
use welkin_shaders::catalogue::Field;

fn gpu() -> Machine {
    Machine {
        threads: None,
        compute: Compute::choose("gpu").expect("an adapter"),
    }
}

fn cumulus(cells: [u32; 3]) -> Scene {
    let mut scene = presets::find("fair-weather-cumulus").expect("a preset");
    scene.domain.cells = cells;
    scene.domain.cell_size_m[2] = 3000.0 / cells[2] as f64;
    scene
}

fn field(world: &World, which: Field) -> Vec<f32> {
    world.device().read(which).expect("a planned field").to_vec()
}

fn largest_difference(a: &[f32], b: &[f32]) -> f32 {
    assert!(a.iter().chain(b).all(|v| v.is_finite()));
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn a_tick_of_the_default_scene_agrees() {
    if adapter("a_tick_of_the_default_scene_agrees").is_none() {
        return;
    }
    let scene = presets::find(presets::DEFAULT).expect("a preset");
    let mut worlds = [None.into(), gpu()].map(|m: Machine| World::new(scene.clone(), m).expect("a world"));
    for world in &mut worlds {
        world.advance_by(4.0);
    }
    let [cpu, gpu] = &worlds;
    assert_eq!(cpu.numbers().substeps, gpu.numbers().substeps);
    // Rounding of one tick: some units in the last place of winds of 9 m/s, heat of 10 K and water of 0.02.
    for (which, allowed) in [
        (Field::VelocityX, 2e-5),
        (Field::VelocityY, 2e-5),
        (Field::VelocityZ, 2e-5),
        (Field::Heat, 3e-5),
        (Field::Water, 3e-8),
    ] {
        let found = largest_difference(&field(cpu, which), &field(gpu, which));
        assert!(
            found <= allowed,
            "{} differs by {found:e}; {allowed:e} is allowed",
            which.name()
        );
    }
    assert!(
        gpu.numbers().divergence_max_per_s < 1e-6,
        "{}",
        gpu.numbers().divergence_max_per_s
    );
    assert!(gpu.numbers().divergence_max_per_s > 0.0);
}

#[test]
fn some_ticks_of_every_rung_agree() {
    if adapter("some_ticks_of_every_rung_agree").is_none() {
        return;
    }
    let machine = gpu();
    let of = |advection, pressure, mixing| (Some(advection), Some(pressure), mixing);
    let sor = Pressure::RedBlackSor {
        sweeps: 6,
        relaxation: 1.5,
    };
    for (advection, pressure, mixing) in [
        of(Advection::SemiLagrangianLinear, Pressure::Direct {}, None),
        of(Advection::MacCormack, Pressure::Direct {}, None),
        of(Advection::SemiLagrangianCubic, Pressure::Direct {}, None),
        of(
            Advection::FluxForm,
            Pressure::Jacobi { sweeps: 9 },
            Some(DiffusionScheme::Explicit),
        ),
        of(Advection::MacCormack, sor, Some(DiffusionScheme::Implicit)),
    ] {
        let mut scene = cumulus([13, 12, 20]);
        scene.methods.advection = advection;
        scene.methods.pressure = pressure;
        if let Some(scheme) = mixing {
            scene.effects.turbulence = None;
            scene.effects.constant_viscosity = Some(ConstantViscosity {
                viscosity_m2_s: 10.0,
                diffusivity_m2_s: 30.0,
                scheme,
            });
        }
        let what = format!("{advection:?}, {:?}, {mixing:?}", scene.methods.pressure);
        let [cpu, gpu] = [None.into(), machine.clone()].map(|machine: Machine| {
            let mut world = World::new(scene.clone(), machine).expect("a world");
            (0..5).for_each(|_| world.advance_by(8.0));
            world
        });
        assert_eq!(cpu.numbers().substeps, gpu.numbers().substeps, "{what}");
        // Rounding of a tick (see above) grows with each; of flux form most, whose weights magnify it (1.5e-7 of water here, elsewhere 1e-8).
        for (which, allowed) in [
            (Field::VelocityX, 3e-5),
            (Field::VelocityY, 3e-5),
            (Field::VelocityZ, 3e-5),
            (Field::Heat, 5e-5),
            (Field::Water, 5e-7),
        ] {
            let found = largest_difference(&field(&cpu, which), &field(&gpu, which));
            println!("{what}: {} {found:.1e} of {allowed:e}", which.name());
            assert!(
                found <= allowed,
                "{what}: {} differs by {found:e}; {allowed:e} is allowed",
                which.name()
            );
        }
        let water = |world: &World| world.numbers().total_water_path_kg_m2.expect("moist");
        assert!((water(&cpu) / water(&gpu) - 1.0).abs() < 1e-6, "{what}");
    }
}

#[test]
fn two_hundred_ticks_stay_statistically_the_same() {
    if adapter("two_hundred_ticks_stay_statistically_the_same").is_none() {
        return;
    }
    // Coarse, so that it lasts seconds: 200 ticks of 20 s are more than an hour, in which cumulus has formed.
    let mut scene = cumulus([24, 24, 40]);
    scene.domain.cell_size_m[0] = 150.0;
    scene.domain.cell_size_m[1] = 150.0;
    let numbers = [None.into(), gpu()].map(|machine: Machine| {
        let mut world = World::new(scene.clone(), machine).expect("a world");
        let mut sums = [0.0; 4];
        for tick in 0..200 {
            world.advance_by(20.0);
            assert_eq!(world.watchdog().restores(), 0, "{:?}", world.watchdog().trouble());
            let n = world.numbers();
            if tick >= 100 {
                sums[0] += n.cloud_cover.expect("moist") / 100.0;
                sums[1] += n.cloud_base_m.unwrap_or(600.0) / 100.0;
                sums[2] += n.updraught_max_m_s / 100.0;
                sums[3] += n.total_water_path_kg_m2.expect("moist") / 100.0;
            }
        }
        sums
    });
    let [a, b] = numbers;
    // The two runs part after some minutes, as any two that differ in a last bit; their means over half an hour stay within the weather's own scatter.
    assert!(a[0] > 0.01, "no cloud to compare: {a:?}");
    assert!((a[0] - b[0]).abs() < 0.08, "cover {} and {}", a[0], b[0]);
    assert!((a[1] - b[1]).abs() < 150.0, "base {} and {}", a[1], b[1]);
    assert!((a[2] / b[2] - 1.0).abs() < 0.35, "updraught {} and {}", a[2], b[2]);
    // Sources are named and equal: water is kept to rounding on both.
    assert!((a[3] / b[3] - 1.0).abs() < 1e-4, "water {} and {}", a[3], b[3]);
}

#[test]
fn a_world_on_the_gpu_repeats_itself_bit_for_bit() {
    if adapter("a_world_on_the_gpu_repeats_itself_bit_for_bit").is_none() {
        return;
    }
    let runs = [(); 2].map(|()| {
        let mut world = World::new(cumulus([12, 10, 20]), gpu()).expect("a world");
        for _ in 0..10 {
            world.advance_by(10.0);
        }
        [Field::VelocityZ, Field::Heat, Field::Water].map(|f| field(&world, f))
    });
    assert!(runs[0] == runs[1]);
}

#[test]
fn two_worlds_on_one_adapter_do_not_touch_each_other() {
    if adapter("two_worlds_on_one_adapter_do_not_touch_each_other").is_none() {
        return;
    }
    let machine = gpu();
    let alone = {
        let mut world = World::new(cumulus([12, 10, 20]), machine.clone()).expect("a world");
        (0..6).for_each(|_| world.advance_by(10.0));
        field(&world, Field::Heat)
    };
    let mut first = World::new(cumulus([12, 10, 20]), machine.clone()).expect("a world");
    let mut bubble = presets::find("warm-bubble").expect("a preset");
    bubble.domain.cells = [9, 7, 16];
    let mut second = World::new(bubble, machine).expect("a world");
    for _ in 0..6 {
        first.advance_by(10.0);
        second.advance_by(7.0);
    }
    assert!(field(&first, Field::Heat) == alone);
    assert!(second.watchdog().restores() == 0 && second.numbers().updraught_max_m_s > 0.0);
}

#[test]
fn an_adapter_that_is_not_there_is_named_with_those_that_are() {
    let error = Compute::choose("no such adapter").expect_err("there is none");
    assert_eq!(error.code, "no_adapter");
    assert!(error.message.contains("no such adapter"), "{}", error.message);
    assert!(matches!(Compute::choose("cpu"), Ok(Compute::Cpu)));
}

#[test]
fn lines_too_long_for_the_transform_are_refused() {
    let Some(context) = adapter("lines_too_long_for_the_transform_are_refused") else {
        return;
    };
    let error = context
        .storage("a field", context.binding_bytes_max() + 4)
        .expect_err("more than a binding");
    assert_eq!(error.code(), "device_limit");
    drop::<Arc<_>>(context);
}

#[test]
fn a_world_whose_device_is_lost_is_rebuilt_and_says_so() {
    if adapter("a_world_whose_device_is_lost_is_rebuilt_and_says_so").is_none() {
        return;
    }
    use welkin_proto::wire::HealthState;
    let machine = gpu();
    let mut world = World::new(cumulus([12, 10, 20]), machine.clone()).expect("a world");
    let start = field(&world, Field::Heat);
    for _ in 0..3 {
        world.advance_by(5.0);
    }
    assert_eq!(world.numbers().health, HealthState::Good);
    let lost = machine.compute.context().expect("a GPU");
    lost.device.destroy();
    world.advance_by(5.0);
    let numbers = world.numbers();
    assert_eq!(numbers.health, HealthState::Degraded, "{:?}", numbers.trouble_message);
    assert_eq!(numbers.trouble_code.as_deref(), Some("device_lost"));
    // The host's copy is that of the start: the next one is made after some seconds of wall time.
    assert_eq!(world.simulated_s(), 0.0);
    assert!(field(&world, Field::Heat) == start);
    assert!(!Arc::ptr_eq(&lost, &machine.compute.context().expect("opened again")));
    for _ in 0..3 {
        world.advance_by(5.0);
    }
    assert_eq!(world.simulated_s(), 15.0);
    assert!(world.snapshot().volume.is_some());
}

#[test]
fn effects_change_while_a_world_runs_on_either_device() {
    use welkin_server::change::Change;
    let mut machines: Vec<Machine> = vec![None.into()];
    if adapter("effects_change_while_a_world_runs_on_either_device").is_some() {
        machines.push(gpu());
    }
    for machine in machines {
        let mut world = World::new(cumulus([12, 10, 20]), machine.clone()).expect("a world");
        world.advance_by(20.0);
        let whole = world.scene().effects.clone();
        let heat = field(&world, Field::Heat);
        // Made ready while the world stands where it stands; nothing of it changes until it is taken over.
        let mut dry = whole.clone();
        dry.moisture = None;
        dry.turbulence = None;
        dry.large_scale = None;
        dry.noise = None;
        dry.surface.as_mut().expect("a surface").moisture_flux_m_s = 0.0;
        dry.cloud_detail = None;
        dry.multiple_scattering = None;
        dry.cloud_shadow = None;
        let change = Change::prepare(world.scene(), dry, &machine).expect("other effects");
        assert!(world.device().read(Field::Water).is_some());
        world.adopt(change);
        assert!(world.device().read(Field::Water).is_none() && world.snapshot().volume.is_none());
        assert!(
            field(&world, Field::Heat) == heat,
            "what both plans hold goes on as it is"
        );
        assert_eq!(world.simulated_s(), 20.0);
        world.advance_by(20.0);
        let wind = field(&world, Field::VelocityX);
        let back = Change::prepare(world.scene(), whole, &machine).expect("the effects of before");
        world.adopt(back);
        assert!(field(&world, Field::VelocityX) == wind);
        assert!(world.snapshot().volume.is_some());
        world.advance_by(20.0);
        assert_eq!(world.simulated_s(), 60.0);
        assert_eq!(world.numbers().retries, 0);
    }
}

#[test]
fn a_tick_that_is_judged_during_the_next_gives_the_same_bits() {
    if adapter("a_tick_that_is_judged_during_the_next_gives_the_same_bits").is_none() {
        return;
    }
    use welkin_proto::wire::HealthState;
    use welkin_server::watchdog::{Damage, Fault};
    let fault = |field, damage, strikes| Fault {
        tick: 3,
        substep: 0,
        field,
        damage,
        strikes,
    };
    // Nothing; what a retry gets over; what only the tick's end shows; what no retry gets over.
    let faults = [
        None,
        Some(fault(Field::VelocityZ, Damage::Cell(700, f32::NAN), 1)),
        Some(fault(Field::Water, Damage::Scale(0.5), 1)),
        Some(fault(Field::Heat, Damage::Cell(700, f32::NAN), 9)),
    ];
    for (n, fault) in faults.into_iter().enumerate() {
        let [waiting, ahead] = [false, true].map(|ahead| {
            let mut world = World::new(cumulus([12, 10, 20]), gpu()).expect("a world");
            if let Some(fault) = fault {
                world.inject(fault);
            }
            for _ in 0..8 {
                if ahead { world.tick_ahead() } else { world.tick() }
            }
            world.settle();
            world
        });
        let numbers = [&waiting, &ahead].map(|world| {
            let numbers = world.numbers();
            (
                numbers.tick,
                numbers.simulated_s,
                numbers.retries,
                numbers.restores,
                numbers.health,
                numbers.trouble_code,
            )
        });
        assert_eq!(numbers[0], numbers[1], "fault {n}");
        let (_, _, retries, restores, health, _) = &numbers[0];
        match n {
            0 => assert_eq!((*retries, *restores, *health), (0, 0, HealthState::Good)),
            1 | 2 => assert_eq!((*retries, *restores, *health), (1, 0, HealthState::Good)),
            _ => assert_eq!((*restores, *health), (1, HealthState::Degraded)),
        }
        for which in Field::STATE {
            assert!(
                field(&waiting, which) == field(&ahead, which),
                "fault {n}: {}",
                which.name()
            );
        }
        assert_eq!(
            waiting.numbers().total_water_path_kg_m2,
            ahead.numbers().total_water_path_kg_m2
        );
    }
}

#[test]
fn weather_of_a_gpu_is_that_of_its_own_state_and_a_lost_one_gives_none() {
    use welkin_proto::Channel;
    use welkin_server::weather::{FieldSet, Weather};
    if adapter("weather_of_a_gpu_is_that_of_its_own_state_and_a_lost_one_gives_none").is_none() {
        return;
    }
    let machine = gpu();
    let mut scene = cumulus([12, 12, 20]);
    // Cloud from the start: the lower half of the box is moistened beyond saturation.
    scene.effects.noise = None;
    let mut world = World::new(scene, machine.clone()).expect("a world");
    let wet: Vec<f32> = field(&world, Field::Water).iter().map(|w| w * 1.3).collect();
    world.write_field(Field::Water, &wet).expect("a field of the state");
    world.advance_by(4.0);
    let snapshot = world.snapshot();
    let copied = world.weather(FieldSet::ALL, snapshot.volume.clone()).expect("a device");
    let weather = Weather::new(copied, 1);
    let there = |channel| weather.field(channel).expect("the scene has it");
    let total = there(Channel::TotalWaterKgKg);
    assert_eq!(total[..], field(&world, Field::Water)[..]);
    assert_eq!(
        there(Channel::ExtinctionPerM)[..],
        snapshot.volume.expect("a cloud").extinction_per_m[..]
    );
    // Derived on the host, by the kernel whose twin made the GPU's: the catalogue's tolerance of that pass.
    let (host, device) = (there(Channel::LiquidWaterKgKg), field(&world, Field::CloudWater));
    let largest = device.iter().copied().fold(0.0, f32::max);
    assert!(largest > 1e-4, "{largest} kg/kg is no cloud");
    let found = largest_difference(&host, &device);
    assert!(found <= 6e-5 * largest, "{found:e} of {largest:e}");
    let only_wind = world.weather(FieldSet::of(&[Channel::WindXMS]), weather.volume.clone());
    let only_wind = Weather::new(only_wind.expect("a device"), 2);
    assert!(only_wind.field(Channel::WindZMS).is_ok() && only_wind.field(Channel::TemperatureK).is_err());

    let lost = machine.compute.context().expect("a GPU");
    lost.device.destroy();
    assert!(world.weather(FieldSet::ALL, weather.volume.clone()).is_none());
}
