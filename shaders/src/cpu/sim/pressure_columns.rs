//! What the rungs that relax whole columns share: columns of the pressure equation solved at once, in an order of two colours.
//!
//! A column's unknowns are coupled up and down far more strongly than sideways wherever cells are flat. Solving each column as a whole, with its
//! neighbours held, takes that coupling out: what is left to iterate is a problem in x and y, as easy for cells 1000 times wider than
//! high as for cubes (Boerm and Hiptmair 2001 show this for such operators; Mueller and Scheichl 2014 use it in weather models). Density
//! depends on height alone, so all columns of a grid share the same elimination factors.
//!
//! Columns lie like a chessboard's fields; all of one colour are relaxed with the other colour held. Rows of even y, of odd y and, where the
//! extent is odd, the last row are kept in arrays of their own, so that one is written while the others are read; within a row the
//! columns of even x lie before those of odd x, and the last one of an odd extent behind them. That last row and last column have a
//! neighbour of their own colour across the seam, and are relaxed after both colours. Whatever is computed does not depend on the number of threads.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::pressure_source::{Source, centre_level};
use super::slab::{ahead, back};

/// Rows in a task. Fixed, so that the cut never depends on the number of threads.
const TASK_ROWS: usize = 4;
/// Grids of fewer cells are worked on by one thread: waking others costs more.
const ALONE_BELOW: usize = 1 << 13;

/// The pressure equation on one grid: sizes, couplings and the elimination factors of a column.
pub struct Columns {
    /// Columns east and north.
    pub extent: [usize; 2],
    /// Levels.
    pub levels: usize,
    /// One over the squared cell sizes east and north, 1/m2; 0 along an axis of one cell, where there is no gradient.
    pub coupling: [f64; 2],
    density: Vec<f32>,
    /// Coupling of each level to the one below, kg/m5; 0 at the ground.
    pub below: Vec<f32>,
    /// To the one above; 0 under the lid.
    pub above: Vec<f32>,
    /// One over the pivots of a column's elimination, m5/kg.
    pub pivots: Vec<f32>,
}

/// Values of all columns; see the module for their order. Within a row: `[level][x]`.
#[derive(Clone, Debug)]
pub struct Planes {
    even: Vec<f32>,
    odd: Vec<f32>,
    last: Vec<f32>,
    rows: usize,
    plane: usize,
}

impl Planes {
    /// All 0.
    pub fn new(columns: &Columns) -> Self {
        let plane = columns.plane();
        let rows = columns.extent[1];
        Self {
            even: vec![0.0; rows / 2 * plane],
            odd: vec![0.0; rows / 2 * plane],
            last: vec![0.0; rows % 2 * plane],
            rows,
            plane,
        }
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        4 * (self.even.len() + self.odd.len() + self.last.len())
    }

    /// Row `y`.
    #[inline(always)]
    pub fn row(&self, y: usize) -> &[f32] {
        let (from, at) = match y {
            _ if y / 2 == self.rows / 2 => (&self.last, 0),
            _ if y.is_multiple_of(2) => (&self.even, y / 2),
            _ => (&self.odd, y / 2),
        };
        &from[at * self.plane..(at + 1) * self.plane]
    }

    /// Runs `work` on every row with its y.
    pub fn for_each_row(&mut self, work: impl Fn(usize, &mut [f32]) + Sync) {
        let (plane, last_y) = (self.plane, self.rows - 1);
        let alone = self.rows * plane < ALONE_BELOW;
        for (first, rows) in [(0, &mut self.even), (1, &mut self.odd)] {
            if alone {
                rows.chunks_exact_mut(plane)
                    .enumerate()
                    .for_each(|(i, row)| work(first + 2 * i, row));
            } else {
                rows.par_chunks_exact_mut(plane)
                    .enumerate()
                    .for_each(|(i, row)| work(first + 2 * i, row));
            }
        }
        self.last.chunks_exact_mut(plane).for_each(|row| work(last_y, row));
    }
}

/// Which columns of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Part {
    EvenX,
    OddX,
    LastX,
}

