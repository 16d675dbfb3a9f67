//! Stage `slab_collector`: a plane-parallel slab fitted to the cloud around each place by the original iteration of Bouthors et al. (2008), as seed 000 tells it.
//!
//! Reads: [`Shape`], the sun's direction, the tables of [`SlabSources`]. Writes: a [`SlabFit`] with three slabs a point, for each group of orders (2 to 4, 5 to 15, 16 and more) its own: what its optical depths
//! towards the sun and against it are beyond the place's own (16 bits each, of roots with their signs), its normal, and the share of the group's light that comes in at all (10 bits, times the cloud's balance).
//! Scheme: the collector is the part of the lit side through which almost all of a group's light came, a Gaussian with a centre and a deviation. It begins at the place itself, half as wide as the cloud is
//! deep. The depths at seven places of it (a rule that is exact under a Gaussian for polynomials of degree 5), on the plane through the place along the lit side, tell in the mean how thick a slab is
//! and how deep the place lies in it (equation 3.55); the normal is the one around the collector's centre. The tables say where in such a slab the light came in, and how widely: the next collector. A
//! step is no longer than half the deviation and changes it by no more than half (equations 3.61, 3.62); the iteration ends when the centre moves less than a tenth of it (3.63), or after [`STEPS`] steps.
//!
//! What is other than in seed 000, besides what stage `slab_fit` has: maps seen from the sun have one surface a ray, and the mean of what lies under a collector is that of the surface alone, alpha
//! dividing out the sky beside it. So a cloud's edge is as thick as its middle and is lit from all around, also from where there is nothing to scatter light its way: 1.4 to 3.6 times the light in real clouds.
//! Here a column counts for as much of the place's own depth along the sun as it has, at most wholly; the share that counts is the share of the group's light that is
//! there, and what is missing is sky: it makes the slab thinner by the share's root. By the share itself balls (below) would send out 0.80 to 0.91, not at all 0.85 to 1.10.
//! A step that breaks the limits is cut to them; the seed does not say what becomes of it. The spread is called the radius within which 95 % of the light came in there; within a Gaussian's deviation are 39 %, and all
//! lengths here are deviations. Normals look at the sun by their making, so that their mean over a wide collector is the sun's direction (by a low sun an error of 0.5 in place of 0.3): they
//! are those of blocks of [`NORMAL_BLOCK_M`] at the collector's centre, wider ones where no cloud is there.
//!
//! Keeps: in level slabs all places of a collector are alike, and the light is the one-step fit's (a test). Each cloud sends out what it takes from the beam ([`super::slab_balance`]; balls of optical depth 2.7 to 90,
//! a test); without the balance balls sent out 0.84 to 1.03, by the one step's slabs 1.23 to 1.32.
//! Errors: paths that leave a cloud sideways between where they came in and the place are counted as if the slab had kept them. The fixed point need not be the only one, and neighbours may end in different
//! slabs: seed 000 found its pictures noisy. Order 1 in the points' distance; a sun lower than 7 degrees to the lit side is taken as 7 degrees.
//! Source: Bouthors et al. (2008), by seed 000, sections 3.1.3 and 3.1.4.

use multiversion::multiversion;
use rayon::prelude::*;

use super::slab_blocks::SlabBlocks;
use super::slab_fit::{
    COSINE_LEAST, Field, NORMAL_BLOCK_M, SHARE_BITS, SHARE_UNIT, SlabFit, Slabs, across, normal_code, shift_code,
    square_of_root,
};
use super::slab_tables::{Fitted, GROUPS, SlabSources};
use super::sun_optical_depth::{marched_direction, margin_m};
use crate::cpu::view::lanes::{LANES, Lanes};
use crate::cpu::view::shape::{Shape, trilinear};

/// Steps at most.
pub const STEPS: usize = 10;
/// Numbers that blocks hold: the extinction's sum, and by it the normal and the extinction.
const SUMS: usize = 5;
/// Words of a slab: what its depths are beyond the place's own, and its normal.
const PLANES: usize = 2;
/// Words of a point: those of its slabs, and the shares of all groups.
const WORDS: usize = GROUPS * PLANES + 1;

