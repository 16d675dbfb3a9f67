//! The seeds' experiments on what a picture costs, with our curves and whether their conclusions hold here.
//!
//! Seed 001 compares four ways to learn how much cloud lies towards the sun: a secondary march and an exponential, a Beer and a Fourier map, by the maps' size, the number of samples,
//! the size of the picture and how much of it is cloud. Seed 004 skips empty space, so that the domain's size should matter little. Seed 000 plots frames a second against the segments of a ray. Ours run on the CPU, theirs on GPUs of 2022 and 2009:
//! what is compared is who is cheaper where and how costs grow, not milliseconds. A number of a seed's (a growth, a cover) holds where ours is within a factor of 1.5 of it.

use serde::Serialize;
use welkin_shaders::cpu::view::{MapKind, Prepared, SunOcclusion, ViewSettings, radiance, render};
use welkin_shaders::view::ViewSteps;
use welkin_shaders::{CloudVolume, Grid};

use super::LadderError;
use super::light::{self, map, occluded, occlusion_name, times};
use crate::clouds::{self, broken_layer, cumulus_field, settings};
use crate::plot::{self, Chart, Panel, PlotError, Series};

/// How the experiments are to be run.
pub struct Conditions<'a> {
    /// Smaller pictures, fewer points.
    pub quick: bool,
    /// Told what is running and how far it is, from 0 to 1; `false` ends it.
    pub progress: &'a dyn Fn(&str, f64) -> bool,
}

/// One measurement.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Point {
    /// Where on the experiment's axis.
    pub at: f64,
    /// Wall milliseconds of the march, the middle one of three.
    pub march_ms: f64,
    /// Wall milliseconds of all that a tick makes anew, stage by stage the middle one of three.
    pub tick_ms: f64,
    /// What of it is the method's own: its map.
    pub map_ms: f64,
    /// Relative difference of radiance in the mean square from the exact one, where the experiment has one.
    pub error: Option<f64>,
}

impl Point {
    /// Both times together.
    pub fn ms(&self) -> f64 {
        self.march_ms + self.tick_ms
    }
}

/// A method's measurements.
#[derive(Clone, Debug, Serialize)]
pub struct Curve {
    /// The method.
    pub method: String,
    /// In the order of the axis.
    pub points: Vec<Point>,
}

/// One experiment.
#[derive(Clone, Debug, Serialize)]
pub struct Experiment {
    /// Its name.
    pub name: &'static str,
    /// What is varied, with its unit.
    pub axis: &'static str,
    /// Pixels across and down, where they are not what is varied.
    pub size: Option<[usize; 2]>,
    /// One a method.
    pub curves: Vec<Curve>,
    /// What the seed concludes, and what of it holds here.
    pub findings: Vec<Finding>,
}

/// A seed's conclusion, held against our curves.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    /// The seed.
    pub seed: &'static str,
    /// What it says.
    pub says: &'static str,
    /// Whether our figures say the same, each of the numbers within a factor of 1.5.
    pub holds: bool,
    /// Our figures.
    pub here: String,
    /// The seed's numbers beside ours, where it has any.
    pub numbers: Vec<Number>,
}

/// A number of a seed's beside ours.
#[derive(Clone, Debug, Serialize)]
pub struct Number {
    /// What it counts, with its unit.
    pub what: String,
    /// From and to what the seed has it.
    pub seed: [f64; 2],
    /// Ours; none where our curves have no such place.
    pub here: Option<f64>,
}

/// By what factor a number may miss a seed's and still say the same.
const SAME: f64 = 1.5;

impl Number {
    fn new(what: impl Into<String>, seed: [f64; 2], here: Option<f64>) -> Number {
        let what = what.into();
        Number { what, seed, here }
    }
    /// Whether ours is within [`SAME`] of the seed's.
    fn is_near(&self) -> bool {
        let [from, to] = self.seed;
        self.here.is_some_and(|here| (from / SAME..=to * SAME).contains(&here))
    }
}

impl Finding {
    /// A conclusion that holds where our curves have its `shape` and its numbers are near.
    fn new(seed: &'static str, says: &'static str, shape: bool, here: String, numbers: Vec<Number>) -> Finding {
        Finding {
            seed,
            says,
            holds: shape && numbers.iter().all(Number::is_near),
            here,
            numbers,
        }
    }
}

