//! The command line.

mod explain;
mod ladder;
mod render;
mod run;
mod serve;
mod tables;
mod validate;

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::{Args, CommandFactory, Parser, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use tracing_subscriber::EnvFilter;
use welkin_proto::scene::BaseState;
use welkin_proto::validate as judge;
use welkin_proto::{ApiError, Scene, presets};

use crate::bench::BenchOptions;
use crate::limits::Limits;
use crate::machine::{Compute, Machine};
use crate::priority;

/// Exit code of a command that Ctrl-C has ended, as shells expect it.
const INTERRUPTED: u8 = 130;
/// What is logged when nobody says otherwise.
const LOG_FILTER: &str = "warn,welkin_server=info";

const EXAMPLES: &str = "\
Examples:
  welkin                                         serve the default scene on http://127.0.0.1:8080/
  welkin serve --scene stratocumulus --listen 0.0.0.0:9000
  welkin serve --sounding omaha.txt              grow clouds from a real ascent
  welkin render warm-bubble -o bubble.png --at 15m --size 1280x720
  welkin render http://127.0.0.1:8080 -o live.png
  welkin run fair-weather-cumulus --until 2h --stats stats.csv
  welkin explain clear-sky-wind                  which passes run, why, and what each costs
  welkin scenes                                  the presets, one line each
  welkin validate --quick                        published cases, figures beside ours
  welkin ladder dynamics --quick                 what accuracy costs
  welkin tables --out slab-tables.bin            light in slabs of cloud, photon by photon
  welkin bench --json bench.json                 how fast this machine is
  welkin bench --device gpu                      how fast its GPU is, pass by pass
  welkin bench --beside gpu                      the same pictures on the CPU and on a GPU in turns

SCENE is a preset's name or the path of a JSON document. RUST_LOG sets what is logged.";

/// A shared, physically simulated sky as a service.
#[derive(Parser)]
#[command(name = "welkin", version, after_help = EXAMPLES, args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    serve: serve::Options,
}

#[derive(Subcommand)]
enum Command {
    /// Serve a live sky to browsers, games and dashboards (the default).
    #[command(after_help = serve::EXAMPLES)]
    Serve(serve::Options),
    /// Run a scene to a moment and write a picture of it.
    #[command(after_help = render::EXAMPLES)]
    Render(render::Options),
    /// Run a scene and write its numbers after every tick.
    #[command(after_help = run::EXAMPLES)]
    Run(run::Options),
    /// Show a scene's plan: passes, why each is there, fields with bytes, measured times.
    #[command(after_help = explain::EXAMPLES)]
    Explain(explain::Options),
    /// List the scene presets.
    Scenes,
    /// Print the JSON Schema of a scene.
    Schema,
    /// Run published cases and show each figure beside the published one.
    #[command(after_help = validate::EXAMPLES)]
    Validate(validate::Options),
    /// Measure the methods on a ladder: error beside cost.
    #[command(after_help = ladder::EXAMPLES)]
    Ladder(ladder::Options),
    /// Follow light through slabs of cloud and write the tables that `methods.scattering: slab` reads.
    #[command(after_help = tables::EXAMPLES)]
    Tables(tables::Options),
    /// Measure this machine: simulation and pictures, alone and together.
    #[command(after_help = crate::bench::EXAMPLES)]
    Bench(BenchOptions),
}

/// Flags of every command that runs a scene.
#[derive(Args, Clone)]
struct SceneFlags {
    /// Take the air from a radiosonde ascent (SPC or University of Wyoming text) in place of the scene's.
    #[arg(long, value_name = "FILE")]
    sounding: Option<PathBuf>,
    #[command(flatten)]
    machine: MachineFlags,
}

/// Flags of every command that computes.
#[derive(Args, Clone)]
struct MachineFlags {
    /// Worker threads; as many as the machine has cores unless given.
    #[arg(long, value_name = "N")]
    threads: Option<std::num::NonZeroUsize>,
    #[command(flatten)]
    device: DeviceFlag,
}

impl MachineFlags {
    /// What to compute on. Errors: an adapter that isn't there, with those that are.
    fn machine(&self) -> Result<Machine, Failure> {
        Ok(Machine {
            threads: self.threads.map(Into::into),
            compute: Compute::choose(&self.device.device)?,
        })
    }

    /// Gives rayon's shared pool, which the renderer runs on, the same number of threads, as nice as told.
    fn size_pool(&self, niceness: Option<i32>) {
        let builder = rayon::ThreadPoolBuilder::new().num_threads(self.threads.map_or(0, Into::into));
        let builder = match niceness {
            Some(niceness) => builder.start_handler(move |_| priority::step_back(niceness)),
            None => builder,
        };
        if let Err(error) = builder.build_global() {
            tracing::warn!(%error, "the renderer's threads are as they were");
        }
    }
}

/// The flag that chooses the device.
#[derive(Args, Clone, Debug)]
pub(crate) struct DeviceFlag {
    /// What to compute on: auto (a GPU if there is a real one, else the CPU), cpu, gpu (any adapter, software too), or a part of an
    /// adapter's name.
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    pub(crate) device: String,
}

