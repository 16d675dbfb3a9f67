//! A scene pays only for the effects that it names: passes and bytes are counted with and without each.

use welkin_proto::scene::{self, Accuracy, Advection, Pressure};
use welkin_proto::{Scene, presets};
use welkin_server::methods;
use welkin_server::plan::Plan;
use welkin_server::world::World;
use welkin_shaders::catalogue::{Effect, Field, Ladder, Pass, Phase, Rung};
use welkin_shaders::view::ViewSampling;

fn cumulus() -> Scene {
    let mut scene = presets::find("fair-weather-cumulus").expect("a preset");
    scene.domain.cells = [8, 8, 16];
    scene.domain.cell_size_m[2] = 180.0;
    scene
}

#[test]
fn a_clear_sky_with_wind_runs_no_thermodynamics() {
    let mut scene = presets::find("clear-sky-wind").expect("a preset");
    scene.domain.cells = [8, 8, 8];
    let world = World::new(scene, None).expect("a world");
    let plan = world.plan();
    assert_eq!(plan.passes, [Pass::AdvectMomentum, Pass::PressureSolve, Pass::Project]);
    // Three velocities, each with its start and its next value, and the pressure.
    assert_eq!(plan.fields.len(), 10);
    let report = world.plan_report();
    let grid_bytes: u64 = report
        .fields
        .iter()
        .filter(|f| f.place != "spectrum" && f.place != "slot")
        .map(|f| f.bytes)
        .sum();
    assert_eq!(grid_bytes, 10 * 8 * 8 * 8 * 4);
    for field in [
        Field::Heat,
        Field::Water,
        Field::Buoyancy,
        Field::CloudWater,
        Field::Extinction,
        Field::SlowVelocityX,
    ] {
        assert!(world.device().read(field).is_none(), "{} is allocated", field.name());
    }
    assert!(world.snapshot().volume.is_none());
}

#[test]
fn each_effect_adds_what_it_needs_and_nothing_else() {
    let whole = Plan::new(&cumulus()).expect("a plan");
    let without = |remove: &dyn Fn(&mut Scene)| {
        let mut scene = cumulus();
        remove(&mut scene);
        Plan::new(&scene).expect("a plan")
    };
    let gone = |plan: &Plan| {
        whole
            .passes
            .iter()
            .filter(|p| !plan.passes.contains(p))
            .map(|p| p.info().name)
            .collect::<Vec<_>>()
    };
    let fewer = |plan: &Plan| whole.fields.len() - plan.fields.len();

    let plan = without(&|s| s.effects.turbulence = None);
    assert_eq!(
        gone(&plan),
        [
            "saturation_adjustment:step",
            "eddy_viscosity",
            "diffuse_momentum",
            "diffuse_scalar:heat",
            "diffuse_scalar:water"
        ]
    );
    assert_eq!(fewer(&plan), 1);
    let plan = without(&|s| s.effects.surface = None);
    assert_eq!((gone(&plan), fewer(&plan)), (vec!["surface_flux"], 0));
    let plan = without(&|s| s.effects.coriolis = None);
    assert_eq!((gone(&plan), fewer(&plan)), (vec!["coriolis"], 0));
    let plan = without(&|s| s.effects.sponge = None);
    assert_eq!((gone(&plan), fewer(&plan)), (vec!["sponge"], 0));
    let plan = without(&|s| s.effects.large_scale = None);
    assert_eq!(
        (gone(&plan), fewer(&plan)),
        (vec!["large_scale:heat", "large_scale:water", "large_scale:momentum"], 0)
    );
    // Without water, what water needs goes, and dry buoyancy comes.
    let plan = without(&|s| s.effects.moisture = None);
    assert!(plan.passes.contains(&Pass::DryBuoyancy) && !whole.passes.contains(&Pass::DryBuoyancy));
    assert!(plan.fields.iter().all(|f| f.effect() != Effect::Moisture));
    assert_eq!(fewer(&plan), 6);
    // With no effect left there is nothing at all.
    let plan = without(&|s| s.effects = Default::default());
    assert!(plan.passes.is_empty() && plan.fields.is_empty());
}

