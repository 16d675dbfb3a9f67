//! Other effects for a world that runs: made ready on any thread while its ticks go on, taken over between two of them.

use std::sync::Arc;

use welkin_proto::scene::Effects;
use welkin_proto::{ApiError, Scene, validate};
use welkin_shaders::Device;
use welkin_shaders::cpu::sim::Parameters;

use crate::machine::Machine;
use crate::plan::Plan;
use crate::{base_state, initial, parameters};

/// Everything that other effects need: plan, parameters, a device with its fields allocated and its pipelines compiled.
pub struct Change {
    pub(crate) scene: Scene,
    pub(crate) plan: Plan,
    pub(crate) parameters: Arc<Parameters>,
    pub(crate) device: Box<dyn Device>,
}

impl Change {
    /// Judges other effects for `scene` without making anything. Errors: those of a scene, with pointers into the effects as in a scene; those of
    /// [`Plan::new`]; `method_needs_cpu`.
    pub fn judge(scene: &Scene, effects: Effects, machine: &Machine) -> Result<(Scene, Plan), ApiError> {
        let scene = Scene {
            effects,
            ..scene.clone()
        };
        // The scene was let in with these cells; only what changes is judged.
        let limits = validate::Limits {
            max_cells: u64::MAX,
            max_scene_bytes: usize::MAX,
            max_profile_rows: validate::Limits::default().max_profile_rows,
        };
        validate::validate(&scene, &limits)?;
        let plan = Plan::new(&scene)?;
        machine.compute.supports(&plan)?;
        Ok((scene, plan))
    }

    /// Makes a change ready. Errors: those of [`Change::judge`] and of [`Compute::device`](crate::machine::Compute::device).
    pub fn prepare(scene: &Scene, effects: Effects, machine: &Machine) -> Result<Self, ApiError> {
        let (scene, plan) = Self::judge(scene, effects, machine)?;
        let base = base_state::build(&scene)?;
        let parameters = Arc::new(parameters::parameters(&scene, &base, plan.chosen.methods.clone()));
        let mut device = machine.compute.device(&parameters, &plan)?;
        initial::write(&scene, &base, &parameters, device.as_mut());
        Ok(Self {
            scene,
            plan,
            parameters,
            device,
        })
    }
}
