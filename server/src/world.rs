//! A world: one scene that runs. It owns its device and its clock; whoever owns it decides how fast ticks follow each other.

mod lost_device;
mod report;
mod tick;

use std::sync::Arc;
use std::time::{Duration, Instant};

use welkin_proto::scene::Sun;
use welkin_proto::wire::{HealthState, Numbers, PlanReport};
use welkin_proto::{ApiError, Scene};
use welkin_shaders::catalogue::{Field, Pass, Phase};
use welkin_shaders::constants::GRAVITY_M_S2;
use welkin_shaders::cpu::sim::Parameters;
use welkin_shaders::{CloudReductions, CloudVolume, Device, Reductions, Vitals};

use crate::base_state::{self, BaseState};
use crate::change::Change;
use crate::machine::Machine;
use crate::plan::{Plan, Timings};
use crate::watchdog::{Bounds, Fault, Mark, Watchdog};
use crate::{initial, parameters};

/// See [`World::unwatched_tick_s`].
const UNWATCHED_TICK_S: f64 = 20.0;
/// Wall time between copies of a GPU's state to the host.
const HOST_COPY_EVERY: Duration = Duration::from_secs(5);
/// A substep is never longer than this share of a buoyancy oscillation's 1/N, which the explicit scheme must follow.
const BUOYANCY_PHASE_MAX: f64 = 1.0;

/// A running scene.
pub struct World {
    scene: Arc<Scene>,
    base: BaseState,
    plan: Plan,
    report: Arc<PlanReport>,
    machine: Machine,
    parameters: Arc<Parameters>,
    device: Box<dyn Device>,
    pool: Arc<rayon::ThreadPool>,
    passes: [Vec<Pass>; 3],
    timings: Arc<Timings>,
    start_unix_s: f64,
    simulated_s: f64,
    tick: u64,
    tick_ms: f64,
    substeps: u32,
    substep_s: f64,
    reductions: Reductions,
    cloud: Option<CloudReductions>,
    vitals: Vitals,
    air_displacement_m: [f64; 2],
    buoyancy_frequency_per_s: f64,
    watchdog: Watchdog,
    /// Whether somebody changed the state since it was reduced last.
    touched: bool,
    faults: Vec<Fault>,
    host_copy: Option<HostCopy>,
    unjudged: Option<Unjudged>,
}

/// A tick whose end the device is still reducing; see [`World::tick_ahead`].
struct Unjudged {
    tick: u64,
    length_s: f64,
    substeps: u32,
    start: Mark,
    /// Whether the start is in the watchdog's slot for it.
    saved: bool,
}

/// A good state in the host's memory, from which a world is rebuilt whose device was lost.
struct HostCopy {
    fields: Vec<(Field, Vec<f32>)>,
    mark: Mark,
    made: Instant,
}

/// What a tick publishes; immutable and cheap to clone.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// The world's numbers.
    pub numbers: Numbers,
    /// The cloud; none where the scene has no moisture.
    pub volume: Option<Arc<CloudVolume>>,
    /// Unit vector towards the sun: x east, y north, z up.
    pub sun_direction: [f32; 3],
    /// The scene, with the effects that it has now.
    pub scene: Arc<Scene>,
    /// What runs.
    pub plan: Arc<PlanReport>,
    /// What it costs; it goes on counting.
    pub timings: Arc<Timings>,
}

