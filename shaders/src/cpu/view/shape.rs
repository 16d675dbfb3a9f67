//! Stage `shape`: the cloud as a smooth field that can be looked up anywhere.
//!
//! Reads: extinction at cell centres, 1/m. Writes: [`Shape`], on the levels that hold cloud: a field twice as fine, periodic
//! in x and y, with two numbers a point packed in 32 bits: the amplitude (largest extinction among a cell and its 26
//! neighbours, smoothed; 16 bits) and the cover (smoothed extinction over amplitude, 0 to 1; 16 bits). Cover times amplitude is the
//! smoothed extinction; cover alone tells the cloud's edge from its inside whatever its density, which detail noise needs.
//! Also the distance to the next cell with cloud (stage `occupancy`). Scheme: quadratic B-splines in the three directions
//! (second order, never negative, keeps the sum), between points trilinear.

use rayon::prelude::*;

use super::lanes::{Indices, Lanes};
use super::occupancy::Occupancy;
use crate::CloudVolume;
use crate::view::Slab;

crate::constants! {
    /// Cover below which carved cloud is empty on average.
    pub(crate) const CARVE_EDGE: f32 = 0.16;
    /// Width in cover of the ramp from empty to full of carved cloud on average.
    const CARVE_MEAN_RAMP: f32 = 0.45;
}

/// See the module.
#[derive(Clone, Debug)]
pub struct Shape {
    /// Points east, north, up.
    pub points: [usize; 3],
    /// Row length and rows of a level as stored: one more point on each side.
    pub stride: [usize; 2],
    /// Distance between points, m.
    pub point_spacing_m: [f32; 3],
    /// Lowest height with cloud, m.
    pub bottom_m: f32,
    /// Highest height with cloud, m.
    pub top_m: f32,
    /// Amplitude in the high half, cover in the low half.
    pub words: Vec<u32>,
    /// Extinction of the slab's cells, `[level][y][x]`, 1/m.
    pub slab_per_m: Vec<f32>,
    /// Amplitude a unit, 1/m.
    amplitude_unit_per_m: f32,
    per_period: [f32; 2],
    cells: [usize; 2],
    finer: usize,
    occupancy: Occupancy,
}

