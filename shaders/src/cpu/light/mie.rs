//! Stage input: how spheres of water scatter light, from Maxwell's equations.
//!
//! Reads: a size distribution, a wavelength, the index of water. Writes: the phase function at given angles, the asymmetry, the
//! efficiency of scattering. Scheme: Mie's series in 64 bits, logarithmic derivatives by downward recurrence, Riccati-Bessel functions
//! by upward recurrence, `x + 4 x^(1/3) + 2` terms (Bohren and Huffman 1983, chapter 4 and appendix A); droplets after Hansen's gamma
//! distribution (Hansen and Travis 1974), summed over [`RADII`] radii. Water does not absorb here: its
//! imaginary index is below 3e-8 in visible light, 1e-5 of the extinction of a droplet. Errors: the series' own are near 1e-12; the
//! sum over radii leaves ripples of about a percent of the phase function sideways, where it is least.

use rayon::prelude::*;
use std::f64::consts::PI;

/// Wavelengths that stand for red, green and blue, micrometres.
pub const WAVELENGTHS_UM: [f64; 3] = [0.680, 0.550, 0.440];
/// Index of water at these wavelengths, 25 C: Hale and Querry (1973), interpolated.
pub const WATER_INDEX: [f64; 3] = [1.331, 1.333, 1.337];
/// Radii of a size distribution.
pub const RADII: usize = 192;

/// Coefficients of the series of one sphere.
struct Series {
    electric: Vec<[f64; 2]>,
    magnetic: Vec<[f64; 2]>,
    size: f64,
}

impl Series {
    /// Of a sphere whose circumference is `size` wavelengths, of relative index `index` (real).
    fn new(size: f64, index: f64) -> Series {
        let terms = (size + 4.0 * size.cbrt() + 2.0).ceil().max(1.0) as usize;
        let inside = index * size;
        let deep = terms.max(inside.ceil() as usize) + 16;
        let mut derivative = vec![0.0; deep + 1];
        for n in (1..=deep).rev() {
            let ratio = n as f64 / inside;
            derivative[n - 1] = ratio - 1.0 / (derivative[n] + ratio);
        }
        // Riccati-Bessel functions at n - 1 and n; xi = psi - i chi.
        let (mut psi, mut psi_before) = (size.sin(), size.cos());
        let (mut chi, mut chi_before) = (size.cos(), -size.sin());
        let mut series = Series {
            electric: Vec::with_capacity(terms),
            magnetic: Vec::with_capacity(terms),
            size,
        };
        for n in 1..=terms {
            let factor = (2 * n - 1) as f64 / size;
            let (psi_next, chi_next) = (factor * psi - psi_before, factor * chi - chi_before);
            let coefficient = |d: f64| {
                let above = d * psi_next - psi;
                let (real, imaginary) = (above, -(d * chi_next - chi));
                let square = real * real + imaginary * imaginary;
                // above / (real + i imaginary)
                [above * real / square, -above * imaginary / square]
            };
            let by_size = n as f64 / size;
            series.electric.push(coefficient(derivative[n] / index + by_size));
            series.magnetic.push(coefficient(derivative[n] * index + by_size));
            (psi_before, psi) = (psi, psi_next);
            (chi_before, chi) = (chi, chi_next);
        }
        series
    }

    /// Efficiency of scattering.
    fn efficiency(&self) -> f64 {
        let sum: f64 = self
            .electric
            .iter()
            .zip(&self.magnetic)
            .enumerate()
            .map(|(i, (a, b))| (2 * i + 3) as f64 * (a[0] * a[0] + a[1] * a[1] + b[0] * b[0] + b[1] * b[1]))
            .sum();
        2.0 / (self.size * self.size) * sum
    }

    /// Mean cosine of the angle of scattering times the efficiency.
    fn efficiency_times_asymmetry(&self) -> f64 {
        let dot = |a: &[f64; 2], b: &[f64; 2]| a[0] * b[0] + a[1] * b[1];
        let (a, b) = (&self.electric, &self.magnetic);
        let mut sum = 0.0;
        for i in 0..a.len() {
            let n = (i + 1) as f64;
            if i + 1 < a.len() {
                sum += n * (n + 2.0) / (n + 1.0) * (dot(&a[i], &a[i + 1]) + dot(&b[i], &b[i + 1]));
            }
            sum += (2.0 * n + 1.0) / (n * (n + 1.0)) * dot(&a[i], &b[i]);
        }
        4.0 / (self.size * self.size) * sum
    }

    /// Adds `weight` times `(|S1|^2 + |S2|^2) / 2` at the angles of cosines `mu`.
    fn add_intensity(&self, mu: &[f64], weight: f64, sum: &mut [f64]) {
        const BLOCK: usize = 64;
        for (mu, sum) in mu.chunks(BLOCK).zip(sum.chunks_mut(BLOCK)) {
            let count = mu.len();
            let mut cosine = [0.0; BLOCK];
            cosine[..count].copy_from_slice(mu);
            let mut before = [0.0; BLOCK];
            let mut here = [1.0; BLOCK];
            // S1 and S2, real and imaginary.
            let mut s = [[0.0; BLOCK]; 4];
            for (i, (a, b)) in self.electric.iter().zip(&self.magnetic).enumerate() {
                let n = (i + 1) as f64;
                let factor = (2.0 * n + 1.0) / (n * (n + 1.0));
                let (a, b) = (a.map(|v| v * factor), b.map(|v| v * factor));
                let (rise, fall) = ((2.0 * n + 1.0) / n, (n + 1.0) / n);
                for l in 0..BLOCK {
                    let pi = here[l];
                    let tau = n * cosine[l] * pi - (n + 1.0) * before[l];
                    s[0][l] += a[0] * pi + b[0] * tau;
                    s[1][l] += a[1] * pi + b[1] * tau;
                    s[2][l] += a[0] * tau + b[0] * pi;
                    s[3][l] += a[1] * tau + b[1] * pi;
                    here[l] = rise * cosine[l] * pi - fall * before[l];
                    before[l] = pi;
                }
            }
            for l in 0..count {
                let square = s[0][l].powi(2) + s[1][l].powi(2) + s[2][l].powi(2) + s[3][l].powi(2);
                sum[l] += 0.5 * weight * square;
            }
        }
    }
}