type Vector = [Lanes; 3];

fn dot(a: &Vector, b: &Vector) -> Lanes {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
fn cross(a: &Vector, b: &Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}
fn plus(a: &Vector, b: &Vector, factor: Lanes) -> Vector {
    std::array::from_fn(|v| a[v] + b[v] * factor)
}
fn select(mask: Lanes, a: Lanes, b: Lanes) -> Lanes {
    Lanes::select_less(Lanes::splat(0.5), mask, a, b)
}

/// Seven points whose weighted sum is a Gaussian's integral of any polynomial of degree 5: the middle, half of all, and six around at twice the deviation.
const AROUND: usize = 6;
const MIDDLE_WEIGHT: f32 = 0.5;
/// A place's own thickness along the sun is taken as no less: what is thinner scatters nothing to speak of.
const THICKNESS_LEAST: f32 = 1e-6;

/// Shares are taken as no less where means are divided by their roots.
const SHARE_LEAST: f32 = 1e-6;

/// What the fit reads.
struct Input<'a> {
    shape: &'a Shape,
    /// Depths towards the sun and against it, at all points.
    depths: &'a [u32],
    /// Blocks of [`NORMAL_BLOCK_M`] and larger ones.
    levels: Vec<SlabBlocks<SUMS>>,
    sources: &'a SlabSources,
    sun: Vector,
}

/// A slab for sixteen places, and what share of its lit side has cloud under it.
#[derive(Clone, Copy)]
struct Found {
    slab: Fitted,
    normal: Vector,
    share: Lanes,
}

/// Fits. `carved` as in [`super::sun_optical_depth::SunLight::new`].
pub fn collected(shape: &Shape, carved: bool, sun_direction: [f32; 3], sources: SlabSources) -> SlabFit {
    let frame = across(marched_direction(sun_direction));
    let field = Field::new(shape, carved, true, frame[2]);
    let depths = field.depths();
    let input = Input {
        shape,
        depths: &depths,
        levels: pyramid(&field, &frame),
        sources: &sources,
        sun: frame[2].map(Lanes::splat),
    };
    let row = shape.stride[0];
    // Rows first, each with all its planes; then planes.
    let mut rows = vec![0u32; shape.words.len() * WORDS];
    rows.par_chunks_mut(row * WORDS)
        .enumerate()
        .for_each(|(n, out)| fit_row(&input, &frame, n, out));
    let plane = |plane: usize| -> Vec<u32> {
        let chunks = rows.chunks_exact(row * WORDS);
        chunks.flat_map(|chunk| &chunk[plane * row..][..row]).copied().collect()
    };
    let slabs = (0..GROUPS).map(|group| Slabs {
        shifts: plane(group * PLANES),
        normals: plane(group * PLANES + 1),
        groups: group..group + 1,
    });
    let mut fit = SlabFit {
        slabs: slabs.collect(),
        shares: plane(WORDS - 1),
        depths,
        frame,
        sources,
    };
    fit.balance(shape, carved);
    fit
}

/// Blocks of the fit's size and larger ones, the finest first.
fn pyramid(field: &Field<'_>, frame: &[[f32; 3]; 3]) -> Vec<SlabBlocks<SUMS>> {
    let shape = field.shape;
    let normals = field.fine_normals(frame);
    let fine = normals.iter().map(|[a, b, c, weight]| {
        let mut normal = [0.0f32; 3];
        for v in 0..3 {
            normal[v] = a * frame[0][v] + b * frame[1][v] + c * frame[2][v];
        }
        [*weight, normal[0], normal[1], normal[2], weight * weight]
    });
    let mut finest = SlabBlocks::new(shape, fine.collect());
    while finest.can_grow(NORMAL_BLOCK_M) {
        finest = finest.coarser();
    }
    let mut levels = vec![finest];
    let most_m = (shape.top_m - shape.bottom_m) * 2.0;
    while let Some(next) = levels.last().filter(|l| l.can_grow(most_m)).map(SlabBlocks::coarser) {
        levels.push(next);
    }
    levels
}

