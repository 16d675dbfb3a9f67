//! From a snapshot and a camera to coded pixels.

pub mod layers;
mod supersampling;

use std::sync::Arc;
use std::time::Instant;

use welkin_proto::scene::{self, Scene};
use welkin_proto::wire::{FrameFormat, PlanReport};
use welkin_proto::{ApiError, Camera};
use welkin_shaders::CloudVolume;
use welkin_shaders::cpu::light::analytic_sky::SkyMethod;
use welkin_shaders::cpu::light::path_tracer::Film;
use welkin_shaders::cpu::view as cpu_view;
use welkin_shaders::cpu::view::layers::Layer;
use welkin_shaders::cpu::view::reproject::History;
use welkin_shaders::cpu::view::{
    Detail, Ground, MoonPlace, Prepared, StarPlaces, ViewSampling, ViewSettings, render_live, render_watched,
};
use welkin_shaders::gpu::{GpuError, GpuHistory, GpuView};

use crate::machine::{Adapter, Compute, gpu_failure};
use crate::methods;
use crate::moon;
use crate::world::Snapshot;

/// Quality of JPEG pictures, 0 to 100.
const JPEG_QUALITY: u8 = 85;
/// The same of still pictures; from 90 on colours are coded as finely as brightness.
const JPEG_QUALITY_STILL: u8 = 95;
/// Rays along each side of a still picture's pixel.
pub const STILL_RAYS_A_SIDE: u32 = 2;

/// A rendered picture.
pub struct Picture {
    /// sRGB, three bytes a pixel, rows from the top.
    pub rgb8: Vec<u8>,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Wall milliseconds that it took.
    pub render_ms: f64,
}

/// What a viewer's last picture leaves to the next, where the device that draws keeps it.
#[derive(Debug, Default)]
pub struct LastPicture {
    host: History,
    gpu: GpuHistory,
}

impl LastPicture {
    /// Bytes that it holds, of either memory.
    pub fn bytes(&self) -> usize {
        self.host.bytes() + self.gpu.bytes() as usize
    }
    /// Forgets it: the next picture is marched whole.
    pub fn forget(&mut self) {
        self.host.forget();
        self.gpu.forget();
    }
}

/// Renders pictures of one world; keeps what pictures of the same tick or sky share.
pub struct Renderer {
    painter: Painter,
    stages: Vec<StageTime>,
}

/// What draws: the device that worlds compute on, never another in its place.
enum Painter {
    Cpu(Box<Prepared>),
    Gpu {
        adapter: Adapter,
        view: Option<Box<GpuView>>,
    },
}

