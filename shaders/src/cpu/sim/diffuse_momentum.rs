//! Stage `diffuse_momentum`: mixing of momentum by eddies smaller than a cell.
//!
//! Reads the velocities (m/s) at their faces and `EddyViscosity` (m2/s) at centres; adds `(1/rho) d_j(2 rho nu S_ij)` to the three held
//! tendencies (m/s2). Second order, flux form: keeps the mass-weighted sums of u and v to rounding. No stress through ground and lid (drag is
//! another stage's). Explicit: the substep must obey `nu dt (1/dx2 + 1/dy2 + 1/dz2) <= 1/4`. Errors: none. Bytes a cell: 40.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::slab::{PIECE, Piece, SLAB_LEVELS, ahead, back, row, slab_len};

/// Stress over density at edges, m2/s2: the mean of four viscosities times the two shears, of `q` across the edge from `q_back` and of
/// `p` along it from `p_back`.
#[inline(always)]
fn edge_stress(viscosity: [&[f32]; 4], q: [&[f32]; 2], p: [&[f32]; 2], r_q: f32, r_p: f32, out: &mut [f32]) {
    let n = out.len();
    let ([k0, k1, k2, k3], [q_back, q], [p_back, p]) = (viscosity, q, p);
    let (k0, k1, k2, k3) = (&k0[..n], &k1[..n], &k2[..n], &k3[..n]);
    let (q_back, q, p_back, p) = (&q_back[..n], &q[..n], &p_back[..n], &p[..n]);
    for i in 0..n {
        let shear = (q[i] - q_back[i]) * r_q + (p[i] - p_back[i]) * r_p;
        out[i] = 0.25 * ((k0[i] + k1[i]) + (k2[i] + k3[i])) * shear;
    }
}

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
    let [dx, dy, dz] = grid.cell_size_m;
    let (rx, ry, rz) = (1.0 / dx, 1.0 / dy, 1.0 / dz);
    let density = &parameters.density_kg_m3;
    let face_density = &parameters.density_at_z_face_kg_m3;
    let [u, v, w] = velocity;
    let (z_below, z_above) = (z.saturating_sub(1), (z + 1).min(levels - 1));
    let below = if z > 0 { face_density[z] * rz / density[z] } else { 0.0 };
    let (above, has_above) = if z + 1 < levels {
        (face_density[z + 1] * rz / density[z], 1.0)
    } else {
        (0.0, 0.0)
    };
    let w_above_scale = 2.0 * density[z] * rz * rz / face_density[z];
    let w_below_scale = 2.0 * density[z_below] * rz * rz / face_density[z];
    let (two_xx, two_yy) = (2.0 * rx * rx, 2.0 * ry * ry);
    // Where a stress is asked for one cell further east, pieces hold it; elsewhere rows do.
    let (mut u_south, mut u_here, mut u_north) = (Piece::new(), Piece::new(), Piece::new());
    let (mut v_here, mut v_north) = (Piece::new(), Piece::new());
    let (mut u_below, mut w_here) = (Piece::new(), Piece::new());
    let (mut u_above, mut w_above) = (Piece::new(), Piece::new());
    let (mut k_south, mut k_here, mut k_north) = (Piece::new(), Piece::new(), Piece::new());
    let (mut k_below, mut k_above) = (Piece::new(), Piece::new());
    let (mut corner_south, mut corner_north) = ([0.0; PIECE + 1], [0.0; PIECE]);
    let (mut side_below, mut side_above) = ([0.0; PIECE + 1], [0.0; PIECE]);
    let (mut south_below, mut south_above, mut north_below) = ([0.0; PIECE], [0.0; PIECE], [0.0; PIECE]);
    for y in 0..ny {
        let (s, n) = (back(y, 1, ny), ahead(y, 1, ny));
        for at in (0..nx).step_by(PIECE) {
            let cells = PIECE.min(nx - at);
            let (more, end) = (cells + 1, at + cells);
            u_south.load(row(grid, u, s, z), at, cells);
            u_here.load(row(grid, u, y, z), at, cells);
            u_north.load(row(grid, u, n, z), at, cells);
            u_below.load(row(grid, u, y, z_below), at, cells);
            u_above.load(row(grid, u, y, z_above), at, cells);
            v_here.load(row(grid, v, y, z), at, cells);
            v_north.load(row(grid, v, n, z), at, cells);
            w_here.load(row(grid, w, y, z), at, cells);
            w_above.load(row(grid, w, y, z_above), at, cells);
            k_south.load(row(grid, viscosity, s, z), at, cells);
            k_here.load(row(grid, viscosity, y, z), at, cells);
            k_north.load(row(grid, viscosity, n, z), at, cells);
            k_below.load(row(grid, viscosity, y, z_below), at, cells);
            k_above.load(row(grid, viscosity, y, z_above), at, cells);
            let (k0, k_west) = (k_here.from(1, more), k_here.from(0, more));
            // xy at the corners of the level, south and north.
            edge_stress(
                [k_west, k0, k_south.from(0, more), k_south.from(1, more)],
                [u_south.from(1, more), u_here.from(1, more)],
                [v_here.from(0, more), v_here.from(1, more)],
                ry,
                rx,
                &mut corner_south[..more],
            );
            edge_stress(
                [k_west, k0, k_north.from(0, more), k_north.from(1, more)],
                [u_here.from(1, more), u_north.from(1, more)],
                [v_north.from(0, more), v_north.from(1, more)],
                ry,
                rx,
                &mut corner_north[..cells],
            );
            // xz at the lower and upper edges of the west side.
            edge_stress(
                [k_west, k0, k_below.from(0, more), k_below.from(1, more)],
                [u_below.from(1, more), u_here.from(1, more)],
                [w_here.from(0, more), w_here.from(1, more)],
                rz,
                rx,
                &mut side_below[..more],
            );
            edge_stress(
                [k_west, k0, k_above.from(0, more), k_above.from(1, more)],
                [u_here.from(1, more), u_above.from(1, more)],
                [w_above.from(0, more), w_above.from(1, more)],
                rz,
                rx,
                &mut side_above[..cells],
            );
            // yz at the lower and upper edges of the south side, and at the lower one of the north side.
            let (v0, vn) = (v_here.from(1, cells), v_north.from(1, cells));
            let (w0, wa) = (w_here.from(1, cells), w_above.from(1, cells));
            let (ks, kn, kb) = (k_south.from(1, cells), k_north.from(1, cells), k_below.from(1, cells));
            let ksb = &row(grid, viscosity, s, z_below)[at..end];
            let ksa = &row(grid, viscosity, s, z_above)[at..end];
            let knb = &row(grid, viscosity, n, z_below)[at..end];
            let (ws, was) = (&row(grid, w, s, z)[at..end], &row(grid, w, s, z_above)[at..end]);
            let (vb, va) = (&row(grid, v, y, z_below)[at..end], &row(grid, v, y, z_above)[at..end]);
            let (wn, vnb) = (&row(grid, w, n, z)[at..end], &row(grid, v, n, z_below)[at..end]);
            let k0 = &k0[..cells];
            edge_stress([ks, k0, ksb, kb], [vb, v0], [ws, w0], rz, ry, &mut south_below[..cells]);
            let ka = k_above.from(1, cells);
            edge_stress(
                [ks, k0, ksa, ka],
                [v0, va],
                [was, wa],
                rz,
                ry,
                &mut south_above[..cells],
            );
            edge_stress(
                [kn, k0, knb, kb],
                [vnb, vn],
                [w0, wn],
                rz,
                ry,
                &mut north_below[..cells],
            );

            // u at the west face.
            let (u_west, u0, u_east) = (u_here.from(0, cells), u_here.from(1, cells), u_here.from(2, cells));
            let k_west = &k_west[..cells];
            let (south, north) = (&corner_south[..cells], &corner_north[..cells]);
            let (down, up) = (&side_below[..cells], &side_above[..cells]);
            let slow = &mut slow_u[y * nx + at..y * nx + end];
            for i in 0..cells {
                let xx = k0[i] * (u_east[i] - u0[i]) - k_west[i] * (u0[i] - u_west[i]);
                slow[i] += two_xx * xx + ry * (north[i] - south[i]) + (above * up[i] - below * down[i]);
            }
            // v at the south face.
            let vs = &row(grid, v, s, z)[at..end];
            let east = &corner_south[1..more];
            let (down, up) = (&south_below[..cells], &south_above[..cells]);
            let slow = &mut slow_v[y * nx + at..y * nx + end];
            for i in 0..cells {
                let yy = k0[i] * (vn[i] - v0[i]) - ks[i] * (v0[i] - vs[i]);
                slow[i] += two_yy * yy + rx * (east[i] - south[i]) + (above * up[i] - below * down[i]);
            }
            // w at the lower face.
            if z > 0 {
                let (west, east) = (&side_below[..cells], &side_below[1..more]);
                let (south, north) = (&south_below[..cells], &north_below[..cells]);
                let wb = &row(grid, w, y, z_below)[at..end];
                let slow = &mut slow_w[y * nx + at..y * nx + end];
                for i in 0..cells {
                    let zz =
                        w_above_scale * k0[i] * (has_above * wa[i] - w0[i]) - w_below_scale * kb[i] * (w0[i] - wb[i]);
                    slow[i] += rx * (east[i] - west[i]) + ry * (north[i] - south[i]) + zz;
                }
            }
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
