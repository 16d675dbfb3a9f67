//! Stage input of `march`: how strong the octaves behind the first may be, so that they make no light and lose none.
//!
//! Reads: Legendre moments of the phase function and of each octave's, with its weight. Writes: factors on the sum of octaves, `[sun][passage]`: the cosine of the angle between the sun and the
//! vertical, and the share of diffuse light that passes the cloud from top to bottom (a b / (a + b - a b) of the shares a and b that a place in it sees of sky and ground: resistances in
//! series), both from 0 to 1 in even steps. Scheme: a level slab of the optical depth t that lets so much
//! pass takes mu (1 - e^(-t / mu)) out of the beam. What is scattered once, and by each octave, leaves through its faces with e^(-s / nu) of the path s along the vertical in every
//! direction nu: both integrals over s are closed, those over nu are Gauss and Legendre's, over the azimuth by the moments. The factor makes the octaves bring what
//! the first scattering leaves of what the beam has lost.
//!
//! Where a place lies as far behind the cloud's surface upwards as a level cloud would have it, the cosine is the sun's. Behind a side that the sun shines on more is above it than that: the cosine
//! goes a share of the way to the ratio of the optical depths upwards and towards the sun.
//!
//! Keeps: in a level slab all that came in, whatever its depth and the sun's height, between the nodes to some parts in a hundred. Other clouds get what a slab gets
//! that lets as much diffuse light pass: near the edge of a cloud that ends sideways that is too much, on sides under a low sun too little; what clouds bring as a whole [`super::octave_balance`] puts right. As Wrenninge et al. (2013) give them, weights alone, octaves bring thin cloud up to three and a half
//! times what came in (a depth of 1 under a sun of cosine 0.1) and thick cloud a third. Only [`OCTAVE_SHARE_MOST`] bounds the factor: few octaves of the forward peak cannot turn back all light.
//!
//! [`super::diffusion_shares`] goes through the same slabs and suns, and the march looks both kinds of factors up alike.

use super::march_phase::{GAUSS, MOMENTS, legendre};
use super::sky_visibility::{DIFFUSE_VISIBILITY, SLANT_PATH};
use super::sun_optical_depth::SUN_MARCH_DEEP;
use crate::cpu::view::lanes::{LANES, Lanes};

crate::constants! {
    /// Nodes of each of the two variables.
    pub const OCTAVE_SHARE_NODES: usize = 17;
    /// The largest factor.
    pub const OCTAVE_SHARE_MOST: f32 = 8.0;
    /// What the stage `sky_visibility` makes of an optical depth along the vertical, 1 / (1 + r t), for its one vertical and four slanted ways together.
    pub const LEVEL_RESISTANCE: f32 = 0.149;
    /// Optical depth that is added to both of those whose ratio is the cosine: at the surface both are 0.
    pub const LEVEL_DEPTH: f32 = 0.3;
    /// Optical depth towards the sun from which on the cloud is taken as level, and over which it comes to be: depths are followed to [`SUN_MARCH_DEEP`] alone.
    pub const LEVEL_FROM: f32 = 45.0;
    /// See [`LEVEL_FROM`].
    pub const LEVEL_OVER: f32 = 10.0;
    /// How far the cosine goes from the sun's own towards the ratio: what gave the least error by a low sun.
    pub const TURNED_SHARE: f32 = 0.2;
}
/// Slabs that let less pass are taken as this one.
const PASSAGE_LEAST: f64 = 0.004;
/// Slabs that let more pass are taken as this one.
const PASSAGE_MOST: f64 = 0.999;
/// A lower sun is taken as one of this cosine.
const SUN_LEAST: f64 = 0.02;
/// Parts of the range of cosines that light leaves by, each of three nodes.
const PARTS: usize = 6;

/// Means over the azimuth of a phase function, 1/sr, for light of one sun that is turned upwards and downwards to each of [`cosines`].
pub(super) type Turned = [[f64; 2]; 3 * PARTS];

