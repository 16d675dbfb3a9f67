//! Stage input of `march`: light in plane-parallel slabs, by sets of orders of scattering, from tables of our own Monte Carlo study ([`super::slab_photons`]).
//!
//! Reads: the kept tables (`data/slab-tables.bin`, written by `welkin tables`), the phase function's asymmetry. Writes: [`SlabSources`]: for three groups of orders (2 to 4, 5 to 15, 16 and more)
//! what light a place scatters, by the slab's thickness, the place's depth and the sun's cosine. Scheme: light of a set is taken to be Henyey and Greenstein's about its mean direction m:
//! turned once more by a function of asymmetry g it has the mean direction g m, and F times Henyey and Greenstein's function of asymmetry |g m| about m is what a unit of extinction
//! scatters (F the fluence). That is exact for light turned by Henyey and Greenstein's function alone, and for any in sum over directions and in the mean direction. Axes: thickness times 1 - g in octaves,
//! the logarithm of (1 + depth) / (1 + thickness - depth), the sun's cosine, asymmetry; between nodes the root of a group's fluence is linear, which lies between a share that falls exponentially and one that falls evenly. Slabs thicker than the last node keep the light of both sides and their
//! own share of depth between; thinner ones than the first have light in proportion.
//!
//! Keeps: what leaves a slab, up and down, is what came in: each node's light is scaled so that it is (a test integrates it, between nodes too). Its errors: sixteen layers; asymmetries from 0 to 0.9, others are taken as the nearest.
//!
//! A file: two lines of text, the second a JSON object that says how it was made, then six bytes a node, `[asymmetry][sun][thickness][set][layer]`: log2 of the fluence
//! (16 bits, little endian), the mean direction's two numbers (1/127 each), logarithms of the distance to where light came in and of its spread.

use std::ops::Range;
use std::sync::OnceLock;

use rayon::prelude::*;

use super::march_phase::MOMENTS;
use super::octave_shares::{cosines, leaves, lost, turned};
use super::slab_photons::{DEPTHS, NUMBERS, SETS, SlabCase, SlabStudy};
use crate::cpu::view::lanes::{Indices, LANES, Lanes, log2};
use crate::cpu::view::shape::trilinear;

/// Asymmetries of the study.
pub const ASYMMETRIES: [f64; 4] = [0.0, 0.6, 0.85, 0.9];
/// Thicknesses of the study, an octave apart.
pub const THICKNESSES: usize = 12;
/// The least of them, optical depth times 1 - g.
pub const TRANSPORT_LEAST: f64 = 0.0375;
/// Cosines of the sun, evenly far apart from 1 / [`SUNS`] to 1.
pub const SUNS: usize = 8;
/// Slabs of the study.
pub const CASES: usize = ASYMMETRIES.len() * SUNS * THICKNESSES;
/// First line of a file.
const MAGIC: &str = "welkin slab tables 1\n";
/// Bytes of a slab.
pub const CASE_BYTES: usize = SETS * DEPTHS * LAYER_BYTES;
/// Bytes of a set's layer.
const LAYER_BYTES: usize = 7;
/// Groups of sets that are looked up together, the first set of each and the end.
pub const GROUPS: usize = 3;
/// Layers that a slab's light is summed in.
const ENERGY_LAYERS: usize = 16;
/// The largest factor that keeps energy, and one over the least.
const ENERGY_FACTOR_MOST: f64 = 1.3;
const GROUP_BEGINS: [usize; GROUPS + 1] = [0, 3, 6, 7];
/// Thicknesses in the program's memory: those of the study and one between each two, half an octave apart.
const FINER: usize = 2 * THICKNESSES - 1;
/// Nodes of a group.
const NODES: usize = SUNS * FINER * DEPTHS;
/// Exponent and steps an octave of fluences and of lengths.
const FLUENCE_OCTAVE: f64 = 2048.0;
const FLUENCE_LEAST: f64 = -24.0;
/// Steps a unit of moments and of roots of fluences, in the program's memory.
const MOMENT_CODE: f64 = 32_767.5;
const ROOT_CODE: f64 = 16_383.0;
const ROOT_STEP: f32 = (1.0 / ROOT_CODE) as f32;
const MOMENT_STEP: f32 = (1.0 / MOMENT_CODE) as f32;
const LENGTH_OCTAVE: f64 = 16.0;
const LENGTH_LEAST: f64 = -6.0;
/// Sides of slabs beyond the tables: what is no deeper than this from either is looked up as it is.
const SIDE_DEPTH: f32 = 24.0;
/// Mean directions are no longer.
const DIRECTION_MAX: f32 = 0.97;

