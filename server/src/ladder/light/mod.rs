//! The ladder of light measured: every rung's pictures against the path tracer's, beside what they cost.
//!
//! The truth is the same cloud, sky, air and ground with paths traced in place of the march, and the same phase function. Rungs of the other ladders than scattering are also held
//! against the march by what their ladder calls exact (`rungs::exact`), with the scattering that all of them have, for the error of that would hide theirs. Measured on the
//! CPU device, which has every rung.
//!
//! Costs are what a viewer pays: a tick brings other cloud and a sun that has moved, so every rung is billed for all stages that are made anew then, whoever made them necessary.
//! Work that is the same for several rungs has one number, the least that any of them took ([`share`]), so that they stand apart by their own work only.

mod balls;
mod flip;
mod rungs;
pub(super) mod scenes;
mod slabs;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Serialize;
use welkin_proto::ApiError;
use welkin_proto::wire::FrameFormat;
use welkin_shaders::CloudVolume;
use welkin_shaders::cpu::light::path_tracer::Film;
use welkin_shaders::cpu::light::phase_table::PhaseChoice;
use welkin_shaders::cpu::view::{Prepared, ViewSettings, developed, path_trace, radiance, render_watched};
use welkin_shaders::gpu::view_stages::ShapeGrid;
use welkin_shaders::view::{Slab, fingerprint};

use super::{LadderError, keep, on_front};
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
    /// Told all that is known after each scene; an error ends it.
    pub measured: &'a dyn Fn(&LightReport) -> Result<(), LadderError>,
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
    /// Wall milliseconds of the march, the least of three; the same for rungs of a ladder that marches alike ([`share`]).
    pub march_ms: f64,
    /// Wall milliseconds of all that a tick makes anew for it: the sum of `tick_stages_ms`. The grid of optical depths is part of it for every rung, who has a map or
    /// marches towards the sun too: it holds how much of sky and ground each place sees, and the ground's shadow.
    pub sun_ms: f64,
    /// Its stages, each the least of three.
    pub tick_stages_ms: BTreeMap<&'static str, f64>,
    /// Of phase functions: wall milliseconds of making the march's tables of it, once in a world's life.
    pub once_ms: Option<f64>,
    /// Bytes that are kept for what the ladder is about.
    pub bytes: u64,
    /// Whether no other rung of the ladder is both cheaper (both times together) and nearer to the truth.
    pub pareto: bool,
}

