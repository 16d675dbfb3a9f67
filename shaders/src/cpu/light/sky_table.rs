//! Stage `sky_table`: the clear sky's radiance as seen from the camera.
//!
//! Reads: [`Atmosphere`], [`TransmittanceTable`], [`MultipleScatteringTable`], a [`SkySource`] (the sun with the night sky's own light, or the moon), the camera's
//! height. Writes: radiance over the sun's irradiance, `[colour 3][elevation 2 x 56][azimuth from the sun 48]`; the lower half
//! of the rows looks at the ground and holds the light scattered in between, the upper half looks at space. Rows are dense near the
//! horizon, columns near the sun. Scheme: single scattering by 28 steps (112 at dusk), each integrated in closed form, plus the isotropic higher
//! orders. Source: Hillaire (2020), section 5.3. The source's disc is not in the table.
//!
//! The night sky's own light (airglow, zodiacal light, stars too faint to be drawn) comes from a layer at 90 km, brighter towards the horizon by van Rhijn's
//! law, and is scattered by the air as an even light.

use rayon::prelude::*;

use super::analytic_sky::AnalyticSky;
use super::atmosphere::{
    AEROSOL_ASYMMETRY, AIR_DEPTH_M, Atmosphere, EARTH_RADIUS_M, distance_to_ground_m, distance_to_shell_m,
    height_along_m,
};
use super::multiple_scattering_table::{MultipleScatteringTable, local_sun_cosine};
use super::phase::{henyey_greenstein, rayleigh};
use super::transmittance_table::TransmittanceTable;
use crate::cpu::view::lanes::Lanes;

crate::constants! {
    /// Rows of each half.
    pub const SKY_HALF_ROWS: usize = 56;
    /// Columns.
    pub const SKY_COLUMNS: usize = 48;
    const SKY_STEPS: usize = 28;
    /// The same while the source is below the horizon: the Earth's shadow crosses the ray, and steps show as bands.
    const SKY_STEPS_DUSK: usize = 112;
    /// Even light that pictures without an effect of the night are given, over the sun's irradiance: keeps them above black.
    pub const AIRGLOW: f32 = 2.0e-7;
    /// Height of the layer that the night sky's own light is taken to come from, m.
    const GLOW_HEIGHT_M: f32 = 90_000.0;
    /// The night sky's own light in the zenith over the sun's irradiance, 1/sr: 20.9, 21.6 and 22.6 magnitudes a square second of arc in R, V and B (Patat 2003, Paranal),
    /// against the sun's -27.10, -26.74 and -26.09.
    const GLOW_RED: f32 = 2.69e-9;
    /// See [`GLOW_RED`].
    const GLOW_GREEN: f32 = 1.96e-9;
    /// See [`GLOW_RED`].
    const GLOW_BLUE: f32 = 1.42e-9;
    /// Mean over all directions of that light against the zenith's, as the air scatters it: half the directions look at the ground, and the layer is brighter below the zenith.
    const GLOW_MEAN: f32 = 0.85;
}

/// What lights a sky.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkySource {
    /// Unit vector towards it.
    pub direction: [f32; 3],
    /// Its irradiance over the sun's, red, green, blue.
    pub strength: [f32; 3],
    /// Even light that the air scatters besides, times the source's strength.
    pub scattered_glow: [f32; 3],
    /// Light of the layer above the air in the zenith, times the source's strength.
    pub layer_glow: [f32; 3],
}

impl SkySource {
    /// The sun; with the night sky's own light where pictures adapt to the dark.
    pub fn sun(direction: [f32; 3], night: bool) -> SkySource {
        let glow = [GLOW_RED, GLOW_GREEN, GLOW_BLUE];
        SkySource {
            direction,
            strength: [1.0; 3],
            scattered_glow: if night {
                glow.map(|g| g * GLOW_MEAN)
            } else {
                [AIRGLOW; 3]
            },
            layer_glow: if night { glow } else { [0.0; 3] },
        }
    }
    /// The moon, with its irradiance over the sun's.
    pub fn moon(direction: [f32; 3], irradiance: [f32; 3]) -> SkySource {
        SkySource {
            direction,
            strength: irradiance,
            scattered_glow: [0.0; 3],
            layer_glow: [0.0; 3],
        }
    }
}