/// The mean normal and extinction (1/m) around a place in m; of a wider block where there is no cloud.
#[inline(always)]
fn under(input: &Input<'_>, place_m: [f32; 3]) -> Option<([f32; 3], f32)> {
    let spacing = input.shape.point_spacing_m;
    let place = [
        place_m[0] / spacing[0] - 0.5,
        place_m[1] / spacing[1] - 0.5,
        (place_m[2] - input.shape.bottom_m) / spacing[2] - 0.5,
    ];
    input.levels.iter().find_map(|level| {
        let [weight, x, y, z, square] = level.look(place);
        let length = (x * x + y * y + z * z).sqrt();
        (weight > 0.0 && length > 0.0).then(|| ([x, y, z].map(|v| v / length), square / weight))
    })
}

/// Depths towards the sun and against it at sixteen places in m. What is above or below the shape is looked up where the sun's ray through it leaves it.
#[inline(always)]
fn depths(input: &Input<'_>, p: &Vector) -> [Lanes; 2] {
    let shape = input.shape;
    let inside = p[2].clamp(shape.bottom_m, shape.top_m);
    let slide = (inside - p[2]) / input.sun[2].0[0];
    let [x, y, z] = plus(p, &input.sun, slide);
    let (index, f) = shape.place(x, y, z);
    let corners = shape.corners(input.depths, index);
    [0, 16].map(|shift| square_of_root(trilinear(&corners, shift, 0xffff, &f)))
}

/// Fits all groups of a row of points.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn fit_row(input: &Input<'_>, frame: &[[f32; 3]; 3], n: usize, out: &mut [u32]) {
    let shape = input.shape;
    let [row, rows] = shape.stride;
    let (j, k) = (n % rows, n / rows);
    // Where there is no cloud, the normal is the sun's direction.
    for group in 0..GROUPS {
        out[group * PLANES * row..][..row].fill(shift_code([0.0; 2]));
        out[(group * PLANES + 1) * row..][..row].fill(normal_code([0.0; 2]));
    }
    for first in (0..row).step_by(LANES) {
        let count = LANES.min(row - first);
        let spacing = shape.point_spacing_m;
        let p = [
            Lanes::from_fn(|l| ((first + l) as f32 - 0.5) * spacing[0]),
            Lanes::splat((j as f32 - 0.5) * spacing[1]),
            Lanes::splat(shape.bottom_m + (k as f32 + 0.5) * spacing[2]),
        ];
        let near = Lanes::splat(margin_m(false)) - shape.empty_distance_m(p[0], p[1], p[2]);
        if !near.any_above(0.0) {
            continue;
        }
        let own = depths(input, &p);
        for group in 0..GROUPS {
            let found = find(input, &p, &own, near, group);
            for l in 0..count {
                if near.0[l] <= 0.0 {
                    continue;
                }
                let cosine = found.slab.sun_cosine.0[l];
                let [thickness, depth] = [&found.slab.thickness, &found.slab.depth].map(|v| v.0[l] / cosine);
                let shift = [depth - own[0].0[l], thickness - depth - own[1].0[l]];
                let normal = found.normal.map(|v| v.0[l]);
                let side = |axis: &[f32; 3]| normal[0] * axis[0] + normal[1] * axis[1] + normal[2] * axis[2];
                out[group * PLANES * row + first + l] = shift_code(shift);
                out[(group * PLANES + 1) * row + first + l] = normal_code([side(&frame[0]), side(&frame[1])]);
                let share = (found.share.0[l].clamp(0.0, 1.0) / SHARE_UNIT + 0.5) as u32;
                out[(WORDS - 1) * row + first + l] |= share << (SHARE_BITS * group as u32);
            }
        }
    }
}

/// Two unit vectors along the lit sides that have these normals, the first towards where the beam comes from.
#[inline(always)]
fn along_lit_side(normal: &Vector, sun: &Vector, sun_cosine: Lanes) -> [Vector; 2] {
    let sine = (Lanes::splat(1.0) - sun_cosine * sun_cosine)
        .max(Lanes::splat(1e-6))
        .sqrt();
    let mut upstream: Vector = std::array::from_fn(|v| (sun[v] - sun_cosine * normal[v]) / sine);
    let length = dot(&upstream, &upstream).sqrt();
    for l in 0..LANES {
        // The sun straight above has no such side.
        if length.0[l] < 0.5 {
            let n = glam::Vec3::from_array(normal.map(|v| v.0[l]));
            let any = n.any_orthonormal_vector().to_array();
            for v in 0..3 {
                upstream[v].0[l] = any[v];
            }
        }
    }
    [upstream, cross(normal, &upstream)]
}

