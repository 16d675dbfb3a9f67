//! Every stage of the simulation on both devices: the same random input, outputs poisoned, the tolerance that the catalogue gives.

mod common;

use std::sync::Arc;

use common::{adapter, noise, with_and_without_subgroups};
use welkin_proto::scene::{Advection, BodyForce, ConstantViscosity, DiffusionScheme, Pressure};
use welkin_proto::{Scene, presets};
use welkin_server::world::World;
use welkin_shaders::catalogue::{Field, Pass};
use welkin_shaders::cpu::Cpu;
use welkin_shaders::cpu::sim::Parameters;
use welkin_shaders::gpu::{Context, Gpu, dispatches};
use welkin_shaders::{Device, Substep};

/// A scene with every effect, on a grid of no round numbers.
fn scene(cells: [u32; 3]) -> Scene {
    let mut scene = presets::find("fair-weather-cumulus").expect("a preset");
    scene.domain.cells = cells;
    scene.domain.cell_size_m[2] = 3000.0 / cells[2] as f64;
    let size = [0, 1, 2].map(|a| f64::from(cells[a]) * scene.domain.cell_size_m[a]);
    scene.effects.body_force = Some(BodyForce {
        lower_m: size.map(|l| 0.2 * l),
        upper_m: size.map(|l| 0.9 * l),
        acceleration_m_s2: [0.02, -0.01, 0.005],
        drag_per_s: 0.003,
    });
    scene
}

/// Scenes that choose, between them, every rung that has shaders beside those of `scene`; sweeps odd and even in number.
fn other_rungs(cells: [u32; 3]) -> Vec<Scene> {
    let sor = Pressure::RedBlackSor {
        sweeps: 3,
        relaxation: 1.7,
    };
    [
        (
            Advection::SemiLagrangianLinear,
            Pressure::Jacobi { sweeps: 5 },
            Some(DiffusionScheme::Explicit),
        ),
        (Advection::MacCormack, sor, Some(DiffusionScheme::Implicit)),
        (Advection::SemiLagrangianCubic, Pressure::Jacobi { sweeps: 4 }, None),
    ]
    .into_iter()
    .map(|(advection, pressure, mixing)| {
        let mut scene = scene(cells);
        scene.methods.advection = Some(advection);
        scene.methods.pressure = Some(pressure);
        if let Some(scheme) = mixing {
            scene.effects.turbulence = None;
            scene.effects.constant_viscosity = Some(ConstantViscosity {
                viscosity_m2_s: 400.0,
                diffusivity_m2_s: 700.0,
                scheme,
            });
        }
        scene
    })
    .collect()
}

fn parameters(scene: &Scene) -> (Parameters, Vec<Field>, Vec<Pass>) {
    let world = World::new(scene.clone(), Some(1)).expect("a world");
    let plan = world.plan();
    (world.parameters().clone(), plan.fields.clone(), plan.passes.clone())
}

/// Random values of a field around what it holds in nature, so that every branch of every stage is met.
fn random(field: Field, parameters: &Parameters, seed: u32) -> Vec<f32> {
    use Field::*;
    let plane = parameters.grid.plane();
    let value = |i: usize| {
        let n = noise(seed ^ ((field as u32) << 8), i);
        let z = i / plane;
        match field {
            // The ground's face holds no wind, as every stage may take for granted.
            VelocityZ | StartVelocityZ | NextVelocityZ if z == 0 => 0.0,
            VelocityX | StartVelocityX | NextVelocityX => -5.0 + 8.0 * n,
            VelocityY | StartVelocityY | NextVelocityY | VelocityZ | StartVelocityZ | NextVelocityZ => 6.0 * n,
            Heat | StartHeat | NextHeat => parameters.base_heat_k[z] + 1.5 * n,
            // From dry to twice saturated.
            Water | StartWater | NextWater => 0.012 + 0.011 * n,
            SlowVelocityX | SlowVelocityY | SlowVelocityZ => 1e-2 * n,
            SlowHeat => 1e-3 * n,
            SlowWater => 1e-6 * n,
            CentreVelocityX | CentreVelocityY | CentreVelocityZ => 6.0 * n,
            // Cells, both ways and beyond the box.
            DepartureX | DepartureY | DepartureZ | ArrivalX | ArrivalY | ArrivalZ => 4.0 * n,
            Forward | ForwardLow | ForwardHigh => n,
            Buoyancy => 0.05 * n,
            // A third of the cells holds cloud.
            CloudWater => (2e-3 * (n - 0.3)).max(0.0),
            EddyViscosity => 20.0 + 19.0 * n,
            Pressure => 40.0 * n,
            Extinction => (0.1 * (n - 0.3)).max(0.0),
        }
    };
    (0..parameters.grid.len()).map(value).collect()
}