impl SceneFlags {
    /// What to compute on. Errors: an adapter that isn't there, with those that are.
    fn machine(&self) -> Result<Machine, Failure> {
        self.machine.machine()
    }

    /// Loads a scene, with the sounding in place of its base state if one was given.
    fn load(&self, scene: &str, limits: &judge::Limits) -> Result<Scene, Failure> {
        let mut scene = load_scene(scene, limits)?;
        if let Some(path) = &self.sounding {
            scene.base_state = BaseState::Sounding { text: read_text(path)? };
            judge::validate(&scene, limits).map_err(|error| Failure(format!("{}: {error}", path.display())))?;
        }
        Ok(scene)
    }

    /// As [`MachineFlags::size_pool`].
    fn size_pool(&self, niceness: Option<i32>) {
        self.machine.size_pool(niceness);
    }
}

/// Why a command failed, for a person.
#[derive(Debug)]
struct Failure(String);

impl From<ApiError> for Failure {
    fn from(error: ApiError) -> Self {
        Self(error.to_string())
    }
}

/// How a command ended, when it did not fail.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Outcome {
    Done,
    Interrupted,
}

/// Runs the command line `args` (the program's name first). `log_filter` is `RUST_LOG`'s value.
pub fn run(args: impl IntoIterator<Item = OsString>, log_filter: Option<String>) -> ExitCode {
    let cli = match Cli::try_parse_from(args) {
        Ok(cli) => cli,
        Err(error) => {
            let _ = error.print(); // where even that fails there is nobody to tell
            return ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2));
        }
    };
    let filter = EnvFilter::try_new(log_filter.as_deref().unwrap_or(LOG_FILTER)).unwrap_or_else(|error| {
        eprintln!("welkin: RUST_LOG is not understood ({error}); using {LOG_FILTER}");
        EnvFilter::new(LOG_FILTER)
    });
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .init();
    let outcome = match cli.command {
        None => serve::run(cli.serve),
        Some(Command::Serve(options)) => serve::run(options),
        Some(Command::Render(options)) => render::run(options),
        Some(Command::Run(options)) => run::run(options),
        Some(Command::Explain(options)) => explain::run(options),
        Some(Command::Scenes) => scenes(),
        Some(Command::Schema) => schema(),
        Some(Command::Validate(options)) => validate::run(options),
        Some(Command::Ladder(options)) => ladder::run(options),
        Some(Command::Tables(options)) => tables::run(options),
        Some(Command::Bench(options)) => crate::bench::run(&options)
            .map(|()| Outcome::Done)
            .map_err(|error| Failure(error.to_string())),
    };
    match outcome {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Interrupted) => ExitCode::from(INTERRUPTED),
        Err(Failure(why)) => {
            eprintln!("welkin: {why}");
            ExitCode::FAILURE
        }
    }
}

fn scenes() -> Result<Outcome, Failure> {
    let scenes = crate::http::scene_list();
    let width = scenes.iter().map(|s| s.name.len()).max().unwrap_or_default();
    for scene in scenes {
        let mark = if scene.name == presets::DEFAULT {
            " (default)"
        } else {
            ""
        };
        print_line(&format!("{:width$}  {}{mark}", scene.name, scene.description))?;
    }
    Ok(Outcome::Done)
}

fn schema() -> Result<Outcome, Failure> {
    let text = serde_json::to_string_pretty(&judge::schema()).map_err(|error| Failure(error.to_string()))?;
    print_line(&text)?;
    Ok(Outcome::Done)
}

/// Prints a line; a reader that has left (`welkin schema | head`) is no failure worth a panic.
fn print_line(line: &str) -> Result<(), Failure> {
    use std::io::Write;
    writeln!(std::io::stdout(), "{line}").map_err(|error| Failure(format!("cannot write: {error}")))
}

/// A scene by preset name or file.
fn load_scene(scene: &str, limits: &judge::Limits) -> Result<Scene, Failure> {
    if presets::all().iter().any(|preset| preset.name == scene) {
        return Ok(presets::find(scene)?);
    }
    let path = Path::new(scene);
    if !path.exists() {
        let names = presets::all()
            .iter()
            .map(|preset| preset.name)
            .collect::<Vec<_>>()
            .join(", ");
        return Err(Failure(format!(
            "{scene:?} is neither a file nor a preset; the presets are {names}"
        )));
    }
    judge::parse_scene(&read_text(path)?, limits).map_err(|error| Failure(format!("{scene}: {error}")))
}

