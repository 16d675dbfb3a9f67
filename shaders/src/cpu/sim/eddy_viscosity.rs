//! Stage `eddy_viscosity`: Smagorinsky-Lilly viscosity from strain and stability.
//!
//! Reads the velocities (m/s) and, if planned, `Buoyancy` (m/s2); writes `EddyViscosity` (m2/s) at centres:
//! `nu = (C_s D)^2 |S| sqrt(max(0, 1 - N^2 / (Pr |S|^2)))`, `|S|^2 = 2 S_ij S_ij`, D the cube root of the cell's volume, reduced near the ground
//! by `1 / D'^2 = 1 / (C_s D)^2 + 1 / (k z)^2` (Mason 1989). Shears live at cell edges and are squared there before they are
//! averaged to the centre, so that a checkerboard counts as strain. N^2 comes from the virtual potential temperature that
//! buoyancy carries plus the reference state's own. Second order. Source: Lilly (1962), Smagorinsky (1963). Errors: none. Bytes a cell: 20.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::slab::{PIECE, Piece, SLAB_LEVELS, ahead, back, row, slab_len};
use crate::constants::{GRAVITY_M_S2, VON_KARMAN};
use crate::grid::Grid;

/// Square of the mixing length at level `z`, with the wall's damping, m2.
#[inline]
pub fn length_squared_m2(grid: &Grid, coefficient: f32, z: usize) -> f32 {
    let [dx, dy, dz] = grid.cell_size_m;
    let plain = coefficient * (dx * dy * dz).cbrt();
    let wall = VON_KARMAN as f32 * grid.centre_height_m(z) as f32;
    1.0 / (1.0 / (plain * plain) + 1.0 / (wall * wall))
}

