//! Stage `impostors`: a viewer's far clouds are drawn from pictures of them that are kept until they no longer fit; only what is near is marched every time.
//!
//! Reads: [`Frame`], the viewer's [`Impostors`] of the pictures before. Writes: RGB bytes, the impostors. Scheme (seed 002, after Schaufler 1995): what lies beyond
//! [`FAR_LEAST_M`], or 3.3 times the height between camera and the farther side of the clouds' slab where that is more, is kept in tiles of [`FAR_TILE`] x [`FAR_TILE`] directions on the four
//! upright sides of a cube around the camera: radiance, transmittance and mean distance, a direction a pixel of the picture. A ray of the picture is marched up to there, and behind it stands what
//! the tile has, linear between its directions. A tile in view is marched anew when the camera has moved against the air by more than [`FAR_TRANSLATION_RAD`] as seen from the near
//! edge of what is far (the translation metric: the angle that parallax can be off by), when the picture's pixels are finer than its directions or more than twice as
//! coarse (the zoom metric), and when look or light have changed. When the weather has gone on, the oldest tiles are renewed, [`RENEWED_SHARE`] of those in view a picture, so that
//! the cost is spread over pictures.
//! Keeps: what is near, exactly; what is far to the tolerance. Loses: far edges soften by up to a pixel; far clouds lag behind the weather by a few pictures. Tiles out of view are
//! given up, so memory is bounded by the picture: 20 bytes a pixel of its middle band.
//! On a GPU ([`crate::gpu::view_impostors`]) the tiles stay in the GPU's memory.
//! Errors on resting, turning and flying cameras: `welkin ladder view`.
//! Objects within clouds need no splitting of impostors here: stage `layers` ends rays at them.

use std::sync::atomic::{AtomicBool, Ordering};

use multiversion::multiversion;
use rayon::prelude::*;

use super::lanes::{LANES, Lanes};
use super::march::{Frame, Met, Out, PACKET_ROWS, Rays, finish_packet, met_before, met_beyond};
use super::reproject::alike;
use super::upsample::{SAMPLE_NUMBERS, Samples};
use crate::view::Look;

/// Nearer than this nothing is far, m.
pub const FAR_LEAST_M: f32 = 8_000.0;
/// How many times the height to the slab's farther side: rays to what is far are no steeper than one in so many.
const FAR_FLATNESS: f32 = 3.3;
/// Largest angle of parallax, rad: 0.15 degrees, where seed 002 sees no popping any more.
pub const FAR_TRANSLATION_RAD: f32 = 0.15 * std::f32::consts::PI / 180.0;
/// Share of the tiles in view that is renewed for the weather's sake in a picture.
const RENEWED_SHARE: usize = 4;

crate::constants! {
    /// Directions along each side of a tile.
    pub const FAR_TILE: usize = 32;
    /// Samples along a tile's side; neighbours share theirs.
    pub const FAR_SIDE: usize = 33;
    /// Largest slope of a ray against the side of the cube that it goes through: steeper ones leave the slab before what is far, in the cube's corners too (0.48 there is a sine of 0.32).
    pub const FAR_SLOPE_MOST: f32 = 0.48;
}

/// A viewer's far clouds; `N` holds the numbers of a tile, `[row][column][number]`.
#[derive(Debug)]
pub struct Impostors<N = Vec<f32>> {
    tiles: Vec<Option<Tile<N>>>,
    taken: Option<Taken>,
    picture: u64,
}

/// How the tiles were laid out, and what they hang on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Taken {
    look: Look,
    pub(crate) far_m: f32,
    /// Slope between neighbouring directions.
    pub(crate) step: f32,
    pub(crate) tiles: [usize; 2],
}

#[derive(Debug)]
struct Tile<N> {
    numbers: N,
    /// When and where it was marched.
    at: Moment,
    picture: u64,
}

/// When and where a picture is taken, as far as what is far goes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moment {
    /// Camera less the air's way, m.
    place_m: [f32; 3],
    /// Tells one cloud from another.
    weather: u64,
}

impl Moment {
    /// From a camera and how far the air has moved, m.
    pub(crate) fn new(position_m: [f32; 3], displacement_m: [f32; 3], weather: u64) -> Moment {
        let place_m = [0, 1, 2].map(|a| {
            let moved = displacement_m[a];
            position_m[a] - if moved.is_finite() { moved } else { 0.0 }
        });
        Moment { place_m, weather }
    }
}

