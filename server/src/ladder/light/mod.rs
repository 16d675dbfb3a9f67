//! The ladder of light measured: every rung's pictures against the path tracer's, beside what they cost.
//!
//! The truth is the same cloud, sky, air and ground with paths traced in place of the march, and the same phase function. Rungs of the other ladders than scattering are also held
//! against the march by what their ladder calls exact (`rungs::exact`), with the scattering that all of them have, for the error of that would hide theirs. Measured on the
//! CPU device, which has every rung.

mod balls;
mod flip;
mod rungs;
pub(super) mod scenes;
mod slabs;

use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Serialize;
use welkin_proto::ApiError;
use welkin_proto::wire::FrameFormat;
use welkin_shaders::CloudVolume;
use welkin_shaders::cpu::light::path_tracer::Film;
use welkin_shaders::cpu::view::{
    Prepared, SunOcclusion, ViewSettings, developed, path_trace, radiance, render_watched,
};
use welkin_shaders::gpu::view_stages::ShapeGrid;
use welkin_shaders::view::{Slab, fingerprint};

use super::{LadderError, on_front};
use crate::picture;
use crate::plot::{self, Chart, Mark, Panel, PlotError, Series};
use rungs::{Contender, LADDERS, SCATTERINGS};
use scenes::Picture;

pub use balls::BallRow;
pub use flip::flip;
pub(super) use rungs::{exact, map, occluded, occlusion_name};
pub use slabs::SlabRow;

/// Radiance is cut at so many times the truth's mean: the sun's disc alone would be all there is.
const CUT: f64 = 20.0;

/// How the ladder is to be measured.
pub struct LightContext<'a> {
    /// Smaller pictures and fewer paths.
    pub quick: bool,
    /// Folder where traced pictures are kept and gone on with; what is interrupted loses nothing then.
    pub truths: Option<&'a Path>,
    /// Told what is running and how far it is, from 0 to 1; `false` ends it.
    pub progress: &'a dyn Fn(&str, f64) -> bool,
}

/// One rung on one scene.
#[derive(Clone, Debug, Serialize)]
pub struct LightRow {
    /// The ladder.
    pub ladder: &'static str,
    /// The rung with its settings.
    pub rung: String,
    /// Root of the mean square difference of radiance over the truth's root mean square, the truth's own noise taken off.
    pub error: f64,
    /// Of the other ladders: the same difference, over the same, from the march by what the ladder calls exact.
    pub own_error: Option<f64>,
    /// Mean FLIP against the truth's picture, its noise included.
    pub flip: f64,
    /// Mean radiance over the truth's.
    pub brightness: f64,
    /// Wall milliseconds of the march, the lesser of two runs.
    pub march_ms: f64,
    /// Wall milliseconds of what it needs once a tick. The grid of optical depths counts for who looks depths up in it; it is made for all, since it holds
    /// how much of sky and ground is seen.
    pub sun_ms: f64,
    /// Bytes that are kept for it.
    pub bytes: u64,
    /// Whether no other rung of the ladder is both cheaper (both times together) and nearer to the truth.
    pub pareto: bool,
}

impl LightRow {
    /// Milliseconds in all, and the error that its ladder is judged by.
    fn cost_and_error(&self) -> (f64, f64) {
        let sun_ms = if self.sun_ms.is_finite() { self.sun_ms } else { 0.0 };
        (self.march_ms + sun_ms, self.own_error.unwrap_or(self.error))
    }
}

/// All rungs on one scene.
#[derive(Clone, Debug, Serialize)]
pub struct LightScene {
    /// Its name.
    pub scene: &'static str,
    /// What is seen.
    pub what: &'static str,
    /// Pixels across and down.
    pub size: [usize; 2],
    /// Paths a pixel of the truth.
    pub paths: u32,
    /// The truth's standard error in the mean square, relative.
    pub truth_error: f64,
    /// Wall seconds that its paths took in this run.
    pub truth_s: f64,
    /// One a rung.
    pub rows: Vec<LightRow>,
    /// The truth and then each rung, RGB bytes.
    #[serde(skip)]
    pub pictures: Vec<Vec<u8>>,
}

/// Everything.
#[derive(Clone, Debug, Serialize)]
pub struct LightReport {
    /// The program's version.
    pub version: &'static str,
    /// What computed.
    pub device: &'static str,
    /// Whether it was the small form.
    pub quick: bool,
    /// The scenes.
    pub scenes: Vec<LightScene>,
    /// Reflectances of slabs.
    pub slabs: Vec<SlabRow>,
    /// What balls send out.
    pub balls: Vec<BallRow>,
}

