//! Stage `slab_fit`: a plane-parallel slab fitted to the cloud around each place, by seed 000's one step.
//!
//! Reads: [`Shape`], the sun's direction. Writes: [`SlabFit`], at the shape's points near cloud: the optical depths towards the sun and against it (16 bits each, of their roots), and the normal of the
//! lit side (two numbers of 16 bits across the sun's direction; the third follows). Scheme: both depths by the march of stage `sun_optical_depth`, without its bound. The lit side is where the depth towards the
//! sun is nothing, and in a slab this depth falls along the normal: the normal is against its gradient, made a unit vector, and averaged over a block of a pyramid of [`NORMAL_BLOCK_M`] with the extinction as weight
//! (the mip level of seed 000, whose alpha channel is such a weight). At a place with the cosine mu between sun and normal the slab is mu times both depths thick, and the place lies mu times the depth towards the sun
//! deep in it. The march looks its light up in [`SlabSources`]. A [`SlabFit`] may hold three slabs a point, each for a group of orders, as what their depths are beyond the point's own: those of stage `slab_collector`.
//!
//! What is other than in seed 000: its maps hold one lit and one dark surface for each ray of the sun, where a field has several clouds on a ray; the grid has them all. Its thickness is
//! the distance along the sun between the two maps; along the normal it is mu times that, or a slab would be as thick as the sun is low. It takes the
//! light at one place of a ray of view, the light behind it included, which is nothing where one looks up from a slab's lit side, and so it sinks places to a tenth of the slab. Here every sample of the march has the
//! light that it scatters itself, which has no such holes.
//!
//! Keeps: each cloud sends out what it takes from the beam (part [`super::slab_balance`]).
//! Errors: a cloud ends sideways too; light that leaves there is in a slab only as the balance says, for the cloud as a whole, and what a cloud in another's shadow gets from its sides is lost. Order 1 in the points' distance.
//! A sun lower than 7 degrees to the lit side is taken as 7 degrees.

use std::ops::Range;

use multiversion::multiversion;
use rayon::prelude::*;

use super::slab_blocks::SlabBlocks;
use super::slab_tables::{Fitted, GROUPS, SUNS, SlabSources};
use super::sun_optical_depth::{marched_direction, margin_m, optical_depth};
use crate::cpu::view::lanes::{LANES, Lanes};
use crate::cpu::view::shape::{Shape, trilinear};

/// Normals are averaged over blocks of about this edge, m.
pub const NORMAL_BLOCK_M: f32 = 160.0;
/// Growth of a march's steps with distance: slopes are taken of the depths, so that they must not leap where a step crosses the far surface.
const MARCH_GROWTH: f32 = 0.03;
/// No depth is kept above this.
const DEPTH_MAX: f32 = 4095.0;
/// Steps of a root of depth, one over.
const ROOT_STEP: f32 = 1.0 / 1024.0;
/// Steps of a difference's root, and its code where there is none.
const SHIFT_STEP: f32 = 1.0 / 510.0;
const SHIFT_ZERO: f32 = 32_768.0;
/// Depths towards the sun are the march's own, with the detail near by, below this; the stage's above.
const OWN_DEPTH_MAX: f32 = 50.0;
/// Shares of a group's light: bits of each in a word, those bits, and a unit: up to 2.
pub(super) const SHARE_BITS: u32 = 10;
pub(super) const SHARE_MASK: u32 = (1 << SHARE_BITS) - 1;
pub(super) const SHARE_UNIT: f32 = 2.0 / SHARE_MASK as f32;
/// Least cosine between sun and normal: the tables' first.
pub(super) const COSINE_LEAST: f32 = 1.0 / SUNS as f32;