static KEPT: &[u8] = include_bytes!("../../../data/slab-tables.bin");

/// The asymmetry of slab `n` of the study, and the slab.
pub fn case(n: usize) -> (f64, SlabCase) {
    let (asymmetry, sun, thickness) = (
        ASYMMETRIES[n / (SUNS * THICKNESSES) % ASYMMETRIES.len()],
        n / THICKNESSES % SUNS,
        n % THICKNESSES,
    );
    let slab = SlabCase {
        optical_depth: TRANSPORT_LEAST / (1.0 - asymmetry) * f64::from(1u32 << thickness),
        sun_cosine: (sun + 1) as f64 / SUNS as f64,
    };
    (asymmetry, slab)
}

/// A slab's bytes.
pub fn encode_case(study: &SlabStudy) -> Vec<u8> {
    let log = |v: f64, least: f64, octave: f64, most: f64| {
        let place = (v.max(1e-30).log2() - least) * octave;
        place.round().clamp(0.0, most)
    };
    let share = |v: f64| ((v.clamp(-1.0, 1.0) + 1.0) * 127.0).round() as u8;
    let layers = study.layers.iter().flat_map(|layer| {
        let [fluence, across, inward, second, place, spread] = layer.map(|e| e.mean);
        let fluence = log(fluence, FLUENCE_LEAST, FLUENCE_OCTAVE, 65_535.0) as u16;
        let [low, high] = fluence.to_le_bytes();
        let length = |v: f64| log(v, LENGTH_LEAST, LENGTH_OCTAVE, 255.0) as u8;
        [
            low,
            high,
            share(across),
            share(inward),
            share(second),
            length(place),
            length(spread),
        ]
    });
    layers.collect()
}

/// A file of all slabs' bytes in order; `provenance` is one line of JSON.
pub fn encode(provenance: &str, cases: &[Vec<u8>]) -> Vec<u8> {
    let mut file = format!("{MAGIC}{}\n", provenance.replace('\n', " ")).into_bytes();
    file.extend(cases.iter().flatten());
    file
}

/// A study's tables.
#[derive(Clone, Debug)]
pub struct SlabTables<'a> {
    /// One line of JSON: how they were made.
    pub provenance: &'a str,
    bytes: &'a [u8],
}

impl<'a> SlabTables<'a> {
    /// Reads a file; none where it is not whole or not of this kind.
    pub fn read(file: &'a [u8]) -> Option<SlabTables<'a>> {
        let rest = file.strip_prefix(MAGIC.as_bytes())?;
        let end = rest.iter().position(|b| *b == b'\n')?;
        let provenance = std::str::from_utf8(&rest[..end]).ok()?;
        let bytes = &rest[end + 1..];
        (bytes.len() == CASES * CASE_BYTES).then_some(SlabTables { provenance, bytes })
    }

    /// Those of the program; none where its data is damaged, which a test rules out.
    pub fn kept() -> Option<&'static SlabTables<'static>> {
        static TABLES: OnceLock<Option<SlabTables<'static>>> = OnceLock::new();
        TABLES.get_or_init(|| SlabTables::read(KEPT)).as_ref()
    }

    /// Bytes of slab `n`.
    pub fn case_bytes(&self, n: usize) -> &'a [u8] {
        &self.bytes[n * CASE_BYTES..][..CASE_BYTES]
    }

