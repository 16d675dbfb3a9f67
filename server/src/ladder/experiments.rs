//! The seeds' experiments on what a picture costs, with our curves and whether their conclusions hold here.
//!
//! Seed 001 compares four ways to learn how much cloud lies towards the sun: a secondary march and an exponential, a Beer and a Fourier map, by the maps' size, the number of samples,
//! the size of the picture and how much of it is cloud. Seed 004 skips empty space, so that the domain's size should matter little. Seed 000 plots frames a second against the segments of a ray. Ours run on the CPU, theirs on GPUs of 2022 and 2009:
//! what is compared is who is cheaper where and how costs grow, not milliseconds.

use serde::Serialize;
use welkin_shaders::cpu::view::{MapKind, Prepared, SunOcclusion, ViewSettings, radiance, render};
use welkin_shaders::view::ViewSteps;
use welkin_shaders::{CloudVolume, Grid};

use super::LadderError;
use super::light::{self, map, occluded, occlusion_name, times};
use crate::clouds::{self, cumulus_field, settings};
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
    /// Whether our figures say the same.
    pub holds: bool,
    /// Our figures.
    pub here: String,
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
        Ok(Point {
            at,
            march_ms: times.march_ms[1],
            tick_ms: times.stages_ms.iter().map(|(_, ms)| ms[1]).sum(),
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

/// Runs them. Errors: `Interrupted`.
pub fn experiments(conditions: &Conditions) -> Result<Experiments, LadderError> {
    let mut run = Run {
        conditions,
        prepared: Prepared::new(),
        done: 0,
        all: if conditions.quick { 38 } else { 108 },
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
    let last = |n: usize| curves[n].points[sides.len() - 1];
    let of = |n: usize| &curves[n].points;
    let growth: Vec<f64> = (0..3)
        .map(|n| of(n)[sides.len() - 1].tick_ms / of(n)[sides.len() - 2].tick_ms)
        .collect();
    let order = last(0).tick_ms <= last(1).tick_ms * 1.05 && last(1).tick_ms <= last(2).tick_ms * 1.05;
    let findings = vec![
        Finding {
            seed: "001",
            says: "the Fourier map costs most to make, the exponential one least",
            holds: order,
            here: format!(
                "{:.1}, {:.1} and {:.1} ms for an exponential, a Beer and a Fourier map of {} squared",
                last(0).tick_ms,
                last(1).tick_ms,
                last(2).tick_ms,
                sides[sides.len() - 1],
            ),
        },
        Finding {
            seed: "001",
            says: "twice the side makes a map cost less than four times as much (2 to 2.5)",
            holds: growth.iter().all(|g| *g < 3.6),
            here: format!(
                "{:.1}, {:.1} and {:.1} times at the last doubling",
                growth[0], growth[1], growth[2]
            ),
        },
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
    let marched = &curves[0].points;
    let (first, last) = (marched[0], marched[marched.len() - 1]);
    // Linear: the middle lies on the line between the ends.
    let middle = marched[marched.len() / 2];
    let straight = first.ms() + (last.ms() - first.ms()) * (middle.at - first.at) / (last.at - first.at);
    let ten = marched.iter().find(|p| p.at >= 10.0).unwrap_or(&last);
    let beaten: Vec<String> = curves[1..]
        .iter()
        .filter(|c| c.points[0].ms() < ten.ms())
        .map(|c| c.method.clone())
        .collect();
    let least = curves[1..4]
        .iter()
        .filter_map(|c| c.points[0].error)
        .fold(f64::INFINITY, f64::min);
    let findings = vec![
        Finding {
            seed: "001",
            says: "the secondary march's time grows linearly with its samples, 2.35 times from 1 to 50",
            holds: (middle.ms() / straight - 1.0).abs() < 0.2,
            here: format!(
                "{:.0} to {:.0} ms, {:.1} times; {:.0} samples take {:.2} of what a straight line has",
                first.ms(),
                last.ms(),
                last.ms() / first.ms(),
                middle.at,
                middle.ms() / straight,
            ),
        },
        Finding {
            seed: "001",
            says: "with ten samples it is already slower than exponential and Beer maps",
            holds: beaten.len() >= 2,
            here: format!(
                "{:.0} ms; cheaper are {}",
                ten.ms(),
                if beaten.is_empty() {
                    "none".to_owned()
                } else {
                    beaten.join(", ")
                }
            ),
        },
        Finding {
            seed: "001",
            says: "its shadows are the nearest to the truth",
            holds: ten.error.is_some_and(|e| e < least),
            here: format!(
                "relative error {:.3} with ten samples, {least:.3} the best map",
                ten.error.unwrap_or(f64::NAN)
            ),
        },
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
    let growth = |c: &Curve| c.points[sizes.len() - 1].ms() - c.points[0].ms();
    let march = growth(&curves[0]);
    let fastest = curves[1..4].iter().map(growth).fold(f64::INFINITY, f64::min);
    let pixels = |n: usize| (sizes[n][0] * sizes[n][1]) as f64;
    let linear: Vec<f64> = curves
        .iter()
        .map(|c| {
            let n = sizes.len() - 1;
            (c.points[n].march_ms / c.points[n - 1].march_ms) / (pixels(n) / pixels(n - 1))
        })
        .collect();
    let findings = vec![
        Finding {
            seed: "001",
            says: "a larger picture burdens the secondary march more than the maps",
            holds: march > fastest,
            here: format!("{march:.0} ms more from the least to the largest picture, the cheapest map {fastest:.0}"),
        },
        Finding {
            seed: "001",
            says: "cost grows with the pixels",
            holds: linear.iter().all(|l| (0.7..1.3).contains(l)),
            here: format!(
                "the march's time over the pixels' growth at the last step, by method: {}",
                linear.iter().map(|l| format!("{l:.2}")).collect::<Vec<_>>().join(", ")
            ),
        },
    ];
    Ok(Experiment {
        name: "picture size",
        axis: "pixels",
        size: None,
        curves,
        findings,
    })
}

/// The same sky in a domain of `times` x `times` as many columns.
fn tiled(volume: &CloudVolume, times: usize) -> CloudVolume {
    let [nx, ny, nz] = volume.grid.cells;
    let grid = Grid {
        cells: [nx * times, ny * times, nz],
        ..volume.grid
    };
    let cells = (0..grid.len()).map(|n| {
        let [i, j, k] = [n % (nx * times), n / (nx * times) % (ny * times), n / grid.plane()];
        volume.extinction_per_m[volume.grid.index(i % nx, j % ny, k)]
    });
    clouds::volume(grid, cells.collect())
}

fn domain_sizes(run: &mut Run) -> Result<Experiment, LadderError> {
    let one = cumulus_field(7, 12);
    let size = usual_size(run);
    let times: &[usize] = if run.conditions.quick { &[1, 2] } else { &[1, 2, 4] };
    let mut points = Vec::new();
    for times in times {
        let volume = tiled(&one, *times);
        points.push(run.point(&volume, &looking_up(size), volume.grid.len() as f64)?);
    }
    let (first, last) = (points[0], points[points.len() - 1]);
    let [cells, march, tick] = [
        last.at / first.at,
        last.march_ms / first.march_ms,
        last.tick_ms / first.tick_ms.max(1e-3),
    ];
    Ok(Experiment {
        name: "domain size",
        axis: "cells",
        size: Some(size),
        curves: vec![Curve {
            method: occlusion_name(SunOcclusion::LightGrid),
            points,
        }],
        findings: vec![Finding {
            seed: "004",
            says: "where empty space is skipped a picture's time grows less than the domain",
            holds: march < 0.5 * cells,
            here: format!(
                "{cells:.0} times the cells take {march:.2} times the march, {tick:.1} times what a tick needs"
            ),
        }],
    })
}

/// Share of the picture's pixels that differ from the clear sky's.
fn covered(volume: &CloudVolume, view: &ViewSettings, prepared: &mut Prepared) -> f64 {
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
    differ.count() as f64 / (160.0 * 90.0)
}

fn coverage(run: &mut Run) -> Result<Experiment, LadderError> {
    let size = usual_size(run);
    let view = ViewSettings {
        elevation_deg: 80.0,
        ..looking_up(size)
    };
    let counts: &[usize] = if run.conditions.quick {
        &[2, 120]
    } else {
        &[1, 3, 6, 10, 16, 26, 45, 90, 300]
    };
    let ways = ways(run.conditions.quick);
    let mut curves: Vec<Curve> = ways
        .iter()
        .map(|way| Curve {
            method: occlusion_name(*way),
            points: Vec::new(),
        })
        .collect();
    for clouds in counts {
        let volume = cumulus_field(11, *clouds);
        let share = 100.0 * covered(&volume, &view, &mut run.prepared);
        for (way, curve) in ways.iter().zip(&mut curves) {
            curve.points.push(run.point(&volume, &occluded(&view, *way), share)?);
        }
    }
    for curve in &mut curves {
        curve.points.sort_by(|a, b| a.at.total_cmp(&b.at));
    }
    let slope = |c: &Curve| {
        let (first, last) = (c.points[0], c.points[c.points.len() - 1]);
        (last.ms() - first.ms()) / (last.at - first.at).max(1.0)
    };
    let first_dearer = |n: usize| {
        let pairs = curves[0].points.iter().zip(&curves[n].points);
        pairs
            .filter(|(march, map)| march.ms() > map.ms())
            .map(|(march, _)| march.at)
            .next()
    };
    let crossings: Vec<String> = (1..4)
        .map(|n| match first_dearer(n) {
            Some(at) => format!("{} from {at:.0} %", curves[n].method),
            None => format!("{} nowhere", curves[n].method),
        })
        .collect();
    let cheapest = curves[..4]
        .iter()
        .map(|c| c.points[0].ms())
        .fold(f64::INFINITY, f64::min);
    let steepest = curves[1..4].iter().map(slope).fold(0.0, f64::max);
    let findings = vec![
        Finding {
            seed: "001",
            says: "with little cloud the secondary march is the cheapest",
            holds: curves[0].points[0].ms() <= cheapest,
            here: format!(
                "{:.1} ms at {:.0} %, the cheapest of the four {cheapest:.1}",
                curves[0].points[0].ms(),
                curves[0].points[0].at
            ),
        },
        Finding {
            seed: "001",
            says: "its time grows fastest with the cover, and passes those of the maps at 35, 45 and 78 %",
            holds: slope(&curves[0]) > steepest && (1..4).all(|n| first_dearer(n).is_some()),
            here: format!(
                "{:.2} ms a percent, the maps at most {steepest:.2}; dearer than {}",
                slope(&curves[0]),
                crossings.join(", ")
            ),
        },
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
    let curves = vec![
        curve("logarithmic_segments", &logarithmic)?,
        curve("by_distance", &ends.map(|at| (at, ViewSteps::ByDistance)))?,
        curve(
            "by_optical_depth 0.25",
            &ends.map(|at| (at, ViewSteps::ByOpticalDepth { optical_depth: 0.25 })),
        )?,
    ];
    let points = &curves[0].points;
    let at = |n: f64| points.iter().find(|p| p.at >= n).unwrap_or(&points[points.len() - 1]);
    let (few, many) = (at(5.0), at(30.0));
    let findings = vec![
        Finding {
            seed: "000",
            says: "frames a second fall steeply with the first segments and ever less after: 48 with 5, 10 with 30",
            holds: few.march_ms < many.march_ms && many.march_ms / few.march_ms < 6.0,
            here: format!(
                "{:.1} frames/s with 5, {:.1} with 30",
                1e3 / few.march_ms,
                1e3 / many.march_ms
            ),
        },
        Finding {
            seed: "000",
            says: "five segments look as good as eight or thirty",
            holds: few.error.zip(many.error).is_some_and(|(few, many)| few < 1.5 * many),
            here: format!(
                "relative error {:.3} with 5, {:.3} with 30; steps by distance {:.3}, by optical depth {:.3}. Our rays cross whole fields of ragged clouds, theirs one ellipsoid at a time",
                few.error.unwrap_or(f64::NAN),
                many.error.unwrap_or(f64::NAN),
                curves[1].points[0].error.unwrap_or(f64::NAN),
                curves[2].points[0].error.unwrap_or(f64::NAN),
            ),
        },
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
            "ms of a picture and what it needs once a tick",
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
            "\n{} ({}{size}): ms of the march + ms a tick, relative error\n",
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
        assert!(cover[0].at < 40.0 && cover[cover.len() - 1].at > 80.0, "{cover:?}");
        assert!(text(&report).contains("seed 000"));
        assert!(png(&report).unwrap().len() > 10_000);
    }
}
