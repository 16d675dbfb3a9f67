//! Stage `eddy_viscosity`: Smagorinsky-Lilly viscosity from strain and stability.
//!
//! Reads the velocities (m/s) and, if planned, `Buoyancy` (m/s2); writes `EddyViscosity` (m2/s) at centres:
//! `nu = (C_s D)^2 |S| sqrt(max(0, 1 - N^2 / (Pr |S|^2)))`, `|S|^2 = 2 S_ij S_ij`, D the cube root of the cell's volume, reduced near the ground
//! by `1 / D'^2 = 1 / (C_s D)^2 + 1 / (k z)^2` (Mason 1989). Shears live at cell edges and are squared there before they are
//! averaged to the centre, so that a checkerboard counts as strain. N^2 comes from the virtual potential temperature that
//! buoyancy carries plus the reference state's own. Second order. Source: Lilly (1962), Smagorinsky (1963). Errors: none. Bytes a cell: 20.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::slab::{SLAB_LEVELS, ahead, back, for_row, row, slab_len};
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
    let [rx, ry, rz] = [1.0 / dx, 1.0 / dy, 1.0 / dz];
    let length_squared = length_squared_m2(grid, coefficient, z);
    let [u, v, w] = velocity;
    let (z_below, z_above) = (z.saturating_sub(1), (z + 1).min(levels - 1));
    let lid = if z + 1 < levels { 1.0 } else { 0.0 };
    // Across the ground and the lid the shear counts as 0: what the ground does is another stage's.
    let theta_v = &parameters.virtual_potential_temperature_k;
    let stable = GRAVITY_M_S2 as f32 / theta_v[z] * (theta_v[z_above] - theta_v[z_below])
        / ((z_above - z_below).max(1) as f32 * dz);
    let per_two_dz = 1.0 / ((z_above - z_below).max(1) as f32 * dz);
    let empty: &[f32] = &[];
    for y in 0..ny {
        let (s, n) = (back(y, 1, ny), ahead(y, 1, ny));
        let [u0, us, un] = [y, s, n].map(|y| &row(grid, u, y, z)[..nx]);
        let [v0, vn] = [y, n].map(|y| &row(grid, v, y, z)[..nx]);
        let [ub, ua] = [z_below, z_above].map(|z| &row(grid, u, y, z)[..nx]);
        let [vb, va] = [z_below, z_above].map(|z| &row(grid, v, y, z)[..nx]);
        let [vnb, vna] = [z_below, z_above].map(|z| &row(grid, v, n, z)[..nx]);
        let [w0, ws, wn] = [y, s, n].map(|y| &row(grid, w, y, z)[..nx]);
        let [wa, was, wan] = [y, s, n].map(|y| &row(grid, w, y, z_above)[..nx]);
        let (bb, ba) = if buoyancy.is_empty() {
            (empty, empty)
        } else {
            (row(grid, buoyancy, y, z_below), row(grid, buoyancy, y, z_above))
        };
        let out = &mut out[y * nx..(y + 1) * nx];
        for_row!(nx, |i, west, east| {
            let xx = (u0[east] - u0[i]) * rx;
            let yy = (vn[i] - v0[i]) * ry;
            let zz = (lid * wa[i] - w0[i]) * rz;
            // Four edges each: xy at the corners of the level, xz and yz at the edges of the side faces.
            let xy = |a: usize, b: usize| {
                let south = (u0[b] - us[b]) * ry + (v0[b] - v0[a]) * rx;
                let north = (un[b] - u0[b]) * ry + (vn[b] - vn[a]) * rx;
                south * south + north * north
            };
            let xz = |a: usize, b: usize| {
                let below = (u0[b] - ub[b]) * rz + (w0[b] - w0[a]) * rx;
                let above = (ua[b] - u0[b]) * rz + lid * (wa[b] - wa[a]) * rx;
                below * below + above * above
            };
            let yz_south = {
                let below = (v0[i] - vb[i]) * rz + (w0[i] - ws[i]) * ry;
                let above = (va[i] - v0[i]) * rz + lid * (wa[i] - was[i]) * ry;
                below * below + above * above
            };
            let yz_north = {
                let below = (vn[i] - vnb[i]) * rz + (wn[i] - w0[i]) * ry;
                let above = (vna[i] - vn[i]) * rz + lid * (wan[i] - wa[i]) * ry;
                below * below + above * above
            };
            let strain_squared = 2.0 * (xx * xx + yy * yy + zz * zz)
                + 0.25 * (xy(west, i) + xy(i, east) + xz(west, i) + xz(i, east) + yz_south + yz_north);
            let stability = if ba.is_empty() {
                0.0
            } else {
                stable + (ba[i] - bb[i]) * per_two_dz
            };
            out[i] = length_squared * (strain_squared - stability / prandtl).max(0.0).sqrt();
        });
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
