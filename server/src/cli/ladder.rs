//! `welkin ladder`.

use std::path::PathBuf;
use std::sync::atomic::Ordering;

use clap::{Args, ValueEnum};

use super::{
    Failure, MachineFlags, Outcome, columns, interrupt_flag, make_folder, print_line, progress_bar, write_file,
};
use crate::ladder::{self, CaseReport, Context, LadderError, Report};

pub(super) const EXAMPLES: &str = "\
Examples:
  welkin ladder dynamics --quick           every rung of advection, pressure and subgrid, small
  welkin ladder dynamics --out results     at full size; JSON, table and plot into a folder";

/// Which ladders.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Which {
    /// Advection, pressure, subgrid.
    Dynamics,
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
    /// Print the results as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    machine: MachineFlags,
}

pub(super) fn run(options: Options) -> Result<Outcome, Failure> {
    if let Some(folder) = &options.out {
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
    let context = Context {
        quick: options.quick,
        machine: options.machine.machine()?,
        progress: &progress,
    };
    let measured = match options.which {
        Which::Dynamics => ladder::dynamics(&context),
    };
    bar.finish_and_clear();
    let report = match measured {
        Ok(report) => report,
        Err(LadderError::Interrupted) => return Ok(Outcome::Interrupted),
        Err(error) => return Err(Failure(error.to_string())),
    };
    let json = serde_json::to_string_pretty(&report).map_err(|error| Failure(error.to_string()))?;
    let text = table(&report);
    if let Some(folder) = &options.out {
        let png = ladder::png(&report).map_err(|error| Failure(error.to_string()))?;
        for (name, bytes) in [
            ("ladder-dynamics.json", json.as_bytes()),
            ("ladder-dynamics.txt", text.as_bytes()),
            ("ladder-dynamics.png", &png),
        ] {
            write_file(&folder.join(name), bytes)?;
        }
    }
    print_line(if options.json { &json } else { text.trim_end() })?;
    Ok(Outcome::Done)
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
