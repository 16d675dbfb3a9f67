//! Stage `body_force`: pushes the air within a part of the box, as a fan does in a wind tunnel.
//!
//! Reads the velocities at their faces (m/s); adds to their held tendencies `a - r v` where the face lies within the region, a the acceleration (m/s2)
//! and r the drag (1/s): air that stays there is brought to `a / r`. As `(a - r v) / (1 + r dt)`, so that it never overshoots however long
//! the substep is. The region's edges are sharp, to the nearest face. Faces on the ground are left alone (w is 0 there). Keeps nothing: that is
//! its purpose. Source: the force of seed 004, equation 7.5, put in where its tunnel puts it, in chosen cells; the drag is
//! not in the seed, without it a force on periodic air has no end. Errors: none. Bytes a cell: 12 within the region.

use std::ops::Range;

use rayon::prelude::*;

use super::parameters::{BodyForce, Parameters};
use crate::grid::Grid;

/// The places along `axis` that lie within the force's region: centres, or faces, which lie half a cell before them. The ground's faces are
/// never among them.
pub fn range(grid: &Grid, force: &BodyForce, axis: usize, at_face: bool) -> Range<usize> {
    let offset = if at_face { 0.0 } else { 0.5 };
    let [first, end] = [force.lower_m[axis], force.upper_m[axis]]
        .map(|edge| ((edge / grid.cell_size_m[axis] - offset).ceil().max(0.0) as usize).min(grid.cells[axis]));
    let first = if axis == 2 && at_face { first.max(1) } else { first };
    first..end.max(first)
}

/// Pushes one velocity, `axis` 0 to 2; nothing if the parameters have no force.
pub fn run(parameters: &Parameters, axis: usize, velocity: &[f32], substep_s: f32, slow: &mut [f32]) {
    let Some(force) = &parameters.body_force else { return };
    let grid = &parameters.grid;
    let nx = grid.cells[0];
    let within = [0, 1, 2].map(|a| range(grid, force, a, a == axis));
    let share = 1.0 / (1.0 + force.drag_per_s * substep_s);
    let (push, drag) = (share * force.acceleration_m_s2[axis], share * force.drag_per_s);
    slow.par_chunks_mut(grid.plane())
        .zip(velocity.par_chunks(grid.plane()))
        .enumerate()
        .filter(|(z, _)| within[2].contains(z))
        .for_each(|(_, (slow, velocity))| {
            for y in within[1].clone() {
                let row = y * nx + within[0].start..y * nx + within[0].end;
                for (s, v) in slow[row.clone()].iter_mut().zip(&velocity[row]) {
                    *s += push - drag * v;
                }
            }
        });
}
