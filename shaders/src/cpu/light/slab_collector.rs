//! Stage `slab_collector`: a plane-parallel slab fitted to the cloud around each place by the original iteration of Bouthors et al. (2008), as seed 000 tells it.
//!
//! Reads: [`Shape`], the sun's direction, the tables of [`SlabSources`]. Writes: a [`SlabFit`] of three slabs a point, for each group of orders (2 to 4, 5 to 15, 16 and more) its own.
//! Scheme: the collector is the area of the lit side through which almost all of a group's light came. It begins at the place itself, as large as the
//! cloud is deep. What lies under it, the means of a pyramid's blocks of its size (normal, extinction, depth along the sun from lit to dark side), and the depth of its centre make a slab; the tables say where in such
//! a slab the light came in, and how widely: the next collector. A step is no longer
//! than half the collector's radius and changes it by no more than half (equations 3.61, 3.62); it ends when the centre moves less than a tenth of the radius (3.63), or after [`STEPS`] steps.
//!
//! As in stage `slab_fit` the depths come from a grid in place of maps, and a block that holds no cloud is widened until it does. What is other than in seed 000: the limits there are conditions, and it does not say what to do with a step that breaks
//! them; here it is cut to them. Its spread is called the radius within which 95 % came in; a Gaussian has 39 % within its deviation and 95 % within 2.45 of them. The block's edge is that of an even square of the same deviation, 12^(1/2) of it, and the limits use the deviation.
//! A beam's own light needs no collector.
//!
//! Errors: those of stage `slab_fit`; and the fixed point need not be the only one, so that neighbours may end in different slabs: seed 000 found its pictures noisy. Details smaller than a point are lost.
//! Source: Bouthors et al. (2008), by seed 000, sections 3.4.1 to 3.4.3.

use multiversion::multiversion;
use rayon::prelude::*;

use super::slab_blocks::SlabBlocks;
use super::slab_fit::{COSINE_LEAST, Field, SlabFit, Slabs, across, normal_code, roots};
use super::slab_tables::{Fitted, GROUPS, SlabSources, SlabTables};
use super::sun_optical_depth::marched_direction;
use crate::cpu::view::lanes::{LANES, Lanes};
use crate::cpu::view::shape::Shape;

/// Steps at most.
pub const STEPS: usize = 10;
/// Numbers that blocks hold: the extinction's sum, and by it towards the sun, against it, the normal, the extinction.
const SUMS: usize = 7;
/// Words of a slab: its depths and its normal.
const PLANES: usize = 2;

/// What lies under a collector.
#[derive(Clone, Copy)]
struct Under {
    /// Optical depth towards the sun at the centre itself, and from lit to dark side along the sun in the mean.
    towards: f32,
    whole: f32,
    normal: [f32; 3],
    per_m: f32,
}

/// The state of sixteen places on their way to a fixed point.
struct Way {
    /// Centre of the collector, from the place, m; across the sun's direction.
    centre: [[f32; 3]; LANES],
    /// Its deviation, m.
    spread: [f32; LANES],
    done: [bool; LANES],
    under: [Option<Under>; LANES],
    slab: Fitted,
}

/// Fits. `carved` as in [`super::sun_optical_depth::SunLight::new`]. None where the program's tables are damaged.
pub fn collected(shape: &Shape, carved: bool, sun_direction: [f32; 3], asymmetry: f32) -> Option<SlabFit> {
    let sources = SlabSources::new(SlabTables::kept()?, asymmetry);
    let frame = across(marched_direction(sun_direction));
    let field = Field::new(shape, carved, frame[2]);
    let levels = pyramid(&field, &frame);
    let row = shape.stride[0];
    // Rows first, each with all its planes; then planes.
    let mut rows = vec![0u32; shape.words.len() * GROUPS * PLANES];
    rows.par_chunks_mut(row * GROUPS * PLANES)
        .enumerate()
        .for_each(|(n, out)| fit_row(&field, &levels, &sources, &frame, n, out));
    let plane = |plane: usize| {
        let chunks = rows.chunks_exact(row * GROUPS * PLANES);
        chunks.flat_map(|chunk| &chunk[plane * row..][..row]).copied().collect()
    };
    let slabs = (0..GROUPS).map(|group| Slabs {
        depths: plane(group * PLANES),
        normals: plane(group * PLANES + 1),
        groups: group..group + 1,
        own_depth_max: -1.0,
    });
    Some(SlabFit {
        slabs: slabs.collect(),
        frame,
        sources,
    })
}