/// All of them.
#[derive(Clone, Debug, Serialize)]
pub struct Experiments {
    /// The program's version.
    pub version: &'static str,
    /// What computed.
    pub device: &'static str,
    /// Threads that drew.
    pub threads: usize,
    /// Whether it was the small form.
    pub quick: bool,
    /// Each with its curves.
    pub experiments: Vec<Experiment>,
}

/// Seed 001's four ways at its usual settings, and the one that is usual here; smaller maps in the small form.
fn ways(quick: bool) -> [SunOcclusion; 5] {
    let side = if quick { 64 } else { 512 };
    [
        SunOcclusion::SecondaryMarch { steps: 10 },
        map(MapKind::Exponential, side),
        map(MapKind::Beer, side),
        map(MapKind::Fourier, side),
        SunOcclusion::LightGrid,
    ]
}

struct Run<'a> {
    conditions: &'a Conditions<'a>,
    prepared: Prepared,
    done: usize,
    all: usize,
}

impl Run<'_> {
    fn point(&mut self, volume: &CloudVolume, settings: &ViewSettings, at: f64) -> Result<Point, LadderError> {
        let share = self.done as f64 / self.all as f64;
        if !(self.conditions.progress)("the seeds' experiments", share.min(1.0)) {
            return Err(LadderError::Interrupted);
        }
        self.done += 1;
        let times = times(volume, settings, &mut self.prepared);
        let map = times.stages_ms.iter().find(|(stage, _)| *stage == "sun_map");
        Ok(Point {
            at,
            march_ms: times.march_ms[1],
            tick_ms: times.stages_ms.iter().map(|(_, ms)| ms[1]).sum(),
            map_ms: map.map_or(0.0, |(_, ms)| ms[1]),
            error: None,
        })
    }

    /// Radiance by what the ladder's rungs are held against.
    fn exact(&mut self, volume: &CloudVolume, ladder: &str, base: &ViewSettings) -> Vec<[f32; 3]> {
        let view = light::exact(ladder, base).unwrap_or(*base);
        radiance(Some(volume), &view, &mut self.prepared)
    }

    fn apart(&mut self, volume: &CloudVolume, ours: &ViewSettings, exact: &[[f32; 3]]) -> f64 {
        let ours = radiance(Some(volume), ours, &mut self.prepared);
        let square = |v: f32| f64::from(v).powi(2);
        let apart: f64 = ours
            .iter()
            .flatten()
            .zip(exact.iter().flatten())
            .map(|(a, b)| square(a - b))
            .sum();
        (apart / exact.iter().flatten().map(|v| square(*v)).sum::<f64>()).sqrt()
    }
}

/// Gives what a tick makes anew of the same clouds, but for the methods' own maps, one number, the least that any point has: it is far more than the methods differ by, and the
/// chance of a clock in it would hide that.
fn share<'a>(points: impl IntoIterator<Item = &'a mut Point>) {
    let points: Vec<&mut Point> = points.into_iter().collect();
    let least = points
        .iter()
        .map(|p| p.tick_ms - p.map_ms)
        .fold(f64::INFINITY, f64::min);
    for point in points {
        point.tick_ms = least + point.map_ms;
    }
}

/// Runs them. Errors: `Interrupted`.
pub fn experiments(conditions: &Conditions) -> Result<Experiments, LadderError> {
    let mut run = Run {
        conditions,
        prepared: Prepared::new(),
        done: 0,
        all: if conditions.quick { 42 } else { 112 },
    };
    Ok(Experiments {
        version: env!("CARGO_PKG_VERSION"),
        device: "cpu",
        threads: rayon::current_num_threads(),
        quick: conditions.quick,
        experiments: vec![
            map_sizes(&mut run)?,
            samples(&mut run)?,
            picture_sizes(&mut run)?,
            domain_sizes(&mut run)?,
            coverage(&mut run)?,
            segments(&mut run)?,
        ],
    })
}

fn usual_size(run: &Run) -> [usize; 2] {
    if run.conditions.quick { [64, 36] } else { [640, 360] }
}

fn looking_up([width, height]: [usize; 2]) -> ViewSettings {
    ViewSettings {
        elevation_deg: 35.0,
        ..settings(width, height)
    }
}