/// Largest difference, over the field's root mean square.
fn difference(a: &[f32], b: &[f32]) -> f64 {
    let square: f64 = a.iter().map(|&v| (v as f64).powi(2)).sum();
    let scale = (square / a.len() as f64).sqrt().max(1e-30);
    a.iter()
        .zip(b)
        .map(|(&a, &b)| {
            let d = (a as f64 - b as f64).abs() / scale;
            if d.is_nan() { f64::INFINITY } else { d }
        })
        .fold(0.0, f64::max)
}

fn both(context: &Arc<Context>, scene: &Scene) -> (Cpu, Gpu, Parameters, Vec<Field>, Vec<Pass>) {
    let (parameters, fields, passes) = parameters(scene);
    let cpu = Cpu::new(parameters.clone(), &fields);
    let gpu = Gpu::new(context.clone(), parameters.clone(), &fields, &passes).expect("a device");
    (cpu, gpu, parameters, fields, passes)
}

fn run_every_pass(context: &Arc<Context>, scene: &Scene) -> usize {
    run_passes(context, scene, &[])
}

/// Runs the scene's passes on both devices, without those that were judged already.
fn run_passes(context: &Arc<Context>, scene: &Scene, judged: &[Pass]) -> usize {
    let (mut cpu, mut gpu, parameters, fields, passes) = both(context, scene);
    let stages = parameters.methods.stages();
    let mut checked = 0;
    let mut beyond = Vec::new();
    for (n, &pass) in passes.iter().enumerate().filter(|(_, p)| !judged.contains(p)) {
        let info = pass.info();
        for stage in 0..stages {
            let substep = Substep {
                substep_s: 1.7,
                stage,
                stages,
            };
            for &field in &fields {
                // What a pass adds to is input too; what it only writes is poisoned.
                let poisoned = info.writes.contains(&field) && !pass.changes();
                let seed = 17 * n as u32 + stage as u32;
                let values = match (pass, field) {
                    _ if poisoned => vec![f32::NAN; parameters.grid.len()],
                    // The water before it was carried, its tendencies in it.
                    (Pass::FixWater, Field::SlowWater) => random(Field::Water, &parameters, seed),
                    // Below zero here and there, and some columns in all.
                    (Pass::FillWater, Field::NextWater) => {
                        let water = random(field, &parameters, seed);
                        water.iter().map(|q| q - 0.010).collect()
                    }
                    _ => random(field, &parameters, seed),
                };
                assert!(cpu.write(field, &values) && gpu.write(field, &values));
            }
            cpu.run(pass, &substep);
            gpu.run(pass, &substep);
            for &field in info.writes.iter().filter(|f| fields.contains(f)) {
                let a = cpu.read(field).expect("planned").to_vec();
                let b = gpu.read(field).expect("planned").to_vec();
                let (tolerance, why) = info.tolerance;
                let found = difference(&a, &b);
                assert!(
                    a.iter().all(|v| v.is_finite()),
                    "{}: the poison is still in {}",
                    info.name,
                    field.name()
                );
                println!(
                    "{} stage {stage}, {}: {found:.1e} of {tolerance:e}",
                    info.name,
                    field.name()
                );
                if found > tolerance {
                    beyond.push(format!(
                        "{} stage {stage}: {} differs by {found:e} of its root mean square; {tolerance:e} is allowed: {why}",
                        info.name,
                        field.name(),
                    ));
                }
                checked += 1;
            }
        }
    }
    assert!(beyond.is_empty(), "{}", beyond.join("\n"));
    checked
}

#[test]
fn every_pass_agrees_on_both_devices() {
    let Some(context) = adapter("every_pass_agrees_on_both_devices") else {
        return;
    };
    // No multiple of a workgroup, primes among them.
    assert!(run_every_pass(&context, &scene([37, 11, 19])) > 60);
}

#[test]
fn passes_agree_on_boxes_of_few_cells() {
    let Some(context) = adapter("passes_agree_on_boxes_of_few_cells") else {
        return;
    };
    for cells in [[1, 1, 2], [3, 3, 3], [1, 5, 4], [2, 1, 8]] {
        run_every_pass(&context, &scene(cells));
    }
}

#[test]
fn passes_of_the_other_rungs_agree() {
    let Some(context) = adapter("passes_of_the_other_rungs_agree") else {
        return;
    };
    let (.., judged) = parameters(&scene([37, 11, 19]));
    for cells in [[37, 11, 19], [12, 8, 10], [5, 6, 2]] {
        let checked: usize = other_rungs(cells)
            .iter()
            .map(|scene| run_passes(&context, scene, &judged))
            .sum();
        assert!(checked > 40, "{checked}");
    }
    for cells in [[1, 1, 2], [3, 3, 3], [1, 5, 4], [2, 1, 8]] {
        for scene in other_rungs(cells) {
            run_passes(&context, &scene, &judged);
        }
    }
}

