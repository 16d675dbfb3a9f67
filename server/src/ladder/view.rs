//! The ladder of view sampling measured: pictures of which not every pixel is marched against whole ones, at rest and from a camera that moves.
//!
//! Two parts, on the CPU device. Single pictures: the ladder of light's scenes at the page's size, by half resolution and whole in turns. Streams: a field of cumulus that the wind
//! carries, seen by a camera that rests, turns or flies through it, gently and fast; each rung sees picture after picture with its history, and each of them is held against the whole
//! one of that moment (`every_pixel`, which is what accuracy `reference` draws). What reuse leaves behind is small beside the whole picture and hides in its mean. So it is looked for where it is: in
//! the pixels whose cloud has come, gone or changed its distance since the last whole picture (ghosts, places that come into sight), and in the worst thousandth of all.

use std::time::Instant;

use serde::Serialize;
use welkin_shaders::CloudVolume;
use welkin_shaders::catalogue::Rung;
use welkin_shaders::cpu::view::layers::Layer;
use welkin_shaders::cpu::view::reproject::History;
use welkin_shaders::cpu::view::{Prepared, ViewSampling, ViewSettings, layers, radiance, render_live};

use super::LadderError;
use super::light::{flip, scenes, times};
use crate::clouds::{cumulus_field, settings};

/// Radiance is cut at so many times the truth's mean: the sun's disc alone would be all there is.
const CUT: f64 = 20.0;
/// A pixel's cloud has jumped where its opacity is another by so much, or where so opaque a cloud is so many times as far as the one before it, or as near.
const OPACITY_JUMP: f32 = 0.2;
const DISTANCE_JUMP: f32 = 1.25;
/// Pictures a second of a stream, and how fast the wind carries the clouds, m/s.
const STREAM_PER_S: f32 = 10.0;
const WIND_M_S: [f32; 3] = [7.0, -3.0, 0.0];

/// How the ladder is to be measured.
pub struct ViewContext<'a> {
    /// Smaller pictures and shorter streams.
    pub quick: bool,
    /// Told what is running and how far it is, from 0 to 1; `false` ends it.
    pub progress: &'a dyn Fn(&str, f64) -> bool,
}

/// A single picture at half the resolution.
#[derive(Clone, Debug, Serialize)]
pub struct StillRow {
    /// The scene.
    pub scene: &'static str,
    /// Root of the mean square difference of radiance from the whole picture's over its root mean square.
    pub error: f64,
    /// Mean FLIP.
    pub flip: f64,
    /// Largest difference of bytes that 99 in 100 stay within.
    pub bytes_99: u8,
    /// Rays marched, of one a pixel.
    pub rays: f64,
    /// Wall milliseconds of a picture that finds all made that a tick brings, the least of some.
    pub ms: f64,
    /// The same of one that brings a new tick: with all that is made anew then, stage by stage the least of three.
    pub new_tick_ms: f64,
    /// `ms` of the whole picture, which is what accuracy `reference` draws.
    pub whole_ms: f64,
    /// `new_tick_ms` of that.
    pub whole_new_tick_ms: f64,
}

/// A rung in a stream.
#[derive(Clone, Debug, Serialize)]
pub struct StreamRow {
    /// What the camera does.
    pub camera: &'static str,
    /// The rung.
    pub rung: &'static str,
    /// Mean over the pictures of the root of the mean square difference of bytes from the whole picture's, of 255.
    pub rms_bytes: f64,
    /// The worst picture's.
    pub rms_bytes_worst: f64,
    /// Mean FLIP of that one.
    pub flip_worst: f64,
    /// What the absolute difference of a pixel's worst byte stays within in 999 of 1000 pixels of all pictures.
    pub bytes_999: u8,
    /// As `rms_bytes`, but over the pixels of all pictures whose cloud has jumped since the last one.
    pub jumped_rms_bytes: f64,
    /// Share of pixels that have.
    pub jumped: f64,
    /// Rays marched after the first picture, of one a pixel.
    pub rays: f64,
    /// Mean wall milliseconds of a picture after the first.
    pub ms: f64,
}

