//! Stage input of `march`: how light is turned, as numbers that a ray looks up once.
//!
//! Reads: [`PhaseChoice`], [`Scattering`]. Writes: [`MarchPhase`]: of light that is scattered once the phase function in three colours at the nodes of [`PhaseTable`], and of each octave behind it
//! one function for all colours at [`PHASE_OCTAVE_NODES`] cosines equally far apart; 1/sr; linear between. Scheme: an octave's light was turned before, so that it sees a rounder function
//! (Wrenninge et al. 2013): a Henyey-Greenstein function's asymmetry times e^n. For any other function the same is a convolution over the sphere with
//! Henyey and Greenstein's function of asymmetry e^n: its Legendre moments times e^(n l), which are what is scaled in that one. Octaves carry
//! the weights that they are summed with. Where light diffuses the octaves are [`super::diffusion_shares::forward_octaves`]. The march scales their sum by [`super::octave_shares`] or
//! [`super::diffusion_shares`], which follow the two tables.
//!
//! `multiple_forward` takes the function without its chopped peak, unscaled: light within the peak goes on (seed 002, seed 004), so that what is left integrates to less than 1.

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
                .map(|n| 1.0 - 2.0 * n as f64 / (PHASE_OCTAVE_NODES - 1) as f64)
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
        let place = (1.0 - mu).clamp(0.0, 2.0) * (0.5 * (PHASE_OCTAVE_NODES - 1) as f32);
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
