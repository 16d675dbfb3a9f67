//! Stage `stars`: the stars that an eye sees, each where it stands.
//!
//! Reads: the catalogue `data/stars.csv` (its head says whose it is), the years since 2000, the faintest magnitude. Writes: [`StarTable`]: packed words, a head of one word for each of 6 x 8 x 8 tiles of the cube around the
//! equator's frame of date (first entry and number of entries, 16 bits each), then two words an entry: direction (octahedron, 16 bits a coordinate, 6 seconds of arc), then magnitude and
//! colour index in thousandths, 16 bits each. A tile lists what stands within a margin around it, so that one tile holds all that a pixel may see. In the march
//! a star's irradiance is spread over a round spot a pixel wide, so that its light does not depend on the picture's size.
//!
//! Scheme: precession from 2000 to the scene's date (Lieske 1979, as in Meeus 1998, chapter 21); irradiance 10^(-0.4 (V + 26.74)) of the sun's; colours
//! from B-V, with V-R taken as 0.56 (B-V). Left out: proper motion (a minute of arc in 25 years for the fastest), nutation, aberration and refraction, planets, the Milky
//! Way (its mean light is part of the night sky's).

use super::transmittance_table::TransmittanceTable;
use crate::cpu::view::lanes::{LANES, Lanes};

crate::constants! {
    /// Tiles along an edge of the cube's faces.
    pub const STAR_TILES: usize = 8;
    /// How far around a tile its list reaches, rad.
    const STAR_MARGIN: f32 = 0.016;
    /// The sun's magnitude and colour index: what irradiance and colours are relative to.
    const SUN_MAGNITUDE: f32 = -26.74;
    const SUN_COLOUR_INDEX: f32 = 0.653;
    /// Magnitudes of red over green a unit of B-V.
    const STAR_RED_SLOPE: f32 = 0.56;
    /// Width of the spot (standard deviation), pixels, and where it ends.
    const STAR_SPOT_PIXELS: f32 = 0.5;
    const STAR_SPOT_END: f32 = 3.0;
    /// Steps a magnitude as packed, and what the least packed magnitude and colour index stand for.
    const STAR_STEPS: f32 = 1000.0;
    const STAR_LEAST: f32 = -3.0;
    /// Base 2 logarithm of 10^0.4.
    pub(crate) const MAGNITUDE_LOG2: f32 = 1.328_771_2;
    /// Words of the whole table: what fits a uniform of 64 KiB.
    pub const STAR_WORDS: usize = 16_384;
    /// Stars are drawn while the sine of the sun's elevation is below this: 2 degrees under the horizon.
    pub const STARS_SUN_SINE: f32 = -0.034_9;
}
/// Tiles in all.
const TILES: usize = 6 * STAR_TILES * STAR_TILES;

/// A star of the catalogue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Star {
    /// Right ascension, degrees, equinox 2000.
    pub ascension_deg: f64,
    /// Declination, degrees, equinox 2000.
    pub declination_deg: f64,
    /// Visual magnitude V.
    pub magnitude: f32,
    /// Colour index B-V.
    pub colour_index: f32,
}

/// The stars of the catalogue, brightest first.
pub fn catalogue() -> impl Iterator<Item = Star> {
    let lines = include_str!("../../../data/stars.csv").lines();
    lines.filter(|line| !line.starts_with('#')).filter_map(|line| {
        let mut numbers = line.split(',').map(|n| n.trim().parse::<f64>());
        let mut next = || numbers.next().and_then(Result::ok);
        Some(Star {
            ascension_deg: next()?,
            declination_deg: next()?,
            magnitude: next()? as f32,
            colour_index: next()? as f32,
        })
    })
}

/// Light of a colour index in red, green and blue, over the sun's, with green 1.
pub fn colour_of(colour_index: f32) -> [f32; 3] {
    let redder = colour_index - SUN_COLOUR_INDEX;
    [
        (MAGNITUDE_LOG2 * STAR_RED_SLOPE * redder).exp2(),
        1.0,
        (-MAGNITUDE_LOG2 * redder).exp2(),
    ]
}

