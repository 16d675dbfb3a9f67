//! A world: one scene that runs. It owns its device and its clock; whoever owns it decides how fast ticks follow each other.

use std::sync::Arc;
use std::time::{Duration, Instant};

use welkin_proto::scene::Sun;
use welkin_proto::wire::{FieldReport, HealthState, LadderReport, Numbers, PassReport, PlanReport};
use welkin_proto::{ApiError, Scene};
use welkin_shaders::catalogue::{Field, Pass, Phase, VIEW_STAGES};
use welkin_shaders::constants::GRAVITY_M_S2;
use welkin_shaders::cpu::sim::Parameters;
use welkin_shaders::cpu::sim::parameters::DiffusionScheme;
use welkin_shaders::{CloudReductions, CloudVolume, Device, Reductions, Substep, Vitals};

use crate::base_state::{self, BaseState};
use crate::change::Change;
use crate::machine::Machine;
use crate::plan::{Plan, Timings};
use crate::watchdog::{Bounds, Damage, Fault, HALVINGS, Mark, Trouble, Watchdog};
use crate::weather::{Copied, FieldSet};
use crate::{initial, moon, parameters, sun};

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

    /// Length of a tick that nobody watches, in spin-up and in runs without viewers, s: the scene's, or 20 s if that is longer. A tick
    /// bounds its substeps, so short ones make a run slower than stability asks for.
    pub fn unwatched_tick_s(&self) -> f64 {
        self.scene.time.tick_s.max(UNWATCHED_TICK_S)
    }

    /// Advances by one tick: the scene's tick length, or an unwatched tick's during spin-up.
    pub fn tick(&mut self) {
        self.advance_by(self.tick_length_s());
    }

    /// Advances by one tick as [`World::tick`] does, to the same bits, but on a device that lags leaves the tick's end to be judged while the
    /// device computes the next tick's first substep, so that it never stands idle between two ticks. Call [`World::settle`] before
    /// anything is made of the tick: until then its numbers are those of the tick before.
    pub fn tick_ahead(&mut self) {
        let (length_s, ahead) = (self.tick_length_s(), self.device.lags() && self.has_flow());
        self.on_threads(|world| world.advance_here(length_s, ahead));
    }

    /// Judges a tick that [`World::tick_ahead`] left unjudged; does nothing otherwise.
    pub fn settle(&mut self) {
        if self.unjudged.is_some() {
            self.on_threads(|world| world.settle_here(true));
        }
    }

    fn tick_length_s(&self) -> f64 {
        if self.spinning_up() {
            self.unwatched_tick_s()
        } else {
            self.scene.time.tick_s
        }
    }

    /// Ticks until `simulated_s`, or until the watchdog halts the world; the last tick may be shorter. `progress` is told the simulated
    /// seconds after each tick and stops the run by `false`.
    pub fn advance_to(&mut self, simulated_s: f64, mut progress: impl FnMut(&Self) -> bool) {
        while self.simulated_s < simulated_s - 1e-9 && !self.is_halted() {
            self.advance_by(self.unwatched_tick_s().min(simulated_s - self.simulated_s));
            if !progress(self) {
                return;
            }
        }
    }

    /// Advances by `length_s` simulated seconds as one tick, in as many equal substeps as stability asks for. A tick that the
    /// watchdog rejects is tried again with shorter substeps, or ends in an earlier good state; a halted world stays as it is.
    pub fn advance_by(&mut self, length_s: f64) {
        self.on_threads(|world| world.advance_here(length_s, false));
    }

    fn advance_here(&mut self, length_s: f64, ahead: bool) {
        if self.is_halted() {
            return;
        }
        let begin = Instant::now();
        let mut begun = None;
        if self.unjudged.is_some() && !self.host_copy_is_fresh() {
            self.settle_here(true);
        } else if self.unjudged.is_some() {
            // The tick before is judged while the device computes the first substep of this one.
            let reductions = self.reductions;
            self.tick += 1;
            self.substeps = 0;
            self.next_substep(length_s, self.watchdog.caution());
            let first = (self.reductions, self.substep_s);
            self.reductions = reductions;
            if self.settle_here(false) {
                begun = Some(first);
            } else {
                // The state is another one now, or the world stands: what was begun is gone.
                self.tick -= 1;
            }
        }
        if self.is_halted() {
            return;
        }
        if begun.is_none() {
            self.refresh();
            self.tick += 1;
        }
        let start = self.mark();
        let mut saved = false;
        let tried = self.try_tick(length_s, self.watchdog.caution(), begun, &start, &mut saved, ahead);
        if ahead && tried.is_ok() {
            self.unjudged = Some(Unjudged {
                tick: self.tick,
                length_s,
                substeps: self.substeps,
                start,
                saved,
            });
        } else {
            self.finish_tick(length_s, tried, start, saved);
            self.keep_host_copy();
        }
        self.tick_ms = begin.elapsed().as_secs_f64() * 1e3;
    }

    /// Judges the tick that is not judged yet; `false` if it was bad, so that the state is another one than it was. `at_its_end`: nothing was begun since.
    fn settle_here(&mut self, at_its_end: bool) -> bool {
        let Some(Unjudged {
            tick,
            length_s,
            substeps,
            start,
            saved,
        }) = self.unjudged.take()
        else {
            return true;
        };
        let now = (self.tick, self.substeps, self.substep_s);
        (self.tick, self.substeps) = (tick, substeps);
        // The clock went on ahead of the judgement, which sets it again.
        self.simulated_s = start.simulated_s;
        let judged = self.judge(length_s, &start);
        let good = judged.is_ok();
        self.finish_tick(length_s, judged, start, saved);
        if good && at_its_end {
            self.keep_host_copy();
        }
        if good {
            (self.tick, self.substeps, self.substep_s) = now;
        } else {
            self.tick = now.0;
        }
        good
    }

    /// Keeps what a good tick leaves; what the watchdog rejected is tried again with shorter substeps, undone, or ends the run.
    fn finish_tick(&mut self, length_s: f64, mut tried: Result<(), Trouble>, start: Mark, mut saved: bool) {
        let mut factor = self.watchdog.caution();
        let mut halvings = 0;
        loop {
            let Err(trouble) = tried else {
                self.watchdog.good(&start, saved, self.simulated_s);
                return;
            };
            if let Some(lost) = self.device_lost() {
                tracing::error!(tick = self.tick, "{}", lost.message);
                if let Err(error) = self.rebuild(start.simulated_s, &lost) {
                    self.recall(&start);
                    let message = format!("{}; it could not be rebuilt: {error}", lost.message);
                    self.watchdog.halt(self.tick, Trouble { message, ..lost });
                }
                return;
            }
            tracing::warn!(tick = self.tick, code = trouble.code, halvings, "{}", trouble.message);
            // A start that is bad itself gets no better by shorter substeps.
            if saved && halvings < HALVINGS {
                self.device.restore(self.watchdog.start_slot());
                self.recall(&start);
                self.watchdog.retry(self.tick, trouble);
                halvings += 1;
                factor *= 0.5;
                saved = false;
                tried = self.try_tick(length_s, factor, None, &start, &mut saved, false);
                continue;
            }
            let fallback = self.watchdog.fall_back(self.tick, start.simulated_s, trouble);
            self.device.restore(fallback.slot);
            self.recall(&fallback.mark);
            self.publish();
            if let Some((_, trouble)) = self.watchdog.trouble() {
                tracing::error!(
                    tick = self.tick,
                    code = trouble.code,
                    health = self.watchdog.health().name(),
                    "{}",
                    trouble.message
                );
            }
            return;
        }
    }

    /// Copies the state to the host where the device may be lost, when the last copy has become old.
    fn keep_host_copy(&mut self) {
        if self.host_copy_is_fresh() {
            return;
        }
        let held = Field::STATE.into_iter().filter(|f| self.plan.fields.contains(f));
        // A device that is lost meanwhile answers nothing; the copy before stays.
        let fields: Option<Vec<_>> = held.map(|f| Some((f, self.device.read(f)?.into_owned()))).collect();
        if let Some(fields) = fields {
            self.host_copy = Some(HostCopy {
                fields,
                mark: self.mark(),
                made: Instant::now(),
            });
        }
    }

    /// Whether no copy on the host is due: the last one is young, or the device cannot be lost.
    fn host_copy_is_fresh(&self) -> bool {
        let fresh = |copy: &HostCopy| copy.made.elapsed() < HOST_COPY_EVERY;
        !self.device.lags() || self.host_copy.as_ref().is_some_and(fresh)
    }

    /// Opens the device again and goes on from the host's copy of the state. Errors: the adapter is gone, or refuses what it gave before.
    fn rebuild(&mut self, failed_s: f64, lost: &Trouble) -> Result<(), ApiError> {
        let copy = self.host_copy.take();
        let copy = copy.ok_or_else(|| ApiError::new("device_lost", "the host holds no state"))?;
        self.machine.compute.reopen()?;
        self.parameters = Arc::clone(&copy.mark.parameters);
        let mut device = self.machine.compute.device(&self.parameters, &self.plan)?;
        for (field, values) in &copy.fields {
            device.write(*field, values);
        }
        self.device = device;
        self.recall(&copy.mark);
        self.publish();
        Watchdog::slots().for_each(|slot| self.device.save(slot));
        self.watchdog.rebuilt(self.tick, failed_s, lost.clone(), &copy.mark);
        self.host_copy = Some(copy);
        Ok(())
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

    /// A device that is gone for good, as trouble.
    fn device_lost(&self) -> Option<Trouble> {
        let error = self.device.trouble()?;
        Some(Trouble {
            code: "device_lost",
            message: format!("the device is lost: {error}"),
        })
    }

    /// One try of a tick, whose first substep may have been `begun`: what its reductions were and how long it is. `saved` tells whether the start is in the
    /// watchdog's slot for it, so that it can be restored. Judges the end as well, unless that is left for later (`ahead`).
    fn try_tick(
        &mut self,
        length_s: f64,
        factor: f64,
        begun: Option<(Reductions, f64)>,
        start: &Mark,
        saved: &mut bool,
        ahead: bool,
    ) -> Result<(), Trouble> {
        let bounds = self.watchdog.bounds;
        bounds.start(&self.reductions, &self.vitals)?;
        self.substeps = 0;
        if self.has_flow() {
            match begun {
                Some(first) => (self.reductions, self.substep_s) = first,
                None => self.next_substep(length_s, factor),
            }
            self.device.save_start(self.watchdog.start_slot());
            *saved = true;
            let mut done = self.substep_s;
            self.substeps = 1;
            bounds.substep(&self.reductions, self.substep_s)?;
            while length_s - done > 1e-6 * length_s {
                self.next_substep(length_s - done, factor);
                done += self.substep_s;
                self.substeps += 1;
                bounds.substep(&self.reductions, self.substep_s)?;
            }
        }
        self.run_publish_passes();
        if ahead {
            self.simulated_s += length_s;
            return Ok(());
        }
        self.judge(length_s, start)
    }

    /// One substep with its reductions: the longest of equal ones that fill `left_s`.
    fn next_substep(&mut self, left_s: f64, factor: f64) {
        let count = (left_s / (factor * self.substep_max_s())).ceil().max(1.0);
        self.substep_s = left_s / count;
        self.substep(self.substep_s as f32);
        self.strike();
        self.reductions = self.device.reduce();
    }

    /// Judges a tick's end and moves the clock.
    fn judge(&mut self, length_s: f64, start: &Mark) -> Result<(), Trouble> {
        let bounds = self.watchdog.bounds;
        self.take_verdict();
        if let Some(lost) = self.device_lost() {
            return Err(lost);
        }
        bounds.state(&self.reductions, &self.vitals)?;
        if let (Some(before), Some(after)) = (&start.cloud, &self.cloud) {
            bounds.water(before, after, length_s, self.substeps)?;
        }
        self.simulated_s += length_s;
        if let Some([u, v]) = self.cloud.and_then(|c| c.wind_m_s) {
            self.air_displacement_m[0] += u * length_s;
            self.air_displacement_m[1] += v * length_s;
        }
        Ok(())
    }

    /// Lets planted faults strike.
    fn strike(&mut self) {
        for i in 0..self.faults.len() {
            let Fault {
                tick,
                substep,
                field,
                damage,
                strikes,
            } = self.faults[i];
            if tick != self.tick || substep != self.substeps || strikes == 0 {
                continue;
            }
            self.faults[i].strikes -= 1;
            let mut values = self.device.read(field).unwrap_or_default().into_owned();
            match damage {
                Damage::Cell(cell, value) => values[cell] = value,
                Damage::Scale(factor) => values.iter_mut().for_each(|v| *v *= factor),
            }
            self.device.write(field, &values);
        }
    }

    /// What belongs to the present state.
    fn mark(&self) -> Mark {
        Mark {
            simulated_s: self.simulated_s,
            reductions: self.reductions,
            cloud: self.cloud,
            vitals: self.vitals,
            air_displacement_m: self.air_displacement_m,
            parameters: Arc::clone(&self.parameters),
        }
    }

    /// Takes what belongs to a state whose fields have been restored.
    fn recall(&mut self, mark: &Mark) {
        self.simulated_s = mark.simulated_s;
        self.reductions = mark.reductions;
        self.cloud = mark.cloud;
        self.vitals = mark.vitals;
        self.air_displacement_m = mark.air_displacement_m;
        self.touched = false;
        if !Arc::ptr_eq(&self.parameters, &mark.parameters) {
            self.parameters = Arc::clone(&mark.parameters);
            self.device.set_parameters(&self.parameters);
        }
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

    /// The longest substep that is stable for the present state, s.
    fn substep_max_s(&self) -> f64 {
        let courant_max = self.plan.chosen.courant_max.unwrap_or(1.0);
        let by_speed = courant_max / (self.reductions.courant_rate_per_s as f64).max(1e-9);
        let by_buoyancy = BUOYANCY_PHASE_MAX / self.buoyancy_frequency_per_s.max(1e-9);
        let by_mixing = self.parameters.turbulence.as_ref().map_or(f64::INFINITY, |t| {
            let curvature: f64 = self
                .parameters
                .grid
                .cell_size_m
                .iter()
                .map(|&d| 1.0 / (d as f64).powi(2))
                .sum();
            let worst = self.reductions.viscosity_max_m2_s as f64 * (1.0f64).max(0.5 / t.prandtl as f64) * curvature;
            0.25 / worst.max(1e-9)
        });
        let by_viscosity = match &self.parameters.constant_viscosity {
            Some(mixing) if mixing.scheme == DiffusionScheme::Explicit => {
                let grid = &self.parameters.grid;
                let curvature: f64 = (0..3)
                    .filter(|&a| grid.cells[a] > 1)
                    .map(|a| (grid.cell_size_m[a] as f64).powi(-2))
                    .sum();
                let worst = mixing.viscosity_m2_s.max(mixing.diffusivity_m2_s) as f64 * curvature;
                0.25 / worst.max(1e-9)
            }
            _ => f64::INFINITY,
        };
        by_speed.min(by_buoyancy).min(by_mixing).min(by_viscosity)
    }

    fn run(&mut self, pass: Pass, substep: &Substep) {
        let begin = Instant::now();
        self.device.run(pass, substep);
        self.timings.add(pass, begin.elapsed());
    }

    fn run_phase(&mut self, phase: usize, substep: &Substep) {
        let last = substep.stage + 1 == substep.stages;
        for i in 0..self.passes[phase].len() {
            let pass = self.passes[phase][i];
            if last || !pass.ends_substep() {
                self.run(pass, substep);
            }
        }
    }

    fn substep(&mut self, substep_s: f32) {
        let stages = self.parameters.methods.stages();
        let part = |stage| Substep {
            substep_s,
            stage,
            stages,
        };
        self.run_phase(0, &part(0));
        for stage in 0..stages {
            self.run_phase(1, &part(stage));
            self.device.accept(stage);
        }
    }

    /// Frees the initial wind of divergence: a projection with nothing carried before it.
    fn make_divergence_free(&mut self) {
        for (state, next) in [
            (Field::VelocityX, Field::NextVelocityX),
            (Field::VelocityY, Field::NextVelocityY),
            (Field::VelocityZ, Field::NextVelocityZ),
        ] {
            let values = self.device.read(state).unwrap_or_default().into_owned();
            self.device.write(next, &values);
        }
        let whole = Substep {
            substep_s: 1.0,
            stage: 0,
            stages: 1,
        };
        for pass in self.plan.phase(Phase::Stage) {
            if pass == Pass::Project || pass.info().writes.contains(&Field::Pressure) {
                self.device.run(pass, &whole);
            }
        }
        for (state, next) in [
            (Field::VelocityX, Field::NextVelocityX),
            (Field::VelocityY, Field::NextVelocityY),
            (Field::VelocityZ, Field::NextVelocityZ),
        ] {
            let values = self.device.read(next).unwrap_or_default().into_owned();
            self.device.write(state, &values);
        }
        self.reductions = self.device.reduce();
    }

    /// Computes what is published of the state, and what it is judged by.
    fn publish(&mut self) {
        self.run_publish_passes();
        self.take_verdict();
    }

    fn run_publish_passes(&mut self) {
        self.run_phase(
            2,
            &Substep {
                substep_s: 0.0,
                stage: 0,
                stages: 1,
            },
        );
        self.device.judge();
    }

    fn take_verdict(&mut self) {
        self.vitals = self.device.vitals();
        self.cloud = self.device.reduce_cloud();
        for &pass in &self.plan.passes {
            if let Some((runs, total_s)) = self.device.pass_time(pass) {
                self.timings.set(pass, runs, total_s);
            }
        }
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

    /// The world's numbers. What its host knows better (speed, time scale, pause, milliseconds a frame) is left at its default.
    pub fn numbers(&self) -> Numbers {
        let unix_s = self.start_unix_s + self.simulated_s;
        let [sun_elevation_deg, sun_azimuth_deg] = sun::position_deg(&self.scene.sun, &self.scene.domain, unix_s);
        let moon = moon::of_scene(&self.scene, unix_s);
        let stars = self.scene.effects.stars.as_ref();
        let cloud = self.cloud;
        Numbers {
            tick: self.tick,
            simulated_s: self.simulated_s,
            utc: welkin_proto::time::format_utc(unix_s),
            tick_ms: self.tick_ms,
            substeps: self.substeps,
            substep_s: self.substep_s,
            time_scale: self.scene.time.time_scale,
            spinning_up: self.spinning_up(),
            cloud_cover: cloud.map(|c| c.cover),
            cloud_base_m: cloud.and_then(|c| c.base_m),
            cloud_top_m: cloud.and_then(|c| c.top_m),
            liquid_water_path_kg_m2: cloud.map(|c| c.liquid_water_path_kg_m2),
            total_water_path_kg_m2: cloud.map(|c| c.total_water_path_kg_m2),
            updraught_max_m_s: self.reductions.updraught_max_m_s as f64,
            wind_max_m_s: self.reductions.wind_max_m_s as f64,
            courant: self.reductions.courant_rate_per_s as f64 * self.substep_s,
            divergence_max_per_s: self.vitals.divergence_max_per_s as f64,
            sun_elevation_deg,
            sun_azimuth_deg,
            moon_elevation_deg: moon.map(|m| m.elevation_deg),
            moon_azimuth_deg: moon.map(|m| m.azimuth_deg),
            moon_distance_m: moon.map(|m| m.distance_m),
            sidereal_deg: stars.map(|_| moon::sidereal_rad(unix_s, self.scene.domain.longitude_deg).to_degrees()),
            health: self.watchdog.health(),
            trouble_code: self.watchdog.trouble().map(|(_, t)| t.code.to_owned()),
            trouble_message: self.watchdog.trouble().map(|(_, t)| t.message.clone()),
            trouble_tick: self.watchdog.trouble().map(|(tick, _)| tick),
            retries: self.watchdog.retries(),
            restores: self.watchdog.restores(),
            ..Numbers::default()
        }
    }

    /// A copy of the state's fields that are wanted, with the drawn cloud that goes with them. Waits for a device that lags. None where the
    /// device is lost.
    pub fn weather(&self, wanted: FieldSet, volume: Option<Arc<CloudVolume>>) -> Option<Copied> {
        let mut state: [Vec<f32>; 5] = Default::default();
        for (place, field) in Field::STATE.into_iter().enumerate() {
            if wanted.fields().any(|f| f == field) && self.plan.fields.contains(&field) {
                state[place] = self.device.read(field)?.into_owned();
            }
        }
        (volume.is_some() || self.scene.effects.moisture.is_none()).then(|| Copied {
            tick: self.tick,
            simulated_s: self.simulated_s,
            utc_unix_s: self.start_unix_s + self.simulated_s,
            scene: Arc::clone(&self.scene),
            parameters: Arc::clone(&self.parameters),
            volume,
            held: wanted,
            state,
        })
    }

    /// What views need, as it is now.
    pub fn snapshot(&self) -> Snapshot {
        let numbers = self.numbers();
        let volume = self
            .device
            .read(Field::Extinction)
            .zip(self.cloud)
            .map(|(extinction, cloud)| {
                // The displacement is kept small: the detail noise repeats far below a million metres, f32 resolves centimetres there.
                let displacement = self.air_displacement_m.map(|d| (d % 1.0e6) as f32);
                Arc::new(CloudVolume {
                    grid: self.parameters.grid,
                    extinction_per_m: extinction.to_vec(),
                    cloudy_levels: cloud.lit_levels,
                    air_displacement_m: [displacement[0], displacement[1], 0.0],
                })
            });
        Snapshot {
            sun_direction: sun::direction([numbers.sun_elevation_deg, numbers.sun_azimuth_deg]),
            numbers,
            volume,
            scene: Arc::clone(&self.scene),
            plan: Arc::clone(&self.report),
            timings: Arc::clone(&self.timings),
        }
    }

    /// What its passes have cost so far; it goes on counting.
    pub fn timings(&self) -> &Arc<Timings> {
        &self.timings
    }

    /// The plan with what each pass has cost so far. The view's stages are named with the effect that asks for them;
    /// what they cost, the renderer knows.
    pub fn plan_report(&self) -> PlanReport {
        let names = |fields: &[Field]| {
            fields
                .iter()
                .filter(|f| self.plan.fields.contains(f))
                .map(|f| f.name().to_owned())
                .collect()
        };
        let chosen = &self.plan.chosen;
        let ladders = chosen.choices.iter().map(|choice| {
            let info = choice.rung.info();
            LadderReport {
                ladder: info.ladder.name().to_owned(),
                rung: info.name.to_owned(),
                why: choice.why.clone(),
                what: info.what.to_owned(),
                keeps: info.keeps.to_owned(),
                rungs: info
                    .ladder
                    .rungs()
                    .filter(|r| r.is_there())
                    .map(|r| r.info().name.to_owned())
                    .collect(),
            }
        });
        let mut passes: Vec<PassReport> = self
            .plan
            .passes
            .iter()
            .map(|pass| {
                let info = pass.info();
                let mut why = info.needs.iter().map(|e| e.name()).collect::<Vec<_>>().join(" + ");
                for choice in chosen.choices.iter().filter(|c| info.rungs.contains(&c.rung)) {
                    let rung = choice.rung.info();
                    why += &format!(", {} {}", rung.ladder.name(), rung.name);
                }
                PassReport {
                    stage: info.name.to_owned(),
                    phase: info.phase.name().to_owned(),
                    why: format!("effect {why}: {}", info.what),
                    reads: names(info.reads),
                    writes: names(info.writes),
                    bytes_per_cell: Some(self.device.bytes_per_cell(*pass, &self.plan.fields)),
                    mean_ms: None,
                    runs: 0,
                }
            })
            .collect();
        passes.extend(
            VIEW_STAGES
                .iter()
                .filter(|s| s.needs.iter().all(|e| self.plan.effects.contains(e)))
                .filter(|s| s.rungs.is_empty() || chosen.choices.iter().any(|c| s.rungs.contains(&c.rung)))
                .map(|stage| PassReport {
                    stage: stage.name.to_owned(),
                    phase: "view".to_owned(),
                    why: {
                        let mut why = match stage.needs {
                            [] => "every picture".to_owned(),
                            needs => {
                                let names: Vec<_> = needs.iter().map(|e| e.name()).collect();
                                format!("effect {}", names.join(" + "))
                            }
                        };
                        for choice in chosen.choices.iter().filter(|c| stage.rungs.contains(&c.rung)) {
                            let rung = choice.rung.info();
                            why += &format!(", {} {}", rung.ladder.name(), rung.name);
                        }
                        format!("{why}: {}", stage.what)
                    },
                    reads: stage.reads.iter().map(|s| (*s).to_owned()).collect(),
                    writes: stage.writes.iter().map(|s| (*s).to_owned()).collect(),
                    bytes_per_cell: None,
                    mean_ms: None,
                    runs: 0,
                }),
        );
        let cell_bytes = 4 * self.parameters.grid.len() as u64;
        let mut fields: Vec<FieldReport> = self
            .plan
            .fields
            .iter()
            .map(|f| FieldReport {
                name: f.name().to_owned(),
                place: f.place().name().to_owned(),
                unit: f.unit().to_owned(),
                bytes: cell_bytes,
            })
            .collect();
        if self.device.solver_bytes() > 0 {
            fields.push(FieldReport {
                name: "pressure_solver_spectra_and_factors".to_owned(),
                place: "spectrum".to_owned(),
                unit: "1".to_owned(),
                bytes: self.device.solver_bytes() as u64,
            });
        }
        fields.push(FieldReport {
            name: "watchdog_states".to_owned(),
            place: "slot".to_owned(),
            unit: "1".to_owned(),
            bytes: self.device.saved_bytes() as u64,
        });
        let bytes = fields.iter().map(|f| f.bytes).sum();
        let mut report = PlanReport {
            device: self.device.name(),
            ladders: ladders.collect(),
            courant_max: chosen.courant_max,
            passes,
            fields,
            bytes,
        };
        self.timings.put(&mut report);
        report
    }
}
