//! Stage `octave_balance`: how strong octaves may be over each column of cells, so that clouds send out what they take from the sun's beam.
//!
//! Reads: [`Shape`], [`SunLight`], [`MarchPhase`] with its octaves and their factors by level slabs, the sun's direction. Writes: [`OctaveBalance`]: a factor a column of the slab's cells,
//! `[y][x]` with one more on each side, periodic; 0 to [`BALANCE_MOST`]. Scheme: octaves know what level slabs give back ([`super::octave_shares`]), and a cloud that ends sideways lets more light go: balls sent out up to 1.5 of what
//! they take. So at one place in each cell two things are summed over [`BALANCE_RINGS`] directions around the beam, one at each of Gauss's cosines: what the first scattering leaves in its cloud of what was taken from the beam there, and what octaves
//! bring from there out of the cloud. A direction is followed to where no cloud is near, by steps that grow; its azimuth, and the place within the cell, go through evenly spread ones from cell to cell (Kronecker's sequence).
//! What each column has left is then given to the octaves of all columns within [`BALANCE_REACH_M`], by shares that are products of 1 - (d / reach)^2 along x and y and of what the octaves bring: factor = G * (left / (G * brought)), G being that weight's sum over columns.
//!
//! Keeps: the sun's light over all clouds, to the sums' error, whatever the reach: G goes both ways alike, so that the factors times what octaves bring have the sum of all that is left. Clouds farther than the reach from others keep their own.
//! Clouds that stand one above the other, or side by side within the reach, share what they have left. No cloud's factor jumps when it joins another: nothing asks which cells hang together.
//! Errors: sums by a place a cell and eight cosines are good to 0.02 in balls ten cells across. Where light ends within a cell they are not: interpolated depths towards the sun are too large in the outermost half of a cell, what is left comes out too small there, and
//! balls of eight optical depths a cell send out 0.86 of what they take. The error in level slabs, where octaves are right already, goes both ways, to 0.09 in 16 columns; so no factor is above 1, and none makes light.
//!
//! Floor of the cost: of the broken field 8,000 cells with cloud, in 8 directions, some 15 steps of 20 gathers of 16 lanes at 20 cycles: 24e6 cycles, 4 ms on two cores. It takes 42 ms there, and 13 (one thick ball) to 87 (a field seen from above) in the other scenes of `welkin ladder light`.

use multiversion::multiversion;
use rayon::prelude::*;

use super::march_phase::MarchPhase;
use super::octave_shares::{level_share, passage};
use super::phase::directions_around;
use super::slab_fit::across;
use super::sun_optical_depth::{DEPTH_UNIT, SunLight, marched_direction};
use crate::cpu::view::lanes::{LANES, Lanes};
use crate::cpu::view::march::OCTAVES_MAX;
use crate::cpu::view::shape::{Shape, trilinear};

crate::constants! {
    /// Directions around the beam at each place.
    pub const BALANCE_RINGS: usize = 8;
    /// How far columns share what they have left, m.
    pub const BALANCE_REACH_M: f32 = 2_000.0;
    /// The largest factor: level slabs need none, and clouds that end sideways let more light go.
    pub const BALANCE_MOST: f32 = 1.0;
    /// First step of a way out of cloud, a share of the smallest edge of a cell.
    const BALANCE_STEP_OF_CELL: f32 = 0.5;
    /// Growth of steps with distance.
    const BALANCE_STEP_GROWTH: f32 = 0.12;
    /// Steps at most.
    const BALANCE_STEPS: u32 = 48;
    /// Optical depth at which no light is left.
    const BALANCE_DARK: f32 = 10.0;
    /// 2^32 times the powers of the root of x^4 = x + 1, and of that of x^2 = x + 1: places within cells, then azimuths.
    const BALANCE_SPREAD_X: u32 = 3_518_319_155;
    /// See [`BALANCE_SPREAD_X`].
    const BALANCE_SPREAD_Y: u32 = 2_882_110_345;
    /// See [`BALANCE_SPREAD_X`].
    const BALANCE_SPREAD_Z: u32 = 2_360_945_575;
    /// See [`BALANCE_SPREAD_X`].
    const BALANCE_SPREAD_RING: u32 = 2_654_435_769;
    /// Azimuths.
    pub const BALANCE_TURNS: u32 = 64;
    /// What each column has left and brings besides, 1/m, less than clouds that can be seen: where there are no others, the factor is 1.
    const BALANCE_TRACE: f32 = 1e-8;
}

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct OctaveBalance {
    /// The factors.
    pub columns: Vec<f32>,
    left: Vec<f32>,
    brought: Vec<f32>,
    along_x: Vec<f32>,
}