/// Everything.
#[derive(Clone, Debug, Serialize)]
pub struct ViewReport {
    /// The program's version.
    pub version: &'static str,
    /// What computed.
    pub device: &'static str,
    /// Whether it was the small form.
    pub quick: bool,
    /// Pixels across and down.
    pub size: [usize; 2],
    /// Pictures of a stream, after the first.
    pub stream_pictures: usize,
    /// Single pictures.
    pub stills: Vec<StillRow>,
    /// Streams.
    pub streams: Vec<StreamRow>,
}

/// Measures. Errors: `Interrupted`.
pub fn view(context: &ViewContext) -> Result<ViewReport, LadderError> {
    let (size, pictures) = if context.quick {
        ([160, 90], 20)
    } else {
        ([640, 360], 24)
    };
    let mut stills = Vec::new();
    for picture in scenes::all(size[0], size[1]) {
        going_on(context, picture.name, 0.0)?;
        stills.push(still(picture.name, &picture.volume, &picture.settings));
    }
    let mut streams = Vec::new();
    for camera in CAMERAS {
        streams.extend(stream(context, camera, size, pictures)?);
    }
    Ok(ViewReport {
        version: env!("CARGO_PKG_VERSION"),
        device: "cpu",
        quick: context.quick,
        size,
        stream_pictures: pictures,
        stills,
        streams,
    })
}

fn going_on(context: &ViewContext, what: &str, share: f64) -> Result<(), LadderError> {
    match (context.progress)(what, share) {
        true => Ok(()),
        false => Err(LadderError::Interrupted),
    }
}

fn sampled(settings: &ViewSettings, sampling: ViewSampling) -> ViewSettings {
    ViewSettings { sampling, ..*settings }
}

fn still(scene: &'static str, volume: &CloudVolume, settings: &ViewSettings) -> StillRow {
    const TIMES: usize = 4;
    let mut prepared = Prepared::new();
    let ways = [ViewSampling::EveryPixel, ViewSampling::HalfResolution].map(|way| sampled(settings, way));
    let [whole, ours] = ways.map(|way| radiance(Some(volume), &way, &mut prepared));
    let pixels = settings.width * settings.height;
    let rays = prepared.marched() as f64 / pixels as f64;
    let mut least_ms = [f64::INFINITY; 2];
    let mut bytes = [Vec::new(), Vec::new()];
    for _ in 0..TIMES {
        for (n, way) in ways.iter().enumerate() {
            let began = Instant::now();
            bytes[n] = render_live(Some(volume), way, &mut History::default(), &mut prepared, &mut |_| {});
            least_ms[n] = least_ms[n].min(began.elapsed().as_secs_f64() * 1e3);
        }
    }
    let mean = whole.iter().flatten().map(|v| f64::from(*v)).sum::<f64>() / (3 * pixels) as f64;
    let cut = |v: &f32| f64::from(*v).min(CUT * mean);
    let pairs = || ours.iter().flatten().zip(whole.iter().flatten());
    let apart: f64 = pairs().map(|(a, b)| (cut(a) - cut(b)).powi(2)).sum();
    let mut differences: Vec<u8> = bytes[0].iter().zip(&bytes[1]).map(|(a, b)| a.abs_diff(*b)).collect();
    differences.sort_unstable();
    let [whole_new_tick_ms, new_tick_ms] = ways.map(|way| {
        let times = times(volume, &way, &mut prepared);
        times.march_ms[0] + times.stages_ms.iter().map(|(_, ms)| ms[0]).sum::<f64>()
    });
    StillRow {
        scene,
        error: (apart / pairs().map(|(_, b)| cut(b).powi(2)).sum::<f64>()).sqrt(),
        flip: flip(&bytes[1], &bytes[0], settings.width),
        bytes_99: differences[differences.len() * 99 / 100],
        rays,
        ms: least_ms[1],
        new_tick_ms,
        whole_ms: least_ms[0],
        whole_new_tick_ms,
    }
}

