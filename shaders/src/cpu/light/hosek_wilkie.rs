//! The clear sky after Hosek and Wilkie (2012), "An Analytic Model for Full Spectral Sky-Dome Radiance".
//!
//! Reads: turbidity, the ground's albedo, the sun's elevation, the authors' data set for red, green and blue (`data/hosek-wilkie-rgb.f32`; its licence stands beside it). Writes: radiance over the sun's irradiance above
//! the air, by direction. Scheme: their extension of Perez's form by an anisotropic term and one for the zenith (equations 8 and 9); nine coefficients and a scale a colour, linear in turbidity and
//! albedo, quintic Bezier curves in the cube root of the elevation.
//!
//! What it cannot: no sun below the horizon, no air between here and a cloud, no height of the viewer. Turbidity 1 to 10, bounded. The data are those of the authors' sample
//! implementation as carried by the crate hw-skymodel 0.1.1, which itself is not kept up and would bring old versions of four crates.

use super::preetham::sunlight_rgb;

/// Turbidities of the data set.
pub const TURBIDITY: [f32; 2] = [1.0, 10.0];
const TURBIDITIES: usize = 10;
const COEFFICIENTS: usize = 9;
/// Control points of a curve.
const POINTS: usize = 6;
/// Numbers of a colour's coefficients: albedo 0 and 1, turbidity, control point, coefficient.
const COLOUR: usize = 2 * TURBIDITIES * POINTS * COEFFICIENTS;
/// Numbers of a colour's scale.
const SCALE: usize = 2 * TURBIDITIES * POINTS;

static DATA: &[u8; 4 * 3 * (COLOUR + SCALE)] = include_bytes!("../../../data/hosek-wilkie-rgb.f32");

fn number(n: usize) -> f32 {
    let bytes = &DATA[4 * n..4 * n + 4];
    f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])
}

/// A sky by this model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HosekWilkie {
    coefficients: [[f32; COEFFICIENTS]; 3],
    scale: [f32; 3],
}

impl HosekWilkie {
    /// For a turbidity, bounded to [`TURBIDITY`], the ground's albedo, and the sine of the sun's elevation, bounded to the upper half of the sky.
    pub fn new(turbidity: f32, albedo: [f32; 3], sun_sine: f32) -> HosekWilkie {
        let turbidity = turbidity.clamp(TURBIDITY[0], TURBIDITY[1]);
        let below = (turbidity as usize).clamp(1, TURBIDITIES - 1);
        let above = turbidity - below as f32;
        let elevation = sun_sine.clamp(0.0, 1.0).asin();
        let t = (elevation / std::f32::consts::FRAC_PI_2).cbrt();
        let bezier = [1.0, 5.0, 10.0, 10.0, 5.0, 1.0];
        let weights: [f32; POINTS] =
            std::array::from_fn(|i| bezier[i] * (1.0 - t).powi((POINTS - 1 - i) as i32) * t.powi(i as i32));
        // `first` numbers before a table of `width` numbers a control point.
        let value = |first: usize, width: usize, n: usize, albedo: f32| {
            let mut sum = 0.0;
            for (white, share) in [(0, 1.0 - albedo), (1, albedo)] {
                for (step, part) in [(below - 1, 1.0 - above), (below, above)] {
                    let row = first + (white * TURBIDITIES + step) * POINTS * width + n;
                    let curve: f32 = (0..POINTS).map(|i| weights[i] * number(row + i * width)).sum();
                    sum += share * part * curve;
                }
            }
            sum
        };
        let albedo = albedo.map(|a| a.clamp(0.0, 1.0));
        HosekWilkie {
            coefficients: [0, 1, 2].map(|c| std::array::from_fn(|n| value(c * COLOUR, COEFFICIENTS, n, albedo[c]))),
            scale: [0, 1, 2].map(|c| value(3 * COLOUR + c * SCALE, 1, 0, albedo[c])),
        }
    }
    /// The data set's radiance (W/m2/sr by the eye's response), at the sine of an elevation and the cosine of the angle to the sun.
    pub fn watts(&self, sine: f32, sun_cosine: f32) -> [f32; 3] {
        let (sine, cosine) = (sine.max(0.0), sun_cosine.clamp(-1.0, 1.0));
        let angle = cosine.acos();
        [0, 1, 2].map(|n| {
            let [a, b, c, d, e, f, g, i, h] = self.coefficients[n];
            let peak = (1.0 + cosine * cosine) / (1.0 + h * h - 2.0 * h * cosine).max(1e-6).powf(1.5);
            let form = (1.0 + a * (b / (sine + 0.01)).exp())
                * (c + d * (e * angle).exp() + f * cosine * cosine + g * peak + i * sine.sqrt());
            self.scale[n] * form
        })
    }
    /// Radiance over the sun's irradiance.
    pub fn radiance(&self, sine: f32, sun_cosine: f32) -> [f32; 3] {
        let (sky, sun) = (self.watts(sine, sun_cosine), sunlight_rgb());
        [0, 1, 2].map(|c| (sky[c] / sun[c]).max(0.0))
    }
}
