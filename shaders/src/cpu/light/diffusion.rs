//! Stage `diffusion`: sunlight that cloud has scattered so often that it goes all ways.
//!
//! Reads: [`Shape`] (mean extinction at the slab's cells), [`SunLight`] (optical depth towards the sun), the phase function's asymmetry g. Writes: [`Diffuse`]: the fluence
//! of diffuse light over the irradiance of the sun's beam and the flux over the fluence, in the slab's cells, a word each. Scheme: light in cloud is split in three: the beam, which goes as exp(-t); what was scattered but
//! still goes about the beam's way ([`super::diffusion_shares::forward_octaves`]); and the rest, whose fluence f obeys the
//! diffusion equation (Stam 1995; Ishimaru 1978), div(D grad f) = -s exp(-(1 - g) t), D = 1 / (3 s), s = (1 - g) extinction. Finite volumes on the cells, harmonic
//! means of D at faces; at the cloud's surface nothing comes in (the fluence falls to nothing 0.7104 free paths behind it, Milne: the flux that leaves is the surface's fluence over 2.13), and of the half cell before it three quarters of the resistance, for extinction falls there. A surface
//! that stands aslant is a staircase of cells' faces: it loses as much as the faces across each axis make as a vector, since their areas' sum is up to 1.7 times the surface's. Solved by multigrid, see [`super::diffusion_grids`].
//! The equation lets all that a cell is given out from its centre. Of a source that is even in the cell half has a shorter way to each face, and the fluence at the centre is less by a quarter of what
//! the faces across each axis let out times half the cell's resistance.
//!
//! Keeps: energy, to the solver's bound (a hundredth, lost). What a cell's source puts in leaves through the surface; the source is the midpoint's, which is less than what the beam
//! loses in the cell. No absorption. Light that leaves one cloud for another is even between all of them ([`super::between_clouds`]); what the ground sends back of it is lost. Order 2 inside; at
//! surfaces, and where a cell is thin, diffusion is an approximation however fine the grid; the march scales it and what goes about the beam's way by
//! [`super::diffusion_shares::diffusion_shares`], so that level slabs give back all that came in.
//!
//! The march adds what diffuse light brings towards the camera: f / 4 pi, and of the flux F = -D grad f the part along the ray, 3 g F / 4 pi; both trilinear between cells' centres. A cell's flux is the mean of what
//! passes its two faces across each axis. Outwards it is bounded by half the fluence, about its value at a surface; inwards by less, for what comes from one side only is scattered back too, and light is never negative.
//! Packed: the flux, 7 bits a component, steps of a fortieth of the fluence (3 F); the fluence as a float of 10 bits whose least number is taken off again, to 0.4 % above 1/32 and 1.2e-4 below, up to 7.9 (a half space under a sun in the
//! zenith has 5.1). The highest bit is 0 and the next seven are neither all 0 nor all 1, so that the word may lie among a GPU's floats.
//!
//! Floor of the cost: 196,608 cells, of those in or beside cloud a sample of shape and light (16 words), once through the numbers for what cells conduct, once for the flux (four floats a cell written and read again), and the solver's
//! ([`super::diffusion_grids`]): 6 ms on two cores; measured 10 to 17 ms. In the march 8 words a sample, once: as long as octaves, to a tenth.

use multiversion::multiversion;
use rayon::prelude::*;

use super::between_clouds::{Meetings, between_clouds, meetings};
use super::diffusion_grids::Grids;
use super::sun_optical_depth::{DEPTH_UNIT, SUN_MARCH_DEEP, SunLight};
use crate::cpu::view::lanes::{Indices, LANES, Lanes};
use crate::cpu::view::shape::{Shape, trilinear};

