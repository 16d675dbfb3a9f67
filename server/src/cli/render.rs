//! `welkin render`.

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Instant;

use clap::Args;
use futures_util::StreamExt;
use welkin_client::volume::{VolumeEvent, VolumeOptions, subscribe};
use welkin_client::{ClientError, ServerUrl, get_json};
use welkin_proto::volume::subscribe::VolumeServerMessage;
use welkin_proto::wire::FrameFormat;
use welkin_proto::{Camera, validate};
use welkin_shaders::cpu::light::phase_table::PhaseChoice;

use super::{
    Failure, Outcome, SceneFlags, duration_s, interrupt_flag, own_limits, print_line, progress_bar, write_file,
};
use crate::http::WorldState;
use crate::live_sky;
use crate::picture::{self, Renderer};
use crate::world::World;

pub(super) const EXAMPLES: &str = "\
Examples:
  welkin render fair-weather-cumulus -o sky.png
  welkin render warm-bubble -o bubble.jpg --at 15m --size 1920x1080
  welkin render warm-bubble -o truth.png --at 15m --size 320x180 --paths 256
  welkin render my-scene.json -o up.webp --at 2h --position 3200,3200,2 --elevation 90 --fov 100
  welkin render http://127.0.0.1:8080 -o live.png      a live world as it is now, drawn on this machine";

/// Longest side of a picture, pixels: what a JPEG can hold.
const SIDE_MAX: u32 = 16_384;

/// Phase functions of traced pictures.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Phase {
    /// The fit of Jendersie and d'Eon for 18 micrometres.
    Droplets,
    /// Mie's, effective radius 9 micrometres.
    Mie,
    /// That of compact hexagonal crystals of ice.
    Ice,
    /// Henyey and Greenstein's, mean cosine 0.85.
    HenyeyGreenstein,
    /// Molecules', for comparison.
    Rayleigh,
}

impl Phase {
    fn choice(self) -> PhaseChoice {
        match self {
            Phase::Droplets => PhaseChoice::default(),
            Phase::Mie => PhaseChoice::Mie {
                effective_radius_um: 9.0,
            },
            Phase::Ice => PhaseChoice::Ice { aspect_ratio: 1.0 },
            Phase::HenyeyGreenstein => PhaseChoice::HenyeyGreenstein { asymmetry: 0.85 },
            Phase::Rayleigh => PhaseChoice::Rayleigh,
        }
    }
}

#[derive(Args)]
pub(super) struct Options {
    /// A preset's name, the path of a JSON document, or the address of a server whose first world is drawn on this machine from
    /// its volumes.
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
    /// Of a live world: its id; the server's first unless given.
    #[arg(long, value_name = "ID", conflicts_with_all = ["at", "sounding"])]
    world: Option<String>,
    /// Of a live world: fetch its cloud coarser by 2^mip along each edge.
    #[arg(long, value_name = "0..6", default_value_t = 0, conflicts_with_all = ["at", "sounding"])]
    mip: u8,
    /// Four rays a pixel, in four times the time.
    #[arg(long)]
    still: bool,
    /// Trace so many paths of light a pixel in place of the march: slow, on the CPU, and right but for the noise that is printed.
    #[arg(long, value_name = "N", conflicts_with = "still", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    paths: Option<u32>,
    /// How droplets turn the traced light; as the scene says unless given.
    #[arg(long, value_enum, requires = "paths")]
    phase: Option<Phase>,
    #[command(flatten)]
    flags: SceneFlags,
}

impl Options {
    /// The scene's camera with what was given in its place. Errors: `out_of_range`.
    fn camera(&self, base: &Camera) -> Result<Camera, Failure> {
        let camera = Camera {
            position_m: self.position.unwrap_or(base.position_m),
            azimuth_deg: self.azimuth.unwrap_or(base.azimuth_deg),
            elevation_deg: self.elevation.unwrap_or(base.elevation_deg),
            vertical_fov_deg: self.fov.unwrap_or(base.vertical_fov_deg),
            exposure_ev: self.exposure.unwrap_or(base.exposure_ev),
        };
        validate::camera(&camera, "")?;
        Ok(camera)
    }
}

