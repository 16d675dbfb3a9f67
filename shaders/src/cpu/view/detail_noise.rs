//! Stage `detail_noise`: the pattern that carves cloud edges finer than a cell.
//!
//! Reads: nothing. Writes: a tile of 64^3 points, periodic, two numbers of 8 bits a point, each beside its eastern neighbour's: large
//! billows (inverted cell noise after Worley 1996 at 4 and 8 cells a tile, with a little gradient noise after Perlin 1985) and small
//! billows (16 cells a tile, and 8 shifted). Both have mean near one half. The same tile serves every world; a seed shifts it.

use rayon::prelude::*;

use super::lanes::{Indices, LANES, Lanes};

crate::constants! {
    /// Points along an edge of the tile.
    pub const TILE_POINTS: usize = 64;
    /// Largest billows along an edge of the tile.
    pub const TILE_BILLOWS: usize = 4;
    /// Shares of the large billows: the largest, those half as large, gradient noise.
    const NOISE_LARGE_BILLOWS: f32 = 0.60;
    const NOISE_LARGE_FINER: f32 = 0.27;
    const NOISE_LARGE_GRADIENT: f32 = 0.13;
    /// Shares of the small billows: half and a quarter as large as the largest.
    const NOISE_SMALL_BILLOWS: f32 = 0.62;
    const NOISE_SMALL_FINER: f32 = 0.38;
    /// Standard deviation that both are stretched to.
    const NOISE_DEVIATION: f32 = 0.2;
    /// Gain of gradient noise.
    const NOISE_GRADIENT_GAIN: f32 = 0.7;
    /// Odd numbers that spread a cell's indices over 32 bits, and those that mix them.
    const NOISE_HASH_X: u32 = 0x8da6_b343;
    const NOISE_HASH_Y: u32 = 0xd816_3841;
    const NOISE_HASH_Z: u32 = 0xcb1a_b31f;
    const NOISE_HASH_SALT: u32 = 0x9e37_79b9;
    const NOISE_HASH_FIRST: u32 = 0x7feb_352d;
    const NOISE_HASH_SECOND: u32 = 0x846c_a68b;
}

/// See the module.
#[derive(Clone, Debug)]
pub struct DetailNoise {
    words: Vec<u32>,
}

impl DetailNoise {
    /// Bakes the tile; some 50 ms.
    pub fn new() -> DetailNoise {
        let n = TILE_POINTS;
        let mut pairs = vec![[0.0f32; 2]; n * n * n];
        pairs.par_chunks_mut(n * n).enumerate().for_each(|(k, level)| {
            for j in 0..n {
                for i in 0..n {
                    let p = [i, j, k].map(|v| v as f32 / n as f32);
                    let large = NOISE_LARGE_BILLOWS * billow(p, TILE_BILLOWS, 1)
                        + NOISE_LARGE_FINER * billow(p, 2 * TILE_BILLOWS, 2)
                        + NOISE_LARGE_GRADIENT * gradient(p, TILE_BILLOWS + 1, 3);
                    let small = NOISE_SMALL_BILLOWS * billow(p, 2 * TILE_BILLOWS, 4)
                        + NOISE_SMALL_FINER * billow(p, 4 * TILE_BILLOWS, 5);
                    level[j * n + i] = [large, small];
                }
            }
        });
        // Stretch both to the full range around their means.
        let mut scale = [[0.0f32; 2]; 2];
        for c in 0..2 {
            let mean = pairs.iter().map(|p| p[c] as f64).sum::<f64>() / pairs.len() as f64;
            let square = pairs.iter().map(|p| (p[c] as f64 - mean).powi(2)).sum::<f64>() / pairs.len() as f64;
            scale[c] = [mean as f32, (NOISE_DEVIATION as f64 / square.sqrt().max(1e-6)) as f32];
        }
        let byte =
            |p: [f32; 2], c: usize| (((p[c] - scale[c][0]) * scale[c][1] + 0.5).clamp(0.0, 1.0) * 255.0 + 0.5) as u32;
        let words = (0..pairs.len())
            .map(|at| {
                let east = at - at % n + (at + 1) % n;
                byte(pairs[at], 0) | byte(pairs[at], 1) << 8 | byte(pairs[east], 0) << 16 | byte(pairs[east], 1) << 24
            })
            .collect();
        DetailNoise { words }
    }
    /// The tile, `[z][y][x]`: two bytes of a point, then two of its eastern neighbour.
    pub fn words(&self) -> &[u32] {
        &self.words
    }
    /// Large and small billows, 0 to 1, at 16 places in units of the tile's edge.
    #[inline(always)]
    pub(crate) fn look(&self, x: Lanes, y: Lanes, z: Lanes) -> (Lanes, Lanes) {
        let n = TILE_POINTS as f32;
        let (i, fx) = (x * n).split();
        let (j, fy) = (y * n).split();
        let (k, fz) = (z * n).split();
        let f = [fx, fy, fz];
        let corners = [
            self.corner(i, j, k, 0, 0),
            self.corner(i, j, k, 1, 0),
            self.corner(i, j, k, 0, 1),
            self.corner(i, j, k, 1, 1),
        ];
        (mix(&corners, 0, &f), mix(&corners, 8, &f))
    }
    #[inline(always)]
    fn corner(&self, i: Indices, j: Indices, k: Indices, dj: u32, dk: u32) -> Indices {
        const MASK: u32 = TILE_POINTS as u32 - 1;
        const BITS: u32 = TILE_POINTS.trailing_zeros();
        let mut index = i;
        for l in 0..LANES {
            let row = (k.0[l].wrapping_add(dk) & MASK) << BITS | (j.0[l].wrapping_add(dj) & MASK);
            index.0[l] = row << BITS | (i.0[l] & MASK);
        }
        index.gather(&self.words)
    }
}

