//! `welkin-client`: watches a live sky from a terminal.

mod command;

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use clap::{Parser, Subcommand, ValueEnum};
use command::Failure;
use futures_util::StreamExt;
use welkin_client::{Event, Frame, FrameWish, Next, Options, connect};
use welkin_proto::wire::{FrameFormat, HealthState, Numbers};

const EXAMPLES: &str = "Examples:
  welkin-client watch http://127.0.0.1:8080
  welkin-client watch http://127.0.0.1:8080 --save frames --fps 1 --for 10m
  welkin-client watch http://127.0.0.1:8080 --world w2 --json | jq .numbers.updraught_max_m_s
  welkin-client sample http://127.0.0.1:8080 --at 1600,1600,800 --at 1600,1600,900
  welkin-client sample http://127.0.0.1:8080 --at 0,0,500 --at 6000,0,500 --step 100 --json
  welkin-client volume http://127.0.0.1:8080 --channels extinction_per_m,wind_z_m_s --mip 2
  welkin-client record http://127.0.0.1:8080 sky.wlkr --for 1m
  welkin-client replay sky.wlkr --speed 10
  welkin-client load http://127.0.0.1:8080 --subscribers 100 --viewers 5 --each 10s";

/// A thin native client of a Welkin server.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Arguments {
    #[command(subcommand)]
    command: Subcommands,
}

#[derive(Subcommand)]
enum Subcommands {
    /// Print a world's numbers as they come, and save its frames if asked to; reconnects by itself.
    #[command(after_help = EXAMPLES)]
    Watch(Watch),
    /// Ask for the air at places, or along a path; once, or again and again.
    Sample(command::sample::Sample),
    /// Follow a world's volumes and print a line for each; reconnects by itself.
    Volume(command::volume::Volume),
    /// The same, and keep what comes in a file.
    Record(command::volume::Record),
    /// Play such a file as if its server were there.
    Replay(command::volume::Replay),
    /// Put many clients on a server of your own, and tell what it does to its ticks.
    Load(command::load::Load),
}

#[derive(clap::Args)]
struct Watch {
    /// The server, such as http://127.0.0.1:8080.
    url: String,
    /// The world's id; otherwise the server's first.
    #[arg(long, value_name = "ID")]
    world: Option<String>,
    /// Save frames in this directory, which is made if it is not there.
    #[arg(long, value_name = "DIR")]
    save: Option<PathBuf>,
    /// How frames are coded.
    #[arg(long, value_enum, default_value = "jpeg")]
    format: Format,
    /// Size of the frames in pixels.
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "640x360", value_parser = size)]
    size: (u32, u32),
    /// At most so many frames a second.
    #[arg(long, value_name = "N", default_value_t = 2.0, value_parser = rate)]
    fps: f64,
    /// End after so many frames.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    frames: Option<u64>,
    /// End after so long, such as 30s, 5m or 2h.
    #[arg(long = "for", value_name = "TIME", value_parser = duration)]
    duration: Option<Duration>,
    /// Print one JSON object a line instead of text.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Format {
    Jpeg,
    Png,
    Webp,
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let side = |text: &str| text.parse().ok().filter(|&pixels: &u32| pixels > 0);
    let sides = text
        .split_once(['x', 'X', '×'])
        .and_then(|(w, h)| Some((side(w)?, side(h)?)));
    sides.ok_or_else(|| "a size is two whole numbers above 0, such as 640x360".to_owned())
}

fn rate(text: &str) -> Result<f64, String> {
    let rate = text.parse().ok().filter(|&r: &f64| r.is_finite() && r > 0.0);
    rate.ok_or_else(|| "a rate is a number above 0".to_owned())
}

