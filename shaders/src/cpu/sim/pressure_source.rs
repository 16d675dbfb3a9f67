//! What the iterative pressure rungs share: the right side of the pressure equation, and the part of the pressure that needs no iteration.
//!
//! Reads the velocities at their faces (m/s). The equation is `div(rho grad phi) = div(rho v) / dt`, periodic in x and y, no gradient through ground
//! and lid. Averaged over a level it says that the mean pressure gradient takes away the mean of w: `d phi_mean / dz = w_mean / dt`. That is a sum
//! over the levels, exact, and it is the hydrostatic part, which relaxation would find last. So the rungs iterate on what departs from
//! the level's mean alone, and the mean column is added to the result. Its constant is fixed as the direct solver fixes it: phi_mean = 0
//! in the topmost level. Errors: none. Bytes a cell: 4 for the means, 20 for the right side.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::pressure_solve::mass_divergence_row;

/// Means over levels, made once for a grid.
pub struct Source {
    /// Mean of w at each level's lower face, m/s.
    mean_w_m_s: Vec<f32>,
    /// The mean column of the pressure, m2/s2.
    mean_pressure: Vec<f32>,
}

impl Source {
    /// Room for `levels`.
    pub fn new(levels: usize) -> Self {
        Self {
            mean_w_m_s: vec![0.0; levels],
            mean_pressure: vec![0.0; levels],
        }
    }

    /// Measures the mean of w and makes the mean column of the pressure.
    pub fn measure(&mut self, parameters: &Parameters, w: &[f32], dt_s: f32) {
        let levels = parameters.grid.cells[2];
        self.mean_w_m_s
            .par_iter_mut()
            .zip(w.par_chunks(parameters.grid.plane()))
            .for_each(|(mean, w)| *mean = level_mean(w));
        self.mean_w_m_s[0] = 0.0;
        let per_dt = parameters.grid.cell_size_m[2] / dt_s;
        self.mean_pressure[levels - 1] = 0.0;
        for z in (0..levels - 1).rev() {
            self.mean_pressure[z] = self.mean_pressure[z + 1] - per_dt * self.mean_w_m_s[z + 1];
        }
    }

    /// The mean pressure of a level, m2/s2.
    pub fn mean_pressure(&self, z: usize) -> f32 {
        self.mean_pressure[z]
    }

    /// `div(rho v) / dt` of one row less its level's mean, kg/m3/s2.
    #[inline(always)]
    pub(super) fn row(
        &self,
        parameters: &Parameters,
        velocity: [&[f32]; 3],
        per_dt: f32,
        y: usize,
        z: usize,
        out: &mut [f32],
    ) {
        mass_divergence_row(parameters, velocity, per_dt, y, z, out);
        let per_dz = per_dt / parameters.grid.cell_size_m[2];
        let flux = |face: usize| match self.mean_w_m_s.get(face) {
            Some(w) => parameters.density_at_z_face_kg_m3[face] * w,
            None => 0.0,
        };
        let mean = per_dz * (flux(z + 1) - flux(z));
        out.iter_mut().for_each(|o| *o -= mean);
    }
}

/// Takes off a level's mean. A level that is not finite becomes 0: a first guess must not keep what a spoilt substep left.
pub fn centre_level(level: &mut [f32]) {
    let mean = level_mean(level);
    if mean.is_finite() {
        level.iter_mut().for_each(|p| *p -= mean);
    } else {
        level.fill(0.0);
    }
}

/// Mean of a level's values, summed in eight fixed strands of 64 bits: the same bits whatever the machine's vectors.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
pub fn level_mean(values: &[f32]) -> f32 {
    let mut strands = [0.0f64; 8];
    let chunks = values.chunks_exact(8);
    let rest: f64 = chunks.remainder().iter().map(|&v| v as f64).sum();
    for chunk in chunks {
        for (s, &v) in strands.iter_mut().zip(chunk) {
            *s += v as f64;
        }
    }
    ((strands.iter().sum::<f64>() + rest) / values.len() as f64) as f32
}