impl LightRow {
    /// Milliseconds in all, and the error that its ladder is judged by.
    fn cost_and_error(&self) -> (f64, f64) {
        (self.march_ms + self.sun_ms, self.own_error.unwrap_or(self.error))
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
    /// Wall seconds that its paths took, in this run and in those that it was gone on from.
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

/// Measures. Errors: `Interrupted`, those of files, and what `measured` says.
pub fn light(context: &LightContext) -> Result<LightReport, LadderError> {
    let ([width, height], paths) = if context.quick { ([48, 27], 32) } else { ([128, 72], 96) };
    let mut report = LightReport {
        version: env!("CARGO_PKG_VERSION"),
        device: "cpu",
        quick: context.quick,
        scenes: Vec::new(),
        slabs: Vec::new(),
        balls: Vec::new(),
    };
    let goes_on = |what: &str| {
        (context.progress)(what, 0.0)
            .then_some(())
            .ok_or(LadderError::Interrupted)
    };
    for picture in scenes::all(width, height) {
        report.scenes.push(measure(context, &picture, paths)?);
        (context.measured)(&report)?;
    }
    goes_on("slabs")?;
    report.slabs = slabs::all(&SCATTERINGS);
    goes_on("balls")?;
    report.balls = balls::all(&SCATTERINGS);
    Ok(report)
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

/// A film as it is kept: its bytes, then the seconds that its paths have taken so far. A file of another length is no such film, and is traced anew.
fn kept_film(path: &Path, pixels: usize) -> Option<(Film, f64)> {
    let bytes = std::fs::read(path).ok()?;
    let (film, seconds) = bytes.split_last_chunk::<8>()?;
    Some((Film::from_bytes(pixels, film)?, f64::from_le_bytes(*seconds)))
}

fn measure(context: &LightContext, picture: &Picture, paths: u32) -> Result<LightScene, LadderError> {
    let Picture {
        name,
        what,
        volume,
        settings,
    } = picture;
    let mut prepared = Prepared::new();
    let kept = context.truths.map(|folder| truth_file(folder, picture));
    let pixels = settings.width * settings.height;
    let (mut film, mut truth_s) = kept
        .as_deref()
        .and_then(|path| kept_film(path, pixels))
        .unwrap_or_else(|| (Film::new(pixels), 0.0));
    while film.samples < paths {
        if !(context.progress)(
            &format!("{name}: the truth"),
            f64::from(film.samples) / f64::from(paths),
        ) {
            return Err(LadderError::Interrupted);
        }
        let batch = 16.min(paths - film.samples);
        let began = Instant::now();
        path_trace(Some(volume), settings, &mut prepared, 1.0, &mut film, batch);
        truth_s += began.elapsed().as_secs_f64();
        if let Some(path) = &kept {
            keep(path, &[film.to_bytes().as_slice(), &truth_s.to_le_bytes()].concat())?;
        }
    }
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
        let once_ms = (ladder == "phase").then(|| phase_ms(&timed, &mut prepared));
        let times = times(volume, &timed, &mut prepared);
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
            march_ms: times.march_ms[0],
            sun_ms: f64::NAN,
            tick_stages_ms: times.stages_ms.iter().map(|(stage, ms)| (*stage, ms[0])).collect(),
            once_ms,
            bytes: rungs::bytes_of(ladder, &settings.lighting, &grid),
            pareto: false,
        });
        pictures.push(bytes);
    }
    share(&mut rows);
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

/// The ladders whose rungs change what a stage has to do.
fn changed_by(stage: &str) -> &'static [&'static str] {
    match stage {
        "march" => &["scattering", "sun_occlusion", "view_steps"],
        "sky_table" | "sky_light" => &["sky"],
        "sun_map" => &["sun_occlusion"],
        "diffusion" | "octave_balance" | "slab_fit" | "slab_collector" => &["scattering", "phase"],
        _ => &[],
    }
}

/// Gives work that is the same for many rungs one number, the least that any of them took, and sums up the stages of a tick. A phase function or a sky is looked up in
/// tables of one size whatever made them, so that those ladders' rungs march alike.
fn share(rows: &mut [LightRow]) {
    fn shared(row: &mut LightRow) -> impl Iterator<Item = (&'static str, &mut f64)> {
        let ladder = row.ladder;
        let stages = row.tick_stages_ms.iter_mut().map(|(stage, ms)| (*stage, ms));
        let march = std::iter::once(("march", &mut row.march_ms));
        stages
            .chain(march)
            .filter(move |(stage, _)| !changed_by(stage).contains(&ladder))
    }
    let mut least_ms = BTreeMap::new();
    for (stage, ms) in rows.iter_mut().flat_map(shared) {
        let least = least_ms.entry(stage).or_insert(*ms);
        *least = least.min(*ms);
    }
    for (stage, ms) in rows.iter_mut().flat_map(shared) {
        *ms = least_ms[stage];
    }
    for row in rows {
        row.sun_ms = row.tick_stages_ms.values().sum();
    }
}

/// How often everything is timed.
const RUNS: usize = 3;