impl Shape {
    /// The shape of `volume`; none if it holds no cloud or if its numbers do not fit its grid. What is not finite or is
    /// negative counts as empty.
    pub fn new(volume: &CloudVolume) -> Option<Shape> {
        let slab = Slab::new(volume)?;
        let [nx, ny, levels] = slab.cells;
        let wide = largest_of_neighbours(&slab.extinction_per_m, slab.cells);
        let points = slab.points();
        let stride = [points[0] + 2, points[1] + 2];
        let mut shape = Shape {
            points,
            stride,
            point_spacing_m: slab.point_spacing_m(),
            bottom_m: slab.bottom_m,
            top_m: slab.top_m,
            words: vec![0; stride[0] * stride[1] * points[2]],
            occupancy: Occupancy::new(&wide, [nx, ny, levels], slab.cell_size_m),
            amplitude_unit_per_m: slab.amplitude_unit_per_m(),
            per_period: slab.per_period(),
            cells: [nx, ny],
            finer: slab.finer,
            slab_per_m: slab.extinction_per_m,
        };
        let mut words = std::mem::take(&mut shape.words);
        words
            .par_chunks_mut(stride[0] * stride[1])
            .enumerate()
            .for_each(|(k, level)| {
                let extinction = shape.smoothed_level(&shape.slab_per_m, k);
                let amplitude = shape.smoothed_level(&wide, k);
                for (word, (e, a)) in level.iter_mut().zip(extinction.iter().zip(&amplitude)) {
                    let cover = (e / a.max(1e-12)).min(1.0);
                    *word = ((a / shape.amplitude_unit_per_m).min(65_535.0) as u32) << 16 | (cover * 65_535.0) as u32;
                }
            });
        shape.words = words;
        Some(shape)
    }
    /// Level `k` of points, with the padding, of a field at the slab's cell centres, smoothed by B-splines.
    pub(crate) fn smoothed_level(&self, field: &[f32], k: usize) -> Vec<f32> {
        let [nx, ny] = self.cells;
        let plane = nx * ny;
        let levels = field.len() / plane;
        let mut flat = vec![0.0f32; plane];
        let weights = spline(k % self.finer, self.finer);
        for (n, w) in weights.iter().enumerate() {
            let level = (k / self.finer + n).saturating_sub(1).min(levels - 1);
            for (to, v) in flat.iter_mut().zip(&field[level * plane..][..plane]) {
                *to += w * v;
            }
        }
        let mut out = vec![0.0f32; self.stride[0] * self.stride[1]];
        let mut row = vec![0.0f32; nx + 2];
        for (j, to) in out.chunks_mut(self.stride[0]).enumerate() {
            // Stored row j is point j - 1; periodic.
            let point = (j + self.points[1] - 1) % self.points[1];
            let weights = spline(point % self.finer, self.finer);
            let y = point / self.finer;
            let rows = [(y + ny - 1) % ny, y, (y + 1) % ny].map(|r| &flat[r * nx..][..nx]);
            for x in 0..nx {
                row[x + 1] = weights[0] * rows[0][x] + weights[1] * rows[1][x] + weights[2] * rows[2][x];
            }
            row[0] = row[nx];
            row[nx + 1] = row[1];
            for s in 0..self.finer {
                let w = spline(s, self.finer);
                for x in 0..nx {
                    to[1 + x * self.finer + s] = w[0] * row[x] + w[1] * row[x + 1] + w[2] * row[x + 2];
                }
            }
            to[0] = to[self.points[0]];
            to[self.points[0] + 1] = to[1];
        }
        out
    }
    /// Cover and amplitude (1/m) of a point as stored: column, row, level.
    pub(crate) fn at_point(&self, i: usize, j: usize, k: usize) -> (f32, f32) {
        let word = self.words[(k * self.stride[1] + j) * self.stride[0] + i];
        (
            (word & 0xffff) as f32 / 65_535.0,
            (word >> 16) as f32 * self.amplitude_unit_per_m,
        )
    }
    /// Cells of the slab east, north, up.
    pub(crate) fn slab_cells(&self) -> [usize; 3] {
        let [nx, ny] = self.cells;
        [nx, ny, self.slab_per_m.len() / (nx * ny)]
    }
    /// Of each of them, 1 if it has cloud in it or beside it, else 0.
    pub(crate) fn cloudy_neighbourhood(&self) -> Vec<u32> {
        let wide = largest_of_neighbours(&self.slab_per_m, self.slab_cells());
        wide.into_iter().map(|largest| u32::from(largest > 0.0)).collect()
    }
    /// Their sizes, m.
    pub(crate) fn cell_size_m(&self) -> [f32; 3] {
        self.point_spacing_m.map(|s| s * self.finer as f32)
    }
    /// One over the periods in x and y, 1/m.
    pub(crate) fn per_period(&self) -> [f32; 2] {
        self.per_period
    }
    /// The distances to the next cell with cloud.
    pub fn occupancy(&self) -> &Occupancy {
        &self.occupancy
    }
    /// Place in the table and the three fractions at 16 positions in m; heights are bounded to the slab.
    #[inline(always)]
    pub(crate) fn place(&self, x: Lanes, y: Lanes, z: Lanes) -> (Indices, [Lanes; 3]) {
        let gx = (x * self.per_period[0]).fraction() * self.points[0] as f32 + 0.5;
        let gy = (y * self.per_period[1]).fraction() * self.points[1] as f32 + 0.5;
        let gz =
            ((z - self.bottom_m) * (1.0 / self.point_spacing_m[2]) - 0.5).clamp(0.0, self.points[2] as f32 - 1.001);
        let (i, fx) = gx.split();
        let (j, fy) = gy.split();
        let (k, fz) = gz.split();
        let mut index = i;
        for l in 0..index.0.len() {
            index.0[l] = (k.0[l] * self.stride[1] as u32 + j.0[l]) * self.stride[0] as u32 + i.0[l];
        }
        (index, [fx, fy, fz])
    }
    /// The eight corners' words around a place.
    #[inline(always)]
    pub(crate) fn corners(&self, words: &[u32], index: Indices) -> [Indices; 8] {
        let row = self.stride[0] as u32;
        let level = row * self.stride[1] as u32;
        let mut corners = [index; 8];
        let offsets = [0, 1, row, row + 1, level, level + 1, level + row, level + row + 1];
        for n in 0..8 {
            corners[n] = index.plus(offsets[n]).gather(words);
        }
        corners
    }
    /// Cover (0 to 1) and amplitude (1/m) at 16 positions in m.
    #[inline(always)]
    pub(crate) fn sample(&self, x: Lanes, y: Lanes, z: Lanes) -> (Lanes, Lanes) {
        let (index, f) = self.place(x, y, z);
        let corners = self.corners(&self.words, index);
        let cover = trilinear(&corners, 0, 0xffff, &f) * (1.0 / 65_535.0);
        let amplitude = trilinear(&corners, 16, 0xffff, &f) * self.amplitude_unit_per_m;
        (cover, amplitude)
    }
    /// Extinction without noise, 1/m; `carved` is what carving by noise leaves on average.
    #[inline(always)]
    pub(crate) fn mean_extinction(&self, cover: Lanes, amplitude: Lanes, carved: bool) -> Lanes {
        if carved {
            amplitude * ((cover - CARVE_EDGE) * (1.0 / CARVE_MEAN_RAMP)).smoothstep()
        } else {
            amplitude * cover
        }
    }
    /// Distance in m that holds no cloud whatever the direction; 0 in and beside cloud.
    #[inline(always)]
    pub(crate) fn empty_distance_m(&self, x: Lanes, y: Lanes, z: Lanes) -> Lanes {
        let u = (x * self.per_period[0]).fraction();
        let v = (y * self.per_period[1]).fraction();
        let inside = self
            .occupancy
            .look(u, v, (z - self.bottom_m) * (1.0 / (self.top_m - self.bottom_m)));
        let outside = (Lanes::splat(self.bottom_m) - z).max(z - self.top_m);
        inside.max(outside)
    }
}

