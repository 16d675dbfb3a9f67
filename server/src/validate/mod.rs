//! Validation: published cases run whole, each figure beside the published one, with the aim that it is held against.
//!
//! A case is one file here and one row of [`CASES`]. It returns figures, the data behind them and plots; printing and writing are
//! the command line's.

mod bomex;
mod bubbles;
mod compressible;
mod density_current;
pub(crate) mod slab;
mod wind_tunnel;

use std::borrow::Cow;
use std::time::Instant;

use serde::Serialize;
use welkin_proto::{ApiError, Scene};
use welkin_shaders::catalogue::Field;

use crate::machine::Machine;
use crate::plot::PlotError;
use crate::world::World;

/// Why a case has no result.
#[derive(Debug, thiserror::Error)]
pub enum ValidateError {
    /// The scene was refused.
    #[error(transparent)]
    Refused(#[from] ApiError),
    /// The watchdog had to undo a tick.
    #[error("{0}: the watchdog had to undo a tick and went back to {1} simulated s")]
    NotFinite(String, f64),
    /// Somebody wants it to end.
    #[error("interrupted")]
    Interrupted,
    /// A plot could not be drawn.
    #[error(transparent)]
    Plot(#[from] PlotError),
}

/// What a figure is held against.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Aim {
    /// No further from the published figure than this, in the figure's unit.
    Within {
        /// The distance.
        distance: f64,
    },
    /// No further from it than this share of it.
    WithinShare {
        /// The share.
        share: f64,
    },
    /// Inside a published range, or below a bound (then from 0).
    Between {
        /// Least.
        least: f64,
        /// Most.
        most: f64,
    },
}

/// One figure.
#[derive(Clone, Debug, Serialize)]
pub struct Figure {
    /// What it is, with its setting.
    pub what: String,
    /// Its unit.
    pub unit: &'static str,
    /// What we got.
    pub ours: f64,
    /// What is published.
    pub published: Option<f64>,
    /// Ours less the published one.
    pub difference: Option<f64>,
    /// What it is held against; absent, it is only reported.
    pub aim: Option<Aim>,
    /// Whether it meets the aim.
    pub met: Option<bool>,
}

impl Figure {
    /// A figure beside a published one, without an aim.
    pub fn beside(what: impl Into<String>, unit: &'static str, ours: f64, published: f64) -> Self {
        Self {
            published: Some(published),
            difference: Some(ours - published),
            ..Self::alone(what, unit, ours)
        }
    }

    /// A figure by itself.
    pub fn alone(what: impl Into<String>, unit: &'static str, ours: f64) -> Self {
        Self {
            what: what.into(),
            unit,
            ours,
            published: None,
            difference: None,
            aim: None,
            met: None,
        }
    }

    /// Holds it against an aim.
    pub fn aimed(mut self, aim: Aim) -> Self {
        let distance = self.difference.map_or(f64::INFINITY, f64::abs);
        let met = match aim {
            Aim::Within { distance: most } => distance <= most,
            Aim::WithinShare { share } => distance <= share * self.published.unwrap_or(0.0).abs(),
            Aim::Between { least, most } => (least..=most).contains(&self.ours),
        };
        self.aim = Some(aim);
        self.met = Some(met);
        self
    }
}

/// A plot of a case.
#[derive(Clone, Debug)]
pub struct Plot {
    /// Its file's name without the ending.
    pub name: String,
    /// The PNG.
    pub png: Vec<u8>,
}

/// What a case found.
#[derive(Clone, Debug, Serialize)]
pub struct Findings {
    /// Figures in order.
    pub figures: Vec<Figure>,
    /// What a reader must know to judge them.
    pub notes: Vec<String>,
    /// Series and profiles behind the figures.
    pub data: serde_json::Value,
    /// Plots.
    #[serde(skip)]
    pub plots: Vec<Plot>,
}

/// A case's result.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The case's name.
    pub case: &'static str,
    /// One line on it.
    pub what: &'static str,
    /// Where the published figures come from.
    pub source: &'static str,
    /// Whether it was run in its short form.
    pub quick: bool,
    /// What computed it.
    pub device: String,
    /// Wall seconds.
    pub wall_s: f64,
    /// What it found.
    #[serde(flatten)]
    pub findings: Findings,
}

impl Report {
    /// Figures that miss their aims.
    pub fn missed(&self) -> impl Iterator<Item = &Figure> {
        self.findings.figures.iter().filter(|f| f.met == Some(false))
    }
}

/// A published case.
pub struct Case {
    /// What it is asked for by.
    pub name: &'static str,
    /// One line on it.
    pub what: &'static str,
    /// Who published the figures.
    pub source: &'static str,
    run: fn(&Context) -> Result<Findings, ValidateError>,
}

