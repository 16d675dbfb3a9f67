//! Stage `reproject`: of a viewer's live picture one pixel in 4 or in 16 is marched, the others are looked up in the picture before.
//!
//! Reads: [`Frame`], the [`History`] of the viewer: radiance, transmittance and mean distance (m) of the cloud of every pixel of the last picture, its camera, and how
//! far the air had moved. Writes: RGB bytes, the history. Scheme (Schneider and Vos 2015, seed 001): each picture marches one pixel of every cell of 2 x 2 or 4 x 4, the next one
//! another, in the order of a Bayer matrix. The pixels marched tell the others how far away the cloud is; from there a pixel is carried back with the wind
//! and seen by the last camera, and what that picture has there (linear between its pixels; the pixel itself where it falls on one) is taken. It is not
//! taken, and the pixel is marched, where the place is out of the last picture, where that picture saw cloud at another distance (disocclusion), and where it is brighter,
//! darker, thinner or thicker than the pixels marched around it by more than bounds. Where look, light or size have changed there is no history, and every pixel is marched.
//! Sky, ground, sun, moon, stars and haze are made for every pixel.
//! On a GPU ([`crate::gpu::view_reproject`]) the history stays in the GPU's memory, 20 bytes a pixel; here it is 40.
//! Keeps: a picture that rests becomes the whole picture's after 4 or 16 pictures, bit for bit. Loses: what changes faster than that lags within the bounds, and edges soften
//! while the camera moves. Errors on resting, turning and flying cameras: `welkin ladder view`.
//! Sources: Schneider and Vos (2015); Nehab et al. (2007), \"Accelerating real-time shading with reverse reprojection caching\".

use std::sync::atomic::{AtomicU64, Ordering};

use multiversion::multiversion;
use rayon::prelude::*;

use super::impostors::Impostors;
use super::lanes::{Indices, LANES, Lanes};
use super::march::{Frame, Met, Out, PACKET_ROWS, Rays};
use super::upsample::{SAMPLE_NUMBERS, Samples, Scratch, extremes, finish_rows, march_grid, taps};
use crate::cpu::light::atmosphere::EARTH_RADIUS_M;
use crate::view::Look;

crate::constants! {
    /// Distance at which a ray that meets no cloud nearby is thought to, m.
    const RECALL_FAR_M: f32 = 15_000.0;
    /// How far from a pixel's centre, in pixels, the last picture's pixel is taken as it is.
    const RECALL_SNAP: f32 = 0.03;
    /// Largest difference of distances, a share of them, times opacity.
    const RECALL_DISTANCE: f32 = 0.2;
    /// How much darker or brighter than the pixels around, a share of them and of a floor, in exposed light.
    const RECALL_LIGHT: f32 = 0.12;
    const RECALL_FLOOR: f32 = 0.05;
    /// How much thinner or thicker, in transmittance.
    const RECALL_THROUGH: f32 = 0.06;
}

/// The order in which the pixels of a cell are marched: a Bayer matrix, so that neighbours in time are far apart in the cell.
const ORDER_4: [[isize; 2]; 4] = [[0, 0], [1, 1], [1, 0], [0, 1]];
const ORDER_16: [[isize; 2]; 16] = [
    [0, 0],
    [2, 2],
    [2, 0],
    [0, 2],
    [1, 1],
    [3, 3],
    [3, 1],
    [1, 3],
    [1, 0],
    [3, 2],
    [3, 0],
    [1, 2],
    [0, 1],
    [2, 3],
    [2, 1],
    [0, 3],
];

/// What a viewer's last picture leaves to the next.
#[derive(Debug, Default)]
pub struct History {
    last: Option<Last>,
    /// `[row][number][column]`.
    numbers: Vec<f32>,
    next: Vec<f32>,
    pictures: usize,
    /// Far clouds, of the rung that keeps them.
    pub(super) impostors: Impostors,
}

/// How the last picture was taken.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Last {
    pub(crate) size: [usize; 2],
    pub(crate) look: Look,
    pub(crate) displacement_m: [f32; 3],
}

