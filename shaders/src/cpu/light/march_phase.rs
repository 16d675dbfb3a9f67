//! Stage input of `march`: how light is turned, as numbers that a ray looks up once.
//!
//! Reads: [`PhaseChoice`], [`Scattering`]. Writes: [`MarchPhase`]: of light that is scattered once the phase function in three colours at the nodes of [`PhaseTable`], and of each octave behind it
//! one function for all colours at [`PHASE_OCTAVE_NODES`] sines of half the angle equally far apart, which are densest towards the sun; 1/sr; linear between. Scheme: an octave's light was turned before, so that it sees a rounder function
//! (Wrenninge et al. 2013): a Henyey-Greenstein function's asymmetry times e^n. For any other function the same is a convolution over the sphere with
//! Henyey and Greenstein's function of asymmetry e^n: its Legendre moments times e^(n l), which are what is scaled in that one. Octaves carry
//! the weights that they are summed with. Where light diffuses the octaves are [`super::diffusion_shares::forward_octaves`]. The march scales their sum by [`super::octave_shares`] or
//! [`super::diffusion_shares`], which follow the two tables.
//!
//! `multiple_forward` takes the function without its chopped peak, unscaled: light within the peak goes on (seed 002, seed 004), so that what is left integrates to less than 1.
//!
//! That is the limit of what both seeds step through. Let F be the share of scattering that stays within the peak, and count light within it as the beam's. A cell of optical
//! depth t lets exp(-t) of its light I pass and adds what it scatters on, F t I (seed 002's equation 8, all extinction being scattering): I_k+1 = (F t + exp(-t)) I_k. Through N cells of t = tau / N that is
//!
//! ```text
//! (F t + exp(-t))^N = exp(-(1 - F) tau + tau^2 / (2 N) F (2 - F) + ...) -> exp(-(1 - F) tau).
//! ```
//!
//! Seed 004's voxels hold L(D) = I0 T(0, D) + the integral over l of F beta(l) L(l) T(l, D); its derivative by D is L' = -(1 - F) beta L, and the same limit follows; summed over voxels the error's first term is
//! -tau^2 / (2 N) F^2. Both overdo or lack light at first order in the cell's depth, so the march takes the limit: the depth towards the sun times 1 - F, one exponential, no cells.
//! In the eye's direction a place scatters what the function without its peak gives, for the peak's light is in the beam already.
//!
//! What is in print needs mending for that. 002: its tau is an extinction in equations 5 and 6 and a depth from 7 on; the product in 7 runs over the cell itself, in 8 it ends before it; g_k has
//! p / (4 pi), right for the phase function of equation 3, whose integral is 4 pi, and too little by 4 pi for that of 4, whose integral is 1; and the solid angle that p is to be integrated over, which makes p the share F, has been lost.
//! 004: equation 5.3 has T(0, l), which dims what is scattered at l by the cloud before it and not by the cloud behind it, T(l, D); C(l) in 5.4 lacks both the light at l and the extinction there, without which 5.5 (which lacks the step's length too) grows with the
//! number of steps; and gamma / (4 pi) is there once too often, for the half that stays within gamma is the share F itself: as printed it is 4e-6.

use super::diffusion_shares::{diffusion_shares, forward_octaves};
use super::octave_shares::{OCTAVE_SHARE_NODES, octave_shares};
use super::phase_table::{PHASE_HALF_NODES, PHASE_NODES, PhaseChoice, PhaseTable, chopped, node_cosine, ordered};
use crate::cpu::view::march::{OCTAVE_CONTRIBUTION, OCTAVE_ECCENTRICITY, OCTAVES_MAX};
use crate::view::Scattering;

crate::constants! {
    /// Nodes of an octave.
    pub const PHASE_OCTAVE_NODES: usize = 128;
    /// Nodes of each half of the first function.
    pub const PHASE_FIRST_HALF: usize = PHASE_HALF_NODES;
    /// The quad that the factors begin at.
    pub const PHASE_SHARES_FIRST: usize = PHASE_NODES + (OCTAVES_MAX + 1) * PHASE_OCTAVE_NODES / 4;
    /// Numbers, four at a time: nodes of the first function as red, green, blue and nothing; then four nodes of an octave in each, from the one that falls as the beam does; then the factors.
    pub const PHASE_QUADS: usize = PHASE_SHARES_FIRST + OCTAVE_SHARE_NODES * OCTAVE_SHARE_NODES / 4 + 1;
}
/// Legendre moments that octaves are made of: 0.75^40 is 1e-5.
pub(super) const MOMENTS: usize = 41;
/// Points and weights of Gauss and Legendre's rule of three on 0 to 1.
pub(super) const GAUSS: [[f64; 2]; 3] = [
    [0.112_701_665_379_258_3, 5.0 / 18.0],
    [0.5, 8.0 / 18.0],
    [0.887_298_334_620_741_7, 5.0 / 18.0],
];