/// What cameras do: a name, degrees a second that they turn, and metres a second that they fly ahead.
const CAMERAS: [(&str, f32, f32); 5] = [
    ("rests", 0.0, 0.0),
    ("turns", 12.0, 0.0),
    ("flies", 0.0, 60.0),
    ("turns fast", 60.0, 0.0),
    ("flies fast", 0.0, 200.0),
];
const RUNGS: [(Rung, ViewSampling); 5] = [
    (Rung::Reproject16, ViewSampling::Reproject16),
    (Rung::Reproject4, ViewSampling::Reproject4),
    (Rung::Impostors, ViewSampling::Impostors),
    (Rung::HalfResolution, ViewSampling::HalfResolution),
    (Rung::EveryPixel, ViewSampling::EveryPixel),
];

/// Whether a pixel's cloud has jumped from one whole picture to the next.
fn has_jumped(before: &Layer, now: &Layer) -> bool {
    let [.., distance_before, opacity_before] = *before;
    let [.., distance_m, opacity] = *now;
    let farther = distance_m.max(distance_before) > DISTANCE_JUMP * distance_m.min(distance_before);
    (opacity - opacity_before).abs() > OPACITY_JUMP || (opacity.min(opacity_before) > OPACITY_JUMP && farther)
}

/// The least byte that so many of counted ones stay within.
fn quantile(counts: &[u64], share: f64) -> u8 {
    let wanted = share * counts.iter().sum::<u64>() as f64;
    let mut so_far = 0;
    let within = |count: &u64| {
        so_far += count;
        so_far as f64 >= wanted
    };
    counts.iter().position(within).unwrap_or_default() as u8
}

/// What one rung has seen so far.
#[derive(Default)]
struct Viewer {
    prepared: Prepared,
    history: History,
    rms: Vec<f64>,
    /// How many pixels' worst byte differed by how much, from 0 to 255.
    counts: Vec<u64>,
    /// Sum of squares over the bytes of pixels that have jumped.
    jumped_square: f64,
    /// The worst picture so far, beside the whole one.
    worst: [Vec<u8>; 2],
    rays: u64,
    ms: f64,
}