impl Last {
    /// Whether it serves a picture of that size and look.
    pub(crate) fn serves(&self, size: [usize; 2], look: &Look) -> bool {
        self.size == size && alike(&self.look, look)
    }
    /// Where the air that is at the world's origin now would see its camera, m.
    pub(crate) fn position_m(&self, displacement_m: [f32; 3]) -> [f32; 3] {
        let moved = [0, 1, 2].map(|a| displacement_m[a] - self.displacement_m[a]);
        [0, 1, 2].map(|a| self.look.position_m[a] + if moved[a].is_finite() { moved[a] } else { 0.0 })
    }
    /// Pixels to a tangent of 1.
    pub(crate) fn per_pixel(&self) -> f32 {
        self.size[1] as f32 / (2.0 * self.look.half_height)
    }
}

/// The pixel of the first sample of a viewer's `picture`th picture, where one of every `cell` x `cell` is marched: left of the picture and above it.
pub(crate) fn first_sample(cell: usize, picture: usize) -> [isize; 2] {
    let order: &[[isize; 2]] = if cell == 2 { &ORDER_4 } else { &ORDER_16 };
    order[picture % order.len()].map(|n| n - cell as isize)
}

impl History {
    /// Bytes that it holds.
    pub fn bytes(&self) -> usize {
        4 * (self.numbers.capacity() + self.next.capacity()) + self.impostors.bytes()
    }
    /// Forgets the last picture: the next one is marched whole.
    pub fn forget(&mut self) {
        self.last = None;
        self.impostors.forget();
    }
}

/// Whether what one look has met serves another.
pub(super) fn alike(a: &Look, b: &Look) -> bool {
    // The detail's offset is the wind's.
    let detail = |look: &Look| look.detail.map(|d| (d.push, d.blend, d.tiles_per_m));
    let turned: f32 = (0..3).map(|c| (a.table_beam[c] - b.table_beam[c]).powi(2)).sum();
    a.air == b.air
        && a.ground == b.ground
        && a.lighting == b.lighting
        && a.octaves == b.octaves
        && a.steps == b.steps
        && a.night == b.night
        && detail(a) == detail(b)
        // A fifth of a degree.
        && turned < 1.2e-5
}

/// Draws a picture with what the last one left; `cell` is 2 or 4. Gives the rays marched. The frame has a cloud.
pub(super) fn draw(
    frame: &Frame<'_>,
    look: &Look,
    displacement_m: [f32; 3],
    cell: usize,
    history: &mut History,
    samples: &mut Samples,
    picture: &mut [u8],
) {
    let size = [frame.width, frame.height];
    let row_numbers = SAMPLE_NUMBERS * frame.width;
    march_grid(frame, samples, cell, first_sample(cell, history.pictures));
    history.pictures += 1;
    history.numbers.resize(row_numbers * frame.height, 0.0);
    history.next.resize(row_numbers * frame.height, 0.0);
    let last = history.last.filter(|last| last.serves(size, look));
    let before = last.map(|last| Before::new(&last, displacement_m, &history.numbers));
    let marched = AtomicU64::new(0);
    picture
        .par_chunks_mut(PACKET_ROWS * frame.width * 3)
        .zip(history.next.par_chunks_mut(PACKET_ROWS * row_numbers))
        .enumerate()
        .for_each_init(Scratch::default, |scratch, (n, (out, kept))| {
            let first_row = n * PACKET_ROWS;
            scratch.clear();
            recall_rows(frame, before.as_ref(), samples, first_row, scratch);
            let more = finish_rows(frame, first_row, scratch, Out::Bytes(out));
            marched.fetch_add(more, Ordering::Relaxed);
            keep_rows(frame.width, scratch, kept);
        });
    samples.marched += marched.into_inner();
    std::mem::swap(&mut history.numbers, &mut history.next);
    history.last = Some(Last {
        size,
        look: *look,
        displacement_m,
    });
}

/// Stores what four rows met.
fn keep_rows(width: usize, scratch: &Scratch, kept: &mut [f32]) {
    let row_numbers = SAMPLE_NUMBERS * width;
    for (packet, met) in scratch.met.iter().enumerate() {
        for (n, number) in met.numbers().iter().enumerate() {
            for l in 0..LANES {
                let (x, y) = (packet * (LANES / PACKET_ROWS) + l % 4, l / 4);
                if x < width && (y + 1) * row_numbers <= kept.len() {
                    kept[y * row_numbers + n * width + x] = number.0[l];
                }
            }
        }
    }
}