/// Blocks of all sizes, the finest first.
fn pyramid(field: &Field<'_>, frame: &[[f32; 3]; 3]) -> Vec<SlabBlocks<SUMS>> {
    let shape = field.shape;
    let normals = field.fine_normals(frame);
    let [nx, ny, _] = shape.points;
    let [row, rows] = shape.stride;
    let fine = normals.iter().enumerate().map(|(n, [a, b, c, weight])| {
        let (i, j, k) = (n % nx + 1, n / nx % ny + 1, n / (nx * ny));
        let at = (k * rows + j) * row + i;
        let mut normal = [0.0f32; 3];
        for v in 0..3 {
            normal[v] = a * frame[0][v] + b * frame[1][v] + c * frame[2][v];
        }
        [
            *weight,
            weight * field.towards[at],
            weight * field.against[at],
            normal[0],
            normal[1],
            normal[2],
            weight * weight,
        ]
    });
    let mut levels = vec![SlabBlocks::new(shape, fine.collect())];
    let most_m = (shape.top_m - shape.bottom_m) * 2.0;
    while let Some(next) = levels.last().filter(|l| l.can_grow(most_m)).map(SlabBlocks::coarser) {
        levels.push(next);
    }
    levels
}

/// Means under a collector of this deviation around a place in points; a wider one where there is no cloud.
#[inline(always)]
fn under(levels: &[SlabBlocks<SUMS>], place: [f32; 3], spread_m: f32) -> Option<Under> {
    let edge_m = spread_m * 12f32.sqrt();
    let first = levels
        .iter()
        .position(|l| l.edge_m() >= edge_m)
        .unwrap_or(levels.len() - 1);
    for level in &levels[first..] {
        let [weight, towards, against, x, y, z, square] = level.look(place);
        let length = (x * x + y * y + z * z).sqrt();
        if weight > 0.0 && length > 0.0 {
            let [here, depth, ..] = levels[0].look(place);
            let towards = towards / weight;
            return Some(Under {
                towards: if here > 0.0 { depth / here } else { towards },
                whole: towards + against / weight,
                normal: [x, y, z].map(|v| v / length),
                per_m: square / weight,
            });
        }
    }
    None
}

