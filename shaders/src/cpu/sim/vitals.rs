//! Stage `vitals`: what a tick's end is judged by.
//!
//! Reads the three velocities (m/s, faces), `Heat` (K), `Water` (kg/kg) and `Extinction` (1/m) at centres, each empty where it is not planned;
//! gives whether all is finite, the largest `|div(rho v)| / rho` (1/s) and the least water. Once a tick. Partial results are
//! kept a level and joined in level order: bit-identical for any number of threads. Errors: none. Bytes a cell: 24.

use rayon::prelude::*;

use super::parameters::Parameters;
use super::reduce::{divergence, larger};
use crate::device::Vitals;

/// One level's part.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn level(
    parameters: &Parameters,
    velocity: [&[f32]; 3],
    heat: &[f32],
    water: &[f32],
    extinction: &[f32],
    z: usize,
) -> Vitals {
    let grid = &parameters.grid;
    let plane = grid.plane();
    let of_level = |field: &[f32]| {
        if field.is_empty() {
            0..0
        } else {
            z * plane..(z + 1) * plane
        }
    };
    // As in `reduce`: bits of what is not negative are ordered as the numbers are, with infinity and NaN on top.
    let (mut largest, mut least) = (0, i32::MAX);
    for field in [heat, extinction] {
        for &value in &field[of_level(field)] {
            largest = larger(largest, value.abs());
        }
    }
    for &q in &water[of_level(water)] {
        largest = larger(largest, q.abs());
        least = least.min(ordered(q.to_bits() as i32));
    }
    let worst = if velocity[0].is_empty() {
        0
    } else {
        divergence(parameters, velocity, z)
    };
    let [largest, worst] = [largest, worst].map(f32::from_bits);
    Vitals {
        finite: largest.is_finite() && worst.is_finite(),
        divergence_max_per_s: worst,
        water_min_kg_per_kg: if water.is_empty() {
            0.0
        } else {
            f32::from_bits(ordered(least) as u32)
        },
    }
}

/// Bits of a number as an integer of the same order, and back again: it is its own inverse.
#[inline(always)]
fn ordered(bits: i32) -> i32 {
    bits ^ (((bits >> 31) as u32) >> 1) as i32
}

/// Judges the state. `levels` is scratch, one a level.
pub fn run(
    parameters: &Parameters,
    velocity: [&[f32]; 3],
    heat: &[f32],
    water: &[f32],
    extinction: &[f32],
    levels: &mut [Vitals],
) -> Vitals {
    levels
        .par_iter_mut()
        .enumerate()
        .for_each(|(z, l)| *l = level(parameters, velocity, heat, water, extinction, z));
    levels
        .iter()
        .copied()
        .reduce(|a, b| Vitals {
            finite: a.finite && b.finite,
            divergence_max_per_s: a.divergence_max_per_s.max(b.divergence_max_per_s),
            water_min_kg_per_kg: a.water_min_kg_per_kg.min(b.water_min_kg_per_kg),
        })
        .unwrap_or(Vitals {
            finite: true,
            ..Vitals::default()
        })
}