fn map_sizes(run: &mut Run) -> Result<Experiment, LadderError> {
    let volume = cumulus_field(7, 12);
    let size = usual_size(run);
    let sides: &[u32] = if run.conditions.quick {
        &[32, 64]
    } else {
        &[128, 256, 512, 1024]
    };
    let mut curves = Vec::new();
    for kind in [MapKind::Exponential, MapKind::Beer, MapKind::Fourier] {
        let mut points = Vec::new();
        for side in sides {
            let view = occluded(&looking_up(size), map(kind, *side));
            points.push(run.point(&volume, &view, f64::from(*side))?);
        }
        let method = occlusion_name(map(kind, 0));
        curves.push(Curve {
            method: method.trim_end_matches(" 0").to_owned(),
            points,
        });
    }
    share(curves.iter_mut().flat_map(|c: &mut Curve| &mut c.points));
    let last = |n: usize| curves[n].points[sides.len() - 1];
    let of = |n: usize| &curves[n].points;
    let growth: Vec<f64> = (0..3)
        .map(|n| of(n)[sides.len() - 1].map_ms / of(n)[sides.len() - 2].map_ms)
        .collect();
    let order = last(0).map_ms <= last(1).map_ms * 1.05 && last(1).map_ms <= last(2).map_ms * 1.05;
    let findings = vec![
        Finding::new(
            "001",
            "the Fourier map costs most to make, the exponential one least",
            order,
            format!(
                "{:.1}, {:.1} and {:.1} ms for an exponential, a Beer and a Fourier map of {} squared",
                last(0).map_ms,
                last(1).map_ms,
                last(2).map_ms,
                sides[sides.len() - 1],
            ),
            Vec::new(),
        ),
        Finding::new(
            "001",
            "twice the side makes a map cost less than four times as much",
            growth.iter().all(|g| *g < 4.0),
            "the making of the map alone, at the last doubling".to_owned(),
            curves
                .iter()
                .zip(&growth)
                .map(|(curve, growth)| Number::new(format!("times, {}", curve.method), [2.0, 2.5], Some(*growth)))
                .collect(),
        ),
    ];
    Ok(Experiment {
        name: "map size",
        axis: "side of the map, rays",
        size: Some(size),
        curves,
        findings,
    })
}

fn samples(run: &mut Run) -> Result<Experiment, LadderError> {
    let volume = cumulus_field(7, 12);
    let size = usual_size(run);
    let base = looking_up(size);
    let exact = run.exact(&volume, "sun_occlusion", &base);
    let counts: &[u32] = if run.conditions.quick {
        &[1, 10]
    } else {
        &[1, 2, 5, 10, 20, 35, 50]
    };
    let mut points = Vec::new();
    for steps in counts {
        let view = occluded(&base, SunOcclusion::SecondaryMarch { steps: *steps });
        let mut point = run.point(&volume, &view, f64::from(*steps))?;
        point.error = Some(run.apart(&volume, &view, &exact));
        points.push(point);
    }
    let mut curves = vec![Curve {
        method: "secondary_march".to_owned(),
        points,
    }];
    for way in ways(run.conditions.quick).into_iter().skip(1) {
        let view = occluded(&base, way);
        let mut point = run.point(&volume, &view, f64::from(counts[0]))?;
        point.error = Some(run.apart(&volume, &view, &exact));
        let end = Point {
            at: f64::from(counts[counts.len() - 1]),
            ..point
        };
        curves.push(Curve {
            method: occlusion_name(way),
            points: vec![point, end],
        });
    }
    // Lines from end to end are one measurement drawn twice.
    share(curves.iter_mut().flat_map(|c| &mut c.points));
    let marched = &curves[0].points;
    let (first, last) = (marched[0], marched[marched.len() - 1]);
    // Linear: the middle lies on the line between the ends.
    let middle = marched[marched.len() / 2];
    let grown = (last.march_ms - first.march_ms) * (middle.at - first.at) / (last.at - first.at);
    let straight = first.march_ms + grown;
    let ten = marched.iter().find(|p| p.at >= 10.0).unwrap_or(&last);
    let cheaper: Vec<String> = curves[1..]
        .iter()
        .filter(|c| c.points[0].ms() < ten.ms())
        .map(|c| c.method.clone())
        .collect();
    let beaten = curves[1..3].iter().all(|c| c.points[0].ms() < ten.ms());
    let least = curves[1..4]
        .iter()
        .filter_map(|c| c.points[0].error)
        .fold(f64::INFINITY, f64::min);
    let findings = vec![
        Finding::new(
            "001",
            "the secondary march's time grows linearly with its samples",
            (middle.march_ms / straight - 1.0).abs() < 0.2,
            format!(
                "{:.0} samples take {:.2} of what a straight line has",
                middle.at,
                middle.march_ms / straight,
            ),
            Vec::new(),
        ),
        Finding::new(
            "001",
            "that growth is gentle: 2.35 times the time from 1 to 50 samples",
            true,
            format!(
                "the picture's march alone takes {:.0} ms with {:.0}, {:.0} ms with {:.0}",
                first.march_ms, first.at, last.march_ms, last.at
            ),
            vec![Number::new("times", [2.35; 2], Some(last.march_ms / first.march_ms))],
        ),
        Finding::new(
            "001",
            "with ten samples it is already slower than exponential and Beer maps",
            beaten,
            format!(
                "{:.0} ms; cheaper are {}",
                ten.ms(),
                if cheaper.is_empty() {
                    "none".to_owned()
                } else {
                    cheaper.join(", ")
                }
            ),
            Vec::new(),
        ),
        Finding::new(
            "001",
            "its shadows are the nearest to the truth",
            ten.error.is_some_and(|e| e < least),
            format!(
                "relative error {:.3} with ten samples, {least:.3} the best map",
                ten.error.unwrap_or(f64::NAN)
            ),
            Vec::new(),
        ),
    ];
    Ok(Experiment {
        name: "samples",
        axis: "samples towards the sun",
        size: Some(size),
        curves,
        findings,
    })
}

