//! Part of stages `slab_fit` and `slab_collector`: each cloud sends out what it takes from the sun's beam.
//!
//! Reads: [`Shape`], a [`SlabFit`]. Writes: its shares, at the points of each cloud times one number. Scheme: a slab keeps light that in a real cloud leaves sideways, and each place has a slab of its own, so that nothing binds the
//! light of all places together: balls by the one-step fit sent out 1.23 to 1.32 of what they take, by the collector 0.84 to 1.03. Cloud that does not absorb sends out what it takes. So for each cloud three sums are made over the shape's
//! points: what it takes from the beam, what of that leaves after the first scattering, and what leaves of the orders that the slabs tell; the last is multiplied by what makes them fit. A direction's light is followed to where it leaves its cloud first.
//! Directions: [`directions_around`] the beam, [`AROUND`] in each ring. A cloud is what hangs together of the cells that
//! have cloud in them or beside them (six neighbours, periodic in x and y).
//!
//! Keeps: each cloud's energy, to the sums' steps; how light lies within a cloud stays the slabs'. A level slab has kept it before (its tables are scaled so), and stays as it is to within what the sums miss (0.03 at most of the sixteen that `welkin ladder light` prints). Errors: a factor is bounded to [`FACTORS`].
//!
//! Floor of the cost: of the broken field 50,000 points in cloud in 48 directions, some 15 steps of 20 gathers of 16 lanes at 20 cycles: 0.9e9 cycles, 0.12 s on two cores.

use multiversion::multiversion;
use rayon::prelude::*;

use super::phase::{TowardsCamera, directions_around};
use super::slab_fit::{SHARE_BITS, SHARE_MASK, SHARE_UNIT, SlabFit, square_of_root};
use super::slab_tables::GROUPS;
use crate::cpu::view::lanes::{Indices, LANES, Lanes};
use crate::cpu::view::shape::{Shape, trilinear};

/// Directions of a ring.
const AROUND: usize = 6;
/// No factor is below or above.
const FACTORS: [f64; 2] = [0.0, 2.0];
/// Where in its box each point is looked at: evenly spread (Kronecker's sequence by powers of the root of x^4 = x + 1), for light falls so steeply that the boxes' middles would miss up to a twentieth of it.
const SPREAD: [f32; 3] = [0.819_172_5, 0.671_043_6, 0.549_700_5];
/// Steps of a way out: a share of the smallest edge of a cell, and their growth with the way.
const STEP_OF_CELL: f32 = 0.5;
const STEP_GROWTH: f32 = 0.06;
const STEPS: usize = 200;
/// Optical depth at which no light is left.
const DARK: f32 = 10.0;

/// Which cloud each of the slab's cells belongs to, from 1 on, and how many clouds there are; 0 where there is none.
struct Clouds {
    of_cell: Vec<u32>,
    count: usize,
}

impl Clouds {
    fn new(shape: &Shape) -> Clouds {
        let [nx, ny, nz] = shape.slab_cells();
        let mut of_cell: Vec<u32> = shape.cloudy_neighbourhood();
        // Cells that wait for their cloud hold the largest number.
        for cell in &mut of_cell {
            *cell = if *cell > 0 { u32::MAX } else { 0 };
        }
        let (mut count, mut open) = (0, Vec::new());
        for first in 0..of_cell.len() {
            if of_cell[first] != u32::MAX {
                continue;
            }
            count += 1;
            of_cell[first] = count;
            open.push(first);
            while let Some(at) = open.pop() {
                let (i, j, k) = (at % nx, at / nx % ny, at / (nx * ny));
                let cell = |i: usize, j: usize, k: usize| (k * ny + j) * nx + i;
                let beside = [
                    Some(cell((i + nx - 1) % nx, j, k)),
                    Some(cell((i + 1) % nx, j, k)),
                    Some(cell(i, (j + ny - 1) % ny, k)),
                    Some(cell(i, (j + 1) % ny, k)),
                    (k > 0).then(|| at - nx * ny),
                    (k + 1 < nz).then(|| at + nx * ny),
                ];
                for next in beside.into_iter().flatten() {
                    if of_cell[next] == u32::MAX {
                        of_cell[next] = count;
                        open.push(next);
                    }
                }
            }
        }
        Clouds {
            of_cell,
            count: count as usize,
        }
    }
}

/// What a cloud takes from the beam, what of it leaves after one scattering, and what leaves of the slabs' orders; over the beam's irradiance and a point's volume, 1/m.
type Sums = [f64; 3];

