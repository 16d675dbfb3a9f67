//! A world: one scene that runs. It owns its device and its clock; whoever owns it decides how fast ticks follow each other.

use std::sync::Arc;
use std::time::Instant;

use welkin_proto::scene::Sun;
use welkin_proto::wire::{FieldReport, LadderReport, Numbers, PassReport, PlanReport};
use welkin_proto::{ApiError, Scene};
use welkin_shaders::catalogue::{Field, Pass, Phase, VIEW_STAGES};
use welkin_shaders::constants::GRAVITY_M_S2;
use welkin_shaders::cpu::sim::Parameters;
use welkin_shaders::cpu::sim::parameters::DiffusionScheme;
use welkin_shaders::{CloudReductions, CloudVolume, Device, Reductions, Substep, Vitals};

use crate::base_state::{self, BaseState};
use crate::machine::Machine;
use crate::plan::Plan;
use crate::{initial, parameters, sun};

/// See [`World::unwatched_tick_s`].
const UNWATCHED_TICK_S: f64 = 20.0;
/// A substep is never longer than this share of a buoyancy oscillation's 1/N, which the explicit scheme must follow.
const BUOYANCY_PHASE_MAX: f64 = 1.0;

/// How often a pass ran and how long it took in all.
#[derive(Clone, Copy, Debug, Default)]
struct Timing {
    runs: u64,
    total_s: f64,
}

/// A running scene.
pub struct World {
    scene: Scene,
    base: BaseState,
    plan: Plan,
    parameters: Parameters,
    device: Box<dyn Device>,
    pool: Arc<rayon::ThreadPool>,
    passes: [Vec<Pass>; 3],
    timings: Vec<Timing>,
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
    /// What runs and what it costs.
    pub plan: Arc<PlanReport>,
}

impl World {
    /// Builds the world of a validated scene: base state, plan, fields, initial state.
    ///
    /// `machine` is what it computes on, or the number of the CPU's threads. Errors: those of [`Plan::new`], of the base state and of
    /// [`Compute::device`](crate::machine::Compute::device); `bad_time`; `internal` where no threads can be started.
    pub fn new(scene: Scene, machine: impl Into<Machine>) -> Result<Self, ApiError> {
        let machine = machine.into();
        let plan = Plan::new(&scene)?;
        let base = base_state::build(&scene)?;
        let start_unix_s = welkin_proto::time::parse_utc(&scene.time.start_utc)?;
        let parameters = parameters::parameters(&scene, &base, plan.chosen.methods.clone());
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
        let mut world = Self {
            timings: vec![Timing::default(); Pass::ALL.len()],
            scene,
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
        }
        world.publish();
        Ok(world)
    }

    fn has_flow(&self) -> bool {
        self.plan.fields.contains(&Field::VelocityX)
    }

    /// The scene it runs.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The air it started from.
    pub fn base_state(&self) -> &BaseState {
        &self.base
    }