fn picture_sizes(run: &mut Run) -> Result<Experiment, LadderError> {
    let volume = cumulus_field(7, 12);
    let sizes: &[[usize; 2]] = if run.conditions.quick {
        &[[32, 18], [64, 36]]
    } else {
        &[[320, 180], [640, 360], [1280, 720], [1920, 1080]]
    };
    let mut curves = Vec::new();
    for way in ways(run.conditions.quick) {
        let mut points = Vec::new();
        for [width, height] in sizes {
            let view = occluded(&looking_up([*width, *height]), way);
            points.push(run.point(&volume, &view, (width * height) as f64)?);
        }
        curves.push(Curve {
            method: occlusion_name(way),
            points,
        });
    }
    share(curves.iter_mut().flat_map(|c: &mut Curve| &mut c.points));
    let growth = |c: &Curve| c.points[sizes.len() - 1].ms() - c.points[0].ms();
    let march = growth(&curves[0]);
    let maps = curves[1..4].iter().map(growth).fold(0.0, f64::max);
    let pixels = |n: usize| (sizes[n][0] * sizes[n][1]) as f64;
    let linear: Vec<f64> = curves
        .iter()
        .map(|c| {
            let n = sizes.len() - 1;
            (c.points[n].march_ms / c.points[n - 1].march_ms) / (pixels(n) / pixels(n - 1))
        })
        .collect();
    let findings = vec![
        Finding::new(
            "001",
            "a larger picture burdens the secondary march more than the maps",
            march > maps,
            format!("{march:.0} ms more from the least to the largest picture, the dearest map {maps:.0}"),
            Vec::new(),
        ),
        Finding::new(
            "001",
            "cost grows with the pixels",
            linear.iter().all(|l| (0.7..1.3).contains(l)),
            format!(
                "the march's time over the pixels' growth at the last step, by method: {}",
                linear.iter().map(|l| format!("{l:.2}")).collect::<Vec<_>>().join(", ")
            ),
            Vec::new(),
        ),
    ];
    Ok(Experiment {
        name: "picture size",
        axis: "pixels",
        size: None,
        curves,
        findings,
    })
}

