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

/// Cells of a row that a kernel with neighbours in x takes at a time: whole vectors of any width, and little enough for the stack.
pub const PIECE: usize = 64;

/// A piece of a row with the cell before it and the one behind it, periodic.
///
/// Loops over the three slices of a piece have no ends to treat apart and no remainder; reading the neighbours from the row itself
/// leaves a vector's width of cells to scalar code at each end.
/// For the same reason kernels take rows apart without closures (`map` over an array of slices is a call that hides their lengths, and
/// with it goes the last vector of each row: measured, ten times slower).
pub struct Piece([f32; PIECE + 2]);

impl Piece {
    /// Of zeros.
    #[allow(
        clippy::new_without_default,
        reason = "zeros are a buffer's state before its first load, no default of anybody's"
    )]
    #[inline(always)]
    pub fn new() -> Self {
        Self([0.0; PIECE + 2])
    }

    /// Takes the `n` cells from `at` on, at most [`PIECE`].
    #[inline(always)]
    pub fn load(&mut self, row: &[f32], at: usize, n: usize) {
        let nx = row.len();
        self.0[0] = row[if at > 0 { at - 1 } else { nx - 1 }];
        self.0[1..n + 1].copy_from_slice(&row[at..at + n]);
        self.0[n + 1] = row[if at + n < nx { at + n } else { 0 }];
    }

    /// The `n` cells from `shift - 1` cells east of the piece's first on.
    #[inline(always)]
    pub fn from(&self, shift: usize, n: usize) -> &[f32] {
        &self.0[shift..shift + n]
    }
}

/// The horizontal wind at each other's places along a piece of a row: u at the south faces where v sits and v at the west faces where u does, each the
/// mean of its four nearest values, m/s.
pub struct Crosswind {
    u_here: Piece,
    u_south: Piece,
    v_here: Piece,
    v_north: Piece,
    /// u where v sits.
    pub u_at_v: [f32; PIECE],
    /// v where u sits.
    pub v_at_u: [f32; PIECE],
}

impl Crosswind {
    /// Of zeros.
    #[allow(clippy::new_without_default, reason = "as of a piece")]
    pub fn new() -> Self {
        Self {
            u_here: Piece::new(),
            u_south: Piece::new(),
            v_here: Piece::new(),
            v_north: Piece::new(),
            u_at_v: [0.0; PIECE],
            v_at_u: [0.0; PIECE],
        }
    }

    /// Takes the `n` cells of row `(y, z)` from `at` on, at most [`PIECE`].
    #[inline(always)]
    pub fn load(&mut self, grid: &Grid, [u, v]: [&[f32]; 2], [y, z]: [usize; 2], at: usize, n: usize) {
        let ny = grid.cells[1];
        self.u_here.load(row(grid, u, y, z), at, n);
        self.u_south.load(row(grid, u, back(y, 1, ny), z), at, n);
        self.v_here.load(row(grid, v, y, z), at, n);
        self.v_north.load(row(grid, v, ahead(y, 1, ny), z), at, n);
        let (u0, u_east) = (self.u_here.from(1, n), self.u_here.from(2, n));
        let (us, us_east) = (self.u_south.from(1, n), self.u_south.from(2, n));
        let (v0, v_west) = (self.v_here.from(1, n), self.v_here.from(0, n));
        let (vn, vn_west) = (self.v_north.from(1, n), self.v_north.from(0, n));
        let (u_at_v, v_at_u) = (&mut self.u_at_v[..n], &mut self.v_at_u[..n]);
        for i in 0..n {
            v_at_u[i] = 0.25 * (v_west[i] + v0[i] + vn_west[i] + vn[i]);
            u_at_v[i] = 0.25 * (u0[i] + u_east[i] + us[i] + us_east[i]);
        }
    }
}
