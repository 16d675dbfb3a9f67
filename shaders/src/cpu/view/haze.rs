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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::light::atmosphere::EARTH_RADIUS_M;

    /// Transmittance over a way through the same air in steps of a metre, in 64 bits; over the Earth as it is or flat, ozone included or not.
    fn stepped(air: &Atmosphere, height_m: f64, rise: f64, distance_m: f64, curved: bool) -> [f64; 3] {
        let radius = f64::from(EARTH_RADIUS_M) + height_m;
        let steps = distance_m as usize;
        let step = distance_m / steps as f64;
        let mut depth = [0.0; 3];
        for n in 0..steps {
            let t = (n as f64 + 0.5) * step;
            let height = if curved {
                (radius * radius + 2.0 * radius * rise * t + t * t).sqrt() - f64::from(EARTH_RADIUS_M)
            } else {
                height_m + rise * t
            };
            let here = air.at(height as f32);
            for c in 0..3 {
                let aerosol = f64::from(air.aerosol_per_m) * (-height.max(0.0) / f64::from(AEROSOL_HEIGHT_M)).exp();
                let extinction = if curved {
                    f64::from(here.extinction_per_m[c])
                } else {
                    f64::from(here.rayleigh_per_m[c]) + aerosol
                };
                depth[c] += extinction * step;
            }
        }
        depth.map(|d| (-d).exp())
    }

    /// Over flat ground and without ozone the closed form is exact to rounding. Over a round Earth it is out where a way ends in thick air far off, which has sunk by 126 m at
    /// 40 km, a tenth of the aerosol's scale height: from 6 km down to the ground the haze takes away 2 % of the light too much. Ways that end in the ozone layer, above all
    /// but the highest clouds, lack its green.
    #[test]
    fn haze_is_that_of_the_air_stepped_through() {
        const OZONE_BEGINS_M: f64 = 9_700.0;
        let (mut form, mut below, mut through): (f64, f64, f64) = (0.0, 0.0, 0.0);
        for visibility_m in [None, Some(10_000.0), Some(40_000.0)] {
            let air = Atmosphere::new(200.0, visibility_m);
            for height_m in [2.0, 1_500.0, 6_000.0] {
                let haze = Haze::new(&air, height_m as f32);
                for distance_m in [5_000.0, 10_000.0, 20_000.0, 40_000.0] {
                    let floor = f64::max(-height_m / distance_m, -1.0);
                    // Down to the ground and half as steep, level, up at all slopes.
                    for rise in [floor, 0.5 * floor, 0.0, 1e-4, 0.05, 0.3, 1.0] {
                        let ours = haze.transmittance(Lanes::splat(distance_m as f32), Lanes::splat(rise as f32));
                        let [flat, round] =
                            [false, true].map(|curved| stepped(&air, height_m, rise, distance_m, curved));
                        for c in 0..3 {
                            let ours = f64::from(ours[c].0[5]);
                            form = form.max((ours - flat[c]).abs());
                            let highest = height_m + rise * distance_m;
                            let most = if highest < OZONE_BEGINS_M {
                                &mut below
                            } else {
                                &mut through
                            };
                            *most = most.max((ours - round[c]).abs());
                        }
                    }
                }
            }
        }
        assert!(form < 1e-5, "closed form: {form}");
        assert!(below < 0.025, "round Earth: {below}");
        assert!(through < 0.03, "ozone: {through}");
    }
}
