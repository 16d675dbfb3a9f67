//! Semi-Lagrangian advection on the C grid: where values lie, and how they are read between.
//!
//! A value moves with the air: the new value at a point is the old one at the place that the air came from. What is carried lies on a
//! lattice of its own (cell centres, or one kind of face); a place is given as a displacement in cells back along the wind, so that
//! its fraction keeps all the bits of a small displacement. Displacements are known at centres; at a face they are the mean of the
//! two centres beside it. x and y are periodic, however far a trajectory goes; upwards a place beyond the lattice's first or last level is
//! moved onto it, so nothing comes through ground or lid. w has one level more than is stored, the lid's, which holds 0.
//!
//! Source: Staniforth and Cote (1991), sections 2 and 3; Stam (1999).

use super::slab::back;
use crate::catalogue::Place;
use crate::grid::Grid;

/// Points of a row that are worked on at once; their intermediate values lie on the stack.
pub const CHUNK: usize = 64;

/// One value for each point of a chunk and direction.
pub type Displacement = [[f32; CHUNK]; 3];

/// Where values of one kind lie, upwards.
#[derive(Clone, Copy, Debug)]
pub struct Lattice {
    /// The last level, stored or not.
    pub top: usize,
    /// Levels that are stored; a level above them holds 0.
    pub stored: usize,
}

impl Lattice {
    /// The lattice of a place.
    pub fn new(grid: &Grid, place: Place) -> Self {
        let stored = grid.cells[2];
        let top = if place == Place::ZFace { stored } else { stored - 1 };
        Self { top, stored }
    }
}

/// Added to a whole number from 0 to 2^23 it leaves that number in the low mantissa bits.
const TO_BITS: f32 = 8_388_608.0;

/// A whole number from 0 to 2^23 as an integer. A conversion by `as` would test for NaN; a wrong index is caught where it is used.
#[inline(always)]
pub fn index_of(whole: f32) -> u32 {
    (whole + TO_BITS).to_bits() & 0x7f_ffff
}

/// A whole number on the periodic axis of `n` cells.
#[inline(always)]
pub fn wrapped(whole: f32, n: f32) -> f32 {
    whole - n * (whole / n).floor()
}

/// The whole number below a place that is `displacement` back, and the rest from 0 to 1.
#[inline(always)]
pub fn split(displacement: f32) -> (f32, f32) {
    let below = (-displacement).floor();
    (below, -displacement - below)
}

/// The least and the largest displacement in z that stay on the lattice, seen from level `z`.
#[inline(always)]
pub fn bounds_z(lattice: &Lattice, z: usize) -> (f32, f32) {
    (z as f32 - lattice.top as f32, z as f32)
}

/// `value` not below `low` and not above `high`; NaN stays.
#[inline(always)]
pub fn bounded(value: f32, low: f32, high: f32) -> f32 {
    let value = if value < low { low } else { value };
    if value > high { high } else { value }
}

/// Where the eight values around a place lie, x fastest and z slowest, and whether the lower and the upper level are there (1) or hold 0.
#[derive(Clone, Copy)]
pub struct Corners {
    /// Indices into a field.
    pub index: [u32; 8],
    /// Factors of the lower four and the upper four.
    pub there: [f32; 2],
}

/// Runs `$body` for each point `$i` of a chunk of row `(y, z)` that begins at column `$begin`, with the corners around the place it came from
/// and that place's fractions of a cell.
///
/// A macro and not a function with a closure: closures do not get the caller's instruction set.
macro_rules! around {
    ($grid:expr, $lattice:expr, [$y:expr, $z:expr], $begin:expr, $displacement:expr, $n:expr, |$i:ident, $corners:ident, $t:ident| $body:block) => {{
        use $crate::cpu::sim::semi_lagrangian::{Corners, bounded, bounds_z, index_of, split, wrapped};
        let [nx, ny, _] = $grid.cells;
        let (row, rows, plane) = (nx as u32, ny as u32, (nx * ny) as u32);
        let (nx_f, ny_f) = (nx as f32, ny as f32);
        let (y, z) = ($y as f32, $z as f32);
        let begin = $begin as i32;
        let n: usize = $n;
        let [dx, dy, dz] = &$displacement;
        let (dx, dy, dz) = (&dx[..n], &dy[..n], &dz[..n]);
        let (low, high) = bounds_z(&$lattice, $z);
        let (top, stored) = ($lattice.top as u32, $lattice.stored as u32);
        for $i in 0..n {
            let (below, tx) = split(dx[$i]);
            let x0 = index_of(wrapped(begin.wrapping_add($i as i32) as f32 + below, nx_f));
            let x1 = x0.wrapping_add(1);
            let x1 = if x1 < row { x1 } else { 0 };
            let (below, ty) = split(dy[$i]);
            let y0 = index_of(wrapped(y + below, ny_f));
            let y1 = y0.wrapping_add(1);
            let y1 = if y1 < rows { y1 } else { 0 };
            let (below, tz) = split(bounded(dz[$i], low, high));
            let z0 = index_of(z + below);
            let z1 = if z0 < top { z0.wrapping_add(1) } else { top };
            let (level0, level1) = (z0.wrapping_mul(plane), z1.wrapping_mul(plane));
            let (row0, row1) = (y0.wrapping_mul(row), y1.wrapping_mul(row));
            let (r00, r01) = (level0.wrapping_add(row0), level0.wrapping_add(row1));
            let (r10, r11) = (level1.wrapping_add(row0), level1.wrapping_add(row1));
            let $corners = Corners {
                index: [
                    r00.wrapping_add(x0),
                    r00.wrapping_add(x1),
                    r01.wrapping_add(x0),
                    r01.wrapping_add(x1),
                    r10.wrapping_add(x0),
                    r10.wrapping_add(x1),
                    r11.wrapping_add(x0),
                    r11.wrapping_add(x1),
                ],
                there: [if z0 < stored { 1.0 } else { 0.0 }, if z1 < stored { 1.0 } else { 0.0 }],
            };
            let $t = [tx, ty, tz];
            $body
        }
    }};
}
pub(crate) use around;