/// Unit vector of a place on the sky at an equinox some years from 2000.
pub fn direction_of_date(ascension_deg: f64, declination_deg: f64, years_since_2000: f32) -> [f64; 3] {
    let t = f64::from(years_since_2000) / 100.0;
    let second = (1.0f64 / 3_600.0).to_radians();
    let zeta = t * (2_306.218_1 + t * (0.301_88 + t * 0.017_998)) * second;
    let z = t * (2_306.218_1 + t * (1.094_68 + t * 0.018_203)) * second;
    let theta = t * (2_004.310_9 - t * (0.426_65 + t * 0.041_833)) * second;
    let (a, d) = (ascension_deg.to_radians() + zeta, declination_deg.to_radians());
    let x = theta.cos() * d.cos() * a.cos() - theta.sin() * d.sin();
    let y = d.cos() * a.sin();
    let up = theta.sin() * d.cos() * a.cos() + theta.cos() * d.sin();
    [x * z.cos() - y * z.sin(), x * z.sin() + y * z.cos(), up]
}

/// See the module.
#[derive(Clone, Debug, PartialEq)]
pub struct StarTable {
    words: Vec<u32>,
}

/// Face of the cube, and the two coordinates on it from -1 to 1.
#[inline(always)]
fn on_cube(q: [f32; 3]) -> (usize, [f32; 2]) {
    let size = q.map(f32::abs);
    if size[0] >= size[1] && size[0] >= size[2] {
        ((q[0] < 0.0) as usize, [q[1] / size[0], q[2] / size[0]])
    } else if size[1] >= size[2] {
        (2 + (q[1] < 0.0) as usize, [q[0] / size[1], q[2] / size[1]])
    } else {
        (4 + (q[2] < 0.0) as usize, [q[0] / size[2], q[1] / size[2]])
    }
}

fn tile(coordinate: f32) -> usize {
    (((coordinate * 0.5 + 0.5) * STAR_TILES as f32).max(0.0) as usize).min(STAR_TILES - 1)
}

/// Direction as an octahedron's coordinates, 16 bits each.
fn packed(d: [f64; 3]) -> u32 {
    let sum: f64 = d.iter().map(|v| v.abs()).sum();
    let [x, y] = [d[0] / sum, d[1] / sum];
    let [x, y] = if d[2] >= 0.0 {
        [x, y]
    } else {
        let sign = |v: f64| if v < 0.0 { -1.0 } else { 1.0 };
        [(1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y)]
    };
    let bits = |v: f64| ((v * 0.5 + 0.5) * 65_535.0).round() as u32;
    bits(x) | bits(y) << 16
}

#[inline(always)]
fn unpacked(word: u32) -> [f32; 3] {
    let part = |v: u32| v as f32 * (2.0 / 65_535.0) - 1.0;
    let (x, y) = (part(word & 0xffff), part(word >> 16));
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    let [x, y] = [x, y].map(|v| if v < 0.0 { v + fold } else { v - fold });
    let length = (x * x + y * y + z * z).sqrt();
    [x / length, y / length, z / length]
}

