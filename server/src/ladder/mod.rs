//! Ladders measured: what each rung costs beside how far it is from the truth.
//!
//! The rungs are the catalogue's: a rung that is written shows up here by itself. Each is put into the same scenes in place of the balanced
//! choice, the other ladders staying as they are, and is judged against an exact solution or a refined run of our own.

mod cases;
mod draw;
pub mod experiments;
pub mod light;
pub mod view;

use std::path::Path;
use std::time::Instant;

use serde::Serialize;
use serde_json::{Value, json};
use welkin_proto::{ApiError, Scene, presets};
use welkin_shaders::catalogue::{Ladder, Pass, Rung};

use crate::machine::Machine;
use crate::plot::PlotError;
use crate::world::World;

pub use draw::png;

/// Settings that a rung of the pressure ladder is measured with, beside its name: most rungs take a number of sweeps.
const PRESSURE_SETTINGS: &[(Rung, &[(&str, f64)])] = &[
    (Rung::Jacobi, &[("sweeps", 10.0)]),
    (Rung::Jacobi, &[("sweeps", 40.0)]),
    (Rung::Jacobi, &[("sweeps", 160.0)]),
    (Rung::RedBlackSor, &[("sweeps", 5.0), ("relaxation", 1.7)]),
    (Rung::RedBlackSor, &[("sweeps", 20.0), ("relaxation", 1.7)]),
    (Rung::RedBlackSor, &[("sweeps", 80.0), ("relaxation", 1.7)]),
    (Rung::Multigrid, &[("cycles", 1.0)]),
    (Rung::Multigrid, &[("cycles", 2.0)]),
    (Rung::Multigrid, &[("cycles", 4.0)]),
    (Rung::Direct, &[]),
];
/// The same for the subgrid ladder: what is changed in the effect's block.
const SUBGRID_SETTINGS: &[(Rung, &[(&str, f64)])] = &[
    (
        Rung::ConstantViscosity,
        &[("viscosity_m2_s", 3.0), ("diffusivity_m2_s", 9.0)],
    ),
    (
        Rung::ConstantViscosity,
        &[("viscosity_m2_s", 12.0), ("diffusivity_m2_s", 36.0)],
    ),
];
/// A method that bears long substeps is measured with one of this Courant number too.
const LONG_COURANT: f64 = 4.0;
/// The Courant number that every method is measured with.
const COURANT: f64 = 1.0;

