//! Stage `diffusion`: sunlight that cloud has scattered so often that it goes all ways.
//!
//! Reads: [`Shape`] (mean extinction at the slab's cells), [`SunLight`] (optical depth towards the sun), the phase function's asymmetry g. Writes: [`Diffuse`]: the fluence
//! of diffuse light over the irradiance of the sun's beam, at the shape's points. Scheme: light in cloud is split in three: the beam, which goes as exp(-t); what was scattered but
//! still goes about the beam's way, exp(-(1 - g) t) - exp(-t), by the similarity of thick media (it is turned further by Henyey and Greenstein's function of the same
//! mean, for the peak of droplets is washed out by then); and the rest, whose fluence f obeys the
//! diffusion equation (Stam 1995; Ishimaru 1978), div(D grad f) = -s exp(-(1 - g) t), D = 1 / (3 s), s = (1 - g) extinction. Finite volumes on the cells, harmonic
//! means of D at faces; at the cloud's surface nothing comes in (Marshak: the flux that leaves is half of the surface's fluence). Solved by conjugate gradients,
//! preconditioned by the diagonal, to 1e-4 of the source.
//!
//! Keeps: energy. What a cell's source puts in leaves through the surface or stays as a residual below the solver's bound; the source is the midpoint's, which is less than what the beam
//! loses in the cell. No absorption. Light that leaves one cloud for another is lost, and so is what comes back from the ground. Order 2 inside; at
//! surfaces, and where a cell is thin, diffusion is an approximation however fine the grid.
//!
//! The march adds what diffuse light brings towards the camera: f / 4 pi, and of the flux F = -D grad f the part along the ray, 3 g F / 4 pi. The flux outwards is bounded by half the
//! fluence, its value at a surface; inwards by less, for what comes from one side only is scattered back too, and light is never negative.

use multiversion::multiversion;
use rayon::prelude::*;

use super::sun_optical_depth::{DEPTH_UNIT, SUN_MARCH_DEEP, SunLight};
use crate::cpu::view::lanes::{LANES, Lanes};
use crate::cpu::view::shape::{Shape, trilinear};

/// Residual over the source, in the preconditioner's norm, at which the solver ends, and its steps at most.
const RESIDUAL: f64 = 1e-4;
const STEPS_MAX: usize = 400;
/// Half a cell's resistance is no less: where light meets nothing, diffusion would make it infinitely fast.
const RESISTANCE_LEAST: f32 = 1e-3;
/// Bounds of 3 F over the fluence: out of the cloud, and into it.
const FLUX_OUTWARD: f32 = 1.5;
const FLUX_INWARD: f32 = 0.8;
/// Asymmetry is taken as no more.
const ASYMMETRY_MAX: f32 = 0.99;

/// See the module.
#[derive(Clone, Debug)]
pub struct Diffuse {
    /// Fluence over the beam's irradiance, laid out as the shape's words.
    pub fluence: Vec<f32>,
    /// 1 - g.
    pub(crate) similarity: f32,
    /// Conjugate gradients' steps.
    pub steps: usize,
}

/// What the equation is solved with, `[level][y][x]`.
struct System {
    cells: [usize; 3],
    /// Conductance to the next cell east, north, up; 0 where either is empty or there is none.
    next: [Vec<f32>; 3],
    /// Sum of a cell's conductances, the surface's included; 0 for empty cells.
    diagonal: Vec<f32>,
    source: Vec<f32>,
    /// Extinction that diffuse light meets, 1/m.
    transport: Vec<f32>,
    size_m: [f32; 3],
}

impl Diffuse {
    /// Solves. `carved` as in [`SunLight::new`].
    pub fn new(shape: &Shape, sun_light: &SunLight, carved: bool, asymmetry: f32) -> Diffuse {
        let similarity = 1.0 - asymmetry.clamp(0.0, ASYMMETRY_MAX);
        let system = System::new(shape, sun_light, carved, similarity);
        let (mut fluence, steps) = system.solve();
        system.fill_surfaces(&mut fluence);
        let level_len = shape.stride[0] * shape.stride[1];
        let mut points = vec![0.0f32; shape.words.len()];
        points
            .par_chunks_mut(level_len)
            .enumerate()
            .for_each(|(k, level)| level.copy_from_slice(&shape.smoothed_level(&fluence, k)));
        Diffuse {
            fluence: points,
            similarity,
            steps,
        }
    }

