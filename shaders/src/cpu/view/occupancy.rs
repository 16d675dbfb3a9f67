//! Stage `occupancy`: how far one may go from a cell without meeting cloud.
//!
//! Reads: which of the slab's cells hold cloud, themselves or a neighbour. Writes: one byte a cell, the distance in units of 8 m
//! that is free of cloud in every direction from everywhere in the cell: 0 in cloud, at least 1 elsewhere, at most 2040 m. Rays
//! leap by it. Scheme: exact Euclidean distance between boxes, direction by direction (nearest in x, then the least over y and z of
//! the sum of squares), cut off at 2 km; rounded down.

use rayon::prelude::*;

use super::lanes::{Indices, Lanes};

crate::constants! {
    /// Metres a unit.
    const OCCUPANCY_UNIT_M: f32 = 8.0;
}

/// See the module.
#[derive(Clone, Debug)]
pub struct Occupancy {
    cells: [usize; 3],
    /// Free distances, four a word.
    words: Vec<u32>,
}

impl Occupancy {
    /// Cells where `field` is positive are occupied; periodic in x and y.
    pub fn new(field: &[f32], cells: [usize; 3], size_m: [f32; 3]) -> Occupancy {
        let [nx, ny, nz] = cells;
        let plane = nx * ny;
        let far = OCCUPANCY_UNIT_M * 255.0;
        let far_squared = far * far;
        let gap = |cells_apart: usize, size: f32| (cells_apart.saturating_sub(1) as f32 * size).powi(2);
        let mut a = vec![far_squared; field.len()];
        a.par_chunks_mut(nx).zip(field.par_chunks(nx)).for_each(|(to, from)| {
            // Twice round either way finds the nearest across the seam.
            for forward in [true, false] {
                let mut apart = usize::MAX;
                for n in 0..2 * nx {
                    let x = if forward { n % nx } else { nx - 1 - n % nx };
                    apart = if from[x] > 0.0 { 0 } else { apart.saturating_add(1) };
                    if apart < 4096 {
                        to[x] = to[x].min(gap(apart, size_m[0]) + if apart > 0 { 1.0 } else { 0.0 });
                    }
                }
            }
        });
        let mut b = a.clone();
        let reach_y = ((far / size_m[1]) as usize + 1).min(ny / 2);
        b.par_chunks_mut(plane).zip(a.par_chunks(plane)).for_each(|(to, from)| {
            for y in 0..ny {
                for n in 1..=reach_y {
                    let add = gap(n, size_m[1]) + 1.0;
                    for row in [(y + n) % ny, (y + ny - n) % ny] {
                        for x in 0..nx {
                            to[y * nx + x] = to[y * nx + x].min(from[row * nx + x] + add);
                        }
                    }
                }
            }
        });
        let reach_z = ((far / size_m[2]) as usize + 1).min(nz);
        let mut distance = vec![0u8; field.len()];
        distance.par_chunks_mut(plane).enumerate().for_each(|(k, to)| {
            let mut least = b[k * plane..][..plane].to_vec();
            for other in k.saturating_sub(reach_z)..(k + reach_z + 1).min(nz) {
                if other != k {
                    let add = gap(other.abs_diff(k), size_m[2]) + 1.0;
                    for (l, v) in least.iter_mut().zip(&b[other * plane..][..plane]) {
                        *l = l.min(v + add);
                    }
                }
            }
            for (t, l) in to.iter_mut().zip(&least) {
                *t = if *l == 0.0 {
                    0
                } else {
                    (l.sqrt() / OCCUPANCY_UNIT_M).clamp(1.0, 255.0) as u8
                };
            }
        });
        let words = distance
            .chunks(4)
            .map(|four| four.iter().rev().fold(0, |word, &byte| word << 8 | u32::from(byte)))
            .collect();
        Occupancy { cells, words }
    }
    /// Free distances in units of 8 m, a byte a cell.
    pub fn distances(&self) -> Vec<u8> {
        let bytes = self.words.iter().flat_map(|word| word.to_le_bytes());
        bytes.take(self.cells.iter().product()).collect()
    }
    /// Free distance in m at 16 places given as shares of the box, 0 to 1; heights are bounded to the slab.
    #[inline(always)]
    pub(crate) fn look(&self, x: Lanes, y: Lanes, z: Lanes) -> Lanes {
        let (i, j, k) = (cell(x, self.cells[0]), cell(y, self.cells[1]), cell(z, self.cells[2]));
        let mut index = i;
        for l in 0..index.0.len() {
            index.0[l] = (k.0[l] * self.cells[1] as u32 + j.0[l]) * self.cells[0] as u32 + i.0[l];
        }
        index.gather_bytes(&self.words) * OCCUPANCY_UNIT_M
    }
}

/// Number of the cell of `n` that holds a place from 0 to 1.
#[inline(always)]
fn cell(place: Lanes, n: usize) -> Indices {
    (place * n as f32).clamp(0.0, n as f32 - 0.01).split().0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against the plain definition, over all pairs of cells, on a small periodic box.
    #[test]
    fn distances_never_overshoot_and_are_close() {
        let cells = [12usize, 10, 6];
        let size = [100.0f32, 80.0, 40.0];
        let mut field = vec![0.0; 720];
        for at in [5usize, 333, 640] {
            field[at] = 1.0;
        }
        let occupancy = Occupancy::new(&field, cells, size);
        for n in 0..720 {
            let mut least = f32::MAX;
            for (m, v) in field.iter().enumerate() {
                if *v > 0.0 {
                    let part = |q: usize| [q % 12, q / 12 % 10, q / 120];
                    let (a, b) = (part(n), part(m));
                    let mut sum = 0.0;
                    for axis in 0..3 {
                        let mut apart = a[axis].abs_diff(b[axis]);
                        if axis < 2 {
                            apart = apart.min(cells[axis] - apart);
                        }
                        sum += (apart.saturating_sub(1) as f32 * size[axis]).powi(2);
                    }
                    least = least.min(sum.sqrt());
                }
            }
            let got = occupancy.distances()[n] as f32 * OCCUPANCY_UNIT_M;
            if field[n] > 0.0 {
                assert_eq!(got, 0.0);
            } else {
                assert!(
                    got >= OCCUPANCY_UNIT_M
                        && got <= least.max(OCCUPANCY_UNIT_M) + 0.1
                        && got > least - OCCUPANCY_UNIT_M - 1.0,
                    "{got} {least}"
                );
            }
        }
    }
}