    /// Numbers of slab `n`, set and layer; the first as its log2.
    pub fn numbers(&self, n: usize, set: usize, layer: usize) -> [f64; NUMBERS] {
        let b = &self.case_bytes(n)[(set * DEPTHS + layer) * LAYER_BYTES..][..LAYER_BYTES];
        let share = |v: u8| f64::from(v) / 127.0 - 1.0;
        let length = |v: u8| (f64::from(v) / LENGTH_OCTAVE + LENGTH_LEAST).exp2();
        [
            f64::from(u16::from_le_bytes([b[0], b[1]])) / FLUENCE_OCTAVE + FLUENCE_LEAST,
            share(b[2]),
            share(b[3]),
            share(b[4]),
            length(b[5]),
            length(b[6]),
        ]
    }
}

/// See the module.
#[derive(Clone, Debug)]
pub struct SlabSources {
    /// `[group][sun][thickness][layer]`: root of the fluence and the mean direction inwards (16 bits each).
    words: Vec<u32>,
    /// The same nodes: the mean direction across and the second moment (16 bits each).
    turns: Vec<u32>,
    /// The same nodes: log2 of the distance to where light came in and of its spread, in steps of 1/16 (16 bits each).
    collectors: Vec<u32>,
    /// Of the phase function, bounded to that of the tables.
    pub asymmetry: f32,
}

/// A slab fitted to sixteen places, and where they are in it, in optical depths.
#[derive(Clone, Copy, Debug)]
pub struct Fitted {
    /// From the lit side to the other.
    pub thickness: Lanes,
    /// From the lit side, 0 to the thickness.
    pub depth: Lanes,
    /// Cosine between sun and normal.
    pub sun_cosine: Lanes,
}

/// Light of one group at sixteen places.
#[derive(Clone, Copy, Debug)]
pub struct GroupLight {
    /// Fluence over the beam's irradiance.
    pub fluence: Lanes,
    /// Mean direction: towards the beam's side over the beam's sine, and inwards.
    pub across: Lanes,
    /// See `across`.
    pub inward: Lanes,
    /// Mean of Legendre's second polynomial of the cosine to the inward normal.
    pub second: Lanes,
}

/// Nodes and fractions of a lookup, and the factor of slabs thinner than any of the study.
#[derive(Clone, Copy, Debug)]
struct Place {
    index: Indices,
    fractions: [Lanes; 3],
    thin: Lanes,
}

/// Numbers of a thickness, a root of fluence and means, half an octave from one to the next; `of_case` gives those of the study. Between four of them the fluence to the power 3/4 and the fluence
/// times the means are a cubic: a line between roots loses a tenth of the light.
fn between(finer: usize, of_case: &dyn Fn(usize) -> [f64; 6]) -> [f64; 6] {
    let below = finer / 2;
    if finer.is_multiple_of(2) {
        return of_case(below);
    }
    let (near, far) = (of_case(below), of_case(below + 1));
    let fluence = |v: f64| (v * v).powf(0.75);
    let middle = 0.5 * (fluence(near[0]) + fluence(far[0]));
    let bent = if below > 0 && below + 2 < THICKNESSES {
        let outer = fluence(of_case(below - 1)[0]) + fluence(of_case(below + 2)[0]);
        1.125 * middle - outer / 16.0
    } else {
        middle
    };
    let weights = [near[0] * near[0], far[0] * far[0]];
    let all = (weights[0] + weights[1]).max(1e-30);
    let mut means: [f64; 6] = std::array::from_fn(|v| (weights[0] * near[v] + weights[1] * far[v]) / all);
    means[0] = bent.max(0.0).powf(2.0 / 3.0);
    means
}

