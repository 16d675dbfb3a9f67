//! Stage `diffuse_scalar`: mixing of a scalar by eddies smaller than a cell.
//!
//! Reads a scalar and `EddyViscosity` (m2/s) at centres; adds `(1/rho) div(rho K grad q)` to the scalar's held tendency, K = nu / Pr averaged to
//! the faces. No flux through ground and lid (the ground's flux is another stage's). Second order, flux form: keeps the
//! mass-weighted sum to rounding; explicit: the substep must obey `K dt (1/dx2 + 1/dy2 + 1/dz2) <= 1/2`. Errors: none. Bytes a cell: 16.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::slab::{PIECE, Piece, SLAB_LEVELS, ahead, back, row, slab_len};

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn level(parameters: &Parameters, prandtl: f32, q: &[f32], viscosity: &[f32], z: usize, slow: &mut [f32]) {
    let grid = &parameters.grid;
    let [nx, ny, levels] = grid.cells;
    let [dx, dy, dz] = grid.cell_size_m;
    let half = 0.5 / prandtl;
    let (kx, ky) = (half / (dx * dx), half / (dy * dy));
    let kz = half / (dz * dz * parameters.density_kg_m3[z]);
    let density = &parameters.density_at_z_face_kg_m3;
    let below = if z > 0 { kz * density[z] } else { 0.0 };
    let above = if z + 1 < levels { kz * density[z + 1] } else { 0.0 };
    let (z_below, z_above) = (z.saturating_sub(1), (z + 1).min(levels - 1));
    let (mut q_piece, mut k_piece) = (Piece::new(), Piece::new());
    for y in 0..ny {
        let (s, n) = (back(y, 1, ny), ahead(y, 1, ny));
        for at in (0..nx).step_by(PIECE) {
            let cells = PIECE.min(nx - at);
            q_piece.load(row(grid, q, y, z), at, cells);
            k_piece.load(row(grid, viscosity, y, z), at, cells);
            let (qw, q0, qe) = (q_piece.from(0, cells), q_piece.from(1, cells), q_piece.from(2, cells));
            let (kw, k0, ke) = (k_piece.from(0, cells), k_piece.from(1, cells), k_piece.from(2, cells));
            let (qs, qn) = (&row(grid, q, s, z)[at..at + cells], &row(grid, q, n, z)[at..at + cells]);
            let (ks, kn) = (
                &row(grid, viscosity, s, z)[at..at + cells],
                &row(grid, viscosity, n, z)[at..at + cells],
            );
            let (qb, qa) = (
                &row(grid, q, y, z_below)[at..at + cells],
                &row(grid, q, y, z_above)[at..at + cells],
            );
            let kb = &row(grid, viscosity, y, z_below)[at..at + cells];
            let ka = &row(grid, viscosity, y, z_above)[at..at + cells];
            let slow = &mut slow[y * nx + at..y * nx + at + cells];
            for i in 0..cells {
                let x = (k0[i] + ke[i]) * (qe[i] - q0[i]) - (k0[i] + kw[i]) * (q0[i] - qw[i]);
                let y = (k0[i] + kn[i]) * (qn[i] - q0[i]) - (k0[i] + ks[i]) * (q0[i] - qs[i]);
                let z = above * (k0[i] + ka[i]) * (qa[i] - q0[i]) - below * (k0[i] + kb[i]) * (q0[i] - qb[i]);
                slow[i] += kx * x + ky * y + z;
            }
        }
    }
}

/// Runs the stage on one scalar; nothing if the parameters have no turbulence.
pub fn run(parameters: &Parameters, q: &[f32], viscosity: &[f32], slow: &mut [f32]) {
    let Some(turbulence) = &parameters.turbulence else {
        return;
    };
    let plane = parameters.grid.plane();
    slow.par_chunks_mut(slab_len(&parameters.grid))
        .enumerate()
        .for_each(|(s, slab)| {
            for (l, slow) in slab.chunks_exact_mut(plane).enumerate() {
                level(parameters, turbulence.prandtl, q, viscosity, s * SLAB_LEVELS + l, slow);
            }
        });
}
