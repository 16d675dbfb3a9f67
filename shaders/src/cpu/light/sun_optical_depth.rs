//! Stage `sun_optical_depth`: how much cloud lies between a place and the sun.
//!
//! Reads: [`Shape`], the sky's visibility at cell centres, the sun's direction. Writes: [`SunLight`]: at every point of the shape near cloud (everywhere, for light shafts),
//! packed in 32 bits, the optical depth towards the sun (16 bits, steps of 0.001, up to 65) and the two visibilities (8 bits
//! each); and a map of the optical depth seen from the clouds' lowest level, `[y][x]` as the shape's points, for shadows on
//! the ground. Scheme: a march from each point, steps of 10 m growing with distance (just behind a surface longer ones would miss the cloud before it), midpoint rule, empty space skipped, to
//! 12 km or to the top. A sun lower than 1.5 degrees is marched to at 1.5 degrees.

use multiversion::multiversion;
use rayon::prelude::*;

use crate::cpu::view::lanes::{LANES, Lanes};
use crate::cpu::view::shape::Shape;

crate::constants! {
    /// Optical depth a unit of the packed 16 bits.
    pub const DEPTH_UNIT: f32 = 0.001;
    /// Sine of the lowest elevation that is marched to, 1.5 degrees.
    pub const SUN_MARCHED_SINE_LEAST: f32 = 0.026;
    /// No march goes farther, m.
    pub(crate) const SUN_MARCH_REACH_M: f32 = 12_000.0;
    /// Length of the first step, m.
    const SUN_MARCH_STEP_M: f32 = 10.0;
    /// Growth of steps with distance.
    const SUN_MARCH_STEP_GROWTH: f32 = 0.12;
    /// Steps at most.
    const SUN_MARCH_STEPS: u32 = 200;
    /// Optical depth at which a march ends: nothing more is to be learnt.
    pub(crate) const SUN_MARCH_DEEP: f32 = 60.0;
}

/// Where light is wanted in cloud alone, points farther than this from it are left empty, m.
const SUN_LIGHT_MARGIN_M: f32 = 130.0;

/// See the module.
#[derive(Clone, Debug)]
pub struct SunLight {
    /// Optical depth and visibilities, laid out as [`Shape::words`].
    pub words: Vec<u32>,
    /// Optical depth towards the sun from the shape's lowest level, laid out as one padded level of the shape.
    pub shadow: Vec<f32>,
    /// Mean over the map of the share of sunlight that passes the clouds.
    pub sunlit_share: f32,
}

/// The sun's direction as it is marched to: never lower than 1.5 degrees, a unit vector.
pub fn marched_direction(sun_direction: [f32; 3]) -> [f32; 3] {
    let z = sun_direction[2].clamp(SUN_MARCHED_SINE_LEAST, 1.0);
    let side = (sun_direction[0].powi(2) + sun_direction[1].powi(2)).sqrt();
    let scale = (1.0 - z * z).sqrt();
    let [x, y] = if side > 1e-6 {
        [sun_direction[0] / side, sun_direction[1] / side]
    } else {
        [1.0, 0.0]
    };
    [x * scale, y * scale, z]
}

/// Points farther than this from cloud are left empty, m.
pub(crate) fn margin_m(everywhere: bool) -> f32 {
    if everywhere { f32::MAX } else { SUN_LIGHT_MARGIN_M }
}