crate::constants! {
    /// Half a cell's resistance is no less: where light meets nothing, diffusion would make it infinitely fast.
    const DIFFUSION_RESISTANCE_LEAST: f32 = 0.005;
    /// What the surface resists, three times Milne's 0.7104: its fluence over this leaves.
    pub(super) const DIFFUSION_SURFACE_RESISTANCE: f32 = 2.1313;
    /// Share of half a cell's resistance that lies between its middle and the cloud's surface: extinction falls about evenly to the middle of the empty cell beside it.
    const RIM_SHARE: f32 = 0.75;
    /// Half a cell's resistance from which on its own fluence is looked up alone: light must not leap where a cell at the edge comes to be cloud.
    const SUBSTANCE_RESISTANCE: f32 = 0.05;
    /// Bounds of 3 F over the fluence: out of the cloud, and into it.
    pub(super) const FLUX_OUTWARD: f32 = 1.5;
    pub(super) const FLUX_INWARD: f32 = 0.6;
    /// Of the packed flux: the code of none, and codes from there to [`FLUX_OUTWARD`].
    const FLUX_NONE: u32 = 64;
    const FLUX_CODES: u32 = 62;
    /// The packed fluence: bits of the least float, that float, bits that are dropped, and the most.
    const FLUENCE_LEAST_BITS: u32 = 0x3d00_0000;
    const FLUENCE_LEAST: f32 = 0.03125;
    const FLUENCE_DROPPED_BITS: u32 = 16;
    const FLUENCE_MOST: f32 = 7.9;
    /// By what share of half a cell's resistance an even source in it is nearer to its face than its centre is.
    const SOURCE_NEARER: f32 = 0.25;
    /// Weight of the cells at a place along an axis where those before and after have 1, for the fluence beside cloud.
    const SURFACE_MIDDLE: f32 = 4.0;
}
/// Asymmetry is taken as no more.
const ASYMMETRY_MAX: f32 = 0.99;

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct Diffuse {
    /// Fluence over the beam's irradiance and 3 F over the fluence, packed, `[level][y][x]`, with one more cell on each side in x and y.
    pub words: Vec<u32>,
    /// 1 - g.
    pub(crate) similarity: f32,
    cells: [usize; 3],
    per_cell_size: f32,
    /// Extinction that diffuse light meets, 1/m.
    transport: Vec<f32>,
    /// -3 F in the cells.
    flow: Vec<[f32; 3]>,
    /// Fluence at the cells' centres.
    centre: Vec<f32>,
    /// A row of empty cells.
    nothing: Vec<f32>,
    /// What lines from the lowest level's rows meet.
    met: Vec<Meetings>,
    grids: Grids,
}

/// 1 - g, as the stage takes it.
pub(crate) fn similarity(asymmetry: f32) -> f32 {
    1.0 - asymmetry.clamp(0.0, ASYMMETRY_MAX)
}

impl Diffuse {
    /// Of a cloud; `carved` as in [`SunLight::new`].
    pub fn new(shape: &Shape, sun_light: &SunLight, carved: bool, asymmetry: f32) -> Diffuse {
        let mut diffuse = Diffuse::default();
        diffuse.make(shape, sun_light, carved, asymmetry);
        diffuse
    }

