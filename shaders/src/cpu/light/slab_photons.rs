//! Stage input of `slab_tables`: light through plane-parallel slabs, photon by photon and by sets of orders of scattering.
//!
//! Reads: a phase function ([`Scatterer`], the path tracer's), [`SlabCase`]. Writes: [`SlabStudy`]: for the light that will be scattered for the 2nd, 3rd, 4th, 5th to 6th, 7th to 9th, 10th to 15th
//! and 16th and further time, in [`DEPTHS`] layers: its fluence for a beam of unit irradiance across it, its mean direction, and how far from there it
//! came in, in the mean and spread; and what leaves the slab, by the same sets. Scheme: photons from the lit side, their first collision forced to be in the slab; every flight adds its length in each layer
//! (the track-length estimator: fluence is length a volume). Lengths are in mean free paths. No absorption. Order: none; unbiased, and the
//! standard errors come from [`BATCHES`] batches. The path tracer looks from a camera and gives radiance along a ray; photons from the sun
//! give all depths and all orders at once, which is what a table needs. Source: the study of Bouthors et al. (2008) as told by seed 000,
//! which followed paths back from each place and direction of view for weeks.
//!
//! What light does that was scattered once is known in closed form and is not sampled: the beam at depth d is exp(-d / mu0).

use rayon::prelude::*;

use super::path_tracer::Scatterer;
use super::path_tracer::sampler::{Random, turned};
use super::path_tracer::slab::Estimate;

/// Sets of orders.
pub const SETS: usize = 7;
/// First order of each set; the last has no end.
pub const SET_BEGINS: [u32; SETS] = [2, 3, 4, 5, 7, 10, 16];
/// Layers of a slab, thin at both sides: their edges are evenly far apart in the logarithm of (1 + depth) / (1 + thickness - depth).
pub const DEPTHS: usize = 14;
/// Batches that errors are judged by.
pub const BATCHES: usize = 16;
/// Sets of light that leaves: what was scattered once, then the sets.
pub const LEAVING: usize = SETS + 1;
/// Numbers of a layer and set: fluence; mean direction towards the beam's side over the beam's sine, and inwards; mean of Legendre's second polynomial of the cosine to the inward normal; distance to where it came in, sidewards, and its spread.
pub const NUMBERS: usize = 6;
/// Below this sine of the sun's zenith angle the mean direction is taken to be the beam's.
const SINE_LEAST: f64 = 0.05;

/// A slab and its sun.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlabCase {
    /// Optical depth from the lit side to the other.
    pub optical_depth: f64,
    /// Cosine between sun and normal.
    pub sun_cosine: f64,
}

/// What was found of a slab.
#[derive(Clone, Debug, PartialEq)]
pub struct SlabStudy {
    /// Photons followed.
    pub photons: u64,
    /// [`NUMBERS`] a set and layer, `[set][layer]`; where nothing came by, 0 all.
    pub layers: Vec<[Estimate; NUMBERS]>,
    /// Share of the flux that is sent back, by how often it was scattered: once, then [`SETS`].
    pub reflected: [Estimate; LEAVING],
    /// The same of what passes; what passes straight is not in it.
    pub transmitted: [Estimate; LEAVING],
}

/// The set of what is scattered for the `order`th time, 2 or more.
fn set_of(order: u32) -> usize {
    SET_BEGINS.iter().rposition(|begin| *begin <= order).unwrap_or(0)
}

/// Depths of the layers' edges.
pub fn edges(optical_depth: f64) -> [f64; DEPTHS + 1] {
    let mut edges = [0.0; DEPTHS + 1];
    for (k, edge) in edges.iter_mut().enumerate() {
        let ratio = (1.0 + optical_depth).powf(2.0 * k as f64 / DEPTHS as f64 - 1.0);
        *edge = (ratio * (1.0 + optical_depth) - 1.0) / (1.0 + ratio);
    }
    (edges[0], edges[DEPTHS]) = (0.0, optical_depth);
    edges
}

/// Sums of one batch: of lengths, lengths times direction (two), times Legendre's second polynomial, times place, and place squared (two).
#[derive(Clone)]
struct Sums {
    photons: u64,
    layers: Vec<[f64; 7]>,
    leaving: [[f64; LEAVING]; 2],
}

