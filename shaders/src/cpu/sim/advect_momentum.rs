//! Stage `advect_momentum`: carries the three velocities through one Runge-Kutta stage and adds buoyancy to w.
//!
//! Reads the velocities, their values at the substep's start, their held tendencies and the buoyancy at centres; writes the
//! velocities' next values, not yet free of divergence. Scheme: see `advect`, with linear fifth-order upwind faces; the carrying mass
//! flux is averaged to the control volume of each velocity, so that it is as free of divergence there as at the cells.
//! Buoyancy is averaged to the faces. Keeps the mass-weighted sums of u and v. Errors: none; NaN in, NaN out.

use rayon::prelude::*;

use super::advect::{Carried, Carrier, FaceScheme, Scratch, carry_slab};
use super::parameters::Parameters;
use super::slab::{PIECE, Piece, SLAB_LEVELS, back, row, slab_len};

/// Which velocity is carried.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Component {
    X,
    Y,
    Z,
}

struct VelocityCarrier<'a> {
    parameters: &'a Parameters,
    velocity: [&'a [f32]; 3],
    component: Component,
}

/// `out[i] = scale (a[i - 1] + a[i])` with a periodic row.
#[inline(always)]
fn mean_with_west(a: &[f32], scale: f32, out: &mut [f32]) {
    let mut piece = Piece::new();
    for at in (0..a.len()).step_by(PIECE) {
        let n = PIECE.min(a.len() - at);
        piece.load(a, at, n);
        let (west, here, out) = (piece.from(0, n), piece.from(1, n), &mut out[at..at + n]);
        for i in 0..n {
            out[i] = scale * (west[i] + here[i]);
        }
    }
}

/// `out[i] = scale_a a[i] + scale_b b[i]`.
#[inline(always)]
fn mean_of(a: &[f32], scale_a: f32, b: &[f32], scale_b: f32, out: &mut [f32]) {
    let n = out.len();
    let (a, b) = (&a[..n], &b[..n]);
    for i in 0..n {
        out[i] = scale_a * a[i] + scale_b * b[i];
    }
}

impl VelocityCarrier<'_> {
    /// A horizontal velocity, mass-weighted between levels `z - 1` and `z`, over the density at the face between.
    #[inline(always)]
    fn at_z_face(&self, velocity: &[f32], y: usize, z: usize, out: &mut [f32]) {
        let p = self.parameters;
        let half = 0.5 / p.density_at_z_face_kg_m3[z];
        mean_of(
            row(&p.grid, velocity, y, z - 1),
            half * p.density_kg_m3[z - 1],
            row(&p.grid, velocity, y, z),
            half * p.density_kg_m3[z],
            out,
        );
    }
}

impl Carrier for VelocityCarrier<'_> {
    #[inline(always)]
    fn west(&self, y: usize, z: usize, out: &mut [f32]) {
        let grid = &self.parameters.grid;
        let u = self.velocity[0];
        match self.component {
            Component::X => mean_with_west(row(grid, u, y, z), 0.5, out),
            Component::Y => mean_of(
                row(grid, u, back(y, 1, grid.cells[1]), z),
                0.5,
                row(grid, u, y, z),
                0.5,
                out,
            ),
            Component::Z => self.at_z_face(u, y, z, out),
        }
    }
    #[inline(always)]
    fn south(&self, y: usize, z: usize, out: &mut [f32]) {
        let grid = &self.parameters.grid;
        let v = self.velocity[1];
        match self.component {
            Component::X => mean_with_west(row(grid, v, y, z), 0.5, out),
            Component::Y => mean_of(
                row(grid, v, back(y, 1, grid.cells[1]), z),
                0.5,
                row(grid, v, y, z),
                0.5,
                out,
            ),
            Component::Z => self.at_z_face(v, y, z, out),
        }
    }
    #[inline(always)]
    fn below(&self, y: usize, z: usize, out: &mut [f32]) {
        let grid = &self.parameters.grid;
        let density = &self.parameters.density_at_z_face_kg_m3;
        let w = self.velocity[2];
        match self.component {
            Component::X => mean_with_west(row(grid, w, y, z), 0.5 * density[z], out),
            Component::Y => mean_of(
                row(grid, w, back(y, 1, grid.cells[1]), z),
                0.5 * density[z],
                row(grid, w, y, z),
                0.5 * density[z],
                out,
            ),
            Component::Z => {
                let below = row(grid, w, y, z - 1);
                if z == grid.cells[2] {
                    mean_of(below, 0.5 * density[z - 1], below, 0.0, out);
                } else {
                    mean_of(below, 0.5 * density[z - 1], row(grid, w, y, z), 0.5 * density[z], out);
                }
            }
        }
    }
    #[inline(always)]
    fn volume_per_mass(&self, z: usize) -> f32 {
        match self.component {
            Component::Z => 1.0 / self.parameters.density_at_z_face_kg_m3[z],
            _ => 1.0 / self.parameters.density_kg_m3[z],
        }
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
    carried: &[Carried; 3],
    buoyancy: &[f32],
    dt_s: f32,
    first: usize,
    out: [&mut [f32]; 3],
    scratch: &mut Scratch,
) {
    let grid = &parameters.grid;
    let [out_x, out_y, out_z] = out;
    let x = VelocityCarrier {
        parameters,
        velocity,
        component: Component::X,
    };
    carry_slab(FaceScheme::Upwind5, grid, &x, &carried[0], dt_s, first, out_x, scratch);
    let y = VelocityCarrier {
        parameters,
        velocity,
        component: Component::Y,
    };
    carry_slab(FaceScheme::Upwind5, grid, &y, &carried[1], dt_s, first, out_y, scratch);
    let z = VelocityCarrier {
        parameters,
        velocity,
        component: Component::Z,
    };
    carry_slab(FaceScheme::Upwind5, grid, &z, &carried[2], dt_s, first, out_z, scratch);
    if buoyancy.is_empty() {
        return;
    }
    let plane = grid.plane();
    for level in first.max(1)..(first + SLAB_LEVELS).min(grid.cells[2]) {
        let below = &buoyancy[(level - 1) * plane..level * plane];
        let above = &buoyancy[level * plane..(level + 1) * plane];
        let out = &mut out_z[(level - first) * plane..(level - first + 1) * plane];
        for i in 0..plane {
            out[i] += dt_s * 0.5 * (below[i] + above[i]);
        }
    }
}

/// Carries the velocities; see the module. `buoyancy` and the `slow` tendencies may be empty.
pub fn run(
    parameters: &Parameters,
    velocity: [&[f32]; 3],
    start: [&[f32]; 3],
    slow: [&[f32]; 3],
    buoyancy: &[f32],
    dt_s: f32,
    out: [&mut [f32]; 3],
    scratch: &mut [Scratch],
) {
    let carried = [0, 1, 2].map(|c| Carried {
        state: velocity[c],
        start: start[c],
        slow: slow[c],
        first_level: usize::from(c == 2),
        zero_at_lid: c == 2,
    });
    let len = slab_len(&parameters.grid);
    let [x, y, z] = out;
    x.par_chunks_mut(len)
        .zip(y.par_chunks_mut(len))
        .zip(z.par_chunks_mut(len))
        .zip(scratch.par_iter_mut())
        .enumerate()
        .for_each(|(s, (((x, y), z), scratch))| {
            slab(
                parameters,
                velocity,
                &carried,
                buoyancy,
                dt_s,
                s * SLAB_LEVELS,
                [x, y, z],
                scratch,
            );
        });
}
