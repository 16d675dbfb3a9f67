//! How work is cut: slabs of whole levels, and rows along x within them.

use crate::grid::Grid;

/// Levels in a slab. Fixed, so that the cut never depends on the number of threads.
pub const SLAB_LEVELS: usize = 8;

/// Values in a slab of `grid`.
pub fn slab_len(grid: &Grid) -> usize {
    grid.plane() * SLAB_LEVELS
}

/// Number of slabs.
pub fn slab_count(grid: &Grid) -> usize {
    grid.cells[2].div_ceil(SLAB_LEVELS)
}

/// Row `(y, z)` of a field.
#[inline(always)]
pub fn row<'a>(grid: &Grid, field: &'a [f32], y: usize, z: usize) -> &'a [f32] {
    let nx = grid.cells[0];
    let at = (z * grid.cells[1] + y) * nx;
    &field[at..at + nx]
}

/// `y - by` on the periodic axis of `n` cells.
#[inline(always)]
pub fn back(y: usize, by: usize, n: usize) -> usize {
    (y + n * by - by) % n
}

/// `y + by` on the periodic axis of `n` cells.
#[inline(always)]
pub fn ahead(y: usize, by: usize, n: usize) -> usize {
    (y + by) % n
}

/// Runs a body for each cell `i` of a row with its periodic neighbours `west` and `east`: `for_row!(nx, |i, west, east| { .. })`.
///
/// A macro and not a function with a closure: the body is written out at the row's two ends and in the plain inner loop, which
/// vectorises; a closure of that size is called once a cell instead (measured: three times slower).
macro_rules! for_row {
    ($nx:expr, |$i:ident, $west:ident, $east:ident| $body:block) => {{
        let nx: usize = $nx;
        {
            let ($i, $west, $east) = (0, nx - 1, 1 % nx);
            $body
        }
        for $i in 1..nx.max(1) - 1 {
            let ($west, $east) = ($i - 1, $i + 1);
            $body
        }
        if nx > 1 {
            let ($i, $west, $east) = (nx - 1, nx - 2, 0);
            $body
        }
    }};
}
pub(crate) use for_row;