/// See the module.
#[derive(Clone, Debug, PartialEq)]
pub struct MarchPhase {
    /// [`PHASE_QUADS`] of them.
    pub quads: Vec<[f32; 4]>,
    /// Factor on the optical depth towards the sun: 1, or less where part of the scattered light goes on.
    pub depth_scale: f32,
    /// Mean cosine, the mean of the colours.
    pub asymmetry: f32,
}

impl MarchPhase {
    /// Makes the numbers for so many octaves; some milliseconds, for Mie some tenths of a second.
    pub fn new(choice: PhaseChoice, scattering: Scattering, octaves: usize) -> MarchPhase {
        let table = PhaseTable::new(choice);
        let mut first = table.colours.clone();
        let mut depth_scale = 1.0;
        if scattering == Scattering::MultipleForward {
            depth_scale = 1.0 - table.peak_share();
            // Each colour keeps its own peak's share, the light its mean.
            for values in &mut first {
                let mut rest = chopped(values).into_iter();
                if let Some(rest) = rest.next() {
                    *values = rest;
                }
            }
        }
        let mean: Vec<f64> = (0..PHASE_NODES)
            .map(|n| table.colours.iter().map(|c| c[n]).sum::<f64>() / 3.0)
            .collect();
        let moments = moments(&mean);
        let asymmetry = moments[1] as f32;
        let mut quads: Vec<[f32; 4]> = (0..PHASE_NODES)
            .map(|n| [first[0][n] as f32, first[1][n] as f32, first[2][n] as f32, 0.0])
            .collect();
        let octaves = octaves.min(OCTAVES_MAX);
        // The octave that falls as the beam does, and those behind it.
        let mut rounder = vec![[0.0; MOMENTS]; OCTAVES_MAX + 1];
        if scattering == Scattering::Diffusion {
            let forward = forward_octaves(asymmetry);
            rounder[..forward.len()].copy_from_slice(&forward);
        } else {
            for (octave, rounded) in rounder.iter_mut().enumerate().skip(1) {
                let weight = f64::from(OCTAVE_CONTRIBUTION).powi(octave as i32);
                let eccentricity = f64::from(OCTAVE_ECCENTRICITY).powi(octave as i32);
                for (l, (to, moment)) in rounded.iter_mut().zip(moments).enumerate() {
                    *to = weight * eccentricity.powi(l as i32) * moment;
                }
            }
        }
        // What goes about the beam's way is a sum in which single terms may be negative; an octave is light.
        let least = if scattering == Scattering::Diffusion {
            f64::MIN
        } else {
            0.0
        };
        for rounded in &rounder {
            let values: Vec<f32> = (0..PHASE_OCTAVE_NODES)
                .map(|n| 1.0 - 2.0 * (n as f64 / (PHASE_OCTAVE_NODES - 1) as f64).powi(2))
                .map(|mu| of_moments(rounded, mu).max(least) as f32)
                .collect();
            quads.extend(values.chunks_exact(4).map(|v| [v[0], v[1], v[2], v[3]]));
        }
        let mut shares = match scattering {
            Scattering::Diffusion => diffusion_shares(&moments, asymmetry),
            Scattering::Octaves => octave_shares(&moments, &rounder[1..=octaves]),
            _ => Vec::new(),
        };
        shares.resize(4 * (PHASE_QUADS - PHASE_SHARES_FIRST), 0.0);
        quads.extend(shares.chunks_exact(4).map(|v| [v[0], v[1], v[2], v[3]]));
        MarchPhase {
            quads,
            depth_scale: depth_scale as f32,
            asymmetry,
        }
    }