impl<N> Default for Impostors<N> {
    fn default() -> Self {
        Impostors {
            tiles: Vec::new(),
            taken: None,
            picture: 0,
        }
    }
}

impl<N> Impostors<N> {
    /// Gives all up.
    pub fn forget(&mut self) {
        *self = Impostors::default();
    }
    /// How the tiles of a picture lie that would lie as `now`: as before, or anew, all of them empty, where those of before don't serve it.
    pub(crate) fn laid_out(&mut self, now: Taken) -> Taken {
        let taken = match self.taken.filter(|taken| taken.serves(&now)) {
            Some(taken) => Taken {
                look: now.look,
                ..taken
            },
            None => {
                self.tiles.clear();
                self.tiles.resize_with(now.count(), || None);
                now
            }
        };
        self.taken = Some(taken);
        self.picture += 1;
        taken
    }
    /// Gives up the tiles that are not in view, and names those that are to be marched.
    pub(crate) fn choose(&mut self, taken: &Taken, now: &Moment, in_view: impl Fn(usize) -> bool) -> Vec<usize> {
        let mut fresh = Vec::new();
        let mut old = Vec::new();
        let mut seen = 0usize;
        for (number, slot) in self.tiles.iter_mut().enumerate() {
            if !in_view(number) {
                *slot = None;
                continue;
            }
            seen += 1;
            match slot {
                Some(tile) if parallax(tile.at.place_m, now.place_m, taken.far_m) <= FAR_TRANSLATION_RAD => {
                    if tile.at.weather != now.weather {
                        old.push((tile.picture, number));
                    }
                }
                _ => fresh.push(number),
            }
        }
        old.sort_unstable();
        let in_turn = old.iter().take(seen.div_ceil(RENEWED_SHARE));
        fresh.extend(in_turn.map(|(_, number)| *number));
        fresh
    }
    /// Keeps what was marched.
    pub(crate) fn put(&mut self, number: usize, now: &Moment, numbers: N) {
        self.tiles[number] = Some(Tile {
            numbers,
            at: *now,
            picture: self.picture,
        });
    }
    /// What is kept of each tile.
    pub(crate) fn kept(&self) -> impl Iterator<Item = Option<&N>> {
        self.tiles.iter().map(|tile| tile.as_ref().map(|t| &t.numbers))
    }
}

impl Impostors {
    /// Bytes that they hold.
    pub fn bytes(&self) -> usize {
        let numbers = self.kept().flatten();
        numbers.map(|n| 4 * n.capacity()).sum::<usize>() + self.tiles.capacity() * size_of::<Option<Tile<Vec<f32>>>>()
    }
}