/// See the module.
#[derive(Clone, Debug)]
pub struct SkyTable {
    planes: [Vec<f32>; 3],
    /// Sine of the horizon's elevation; not above 0.
    pub horizon_sine: f32,
    sun_azimuth: [f32; 2],
}

/// Sine of the elevation of the horizon seen from `height_m`.
pub fn horizon_sine(height_m: f32) -> f32 {
    let q = 2.0 * height_m.max(0.0) / EARTH_RADIUS_M;
    -(q / (1.0 + q)).sqrt()
}

/// The sun's direction on the ground, a unit vector; east where it stands in the zenith.
pub fn sun_azimuth(sun_direction: [f32; 3]) -> [f32; 2] {
    let horizontal = (sun_direction[0].powi(2) + sun_direction[1].powi(2)).sqrt();
    if horizontal > 1e-4 {
        [sun_direction[0] / horizontal, sun_direction[1] / horizontal]
    } else {
        [1.0, 0.0]
    }
}

impl SkyTable {
    /// Computes the table; a few ms on two threads. A formula takes the place of the rays that do not end at the ground.
    pub fn new(
        air: &Atmosphere,
        transmittance: &TransmittanceTable,
        multiple: &MultipleScatteringTable,
        source: &SkySource,
        analytic: Option<&AnalyticSky>,
        height_m: f32,
    ) -> SkyTable {
        let horizon = horizon_sine(height_m);
        let [x, y, z] = source.direction;
        let turned = SkySource {
            direction: [(x * x + y * y).sqrt(), 0.0, z],
            ..*source
        };
        let formula = analytic.map(|a| a.towards(turned.direction));
        let texels: Vec<[f32; 3]> = (0..2 * SKY_HALF_ROWS * SKY_COLUMNS)
            .into_par_iter()
            .map(|n| {
                let (row, column) = (n / SKY_COLUMNS, n % SKY_COLUMNS);
                let x = column as f32 / (SKY_COLUMNS - 1) as f32;
                let below = row < SKY_HALF_ROWS;
                let v = (row % SKY_HALF_ROWS) as f32 / (SKY_HALF_ROWS - 1) as f32;
                let sine = if below {
                    horizon - v * v * (1.0 + horizon)
                } else {
                    horizon + v * v * (1.0 - horizon)
                };
                let side = (1.0 - sine * sine).max(0.0).sqrt();
                let cosine = 1.0 - 2.0 * x * x;
                let direction = [side * cosine, side * (1.0 - cosine * cosine).max(0.0).sqrt(), sine];
                let scattered = radiance(air, transmittance, multiple, height_m, direction, &turned, Some(below));
                match &formula {
                    Some(formula) if !below => formula.over(scattered, direction),
                    _ => scattered,
                }
            })
            .collect();
        SkyTable {
            planes: [0, 1, 2].map(|c| texels.iter().map(|t| t[c]).collect()),
            horizon_sine: horizon,
            sun_azimuth: sun_azimuth(source.direction),
        }
    }
    /// Radiance of every texel, a plane a colour, `[row][column]`.
    pub fn planes(&self) -> &[Vec<f32>; 3] {
        &self.planes
    }
    /// Radiance of 16 unit directions.
    #[inline(always)]
    pub(crate) fn look(&self, direction: &[Lanes; 3]) -> [Lanes; 3] {
        let side = (direction[0] * direction[0] + direction[1] * direction[1]).sqrt();
        let along = direction[0] * self.sun_azimuth[0] + direction[1] * self.sun_azimuth[1];
        let cosine = along / side.max(Lanes::splat(1e-5));
        let x = ((Lanes::splat(1.0) - cosine) * 0.5).sqrt().clamp(0.0, 1.0) * (SKY_COLUMNS - 1) as f32;
        let s = direction[2] - self.horizon_sine;
        let above = (s * (1.0 / (1.0 - self.horizon_sine))).sqrt();
        let below = (s * (-1.0 / (1.0 + self.horizon_sine))).sqrt();
        let zero = Lanes::splat(0.0);
        let v = Lanes::select_less(s, zero, below, above).clamp(0.0, 1.0) * (SKY_HALF_ROWS - 1) as f32;
        let (i, fx) = x.min(Lanes::splat(SKY_COLUMNS as f32 - 1.001)).split();
        let (j, fy) = v.min(Lanes::splat(SKY_HALF_ROWS as f32 - 1.001)).split();
        let mut index = i;
        for l in 0..index.0.len() {
            let half = if s.0[l] < 0.0 { 0 } else { SKY_HALF_ROWS as u32 };
            index.0[l] = i.0[l] + (j.0[l] + half) * SKY_COLUMNS as u32;
        }
        let mut seen = [Lanes::splat(0.0); 3];
        for (light, plane) in seen.iter_mut().zip(&self.planes) {
            let row = SKY_COLUMNS as u32;
            let low = index.gather_f32(plane).lerp(index.plus(1).gather_f32(plane), fx);
            let high = index
                .plus(row)
                .gather_f32(plane)
                .lerp(index.plus(row + 1).gather_f32(plane), fx);
            *light = low.lerp(high, fy);
        }
        seen
    }
}