pub(super) fn run(options: Options) -> Result<Outcome, Failure> {
    let format = format_of(&options.output)?;
    options.flags.size_pool(None);
    if options.scene.starts_with("http://") {
        if options.paths.is_some() {
            return Err(Failure(
                "paths are traced through a scene, not through a live world".to_owned(),
            ));
        }
        return live(&options, format);
    }
    let scene = options.flags.load(&options.scene, &own_limits())?;
    let camera = options.camera(&scene.camera)?;
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
    let (picture, how) = match options.paths {
        None => (
            renderer.render(&snapshot, world.scene(), &camera, options.size, options.still)?,
            String::new(),
        ),
        Some(paths) => {
            let mut settings = picture::settings(&snapshot, world.scene(), &camera, options.size.map(|n| n as usize));
            let bar = progress_bar(f64::from(paths), "tracing");
            if let Some(phase) = options.phase {
                settings.lighting.phase = phase.choice();
            }
            let traced = picture::path_trace(snapshot.volume.as_deref(), &settings, paths, &mut |done, error| {
                bar.set_position(u64::from(done));
                bar.set_message(format!("tracing, error {:.1} %", 100.0 * error));
                !interrupted.load(Ordering::Relaxed)
            });
            bar.finish_and_clear();
            if interrupted.load(Ordering::Relaxed) {
                return Ok(Outcome::Interrupted);
            }
            let error = 100.0 * traced.relative_error;
            let how = format!(", {paths} paths a pixel, relative error {error:.1} %");
            (traced.picture, how)
        }
    };
    write_file(&options.output, &picture::encode(&picture, format, options.still)?)?;
    print_line(&format!(
        "{}: {width}x{height} at simulated second {:.0}; simulated in {simulate_s:.1} s, rendered in {:.0} ms{how}",
        options.output.display(),
        snapshot.numbers.simulated_s,
        picture.render_ms,
    ))?;
    Ok(Outcome::Done)
}

/// Draws a live world on this machine, from one volume of its cloud.
fn live(options: &Options, format: FrameFormat) -> Result<Outcome, Failure> {
    let failed = |error: ClientError| Failure(error.to_string());
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime.map_err(|error| Failure(error.to_string()))?;
    let (world, field) = runtime.block_on(async {
        let server = ServerUrl::parse(&options.scene).map_err(failed)?;
        let volume_options = VolumeOptions {
            world: options.world.clone(),
            subscription: live_sky::subscription(options.mip),
            ..VolumeOptions::default()
        };
        let mut volumes = subscribe(&options.scene, volume_options).map_err(failed)?;
        let mut world = None;
        loop {
            match volumes.next().await {
                Some(VolumeEvent::Hello(VolumeServerMessage::Hello { world: id, .. })) => world = Some(id),
                Some(VolumeEvent::Hello(_) | VolumeEvent::Subscribed(_)) => {}
                Some(VolumeEvent::Error { error, .. }) => return Err(failed(error)),
                None => return Err(Failure("the server sent no volume".to_owned())),
                Some(VolumeEvent::Volume { field, .. }) => {
                    let path = format!("/v1/worlds/{}", world.unwrap_or_default());
                    let body = get_json(&server, &path).await.map_err(failed)?;
                    let state: WorldState = serde_json::from_slice(&body).map_err(|e| Failure(e.to_string()))?;
                    return Ok((state, field));
                }
            }
        }
    })?;
    let camera = options.camera(&world.scene.camera)?;
    let snapshot = live_sky::snapshot(&field, world.scene)?;
    let machine = options.flags.machine()?;
    let [width, height] = options.size;
    let picture =
        Renderer::new(&machine.compute).render(&snapshot, &snapshot.scene, &camera, options.size, options.still)?;
    write_file(&options.output, &picture::encode(&picture, format, options.still)?)?;
    print_line(&format!(
        "{}: {width}x{height} of world {} at simulated second {:.0}, drawn here in {:.0} ms",
        options.output.display(),
        world.id,
        field.moment.simulated_s,
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