impl SlabSources {
    /// For light that is turned with this mean cosine, of the program's own tables; none where they are damaged.
    pub fn kept(asymmetry: f32) -> Option<SlabSources> {
        SlabTables::kept().map(|tables| SlabSources::new(tables, asymmetry))
    }
    /// For light that is turned with this mean cosine. Takes a quarter of a second of a core.
    pub fn new(tables: &SlabTables<'_>, asymmetry: f32) -> SlabSources {
        let last = ASYMMETRIES.len() - 1;
        let asymmetry = f64::from(if asymmetry.is_finite() { asymmetry } else { 0.0 });
        let asymmetry = asymmetry.clamp(ASYMMETRIES[0], ASYMMETRIES[last]);
        let above = ASYMMETRIES.partition_point(|g| *g <= asymmetry).clamp(1, last);
        let share = (asymmetry - ASYMMETRIES[above - 1]) / (ASYMMETRIES[above] - ASYMMETRIES[above - 1]);
        let mut words = Vec::with_capacity(GROUPS * NODES);
        let mut turns = Vec::with_capacity(GROUPS * NODES);
        let mut collectors = Vec::with_capacity(GROUPS * NODES);
        for sets in GROUP_BEGINS.windows(2) {
            for node in 0..NODES {
                let (column, layer) = (node / DEPTHS, node % DEPTHS);
                let (sun, finer) = (column / FINER, column % FINER);
                // The root of a group's fluence, and the means of its sets by their fluence: three moments, place, its square with the spread's.
                let of_case = |asymmetry: usize, thickness: usize| {
                    let mut sums = [0.0f64; 6];
                    for set in sets[0]..sets[1] {
                        let n = (asymmetry * SUNS + sun) * THICKNESSES + thickness;
                        let [log, across, inward, second, place, spread] = tables.numbers(n, set, layer);
                        let square = place * place + spread * spread;
                        for (sum, v) in sums.iter_mut().zip([1.0, across, inward, second, place, square]) {
                            *sum += log.exp2() * v;
                        }
                    }
                    let fluence = sums[0];
                    let mut means = sums.map(|v| v / fluence);
                    means[0] = fluence.sqrt();
                    means
                };
                let of_group = |asymmetry: usize| between(finer, &|thickness| of_case(asymmetry, thickness));
                let (near, far) = (of_group(above - 1), of_group(above));
                let mut numbers: [f64; NUMBERS] = std::array::from_fn(|v| near[v] + (far[v] - near[v]) * share);
                // Light itself is what is in proportion between asymmetries: a line between roots loses some.
                numbers[0] = (near[0] * near[0] * (1.0 - share) + far[0] * far[0] * share).sqrt();
                let [root, across, inward, second, place, square] = numbers;
                let code = |v: f64| ((v.clamp(-1.0, 1.0) + 1.0) * MOMENT_CODE).round() as u32;
                words.push((root * ROOT_CODE).round().clamp(0.0, 65_535.0) as u32 | code(inward) << 16);
                turns.push(code(across) | code(second) << 16);
                let spread = (square - place * place).max(0.0).sqrt();
                let length = |v: f64| {
                    let code = (v.max(1e-6).log2() - LENGTH_LEAST) * FLUENCE_OCTAVE;
                    code.round().clamp(0.0, 65_535.0) as u32
                };
                collectors.push(length(place) | length(spread) << 16);
            }
        }
        let mut sources = SlabSources {
            words,
            turns,
            collectors,
            asymmetry: asymmetry as f32,
        };
        sources.keep_energy();
        sources
    }

