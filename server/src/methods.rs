//! Which rung of each ladder a scene gets, and why.

use welkin_proto::scene::{
    Accuracy, Advection, MultipleScattering, Phase, Pressure, Scattering, Sky, SunOcclusion, ViewSampling, ViewSteps,
};
use welkin_proto::{ApiError, Scene};
use welkin_shaders::catalogue::{Ladder, Rung};
use welkin_shaders::cpu::light::phase_table::PhaseChoice;
use welkin_shaders::cpu::sim::parameters::{Methods, PressureMethod};
use welkin_shaders::view::{self, Lighting, MapKind};

/// A rung and what chose it.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// The rung.
    pub rung: Rung,
    /// Who chose it, in a few words.
    pub why: String,
}

/// A scene's methods.
#[derive(Clone, Debug, PartialEq)]
pub struct Chosen {
    /// One rung a ladder; of advection and pressure only where something flows, of light only where there can be cloud.
    pub choices: Vec<Choice>,
    /// What the passes are told.
    pub methods: Methods,
    /// Largest Courant number of a substep; absent where nothing flows.
    pub courant_max: Option<f64>,
}

/// What an accuracy stands for: a rung of advection, a pressure solver, and a factor on the scene's largest Courant number, which
/// stays within what the rung is claimed to bear.
fn meaning(accuracy: Accuracy) -> (&'static str, Rung, PressureMethod, f64) {
    match accuracy {
        // Measured on the CPU (the dry bubble at 100 m against one at 50 m): flux form errs by 0.11 in theta for 0.20 s, MacCormack by
        // 0.49 for 0.21 s at twice the Courant number and cubic by 0.32 for 0.27 s, so the fast way is flux form in the longest
        // substeps it bears. The direct solver is both the exact one and the fast one: 1.6 ms a solve at 64 x 64 x 75 cells, where two
        // cycles of multigrid take 5.6 and forty sweeps of Jacobi's method 8.
        Accuracy::Fast => ("fast", Rung::FluxForm, PressureMethod::Direct, 1.4),
        Accuracy::Balanced => ("balanced", Rung::FluxForm, PressureMethod::Direct, 1.0),
        Accuracy::Reference => ("reference", Rung::FluxForm, PressureMethod::Direct, 0.5),
    }
}

fn advection_rung(advection: Advection) -> Rung {
    match advection {
        Advection::SemiLagrangianLinear => Rung::SemiLagrangianLinear,
        Advection::MacCormack => Rung::MacCormack,
        Advection::SemiLagrangianCubic => Rung::SemiLagrangianCubic,
        Advection::FluxForm => Rung::FluxForm,
    }
}

fn pressure_method(pressure: &Pressure) -> PressureMethod {
    match *pressure {
        Pressure::Direct {} => PressureMethod::Direct,
        Pressure::Jacobi { sweeps } => PressureMethod::Jacobi { sweeps },
        Pressure::RedBlackSor { sweeps, relaxation } => PressureMethod::RedBlackSor {
            sweeps,
            relaxation: relaxation as f32,
        },
        Pressure::Multigrid { cycles } => PressureMethod::Multigrid { cycles },
    }
}

fn sky_rung(sky: Sky) -> Rung {
    match sky {
        Sky::Preetham => Rung::Preetham,
        Sky::HosekWilkie => Rung::HosekWilkie,
        Sky::ScatteringTables => Rung::ScatteringTables,
    }
}

fn scattering_of(scattering: Scattering) -> (Rung, view::Scattering) {
    match scattering {
        Scattering::Octaves => (Rung::Octaves, view::Scattering::Octaves),
        Scattering::MultipleForward => (Rung::MultipleForward, view::Scattering::MultipleForward),
        Scattering::Diffusion => (Rung::Diffusion, view::Scattering::Diffusion),
        Scattering::Slab => (Rung::Slab, view::Scattering::Slab),
        Scattering::SlabCollector => (Rung::SlabCollector, view::Scattering::SlabCollector),
    }
}

fn sun_occlusion_of(occlusion: &SunOcclusion) -> (Rung, view::SunOcclusion) {
    let map = |kind, side| view::SunOcclusion::ShadowMap { kind, side };
    match *occlusion {
        SunOcclusion::LightGrid {} => (Rung::LightGrid, view::SunOcclusion::LightGrid),
        SunOcclusion::SecondaryMarch { steps } => (Rung::SecondaryMarch, view::SunOcclusion::SecondaryMarch { steps }),
        SunOcclusion::ExponentialShadowMap { side } => (Rung::ExponentialShadowMap, map(MapKind::Exponential, side)),
        SunOcclusion::BeerShadowMap { side } => (Rung::BeerShadowMap, map(MapKind::Beer, side)),
        SunOcclusion::FourierOpacityMap { side } => (Rung::FourierOpacityMap, map(MapKind::Fourier, side)),
    }
}