/// A cloud field in a domain of `times` x `times` as many columns: copied into all of it, so that every ray sees the same sky, or else alone in its middle with empty air around.
fn widened(volume: &CloudVolume, times: usize, copied: bool) -> CloudVolume {
    let [nx, ny, nz] = volume.grid.cells;
    let grid = Grid {
        cells: [nx * times, ny * times, nz],
        ..volume.grid
    };
    let middle = (times - 1) / 2;
    let cells = (0..grid.len()).map(|n| {
        let [i, j, k] = [n % (nx * times), n / (nx * times) % (ny * times), n / grid.plane()];
        if copied || (i / nx == middle && j / ny == middle) {
            volume.extinction_per_m[volume.grid.index(i % nx, j % ny, k)]
        } else {
            0.0
        }
    });
    clouds::volume(grid, cells.collect())
}

/// Domains are endless: at their edges they begin again. A ray is as long in a large one as in a small one, and where clouds are copied it meets the same; with empty air around
/// the clouds it meets their copies only after so much more nothing. There is no march without skipping to hold against; linear growth is what it would have in a domain
/// that rays cross from end to end.
fn domain_sizes(run: &mut Run) -> Result<Experiment, LadderError> {
    let one = cumulus_field(7, 12);
    let size = usual_size(run);
    let times: &[usize] = if run.conditions.quick { &[1, 2] } else { &[1, 2, 4] };
    let mut curves = Vec::new();
    for (method, copied) in [("clouds in empty air", false), ("clouds copied", true)] {
        let mut points = Vec::new();
        for times in times {
            let volume = widened(&one, *times, copied);
            let mut view = looking_up(size);
            // Flat enough that rays leave the clouds' own part of the domain, and with it as it moves.
            view.elevation_deg = 18.0;
            for (a, cells) in one.grid.cells[..2].iter().enumerate() {
                let moved = ((times - 1) / 2 * cells) as f32;
                view.camera_position_m[a] += moved * one.grid.cell_size_m[a];
            }
            points.push(run.point(&volume, &view, volume.grid.len() as f64)?);
        }
        curves.push(Curve {
            method: method.to_owned(),
            points,
        });
    }
    let growths = |curve: &Curve| {
        let (first, last) = (curve.points[0], curve.points[times.len() - 1]);
        [
            last.at / first.at,
            last.march_ms / first.march_ms,
            last.tick_ms / first.tick_ms,
            last.ms() / first.ms(),
        ]
    };
    let finding = |says: &'static str, curve: &Curve, judged: usize| {
        let growth = growths(curve);
        let [cells, march, tick, whole] = growth;
        Finding::new(
            "004",
            says,
            growth[judged] * SAME < cells,
            format!(
                "{}: {cells:.0} times the cells take {march:.2} times the march, {tick:.1} times what a tick needs, {whole:.1} times both; linear growth would be {cells:.0} times",
                curve.method
            ),
            Vec::new(),
        )
    };
    let march = "where empty space is skipped the march's time grows less than the domain";
    let whole = "a picture's whole time with what a tick makes anew does too";
    let findings = vec![
        finding(march, &curves[0], 1),
        finding(whole, &curves[0], 3),
        finding(march, &curves[1], 1),
    ];
    Ok(Experiment {
        name: "domain size",
        axis: "cells",
        size: Some(size),
        curves,
        findings,
    })
}

/// Share of the picture's pixels that differ from the clear sky's, %.
fn cover(volume: &CloudVolume, view: &ViewSettings, prepared: &mut Prepared) -> f64 {
    let small = ViewSettings {
        width: 160,
        height: 90,
        ..*view
    };
    let cloudy = render(Some(volume), &small, prepared);
    let clear = render(None, &small, prepared);
    let pixels = cloudy.chunks_exact(3).zip(clear.chunks_exact(3));
    // The pattern against bands and the last bit of rounding are no cloud.
    let differ = pixels.filter(|(a, b)| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > 2));
    100.0 * differ.count() as f64 / (160.0 * 90.0)
}

/// A field of which so much of the picture is cloud, %, to 2 % or as near as a dozen halvings come; and how much it is.
fn covering(wanted: f64, view: &ViewSettings, prepared: &mut Prepared) -> (CloudVolume, f64) {
    // Above the higher threshold there is hardly any cloud, above the lower one nothing else.
    let (mut low, mut high) = (-4.0f32, 4.0);
    let mut tries = 12;
    loop {
        let threshold = 0.5 * (low + high);
        let volume = broken_layer(11, threshold);
        let share = cover(&volume, view, prepared);
        tries -= 1;
        if (share - wanted).abs() <= 2.0 || tries == 0 {
            return (volume, share);
        }
        if share < wanted {
            high = threshold;
        } else {
            low = threshold;
        }
    }
}