/// See the module.
#[derive(Clone, Debug)]
pub struct SlabFit {
    /// Depths towards the sun and against it at the points, laid out as the shape's words.
    pub(super) depths: Vec<u32>,
    /// Slabs, each for its groups of orders.
    pub(super) slabs: Vec<Slabs>,
    /// What share of each group's light is there, [`SHARE_BITS`] a group in steps of [`SHARE_UNIT`]; empty until the light is balanced, where all is.
    pub(super) shares: Vec<u32>,
    /// Unit vectors across the sun's direction, and towards the sun.
    pub(super) frame: [[f32; 3]; 3],
    pub(super) sources: SlabSources,
}

/// A slab for each of the shape's points.
#[derive(Clone, Debug)]
pub(super) struct Slabs {
    /// What its depths towards the sun and against it are beyond the point's own, by [`shift_code`]; empty where they are those.
    pub(super) shifts: Vec<u32>,
    /// Normals.
    pub(super) normals: Vec<u32>,
    /// Groups of orders that see this one.
    pub(super) groups: Range<usize>,
}

impl SlabFit {
    /// Fits. `carved` as in [`super::sun_optical_depth::SunLight::new`].
    pub fn new(shape: &Shape, carved: bool, sun_direction: [f32; 3], sources: SlabSources) -> SlabFit {
        let sun = marched_direction(sun_direction);
        let frame = across(sun);
        let field = Field::new(shape, carved, false, sun);
        let slabs = Slabs {
            shifts: Vec::new(),
            normals: field.normals(&frame),
            groups: 0..GROUPS,
        };
        let mut fit = SlabFit {
            depths: field.depths(),
            slabs: vec![slabs],
            shares: Vec::new(),
            frame,
            sources,
        };
        fit.balance(shape, carved);
        fit
    }

    /// Bytes kept.
    pub fn bytes(&self) -> u64 {
        let slabs = self.slabs.iter().map(|s| s.shifts.len() + s.normals.len());
        4 * (self.depths.len() + self.shares.len() + slabs.sum::<usize>()) as u64
    }

    /// What a unit of extinction at sixteen places in m scatters of orders from 2 on towards a camera that looks along `d`, over the irradiance of the sun's beam, 1/sr. `depth` is the optical depth towards
    /// the sun as the march has it, `turn` the cosine between `d` and the sun.
    #[inline(always)]
    pub(crate) fn towards(&self, shape: &Shape, p: &[Lanes; 3], d: &[Lanes; 3], depth: Lanes, turn: Lanes) -> Lanes {
        let one = Lanes::splat(1.0);
        let (index, f) = shape.place(p[0], p[1], p[2]);
        let corners = shape.corners(&self.depths, index);
        let staged = square_of_root(trilinear(&corners, 0, 0xffff, &f));
        let own = [
            Lanes::select_less(Lanes::splat(OWN_DEPTH_MAX), staged, staged, depth),
            square_of_root(trilinear(&corners, 16, 0xffff, &f)),
        ];
        let shares = (!self.shares.is_empty()).then(|| shape.corners(&self.shares, index));
        let mut sum = Lanes::splat(0.0);
        for slabs in &self.slabs {
            let [mut towards, mut against] = own;
            if !slabs.shifts.is_empty() {
                let corners = shape.corners(&slabs.shifts, index);
                let [to, from] = [0, 16].map(|shift| shift_of_code(trilinear(&corners, shift, 0xffff, &f)));
                let zero = Lanes::splat(0.0);
                (towards, against) = ((towards + to).max(zero), (against + from).max(zero));
            }
            let corners = shape.corners(&slabs.normals, index);
            let side = [0, 16].map(|shift| trilinear(&corners, shift, 0xffff, &f) * (2.0 / 65_535.0) - 1.0);
            let sun_cosine = (one - side[0] * side[0] - side[1] * side[1]).sqrt();
            let mut inward = sun_cosine * turn;
            for (n, axis) in side.iter().zip(&self.frame) {
                inward = inward + *n * (d[0] * axis[0] + d[1] * axis[1] + d[2] * axis[2]);
            }
            let across = turn - sun_cosine * inward;
            let sun_cosine = sun_cosine.max(Lanes::splat(COSINE_LEAST));
            let slab = Fitted {
                thickness: (towards + against) * sun_cosine,
                depth: towards * sun_cosine,
                sun_cosine,
            };
            let mut light = self.sources.towards(&slab, slabs.groups.clone(), inward, across);
            if let Some(corners) = &shares {
                light = light * trilinear(corners, SHARE_BITS * slabs.groups.start as u32, SHARE_MASK, &f) * SHARE_UNIT;
            }
            sum = sum + light;
        }
        sum
    }
}