    /// Scales the light of each sun and thickness by what makes a slab give back what came in: sixteen layers, looked up on straight lines between them, bring 0.96 to 1.04 of it by themselves.
    fn keep_energy(&mut self) {
        let asymmetry = f64::from(self.asymmetry);
        let moments: [f64; MOMENTS] = std::array::from_fn(|l| asymmetry.powi(l as i32));
        let factors: Vec<f64> = (0..SUNS * FINER)
            .into_par_iter()
            .map(|column| {
                let sun = (column / FINER + 1) as f64 / SUNS as f64;
                let depth = TRANSPORT_LEAST / (1.0 - asymmetry) * 2.0f64.powf((column % FINER) as f64 / 2.0);
                let left = lost(depth, sun) - leaves(depth, 1.0 / sun, depth, &turned(&moments, sun));
                (left / self.brought(depth as f32, sun as f32)).clamp(1.0 / ENERGY_FACTOR_MOST, ENERGY_FACTOR_MOST)
            })
            .collect();
        for (node, word) in self.words.iter_mut().enumerate() {
            let factor = factors[node % NODES / DEPTHS].sqrt();
            let root = f64::from(*word & 0xffff) * factor;
            *word = root.round().min(65_535.0) as u32 | *word & 0xffff_0000;
        }
    }

    /// Flux through both faces of a level slab of light of all groups, over the beam's irradiance.
    fn brought(&self, optical_depth: f32, sun_cosine: f32) -> f64 {
        let sine = (1.0 - sun_cosine * sun_cosine).max(0.0).sqrt();
        // Faces of the layers, thin ones at both sides.
        let face = |n: usize| {
            let ratio = (1.0 + optical_depth).powf(2.0 * n as f32 / ENERGY_LAYERS as f32 - 1.0);
            (ratio * (1.0 + optical_depth) - 1.0) / (1.0 + ratio)
        };
        let mut flux = 0.0;
        for layer in 0..ENERGY_LAYERS {
            let (from, to) = (face(layer), face(layer + 1));
            let slab = Fitted {
                thickness: Lanes::splat(optical_depth),
                depth: Lanes::splat(0.5 * (from + to)),
                sun_cosine: Lanes::splat(sun_cosine),
            };
            for [cosine, weight] in cosines() {
                let flat = (1.0 - cosine * cosine).sqrt() as f32 * sine;
                let across = Lanes::from_fn(|l| ((l as f32 + 0.5) * std::f32::consts::PI / LANES as f32).cos() * flat);
                // Upwards through the lit side, downwards through the other.
                for (inward, near, far) in [(-cosine, from, to), (cosine, optical_depth - to, optical_depth - from)] {
                    let light = self.towards(&slab, 0..GROUPS, Lanes::splat(inward as f32), across);
                    let mean = light.0.iter().map(|v| f64::from(*v)).sum::<f64>() / LANES as f64;
                    let out = (-f64::from(near) / cosine).exp() - (-f64::from(far) / cosine).exp();
                    flux += 2.0 * std::f64::consts::PI * weight * cosine * mean * out;
                }
            }
        }
        flux
    }

    #[inline(always)]
    fn place(&self, slab: &Fitted) -> Place {
        let one = Lanes::splat(1.0);
        let least = (TRANSPORT_LEAST / (1.0 - f64::from(self.asymmetry))) as f32;
        let most = least * (1u32 << (THICKNESSES - 1)) as f32;
        let thickness = slab.thickness.max(Lanes::splat(1e-6));
        let octave = thickness.min(Lanes::splat(most)) * (1.0 / least);
        // Beyond the tables both sides stay as they are, and what is deeper keeps its share of the depth.
        let shrink = (Lanes::splat(most) / thickness).min(one);
        let inside = thickness * shrink;
        let side = Lanes::splat(SIDE_DEPTH);
        let depth = slab.depth.max(Lanes::splat(0.0)).min(thickness);
        let left = thickness - depth;
        let depth = (depth * shrink).max(depth.min(side)).min(inside - left.min(side));
        let left = inside - depth;
        let (mut at_octave, mut layer) = (octave, depth);
        for l in 0..LANES {
            at_octave.0[l] = log2(octave.0[l]);
            // Of a thin slab 1 + x would lose x.
            layer.0[l] = if inside.0[l] < 1e-3 {
                depth.0[l] / inside.0[l]
            } else {
                0.5 + 0.5 * log2((1.0 + depth.0[l]) / (1.0 + left.0[l])) / log2(1.0 + inside.0[l])
            };
        }
        let (k, fk) = (layer * DEPTHS as f32 - 0.5).clamp(0.0, DEPTHS as f32 - 1.001).split();
        let (t, ft) = (at_octave * 2.0).clamp(0.0, FINER as f32 - 1.001).split();
        let (s, fs) = (slab.sun_cosine * SUNS as f32 - 1.0)
            .clamp(0.0, SUNS as f32 - 1.001)
            .split();
        let mut index = k;
        for l in 0..LANES {
            index.0[l] = (s.0[l] * FINER as u32 + t.0[l]) * DEPTHS as u32 + k.0[l];
        }
        Place {
            index,
            fractions: [fk, ft, fs],
            thin: octave.min(one),
        }
    }

