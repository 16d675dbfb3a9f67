//! Stage `haze`: what the air between the camera and a place takes away.
//!
//! Reads: [`Atmosphere`], the camera's height, a ray. Writes: transmittance, three colours. Scheme: optical depth of two exponential
//! layers (molecules, aerosol) along a straight ray over flat ground, in closed form. The light that the air adds is the sky
//! table's radiance times `(1 - T(distance)) / (1 - T(end of the ray))`, exact where the source is even along the ray.

use super::lanes::Lanes;
use crate::cpu::light::atmosphere::{AEROSOL_HEIGHT_M, Atmosphere, RAYLEIGH_HEIGHT_M, RAYLEIGH_PER_M};

/// Extinction at the camera.
#[derive(Clone, Copy, Debug)]
pub struct Haze {
    /// Scattering by molecules, 1/m.
    pub rayleigh_per_m: [f32; 3],
    /// Extinction by aerosol, 1/m.
    pub aerosol_per_m: f32,
}

impl Haze {
    /// Air at `height_m` above the ground.
    pub fn new(air: &Atmosphere, height_m: f32) -> Haze {
        let c = air.at(height_m);
        let molecules = c.rayleigh_per_m[1] / RAYLEIGH_PER_M[1];
        Haze {
            rayleigh_per_m: RAYLEIGH_PER_M.map(|b| b * molecules),
            aerosol_per_m: (-height_m.max(0.0) / AEROSOL_HEIGHT_M).exp() * air.aerosol_per_m,
        }
    }
    /// Transmittance over `distance_m` along rays of slope `rise` (sine of the elevation).
    #[inline(always)]
    pub(crate) fn transmittance(&self, distance_m: Lanes, rise: Lanes) -> [Lanes; 3] {
        let molecules = layer(distance_m, rise, RAYLEIGH_HEIGHT_M);
        let aerosol = layer(distance_m, rise, AEROSOL_HEIGHT_M) * self.aerosol_per_m;
        let mut passed = [aerosol; 3];
        for c in 0..3 {
            passed[c] = (Lanes::splat(0.0) - molecules * self.rayleigh_per_m[c] - aerosol).exp();
        }
        passed
    }
}

/// Integral of exp(-climb / scale height) over the path, m.
#[inline(always)]
fn layer(distance_m: Lanes, rise: Lanes, scale_height_m: f32) -> Lanes {
    let x = (distance_m * rise * (1.0 / scale_height_m)).clamp(-20.0, 1e6);
    let exact = (Lanes::splat(1.0) - (Lanes::splat(0.0) - x).exp()) / x;
    let series = Lanes::splat(1.0) - x * 0.5;
    distance_m * Lanes::select_less(x * x, Lanes::splat(1e-4), series, exact)
}