/// A file's text; bytes that are not UTF-8 are replaced, since old soundings carry odd degree signs.
fn read_text(path: &Path) -> Result<String, Failure> {
    let bytes = std::fs::read(path).map_err(|error| Failure(format!("cannot read {}: {error}", path.display())))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// Writes a file whole.
fn write_file(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    std::fs::write(path, bytes).map_err(|error| Failure(format!("cannot write {}: {error}", path.display())))
}

/// A folder, made if it is not there.
fn make_folder(path: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(path).map_err(|error| Failure(format!("cannot make {}: {error}", path.display())))
}

/// Seconds from `90s`, `10m`, `2h`, `1d` or a plain number of seconds.
fn duration_s(text: &str) -> Result<f64, String> {
    let wanted = || format!("{text:?} is not a duration; write it like 90s, 10m, 2h or 1d");
    let (number, unit_s) = match text.strip_suffix(|c: char| c.is_ascii_alphabetic()) {
        None => (text, 1.0),
        Some(number) if text.ends_with('s') => (number, 1.0),
        Some(number) if text.ends_with('m') => (number, 60.0),
        Some(number) if text.ends_with('h') => (number, 3600.0),
        Some(number) if text.ends_with('d') => (number, 86_400.0),
        Some(_) => return Err(wanted()),
    };
    let seconds = number.parse::<f64>().map_err(|_| wanted())? * unit_s;
    if (0.0..=1e8).contains(&seconds) {
        Ok(seconds)
    } else {
        Err(format!("{text:?} is out of range; allowed is 0 to 1e8 s"))
    }
}

/// A flag that Ctrl-C raises; a second Ctrl-C ends the process at once.
fn interrupt_flag() -> Arc<AtomicBool> {
    let flag = Arc::new(AtomicBool::new(false));
    let raised = flag.clone();
    let watch = move || {
        let runtime = match tokio::runtime::Builder::new_current_thread().enable_all().build() {
            Ok(runtime) => runtime,
            Err(error) => return tracing::warn!(%error, "Ctrl-C will end the process at once"),
        };
        runtime.block_on(async {
            while tokio::signal::ctrl_c().await.is_ok() {
                if raised.swap(true, Ordering::Relaxed) {
                    std::process::exit(INTERRUPTED.into());
                }
                eprintln!("\nstopping after this tick; Ctrl-C again ends at once");
            }
        });
    };
    if let Err(error) = std::thread::Builder::new().name("ctrl-c".into()).spawn(watch) {
        tracing::warn!(%error, "Ctrl-C will end the process at once");
    }
    flag
}

/// A bar over simulated seconds, on stderr; invisible where stderr is no terminal.
fn progress_bar(until_s: f64, what: &str) -> ProgressBar {
    let bar = ProgressBar::new(until_s.ceil() as u64);
    let template = "{msg} [{bar:40}] {pos}/{len} simulated s, {elapsed} gone, {eta} to go";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.set_message(what.to_owned());
    bar
}

/// Rows of text in columns as wide as their widest cell; numbers to the right.
fn columns<const N: usize>(rows: Vec<[String; N]>, right: [bool; N]) -> String {
    let widths: [usize; N] = std::array::from_fn(|c| rows.iter().map(|row| row[c].chars().count()).max().unwrap_or(0));
    let mut text = String::new();
    for row in &rows {
        let cells = row.iter().enumerate().map(|(c, cell)| {
            let width = widths[c];
            if right[c] {
                format!("{cell:>width$}")
            } else {
                format!("{cell:<width$}")
            }
        });
        text += cells.collect::<Vec<_>>().join("  ").trim_end();
        text += "\n";
    }
    text
}

/// The command line's definition, for tests and documents.
pub fn definition() -> clap::Command {
    Cli::command()
}

/// Limits of the command line where nobody is to be kept from anything: the scene's own ranges hold, nothing else.
fn own_limits() -> judge::Limits {
    judge::Limits {
        max_cells: u64::MAX,
        max_scene_bytes: usize::MAX,
        ..Limits::default().scene()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn definition_is_consistent() {
        definition().debug_assert();
    }

    #[test]
    fn durations_are_read_in_every_unit_and_refused_without_sense() {
        let good = [
            ("90s", 90.0),
            ("10m", 600.0),
            ("2h", 7200.0),
            ("1.5h", 5400.0),
            ("1d", 86_400.0),
            ("45", 45.0),
            ("0", 0.0),
        ];
        for (text, seconds) in good {
            assert_eq!(duration_s(text), Ok(seconds), "{text}");
        }
        for text in ["", "h", "-1s", "10 parsecs", "2w", "NaN", "inf", "1e9h", "ms", "5ms"] {
            assert!(duration_s(text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_scene_that_is_neither_preset_nor_file_is_refused_with_the_presets() {
        let Failure(why) = load_scene("no-such-scene", &own_limits()).unwrap_err();
        assert!(why.contains("no-such-scene") && why.contains(presets::DEFAULT), "{why}");
    }

    #[test]
    fn defaults_of_the_limits_are_those_of_the_flags() {
        let Cli { serve, .. } = Cli::try_parse_from(["welkin"]).unwrap();
        assert_eq!(format!("{:?}", serve.limits), format!("{:?}", Limits::default()));
        let Cli { command, .. } = Cli::try_parse_from(["welkin", "serve", "--max-worlds", "9"]).unwrap();
        let Some(Command::Serve(options)) = command else {
            panic!("serve was not understood")
        };
        assert_eq!(options.limits.worlds_max, 9);
    }
}