/// Where the first curve, from below, comes to cost what the second does: between two points on the straight line.
fn crossing(first: &Curve, second: &Curve) -> Option<f64> {
    let ahead: Vec<[f64; 2]> = first
        .points
        .iter()
        .zip(&second.points)
        .map(|(a, b)| [a.at, a.ms() - b.ms()])
        .collect();
    let (from, to) = ahead
        .windows(2)
        .map(|pair| (pair[0], pair[1]))
        .find(|(from, to)| from[1] <= 0.0 && to[1] > 0.0)?;
    Some(from[0] + (to[0] - from[0]) * -from[1] / (to[1] - from[1]))
}

fn coverage(run: &mut Run) -> Result<Experiment, LadderError> {
    let size = usual_size(run);
    let view = ViewSettings {
        elevation_deg: 80.0,
        ..looking_up(size)
    };
    let covers: &[f64] = if run.conditions.quick {
        &[20.0, 90.0]
    } else {
        &[10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 100.0]
    };
    let ways = ways(run.conditions.quick);
    let mut curves: Vec<Curve> = ways
        .iter()
        .map(|way| Curve {
            method: occlusion_name(*way),
            points: Vec::new(),
        })
        .collect();
    for wanted in covers {
        let (volume, share) = covering(*wanted, &view, &mut run.prepared);
        for (way, curve) in ways.iter().zip(&mut curves) {
            curve.points.push(run.point(&volume, &occluded(&view, *way), share)?);
        }
    }
    for n in 0..covers.len() {
        share(curves.iter_mut().map(|c| &mut c.points[n]));
    }
    let slope = |c: &Curve| {
        let (first, last) = (c.points[0], c.points[c.points.len() - 1]);
        (last.ms() - first.ms()) / (last.at - first.at).max(1.0)
    };
    let cheapest = curves[..4]
        .iter()
        .map(|c| c.points[0].ms())
        .fold(f64::INFINITY, f64::min);
    let steepest = curves[1..4].iter().map(slope).fold(0.0, f64::max);
    let findings = vec![
        Finding::new(
            "001",
            "with little cloud the secondary march is the cheapest",
            curves[0].points[0].ms() <= cheapest,
            format!(
                "{:.1} ms at {:.0} %, the cheapest of the four {cheapest:.1}",
                curves[0].points[0].ms(),
                curves[0].points[0].at
            ),
            Vec::new(),
        ),
        Finding::new(
            "001",
            "its time grows fastest with the cover",
            slope(&curves[0]) > steepest,
            format!("{:.2} ms a percent, the maps at most {steepest:.2}", slope(&curves[0])),
            Vec::new(),
        ),
        Finding::new(
            "001",
            "it passes the maps at 35, 45 and 78 % of cover, the cheapest map first",
            true,
            "between measured covers on the straight line".to_owned(),
            curves[1..4]
                .iter()
                .zip([35.0, 45.0, 78.0])
                .map(|(map, seed)| Number::new(format!("%, {}", map.method), [seed; 2], crossing(&curves[0], map)))
                .collect(),
        ),
    ];
    Ok(Experiment {
        name: "coverage",
        axis: "share of the picture that is cloud, %",
        size: Some(size),
        curves,
        findings,
    })
}