    /// Its numbers as a GPU is given them.
    pub fn bytes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.quads)
    }

    /// Light scattered once at the angle whose cosine is `mu`, three colours, 1/sr.
    #[inline(always)]
    pub(crate) fn first(&self, mu: f32) -> [f32; 3] {
        let last = (PHASE_FIRST_HALF - 1) as f32;
        let (start, place) = if mu >= 0.0 {
            (0, (1.0 - mu).max(0.0).sqrt().sqrt() * last)
        } else {
            (PHASE_FIRST_HALF, (1.0 + mu).max(0.0).sqrt() * last)
        };
        let n = (place as usize).min(PHASE_FIRST_HALF - 2);
        let share = place - n as f32;
        let (a, b) = (&self.quads[start + n], &self.quads[start + n + 1]);
        [
            a[0] + (b[0] - a[0]) * share,
            a[1] + (b[1] - a[1]) * share,
            a[2] + (b[2] - a[2]) * share,
        ]
    }

    /// The same of an octave, 0 to [`OCTAVES_MAX`], with its weight.
    #[inline(always)]
    pub(crate) fn octave(&self, octave: usize, mu: f32) -> f32 {
        let place = (0.5 * (1.0 - mu)).clamp(0.0, 1.0).sqrt() * (PHASE_OCTAVE_NODES - 1) as f32;
        let n = (place as usize).min(PHASE_OCTAVE_NODES - 2);
        let share = place - n as f32;
        let at = |n: usize| {
            let n = octave * PHASE_OCTAVE_NODES + n;
            self.quads[PHASE_NODES + n / 4][n % 4]
        };
        at(n) + (at(n + 1) - at(n)) * share
    }

    /// Factors on light behind the first scattering, laid out as [`super::octave_shares`] says.
    pub(crate) fn level_shares(&self) -> &[f32] {
        self.quads[PHASE_SHARES_FIRST..].as_flattened()
    }
}

/// Legendre moments of a function at the nodes, linear in the cosine between; the first is its integral over the sphere.
fn moments(values: &[f64]) -> [f64; MOMENTS] {
    let mut moments = [0.0; MOMENTS];
    let nodes: Vec<[f64; 2]> = ordered().map(|n| [node_cosine(n), values[n]]).collect();
    for pair in nodes.windows(2) {
        let [[mu0, p0], [mu1, p1]] = [pair[0], pair[1]];
        for [place, weight] in GAUSS {
            let mu = mu0 + (mu1 - mu0) * place;
            let value = (p0 + (p1 - p0) * place) * weight * (mu0 - mu1) * 2.0 * std::f64::consts::PI;
            for (moment, legendre) in moments.iter_mut().zip(legendre(mu)) {
                *moment += value * legendre;
            }
        }
    }
    moments
}

/// A function of these moments, 1/sr.
fn of_moments(moments: &[f64; MOMENTS], mu: f64) -> f64 {
    let terms = moments.iter().zip(legendre(mu)).enumerate();
    terms
        .map(|(l, (moment, legendre))| (2 * l + 1) as f64 * moment * legendre)
        .sum::<f64>()
        / (4.0 * std::f64::consts::PI)
}