impl StarTable {
    /// The stars not fainter than `faintest`, so many years from 2000; the faintest are left out where they would not fit.
    pub fn new(faintest: f32, years_since_2000: f32) -> StarTable {
        let mut tiles: Vec<Vec<[u32; 2]>> = vec![Vec::new(); TILES];
        let mut room = (STAR_WORDS - TILES) / 2;
        for star in catalogue().filter(|s| s.magnitude <= faintest) {
            let d = direction_of_date(star.ascension_deg, star.declination_deg, years_since_2000);
            let thousandths = |v: f32| ((v - STAR_LEAST) * STAR_STEPS).round().clamp(0.0, 65_535.0) as u32;
            let entry = [
                packed(d),
                thousandths(star.magnitude) | thousandths(star.colour_index) << 16,
            ];
            let seen = near(d.map(|v| v as f32));
            if seen.len() > room {
                break;
            }
            room -= seen.len();
            for n in seen {
                tiles[n].push(entry);
            }
        }
        let mut words = Vec::with_capacity(STAR_WORDS);
        let mut first = 0;
        for list in &tiles {
            words.push(first as u32 | (list.len() as u32) << 16);
            first += list.len();
        }
        words.extend(tiles.iter().flatten().flatten());
        words.resize(STAR_WORDS, 0);
        StarTable { words }
    }
    /// The table as it is bound.
    pub fn words(&self) -> &[u32] {
        &self.words
    }
    /// Light of the stars along `direction` in the equator's frame, in pixels of so many radians: radiance over the sun's irradiance, before the air.
    #[inline(always)]
    pub fn radiance(&self, direction: [f32; 3], pixel: f32) -> [f32; 3] {
        let (face, [u, v]) = on_cube(direction);
        let head = self.words[(face * STAR_TILES + tile(v)) * STAR_TILES + tile(u)];
        let (first, count) = ((head & 0xffff) as usize, (head >> 16) as usize);
        let width = pixel * STAR_SPOT_PIXELS;
        let reach = (width * STAR_SPOT_END).min(STAR_MARGIN);
        let mut light = [0.0f32; 3];
        for entry in self.words[TILES + 2 * first..][..2 * count].chunks_exact(2) {
            let s = unpacked(entry[0]);
            let [x, y, z] = [direction[0] - s[0], direction[1] - s[1], direction[2] - s[2]];
            let squared = x * x + y * y + z * z;
            if squared < reach * reach {
                let magnitude = (entry[1] & 0xffff) as f32 / STAR_STEPS + STAR_LEAST;
                let colour = colour_of((entry[1] >> 16) as f32 / STAR_STEPS + STAR_LEAST);
                let irradiance = (MAGNITUDE_LOG2 * (SUN_MAGNITUDE - magnitude)).exp2();
                let spot = (-0.5 * squared / (width * width)).exp() / (2.0 * std::f32::consts::PI * width * width);
                for c in 0..3 {
                    light[c] += irradiance * spot * colour[c];
                }
            }
        }
        light
    }
}

/// The tiles that list a star: those that it stands in or near.
fn near(d: [f32; 3]) -> Vec<usize> {
    let mut seen = Vec::new();
    for face in 0..6 {
        let axis = face / 2;
        let out = if face % 2 == 0 { d[axis] } else { -d[axis] };
        if out < 0.3 {
            continue;
        }
        let [a, b] = [[1, 2], [0, 2], [0, 1]][axis];
        let (u, v) = (d[a] / out, d[b] / out);
        // The most that a coordinate changes along an arc.
        let margin = STAR_MARGIN * (1.0 + u * u + v * v) * 1.1;
        if u.abs().max(v.abs()) > 1.0 + margin {
            continue;
        }
        for row in tile(v - margin)..=tile(v + margin) {
            for column in tile(u - margin)..=tile(u + margin) {
                seen.push((face * STAR_TILES + row) * STAR_TILES + column);
            }
        }
    }
    seen
}

/// Stars over a picture.
#[derive(Clone, Copy, Debug)]
pub struct StarField<'a> {
    /// The table.
    pub table: &'a StarTable,
    /// Rows that turn a direction of the world into the equator's frame of date.
    pub equatorial_from_world: [[f32; 3]; 3],
    /// The air that they shine through.
    pub transmittance: &'a TransmittanceTable,
    /// Camera, m.
    pub height_m: f32,
}

impl StarField<'_> {
    /// Radiance along sixteen unit vectors, of those lanes where `seen` is above 0.
    pub(crate) fn radiance(&self, d: &[Lanes; 3], pixel: f32, seen: Lanes) -> [Lanes; 3] {
        let mut light = [Lanes::splat(0.0); 3];
        for l in 0..LANES {
            if seen.0[l] <= 0.0 {
                continue;
            }
            let w = [d[0].0[l], d[1].0[l], d[2].0[l]];
            let q = self
                .equatorial_from_world
                .map(|row| row[0] * w[0] + row[1] * w[1] + row[2] * w[2]);
            let own = self.table.radiance(q, pixel);
            if own[1] > 0.0 {
                let passed = self.transmittance.to_space(self.height_m, w[2]);
                for c in 0..3 {
                    light[c].0[l] = own[c] * passed[c] * seen.0[l];
                }
            }
        }
        light
    }
}