/// Radiance over the sun's irradiance along `direction` from `height_m`, light from the ground left out. `to_ground` says
/// whether the ray ends at the ground; `None` works it out.
pub fn radiance(
    air: &Atmosphere,
    transmittance: &TransmittanceTable,
    multiple: &MultipleScatteringTable,
    height_m: f32,
    direction: [f32; 3],
    source: &SkySource,
    to_ground: Option<bool>,
) -> [f32; 3] {
    let mu = direction[2];
    let hit = distance_to_ground_m(height_m, mu);
    let horizon_m = (height_m * (2.0 * EARTH_RADIUS_M + height_m)).max(0.0).sqrt();
    let whole = match (to_ground, hit) {
        (Some(true), hit) => hit.unwrap_or(horizon_m),
        (None, Some(distance)) => distance,
        _ => distance_to_shell_m(height_m, mu, AIR_DEPTH_M),
    };
    let sun = source.direction;
    let turn = direction[0] * sun[0] + direction[1] * sun[1] + direction[2] * sun[2];
    let (molecules, aerosol) = (rayleigh(turn), henyey_greenstein(AEROSOL_ASYMMETRY, turn));
    let mut light = [0.0f32; 3];
    let mut through = [1.0f32; 3];
    let mut before = 0.0;
    let steps = if sun[2] < 0.0 { SKY_STEPS_DUSK } else { SKY_STEPS };
    for s in 0..steps {
        let f = (s + 1) as f32 / steps as f32;
        let after = whole * f * f;
        let at = 0.5 * (before + after);
        let h = height_along_m(height_m, mu, at).max(0.0);
        let local_mu = local_sun_cosine(height_m, direction, sun, at, h);
        let c = air.at(h);
        let lit = transmittance.of_sun(h, local_mu);
        let higher = multiple.at(h, local_mu);
        for k in 0..3 {
            let lit_up = lit[k] * (c.rayleigh_per_m[k] * molecules + c.aerosol_per_m * aerosol)
                + (higher[k] + source.scattered_glow[k]) * (c.rayleigh_per_m[k] + c.aerosol_per_m);
            let kept = (-c.extinction_per_m[k] * (after - before)).exp();
            light[k] += through[k] * lit_up * (1.0 - kept) / c.extinction_per_m[k].max(1e-12);
            through[k] *= kept;
        }
        before = after;
    }
    let to_space = !to_ground.unwrap_or(hit.is_some());
    let layer = if to_space { layer_brightness(height_m, mu) } else { 0.0 };
    [0, 1, 2].map(|k| source.strength[k] * (light[k] + source.layer_glow[k] * layer * through[k]))
}

/// Brightness of a thin glowing layer along a direction against the zenith's (van Rhijn 1921).
fn layer_brightness(height_m: f32, mu: f32) -> f32 {
    let nearer = (EARTH_RADIUS_M + height_m) / (EARTH_RADIUS_M + GLOW_HEIGHT_M);
    1.0 / (1.0 - nearer * nearer * (1.0 - mu * mu)).max(1e-3).sqrt()
}
