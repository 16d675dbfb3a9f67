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

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::super::sun_optical_depth::tests::{fine_depth, ragged, shape_of};
    use super::*;

    const KINDS: [MapKind; 3] = [MapKind::Exponential, MapKind::Beer, MapKind::Fourier];
    /// 53 degrees high.
    const SUN: [f32; 3] = [0.36, -0.48, 0.8];
    const SIDE: u32 = 16;
    /// A level's depth of [`layers`], m.
    const LEVEL_M: f64 = 10.0;

    fn map_of(shape: &Shape, kind: MapKind, sun: [f32; 3]) -> SunMap {
        SunMap::new(shape, &DetailNoise::new(), None, kind, SIDE, sun)
    }

    fn depth_at(map: &SunMap, place: [f64; 3]) -> f64 {
        let [x, y, z] = place.map(|v| Lanes::splat(v as f32));
        f64::from(map.optical_depth(x, y, z).0[3])
    }

    /// A place on the ray through a texel's centre, so far down from the top.
    fn on_ray(map: &SunMap, texel: [usize; 2], from_top: f64) -> [f64; 3] {
        let back = f64::from(map.length_m) - from_top;
        let start = |a: usize| (texel[a] as f64 + 0.5) / (f64::from(map.per_period[a]) * map.side as f64);
        let sun = map.sun.map(f64::from);
        [
            start(0) + back * sun[0],
            start(1) + back * sun[1],
            f64::from(map.bottom_m) + back * sun[2],
        ]
    }

    /// Homogeneous layers: first level, one past the last, extinction in 1/m.
    fn layers(of: &[(usize, usize, f32)]) -> Shape {
        shape_of([4, 4, 120], [100.0, 100.0, LEVEL_M as f32], |[_, _, k]| {
            let here = of.iter().find(|(first, end, _)| (*first..*end).contains(&k));
            here.map_or(0.0, |layer| layer.2)
        })
    }

    /// What an edge may cost: the spline makes a ramp of two levels of it, and a step lies across it; a line through the middle of both is off by
    /// half of that.
    fn edge(extinction: f64) -> f64 {
        0.5 * extinction * (2.0 * LEVEL_M / f64::from(SUN[2]) + f64::from(MAP_STEP_M))
    }

    /// How far a series of three terms swings about a function of so much variation (1/m, up and down) on a ray of so many metres, integrated: what
    /// is left out is the sum over k > 3 of two terms of at most variation / (2 pi^2 k^2), of each end of the integral.
    fn ringing(variation: f64, length: f64) -> f64 {
        let left: f64 = (4..100_000).map(|k| 0.5 / (PI * f64::from(k)).powi(2)).sum();
        2.0 * left * variation * length
    }

    /// Within one homogeneous cloud the exponential and the Beer map are exact but for its edges, the Fourier map but for its ringing.
    #[test]
    fn one_cloud_is_as_deep_as_a_fine_march_finds() {
        let extinction = 0.005;
        let shape = layers(&[(30, 90, extinction as f32)]);
        for kind in KINDS {
            let map = map_of(&shape, kind, SUN);
            let length = f64::from(map.length_m);
            for n in 0..=50 {
                let from_top = length * f64::from(n) / 50.0;
                let place = on_ray(&map, [3, 9], from_top);
                let (ours, truth) = (depth_at(&map, place), fine_depth(&shape, map.sun, place));
                let allowed = match kind {
                    MapKind::Fourier => ringing(2.0 * extinction, length) + edge(extinction),
                    MapKind::Exponential | MapKind::Beer => edge(extinction),
                };
                assert!(
                    (ours - truth).abs() < allowed,
                    "{kind:?}, {from_top} m: {ours} {truth} {allowed}"
                );
            }
        }
    }

    /// Two clouds, the upper twice as thick as the lower: what each map makes of the gap is known, and no more than that.
    #[test]
    fn two_clouds_show_what_each_map_leaves_out() {
        let (upper, lower) = (0.008, 0.004);
        let shape = layers(&[(20, 50, lower as f32), (80, 110, upper as f32)]);
        let [exponential, beer, fourier] = KINDS.map(|kind| map_of(&shape, kind, SUN));
        let length = f64::from(beer.length_m);
        // Along the ray: a clear level, a cloud, as much clear air, a cloud, a clear level.
        let begins = LEVEL_M / f64::from(SUN[2]);
        let cloud = 30.0 * begins;
        let whole = (upper + lower) * cloud;
        // Steps that are partly clear lower the mean, by an edge on either side of a cloud.
        let mean = f64::from(exponential.mean_per_m);
        let most = 0.5 * (upper + lower);
        assert!(
            mean <= 1.001 * most && mean > most / (1.0 + 4.0 * edge(1.0) / cloud),
            "{mean}"
        );
        let mut gap: f64 = 0.0;
        for n in 0..=92 {
            let from_top = length * f64::from(n) / 92.0;
            let place = on_ray(&beer, [12, 2], from_top);
            let truth = fine_depth(&shape, beer.sun, place);
            let [e, b, f] = [&exponential, &beer, &fourier].map(|map| depth_at(map, place));
            let since = (from_top - begins).max(0.0);
            // One extinction for all from where cloud begins, gaps and what lies under the last cloud included: right at neither depth here.
            assert!(
                (e - mean * since).abs() < edge(upper),
                "exponential, {from_top} m: {e} {}",
                mean * since
            );
            // A straight line from the first cloud's top to the last one's base.
            let line = (whole * since / (3.0 * cloud)).min(whole);
            assert!((b - line).abs() < edge(upper), "Beer, {from_top} m: {b} {line}");
            gap = gap.max(truth - b);
            let swing = ringing(2.0 * (upper + lower), length) + edge(upper);
            assert!((f - truth).abs() < swing, "Fourier, {from_top} m: {f} {truth} {swing}");
        }
        // The line misses most where the upper cloud ends: a third of the way with two thirds of the depth.
        assert!((gap - whole / 3.0).abs() < edge(upper), "{gap} {whole}");
        // At the lowest level, and there alone, both hold the whole.
        for map in [&beer, &fourier] {
            let ours = depth_at(map, on_ray(map, [12, 2], length));
            assert!((ours - whole).abs() < 0.01 * whole, "{ours} {whole}");
        }
    }

    /// Of ragged clouds and a sun from the side each ray's whole depth is that of a fine march down the same ray.
    #[test]
    fn whole_depths_of_ragged_clouds_are_those_of_a_fine_march() {
        let shape = ragged([12, 10, 16], [100.0, 100.0, 40.0]);
        for kind in [MapKind::Beer, MapKind::Fourier] {
            let map = map_of(&shape, kind, SUN);
            let mut deepest: f64 = 0.0;
            for n in 0..map.side * map.side {
                let place = on_ray(&map, [n % map.side, n / map.side], f64::from(map.length_m));
                let (ours, truth) = (depth_at(&map, place), fine_depth(&shape, map.sun, place));
                deepest = deepest.max(truth);
                // Midpoints 30 m apart see a field whose cells are 40 m high and whose extinction reaches 0.02 per m.
                assert!(
                    (ours - truth).abs() < 0.1 + 0.02 * truth,
                    "{kind:?}, {n}: {ours} {truth}"
                );
            }
            assert!(deepest > 2.0, "nothing was tested: {deepest}");
        }
    }

    /// Each coefficient for itself: of an extinction `1 + 0.8 cos(2 pi k s)` only a_k stands out, of `1 + 0.8 sin(2 pi k s)` only b_k, s from top to bottom.
    #[test]
    fn fourier_coefficients_are_recovered_one_by_one() {
        const CELLS: usize = 120;
        // The ray also crosses a clear level above and below.
        let share = |k: usize| 1.0 - (k as f64 + 1.5) / (CELLS + 2) as f64;
        for shines in 1..7 {
            let wave = |n: usize, s: f64| match n {
                0 => 1.0,
                1..4 => (2.0 * PI * n as f64 * s).cos(),
                _ => (2.0 * PI * (n - 3) as f64 * s).sin(),
            };
            let extinction = |k: usize| 0.003 * (1.0 + 0.8 * wave(shines, share(k)));
            // A cloud that stood on the ground would go on below it.
            let shape = shape_of([4, 4, CELLS + 1], [100.0, 100.0, LEVEL_M as f32], |[_, _, k]| {
                if k == 0 { 0.0 } else { extinction(k - 1) as f32 }
            });
            let map = map_of(&shape, MapKind::Fourier, SUN);
            let numbers: Vec<f64> = (0..7)
                .map(|n| f64::from(map.planes[n * map.side * map.side + 37]))
                .collect();
            for (n, ours) in numbers.iter().enumerate() {
                let terms = (0..CELLS).map(|k| extinction(k) * wave(n, share(k)));
                let wanted = 2.0 * terms.sum::<f64>() * LEVEL_M / f64::from(SUN[2]);
                // Midpoints 30 m apart are exact to their share of the two edges.
                assert!(
                    (ours - wanted).abs() < 0.01 * numbers[0],
                    "{n} of {shines}: {ours} {wanted}"
                );
                let stands_out = ours.abs() > 0.2 * numbers[0];
                assert_eq!(stands_out, n == 0 || n == shines, "{shines}: {numbers:?}");
            }
        }
    }

    /// On texels' borders and corners and at the map's seam depths lie between those of the rays around, and are the same a period on.
    #[test]
    fn borders_lie_between_their_texels() {
        let shape = ragged([8, 8, 12], [100.0, 100.0, 40.0]);
        let texel = 800.0 / f64::from(SIDE);
        for kind in KINDS {
            let map = map_of(&shape, kind, [0.0, 0.0, 1.0]);
            let mut judged = 0;
            let height = f64::from(shape.top_m - shape.bottom_m);
            for level in 0..6 {
                let z = f64::from(shape.bottom_m) + height * f64::from(level) / 6.0;
                for n in 0..17 * 17 {
                    // The seam is among them, twice.
                    let [i, j] = [n % 17, n / 17];
                    let [x, y] = [f64::from(i) * texel, f64::from(j) * texel];
                    let ours = depth_at(&map, [x, y, z]);
                    assert!(ours.is_finite() && ours >= 0.0, "{kind:?}: {ours}");
                    for period in [-8_000.0, -800.0, 800.0, 80_000.0] {
                        let moved = depth_at(&map, [x + period, y - period, z]);
                        // A place is known to some thousandths of a metre there.
                        assert!(
                            (moved - ours).abs() < 1e-3 * (1.0 + ours),
                            "{kind:?}, {period}: {moved} {ours}"
                        );
                    }
                    let around = [[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]];
                    let centre = |a: [f64; 2], z: f64| depth_at(&map, [x + a[0] * texel, y + a[1] * texel, z]);
                    let depths = around.map(|a| centre(a, z));
                    // The Fourier map's series are mixed before they are bounded: where a ray's is, the mixture may lie beyond it.
                    let bottom = f64::from(shape.bottom_m);
                    let inside = |n: usize| depths[n] > 1e-3 && depths[n] < centre(around[n], bottom) - 1e-3;
                    if kind == MapKind::Fourier && level > 0 && !(0..4).all(inside) {
                        continue;
                    }
                    judged += usize::from(ours > 1e-3);
                    let least = depths.iter().copied().fold(f64::INFINITY, f64::min);
                    let most = depths.iter().copied().fold(0.0, f64::max);
                    let rounding = 1e-4 * (1.0 + most);
                    assert!(
                        (least - rounding..=most + rounding).contains(&ours),
                        "{kind:?}, {i} {j}: {ours} {depths:?}"
                    );
                }
            }
            assert!(judged > 100, "{kind:?}: {judged}");
        }
    }
}