/// The last picture, and how a place of now is found in it.
struct Before<'a> {
    numbers: &'a [f32],
    width: usize,
    height: usize,
    /// Where the air that is at the world's origin now would see the last camera.
    position_m: [f32; 3],
    axes: [[f32; 3]; 3],
    per_pixel: f32,
}

impl<'a> Before<'a> {
    fn new(last: &Last, displacement_m: [f32; 3], numbers: &'a [f32]) -> Before<'a> {
        let [width, height] = last.size;
        Before {
            numbers,
            width,
            height,
            position_m: last.position_m(displacement_m),
            axes: last.look.axes,
            per_pixel: last.per_pixel(),
        }
    }
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn recall_rows(
    frame: &Frame<'_>,
    before: Option<&Before<'_>>,
    samples: &Samples,
    first_row: usize,
    scratch: &mut Scratch,
) {
    for first_column in (0..frame.width).step_by(LANES / PACKET_ROWS) {
        let (met, open) = recall(frame, before, samples, first_column, first_row);
        scratch.push(met, open);
    }
}

#[inline(always)]
fn recall(
    frame: &Frame<'_>,
    before: Option<&Before<'_>>,
    samples: &Samples,
    first_column: usize,
    first_row: usize,
) -> (Met, Lanes) {
    let (zero, one) = (Lanes::splat(0.0), Lanes::splat(1.0));
    let row_numbers = SAMPLE_NUMBERS * samples.columns;
    // The four pixels marched around each, the first of them the pixel itself where it was marched.
    let mut at = [Indices([0; LANES]); 4];
    let mut missing = one;
    for l in 0..LANES {
        let x = ((first_column + l % 4) as isize - samples.origin[0]) as usize;
        let y = ((first_row + l / 4) as isize - samples.origin[1]) as usize;
        for (n, index) in at.iter_mut().enumerate() {
            let column = (x / samples.stride + n % 2).min(samples.columns - 1);
            let row = (y / samples.stride + n / 2).min(samples.rows - 1);
            index.0[l] = (row * row_numbers + column) as u32;
        }
        if x.is_multiple_of(samples.stride) && y.is_multiple_of(samples.stride) {
            missing.0[l] = 0.0;
        }
    }
    let number = |n: usize| taps(&samples.numbers, &at, n * samples.columns);
    let colours = [number(0), number(1), number(2)];
    let through = number(3);
    let distance = number(4);
    let marched = Met {
        light: [colours[0][0], colours[1][0], colours[2][0]],
        through: through[0],
        distance_m: distance[0],
    };
    let Some(before) = before else {
        return (marched, missing);
    };
    let mut brightness = [zero; 4];
    let (mut weighted, mut weights) = (zero, zero);
    for n in 0..4 {
        brightness[n] = (colours[0][n] + colours[1][n] + colours[2][n]) * (frame.exposure / 3.0);
        weighted = weighted + (one - through[n]) * distance[n];
        weights = weights + (one - through[n]);
    }
    let far = Lanes::splat(RECALL_FAR_M);
    let distance_m = Lanes::select_less(
        Lanes::splat(0.02),
        weights,
        weighted / weights.max(Lanes::splat(1e-6)),
        far,
    );

    // The place in the world, carried back with the wind, as the last camera saw it.
    let px = Lanes::from_fn(|l| (first_column + l % 4) as f32 + 0.5);
    let py = Lanes::from_fn(|l| (first_row + l / 4) as f32 + 0.5);
    let rays = Rays::new(frame, px, py);
    let (d, t) = (rays.d, distance_m);
    let [ox, oy, oz] = [0, 1, 2].map(|a| frame.position_m[a] - before.position_m[a]);
    let (east, north) = (d[0] * t + ox, d[1] * t + oy);
    // Rays bend up by d^2 / 2R for the one camera as for the other.
    let bent = |x: Lanes, y: Lanes| (x * x + y * y) * (0.5 / EARTH_RADIUS_M);
    let up = d[2] * t + oz + bent(d[0] * t, d[1] * t) - bent(east, north);
    let along = |axis: [f32; 3]| east * axis[0] + north * axis[1] + up * axis[2];
    let ahead = along(before.axes[2]);
    let inverse = one / ahead.max(Lanes::splat(1e-3));
    let x = along(before.axes[0]) * inverse * before.per_pixel + (before.width as f32 * 0.5 - 0.5);
    let y = along(before.axes[1]) * inverse * -before.per_pixel + (before.height as f32 * 0.5 - 0.5);
    let (most_x, most_y) = (before.width as f32 - 1.0, before.height as f32 - 1.0);
    let mut open = Lanes::select_less(ahead, Lanes::splat(1e-3), one, zero);
    for (place, most) in [(x, most_x), (y, most_y)] {
        open = Lanes::select_less(place, Lanes::splat(-RECALL_SNAP), one, open);
        open = Lanes::select_less(Lanes::splat(most + RECALL_SNAP), place, one, open);
    }
    let was = looked_up(before, x.clamp(0.0, most_x), y.clamp(0.0, most_y));

    let seen_m = (east * east + north * north + up * up).sqrt();
    let apart = was.distance_m - seen_m;
    let apart = apart.max(zero - apart) * (one - was.through);
    open = Lanes::select_less(seen_m * RECALL_DISTANCE, apart, one, open);
    let [darkest, brightest] = extremes(&brightness);
    let [closed, clear] = extremes(&through);
    let shone = (was.light[0] + was.light[1] + was.light[2]) * (frame.exposure / 3.0);
    let slack = (darkest + brightest + 2.0 * RECALL_FLOOR) * (0.5 * RECALL_LIGHT);
    open = Lanes::select_less(shone, darkest - slack, one, open);
    open = Lanes::select_less(brightest + slack, shone, one, open);
    open = Lanes::select_less(was.through, closed - RECALL_THROUGH, one, open);
    open = Lanes::select_less(clear + RECALL_THROUGH, was.through, one, open);

    let pick = |new: Lanes, old: Lanes| Lanes::select_less(zero, missing, old, new);
    let met = Met {
        light: [0, 1, 2].map(|c| pick(marched.light[c], was.light[c])),
        through: pick(marched.through, was.through),
        distance_m: pick(marched.distance_m, was.distance_m),
    };
    (met, open * missing)
}

/// What the last picture has at a place within it, linear between its pixels.
#[inline(always)]
fn looked_up(before: &Before<'_>, x: Lanes, y: Lanes) -> Met {
    let (zero, one) = (Lanes::splat(0.0), Lanes::splat(1.0));
    let row_numbers = SAMPLE_NUMBERS * before.width;
    let mut at = [Indices([0; LANES]); 4];
    let (mut fx, mut fy) = (zero, zero);
    for l in 0..LANES {
        let place = |v: f32, most: usize| {
            let nearest = (v + 0.5) as u32;
            let off = v - nearest as f32;
            if (-RECALL_SNAP..=RECALL_SNAP).contains(&off) {
                return (nearest.min(most as u32), 0.0);
            }
            let first = (v as u32).min(most as u32);
            (first, v - first as f32)
        };
        let (column, share_x) = place(x.0[l], before.width - 1);
        let (row, share_y) = place(y.0[l], before.height - 1);
        fx.0[l] = share_x;
        fy.0[l] = share_y;
        for (n, index) in at.iter_mut().enumerate() {
            let column = (column as usize + n % 2).min(before.width - 1);
            let row = (row as usize + n / 2).min(before.height - 1);
            index.0[l] = (row * row_numbers + column) as u32;
        }
    }
    let shares = [(one - fx) * (one - fy), fx * (one - fy), (one - fx) * fy, fx * fy];
    let number = |n: usize| taps(before.numbers, &at, n * before.width);
    let mixed =
        |taps: &[Lanes; 4]| taps[0] * shares[0] + taps[1] * shares[1] + taps[2] * shares[2] + taps[3] * shares[3];
    let through = number(3);
    let distance = number(4);
    let (mut weighted, mut weights) = (zero, zero);
    for n in 0..4 {
        let weight = shares[n] * (one - through[n]);
        weighted = weighted + weight * distance[n];
        weights = weights + weight;
    }
    Met {
        light: [mixed(&number(0)), mixed(&number(1)), mixed(&number(2))],
        through: mixed(&through),
        distance_m: weighted / weights.max(Lanes::splat(1e-6)),
    }
}