/// Depths towards the sun and against it, packed.
fn packed_roots(towards: f32, against: f32) -> u32 {
    let root = |depth: f32| (depth.clamp(0.0, DEPTH_MAX).sqrt() / ROOT_STEP) as u32;
    root(towards) | root(against) << 16
}

/// Differences of both depths, packed: roots with their signs.
pub(super) fn shift_code(shifts: [f32; 2]) -> u32 {
    let code = |shift: f32| {
        let root = shift.abs().min(DEPTH_MAX).sqrt().copysign(shift);
        (SHIFT_ZERO + root / SHIFT_STEP).round().clamp(0.0, 65_535.0) as u32
    };
    code(shifts[0]) | code(shifts[1]) << 16
}

fn shift_of_code(code: Lanes) -> Lanes {
    let root = (code - SHIFT_ZERO) * SHIFT_STEP;
    let square = root * root;
    Lanes::select_less(root, Lanes::splat(0.0), Lanes::splat(0.0) - square, square)
}

/// The two numbers of a normal across the sun's direction, packed.
pub(super) fn normal_code([a, b]: [f32; 2]) -> u32 {
    let code = |v: f32| ((v.clamp(-1.0, 1.0) + 1.0) * 32_767.5) as u32;
    code(a) | code(b) << 16
}

#[inline(always)]
pub(super) fn square_of_root(root: Lanes) -> Lanes {
    root * root * (ROOT_STEP * ROOT_STEP)
}

/// Two unit vectors across a direction, and the direction.
pub(super) fn across(sun: [f32; 3]) -> [[f32; 3]; 3] {
    let sun = glam::Vec3::from_array(sun);
    let (a, b) = sun.any_orthonormal_pair();
    [a.to_array(), b.to_array(), sun.to_array()]
}

/// Depths at the shape's points, as stored; below 0 where there is no cloud near.
pub(super) struct Field<'a> {
    pub(super) shape: &'a Shape,
    pub(super) towards: Vec<f32>,
    pub(super) against: Vec<f32>,
    /// Extinction, 1/m.
    extinction: Vec<f32>,
}