fn view_steps_of(steps: &ViewSteps) -> (Rung, view::ViewSteps) {
    match *steps {
        ViewSteps::ByDistance {} => (Rung::ByDistance, view::ViewSteps::ByDistance),
        ViewSteps::ByOpticalDepth { optical_depth } => {
            let optical_depth = optical_depth as f32;
            (Rung::ByOpticalDepth, view::ViewSteps::ByOpticalDepth { optical_depth })
        }
        ViewSteps::LogarithmicSegments { segments } => (
            Rung::LogarithmicSegments,
            view::ViewSteps::LogarithmicSegments { segments },
        ),
    }
}

/// Where a scene's pictures look into cloud.
pub fn view_steps(scene: &Scene) -> view::ViewSteps {
    let named = scene.methods.view_steps.as_ref();
    named.map(|s| view_steps_of(s).1).unwrap_or_default()
}

fn phase_of(phase: &Phase) -> (Rung, PhaseChoice) {
    match *phase {
        Phase::Rayleigh {} => (Rung::Rayleigh, PhaseChoice::Rayleigh),
        Phase::HenyeyGreenstein { asymmetry } => {
            let asymmetry = asymmetry as f32;
            (Rung::HenyeyGreenstein, PhaseChoice::HenyeyGreenstein { asymmetry })
        }
        Phase::DoubleHenyeyGreenstein {
            forward_asymmetry,
            backward_asymmetry,
            forward_share,
        } => {
            let choice = PhaseChoice::DoubleHenyeyGreenstein {
                forward_asymmetry: forward_asymmetry as f32,
                backward_asymmetry: backward_asymmetry as f32,
                forward_share: forward_share as f32,
            };
            (Rung::DoubleHenyeyGreenstein, choice)
        }
        Phase::Droplets { diameter_um } => {
            let diameter_um = diameter_um as f32;
            (Rung::Droplets, PhaseChoice::Droplets { diameter_um })
        }
        Phase::Mie { effective_radius_um } => {
            let effective_radius_um = effective_radius_um as f32;
            (Rung::Mie, PhaseChoice::Mie { effective_radius_um })
        }
        Phase::Ice { aspect_ratio } => {
            let aspect_ratio = aspect_ratio as f32;
            (Rung::Ice, PhaseChoice::Ice { aspect_ratio })
        }
    }
}

/// How many pixels of a scene's live pictures are marched, as a rung, to the view, and why.
fn view_sampling_of(scene: &Scene) -> (Rung, view::ViewSampling, String) {
    let (named, why) = match scene.methods.view_sampling {
        Some(named) => (named, "the scene names it".to_owned()),
        // What half resolution loses is below what an eye sees (`welkin ladder view`); the reference has no such loss to be asked about.
        None if scene.accuracy == Accuracy::Reference => (ViewSampling::EveryPixel, "accuracy reference".to_owned()),
        None => (
            ViewSampling::HalfResolution,
            format!("accuracy {}", meaning(scene.accuracy).0),
        ),
    };
    match named {
        ViewSampling::Reproject16 => (Rung::Reproject16, view::ViewSampling::Reproject16, why),
        ViewSampling::Reproject4 => (Rung::Reproject4, view::ViewSampling::Reproject4, why),
        ViewSampling::Impostors => (Rung::Impostors, view::ViewSampling::Impostors, why),
        ViewSampling::HalfResolution => (Rung::HalfResolution, view::ViewSampling::HalfResolution, why),
        ViewSampling::EveryPixel => (Rung::EveryPixel, view::ViewSampling::EveryPixel, why),
    }
}

/// How many pixels of a scene's live pictures are marched.
pub fn view_sampling(scene: &Scene) -> view::ViewSampling {
    view_sampling_of(scene).1
}

/// How a scene's pictures light clouds.
pub fn lighting(scene: &Scene) -> Lighting {
    let methods = &scene.methods;
    Lighting {
        phase: methods.phase.as_ref().map(|p| phase_of(p).1).unwrap_or_default(),
        scattering: scattering(scene).0.1,
        sun_occlusion: methods
            .sun_occlusion
            .as_ref()
            .map(|o| sun_occlusion_of(o).1)
            .unwrap_or_default(),
    }
}

/// Octaves of a scene that is lit by them and does not say how many.
const OCTAVES_USUAL: u32 = 6;

/// Octaves that pictures ask for; 0 where light is scattered once.
pub(crate) fn octaves(scene: &Scene) -> u32 {
    let effect = scene.effects.multiple_scattering.as_ref();
    effect.map_or(0, |effect| effect.octaves.unwrap_or(OCTAVES_USUAL))
}

/// How light goes on beyond its first scattering, and why so.
fn scattering(scene: &Scene) -> ((Rung, view::Scattering), &'static str) {
    let effect = "effect multiple_scattering";
    match (scene.methods.scattering, &scene.effects.multiple_scattering) {
        // No octave is single scattering.
        (_, None) => (
            (Rung::SingleScattering, view::Scattering::Octaves),
            "no effect asks for more",
        ),
        (Some(scattering), _) => (scattering_of(scattering), "the scene names it"),
        (None, Some(MultipleScattering { octaves: Some(_) })) => (scattering_of(Scattering::Octaves), effect),
        (None, Some(MultipleScattering { octaves: None })) => (scattering_of(Scattering::Diffusion), effect),
    }
}

