//! Stage input of `march`: light that goes about the beam's way where [`super::diffusion`] computes what diffuses, and how strong both may be, so that level cloud gives back what came in.
//!
//! Reads: Legendre moments of the phase function and its asymmetry g. Writes: [`forward_octaves`], functions of the turn (1/sr) that are summed with e^(-t / 2^n) of the optical depth t towards
//! the sun, n from 0; [`diffusion_shares`], factors on all light behind the first scattering, laid out as [`super::octave_shares`]'s.
//!
//! Scheme: light turned again and again by Henyey and Greenstein's function of asymmetry g spreads: its moment of degree l falls as e^(-(1 - g^l) t) (Goudsmit and Saunderson 1940), less what was
//! not turned yet, e^(-t). Each rate is shared between the two octaves around it. The moments 0 and 1 fall as fast as what is no longer about the beam's way is lost: by similarity 1 - g, by the
//! delta-Eddington split (Joseph, Wiscombe and Weinman 1976) 1 - g^2, of which the first draws slabs best and the second clouds that end sideways; it is the mean of both. The factors are
//! what the stage's equations give in a level slab, in 64 bits, on cells that are finer towards its faces; what leaves is summed as the march does, with the bounds of the flux.
//!
//! Keeps: in a level slab all that came in, where grid and steps are fine enough. Without the factors thin slabs lose up to a sixth (diffuse light that leaves at once is not met again by a ray),
//! and a low sun's gain as much. An asymmetry above 0.94 spreads as one of 0.94.

use super::diffusion::{DIFFUSION_SURFACE_RESISTANCE, FLUX_INWARD, FLUX_OUTWARD, similarity};
use super::march_phase::MOMENTS;
use super::octave_shares::{by_level_slabs, cosines, leaves, lost, turned};

/// Octaves of the light that goes about the beam's way.
pub(crate) const FORWARD_OCTAVES: usize = 4;
/// Cells of a slab.
const CELLS: usize = 160;
/// The largest factor: thin slabs would ask for more, of light that hardly is.
const DIFFUSION_SHARE_MOST: f64 = 1.5;

/// Octaves of the light that goes about the beam's way, as Legendre moments: the one of e^(-t) first. See the module.
pub fn forward_octaves(asymmetry: f32) -> [[f64; MOMENTS]; FORWARD_OCTAVES + 1] {
    let s = f64::from(similarity(asymmetry));
    let mut octaves = [[0.0; MOMENTS]; FORWARD_OCTAVES + 1];
    for l in 0..MOMENTS {
        let moment = (1.0 - s).powi(l as i32);
        // What falls as e^(-rate t) is between two octaves.
        let rate = if l < 2 {
            s * (1.0 + 0.5 * (1.0 - s))
        } else {
            1.0 - moment
        };
        let place = (-rate.log2()).clamp(0.0, FORWARD_OCTAVES as f64 - 1e-9);
        let (octave, rest) = (place as usize, place.fract());
        octaves[octave][l] += moment * (1.0 - rest);
        octaves[octave + 1][l] += moment * rest;
        octaves[0][l] -= moment;
    }
    octaves
}

/// The factors; see the module.
pub fn diffusion_shares(first: &[f64; MOMENTS], asymmetry: f32) -> Vec<f32> {
    let s = f64::from(similarity(asymmetry));
    let octaves = forward_octaves(asymmetry);
    let turns = |sun: f64| (turned(first, sun), octaves.map(|octave| turned(&octave, sun)));
    by_level_slabs(turns, |(once, octaves), sun, depth, followed| {
        let left = lost(depth, sun) - leaves(depth, 1.0 / sun, followed, once);
        let onward = octaves
            .iter()
            .zip(0..)
            .map(|(turned, octave)| leaves(depth, 0.5f64.powi(octave) / sun, followed, turned));
        let brought = onward.sum::<f64>() + diffuse_leaves(depth, sun, followed, s);
        (left / brought).clamp(0.0, DIFFUSION_SHARE_MOST)
    })
}

