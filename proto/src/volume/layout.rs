//! Which cells a message holds: a region of the world's grid, made coarser, cut into bricks.

use super::VolumeError;

/// Coarsest mip: a cell of it is 64 cells of the world along each edge.
pub const MIP_MAX: u8 = 6;
/// Longest side of a world, cells.
const SIDE_MAX: u32 = 1 << 16;
/// Longest edge of a brick, cells.
const BRICK_EDGE_MAX: u8 = 64;

/// A box of the world's cells: from the first cell along each axis, so many of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Region {
    /// First cell east, north, up.
    pub from: [u32; 3],
    /// Cells east, north, up.
    pub cells: [u32; 3],
}

impl Region {
    /// The whole of a world.
    pub fn whole(world_cells: [u32; 3]) -> Self {
        Self {
            from: [0; 3],
            cells: world_cells,
        }
    }

    /// The smallest region around this one that mip `mip` can show: bounds are multiples of 2^mip cells, or the world's end.
    pub fn widened(&self, mip: u8, world_cells: [u32; 3]) -> Self {
        let edge = 1u32 << mip.min(MIP_MAX);
        let from = self.from.map(|f| f / edge * edge);
        let end = [0, 1, 2].map(|a| {
            (self.from[a].saturating_add(self.cells[a]))
                .next_multiple_of(edge)
                .min(world_cells[a])
        });
        Self {
            from,
            cells: [0, 1, 2].map(|a| end[a].saturating_sub(from[a])),
        }
    }
}

/// See the module.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout {
    /// Cells of the whole world.
    pub world_cells: [u32; 3],
    /// Sizes of the world's cells, m.
    pub cell_size_m: [f64; 3],
    /// What is shown of it.
    pub region: Region,
    /// A cell of the message is the mean of 2^mip cells along each edge; at the world's end of as many as there are.
    pub mip: u8,
    /// Edges of a brick, cells of the message; the last bricks along an axis may be smaller.
    pub brick: [u8; 3],
}

impl Layout {
    /// Checks that the numbers fit one another. Errors: [`VolumeError::Header`].
    pub fn check(&self) -> Result<(), VolumeError> {
        let bad = VolumeError::header;
        if self.mip > MIP_MAX {
            return Err(bad("mip", format!("{} is above {MIP_MAX}", self.mip)));
        }
        let edge = 1u32 << self.mip;
        for axis in 0..3 {
            let (world, from, cells) = (self.world_cells[axis], self.region.from[axis], self.region.cells[axis]);
            if world == 0 || world > SIDE_MAX {
                return Err(bad("world_cells", format!("{world} is not 1 to {SIDE_MAX}")));
            }
            let size_m = self.cell_size_m[axis];
            if !(size_m.is_finite() && size_m > 0.0) {
                return Err(bad("cell_size_m", format!("{size_m} is no length")));
            }
            let end = u64::from(from) + u64::from(cells);
            if cells == 0 || end > u64::from(world) {
                return Err(bad(
                    "region",
                    format!("{cells} cells from {from} do not lie within {world}"),
                ));
            }
            if !from.is_multiple_of(edge) || !(end.is_multiple_of(u64::from(edge)) || end == u64::from(world)) {
                return Err(bad(
                    "region",
                    format!("{from} to {end} are no bounds of cells of mip {}", self.mip),
                ));
            }
            let brick = self.brick[axis];
            if brick == 0 || brick > BRICK_EDGE_MAX {
                return Err(bad("brick", format!("an edge of {brick} is not 1 to {BRICK_EDGE_MAX}")));
            }
        }
        Ok(())
    }

    /// Cells of the message east, north, up.
    pub fn cells(&self) -> [usize; 3] {
        self.region.cells.map(|n| n.div_ceil(1 << self.mip) as usize)
    }

    /// Number of cells of the message.
    pub fn len(&self) -> usize {
        self.cells().iter().product()
    }

    /// Whether it holds no cell; a checked layout never does.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bricks east, north, up.
    pub fn bricks(&self) -> [usize; 3] {
        let cells = self.cells();
        [0, 1, 2].map(|a| cells[a].div_ceil(usize::from(self.brick[a])))
    }

    /// Number of bricks.
    pub fn brick_count(&self) -> usize {
        self.bricks().iter().product()
    }

    /// First cell and cells of brick `index`; bricks are counted x fastest, then y, then z.
    pub fn brick_at(&self, index: usize) -> ([usize; 3], [usize; 3]) {
        let (bricks, cells) = (self.bricks(), self.cells());
        let place = [
            index % bricks[0],
            index / bricks[0] % bricks[1],
            index / bricks[0] / bricks[1],
        ];
        let edges = self.brick.map(usize::from);
        let from = [0, 1, 2].map(|a| place[a] * edges[a]);
        (from, [0, 1, 2].map(|a| edges[a].min(cells[a].saturating_sub(from[a]))))
    }

    /// The region's south-west lower corner, m from the world's.
    pub fn origin_m(&self) -> [f64; 3] {
        [0, 1, 2].map(|a| f64::from(self.region.from[a]) * self.cell_size_m[a])
    }

    /// Sizes of a cell of the message, m. The last one along an axis is thinner where the world ends within it.
    pub fn message_cell_size_m(&self) -> [f64; 3] {
        self.cell_size_m.map(|s| s * f64::from(1u32 << self.mip))
    }
}
