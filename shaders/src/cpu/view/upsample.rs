//! Stage `upsample`: a picture of which one pixel in four is marched, and more only where those disagree.
//!
//! Reads: [`Frame`]. Writes: rows of RGB bytes, or radiance; on its way [`Samples`]: radiance, transmittance and mean distance (m) of the
//! cloud at every second pixel of every second row. Scheme: those rays are the very ones that a whole picture has there, so a quarter of the
//! pixels are what they would be. Any other pixel lies between two or four of them. Where these agree (in the light that they send, in what they let through, in how
//! far away they are) the pixel takes their mean, the distance weighted by opacity; where they do not, as at edges of clouds and in strong relief, the pixel is
//! marched too. So there are no halos: nothing is mixed across an edge. Sky, ground, sun, moon, stars and haze are made for every pixel. Never more rays than a whole
//! picture has.
//! Keeps: edges, and pixels on even rows and columns, exactly. Loses: relief finer than two pixels and fainter than the bounds
//! ([`AGREES_LIGHT`] and those beside it), cloud that no sample meets; the grain that steps begin with is smoothed. Errors: `welkin ladder view`.
//! Source: marching at half resolution as in Schneider and Vos (2015), the bounds in place of a bilateral filter (Tomasi and Manduchi 1998): a filter needs
//! to know the pixel that it fills, and a pixel of cloud is known when it is marched.

use std::sync::atomic::{AtomicU64, Ordering};

use multiversion::multiversion;
use rayon::prelude::*;

use super::lanes::{Indices, LANES, Lanes};
use super::march::{Frame, Met, Out, PACKET_ROWS, Rays, finish_packet, met_by};

crate::constants! {
    /// Samples agree if their light differs by no more than this share of it and of a floor, in exposed light (1 is white).
    pub const AGREES_LIGHT: f32 = 0.20;
    const AGREES_FLOOR: f32 = 0.08;
    /// And their transmittance by no more than this.
    const AGREES_THROUGH: f32 = 0.10;
    /// And their distance by no more than this share, times their opacity.
    const AGREES_DISTANCE: f32 = 0.25;
    /// Numbers of a sample: light of three colours, transmittance, distance.
    pub const SAMPLE_NUMBERS: usize = 5;
}

const PACKET_COLUMNS: usize = LANES / PACKET_ROWS;

/// What was marched at every second pixel or every fourth, `[row][number][column]`.
#[derive(Debug, Default)]
pub struct Samples {
    pub(super) columns: usize,
    pub(super) rows: usize,
    pub(super) stride: usize,
    /// Pixel of the first sample; it may lie left of the picture and above it.
    pub(super) origin: [isize; 2],
    pub(super) numbers: Vec<f32>,
    pub(super) marched: u64,
}

impl Samples {
    /// Rays that the last picture took.
    pub fn marched(&self) -> u64 {
        self.marched
    }
    /// Notes that a picture was marched whole.
    pub(super) fn all_marched(&mut self, frame: &Frame<'_>) {
        self.marched = match frame.cloud {
            Some(_) => (frame.width * frame.height) as u64,
            None => 0,
        };
    }
}

/// Marches the samples of a picture. The frame has a cloud.
pub(super) fn march_samples(frame: &Frame<'_>, samples: &mut Samples) {
    march_grid(frame, samples, 2, [0, 0]);
}

/// Marches every `stride`th pixel from `origin` on, to beyond the picture's last ones.
pub(super) fn march_grid(frame: &Frame<'_>, samples: &mut Samples, stride: usize, origin: [isize; 2]) {
    let [columns, rows] = samples_along([frame.width, frame.height], stride, origin);
    samples.columns = columns;
    samples.rows = rows;
    samples.stride = stride;
    samples.origin = origin;
    samples.numbers.resize(rows * columns * SAMPLE_NUMBERS, 0.0);
    samples.marched = (columns * rows) as u64;
    samples
        .numbers
        .par_chunks_mut(PACKET_ROWS * columns * SAMPLE_NUMBERS)
        .enumerate()
        .for_each(|(n, out)| {
            sample_rows(
                frame,
                n * PACKET_ROWS,
                columns,
                [stride as isize, origin[0], origin[1]],
                out,
            )
        });
}