#[test]
fn semi_lagrangian_passes_agree_where_no_tendency_is_held() {
    let Some(context) = adapter("semi_lagrangian_passes_agree_where_no_tendency_is_held") else {
        return;
    };
    let (.., judged) = parameters(&scene([9, 8, 7]));
    for mut scene in other_rungs([9, 8, 7]) {
        scene.effects.constant_viscosity = None;
        scene.effects.turbulence = None;
        scene.effects.body_force = None;
        scene.effects.surface = None;
        scene.effects.coriolis = None;
        scene.effects.large_scale = None;
        scene.effects.sponge = None;
        let (_, fields, passes) = parameters(&scene);
        assert!(!fields.contains(&Field::SlowHeat) && passes.contains(&Pass::FixWater));
        run_passes(&context, &scene, &judged);
        // Dry, the buoyancy has a pass of its own.
        scene.effects.moisture = None;
        scene.effects.cloud_detail = None;
        scene.effects.multiple_scattering = None;
        scene.effects.cloud_shadow = None;
        run_passes(&context, &scene, &judged);
    }
}

#[test]
fn limiters_keep_what_is_not_a_number() {
    let Some(context) = adapter("limiters_keep_what_is_not_a_number") else {
        return;
    };
    for scene in other_rungs([9, 8, 7]) {
        let (mut cpu, mut gpu, parameters, fields, passes) = both(&context, &scene);
        let substep = Substep {
            substep_s: 1.7,
            stage: 0,
            stages: 1,
        };
        let carries =
            |p: &&Pass| p.info().writes.contains(&Field::NextHeat) && p.info().reads.contains(&Field::DepartureX);
        let carry = *passes.iter().find(carries).expect("one stage carries heat");
        for poisoned in [Field::SlowHeat, Field::DepartureX, Field::DepartureZ] {
            let devices: [&mut dyn Device; 2] = [&mut cpu, &mut gpu];
            for device in devices {
                for &field in &fields {
                    let mut values = random(field, &parameters, 5);
                    if field == poisoned {
                        values.fill(f32::NAN);
                    }
                    assert!(device.write(field, &values));
                }
                device.run(carry, &substep);
                let heat = device.read(Field::NextHeat).expect("planned").to_vec();
                assert!(
                    heat.iter().all(|v| v.is_nan()),
                    "{} on {}: {} of NaN made numbers",
                    carry.info().name,
                    device.name(),
                    poisoned.name()
                );
            }
        }
    }
}

#[test]
fn a_kept_pressure_comes_back_with_the_state() {
    let Some(context) = adapter("a_kept_pressure_comes_back_with_the_state") else {
        return;
    };
    let (mut cpu, mut gpu, parameters, fields, _) = both(&context, &other_rungs([7, 6, 5])[0]);
    let devices: [&mut dyn Device; 2] = [&mut cpu, &mut gpu];
    for device in devices {
        let pressure = |device: &dyn Device| device.read(Field::Pressure).expect("planned").to_vec();
        let substep = Substep {
            substep_s: 1.7,
            stage: 0,
            stages: 1,
        };
        for &field in &fields {
            assert!(device.write(field, &random(field, &parameters, 3)));
        }
        let before = pressure(device);
        device.save(0);
        assert!(device.saved_bytes() >= 6 * 4 * parameters.grid.len());
        device.run(Pass::PressureJacobi, &substep);
        assert_ne!(pressure(device), before);
        assert!(device.restore(0));
        assert_eq!(pressure(device), before);
        // A state that was taken from a substep's start has no pressure of its own: the solver begins anew.
        device.save_start(0);
        assert!(device.restore(0));
        assert!(pressure(device).iter().all(|p| *p == 0.0));
    }
}

#[test]
fn dry_passes_agree() {
    let Some(context) = adapter("dry_passes_agree") else {
        return;
    };
    let mut scene = scene([16, 8, 10]);
    scene.effects.moisture = None;
    scene.effects.cloud_detail = None;
    scene.effects.multiple_scattering = None;
    scene.effects.cloud_shadow = None;
    run_every_pass(&context, &scene);
}

#[test]
fn every_pass_of_a_shared_rung_has_a_shader() {
    use welkin_shaders::catalogue::{Devices, Ladder};
    for &pass in Pass::ALL {
        let info = pass.info();
        // Of some ladder it belongs to no other rungs than those of the CPU.
        let cpu_only = Ladder::ALL.iter().any(|&ladder| {
            let mut rungs = info.rungs.iter().filter(|r| r.info().ladder == ladder).peekable();
            rungs.peek().is_some() && rungs.all(|r| matches!(r.info().devices, Devices::CpuOnly(_)))
        });
        assert_eq!(dispatches::is_there(pass), !cpu_only, "{}", info.name);
    }
}