impl Columns {
    /// The equation on the scene's own grid.
    pub fn finest(parameters: &Parameters) -> Self {
        let grid = &parameters.grid;
        let coupling = [0, 1].map(|a| (grid.cell_size_m[a] as f64).powi(-2));
        Self::new(parameters, [grid.cells[0], grid.cells[1]], coupling)
    }

    /// The equation on `extent` columns, `coupling` one over the squared cell sizes.
    pub fn new(parameters: &Parameters, extent: [usize; 2], coupling: [f64; 2]) -> Self {
        let levels = parameters.grid.cells[2];
        let coupling = [0, 1].map(|a| if extent[a] > 1 { coupling[a] } else { 0.0 });
        let hz = (parameters.grid.cell_size_m[2] as f64).powi(-2);
        let face = |z: usize| parameters.density_at_z_face_kg_m3[z] as f64 * hz;
        let below: Vec<f64> = (0..levels).map(|z| if z > 0 { face(z) } else { 0.0 }).collect();
        let above: Vec<f64> = (0..levels)
            .map(|z| if z + 1 < levels { face(z + 1) } else { 0.0 })
            .collect();
        let mut pivots: Vec<f64> = Vec::with_capacity(levels);
        for z in 0..levels {
            let sideways = 2.0 * parameters.density_kg_m3[z] as f64 * (coupling[0] + coupling[1]);
            let eliminated = if z > 0 {
                below[z] * above[z - 1] * pivots[z - 1]
            } else {
                0.0
            };
            // A single column is singular, its pressure known but for a constant: the topmost level is pinned to 0.
            let pinned = extent == [1, 1] && z + 1 == levels;
            pivots.push(if pinned {
                0.0
            } else {
                1.0 / (below[z] + above[z] + sideways - eliminated)
            });
        }
        let single = |values: &[f64]| values.iter().map(|&v| v as f32).collect::<Vec<f32>>();
        Self {
            extent,
            levels,
            coupling,
            density: parameters.density_kg_m3.clone(),
            below: single(&below),
            above: single(&above),
            pivots: single(&pivots),
        }
    }

    /// Values in a row of columns.
    pub fn plane(&self) -> usize {
        self.levels * self.extent[0]
    }

    /// Length of a task's scratch times the number of tasks that may run at once.
    pub fn scratch_len(&self) -> usize {
        (self.extent[1] / 2).div_ceil(TASK_ROWS).max(1) * self.scratch_task()
    }

    fn scratch_task(&self) -> usize {
        self.levels * (self.extent[0] / 2).max(1)
    }

    /// One sweep over all columns, each moved by `relaxation` times the way to its own solution.
    ///
    /// `source` is the right side, all rows in order of y; `scratch` has [`Columns::scratch_len`] values.
    pub fn sweep(&self, relaxation: f32, source: &[f32], values: &mut Planes, scratch: &mut [f32]) {
        let plane = self.plane();
        let pairs = self.extent[1] / 2;
        let last_y = self.extent[1] - 1;
        let alone = source.len() < ALONE_BELOW;
        let scratch_task = self.scratch_task();
        let parts = [
            (Part::EvenX, Part::OddX),
            (Part::OddX, Part::EvenX),
            (Part::LastX, Part::LastX),
        ];
        for (of_even, of_odd) in parts {
            if of_even == Part::LastX && self.extent[0].is_multiple_of(2) {
                continue;
            }
            for (first, part) in [(0, of_even), (1, of_odd)] {
                let Planes { even, odd, last, .. } = &mut *values;
                let (written, read) = if first == 0 { (even, &*odd) } else { (odd, &*even) };
                let last: &[f32] = last;
                let task = |(t, (rows, scratch)): (usize, (&mut [f32], &mut [f32]))| {
                    for (r, own) in rows.chunks_exact_mut(plane).enumerate() {
                        let i = t * TASK_ROWS + r;
                        let y = 2 * i + first;
                        let at = |i: usize| &read[i * plane..(i + 1) * plane];
                        // The neighbours of an even row 2i are the odd rows i - 1 and i, of an odd one the even rows i and i + 1.
                        let south = match (first, i) {
                            (0, 0) if last.is_empty() => at(pairs - 1),
                            (0, 0) => last,
                            (0, _) => at(i - 1),
                            _ => at(i),
                        };
                        let north = match first {
                            0 => at(i),
                            _ if i + 1 < pairs => at(i + 1),
                            _ if last.is_empty() => at(0),
                            _ => last,
                        };
                        let source = &source[y * plane..(y + 1) * plane];
                        self.relax_row(relaxation, part, own, [south, north], source, scratch);
                    }
                };
                if alone {
                    written
                        .chunks_mut(TASK_ROWS * plane)
                        .zip(scratch.chunks_mut(scratch_task))
                        .enumerate()
                        .for_each(task);
                } else {
                    written
                        .par_chunks_mut(TASK_ROWS * plane)
                        .zip(scratch.par_chunks_mut(scratch_task))
                        .enumerate()
                        .for_each(task);
                }
            }
        }
        let Planes { even, odd, last, .. } = values;
        if !last.is_empty() {
            let source = &source[last_y * plane..];
            // A single row has no neighbour: its coupling is 0, and what stands in for one must only be finite.
            let (south, north) = match pairs {
                0 => (source, source),
                _ => (&odd[(pairs - 1) * plane..], &even[..plane]),
            };
            for part in [Part::EvenX, Part::OddX, Part::LastX] {
                self.relax_row(relaxation, part, last, [south, north], source, scratch);
            }
        }
    }

