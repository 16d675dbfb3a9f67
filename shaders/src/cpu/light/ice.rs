//! Stage input: how crystals of ice scatter light, by rays.
//!
//! Reads: the length of hexagonal columns (or plates) over their width. Writes: the phase function at given angles, in three colours. Scheme: crystals lie at random; [`RAYS`]
//! rays meet each colour's where a sphere around them is met at random, are turned by Snell's law and parted by Fresnel's (of the two polarisations the mean; a random number picks
//! where each goes on), and are counted by the angle they leave at, in bins of [`BIN_DEG`]. Half of the extinction is diffraction, the edge's share by Babinet: Fraunhofer's pattern of discs of
//! [`CRYSTAL_RADIUS_UM`], sizes spread by half as much; rays that leave as they came (through parallel faces) are spread by it too. Counts are
//! smoothed by a bell of [`BLUR_DEG`], which stands for crystals that are not quite perfect.
//!
//! Keeps: the halos of 22 and 46 degrees with red inside, the integral over the sphere. Leaves out: polarisation, absorption (the index' imaginary part is below
//! 3e-9 in visible light), air bubbles, roughness beyond the blur. Errors: counts of the random rays, 1 to 3 % a bin before the blur. Source: the method is that of
//! Wendling, Wendling and Weickmann (1979) and Macke (1993); the index is Warren's (1984).

use std::f64::consts::{PI, TAU};

use rayon::prelude::*;

use super::mie::WAVELENGTHS_UM;

/// Index of ice at these wavelengths.
pub const ICE_INDEX: [f64; 3] = [1.307, 1.311, 1.316];
/// Rays a colour.
const RAYS: u64 = 400_000;
/// Rays that one task follows.
const RAYS_A_TASK: u64 = 10_000;
/// Faces that a ray meets at most; what is left then, a thousandth, is counted where it goes.
const FACES_MET_MAX: usize = 40;
/// Width of a bin, degrees.
const BIN_DEG: f64 = 0.25;
const BINS: usize = 720;
/// Standard deviation of the blur, degrees.
const BLUR_DEG: f64 = 0.35;
/// A ray that is turned by less than this, degrees, has gone straight on.
const STRAIGHT_DEG: f64 = 0.01;
/// Mean radius of the discs that diffract as the crystals do, micrometres.
pub const CRYSTAL_RADIUS_UM: f64 = 25.0;
/// Bounds of length over width.
pub const ASPECT_RANGE: [f64; 2] = [0.05, 20.0];

/// A hexagonal column whose width from corner to corner is 2.
struct Prism {
    half_length: f64,
    /// Half the width from side to side.
    inner: f64,
    index: f64,
}

/// A stream of random numbers for one ray: SplitMix64 (Steele et al. 2014).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 * (1.0 / 9_007_199_254_740_992.0)
    }
}

type Vector = [f64; 3];

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn along(from: Vector, d: Vector, t: f64) -> Vector {
    [0, 1, 2].map(|a| from[a] + d[a] * t)
}

impl Prism {
    /// Outward normals and distances from the centre of the eight faces.
    fn faces(&self) -> [(Vector, f64); 8] {
        let side = |n: usize| {
            let (s, c) = (n as f64 * TAU / 6.0).sin_cos();
            ([c, s, 0.0], self.inner)
        };
        let end = |z: f64| ([0.0, 0.0, z], self.half_length);
        [
            side(0),
            side(1),
            side(2),
            side(3),
            side(4),
            side(5),
            end(1.0),
            end(-1.0),
        ]
    }

    /// Where a line from outside meets the crystal first: distance and face.
    fn entry(faces: &[(Vector, f64); 8], from: Vector, d: Vector) -> Option<(f64, usize)> {
        let (mut near, mut far, mut face) = (f64::MIN, f64::MAX, 0);
        for (n, (normal, distance)) in faces.iter().enumerate() {
            let (towards, gap) = (dot(*normal, d), distance - dot(*normal, from));
            if towards.abs() < 1e-12 {
                if gap < 0.0 {
                    return None;
                }
            } else if towards < 0.0 {
                if gap / towards > near {
                    (near, face) = (gap / towards, n);
                }
            } else {
                far = far.min(gap / towards);
            }
        }
        (near < far).then_some((near, face))
    }

    /// Where a ray inside meets the crystal's face: distance and face.
    fn exit(faces: &[(Vector, f64); 8], from: Vector, d: Vector) -> (f64, usize) {
        let (mut far, mut face) = (f64::MAX, 0);
        for (n, (normal, distance)) in faces.iter().enumerate() {
            let towards = dot(*normal, d);
            if towards > 1e-12 {
                let t = (distance - dot(*normal, from)) / towards;
                if t < far {
                    (far, face) = (t, n);
                }
            }
        }
        (far.max(0.0), face)
    }