impl Field<'_> {
    pub(super) fn new(shape: &Shape, carved: bool, everywhere: bool, sun: [f32; 3]) -> Field<'_> {
        let level_len = shape.stride[0] * shape.stride[1];
        let fill = |direction: [f32; 3]| {
            let mut depths = vec![-1.0f32; shape.words.len()];
            let levels = depths.par_chunks_mut(level_len).enumerate();
            levels.for_each(|(k, level)| fill_level(shape, carved, margin_m(everywhere), &direction, k, level));
            depths
        };
        let mut extinction = vec![0.0f32; shape.words.len()];
        extinction.par_chunks_mut(level_len).enumerate().for_each(|(k, level)| {
            for (n, to) in level.iter_mut().enumerate() {
                let (cover, amplitude) = shape.at_point(n % shape.stride[0], n / shape.stride[0], k);
                let [cover, amplitude] = [cover, amplitude].map(Lanes::splat);
                *to = shape.mean_extinction(cover, amplitude, carved).0[0];
            }
        });
        Field {
            shape,
            towards: fill(sun),
            against: fill(sun.map(|v| -v)),
            extinction,
        }
    }

    /// Depths, packed.
    pub(super) fn depths(&self) -> Vec<u32> {
        let sides = self.towards.par_iter().zip(&self.against);
        sides
            .map(|(towards, against)| packed_roots(*towards, *against))
            .collect()
    }

    /// Normals, averaged, packed.
    fn normals(&self, frame: &[[f32; 3]; 3]) -> Vec<u32> {
        let fine = self.fine_normals(frame);
        let mut blocks = SlabBlocks::new(self.shape, fine);
        while blocks.can_grow(NORMAL_BLOCK_M) {
            blocks = blocks.coarser();
        }
        let [row, rows] = self.shape.stride;
        let mut words = vec![0u32; self.towards.len()];
        words.par_chunks_mut(row * rows).enumerate().for_each(|(k, level)| {
            for (n, to) in level.iter_mut().enumerate() {
                // Stored rows and columns are one more than the point's own number.
                let place = [(n % row) as f32 - 1.0, (n / row) as f32 - 1.0, k as f32];
                let [a, b, c, weight] = blocks.look(place);
                let length = (a * a + b * b + c * c).sqrt();
                let [a, b] = if weight > 0.0 && length > 0.0 {
                    [a / length, b / length]
                } else {
                    [0.0; 2]
                };
                *to = normal_code([a, b]);
            }
        });
        words
    }

    /// Unit normals in the sun's frame times the extinction, and the extinction; of the points without their padding.
    pub(super) fn fine_normals(&self, frame: &[[f32; 3]; 3]) -> Vec<[f32; 4]> {
        let [nx, ny, nz] = self.shape.points;
        let [row, rows] = self.shape.stride;
        let mut fine = vec![[0.0f32; 4]; nx * ny * nz];
        fine.par_chunks_mut(nx * ny).enumerate().for_each(|(k, level)| {
            for (n, to) in level.iter_mut().enumerate() {
                let (i, j) = (n % nx + 1, n / nx + 1);
                let at = (k * rows + j) * row + i;
                let weight = self.extinction[at];
                if weight <= 0.0 || self.towards[at] < 0.0 {
                    continue;
                }
                let level_len = row * rows;
                let beside = [
                    [Some(at - 1), Some(at + 1)],
                    [Some(at - row), Some(at + row)],
                    [at.checked_sub(level_len), (k + 1 < nz).then_some(at + level_len)],
                ];
                let mut fall = [0.0f32; 3];
                for (a, [before, after]) in beside.into_iter().enumerate() {
                    let known = |n: Option<usize>| n.map(|n| self.towards[n]).filter(|depth| *depth >= 0.0);
                    let spacing = self.shape.point_spacing_m[a];
                    fall[a] = match (known(before), known(after)) {
                        (Some(before), Some(after)) => 0.5 * (before - after) / spacing,
                        (Some(before), None) => (before - self.towards[at]) / spacing,
                        (None, Some(after)) => (self.towards[at] - after) / spacing,
                        (None, None) => 0.0,
                    };
                }
                let turned = frame.map(|axis| fall[0] * axis[0] + fall[1] * axis[1] + fall[2] * axis[2]);
                // The lit side looks at the sun, whatever rounding says.
                let turned = [turned[0], turned[1], turned[2].max(0.0)];
                let length = turned.iter().map(|v| v * v).sum::<f32>().sqrt();
                let unit = if length > 0.0 {
                    turned.map(|v| v / length)
                } else {
                    [0.0, 0.0, 1.0]
                };
                *to = [unit[0] * weight, unit[1] * weight, unit[2] * weight, weight];
            }
        });
        fine
    }
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn fill_level(shape: &Shape, carved: bool, margin_m: f32, along: &[f32; 3], k: usize, level: &mut [f32]) {
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
            let depth = optical_depth(shape, carved, along, DEPTH_MAX, MARCH_GROWTH, x, y, z, near);
            for l in 0..LANES.min(width - first) {
                if near.0[l] > 0.0 {
                    row[first + l] = depth.0[l].min(DEPTH_MAX);
                }
            }
        }
    }
}
