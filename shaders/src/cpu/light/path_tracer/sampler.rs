//! Random numbers, and directions drawn from a phase function.

use std::f64::consts::PI;

use crate::cpu::light::phase_table::{
    PHASE_HALF_NODES, PHASE_NODES, PhaseChoice, at_nodes, chopped, node_cosine, ordered,
};

/// Random numbers that depend on their place alone: a hash (SplitMix64's finaliser; Steele et al. 2014) of a key and a counter.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Random {
    key: u64,
    count: u64,
}

fn mix(mut v: u64) -> u64 {
    v = (v ^ (v >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    v = (v ^ (v >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    v ^ (v >> 31)
}

impl Random {
    /// Those of one sample of one pixel.
    pub(crate) fn new(pixel: u64, sample: u64) -> Random {
        const ODD: u64 = 0x9e37_79b9_7f4a_7c15;
        Random {
            key: mix(mix(pixel.wrapping_add(ODD)).wrapping_add(sample.wrapping_mul(ODD))),
            count: 0,
        }
    }
    /// From 0, included, to 1, excluded.
    pub(crate) fn next(&mut self) -> f64 {
        self.count = self.count.wrapping_add(0x9e37_79b9_7f4a_7c15);
        (mix(self.key.wrapping_add(self.count)) >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }
}

/// A part of a phase function: linear in the cosine between nodes, so that drawing and value agree exactly.
#[derive(Clone, Debug)]
pub(crate) struct Part {
    /// Its integral over the sphere, mean of the colours.
    pub(crate) share: f64,
    /// Falling.
    cosines: Vec<f64>,
    mean: Vec<f64>,
    colours: [Vec<f64>; 3],
    /// Integral up to each node.
    sums: Vec<f64>,
}

impl Part {
    fn new(colours: [Vec<f64>; 3]) -> Part {
        let order: Vec<usize> = ordered().collect();
        let cosines: Vec<f64> = order.iter().map(|n| node_cosine(*n)).collect();
        let colours = colours.map(|c| order.iter().map(|n| c[*n]).collect::<Vec<f64>>());
        let mean: Vec<f64> = (0..order.len())
            .map(|i| (colours[0][i] + colours[1][i] + colours[2][i]) / 3.0)
            .collect();
        let mut sums = vec![0.0];
        for i in 1..order.len() {
            sums.push(sums[i - 1] + PI * (cosines[i - 1] - cosines[i]) * (mean[i - 1] + mean[i]));
        }
        Part {
            share: sums[order.len() - 1],
            cosines,
            mean,
            colours,
            sums,
        }
    }
    /// The node before a cosine, and how far it is towards the next.
    fn place(&self, mu: f64) -> (usize, f64) {
        let last = (PHASE_HALF_NODES - 1) as f64;
        let from_front = if mu >= 0.0 {
            (1.0 - mu).max(0.0).sqrt().sqrt() * last
        } else {
            (PHASE_NODES - 2) as f64 - (1.0 + mu).max(0.0).sqrt() * last
        };
        let mut i = (from_front as usize).min(self.cosines.len() - 2);
        // Rounding of the roots may be off by a node.
        while i > 0 && self.cosines[i] < mu {
            i -= 1;
        }
        while i + 2 < self.cosines.len() && self.cosines[i + 1] > mu {
            i += 1;
        }
        let width = self.cosines[i] - self.cosines[i + 1];
        (i, ((self.cosines[i] - mu) / width).clamp(0.0, 1.0))
    }
    /// 1/sr, each colour and the mean last.
    pub(crate) fn value(&self, mu: f64) -> [f64; 4] {
        let (i, f) = self.place(mu);
        let at = |v: &[f64]| v[i] + (v[i + 1] - v[i]) * f;
        [
            at(&self.colours[0]),
            at(&self.colours[1]),
            at(&self.colours[2]),
            at(&self.mean),
        ]
    }
    /// A cosine, and what each colour weighs against the mean there.
    pub(crate) fn draw(&self, random: &mut Random) -> (f64, [f64; 3]) {
        let wanted = random.next() * self.share;
        let i = (self.sums.partition_point(|s| *s <= wanted)).clamp(1, self.sums.len() - 1) - 1;
        let (p0, p1) = (self.mean[i], self.mean[i + 1]);
        let part = ((wanted - self.sums[i]) / (self.sums[i + 1] - self.sums[i])).clamp(0.0, 1.0);
        let root = (p0 * p0 + (p1 * p1 - p0 * p0) * part).max(0.0).sqrt();
        let f = if p0 + root > 0.0 {
            part * (p0 + p1) / (p0 + root)
        } else {
            part
        };
        let mu = self.cosines[i] + (self.cosines[i + 1] - self.cosines[i]) * f;
        let mean = p0 + (p1 - p0) * f;
        let weights = [0, 1, 2].map(|c| {
            let v = &self.colours[c];
            if mean > 0.0 {
                (v[i] + (v[i + 1] - v[i]) * f) / mean
            } else {
                1.0
            }
        });
        (mu, weights)
    }
}

/// A phase function as the sum of its forward peak, cut at 8 degrees, and the rest.
#[derive(Clone, Debug)]
pub struct Scatterer {
    pub(crate) peak: Part,
    pub(crate) rest: Part,
}

impl Scatterer {
    /// Of the whole function; a peak that the choice would cut off stays in. Mie's takes some tenths of a second.
    pub fn new(choice: PhaseChoice) -> Scatterer {
        let colours = at_nodes(choice);
        let parts = [0, 1, 2].map(|c| chopped(&colours[c]));
        let peak = Part::new([0, 1, 2].map(|c| parts[c][1].clone()));
        // A flat function has no peak worth a case of its own.
        if peak.share < 0.02 {
            return Scatterer {
                peak: Part::new([0, 1, 2].map(|_| vec![0.0; PHASE_NODES])),
                rest: Part::new(colours),
            };
        }
        Scatterer {
            peak,
            rest: Part::new(parts.map(|[rest, _]| rest)),
        }
    }
    /// The cosine of an angle to be turned by, of the whole function.
    pub(crate) fn draw_cosine(&self, random: &mut Random) -> f64 {
        let by_peak = random.next() * (self.peak.share + self.rest.share) < self.peak.share;
        let part = if by_peak { &self.peak } else { &self.rest };
        part.draw(random).0
    }
    /// Peak and rest as one.
    #[cfg(test)]
    pub(crate) fn whole_part(&self) -> Part {
        let mut part = self.rest.clone();
        part.share += self.peak.share;
        let parts = part.sums.iter_mut().zip(&self.peak.sums);
        parts.for_each(|(to, v)| *to += v);
        part.mean.iter_mut().zip(&self.peak.mean).for_each(|(to, v)| *to += v);
        for c in 0..3 {
            let colours = part.colours[c].iter_mut().zip(&self.peak.colours[c]);
            colours.for_each(|(to, v)| *to += v);
        }
        part
    }
}

/// The unit vector at an angle of cosine `mu` from `from`, at a random azimuth. The frame is that of Duff et al. (2017).
pub(crate) fn turned(from: &[f64; 3], mu: f64, random: &mut Random) -> [f64; 3] {
    let [x, y, z] = *from;
    let sign = 1f64.copysign(z);
    let a = -1.0 / (sign + z);
    let b = x * y * a;
    let side = [1.0 + sign * x * x * a, sign * b, -sign * x];
    let other = [b, sign + y * y * a, -y];
    let azimuth = 2.0 * PI * random.next();
    let sine = (1.0 - mu * mu).max(0.0).sqrt();
    let (s, c) = azimuth.sin_cos();
    let v = [0, 1, 2].map(|i| mu * from[i] + sine * (c * side[i] + s * other[i]));
    let length = dot(&v, &v).sqrt();
    v.map(|p| p / length)
}

pub(crate) fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drawn_cosines_follow_the_function() {
        let g = 0.85;
        let scatterer = Scatterer::new(PhaseChoice::HenyeyGreenstein { asymmetry: 0.85 });
        let (peak, rest) = (&scatterer.peak, &scatterer.rest);
        assert!((peak.share + rest.share - 1.0).abs() < 1e-9);
        let mut random = Random::new(3, 4);
        let n = 200_000;
        let mut sum = 0.0;
        for _ in 0..n {
            let part = if random.next() < peak.share { peak } else { rest };
            sum += part.draw(&mut random).0;
        }
        // The cosine's deviation is about 0.27: three times 0.27 / n^0.5 is 0.002.
        assert!((sum / n as f64 - g).abs() < 0.002, "{}", sum / n as f64);
        for mu in [-1.0, -0.3, 0.0, 0.4, 0.99, 1.0f64] {
            let d = 1.0 + g * g - 2.0 * g * mu;
            let truth = (1.0 - g * g) / (4.0 * PI * d.powf(1.5));
            let ours = peak.value(mu)[3] + rest.value(mu)[3];
            // Lines between 1023 nodes.
            assert!((ours / truth - 1.0).abs() < 2e-4, "{mu}: {ours} {truth}");
        }
    }

    #[test]
    fn a_turned_direction_has_the_angle() {
        let mut random = Random::new(1, 1);
        for from in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, -0.8]] {
            let v = turned(&from, 0.3, &mut random);
            assert!((dot(&v, &from) - 0.3).abs() < 1e-12 && (dot(&v, &v) - 1.0).abs() < 1e-12);
        }
    }
}
