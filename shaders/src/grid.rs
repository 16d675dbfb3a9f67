//! The Arakawa C grid: where cells and faces are, and how their values lie in memory.

/// A uniform grid of `nx * ny * nz` cells, periodic in x and y, rigid at the ground and the lid.
///
/// Every field is a dense array `[z][y][x]`, x fastest. A value `at x face (i, j, k)` lies on the west face of
/// cell `(i, j, k)`, `at y face` on its south face, `at z face` on its lower face; the lid's face is not stored, w is 0 there
/// as it is at the ground (k = 0).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Cells east, north, up.
    pub cells: [usize; 3],
    /// Cell sizes, m.
    pub cell_size_m: [f32; 3],
}

impl Grid {
    /// Number of cells.
    pub fn len(&self) -> usize {
        self.cells[0] * self.cells[1] * self.cells[2]
    }
    /// Whether there is no cell at all.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// Cells in one level.
    pub fn plane(&self) -> usize {
        self.cells[0] * self.cells[1]
    }
    /// Index of cell `(x, y, z)`.
    #[inline(always)]
    pub fn index(&self, x: usize, y: usize, z: usize) -> usize {
        (z * self.cells[1] + y) * self.cells[0] + x
    }
    /// Size of the box, m.
    pub fn size_m(&self) -> [f32; 3] {
        [0, 1, 2].map(|a| self.cells[a] as f32 * self.cell_size_m[a])
    }
    /// Height of the centres of level `k`, m.
    pub fn centre_height_m(&self, k: usize) -> f64 {
        (k as f64 + 0.5) * self.cell_size_m[2] as f64
    }
}