/// Samples across and down a picture, from `origin` to beyond its last pixels.
pub(crate) fn samples_along(size: [usize; 2], stride: usize, origin: [isize; 2]) -> [usize; 2] {
    [0, 1].map(|a| (size[a] as isize - 1 - origin[a]) as usize / stride + 2)
}

/// Draws a picture from its samples, marching what they leave open.
pub(super) fn draw(frame: &Frame<'_>, samples: &mut Samples, picture: Out<'_>) {
    let pixels = PACKET_ROWS * frame.width;
    let marched = AtomicU64::new(0);
    let rows = |scratch: &mut Scratch, n: usize, out: Out<'_>| {
        scratch.clear();
        between_rows(frame, samples, n * PACKET_ROWS, scratch);
        let more = finish_rows(frame, n * PACKET_ROWS, scratch, out);
        marched.fetch_add(more, Ordering::Relaxed);
    };
    match picture {
        Out::Bytes(bytes) => bytes
            .par_chunks_mut(pixels * 3)
            .enumerate()
            .for_each_init(Scratch::default, |scratch, (n, out)| rows(scratch, n, Out::Bytes(out))),
        Out::Radiance(values) => values
            .par_chunks_mut(pixels)
            .enumerate()
            .for_each_init(Scratch::default, |scratch, (n, out)| {
                rows(scratch, n, Out::Radiance(out))
            }),
    }
    samples.marched += marched.into_inner();
}

/// What four rows of a picture take.
#[derive(Default)]
pub(super) struct Scratch {
    /// What their rays met, a packet each.
    pub(super) met: Vec<Met>,
    /// Rays that are to be marched: the packet's number times [`LANES`] and the lane.
    pending: Vec<u32>,
}

impl Scratch {
    /// Nothing known.
    pub(super) fn clear(&mut self) {
        self.met.clear();
        self.pending.clear();
    }
    /// The next packet, and those of its rays that are to be marched.
    #[inline(always)]
    pub(super) fn push(&mut self, met: Met, open: Lanes) {
        if open.any_above(0.0) {
            let packet = self.met.len() * LANES;
            for l in 0..LANES {
                if open.0[l] > 0.0 {
                    self.pending.push((packet + l) as u32);
                }
            }
        }
        self.met.push(met);
    }
}

fn sample_rows(frame: &Frame<'_>, first_row: usize, columns: usize, [stride, x, y]: [isize; 3], out: &mut [f32]) {
    let row_numbers = SAMPLE_NUMBERS * columns;
    for first_column in (0..columns).step_by(PACKET_COLUMNS) {
        let px = Lanes::from_fn(|l| (x + stride * (first_column + l % 4).min(columns - 1) as isize) as f32 + 0.5);
        let py = Lanes::from_fn(|l| (y + stride * (first_row + l / 4) as isize) as f32 + 0.5);
        let met = met_by(frame, &Rays::new(frame, px, py)).numbers();
        for l in 0..LANES {
            let (column, row) = (first_column + l % 4, l / 4);
            if column < columns && (row + 1) * row_numbers <= out.len() {
                for (n, number) in met.iter().enumerate() {
                    out[row * row_numbers + n * columns + column] = number.0[l];
                }
            }
        }
    }
}

/// Four rows of the picture, of which `scratch` knows what it knows; gives the rays that they took besides.
pub(super) fn finish_rows(frame: &Frame<'_>, first_row: usize, scratch: &mut Scratch, mut out: Out<'_>) -> u64 {
    let (width, rows) = (frame.width, PACKET_ROWS.min(frame.height - first_row));
    scratch.pending.retain(|n| {
        let lane = *n as usize % LANES;
        *n as usize / LANES * PACKET_COLUMNS + lane % 4 < width && lane / 4 < rows
    });
    for some in scratch.pending.chunks(LANES) {
        let at = |l: usize| some[l.min(some.len() - 1)] as usize;
        let px = Lanes::from_fn(|l| (at(l) / LANES * PACKET_COLUMNS + at(l) % 4) as f32 + 0.5);
        let py = Lanes::from_fn(|l| (first_row + at(l) % LANES / 4) as f32 + 0.5);
        let met = met_by(frame, &Rays::new(frame, px, py));
        for (from, n) in some.iter().enumerate() {
            let (packet, to) = (*n as usize / LANES, *n as usize % LANES);
            scratch.met[packet].take(to, &met, from);
        }
    }
    for (n, met) in scratch.met.iter().enumerate() {
        finish_packet(frame, n * PACKET_COLUMNS, first_row, met, &mut out);
    }
    scratch.pending.len() as u64
}