    /// The same in place of another.
    pub fn make(&mut self, shape: &Shape, sun_light: &SunLight, carved: bool, asymmetry: f32) {
        let (cells, size) = (shape.slab_cells(), shape.cell_size_m());
        let [nx, ny, nz] = cells;
        self.similarity = similarity(asymmetry);
        self.cells = cells;
        self.per_cell_size = 1.0 / size[2];
        self.transport.resize(nx * ny * nz, 0.0);
        self.flow.resize(nx * ny * nz, [0.0; 3]);
        self.centre.resize(nx * ny * nz, 0.0);
        self.nothing.resize(nx, 0.0);
        let grid = self.grids.finest(cells, size);
        let similarity = self.similarity;
        let volume = size[0] * size[1] * size[2];
        let rows = self.transport.par_chunks_mut(nx).zip(grid.source.par_chunks_mut(nx));
        rows.enumerate().for_each(|(n, (transport, source))| {
            let y = ((n % ny) as f32 + 0.5) * size[1];
            let z = shape.bottom_m + ((n / ny) as f32 + 0.5) * size[2];
            source_row(
                shape,
                sun_light,
                carved,
                similarity,
                volume,
                [y, z],
                size[0],
                transport,
                source,
            );
        });
        let (transport, nothing) = (&self.transport, &self.nothing[..nx]);
        let [east, north, up] = &mut grid.next;
        let rows = east.par_chunks_mut(nx).zip(north.par_chunks_mut(nx));
        let rows = rows.zip(up.par_chunks_mut(nx)).zip(grid.outside.par_chunks_mut(nx));
        rows.enumerate().for_each(|(n, (((east, north), up), outside))| {
            let (j, k) = (n % ny, n / ny);
            let row = |j: usize, k: usize| &transport[(k * ny + j) * nx..][..nx];
            let here = row(j, k);
            conduct_row(
                here,
                [row((j + ny - 1) % ny, k), row((j + 1) % ny, k)],
                [
                    if k > 0 { row(j, k - 1) } else { nothing },
                    if k + 1 < nz { row(j, k + 1) } else { nothing },
                ],
                [nx > 1, ny > 1],
                size,
                [east, north, up, outside],
            );
        });
        // Row by row, so that the sum does not hang on how many threads there are.
        let given = grid
            .source
            .chunks(nx)
            .map(|row| f64::from(row.iter().sum::<f32>()))
            .sum();
        self.met.resize(ny, Meetings::default());
        let rows = self.met.par_iter_mut().enumerate();
        rows.for_each(|(j, met)| *met = meetings(transport, cells, size, j));
        let between = between_clouds(&self.met, cells, size, given);
        let solved = self.grids.solve();
        let rows = self.flow.par_chunks_mut(nx).zip(self.centre.par_chunks_mut(nx));
        rows.enumerate().for_each(|(n, (flow, centre))| {
            let (j, k) = (n % ny, n / ny);
            let row = |j: usize, k: usize| {
                let first = (k * ny + j) * nx;
                (&transport[first..][..nx], &solved[first..][..nx])
            };
            let sides = [
                row((j + ny - 1) % ny, k),
                row((j + 1) % ny, k),
                if k > 0 { row(j, k - 1) } else { (nothing, nothing) },
                if k + 1 < nz { row(j, k + 1) } else { (nothing, nothing) },
            ];
            flow_row(row(j, k), sides, [nx > 1, ny > 1], size, flow, centre);
        });
        let (flow, centre) = (&self.flow, &self.centre);
        let stride = nx + 2;
        self.words.resize(stride * (ny + 2) * nz, 0);
        self.words.par_chunks_mut(stride).enumerate().for_each(|(n, to)| {
            // Stored row j is row j - 1; periodic.
            let (j, k) = ((n % (ny + 2) + ny - 1) % ny, n / (ny + 2));
            let at = |j: usize, k: usize| (k * ny + j) * nx;
            let mut rows = [None; 9];
            for (c, row) in rows.iter_mut().enumerate() {
                let level = (k + c / 3).wrapping_sub(1);
                let first = at((j + ny + c % 3 - 1) % ny, level.min(nz - 1));
                *row = (level < nz).then(|| (&transport[first..][..nx], &centre[first..][..nx], &flow[first..][..nx]));
            }
            surface_row(&rows, size, between, &mut to[1..=nx]);
            (to[0], to[nx + 1]) = (to[nx], to[1]);
        });
    }

    /// What diffuse light brings towards a camera that looks along `d`, times 4 pi, at sixteen places in m.
    #[inline(always)]
    pub(crate) fn towards(&self, shape: &Shape, p: &[Lanes; 3], d: &[Lanes; 3]) -> Lanes {
        let [nx, ny, nz] = self.cells;
        let per_period = shape.per_period();
        let (i, fx) = ((p[0] * per_period[0]).fraction() * nx as f32 + 0.5).split();
        let (j, fy) = ((p[1] * per_period[1]).fraction() * ny as f32 + 0.5).split();
        let (k, fz) = ((p[2] - shape.bottom_m) * self.per_cell_size - 0.5)
            .clamp(0.0, nz as f32 - 1.001)
            .split();
        let (row, rows) = (nx as u32 + 2, ny as u32 + 2);
        let level = row * rows;
        let mut index = Indices([0; LANES]);
        for l in 0..LANES {
            index.0[l] = (k.0[l] * rows + j.0[l]) * row + i.0[l];
        }
        let asymmetry = 1.0 - self.similarity;
        let unit = asymmetry * FLUX_OUTWARD / FLUX_CODES as f32;
        let along = [d[0] * unit, d[1] * unit, d[2] * unit];
        let none = (along[0] + along[1] + along[2]) * FLUX_NONE as f32;
        let offsets = [0, 1, row, row + 1, level, level + 1, level + row, level + row + 1];
        let mut brought = [fx; 8];
        for n in 0..8 {
            let word = index.plus(offsets[n]).gather(&self.words);
            let flux = word.bits(10, 127) * along[0] + word.bits(17, 127) * along[1] + word.bits(24, 127) * along[2];
            let more = (flux - none).clamp(-FLUX_INWARD * asymmetry, FLUX_OUTWARD * asymmetry) + 1.0;
            brought[n] = fluence_of(word) * more;
        }
        let low = brought[0]
            .lerp(brought[1], fx)
            .lerp(brought[2].lerp(brought[3], fx), fy);
        let high = brought[4]
            .lerp(brought[5], fx)
            .lerp(brought[6].lerp(brought[7], fx), fy);
        low.lerp(high, fz)
    }
}