/// Every case, the quickest first.
pub const CASES: &[Case] = &[
    Case {
        name: "dry-bubble",
        what: "a warm bubble rises through neutral air",
        source: "Bryan and Fritsch (2002), dry case; fully compressible reference at 100 m",
        run: bubbles::dry,
    },
    Case {
        name: "moist-bubble",
        what: "a warm bubble rises inside a cloud that fills the box",
        source: "Bryan and Fritsch (2002), saturated neutral case; fully compressible reference at 100 m",
        run: bubbles::moist,
    },
    Case {
        name: "density-current",
        what: "a cold bubble falls and runs along the ground",
        source: "Straka et al. (1993), compressible reference at 25 m",
        run: density_current::run,
    },
    Case {
        name: "wind-tunnel",
        what: "a fan drives a cloud through a tunnel, by the stable-fluids solver and by flux form",
        source: "seed 004, chapter 7; it prints no figures",
        run: wind_tunnel::run,
    },
    Case {
        name: "bomex",
        what: "six hours of shallow cumulus over the tropical Atlantic",
        source: "Siebesma et al. (2003), large-eddy intercomparison",
        run: bomex::run,
    },
    Case {
        name: "slab",
        what: "the path tracer on plane-parallel slabs",
        source: "discrete ordinates of 64 streams, Henyey-Greenstein, no absorption",
        run: slab::run,
    },
];

/// How a case is to be run.
pub struct Context<'a> {
    /// Coarser or shorter, to see that it works.
    pub quick: bool,
    /// What computes.
    pub machine: Machine,
    /// Told what is running, how far it is and how far it goes, both in simulated seconds; `false` ends the case.
    pub progress: &'a dyn Fn(&str, f64, f64) -> bool,
}

impl Context<'_> {
    /// Starts a world. Errors: the scene's.
    pub fn world(&self, scene: Scene) -> Result<World, ValidateError> {
        Ok(World::new(scene, self.machine.clone())?)
    }

    /// Runs a world to `until_s`, and shows it to `each` after every tick.
    ///
    /// Errors: `Interrupted`, `NotFinite`.
    pub fn advance(
        &self,
        world: &mut World,
        until_s: f64,
        what: &str,
        mut each: impl FnMut(&World),
    ) -> Result<(), ValidateError> {
        let mut going = true;
        world.advance_to(until_s, |world| {
            each(world);
            going = (self.progress)(what, world.simulated_s(), until_s);
            going && world.ran_through()
        });
        if !going {
            return Err(ValidateError::Interrupted);
        }
        if world.ran_through() {
            Ok(())
        } else {
            Err(ValidateError::NotFinite(what.to_owned(), world.simulated_s()))
        }
    }
}

impl Case {
    /// Runs it. Errors: [`ValidateError`].
    pub fn run(&self, context: &Context) -> Result<Report, ValidateError> {
        let began = Instant::now();
        let findings = (self.run)(context)?;
        Ok(Report {
            case: self.name,
            what: self.what,
            source: self.source,
            quick: context.quick,
            device: context.machine.compute.name(),
            wall_s: began.elapsed().as_secs_f64(),
            findings,
        })
    }
}

/// A field's values; empty if the plan doesn't hold it.
pub(crate) fn field(world: &World, field: Field) -> Vec<f32> {
    world.device().read(field).map(Cow::into_owned).unwrap_or_default()
}

/// Least and largest value.
pub(crate) fn extremes(values: &[f32]) -> [f64; 2] {
    values
        .iter()
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], &v| {
            [low.min(f64::from(v)), high.max(f64::from(v))]
        })
}

/// Largest difference between a field of one row in y and its mirror image in x, over the field's largest magnitude. `at_faces` for
/// what lies on west faces, which changes sign.
pub(crate) fn lopsided(values: &[f32], columns: usize) -> f64 {
    let most = values.iter().map(|v| v.abs()).fold(0.0, f32::max);
    let worst = values
        .chunks_exact(columns)
        .flat_map(|row| row.iter().zip(row.iter().rev()))
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max);
    f64::from(worst) / f64::from(most).max(1e-30)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn aims_are_judged() {
        let figure = || Figure::beside("front", "m", 15_400.0, 15_537.0);
        assert_eq!(figure().aimed(Aim::Within { distance: 250.0 }).met, Some(true));
        assert_eq!(figure().aimed(Aim::Within { distance: 100.0 }).met, Some(false));
        assert_eq!(figure().aimed(Aim::WithinShare { share: 0.01 }).met, Some(true));
        assert_eq!(figure().aimed(Aim::WithinShare { share: 0.005 }).met, Some(false));
        let cover = |ours| Figure::alone("cover", "%", ours).aimed(Aim::Between { least: 8.0, most: 17.0 });
        assert_eq!(cover(11.0).met, Some(true));
        assert_eq!(cover(18.0).met, Some(false));
        // What is not a number meets nothing.
        assert_eq!(cover(f64::NAN).met, Some(false));
        let nothing = Figure::beside("w", "m/s", f64::NAN, 1.0);
        assert_eq!(nothing.aimed(Aim::Within { distance: 9.0 }).met, Some(false));
    }

    #[test]
    fn a_mirror_image_is_told_from_what_is_not() {
        assert_eq!(lopsided(&[1.0, 2.0, 2.0, 1.0, -3.0, 0.0, 0.0, -3.0], 4), 0.0);
        assert_eq!(lopsided(&[1.0, 2.0, 2.0, 0.0], 4), 0.5);
    }
}