    /// The cosine of the angle by which a ray is turned that meets the crystal somewhere; none if it goes past.
    fn turned(&self, random: &mut Random) -> Option<f64> {
        let faces = self.faces();
        let z = 2.0 * random.next() - 1.0;
        let (s, c) = (TAU * random.next()).sin_cos();
        let side = (1.0 - z * z).max(0.0).sqrt();
        let d = [side * c, side * s, z];
        // Two directions across it.
        let across = if z.abs() < 0.9 {
            [0.0, 0.0, 1.0]
        } else {
            [1.0, 0.0, 0.0]
        };
        let u = unit(cross(d, across));
        let v = cross(d, u);
        let reach = (1.0 + self.half_length * self.half_length).sqrt();
        let radius = reach * random.next().sqrt();
        let (s, c) = (TAU * random.next()).sin_cos();
        let from = [0, 1, 2].map(|a| radius * (c * u[a] + s * v[a]) - 2.0 * reach * d[a]);
        let (t, face) = Prism::entry(&faces, from, d)?;
        let mut at = along(from, d, t);
        let (inward, share) = refracted(d, faces[face].0, 1.0 / self.index);
        if random.next() < share {
            return Some(dot(d, mirrored(d, faces[face].0)));
        }
        let mut way = inward?;
        for _ in 0..FACES_MET_MAX {
            let (t, face) = Prism::exit(&faces, at, way);
            at = along(at, way, t);
            let normal = faces[face].0;
            let (out, share) = refracted(way, normal, self.index);
            if let Some(out) = out
                && random.next() >= share
            {
                return Some(dot(d, out));
            }
            way = mirrored(way, normal);
        }
        Some(dot(d, way))
    }
}