    /// What it runs and holds.
    pub fn plan(&self) -> &Plan {
        &self.plan
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
        if self.device.write(field, values) {
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

    /// Whether all velocities and viscosities were finite after the last substep. The numbers alone can't tell: a maximum passes over
    /// NaN.
    pub fn is_finite(&self) -> bool {
        !self.has_flow() || self.reductions.finite
    }

    /// Length of a tick that nobody watches, in spin-up and in runs without viewers, s: the scene's, or 20 s if that is longer. A tick
    /// bounds its substeps, so short ones make a run slower than stability asks for.
    pub fn unwatched_tick_s(&self) -> f64 {
        self.scene.time.tick_s.max(UNWATCHED_TICK_S)
    }

    /// Advances by one tick: the scene's tick length, or an unwatched tick's during spin-up.
    pub fn tick(&mut self) {
        let length = if self.spinning_up() {
            self.unwatched_tick_s()
        } else {
            self.scene.time.tick_s
        };
        self.advance_by(length);
    }

    /// Ticks until `simulated_s`; the last tick may be shorter. `progress` is told the simulated seconds after each
    /// tick and stops the run by `false`.
    pub fn advance_to(&mut self, simulated_s: f64, mut progress: impl FnMut(&Self) -> bool) {
        while self.simulated_s < simulated_s - 1e-9 {
            self.advance_by(self.unwatched_tick_s().min(simulated_s - self.simulated_s));
            if !progress(self) {
                return;
            }
        }
    }

    /// Advances by `length_s` simulated seconds as one tick, in as many equal substeps as stability asks for. Once a field is no longer
    /// finite no substep is made: the clock goes on, and [`World::is_finite`] tells.
    pub fn advance_by(&mut self, length_s: f64) {
        let pool = Arc::clone(&self.pool);
        pool.install(|| self.advance_here(length_s));
    }

    fn advance_here(&mut self, length_s: f64) {
        let begin = Instant::now();
        let mut done = 0.0;
        self.substeps = 0;
        if self.has_flow() {
            // An infinite speed would ask for substeps of no length, and the loop would never end.
            while length_s - done > 1e-6 * length_s && self.reductions.finite {
                let left = length_s - done;
                let count = (left / self.substep_max_s()).ceil().max(1.0);
                self.substep_s = left / count;
                self.substep(self.substep_s as f32);
                self.substeps += 1;
                done += self.substep_s;
            }
        }
        self.simulated_s += length_s;
        self.tick += 1;
        self.publish();
        if let Some([u, v]) = self.cloud.and_then(|c| c.wind_m_s) {
            self.air_displacement_m[0] += u * length_s;
            self.air_displacement_m[1] += v * length_s;
        }
        self.tick_ms = begin.elapsed().as_secs_f64() * 1e3;
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
        let timing = &mut self.timings[pass as usize];
        timing.runs += 1;
        timing.total_s += begin.elapsed().as_secs_f64();
    }

    fn run_phase(&mut self, phase: usize, substep: &Substep) {
        for i in 0..self.passes[phase].len() {
            self.run(self.passes[phase][i], substep);
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
        self.reductions = self.device.reduce();
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

    fn publish(&mut self) {
        self.run_phase(
            2,
            &Substep {
                substep_s: 0.0,
                stage: 0,
                stages: 1,
            },
        );
        // A tick is judged before anything is built on it.
        self.device.settle();
        self.vitals = self.device.vitals();
        self.cloud = self.device.reduce_cloud();
    }

    /// Adds a uniform wind to the whole box; the base and geostrophic winds move with it, so that it stays.
    pub fn add_wind(&mut self, x_m_s: f64, y_m_s: f64) {
        for (field, add) in [(Field::VelocityX, x_m_s), (Field::VelocityY, y_m_s)] {
            if let Some(values) = self.device.read(field) {
                let moved: Vec<f32> = values.iter().map(|v| v + add as f32).collect();
                drop(values);
                self.device.write(field, &moved);
            }
        }
        let p = &mut self.parameters;
        let shift = |profile: &mut Vec<f32>, add: f64| profile.iter_mut().for_each(|v| *v += add as f32);
        shift(&mut p.base_wind_x_m_s, x_m_s);
        shift(&mut p.base_wind_y_m_s, y_m_s);
        if let Some(rotation) = &mut p.coriolis {
            shift(&mut rotation.wind_x_m_s, x_m_s);
            shift(&mut rotation.wind_y_m_s, y_m_s);
        }
        self.device.set_parameters(&self.parameters);
        if self.has_flow() {
            self.reductions = self.device.reduce();
        }
    }

    /// Places the sun, or gives it to the clock.
    pub fn set_sun(&mut self, sun: Sun) {
        self.scene.sun = sun;
    }

    /// The world's numbers. What its host knows better (speed, time scale, pause, milliseconds a frame) is left at its default.
    pub fn numbers(&self) -> Numbers {
        let unix_s = self.start_unix_s + self.simulated_s;
        let [sun_elevation_deg, sun_azimuth_deg] = sun::position_deg(&self.scene.sun, &self.scene.domain, unix_s);
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
            ..Numbers::default()
        }
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
            plan: Arc::new(self.plan_report()),
        }
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
                let timing = self.timings[*pass as usize];
                let timing = self
                    .device
                    .pass_time(*pass)
                    .map_or(timing, |(runs, total_s)| Timing { runs, total_s });
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
                    mean_ms: (timing.runs > 0).then(|| timing.total_s * 1e3 / timing.runs as f64),
                    runs: timing.runs,
                }
            })
            .collect();
        passes.extend(
            VIEW_STAGES
                .iter()
                .filter(|s| s.needs.iter().all(|e| self.plan.effects.contains(e)))
                .map(|stage| PassReport {
                    stage: stage.name.to_owned(),
                    phase: "view".to_owned(),
                    why: match stage.needs {
                        [] => format!("every picture: {}", stage.what),
                        needs => format!(
                            "effect {}: {}",
                            needs.iter().map(|e| e.name()).collect::<Vec<_>>().join(" + "),
                            stage.what
                        ),
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
        let bytes = fields.iter().map(|f| f.bytes).sum();
        PlanReport {
            device: self.device.name(),
            ladders: ladders.collect(),
            courant_max: chosen.courant_max,
            passes,
            fields,
            bytes,
        }
    }
}
