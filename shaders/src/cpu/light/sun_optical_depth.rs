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