/// The fluence and -3 F of a cell, packed.
#[inline(always)]
fn packed(fluence: f32, flow: [f32; 3]) -> u32 {
    let [x, y, z] = flow;
    let most = FLUX_OUTWARD / (x * x + y * y + z * z).sqrt().max(1e-20);
    let scale = (1.0 / fluence.max(1e-9)).min(most) * (FLUX_CODES as f32 / FLUX_OUTWARD);
    let [x, y, z] = flow.map(|v| (v * scale + (FLUX_NONE as f32 + 0.5)) as u32);
    let float = (fluence.min(FLUENCE_MOST) + FLUENCE_LEAST).to_bits() - FLUENCE_LEAST_BITS;
    let fluence = (float + (1 << (FLUENCE_DROPPED_BITS - 1))) >> FLUENCE_DROPPED_BITS;
    fluence | x << 10 | y << 17 | z << 24
}

/// The fluence that words hold.
#[inline(always)]
fn fluence_of(words: Indices) -> Lanes {
    let mut r = Lanes::splat(0.0);
    for l in 0..LANES {
        r.0[l] = f32::from_bits(((words.0[l] & 0x3ff) << FLUENCE_DROPPED_BITS) + FLUENCE_LEAST_BITS) - FLUENCE_LEAST;
    }
    r
}

/// Extinction that diffuse light meets (1/m) and what becomes diffuse in a row of cells.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn source_row(
    shape: &Shape,
    sun_light: &SunLight,
    carved: bool,
    similarity: f32,
    volume_m3: f32,
    [y_m, z_m]: [f32; 2],
    size_x_m: f32,
    transport: &mut [f32],
    source: &mut [f32],
) {
    let zero = Lanes::splat(0.0);
    for first in (0..transport.len()).step_by(LANES) {
        let count = LANES.min(transport.len() - first);
        let x = Lanes::from_fn(|l| ((first + l) as f32 + 0.5) * size_x_m);
        let (y, z) = (Lanes::splat(y_m), Lanes::splat(z_m));
        let cloud = Lanes::select_less(zero, shape.empty_distance_m(x, y, z), zero, Lanes::splat(1.0));
        let (mut thick, mut given) = (zero, zero);
        if cloud.any_above(0.0) {
            let (cover, amplitude) = shape.sample(x, y, z);
            let (index, f) = shape.place(x, y, z);
            let depth = trilinear(&shape.corners(&sun_light.words, index), 0, 0xffff, &f) * DEPTH_UNIT;
            thick = shape.mean_extinction(cover, amplitude, carved) * similarity * cloud;
            // Depths are followed to about this one only: behind it the source would not fall any more and make light.
            let followed = Lanes::select_less(depth, Lanes::splat(SUN_MARCH_DEEP), Lanes::splat(volume_m3), zero);
            given = thick * (depth * -similarity).exp() * followed;
        }
        transport[first..][..count].copy_from_slice(&thick.0[..count]);
        source[first..][..count].copy_from_slice(&given.0[..count]);
    }
}

/// Half a cell's resistance to diffuse light, times its face's area.
#[inline(always)]
fn half_resistance(transport_per_m: f32, size_m: f32) -> f32 {
    (1.5 * transport_per_m * size_m).max(DIFFUSION_RESISTANCE_LEAST)
}

/// Resistance from the middle of a cell, of which `half` is half a cell's, to the outside.
#[inline(always)]
fn to_outside(half: f32) -> f32 {
    half * RIM_SHARE + DIFFUSION_SURFACE_RESISTANCE
}