fn segments(run: &mut Run) -> Result<Experiment, LadderError> {
    let volume = cumulus_field(7, 12);
    let size = usual_size(run);
    let base = looking_up(size);
    let by = |steps| ViewSettings { steps, ..base };
    let exact = run.exact(&volume, "view_steps", &base);
    let counts: &[u32] = if run.conditions.quick {
        &[2, 30]
    } else {
        &[2, 5, 8, 10, 15, 20, 30, 60, 120]
    };
    let mut curve = |method: &str, each: &[(f64, ViewSteps)]| -> Result<Curve, LadderError> {
        let mut points = Vec::new();
        for (at, steps) in each {
            let mut point = run.point(&volume, &by(*steps), *at)?;
            point.error = Some(run.apart(&volume, &by(*steps), &exact));
            points.push(point);
        }
        Ok(Curve {
            method: method.to_owned(),
            points,
        })
    };
    let logarithmic: Vec<(f64, ViewSteps)> = counts
        .iter()
        .map(|n| (f64::from(*n), ViewSteps::LogarithmicSegments { segments: *n }))
        .collect();
    // On the axis of segments these two have no place of their own: they are drawn from end to end.
    let ends = [f64::from(counts[0]), f64::from(counts[counts.len() - 1])];
    let mut curves = vec![
        curve("logarithmic_segments", &logarithmic)?,
        curve("by_distance", &ends.map(|at| (at, ViewSteps::ByDistance)))?,
        curve(
            "by_optical_depth 0.25",
            &ends.map(|at| (at, ViewSteps::ByOpticalDepth { optical_depth: 0.25 })),
        )?,
    ];
    share(curves.iter_mut().flat_map(|c| &mut c.points));
    let points = &curves[0].points;
    let at = |n: f64| points.iter().find(|p| p.at >= n).unwrap_or(&points[points.len() - 1]);
    let (few, many) = (at(5.0), at(30.0));
    let findings = vec![
        Finding::new(
            "000",
            "frames a second fall steeply with the first segments and ever less after: 48 with 5, 10 with 30",
            few.march_ms < many.march_ms,
            format!(
                "{:.1} frames/s with {:.0}, {:.1} with {:.0}",
                1e3 / few.march_ms,
                few.at,
                1e3 / many.march_ms,
                many.at
            ),
            vec![Number::new(
                "times as many with the few",
                [4.8; 2],
                Some(many.march_ms / few.march_ms),
            )],
        ),
        Finding::new(
            "000",
            "five segments look as good as eight or thirty",
            few.error.zip(many.error).is_some_and(|(few, many)| few < SAME * many),
            format!(
                "relative error {:.3} with 5, {:.3} with 30; steps by distance {:.3}, by optical depth {:.3}. Our rays cross whole fields of ragged clouds, theirs one ellipsoid at a time",
                few.error.unwrap_or(f64::NAN),
                many.error.unwrap_or(f64::NAN),
                curves[1].points[0].error.unwrap_or(f64::NAN),
                curves[2].points[0].error.unwrap_or(f64::NAN),
            ),
            Vec::new(),
        ),
    ];
    Ok(Experiment {
        name: "segments",
        axis: "segments of a ray",
        size: Some(size),
        curves,
        findings,
    })
}

/// Curves of time, a panel an experiment, and of error where there is one. Errors: [`PlotError`].
pub fn png(report: &Experiments) -> Result<Vec<u8>, PlotError> {
    let chart = |experiment: &Experiment, what: &str, of: &dyn Fn(&Point) -> Option<f64>| {
        let series = experiment.curves.iter().enumerate().map(|(n, curve)| {
            let points = curve.points.iter().filter_map(|p| of(p).map(|y| [p.at, y.max(1e-4)]));
            Series::line(curve.method.clone(), n, points.collect())
        });
        Panel::Chart(Chart {
            title: format!("{}: {what}", experiment.name),
            axes: [experiment.axis.to_owned(), what.to_owned()],
            log: [experiment.name != "coverage", true],
            series: series.collect(),
            ..Chart::default()
        })
    };
    let mut panels = Vec::new();
    for experiment in &report.experiments {
        panels.push(chart(
            experiment,
            "ms of a picture and of all that a tick makes anew",
            &|p| Some(p.ms()),
        ));
        if experiment
            .curves
            .iter()
            .flat_map(|c| &c.points)
            .any(|p| p.error.is_some())
        {
            panels.push(chart(experiment, "relative error of radiance", &|p| p.error));
        }
    }
    plot::png(&panels, 2, [760, 470])
}