fn duration(text: &str) -> Result<Duration, String> {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit_s = match &text[digits.len()..] {
        "s" | "" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return Err("a time ends in s, m or h".to_owned()),
    };
    let seconds = digits
        .parse()
        .ok()
        .filter(|n: &f64| n.is_finite() && *n > 0.0)
        .map(|n| n * unit_s);
    let time = seconds.and_then(|s| Duration::try_from_secs_f64(s).ok());
    time.ok_or_else(|| "a time is a number above 0 and a unit, such as 30s".to_owned())
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> ExitCode {
    let outcome = match Arguments::parse().command {
        Subcommands::Watch(arguments) => {
            let mut screen = Screen {
                live: !arguments.json && std::io::stdout().is_terminal(),
                json: arguments.json,
                width: 0,
            };
            let outcome = watch(&arguments, &mut screen).await;
            screen.end_line();
            outcome
        }
        Subcommands::Sample(arguments) => command::sample::sample(&arguments).await,
        Subcommands::Volume(arguments) => command::volume::volume(&arguments).await,
        Subcommands::Record(arguments) => command::volume::record(&arguments).await,
        Subcommands::Replay(arguments) => command::volume::play(&arguments).await,
        Subcommands::Load(arguments) => command::load::load(&arguments).await,
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(problem) => {
            eprintln!("welkin-client: {problem}");
            ExitCode::FAILURE
        }
    }
}

async fn watch(arguments: &Watch, screen: &mut Screen) -> Result<(), Failure> {
    let wants_frames = arguments.save.is_some() || arguments.frames.is_some();
    let (width, height) = arguments.size;
    let format = match arguments.format {
        Format::Jpeg => FrameFormat::Jpeg,
        Format::Png => FrameFormat::Png,
        Format::Webp => FrameFormat::Webp,
    };
    let wish = FrameWish {
        width,
        height,
        format,
        max_fps: arguments.fps,
        camera: None,
    };
    if let Some(directory) = &arguments.save {
        let failed = |source| Failure::Write {
            path: directory.clone(),
            source,
        };
        std::fs::create_dir_all(directory).map_err(failed)?;
    }
    let options = Options {
        world: arguments.world.clone(),
        frames: wants_frames.then_some(wish),
        ..Options::default()
    };
    let mut events = connect(&arguments.url, options)?;
    let over = async {
        match arguments.duration {
            Some(duration) => tokio::time::sleep(duration).await,
            None => std::future::pending().await,
        }
    };
    tokio::pin!(over);
    let mut frames = 0;
    loop {
        let event = tokio::select! {
            event = events.next() => event,
            () = &mut over => return Ok(()),
            _ = tokio::signal::ctrl_c() => return Ok(()),
        };
        let Some(event) = event else { return Ok(()) };
        let event = match event {
            Event::Error {
                error,
                next: Next::Ends,
            } => return Err(error.into()),
            other => other,
        };
        match screen.show(&event) {
            // The reader of a pipe that has seen enough is no failure.
            Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => return Ok(()),
            shown => shown.map_err(Failure::Print)?,
        }
        if let Event::Frame(frame) = event {
            if let Some(directory) = &arguments.save {
                save(directory, &frame, frames)?;
            }
            frames += 1;
            if arguments.frames.is_some_and(|most| frames >= most) {
                return Ok(());
            }
        }
    }
}

/// Writes `frame-<tick>-<number>.<format>`, under another name first, so that nobody ever sees half a picture.
fn save(directory: &Path, frame: &Frame, number: u64) -> Result<(), Failure> {
    let extension = match frame.header.format {
        FrameFormat::Jpeg => "jpg",
        FrameFormat::Png => "png",
        FrameFormat::Webp => "webp",
    };
    let name = format!("frame-{:08}-{number:06}.{extension}", frame.header.tick);
    let path = directory.join(&name);
    let part = directory.join(format!(".{name}.part"));
    let written = std::fs::write(&part, &frame.image).and_then(|()| std::fs::rename(&part, &path));
    written.map_err(|source| {
        // What is half written is of no use; if it cannot be removed either, the first error says why.
        let _ = std::fs::remove_file(&part);
        Failure::Write { path, source }
    })
}

/// Standard output: one line that is written over where a person looks at it, a line an event otherwise.
struct Screen {
    live: bool,
    json: bool,
    /// Characters on the live line.
    width: usize,
}

impl Screen {
    fn show(&mut self, event: &Event) -> std::io::Result<()> {
        if self.json {
            return match json_line(event) {
                Some(line) => writeln!(std::io::stdout(), "{line}"),
                None => Ok(()),
            };
        }
        match event {
            Event::Hello(hello) => {
                let [x, y, z] = hello.cells;
                let (scene, world, server) = (&hello.scene, &hello.world, &hello.server);
                self.line(&format!(
                    "{scene}: world {world}, {x} x {y} x {z} cells, server {server}"
                ))
            }
            Event::Tick(numbers) if self.live => self.rewrite(&summary(numbers)),
            Event::Tick(numbers) => self.line(&summary(numbers)),
            Event::Frame(_) => Ok(()),
            Event::Error { error, next } => {
                self.end_line();
                eprintln!("welkin-client: {error}; {next}");
                Ok(())
            }
        }
    }

    fn line(&mut self, text: &str) -> std::io::Result<()> {
        self.end_line();
        writeln!(std::io::stdout(), "{text}")
    }

    fn rewrite(&mut self, text: &str) -> std::io::Result<()> {
        let mut out = std::io::stdout();
        // To the line's start, and blanks over what the longer line before has left.
        write!(out, "\r{text:<width$}", width = self.width)?;
        self.width = text.chars().count();
        out.flush()
    }

    fn end_line(&mut self) {
        if self.width > 0 {
            // Where the terminal is gone there is no line to end.
            let _ = writeln!(std::io::stdout());
            self.width = 0;
        }
    }
}

/// The numbers in one line.
fn summary(n: &Numbers) -> String {
    let or_dash = |value: Option<String>| value.unwrap_or_else(|| "-".to_owned());
    let state = match (n.paused, n.spinning_up) {
        (true, _) => "paused".to_owned(),
        (false, true) => format!("growing, {:.0}x real", n.speed),
        (false, false) => format!("{:.1}x real", n.speed),
    };
    format!(
        "tick {} | {} | {state} | {:.1} ms/tick | cover {} | base {} | top {} | water {} | updraught {:.1} m/s | wind {:.1} m/s",
        n.tick,
        n.utc,
        n.tick_ms,
        or_dash(n.cloud_cover.map(|v| format!("{:.1} %", 100.0 * v))),
        or_dash(n.cloud_base_m.map(|v| format!("{v:.0} m"))),
        or_dash(n.cloud_top_m.map(|v| format!("{v:.0} m"))),
        or_dash(n.liquid_water_path_kg_m2.map(|v| format!("{:.1} g/m2", 1000.0 * v))),
        n.updraught_max_m_s,
        n.wind_max_m_s,
    ) + &health(n)
}

/// What the watchdog says, where it has something to say.
fn health(n: &Numbers) -> String {
    let mut text = match (n.health, n.trouble_code.as_deref()) {
        (HealthState::Good, _) => String::new(),
        (state, code) => format!(
            " | {} ({})",
            state.name().to_uppercase(),
            code.unwrap_or("no reason given")
        ),
    };
    if n.retries > 0 {
        text += &format!(" | {} retries", n.retries);
    }
    text
}

/// An event as JSON, with the field names of the wire.
fn json_line(event: &Event) -> Option<String> {
    let value = match event {
        Event::Hello(h) => serde_json::json!({
            "type": "hello", "server": h.server, "world": h.world, "scene": h.scene,
            "cells": h.cells, "cell_size_m": h.cell_size_m, "camera": h.camera,
        }),
        Event::Tick(numbers) => serde_json::json!({ "type": "tick", "numbers": numbers }),
        Event::Frame(Frame { header: h, .. }) => serde_json::json!({
            "type": "frame", "format": h.format, "width": h.width, "height": h.height, "tick": h.tick,
            "simulated_s": h.simulated_s, "render_ms": h.render_ms, "encode_ms": h.encode_ms,
            "sequence": h.sequence, "image_bytes": h.image_bytes,
        }),
        Event::Error { error, next } => {
            let retry_in_s = match next {
                Next::RetryIn(pause) => Some(pause.as_secs_f64()),
                Next::GoesOn | Next::Ends => None,
            };
            serde_json::json!({ "type": "error", "message": error.to_string(), "retry_in_s": retry_in_s })
        }
    };
    serde_json::to_string(&value).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_tells_of_trouble_and_of_nothing_else() {
        let good = Numbers::default();
        assert_eq!(health(&good), "");
        let sick = Numbers {
            health: HealthState::Degraded,
            trouble_code: Some("not_finite".to_owned()),
            retries: 4,
            ..good
        };
        assert!(
            summary(&sick).ends_with(" | DEGRADED (not_finite) | 4 retries"),
            "{}",
            summary(&sick)
        );
    }

    #[test]
    fn sizes_and_times_are_read_or_refused() {
        assert_eq!(size("640x360"), Ok((640, 360)));
        for text in ["0x0", "640", "640x", "-1x5", "axb", "99999999999x1"] {
            assert!(size(text).is_err(), "{text} was taken");
        }
        assert_eq!(duration("30s"), Ok(Duration::from_secs(30)));
        assert_eq!(duration("1.5m"), Ok(Duration::from_secs(90)));
        assert_eq!(duration("2h"), Ok(Duration::from_secs(7200)));
        for text in ["", "s", "0s", "-1s", "NaNs", "infh", "5d", "1e300h"] {
            assert!(duration(text).is_err(), "{text} was taken");
        }
    }
}