/// A row's conductances to the next cells east, north and up, and to the outside; `sides` are the rows south and north, below and above. An axis of one cell conducts nothing.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn conduct_row(
    here: &[f32],
    [south, north]: [&[f32]; 2],
    [below, above]: [&[f32]; 2],
    goes: [bool; 2],
    size_m: [f32; 3],
    [east, to_north, up, outside]: [&mut [f32]; 4],
) {
    let n = here.len();
    let face = [size_m[1] * size_m[2], size_m[0] * size_m[2], size_m[0] * size_m[1]];
    // To a cell, or to the outside, where the other is cloud or not.
    let both = |a: f32, b: f32, axis: usize| {
        let through = face[axis] / (half_resistance(a, size_m[axis]) + half_resistance(b, size_m[axis]));
        if a > 0.0 && b > 0.0 { through } else { 0.0 }
    };
    let lost = |a: f32, b: f32, axis: usize| {
        let through = face[axis] / to_outside(half_resistance(a, size_m[axis]));
        if a > 0.0 && b <= 0.0 { through } else { 0.0 }
    };
    to_north.fill(0.0);
    east.fill(0.0);
    outside.fill(0.0);
    // What each axis's faces lose, squared: a surface that stands aslant is as large as its faces' areas make as a vector, not their sum.
    if goes[0] {
        let square = |i: usize, west: usize, east: usize| {
            let through = lost(here[i], here[west], 0) + lost(here[i], here[east], 0);
            through * through
        };
        for i in 1..n - 1 {
            outside[i] = square(i, i - 1, i + 1);
        }
        outside[0] = square(0, n - 1, 1);
        outside[n - 1] = square(n - 1, n - 2, 0);
    }
    if goes[1] {
        let (south, north) = (&south[..n], &north[..n]);
        for i in 0..n {
            let through = lost(here[i], north[i], 1) + lost(here[i], south[i], 1);
            outside[i] += through * through;
        }
    }
    // Light leaves under the ground and above the lid too, where the row beside is empty.
    let (below, above) = (&below[..n], &above[..n]);
    for i in 0..n {
        let through = lost(here[i], below[i], 2) + lost(here[i], above[i], 2);
        outside[i] = (outside[i] + through * through).sqrt();
    }
    if goes[0] {
        for i in 0..n - 1 {
            east[i] = both(here[i], here[i + 1], 0);
        }
        east[n - 1] = both(here[n - 1], here[0], 0);
    }
    if goes[1] {
        for i in 0..n {
            to_north[i] = both(here[i], north[i], 1);
        }
    }
    for i in 0..n {
        up[i] = both(here[i], above[i], 2);
    }
}

/// -3 F in a row of cells, the mean of what passes both faces across each axis, nothing in empty cells, and the fluence at their centres. Extinction and fluence of the row, and `sides` of those south, north, below and above.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn flow_row(
    (here, fluence): (&[f32], &[f32]),
    [south, north, below, above]: [(&[f32], &[f32]); 4],
    goes: [bool; 2],
    size_m: [f32; 3],
    flow: &mut [[f32; 3]],
    centre: &mut [f32],
) {
    let n = flow.len();
    // Into a cell through a face.
    let through = |i: usize, (beside, other): (&[f32], &[f32]), at: usize, axis: usize| {
        let half = half_resistance(here[i], size_m[axis]);
        let inside = (other[at] - fluence[i]) / (half + half_resistance(beside[at], size_m[axis]));
        let outside = -fluence[i] / to_outside(half);
        if beside[at] > 0.0 { inside } else { outside }
    };
    for i in 0..n {
        let mut faces = [[0.0f32; 2]; 3];
        if here[i] > 0.0 {
            if goes[0] {
                let (next, last) = (if i + 1 < n { i + 1 } else { 0 }, if i > 0 { i - 1 } else { n - 1 });
                let row = (here, fluence);
                faces[0] = [through(i, row, next, 0), through(i, row, last, 0)];
            }
            if goes[1] {
                faces[1] = [through(i, north, i, 1), through(i, south, i, 1)];
            }
            faces[2] = [through(i, above, i, 2), through(i, below, i, 2)];
        }
        let mut nearer = 0.0;
        for (axis, [after, before]) in faces.into_iter().enumerate() {
            flow[i][axis] = 1.5 * (after - before);
            nearer += half_resistance(here[i], size_m[axis]) * (after + before);
        }
        centre[i] = (fluence[i] + SOURCE_NEARER * nearer).max(0.0);
    }
}

/// How far a cell counts as cloud, 0 to 1.
#[inline(always)]
fn substance(transport_per_m: f32, mean_m: f32) -> f32 {
    (transport_per_m * mean_m * (1.5 / SUBSTANCE_RESISTANCE)).min(1.0)
}

