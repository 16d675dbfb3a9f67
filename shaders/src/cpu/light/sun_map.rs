//! Stage `sun_map`: how much cloud lies towards the sun, in a map of its rays: three ways to keep a ray's cloud in a few numbers.
//!
//! Reads: [`Shape`], [`DetailNoise`], the sun's direction. Writes: [`SunMap`]: `side` x `side` rays, periodic as the cloud is, each named by where it meets the
//! clouds' lowest level; 32-bit floats, as planes. Scheme: a march down each ray from the clouds' top in equal steps of 30 m, or of a 256th of the way where that
//! is longer, midpoint rule, with the detail that the march would draw there. A map's error is what its few numbers leave out of a ray that meets several clouds:
//!
//! | map | numbers a ray | optical depth at the distance d from the top |
//! |---|---|---|
//! | exponential (Annen et al. 2008; Bauer 2019) | z, where the cloud begins | c max(0, d - z), c the mean extinction of all cloud |
//! | Beer (Hillaire 2020) | z, mean extinction s from there to the last cloud, the whole depth D | min(D, s max(0, d - z)) |
//! | Fourier (Jansen and Bavoil 2010) | a0 to a3, b1 to b3 of the extinction's Fourier series | the series' integral |
//!
//! Derived anew, for the listings of seed 001 (algorithms 3 to 8) don't do what its equations 2.17 to 2.26 say: the Beer map's transmittance is multiplied by the optical depth
//! once more and its mean extinction counts the clear air before and behind the cloud; the Fourier map sums `-2 ln(1 - density)` where the
//! opacity of a step, `1 - exp(-extinction * step)`, belongs, takes b1 for b2 and b3, and moves by the step's number
//! times the direction on top of where it is. The sums here are those of the equations: a step's `-ln(1 - opacity)` is its optical depth.
//! Between rays the Fourier map's numbers are mixed (its depth is linear in them), of the other two the optical depths or transmittances.
//! Memory: 1, 3 and 7 numbers a ray; seed 001's table 4.1 has the same ratios at 16 bytes a number.

use multiversion::multiversion;
use rayon::prelude::*;

use super::sun_optical_depth::marched_direction;
use crate::cpu::view::detail_noise::DetailNoise;
use crate::cpu::view::lanes::{LANES, Lanes};
use crate::cpu::view::march::detailed_extinction;
use crate::cpu::view::shape::Shape;
use crate::view::{FrameDetail, MapKind};

crate::constants! {
    /// Length of a step, m, and the most steps of a ray.
    const MAP_STEP_M: f32 = 30.0;
    const MAP_STEPS_MAX: usize = 256;
    /// Distance for the detail's fading, m: beyond the closest look, as for a camera some kilometres away.
    const MAP_DETAIL_DISTANCE_M: f32 = 4_000.0;
    /// No number of a ray is kept above this.
    const MAP_DEPTH_MAX: f32 = 1e6;
    /// Planes that a GPU keeps at least: an exponential map needs three while it is made.
    pub(crate) const MAP_PLANES_LEAST: usize = 3;
}

/// Rays along a map's side for what a scene asks for: 16 to 4096, whole packets.
pub(crate) fn map_side(side: u32) -> usize {
    (side as usize).clamp(16, 4096).next_multiple_of(LANES)
}

/// See the module.
#[derive(Clone, Debug)]
pub struct SunMap {
    kind: MapKind,
    side: usize,
    /// `side * side` numbers of each kind after the other.
    pub planes: Vec<f32>,
    per_period: [f32; 2],
    bottom_m: f32,
    top_m: f32,
    sun: [f32; 3],
    /// Length of a ray from top to bottom, m.
    length_m: f32,
    /// Mean extinction of all cloud that the rays met, 1/m.
    pub mean_per_m: f32,
}

