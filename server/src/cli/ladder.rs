//! `welkin ladder`.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use clap::{Args, ValueEnum};

use super::{Failure, MachineFlags, Outcome, columns, interrupt_flag, make_folder, print_line, progress_bar};
use crate::ladder::experiments::{self, Conditions};
use crate::ladder::light::{self, LightContext, LightReport, LightScene};
use crate::ladder::view::{self, ViewContext, ViewReport};
use crate::ladder::{self, CaseReport, Context, LadderError, Report};

pub(super) const EXAMPLES: &str = "\
Examples:
  welkin ladder dynamics --quick           every rung of advection, pressure and subgrid, small
  welkin ladder dynamics --out results     at full size; JSON, table and plot into a folder
  welkin ladder light --quick              every way to light a cloud against traced paths, small
  welkin ladder experiments                what pictures cost by map, samples, size, cover and segments
  welkin ladder light --truths traced --out results     interrupt it, run it again: it goes on
  welkin ladder view --out results         live pictures of fewer rays, at rest and from moving cameras";

/// Which ladders.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Which {
    /// Advection, pressure, subgrid.
    Dynamics,
    /// How clouds are lit, on the CPU.
    Light,
    /// The seeds' experiments on what pictures cost, on the CPU.
    Experiments,
    /// How many pixels of live pictures are marched, on the CPU.
    View,
}

#[derive(Args)]
pub(super) struct Options {
    /// The ladders to measure.
    #[arg(value_enum)]
    which: Which,
    /// Smaller and shorter runs.
    #[arg(long)]
    quick: bool,
    /// Folder for JSON, table and plot.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Folder where the ladder of light keeps its traced pictures, and finds them again.
    #[arg(long, value_name = "DIR")]
    truths: Option<PathBuf>,
    /// Print the results as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    machine: MachineFlags,
}

pub(super) fn run(options: Options) -> Result<Outcome, Failure> {
    for folder in options.out.iter().chain(&options.truths) {
        make_folder(folder)?;
    }
    let interrupted = interrupt_flag();
    let bar = progress_bar(1000.0, "measuring");
    let progress = |what: &str, share: f64| {
        if bar.message() != what {
            bar.set_message(what.to_owned());
            bar.reset_eta();
        }
        bar.set_position((1000.0 * share) as u64);
        !interrupted.load(Ordering::Relaxed)
    };
    let measured = match options.which {
        Which::Dynamics => ladder::dynamics(&Context {
            quick: options.quick,
            machine: options.machine.machine()?,
            progress: &progress,
        })
        .and_then(|report| written(&report, table(&report), "dynamics", vec![("", ladder::png(&report)?)])),
        Which::Light => {
            options.machine.size_pool(None);
            light::light(&LightContext {
                quick: options.quick,
                truths: options.truths.as_deref(),
                progress: &progress,
                measured: &|report| {
                    let so_far = written(report, light_table(report), "light", Vec::new())?;
                    options.out.as_deref().map_or(Ok(()), |folder| so_far.keep(folder))
                },
            })
            .and_then(|report| {
                let plots = vec![
                    ("", light::png(&report)?),
                    ("-pictures", light::contact_sheet(&report)?),
                ];
                written(&report, light_table(&report), "light", plots)
            })
        }
        Which::Experiments => {
            options.machine.size_pool(None);
            experiments::experiments(&Conditions {
                quick: options.quick,
                progress: &progress,
            })
            .and_then(|report| {
                let plots = vec![("", experiments::png(&report)?)];
                written(&report, experiments::text(&report), "experiments", plots)
            })
        }
        Which::View => {
            options.machine.size_pool(None);
            view::view(&ViewContext {
                quick: options.quick,
                progress: &progress,
            })
            .and_then(|report| written(&report, view_table(&report), "view", Vec::new()))
        }
    };
    bar.finish_and_clear();
    let results = match measured {
        Ok(results) => results,
        Err(LadderError::Interrupted) => return Ok(Outcome::Interrupted),
        Err(error) => return Err(Failure(error.to_string())),
    };
    if let Some(folder) = &options.out {
        results.keep(folder).map_err(|error| Failure(error.to_string()))?;
    }
    print_line(if options.json {
        &results.json
    } else {
        results.text.trim_end()
    })?;
    Ok(Outcome::Done)
}