    /// What diffuse light brings towards a camera that looks along `d`, times 4 pi, at sixteen places in m where the extinction is `mean` in 1/m on average.
    #[inline(always)]
    pub(crate) fn towards(&self, shape: &Shape, p: &[Lanes; 3], d: &[Lanes; 3], mean: Lanes) -> Lanes {
        let ahead_m = shape.cell_size_m()[2];
        let q = [p[0] + d[0] * ahead_m, p[1] + d[1] * ahead_m, p[2] + d[2] * ahead_m];
        let here = self.look(shape, p[0], p[1], p[2]);
        let ahead = self.look(shape, q[0], q[1], q[2]);
        let asymmetry = 1.0 - self.similarity;
        let flux = (ahead - here) * asymmetry / (mean * (self.similarity * ahead_m)).max(Lanes::splat(1e-6));
        here + flux
            .max(here * (-FLUX_INWARD * asymmetry))
            .min(here * (FLUX_OUTWARD * asymmetry))
    }

    /// Fluence at sixteen places in m.
    #[inline(always)]
    pub(crate) fn look(&self, shape: &Shape, x: Lanes, y: Lanes, z: Lanes) -> Lanes {
        let (index, f) = shape.place(x, y, z);
        let row = shape.stride[0] as u32;
        let level = row * shape.stride[1] as u32;
        let at = |offset: u32| index.plus(offset).gather_f32(&self.fluence);
        let low = at(0).lerp(at(1), f[0]).lerp(at(row).lerp(at(row + 1), f[0]), f[1]);
        let high = at(level)
            .lerp(at(level + 1), f[0])
            .lerp(at(level + row).lerp(at(level + row + 1), f[0]), f[1]);
        low.lerp(high, f[2])
    }
}

/// Extinction (1/m) and optical depth towards the sun at a row of cells' centres.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn look_at_row(
    shape: &Shape,
    sun_light: &SunLight,
    carved: bool,
    y_m: f32,
    z_m: f32,
    size_x_m: f32,
    extinction: &mut [f32],
    depth: &mut [f32],
) {
    for first in (0..extinction.len()).step_by(LANES) {
        let x = Lanes::from_fn(|l| ((first + l) as f32 + 0.5) * size_x_m);
        let (y, z) = (Lanes::splat(y_m), Lanes::splat(z_m));
        let (cover, amplitude) = shape.sample(x, y, z);
        let (index, f) = shape.place(x, y, z);
        let towards = trilinear(&shape.corners(&sun_light.words, index), 0, 0xffff, &f) * DEPTH_UNIT;
        let thick = shape.mean_extinction(cover, amplitude, carved);
        let count = LANES.min(extinction.len() - first);
        extinction[first..][..count].copy_from_slice(&thick.0[..count]);
        depth[first..][..count].copy_from_slice(&towards.0[..count]);
    }
}

impl System {
    fn new(shape: &Shape, sun_light: &SunLight, carved: bool, similarity: f32) -> System {
        let (cells, size) = (shape.slab_cells(), shape.cell_size_m());
        let [nx, ny, _] = cells;
        let len = shape.slab_per_m.len();
        let (mut extinction, mut depth) = (vec![0.0f32; len], vec![0.0f32; len]);
        let rows = extinction.par_chunks_mut(nx).zip(depth.par_chunks_mut(nx));
        rows.enumerate().for_each(|(n, (extinction, depth))| {
            let y = ((n % ny) as f32 + 0.5) * size[1];
            let z = shape.bottom_m + ((n / ny) as f32 + 0.5) * size[2];
            look_at_row(shape, sun_light, carved, y, z, size[0], extinction, depth);
        });
        let face = [size[1] * size[2], size[0] * size[2], size[0] * size[1]];
        let volume = size[0] * size[1] * size[2];
        let transport: Vec<f32> = extinction.iter().map(|e| e * similarity).collect();
        // Depths are followed to about this one only: behind it the source would not fall any more and make light.
        let followed = |t: f32| if t < SUN_MARCH_DEEP { 1.0 } else { 0.0 };
        let source = transport
            .iter()
            .zip(&depth)
            .map(|(s, t)| s * volume * (-similarity * t).exp() * followed(*t))
            .collect();
        let mut next = [0, 1, 2].map(|_| vec![0.0f32; len]);
        let mut diagonal = vec![0.0f32; len];
        for n in 0..len {
            if transport[n] <= 0.0 {
                continue;
            }
            for a in 0..3 {
                let half = half_resistance(transport[n], size[a]);
                for ahead in [true, false] {
                    let through = match neighbour(n, a, ahead, cells) {
                        Some(other) if transport[other] > 0.0 => {
                            face[a] / (half + half_resistance(transport[other], size[a]))
                        }
                        // Half of the surface's fluence leaves, under the ground and above the lid too.
                        _ => face[a] / (half + 2.0),
                    };
                    diagonal[n] += through;
                    if ahead
                        && let Some(other) = neighbour(n, a, true, cells)
                        && transport[other] > 0.0
                    {
                        next[a][n] = through;
                    }
                }
            }
        }
        System {
            cells,
            next,
            diagonal,
            source,
            transport,
            size_m: size,
        }
    }