#[test]
fn reductions_agree() {
    for context in with_and_without_subgroups("reductions_agree") {
        compare_reductions(&context);
    }
}

fn compare_reductions(context: &Arc<Context>) {
    let (mut cpu, mut gpu, parameters, fields, _) = both(context, &scene([37, 11, 19]));
    let close = |a: f64, b: f64, what: &str| {
        // Sums of a level are made in f32 on the GPU, in a tree of 256.
        assert!((a - b).abs() <= 1e-5 * a.abs().max(b.abs()), "{what}: {a} and {b}");
    };
    for &field in &fields {
        let values = random(field, &parameters, 5);
        assert!(cpu.write(field, &values) && gpu.write(field, &values));
    }
    let (a, b) = (cpu.reduce(), gpu.reduce());
    assert!(a.finite && b.finite);
    close(a.courant_rate_per_s as f64, b.courant_rate_per_s as f64, "rate");
    assert_eq!(a.wind_max_m_s, b.wind_max_m_s);
    assert_eq!(a.updraught_max_m_s, b.updraught_max_m_s);
    assert_eq!(a.viscosity_max_m2_s, b.viscosity_max_m2_s);
    cpu.judge();
    gpu.judge();
    let (a, b) = (cpu.vitals(), gpu.vitals());
    assert!(a.finite && b.finite);
    close(
        a.divergence_max_per_s as f64,
        b.divergence_max_per_s as f64,
        "divergence",
    );
    assert_eq!(a.water_min_kg_per_kg, b.water_min_kg_per_kg);
    let (a, b) = (cpu.reduce_cloud().expect("cloud"), gpu.reduce_cloud().expect("cloud"));
    assert_eq!(a.cover, b.cover);
    assert_eq!((a.base_m, a.top_m, a.lit_levels), (b.base_m, b.top_m, b.lit_levels));
    close(
        a.liquid_water_path_kg_m2,
        b.liquid_water_path_kg_m2,
        "liquid water path",
    );
    close(a.total_water_path_kg_m2, b.total_water_path_kg_m2, "water path");
    let (a, b) = (a.wind_m_s.expect("wind"), b.wind_m_s.expect("wind"));
    close(a[0], b[0], "wind");
    assert!((a[1] - b[1]).abs() < 1e-4);
}

#[test]
fn what_is_not_finite_is_noticed_on_both_devices() {
    for context in with_and_without_subgroups("what_is_not_finite_is_noticed_on_both_devices") {
        notice_what_is_not_finite(&context);
    }
}

fn notice_what_is_not_finite(context: &Arc<Context>) {
    for (poisoned, in_reductions) in [
        (Field::VelocityY, true),
        (Field::EddyViscosity, true),
        (Field::Heat, false),
        (Field::Water, false),
        (Field::Extinction, false),
    ] {
        for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let (mut cpu, mut gpu, parameters, fields, _) = both(context, &scene([5, 4, 6]));
            for &field in &fields {
                let mut values = random(field, &parameters, 5);
                if field == poisoned {
                    values[63] = poison;
                }
                assert!(cpu.write(field, &values) && gpu.write(field, &values));
            }
            let what = format!("{poison} in {}", poisoned.name());
            if in_reductions {
                assert!(!cpu.reduce().finite && !gpu.reduce().finite, "{what}");
            }
            if poisoned != Field::EddyViscosity {
                cpu.judge();
                gpu.judge();
                assert!(!cpu.vitals().finite && !gpu.vitals().finite, "{what}");
            }
        }
    }
}

#[test]
fn a_kept_state_comes_back_bit_for_bit() {
    let Some(context) = adapter("a_kept_state_comes_back_bit_for_bit") else {
        return;
    };
    let (_, mut gpu, parameters, fields, _) = both(&context, &scene([7, 6, 5]));
    let state = |gpu: &Gpu| Field::STATE.map(|f| gpu.read(f).expect("planned").to_vec());
    for &field in &fields {
        assert!(gpu.write(field, &random(field, &parameters, 3)));
    }
    let before = state(&gpu);
    assert!(!gpu.restore(1), "nothing was saved there");
    gpu.save(1);
    for field in Field::STATE {
        assert!(gpu.write(field, &random(field, &parameters, 4)));
    }
    assert_ne!(state(&gpu), before);
    assert!(gpu.restore(1));
    assert_eq!(state(&gpu), before);
}
