//! A plane-parallel slab for the path tracer: what discrete ordinates have exact figures for.

use super::{Film, Flight, Medium, PathTracer, Scatterer};
use crate::cpu::view::lanes::LANES;

/// How much the majorant is above the extinction, so that delta tracking is put to the test.
const MAJORANT: f64 = 1.25;

/// A homogeneous slab between heights 0 and 1 over black ground.
#[derive(Clone, Copy, Debug)]
pub struct Slab {
    /// Optical depth from bottom to top.
    pub optical_depth: f64,
    /// Radiance that comes in from above.
    pub from_above: f64,
    /// Radiance that comes in from below.
    pub from_below: f64,
}

impl Medium for Slab {
    fn fly(&self, at: &mut [f64; 3], along: &[f64; 3], _reach: &mut f64, random: f64) -> Option<Flight> {
        let end = if along[2] > 0.0 {
            (1.0 - at[2]) / along[2]
        } else if along[2] < 0.0 {
            at[2] / -along[2]
        } else {
            f64::INFINITY
        };
        let majorant = MAJORANT * self.optical_depth;
        let free = -(1.0 - random).ln() / majorant;
        if free < end {
            at[2] = (at[2] + along[2] * free).clamp(0.0, 1.0);
            return Some(Flight::Candidate(majorant));
        }
        Some(Flight::Sky)
    }
    fn extinction(&self, _at: &[[f64; 3]; LANES]) -> [f64; LANES] {
        [self.optical_depth; LANES]
    }
    fn sun(&self, _at: &[f64; 3]) -> [f64; 3] {
        [1.0; 3]
    }
    fn sky(&self, along: &[f64; 3], _from_ground: bool) -> [f64; 3] {
        [if along[2] > 0.0 {
            self.from_above
        } else {
            self.from_below
        }; 3]
    }
}

/// A number and its standard error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The mean.
    pub mean: f64,
    /// Standard error of it.
    pub error: f64,
}

/// Many films' worth of one ray: the pixels are samples too.
const RAYS: usize = 1024;

fn estimate(tracer: &PathTracer<'_, Slab>, start: [[f64; 3]; 2], paths: u64) -> Estimate {
    let mut film = Film::new(RAYS);
    tracer.trace(&mut film, &|_| start, paths.div_ceil(RAYS as u64).max(2) as u32);
    let n = RAYS as f64;
    Estimate {
        mean: film.radiance().iter().map(|p| p[1]).sum::<f64>() / n,
        error: film.squared_error().iter().map(|p| p[1]).sum::<f64>().sqrt() / n,
    }
}

fn down(mu: f64) -> [f64; 3] {
    [(1.0 - mu * mu).max(0.0).sqrt(), 0.0, -mu]
}

/// Share of a beam's flux, `sun_cosine` to the vertical, that a slab over black ground sends back. By reciprocity that is the radiance along the beam
/// of the slab under an even sky.
pub fn reflectance(optical_depth: f64, sun_cosine: f64, albedo: f64, scatterer: &Scatterer, paths: u64) -> Estimate {
    under_sky(optical_depth, sun_cosine, albedo, scatterer, paths, [1.0, 0.0])
}

/// Radiance of a slab, seen from above along a ray of `cosine` to the vertical, with these radiances coming in from above and from below. Even light
/// from all around and no absorption give the same light back (the furnace test).
pub fn under_sky(
    optical_depth: f64,
    cosine: f64,
    albedo: f64,
    scatterer: &Scatterer,
    paths: u64,
    [from_above, from_below]: [f64; 2],
) -> Estimate {
    let medium = Slab {
        optical_depth,
        from_above,
        from_below,
    };
    let tracer = PathTracer {
        medium: &medium,
        scatterer,
        sun_direction: None,
        albedo,
    };
    estimate(&tracer, [[0.0, 0.0, 1.0], down(cosine)], paths)
}

/// Radiance straight up from a slab under a beam of unit irradiance across it, `sun_cosine` to the vertical.
pub fn nadir_radiance(optical_depth: f64, sun_cosine: f64, scatterer: &Scatterer, paths: u64) -> Estimate {
    let medium = Slab {
        optical_depth,
        from_above: 0.0,
        from_below: 0.0,
    };
    let [x, y, z] = down(sun_cosine);
    let tracer = PathTracer {
        medium: &medium,
        scatterer,
        sun_direction: Some([-x, -y, -z]),
        albedo: 1.0,
    };
    estimate(&tracer, [[0.0, 0.0, 1.0], down(1.0)], paths)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::light::phase_table::PhaseChoice;

    fn scatterer(asymmetry: f32) -> Scatterer {
        Scatterer::new(PhaseChoice::HenyeyGreenstein { asymmetry })
    }

    /// Even light from all around, nothing absorbed: the same light comes back. With absorption less comes back.
    #[test]
    fn a_furnace_is_even() {
        for choice in [
            PhaseChoice::HenyeyGreenstein { asymmetry: 0.999 },
            PhaseChoice::Droplets { diameter_um: 18.0 },
            PhaseChoice::Mie {
                effective_radius_um: 6.0,
            },
        ] {
            let scatterer = Scatterer::new(choice);
            let even = under_sky(5.0, 0.3, 1.0, &scatterer, 20_000, [0.7, 0.7]);
            // Nothing is random there but the colours' weights of Mie: their errors, and rounding.
            assert!(
                (even.mean - 0.7).abs() < 3.0 * even.error + 1e-9,
                "{choice:?}: {even:?}"
            );
            let dimmed = under_sky(5.0, 0.3, 0.9, &scatterer, 20_000, [0.7, 0.7]);
            assert!(dimmed.mean + 3.0 * dimmed.error < 0.7, "{choice:?}: {dimmed:?}");
            let black = under_sky(0.5, 0.3, 0.0, &scatterer, 20_000, [0.7, 0.7]);
            let straight = 0.7 * (-0.5f64 / 0.3).exp();
            assert!(
                (black.mean - straight).abs() <= 3.0 * black.error + 1e-9,
                "{choice:?}: {black:?}"
            );
        }
    }

    /// The run of the peak on the sun's side sums over the same paths as looks at the sun with the whole function: a flat part that holds everything
    /// must give the same radiance, only noisier.
    #[test]
    fn splitting_off_the_peak_changes_nothing() {
        let split = scatterer(0.85);
        let mut plain = scatterer(0.0);
        plain.rest = split.whole_part();
        let (ours, theirs) = (
            nadir_radiance(4.0, 0.5, &split, 200_000),
            nadir_radiance(4.0, 0.5, &plain, 400_000),
        );
        let error = (ours.error.powi(2) + theirs.error.powi(2)).sqrt();
        assert!((ours.mean - theirs.mean).abs() < 3.0 * error, "{ours:?} {theirs:?}");
        assert!(error < 0.03 * ours.mean, "{ours:?} {theirs:?}");
    }

    #[test]
    fn threads_change_no_bit() {
        let scatterer = scatterer(0.85);
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| nadir_radiance(4.0, 0.5, &scatterer, 8_000))
        };
        assert_eq!(run(1), run(3));
    }
}