/// The mean depths towards the sun and against it under a collector, and the share of it that has as much cloud as a place whose own depths come to `own`.
#[inline(always)]
fn mean_depths(
    input: &Input<'_>,
    middle: &Vector,
    [upstream, sideways]: [&Vector; 2],
    spread: Lanes,
    own: Lanes,
) -> ([Lanes; 2], Lanes) {
    let [mut towards, mut against, mut share] = [Lanes::splat(0.0); 3];
    for n in 0..=AROUND {
        let (weight, at) = if n == 0 {
            (MIDDLE_WEIGHT, *middle)
        } else {
            let (sine, cosine) = (n as f32 * std::f32::consts::TAU / AROUND as f32).sin_cos();
            let at = plus(middle, upstream, spread * (2.0 * cosine));
            let weight = (1.0 - MIDDLE_WEIGHT) / AROUND as f32;
            (weight, plus(&at, sideways, spread * (2.0 * sine)))
        };
        let [to, from] = depths(input, &at);
        let there = ((to + from) / own).min(Lanes::splat(1.0)) * weight;
        towards = towards + to * there;
        against = against + from * there;
        share = share + there;
    }
    // Sky beside the cloud counts for half of what it is, in logarithms.
    let over = Lanes::splat(1.0) / share.max(Lanes::splat(SHARE_LEAST)).sqrt();
    ([towards * over, against * over], share)
}

