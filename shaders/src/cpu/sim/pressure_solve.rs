//! Stage `pressure_solve`: the pressure that frees the mass flux of divergence, solved directly.
//!
//! Reads the velocities at their faces (m/s); writes `Pressure`, the perturbation pressure over the reference density (m2/s2),
//! at centres: `div(rho grad phi) = div(rho v) / dt`, periodic in x and y, no gradient through ground and lid. Discrete
//! second-order Laplacian, the exact one that `project` inverts: real FFT in x, complex FFT in y, one tridiagonal system in z a wave
//! number (Thomas, factors made once in f64). The mean mode is fixed by phi = 0 in the topmost level. After `project` the divergence is
//! at rounding level. Errors: none; cells of 1 in any horizontal direction are allowed.
//!
//! Transforms and elimination are in f64: in f32 their rounding is the one thing in a tick that tells left from right, and an unstable flow
//! makes much of it (a bubble's mirror images differed by 7e-4 of its warmth after 1000 s at 100 m, by 2e-2 at 50 m; now by nothing). It
//! costs an eighth of the stage's time.
//!
//! Work is laid out for the cache: planes of rows for the transform in x; then blocks of eight wave numbers in x, each block transformed in y,
//! solved in z and transformed back while it is in the core's own cache; then rows again. Bytes a cell: about 72 (three velocities and the
//! pressure, and the half spectrum written and read twice with the pivots).

use std::sync::Arc;

use rayon::prelude::*;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{FftPlanner, num_complex::Complex64};

use super::parameters::Parameters;
use super::slab::{ahead, row};

/// Wave numbers in x that are worked on together: eight complex numbers are one cache line.
const BLOCK: usize = 8;

/// Plans, factors and buffers of the solver; made once for a grid.
pub struct Solver {
    real_to_complex: Arc<dyn RealToComplex<f64>>,
    complex_to_real: Arc<dyn ComplexToReal<f64>>,
    forward_y: Arc<dyn rustfft::Fft<f64>>,
    inverse_y: Arc<dyn rustfft::Fft<f64>>,
    /// `[level][y][wave number in x]`.
    planes: Vec<Complex64>,
    /// `[block][level][wave number in block][y]`, the last block padded.
    blocks: Vec<Complex64>,
    /// One over the pivots, laid out as `blocks`, one value for both parts of a complex number.
    pivots: Vec<f64>,
    /// Couplings to the level below and above, 1/m2 times density.
    couple_below: Vec<f64>,
    couple_above: Vec<f64>,
    plane_scratch: Vec<PlaneScratch>,
    block_scratch: Vec<Vec<Complex64>>,
}

struct PlaneScratch {
    single: Vec<f32>,
    row: Vec<f64>,
    spectrum: Vec<Complex64>,
    fft: Vec<Complex64>,
}

impl Solver {
    /// Plans the solve for `parameters.grid`.
    pub fn new(parameters: &Parameters) -> Self {
        let grid = &parameters.grid;
        let [nx, ny, levels] = grid.cells;
        let half = nx / 2 + 1;
        let block_count = half.div_ceil(BLOCK);
        let mut real = RealFftPlanner::<f64>::new();
        let (real_to_complex, complex_to_real) = (real.plan_fft_forward(nx), real.plan_fft_inverse(nx));
        let mut complex = FftPlanner::<f64>::new();
        let (forward_y, inverse_y) = (complex.plan_fft_forward(ny), complex.plan_fft_inverse(ny));

        let mut pivots = vec![0.0f64; block_count * levels * BLOCK * ny];
        for_each_pivot(parameters, |m, j, z, pivot| {
            pivots[((m / BLOCK * levels + z) * BLOCK + m % BLOCK) * ny + j] = pivot;
        });
        let [below, above] = couplings(parameters);
        let fft_scratch = real_to_complex.get_scratch_len().max(complex_to_real.get_scratch_len());
        let y_scratch = forward_y
            .get_inplace_scratch_len()
            .max(inverse_y.get_inplace_scratch_len());
        Self {
            planes: vec![Complex64::default(); levels * ny * half],
            blocks: vec![Complex64::default(); block_count * levels * BLOCK * ny],
            pivots,
            couple_below: below,
            couple_above: above,
            plane_scratch: (0..levels)
                .map(|_| PlaneScratch {
                    single: vec![0.0; nx],
                    row: vec![0.0; nx],
                    spectrum: vec![Complex64::default(); ny * half],
                    fft: vec![Complex64::default(); fft_scratch],
                })
                .collect(),
            block_scratch: vec![vec![Complex64::default(); y_scratch]; block_count],
            real_to_complex,
            complex_to_real,
            forward_y,
            inverse_y,
        }
    }

