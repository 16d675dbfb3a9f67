//! Stage `pressure_multigrid`: the pressure that frees the mass flux of divergence, by V-cycles of multigrid.
//!
//! Reads the velocities at their faces (m/s) and `Pressure` (m2/s2) at centres as a first guess; writes `Pressure`. The discrete problem is that of
//! `pressure_solve`, second order. Grids are made coarser in x and y only, and whole columns are relaxed in two colours (`pressure_columns`): each
//! vertical structure of the pressure is then a problem in x and y by itself, so the convergence does not depend on how flat the cells are
//! (Boerm and Hiptmair 2001). Where cells are longer one way than the other, only the axis with the shorter cells is made coarser
//! until both are alike. An axis of n cells becomes one of n/2, rounded up, over the same length; fine values are interpolated linearly from coarse
//! ones, and residuals are brought to the coarse grid by the same weights transposed, which keeps their sum. So extents may be odd or prime.
//! The coarsest grid is one column, solved exactly.
//!
//! A cycle: one sweep, residual to the coarse grid, correction from there, one sweep. Convergence factor a cycle, over the residual's
//! root mean square: `tests/physics/pressure.rs` holds it. The number of cycles is fixed; nothing is read back. The first guess is the
//! pressure of the stage before, which makes `Pressure` part of the state with this rung. The mean column is exact (`pressure_source`).
//! Errors: none. Bytes a cell: 40 to load and store, about 80 a cycle. Holds about 20 bytes a cell.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::pressure_columns::{Columnar, Columns, Planes, join_row, split_row};

/// Sweeps before and after the coarse correction.
const SWEEPS: [usize; 2] = [1, 1];
/// An axis is made coarser if its coupling is at least this share of the stronger one.
const ALIKE: f64 = 0.5;
/// Grids of fewer cells are worked on by one thread.
const ALONE_BELOW: usize = 1 << 13;

/// Buffers, factors and weights, made once for a grid.
pub struct Solver {
    columnar: Columnar,
    grids: Vec<Level>,
    /// The coarse grids' values and right sides; the finest has its own in `columnar`.
    coarse: Vec<Coarse>,
}

struct Coarse {
    source: Vec<f32>,
    values: Planes,
}

/// A grid and the way to the next coarser one.
struct Level {
    columns: Columns,
    scratch: Vec<f32>,
    /// Residuals already coarse in x, `[y][level][x]` in the grid's order.
    narrow: Vec<f32>,
    /// A row in the grid's order for each y.
    rows: Vec<f32>,
    residual: Vec<f32>,
    along_x: Option<Transfer>,
    along_y: Option<Transfer>,
}

/// Weights between an axis of n cells and one of fewer.
struct Transfer {
    /// For each fine place two coarse ones with their weights.
    to_fine: Vec<[(usize, f32); 2]>,
    /// For each coarse place the fine ones with their weights.
    to_coarse: Vec<Vec<(usize, f32)>>,
}

impl Transfer {
    fn new(fine: usize, coarse: usize) -> Self {
        let spacing = fine as f64 / coarse as f64;
        let mut to_coarse = vec![Vec::new(); coarse];
        let to_fine = (0..fine)
            .map(|i| {
                let at = i as f64 / spacing;
                // Half a rounding error must not put a fine place that lies on a coarse one between two.
                let left = (at + 1e-9).floor();
                let share = (at - left).max(0.0);
                let pair = [
                    (left as usize % coarse, 1.0 - share),
                    ((left as usize + 1) % coarse, share),
                ];
                for (j, weight) in pair {
                    if weight > 1e-9 {
                        to_coarse[j].push((i, (weight / spacing) as f32));
                    }
                }
                pair.map(|(j, weight)| (j, weight as f32))
            })
            .collect();
        Self { to_fine, to_coarse }
    }
}

impl Solver {
    /// Makes the grids for `parameters.grid`.
    pub fn new(parameters: &Parameters) -> Self {
        let finest = Columns::finest(parameters);
        let columnar = Columnar::new(&finest);
        let (mut grids, mut coarse) = (Vec::new(), Vec::new());
        let mut columns = finest;
        loop {
            let [nx, ny] = columns.extent;
            let strongest = columns.coupling[0].max(columns.coupling[1]);
            let next = [0, 1].map(|a| {
                let n = columns.extent[a];
                if n > 1 && columns.coupling[a] >= ALIKE * strongest {
                    n.div_ceil(2)
                } else {
                    n
                }
            });
            let along = |a: usize| (next[a] < columns.extent[a]).then(|| Transfer::new(columns.extent[a], next[a]));
            let coupling = [0, 1].map(|a| columns.coupling[a] * (next[a] as f64 / columns.extent[a] as f64).powi(2));
            let last = next == columns.extent;
            let fine = Level {
                scratch: vec![0.0; columns.scratch_len()],
                narrow: vec![0.0; if last { 0 } else { ny * columns.levels * next[0] }],
                rows: vec![0.0; if last { 0 } else { nx * ny }],
                residual: vec![0.0; if last { 0 } else { ny * columns.plane() }],
                along_x: along(0),
                along_y: along(1),
                columns,
            };
            grids.push(fine);
            if last {
                break;
            }
            columns = Columns::new(parameters, next, coupling);
            coarse.push(Coarse {
                source: vec![0.0; columns.plane() * next[1]],
                values: Planes::new(&columns),
            });
        }
        Self {
            columnar,
            grids,
            coarse,
        }
    }

