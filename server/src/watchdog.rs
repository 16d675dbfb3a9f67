//! The watchdog: judges every tick before anybody sees it, and keeps good states to go back to.
//!
//! A tick is judged after each substep (all velocities finite, Courant number) and at its end (all fields finite, divergence,
//! water). On trouble the world restores the tick's start and tries again with substeps half as long, [`HALVINGS`] times.
//! If that fails, it goes back to the newest of [`KEPT`] good states that are [`KEEP_EVERY_S`] apart or more, is `degraded`, and goes on with
//! substeps half as long until it is past the place where it failed. If it fails again before that, the state before is next, and
//! after the last one it is `halted`.
//!
//! States are kept on the device, fields of the state only: one for the tick's start and [`KEPT`] good ones, 20 bytes a cell each, 60 in
//! all. The tick's start costs no copy: after a tick's first substep the device gives the memory of the substep's start away for the
//! slot's. A slot whose tick was good becomes a kept state by taking its place in the ring.

use std::sync::Arc;

use welkin_proto::wire::HealthState;
use welkin_shaders::catalogue::{Field, Rung};
use welkin_shaders::cpu::sim::Parameters;
use welkin_shaders::cpu::sim::parameters::{Methods, PressureMethod};
use welkin_shaders::{CloudReductions, Reductions, Vitals};

/// Times that a tick's substeps are halved before the tick is given up.
pub const HALVINGS: u32 = 4;
/// Good states that are kept beside the tick's start.
pub const KEPT: usize = 2;
/// Simulated seconds between kept states, no less.
pub const KEEP_EVERY_S: f64 = 60.0;
/// Simulated seconds past the last trouble after which a degraded world is good again.
pub const GOOD_AGAIN_S: f64 = 600.0;

/// A substep may end with a Courant number this many times the bound that its length was chosen by: the wind grows while it runs.
/// Three-stage Runge-Kutta with fifth-order fluxes is stable up to 1.42 (Wicker and Skamarock 2002), so half as much again as 1 is the
/// most that one substep may meet without harm.
const COURANT_MARGIN: f64 = 1.5;
/// Largest divergence after a direct solve, 1/s. Rounding leaves 5e-7 in cumulus; the wildest hard case stays below 1e-4.
const DIVERGENCE_MAX_PER_S: f64 = 1e-4;
/// Largest divergence after an iterative solve, as a share of the largest speed over cell size: such a solver only lowers it.
const DIVERGENCE_SHARE_ITERATIVE: f64 = 1.0;
/// Drift of the water path that rounding may cause in a substep of flux form, as a share of the path.
const WATER_DRIFT_FLUX_FORM: f64 = 1e-6;
/// The same of methods that do not keep sums.
const WATER_DRIFT_OTHERS: f64 = 1e-3;
/// How much two sums of the same water may differ where a device sums levels in 32 bits: up to a thousand additions of like numbers in a row.
const WATER_SUM_SINGLE: f64 = 3e-5;
/// Share of the sources' own change over a tick by which the mean of their rates at its two ends may miss what they gave.
const WATER_SOURCE_SLACK: f64 = 1.0;
/// Least total water, kg/kg. `hole_filler` leaves none below zero unless a whole column holds less than nothing; what a command or a fault wrote
/// may be, and counts as none down to here.
const WATER_MIN_KG_PER_KG: f64 = -1e-4;

/// What was wrong with a tick.
#[derive(Clone, Debug, PartialEq)]
pub struct Trouble {
    /// Stable code.
    pub code: &'static str,
    /// What, with the number and its bound.
    pub message: String,
}

impl Trouble {
    fn new(code: &'static str, message: String) -> Self {
        Self { code, message }
    }
}

/// What a tick is held to.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    courant_max: f64,
    divergence_share: f64,
    water_drift: f64,
    water_rounding: f64,
}

impl Bounds {
    /// The bounds of a world whose substeps are chosen by `courant_max`.
    /// `single_sums` says that the device sums a level in 32 bits.
    pub fn new(courant_max: f64, methods: &Methods, single_sums: bool) -> Self {
        Self {
            courant_max: COURANT_MARGIN * courant_max,
            divergence_share: match methods.pressure {
                PressureMethod::Direct => 0.0,
                _ => DIVERGENCE_SHARE_ITERATIVE,
            },
            water_drift: match methods.advection {
                Rung::FluxForm => WATER_DRIFT_FLUX_FORM,
                _ => WATER_DRIFT_OTHERS,
            },
            water_rounding: if single_sums { WATER_SUM_SINGLE } else { 0.0 },
        }
    }

    /// Judges a substep of `substep_s` by the reductions after it.
    pub fn substep(&self, reductions: &Reductions, substep_s: f64) -> Result<(), Trouble> {
        if !reductions.finite {
            return Err(Trouble::new(
                "not_finite",
                "a velocity or a viscosity is not finite".to_owned(),
            ));
        }
        let courant = reductions.courant_rate_per_s as f64 * substep_s;
        if courant > self.courant_max {
            let most = self.courant_max;
            return Err(Trouble::new(
                "courant_exceeded",
                format!("Courant number {courant:.3} after a substep, above {most:.3}"),
            ));
        }
        Ok(())
    }