    /// Bytes that the solver holds.
    pub fn bytes(&self) -> usize {
        16 * (self.planes.len() + self.blocks.len()) + 8 * self.pivots.len()
    }

    /// Solves for the pressure of a stage of length `dt_s`; `out` is overwritten whole.
    pub fn run(&mut self, parameters: &Parameters, velocity: [&[f32]; 3], dt_s: f32, out: &mut [f32]) {
        let grid = &parameters.grid;
        let [nx, ny, levels] = grid.cells;
        let half = nx / 2 + 1;
        let scale = 1.0 / (dt_s * (nx * ny) as f32);

        self.planes
            .par_chunks_mut(ny * half)
            .zip(self.plane_scratch.par_iter_mut())
            .enumerate()
            .for_each(|(z, (plane, scratch))| {
                for y in 0..ny {
                    source_row(parameters, velocity, scale, y, z, &mut scratch.single, &mut scratch.row);
                    // The only error is a wrong length, and the lengths are the plan's own.
                    let _ = self.real_to_complex.process_with_scratch(
                        &mut scratch.row,
                        &mut plane[y * half..(y + 1) * half],
                        &mut scratch.fft,
                    );
                }
            });

        let planes = &self.planes;
        let block_len = levels * BLOCK * ny;
        self.blocks
            .par_chunks_mut(block_len)
            .zip(self.pivots.par_chunks(block_len))
            .zip(self.block_scratch.par_iter_mut())
            .enumerate()
            .for_each(|(b, ((block, pivots), scratch))| {
                let first = b * BLOCK;
                let wide = BLOCK.min(half - first);
                for z in 0..levels {
                    let to = &mut block[z * BLOCK * ny..(z + 1) * BLOCK * ny];
                    for y in 0..ny {
                        let from = &planes[(z * ny + y) * half + first..][..wide];
                        for (m, value) in from.iter().enumerate() {
                            to[m * ny + y] = *value;
                        }
                    }
                    self.forward_y.process_with_scratch(&mut to[..wide * ny], scratch);
                }
                solve_block(&self.couple_below, &self.couple_above, pivots, block, BLOCK * ny);
                for z in 0..levels {
                    let to = &mut block[z * BLOCK * ny..][..wide * ny];
                    self.inverse_y.process_with_scratch(to, scratch);
                }
            });

        let blocks = &self.blocks;
        out.par_chunks_mut(grid.plane())
            .zip(self.plane_scratch.par_iter_mut())
            .enumerate()
            .for_each(|(z, (out, scratch))| {
                for m in 0..half {
                    let from = &blocks[((m / BLOCK * levels + z) * BLOCK + m % BLOCK) * ny..][..ny];
                    for (y, value) in from.iter().enumerate() {
                        scratch.spectrum[y * half + m] = *value;
                    }
                }
                for (spectrum, out) in scratch.spectrum.chunks_exact_mut(half).zip(out.chunks_exact_mut(nx)) {
                    // The row is real: what is imaginary in its mean and its shortest wave is rounding.
                    spectrum[0].im = 0.0;
                    if nx.is_multiple_of(2) {
                        spectrum[half - 1].im = 0.0;
                    }
                    let _ = self
                        .complex_to_real
                        .process_with_scratch(spectrum, &mut scratch.row, &mut scratch.fft);
                    for (out, row) in out.iter_mut().zip(&scratch.row) {
                        *out = *row as f32;
                    }
                }
            });
    }
}

/// Couplings of each level to the one below and the one above, kg/m5.
fn couplings(parameters: &Parameters) -> [Vec<f64>; 2] {
    let levels = parameters.grid.cells[2];
    let dz = parameters.grid.cell_size_m[2] as f64;
    let face = |z: usize| parameters.density_at_z_face_kg_m3[z] as f64 / (dz * dz);
    [
        (0..levels).map(|z| if z > 0 { face(z) } else { 0.0 }).collect(),
        (0..levels)
            .map(|z| if z + 1 < levels { face(z + 1) } else { 0.0 })
            .collect(),
    ]
}