/// The optical depth of a slab that lets the share `passage` of diffuse light pass, by the stage `sky_visibility`'s one vertical and four slanted ways.
fn slab_depth(passage: f64) -> f64 {
    let (a, b) = (
        f64::from(DIFFUSE_VISIBILITY),
        f64::from(DIFFUSE_VISIBILITY * SLANT_PATH),
    );
    // 0.2 / (1 + a t) + 0.8 / (1 + b t) = passage.
    let (square, linear, rest) = (passage * a * b, passage * (a + b) - 0.2 * b - 0.8 * a, passage - 1.0);
    ((linear * linear - 4.0 * square * rest).sqrt() - linear) / (2.0 * square)
}

/// Share of a flux through a slab's faces, of light that is turned by these moments, where the beam falls as e^(-`slope` s) with the vertical depth s down to the depth `followed`, and is
/// the same from there on.
pub(super) fn leaves(depth: f64, slope: f64, followed: f64, turned: &Turned) -> f64 {
    let (bend, rest) = (depth.min(followed), (depth - followed).max(0.0));
    let still = (-slope * bend).exp();
    let mut flux = 0.0;
    for ([cosine, weight], [up, down]) in cosines().zip(turned) {
        let back = slope + 1.0 / cosine;
        let onward = 1.0 / cosine - slope;
        let over_rest = -(-rest / cosine).exp_m1() * cosine * still;
        let above = -(-bend * back).exp_m1() / back + over_rest * (-bend / cosine).exp();
        let to_bend = if (onward * bend).abs() < 1e-6 {
            bend * still
        } else {
            (still - (-bend / cosine).exp()) / onward
        };
        flux += weight * (up * above + down * (to_bend * (-rest / cosine).exp() + over_rest));
    }
    flux * 2.0 * std::f64::consts::PI
}

/// Cosines that light leaves by, with weights.
pub(super) fn cosines() -> impl Iterator<Item = [f64; 2]> {
    (0..PARTS)
        .flat_map(|part| GAUSS.map(|[place, weight]| [(part as f64 + place) / PARTS as f64, weight / PARTS as f64]))
}

/// Means over the azimuth of a function of these moments, 1/sr, for light that a sun of cosine `sun` turns upwards and downwards.
pub(super) fn turned(moments: &[f64; MOMENTS], sun: f64) -> Turned {
    let of_sun = legendre(sun);
    let mut values = [[0.0; 2]; 3 * PARTS];
    for (value, [cosine, _]) in values.iter_mut().zip(cosines()) {
        for (l, (own, (moment, sun))) in legendre(cosine).iter().zip(moments.iter().zip(of_sun)).enumerate() {
            let term = (2 * l + 1) as f64 * moment * own * sun / (4.0 * std::f64::consts::PI);
            value[0] += if l % 2 == 0 { term } else { -term };
            value[1] += term;
        }
    }
    values
}

/// The factors; see the module. `octaves` with their weights.
pub fn octave_shares(first: &[f64; MOMENTS], octaves: &[[f64; MOMENTS]]) -> Vec<f32> {
    let turns = |sun: f64| {
        let again: Vec<Turned> = octaves.iter().map(|moments| turned(moments, sun)).collect();
        (turned(first, sun), again)
    };
    by_level_slabs(turns, |(once, again), sun, depth, followed| {
        let left = lost(depth, sun) - leaves(depth, 1.0 / sun, followed, once);
        let brought = again
            .iter()
            .zip(1..)
            .map(|(turned, octave)| leaves(depth, 0.5f64.powi(octave) / sun, followed, turned));
        (left / brought.sum::<f64>()).clamp(0.0, f64::from(OCTAVE_SHARE_MOST))
    })
}

/// What a level slab of this depth takes out of the beam.
pub(super) fn lost(depth: f64, sun: f64) -> f64 {
    -sun * (-depth / sun).exp_m1()
}