    /// Conjugate gradients; the fluence and the steps taken.
    fn solve(&self) -> (Vec<f32>, usize) {
        let len = self.source.len();
        let plane = self.cells[0] * self.cells[1];
        let inverse: Vec<f32> = self
            .diagonal
            .iter()
            .map(|d| if *d > 0.0 { 1.0 / d } else { 0.0 })
            .collect();
        let mut fluence = vec![0.0f32; len];
        let mut residual = self.source.clone();
        let mut better: Vec<f32> = residual.iter().zip(&inverse).map(|(r, i)| r * i).collect();
        let mut way = better.clone();
        let mut pushed = vec![0.0f32; len];
        let mut size = dot(&residual, &better, plane);
        let wanted = size * RESIDUAL * RESIDUAL;
        let mut steps = 0;
        while steps < STEPS_MAX && size > wanted && size > 0.0 {
            pushed
                .par_chunks_mut(plane)
                .enumerate()
                .for_each(|(k, level)| self.apply(&way, k, level));
            let along = dot(&way, &pushed, plane);
            if along.is_nan() || along <= 0.0 {
                break;
            }
            let share = (size / along) as f32;
            add(&mut fluence, &way, share, plane);
            add(&mut residual, &pushed, -share, plane);
            let levels = better.par_chunks_mut(plane).zip(residual.par_chunks(plane));
            levels.zip(inverse.par_chunks(plane)).for_each(|((to, r), i)| {
                for ((to, r), i) in to.iter_mut().zip(r).zip(i) {
                    *to = r * i;
                }
            });
            let now = dot(&residual, &better, plane);
            let kept = (now / size) as f32;
            way.par_chunks_mut(plane)
                .zip(better.par_chunks(plane))
                .for_each(|(way, better)| {
                    for (w, b) in way.iter_mut().zip(better) {
                        *w = b + kept * *w;
                    }
                });
            size = now;
            steps += 1;
        }
        for v in &mut fluence {
            *v = v.max(0.0);
        }
        (fluence, steps)
    }

    /// A level of what leaves each cell.
    fn apply(&self, field: &[f32], k: usize, out: &mut [f32]) {
        let [nx, ny, nz] = self.cells;
        let plane = nx * ny;
        for (j, to) in out.chunks_mut(nx).enumerate() {
            let row = k * plane + j * nx;
            let south = k * plane + (j + ny - 1) % ny * nx;
            let north = k * plane + (j + 1) % ny * nx;
            row_of(
                to,
                &field[row..][..nx],
                &self.diagonal[row..][..nx],
                &self.next[0][row..][..nx],
                [&field[south..][..nx], &field[north..][..nx]],
                [&self.next[1][south..][..nx], &self.next[1][row..][..nx]],
            );
            if k > 0 {
                take(to, &field[row - plane..][..nx], &self.next[2][row - plane..][..nx]);
            }
            if k + 1 < nz {
                take(to, &field[row + plane..][..nx], &self.next[2][row..][..nx]);
            }
        }
    }