impl World {
    /// Builds the world of a validated scene: base state, plan, fields, initial state.
    ///
    /// `machine` is what it computes on, or the number of the CPU's threads. Errors: those of [`Plan::new`], of the base state and of
    /// [`Compute::device`](crate::machine::Compute::device); `bad_time`; `internal` where no threads can be started; `unstable`
    /// where the initial state does not pass the watchdog.
    pub fn new(scene: Scene, machine: impl Into<Machine>) -> Result<Self, ApiError> {
        let machine = machine.into();
        let plan = Plan::new(&scene)?;
        let base = base_state::build(&scene)?;
        let start_unix_s = welkin_proto::time::parse_utc(&scene.time.start_utc)?;
        let parameters = Arc::new(parameters::parameters(&scene, &base, plan.chosen.methods.clone()));
        let mut device = machine.compute.device(&parameters, &plan)?;
        initial::write(&scene, &base, &parameters, device.as_mut());
        // Threads of its own, so that a tick and a picture share the cores by the system's clock and not task by task.
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(machine.threads.unwrap_or(0))
            .thread_name(|n| format!("world-{n}"))
            .build()
            .map_err(|e| ApiError::new("internal", format!("no threads to compute on: {e}")))?;
        let dz = parameters.grid.cell_size_m[2] as f64;
        let theta_v = &base.virtual_potential_temperature_k;
        let stability = theta_v
            .windows(2)
            .map(|t| GRAVITY_M_S2 / t[0] * (t[1] - t[0]).abs() / dz)
            .fold(0.0, f64::max);
        let passes = [Phase::Step, Phase::Stage, Phase::Publish].map(|p| plan.phase(p));
        let first = Mark {
            simulated_s: 0.0,
            reductions: Reductions::default(),
            cloud: None,
            vitals: Vitals::default(),
            air_displacement_m: [0.0; 2],
            parameters: Arc::clone(&parameters),
        };
        let bounds = Bounds::new(
            plan.chosen.courant_max.unwrap_or(1.0),
            &parameters.methods,
            device.lags(),
        );
        let mut world = Self {
            watchdog: Watchdog::new(bounds, &first),
            touched: false,
            faults: Vec::new(),
            host_copy: None,
            unjudged: None,
            machine,
            report: Arc::default(),
            timings: Arc::default(),
            scene: Arc::new(scene),
            base,
            plan,
            parameters,
            device,
            pool: Arc::new(pool),
            passes,
            start_unix_s,
            simulated_s: 0.0,
            tick: 0,
            tick_ms: 0.0,
            substeps: 0,
            substep_s: 0.0,
            reductions: Reductions::default(),
            cloud: None,
            vitals: Vitals::default(),
            air_displacement_m: [0.0; 2],
            buoyancy_frequency_per_s: stability.sqrt(),
        };
        if world.has_flow() {
            world.make_divergence_free();
        } else {
            world.reductions.finite = true;
        }
        world.on_threads(|world| {
            world.publish();
            let judged = bounds.state(&world.reductions, &world.vitals);
            judged.map_err(|trouble| {
                ApiError::new(
                    "unstable",
                    format!("the scene's first state cannot be run: {}", trouble.message),
                )
            })?;
            Watchdog::slots().for_each(|slot| world.device.save(slot));
            world.watchdog = Watchdog::new(bounds, &world.mark());
            Ok(())
        })?;
        world.keep_host_copy();
        world.report = Arc::new(world.plan_report());
        Ok(world)
    }

    /// Runs `work` on the world's own threads. Ticks within hand nothing over to them from outside, which would allocate a block of the
    /// pool's queue now and then.
    pub fn on_threads<R: Send>(&mut self, work: impl FnOnce(&mut Self) -> R + Send) -> R {
        let pool = Arc::clone(&self.pool);
        pool.install(|| work(self))
    }

    fn has_flow(&self) -> bool {
        self.plan.fields.contains(&Field::VelocityX)
    }

    /// The threads that it computes on.
    pub fn pool(&self) -> &Arc<rayon::ThreadPool> {
        &self.pool
    }

    /// The scene it runs.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// What it computes on.
    pub fn machine(&self) -> &Machine {
        &self.machine
    }

    /// The air it started from.
    pub fn base_state(&self) -> &BaseState {
        &self.base
    }

    /// What it runs and holds.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// What the last tick's end says of its cloud and water; none where the scene has no moisture.
    pub fn cloud(&self) -> Option<&CloudReductions> {
        self.cloud.as_ref()
    }

    /// The numbers its passes are told.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Its device, to read fields from.
    pub fn device(&self) -> &dyn Device {
        self.device.as_ref()
    }

    /// Replaces a field of the state, say for a test. Errors: `unknown_field` if the plan doesn't hold it or the length differs.
    pub fn write_field(&mut self, field: Field, values: &[f32]) -> Result<(), ApiError> {
        self.settle();
        if self.device.write(field, values) {
            self.touched = true;
            Ok(())
        } else {
            Err(ApiError::new(
                "unknown_field",
                format!("the plan holds no {} of {} values", field.name(), values.len()),
            ))
        }
    }

    /// Simulated seconds since the start.
    pub fn simulated_s(&self) -> f64 {
        self.simulated_s
    }

    /// Whether the spin-up is still running.
    pub fn spinning_up(&self) -> bool {
        self.simulated_s < self.scene.time.spin_up_s
    }

    /// What the watchdog knows: health, the last trouble, retries.
    pub fn watchdog(&self) -> &Watchdog {
        &self.watchdog
    }

    /// Whether the watchdog has stopped it: ticks do nothing until [`World::resume`].
    pub fn is_halted(&self) -> bool {
        self.watchdog.health() == HealthState::Halted
    }

    /// Whether its time ran through once: it never had to go back to an earlier state.
    pub fn ran_through(&self) -> bool {
        self.watchdog.restores() == 0 && !self.is_halted()
    }

    /// Lets a halted world try again; does nothing to others.
    pub fn resume(&mut self) {
        self.watchdog.resume();
    }

    /// The error of a run that needed more simulated time than a halted world gives: `unstable`; none while it runs.
    pub fn halted_error(&self) -> Option<ApiError> {
        let (_, trouble) = self.watchdog.trouble().filter(|_| self.is_halted())?;
        Some(ApiError::new(
            "unstable",
            format!("the scene cannot be run on: {}", trouble.message),
        ))
    }