    /// Judges a state by itself, as a tick leaves it.
    pub fn state(&self, reductions: &Reductions, vitals: &Vitals) -> Result<(), Trouble> {
        self.start(reductions, vitals)?;
        let divergence = vitals.divergence_max_per_s as f64;
        let most = DIVERGENCE_MAX_PER_S.max(self.divergence_share * reductions.courant_rate_per_s as f64);
        if divergence > most {
            return Err(Trouble::new(
                "divergence_exceeded",
                format!("divergence {divergence:.3e} 1/s after the projection, above {most:.3e}"),
            ));
        }
        Ok(())
    }

    /// Judges a state as a tick may find it: somebody may have written fields that are not free of divergence, which the first projection mends.
    pub fn start(&self, reductions: &Reductions, vitals: &Vitals) -> Result<(), Trouble> {
        if !vitals.finite || !reductions.finite {
            return Err(Trouble::new(
                "not_finite",
                "a field of the state is not finite".to_owned(),
            ));
        }
        let least = vitals.water_min_kg_per_kg as f64;
        if least < WATER_MIN_KG_PER_KG {
            return Err(Trouble::new(
                "negative_water",
                format!("total water {least:.3e} kg/kg, below {WATER_MIN_KG_PER_KG:.0e}"),
            ));
        }
        Ok(())
    }

    /// Judges a tick's change of the water path by the rates of its named sources at both ends.
    pub fn water(
        &self,
        before: &CloudReductions,
        after: &CloudReductions,
        length_s: f64,
        substeps: u32,
    ) -> Result<(), Trouble> {
        let [error, most] = self.water_error_kg_m2(before, after, length_s, substeps);
        // Written so that NaN is trouble.
        if error <= most {
            return Ok(());
        }
        Err(Trouble::new(
            "water_budget_broken",
            format!("{error:.3e} kg/m2 of water came or went without a source in one tick, above {most:.3e}"),
        ))
    }

    /// How much water no source accounts for, and how much of that is allowed, kg/m2.
    pub fn water_error_kg_m2(
        &self,
        before: &CloudReductions,
        after: &CloudReductions,
        length_s: f64,
        substeps: u32,
    ) -> [f64; 2] {
        let path = before.total_water_path_kg_m2;
        let rates = [before, after].map(|c| c.water_source_kg_m2_s);
        let given = 0.5 * (rates[0] + rates[1]) * length_s;
        let error = (after.total_water_path_kg_m2 - path - given).abs();
        let rounding = (self.water_rounding + self.water_drift * f64::from(substeps.max(1))) * path;
        [
            error,
            rounding + WATER_SOURCE_SLACK * (rates[1] - rates[0]).abs() * length_s,
        ]
    }
}

/// What belongs to a state beside its fields.
#[derive(Clone, Debug)]
pub struct Mark {
    /// Simulated seconds since the start.
    pub simulated_s: f64,
    /// Its reductions: the next substep's length comes from them.
    pub reductions: Reductions,
    /// Its cloud.
    pub cloud: Option<CloudReductions>,
    /// What it was judged by.
    pub vitals: Vitals,
    /// How the cloud's detail has moved, m.
    pub air_displacement_m: [f64; 2],
    /// The winds that the passes are told, which a command may have changed since.
    pub parameters: Arc<Parameters>,
}

/// A world's health and the states that it can go back to.
#[derive(Debug)]
pub struct Watchdog {
    /// What ticks are held to.
    pub bounds: Bounds,
    /// What belongs to the state in each slot.
    marks: Vec<Mark>,
    /// Slots: the one that takes the tick's start, then the kept ones, newest first.
    order: [usize; KEPT + 1],
    health: HealthState,
    /// Kept states tried since the last trouble that could not be retried.
    tried: usize,
    /// Simulated second of that trouble.
    failed_s: f64,
    trouble: Option<(u64, Trouble)>,
    retries: u64,
    restores: u64,
}

/// What to do after a tick has failed for good.
#[derive(Clone, Debug)]
pub struct Fallback {
    /// Slot to restore.
    pub slot: usize,
    /// What belongs to it.
    pub mark: Mark,
}

impl Watchdog {
    /// A watchdog over a world whose first state is saved in all of [`Watchdog::slots`].
    pub fn new(bounds: Bounds, first: &Mark) -> Self {
        Self {
            bounds,
            marks: vec![first.clone(); KEPT + 1],
            order: std::array::from_fn(|slot| slot),
            health: HealthState::Good,
            tried: 0,
            failed_s: f64::NEG_INFINITY,
            trouble: None,
            retries: 0,
            restores: 0,
        }
    }

    /// The slots of a device that it uses.
    pub fn slots() -> std::ops::Range<usize> {
        0..KEPT + 1
    }