    /// Bytes that the solver holds.
    pub fn bytes(&self) -> usize {
        let grids: usize = self
            .grids
            .iter()
            .map(|g| 4 * (g.scratch.len() + g.narrow.len() + g.rows.len() + g.residual.len()))
            .sum();
        let coarse: usize = self.coarse.iter().map(|c| 4 * c.source.len() + c.values.bytes()).sum();
        self.columnar.bytes() + grids + coarse
    }

    /// Improves `pressure` by `cycles` V-cycles for a stage of length `dt_s`.
    pub fn run(
        &mut self,
        parameters: &Parameters,
        velocity: [&[f32]; 3],
        dt_s: f32,
        cycles: u32,
        pressure: &mut [f32],
    ) {
        self.columnar.load(parameters, velocity, dt_s, pressure);
        for _ in 0..cycles {
            let Columnar {
                source_rows, values, ..
            } = &mut self.columnar;
            cycle(&mut self.grids, &mut self.coarse, source_rows, values);
        }
        self.columnar.store(parameters, pressure);
    }
}

fn cycle(grids: &mut [Level], coarse: &mut [Coarse], source: &[f32], values: &mut Planes) {
    let Some((fine, coarser)) = grids.split_first_mut() else {
        return;
    };
    let sweeps = |level: &mut Level, values: &mut Planes, count: usize| {
        for _ in 0..count {
            level.columns.sweep(1.0, source, values, &mut level.scratch);
        }
    };
    let Some((next, rest)) = coarse.split_first_mut() else {
        // One column: a sweep solves it.
        sweeps(fine, values, 1);
        return;
    };
    sweeps(fine, values, SWEEPS[0]);
    fine.restrict(&coarser[0].columns, source, values, &mut next.source);
    next.values.for_each_row(|_, row| row.fill(0.0));
    cycle(coarser, rest, &next.source, &mut next.values);
    fine.correct(&coarser[0].columns, &next.values, values);
    sweeps(fine, values, SWEEPS[1]);
}

/// Runs `work` on chunks of three arrays, by one thread or by all.
fn in_chunks<const ALONE: bool>(
    [a, b]: [(&mut [f32], usize); 2],
    c: (&mut [f32], usize),
    work: impl Fn(usize, &mut [f32], &mut [f32], &mut [f32]) + Sync,
) {
    if ALONE {
        a.0.chunks_exact_mut(a.1)
            .zip(b.0.chunks_exact_mut(b.1))
            .zip(c.0.chunks_exact_mut(c.1))
            .enumerate()
            .for_each(|(y, ((a, b), c))| work(y, a, b, c));
    } else {
        a.0.par_chunks_exact_mut(a.1)
            .zip(b.0.par_chunks_exact_mut(b.1))
            .zip(c.0.par_chunks_exact_mut(c.1))
            .enumerate()
            .for_each(|(y, ((a, b), c))| work(y, a, b, c));
    }
}

impl Level {
    /// Brings the residual to the coarse grid's right side.
    fn restrict(&mut self, to: &Columns, source: &[f32], values: &Planes, coarse_source: &mut [f32]) {
        let Self {
            columns,
            narrow,
            rows,
            residual,
            along_x,
            along_y,
            ..
        } = self;
        let nx = columns.extent[0];
        let (plane, narrow_plane) = (columns.plane(), to.plane());
        let coarse_nx = to.extent[0];
        let work = |y: usize, narrow: &mut [f32], rows: &mut [f32], residual: &mut [f32]| {
            columns.residual_row(values, &source[y * plane..(y + 1) * plane], y, residual);
            for (from, to) in residual.chunks_exact(nx).zip(narrow.chunks_exact_mut(coarse_nx)) {
                restrict_row(along_x.as_ref(), from, rows, to);
            }
        };
        let arrays = [(narrow.as_mut_slice(), narrow_plane), (rows.as_mut_slice(), nx)];
        let third = (residual.as_mut_slice(), plane);
        let alone = source.len() < ALONE_BELOW;
        if alone {
            in_chunks::<true>(arrays, third, work);
        } else {
            in_chunks::<false>(arrays, third, work);
        }
        let narrow: &[f32] = narrow;
        let scratch = &mut rows[..nx * to.extent[1]];
        let work = |(j, (out, scratch)): (usize, (&mut [f32], &mut [f32]))| {
            let same = [(j, 1.0)];
            let from: &[(usize, f32)] = along_y.as_ref().map_or(&same, |t| &t.to_coarse[j]);
            let sum = &mut scratch[..coarse_nx];
            for (z, out) in out.chunks_exact_mut(coarse_nx).enumerate() {
                sum.fill(0.0);
                for &(y, weight) in from {
                    let row = &narrow[y * narrow_plane + z * coarse_nx..][..coarse_nx];
                    for (s, r) in sum.iter_mut().zip(row) {
                        *s += weight * r;
                    }
                }
                split_row(sum, out);
            }
        };
        if alone {
            coarse_source
                .chunks_exact_mut(narrow_plane)
                .zip(scratch.chunks_exact_mut(nx))
                .enumerate()
                .for_each(work);
        } else {
            coarse_source
                .par_chunks_exact_mut(narrow_plane)
                .zip(scratch.par_chunks_exact_mut(nx))
                .enumerate()
                .for_each(work);
        }
    }