/// A row of cells: extinction, fluence at their centres, and -3 F.
type Row<'a> = (&'a [f32], &'a [f32], &'a [[f32; 3]]);

/// A row's fluence and flux, packed, with what is `between` clouds, and in cells beside cloud what is at their neighbours' surface, the more the less they are cloud themselves: a place between two cells is looked up in both. `rows` are the nine around,
/// from south-below on.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn surface_row(rows: &[Option<Row<'_>>; 9], size_m: [f32; 3], between: f32, to: &mut [u32]) {
    let n = to.len();
    let mean_m = (size_m[0] + size_m[1] + size_m[2]) / 3.0;
    let around = [1.0, SURFACE_MIDDLE, 1.0];
    let Some((here, inside, flows)) = rows[4] else { return };
    for i in 0..n {
        let own = substance(here[i], mean_m);
        if own >= 1.0 {
            to[i] = packed(inside[i] + between, flows[i]);
            continue;
        }
        let (mut sum, mut flow, mut weights) = (0.0f32, [0.0f32; 3], 0.0f32);
        for (c, row) in rows.iter().enumerate() {
            let Some((transport, fluence, flows)) = row else {
                continue;
            };
            let weight = around[c % 3] * around[c / 3];
            for (a, at) in [(i + n - 1) % n, i, (i + 1) % n].into_iter().enumerate() {
                if transport[at] > 0.0 && (c, a) != (4, 1) {
                    // Behind the surface light meets nothing more: the fluence is the surface's.
                    let half = half_resistance(transport[at], mean_m);
                    let weight = weight * around[a] * substance(transport[at], mean_m);
                    sum += weight * fluence[at] * (DIFFUSION_SURFACE_RESISTANCE / to_outside(half));
                    for (to, from) in flow.iter_mut().zip(flows[at]) {
                        *to += weight * from;
                    }
                    weights += weight;
                }
            }
        }
        to[i] = if weights > 0.0 {
            let rest = (1.0 - own) / weights;
            let flow = [0, 1, 2].map(|axis| own * flows[i][axis] + rest * flow[axis]);
            packed(own * inside[i] + rest * sum + between, flow)
        } else {
            packed(inside[i] + between, flows[i])
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::light::sky_visibility::sky_visibility;
    use crate::{CloudVolume, Grid};

    /// A ball, dense or thin, in haze that hardly is: what its cells are given leaves, though cells at its edge conduct hundreds of times better than those inside.
    #[test]
    fn what_a_cloud_is_given_leaves_it() {
        let grid = Grid {
            cells: [24, 20, 30],
            cell_size_m: [100.0, 100.0, 40.0],
        };
        for dense_per_m in [0.1, 0.01, 0.001] {
            let extinction = (0..grid.len()).map(|n| {
                let [x, y, z] = [n % 24, n / 24 % 20, n / grid.plane()].map(|i| i as f32 + 0.5);
                let r_m =
                    ((100.0 * x - 1200.0).powi(2) + (100.0 * y - 1000.0).powi(2) + (40.0 * z - 600.0).powi(2)).sqrt();
                if r_m < 450.0 {
                    dense_per_m
                } else if r_m < 560.0 {
                    1e-5
                } else {
                    0.0
                }
            });
            let volume = CloudVolume {
                grid,
                extinction_per_m: extinction.collect(),
                cloudy_levels: [1, 29],
                air_displacement_m: [0.0; 3],
            };
            let shape = Shape::new(&volume).unwrap();
            let seen = sky_visibility(&shape.slab_per_m, [24, 20], grid.cell_size_m);
            let sun_light = SunLight::new(&shape, &seen, false, false, [0.6, 0.0, 0.8]);
            let mut diffuse = Diffuse::new(&shape, &sun_light, false, 0.86);
            let solved = diffuse.grids.finest(shape.slab_cells(), shape.cell_size_m());
            let sum = |of: &[f32]| of.iter().map(|v| f64::from(*v)).sum::<f64>();
            let leaves: Vec<f32> = solved.outside.iter().zip(&solved.fluence).map(|(o, f)| o * f).collect();
            let share = sum(&leaves) / sum(&solved.source);
            assert!(share > 0.97 && share < 1.0 + 1e-4, "{dense_per_m}: {share}");
        }
    }
}