impl Sums {
    fn new() -> Sums {
        Sums {
            photons: 0,
            layers: vec![[0.0; 7]; SETS * DEPTHS],
            leaving: [[0.0; LEAVING]; 2],
        }
    }
    fn add(&mut self, other: &Sums) {
        self.photons += other.photons;
        for (to, from) in self.layers.iter_mut().zip(&other.layers) {
            to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
        }
        for (to, from) in self.leaving.iter_mut().flatten().zip(other.leaving.iter().flatten()) {
            *to += from;
        }
    }
    fn layer(&self, case: &SlabCase, n: usize, width: f64) -> [f64; NUMBERS] {
        let [track, across, inward, second, place, square_x, square_y] = self.layers[n];
        if track <= 0.0 {
            return [0.0; NUMBERS];
        }
        let sine = (1.0 - case.sun_cosine.powi(2)).max(0.0).sqrt();
        let inward = inward / track;
        let mean = place / track;
        let across = if sine < SINE_LEAST {
            inward / case.sun_cosine
        } else {
            across / (track * sine)
        };
        let spread = 0.5 * ((square_x / track - mean * mean).max(0.0) + square_y / track);
        let fluence = case.sun_cosine * track / (self.photons as f64 * width);
        [fluence, across, inward, second / track, mean, spread.sqrt()]
    }
}

/// Follows photons through a slab until they have made so many flights in all. `stream` tells random numbers of one study from those of another.
pub fn study(scatterer: &Scatterer, case: &SlabCase, stream: u64, flights: u64) -> SlabStudy {
    let edges = edges(case.optical_depth);
    let each = flights.div_ceil(BATCHES as u64);
    let batches: Vec<Sums> = (0..BATCHES as u64)
        .into_par_iter()
        .map(|n| batch(scatterer, case, &edges, Random::new(stream, n), each))
        .collect();
    let mut all = Sums::new();
    batches.iter().for_each(|b| all.add(b));
    let judged = |value: &dyn Fn(&Sums) -> f64| {
        let mean = value(&all);
        let square: f64 = batches.iter().map(|b| (value(b) - mean).powi(2)).sum();
        Estimate {
            mean,
            error: (square / ((BATCHES - 1) * BATCHES) as f64).sqrt(),
        }
    };
    let layers = (0..SETS * DEPTHS).map(|n| {
        let width = edges[n % DEPTHS + 1] - edges[n % DEPTHS];
        std::array::from_fn(|v| judged(&|sums| sums.layer(case, n, width)[v]))
    });
    let leaving = |side: usize| std::array::from_fn(|k| judged(&|sums| sums.leaving[side][k] / sums.photons as f64));
    SlabStudy {
        photons: all.photons,
        layers: layers.collect(),
        reflected: leaving(0),
        transmitted: leaving(1),
    }
}