    /// Relaxes one part of a row.
    fn relax_row(
        &self,
        relaxation: f32,
        part: Part,
        own: &mut [f32],
        beside: [&[f32]; 2],
        source: &[f32],
        scratch: &mut [f32],
    ) {
        let m = self.extent[0] / 2;
        if part == Part::LastX {
            if self.extent[0] % 2 == 1 {
                self.relax_last(relaxation, own, beside, source, scratch);
            }
        } else if m > 0 {
            relax_half(
                self,
                relaxation,
                part == Part::OddX,
                own,
                beside,
                source,
                &mut scratch[..self.levels * m],
            );
        }
    }

    /// Relaxes the last column of a row of odd extent.
    fn relax_last(&self, relaxation: f32, own: &mut [f32], beside: [&[f32]; 2], source: &[f32], scratch: &mut [f32]) {
        let nx = self.extent[0];
        let m = nx / 2;
        let scratch = &mut scratch[..self.levels];
        let [hx, hy] = self.coupling.map(|h| h as f32);
        for z in 0..self.levels {
            let at = z * nx;
            let l = at + nx - 1;
            // A single column is its own neighbour, with coupling 0.
            let sides = if nx > 1 { own[at + 2 * m - 1] + own[at] } else { 0.0 };
            let pull = hx * sides + hy * (beside[0][l] + beside[1][l]);
            let before = if z > 0 { self.below[z] * scratch[z - 1] } else { 0.0 };
            scratch[z] = (self.density[z] * pull - source[l] + before) * self.pivots[z];
        }
        for z in (0..self.levels).rev() {
            if z + 1 < self.levels {
                scratch[z] += self.above[z] * self.pivots[z] * scratch[z + 1];
            }
            let value = &mut own[z * nx + nx - 1];
            *value += relaxation * (scratch[z] - *value);
        }
    }