/// Curves and findings as text.
pub fn text(report: &Experiments) -> String {
    let mut text = format!(
        "welkin {} on {}, {} threads{}\n",
        report.version,
        report.device,
        report.threads,
        if report.quick { ", small" } else { "" }
    );
    for experiment in &report.experiments {
        let size = experiment
            .size
            .map_or(String::new(), |[w, h]| format!(", {w} x {h} pixels"));
        text += &format!(
            "\n{} ({}{size}): ms of the march + ms of what a tick makes anew, relative error\n",
            experiment.name, experiment.axis
        );
        for curve in &experiment.curves {
            text += &format!("  {}\n", curve.method);
            for point in &curve.points {
                let error = point.error.map_or(String::new(), |e| format!("   {e:.4}"));
                text += &format!(
                    "    {:>9.0}  {:>8.1} + {:.1}{error}\n",
                    point.at, point.march_ms, point.tick_ms
                );
            }
        }
        for finding in &experiment.findings {
            let verdict = if finding.holds { "holds" } else { "does not hold" };
            text += &format!(
                "  seed {}: {}. Here that {verdict}: {}.\n",
                finding.seed, finding.says, finding.here
            );
            for Number { what, seed, here } in &finding.numbers {
                let here = here.map_or("nowhere".to_owned(), |v| format!("{v:.2}"));
                let [from, to] = seed;
                let seed = if from == to {
                    from.to_string()
                } else {
                    format!("{from} to {to}")
                };
                text += &format!("    {what}: here {here}, in the seed {seed}\n");
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_experiment_has_curves_and_findings_of_its_own_figures() {
        let conditions = Conditions {
            quick: true,
            progress: &|_, _| true,
        };
        let report = experiments(&conditions).unwrap();
        assert_eq!(report.experiments.len(), 6);
        for experiment in &report.experiments {
            assert!(!experiment.findings.is_empty());
            for curve in &experiment.curves {
                assert!(curve.points.len() >= 2, "{}: {}", experiment.name, curve.method);
                assert!(curve.points.iter().all(|p| p.march_ms > 0.0 && p.tick_ms >= 0.0));
                assert!(
                    curve.points.windows(2).all(|p| p[0].at < p[1].at),
                    "{}",
                    experiment.name
                );
            }
        }
        // What does not hang on the clock: more samples and more segments come nearer.
        for name in ["samples", "segments"] {
            let experiment = report.experiments.iter().find(|e| e.name == name).unwrap();
            let points = &experiment.curves[0].points;
            assert!(points[0].error > points[points.len() - 1].error, "{name}: {points:?}");
        }
        let cover = report.experiments.iter().find(|e| e.name == "coverage").unwrap();
        let cover = &cover.curves[0].points;
        for (point, wanted) in cover.iter().zip([20.0, 90.0]) {
            assert!((point.at - wanted).abs() <= 3.0, "{cover:?}");
        }
        assert!(text(&report).contains("seed 000"));
        assert!(png(&report).unwrap().len() > 10_000);
    }

    #[test]
    fn a_number_that_misses_the_seeds_by_more_than_half_does_not_hold() {
        let says = |here| {
            let number = Number::new("times", [2.35; 2], here);
            Finding::new("001", "", true, String::new(), vec![number]).holds
        };
        assert!(says(Some(2.35)) && says(Some(3.4)) && says(Some(1.6)));
        assert!(!says(Some(4.9)) && !says(Some(1.5)) && !says(None));
    }

    #[test]
    fn curves_cross_between_their_points() {
        let curve = |ms: [f64; 3]| Curve {
            method: String::new(),
            points: (0..3)
                .map(|n| Point {
                    at: 10.0 * f64::from(n),
                    march_ms: ms[n as usize],
                    tick_ms: 1.0,
                    map_ms: 0.0,
                    error: None,
                })
                .collect(),
        };
        let flat = curve([4.0; 3]);
        assert_eq!(crossing(&curve([1.0, 3.0, 7.0]), &flat), Some(12.5));
        assert_eq!(crossing(&curve([5.0, 6.0, 7.0]), &flat), None, "dearer from the start");
        assert_eq!(crossing(&curve([1.0; 3]), &flat), None);
    }

    #[test]
    fn what_is_shared_costs_all_the_same() {
        let point = |tick_ms, map_ms| Point {
            at: 0.0,
            march_ms: 1.0,
            tick_ms,
            map_ms,
            error: None,
        };
        let mut points = [point(9.0, 0.0), point(12.0, 4.0)];
        share(&mut points);
        assert_eq!(points.map(|p| p.tick_ms), [8.0, 12.0]);
    }
}
