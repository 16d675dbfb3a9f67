//! Stage `advect_scalar`: carries a scalar at cell centres through one Runge-Kutta stage.
//!
//! Reads the three velocities, the scalar, the scalar at the substep's start and its held tendency; writes the scalar's next
//! value. Scheme, order and what is kept: see `advect`, with WENO5 faces. Errors: none; NaN in, NaN out.

use rayon::prelude::*;

use super::advect::{Carried, Carrier, FaceScheme, Scratch, carry_slab};
use super::parameters::Parameters;
use super::slab::{SLAB_LEVELS, row, slab_len};
use crate::grid::Grid;

struct ScalarCarrier<'a> {
    grid: &'a Grid,
    parameters: &'a Parameters,
    velocity: [&'a [f32]; 3],
}

impl Carrier for ScalarCarrier<'_> {
    #[inline(always)]
    fn west(&self, y: usize, z: usize, out: &mut [f32]) {
        out.copy_from_slice(row(self.grid, self.velocity[0], y, z));
    }
    #[inline(always)]
    fn south(&self, y: usize, z: usize, out: &mut [f32]) {
        out.copy_from_slice(row(self.grid, self.velocity[1], y, z));
    }
    #[inline(always)]
    fn below(&self, y: usize, z: usize, out: &mut [f32]) {
        let density = self.parameters.density_at_z_face_kg_m3[z];
        for (o, w) in out.iter_mut().zip(row(self.grid, self.velocity[2], y, z)) {
            *o = density * w;
        }
    }
    #[inline(always)]
    fn volume_per_mass(&self, z: usize) -> f32 {
        1.0 / self.parameters.density_kg_m3[z]
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn slab(
    parameters: &Parameters,
    velocity: [&[f32]; 3],
    carried: &Carried,
    dt_s: f32,
    first: usize,
    out: &mut [f32],
    scratch: &mut Scratch,
) {
    let carrier = ScalarCarrier {
        grid: &parameters.grid,
        parameters,
        velocity,
    };
    carry_slab(
        FaceScheme::Weno5,
        &parameters.grid,
        &carrier,
        carried,
        dt_s,
        first,
        out,
        scratch,
    );
}

/// Carries `state`; see the module. `velocity` are u, v, w in m/s; `out` is overwritten whole.
pub fn run(
    parameters: &Parameters,
    velocity: [&[f32]; 3],
    state: &[f32],
    start: &[f32],
    slow: &[f32],
    dt_s: f32,
    out: &mut [f32],
    scratch: &mut [Scratch],
) {
    let carried = Carried {
        state,
        start,
        slow,
        first_level: 0,
        zero_at_lid: false,
    };
    out.par_chunks_mut(slab_len(&parameters.grid))
        .zip(scratch.par_iter_mut())
        .enumerate()
        .for_each(|(s, (out, scratch))| {
            slab(parameters, velocity, &carried, dt_s, s * SLAB_LEVELS, out, scratch);
        });
}