/// Why a ladder could not be measured.
#[derive(Debug, thiserror::Error)]
pub enum LadderError {
    /// A scene was refused that should not be.
    #[error(transparent)]
    Refused(#[from] ApiError),
    /// A method could not be put into a scene.
    #[error("cannot set a method: {0}")]
    Method(#[from] serde_json::Error),
    /// The truth itself is not finite.
    #[error("the reference run of {0} is not finite")]
    Reference(&'static str),
    /// What is kept for another time cannot be written.
    #[error("cannot write {0}: {1}")]
    Kept(String, std::io::Error),
    /// Somebody wants it to end.
    #[error("interrupted")]
    Interrupted,
    /// A plot could not be drawn.
    #[error(transparent)]
    Plot(#[from] PlotError),
}

/// Writes a file whole or not at all.
pub(crate) fn keep(path: &Path, bytes: &[u8]) -> Result<(), LadderError> {
    let part = path.with_extension("part");
    std::fs::write(&part, bytes)
        .and_then(|()| std::fs::rename(&part, path))
        .map_err(|error| LadderError::Kept(path.display().to_string(), error))
}

/// How the ladders are to be measured.
pub struct Context<'a> {
    /// Smaller and shorter.
    pub quick: bool,
    /// What computes.
    pub machine: Machine,
    /// Told what is running and how far it is, from 0 to 1; `false` ends it.
    pub progress: &'a dyn Fn(&str, f64) -> bool,
}

/// A rung with its settings.
#[derive(Clone, Debug)]
pub struct Contender {
    /// Its ladder.
    pub ladder: Ladder,
    /// The rung.
    pub rung: Rung,
    /// Its name with its settings.
    pub label: String,
    settings: Vec<(&'static str, f64)>,
    courant: Option<f64>,
}

/// One rung in one case.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The ladder.
    pub ladder: &'static str,
    /// The rung with its settings.
    pub rung: String,
    /// Distance from the truth, as the case defines it; absent where the run failed.
    pub error: Option<f64>,
    /// Wall milliseconds a tick: its mean number of substeps times the lower quartile of what a substep took, so that what else the
    /// machine did counts little.
    pub ms_per_tick: Option<f64>,
    /// Cells advanced by one substep, a wall second; of the same quartile.
    pub cell_steps_per_s: Option<f64>,
    /// Substeps of the run.
    pub substeps: u64,
    /// Largest divergence of the mass flux over the density at the end, 1/s.
    pub divergence_max_per_s: Option<f64>,
    /// More figures of the case.
    pub figures: Value,
    /// Whether no other rung of the ladder is both cheaper and nearer to the truth.
    pub pareto: bool,
    /// Why there is no figure.
    pub failed: Option<String>,
}

/// A case with all its rows.
#[derive(Clone, Debug, Serialize)]
pub struct CaseReport {
    /// Its name.
    pub case: &'static str,
    /// What is run, and what the truth is.
    pub what: String,
    /// What the error is, with its unit.
    pub error: &'static str,
    /// Simulated seconds of a tick.
    pub tick_s: f64,
    /// Cells east, north, up.
    pub cells: [u32; 3],
    /// Error that the balanced choice has only because its random numbers are others, where the case is chaotic: differences below it
    /// mean nothing.
    pub chance: Option<f64>,
    /// One a contender.
    pub rows: Vec<Row>,
}

/// Everything.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The program's version.
    pub version: &'static str,
    /// What computed.
    pub device: String,
    /// Whether it was the small, short form.
    pub quick: bool,
    /// The cases.
    pub cases: Vec<CaseReport>,
}

/// Error and more figures from what was kept of a run.
type Judge = Box<dyn Fn(&[Vec<f64>]) -> (f64, Value)>;

/// What a case needs to be run by everybody.
pub(crate) struct Case {
    name: &'static str,
    what: String,
    error: &'static str,
    ladders: &'static [Ladder],
    scene: Scene,
    tick_s: f64,
    end_s: f64,
    /// Changes a fresh world's fields, where the scene alone does not say how it starts.
    start: fn(&mut World) -> Result<(), ApiError>,
    /// What is kept of the world after each tick.
    watch: fn(&World, &mut Vec<Vec<f64>>),
    /// Error and more figures from what was kept; the truth is inside.
    judge: Judge,
    chance: Option<f64>,
}

/// A run's result.
pub(crate) struct Run {
    pub(crate) kept: Vec<Vec<f64>>,
    ticks: u64,
    substeps: u64,
    /// Lower quartile over the ticks, s.
    substep_wall_s: f64,
    divergence_max_per_s: f64,
}

/// Every rung of a ladder that is written, with its settings. Without a row of settings a pressure rung has its name alone.
pub fn contenders(ladder: Ladder) -> Vec<Contender> {
    let mut all = Vec::new();
    for rung in ladder.rungs().filter(|rung| rung.is_there()) {
        let info = rung.info();
        let plain = Contender {
            ladder,
            rung,
            label: info.name.to_owned(),
            settings: Vec::new(),
            courant: None,
        };
        match ladder {
            Ladder::Advection => {
                all.push(Contender {
                    courant: Some(COURANT),
                    ..plain.clone()
                });
                if info.advance.is_some_and(|a| a.courant_max >= LONG_COURANT) {
                    all.push(Contender {
                        label: format!("{}, Courant {LONG_COURANT}", info.name),
                        courant: Some(LONG_COURANT),
                        ..plain
                    });
                }
            }
            Ladder::Pressure => with_settings(PRESSURE_SETTINGS, &plain, &mut all),
            // Of light nothing is asked here: `light` has its own cases.
            _ => with_settings(SUBGRID_SETTINGS, &plain, &mut all),
        }
    }
    all
}

/// One contender for each row of settings that the rung has, or the plain one.
fn with_settings(rows: &[(Rung, &[(&'static str, f64)])], plain: &Contender, all: &mut Vec<Contender>) {
    let mut rows = rows.iter().filter(|(rung, _)| *rung == plain.rung).peekable();
    if rows.peek().is_none() {
        all.push(plain.clone());
    }
    for (_, settings) in rows {
        let label = match settings {
            [] => plain.label.clone(),
            [(_, first), ..] => format!("{} {first}", plain.label),
        };
        all.push(Contender {
            label,
            settings: settings.to_vec(),
            ..plain.clone()
        });
    }
}

/// The effect that asks for a rung: the first need of its passes.
fn effect_of(rung: Rung) -> Option<&'static str> {
    let pass = Pass::ALL.iter().find(|p| p.info().rungs.contains(&rung))?;
    pass.info().needs.first().map(|effect| effect.name())
}

/// The block of an effect as some preset has it.
fn block_of(effect: &str) -> Option<Value> {
    presets::all().iter().find_map(|preset| {
        let scene: Value = serde_json::from_str(preset.json).ok()?;
        scene
            .get("effects")?
            .get(effect)
            .filter(|block| !block.is_null())
            .cloned()
    })
}

impl Contender {
    /// Puts the rung into a scene. Errors: `Method` where the scene's format does not know it.
    fn apply(&self, scene: &Scene) -> Result<Scene, LadderError> {
        let mut document = serde_json::to_value(scene)?;
        let name = self.rung.info().name;
        match self.ladder {
            Ladder::Advection => {
                document["methods"]["advection"] = json!(name);
                if let Some(courant) = self.courant {
                    document["effects"]["flow"]["courant_max"] = json!(courant);
                }
            }
            Ladder::Pressure => {
                let mut method = json!({ "solver": name });
                for (setting, value) in &self.settings {
                    method[*setting] = if value.fract() == 0.0 {
                        json!(*value as u64)
                    } else {
                        json!(value)
                    };
                }
                document["methods"]["pressure"] = method;
            }
            Ladder::Sky => document["methods"]["sky"] = json!(name),
            _ => {
                let own = effect_of(self.rung);
                for rung in self.ladder.rungs() {
                    if let Some(effect) = effect_of(rung)
                        && Some(effect) != own
                        && let Some(effects) = document["effects"].as_object_mut()
                    {
                        effects.remove(effect);
                    }
                }
                if let Some(effect) = own {
                    if document["effects"][effect].is_null() {
                        document["effects"][effect] = block_of(effect).unwrap_or(Value::Null);
                    }
                    for (setting, value) in &self.settings {
                        document["effects"][effect][*setting] = json!(value);
                    }
                }
            }
        }
        Ok(serde_json::from_value(document)?)
    }
}

/// Runs a scene in ticks of a case. `Ok(Err(why))` where the scene is refused or the fields blow up.
pub(crate) fn run(
    context: &Context,
    case: &Case,
    scene: Scene,
    shown: &str,
) -> Result<Result<Run, String>, LadderError> {
    let mut world = match World::new(scene, context.machine.clone()) {
        Ok(world) => world,
        Err(error) => return Ok(Err(error.to_string())),
    };
    (case.start)(&mut world)?;
    let (mut kept, mut ticks, mut substeps, mut walls_s) = (Vec::new(), 0, 0, Vec::new());
    while world.simulated_s() < case.end_s - 1e-6 {
        let began = Instant::now();
        world.advance_by(case.tick_s.min(case.end_s - world.simulated_s()));
        let wall_s = began.elapsed().as_secs_f64();
        let steps = world.numbers().substeps;
        walls_s.push(wall_s / f64::from(steps.max(1)));
        ticks += 1;
        substeps += u64::from(steps);
        if !world.ran_through() {
            let trouble = world.watchdog().trouble().map(|(_, trouble)| trouble.message.clone());
            return Ok(Err(trouble.unwrap_or_default()));
        }
        (case.watch)(&world, &mut kept);
        if !(context.progress)(shown, world.simulated_s() / case.end_s) {
            return Err(LadderError::Interrupted);
        }
    }
    walls_s.sort_by(f64::total_cmp);
    Ok(Ok(Run {
        kept,
        ticks,
        substeps,
        substep_wall_s: walls_s.get(walls_s.len() / 4).copied().unwrap_or(f64::NAN),
        divergence_max_per_s: world.numbers().divergence_max_per_s,
    }))
}

/// Measures the ladders of the dynamics. Errors: [`LadderError`]; a rung that fails is a row that says so, not an error.
pub fn dynamics(context: &Context) -> Result<Report, LadderError> {
    let mut reports = Vec::new();
    for make in cases::ALL {
        let case = make(context)?;
        let mut rows = Vec::new();
        for ladder in case.ladders {
            for contender in contenders(*ladder) {
                rows.push(measure(context, &case, &contender)?);
            }
        }
        mark_pareto(&mut rows);
        reports.push(CaseReport {
            case: case.name,
            what: case.what,
            error: case.error,
            tick_s: case.tick_s,
            cells: case.scene.domain.cells,
            chance: case.chance,
            rows,
        });
    }
    Ok(Report {
        version: env!("CARGO_PKG_VERSION"),
        device: context.machine.compute.name(),
        quick: context.quick,
        cases: reports,
    })
}

fn measure(context: &Context, case: &Case, contender: &Contender) -> Result<Row, LadderError> {
    let shown = format!("{}: {}", case.name, contender.label);
    let cells: f64 = case.scene.domain.cells.iter().map(|n| f64::from(*n)).product();
    let scene = contender.apply(&case.scene)?;
    let row = Row {
        ladder: contender.ladder.name(),
        rung: contender.label.clone(),
        error: None,
        ms_per_tick: None,
        cell_steps_per_s: None,
        substeps: 0,
        divergence_max_per_s: None,
        figures: Value::Null,
        pareto: false,
        failed: None,
    };
    Ok(match run(context, case, scene, &shown)? {
        Err(why) => Row {
            failed: Some(why),
            ..row
        },
        Ok(run) => {
            let (error, figures) = (case.judge)(&run.kept);
            Row {
                error: error.is_finite().then_some(error),
                ms_per_tick: Some(1e3 * run.substep_wall_s * run.substeps as f64 / run.ticks as f64),
                cell_steps_per_s: Some(cells / run.substep_wall_s),
                substeps: run.substeps,
                divergence_max_per_s: Some(run.divergence_max_per_s),
                figures,
                ..row
            }
        }
    })
}

/// Marks each row that no other row of its ladder beats in both cost and error.
fn mark_pareto(rows: &mut [Row]) {
    let ladders: Vec<&str> = rows.iter().map(|r| r.ladder).collect();
    for ladder in &ladders {
        let own = |r: &Row| r.ms_per_tick.zip(r.error).filter(|_| r.ladder == *ladder);
        let points: Vec<Option<(f64, f64)>> = rows.iter().map(own).collect();
        for (row, on) in rows.iter_mut().zip(on_front(&points)) {
            row.pareto |= on;
        }
    }
}

/// Which points, cost and error, no other point beats in both.
fn on_front(points: &[Option<(f64, f64)>]) -> Vec<bool> {
    let beaten = |(cost, error): (f64, f64)| {
        let mut others = points.iter().flatten();
        others.any(|&(c, e)| c <= cost && e <= error && (c < cost || e < error))
    };
    points.iter().map(|point| point.is_some_and(|p| !beaten(p))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(ladder: &'static str, ms: f64, error: f64) -> Row {
        Row {
            ladder,
            rung: String::new(),
            error: Some(error),
            ms_per_tick: Some(ms),
            cell_steps_per_s: None,
            substeps: 1,
            divergence_max_per_s: None,
            figures: Value::Null,
            pareto: false,
            failed: None,
        }
    }

    #[test]
    fn the_pareto_front_is_each_ladders_own() {
        let mut rows = [
            row("a", 1.0, 0.5),
            row("a", 2.0, 0.1),
            row("a", 3.0, 0.3),
            row("b", 9.0, 0.9),
        ];
        mark_pareto(&mut rows);
        assert_eq!(rows.map(|r| r.pareto), [true, true, false, true]);
    }

    #[test]
    fn every_written_rung_can_be_put_into_a_scene_that_the_plan_takes() {
        let scene = presets::find("fair-weather-cumulus").unwrap();
        for ladder in [Ladder::Advection, Ladder::Pressure, Ladder::Subgrid] {
            let all = contenders(ladder);
            for rung in ladder.rungs().filter(|r| r.is_there()) {
                assert!(all.iter().any(|c| c.rung == rung), "{} is left out", rung.info().name);
            }
            for contender in all {
                let scene = contender.apply(&scene).unwrap();
                let plan = crate::plan::Plan::new(&scene).unwrap_or_else(|e| panic!("{}: {e}", contender.label));
                assert!(
                    plan.chosen.choices.iter().any(|c| c.rung == contender.rung),
                    "{} was not chosen",
                    contender.label
                );
            }
        }
    }
}
