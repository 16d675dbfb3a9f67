//! Part of stage `diffusion`: the light that clouds send each other.
//!
//! Reads: extinction that diffuse light meets, 1/m, in the slab's cells, and what all of them are given. Writes: the fluence of light between the clouds, one number. Scheme: [`super::diffusion`] lets what leaves a
//! cloud be lost. Light that is even around a cloud without absorption is as strong inside it, whatever its shape, so that the light between clouds, taken as even, is a number added to the fluence
//! everywhere. It follows from a balance. Of what a cloud's surface sends out, the share p meets no other cloud; the rest does and is sent out again. With P given to all, the surface S and the fluence f (an even one brings a
//! surface a quarter of itself), (P + f S / 4) (1 - p) = f S / 4. Both p and S follow from straight lines through the slab: by Cauchy's formula a line enters cloud as often as a quarter of the surface says, and what
//! meets no other cloud leaves through top or bottom. With h the share of lines that meet cloud, and n how often they do, both means over directions weighted by the cosine to the vertical: p = h / n, S = 2 n A, A the
//! slab's area, and f = 2 (P / A) (1 - p) / h, since P leaves upwards and downwards. A line's meeting with a cloud that lets t through counts 1 - t, as diffuse light sees it. Lines: one from the middle of each cell of
//! the lowest level, at two angles (Gauss's two nodes over the cosine) and four azimuths; the cells nearest to them, one a level.
//!
//! Keeps: energy, as far as the clouds' light is even between them: with p of what surfaces send out leaving, all that was given leaves. A cloud alone, if no line meets it twice, gets nothing. Light scattered once or about the beam's way that meets
//! another cloud, and what the ground sends back of it, is left out. Source: a balance of radiosity; Cauchy's formula (1841).
//!
//! Floor of the cost: eight lines a column of 48 levels, 1.6 million cells of 4 bytes from the second-level cache: half a millisecond; with the exponentials some 60 cycles of 16 lanes a cell, 1.5 ms of a core.

use multiversion::multiversion;

use crate::cpu::view::lanes::{LANES, Lanes};

crate::constants! {
    /// Cosines of the lines to the vertical.
    const LINE_STEEP: f32 = 0.788_675_1;
    const LINE_FLAT: f32 = 0.211_324_87;
}

/// What the lines from one row of columns meet, in all: weighted by the cosine, the share of them that meets cloud, and how often they do.
pub(super) type Meetings = [f64; 2];

/// The lines from row `j` of the lowest level.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
pub(super) fn meetings(transport: &[f32], cells: [usize; 3], size_m: [f32; 3], j: usize) -> Meetings {
    let [nx, ny, nz] = cells;
    let (zero, one) = (Lanes::splat(0.0), Lanes::splat(1.0));
    let mut sums = [0.0; 2];
    for cosine in [LINE_STEEP, LINE_FLAT] {
        let path_m = size_m[2] / cosine;
        let sideways_m = (1.0 - cosine * cosine).sqrt() * path_m;
        for way in 0..4 {
            // East, west, north, south.
            let across = sideways_m / size_m[way / 2];
            let along = |k: usize, count: usize| {
                let by = (across * k as f32 + 0.5) as usize % count;
                if way % 2 == 0 { by } else { count - by }
            };
            for first in (0..nx).step_by(LANES) {
                let count = LANES.min(nx - first);
                let (mut whole, mut own, mut met) = (zero, zero, zero);
                for k in 0..nz {
                    let east = if way < 2 { (first + along(k, nx)) % nx } else { first };
                    let row = if way < 2 { j } else { (j + along(k, ny)) % ny };
                    let row = &transport[(k * ny + row) * nx..][..nx];
                    let mut here = zero;
                    for l in 0..count {
                        let i = east + l;
                        here.0[l] = row[if i < nx { i } else { i - nx }];
                    }
                    let out = Lanes::select_less(zero, here, zero, own);
                    if out.any_above(0.0) {
                        met = met + one - (zero - out).exp();
                        own = own - out;
                    }
                    whole = whole + here * path_m;
                    own = own + here * path_m;
                }
                met = met + one - (zero - own).exp();
                let hit = one - (zero - whole).exp();
                for l in 0..count {
                    sums[0] += f64::from(cosine * hit.0[l]);
                    sums[1] += f64::from(cosine * met.0[l]);
                }
            }
        }
    }
    sums
}

/// The fluence between clouds of which the cells are `given` so much in all, m2, by what the lines from all rows met.
pub(super) fn between_clouds(rows: &[Meetings], cells: [usize; 3], size_m: [f32; 3], given_m2: f64) -> f32 {
    // Four azimuths; the cosines add up to 1.
    let lines = (4 * cells[0] * cells[1]) as f64;
    let [hit, met] = [0, 1].map(|n| rows.iter().map(|row| row[n]).sum::<f64>() / lines);
    let area_m2 = (cells[0] * cells[1]) as f64 * f64::from(size_m[0] * size_m[1]);
    let again = (1.0 - hit / met.max(1e-9)).max(0.0);
    if hit > 0.0 {
        (2.0 * given_m2 / area_m2 * again / hit) as f32
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CELLS: [usize; 3] = [40, 40, 12];
    const SIZE_M: [f32; 3] = [100.0, 100.0, 50.0];

    fn of(cloud: impl Fn(usize, usize, usize) -> bool) -> f32 {
        let [nx, ny, nz] = CELLS;
        let transport: Vec<f32> = (0..nx * ny * nz)
            .map(|n| {
                if cloud(n % nx, n / nx % ny, n / (nx * ny)) {
                    1.0
                } else {
                    0.0
                }
            })
            .collect();
        let rows: Vec<Meetings> = (0..ny).map(|j| meetings(&transport, CELLS, SIZE_M, j)).collect();
        between_clouds(&rows, CELLS, SIZE_M, 16.0e6)
    }

    /// A deck sends nothing to itself, nor does a lone column of cloud but through the period; two decks send each other what they send inwards.
    #[test]
    fn decks_and_lone_clouds() {
        assert!(of(|_, _, k| (3..6).contains(&k)) < 1e-5);
        assert!(of(|_, _, _| false) < 1e-9);
        let lone = of(|i, j, k| (18..22).contains(&i) && (18..22).contains(&j) && (4..8).contains(&k));
        assert!(lone < 0.01, "{lone}");
        // Every line meets both: h = 1, n = 2, p = 1/2, f = P / A. Between the decks light is even, and of what each sends inwards, P / 2 a deck, all comes back: 2 f / 4 is what both get.
        let two = of(|_, _, k| !(2..=9).contains(&k));
        assert!((two - 1.0).abs() < 1e-4, "{two}");
    }
}