/// Share of a flux that leaves a slab's faces of what has diffused.
fn diffuse_leaves(depth: f64, sun: f64, followed: f64, s: f64) -> f64 {
    // Faces of the cells.
    let faces: Vec<f64> = (0..=CELLS)
        .map(|n| depth * 0.5 * (1.0 - (std::f64::consts::PI * n as f64 / CELLS as f64).cos()))
        .collect();
    let resistance = f64::from(DIFFUSION_SURFACE_RESISTANCE);
    let half = |n: usize| 1.5 * s * (faces[n + 1] - faces[n]);
    let through = |n: usize| {
        1.0 / (if n == 0 { resistance } else { half(n - 1) } + if n == CELLS { resistance } else { half(n) })
    };
    // Thomas' algorithm from the top; the outside has nothing.
    let (mut ratio, mut fluence) = ([0.0; CELLS], [0.0; CELLS]);
    for n in 0..CELLS {
        let [from, to] = [faces[n], faces[n + 1]].map(|t| sun * (-s * t.min(followed) / sun).exp());
        let (above, below) = (through(n), through(n + 1));
        let before = if n == 0 {
            [0.0; 2]
        } else {
            [ratio[n - 1], fluence[n - 1]]
        };
        let diagonal = above + below - above * before[0];
        ratio[n] = below / diagonal;
        fluence[n] = (from - to + above * before[1]) / diagonal;
    }
    for n in (0..CELLS - 1).rev() {
        fluence[n] += ratio[n] * fluence[n + 1];
    }
    // At faces, by the neighbours or the surface.
    let at = |face: usize| match face {
        0 => fluence[0] * through(0) * resistance,
        CELLS => fluence[CELLS - 1] * through(CELLS) * resistance,
        _ => (fluence[face - 1] * half(face) + fluence[face] * half(face - 1)) / (half(face) + half(face - 1)),
    };
    // The fluence's change downwards a depth over 1 - g.
    let slopes: Vec<f64> = (0..CELLS)
        .map(|n| (at(n + 1) - at(n)) / (s * (faces[n + 1] - faces[n])))
        .collect();
    let mut flux = 0.0;
    for [cosine, weight] in cosines() {
        // What passes from a face upwards; downwards the slab's faces lie the other way round.
        let passed: Vec<f64> = faces.iter().map(|depth| (-depth / cosine).exp()).collect();
        for (n, (here, slope)) in fluence.iter().zip(&slopes).enumerate() {
            let toward = |along: f64| {
                here + (1.0 - s) * along.clamp(-f64::from(FLUX_INWARD) * here, f64::from(FLUX_OUTWARD) * here)
            };
            let up = (passed[n] - passed[n + 1]) * toward(cosine * slope);
            let down = (passed[CELLS - 1 - n] - passed[CELLS - n]) * toward(-cosine * slope);
            flux += 0.5 * weight * cosine * (up + down);
        }
    }
    flux
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In a half space of isotropic scattering under a sun in the zenith the fluence is 3 + r - 3 e^(-t) by the surface's resistance r, and what leaves is half of its integral with the
    /// exponential integral of order 2: (3 + r) / 4 - 3 (1 - ln 2) / 2.
    #[test]
    fn a_deep_slab_is_a_half_space() {
        let resistance = f64::from(DIFFUSION_SURFACE_RESISTANCE);
        let truth = (3.0 + resistance) / 4.0 - 1.5 * (1.0 - std::f64::consts::LN_2);
        // All that comes in leaves through the upper face but a share 4 / (3 depth), which leaves through the other.
        let ours = diffuse_leaves(100.0, 1.0, 100.0, 1.0);
        assert!((ours / truth - 1.0).abs() < 0.01, "{ours} {truth}");
    }

    /// Where the beam has met nothing nothing was turned, and then as much as the rate says.
    #[test]
    fn what_goes_about_the_beams_way_comes_and_goes() {
        let (asymmetry, s) = (0.86f32, 0.14);
        let octaves = forward_octaves(asymmetry);
        for l in 0..MOMENTS {
            let at = |t: f64| {
                let terms = octaves.iter().zip(0..);
                terms
                    .map(|(octave, n)| octave[l] * (-t * 0.5f64.powi(n)).exp())
                    .sum::<f64>()
            };
            assert!(at(0.0).abs() < 1e-9, "{l}");
            let moment = f64::from(asymmetry).powi(l as i32);
            let rate = if l < 2 { s * (1.0 + 0.5 * 0.86) } else { 1.0 - moment };
            for t in [0.5, 2.0, 8.0] {
                let truth = moment * ((-rate * t).exp() - (-t).exp());
                // Between two octaves a rate's exponential is a sum of theirs.
                assert!((at(t) - truth).abs() < 0.04, "{l} {t}: {} {truth}", at(t));
            }
        }
    }
}
