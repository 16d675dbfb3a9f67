//! Stage input: what the clear air is made of.
//!
//! Rayleigh scattering by molecules, scattering and absorption by aerosol, absorption by ozone. Coefficients at sea level
//! after Hillaire (2020), "A Scalable and Production Ready Sky and Atmosphere Rendering Technique", table 1. With a
//! visibility, the aerosol is what Koschmieder's law asks for: extinction near the ground = 3 / visibility.

crate::constants! {
    /// Radius of the Earth, m.
    pub const EARTH_RADIUS_M: f32 = 6_360_000.0;
    /// Depth of air that is marched through, m.
    pub const AIR_DEPTH_M: f32 = 80_000.0;
    /// Scattering of red light by molecules at sea level, 1/m.
    pub const RAYLEIGH_RED_PER_M: f32 = 5.802e-6;
    /// The same of green light.
    pub const RAYLEIGH_GREEN_PER_M: f32 = 13.558e-6;
    /// The same of blue light.
    pub const RAYLEIGH_BLUE_PER_M: f32 = 33.1e-6;
    /// Absorption of red light by ozone at the layer's middle, 1/m.
    const OZONE_RED_PER_M: f32 = 0.650e-6;
    /// The same of green light.
    const OZONE_GREEN_PER_M: f32 = 1.881e-6;
    /// The same of blue light.
    const OZONE_BLUE_PER_M: f32 = 0.085e-6;
    /// Height of the ozone layer's middle above sea level, m.
    const OZONE_MIDDLE_M: f32 = 25_000.0;
    /// Distance from there to where the layer ends, m.
    const OZONE_HALF_DEPTH_M: f32 = 15_000.0;
    /// Scale height of molecules, m.
    pub const RAYLEIGH_HEIGHT_M: f32 = 8_000.0;
    /// Scale height of aerosol, m.
    pub const AEROSOL_HEIGHT_M: f32 = 1_200.0;
    /// Share of aerosol extinction that is scattering.
    pub(crate) const AEROSOL_ALBEDO: f32 = 0.92;
    /// Asymmetry of aerosol scattering.
    pub const AEROSOL_ASYMMETRY: f32 = 0.76;
}
/// Scattering by molecules at sea level, red, green, blue, 1/m.
pub const RAYLEIGH_PER_M: [f32; 3] = [RAYLEIGH_RED_PER_M, RAYLEIGH_GREEN_PER_M, RAYLEIGH_BLUE_PER_M];
/// Absorption by ozone at the layer's middle, 1/m.
const OZONE_PER_M: [f32; 3] = [OZONE_RED_PER_M, OZONE_GREEN_PER_M, OZONE_BLUE_PER_M];
/// Extinction by aerosol near the ground in clean air, 1/m.
const CLEAN_AEROSOL_PER_M: f32 = 4.4e-6;

/// The clear air over a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Atmosphere {
    /// Height of the ground above mean sea level, m.
    pub surface_altitude_m: f32,
    /// Extinction by aerosol near the ground, 1/m.
    pub aerosol_per_m: f32,
}

/// Coefficients at one height.
#[derive(Clone, Copy, Debug)]
pub struct Coefficients {
    /// Scattering by molecules, 1/m.
    pub rayleigh_per_m: [f32; 3],
    /// Scattering by aerosol, 1/m.
    pub aerosol_per_m: f32,
    /// All extinction, 1/m.
    pub extinction_per_m: [f32; 3],
}

impl Atmosphere {
    /// Air over ground at `surface_altitude_m`; without a visibility, clean air. Absurd numbers are bounded: altitude to
    /// -500 to 9000 m, visibility to 500 m and more.
    pub fn new(surface_altitude_m: f32, visibility_m: Option<f32>) -> Atmosphere {
        let bounded = |v: f32, low: f32, high: f32| if v.is_finite() { v.clamp(low, high) } else { low };
        Atmosphere {
            surface_altitude_m: if surface_altitude_m.is_finite() {
                surface_altitude_m.clamp(-500.0, 9_000.0)
            } else {
                0.0
            },
            aerosol_per_m: match visibility_m {
                Some(v) => (3.0 / bounded(v, 500.0, 1.0e6) - RAYLEIGH_PER_M[1]).max(1.0e-6),
                None => CLEAN_AEROSOL_PER_M,
            },
        }
    }
    /// Coefficients at `height_m` above the ground.
    #[inline]
    pub fn at(&self, height_m: f32) -> Coefficients {
        let altitude_m = self.surface_altitude_m + height_m;
        let molecules = (-altitude_m / RAYLEIGH_HEIGHT_M).exp();
        let aerosol = (-height_m.max(0.0) / AEROSOL_HEIGHT_M).exp() * self.aerosol_per_m;
        let ozone = (1.0 - (altitude_m - OZONE_MIDDLE_M).abs() / OZONE_HALF_DEPTH_M).max(0.0);
        let rayleigh_per_m = RAYLEIGH_PER_M.map(|b| b * molecules);
        Coefficients {
            rayleigh_per_m,
            aerosol_per_m: aerosol * AEROSOL_ALBEDO,
            extinction_per_m: [0, 1, 2].map(|c| rayleigh_per_m[c] + aerosol + OZONE_PER_M[c] * ozone),
        }
    }
}

/// Distance in m from height `height_m` along a ray whose cosine to the zenith is `mu` to a sphere at `shell_height_m`
/// above the ground: the far crossing, for a shell above.
#[inline]
pub fn distance_to_shell_m(height_m: f32, mu: f32, shell_height_m: f32) -> f32 {
    let r = (EARTH_RADIUS_M + height_m) as f64;
    let shell = (EARTH_RADIUS_M + shell_height_m) as f64;
    let mu = mu as f64;
    let inside = (shell - r) * (shell + r) + (r * mu) * (r * mu);
    (-r * mu + inside.max(0.0).sqrt()).max(0.0) as f32
}

/// Distance in m to the ground, or none if the ray passes over the horizon.
#[inline]
pub fn distance_to_ground_m(height_m: f32, mu: f32) -> Option<f32> {
    let r = (EARTH_RADIUS_M + height_m) as f64;
    let ground = EARTH_RADIUS_M as f64;
    let mu = mu as f64;
    let under_root = (ground - r) * (ground + r) + (r * mu) * (r * mu);
    (mu < 0.0 && under_root >= 0.0).then(|| ((-r * mu - under_root.sqrt()).max(0.0)) as f32)
}

/// Height above the ground after `distance_m` along a ray, m, and the radius' cosine change is left to the caller.
#[inline]
pub fn height_along_m(height_m: f32, mu: f32, distance_m: f32) -> f32 {
    // (r^2 + 2 r mu d + d^2)^0.5 - R, without cancellation.
    let r = (EARTH_RADIUS_M + height_m) as f64;
    let d = distance_m as f64;
    let rise = 2.0 * r * mu as f64 * d + d * d;
    height_m + (rise / ((r * r + rise).max(0.0).sqrt() + r)) as f32
}