/// Efficiency of scattering and asymmetry of one sphere whose circumference is `size` wavelengths.
pub fn sphere(size: f64, index: f64) -> [f64; 2] {
    let series = Series::new(size, index);
    let efficiency = series.efficiency();
    [efficiency, series.efficiency_times_asymmetry() / efficiency]
}

/// Droplets of many radii.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distribution {
    /// Mean radius weighted by cross section, micrometres.
    pub effective_radius_um: f64,
    /// Variance about it in the same weights, over its square: 0.1 is usual in clouds, 0 a single radius.
    pub effective_variance: f64,
}

impl Distribution {
    /// Radii in micrometres and how many droplets there are of each, relative.
    fn radii(&self) -> Vec<[f64; 2]> {
        let (a, b) = (self.effective_radius_um, self.effective_variance);
        if b < 1e-4 {
            return vec![[a, 1.0]];
        }
        // n(r) = r^((1 - 3 b) / b) exp(-r / (a b)); what counts is weighed by r^2: mean a, deviation a b^0.5.
        let deviation = a * b.sqrt();
        let (least, most) = ((a - 4.5 * deviation).max(0.02 * a), a + 6.0 * deviation);
        (0..RADII)
            .map(|i| {
                let r = least + (most - least) * (i as f64 + 0.5) / RADII as f64;
                let log = (1.0 / b - 3.0) * (r / a).ln() - (r / a - 1.0) / b;
                [r, log.exp()]
            })
            .collect()
    }

    /// Phase function in 1/sr at the angles of cosines `mu`, as the series gives it (its integral over the sphere is 1), and the asymmetry.
    pub fn phase(&self, wavelength_um: f64, index: f64, mu: &[f64]) -> (Vec<f64>, f64) {
        let parts: Vec<(Vec<f64>, f64, f64)> = self
            .radii()
            .par_iter()
            .map(|[radius_um, number]| {
                let size = 2.0 * PI * radius_um / wavelength_um;
                let series = Series::new(size, index);
                let mut sum = vec![0.0; mu.len()];
                series.add_intensity(mu, *number, &mut sum);
                // Cross section over (wavelength / 2 pi)^2: pi x^2 Q.
                let section = number * PI * size * size;
                (
                    sum,
                    section * series.efficiency(),
                    section * series.efficiency_times_asymmetry(),
                )
            })
            .collect();
        let mut intensity = vec![0.0; mu.len()];
        let (mut section, mut turned) = (0.0, 0.0);
        for (sum, s, t) in &parts {
            for (to, v) in intensity.iter_mut().zip(sum) {
                *to += v;
            }
            section += s;
            turned += t;
        }
        intensity.iter_mut().for_each(|v| *v /= section);
        (intensity, turned / section)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Figures of another code for single spheres at 550 nm, four digits: half a unit of the last is allowed.
    #[test]
    fn asymmetry_of_single_spheres_is_the_known_one() {
        for (diameter_um, g) in [(5.0, 0.8311), (10.0, 0.8377), (20.0, 0.8630), (50.0, 0.8724)] {
            let [efficiency, ours] = sphere(PI * diameter_um / 0.55, 1.333);
            assert!((ours - g).abs() < 6e-5, "{diameter_um}: {ours} wanted {g}");
            assert!((1.8..2.6).contains(&efficiency), "{efficiency}");
        }
    }

    /// Small spheres are Rayleigh's: Q = 8/3 x^4 ((m^2 - 1) / (m^2 + 2))^2 up to x^2, and no asymmetry.
    #[test]
    fn small_spheres_scatter_as_rayleigh_said() {
        let (x, m2) = (0.01f64, 1.333f64 * 1.333);
        let [efficiency, g] = sphere(x, 1.333);
        let rayleigh = 8.0 / 3.0 * x.powi(4) * ((m2 - 1.0) / (m2 + 2.0)).powi(2);
        assert!(
            (efficiency / rayleigh - 1.0).abs() < 1e-3 && g.abs() < 1e-3,
            "{efficiency} {g}"
        );
    }

    /// Two ways to the same number: the series' asymmetry and the integral of its phase function.
    #[test]
    fn the_phase_function_agrees_with_the_asymmetry() {
        let n = 4000;
        let angle = |i: usize| PI * (i as f64 / n as f64).powi(2);
        let mu: Vec<f64> = (0..=n).map(|i| angle(i).cos()).collect();
        let droplets = Distribution {
            effective_radius_um: 6.0,
            effective_variance: 0.1,
        };
        let (phase, g) = droplets.phase(0.55, 1.333, &mu);
        let (mut whole, mut mean) = (0.0, 0.0);
        for i in 0..n {
            let width = 2.0 * PI * (mu[i] - mu[i + 1]) * 0.5;
            whole += width * (phase[i] + phase[i + 1]);
            mean += width * (phase[i] * mu[i] + phase[i + 1] * mu[i + 1]);
        }
        // Trapezia over 4000 angles.
        assert!((whole - 1.0).abs() < 1e-3, "{whole}");
        assert!((mean / whole - g).abs() < 1e-3, "{} {g}", mean / whole);
    }
}