fn dot(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Fits all groups of a row of points.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn fit_row(
    field: &Field<'_>,
    levels: &[SlabBlocks<SUMS>],
    sources: &SlabSources,
    frame: &[[f32; 3]; 3],
    n: usize,
    out: &mut [u32],
) {
    let shape = field.shape;
    let [row, rows] = shape.stride;
    let (j, k) = (n % rows, n / rows);
    // Where there is no cloud, the normal is the sun's direction.
    for group in 0..GROUPS {
        out[(group * PLANES + 1) * row..][..row].fill(normal_code([0.0; 2]));
    }
    for first in (0..row).step_by(LANES) {
        let count = LANES.min(row - first);
        let mut near = [false; LANES];
        for l in 0..count {
            near[l] = field.towards[n * row + first + l] >= 0.0;
        }
        if !near.contains(&true) {
            continue;
        }
        for group in 0..GROUPS {
            let way = find(field, levels, sources, frame, [first, j, k], &near, group);
            for l in 0..count {
                if let (true, Some(under)) = (near[l], way.under[l]) {
                    let cosine = way.slab.sun_cosine.0[l];
                    let [thickness, depth] = [&way.slab.thickness, &way.slab.depth].map(|v| v.0[l] / cosine);
                    out[group * PLANES * row + first + l] = roots(depth, thickness - depth);
                    out[(group * PLANES + 1) * row + first + l] =
                        normal_code([0, 1].map(|a| dot(&under.normal, &frame[a])));
                }
            }
        }
    }
}

/// Sixteen places' way to their collectors.
#[inline(always)]
fn find(
    field: &Field<'_>,
    levels: &[SlabBlocks<SUMS>],
    sources: &SlabSources,
    frame: &[[f32; 3]; 3],
    [first, j, k]: [usize; 3],
    near: &[bool; LANES],
    group: usize,
) -> Way {
    let shape = field.shape;
    let spacing = shape.point_spacing_m;
    let sun = &frame[2];
    let zero = Lanes::splat(0.0);
    let begin_m = 0.5 * (shape.top_m - shape.bottom_m);
    let mut way = Way {
        centre: [[0.0; 3]; LANES],
        spread: [begin_m; LANES],
        done: [false; LANES],
        under: [None; LANES],
        slab: Fitted {
            thickness: zero,
            depth: zero,
            sun_cosine: Lanes::splat(1.0),
        },
    };
    for l in 0..LANES {
        way.done[l] = !near[l];
    }
    for _ in 0..STEPS {
        if !way.done.contains(&false) {
            break;
        }
        for l in 0..LANES {
            if way.done[l] {
                continue;
            }
            let centre = way.centre[l];
            // Stored rows and columns are one more than the point's own number.
            let place = [
                (first + l) as f32 - 1.0 + centre[0] / spacing[0],
                j as f32 - 1.0 + centre[1] / spacing[1],
                k as f32 + centre[2] / spacing[2],
            ];
            let Some(found) = under(levels, place, way.spread[l]) else {
                way.done[l] = true;
                continue;
            };
            let cosine = dot(&found.normal, sun).max(COSINE_LEAST);
            let thickness = cosine * found.whole;
            // The lit side's plane goes through the sun's ray of the centre where the depth is used up (equation 3.55).
            let depth = found.per_m * dot(&centre, &found.normal) + cosine * found.towards;
            way.slab.thickness.0[l] = thickness;
            way.slab.depth.0[l] = depth.clamp(0.0, thickness);
            way.slab.sun_cosine.0[l] = cosine.min(1.0);
            way.under[l] = Some(found);
        }
        let [place, spread] = sources.collector(&way.slab, group);
        for l in 0..LANES {
            let (false, Some(found)) = (way.done[l], way.under[l]) else {
                continue;
            };
            let per_m = found.per_m.max(1e-9);
            let depth_m = way.slab.depth.0[l] / per_m;
            let cosine = dot(&found.normal, sun).clamp(0.0, 1.0);
            let sine = (1.0 - cosine * cosine).max(1e-6).sqrt();
            let mut entry = [0.0f32; 3];
            for v in 0..3 {
                // Up to the lit side, then upstream.
                entry[v] =
                    found.normal[v] * depth_m + (sun[v] - cosine * found.normal[v]) / sine * (place.0[l] / per_m);
            }
            let along = dot(&entry, sun);
            let mut step = [0.0f32; 3];
            for v in 0..3 {
                step[v] = entry[v] - along * sun[v] - way.centre[l][v];
            }
            let length = dot(&step, &step).sqrt();
            let was = way.spread[l];
            let cut = (0.5 * was / length.max(1e-9)).min(1.0);
            for v in 0..3 {
                way.centre[l][v] += step[v] * cut;
            }
            let wanted = spread.0[l] / per_m;
            way.spread[l] = wanted.clamp(0.5 * was, 1.5 * was).min(begin_m);
            way.done[l] = length < 0.1 * was;
        }
    }
    way
}