    /// Plants a fault, to prove the watchdog: for tests.
    pub fn inject(&mut self, fault: Fault) {
        self.faults.push(fault);
    }

    /// Keeps the present state in a slot of the caller's choice outside [`Watchdog::slots`]; [`World::restore`] takes what this returns.
    pub fn save(&mut self, slot: usize) -> Mark {
        self.settle();
        self.on_threads(|world| {
            world.refresh();
            world.device.save(slot);
            world.mark()
        })
    }

    /// Goes back to a saved state, from which it continues bit for bit as it did; `false`, and nothing is changed, where the slot is empty.
    /// Its tick number goes on.
    pub fn restore(&mut self, slot: usize, mark: &Mark) -> bool {
        self.settle();
        let restored = self.on_threads(|world| world.device.restore(slot));
        if restored {
            self.recall(mark);
            self.on_threads(Self::publish);
        }
        restored
    }

    /// Takes a change of effects over: what both plans hold goes on as it is, what is new starts from the base state. The clock stays.
    pub fn adopt(&mut self, change: Change) {
        self.settle();
        let Change {
            scene,
            plan,
            mut parameters,
            mut device,
        } = change;
        for field in Field::STATE {
            if self.plan.fields.contains(&field)
                && let Some(values) = self.device.read(field)
            {
                // A field that the new plan lacks is refused and dropped.
                device.write(field, &values);
            }
        }
        // Winds that commands have added stay.
        let p = Arc::make_mut(&mut parameters);
        p.base_wind_x_m_s.clone_from(&self.parameters.base_wind_x_m_s);
        p.base_wind_y_m_s.clone_from(&self.parameters.base_wind_y_m_s);
        if let (Some(new), Some(old)) = (&mut p.coriolis, &self.parameters.coriolis) {
            new.clone_from(old);
        }
        device.set_parameters(p);
        let sun = self.scene.sun.clone();
        self.scene = Arc::new(Scene { sun, ..scene });
        self.plan = plan;
        self.parameters = parameters;
        self.device = device;
        self.passes = [Phase::Step, Phase::Stage, Phase::Publish].map(|p| self.plan.phase(p));
        self.timings = Arc::default();
        self.reductions = Reductions {
            finite: true,
            ..Reductions::default()
        };
        self.touched = true;
        self.on_threads(|world| {
            world.refresh();
            Watchdog::slots().for_each(|slot| world.device.save(slot));
        });
        let bounds = Bounds::new(
            self.plan.chosen.courant_max.unwrap_or(1.0),
            &self.parameters.methods,
            self.device.lags(),
        );
        self.watchdog.changed(bounds, &self.mark());
        self.host_copy = None;
        self.keep_host_copy();
        self.report = Arc::new(self.plan_report());
    }

    /// Reduces a state that somebody has changed since it was reduced.
    fn refresh(&mut self) {
        if std::mem::take(&mut self.touched) {
            if self.has_flow() {
                // The device's viscosity may be of another state, one that was given up; what belongs to this one is known here.
                let viscosity_max_m2_s = self.reductions.viscosity_max_m2_s;
                self.reductions = Reductions {
                    viscosity_max_m2_s,
                    ..self.device.reduce()
                };
            }
            self.publish();
        }
    }

    /// Computes what is published of the state, and what it is judged by.
    fn publish(&mut self) {
        self.run_publish_passes();
        self.take_verdict();
    }

    /// Adds a uniform wind to the whole box; the base and geostrophic winds move with it, so that it stays.
    pub fn add_wind(&mut self, x_m_s: f64, y_m_s: f64) {
        self.settle();
        for (field, add) in [(Field::VelocityX, x_m_s), (Field::VelocityY, y_m_s)] {
            if let Some(values) = self.device.read(field) {
                let moved: Vec<f32> = values.iter().map(|v| v + add as f32).collect();
                drop(values);
                self.device.write(field, &moved);
            }
        }
        let p = Arc::make_mut(&mut self.parameters);
        let shift = |profile: &mut Vec<f32>, add: f64| profile.iter_mut().for_each(|v| *v += add as f32);
        shift(&mut p.base_wind_x_m_s, x_m_s);
        shift(&mut p.base_wind_y_m_s, y_m_s);
        if let Some(rotation) = &mut p.coriolis {
            shift(&mut rotation.wind_x_m_s, x_m_s);
            shift(&mut rotation.wind_y_m_s, y_m_s);
        }
        self.device.set_parameters(&self.parameters);
        self.touched = true;
        self.on_threads(Self::refresh);
    }

    /// Places the sun, or gives it to the clock.
    pub fn set_sun(&mut self, sun: Sun) {
        Arc::make_mut(&mut self.scene).sun = sun;
    }

    /// What its passes have cost so far; it goes on counting.
    pub fn timings(&self) -> &Arc<Timings> {
        &self.timings
    }
}