impl Taken {
    /// Of a picture of so many rows, of clouds between two heights, m.
    pub(crate) fn new(look: &Look, rows: usize, slab_m: [f32; 2]) -> Taken {
        let height_m = slab_m.map(|z| (z - look.position_m[2]).abs());
        let step = 2.0 * look.half_height / rows as f32;
        let across = (2.0 / (step * FAR_TILE as f32)).ceil().max(1.0) as usize;
        let up = (2.0 * FAR_SLOPE_MOST / (step * FAR_TILE as f32)).ceil().max(1.0) as usize;
        Taken {
            look: *look,
            far_m: (FAR_FLATNESS * height_m[0].max(height_m[1])).max(FAR_LEAST_M),
            step,
            tiles: [across, up],
        }
    }
    /// The zoom metric: whether these directions serve pictures of that step; and what is far must be far enough.
    fn serves(&self, now: &Taken) -> bool {
        // A thousandth, so that rounding does not matter.
        self.step <= 1.001 * now.step
            && 2.0 * self.step >= now.step
            && self.far_m >= now.far_m
            && self.far_m <= 1.5 * now.far_m
            && alike(&self.look, &now.look)
    }
    /// Tiles on all four sides.
    pub(crate) fn count(&self) -> usize {
        4 * self.tiles[0] * self.tiles[1]
    }
    /// Side, and place on it in directions from its first corner; none where nothing far can be.
    #[inline(always)]
    fn place(&self, d: [f32; 3]) -> Option<(usize, f32, f32)> {
        let [x, y, z] = d;
        let (side, along, ahead) = if x.abs() >= y.abs() {
            (if x >= 0.0 { 0 } else { 1 }, y, x.abs())
        } else {
            (if y >= 0.0 { 2 } else { 3 }, x, y.abs())
        };
        let (u, v) = (along / ahead, z / ahead);
        // Also false where the ray goes straight up.
        let flat = v.abs() < FAR_SLOPE_MOST;
        flat.then(|| (side, (u + 1.0) / self.step, (v + FAR_SLOPE_MOST) / self.step))
    }
    /// Number of the tile that holds a place, and the place within it.
    #[inline(always)]
    fn tile(&self, (side, u, v): (usize, f32, f32)) -> (usize, f32, f32) {
        let (i, j) = ((u / FAR_TILE as f32) as usize, (v / FAR_TILE as f32) as usize);
        let (i, j) = (i.min(self.tiles[0] - 1), j.min(self.tiles[1] - 1));
        let number = (side * self.tiles[1] + j) * self.tiles[0] + i;
        (number, u - (i * FAR_TILE) as f32, v - (j * FAR_TILE) as f32)
    }
    /// Unit vector of a direction of a tile.
    fn direction(&self, number: usize, column: usize, row: usize) -> [f32; 3] {
        let (i, rest) = (number % self.tiles[0], number / self.tiles[0]);
        let (j, side) = (rest % self.tiles[1], rest / self.tiles[1]);
        let u = (i * FAR_TILE + column) as f32 * self.step - 1.0;
        let v = (j * FAR_TILE + row) as f32 * self.step - FAR_SLOPE_MOST;
        let length = (1.0 + u * u + v * v).sqrt();
        let [x, y] = match side {
            0 => [1.0, u],
            1 => [-1.0, u],
            2 => [u, 1.0],
            _ => [u, -1.0],
        };
        [x / length, y / length, v / length]
    }
}

/// Draws a picture with the far clouds that are kept. The frame has a cloud between the heights `slab_m`; `weather` tells one cloud from another, `displacement_m` is how far the air has moved.
pub(super) fn draw(
    frame: &Frame<'_>,
    look: &Look,
    (slab_m, weather, displacement_m): ([f32; 2], u64, [f32; 3]),
    kept: &mut Impostors,
    samples: &mut Samples,
    picture: &mut [u8],
) {
    let taken = kept.laid_out(Taken::new(look, frame.height, slab_m));
    let seen: Vec<AtomicBool> = (0..taken.count()).map(|_| AtomicBool::new(false)).collect();
    (0..frame.height.div_ceil(PACKET_ROWS))
        .into_par_iter()
        .for_each(|n| mark_rows(frame, &taken, n * PACKET_ROWS, &seen));
    let now = Moment::new(frame.position_m, displacement_m, weather);
    let fresh = kept.choose(&taken, &now, |number| seen[number].load(Ordering::Relaxed));
    let marched: Vec<(usize, Vec<f32>)> = fresh
        .par_iter()
        .map(|number| (*number, march_tile(frame, &taken, *number)))
        .collect();
    samples.marched = (frame.width * frame.height + marched.len() * FAR_SIDE * FAR_SIDE) as u64;
    for (number, numbers) in marched {
        kept.put(number, &now, numbers);
    }
    let tiles = &kept.tiles;
    picture
        .par_chunks_mut(PACKET_ROWS * frame.width * 3)
        .enumerate()
        .for_each(|(n, out)| draw_rows(frame, &taken, tiles, n * PACKET_ROWS, out));
}

/// The translation metric: the angle by which a place at the near edge of what is far may be seen wrongly, rad.
fn parallax(from_m: [f32; 3], to_m: [f32; 3], far_m: f32) -> f32 {
    let moved: f32 = (0..3).map(|a| (from_m[a] - to_m[a]).powi(2)).sum();
    (moved.sqrt() / far_m).atan()
}

/// Tells which tiles four rows of the picture look at.
fn mark_rows(frame: &Frame<'_>, taken: &Taken, first_row: usize, seen: &[AtomicBool]) {
    for first_column in (0..frame.width).step_by(LANES / PACKET_ROWS) {
        let rays = Rays::of_packet(frame, first_column, first_row);
        for l in 0..LANES {
            if let Some(place) = taken.place(rays.d.map(|c| c.0[l])) {
                seen[taken.tile(place).0].store(true, Ordering::Relaxed);
            }
        }
    }
}

