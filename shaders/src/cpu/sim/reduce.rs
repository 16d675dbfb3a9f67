//! Stage `reduce`: a tick's few numbers over the whole state, one pass over the velocities.
//!
//! Partial results are kept a level and joined in level order: bit-identical for any number of threads.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::slab::{PIECE, Piece, ahead, row};
use crate::device::Reductions;

/// The larger of a maximum so far and a value that is not negative, both as bits: their order is that of the numbers, NaN and infinity
/// come out on top, and integers have a vector maximum that needs no leave to reorder.
#[inline(always)]
pub(super) fn larger(maximum: u32, value: f32) -> u32 {
    maximum.max(value.to_bits())
}

/// One level's part.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn level(parameters: &Parameters, velocity: [&[f32]; 3], viscosity: &[f32], z: usize) -> Reductions {
    let grid = &parameters.grid;
    let plane = grid.plane();
    let [dx, dy, dz] = grid.cell_size_m.map(|d| 1.0 / d);
    let [u, v, w] = velocity;
    let (from, to) = (z * plane, (z + 1) * plane);
    let (u, v, w) = (&u[from..to], &v[from..to], &w[from..to]);
    let (mut rate, mut wind, mut up, mut thick) = (0, 0, 0, 0);
    for i in 0..plane {
        let (a, b) = (u[i].abs(), v[i].abs());
        rate = larger(rate, a * dx + b * dy + w[i].abs() * dz);
        wind = larger(larger(wind, a), b);
        up = larger(up, if w[i] > 0.0 { w[i] } else { 0.0 });
    }
    if !viscosity.is_empty() {
        for &n in &viscosity[z * plane..(z + 1) * plane] {
            thick = larger(thick, n.abs());
        }
    }
    let [rate, wind, up, thick] = [rate, wind, up, thick].map(f32::from_bits);
    Reductions {
        courant_rate_per_s: rate,
        wind_max_m_s: wind,
        updraught_max_m_s: up,
        viscosity_max_m2_s: thick,
        finite: rate.is_finite() && thick.is_finite(),
    }
}

/// Reduces the velocities and the viscosity (which may be empty). `levels` is scratch, one a level.
pub fn run(parameters: &Parameters, velocity: [&[f32]; 3], viscosity: &[f32], levels: &mut [Reductions]) -> Reductions {
    levels
        .par_iter_mut()
        .enumerate()
        .for_each(|(z, l)| *l = level(parameters, velocity, viscosity, z));
    levels.iter().fold(
        Reductions {
            finite: true,
            ..Reductions::default()
        },
        |a, b| Reductions {
            courant_rate_per_s: a.courant_rate_per_s.max(b.courant_rate_per_s),
            wind_max_m_s: a.wind_max_m_s.max(b.wind_max_m_s),
            updraught_max_m_s: a.updraught_max_m_s.max(b.updraught_max_m_s),
            viscosity_max_m2_s: a.viscosity_max_m2_s.max(b.viscosity_max_m2_s),
            finite: a.finite && b.finite,
        },
    )
}

/// Largest `|div(rho v)| / rho` of a level as bits, 1/s.
#[inline(always)]
pub(super) fn divergence(parameters: &Parameters, velocity: [&[f32]; 3], z: usize) -> u32 {
    let grid = &parameters.grid;
    let [nx, ny, levels] = grid.cells;
    let [dx, dy, dz] = grid.cell_size_m.map(|d| 1.0 / d);
    let per_density = 1.0 / parameters.density_kg_m3[z];
    let below_density = parameters.density_at_z_face_kg_m3[z];
    let above_density = if z + 1 < levels {
        parameters.density_at_z_face_kg_m3[z + 1]
    } else {
        0.0
    };
    let z_above = (z + 1).min(levels - 1);
    let (mut worst, mut u_piece) = (0, Piece::new());
    for y in 0..ny {
        let v = &row(grid, velocity[1], y, z)[..nx];
        let v_north = &row(grid, velocity[1], ahead(y, 1, ny), z)[..nx];
        let (w, w_above) = (
            &row(grid, velocity[2], y, z)[..nx],
            &row(grid, velocity[2], y, z_above)[..nx],
        );
        for at in (0..nx).step_by(PIECE) {
            let cells = PIECE.min(nx - at);
            let end = at + cells;
            u_piece.load(row(grid, velocity[0], y, z), at, cells);
            let (u, u_east) = (u_piece.from(1, cells), u_piece.from(2, cells));
            let (v, v_north, w, w_above) = (&v[at..end], &v_north[at..end], &w[at..end], &w_above[at..end]);
            for i in 0..cells {
                let vertical = above_density * w_above[i] - below_density * w[i];
                let d = (u_east[i] - u[i]) * dx + (v_north[i] - v[i]) * dy + vertical * dz * per_density;
                worst = larger(worst, d.abs());
            }
        }
    }
    worst
}

/// Largest `|div(rho v)| / rho`, 1/s; NaN or infinite where a velocity is.
pub fn divergence_max_per_s(parameters: &Parameters, velocity: [&[f32]; 3]) -> f32 {
    let worst = (0..parameters.grid.cells[2])
        .into_par_iter()
        .map(|z| divergence(parameters, velocity, z))
        .max();
    f32::from_bits(worst.unwrap_or(0))
}
