//! `welkin render`.

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Instant;

use clap::Args;
use welkin_proto::wire::FrameFormat;
use welkin_proto::{Camera, validate};

use super::{
    Failure, Outcome, SceneFlags, duration_s, interrupt_flag, own_limits, print_line, progress_bar, write_file,
};
use crate::picture::{self, Renderer};
use crate::world::World;

pub(super) const EXAMPLES: &str = "\
Examples:
  welkin render fair-weather-cumulus -o sky.png
  welkin render warm-bubble -o bubble.jpg --at 15m --size 1920x1080
  welkin render my-scene.json -o up.webp --at 2h --position 3200,3200,2 --elevation 90 --fov 100";

/// Longest side of a picture, pixels: what a JPEG can hold.
const SIDE_MAX: u32 = 16_384;

#[derive(Args)]
pub(super) struct Options {
    /// A preset's name or the path of a JSON document.
    scene: String,
    /// File to write; its extension, png, jpg or webp, says the format.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Simulated time of the picture, such as 90s, 10m, 2h; the end of the scene's spin-up unless given.
    #[arg(long, value_name = "DURATION", value_parser = duration_s)]
    at: Option<f64>,
    /// Width and height in pixels.
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = size)]
    size: [u32; 2],
    /// Camera: metres east, north, up from the south-west corner; the scene's unless given.
    #[arg(long, value_name = "X,Y,Z", value_parser = position, allow_hyphen_values = true)]
    position: Option<[f64; 3]>,
    /// Camera: degrees clockwise from north.
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true)]
    azimuth: Option<f64>,
    /// Camera: degrees above the horizon.
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true)]
    elevation: Option<f64>,
    /// Camera: angle of view from bottom to top, degrees.
    #[arg(long, value_name = "DEGREES")]
    fov: Option<f64>,
    /// Exposure compensation, stops.
    #[arg(long, value_name = "STOPS", allow_hyphen_values = true)]
    exposure: Option<f64>,
    #[command(flatten)]
    flags: SceneFlags,
}

pub(super) fn run(options: Options) -> Result<Outcome, Failure> {
    let format = format_of(&options.output)?;
    options.flags.size_pool();
    let scene = options.flags.load(&options.scene, &own_limits())?;
    let base = &scene.camera;
    let camera = Camera {
        position_m: options.position.unwrap_or(base.position_m),
        azimuth_deg: options.azimuth.unwrap_or(base.azimuth_deg),
        elevation_deg: options.elevation.unwrap_or(base.elevation_deg),
        vertical_fov_deg: options.fov.unwrap_or(base.vertical_fov_deg),
        exposure_ev: options.exposure.unwrap_or(base.exposure_ev),
    };
    validate::camera(&camera, "")?;
    let until_s = options.at.unwrap_or(scene.time.spin_up_s);
    let interrupted = interrupt_flag();
    let began = Instant::now();
    let machine = options.flags.machine()?;
    let mut renderer = Renderer::new(&machine.compute);
    let mut world = World::new(scene, machine)?;
    let bar = progress_bar(until_s, "simulating");
    world.advance_to(until_s, |world| {
        bar.set_position(world.simulated_s() as u64);
        !interrupted.load(Ordering::Relaxed)
    });
    bar.finish_and_clear();
    if interrupted.load(Ordering::Relaxed) {
        return Ok(Outcome::Interrupted);
    }
    if let Some(error) = world.halted_error() {
        return Err(error.into());
    }
    let simulate_s = began.elapsed().as_secs_f64();
    let snapshot = world.snapshot();
    let [width, height] = options.size;
    let picture = renderer.render(&snapshot, world.scene(), &camera, width, height)?;
    write_file(&options.output, &picture::encode(&picture, format)?)?;
    print_line(&format!(
        "{}: {width}x{height} at simulated second {:.0}; simulated in {simulate_s:.1} s, rendered in {:.0} ms",
        options.output.display(),
        snapshot.numbers.simulated_s,
        picture.render_ms,
    ))?;
    Ok(Outcome::Done)
}

fn format_of(path: &std::path::Path) -> Result<FrameFormat, Failure> {
    match path
        .extension()
        .and_then(|e| e.to_str())
        .map(str::to_ascii_lowercase)
        .as_deref()
    {
        Some("png") => Ok(FrameFormat::Png),
        Some("jpg" | "jpeg") => Ok(FrameFormat::Jpeg),
        Some("webp") => Ok(FrameFormat::Webp),
        _ => Err(Failure(format!(
            "{}: the file's name must end in .png, .jpg or .webp",
            path.display()
        ))),
    }
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let wanted = || format!("{text:?} is not a size; write it like 1280x720");
    let (width, height) = text.split_once('x').ok_or_else(wanted)?;
    let sides = [
        width.parse::<u32>().map_err(|_| wanted())?,
        height.parse::<u32>().map_err(|_| wanted())?,
    ];
    if sides.iter().all(|side| (1..=SIDE_MAX).contains(side)) {
        Ok(sides)
    } else {
        Err(format!(
            "{text:?} is out of range; each side may have 1 to {SIDE_MAX} pixels"
        ))
    }
}

fn position(text: &str) -> Result<[f64; 3], String> {
    let wanted = || format!("{text:?} is not a position; write it like 3200,3200,2");
    let numbers = text
        .split(',')
        .map(|n| n.trim().parse::<f64>())
        .collect::<Result<Vec<_>, _>>()
        .map_err(|_| wanted())?;
    <[f64; 3]>::try_from(numbers).map_err(|_| wanted())
}