fn stream(
    context: &ViewContext,
    (camera, turns_deg_s, flies_m_s): (&'static str, f32, f32),
    [width, height]: [usize; 2],
    pictures: usize,
) -> Result<Vec<StreamRow>, LadderError> {
    let mut volume = cumulus_field(7, 12);
    let mut view = settings(width, height);
    if flies_m_s > 0.0 {
        // Among the clouds, some of which it passes and one of which it enters.
        view.camera_position_m = [3000.0, -1500.0, 1100.0];
        view.elevation_deg = 0.0;
    }
    let still = volume.extinction_per_m.clone();
    let mut viewers: [Viewer; RUNGS.len()] = Default::default();
    let mut reference = Prepared::new();
    let mut last: Vec<Layer> = Vec::new();
    let mut all_jumped = 0usize;
    for picture in 0..=pictures {
        going_on(context, camera, picture as f64 / pictures as f64)?;
        let at_s = picture as f32 / STREAM_PER_S;
        blown(&mut volume, &still, at_s);
        let mut now = view;
        now.azimuth_deg += turns_deg_s * at_s;
        now.camera_position_m[1] += flies_m_s * at_s;
        let clouds = layers(Some(&volume), &now, None, &mut reference, &mut |_| {});
        let jumped: Vec<bool> = last.iter().zip(&clouds).map(|(a, b)| has_jumped(a, b)).collect();
        all_jumped += jumped.iter().filter(|j| **j).count();
        last = clouds;
        let mut whole = Vec::new();
        for ((_, sampling), viewer) in RUNGS.iter().zip(&mut viewers).rev() {
            let began = Instant::now();
            let Viewer { prepared, history, .. } = viewer;
            let drawn = render_live(Some(&volume), &sampled(&now, *sampling), history, prepared, &mut |_| {});
            let ms = began.elapsed().as_secs_f64() * 1e3;
            if *sampling == ViewSampling::EveryPixel {
                whole = drawn.clone();
            }
            if picture == 0 {
                continue;
            }
            viewer.ms += ms;
            viewer.rays += viewer.prepared.marched();
            let squares = drawn.iter().zip(&whole).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
            let rms = (squares.sum::<f64>() / whole.len() as f64).sqrt();
            viewer.counts.resize(256, 0);
            let pixels = drawn.chunks_exact(3).zip(whole.chunks_exact(3));
            for ((ours, truth), jumped) in pixels.zip(&jumped) {
                let apart = [0, 1, 2].map(|c| ours[c].abs_diff(truth[c]));
                viewer.counts[usize::from(apart.into_iter().max().unwrap_or(0))] += 1;
                if *jumped {
                    viewer.jumped_square += apart.iter().map(|d| f64::from(*d).powi(2)).sum::<f64>();
                }
            }
            if viewer.rms.iter().all(|before| *before < rms) {
                viewer.worst = [drawn, whole.clone()];
            }
            viewer.rms.push(rms);
        }
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let worst = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    let rows = RUNGS.iter().zip(&viewers).map(|((rung, _), viewer)| StreamRow {
        camera,
        rung: rung.info().name,
        rms_bytes: mean(&viewer.rms),
        rms_bytes_worst: worst(&viewer.rms),
        flip_worst: flip(&viewer.worst[0], &viewer.worst[1], width),
        bytes_999: quantile(&viewer.counts, 0.999),
        jumped_rms_bytes: (viewer.jumped_square / (3 * all_jumped).max(1) as f64).sqrt(),
        jumped: all_jumped as f64 / (pictures * width * height) as f64,
        rays: viewer.rays as f64 / (pictures * width * height) as f64,
        ms: viewer.ms / pictures as f64,
    });
    Ok(rows.collect())
}

/// The clouds as the wind has carried them after so many seconds, linear between cells; one new volume a second, as worlds publish it, with how far the air has moved by then.
fn blown(volume: &mut CloudVolume, still: &[f32], at_s: f32) {
    let tick_s = at_s.floor();
    let moved = WIND_M_S.map(|w| w * tick_s);
    if moved == volume.air_displacement_m && tick_s > 0.0 {
        return;
    }
    let grid = volume.grid;
    let [nx, ny, nz] = grid.cells;
    let shift = [0, 1].map(|a| (moved[a] / grid.cell_size_m[a]).rem_euclid(grid.cells[a] as f32));
    let [whole_x, whole_y] = shift.map(|s| s as usize);
    let [fx, fy] = shift.map(f32::fract);
    for k in 0..nz {
        for j in 0..ny {
            for i in 0..nx {
                let at = |back_x: usize, back_y: usize| {
                    let x = (i + 2 * nx - whole_x - back_x) % nx;
                    let y = (j + 2 * ny - whole_y - back_y) % ny;
                    still[grid.index(x, y, k)]
                };
                let south = at(0, 1) * (1.0 - fx) + at(1, 1) * fx;
                let north = at(0, 0) * (1.0 - fx) + at(1, 0) * fx;
                volume.extinction_per_m[grid.index(i, j, k)] = south * fy + north * (1.0 - fy);
            }
        }
    }
    volume.air_displacement_m = moved;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clouds_jump_where_they_come_go_or_change_their_distance() {
        let layer = |distance_m: f32, opacity: f32| [0.0, 0.0, 0.0, 1.0 - opacity, distance_m, opacity];
        for (before, now, jumps) in [
            (layer(0.0, 0.0), layer(2000.0, 0.5), true),
            (layer(2000.0, 0.5), layer(0.0, 0.0), true),
            (layer(2000.0, 0.9), layer(2600.0, 0.9), true),
            (layer(2600.0, 0.9), layer(2000.0, 0.9), true),
            (layer(2000.0, 0.9), layer(2300.0, 0.8), false),
            (layer(2000.0, 0.1), layer(9000.0, 0.15), false),
            (layer(0.0, 0.0), layer(0.0, 0.0), false),
        ] {
            assert_eq!(has_jumped(&before, &now), jumps, "{before:?} {now:?}");
        }
    }

    #[test]
    fn a_thousandth_of_the_pixels_lies_beyond() {
        let mut counts = vec![0u64; 256];
        (counts[0], counts[7], counts[200]) = (990, 9, 1);
        assert_eq!(quantile(&counts, 0.999), 7);
        counts[200] = 2;
        assert_eq!(quantile(&counts, 0.999), 200);
        assert_eq!(quantile(&[], 0.999), 0);
    }
}
