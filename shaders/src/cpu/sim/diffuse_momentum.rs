//! Stage `diffuse_momentum`: mixing of momentum by eddies smaller than a cell.
//!
//! Reads the velocities (m/s) at their faces and `EddyViscosity` (m2/s) at centres; adds `(1/rho) d_j(2 rho nu S_ij)` to the three held
//! tendencies (m/s2). Second order, flux form: keeps the mass-weighted sums of u and v to rounding. No stress through ground and lid (drag is
//! another stage's). Explicit: the substep must obey `nu dt (1/dx2 + 1/dy2 + 1/dz2) <= 1/4`. Errors: none. Bytes a cell: 40.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::slab::{SLAB_LEVELS, ahead, back, for_row, row, slab_len};

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn level(
    parameters: &Parameters,
    velocity: [&[f32]; 3],
    viscosity: &[f32],
    z: usize,
    slow_u: &mut [f32],
    slow_v: &mut [f32],
    slow_w: &mut [f32],
) {
    let grid = &parameters.grid;
    let [nx, ny, levels] = grid.cells;
    let [rx, ry, rz] = grid.cell_size_m.map(|d| 1.0 / d);
    let density = &parameters.density_kg_m3;
    let face_density = &parameters.density_at_z_face_kg_m3;
    let [u, v, w] = velocity;
    let (z_below, z_above) = (z.saturating_sub(1), (z + 1).min(levels - 1));
    let below = if z > 0 {
        0.25 * face_density[z] * rz / density[z]
    } else {
        0.0
    };
    let above = if z + 1 < levels {
        0.25 * face_density[z + 1] * rz / density[z]
    } else {
        0.0
    };
    let has_above = if z + 1 < levels { 1.0 } else { 0.0 };
    let w_above_scale = 2.0 * density[z] * rz * rz / face_density[z];
    let w_below_scale = 2.0 * density[z_below] * rz * rz / face_density[z];
    for y in 0..ny {
        let (s, n) = (back(y, 1, ny), ahead(y, 1, ny));
        let at = |f, y, z| -> &[f32] { &row(grid, f, y, z)[..nx] };
        let [u0, us, un] = [y, s, n].map(|y| at(u, y, z));
        let [v0, vs, vn] = [y, s, n].map(|y| at(v, y, z));
        let [w0, ws, wn] = [y, s, n].map(|y| at(w, y, z));
        let [ub, ua] = [z_below, z_above].map(|z| at(u, y, z));
        let [vb, va] = [z_below, z_above].map(|z| at(v, y, z));
        let vnb = at(v, n, z_below);
        let [wa, was] = [y, s].map(|y| at(w, y, z_above));
        let wb = at(w, y, z_below);
        let [k0, ks, kn] = [y, s, n].map(|y| at(viscosity, y, z));
        let [kb, ksb, knb] = [y, s, n].map(|y| at(viscosity, y, z_below));
        let [ka, ksa] = [y, s].map(|y| at(viscosity, y, z_above));
        let slow_u = &mut slow_u[y * nx..(y + 1) * nx];
        let slow_v = &mut slow_v[y * nx..(y + 1) * nx];
        let slow_w = &mut slow_w[y * nx..(y + 1) * nx];
        for_row!(nx, |i, west, east| {
            // u at the west face of cell i.
            let xx = 2.0 * rx * rx * (k0[i] * (u0[east] - u0[i]) - k0[west] * (u0[i] - u0[west]));
            let north = 0.25 * (k0[west] + k0[i] + kn[west] + kn[i]) * ((un[i] - u0[i]) * ry + (vn[i] - vn[west]) * rx);
            let south = 0.25 * (k0[west] + k0[i] + ks[west] + ks[i]) * ((u0[i] - us[i]) * ry + (v0[i] - v0[west]) * rx);
            let up = above * (k0[west] + k0[i] + ka[west] + ka[i]) * ((ua[i] - u0[i]) * rz + (wa[i] - wa[west]) * rx);
            let down = below * (k0[west] + k0[i] + kb[west] + kb[i]) * ((u0[i] - ub[i]) * rz + (w0[i] - w0[west]) * rx);
            slow_u[i] += xx + ry * (north - south) + (up - down);

            // v at the south face of cell i.
            let yy = 2.0 * ry * ry * (k0[i] * (vn[i] - v0[i]) - ks[i] * (v0[i] - vs[i]));
            let e =
                0.25 * (k0[i] + k0[east] + ks[i] + ks[east]) * ((v0[east] - v0[i]) * rx + (u0[east] - us[east]) * ry);
            let f = 0.25 * (k0[west] + k0[i] + ks[west] + ks[i]) * ((v0[i] - v0[west]) * rx + (u0[i] - us[i]) * ry);
            let up = above * (k0[i] + ks[i] + ka[i] + ksa[i]) * ((va[i] - v0[i]) * rz + (wa[i] - was[i]) * ry);
            let down = below * (k0[i] + ks[i] + kb[i] + ksb[i]) * ((v0[i] - vb[i]) * rz + (w0[i] - ws[i]) * ry);
            slow_v[i] += yy + rx * (e - f) + (up - down);
        });
        if z > 0 {
            for_row!(nx, |i, west, east| {
                // w at the lower face of cell i.
                let e = 0.25
                    * (k0[i] + k0[east] + kb[i] + kb[east])
                    * ((w0[east] - w0[i]) * rx + (u0[east] - ub[east]) * rz);
                let f = 0.25 * (k0[west] + k0[i] + kb[west] + kb[i]) * ((w0[i] - w0[west]) * rx + (u0[i] - ub[i]) * rz);
                let north = 0.25 * (k0[i] + kn[i] + kb[i] + knb[i]) * ((wn[i] - w0[i]) * ry + (vn[i] - vnb[i]) * rz);
                let south = 0.25 * (k0[i] + ks[i] + kb[i] + ksb[i]) * ((w0[i] - ws[i]) * ry + (v0[i] - vb[i]) * rz);
                let zz = w_above_scale * k0[i] * (has_above * wa[i] - w0[i]) - w_below_scale * kb[i] * (w0[i] - wb[i]);
                slow_w[i] += rx * (e - f) + ry * (north - south) + zz;
            });
        }
    }
}

/// Runs the stage; nothing if the parameters have no turbulence.
pub fn run(parameters: &Parameters, velocity: [&[f32]; 3], viscosity: &[f32], slow: [&mut [f32]; 3]) {
    if parameters.turbulence.is_none() {
        return;
    }
    let plane = parameters.grid.plane();
    let len = slab_len(&parameters.grid);
    let [u, v, w] = slow;
    u.par_chunks_mut(len)
        .zip(v.par_chunks_mut(len))
        .zip(w.par_chunks_mut(len))
        .enumerate()
        .for_each(|(s, ((u, v), w))| {
            for (l, ((u, v), w)) in u
                .chunks_exact_mut(plane)
                .zip(v.chunks_exact_mut(plane))
                .zip(w.chunks_exact_mut(plane))
                .enumerate()
            {
                level(parameters, velocity, viscosity, s * SLAB_LEVELS + l, u, v, w);
            }
        });
}