/// What the directions of a tile meet beyond what is near.
fn march_tile(frame: &Frame<'_>, taken: &Taken, number: usize) -> Vec<f32> {
    let mut numbers = vec![0.0f32; FAR_SIDE * FAR_SIDE * SAMPLE_NUMBERS];
    let from = Lanes::splat(taken.far_m);
    for first in (0..FAR_SIDE * FAR_SIDE).step_by(LANES) {
        let at = |l: usize| (first + l).min(FAR_SIDE * FAR_SIDE - 1);
        let mut d = [Lanes::splat(0.0); 3];
        for l in 0..LANES {
            let direction = taken.direction(number, at(l) % FAR_SIDE, at(l) / FAR_SIDE);
            for c in 0..3 {
                d[c].0[l] = direction[c];
            }
        }
        // Steps begin as those of the picture's pixels do, at a pattern of the directions.
        let column = Lanes::from_fn(|l| (at(l) % FAR_SIDE) as f32 + 0.5);
        let row = Lanes::from_fn(|l| (at(l) / FAR_SIDE) as f32 + 0.5);
        let met = met_beyond(frame, &Rays::along(frame, d, column, row), &from).numbers();
        for l in 0..LANES.min(FAR_SIDE * FAR_SIDE - first) {
            for (n, number) in met.iter().enumerate() {
                numbers[(first + l) * SAMPLE_NUMBERS + n] = number.0[l];
            }
        }
    }
    numbers
}

fn draw_rows(frame: &Frame<'_>, taken: &Taken, tiles: &[Option<Tile<Vec<f32>>>], first_row: usize, out: &mut [u8]) {
    let limit = Lanes::splat(taken.far_m);
    for first_column in (0..frame.width).step_by(LANES / PACKET_ROWS) {
        let rays = Rays::of_packet(frame, first_column, first_row);
        let near = met_before(frame, &rays, &limit);
        let met = behind_near(taken, tiles, &rays, &near);
        finish_packet(frame, first_column, first_row, &met, &mut Out::Bytes(out));
    }
}

/// What is near, and behind it what the tiles have.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn behind_near(taken: &Taken, tiles: &[Option<Tile<Vec<f32>>>], rays: &Rays, near: &Met) -> Met {
    let (zero, one) = (Lanes::splat(0.0), Lanes::splat(1.0));
    let mut far = Met::NOTHING.numbers();
    let mut weighted = zero;
    for l in 0..LANES {
        let Some(place) = taken.place([rays.d[0].0[l], rays.d[1].0[l], rays.d[2].0[l]]) else {
            continue;
        };
        let (number, u, v) = taken.tile(place);
        let Some(tile) = &tiles[number] else { continue };
        let (i, j) = ((u as usize).min(FAR_TILE - 1), (v as usize).min(FAR_TILE - 1));
        let (fu, fv) = (u - i as f32, v - j as f32);
        let shares = [(1.0 - fu) * (1.0 - fv), fu * (1.0 - fv), (1.0 - fu) * fv, fu * fv];
        let mut numbers = [0.0f32; SAMPLE_NUMBERS];
        let mut hidden = 0.0;
        for (n, share) in shares.iter().enumerate() {
            let at = ((j + n / 2) * FAR_SIDE + i + n % 2) * SAMPLE_NUMBERS;
            let here = &tile.numbers[at..at + SAMPLE_NUMBERS];
            for c in 0..4 {
                numbers[c] += share * here[c];
            }
            hidden += share * (1.0 - here[3]) * here[4];
        }
        for c in 0..4 {
            far[c].0[l] = numbers[c];
        }
        weighted.0[l] = hidden;
    }
    let near_hides = one - near.through;
    let hides = near_hides + near.through * (one - far[3]);
    let distance = near_hides * near.distance_m + near.through * weighted;
    let mut met = *near;
    for c in 0..3 {
        met.light[c] = near.light[c] + near.through * far[c];
    }
    met.through = near.through * far[3];
    met.distance_m = distance / hides.max(Lanes::splat(1e-6));
    met
}