    /// The slot for the tick's start.
    pub fn start_slot(&self) -> usize {
        self.order[0]
    }

    /// The world's health.
    pub fn health(&self) -> HealthState {
        self.health
    }

    /// The last trouble and its tick.
    pub fn trouble(&self) -> Option<(u64, &Trouble)> {
        self.trouble.as_ref().map(|(tick, trouble)| (*tick, trouble))
    }

    /// Tries that were thrown away.
    pub fn retries(&self) -> u64 {
        self.retries
    }

    /// Times that an earlier state was restored.
    pub fn restores(&self) -> u64 {
        self.restores
    }

    /// Factor on the length of substeps: shorter ones until the world is past the place where it failed.
    pub fn caution(&self) -> f64 {
        0.5f64.powi(self.tried as i32)
    }

    /// Notes a try that was thrown away.
    pub fn retry(&mut self, tick: u64, trouble: Trouble) {
        self.retries += 1;
        self.trouble = Some((tick, trouble));
    }

    /// Notes a good tick that began at `start`, which is in [`Watchdog::start_slot`] if `saved`, and has come to `simulated_s`.
    pub fn good(&mut self, start: &Mark, saved: bool, simulated_s: f64) {
        if self.tried > 0 && simulated_s > self.failed_s + KEEP_EVERY_S {
            self.tried = 0;
        }
        if self.health == HealthState::Degraded && simulated_s > self.failed_s + GOOD_AGAIN_S {
            self.health = HealthState::Good;
        }
        let newest = self.marks[self.order[1]].simulated_s;
        // While the world catches up with where it failed, the states that it may have to go back to stay.
        if saved && self.tried == 0 && start.simulated_s >= newest + KEEP_EVERY_S {
            self.marks[self.order[0]].clone_from(start);
            self.order.rotate_right(1);
        }
    }

    /// Notes a tick that failed for good at `simulated_s` and says which state to go back to. From then on the world is degraded, or, where
    /// every kept state has been tried, halted.
    pub fn fall_back(&mut self, tick: u64, simulated_s: f64, trouble: Trouble) -> Fallback {
        let left = self.tried < KEPT;
        let step = self.tried.min(KEPT - 1);
        let slot = self.order[1 + step];
        let mark = self.marks[slot].clone();
        self.health = if left {
            self.restores += 1;
            self.tried += 1;
            HealthState::Degraded
        } else {
            HealthState::Halted
        };
        self.failed_s = self.failed_s.max(simulated_s);
        let Trouble { code, message } = trouble;
        let done = if left {
            format!("went back to simulated second {:.0}", mark.simulated_s)
        } else {
            format!(
                "halted at simulated second {:.0}: it failed again from every kept state",
                mark.simulated_s
            )
        };
        self.trouble = Some((
            tick,
            Trouble {
                code,
                message: format!("{message}; {done}"),
            },
        ));
        Fallback { slot, mark }
    }

    /// Notes that the device was lost and its kept states with it, and that the world stands at `mark` again, which all slots hold.
    pub fn rebuilt(&mut self, tick: u64, simulated_s: f64, trouble: Trouble, mark: &Mark) {
        self.marks.fill(mark.clone());
        self.health = HealthState::Degraded;
        self.restores += 1;
        self.failed_s = self.failed_s.max(simulated_s);
        let message = format!(
            "{}; rebuilt at simulated second {:.0}",
            trouble.message, mark.simulated_s
        );
        self.trouble = Some((tick, Trouble { message, ..trouble }));
    }

    /// Notes that all slots hold the state at `mark`, and that ticks are held to other bounds from now on.
    pub fn changed(&mut self, bounds: Bounds, mark: &Mark) {
        self.bounds = bounds;
        self.marks.fill(mark.clone());
    }

    /// Notes that the world cannot go on whatever is restored.
    pub fn halt(&mut self, tick: u64, trouble: Trouble) {
        self.health = HealthState::Halted;
        self.trouble = Some((tick, trouble));
    }

    /// Lets a halted world try again, from its oldest kept state, with the shortest substeps.
    pub fn resume(&mut self) {
        if self.health == HealthState::Halted {
            self.health = HealthState::Degraded;
        }
    }
}

/// A fault that a test plants: from within the program only, nothing on the wire makes one.
#[derive(Clone, Copy, Debug)]
pub struct Fault {
    /// Tick in which it strikes; ticks count from 1.
    pub tick: u64,
    /// Substep of that tick whose result it strikes, from 0.
    pub substep: u32,
    /// Field that it strikes.
    pub field: Field,
    /// What it does.
    pub damage: Damage,
    /// How often it strikes; 1 is a passing fault that a retry gets over.
    pub strikes: u32,
}

/// What a [`Fault`] does to a field.
#[derive(Clone, Copy, Debug)]
pub enum Damage {
    /// One cell takes a value.
    Cell(usize, f32),
    /// Every cell is multiplied.
    Scale(f32),
}