fn cross(a: Vector, b: Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn unit(v: Vector) -> Vector {
    let length = dot(v, v).sqrt();
    v.map(|c| c / length)
}

fn mirrored(d: Vector, normal: Vector) -> Vector {
    along(d, normal, -2.0 * dot(d, normal))
}

/// A ray behind a face, and the share that the face mirrors: Snell's and Fresnel's laws for the index before over the index behind. None where it mirrors all.
fn refracted(d: Vector, normal: Vector, ratio: f64) -> (Option<Vector>, f64) {
    let falls = dot(d, normal);
    let towards = if falls > 0.0 { normal } else { normal.map(|c| -c) };
    let before = falls.abs();
    let behind_squared = 1.0 - ratio * ratio * (1.0 - before * before);
    if behind_squared <= 0.0 {
        return (None, 1.0);
    }
    let behind = behind_squared.sqrt();
    let across = (ratio * before - behind) / (ratio * before + behind);
    let within = (before - ratio * behind) / (before + ratio * behind);
    let out = [0, 1, 2].map(|a| ratio * (d[a] - before * towards[a]) + behind * towards[a]);
    (Some(unit(out)), 0.5 * (across * across + within * within))
}

/// Rays of a colour by the angle they are turned by: those that go straight on, and the bins of the others.
fn counts(prism: &Prism) -> (u64, Vec<u64>) {
    let tasks = RAYS / RAYS_A_TASK;
    let one = |task: u64| {
        let (mut straight, mut bins) = (0u64, vec![0u64; BINS]);
        for ray in 0..RAYS_A_TASK {
            // The same rays for each colour, so that colours are not parted by chance.
            let mut random = Random((task * RAYS_A_TASK + ray).wrapping_mul(0xd134_2543_de82_ef95));
            if let Some(mu) = prism.turned(&mut random) {
                let angle = mu.clamp(-1.0, 1.0).acos().to_degrees();
                if angle < STRAIGHT_DEG {
                    straight += 1;
                } else {
                    bins[((angle / BIN_DEG) as usize).min(BINS - 1)] += 1;
                }
            }
        }
        (straight, bins)
    };
    let sum = |mut a: (u64, Vec<u64>), b: (u64, Vec<u64>)| {
        a.0 += b.0;
        for (a, b) in a.1.iter_mut().zip(&b.1) {
            *a += b;
        }
        a
    };
    (0..tasks).into_par_iter().map(one).reduce(|| (0, vec![0; BINS]), sum)
}

/// Fraunhofer's pattern of discs of radii from half to one and a half of the mean, a steradian; its integral is 1 but for what falls sideways.
fn diffracted(mu: f64, wavelength_um: f64) -> f64 {
    if mu <= 0.0 {
        return 0.0;
    }
    let sine = (1.0 - mu * mu).max(0.0).sqrt();
    let radii = 24;
    let of = |n: usize| {
        let size = TAU * CRYSTAL_RADIUS_UM * (0.5 + (n as f64 + 0.5) / radii as f64) / wavelength_um;
        let z = size * sine;
        let airy = if z < 1e-4 { 1.0 } else { 2.0 * bessel_1(z) / z };
        // Each disc takes as much light as it is large.
        (size * size, size * size / (4.0 * PI) * airy * airy)
    };
    let (weights, sum) = (0..radii)
        .map(of)
        .fold((0.0, 0.0), |(w, s), (weight, value)| (w + weight, s + weight * value));
    sum / weights
}

/// Bessel's J1 by its integral; the sum over a period converges as soon as there are more points than `z`.
fn bessel_1(z: f64) -> f64 {
    let points = (z as usize + 24) / 2 * 2;
    let sum: f64 = (0..points)
        .map(|n| (n as f64 + 0.5) * PI / points as f64)
        .map(|t| (t - z * t.sin()).cos())
        .sum();
    sum / points as f64
}

/// The phase function at angles of these cosines, 1/sr, in three colours; `aspect_ratio` is length over width, within [`ASPECT_RANGE`]. About a second of one core.
pub fn phase(aspect_ratio: f64, cosines: &[f64]) -> [Vec<f64>; 3] {
    [0, 1, 2].map(|c| {
        let prism = Prism {
            half_length: aspect_ratio.clamp(ASPECT_RANGE[0], ASPECT_RANGE[1]),
            inner: 0.75f64.sqrt(),
            index: ICE_INDEX[c],
        };
        let (straight, bins) = counts(&prism);
        let all = (straight + bins.iter().sum::<u64>()) as f64;
        let straight = straight as f64 / all;
        let reach = (4.0 * BLUR_DEG / BIN_DEG).ceil() as i64;
        let smoothed = |mu: f64| {
            let angle = mu.clamp(-1.0, 1.0).acos().to_degrees();
            let middle = (angle / BIN_DEG) as i64;
            let (mut rays, mut sphere) = (0.0, 0.0);
            for n in (middle - reach).max(0)..=(middle + reach).min(BINS as i64 - 1) {
                let at = (n as f64 + 0.5) * BIN_DEG;
                let weight = (-0.5 * ((at - angle) / BLUR_DEG).powi(2)).exp();
                rays += weight * bins[n as usize] as f64;
                let [from, to] = [at - 0.5 * BIN_DEG, at + 0.5 * BIN_DEG].map(|a| a.to_radians().cos());
                sphere += weight * TAU * (from - to);
            }
            rays / (sphere * all)
        };
        let value = |mu: &f64| {
            let peak = diffracted(*mu, WAVELENGTHS_UM[c]);
            // At least what a millionth of the light would give: no angle is quite dark.
            (0.5 * (peak + straight * peak + smoothed(*mu))).max(1e-6)
        };
        cosines.par_iter().map(value).collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// J1 at 1 and at its third zero (Abramowitz and Stegun, tables 9.1 and 9.5).
    #[test]
    fn bessel_agrees_with_its_table() {
        assert!((bessel_1(1.0) - 0.440_050_585_744_933_5).abs() < 1e-12);
        assert!(bessel_1(10.173_468_135_062_722).abs() < 1e-9);
        assert!((bessel_1(300.0) - -0.031_887_431_377_499_95).abs() < 1e-9);
    }

    /// Fresnel at right angles: ((n - 1) / (n + 1))^2; at the angle of total reflection nothing goes on.
    #[test]
    fn faces_mirror_what_fresnel_says() {
        let (through, share) = refracted([0.0, 0.0, 1.0], [0.0, 0.0, 1.0], 1.311);
        assert_eq!(through, Some([0.0, 0.0, 1.0]));
        assert!((share - (0.311f64 / 2.311).powi(2)).abs() < 1e-12);
        let steep = (1.0 / 1.311f64).asin() + 1e-3;
        let (through, share) = refracted([steep.sin(), 0.0, steep.cos()], [0.0, 0.0, 1.0], 1.311);
        assert_eq!((through, share), (None, 1.0));
    }

    /// A column is met as often as its mean shadow is large: a quarter of its surface (Cauchy).
    #[test]
    fn a_crystal_is_met_by_a_quarter_of_its_surface() {
        for half_length in [0.2, 1.0, 4.0] {
            let prism = Prism {
                half_length,
                inner: 0.75f64.sqrt(),
                index: 1.311,
            };
            let surface = 2.0 * 1.5 * 3f64.sqrt() + 6.0 * 2.0 * half_length;
            let reach = (1.0 + half_length * half_length).sqrt();
            let n = 40_000u64;
            let met = (0..n).filter(|i| {
                prism
                    .turned(&mut Random(i.wrapping_mul(0xd134_2543_de82_ef95)))
                    .is_some()
            });
            let shadow = met.count() as f64 / n as f64 * PI * reach * reach;
            // A random share of 40,000: three standard deviations are 1.5 %, more where few meet a long column.
            assert!(
                (shadow / (surface / 4.0) - 1.0).abs() < 0.03,
                "{half_length}: {shadow} {}",
                surface / 4.0
            );
        }
    }
}
