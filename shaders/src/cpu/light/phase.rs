//! Stage `phase`: how light is turned by molecules, aerosol and droplets.
//!
//! Each function gives the share per steradian, normalised to 1 over the sphere, of light turned by the angle whose cosine is `mu`.

use std::f32::consts::PI;

/// Rayleigh's phase function, 1/sr.
#[inline(always)]
pub fn rayleigh(mu: f32) -> f32 {
    3.0 / (16.0 * PI) * (1.0 + mu * mu)
}

/// Henyey and Greenstein (1941), 1/sr.
#[inline(always)]
pub fn henyey_greenstein(g: f32, mu: f32) -> f32 {
    let d = (1.0 + g * g - 2.0 * g * mu).max(1e-6);
    (1.0 - g * g) / (4.0 * PI * d * d.sqrt())
}

/// Draine (2003), 1/sr: Henyey-Greenstein times `(1 + a mu^2)`, normalised.
#[inline(always)]
pub fn draine(g: f32, a: f32, mu: f32) -> f32 {
    henyey_greenstein(g, mu) * (1.0 + a * mu * mu) / (1.0 + a * (1.0 + 2.0 * g * g) / 3.0)
}

/// Cloud droplets: the blend of Jendersie and d'Eon (2023), "An Approximate Mie Scattering Function for Fog and Cloud
/// Rendering", equations 4 to 7.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Droplets {
    /// Asymmetry of the forward peak.
    pub g_peak: f32,
    /// Asymmetry of the rest.
    pub g_rest: f32,
    /// Draine's parameter of the rest.
    pub alpha: f32,
    /// Share of the rest.
    pub weight: f32,
}

impl Droplets {
    /// Droplets of `diameter_um` micrometres, bounded to the fit's range of 5 to 50.
    pub fn new(diameter_um: f32) -> Droplets {
        let d = diameter_um.clamp(5.0, 50.0);
        Droplets {
            g_peak: (-0.0990567 / (d - 1.67154)).exp(),
            g_rest: (-2.20679 / (d + 3.91029) - 0.428934).exp(),
            alpha: (3.62489 - 8.29288 / (d + 5.52825)).exp(),
            weight: (-0.599085 / (d - 0.641583) - 0.665888).exp(),
        }
    }
    /// The phase function, 1/sr.
    #[inline(always)]
    pub fn value(&self, mu: f32) -> f32 {
        (1.0 - self.weight) * henyey_greenstein(self.g_peak, mu) + self.weight * draine(self.g_rest, self.alpha, mu)
    }
}

/// A direction of look with what it counts for in sums over the sphere.
#[derive(Clone, Copy, Debug)]
pub struct TowardsCamera {
    /// Unit vector.
    pub d: [f32; 3],
    /// Solid angle, sr; together 4 pi.
    pub even: f32,
    /// Share of light that is scattered once; together 1.
    pub once: f32,
}

/// Nodes of Gauss and Legendre's rule of four on 0 to 1, with their weights.
const RING_RULE: [[f64; 2]; 4] = [
    [0.069_431_844_203, 0.173_927_422_569],
    [0.330_009_478_208, 0.326_072_577_431],
    [0.669_990_521_792, 0.326_072_577_431],
    [0.930_568_155_797, 0.173_927_422_569],
];

/// Directions of look in rings around the beam (the last vector of `frame`, all three unit vectors across each other), `around` of them in each: four rings in either hemisphere, at Gauss's nodes of the mean of even light's and
/// Henyey and Greenstein's cumulated functions, so that a forward peak is met as well as the rest.
pub fn directions_around(frame: &[[f32; 3]; 3], asymmetry: f32, around: usize) -> Vec<TowardsCamera> {
    let g = f64::from(asymmetry);
    // Up to the cosine c: half the share of the sphere, and half of what is scattered once.
    let below = |c: f64| {
        let once = if g.abs() < 1e-3 {
            0.5 * (1.0 + c)
        } else {
            (1.0 - g * g) / (2.0 * g) * (1.0 / (1.0 + g * g - 2.0 * g * c).sqrt() - 1.0 / (1.0 + g))
        };
        0.25 * (1.0 + c) + 0.5 * once
    };
    let mut all = Vec::with_capacity(2 * RING_RULE.len() * around);
    for (from, to) in [(0.0, below(0.0)), (below(0.0), 1.0)] {
        for (ring, [node, weight]) in RING_RULE.into_iter().enumerate() {
            let wanted = from + (to - from) * node;
            let [mut low, mut high] = [-1.0f64, 1.0];
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if below(middle) < wanted {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            let cosine = (0.5 * (low + high)) as f32;
            let phase = henyey_greenstein(asymmetry, cosine);
            let even = ((to - from) * weight) as f32 / (0.25 + PI * phase);
            let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
            for n in 0..around {
                // Every other ring is turned by half a place.
                let turn = (n as f32 + 0.5 * (ring % 2) as f32) * std::f32::consts::TAU / around as f32;
                let (b, a) = turn.sin_cos();
                let d = [0, 1, 2].map(|v| frame[2][v] * cosine + (frame[0][v] * a + frame[1][v] * b) * sine);
                let once = even * phase;
                all.push(TowardsCamera { d, even, once });
            }
        }
    }
    let [even, once] = all.iter().fold([0.0; 2], |s, t| [s[0] + t.even, s[1] + t.once]);
    for towards in &mut all {
        towards.even *= 4.0 * std::f32::consts::PI / even;
        towards.once /= once;
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn over_sphere(f: impl Fn(f32) -> f32) -> (f64, f64) {
        let n = 200_000;
        let (mut whole, mut mean) = (0.0, 0.0);
        for i in 0..n {
            // Equal angles, so that the forward peak is resolved.
            let angle = (i as f64 + 0.5) / n as f64 * std::f64::consts::PI;
            let w = 2.0 * std::f64::consts::PI * angle.sin() * std::f64::consts::PI / n as f64;
            let p = f(angle.cos() as f32) as f64 * w;
            whole += p;
            mean += p * angle.cos();
        }
        (whole, mean)
    }

    #[test]
    fn phase_functions_are_normalised() {
        assert!((over_sphere(rayleigh).0 - 1.0).abs() < 1e-4);
        assert!((over_sphere(|m| henyey_greenstein(0.85, m)).0 - 1.0).abs() < 1e-3);
        assert!((over_sphere(|m| draine(0.6, 20.0, m)).0 - 1.0).abs() < 1e-3);
    }

    /// Asymmetry of the true Mie function at 10, 20 and 50 micrometres is 0.8377, 0.8630, 0.8724; the fit
    /// follows the shape of the lobes rather than the mean and comes out up to 0.027 higher (at 10), so 0.03 is allowed.
    #[test]
    fn droplets_have_the_asymmetry_of_mie() {
        for (d, g) in [(10.0, 0.8377), (20.0, 0.8630), (50.0, 0.8724)] {
            let droplets = Droplets::new(d);
            let (whole, mean) = over_sphere(|m| droplets.value(m));
            assert!((mean / whole - g).abs() < 0.03, "d {d}: g {} wanted {g}", mean / whole);
        }
    }
}