/// A ring of directions around the beam.
#[derive(Clone, Copy, Debug, Default)]
pub struct Ring {
    /// Cosine of what the beam is turned by, and its sine.
    pub turn: [f32; 2],
    /// Solid angle, sr.
    pub even: f32,
    /// Share of what is scattered once.
    pub once: f32,
}

/// The rings for light of this asymmetry: Gauss's cosines, closer about the beam's way.
pub fn rings(asymmetry: f32) -> [Ring; BALANCE_RINGS] {
    let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let mut rings = [Ring::default(); BALANCE_RINGS];
    for (ring, of) in rings.iter_mut().zip(directions_around(&axes, asymmetry, 1)) {
        let cosine = of.d[2];
        *ring = Ring {
            turn: [cosine, (1.0 - cosine * cosine).max(0.0).sqrt()],
            even: of.even,
            once: of.once,
        };
    }
    rings
}

/// Columns to either side that share what they have left, along an axis of `cells` columns `size_m` wide: no farther than around.
pub fn columns_reached(cells: usize, size_m: f32) -> usize {
    ((BALANCE_REACH_M / size_m) as usize).min((cells - 1) / 2)
}

struct Input<'a> {
    shape: &'a Shape,
    sun_light: &'a SunLight,
    phase: &'a MarchPhase,
    octaves: usize,
    carved: bool,
    /// Two unit vectors across the beam, and that towards the sun.
    frame: [[f32; 3]; 3],
    rings: [Ring; BALANCE_RINGS],
    /// What each octave scatters along each ring's directions.
    turned: [[f32; OCTAVES_MAX + 1]; BALANCE_RINGS],
    /// Cosine and sine of the azimuths.
    turns: [[f32; 2]; BALANCE_TURNS as usize],
}

impl OctaveBalance {
    /// Makes the factors; `carved` as in [`SunLight::new`].
    pub fn make(
        &mut self,
        (shape, sun_light): (&Shape, &SunLight),
        carved: bool,
        beam: [f32; 3],
        phase: &MarchPhase,
        octaves: usize,
    ) {
        let rings = rings(phase.asymmetry);
        let turned = rings.map(|ring| {
            let mut turned = [0.0; OCTAVES_MAX + 1];
            for (octave, to) in turned.iter_mut().enumerate().take(octaves + 1).skip(1) {
                *to = phase.octave(octave, ring.turn[0]) * ring.even;
            }
            turned
        });
        let turn = |n: usize| {
            let (sine, cosine) = (n as f32 * (std::f32::consts::TAU / BALANCE_TURNS as f32)).sin_cos();
            [cosine, sine]
        };
        let input = Input {
            shape,
            sun_light,
            phase,
            octaves,
            carved,
            frame: across(marched_direction(beam)),
            rings,
            turned,
            turns: std::array::from_fn(turn),
        };
        let [nx, ny, _] = shape.slab_cells();
        for map in [&mut self.left, &mut self.brought, &mut self.along_x] {
            map.clear();
            map.resize(nx * ny, 0.0);
        }
        let rows = self.left.par_chunks_mut(nx).zip(self.brought.par_chunks_mut(nx));
        rows.enumerate()
            .for_each(|(j, (left, brought))| row_sums(&input, j, left, brought));
        self.spread(shape);
    }

    /// Gives what columns have left to the octaves around them.
    fn spread(&mut self, shape: &Shape) {
        let [nx, ny, _] = shape.slab_cells();
        let size_m = shape.cell_size_m();
        let reached = [columns_reached(nx, size_m[0]), columns_reached(ny, size_m[1])];
        let OctaveBalance {
            columns,
            left,
            brought,
            along_x,
        } = self;
        around(brought, along_x, [nx, 1], reached[0], size_m[0]);
        around(along_x, brought, [ny, nx], reached[1], size_m[1]);
        for (left, brought) in left.iter_mut().zip(brought.iter()) {
            *left /= brought;
        }
        around(left, along_x, [nx, 1], reached[0], size_m[0]);
        around(along_x, left, [ny, nx], reached[1], size_m[1]);
        columns.clear();
        columns.reserve((nx + 2) * (ny + 2));
        for j in 0..ny + 2 {
            let row = &left[(j + ny - 1) % ny * nx..][..nx];
            let all = std::iter::once(&row[nx - 1]).chain(row).chain(&row[..1]);
            columns.extend(all.map(|v| v.clamp(0.0, BALANCE_MOST)));
        }
    }

