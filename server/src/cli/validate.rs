//! `welkin validate`.

use std::path::PathBuf;
use std::sync::atomic::Ordering;

use clap::Args;

use super::{
    Failure, MachineFlags, Outcome, columns, interrupt_flag, make_folder, print_line, progress_bar, write_file,
};
use crate::validate::{Aim, CASES, Case, Context, Figure, Report, ValidateError};

pub(super) const EXAMPLES: &str = "\
Examples:
  welkin validate --list                   the cases, one line each
  welkin validate dry-bubble               one case, figures beside the published ones
  welkin validate --quick                  all of them, coarser or shorter
  welkin validate --out results            all of them; JSON and plots into a folder

The exit code is 1 if a figure misses its aim.";

#[derive(Args)]
pub(super) struct Options {
    /// Cases to run; all unless given.
    #[arg(value_name = "CASE")]
    cases: Vec<String>,
    /// List the cases and run none.
    #[arg(long)]
    list: bool,
    /// Coarser or shorter runs.
    #[arg(long)]
    quick: bool,
    /// Folder for one JSON document and plots a case.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print the results as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    machine: MachineFlags,
}

pub(super) fn run(options: Options) -> Result<Outcome, Failure> {
    if options.list {
        let width = CASES.iter().map(|c| c.name.len()).max().unwrap_or_default();
        for case in CASES {
            print_line(&format!("{:width$}  {} ({})", case.name, case.what, case.source))?;
        }
        return Ok(Outcome::Done);
    }
    let cases = chosen(&options.cases)?;
    if let Some(folder) = &options.out {
        make_folder(folder)?;
    }
    let machine = options.machine.machine()?;
    let interrupted = interrupt_flag();
    let mut reports = Vec::new();
    for case in cases {
        let bar = progress_bar(1.0, case.name);
        let progress = |what: &str, done: f64, of: f64| {
            if bar.message() != what {
                bar.set_message(what.to_owned());
                bar.reset_eta();
            }
            bar.set_length(of as u64);
            bar.set_position(done as u64);
            !interrupted.load(Ordering::Relaxed)
        };
        let context = Context {
            quick: options.quick,
            machine: machine.clone(),
            progress: &progress,
        };
        let report = match case.run(&context) {
            Ok(report) => report,
            Err(ValidateError::Interrupted) => {
                bar.abandon();
                return Ok(Outcome::Interrupted);
            }
            Err(error) => {
                bar.abandon();
                return Err(Failure(format!("{}: {error}", case.name)));
            }
        };
        bar.finish_and_clear();
        if let Some(folder) = &options.out {
            let text = serde_json::to_string_pretty(&report).map_err(|error| Failure(error.to_string()))?;
            write_file(&folder.join(format!("{}.json", case.name)), text.as_bytes())?;
            for plot in &report.findings.plots {
                write_file(&folder.join(format!("{}.png", plot.name)), &plot.png)?;
            }
        }
        if !options.json {
            print_line(table(&report).trim_end())?;
        }
        reports.push(report);
    }
    if options.json {
        let text = serde_json::to_string_pretty(&reports).map_err(|error| Failure(error.to_string()))?;
        print_line(&text)?;
    }
    let missed: Vec<String> = reports
        .iter()
        .flat_map(|report| {
            report
                .missed()
                .map(|figure| format!("{}: {}", report.case, figure.what))
        })
        .collect();
    if missed.is_empty() {
        Ok(Outcome::Done)
    } else {
        Err(Failure(format!("these figures miss their aims: {}", missed.join("; "))))
    }
}

fn chosen(names: &[String]) -> Result<Vec<&'static Case>, Failure> {
    if names.is_empty() {
        return Ok(CASES.iter().collect());
    }
    names
        .iter()
        .map(|name| {
            CASES.iter().find(|case| case.name == name).ok_or_else(|| {
                let known = CASES.iter().map(|c| c.name).collect::<Vec<_>>().join(", ");
                Failure(format!("no case is named {name:?}; there are {known}"))
            })
        })
        .collect()
}

/// Four digits that count, or fewer where the number is short.
fn value(number: f64) -> String {
    if number == 0.0 {
        return "0".to_owned();
    }
    if number.abs() < 1e-3 {
        return format!("{number:.2e}");
    }
    let digits = (4 - number.abs().log10().floor() as i32 - 1).clamp(0, 4) as usize;
    format!("{number:.digits$}")
}

fn aim(figure: &Figure) -> String {
    match figure.aim {
        None => String::new(),
        Some(Aim::Within { distance }) => format!("within {}", value(distance)),
        Some(Aim::WithinShare { share }) => format!("within {} %", value(100.0 * share)),
        Some(Aim::Between { least, most }) => format!("{} to {}", value(least), value(most)),
    }
}

fn table(report: &Report) -> String {
    let short = if report.quick { ", short" } else { "" };
    let mut text = format!(
        "{}: {}\n{}; {:.1} s on {}{short}\n\n",
        report.case, report.what, report.source, report.wall_s, report.device
    );
    let head = ["FIGURE", "UNIT", "HERE", "PUBLISHED", "DIFFERENCE", "AIM", ""].map(str::to_owned);
    let rows = report.findings.figures.iter().map(|figure| {
        [
            figure.what.clone(),
            figure.unit.to_owned(),
            value(figure.ours),
            figure.published.map(value).unwrap_or_default(),
            figure.difference.map(value).unwrap_or_default(),
            aim(figure),
            match figure.met {
                Some(true) => "met".to_owned(),
                Some(false) => "MISSED".to_owned(),
                None => String::new(),
            },
        ]
    });
    text += &columns(
        std::iter::once(head).chain(rows).collect(),
        [false, false, true, true, true, false, false],
    );
    for note in &report.findings.notes {
        text += &format!("note: {note}\n");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_four_digits_long() {
        for (number, text) in [
            (15_537.0, "15537"),
            (-9.77, "-9.770"),
            (0.0, "0"),
            (3.2e-5, "3.20e-5"),
            (0.05, "0.0500"),
        ] {
            assert_eq!(value(number), text);
        }
    }

    #[test]
    fn an_unknown_case_is_refused_with_the_known_ones() {
        let Err(Failure(why)) = chosen(&["dry-bubble".to_owned(), "wet-bubble".to_owned()]) else {
            panic!("wet-bubble was taken")
        };
        assert!(why.contains("wet-bubble") && why.contains("moist-bubble"), "{why}");
        assert_eq!(chosen(&[]).unwrap().len(), CASES.len());
    }
}
