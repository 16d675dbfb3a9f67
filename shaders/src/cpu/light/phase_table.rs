//! Stage input of `path_tracer`: any phase function as a table of angles.
//!
//! Reads: [`PhaseChoice`]. Writes: [`PhaseTable`]: the share of light that is turned by an angle, a steradian, at [`PHASE_NODES`] angles, dense towards both
//! the sun and the antisolar point, in three colours. Scheme: functions are evaluated at the nodes (Mie: [`super::mie`], ice: [`super::ice`]) and scaled so that the integral
//! over the sphere is 1; between nodes they are linear in the cosine, so that drawing from them and their value agree exactly. What the march
//! looks up is made of it (`march_phase`).
//!
//! The chopped peak (seed 000, after Lenoble 1985 and Bouthors 2008): below 8 degrees the function is cut to its value there. The path tracer draws from the
//! peak and from the rest apart; nothing is left out.

use std::f64::consts::PI;

use super::ice;
use super::mie::{Distribution, WATER_INDEX, WAVELENGTHS_UM};
use super::phase::{Droplets, rayleigh};

/// Nodes of each half: from straight ahead to sideways, and from straight back to sideways.
pub const PHASE_HALF_NODES: usize = 512;
/// Nodes in all.
pub const PHASE_NODES: usize = 2 * PHASE_HALF_NODES;
/// Angle of the chopped peak, degrees.
pub const CHOP_DEG: f64 = 8.0;

/// Which phase function; numbers that make no sense are bounded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PhaseChoice {
    /// Molecules'.
    Rayleigh,
    /// Henyey and Greenstein's.
    HenyeyGreenstein {
        /// Mean cosine, -0.999 to 0.999.
        asymmetry: f32,
    },
    /// Two of them.
    DoubleHenyeyGreenstein {
        /// Mean cosine of the part that goes on.
        forward_asymmetry: f32,
        /// Mean cosine of the other, below 0 where it goes back.
        backward_asymmetry: f32,
        /// Share of the first, 0 to 1.
        forward_share: f32,
    },
    /// The fit of Jendersie and d'Eon (2023).
    Droplets {
        /// 5 to 50 micrometres.
        diameter_um: f32,
    },
    /// Mie's, of droplets of an effective variance of 0.1, in three colours.
    Mie {
        /// 1 to 50 micrometres.
        effective_radius_um: f32,
    },
    /// That of hexagonal crystals of ice ([`super::ice`]), in three colours.
    Ice {
        /// Length over width, 0.05 to 20.
        aspect_ratio: f32,
    },
}

impl Default for PhaseChoice {
    fn default() -> Self {
        PhaseChoice::Droplets { diameter_um: 18.0 }
    }
}

/// Effective variance of droplets (Hansen 1971: about 0.1 in fair-weather cumulus).
const EFFECTIVE_VARIANCE: f64 = 0.1;

/// See the module.
#[derive(Clone, Debug)]
pub struct PhaseTable {
    /// Of each colour the value at each node, 1/sr.
    pub colours: [Vec<f64>; 3],
}

impl PhaseTable {
    /// Makes the table; a fraction of a millisecond, for Mie some tenths of a second, for ice a second.
    pub fn new(choice: PhaseChoice) -> PhaseTable {
        PhaseTable {
            colours: at_nodes(choice),
        }
    }

    /// Three colours at the angle whose cosine is `mu`, 1/sr.
    pub fn look(&self, mu: f64) -> [f64; 3] {
        let last = (PHASE_HALF_NODES - 1) as f64;
        let (first, place) = if mu >= 0.0 {
            (0, (1.0 - mu).max(0.0).sqrt().sqrt() * last)
        } else {
            (PHASE_HALF_NODES, (1.0 + mu).max(0.0).sqrt() * last)
        };
        let n = first + (place as usize).min(PHASE_HALF_NODES - 2);
        let (near, far) = (node_cosine(n), node_cosine(n + 1));
        let share = ((near - mu) / (near - far)).clamp(0.0, 1.0);
        [0, 1, 2].map(|c| self.colours[c][n] + (self.colours[c][n + 1] - self.colours[c][n]) * share)
    }

    /// Share of scattering within the peak that is chopped at [`CHOP_DEG`], the mean of the colours.
    pub fn peak_share(&self) -> f64 {
        self.colours
            .iter()
            .map(|values| over_sphere(&chopped(values)[1]))
            .sum::<f64>()
            / 3.0
    }
}