/// Legendre's polynomials at `mu`.
pub(super) fn legendre(mu: f64) -> [f64; MOMENTS] {
    let mut p = [1.0; MOMENTS];
    p[1] = mu;
    for l in 2..MOMENTS {
        let n = l as f64;
        p[l] = ((2.0 * n - 1.0) * mu * p[l - 1] - (n - 1.0) * p[l - 2]) / n;
    }
    p
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seed 002's recurrence and seed 004's sum, corrected as the module says, stepped through more and more cells: both tend to what the march
    /// does in one go, the sun's light behind `depth_scale` times the optical depth, with errors that halve with the cells.
    #[test]
    fn forward_scattering_stepped_through_cells_tends_to_the_closed_form() {
        for choice in [
            PhaseChoice::HenyeyGreenstein { asymmetry: 0.85 },
            PhaseChoice::Droplets { diameter_um: 18.0 },
            PhaseChoice::HenyeyGreenstein { asymmetry: 0.98 },
        ] {
            let phase = MarchPhase::new(choice, Scattering::MultipleForward, 0);
            let table = PhaseTable::new(choice);
            // What the peak holds, from the function itself; the march's factor is one less that, in 32 bits.
            let [_, peak] = chopped(&table.colours[1]);
            let share = moments(&peak)[0];
            assert!(
                (share - (1.0 - f64::from(phase.depth_scale))).abs() < 1e-6,
                "{choice:?}: {share}"
            );
            for depth in [0.5, 4.0] {
                let closed = (-depth * (1.0 - share)).exp();
                let errors = [512, 1024, 2048].map(|cells| {
                    let cell = depth / f64::from(cells);
                    let passes = (-cell).exp();
                    // 002: what the last cell let through, and what it scattered on.
                    let stepped = (0..cells).fold(1.0, |light, _| share * cell * light + passes * light);
                    // 004: for each voxel the sum over all that are nearer the sun, each with the light that it stores, seen through what lies between.
                    let mut voxels: Vec<f64> = Vec::new();
                    for v in 0..=cells {
                        let between = |l: usize| (-cell * (f64::from(v) - l as f64)).exp();
                        let scattered = voxels
                            .iter()
                            .enumerate()
                            .map(|(l, light)| share * light * between(l) * cell);
                        voxels.push(between(0) + scattered.sum::<f64>());
                    }
                    let stored = voxels.pop().unwrap_or(0.0);
                    [stepped, stored].map(|light| (light / closed).ln())
                });
                for way in 0..2 {
                    for pair in errors.windows(2) {
                        let order = (pair[0][way] / pair[1][way]).log2();
                        assert!((order - 1.0).abs() < 0.02, "{choice:?}, {depth}, {way}: order {order}");
                    }
                }
                // Their first terms: tau^2 / (2 cells) times F (2 - F) and -F^2.
                let first = depth * depth / (2.0 * 2048.0);
                let wanted = [first * share * (2.0 - share), -first * share * share];
                for (error, wanted) in errors[2].iter().zip(wanted) {
                    assert!(
                        (error / wanted - 1.0).abs() < 0.02,
                        "{choice:?}, {depth}: {error} {wanted}"
                    );
                }
            }
        }
    }

    /// Between nodes too an octave is the function of its moments: within 3 % of it and 0.3 % of its largest value, at every angle (what goes about the beam's way passes through 0).
    #[test]
    fn an_octave_is_looked_up_as_its_moments_have_it() {
        for (scattering, asymmetry) in [Scattering::Octaves, Scattering::Diffusion]
            .into_iter()
            .flat_map(|scattering| [0.0, 0.5, 0.86, 0.94].map(|g| (scattering, g)))
        {
            let phase = MarchPhase::new(PhaseChoice::HenyeyGreenstein { asymmetry }, scattering, OCTAVES_MAX);
            let table = PhaseTable::new(PhaseChoice::HenyeyGreenstein { asymmetry });
            let moments = moments(&table.colours[1]);
            let weight = f64::from(OCTAVE_CONTRIBUTION);
            let eccentricity = f64::from(OCTAVE_ECCENTRICITY);
            let exact = if scattering == Scattering::Diffusion {
                forward_octaves(phase.asymmetry)[0]
            } else {
                std::array::from_fn(|l| weight * eccentricity.powi(l as i32) * moments[l])
            };
            let octave = usize::from(scattering == Scattering::Octaves);
            let cosines = (0..=1800).map(|tenth| (f64::from(tenth) / 10.0).to_radians().cos());
            let wanted: Vec<f64> = cosines.clone().map(|mu| of_moments(&exact, mu)).collect();
            let most = wanted.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
            for (n, (mu, wanted)) in cosines.zip(wanted).enumerate() {
                let seen = f64::from(phase.octave(octave, mu as f32));
                assert!(
                    (seen - wanted).abs() <= 0.03 * wanted.abs() + 0.003 * most,
                    "{scattering:?}, asymmetry {asymmetry}, {n} tenths of a degree: {seen} {wanted}"
                );
            }
        }
    }

    /// Nothing is made or lost: what goes on with the beam and what the function without its peak turns away are all that is scattered.
    #[test]
    fn the_chopped_function_turns_away_what_the_peak_does_not_carry_on() {
        for choice in [
            PhaseChoice::HenyeyGreenstein { asymmetry: 0.85 },
            PhaseChoice::HenyeyGreenstein { asymmetry: 0.999 },
            PhaseChoice::Mie {
                effective_radius_um: 9.0,
            },
        ] {
            let phase = MarchPhase::new(choice, Scattering::MultipleForward, 0);
            let turned: f64 = (0..3)
                .map(|c| {
                    let first: Vec<f64> = phase.quads[..PHASE_NODES].iter().map(|q| f64::from(q[c])).collect();
                    moments(&first)[0] / 3.0
                })
                .sum();
            // The numbers are kept in 32 bits.
            assert!(
                (turned - f64::from(phase.depth_scale)).abs() < 1e-5,
                "{choice:?}: {turned} {}",
                phase.depth_scale
            );
            assert!(phase.depth_scale < 0.97, "{choice:?}: no peak to speak of");
        }
    }
}