/// The slabs of sixteen places for a group.
#[inline(always)]
fn find(input: &Input<'_>, p: &Vector, own: &[Lanes; 2], near: Lanes, group: usize) -> Found {
    let shape = input.shape;
    let sun = &input.sun;
    let (zero, one) = (Lanes::splat(0.0), Lanes::splat(1.0));
    let own = (own[0] + own[1]).max(Lanes::splat(THICKNESS_LEAST));
    let begin_m = 0.5 * (shape.top_m - shape.bottom_m);
    // Of the collector: its centre from the place, across the sun's direction, and its deviation, m.
    let mut centre = [zero; 3];
    let mut spread = Lanes::splat(begin_m);
    let mut going = Lanes::select_less(zero, near, one, zero);
    let mut found = Found {
        slab: Fitted {
            thickness: zero,
            depth: zero,
            sun_cosine: one,
        },
        normal: *sun,
        share: zero,
    };
    for _ in 0..STEPS {
        if !going.any_above(0.0) {
            break;
        }
        let mut normal = found.normal;
        let mut per_m = Lanes::splat(1e-9);
        for l in 0..LANES {
            if going.0[l] <= 0.0 {
                continue;
            }
            let slide = -(0..3).map(|v| normal[v].0[l] * centre[v].0[l]).sum::<f32>()
                / dot(&normal, sun).0[l].max(COSINE_LEAST);
            let place_m = std::array::from_fn(|v| p[v].0[l] + centre[v].0[l] + sun[v].0[l] * slide);
            match under(input, place_m) {
                Some((n, k)) => {
                    for v in 0..3 {
                        normal[v].0[l] = n[v];
                    }
                    per_m.0[l] = k.max(1e-9);
                }
                None => going.0[l] = 0.0,
            }
        }
        let sun_cosine = dot(&normal, sun).clamp(COSINE_LEAST, 1.0);
        let [upstream, sideways] = along_lit_side(&normal, sun, sun_cosine);
        let slide = (zero - dot(&normal, &centre)) / sun_cosine;
        let middle = plus(&plus(p, &centre, one), sun, slide);
        let ([towards, against], share) = mean_depths(input, &middle, [&upstream, &sideways], spread, own);
        let slab = Fitted {
            thickness: (towards + against) * sun_cosine,
            depth: towards * sun_cosine,
            sun_cosine,
        };
        found.slab.thickness = select(going, slab.thickness, found.slab.thickness);
        found.slab.depth = select(going, slab.depth, found.slab.depth);
        found.slab.sun_cosine = select(going, slab.sun_cosine, found.slab.sun_cosine);
        found.normal = std::array::from_fn(|v| select(going, normal[v], found.normal[v]));
        found.share = select(going, share, found.share);
        let [place, wide] = input.sources.collector(&slab, group);
        let entry = plus(
            &std::array::from_fn(|v| normal[v] * (slab.depth / per_m)),
            &upstream,
            place / per_m,
        );
        let along = dot(&entry, sun);
        let step: Vector = std::array::from_fn(|v| entry[v] - along * sun[v] - centre[v]);
        let length = dot(&step, &step).sqrt();
        let cut = (spread * 0.5 / length.max(Lanes::splat(1e-9))).min(one) * going;
        centre = plus(&centre, &step, cut);
        let still = Lanes::select_less(length, spread * 0.1, zero, going);
        let wanted = (wide / per_m).max(spread * 0.5).min(spread * 1.5);
        spread = select(going, wanted.min(Lanes::splat(begin_m)), spread);
        going = still;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::light::phase::henyey_greenstein;
    use crate::cpu::light::sun_optical_depth::optical_depth;
    use crate::{CloudVolume, Grid};

    const ASYMMETRY: f32 = 0.85;
    const SUN: [f32; 3] = [0.6, 0.0, 0.8];

    fn shape_of(cells: [usize; 3], cell_size_m: [f32; 3], extinction: &dyn Fn([f32; 3]) -> f32) -> Shape {
        let grid = Grid { cells, cell_size_m };
        let [nx, ny, nz] = cells;
        let extinction_per_m = (0..grid.len()).map(|n| {
            let place = [n % nx, n / nx % ny, n / grid.plane()];
            extinction(std::array::from_fn(|a| (place[a] as f32 + 0.5) * cell_size_m[a]))
        });
        let volume = CloudVolume {
            grid,
            extinction_per_m: extinction_per_m.collect(),
            cloudy_levels: [1, nz - 1],
            air_displacement_m: [0.0; 3],
        };
        Shape::new(&volume).unwrap()
    }

    fn both(shape: &Shape) -> [SlabFit; 2] {
        let sources = SlabSources::kept(ASYMMETRY).unwrap();
        [
            SlabFit::new(shape, false, SUN, sources.clone()),
            collected(shape, false, SUN, sources),
        ]
    }

    /// Of directions spread evenly over the sphere, number `n` of `count`.
    fn direction(n: usize, count: usize) -> [f32; 3] {
        let z = 1.0 - (2.0 * n as f32 + 1.0) / count as f32;
        let (sine, cosine) = (n as f32 * 2.399_963).sin_cos();
        let across = (1.0 - z * z).sqrt();
        [across * cosine, across * sine, z]
    }

    fn cosine(a: [f32; 3], b: [f32; 3]) -> f32 {
        a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    }

    /// A level slab is what both fit, whatever of it a collector looks at.
    #[test]
    fn a_level_slab_has_the_light_of_the_one_step_fit() {
        let cells = [12, 12, 26];
        for per_m in [0.002, 0.02, 0.1] {
            let shape = shape_of(cells, [100.0, 100.0, 40.0], &|p| {
                if p[2] > 200.0 && p[2] < 840.0 { per_m } else { 0.0 }
            });
            let fits = both(&shape);
            for n in 0..40 {
                let d = direction(n, 40);
                let p = [
                    Lanes::splat(517.0),
                    Lanes::splat(643.0),
                    Lanes::from_fn(|l| 205.0 + l as f32 * 42.0),
                ];
                let wanted = Lanes::splat(1.0);
                let depth = optical_depth(&shape, false, &SUN, 1e4, 0.03, p[0], p[1], p[2], wanted);
                let turn = Lanes::splat(cosine(d, SUN));
                let [one_step, iterated] = fits
                    .each_ref()
                    .map(|fit| fit.towards(&shape, &p, &d.map(Lanes::splat), depth, turn));
                for l in 0..LANES {
                    let (a, b) = (one_step.0[l], iterated.0[l]);
                    assert!(
                        (a - b).abs() < 0.02 * a.max(b) + 1e-4,
                        "{per_m} 1/m, {d:?}, lane {l}: {a} {b}"
                    );
                }
            }
        }
    }

    /// What leaves a ball over what it takes out of the beam, by light of the first order and what a fit says of the others.
    fn leaves(shape: &Shape, fit: &SlabFit) -> f64 {
        const COUNT: usize = 256;
        const STEP_M: f32 = 15.0;
        let mut places = Vec::new();
        for n in 0..24 * 20 * 30 {
            let p = [n % 24, n / 24 % 20, n / 480].map(|v| v as f32 + 0.5);
            let p = [p[0] * 100.0, p[1] * 100.0, p[2] * 40.0];
            if (p[0] - 1200.0).hypot(p[1] - 1000.0).hypot(p[2] - 600.0) < 620.0 {
                places.push(p);
            }
        }
        let packets: Vec<[f64; 2]> = places
            .par_chunks_exact(LANES)
            .map(|packet| {
                let p: Vector = std::array::from_fn(|a| Lanes::from_fn(|l| packet[l][a]));
                let extinction = |p: &Vector| {
                    let (cover, amplitude) = shape.sample(p[0], p[1], p[2]);
                    shape.mean_extinction(cover, amplitude, false)
                };
                // To the ball's other side, so that its images beyond the period are not met.
                let depth_along = |w: [f32; 3]| {
                    let mut depth = Lanes::splat(0.0);
                    for n in 0..80 {
                        let at = plus(&p, &w.map(Lanes::splat), Lanes::splat((n as f32 + 0.5) * STEP_M));
                        depth = depth + extinction(&at) * STEP_M;
                    }
                    depth
                };
                let here = extinction(&p);
                let depth = depth_along(SUN);
                let passed = (Lanes::splat(0.0) - depth).exp();
                let mut sums = [0.0f64; 2];
                let sum = |v: Lanes| v.0.iter().map(|v| f64::from(*v)).sum::<f64>();
                sums[0] += sum(here * passed);
                for n in 0..COUNT {
                    let d = direction(n, COUNT);
                    let turn = cosine(d, SUN);
                    let once = passed * henyey_greenstein(ASYMMETRY, turn);
                    let more = fit.towards(shape, &p, &d.map(Lanes::splat), depth, Lanes::splat(turn));
                    let out = (Lanes::splat(0.0) - depth_along(d.map(|v| -v))).exp();
                    sums[1] += sum(here * (once + more) * out) * 4.0 * std::f64::consts::PI / COUNT as f64;
                }
                sums
            })
            .collect();
        let [taken, left] = packets.iter().fold([0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
        left / taken
    }

    /// A ball ends sideways, where a slab does not.
    #[test]
    fn a_ball_sends_out_what_comes_in() {
        for per_m in [0.003, 0.01, 0.02, 0.1] {
            let shape = shape_of([24, 20, 30], [100.0, 100.0, 40.0], &|p| {
                let r_m = (p[0] - 1200.0).hypot(p[1] - 1000.0).hypot(p[2] - 600.0);
                if r_m < 450.0 { per_m } else { 0.0 }
            });
            let [one_step, iterated] = both(&shape).map(|fit| leaves(&shape, &fit));
            println!("{per_m} 1/m: {one_step:.3} {iterated:.3}");
            // Slabs alone know nothing of a ball's edge: 1.23 to 1.32 by one step, 0.84 to 1.03 by the collector (`slab_balance`). Directions and places differ from those of the balance.
            // In the densest ball a place here stands for a box of 10 optical depths, and the sums of this test are worse than the balance's (1.045); finer ones, of pictures, give 0.96 (`welkin ladder light`).
            let allowed = if per_m > 0.05 { 0.06 } else { 0.02 };
            for leaves in [one_step, iterated] {
                assert!((leaves - 1.0).abs() < allowed, "{per_m} 1/m: {leaves}");
            }
        }
    }
}