/// The rungs of light.
fn light_choices(scene: &Scene) -> impl Iterator<Item = Choice> {
    let (named, usual) = ("the scene names it", "what a scene has that names none");
    let methods = &scene.methods;
    let occlusion = methods.sun_occlusion.as_ref().map(|o| (sun_occlusion_of(o).0, named));
    let ((scattering, _), why) = scattering(scene);
    let phase = methods.phase.as_ref().map(|p| (phase_of(p).0, named));
    let steps = methods.view_steps.as_ref().map(|s| (view_steps_of(s).0, named));
    let rungs = [
        occlusion.unwrap_or((Rung::LightGrid, usual)),
        (scattering, why),
        phase.unwrap_or((Rung::Droplets, usual)),
        steps.unwrap_or((Rung::ByDistance, usual)),
    ];
    rungs.into_iter().map(|(rung, why)| Choice {
        rung,
        why: why.to_owned(),
    })
}

/// The rung, if it is written. Errors: `method_unavailable` at `pointer`.
fn there(rung: Rung, pointer: &str) -> Result<Rung, ApiError> {
    if rung.is_there() {
        return Ok(rung);
    }
    let info = rung.info();
    let known: Vec<_> = info
        .ladder
        .rungs()
        .filter(|r| r.is_there())
        .map(|r| r.info().name)
        .collect();
    let message = format!(
        "this build does not have {} for {}; it has {}",
        info.name,
        info.ladder.name(),
        known.join(", ")
    );
    Err(ApiError::new("method_unavailable", message).at(pointer))
}

/// Chooses. Errors, with pointers into the scene: `method_unavailable` for a rung that this build lacks; `method_limit` for a Courant
/// number above what the chosen advection is claimed to bear.
pub fn choose(scene: &Scene) -> Result<Chosen, ApiError> {
    let (accuracy, advection, pressure, courant_factor) = meaning(scene.accuracy);
    let by_accuracy = format!("accuracy {accuracy}");
    let mut choices = Vec::new();
    let mut methods = Methods::default();
    let mut courant_max = None;
    if let Some(flow) = &scene.effects.flow {
        let (rung, pointer, why) = match scene.methods.advection {
            Some(named) => (advection_rung(named), "/methods/advection", "the scene names it"),
            None => (advection, "/accuracy", by_accuracy.as_str()),
        };
        methods.advection = there(rung, pointer)?;
        choices.push(Choice {
            rung,
            why: why.to_owned(),
        });
        let (method, pointer, why) = match &scene.methods.pressure {
            Some(named) => (pressure_method(named), "/methods/pressure/solver", "the scene names it"),
            None => (pressure, "/accuracy", by_accuracy.as_str()),
        };
        let rung = there(method.rung(), pointer)?;
        methods.pressure = method;
        choices.push(Choice {
            rung,
            why: why.to_owned(),
        });
        let limit = methods
            .advection
            .info()
            .advance
            .map_or(f64::INFINITY, |a| a.courant_max);
        if flow.courant_max > limit {
            let message = format!(
                "a Courant number of {} is above {limit}, the most that {} bears",
                flow.courant_max,
                methods.advection.info().name
            );
            return Err(ApiError::new("method_limit", message).at("/effects/flow/courant_max"));
        }
        courant_max = Some((flow.courant_max * courant_factor).min(limit));
    }
    let (rung, why) = if scene.effects.turbulence.is_some() {
        (Rung::SmagorinskyLilly, "effect turbulence")
    } else if scene.effects.constant_viscosity.is_some() {
        (Rung::ConstantViscosity, "effect constant_viscosity")
    } else {
        (Rung::NoSubgrid, "no effect asks for mixing")
    };
    choices.push(Choice {
        rung,
        why: why.to_owned(),
    });
    let (rung, why) = if scene.effects.moisture.is_some() {
        (Rung::SaturationAdjustment, "effect moisture")
    } else {
        (Rung::NoMicrophysics, "no effect asks for water")
    };
    choices.push(Choice {
        rung,
        why: why.to_owned(),
    });
    let (rung, why) = match scene.methods.sky {
        Some(named) => (sky_rung(named), "the scene names it".to_owned()),
        None => (Rung::ScatteringTables, by_accuracy),
    };
    choices.push(Choice { rung, why });
    if scene.effects.moisture.is_some() {
        choices.extend(light_choices(scene));
        let (rung, _, why) = view_sampling_of(scene);
        choices.push(Choice { rung, why });
    }
    debug_assert!(choices.windows(2).all(|c| order(c[0].rung) < order(c[1].rung)));
    Ok(Chosen {
        choices,
        methods,
        courant_max,
    })
}

fn order(rung: Rung) -> Option<usize> {
    Ladder::ALL.iter().position(|l| *l == rung.info().ladder)
}
