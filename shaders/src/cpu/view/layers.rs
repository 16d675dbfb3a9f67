//! Stage `layers`: what a client needs to put objects into a picture.
//!
//! Reads: [`Frame`], and distances of the client's own objects (m along the ray of each pixel's centre; infinite where there is none), if it has any.
//! Writes six numbers a pixel ([`Layer`]): exposed light from before the object (before the tone map; 1 is white), the share of the object's own light that passes
//! cloud and air, the mean distance of the cloud (m) weighted by what it hides, its opacity. Scheme: the rays of stage `march`, each ended at its object, the last step cut
//! there so that an object within cloud shows no grain. An object behind the ground is behind it; where there is none the light is
//! the whole picture's and nothing passes. Every pixel is marched. Keeps: bit for bit the picture, where there is no object. Loses: an object throws no shadow on
//! cloud and is lit by none of it; one share stands for three colours (their mean).
//! Source: depth as in Schneider and Vos (2015); premultiplied light after Porter and Duff (1984).

use multiversion::multiversion;
use rayon::prelude::*;

use super::lanes::{LANES, Lanes};
use super::march::{Frame, PACKET_ROWS, Rays, behind, composed, composed_before, faded, met_before, pattern};
use super::tone_map::tone_map;

crate::constants! {
    /// Numbers of a pixel.
    pub const LAYER_NUMBERS: usize = 6;
}

/// Red, green and blue of exposed light; share of the light from behind that passes; mean distance of the cloud, m, 0 where there is none; its opacity.
pub type Layer = [f32; LAYER_NUMBERS];

const PACKET_COLUMNS: usize = LANES / PACKET_ROWS;

/// Layers of a picture, rows from the top; `objects_m` holds a distance a pixel.
pub(super) fn draw(frame: &Frame<'_>, objects_m: Option<&[f32]>) -> Vec<Layer> {
    let width = frame.width;
    let mut layers = vec![[0.0; LAYER_NUMBERS]; width * frame.height];
    layers
        .par_chunks_mut(PACKET_ROWS * width)
        .enumerate()
        .for_each(|(n, rows)| layer_rows(frame, objects_m, n * PACKET_ROWS, rows));
    layers
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn layer_rows(frame: &Frame<'_>, objects_m: Option<&[f32]>, first_row: usize, out: &mut [Layer]) {
    let (zero, one) = (Lanes::splat(0.0), Lanes::splat(1.0));
    let never = Lanes::splat(f32::MAX);
    let width = frame.width;
    for first_column in (0..width).step_by(PACKET_COLUMNS) {
        let column = |l: usize| (first_column + l % 4).min(width - 1);
        let row = |l: usize| (first_row + l / 4).min(frame.height - 1);
        let rays = Rays::of_packet(frame, first_column, first_row);
        let mut limit_m = never;
        if let Some(objects_m) = objects_m {
            let object_m = Lanes::from_fn(|l| objects_m.get(row(l) * width + column(l)).copied().unwrap_or(f32::MAX));
            limit_m = Lanes::select_less(object_m, rays.end, object_m, never);
        }
        let behind = behind(frame, &rays);
        let met = met_before(frame, &rays, &limit_m);
        let whole = composed(frame, &rays, &behind, &met);
        let (before, passed) = composed_before(frame, &rays, &behind, &met, limit_m.min(rays.end));
        let light = [0, 1, 2].map(|c| Lanes::select_less(limit_m, never, before[c], whole[c]) * frame.exposure);
        let through = (passed[0] + passed[1] + passed[2]) * (1.0 / 3.0);
        let numbers = [
            light[0],
            light[1],
            light[2],
            Lanes::select_less(limit_m, never, through, zero),
            met.distance_m,
            (one - met.through) * (one - faded(met.distance_m)),
        ];
        for l in 0..LANES {
            let (x, at) = (first_column + l % 4, l / 4 * width + first_column + l % 4);
            if x < width && at < out.len() {
                out[at] = [0, 1, 2, 3, 4, 5].map(|n| numbers[n].0[l]);
            }
        }
    }
}

/// RGBA bytes of layers that are `width` pixels wide, rows from the top: light as pictures have it, and 255 where nothing passes. Light is premultiplied:
/// decoded from sRGB it is to be added to what the client puts behind, times one less alpha.
pub fn rgba8(layers: &[Layer], width: usize) -> Vec<u8> {
    let mut bytes = vec![0u8; layers.len() * 4];
    bytes
        .par_chunks_mut(LANES * 4)
        .zip(layers.par_chunks(LANES))
        .enumerate()
        .for_each(|(n, (out, layers))| bytes_of(layers, n * LANES, width, out));
    bytes
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn bytes_of(layers: &[Layer], first: usize, width: usize, out: &mut [u8]) {
    let last = layers.len() - 1;
    let light = [0, 1, 2].map(|c| Lanes::from_fn(|l| layers[l.min(last)][c]));
    let px = Lanes::from_fn(|l| ((first + l) % width) as f32 + 0.5);
    let py = Lanes::from_fn(|l| ((first + l) / width) as f32 + 0.5);
    let rgb = tone_map(light, 1.0, pattern(px, py));
    for (l, pixel) in out.chunks_exact_mut(4).enumerate() {
        for c in 0..3 {
            pixel[c] = rgb[c].0[l] as u8;
        }
        pixel[3] = 255 - (layers[l][3].clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    }
}