    #[inline(always)]
    fn corners(&self, words: &[u32], place: &Place, group: usize) -> [Indices; 8] {
        let first = (group * NODES) as u32;
        let thickness = DEPTHS as u32;
        let sun = thickness * FINER as u32;
        let offsets = [
            0,
            1,
            thickness,
            thickness + 1,
            sun,
            sun + 1,
            sun + thickness,
            sun + thickness + 1,
        ];
        let mut corners = [place.index; 8];
        for n in 0..8 {
            corners[n] = place.index.plus(first + offsets[n]).gather(words);
        }
        corners
    }

    #[inline(always)]
    fn group(&self, place: &Place, group: usize) -> GroupLight {
        let corners = self.corners(&self.words, place, group);
        let f = &place.fractions;
        let root = trilinear(&corners, 0, 0xffff, f) * ROOT_STEP;
        let inward = trilinear(&corners, 16, 0xffff, f) * MOMENT_STEP - 1.0;
        let corners = self.corners(&self.turns, place, group);
        GroupLight {
            fluence: root * root * place.thin,
            across: trilinear(&corners, 0, 0xffff, f) * MOMENT_STEP - 1.0,
            inward,
            second: trilinear(&corners, 16, 0xffff, f) * MOMENT_STEP - 1.0,
        }
    }

    /// How far from sixteen places the light of a group came in, in optical depths along the lit side: towards where the beam comes from, in the mean, and its spread.
    #[inline(always)]
    pub fn collector(&self, slab: &Fitted, group: usize) -> [Lanes; 2] {
        let place = self.place(slab);
        let corners = self.corners(&self.collectors, &place, group);
        let length = [0, 16].map(|shift| {
            trilinear(&corners, shift, 0xffff, &place.fractions) * (1.0 / FLUENCE_OCTAVE as f32) + LENGTH_LEAST as f32
        });
        [length[0].exp2(), length[1].exp2()]
    }

    /// What a unit of extinction scatters of these groups of orders (from 2 on), over the irradiance of the sun's beam, 1/sr, towards the direction that has these parts along
    /// the slab's inward normal and along the beam's own part across it (its length the beam's sine).
    #[inline(always)]
    pub(crate) fn towards(&self, slab: &Fitted, groups: Range<usize>, inward: Lanes, across: Lanes) -> Lanes {
        let place = self.place(slab);
        let sine_square = (Lanes::splat(1.0) - slab.sun_cosine * slab.sun_cosine).max(Lanes::splat(0.0));
        let mut sum = Lanes::splat(0.0);
        let second = 1.25 / std::f32::consts::PI * self.asymmetry * self.asymmetry;
        for group in groups {
            let light = self.group(&place, group);
            let square = light.across * light.across * sine_square + light.inward * light.inward;
            let along = light.across * across + light.inward * inward;
            // The lobe's own second moment about the normal, by the addition theorem: 3/2 of the inward part's square less half the whole's.
            let own = light.inward * light.inward * 1.5 - square * 0.5;
            let more = (light.second - own) * (inward * inward * 1.5 - 0.5) * second;
            sum = sum + light.fluence * (lobe(self.asymmetry, square, along) + more).max(Lanes::splat(0.0));
        }
        sum
    }
}