/// Adds the squares of the shears at two edges of each cell's west side, 1/s2: of the velocity `q` between `back` and `here` and between
/// `here` and `ahead`, and of `w` across it, at the first edge and the second.
#[inline(always)]
fn add_squares(q: [&[f32]; 3], first: [&[f32]; 2], second: [&[f32]; 2], r_q: f32, r_w: f32, out: &mut [f32]) {
    let n = out.len();
    let ([back, here, ahead], [first_west, first], [second_west, second]) = (q, first, second);
    let (back, here, ahead) = (&back[..n], &here[..n], &ahead[..n]);
    let (first_west, first, second_west, second) = (&first_west[..n], &first[..n], &second_west[..n], &second[..n]);
    for i in 0..n {
        let a = (here[i] - back[i]) * r_q + (first[i] - first_west[i]) * r_w;
        let b = (ahead[i] - here[i]) * r_q + (second[i] - second_west[i]) * r_w;
        out[i] += a * a + b * b;
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn level(
    parameters: &Parameters,
    coefficient: f32,
    prandtl: f32,
    velocity: [&[f32]; 3],
    buoyancy: &[f32],
    z: usize,
    out: &mut [f32],
) {
    let grid = &parameters.grid;
    let [nx, ny, levels] = grid.cells;
    let [dx, dy, dz] = grid.cell_size_m;
    let (rx, ry, rz) = (1.0 / dx, 1.0 / dy, 1.0 / dz);
    let length_squared = length_squared_m2(grid, coefficient, z);
    let [u, v, w] = velocity;
    let (z_below, z_above) = (z.saturating_sub(1), (z + 1).min(levels - 1));
    // Across the ground and the lid the shear counts as 0: what the ground does is another stage's. w at the lid is 0.
    let theta_v = &parameters.virtual_potential_temperature_k;
    let per_two_dz = 1.0 / ((z_above - z_below).max(1) as f32 * dz);
    let stable = GRAVITY_M_S2 as f32 / theta_v[z] * (theta_v[z_above] - theta_v[z_below]) * per_two_dz;
    let per_prandtl = 1.0 / prandtl;
    let (mut u_south, mut u_here, mut u_north) = (Piece::new(), Piece::new(), Piece::new());
    let (mut u_below, mut u_above, mut v_here, mut v_north) = (Piece::new(), Piece::new(), Piece::new(), Piece::new());
    let (mut w_here, mut w_above) = (Piece::new(), Piece::new());
    let mut edges = [0.0; PIECE + 1];
    for y in 0..ny {
        let (s, n) = (back(y, 1, ny), ahead(y, 1, ny));
        for at in (0..nx).step_by(PIECE) {
            let cells = PIECE.min(nx - at);
            u_south.load(row(grid, u, s, z), at, cells);
            u_here.load(row(grid, u, y, z), at, cells);
            u_north.load(row(grid, u, n, z), at, cells);
            u_below.load(row(grid, u, y, z_below), at, cells);
            u_above.load(row(grid, u, y, z_above), at, cells);
            v_here.load(row(grid, v, y, z), at, cells);
            v_north.load(row(grid, v, n, z), at, cells);
            w_here.load(row(grid, w, y, z), at, cells);
            let (was, wan) = if z + 1 < levels {
                w_above.load(row(grid, w, y, z + 1), at, cells);
                (
                    &row(grid, w, s, z + 1)[at..at + cells],
                    &row(grid, w, n, z + 1)[at..at + cells],
                )
            } else {
                (&[0.0; PIECE][..cells], &[0.0; PIECE][..cells])
            };
            // Four edges each: xy at the corners of the level, xz at those of the west side; yz below.
            let more = cells + 1;
            let edges = &mut edges[..more];
            edges.fill(0.0);
            add_squares(
                [u_south.from(1, more), u_here.from(1, more), u_north.from(1, more)],
                [v_here.from(0, more), v_here.from(1, more)],
                [v_north.from(0, more), v_north.from(1, more)],
                ry,
                rx,
                edges,
            );
            add_squares(
                [u_below.from(1, more), u_here.from(1, more), u_above.from(1, more)],
                [w_here.from(0, more), w_here.from(1, more)],
                [w_above.from(0, more), w_above.from(1, more)],
                rz,
                rx,
                edges,
            );
            let (west, east) = (&edges[..cells], &edges[1..cells + 1]);
            let (u0, u_east) = (u_here.from(1, cells), u_here.from(2, cells));
            let (v0, vn) = (v_here.from(1, cells), v_north.from(1, cells));
            let vb = &row(grid, v, y, z_below)[at..at + cells];
            let va = &row(grid, v, y, z_above)[at..at + cells];
            let vnb = &row(grid, v, n, z_below)[at..at + cells];
            let vna = &row(grid, v, n, z_above)[at..at + cells];
            let (w0, w_up) = (w_here.from(1, cells), w_above.from(1, cells));
            let (ws, wn) = (&row(grid, w, s, z)[at..at + cells], &row(grid, w, n, z)[at..at + cells]);
            let out = &mut out[y * nx + at..y * nx + at + cells];
            for i in 0..cells {
                let xx = (u_east[i] - u0[i]) * rx;
                let yy = (vn[i] - v0[i]) * ry;
                let zz = (w_up[i] - w0[i]) * rz;
                let south_below = (v0[i] - vb[i]) * rz + (w0[i] - ws[i]) * ry;
                let south_above = (va[i] - v0[i]) * rz + (w_up[i] - was[i]) * ry;
                let north_below = (vn[i] - vnb[i]) * rz + (wn[i] - w0[i]) * ry;
                let north_above = (vna[i] - vn[i]) * rz + (wan[i] - w_up[i]) * ry;
                let south = south_below * south_below + south_above * south_above;
                let north = north_below * north_below + north_above * north_above;
                let strain_squared =
                    2.0 * (xx * xx + yy * yy + zz * zz) + 0.25 * ((west[i] + east[i]) + (south + north));
                out[i] = strain_squared;
            }
            if buoyancy.is_empty() {
                for nu in out.iter_mut() {
                    *nu = length_squared * nu.sqrt();
                }
            } else {
                let below = &row(grid, buoyancy, y, z_below)[at..at + cells];
                let above = &row(grid, buoyancy, y, z_above)[at..at + cells];
                for i in 0..cells {
                    let stability = stable + (above[i] - below[i]) * per_two_dz;
                    out[i] = length_squared * (out[i] - stability * per_prandtl).max(0.0).sqrt();
                }
            }
        }
    }
}

/// Runs the stage; nothing if the parameters have no turbulence.
pub fn run(parameters: &Parameters, velocity: [&[f32]; 3], buoyancy: &[f32], out: &mut [f32]) {
    let Some(turbulence) = &parameters.turbulence else {
        return;
    };
    let plane = parameters.grid.plane();
    out.par_chunks_mut(slab_len(&parameters.grid))
        .enumerate()
        .for_each(|(s, slab)| {
            for (l, out) in slab.chunks_exact_mut(plane).enumerate() {
                level(
                    parameters,
                    turbulence.coefficient,
                    turbulence.prandtl,
                    velocity,
                    buoyancy,
                    s * SLAB_LEVELS + l,
                    out,
                );
            }
        });
}