impl SunLight {
    /// Marches from every point near cloud, or from all of the slab's points, for who looks at the air between the clouds.
    pub fn new(
        shape: &Shape,
        visibility: &[Vec<f32>; 2],
        carved: bool,
        everywhere: bool,
        sun_direction: [f32; 3],
    ) -> SunLight {
        let sun = marched_direction(sun_direction);
        let margin_m = margin_m(everywhere);
        let level_len = shape.stride[0] * shape.stride[1];
        let mut words = vec![0u32; shape.words.len()];
        words.par_chunks_mut(level_len).enumerate().for_each(|(k, level)| {
            let up = shape.smoothed_level(&visibility[0], k);
            let down = shape.smoothed_level(&visibility[1], k);
            fill_level(shape, carved, margin_m, &sun, k, &up, &down, level);
        });
        let mut shadow = vec![0.0f32; level_len];
        shadow
            .par_chunks_mut(shape.stride[0])
            .enumerate()
            .for_each(|(y, row)| fill_shadow_row(shape, carved, &sun, y, row));
        let sunlit_share = shadow.iter().map(|t| (-t).exp()).sum::<f32>() / level_len as f32;
        SunLight {
            words,
            shadow,
            sunlit_share,
        }
    }
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn fill_level(
    shape: &Shape,
    carved: bool,
    margin_m: f32,
    sun: &[f32; 3],
    k: usize,
    up: &[f32],
    down: &[f32],
    level: &mut [u32],
) {
    let width = shape.stride[0];
    let z = Lanes::splat(shape.bottom_m + (k as f32 + 0.5) * shape.point_spacing_m[2]);
    for (n, row) in level.chunks_mut(width).enumerate() {
        let y = Lanes::splat((n as f32 - 0.5) * shape.point_spacing_m[1]);
        for first in (0..width).step_by(LANES) {
            let x = Lanes::from_fn(|l| ((first + l) as f32 - 0.5) * shape.point_spacing_m[0]);
            let near = Lanes::splat(margin_m) - shape.empty_distance_m(x, y, z);
            if !near.any_above(0.0) {
                continue;
            }
            let depth = optical_depth(shape, carved, sun, SUN_MARCH_DEEP, SUN_MARCH_STEP_GROWTH, x, y, z, near);
            for l in 0..LANES.min(width - first) {
                // Each point for itself, whatever points are looked at together with it.
                if near.0[l] <= 0.0 {
                    continue;
                }
                let d = (depth.0[l] / DEPTH_UNIT).min(65_535.0) as u32;
                let share = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u32;
                let at = n * width + first + l;
                row[first + l] = d | share(up[at]) << 16 | share(down[at]) << 24;
            }
        }
    }
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn fill_shadow_row(shape: &Shape, carved: bool, sun: &[f32; 3], n: usize, row: &mut [f32]) {
    let z = Lanes::splat(shape.bottom_m);
    let y = Lanes::splat((n as f32 - 0.5) * shape.point_spacing_m[1]);
    for first in (0..row.len()).step_by(LANES) {
        let x = Lanes::from_fn(|l| ((first + l) as f32 - 0.5) * shape.point_spacing_m[0]);
        let depth = optical_depth(
            shape,
            carved,
            sun,
            SUN_MARCH_DEEP,
            SUN_MARCH_STEP_GROWTH,
            x,
            y,
            z,
            Lanes::splat(1.0),
        );
        let count = LANES.min(row.len() - first);
        row[first..first + count].copy_from_slice(&depth.0[..count]);
    }
}

/// Optical depth along a direction up to where it is above `deep`, by steps that grow by the share `growth` of the way, of the lanes whose `wanted` is above 0.
#[inline(always)]
pub(crate) fn optical_depth(
    shape: &Shape,
    carved: bool,
    along: &[f32; 3],
    deep: f32,
    growth: f32,
    x: Lanes,
    y: Lanes,
    z: Lanes,
    wanted: Lanes,
) -> Lanes {
    let zero = Lanes::splat(0.0);
    let mut depth = zero;
    let mut t = zero;
    let last_m = if along[2] > 0.0 { shape.top_m } else { shape.bottom_m };
    // Lanes that are not wanted start at the end.
    let end = Lanes::select_less(
        zero,
        wanted,
        ((Lanes::splat(last_m) - z) / along[2]).min(Lanes::splat(SUN_MARCH_REACH_M)),
        zero,
    );
    for _ in 0..SUN_MARCH_STEPS {
        if !(end - t).any_above(0.0) {
            break;
        }
        let step = t * growth + SUN_MARCH_STEP_M;
        let at = t + step * 0.5;
        let (px, py, pz) = (x + at * along[0], y + at * along[1], z + at * along[2]);
        let empty = shape.empty_distance_m(px, py, pz);
        let inside = Lanes::select_less(zero, empty, zero, Lanes::select_less(at, end, Lanes::splat(1.0), zero));
        if inside.any_above(0.0) {
            let (cover, amplitude) = shape.sample(px, py, pz);
            depth = depth + shape.mean_extinction(cover, amplitude, carved) * step * inside;
        }
        t = t + step.max(empty);
        t = Lanes::select_less(Lanes::splat(deep), depth, end, t);
    }
    depth
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::{CloudVolume, Grid};

    /// The shape of a cloud whose cells have these extinctions, 1/m.
    pub(crate) fn shape_of(cells: [usize; 3], cell_size_m: [f32; 3], extinction: impl Fn([usize; 3]) -> f32) -> Shape {
        let grid = Grid { cells, cell_size_m };
        let [nx, plane] = [cells[0], grid.plane()];
        let extinction_per_m: Vec<f32> = (0..grid.len())
            .map(|n| extinction([n % nx, n / nx % cells[1], n / plane]))
            .collect();
        let full = |k: &usize| extinction_per_m[k * plane..][..plane].iter().any(|v| *v > 0.0);
        let cloudy_levels = [
            (0..cells[2]).find(full).unwrap(),
            (0..cells[2]).rfind(full).unwrap() + 1,
        ];
        let volume = CloudVolume {
            grid,
            extinction_per_m,
            cloudy_levels,
            air_displacement_m: [0.0; 3],
        };
        Shape::new(&volume).unwrap()
    }

    /// Heaps of cells of uneven extinction with gaps between, up to 0.02 per m.
    pub(crate) fn ragged(cells: [usize; 3], cell_size_m: [f32; 3]) -> Shape {
        shape_of(cells, cell_size_m, |[i, j, k]| {
            let hash = |n: usize| (n.wrapping_mul(2_654_435_761) >> 7) % 1000;
            let heap = hash(7 + i / 2 + 31 * (j / 2)) < 550 && k > 1 && k + 2 < cells[2];
            if heap {
                2e-5 * hash(i + 17 * j + 331 * k) as f32
            } else {
                0.0
            }
        })
    }

    /// Optical depth from a place up to the top: midpoints at most a metre apart, summed in 64 bits. It looks up the very field that the
    /// stages march through, so that what differs from theirs is how they went, not where.
    pub(crate) fn fine_depth(shape: &Shape, along: [f32; 3], from: [f64; 3]) -> f64 {
        let along = along.map(f64::from);
        let way = (f64::from(shape.top_m) - from[2]) / along[2];
        let packets = (way / LANES as f64).ceil().max(1.0) as usize;
        let step = way / (packets * LANES) as f64;
        let mut depth = 0.0;
        for n in 0..packets {
            let [x, y, z] = [0, 1, 2]
                .map(|a| Lanes::from_fn(|l| (from[a] + ((n * LANES + l) as f64 + 0.5) * step * along[a]) as f32));
            let (cover, amplitude) = shape.sample(x, y, z);
            let extinction = shape.mean_extinction(cover, amplitude, false);
            depth += extinction.0.iter().map(|v| f64::from(*v)).sum::<f64>() * step;
        }
        depth
    }

    /// At every point, and in the ground's map, the depth is that of a fine march. What is left is where steps cut cloud: they grow by 12 % of the way, so that an
    /// edge of extinction e at the distance t may be missed by 0.06 t e, a tenth of a thin cloud's depth; in the mean square most of it evens out.
    #[test]
    fn depths_are_those_of_a_fine_march() {
        let shape = ragged([12, 10, 16], [100.0, 100.0, 40.0]);
        for sun in [[0.0, 0.0, 1.0], [0.48, -0.36, 0.8], [-0.9, 0.1, 0.35]] {
            let sun = marched_direction(sun);
            let seen = vec![1.0f32; shape.slab_per_m.len()];
            let light = SunLight::new(&shape, &[seen.clone(), seen], false, true, sun);
            let (mut worst, mut square, mut deepest, mut count) = (0.0f64, 0.0, 0.0f64, 0);
            let mut judge = |ours: f64, theirs: f64| {
                // Packed depths end at 65, marches at 60.
                let (ours, theirs) = (ours.min(60.0), theirs.min(60.0));
                worst = worst.max((ours - theirs).abs() / (0.2 + theirs));
                square += (ours - theirs).powi(2) / (0.2 + theirs).powi(2);
                deepest = deepest.max(theirs);
                count += 1;
            };
            let level_len = shape.stride[0] * shape.stride[1];
            for at in (0..shape.words.len()).step_by(7) {
                let [i, j, k] = [at % shape.stride[0], at % level_len / shape.stride[0], at / level_len];
                let spacing = shape.point_spacing_m.map(f64::from);
                let place = [
                    (i as f64 - 0.5) * spacing[0],
                    (j as f64 - 0.5) * spacing[1],
                    f64::from(shape.bottom_m) + (k as f64 + 0.5) * spacing[2],
                ];
                let ours = f64::from(light.words[at] & 0xffff) * f64::from(DEPTH_UNIT);
                judge(ours, fine_depth(&shape, sun, place));
                if k == 0 {
                    let ground = [place[0], place[1], f64::from(shape.bottom_m)];
                    judge(f64::from(light.shadow[at]), fine_depth(&shape, sun, ground));
                }
            }
            let mean = (square / f64::from(count)).sqrt();
            assert!(deepest > 3.0, "nothing was tested: {deepest}");
            assert!(worst < 0.15 && mean < 0.02, "{sun:?}: {worst} {mean}");
        }
    }
}