/// What is printed, and what goes into a folder.
struct Results {
    json: String,
    text: String,
    files: Vec<(String, Vec<u8>)>,
}

impl Results {
    fn keep(&self, folder: &Path) -> Result<(), LadderError> {
        for (name, bytes) in &self.files {
            ladder::keep(&folder.join(name), bytes)?;
        }
        Ok(())
    }
}

fn written(
    report: &impl serde::Serialize,
    text: String,
    which: &str,
    pictures: Vec<(&str, Vec<u8>)>,
) -> Result<Results, LadderError> {
    let json = serde_json::to_string_pretty(report)?;
    let mut files = vec![
        (format!("ladder-{which}.json"), json.clone().into_bytes()),
        (format!("ladder-{which}.txt"), text.clone().into_bytes()),
    ];
    for (what, png) in pictures {
        files.push((format!("ladder-{which}{what}.png"), png));
    }
    Ok(Results { json, text, files })
}

fn view_table(report: &ViewReport) -> String {
    let short = if report.quick { ", small and short" } else { "" };
    let [width, height] = report.size;
    let mut text = format!(
        "welkin {} on {}{short}; {width} x {height} pixels\n\nhalf_resolution against every_pixel: relative error of radiance, mean FLIP, what 99 in 100 bytes stay within, rays a pixel; ms of a picture, and of one that brings a new tick; every_pixel is accuracy reference\n",
        report.version, report.device
    );
    let head = [
        "SCENE",
        "ERROR",
        "FLIP",
        "99 %",
        "RAYS",
        "MS",
        "NEW TICK",
        "MS REFERENCE",
        "NEW TICK",
    ];
    let rows = report.stills.iter().map(|row| {
        [
            row.scene.to_owned(),
            format!("{:.4}", row.error),
            format!("{:.4}", row.flip),
            row.bytes_99.to_string(),
            format!("{:.2}", row.rays),
            format!("{:.1}", row.ms),
            format!("{:.1}", row.new_tick_ms),
            format!("{:.1}", row.whole_ms),
            format!("{:.1}", row.whole_new_tick_ms),
        ]
    });
    text += &columns(
        std::iter::once(head.map(str::to_owned)).chain(rows).collect(),
        [false, true, true, true, true, true, true, true, true],
    );
    text += &format!(
        "\nstreams of {} pictures, ten a second, clouds in the wind: against the whole picture of the same moment, in bytes of 255: the mean and the worst picture, and its FLIP; what 999 of 1000 pixels stay within; the mean over pixels whose cloud has jumped, and their share\n",
        report.stream_pictures
    );
    let head = [
        "CAMERA", "RUNG", "RMS", "WORST", "FLIP", "99.9 %", "JUMPED", "SHARE", "RAYS", "MS",
    ];
    let rows = report.streams.iter().map(|row| {
        [
            row.camera.to_owned(),
            row.rung.to_owned(),
            format!("{:.2}", row.rms_bytes),
            format!("{:.2}", row.rms_bytes_worst),
            format!("{:.4}", row.flip_worst),
            row.bytes_999.to_string(),
            format!("{:.2}", row.jumped_rms_bytes),
            format!("{:.3}", row.jumped),
            format!("{:.2}", row.rays),
            format!("{:.1}", row.ms),
        ]
    });
    text + &columns(
        std::iter::once(head.map(str::to_owned)).chain(rows).collect(),
        [false, false, true, true, true, true, true, true, true, true],
    )
}