struct Input<'a> {
    shape: &'a Shape,
    fit: &'a SlabFit,
    clouds: &'a Clouds,
    directions: &'a [TowardsCamera],
    carved: bool,
}

impl SlabFit {
    /// Multiplies each cloud's light by what makes it send out what it takes. `carved` as in [`super::sun_optical_depth::SunLight::new`].
    pub(super) fn balance(&mut self, shape: &Shape, carved: bool) {
        let clouds = Clouds::new(shape);
        let directions = directions_around(&self.frame, self.sources.asymmetry, AROUND);
        let input = Input {
            shape,
            fit: self,
            clouds: &clouds,
            directions: &directions,
            carved,
        };
        let [_, ny, nz] = shape.points;
        let rows: Vec<Vec<(u32, Sums)>> = (0..ny * nz)
            .into_par_iter()
            .map(|n| {
                let mut found = Vec::new();
                row_sums(&input, n % ny, n / ny, &mut found);
                found
            })
            .collect();
        // In the rows' order, whatever thread made them.
        let mut sums = vec![[0.0; 3]; clouds.count + 1];
        for (cloud, row) in rows.iter().flatten() {
            for (to, v) in sums[*cloud as usize].iter_mut().zip(row) {
                *to += v;
            }
        }
        let factors: Vec<f32> = sums
            .iter()
            .map(|[taken, once, more]| {
                if *taken > 0.0 && *more > 1e-6 * taken {
                    ((taken - once) / more).clamp(FACTORS[0], FACTORS[1]) as f32
                } else {
                    1.0
                }
            })
            .collect();
        self.multiply_shares(shape, &clouds, &factors);
    }

    fn multiply_shares(&mut self, shape: &Shape, clouds: &Clouds, factors: &[f32]) {
        if self.shares.is_empty() {
            let whole = (1.0 / SHARE_UNIT) as u32;
            let word = (0..GROUPS).fold(0, |word, group| word | whole << (SHARE_BITS * group as u32));
            self.shares = vec![word; shape.words.len()];
        }
        let [nx, ny, _] = shape.slab_cells();
        let [row, rows] = shape.stride;
        let finer = shape.points[0] / nx;
        self.shares
            .par_chunks_mut(row * rows)
            .enumerate()
            .for_each(|(k, level)| {
                for (n, word) in level.iter_mut().enumerate() {
                    // Stored rows and columns are one more than the point's own number; periodic.
                    let i = (n % row + shape.points[0] - 1) % shape.points[0] / finer;
                    let j = (n / row + shape.points[1] - 1) % shape.points[1] / finer;
                    let cloud = clouds.of_cell[(k / finer * ny + j) * nx + i];
                    let factor = factors[cloud as usize];
                    let own = *word;
                    *word = (0..GROUPS as u32).fold(0, |all, group| {
                        let share = (own >> (SHARE_BITS * group) & SHARE_MASK) as f32 * factor;
                        all | ((share + 0.5).min(SHARE_MASK as f32) as u32) << (SHARE_BITS * group)
                    });
                }
            });
    }
}

/// Adds what row `j` of level `k` of the points has.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn row_sums(input: &Input<'_>, j: usize, k: usize, found: &mut Vec<(u32, Sums)>) {
    let Input {
        shape,
        fit,
        clouds,
        carved,
        ..
    } = *input;
    let zero = Lanes::splat(0.0);
    let [nx, ny, _] = shape.slab_cells();
    let finer = shape.points[0] / nx;
    let spacing = shape.point_spacing_m;
    let sun = fit.frame[2];
    for first in (0..shape.points[0]).step_by(LANES) {
        let count = LANES.min(shape.points[0] - first);
        let mut own = Indices([0; LANES]);
        for l in 0..count {
            own.0[l] = clouds.of_cell[(k / finer * ny + j / finer) * nx + (first + l) / finer];
        }
        if own.0.iter().all(|cloud| *cloud == 0) {
            continue;
        }
        let p = [0, 1, 2].map(|a| {
            Lanes::from_fn(|l| {
                let point = [first + l, j, k];
                let [x, y, z] = point.map(|n| n as f32);
                let within = (x * SPREAD[a] + y * SPREAD[(a + 1) % 3] + z * SPREAD[(a + 2) % 3]).fract();
                (point[a] as f32 + within) * spacing[a] + if a == 2 { shape.bottom_m } else { 0.0 }
            })
        });
        let (cover, amplitude) = shape.sample(p[0], p[1], p[2]);
        let mut here = shape.mean_extinction(cover, amplitude, carved);
        for l in 0..LANES {
            if own.0[l] == 0 {
                here.0[l] = 0.0;
            }
        }
        if !here.any_above(0.0) {
            continue;
        }
        let (index, f) = shape.place(p[0], p[1], p[2]);
        let corners = shape.corners(&fit.depths, index);
        let depth = square_of_root(trilinear(&corners, 0, 0xffff, &f));
        let taken = here * (zero - depth).exp();
        let (mut once, mut more) = (zero, zero);
        for TowardsCamera { d, even, once: of_once } in input.directions {
            let out = (zero - way_out(input, &p, d.map(|v| -v), own, here)).exp();
            let turn = Lanes::splat(d[0] * sun[0] + d[1] * sun[1] + d[2] * sun[2]);
            once = once + out * *of_once;
            more = more + out * fit.towards(shape, &p, &d.map(Lanes::splat), depth, turn) * *even;
        }
        once = once * taken;
        more = more * here;
        for l in 0..count {
            if here.0[l] > 0.0 {
                let sums = [taken, once, more].map(|v| f64::from(v.0[l]));
                match found.last_mut() {
                    Some((cloud, all)) if *cloud == own.0[l] => (0..3).for_each(|n| all[n] += sums[n]),
                    _ => found.push((own.0[l], sums)),
                }
            }
        }
    }
}