/// Wall milliseconds of a picture that brings a new tick, each with its runs in order, the least first.
pub(super) struct Times {
    /// The march.
    pub(super) march_ms: [f64; RUNS],
    /// Each stage that a tick makes anew.
    pub(super) stages_ms: Vec<(&'static str, [f64; RUNS])>,
}

/// Times a picture with all that is made anew where the cloud is another and the sun has moved. Tables of what no tick changes (air, noise, phase function) are there before the clock starts.
pub(super) fn times(volume: &CloudVolume, settings: &ViewSettings, prepared: &mut Prepared) -> Times {
    // A sun a degree away has all light made anew, a sky without cloud the cloud's shape.
    let mut away = *settings;
    away.sun_direction[1] += 0.02;
    [away.width, away.height] = [8, 8];
    let mut stages: Vec<(&'static str, [f64; RUNS])> = Vec::new();
    for run in 0..RUNS {
        for volume in [Some(volume), None] {
            render_watched(volume, &away, prepared, &mut |_| {});
        }
        let mut last = Instant::now();
        render_watched(Some(volume), settings, prepared, &mut |stage| {
            let ms = last.elapsed().as_secs_f64() * 1e3;
            last = Instant::now();
            match stages.iter_mut().find(|(name, _)| *name == stage) {
                Some((_, runs)) => runs[run] = ms,
                None => stages.push((stage, [ms; RUNS])),
            }
        });
    }
    for (_, runs) in &mut stages {
        runs.sort_by(f64::total_cmp);
    }
    let march = stages.iter().position(|(stage, _)| *stage == "march");
    Times {
        march_ms: march.map_or([f64::NAN; RUNS], |n| stages.remove(n).1),
        stages_ms: stages,
    }
}

/// Wall milliseconds of the march's tables of a view's phase function; another one is there before, so that they are made.
fn phase_ms(settings: &ViewSettings, prepared: &mut Prepared) -> f64 {
    let small = ViewSettings {
        width: 8,
        height: 8,
        ..*settings
    };
    let mut other = small;
    other.lighting.phase = PhaseChoice::HenyeyGreenstein { asymmetry: 0.5 };
    render_watched(None, &other, prepared, &mut |_| {});
    let (mut last, mut made_ms) = (Instant::now(), 0.0);
    render_watched(None, &small, prepared, &mut |stage| {
        if stage == "march_phase" {
            made_ms = last.elapsed().as_secs_f64() * 1e3;
        }
        last = Instant::now();
    });
    made_ms
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
                    "ms of the march and of all that a tick makes anew".to_owned(),
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

    /// A map or a march towards the sun spares nobody the grid, and what rungs share costs them the same.
    #[test]
    fn every_rung_pays_for_all_that_a_tick_makes() {
        let picture = &scenes::all(16, 9)[2];
        let mut prepared = Prepared::new();
        let ways = rungs::contenders(&picture.settings);
        let mut paid = |ladder: &str, rung: &str| {
            let way = ways.iter().find(|c| c.ladder == ladder && c.rung == rung).unwrap();
            let times = times(&picture.volume, &way.settings, &mut prepared);
            assert!(times.march_ms[0] > 0.0 && times.march_ms[0] <= times.march_ms[2]);
            times.stages_ms.iter().map(|(stage, _)| *stage).collect::<Vec<_>>()
        };
        let always = ["shape", "sky_visibility", "sky_table", "sky_light", "sun_optical_depth"];
        for (ladder, rung, own) in [
            ("scattering", "single", None),
            ("scattering", "slab", Some("slab_fit")),
            ("sun_occlusion", "secondary_march 4", Some("diffusion")),
            ("sun_occlusion", "beer_shadow_map 128", Some("sun_map")),
            ("phase", "rayleigh", Some("diffusion")),
        ] {
            let stages = paid(ladder, rung);
            for stage in always.into_iter().chain(own) {
                assert!(stages.contains(&stage), "{rung} lacks {stage}: {stages:?}");
            }
        }
        let row = |ladder, march_ms, grid_ms| LightRow {
            ladder,
            rung: String::new(),
            error: 0.0,
            own_error: None,
            flip: 0.0,
            brightness: 1.0,
            march_ms,
            sun_ms: f64::NAN,
            tick_stages_ms: [("sun_optical_depth", grid_ms)].into(),
            once_ms: None,
            bytes: 0,
            pareto: false,
        };
        let mut rows = [
            row("phase", 5.0, 3.0),
            row("sky", 4.0, 2.0),
            row("view_steps", 1.0, 2.5),
        ];
        share(&mut rows);
        assert_eq!(
            rows.map(|r| [r.march_ms, r.sun_ms]),
            [[4.0, 2.0], [4.0, 2.0], [1.0, 2.0]]
        );
    }
}