#[test]
fn every_planned_field_is_touched_and_every_touched_field_planned() {
    for preset in presets::all() {
        let plan = Plan::new(&presets::find(preset.name).expect("a preset")).expect("a plan");
        for field in &plan.fields {
            // What a substep starts from is kept by the device itself, for stages and for the watchdog.
            assert!(
                field.is_start()
                    || plan
                        .passes
                        .iter()
                        .any(|p| p.info().reads.contains(field) || p.info().writes.contains(field)),
                "{}: {} is idle",
                preset.name,
                field.name()
            );
        }
        for pass in &plan.passes {
            let written = pass.info().writes.iter().filter(|f| plan.fields.contains(f)).count();
            assert!(
                written > 0,
                "{}: {} writes nothing that exists",
                preset.name,
                pass.info().name
            );
        }
    }
}

#[test]
fn what_cloudy_ascent_adds_is_not_overwritten() {
    // Whoever carries heat writes its next value whole.
    for pass in Pass::ALL.iter().filter(|p| p.info().writes.contains(&Field::NextHeat)) {
        assert!(*pass <= Pass::CloudyAscent, "{} comes after", pass.info().name);
    }
    assert!(Pass::CloudyAscent > Pass::Saturation, "it needs this stage's cloud");
}

#[test]
fn the_report_says_what_was_run_and_what_it_cost() {
    let mut world = World::new(cumulus(), None).expect("a world");
    world.tick();
    let report = world.plan_report();
    for pass in report.passes.iter().filter(|p| p.phase != "view") {
        assert!(
            pass.runs > 0 && pass.mean_ms.is_some_and(|ms| ms >= 0.0),
            "{} did not run",
            pass.stage
        );
        assert!(pass.why.starts_with("effect "), "{}", pass.why);
    }
    assert_eq!(report.bytes, report.fields.iter().map(|f| f.bytes).sum::<u64>());
    // A picture's stages follow the effects that ask for them.
    let mut plain = cumulus();
    plain.effects.cloud_detail = None;
    let names = |w: &World| {
        w.plan_report()
            .passes
            .iter()
            .map(|p| p.stage.clone())
            .collect::<Vec<_>>()
    };
    let all = names(&world);
    let fewer = names(&World::new(plain, None).expect("a world"));
    assert!(fewer.len() < all.len(), "no stage of the view depends on cloud_detail");
}

#[test]
fn a_plan_runs_one_rung_of_each_ladder_and_says_why() {
    let world = World::new(cumulus(), None).expect("a world");
    let report = world.plan_report();
    let said: Vec<_> = report
        .ladders
        .iter()
        .map(|l| (l.ladder.as_str(), l.rung.as_str(), l.why.as_str()))
        .collect();
    assert_eq!(
        said,
        [
            ("advection", "flux_form", "accuracy balanced"),
            ("pressure", "direct", "accuracy balanced"),
            ("subgrid", "smagorinsky_lilly", "effect turbulence"),
            ("microphysics", "saturation_adjustment", "effect moisture"),
            ("sky", "scattering_tables", "accuracy balanced"),
            ("sun_occlusion", "light_grid", "what a scene has that names none"),
            ("scattering", "diffusion", "effect multiple_scattering"),
            ("phase", "droplets", "what a scene has that names none"),
            ("view_steps", "by_distance", "what a scene has that names none"),
            ("view_sampling", "half_resolution", "accuracy balanced"),
        ]
    );
    assert_eq!(report.courant_max, Some(1.0));
    // Who says how many octaves is lit by octaves.
    let mut scene = cumulus();
    scene.effects.multiple_scattering.as_mut().expect("the effect").octaves = Some(4);
    let report = World::new(scene, None).expect("a world").plan_report();
    assert!(
        report
            .ladders
            .iter()
            .any(|l| (l.ladder.as_str(), l.rung.as_str()) == ("scattering", "octaves"))
    );
    // Fast and reference are the same in longer and shorter substeps, within what the method bears.
    let mut scene = cumulus();
    scene.accuracy = Accuracy::Fast;
    let fast = methods::choose(&scene).expect("a choice");
    assert_eq!((fast.methods.advection, fast.courant_max), (Rung::FluxForm, Some(1.4)));
    scene.effects.flow.as_mut().expect("flow").courant_max = 1.4;
    assert_eq!(methods::choose(&scene).expect("a choice").courant_max, Some(1.4));
    assert_eq!(methods::view_sampling(&scene), ViewSampling::HalfResolution);
    let mut scene = cumulus();
    scene.accuracy = Accuracy::Reference;
    assert_eq!(methods::view_sampling(&scene), ViewSampling::EveryPixel);
    scene.methods.view_sampling = Some(scene::ViewSampling::Reproject16);
    assert_eq!(methods::view_sampling(&scene), ViewSampling::Reproject16);
    scene.methods.view_sampling = None;
    assert_eq!(
        World::new(scene, None).expect("a world").plan_report().courant_max,
        Some(0.5)
    );
    // Without a flow there is nothing to carry and no pressure.
    let mut scene = cumulus();
    scene.effects = Default::default();
    let chosen = Plan::new(&scene).expect("a plan").chosen;
    assert_eq!(chosen.courant_max, None);
    assert_eq!(
        chosen.choices.iter().map(|c| c.rung).collect::<Vec<_>>(),
        [Rung::NoSubgrid, Rung::NoMicrophysics, Rung::ScatteringTables]
    );
}

