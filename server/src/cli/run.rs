//! `welkin run`.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Instant;

use clap::Args;
use serde_json::{Value, json};
use welkin_proto::wire::Numbers;

use super::{
    Failure, Outcome, SceneFlags, duration_s, interrupt_flag, own_limits, print_line, progress_bar, write_file,
};
use crate::world::World;

pub(super) const EXAMPLES: &str = "\
Examples:
  welkin run fair-weather-cumulus --until 2h --stats stats.csv
  welkin run my-scene.json --until 30m --stats stats.json --sounding omaha.txt";

/// Numbers that mean something only where a clock paces the world or somebody looks at it, and prose, which the log has.
const LIVE_ONLY: [&str; 5] = ["frame_ms", "paused", "spinning_up", "time_scale", "trouble_message"];
/// Columns that come first in a CSV file.
const FIRST_COLUMNS: [&str; 3] = ["tick", "simulated_s", "utc"];

#[derive(Args)]
pub(super) struct Options {
    /// A preset's name or the path of a JSON document.
    scene: String,
    /// Simulated time to run to, such as 90s, 10m, 2h.
    #[arg(long, value_name = "DURATION", value_parser = duration_s)]
    until: f64,
    /// File for the numbers after every tick; its extension, csv or json, says the form.
    #[arg(long, value_name = "FILE")]
    stats: Option<PathBuf>,
    #[command(flatten)]
    flags: SceneFlags,
}

#[derive(Clone, Copy)]
enum Form {
    Csv,
    Json,
}

pub(super) fn run(options: Options) -> Result<Outcome, Failure> {
    // Before the work, not after it: a name that says nothing, or a folder that is not there.
    let form = options.stats.as_deref().map(form_of).transpose()?;
    let stats = options.stats.as_deref().zip(form);
    if let Some((path, _)) = stats {
        write_file(path, b"")?;
    }
    let scene = options.flags.load(&options.scene, &own_limits())?;
    let interrupted = interrupt_flag();
    let began = Instant::now();
    let mut world = World::new(scene, options.flags.machine()?)?;
    let bar = progress_bar(options.until, "simulating");
    let mut rows = Vec::new();
    while world.simulated_s() < options.until && !interrupted.load(Ordering::Relaxed) {
        world.advance_by(world.unwatched_tick_s().min(options.until - world.simulated_s()));
        let mut numbers = world.numbers();
        numbers.speed = numbers.simulated_s / began.elapsed().as_secs_f64();
        bar.set_position(numbers.simulated_s as u64);
        rows.push(row(&numbers)?);
        if let Some(error) = world.halted_error() {
            bar.abandon();
            return Err(error.into());
        }
    }
    bar.finish_and_clear();
    if let Some((path, form)) = stats {
        let text = match form {
            Form::Csv => csv(&rows),
            Form::Json => {
                let base_state = &world.base_state().report;
                let document = json!({ "scene": world.scene(), "base_state": base_state, "ticks": rows });
                serde_json::to_string_pretty(&document).map_err(|error| Failure(error.to_string()))?
            }
        };
        write_file(path, text.as_bytes())?;
    }
    let wall_s = began.elapsed().as_secs_f64();
    print_line(&format!(
        "{}: {} ticks in {wall_s:.1} s",
        world.scene().name,
        rows.len()
    ))?;
    if let Some(Value::Object(last)) = rows.last() {
        for (name, value) in last {
            print_line(&format!("  {name:<26} {}", cell(value)))?;
        }
    }
    Ok(if interrupted.load(Ordering::Relaxed) {
        Outcome::Interrupted
    } else {
        Outcome::Done
    })
}

fn form_of(path: &Path) -> Result<Form, Failure> {
    match path
        .extension()
        .and_then(|e| e.to_str())
        .map(str::to_ascii_lowercase)
        .as_deref()
    {
        Some("csv") => Ok(Form::Csv),
        Some("json") => Ok(Form::Json),
        _ => Err(Failure(format!(
            "{}: the file's name must end in .csv or .json",
            path.display()
        ))),
    }
}

fn row(numbers: &Numbers) -> Result<Value, Failure> {
    let mut row = serde_json::to_value(numbers).map_err(|error| Failure(error.to_string()))?;
    if let Value::Object(fields) = &mut row {
        for name in LIVE_ONLY {
            fields.remove(name);
        }
    }
    Ok(row)
}

/// Numbers and times only, so no cell needs quotes; what is absent is an empty cell.
fn csv(rows: &[Value]) -> String {
    let Some(Value::Object(first)) = rows.first() else {
        return String::new();
    };
    let rest = first
        .keys()
        .map(String::as_str)
        .filter(|name| !FIRST_COLUMNS.contains(name));
    let columns: Vec<&str> = FIRST_COLUMNS.into_iter().chain(rest).collect();
    let mut text = columns.join(",") + "\n";
    for row in rows {
        let cells = columns.iter().map(|name| cell(&row[*name])).collect::<Vec<_>>();
        text += &(cells.join(",") + "\n");
    }
    text
}

fn cell(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn csv_has_the_clock_first_and_empty_cells_for_what_is_absent() {
        let numbers = Numbers {
            tick: 3,
            simulated_s: 1.5,
            utc: "2026-06-21T16:00:01Z".into(),
            ..Default::default()
        };
        let text = csv(&[row(&numbers).unwrap()]);
        let lines: Vec<&str> = text.lines().collect();
        assert!(
            lines[0].starts_with("tick,simulated_s,utc,cloud_base_m,"),
            "{}",
            lines[0]
        );
        assert!(lines[1].starts_with("3,1.5,2026-06-21T16:00:01Z,,"), "{}", lines[1]);
        assert_eq!(lines[0].split(',').count(), lines[1].split(',').count());
        assert!(!lines[0].contains("paused"));
    }
}