    /// The factor at 16 positions in m; between columns' middles linear.
    #[inline(always)]
    pub(crate) fn factor(&self, shape: &Shape, x: Lanes, y: Lanes) -> Lanes {
        let [nx, ny, _] = shape.slab_cells();
        let per_period = shape.per_period();
        let (i, fx) = ((x * per_period[0]).fraction() * nx as f32 + 0.5).split();
        let (j, fy) = ((y * per_period[1]).fraction() * ny as f32 + 0.5).split();
        let row = nx as u32 + 2;
        let mut at = i;
        for l in 0..LANES {
            at.0[l] += j.0[l] * row;
        }
        let look = |offset: u32| at.plus(offset).gather_f32(&self.columns);
        look(0).lerp(look(1), fx).lerp(look(row).lerp(look(row + 1), fx), fy)
    }
}

/// Sums of what columns `from` have along one axis, of `n` columns that lie `apart` in memory, by their weights at the distances along it; periodic.
fn around(from: &[f32], to: &mut [f32], [n, apart]: [usize; 2], reached: usize, size_m: f32) {
    let weight = |d: usize| 1.0 - (d as f32 * size_m / BALANCE_REACH_M).powi(2);
    for (at, sum) in to.iter_mut().enumerate() {
        let own = at / apart % n;
        let first = at - own * apart;
        *sum = from[at];
        for d in 1..=reached {
            let [before, behind] = [(own + n - d) % n, (own + d) % n].map(|p| from[first + p * apart]);
            *sum += weight(d) * (before + behind);
        }
    }
}

/// Of row `j` of columns: what the first scattering leaves of what is taken from the beam, and what octaves bring out; 1/m.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn row_sums(input: &Input<'_>, j: usize, left: &mut [f32], brought: &mut [f32]) {
    let Input { shape, carved, .. } = *input;
    let (zero, one) = (Lanes::splat(0.0), Lanes::splat(1.0));
    let [_, _, nz] = shape.slab_cells();
    let size_m = shape.cell_size_m();
    let sun = input.frame[2];
    let shares = input.phase.level_shares();
    let slowest = -std::f32::consts::LOG2_E * 0.5f32.powi(input.octaves as i32);
    let spread = [BALANCE_SPREAD_X, BALANCE_SPREAD_Y, BALANCE_SPREAD_Z];
    for first in (0..left.len()).step_by(LANES) {
        let count = LANES.min(left.len() - first);
        let trace = Lanes::splat(BALANCE_TRACE);
        let (mut all_left, mut all_brought) = (trace, trace);
        for k in 0..nz {
            let cell = |l: usize| [(first + l) as u32, j as u32, k as u32];
            let mixed = |l: usize, from: usize| {
                let cell = cell(l);
                (0..3).fold(0u32, |sum, a| {
                    sum.wrapping_add(cell[a].wrapping_mul(spread[(from + a) % 3]))
                })
            };
            let p = [0, 1, 2].map(|a| {
                Lanes::from_fn(|l| {
                    let within = (mixed(l, a) >> 8) as f32 / 16_777_216.0;
                    (cell(l)[a] as f32 + within) * size_m[a] + if a == 2 { shape.bottom_m } else { 0.0 }
                })
            });
            let mut here = Lanes::select_less(zero, shape.empty_distance_m(p[0], p[1], p[2]), zero, one);
            for l in count..LANES {
                here.0[l] = 0.0;
            }
            if !here.any_above(0.0) {
                continue;
            }
            let (cover, amplitude) = shape.sample(p[0], p[1], p[2]);
            here = here * shape.mean_extinction(cover, amplitude, carved);
            if !here.any_above(0.0) {
                continue;
            }
            let (index, f) = shape.place(p[0], p[1], p[2]);
            let corners = shape.corners(&input.sun_light.words, index);
            let depth = trilinear(&corners, 0, 0xffff, &f) * DEPTH_UNIT;
            let sky = trilinear(&corners, 16, 0xff, &f) * (1.0 / 255.0);
            let ground = trilinear(&corners, 24, 0xff, &f) * (1.0 / 255.0);
            let mut of_octave = [zero; OCTAVES_MAX + 1];
            let mut passed = (depth * slowest).exp2();
            for octave in (1..=input.octaves).rev() {
                of_octave[octave] = passed;
                passed = passed * passed;
            }
            let (mut once, mut more) = (zero, zero);
            for (n, (ring, turned)) in input.rings.iter().zip(&input.turned).enumerate() {
                let mut turn = [zero; 2];
                for l in 0..count {
                    let turned = mixed(l, 1)
                        .rotate_left(16)
                        .wrapping_add(BALANCE_SPREAD_RING.wrapping_mul(n as u32));
                    let [cosine, sine] = input.turns[(turned >> 26) as usize % BALANCE_TURNS as usize];
                    (turn[0].0[l], turn[1].0[l]) = (cosine, sine);
                }
                // Towards where the light goes.
                let along = [0, 1, 2].map(|a| {
                    zero - ((turn[0] * input.frame[0][a] + turn[1] * input.frame[1][a]) * ring.turn[1]
                        + sun[a] * ring.turn[0])
                });
                let out = (zero - way_out(input, &p, &along, here)).exp();
                let mut scattered = zero;
                for octave in 1..=input.octaves {
                    scattered = scattered + of_octave[octave] * turned[octave];
                }
                once = once + out * ring.once;
                more = more + out * scattered;
            }
            let share = level_share(shares, sun[2], depth, sky, passage(sky, ground));
            all_left = all_left + here * passed * (one - once).max(zero);
            all_brought = all_brought + here * more * share;
        }
        left[first..first + count].copy_from_slice(&all_left.0[..count]);
        brought[first..first + count].copy_from_slice(&all_brought.0[..count]);
    }
}