fn all_advections() -> [Advection; 4] {
    [
        Advection::SemiLagrangianLinear,
        Advection::MacCormack,
        Advection::SemiLagrangianCubic,
        Advection::FluxForm,
    ]
}

#[test]
fn a_named_method_is_run_or_refused() {
    let name = |value: serde_json::Value| value.as_str().map(str::to_owned).expect("a name");
    for advection in all_advections() {
        let mut scene = cumulus();
        scene.methods.advection = Some(advection);
        let wanted = name(serde_json::to_value(advection).expect("JSON"));
        let rung = Ladder::Advection
            .rungs()
            .find(|r| r.info().name == wanted)
            .unwrap_or_else(|| panic!("{wanted} is not on the ladder"));
        match Plan::new(&scene) {
            Ok(plan) => {
                assert!(rung.is_there());
                assert_eq!(plan.chosen.choices[0].rung, rung);
                // Each quantity is carried once; the wind is projected after, cloudy air's heat corrected, water fixed and filled.
                for field in [Field::NextHeat, Field::NextWater, Field::NextVelocityZ] {
                    let writers = plan.phase(Phase::Stage).into_iter().filter(|p| {
                        p.info().writes.contains(&field)
                            && ![Pass::Project, Pass::CloudyAscent, Pass::FixWater, Pass::FillWater].contains(p)
                    });
                    assert_eq!(writers.count(), 1, "{wanted}: {}", field.name());
                }
                assert_eq!(
                    plan.passes.contains(&Pass::AdvectHeat),
                    advection == Advection::FluxForm
                );
            }
            Err(error) => {
                assert!(!rung.is_there(), "{error}");
                assert_eq!(error.code, "method_unavailable");
                assert_eq!(error.pointer.as_deref(), Some("/methods/advection"));
                assert!(
                    error.message.contains(&wanted) && error.message.contains("flux_form"),
                    "{error}"
                );
            }
        }
    }
    for pressure in [
        Pressure::Direct {},
        Pressure::Jacobi { sweeps: 40 },
        Pressure::RedBlackSor {
            sweeps: 20,
            relaxation: 1.7,
        },
        Pressure::Multigrid { cycles: 4 },
    ] {
        let wanted = name(serde_json::to_value(&pressure).expect("JSON")["solver"].clone());
        let mut scene = cumulus();
        scene.methods.pressure = Some(pressure);
        match Plan::new(&scene) {
            Ok(plan) => {
                assert_eq!(plan.chosen.choices[1].rung.info().name, wanted);
                let solvers = plan
                    .passes
                    .iter()
                    .filter(|p| p.info().writes.contains(&Field::Pressure));
                assert_eq!(solvers.count(), 1, "{wanted}");
            }
            Err(error) => {
                assert_eq!(error.code, "method_unavailable");
                assert_eq!(error.pointer.as_deref(), Some("/methods/pressure/solver"));
            }
        }
    }
}

#[test]
fn a_courant_number_above_what_the_method_bears_is_refused() {
    for advection in all_advections() {
        let mut scene = cumulus();
        scene.methods.advection = Some(advection);
        let Ok(plan) = Plan::new(&scene) else { continue };
        let limit = plan
            .chosen
            .methods
            .advection
            .info()
            .advance
            .expect("advection")
            .courant_max;
        let mut with = |courant_max: f64| {
            scene.effects.flow.as_mut().expect("flow").courant_max = courant_max;
            methods::choose(&scene)
        };
        assert_eq!(with(limit).expect("at the limit").courant_max, Some(limit));
        let error = with(limit + 0.1).expect_err("above the limit");
        assert_eq!(error.code, "method_limit");
        assert_eq!(error.pointer.as_deref(), Some("/effects/flow/courant_max"));
        assert!(error.message.contains(&limit.to_string()), "{error}");
    }
}
