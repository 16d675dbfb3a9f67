//! A level of a pyramid over the shape's points, for slabs that are fitted to blocks of cloud: sums of some numbers over blocks, periodic in x and y.

use rayon::prelude::*;

use crate::cpu::view::shape::Shape;

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct SlabBlocks<const N: usize> {
    cells: [usize; 3],
    /// Points along each edge of a block.
    points: [usize; 3],
    spacing_m: [f32; 3],
    sums: Vec<[f32; N]>,
}

impl<const N: usize> SlabBlocks<N> {
    /// The finest level: one point a block, `[z][y][x]` without the padding of stored points.
    pub(super) fn new(shape: &Shape, fine: Vec<[f32; N]>) -> SlabBlocks<N> {
        SlabBlocks {
            cells: shape.points,
            points: [1; 3],
            spacing_m: shape.point_spacing_m,
            sums: fine,
        }
    }

    /// Axes along which blocks join next: the shortest edges, and those less than half as long again.
    fn joined(&self) -> [bool; 3] {
        let least = [0, 1, 2]
            .into_iter()
            .filter(|a| self.cells[*a] > 1)
            .map(|a| self.spacing_m[a])
            .fold(f32::INFINITY, f32::min);
        [0, 1, 2].map(|a| self.cells[a] > 1 && self.spacing_m[a] < 1.5 * least)
    }

    /// Whether blocks can join to edges of about `edge_m`.
    pub(super) fn can_grow(&self, edge_m: f32) -> bool {
        let joined = self.joined();
        joined.contains(&true) && (0..3).all(|a| !joined[a] || 2.0 * self.spacing_m[a] < 1.5 * edge_m)
    }

    /// The next level. Where an extent is odd its last block is half a block: what is between it and the first lies a little off.
    pub(super) fn coarser(&self) -> SlabBlocks<N> {
        let joined = self.joined();
        let factor = joined.map(|j| if j { 2 } else { 1 });
        let cells: [usize; 3] = std::array::from_fn(|a| self.cells[a].div_ceil(factor[a]));
        let mut sums = vec![[0.0f32; N]; cells[0] * cells[1] * cells[2]];
        let levels = sums.par_chunks_mut(cells[0] * cells[1]).enumerate();
        levels.for_each(|(k, level)| {
            for (n, to) in level.iter_mut().enumerate() {
                let first = [n % cells[0] * factor[0], n / cells[0] * factor[1], k * factor[2]];
                let end: [usize; 3] = std::array::from_fn(|a| (first[a] + factor[a]).min(self.cells[a]));
                for z in first[2]..end[2] {
                    for y in first[1]..end[1] {
                        for x in first[0]..end[0] {
                            let from = &self.sums[(z * self.cells[1] + y) * self.cells[0] + x];
                            for v in 0..N {
                                to[v] += from[v];
                            }
                        }
                    }
                }
            }
        });
        SlabBlocks {
            cells,
            points: std::array::from_fn(|a| self.points[a] * factor[a]),
            spacing_m: std::array::from_fn(|a| self.spacing_m[a] * factor[a] as f32),
            sums,
        }
    }

    /// The sums at a place in points, 0 the middle of the first; linear between the blocks around.
    #[inline(always)]
    pub(super) fn look(&self, place: [f32; 3]) -> [f32; N] {
        let mut low = [0usize; 3];
        let mut high = [0usize; 3];
        let mut share = [0.0f32; 3];
        for a in 0..3 {
            let at = (place[a] + 0.5) / self.points[a] as f32 - 0.5;
            let below = at.floor();
            share[a] = at - below;
            let count = self.cells[a] as i64;
            let below = below as i64;
            [low[a], high[a]] = if a < 2 {
                [below.rem_euclid(count) as usize, (below + 1).rem_euclid(count) as usize]
            } else {
                [
                    below.clamp(0, count - 1) as usize,
                    (below + 1).clamp(0, count - 1) as usize,
                ]
            };
        }
        let mut sum = [0.0f32; N];
        for corner in 0..8 {
            let mut weight = 1.0;
            let mut at = [0usize; 3];
            for a in 0..3 {
                let up = corner >> a & 1 == 1;
                at[a] = if up { high[a] } else { low[a] };
                weight *= if up { share[a] } else { 1.0 - share[a] };
            }
            let from = &self.sums[(at[2] * self.cells[1] + at[1]) * self.cells[0] + at[0]];
            for v in 0..N {
                sum[v] += weight * from[v];
            }
        }
        sum
    }
}
