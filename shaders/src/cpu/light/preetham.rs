//! The clear sky after Preetham, Shirley and Smits (1999), "A Practical Analytic Model for Daylight".
//!
//! Reads: turbidity, the sun's zenith angle. Writes: radiance over the sun's irradiance above the air, by direction. Scheme: Perez's form F = (1 + A e^(B / cos z)) (1 + C e^(D g) + E cos2 g), z the zenith
//! angle looked at and g the angle to the sun, for luminance and both chromaticities, scaled to the zenith's values; coefficients of the paper's appendix A.2.
//! Turned from xyY into linear colours of ITU-R BT.709, over those of sunlight above the air.
//!
//! What it cannot: no sun below the horizon, no air between here and a cloud, no height of the viewer, no albedo of the ground. Fitted for turbidities 2 to 6; bounded to 2 to 10 here: below 2 the form runs to a pole (the zenith's 1 + A e^B is 0 near 1.645; at 1.7 the horizon is 35 times the zenith, at 2 six times), so that clearer air has the sky of 2.
//! Known faults (Zotti et al. 2007): too dark opposite the sun at low turbidity, too bright towards it at high.

use std::f32::consts::PI;

/// Turbidities that the fit is used for.
pub const TURBIDITY: [f32; 2] = [2.0, 10.0];
/// Illuminance by the sun above the air, lux (Darula, Kittler and Gueymard 2005).
const SUN_LUX: f32 = 133_334.0;
/// Chromaticity of sunlight above the air.
const SUN_XY: [f32; 2] = [0.3233, 0.3326];
/// Least cosine of a zenith angle: the horizon itself has no value.
const HORIZON_COSINE: f32 = 0.01;

/// Coefficients A to E as (a factor of turbidity, a constant), of Y, x and y.
const PEREZ: [[[f32; 2]; 5]; 3] = [
    [
        [0.1787, -1.4630],
        [-0.3554, 0.4275],
        [-0.0227, 5.3251],
        [0.1206, -2.5771],
        [-0.0670, 0.3703],
    ],
    [
        [-0.0193, -0.2592],
        [-0.0665, 0.0008],
        [-0.0004, 0.2125],
        [-0.0641, -0.8989],
        [-0.0033, 0.0452],
    ],
    [
        [-0.0167, -0.2608],
        [-0.0950, 0.0092],
        [-0.0079, 0.2102],
        [-0.0441, -1.6537],
        [-0.0109, 0.0529],
    ],
];
/// The zenith's x and y: rows by falling powers of turbidity, columns by falling powers of the sun's zenith angle.
const ZENITH_XY: [[[f32; 4]; 3]; 2] = [
    [
        [0.00166, -0.00375, 0.00209, 0.0],
        [-0.02903, 0.06377, -0.03202, 0.00394],
        [0.11693, -0.21196, 0.06052, 0.25886],
    ],
    [
        [0.00275, -0.00610, 0.00317, 0.0],
        [-0.04214, 0.08970, -0.04153, 0.00516],
        [0.15346, -0.26756, 0.06670, 0.26688],
    ],
];

/// Luminance of the zenith, cd/m2.
pub fn zenith_luminance_cd_m2(turbidity: f32, sun_zenith_rad: f32) -> f32 {
    let chi = (4.0 / 9.0 - turbidity / 120.0) * (PI - 2.0 * sun_zenith_rad);
    1e3 * ((4.0453 * turbidity - 4.9710) * chi.tan() - 0.2155 * turbidity + 2.4192)
}

/// Perez's form at cosines of the zenith angle and of the angle to the sun.
fn perez(k: &[f32; 5], cosine: f32, sun_cosine: f32) -> f32 {
    let angle = sun_cosine.clamp(-1.0, 1.0).acos();
    let [a, b, c, d, e] = *k;
    (1.0 + a * (b / cosine.max(HORIZON_COSINE)).exp()) * (1.0 + c * (d * angle).exp() + e * sun_cosine * sun_cosine)
}

/// Linear red, green and blue of ITU-R BT.709, of a chromaticity and a luminance.
fn rgb([x, y]: [f32; 2], luminance: f32) -> [f32; 3] {
    let per = luminance / y.max(1e-3);
    let (x, y, z) = (x * per, luminance, (1.0 - x - y) * per);
    [
        3.2406 * x - 1.5372 * y - 0.4986 * z,
        -0.9689 * x + 1.8758 * y + 0.0415 * z,
        0.0557 * x - 0.2040 * y + 1.0570 * z,
    ]
}

/// A sky by this model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Preetham {
    coefficients: [[f32; 5]; 3],
    /// What the forms are multiplied by: the zenith's values over the form there.
    scale: [f32; 3],
}

impl Preetham {
    /// For a turbidity, bounded to [`TURBIDITY`], and the sine of the sun's elevation, bounded to the upper half of the sky.
    pub fn new(turbidity: f32, sun_sine: f32) -> Preetham {
        let t = turbidity.clamp(TURBIDITY[0], TURBIDITY[1]);
        let sun_cosine = sun_sine.clamp(0.0, 1.0);
        let angle = sun_cosine.acos();
        let coefficients = PEREZ.map(|row| row.map(|[factor, constant]| factor * t + constant));
        let zenith_xy = ZENITH_XY.map(|rows| {
            let of = |row: [f32; 4]| row.iter().fold(0.0, |sum, k| sum * angle + k);
            (of(rows[0]) * t + of(rows[1])) * t + of(rows[2])
        });
        let zenith = [zenith_luminance_cd_m2(t, angle), zenith_xy[0], zenith_xy[1]];
        Preetham {
            coefficients,
            scale: [0, 1, 2].map(|n| zenith[n] / perez(&coefficients[n], 1.0, sun_cosine)),
        }
    }
    /// Luminance in cd/m2 and chromaticity, at the sine of an elevation and the cosine of the angle to the sun.
    pub fn luminance_xy(&self, sine: f32, sun_cosine: f32) -> [f32; 3] {
        [0, 1, 2].map(|n| self.scale[n] * perez(&self.coefficients[n], sine, sun_cosine))
    }
    /// Radiance over the sun's irradiance.
    pub fn radiance(&self, sine: f32, sun_cosine: f32) -> [f32; 3] {
        let [luminance, x, y] = self.luminance_xy(sine, sun_cosine);
        let (sky, sun) = (rgb([x, y], luminance.max(0.0)), rgb(SUN_XY, SUN_LUX));
        [0, 1, 2].map(|c| (sky[c] / sun[c]).max(0.0))
    }
}

/// Red, green and blue of sunlight above the air in linear colours of ITU-R BT.709, W/m2 weighted by the eye's response (683 lm/W).
pub(crate) fn sunlight_rgb() -> [f32; 3] {
    rgb(SUN_XY, SUN_LUX / 683.0)
}