/// Optical depth along directions to where no cloud is near, of the lanes whose `wanted` is above 0.
#[inline(always)]
fn way_out(input: &Input<'_>, p: &[Lanes; 3], along: &[Lanes; 3], wanted: Lanes) -> Lanes {
    let (zero, one) = (Lanes::splat(0.0), Lanes::splat(1.0));
    let shape = input.shape;
    let size_m = shape.cell_size_m();
    let least_m = size_m[0].min(size_m[1]).min(size_m[2]) * BALANCE_STEP_OF_CELL;
    let mut depth = zero;
    let mut going = Lanes::select_less(zero, wanted, one, zero);
    let mut t = 0.0f32;
    for _ in 0..BALANCE_STEPS {
        let step = least_m + t * BALANCE_STEP_GROWTH;
        let at = t + 0.5 * step;
        let q = [p[0] + along[0] * at, p[1] + along[1] * at, p[2] + along[2] * at];
        let empty = shape.empty_distance_m(q[0], q[1], q[2]);
        going = Lanes::select_less(zero, empty, zero, going);
        going = Lanes::select_less(Lanes::splat(BALANCE_DARK), depth, zero, going);
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
    use super::super::phase_table::PhaseChoice;
    use super::super::sky_visibility::sky_visibility;
    use super::super::sun_optical_depth::tests::{ragged, shape_of};
    use super::*;
    use crate::cpu::view::Scattering;

    const SUN: [f32; 3] = [0.48, 0.36, 0.8];

    fn phase(asymmetry: f32) -> MarchPhase {
        let choice = PhaseChoice::HenyeyGreenstein { asymmetry };
        MarchPhase::new(choice, Scattering::Octaves, 6)
    }

    fn sun_light(shape: &Shape, sun: [f32; 3]) -> SunLight {
        let [nx, ny, _] = shape.slab_cells();
        let seen = sky_visibility(&shape.slab_per_m, [nx, ny], shape.cell_size_m());
        SunLight::new(shape, &seen, false, false, sun)
    }

    fn balance(shape: &Shape, sun: [f32; 3]) -> OctaveBalance {
        let mut balance = OctaveBalance::default();
        balance.make((shape, &sun_light(shape, sun)), false, sun, &phase(0.85), 6);
        balance
    }

    /// A ball about the middle of the cell at `middle`, in cells of 80 m.
    fn ball(cells: [usize; 3], middle: [f32; 3], radius: f32, per_m: f32) -> Shape {
        shape_of(cells, [80.0; 3], |at| {
            let d = [0, 1, 2].map(|a| at[a] as f32 - middle[a]);
            if d.iter().map(|d| d * d).sum::<f32>() < radius * radius {
                per_m
            } else {
                0.0
            }
        })
    }

    fn level(depth: f32) -> Shape {
        let per_m = depth / 800.0;
        shape_of(
            [16, 16, 16],
            [80.0; 3],
            |[_, _, k]| if (3..13).contains(&k) { per_m } else { 0.0 },
        )
    }

    fn least_and_most(balance: &OctaveBalance) -> [f32; 2] {
        let of = balance.columns.iter();
        [
            of.clone().fold(f32::MAX, |a, b| a.min(*b)),
            of.fold(0.0, |a, b| a.max(*b)),
        ]
    }

    /// Octaves are right in level slabs, and stay so as far as the sums are.
    #[test]
    fn level_slabs_keep_their_octaves() {
        for (depth, least) in [(1.0, 0.97), (4.0, 0.96), (16.0, 0.93), (64.0, 0.83)] {
            let [low, high] = least_and_most(&balance(&level(depth), SUN));
            assert!(low > least && high <= 1.0, "{depth}: {low} {high}");
        }
    }

    /// A ball lets more light go than a slab as thick, the more the thicker it is; another one beyond the reach changes nothing, and where the ball lies among the cells little.
    #[test]
    fn balls_are_dimmed() {
        let middle = |balance: &OctaveBalance, at: [usize; 2]| balance.columns[(at[1] + 1) * 82 + at[0] + 1];
        let mut last = 0.9;
        for depth in [0.8, 4.0, 16.0] {
            let alone = balance(&ball([80, 80, 16], [15.0, 15.0, 7.5], 5.0, depth / 800.0), SUN);
            let shifted = balance(&ball([80, 80, 16], [21.3, 17.6, 7.2], 5.0, depth / 800.0), SUN);
            let pair = shape_of([80, 80, 16], [80.0; 3], |[i, j, k]| {
                let [i, j, k] = [i % 40, j, k].map(|n| n as f32);
                let d2 = (i - 15.0).powi(2) + (j - 15.0).powi(2) + (k - 7.5).powi(2);
                if d2 < 25.0 { depth / 800.0 } else { 0.0 }
            });
            let [one, other] = [middle(&alone, [15, 15]), middle(&shifted, [21, 18])];
            assert!(one < last && (other / one - 1.0).abs() < 0.05, "{depth}: {one} {other}");
            let two = middle(&balance(&pair, SUN), [15, 15]);
            assert!((two / one - 1.0).abs() < 1e-4, "{depth}: {one} {two}");
            last = one;
        }
    }

    /// What columns have left is given on whole, whatever their number along an axis, where no factor is bounded.
    #[test]
    fn what_is_left_is_given_on_whole() {
        for cells in [[1, 1, 4], [7, 3, 4], [40, 9, 4]] {
            let shape = shape_of(cells, [300.0, 170.0, 50.0], |_| 0.01);
            let number = |n: usize| ((n * 2_654_435_761) >> 9) as f32 % 97.0 / 97.0;
            let columns = cells[0] * cells[1];
            let brought: Vec<f32> = (0..columns).map(|n| 3.0 + number(n)).collect();
            let mut balance = OctaveBalance {
                left: (0..columns).map(|n| 0.2 + number(n + 5)).collect(),
                brought: brought.clone(),
                along_x: vec![0.0; columns],
                ..OctaveBalance::default()
            };
            let left: f64 = balance.left.iter().map(|v| f64::from(*v)).sum();
            balance.spread(&shape);
            let row = cells[0] + 2;
            let given: f64 = (0..columns)
                .map(|n| f64::from(balance.columns[(n / cells[0] + 1) * row + n % cells[0] + 1] * brought[n]))
                .sum();
            assert!((given / left - 1.0).abs() < 1e-5, "{cells:?}: {given} {left}");
        }
    }

    /// Heaps by every sun, one column, no cloud near others' columns, ten thousand optical depths a cell and a millionth: factors are numbers from 0 to 1.
    #[test]
    fn hard_cases_have_factors() {
        let suns = [
            [0.0, 0.0, 1.0],
            SUN,
            [1.0, 0.0, 0.0],
            [0.0, 0.999_9, -0.01],
            [0.6, 0.0, -0.8],
        ];
        for sun in suns {
            for shape in [
                ragged([24, 20, 12], [80.0; 3]),
                ragged([1, 1, 12], [80.0; 3]),
                ragged([2, 33, 12], [5_000.0, 30.0, 80.0]),
                shape_of([8, 8, 8], [100.0; 3], |at| if at == [3, 3, 3] { 100.0 } else { 0.0 }),
                shape_of([8, 8, 8], [100.0; 3], |at| if at == [3, 3, 3] { 1e-8 } else { 0.0 }),
            ] {
                let balance = balance(&shape, sun);
                let [nx, ny, _] = shape.slab_cells();
                assert_eq!(balance.columns.len(), (nx + 2) * (ny + 2));
                assert!(
                    balance.columns.iter().all(|v| (0.0..=1.0).contains(v)),
                    "{sun:?}: {:?}",
                    balance.columns
                );
            }
        }
    }
}