    /// `source - div(rho grad values)` of row `y`, in the order of `Planes`; `out` has one row.
    pub fn residual_row(&self, values: &Planes, source: &[f32], y: usize, out: &mut [f32]) {
        let rows = self.extent[1];
        let beside = [back(y, 1, rows), ahead(y, 1, rows)].map(|y| values.row(y));
        residual_row(self, values.row(y), beside, source, out);
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn relax_half(
    columns: &Columns,
    relaxation: f32,
    odd: bool,
    own: &mut [f32],
    beside: [&[f32]; 2],
    source: &[f32],
    scratch: &mut [f32],
) {
    let nx = columns.extent[0];
    let m = nx / 2;
    let levels = columns.levels;
    let [hx, hy] = columns.coupling.map(|h| h as f32);
    let start = if odd { m } else { 0 };
    for z in 0..levels {
        let at = z * nx;
        let row = &own[at..at + nx];
        // The other half of the row; what lies across the seam stands in for its missing end.
        let other = if odd { &row[..m] } else { &row[m..2 * m] };
        let seam = match (odd, nx % 2) {
            (_, 1) => row[nx - 1],
            (true, _) => row[0],
            (false, _) => row[2 * m - 1],
        };
        let (s, n) = (&beside[0][at + start..][..m], &beside[1][at + start..][..m]);
        let f = &source[at + start..][..m];
        let (done, rest) = scratch.split_at_mut(z * m);
        let t = &mut rest[..m];
        let (rx, ry) = (columns.density[z] * hx, columns.density[z] * hy);
        let pivot = columns.pivots[z];
        for i in 0..m {
            t[i] = rx * other[i] + ry * (s[i] + n[i]) - f[i];
        }
        if odd {
            for (t, e) in t[..m - 1].iter_mut().zip(&other[1..]) {
                *t += rx * e;
            }
            t[m - 1] += rx * seam;
        } else {
            t[0] += rx * seam;
            for (t, w) in t[1..].iter_mut().zip(&other[..m - 1]) {
                *t += rx * w;
            }
        }
        if z > 0 {
            let before = &done[(z - 1) * m..][..m];
            let below = columns.below[z];
            for i in 0..m {
                t[i] = (t[i] + below * before[i]) * pivot;
            }
        } else {
            t.iter_mut().for_each(|t| *t *= pivot);
        }
    }
    for z in (0..levels).rev() {
        let (here, over) = scratch.split_at_mut((z + 1) * m);
        let t = &mut here[z * m..][..m];
        if z + 1 < levels {
            let couple = columns.above[z] * columns.pivots[z];
            let over = &over[..m];
            for i in 0..m {
                t[i] += couple * over[i];
            }
        }
        let own = &mut own[z * nx + start..][..m];
        for i in 0..m {
            own[i] += relaxation * (t[i] - own[i]);
        }
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn residual_row(columns: &Columns, own: &[f32], beside: [&[f32]; 2], source: &[f32], out: &mut [f32]) {
    let nx = columns.extent[0];
    let m = nx / 2;
    let [hx, hy] = columns.coupling.map(|h| h as f32);
    for z in 0..columns.levels {
        let at = z * nx;
        let p = &own[at..at + nx];
        let (s, n) = (&beside[0][at..at + nx], &beside[1][at..at + nx]);
        let f = &source[at..at + nx];
        // Beyond ground and lid stands the level itself: no gradient.
        let b = if z > 0 { &own[at - nx..at] } else { p };
        let a = if z + 1 < columns.levels {
            &own[at + nx..at + 2 * nx]
        } else {
            p
        };
        let out = &mut out[at..at + nx];
        let (rx, ry) = (columns.density[z] * hx, columns.density[z] * hy);
        let (below, above) = (columns.below[z], columns.above[z]);
        // Differences first: they are small beside the pressure itself.
        for i in 0..nx {
            let vertical = above * (a[i] - p[i]) - below * (p[i] - b[i]);
            out[i] = f[i] - (ry * ((s[i] - p[i]) + (n[i] - p[i])) + vertical);
        }
        let (even, rest) = p.split_at(m);
        let (odd, last) = rest.split_at(m);
        let mut side = |i: usize, west: f32, east: f32| out[i] -= rx * ((west - p[i]) + (east - p[i]));
        if m == 0 {
            continue;
        }
        side(0, last.first().copied().unwrap_or(odd[m - 1]), odd[0]);
        side(2 * m - 1, even[m - 1], last.first().copied().unwrap_or(even[0]));
        if let Some(&l) = last.first() {
            out[2 * m] -= rx * ((odd[m - 1] - l) + (even[0] - l));
        }
        let (to_even, to_odd) = out.split_at_mut(m);
        for i in 1..m {
            to_even[i] -= rx * ((odd[i - 1] - even[i]) + (odd[i] - even[i]));
        }
        for i in 0..m - 1 {
            to_odd[i] -= rx * ((even[i] - odd[i]) + (even[i + 1] - odd[i]));
        }
    }
}

/// Brings a row from the grid's order into that of `Planes`.
#[inline(always)]
pub fn split_row(from: &[f32], to: &mut [f32]) {
    let m = from.len() / 2;
    let (even, rest) = to.split_at_mut(m);
    let (odd, last) = rest.split_at_mut(m);
    for ((e, o), pair) in even.iter_mut().zip(odd).zip(from.chunks_exact(2)) {
        (*e, *o) = (pair[0], pair[1]);
    }
    if let (Some(to), Some(from)) = (last.first_mut(), from.chunks_exact(2).remainder().first()) {
        *to = *from;
    }
}

/// Brings a row from the order of `Planes` into the grid's.
#[inline(always)]
pub fn join_row(from: &[f32], to: &mut [f32]) {
    let m = from.len() / 2;
    let (even, rest) = from.split_at(m);
    let (odd, last) = rest.split_at(m);
    let mut pairs = to.chunks_exact_mut(2);
    for ((e, o), pair) in even.iter().zip(odd).zip(&mut pairs) {
        pair[0] = *e;
        pair[1] = *o;
    }
    if let (Some(from), Some(to)) = (last.first(), pairs.into_remainder().first_mut()) {
        *to = *from;
    }
}

/// The finest grid's right side and pressure, on their way from the fields and back.
pub struct Columnar {
    source: Source,
    /// The right side, rows in order of y.
    pub source_rows: Vec<f32>,
    /// The pressure less its level's mean.
    pub values: Planes,
    row_scratch: Vec<f32>,
}

impl Columnar {
    /// Makes room.
    pub fn new(columns: &Columns) -> Self {
        Self {
            source: Source::new(columns.levels),
            source_rows: vec![0.0; columns.plane() * columns.extent[1]],
            values: Planes::new(columns),
            row_scratch: vec![0.0; columns.extent[0] * columns.extent[1]],
        }
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        4 * (self.source_rows.len() + self.row_scratch.len()) + self.values.bytes()
    }

    /// Makes the right side from the velocities and takes the first guess from `pressure`, whose level means are taken off it in place.
    pub fn load(&mut self, parameters: &Parameters, velocity: [&[f32]; 3], dt_s: f32, pressure: &mut [f32]) {
        let grid = &parameters.grid;
        let [nx, _, levels] = grid.cells;
        self.source.measure(parameters, velocity[2], dt_s);
        let source = &self.source;
        self.source_rows
            .par_chunks_mut(levels * nx)
            .zip(self.row_scratch.par_chunks_mut(nx))
            .enumerate()
            .for_each(|(y, (rows, scratch))| source_row(source, parameters, velocity, 1.0 / dt_s, y, scratch, rows));
        pressure.par_chunks_mut(grid.plane()).for_each(centre_level);
        let pressure: &[f32] = pressure;
        self.values.for_each_row(|y, plane| {
            for (z, to) in plane.chunks_exact_mut(nx).enumerate() {
                split_row(&pressure[grid.index(0, y, z)..][..nx], to);
            }
        });
    }

    /// Writes the pressure with its mean column to `pressure`, its constant such that the topmost level's mean is 0: relaxation leaves
    /// the constant where it happens to end.
    pub fn store(&self, parameters: &Parameters, pressure: &mut [f32]) {
        let [nx, ny, levels] = parameters.grid.cells;
        let top = (0..ny).map(|y| {
            let row = &self.values.row(y)[(levels - 1) * nx..];
            row.iter().map(|&p| p as f64).sum::<f64>()
        });
        let constant = (top.sum::<f64>() / (nx * ny) as f64) as f32;
        pressure
            .par_chunks_mut(parameters.grid.plane())
            .enumerate()
            .for_each(|(z, level)| {
                let mean = self.source.mean_pressure(z) - constant;
                for (y, to) in level.chunks_exact_mut(nx).enumerate() {
                    join_row(&self.values.row(y)[z * nx..(z + 1) * nx], to);
                    to.iter_mut().for_each(|p| *p += mean);
                }
            });
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn source_row(
    source: &Source,
    parameters: &Parameters,
    velocity: [&[f32]; 3],
    per_dt: f32,
    y: usize,
    scratch: &mut [f32],
    rows: &mut [f32],
) {
    for (z, to) in rows.chunks_exact_mut(scratch.len()).enumerate() {
        source.row(parameters, velocity, per_dt, y, z, scratch);
        split_row(scratch, to);
    }
}