/// Cosine of the angle of node `n`.
pub fn node_cosine(n: usize) -> f64 {
    let place = (n % PHASE_HALF_NODES) as f64 / (PHASE_HALF_NODES - 1) as f64;
    if n < PHASE_HALF_NODES {
        1.0 - place.powi(4)
    } else {
        place.powi(2) - 1.0
    }
}

/// All nodes in order of falling cosine (the two that look sideways are one), as indices.
pub(crate) fn ordered() -> impl DoubleEndedIterator<Item = usize> + Clone {
    (0..PHASE_HALF_NODES).chain((PHASE_HALF_NODES..PHASE_NODES - 1).rev())
}

/// Integral over the sphere of a function at the nodes, linear between.
fn over_sphere(values: &[f64]) -> f64 {
    let nodes: Vec<[f64; 2]> = ordered().map(|n| [node_cosine(n), values[n]]).collect();
    let pairs = nodes.windows(2);
    pairs.map(|p| PI * (p[0][0] - p[1][0]) * (p[0][1] + p[1][1])).sum()
}

/// The function at the nodes for each colour, its integral 1.
pub(crate) fn at_nodes(choice: PhaseChoice) -> [Vec<f64>; 3] {
    let cosines: Vec<f64> = (0..PHASE_NODES).map(node_cosine).collect();
    let bounded = |g: f32| if g.is_finite() { g.clamp(-0.999, 0.999) } else { 0.0 };
    let same = |f: &dyn Fn(f64) -> f64| {
        let values: Vec<f64> = cosines.iter().map(|mu| f(*mu)).collect();
        [values.clone(), values.clone(), values]
    };
    let mut colours = match choice {
        PhaseChoice::Rayleigh => same(&|mu| rayleigh(mu as f32).into()),
        PhaseChoice::HenyeyGreenstein { asymmetry } => {
            let g = f64::from(bounded(asymmetry));
            same(&|mu| exact_henyey_greenstein(g, mu))
        }
        PhaseChoice::DoubleHenyeyGreenstein {
            forward_asymmetry,
            backward_asymmetry,
            forward_share,
        } => {
            let [f, b] = [forward_asymmetry, backward_asymmetry].map(|g| f64::from(bounded(g)));
            let share = f64::from(if forward_share.is_finite() {
                forward_share.clamp(0.0, 1.0)
            } else {
                1.0
            });
            same(&|mu| share * exact_henyey_greenstein(f, mu) + (1.0 - share) * exact_henyey_greenstein(b, mu))
        }
        PhaseChoice::Droplets { diameter_um } => {
            let droplets = Droplets::new(diameter_um);
            same(&|mu| droplets.value(mu as f32).into())
        }
        PhaseChoice::Mie { effective_radius_um } => {
            let radius = if effective_radius_um.is_finite() {
                effective_radius_um.clamp(1.0, 50.0)
            } else {
                9.0
            };
            let droplets = Distribution {
                effective_radius_um: radius.into(),
                effective_variance: EFFECTIVE_VARIANCE,
            };
            [0, 1, 2].map(|c| droplets.phase(WAVELENGTHS_UM[c], WATER_INDEX[c], &cosines).0)
        }
        PhaseChoice::Ice { aspect_ratio } => {
            let aspect_ratio = if aspect_ratio.is_finite() { aspect_ratio } else { 1.0 };
            ice::phase(aspect_ratio.into(), &cosines)
        }
    };
    for values in &mut colours {
        let whole = over_sphere(values);
        values.iter_mut().for_each(|v| *v /= whole);
    }
    colours
}

fn exact_henyey_greenstein(g: f64, mu: f64) -> f64 {
    let d = 1.0 + g * g - 2.0 * g * mu;
    (1.0 - g * g) / (4.0 * PI * d * d.sqrt())
}