/// Measures. Errors: `Interrupted`.
pub fn light(context: &LightContext) -> Result<LightReport, LadderError> {
    let ([width, height], paths) = if context.quick { ([48, 27], 32) } else { ([128, 72], 96) };
    let mut measured = Vec::new();
    for picture in scenes::all(width, height) {
        measured.push(measure(context, &picture, paths)?);
    }
    if !(context.progress)("slabs", 0.0) {
        return Err(LadderError::Interrupted);
    }
    Ok(LightReport {
        version: env!("CARGO_PKG_VERSION"),
        device: "cpu",
        quick: context.quick,
        scenes: measured,
        slabs: slabs::all(&SCATTERINGS),
        balls: balls::all(&SCATTERINGS),
    })
}

/// Goes up when the tracer or the world that it draws changes, so that what was kept before is not taken for the truth.
const TRACED: u32 = 2;

/// The file of a picture's traced paths. Its name holds all that they depend on, the program's version included.
fn truth_file(folder: &Path, picture: &Picture) -> PathBuf {
    let told = format!("{} {TRACED} {:?}", env!("CARGO_PKG_VERSION"), picture.settings);
    let hash = told.bytes().fold(fingerprint(&picture.volume), |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    folder.join(format!("{}-{hash:016x}.film", picture.name))
}

/// Writes a file whole or not at all.
fn keep(path: &Path, bytes: &[u8]) -> Result<(), LadderError> {
    let part = path.with_extension("part");
    std::fs::write(&part, bytes)
        .and_then(|()| std::fs::rename(&part, path))
        .map_err(|error| LadderError::Kept(path.display().to_string(), error))
}

fn measure(context: &LightContext, picture: &Picture, paths: u32) -> Result<LightScene, LadderError> {
    let Picture {
        name,
        what,
        volume,
        settings,
    } = picture;
    let began = Instant::now();
    let mut prepared = Prepared::new();
    let kept = context.truths.map(|folder| truth_file(folder, picture));
    let mut film = kept
        .as_deref()
        .and_then(|path| std::fs::read(path).ok())
        .and_then(|bytes| Film::from_bytes(settings.width * settings.height, &bytes))
        .unwrap_or_else(|| Film::new(settings.width * settings.height));
    while film.samples < paths {
        if !(context.progress)(
            &format!("{name}: the truth"),
            f64::from(film.samples) / f64::from(paths),
        ) {
            return Err(LadderError::Interrupted);
        }
        let batch = 16.min(paths - film.samples);
        path_trace(Some(volume), settings, &mut prepared, 1.0, &mut film, batch);
        if let Some(path) = &kept {
            keep(path, &film.to_bytes())?;
        }
    }
    let truth_s = began.elapsed().as_secs_f64();
    let truth = film.radiance();
    let as_floats: Vec<[f32; 3]> = truth.iter().map(|p| p.map(|v| v as f32)).collect();
    let truth_picture = developed(Some(volume), settings, &mut prepared, &as_floats);
    let count = 3.0 * truth.len() as f64;
    let mean = truth.iter().flatten().sum::<f64>() / count;
    let cut = |v: f64| v.min(CUT * mean);
    let square = truth.iter().flatten().map(|v| cut(*v).powi(2)).sum::<f64>();
    let shown = truth.iter().flatten().map(|v| cut(*v)).sum::<f64>();
    // Noise of what is cut away is cut away with it.
    let noise: f64 = truth
        .iter()
        .flatten()
        .zip(film.squared_error().iter().flatten())
        .map(|(v, e)| if *v < CUT * mean { *e } else { 0.0 })
        .sum();
    let grid = Slab::new(volume).map(|slab| ShapeGrid::new(&slab)).unwrap_or_default();
    let apart = |a: &[[f32; 3]], b: &mut dyn Iterator<Item = f64>| -> f64 {
        let pairs = a.iter().flatten().zip(b);
        pairs.map(|(a, b)| (cut(f64::from(*a)) - cut(b)).powi(2)).sum()
    };
    let exact = LADDERS.map(|ladder| rungs::exact(ladder, settings).map(|e| radiance(Some(volume), &e, &mut prepared)));
    let timed = if context.quick { [160, 90] } else { [320, 180] };
    let mut rows = Vec::new();
    let mut pictures = vec![truth_picture.clone()];
    for Contender { ladder, rung, settings } in rungs::contenders(settings) {
        if !(context.progress)(&format!("{name}: {rung}"), 1.0) {
            return Err(LadderError::Interrupted);
        }
        let ours = radiance(Some(volume), &settings, &mut prepared);
        let bytes = developed(Some(volume), &settings, &mut prepared, &ours);
        let timed = ViewSettings {
            width: timed[0],
            height: timed[1],
            ..settings
        };
        let (march_ms, sun_ms) = times(volume, &timed, &mut prepared);
        let from_truth = apart(&ours, &mut truth.iter().flatten().copied());
        let exact = LADDERS
            .iter()
            .zip(&exact)
            .find(|(name, _)| **name == ladder)
            .and_then(|(_, e)| e.as_ref());
        let from_exact = exact.map(|e| apart(&ours, &mut e.iter().flatten().map(|v| f64::from(*v))));
        rows.push(LightRow {
            ladder,
            rung,
            error: ((from_truth - noise).max(0.0) / square).sqrt(),
            own_error: from_exact.map(|e| (e / square).sqrt()),
            flip: flip(&bytes, &truth_picture, settings.width),
            brightness: ours.iter().flatten().map(|v| cut(f64::from(*v))).sum::<f64>() / shown,
            march_ms,
            sun_ms,
            bytes: rungs::bytes_of(ladder, &settings.lighting, &grid),
            pareto: false,
        });
        pictures.push(bytes);
    }
    for ladder in LADDERS {
        let points: Vec<Option<(f64, f64)>> = rows
            .iter()
            .map(|r| (r.ladder == ladder).then(|| r.cost_and_error()))
            .collect();
        for (row, on) in rows.iter_mut().zip(on_front(&points)) {
            row.pareto |= on;
        }
    }
    Ok(LightScene {
        scene: name,
        what,
        size: [settings.width, settings.height],
        paths: film.samples,
        truth_error: film.relative_error(),
        truth_s,
        rows,
        pictures,
    })
}

/// Milliseconds of a picture's march, the lesser of two, and of what it needs once a tick.
pub(super) fn times(volume: &CloudVolume, settings: &ViewSettings, prepared: &mut Prepared) -> (f64, f64) {
    // The sun a degree away has everything made anew.
    let mut away = *settings;
    away.sun_direction[1] += 0.02;
    [away.width, away.height] = [8, 8];
    render_watched(Some(volume), &away, prepared, &mut |_| {});
    let by_grid = settings.lighting.sun_occlusion == SunOcclusion::LightGrid;
    let (mut march, mut sun) = (f64::INFINITY, 0.0);
    for _ in 0..2 {
        let mut last = Instant::now();
        render_watched(Some(volume), settings, prepared, &mut |stage| {
            let ms = last.elapsed().as_secs_f64() * 1e3;
            last = Instant::now();
            match stage {
                "march" => march = march.min(ms),
                "sun_optical_depth" if by_grid => sun += ms,
                "sun_map" | "diffusion" | "slab_fit" | "slab_collector" => sun += ms,
                _ => {}
            }
        });
    }
    (march, sun)
}

/// Error beside milliseconds, a panel a scene and ladder. Errors: [`PlotError`].
pub fn png(report: &LightReport) -> Result<Vec<u8>, PlotError> {
    let mut panels = Vec::new();
    for scene in &report.scenes {
        for ladder in LADDERS {
            let rows = || scene.rows.iter().filter(|r| r.ladder == ladder);
            let point = |r: &LightRow| {
                let (ms, error) = r.cost_and_error();
                [ms, error.max(1e-3)]
            };
            let mut front: Vec<[f64; 2]> = rows().filter(|r| r.pareto).map(point).collect();
            front.sort_by(|a, b| a[0].total_cmp(&b[0]));
            let mut notes: Vec<([f64; 2], String)> = rows().map(|r| (point(r), r.rung.clone())).collect();
            notes.sort_by(|a, b| a.0[0].total_cmp(&b.0[0]));
            panels.push(Panel::Chart(Chart {
                title: format!("{}: {ladder}", scene.scene),
                axes: [
                    "ms of the march and of what it needs once a tick".to_owned(),
                    if ladder == LADDERS[0] {
                        "relative error of radiance".to_owned()
                    } else {
                        "the same by this alone".to_owned()
                    },
                ],
                log: [true, true],
                series: vec![
                    Series::line("", 0, rows().map(point).collect()).drawn(Mark::Dots),
                    Series::line("", 1, front.clone()).drawn(Mark::Rings),
                    Series::line("Pareto front", 1, front).drawn(Mark::Dashes),
                ],
                notes,
                legend: [false, true],
                ..Chart::default()
            }));
        }
    }
    plot::png(&panels, LADDERS.len(), [560, 400])
}

/// The pictures side by side as PNG, a row a scene: the truth first, then the rungs in the rows' order. Errors: `internal`.
pub fn contact_sheet(report: &LightReport) -> Result<Vec<u8>, ApiError> {
    let [width, height] = report.scenes.first().map_or([1, 1], |scene| scene.size);
    let across = report.scenes.first().map_or(1, |scene| scene.pictures.len()) * width;
    let mut sheet = vec![0u8; report.scenes.len() * height * across * 3];
    for (row, scene) in report.scenes.iter().enumerate() {
        for (column, picture) in scene.pictures.iter().enumerate() {
            for (y, line) in picture.chunks_exact(width * 3).enumerate() {
                let at = ((row * height + y) * across + column * width) * 3;
                sheet[at..at + width * 3].copy_from_slice(line);
            }
        }
    }
    let whole = picture::Picture {
        rgb8: sheet,
        width: across as u32,
        height: (report.scenes.len() * height) as u32,
        render_ms: 0.0,
    };
    picture::encode(&whole, FrameFormat::Png, true)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of isotropic scattering single scattering is known in closed form, so the march's slab must come near it: tau 1, sun and view in the
    /// zenith, radiance (1 - exp(-2 tau)) / (8 pi); the flux is compared with the same integrated over the hemisphere.
    #[test]
    fn slabs_of_the_march_are_as_they_must_be() {
        let rows = slabs::all(&SCATTERINGS);
        assert_eq!(rows.len(), 16);
        for row in &rows {
            let of = |name: &str| row.march.iter().find(|r| r.rung == name).unwrap();
            assert!(row.march.iter().all(|r| r.reflected > 0.0), "{row:?}");
            // Octaves bring what is left, but for few octaves in thick slabs: their factor is bounded. They turn back somewhat more than they should, for
            // their phase functions round faster than light's.
            for name in ["octaves 6", "octaves 8"] {
                assert!(of(name).in_all > 0.9, "{name}: {row:?}");
                assert!(
                    (of(name).reflected - row.discrete_ordinates).abs() < 0.15,
                    "{name}: {row:?}"
                );
            }
            assert!(of("diffusion").in_all > 0.93, "{row:?}");
            // None of these makes light; the rule of six directions and the march's steps are good to a hundredth or two.
            for (name, most) in [
                ("single", 1.02),
                ("multiple_forward", 1.02),
                ("octaves 2", 1.03),
                ("octaves 6", 1.03),
                ("octaves 8", 1.03),
                ("diffusion", 1.02),
                // The tables' own is 1.00; the balance of each cloud takes sums over points, good to a hundredth or two.
                ("slab", 1.03),
                ("slab_collector", 1.03),
            ] {
                assert!(of(name).in_all < most, "{name}: {row:?}");
            }
            // A slab is what slabs are fitted to; what is left are the tables' steps and the cloud's edge, smoothed over a level.
            for name in ["slab", "slab_collector"] {
                let ours = of(name).reflected;
                assert!((ours - row.discrete_ordinates).abs() < 0.04, "{name}: {row:?}");
            }
            // What diffuses is near to the truth wherever a slab is thick.
            if row.optical_depth >= 16.0 {
                let ours = of("diffusion").reflected;
                assert!((ours - row.discrete_ordinates).abs() < 0.1, "{row:?}");
            }
        }
        let first = &rows[0];
        // Integral over mu of mu / (2 (1 + mu)) (1 - exp(-(1 + 1 / mu))), 2000 steps.
        let truth: f64 = (0..2000)
            .map(|i| (f64::from(i) + 0.5) / 2000.0)
            .map(|mu| 0.5 * mu / (1.0 + mu) * (1.0 - (-(1.0 + 1.0 / mu)).exp()) / 2000.0)
            .sum();
        let ours = first.march[0].reflected;
        // Steps of 15 m in 1000 m, the 1 % at which rays end, and edges smoothed over a level.
        assert!((ours / truth - 1.0).abs() < 0.03, "{ours} {truth}");
    }
}