/// A field's values at the corners.
#[inline(always)]
pub fn eight(field: &[f32], corners: &Corners) -> [f32; 8] {
    // The level above the last is not stored, and NaN gives any index: both end at the last value.
    let last = field.len() - 1;
    let mut q = [0.0; 8];
    for k in 0..8 {
        q[k] = field[(corners.index[k] as usize).min(last)] * corners.there[k / 4];
    }
    q
}

/// The trilinear mean of eight values.
#[inline(always)]
pub fn trilinear(q: [f32; 8], t: [f32; 3]) -> f32 {
    let (a, b) = (q[0] + t[0] * (q[1] - q[0]), q[2] + t[0] * (q[3] - q[2]));
    let (c, d) = (q[4] + t[0] * (q[5] - q[4]), q[6] + t[0] * (q[7] - q[6]));
    let (low, high) = (a + t[1] * (b - a), c + t[1] * (d - c));
    low + t[2] * (high - low)
}

/// The smallest and the largest of eight values.
#[inline(always)]
pub fn extrema(q: [f32; 8]) -> (f32, f32) {
    let (mut low, mut high) = (q[0], q[0]);
    for k in 1..8 {
        low = if q[k] < low { q[k] } else { low };
        high = if q[k] > high { q[k] } else { high };
    }
    (low, high)
}

/// A quantity that is carried by a semi-Lagrangian stage.
#[derive(Clone, Copy)]
pub struct Carried<'a> {
    /// Where it lies.
    pub place: Place,
    /// The old values, with the tendencies of the substep.
    pub state: &'a [f32],
    /// How far back the air at each cell centre was, in cells.
    pub departure: [&'a [f32]; 3],
    /// Buoyancy at centres for w, or empty.
    pub buoyancy: &'a [f32],
    /// Length of the substep, s.
    pub dt_s: f32,
}

impl Carried<'_> {
    /// Whether level `z` is the ground's, where w stays 0.
    #[inline(always)]
    pub fn is_wall(&self, z: usize) -> bool {
        self.place == Place::ZFace && z == 0
    }

    /// Adds the buoyancy at the face to row `(y, z)` of w: the mean of those below and above.
    #[inline(always)]
    pub fn add_buoyancy(&self, grid: &Grid, y: usize, z: usize, out: &mut [f32]) {
        if self.place != Place::ZFace || self.buoyancy.is_empty() || z == 0 {
            return;
        }
        let n = out.len();
        let at = grid.index(0, y, z);
        let (below, above) = (&self.buoyancy[at - grid.plane()..][..n], &self.buoyancy[at..][..n]);
        for i in 0..n {
            out[i] += self.dt_s * 0.5 * (below[i] + above[i]);
        }
    }
}

/// The displacements of a place's points `begin .. begin + n` in row `(y, z)` from those at centres. Not to be asked for at the ground's faces.
#[inline(always)]
pub fn displacements(
    grid: &Grid,
    place: Place,
    at_centres: [&[f32]; 3],
    [y, z]: [usize; 2],
    begin: usize,
    n: usize,
    out: &mut Displacement,
) {
    let at = grid.index(begin, y, z);
    let beside = match place {
        Place::YFace => grid.index(begin, back(y, 1, grid.cells[1]), z),
        Place::ZFace => grid.index(begin, y, z - 1),
        Place::Centre | Place::XFace => at,
    };
    for c in 0..3 {
        let from = at_centres[c];
        let (here, beside) = (&from[at..][..n], &from[beside..][..n]);
        let out = &mut out[c][..n];
        match place {
            Place::Centre => out.copy_from_slice(here),
            Place::XFace => {
                let west = if begin > 0 { at - 1 } else { at + grid.cells[0] - 1 };
                out[0] = 0.5 * (from[west] + here[0]);
                for i in 1..n {
                    out[i] = 0.5 * (here[i - 1] + here[i]);
                }
            }
            Place::YFace | Place::ZFace => {
                for i in 0..n {
                    out[i] = 0.5 * (beside[i] + here[i]);
                }
            }
        }
    }
}