impl Painter {
    fn paint(
        &mut self,
        volume: Option<&CloudVolume>,
        settings: &ViewSettings,
        last: Option<&mut LastPicture>,
        after: &mut dyn FnMut(&'static str),
    ) -> Result<Vec<u8>, ApiError> {
        match self {
            Painter::Cpu(prepared) => Ok(match last {
                Some(last) => render_live(volume, settings, &mut last.host, prepared, after),
                None => render_watched(volume, settings, prepared, after),
            }),
            Painter::Gpu { adapter, view } => on_gpu(adapter, view, |view| match last {
                Some(last) => view.render_live(volume, settings, &mut last.gpu, after),
                None => view.render(volume, settings, after),
            }),
        }
    }

    fn layers(
        &mut self,
        volume: Option<&CloudVolume>,
        settings: &ViewSettings,
        objects_m: Option<&[f32]>,
        after: &mut dyn FnMut(&'static str),
    ) -> Result<Vec<Layer>, ApiError> {
        match self {
            Painter::Cpu(prepared) => Ok(cpu_view::layers(volume, settings, objects_m, prepared, after)),
            Painter::Gpu { adapter, view } => {
                on_gpu(adapter, view, |view| view.layers(volume, settings, objects_m, after))
            }
        }
    }
}

/// Draws on the adapter as it is now, with what is kept for it.
fn on_gpu<T>(
    adapter: &Adapter,
    view: &mut Option<Box<GpuView>>,
    draw: impl FnOnce(&mut GpuView) -> Result<T, GpuError>,
) -> Result<T, ApiError> {
    let context = adapter.context();
    let made = match view.take() {
        Some(made) if Arc::ptr_eq(made.context(), &context) => Ok(made),
        _ => adapter.view_stages().and_then(GpuView::new).map(Box::new),
    };
    let painted = made.and_then(|mut made| {
        let drawn = draw(&mut made)?;
        *view = Some(made);
        Ok(drawn)
    });
    painted.map_err(|error| {
        // A device in trouble stays so: the next picture finds it opened again.
        if context.check().is_err()
            && let Err(error) = adapter.reopen(&context)
        {
            tracing::error!(%error, "the adapter cannot be opened again");
        }
        gpu_failure(&error)
    })
}

/// How often a stage of the view ran and how long it took in all.
#[derive(Clone, Copy, Debug)]
pub struct StageTime {
    stage: &'static str,
    runs: u64,
    total_ms: f64,
}

/// Puts measured times of the view's stages into a plan.
pub fn put_times(plan: &mut PlanReport, times: &[StageTime]) {
    for time in times {
        if let Some(pass) = plan.passes.iter_mut().find(|p| p.stage == time.stage) {
            pass.runs = time.runs;
            pass.mean_ms = Some(time.total_ms / time.runs as f64);
        }
    }
}

impl Renderer {
    /// Draws on that device; nothing is prepared yet.
    pub fn new(compute: &Compute) -> Self {
        Self {
            painter: match compute {
                Compute::Cpu => Painter::Cpu(Box::default()),
                Compute::Gpu(adapter) => Painter::Gpu {
                    adapter: adapter.clone(),
                    view: None,
                },
            },
            stages: Vec::new(),
        }
    }

    /// What the view's stages have cost so far.
    pub fn times(&self) -> &[StageTime] {
        &self.stages
    }

    /// Renders `size` pixels from `camera`, every one of them marched; `still` takes four rays a pixel. Errors: `out_of_range` for a picture of no or absurdly many pixels
    /// (callers set their own, lower limits); those of [`GpuError::code`].
    pub fn render(
        &mut self,
        snapshot: &Snapshot,
        scene: &Scene,
        camera: &Camera,
        size: [u32; 2],
        still: bool,
    ) -> Result<Picture, ApiError> {
        let begin = Instant::now();
        let rays = rays(size, if still { STILL_RAYS_A_SIDE } else { 1 })?;
        let settings = ViewSettings {
            sampling: ViewSampling::EveryPixel,
            ..settings(snapshot, scene, camera, rays)
        };
        let volume = snapshot.volume.as_deref();
        let rgb8 = self
            .painter
            .paint(volume, &settings, None, &mut counted(&mut self.stages))?;
        let rgb8 = if still {
            supersampling::mean_of_four(&rgb8, size.map(|pixels| pixels as usize))
        } else {
            rgb8
        };
        Ok(finished(rgb8, size, begin))
    }

    /// Renders the next picture of a viewer who sees one after another, by the scene's `view_sampling`; `last` is what the one before left. Errors: as of [`Renderer::render`].
    pub fn live(
        &mut self,
        snapshot: &Snapshot,
        scene: &Scene,
        camera: &Camera,
        size: [u32; 2],
        last: &mut LastPicture,
    ) -> Result<Picture, ApiError> {
        let begin = Instant::now();
        let settings = settings(snapshot, scene, camera, rays(size, 1)?);
        let volume = snapshot.volume.as_deref();
        let mut after = counted(&mut self.stages);
        let rgb8 = self.painter.paint(volume, &settings, Some(last), &mut after)?;
        Ok(finished(rgb8, size, begin))
    }

    /// Layers of such a picture; `objects_m` holds the distances of a client's objects, one a pixel, if it has any. Errors: as of [`Renderer::render`].
    pub fn layers(
        &mut self,
        snapshot: &Snapshot,
        scene: &Scene,
        camera: &Camera,
        size: [u32; 2],
        objects_m: Option<&[f32]>,
    ) -> Result<Vec<Layer>, ApiError> {
        let settings = settings(snapshot, scene, camera, rays(size, 1)?);
        let volume = snapshot.volume.as_deref();
        let mut after = counted(&mut self.stages);
        self.painter.layers(volume, &settings, objects_m, &mut after)
    }
}

fn finished(rgb8: Vec<u8>, [width, height]: [u32; 2], begin: Instant) -> Picture {
    Picture {
        rgb8,
        width,
        height,
        render_ms: begin.elapsed().as_secs_f64() * 1e3,
    }
}

/// The rays of a picture, `a_side` squared a pixel. Errors: `out_of_range` for none or absurdly many.
fn rays(size: [u32; 2], a_side: u32) -> Result<[usize; 2], ApiError> {
    const RAYS_MAX: u64 = 1 << 26;
    let [width, height] = size.map(|pixels| pixels as u64 * a_side as u64);
    if width == 0 || height == 0 || width.saturating_mul(height) > RAYS_MAX {
        return Err(ApiError::new(
            "out_of_range",
            format!("a picture of {width}x{height} rays is not between 1 and {RAYS_MAX}"),
        ));
    }
    Ok([width as usize, height as usize])
}

/// Takes the time of each stage that is named, from now on.
fn counted(stages: &mut Vec<StageTime>) -> impl FnMut(&'static str) {
    let mut last = Instant::now();
    move |stage| {
        let now = Instant::now();
        let ms = (now - last).as_secs_f64() * 1e3;
        last = now;
        match stages.iter_mut().find(|s| s.stage == stage) {
            Some(time) => {
                time.runs += 1;
                time.total_ms += ms;
            }
            None => stages.push(StageTime {
                stage,
                runs: 1,
                total_ms: ms,
            }),
        }
    }
}

/// What a picture of a snapshot is taken of and how: `size` is its rays.
pub fn settings(snapshot: &Snapshot, scene: &Scene, camera: &Camera, [width, height]: [usize; 2]) -> ViewSettings {
    let effects = &scene.effects;
    let unix_s = moon::start_unix_s(scene) + snapshot.numbers.simulated_s;
    ViewSettings {
        camera_position_m: camera.position_m.map(|c| c as f32),
        azimuth_deg: camera.azimuth_deg as f32,
        elevation_deg: camera.elevation_deg as f32,
        vertical_fov_deg: camera.vertical_fov_deg as f32,
        exposure_ev: camera.exposure_ev as f32,
        width,
        height,
        sun_direction: snapshot.sun_direction,
        detail: effects.cloud_detail.as_ref().map(|d| Detail {
            strength: d.strength as f32,
            scale_m: d.scale_m as f32,
        }),
        multiple_scattering_octaves: methods::octaves(scene),
        lighting: methods::lighting(scene),
        steps: methods::view_steps(scene),
        ground: match scene.domain.ground {
            scene::Ground::Land => Ground::Land,
            scene::Ground::Sea => Ground::Sea,
        },
        cloud_shadow: effects.cloud_shadow.is_some(),
        light_shafts: effects.light_shafts.as_ref().map_or(0, |s| s.samples),
        visibility_m: effects.aerial_perspective.as_ref().map(|a| a.visibility_m as f32),
        seed: scene.seed,
        surface_altitude_m: scene.domain.surface_altitude_m as f32,
        sky: match scene.methods.sky {
            Some(scene::Sky::Preetham) => SkyMethod::Preetham,
            Some(scene::Sky::HosekWilkie) => SkyMethod::HosekWilkie,
            Some(scene::Sky::ScatteringTables) | None => SkyMethod::ScatteringTables,
        },
        sampling: methods::view_sampling(scene),
        moon: moon::of_scene(scene, unix_s).map(|moon| MoonPlace {
            direction: moon::direction(&moon),
            distance_m: moon.distance_m as f32,
        }),
        stars: effects.stars.as_ref().map(|stars| {
            let sidereal = moon::sidereal_rad(unix_s, scene.domain.longitude_deg);
            StarPlaces {
                equatorial_from_world: moon::equatorial_from_world(sidereal, scene.domain.latitude_deg),
                years_since_2000: moon::years_since_2000(scene),
                faintest: stars.faintest_magnitude as f32,
            }
        }),
    }
}

/// A picture by traced paths, and how sure it is.
pub struct Traced {
    /// The picture.
    pub picture: Picture,
    /// Standard error of its pixels' radiance in the mean square, over their radiance in the mean square.
    pub relative_error: f64,
}

/// Traces `paths` paths a pixel (stage `path_tracer`, on the CPU whatever the worlds compute on). `progress` is told how many of them are done and the
/// relative error so far, and ends it by `false`. The pixels' number is the caller's to bound.
pub fn path_trace(
    volume: Option<&CloudVolume>,
    settings: &ViewSettings,
    paths: u32,
    progress: &mut dyn FnMut(u32, f64) -> bool,
) -> Traced {
    let begin = Instant::now();
    let mut prepared = Prepared::new();
    let mut film = Film::new(settings.width * settings.height);
    while film.samples < paths {
        let batch = 16.min(paths - film.samples);
        cpu_view::path_trace(volume, settings, &mut prepared, 1.0, &mut film, batch);
        if !progress(film.samples, film.relative_error()) {
            break;
        }
    }
    let radiance: Vec<[f32; 3]> = film.radiance().iter().map(|p| p.map(|v| v as f32)).collect();
    Traced {
        picture: Picture {
            rgb8: cpu_view::developed(volume, settings, &mut prepared, &radiance),
            width: settings.width as u32,
            height: settings.height as u32,
            render_ms: begin.elapsed().as_secs_f64() * 1e3,
        },
        relative_error: film.relative_error(),
    }
}

/// Codes a picture; a `still` one as JPEG more finely. Errors: `internal` where an encoder fails, and `out_of_range` for a JPEG of more than 65,535 pixels a side.
pub fn encode(picture: &Picture, format: FrameFormat, still: bool) -> Result<Vec<u8>, ApiError> {
    use image::ImageEncoder;
    use image::codecs::{png, webp};
    let failed = |e: image::ImageError| ApiError::new("internal", format!("the picture could not be coded: {e}"));
    let color = image::ExtendedColorType::Rgb8;
    let mut bytes = Vec::new();
    match format {
        FrameFormat::Jpeg => {
            let side = |n: u32| {
                u16::try_from(n).map_err(|_| {
                    ApiError::new(
                        "out_of_range",
                        format!("a JPEG has at most 65535 pixels a side, not {n}"),
                    )
                })
            };
            let quality = if still { JPEG_QUALITY_STILL } else { JPEG_QUALITY };
            jpeg_encoder::Encoder::new(&mut bytes, quality)
                .encode(
                    &picture.rgb8,
                    side(picture.width)?,
                    side(picture.height)?,
                    jpeg_encoder::ColorType::Rgb,
                )
                .map_err(|e| ApiError::new("internal", format!("the picture could not be coded: {e}")))?;
        }
        FrameFormat::Png => {
            png::PngEncoder::new_with_quality(&mut bytes, png::CompressionType::Fast, png::FilterType::Adaptive)
                .write_image(&picture.rgb8, picture.width, picture.height, color)
                .map_err(failed)?
        }
        FrameFormat::Webp => webp::WebPEncoder::new_lossless(&mut bytes)
            .write_image(&picture.rgb8, picture.width, picture.height, color)
            .map_err(failed)?,
    }
    Ok(bytes)
}