/// What the samples say of every pixel of four rows, and which pixels they leave open.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn between_rows(frame: &Frame<'_>, samples: &Samples, first_row: usize, scratch: &mut Scratch) {
    for first_column in (0..frame.width).step_by(PACKET_COLUMNS) {
        let (met, open) = between(frame, samples, first_column, first_row);
        scratch.push(met, open);
    }
}

#[inline(always)]
fn between(frame: &Frame<'_>, samples: &Samples, first_column: usize, first_row: usize) -> (Met, Lanes) {
    let (zero, one) = (Lanes::splat(0.0), Lanes::splat(1.0));
    let row_numbers = SAMPLE_NUMBERS * samples.columns;
    // Even pixels are samples, the others lie between two or four.
    let mut at = [Indices([0; LANES]); 4];
    for l in 0..LANES {
        let (x, y) = (first_column + l % 4, first_row + l / 4);
        for (n, index) in at.iter_mut().enumerate() {
            let column = ((x + n % 2) / 2).min(samples.columns - 1);
            let row = ((y + n / 2) / 2).min(samples.rows - 1);
            index.0[l] = (row * row_numbers + column) as u32;
        }
    }
    let number = |n: usize| taps(&samples.numbers, &at, n * samples.columns);
    let colours = [number(0), number(1), number(2)];
    let through = number(3);
    let distance = number(4);
    let (mut brightness, mut hidden, mut weighted) = ([zero; 4], [zero; 4], [zero; 4]);
    for n in 0..4 {
        brightness[n] = (colours[0][n] + colours[1][n] + colours[2][n]) * (frame.exposure / 3.0);
        hidden[n] = one - through[n];
        weighted[n] = hidden[n] * distance[n];
    }
    let opacity = mean(&hidden);
    let [darkest, brightest] = extremes(&brightness);
    let [closed, clear] = extremes(&through);
    let [nearest, farthest] = extremes(&distance);
    let met = Met {
        light: [mean(&colours[0]), mean(&colours[1]), mean(&colours[2])],
        through: mean(&through),
        // Where all are at one distance, that one, to the last bit.
        distance_m: Lanes::select_less(
            nearest,
            farthest,
            mean(&weighted) / opacity.max(Lanes::splat(1e-6)),
            nearest,
        ),
    };
    let bound = (mean(&brightness) + AGREES_FLOOR) * AGREES_LIGHT;
    let mut open = Lanes::select_less(bound, brightest - darkest, one, zero);
    open = Lanes::select_less(Lanes::splat(AGREES_THROUGH), clear - closed, one, open);
    let apart = (farthest - nearest) * opacity;
    open = Lanes::select_less(farthest * AGREES_DISTANCE, apart, one, open);
    (met, open)
}

/// Four numbers for each of sixteen places, `offset` behind these.
#[inline(always)]
pub(super) fn taps(numbers: &[f32], at: &[Indices; 4], offset: usize) -> [Lanes; 4] {
    let mut taps = [Lanes::splat(0.0); 4];
    for (tap, index) in taps.iter_mut().zip(at) {
        *tap = index.plus(offset as u32).gather_f32(numbers);
    }
    taps
}

/// In pairs, so that the mean of four equal numbers is that number.
#[inline(always)]
fn mean(taps: &[Lanes; 4]) -> Lanes {
    ((taps[0] + taps[1]) + (taps[2] + taps[3])) * 0.25
}

#[inline(always)]
pub(super) fn extremes(taps: &[Lanes; 4]) -> [Lanes; 2] {
    [
        taps[0].min(taps[1]).min(taps[2].min(taps[3])),
        taps[0].max(taps[1]).max(taps[2].max(taps[3])),
    ]
}