/// Optical depth from points of clouds `own` along a direction to where their cloud ends first; only where `wanted` is above 0.
#[inline(always)]
fn way_out(input: &Input<'_>, p: &[Lanes; 3], along: [f32; 3], own: Indices, wanted: Lanes) -> Lanes {
    let (zero, one) = (Lanes::splat(0.0), Lanes::splat(1.0));
    let shape = input.shape;
    let cells = shape.slab_cells();
    let size_m = shape.cell_size_m();
    let per_period = shape.per_period();
    let least_m = size_m[0].min(size_m[1]).min(size_m[2]) * STEP_OF_CELL;
    let mut depth = zero;
    let mut going = Lanes::select_less(zero, wanted, one, zero);
    let mut t = 0.0f32;
    for _ in 0..STEPS {
        let step = least_m + t * STEP_GROWTH;
        let at = t + 0.5 * step;
        let q = [p[0] + at * along[0], p[1] + at * along[1], p[2] + at * along[2]];
        let (i, _) = ((q[0] * per_period[0]).fraction() * cells[0] as f32).split();
        let (j, _) = ((q[1] * per_period[1]).fraction() * cells[1] as f32).split();
        let level = (q[2] - shape.bottom_m) * (1.0 / size_m[2]);
        let (k, _) = level.clamp(0.0, cells[2] as f32 - 0.5).split();
        let mut cell = i;
        for l in 0..LANES {
            let (i, j) = (i.0[l].min(cells[0] as u32 - 1), j.0[l].min(cells[1] as u32 - 1));
            cell.0[l] = (k.0[l] * cells[1] as u32 + j) * cells[0] as u32 + i;
        }
        let there = cell.gather(&input.clouds.of_cell);
        for l in 0..LANES {
            let inside = level.0[l] >= 0.0 && level.0[l] < cells[2] as f32;
            if there.0[l] != own.0[l] || !inside || depth.0[l] > DARK {
                going.0[l] = 0.0;
            }
        }
        if !going.any_above(0.0) {
            break;
        }
        let (cover, amplitude) = shape.sample(q[0], q[1], q[2]);
        depth = depth + shape.mean_extinction(cover, amplitude, input.carved) * step * going;
        t += step;
    }
    depth
}

#[cfg(test)]
mod tests {
    use super::super::sun_optical_depth::tests::shape_of;
    use super::*;

    /// Clouds on both sides of the seam are one, and clouds with three clear cells between them are two: each has the cells beside it.
    #[test]
    fn clouds_are_told_apart() {
        let shape = shape_of([16, 8, 8], [100.0; 3], |[i, j, k]| {
            if [0, 15, 6].contains(&i) && [j, k] == [4, 3] {
                0.05
            } else {
                0.0
            }
        });
        let clouds = Clouds::new(&shape);
        assert_eq!(clouds.count, 2);
        let [nx, ny, _] = shape.slab_cells();
        let of = |i: usize, j: usize| clouds.of_cell[(ny + j) * nx + i];
        assert!(of(0, 4) > 0 && of(0, 4) == of(15, 4) && of(0, 4) == of(14, 5));
        assert!(of(6, 4) > 0 && of(6, 4) != of(0, 4) && of(5, 3) == of(6, 4));
        assert!(of(3, 4) == 0 && of(6, 6) == 0);
        assert!(clouds.of_cell.iter().all(|cloud| *cloud as usize <= clouds.count));
    }
}