    /// Gives empty cells beside cloud what the fluence inside and at the surface lead to, and those behind them the same: a place between two cells is looked up in
    /// both.
    fn fill_surfaces(&self, fluence: &mut [f32]) {
        let mut known: Vec<bool> = self.diagonal.iter().map(|d| *d > 0.0).collect();
        for round in 0..2 {
            let before = fluence.to_vec();
            let was = known.clone();
            for n in 0..fluence.len() {
                if was[n] {
                    continue;
                }
                let (mut sum, mut count) = (0.0, 0.0);
                for a in 0..3 {
                    for ahead in [true, false] {
                        if let Some(other) = neighbour(n, a, ahead, self.cells)
                            && was[other]
                        {
                            let half = half_resistance(self.transport[other], self.size_m[a]);
                            // At the surface it is 2 / (2 + half) of the cell's; as far again behind it, straight on.
                            let onward = if round == 0 {
                                ((2.0 - half) / (2.0 + half)).max(0.0)
                            } else {
                                1.0
                            };
                            sum += before[other] * onward;
                            count += 1.0;
                        }
                    }
                }
                if count > 0.0 {
                    fluence[n] = sum / count;
                    known[n] = true;
                }
            }
        }
    }
}

/// Half a cell's resistance to diffuse light, times its face's area.
fn half_resistance(transport_per_m: f32, size_m: f32) -> f32 {
    (1.5 * transport_per_m * size_m).max(RESISTANCE_LEAST)
}

/// The cell beside `n` along an axis; x and y are periodic.
fn neighbour(n: usize, axis: usize, ahead: bool, [nx, ny, nz]: [usize; 3]) -> Option<usize> {
    let (i, j, k) = (n % nx, n / nx % ny, n / (nx * ny));
    let moved = |v: usize, count: usize| {
        if ahead {
            (v + 1) % count
        } else {
            (v + count - 1) % count
        }
    };
    match axis {
        0 => Some((k * ny + j) * nx + moved(i, nx)),
        1 => Some((k * ny + moved(j, ny)) * nx + i),
        _ if ahead => (k + 1 < nz).then(|| n + nx * ny),
        _ => n.checked_sub(nx * ny),
    }
}

/// The row's own part and what its neighbours in the level take.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn row_of(to: &mut [f32], here: &[f32], diagonal: &[f32], east: &[f32], sides: [&[f32]; 2], through: [&[f32]; 2]) {
    let n = to.len();
    for i in 0..n {
        to[i] = diagonal[i] * here[i] - through[0][i] * sides[0][i] - through[1][i] * sides[1][i];
    }
    for i in 1..n {
        to[i] -= east[i - 1] * here[i - 1];
    }
    for i in 0..n - 1 {
        to[i] -= east[i] * here[i + 1];
    }
    to[0] -= east[n - 1] * here[n - 1];
    to[n - 1] -= east[n - 1] * here[0];
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn take(to: &mut [f32], field: &[f32], through: &[f32]) {
    for i in 0..to.len() {
        to[i] -= through[i] * field[i];
    }
}

/// Sums of products, level by level, joined in order.
fn dot(a: &[f32], b: &[f32], plane: usize) -> f64 {
    let levels: Vec<f64> = a
        .par_chunks(plane)
        .zip(b.par_chunks(plane))
        .map(|(a, b)| level_dot(a, b))
        .collect();
    levels.iter().sum()
}

/// Eight sums side by side, so that the order is the same on every instruction set.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn level_dot(a: &[f32], b: &[f32]) -> f64 {
    let mut sums = [0.0f64; 8];
    let (whole_a, whole_b) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f64 = whole_a
        .remainder()
        .iter()
        .zip(whole_b.remainder())
        .map(|(a, b)| f64::from(*a) * f64::from(*b))
        .sum();
    for (a, b) in whole_a.zip(whole_b) {
        for l in 0..8 {
            sums[l] += f64::from(a[l]) * f64::from(b[l]);
        }
    }
    sums.iter().sum::<f64>() + rest
}

fn add(to: &mut [f32], from: &[f32], share: f32, plane: usize) {
    to.par_chunks_mut(plane)
        .zip(from.par_chunks(plane))
        .for_each(|(to, from)| {
            for (t, f) in to.iter_mut().zip(from) {
                *t += share * f;
            }
        });
}