impl SunMap {
    /// Marches all rays. `side` is bounded to 16 to 4096.
    pub fn new(
        shape: &Shape,
        noise: &DetailNoise,
        detail: Option<FrameDetail>,
        kind: MapKind,
        side: u32,
        sun_direction: [f32; 3],
    ) -> SunMap {
        let sun = marched_direction(sun_direction);
        let side = map_side(side);
        let length_m = (shape.top_m - shape.bottom_m) / sun[2];
        let mut map = SunMap {
            kind,
            side,
            planes: Vec::new(),
            per_period: shape.per_period(),
            bottom_m: shape.bottom_m,
            top_m: shape.top_m,
            sun,
            length_m,
            mean_per_m: 0.0,
        };
        // Rows first, each with all its numbers: [row][number][column]; then planes.
        let row_len = kind.numbers() * side;
        let mut rows = vec![0.0f32; row_len * side];
        let sums: Vec<[f64; 2]> = rows
            .par_chunks_mut(row_len)
            .enumerate()
            .map(|(y, row)| march_row(&map, shape, noise, detail, y, row))
            .collect();
        let [depth, length] = sums.iter().fold([0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
        map.mean_per_m = if length > 0.0 { (depth / length) as f32 } else { 0.0 };
        let mut planes = vec![0.0f32; rows.len()];
        for (n, plane) in planes.chunks_mut(side * side).enumerate() {
            for (to, row) in plane.chunks_mut(side).zip(rows.chunks(row_len)) {
                to.copy_from_slice(&row[n * side..][..side]);
            }
        }
        map.planes = planes;
        map
    }

    /// Optical depth towards the sun at sixteen places in m.
    #[inline(always)]
    pub(crate) fn optical_depth(&self, x: Lanes, y: Lanes, z: Lanes) -> Lanes {
        let zero = Lanes::splat(0.0);
        let height = z.clamp(self.bottom_m, self.top_m);
        let back = (height - self.bottom_m) * (1.0 / self.sun[2]);
        let distance = (Lanes::splat(self.top_m) - height) * (1.0 / self.sun[2]);
        let side = self.side as f32;
        let gx = ((x - back * self.sun[0]) * self.per_period[0]).fraction() * side + (side - 0.5);
        let gy = ((y - back * self.sun[1]) * self.per_period[1]).fraction() * side + (side - 0.5);
        let (i, fx) = gx.split();
        let (j, fy) = gy.split();
        let n = self.side as u32;
        let mut corners = [i; 4];
        let mut weights = [zero; 4];
        let one = Lanes::splat(1.0);
        for c in 0..4 {
            let (right, up) = (c as u32 & 1, c as u32 >> 1);
            for l in 0..LANES {
                corners[c].0[l] = (j.0[l] + up) % n * n + (i.0[l] + right) % n;
            }
            let across = if right == 1 { fx } else { one - fx };
            weights[c] = across * if up == 1 { fy } else { one - fy };
        }
        let plane = (self.side * self.side) as u32;
        match self.kind {
            MapKind::Exponential => {
                let mut passed = zero;
                for c in 0..4 {
                    let begins = corners[c].gather_f32(&self.planes);
                    let within = (distance - begins).max(zero) * self.mean_per_m;
                    passed = passed + weights[c] * (zero - within).exp();
                }
                let mut depth = zero;
                for l in 0..LANES {
                    depth.0[l] = -passed.0[l].clamp(1e-30, 1.0).ln();
                }
                depth
            }
            MapKind::Beer => {
                let mut depth = zero;
                for c in 0..4 {
                    let begins = corners[c].gather_f32(&self.planes);
                    let mean = corners[c].plus(plane).gather_f32(&self.planes);
                    let whole = corners[c].plus(2 * plane).gather_f32(&self.planes);
                    depth = depth + weights[c] * (mean * (distance - begins).max(zero)).min(whole);
                }
                depth
            }
            MapKind::Fourier => {
                let mut number = [zero; 7];
                for (k, value) in number.iter_mut().enumerate() {
                    for c in 0..4 {
                        let at = corners[c].plus(k as u32 * plane);
                        *value = *value + weights[c] * at.gather_f32(&self.planes);
                    }
                }
                let share = distance * (1.0 / self.length_m);
                let mut depth = number[0] * 0.5 * share;
                for k in 1..4 {
                    let turn = std::f32::consts::TAU * k as f32;
                    let (mut sine, mut cosine) = (zero, zero);
                    for l in 0..LANES {
                        (sine.0[l], cosine.0[l]) = (share.0[l] * turn).sin_cos();
                    }
                    depth = depth + (number[k] * sine + number[k + 3] * (one - cosine)) * (1.0 / turn);
                }
                // A series of few terms swings below nothing and above the whole.
                depth.max(zero).min(number[0] * 0.5)
            }
        }
    }
}

/// Fills a row, and gives the optical depths and lengths of its cloud summed.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn march_row(
    map: &SunMap,
    shape: &Shape,
    noise: &DetailNoise,
    detail: Option<FrameDetail>,
    row: usize,
    out: &mut [f32],
) -> [f64; 2] {
    let (zero, one) = (Lanes::splat(0.0), Lanes::splat(1.0));
    let side = map.side;
    let steps = ((map.length_m / MAP_STEP_M).ceil() as usize).clamp(1, MAP_STEPS_MAX);
    let step = map.length_m / steps as f32;
    let per_pixel = [0, 1].map(|a| 1.0 / (map.per_period[a] * side as f32));
    let mut sums = [0.0f64; 2];
    for first in (0..side).step_by(LANES) {
        let x = Lanes::from_fn(|l| (first + l) as f32 * per_pixel[0] + 0.5 * per_pixel[0]);
        let y = Lanes::splat((row as f32 + 0.5) * per_pixel[1]);
        let mut kept = [zero; 7];
        // Of the others: where the cloud begins, where it ends, its depth.
        let (mut begins, mut ends, mut depth) = (Lanes::splat(map.length_m), zero, zero);
        let mut n = 0;
        while n < steps {
            let from_top = (n as f32 + 0.5) * step;
            let back = map.length_m - from_top;
            let p = [
                x + back * map.sun[0],
                y + back * map.sun[1],
                Lanes::splat(map.bottom_m + back * map.sun[2]),
            ];
            let empty = shape.empty_distance_m(p[0], p[1], p[2]);
            let clear = empty.smallest();
            if clear > 0.0 {
                n += ((clear / step) as usize).max(1);
                continue;
            }
            let t = Lanes::splat(MAP_DETAIL_DISTANCE_M);
            let met = detailed_extinction(shape, noise, detail, &p, t, MAP_DETAIL_DISTANCE_M) * step;
            // Each ray for itself, whatever rays are looked at together with it.
            let met = Lanes::select_less(zero, empty, zero, met);
            if met.any_above(0.0) {
                let here = Lanes::select_less(zero, met, one, zero);
                begins = Lanes::select_less(zero, met, begins.min(Lanes::splat(from_top - 0.5 * step)), begins);
                ends = Lanes::select_less(zero, met, Lanes::splat(from_top + 0.5 * step), ends);
                depth = depth + met;
                for l in 0..LANES {
                    sums[0] += f64::from(met.0[l]);
                    sums[1] += f64::from(here.0[l] * step);
                }
                if map.kind == MapKind::Fourier {
                    let share = from_top / map.length_m;
                    kept[0] = kept[0] + met * 2.0;
                    for k in 1..4 {
                        let (sine, cosine) = (std::f32::consts::TAU * k as f32 * share).sin_cos();
                        kept[k] = kept[k] + met * (2.0 * cosine);
                        kept[k + 3] = kept[k + 3] + met * (2.0 * sine);
                    }
                }
            }
            n += 1;
        }
        match map.kind {
            MapKind::Exponential => kept[0] = begins,
            MapKind::Beer => {
                let within = (ends - begins).max(Lanes::splat(0.5 * step));
                kept = [begins, depth / within, depth, zero, zero, zero, zero];
            }
            MapKind::Fourier => {}
        }
        for (k, values) in kept.iter().take(map.kind.numbers()).enumerate() {
            let bounded = values.clamp(-MAP_DEPTH_MAX, MAP_DEPTH_MAX);
            out[k * side + first..][..LANES].copy_from_slice(&bounded.0);
        }
    }
    sums
}
