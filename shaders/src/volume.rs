//! What the simulation hands to light and view: one extinction field, whatever made the cloud.

use crate::grid::Grid;

/// A cloud as light sees it, immutable once published.
#[derive(Clone, Debug)]
pub struct CloudVolume {
    /// The grid; the volume repeats in x and y.
    pub grid: Grid,
    /// Extinction by droplets at cell centres, 1/m, `[z][y][x]`; finite and never negative.
    pub extinction_per_m: Vec<f32>,
    /// Levels that hold any extinction: first, and one past the last; equal where there is no cloud.
    pub cloudy_levels: [usize; 2],
    /// How far the cloudy air has moved since the start, m: detail noise is looked up at `position - air_displacement_m`.
    pub air_displacement_m: [f32; 3],
}