fn light_table(report: &LightReport) -> String {
    let short = if report.quick { ", small" } else { "" };
    let mut text = format!("welkin {} on {}{short}\n", report.version, report.device);
    for scene in &report.scenes {
        let LightScene {
            scene: name,
            what,
            size: [width, height],
            paths,
            truth_error,
            truth_s,
            rows,
            ..
        } = scene;
        text += &format!(
            "\n{name}: {what}\ntruth: {width} x {height} pixels, {paths} paths each, relative error {truth_error:.3}, {truth_s:.0} s\n"
        );
        let head = [
            "LADDER",
            "RUNG",
            "ERROR",
            "BY THIS ALONE",
            "FLIP",
            "BRIGHTNESS",
            "MS MARCH",
            "MS A TICK",
            "KIB",
            "PARETO",
        ];
        let lines = rows.iter().map(|row| {
            [
                row.ladder.to_owned(),
                row.rung.clone(),
                format!("{:.3}", row.error),
                row.own_error.map_or("-".to_owned(), |v| format!("{v:.3}")),
                format!("{:.3}", row.flip),
                format!("{:.3}", row.brightness),
                format!("{:.1}", row.march_ms),
                format!("{:.1}", row.sun_ms),
                (row.bytes / 1024).to_string(),
                if row.pareto { "*".to_owned() } else { String::new() },
            ]
        });
        text += &columns(
            std::iter::once(head.map(str::to_owned)).chain(lines).collect(),
            [false, false, true, true, true, true, true, true, true, false],
        );
    }
    if report.slabs.is_empty() {
        return text;
    }
    text += "\nslabs: share of the flux that is reflected, and in brackets all that leaves (1 is right); discrete ordinates first\n";
    let rungs = report.slabs.first().map(|row| row.march.as_slice()).unwrap_or_default();
    let head = ["DEPTH", "G", "MU0", "DISCRETE"].map(str::to_owned);
    let head: Vec<String> = head
        .into_iter()
        .chain(rungs.iter().map(|r| r.rung.to_uppercase()))
        .collect();
    let lines = report.slabs.iter().map(|row| {
        let own = [
            row.optical_depth.to_string(),
            row.asymmetry.to_string(),
            row.sun_cosine.to_string(),
            format!("{:.4}", row.discrete_ordinates),
        ];
        let march = row
            .march
            .iter()
            .map(|r| format!("{:.3} ({:.2})", r.reflected, r.in_all));
        own.into_iter().chain(march).collect::<Vec<String>>()
    });
    for line in std::iter::once(head).chain(lines) {
        let cells = line.iter().enumerate().map(|(n, cell)| {
            let width = if n < 3 { 5 } else { 17 };
            format!("{cell:>width$}")
        });
        text += &format!("{}\n", cells.collect::<String>());
    }
    text += "\nballs: what leaves of what a ball of cloud takes from the beam, by its optical depth; 1 is right, and above 1 light is made\n";
    let depths = report.balls.iter().map(|row| format!("{:>8}", row.optical_depth));
    text += &format!("{:<18}{}\n", "RUNG", depths.collect::<String>());
    let rungs = report
        .balls
        .first()
        .map(|row| row.sent_out.as_slice())
        .unwrap_or_default();
    for (n, (rung, _)) in rungs.iter().enumerate() {
        let shares = report.balls.iter().map(|row| format!("{:>8.3}", row.sent_out[n].1));
        text += &format!("{rung:<18}{}\n", shares.collect::<String>());
    }
    text
}

fn table(report: &Report) -> String {
    let short = if report.quick { ", small and short" } else { "" };
    let mut text = format!("welkin {} on {}{short}\n", report.version, report.device);
    for case in &report.cases {
        text += &format!("\n{}: {}\nerror: {}", case.case, case.what, case.error);
        if let Some(chance) = case.chance {
            text += &format!("; other random numbers alone make {chance:.3}");
        }
        text += "\n";
        text += &rows(case);
    }
    text
}

fn rows(case: &CaseReport) -> String {
    let head = [
        "LADDER",
        "RUNG",
        "ERROR",
        "MS A TICK",
        "M CELL STEPS/S",
        "SUBSTEPS",
        "DIVERGENCE 1/S",
        "PARETO",
    ];
    let lines = case.rows.iter().map(|row| {
        let number = |value: Option<f64>, digits: usize| value.map_or("-".to_owned(), |v| format!("{v:.digits$}"));
        [
            row.ladder.to_owned(),
            row.rung.clone(),
            row.failed.clone().unwrap_or_else(|| number(row.error, 4)),
            number(row.ms_per_tick, 2),
            number(row.cell_steps_per_s.map(|v| v / 1e6), 2),
            row.substeps.to_string(),
            row.divergence_max_per_s.map_or("-".to_owned(), |v| format!("{v:.1e}")),
            if row.pareto { "*".to_owned() } else { String::new() },
        ]
    });
    columns(
        std::iter::once(head.map(str::to_owned)).chain(lines).collect(),
        [false, false, true, true, true, true, true, false],
    )
}