/// Henyey and Greenstein's function, 1/sr, of light that has this square of its mean direction's length and this part of it along the direction asked for, turned once more with the mean cosine `asymmetry`.
#[inline(always)]
pub(crate) fn lobe(asymmetry: f32, square: Lanes, along: Lanes) -> Lanes {
    let most = asymmetry * DIRECTION_MAX;
    let one = Lanes::splat(1.0);
    let square = (square * (asymmetry * asymmetry)).min(Lanes::splat(most * most));
    let length = square.sqrt();
    let along = (along * asymmetry).min(length).max(Lanes::splat(0.0) - length);
    let d = (one + square - along * 2.0).max(Lanes::splat(1e-4));
    (one - square) * (0.25 / std::f32::consts::PI) / (d * d.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The cosine below which this share of Henyey and Greenstein's function lies.
    fn cosine_of(g: f32, share: f32) -> f32 {
        if g < 1e-3 {
            return 2.0 * share - 1.0;
        }
        let s = (1.0 - g * g) / (1.0 - g + 2.0 * g * share);
        (1.0 + g * g - s * s) / (2.0 * g)
    }

    /// What a slab under these sources sends up and down and lets straight through, the first order by Henyey and Greenstein's own function.
    fn all_that_leaves(sources: &SlabSources, optical_depth: f32, sun_cosine: f32) -> [f64; 3] {
        let g = sources.asymmetry;
        let sine = (1.0 - sun_cosine * sun_cosine).sqrt();
        let mut leaves = [0.0; 3];
        leaves[2] = f64::from((-optical_depth / sun_cosine).exp() * sun_cosine);
        // Layers that get thin at both sides, cosines, azimuths.
        let (layers, cosines, around) = (160, 12, 16);
        for i in 0..layers {
            let edge = |n: usize| {
                let ratio = (1.0 + optical_depth).powf(2.0 * n as f32 / layers as f32 - 1.0);
                (ratio * (1.0 + optical_depth) - 1.0) / (1.0 + ratio)
            };
            let (from, to) = (edge(i), edge(i + 1));
            let depth = 0.5 * (from + to);
            // What was scattered once, in directions drawn evenly from the function.
            let beam = (-depth / sun_cosine).exp() * (to - from);
            for j in 0..400 {
                let mu = cosine_of(g, (j as f32 + 0.5) / 400.0);
                let azimuth = j as f32 * 2.399_963;
                let inward = mu * sun_cosine + (1.0 - mu * mu).max(0.0).sqrt() * sine * azimuth.cos();
                let way = if inward < 0.0 { depth } else { optical_depth - depth };
                leaves[usize::from(inward > 0.0)] += f64::from(beam * (-way / inward.abs()).exp() / 400.0);
            }
            let slab = Fitted {
                thickness: Lanes::splat(optical_depth),
                depth: Lanes::splat(depth),
                sun_cosine: Lanes::splat(sun_cosine),
            };
            for j in 0..2 * cosines {
                let inward = (j as f32 + 0.5) / cosines as f32 - 1.0;
                let way = if inward < 0.0 { depth } else { optical_depth - depth };
                // The share of the layer's light that gets out, whose flux is that times the solid angle.
                let out = (-way / inward.abs()).exp() * (to - from) / cosines as f32;
                let across = Lanes::from_fn(|l| {
                    let azimuth = (l as f32 + 0.5) * std::f32::consts::TAU / around as f32;
                    (1.0 - inward * inward).sqrt() * azimuth.cos()
                });
                let more = sources.towards(&slab, 0..GROUPS, Lanes::splat(inward), across * sine);
                let sum: f32 = more.0.iter().sum();
                leaves[usize::from(inward > 0.0)] += f64::from(sum / around as f32 * std::f32::consts::TAU * out);
            }
        }
        leaves.map(|v| v / f64::from(sun_cosine))
    }

    /// Nothing is made and little is lost: at nodes of the tables a hundredth, between asymmetries and thicknesses up to four.
    #[test]
    fn what_comes_in_leaves_at_nodes_and_between_them() {
        let tables = SlabTables::kept().unwrap();
        for asymmetry in [0.0, 0.3, 0.75, 0.85, 0.87] {
            let sources = SlabSources::new(tables, asymmetry);
            for optical_depth in [0.1, 1.0, 5.5, 16.0, 90.0, 3000.0] {
                for sun_cosine in [0.3, 0.5, 0.8, 1.0] {
                    let shares = all_that_leaves(&sources, optical_depth, sun_cosine);
                    let all: f64 = shares.iter().sum();
                    let what = format!("g {asymmetry}, depth {optical_depth}, mu0 {sun_cosine}: {shares:?}, {all}");
                    assert!(all > 0.95 && all < 1.045, "{what}");
                    println!("{what}");
                }
            }
        }
    }

    #[test]
    fn hard_numbers_give_light_in_bounds() {
        let tables = SlabTables::kept().unwrap();
        for asymmetry in [f32::NAN, -1.0, 0.0, 0.85, 0.999, 1.0] {
            let sources = SlabSources::new(tables, asymmetry);
            for (thickness, depth) in [
                (0.0, 0.0),
                (1e-6, 1e-6),
                (1e-6, 5.0),
                (3.0, -1.0),
                (1e4, 5e3),
                (1e30, 1e30),
            ] {
                for sun_cosine in [0.0, 0.125, 1.0] {
                    let slab = Fitted {
                        thickness: Lanes::splat(thickness),
                        depth: Lanes::splat(depth),
                        sun_cosine: Lanes::splat(sun_cosine),
                    };
                    let inward = Lanes::from_fn(|l| l as f32 / 7.5 - 1.0);
                    let light = sources.towards(&slab, 0..GROUPS, inward, Lanes::splat(0.0));
                    // A lobe of asymmetry 0.9 is 30 straight ahead, of light no more than some beams.
                    assert!(
                        light.0.iter().all(|v| (0.0..60.0).contains(v)),
                        "{asymmetry} {slab:?}: {light:?}"
                    );
                    let none = thickness < 1e-5;
                    assert!(
                        !none || light.0.iter().all(|v| *v < 1e-3),
                        "{asymmetry} {slab:?}: {light:?}"
                    );
                }
            }
        }
    }

    /// Light of few orders came in where the beam did, upstream by the depth times the sun's tangent; light of many came from farther around.
    #[test]
    fn collectors_lie_upstream_and_widen_with_order_and_depth() {
        let sources = SlabSources::new(SlabTables::kept().unwrap(), 0.85);
        let at = |depth: f32, group: usize| {
            let slab = Fitted {
                thickness: Lanes::splat(32.0),
                depth: Lanes::splat(depth),
                sun_cosine: Lanes::splat(0.5),
            };
            sources.collector(&slab, group).map(|v| v.0[0])
        };
        let tangent = 3f32.sqrt();
        let [place, spread] = at(2.0, 0);
        assert!((place / (2.0 * tangent) - 1.0).abs() < 0.4, "{place} {spread}");
        for depth in [1.0, 4.0, 16.0] {
            let spreads = [0, 1, 2].map(|group| at(depth, group)[1]);
            assert!(
                spreads[0] < spreads[1] && spreads[1] < spreads[2],
                "{depth}: {spreads:?}"
            );
        }
        assert!(at(1.0, 0)[1] < at(6.0, 0)[1] && at(4.0, 2)[1] > 4.0);
    }

    #[test]
    fn a_file_that_is_not_whole_is_refused() {
        assert!(SlabTables::read(KEPT).is_some());
        assert!(SlabTables::read(&KEPT[..KEPT.len() - 1]).is_none());
        assert!(SlabTables::read(&KEPT[1..]).is_none());
        assert!(SlabTables::read(b"").is_none());
    }
}