/// Trilinear mix of one byte of the corners, each of which holds its eastern neighbour's byte too.
#[inline(always)]
fn mix(corners: &[Indices; 4], shift: u32, f: &[Lanes; 3]) -> Lanes {
    let c0 = corners[0]
        .bits(shift, 0xff)
        .lerp(corners[0].bits(shift + 16, 0xff), f[0]);
    let c1 = corners[1]
        .bits(shift, 0xff)
        .lerp(corners[1].bits(shift + 16, 0xff), f[0]);
    let c2 = corners[2]
        .bits(shift, 0xff)
        .lerp(corners[2].bits(shift + 16, 0xff), f[0]);
    let c3 = corners[3]
        .bits(shift, 0xff)
        .lerp(corners[3].bits(shift + 16, 0xff), f[0]);
    c0.lerp(c1, f[1]).lerp(c2.lerp(c3, f[1]), f[2]) * (1.0 / 255.0)
}

impl Default for DetailNoise {
    fn default() -> DetailNoise {
        DetailNoise::new()
    }
}

fn hash(x: usize, y: usize, z: usize, salt: u32) -> u32 {
    let mut h = (x as u32).wrapping_mul(NOISE_HASH_X)
        ^ (y as u32).wrapping_mul(NOISE_HASH_Y)
        ^ (z as u32).wrapping_mul(NOISE_HASH_Z);
    h = h.wrapping_add(salt.wrapping_mul(NOISE_HASH_SALT));
    h = (h ^ (h >> 16)).wrapping_mul(NOISE_HASH_FIRST);
    h = (h ^ (h >> 15)).wrapping_mul(NOISE_HASH_SECOND);
    h ^ (h >> 16)
}

/// One less the distance to the nearest of one random point a cell: round billows with creases between.
fn billow(p: [f32; 3], cells: usize, salt: u32) -> f32 {
    let q = p.map(|v| v * cells as f32);
    let base = q.map(|v| v as usize);
    let mut least = 9.0f32;
    for n in 0..27usize {
        let d = [n % 3, n / 3 % 3, n / 9];
        let cell = [0, 1, 2].map(|a| (base[a] + cells + d[a] - 1) % cells);
        let h = hash(cell[0], cell[1], cell[2], salt);
        let mut squared = 0.0;
        for a in 0..3 {
            let jitter = ((h >> (10 * a)) & 1023) as f32 / 1023.0;
            let away = base[a] as f32 + d[a] as f32 - 1.0 + jitter - q[a];
            squared += away * away;
        }
        least = least.min(squared);
    }
    1.0 - least.sqrt().min(1.0)
}

/// Gradient noise, about 0 to 1.
fn gradient(p: [f32; 3], cells: usize, salt: u32) -> f32 {
    let q = p.map(|v| v * cells as f32);
    let base = q.map(|v| v as usize);
    let f = [0, 1, 2].map(|a| q[a] - base[a] as f32);
    let s = f.map(|t| t * t * t * (t * (t * 6.0 - 15.0) + 10.0));
    let mut sum = 0.0;
    for n in 0..8usize {
        let d = [n & 1, n >> 1 & 1, n >> 2];
        let h = hash(
            (base[0] + d[0]) % cells,
            (base[1] + d[1]) % cells,
            (base[2] + d[2]) % cells,
            salt,
        );
        let mut dot = 0.0;
        let mut weight = 1.0;
        for a in 0..3 {
            let slope = ((h >> (10 * a)) & 1023) as f32 / 511.5 - 1.0;
            dot += slope * (f[a] - d[a] as f32);
            weight *= if d[a] == 1 { s[a] } else { 1.0 - s[a] };
        }
        sum += dot * weight;
    }
    0.5 + NOISE_GRADIENT_GAIN * sum
}