/// One over the pivots of Thomas' algorithm, made in f64: calls `put` with the wave numbers in x (half of them) and y, the level and the value.
pub fn for_each_pivot(parameters: &Parameters, mut put: impl FnMut(usize, usize, usize, f64)) {
    let [nx, ny, levels] = parameters.grid.cells;
    let [dx, dy, _] = parameters.grid.cell_size_m.map(f64::from);
    let [below, above] = couplings(parameters);
    let wave =
        |m: usize, n: usize, d: f64| (2.0 - 2.0 * (2.0 * std::f64::consts::PI * m as f64 / n as f64).cos()) / (d * d);
    for m in 0..nx / 2 + 1 {
        for j in 0..ny {
            let horizontal = wave(m, nx, dx) + wave(j, ny, dy);
            let mut previous = 0.0;
            for z in 0..levels {
                let diagonal = -(below[z] + above[z]) - parameters.density_kg_m3[z] as f64 * horizontal;
                let pivot = if z == 0 {
                    diagonal
                } else {
                    diagonal - below[z] * above[z - 1] * previous
                };
                // The mean mode's last pivot is 0 but for rounding: its level is pinned to 0 instead.
                let pinned = m == 0 && j == 0 && z + 1 == levels;
                previous = if pinned { 0.0 } else { 1.0 / pivot };
                put(m, j, z, previous);
            }
        }
    }
}

/// `scale * div(rho v)` of one row, kg/m3/s times scale.
#[inline(always)]
pub(super) fn mass_divergence_row(
    parameters: &Parameters,
    velocity: [&[f32]; 3],
    scale: f32,
    y: usize,
    z: usize,
    out: &mut [f32],
) {
    let grid = &parameters.grid;
    let [_, ny, levels] = grid.cells;
    let [dx, dy, dz] = grid.cell_size_m;
    let density = parameters.density_kg_m3[z] * scale;
    let [u, v, w] = velocity;
    let n = out.len();
    let u = &row(grid, u, y, z)[..n];
    let (v_south, v_north) = (&row(grid, v, y, z)[..n], &row(grid, v, ahead(y, 1, ny), z)[..n]);
    let w_below = &row(grid, w, y, z)[..n];
    let z_above = (z + 1).min(levels - 1);
    let w_above = &row(grid, w, y, z_above)[..n];
    let below = parameters.density_at_z_face_kg_m3[z] * scale / dz;
    let above = if z + 1 < levels {
        parameters.density_at_z_face_kg_m3[z + 1] * scale / dz
    } else {
        0.0
    };
    let (to_x, to_y) = (density / dx, density / dy);
    for i in 0..n - 1 {
        out[i] = to_x * (u[i + 1] - u[i]);
    }
    out[n - 1] = to_x * (u[0] - u[n - 1]);
    for i in 0..n {
        out[i] += to_y * (v_north[i] - v_south[i]) + (above * w_above[i] - below * w_below[i]);
    }
}

/// A row's source in f64; `single` is scratch of a row.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn source_row(
    parameters: &Parameters,
    velocity: [&[f32]; 3],
    scale: f32,
    y: usize,
    z: usize,
    single: &mut [f32],
    out: &mut [f64],
) {
    mass_divergence_row(parameters, velocity, scale, y, z, single);
    for (out, single) in out.iter_mut().zip(single) {
        *out = f64::from(*single);
    }
}

/// Thomas' algorithm on all wave numbers of a block at once, `wide` complex numbers a level.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn solve_block(couple_below: &[f64], couple_above: &[f64], pivots: &[f64], block: &mut [Complex64], wide: usize) {
    let levels = couple_below.len();
    for z in 0..levels {
        let (done, rest) = block.split_at_mut(z * wide);
        let here = &mut rest[..wide];
        let pivot = &pivots[z * wide..(z + 1) * wide];
        if z == 0 {
            for i in 0..wide {
                here[i] *= pivot[i];
            }
        } else {
            let below = &done[(z - 1) * wide..];
            let couple = couple_below[z];
            for i in 0..wide {
                here[i] = (here[i] - below[i] * couple) * pivot[i];
            }
        }
    }
    for z in (0..levels - 1).rev() {
        let (lower, upper) = block.split_at_mut((z + 1) * wide);
        let here = &mut lower[z * wide..];
        let above = &upper[..wide];
        let pivot = &pivots[z * wide..(z + 1) * wide];
        let couple = couple_above[z];
        for i in 0..wide {
            here[i] -= above[i] * (couple * pivot[i]);
        }
    }
}
