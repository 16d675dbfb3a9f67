//! From a scene's effects to what runs: which passes, which fields, why, and what each pass has cost.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use welkin_proto::scene::Effects;
use welkin_proto::wire::PlanReport;
use welkin_proto::{ApiError, Scene};
use welkin_shaders::catalogue::{Effect, Field, Pass, Phase};

use crate::methods::{self, Chosen};

/// What a world runs and holds.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The effects that the scene names.
    pub effects: Vec<Effect>,
    /// The rung of each ladder.
    pub chosen: Chosen,
    /// Passes in catalogue order.
    pub passes: Vec<Pass>,
    /// Fields that are allocated, in catalogue order.
    pub fields: Vec<Field>,
}

/// The effects that are present, in the catalogue's words. Noise and bubble act on the start alone and are none of them.
pub fn effects(effects: &Effects) -> Vec<Effect> {
    [
        (effects.flow.is_some(), Effect::Flow),
        (effects.heat.is_some(), Effect::Heat),
        (effects.moisture.is_some(), Effect::Moisture),
        (effects.turbulence.is_some(), Effect::Turbulence),
        (effects.constant_viscosity.is_some(), Effect::ConstantViscosity),
        (effects.body_force.is_some(), Effect::BodyForce),
        (effects.surface.is_some(), Effect::Surface),
        (effects.coriolis.is_some(), Effect::Coriolis),
        (effects.large_scale.is_some(), Effect::LargeScale),
        (effects.sponge.is_some(), Effect::Sponge),
        (effects.cloud_detail.is_some(), Effect::CloudDetail),
        (effects.multiple_scattering.is_some(), Effect::MultipleScattering),
        (effects.cloud_shadow.is_some(), Effect::CloudShadow),
        (effects.light_shafts.is_some(), Effect::LightShafts),
        (effects.aerial_perspective.is_some(), Effect::AerialPerspective),
        (effects.moon.is_some(), Effect::Moon),
        (effects.stars.is_some(), Effect::Stars),
    ]
    .into_iter()
    .filter_map(|(present, effect)| present.then_some(effect))
    .collect()
}

impl Plan {
    /// Selects from the catalogue what the scene's effects need, by the methods that it chose. Errors: those of [`methods::choose`].
    pub fn new(scene: &Scene) -> Result<Self, ApiError> {
        let chosen = methods::choose(scene)?;
        let effects = effects(&scene.effects);
        let has = |e: &Effect| effects.contains(e);
        let wanted = |pass: &Pass| {
            let info = pass.info();
            // Of each ladder that the pass names, one of the named rungs.
            let on = |ladder| {
                chosen
                    .choices
                    .iter()
                    .any(|c| c.rung.info().ladder == ladder && info.rungs.contains(&c.rung))
            };
            info.rungs.iter().all(|r| on(r.info().ladder))
                && info.needs.iter().all(has)
                && !info.unless.as_ref().is_some_and(has)
        };
        let slow = Pass::SlowClear.info().writes;
        let mut passes: Vec<Pass> = Pass::ALL.iter().copied().filter(wanted).collect();
        // Clearing and adding held tendencies is work for those that make them; with none of them there is nothing to hold.
        let holds = passes
            .iter()
            .any(|p| !p.serves_held_tendencies() && p.info().writes.iter().any(|f| slow.contains(f)));
        passes.retain(|p| !p.serves_held_tendencies() || holds);
        let fields = Field::ALL
            .iter()
            .copied()
            .filter(|f| has(&f.effect()))
            // The start is kept whatever carries: a tick can be taken back to it.
            .filter(|f| f.is_state() || f.is_start() || passes.iter().any(|p| p.info().writes.contains(f)))
            .collect();
        Ok(Self {
            effects,
            chosen,
            passes,
            fields,
        })
    }

    /// The passes of one phase.
    pub fn phase(&self, phase: Phase) -> Vec<Pass> {
        self.passes
            .iter()
            .copied()
            .filter(|p| p.info().phase == phase)
            .collect()
    }
}

/// How often each pass ran and how long it took in all. The world's thread writes, anybody reads, nobody waits.
#[derive(Debug)]
pub struct Timings {
    passes: Vec<Timing>,
}

#[derive(Debug, Default)]
struct Timing {
    runs: AtomicU64,
    total_ns: AtomicU64,
}

impl Default for Timings {
    fn default() -> Self {
        Self {
            passes: Pass::ALL.iter().map(|_| Timing::default()).collect(),
        }
    }
}

impl Timings {
    /// Counts one run of a pass.
    pub fn add(&self, pass: Pass, elapsed: Duration) {
        let timing = &self.passes[pass as usize];
        timing.runs.fetch_add(1, Ordering::Relaxed);
        timing.total_ns.fetch_add(elapsed.as_nanos() as u64, Ordering::Relaxed);
    }

    /// Takes what a device with a clock of its own has counted.
    pub fn set(&self, pass: Pass, runs: u64, total_s: f64) {
        let timing = &self.passes[pass as usize];
        timing.runs.store(runs, Ordering::Relaxed);
        timing.total_ns.store((total_s * 1e9) as u64, Ordering::Relaxed);
    }

    /// Puts what was measured so far into a plan.
    pub fn put(&self, plan: &mut PlanReport) {
        for (pass, timing) in Pass::ALL.iter().zip(&self.passes) {
            let runs = timing.runs.load(Ordering::Relaxed);
            let total_ms = timing.total_ns.load(Ordering::Relaxed) as f64 * 1e-6;
            if let Some(report) = plan.passes.iter_mut().find(|p| p.stage == pass.info().name) {
                report.runs = runs;
                report.mean_ms = (runs > 0).then(|| total_ms / runs as f64);
            }
        }
    }
}