fn batch(scatterer: &Scatterer, case: &SlabCase, edges: &[f64], mut random: Random, flights: u64) -> Sums {
    let mut sums = Sums::new();
    let beam = [(1.0 - case.sun_cosine.powi(2)).max(0.0).sqrt(), 0.0, case.sun_cosine];
    let slant = case.optical_depth / case.sun_cosine;
    let met = -(-slant).exp_m1();
    let mut made = 0;
    while made < flights {
        sums.photons += 1;
        // x along the beam's side, z inwards; the first collision is drawn from those within the slab.
        let first = (-(-random.next() * met).ln_1p()).min(slant);
        let mut at = beam.map(|v| v * first);
        let mut along = beam;
        let mut layer = edges[1..DEPTHS].partition_point(|edge| *edge <= at[2]);
        let mut scattered = 0;
        'walk: loop {
            along = turned(&along, scatterer.draw_cosine(&mut random), &mut random);
            scattered += 1;
            made += 1;
            let set = set_of(scattered + 1) * DEPTHS;
            let mut left = -(1.0 - random.next()).ln();
            loop {
                let edge = if along[2] > 0.0 { edges[layer + 1] } else { edges[layer] };
                let to_edge = if along[2] == 0.0 {
                    f64::INFINITY
                } else {
                    ((edge - at[2]) / along[2]).max(0.0)
                };
                let go = left.min(to_edge);
                let length = met * go;
                let middle = [at[0] + 0.5 * go * along[0], at[1] + 0.5 * go * along[1]];
                let sum = &mut sums.layers[set + layer];
                sum[0] += length;
                sum[1] += length * along[0];
                sum[2] += length * along[2];
                sum[3] += length * (1.5 * along[2] * along[2] - 0.5);
                sum[4] += length * middle[0];
                sum[5] += length * (middle[0].powi(2) + (go * along[0]).powi(2) / 12.0);
                sum[6] += length * (middle[1].powi(2) + (go * along[1]).powi(2) / 12.0);
                for a in 0..3 {
                    at[a] += go * along[a];
                }
                if left <= to_edge {
                    break;
                }
                left -= go;
                at[2] = edge;
                let down = along[2] > 0.0;
                if (down && layer + 1 == DEPTHS) || (!down && layer == 0) {
                    let order = if scattered == 1 { 0 } else { 1 + set_of(scattered) };
                    sums.leaving[usize::from(down)][order] += met;
                    break 'walk;
                }
                layer = if down { layer + 1 } else { layer - 1 };
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::light::phase_table::PhaseChoice;

    fn scatterer(asymmetry: f32) -> Scatterer {
        Scatterer::new(PhaseChoice::HenyeyGreenstein { asymmetry })
    }

    #[test]
    fn sets_are_those_of_the_seed() {
        let sets: Vec<usize> = (2..18).map(set_of).collect();
        assert_eq!(sets, [0, 1, 2, 3, 3, 4, 4, 4, 5, 5, 5, 5, 5, 5, 6, 6]);
    }

    /// Of light that isotropic scattering has turned once, fluence and what leaves are integrals that can be done: at the middle of a slab of depth 1 under a sun in the zenith,
    /// F(d) = 1/2 int exp(-s) E1(|d - s|) ds.
    #[test]
    fn light_scattered_once_is_as_the_integral_says() {
        let case = SlabCase {
            optical_depth: 1.0,
            sun_cosine: 1.0,
        };
        let found = study(&scatterer(0.0), &case, 1, 400_000);
        // 1 / 2 int mu / (1 + mu) (1 - exp(-(1 + 1/mu))) dmu, as the ladder's test has it, by the midpoint rule.
        let truth: f64 = (0..2000)
            .map(|i| (f64::from(i) + 0.5) / 2000.0)
            .map(|mu| 0.5 * mu / (1.0 + mu) * (1.0 - (-(1.0 + 1.0 / mu)).exp()) / 2000.0)
            .sum();
        let ours = found.reflected[0];
        assert!(
            (ours.mean - truth).abs() < 4.0 * ours.error && ours.error < 0.002,
            "{ours:?} {truth}"
        );
        let edges = edges(1.0);
        for layer in [0, 7, 13] {
            // E1 by its integral over cosines: int exp(-x / mu) / mu dmu; midpoint rules throughout.
            let (from, to) = (edges[layer], edges[layer + 1]);
            let mut truth = 0.0;
            for i in 0..40 {
                let d = from + (to - from) * (f64::from(i) + 0.5) / 40.0;
                for j in 0..400 {
                    let mu = (f64::from(j) + 0.5) / 400.0;
                    // int over s of exp(-s) exp(-|d - s| / mu) / mu, in closed form on both sides of d.
                    let above = ((-d).exp() - (-d / mu).exp()) / (1.0 - mu);
                    let below = ((-d).exp() - (-(1.0 + (1.0 - d) / mu)).exp()) / (1.0 + mu);
                    truth += 0.5 * (above + below) / (40.0 * 400.0);
                }
            }
            let ours = found.layers[layer][0];
            assert!(
                (ours.mean - truth).abs() < 4.0 * ours.error + 0.003 * truth && ours.error < 0.02 * truth,
                "{layer}: {ours:?} {truth}"
            );
        }
    }

    /// Nothing is lost and nothing made; mean directions are shorter than 1 and the entry lies upstream.
    #[test]
    fn all_that_comes_in_leaves() {
        for (asymmetry, optical_depth, sun_cosine) in [(0.0, 4.0, 0.5), (0.85, 16.0, 1.0), (0.9, 0.3, 0.125)] {
            let case = SlabCase {
                optical_depth,
                sun_cosine,
            };
            let found = study(&scatterer(asymmetry), &case, 7, 40_000);
            let leaves: f64 = found.reflected.iter().chain(&found.transmitted).map(|e| e.mean).sum();
            let straight = (-optical_depth / sun_cosine).exp();
            assert!((leaves + straight - 1.0).abs() < 1e-9, "{leaves} {straight}");
            let sine = (1.0 - sun_cosine * sun_cosine).sqrt();
            for layer in &found.layers {
                let [fluence, across, inward, ..] = layer.map(|e| e.mean);
                assert!(
                    fluence >= 0.0 && (across * sine).hypot(inward) <= 1.0 + 1e-9,
                    "{layer:?}"
                );
            }
        }
    }

    #[test]
    fn threads_change_no_bit() {
        let scatterer = scatterer(0.85);
        let case = SlabCase {
            optical_depth: 4.0,
            sun_cosine: 0.5,
        };
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| study(&scatterer, &case, 3, 20_000))
        };
        assert_eq!(run(1), run(3));
    }
}