    /// Adds the coarse grid's correction.
    fn correct(&mut self, from: &Columns, coarse: &Planes, values: &mut Planes) {
        let coarse_nx = from.extent[0];
        let nx = self.columns.extent[0];
        let (along_x, along_y) = (self.along_x.as_ref(), self.along_y.as_ref());
        values.for_each_row(|y, row| {
            let [(a, weight_a), (b, weight_b)] = along_y.map_or([(y, 1.0), (y, 0.0)], |t| t.to_fine[y]);
            correct_row(
                along_x,
                coarse_nx,
                nx,
                [coarse.row(a), coarse.row(b)],
                [weight_a, weight_b],
                row,
            );
        });
    }
}

/// One row of residuals, in the order of `Planes`, to a row coarse in x, in the grid's order. `scratch` has the fine length.
#[inline(always)]
fn restrict_row(along_x: Option<&Transfer>, from: &[f32], scratch: &mut [f32], to: &mut [f32]) {
    match along_x {
        None => join_row(from, to),
        Some(_) if from.len().is_multiple_of(2) => {
            let m = to.len();
            let (even, odd) = (&from[..m], &from[m..2 * m]);
            to[0] = 0.5 * even[0] + 0.25 * (odd[m - 1] + odd[0]);
            for i in 1..m {
                to[i] = 0.5 * even[i] + 0.25 * (odd[i - 1] + odd[i]);
            }
        }
        Some(transfer) => {
            join_row(from, scratch);
            for (to, from) in to.iter_mut().zip(&transfer.to_coarse) {
                *to = from.iter().map(|&(i, weight)| weight * scratch[i]).sum();
            }
        }
    }
}

/// Adds to one row of columns what two rows of the coarse grid say.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn correct_row(
    along_x: Option<&Transfer>,
    coarse_nx: usize,
    nx: usize,
    coarse: [&[f32]; 2],
    weights: [f32; 2],
    row: &mut [f32],
) {
    let [wa, wb] = weights;
    for (z, out) in row.chunks_exact_mut(nx).enumerate() {
        let (from, to) = (z * coarse_nx, (z + 1) * coarse_nx);
        let (a, b) = (&coarse[0][from..to], &coarse[1][from..to]);
        // A coarse row lies in the order of `Planes`, too.
        let at = |j: usize| {
            let m = coarse_nx / 2;
            let i = if j == 2 * m {
                j
            } else if j.is_multiple_of(2) {
                j / 2
            } else {
                m + j / 2
            };
            wa * a[i] + wb * b[i]
        };
        match along_x {
            None => {
                for ((o, a), b) in out.iter_mut().zip(a).zip(b) {
                    *o += wa * a + wb * b;
                }
            }
            Some(_) if nx.is_multiple_of(2) => {
                // Coarse places 2k and 2k + 1 lie in halves of their own, as do the fine places on and between them.
                let (even, odd) = out.split_at_mut(coarse_nx);
                let m = coarse_nx / 2;
                let ((ae, ao), (be, bo)) = (a.split_at(m), b.split_at(m));
                let inner = m.saturating_sub(1);
                let (next_a, next_b) = (&ae[m - inner..], &be[m - inner..]);
                for k in 0..inner {
                    let (c0, c1) = (wa * ae[k] + wb * be[k], wa * ao[k] + wb * bo[k]);
                    let c2 = wa * next_a[k] + wb * next_b[k];
                    even[2 * k] += c0;
                    even[2 * k + 1] += c1;
                    odd[2 * k] += 0.5 * (c0 + c1);
                    odd[2 * k + 1] += 0.5 * (c1 + c2);
                }
                for j in 2 * inner..coarse_nx {
                    let (here, next) = (at(j), at((j + 1) % coarse_nx));
                    even[j] += here;
                    odd[j] += 0.5 * (here + next);
                }
            }
            Some(transfer) => {
                let m = nx / 2;
                for (i, pair) in transfer.to_fine.iter().enumerate() {
                    let add = pair[0].1 * at(pair[0].0) + pair[1].1 * at(pair[1].0);
                    let place = if i == 2 * m {
                        i
                    } else if i % 2 == 0 {
                        i / 2
                    } else {
                        m + i / 2
                    };
                    out[place] += add;
                }
            }
        }
    }
}