/// A function at the nodes cut to its value at [`CHOP_DEG`], and what is cut off; neither is scaled.
pub(crate) fn chopped(values: &[f64]) -> [Vec<f64>; 2] {
    let edge = CHOP_DEG.to_radians().cos();
    let mut at_edge = values[0];
    for n in 0..PHASE_HALF_NODES - 1 {
        let (near, far) = (node_cosine(n), node_cosine(n + 1));
        if near >= edge && far < edge {
            at_edge = values[n] + (values[n + 1] - values[n]) * (near - edge) / (near - far);
        }
    }
    let rest: Vec<f64> = (0..PHASE_NODES)
        .map(|n| {
            if node_cosine(n) > edge {
                values[n].min(at_edge)
            } else {
                values[n]
            }
        })
        .collect();
    let peak = values.iter().zip(&rest).map(|(v, r)| v - r).collect();
    [rest, peak]
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHOICES: [PhaseChoice; 6] = [
        PhaseChoice::Rayleigh,
        PhaseChoice::HenyeyGreenstein { asymmetry: 0.85 },
        PhaseChoice::DoubleHenyeyGreenstein {
            forward_asymmetry: 0.9,
            backward_asymmetry: -0.4,
            forward_share: 0.8,
        },
        PhaseChoice::Droplets { diameter_um: 18.0 },
        PhaseChoice::Mie {
            effective_radius_um: 9.0,
        },
        PhaseChoice::Ice { aspect_ratio: 2.0 },
    ];

    /// In equal angles, which are not the nodes.
    #[test]
    fn every_function_integrates_to_one() {
        for choice in CHOICES {
            let table = PhaseTable::new(choice);
            let n = 100_000;
            let mut whole = [0.0; 3];
            for i in 0..n {
                let angle = (f64::from(i) + 0.5) / f64::from(n) * PI;
                let seen = table.look(angle.cos());
                for c in 0..3 {
                    whole[c] += seen[c] * 2.0 * PI * angle.sin() * PI / f64::from(n);
                }
            }
            // The sharpest peak is a few hundred of these angles wide.
            assert!(whole.iter().all(|w| (w - 1.0).abs() < 1e-3), "{choice:?}: {whole:?}");
            assert!(table.colours.iter().flatten().all(|v| v.is_finite() && *v > 0.0));
        }
    }

    /// Bouthors found 0.43 for the droplets of seed 000 (6 micrometres); his distribution is narrower than ours.
    #[test]
    fn the_chopped_peak_weighs_what_it_did_in_the_seed() {
        let table = PhaseTable::new(PhaseChoice::Mie {
            effective_radius_um: 6.0,
        });
        assert!((table.peak_share() - 0.43).abs() < 0.05, "{}", table.peak_share());
    }

    /// The largest value of a colour between two angles in degrees that is higher than what is beside it: a ring.
    fn ring(table: &PhaseTable, colour: usize, from: f64, to: f64) -> Option<f64> {
        let at = |deg: f64| table.look(deg.to_radians().cos())[colour];
        let n = 2000;
        let angle = |i: usize| from + (to - from) * i as f64 / n as f64;
        (1..n)
            .filter(|i| at(angle(*i)) > at(angle(i - 1)) && at(angle(*i)) >= at(angle(i + 1)))
            .max_by(|a, b| at(angle(*a)).total_cmp(&at(angle(*b))))
            .map(angle)
    }

    /// The fogbow stands where Airy's theory has the primary bow's main maximum: the rainbow angle, widened by 1.0845 (h pi^2 / 12)^(1/3) x^(-2/3) with
    /// h = 9/4 ((4 - m^2) / (m^2 - 1)^3)^0.5 (van de Hulst 1957, section 13.2). Sizes differ in a cloud and Airy is off by some tenths of a degree for small
    /// drops: 1.5 degrees are allowed. Red stands farther out than blue.
    #[test]
    fn mie_has_a_fogbow_where_airy_says() {
        let radius = 15.0;
        let table = PhaseTable::new(PhaseChoice::Mie {
            effective_radius_um: radius,
        });
        let bows = [0, 1, 2].map(|c| {
            let (m2, x) = (WATER_INDEX[c].powi(2), 2.0 * PI * f64::from(radius) / WAVELENGTHS_UM[c]);
            let incidence = ((m2 - 1.0) / 3.0).sqrt().acos();
            let refraction = (incidence.sin() / m2.sqrt()).asin();
            let rainbow = PI + 2.0 * incidence - 4.0 * refraction;
            let h = 2.25 * ((4.0 - m2) / (m2 - 1.0).powi(3)).sqrt();
            let airy = rainbow + 1.0845 * (h * PI * PI / 12.0).cbrt() / x.powf(2.0 / 3.0);
            let ours = ring(&table, c, 130.0, 155.0).expect("a bow");
            assert!(
                (ours - airy.to_degrees()).abs() < 1.5,
                "{c}: {ours} {}",
                airy.to_degrees()
            );
            ours
        });
        assert!((136.0..145.0).contains(&bows[1]), "{bows:?}");
    }

    /// The glory's first ring lies between the first maximum of J2^2 (3.05) and the second of J0^2 (3.83) in units of 1/x: near the back the sum of the two
    /// amplitudes goes as J0, their difference as J2 (van de Hulst 1957, section 13.3). A spread of sizes shifts it by a tenth.
    #[test]
    fn mie_has_a_glory_of_the_right_width() {
        for radius in [6.0, 12.0] {
            let table = PhaseTable::new(PhaseChoice::Mie {
                effective_radius_um: radius,
            });
            for c in 0..3 {
                let x = 2.0 * PI * f64::from(radius) / WAVELENGTHS_UM[c];
                let unit = (1.0 / x).to_degrees();
                let ours = 180.0 - ring(&table, c, 180.0 - 5.0 * unit, 180.0 - 1.8 * unit).expect("a ring");
                let place = ours / unit;
                assert!(
                    (2.75..4.2).contains(&place),
                    "{radius} {c}: ring at {ours} degrees, {place} / x"
                );
            }
        }
    }

    /// The halos stand at the least deviation of prisms of 60 and 90 degrees, 2 asin(n sin(A / 2)) - A, with red inside. The blur moves the maximum a little outwards, as light is
    /// turned by more but never by less.
    #[test]
    fn ice_has_its_halos() {
        let table = PhaseTable::new(PhaseChoice::Ice { aspect_ratio: 1.0 });
        for (prism_deg, from, to) in [(60.0f64, 19.0, 26.0), (90.0, 43.0, 50.0)] {
            let places = [0, 1, 2].map(|c| {
                let half = 0.5 * prism_deg.to_radians();
                let least = (2.0 * (ice::ICE_INDEX[c] * half.sin()).asin()).to_degrees() - prism_deg;
                let ours = ring(&table, c, from, to).expect("a halo");
                assert!(
                    (-0.3..1.2).contains(&(ours - least)),
                    "{prism_deg}, {c}: {ours} {least}"
                );
                ours
            });
            assert!(places[0] < places[2], "red inside blue: {places:?}");
        }
        // As bright as it is: several times what is inside it.
        let at = |deg: f64| table.look(deg.to_radians().cos())[1];
        assert!(at(22.3) > 4.0 * at(18.0), "{} {}", at(22.3), at(18.0));
        for choice in &CHOICES[..5] {
            assert_eq!(ring(&PhaseTable::new(*choice), 1, 19.0, 26.0), None, "{choice:?}");
        }
    }

    /// Compact columns and plates of clear ice have mean cosines of about 0.75 to 0.8 in visible light, long columns and thin plates more (Macke et al. 1996; Fu 2007).
    #[test]
    fn ice_goes_forward_the_more_the_less_compact() {
        let mean_cosine = |aspect_ratio| {
            let table = PhaseTable::new(PhaseChoice::Ice { aspect_ratio });
            let nodes: Vec<usize> = ordered().collect();
            let pairs = nodes.windows(2).map(|p| {
                let ([near, far], values) = ([node_cosine(p[0]), node_cosine(p[1])], &table.colours[1]);
                PI * (near - far) * (values[p[0]] + values[p[1]]) * 0.5 * (near + far)
            });
            pairs.sum::<f64>()
        };
        let [compact, column, plate] = [1.0, 8.0, 0.1].map(mean_cosine);
        assert!((0.72..0.82).contains(&compact), "{compact}");
        assert!(
            column > compact + 0.01 && plate > compact + 0.03,
            "{compact} {column} {plate}"
        );
    }

    #[test]
    fn no_other_function_has_rings() {
        for choice in &CHOICES[..4] {
            let table = PhaseTable::new(*choice);
            for c in 0..3 {
                assert_eq!(ring(&table, c, 130.0, 155.0), None, "{choice:?}");
                assert_eq!(ring(&table, c, 172.0, 179.9), None, "{choice:?}");
            }
        }
    }
}