/// A factor for each of the slabs; `turns` is made once for a sun, `factor` of it, the sun, the slab's depth and how deep depths are followed.
pub(super) fn by_level_slabs<T>(turns: impl Fn(f64) -> T, factor: impl Fn(&T, f64, f64, f64) -> f64) -> Vec<f32> {
    let last = (OCTAVE_SHARE_NODES - 1) as f64;
    let mut shares = Vec::with_capacity(OCTAVE_SHARE_NODES * OCTAVE_SHARE_NODES);
    for sun in 0..OCTAVE_SHARE_NODES {
        let sun = (sun as f64 / last).max(SUN_LEAST);
        let turns = turns(sun);
        for passage in 0..OCTAVE_SHARE_NODES {
            let depth = slab_depth((passage as f64 / last).clamp(PASSAGE_LEAST, PASSAGE_MOST));
            shares.push(factor(&turns, sun, depth, f64::from(SUN_MARCH_DEEP) * sun) as f32);
        }
    }
    shares
}

/// Share of diffuse light that passes the cloud from top to bottom where the shares `sky` and `ground` of it come from above and from below: resistances in series.
#[inline(always)]
pub(crate) fn passage(sky: Lanes, ground: Lanes) -> Lanes {
    sky * ground / (sky + ground - sky * ground).max(Lanes::splat(1e-6))
}

/// Factor on light behind the first scattering at places `depth` behind the cloud's surface towards the sun, where the share `sky` of diffuse light comes from above and the share `passage` passes the cloud; see the module.
#[inline(always)]
pub(crate) fn level_share(shares: &[f32], sun: f32, depth: Lanes, sky: Lanes, passage: Lanes) -> Lanes {
    let last = (OCTAVE_SHARE_NODES - 1) as f32;
    let one = Lanes::splat(1.0);
    let above = (one / sky.max(Lanes::splat(1e-3)) - 1.0) * (1.0 / LEVEL_RESISTANCE);
    let cosine = ((above + LEVEL_DEPTH * sun) / (depth + LEVEL_DEPTH)).clamp(sun, 1.0);
    let known = ((Lanes::splat(LEVEL_FROM) - depth) * (TURNED_SHARE / LEVEL_OVER)).clamp(0.0, TURNED_SHARE);
    let cosine = (cosine - sun) * known + sun;
    let (row, between) = (cosine * last).clamp(0.0, last - 1e-3).split();
    let (node, rest) = (passage * last).clamp(0.0, last - 1e-3).split();
    let mut at = node;
    for l in 0..LANES {
        at.0[l] += row.0[l] * OCTAVE_SHARE_NODES as u32;
    }
    let look = |offset: u32| at.plus(offset).gather_f32(shares);
    let next = OCTAVE_SHARE_NODES as u32;
    look(0)
        .lerp(look(1), rest)
        .lerp(look(next).lerp(look(next + 1), rest), between)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slabs_are_as_deep_as_what_passes_them_tells() {
        for depth in [0.1, 1.0, 30.0, 400.0] {
            let (a, b) = (
                f64::from(DIFFUSE_VISIBILITY),
                f64::from(DIFFUSE_VISIBILITY * SLANT_PATH),
            );
            let passage = 0.2 / (1.0 + a * depth) + 0.8 / (1.0 + b * depth);
            assert!((slab_depth(passage) / depth - 1.0).abs() < 1e-6, "{depth}");
        }
    }

    /// Light turned evenly once in a thin slab: half of it leaves up, half down; nothing is left for octaves but what meets the slab again.
    #[test]
    fn thin_slabs_leave_nothing_to_octaves() {
        let mut even = [0.0; MOMENTS];
        even[0] = 1.0;
        let (depth, sun) = (1e-3, 0.7);
        let out = leaves(depth, 1.0 / sun, 60.0, &turned(&even, sun));
        let lost = -sun * (-depth / sun).exp_m1();
        assert!((out / lost - 1.0).abs() < 0.01, "{}", out / lost);
    }
}