/// Weights of the cells before, at and after for point `sub` of `finer` in a cell.
fn spline(sub: usize, finer: usize) -> [f32; 3] {
    let d = (sub as f32 + 0.5) / finer as f32 - 0.5;
    [0.5 * (0.5 - d) * (0.5 - d), 0.75 - d * d, 0.5 * (0.5 + d) * (0.5 + d)]
}

/// Trilinear interpolation of one packed number of the eight corners.
#[inline(always)]
pub(crate) fn trilinear(corners: &[Indices; 8], shift: u32, mask: u32, f: &[Lanes; 3]) -> Lanes {
    let mut c = [Lanes::splat(0.0); 8];
    for n in 0..8 {
        c[n] = corners[n].bits(shift, mask);
    }
    let low = c[0].lerp(c[1], f[0]).lerp(c[2].lerp(c[3], f[0]), f[1]);
    let high = c[4].lerp(c[5], f[0]).lerp(c[6].lerp(c[7], f[0]), f[1]);
    low.lerp(high, f[2])
}

/// The largest of each cell and its 26 neighbours; periodic in x and y.
fn largest_of_neighbours(field: &[f32], [nx, ny, nz]: [usize; 3]) -> Vec<f32> {
    let mut a = field.to_vec();
    a.par_chunks_mut(nx).zip(field.par_chunks(nx)).for_each(|(to, from)| {
        for x in 0..nx {
            to[x] = from[(x + nx - 1) % nx].max(from[x]).max(from[(x + 1) % nx]);
        }
    });
    let mut b = a.clone();
    b.par_chunks_mut(nx * ny)
        .zip(a.par_chunks(nx * ny))
        .for_each(|(to, from)| {
            for y in 0..ny {
                for x in 0..nx {
                    to[y * nx + x] = from[(y + ny - 1) % ny * nx + x]
                        .max(from[y * nx + x])
                        .max(from[(y + 1) % ny * nx + x]);
                }
            }
        });
    let plane = nx * ny;
    a.par_chunks_mut(plane).enumerate().for_each(|(k, to)| {
        let (low, high) = (k.saturating_sub(1) * plane, (k + 1).min(nz - 1) * plane);
        for i in 0..plane {
            to[i] = b[low + i].max(b[k * plane + i]).max(b[high + i]);
        }
    });
    a
}
