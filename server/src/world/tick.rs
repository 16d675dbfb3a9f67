//! The tick: substeps and their stages, judged by the watchdog; tried again, undone or ended where one fails.

use std::sync::Arc;
use std::time::Instant;

use welkin_shaders::catalogue::{Field, Pass, Phase};
use welkin_shaders::cpu::sim::parameters::DiffusionScheme;
use welkin_shaders::{Reductions, Substep};

use super::{BUOYANCY_PHASE_MAX, UNWATCHED_TICK_S, Unjudged, World};
use crate::watchdog::{Damage, Fault, HALVINGS, Mark, Trouble};

impl World {
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

    pub(super) fn tick_length_s(&self) -> f64 {
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

    pub(super) fn advance_here(&mut self, length_s: f64, ahead: bool) {
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
    pub(super) fn settle_here(&mut self, at_its_end: bool) -> bool {
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
    pub(super) fn finish_tick(&mut self, length_s: f64, mut tried: Result<(), Trouble>, start: Mark, mut saved: bool) {
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

    /// One try of a tick, whose first substep may have been `begun`: what its reductions were and how long it is. `saved` tells whether the start is in the
    /// watchdog's slot for it, so that it can be restored. Judges the end as well, unless that is left for later (`ahead`).
    pub(super) fn try_tick(
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
    pub(super) fn next_substep(&mut self, left_s: f64, factor: f64) {
        let count = (left_s / (factor * self.substep_max_s())).ceil().max(1.0);
        self.substep_s = left_s / count;
        self.substep(self.substep_s as f32);
        self.strike();
        self.reductions = self.device.reduce();
    }

    /// Judges a tick's end and moves the clock.
    pub(super) fn judge(&mut self, length_s: f64, start: &Mark) -> Result<(), Trouble> {
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
    pub(super) fn strike(&mut self) {
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
    pub(super) fn mark(&self) -> Mark {
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
    pub(super) fn recall(&mut self, mark: &Mark) {
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

    /// The longest substep that is stable for the present state, s.
    pub(super) fn substep_max_s(&self) -> f64 {
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

    pub(super) fn run(&mut self, pass: Pass, substep: &Substep) {
        let begin = Instant::now();
        self.device.run(pass, substep);
        self.timings.add(pass, begin.elapsed());
    }

    pub(super) fn run_phase(&mut self, phase: usize, substep: &Substep) {
        let last = substep.stage + 1 == substep.stages;
        for i in 0..self.passes[phase].len() {
            let pass = self.passes[phase][i];
            if last || !pass.ends_substep() {
                self.run(pass, substep);
            }
        }
    }

    pub(super) fn substep(&mut self, substep_s: f32) {
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
    pub(super) fn make_divergence_free(&mut self) {
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

    pub(super) fn run_publish_passes(&mut self) {
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

    pub(super) fn take_verdict(&mut self) {
        self.vitals = self.device.vitals();
        self.cloud = self.device.reduce_cloud();
        for &pass in &self.plan.passes {
            if let Some((runs, total_s)) = self.device.pass_time(pass) {
                self.timings.set(pass, runs, total_s);
            }
        }
    }
}
