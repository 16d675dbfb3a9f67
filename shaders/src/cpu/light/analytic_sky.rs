//! Stage `analytic_sky`: the rungs of the sky ladder that are formulas, put in place of the sky table's upper half.
//!
//! Reads: which rung, the clear air, the ground's albedo, the sun's direction. Writes: an [`AnalyticSky`], whose radiance the sky table and the sky's light take over. Turbidity is the vertical
//! optical depth of molecules and aerosol over that of molecules alone, in green.
//!
//! What the formulas cannot, the scattering tables go on doing: rays that end at the ground (haze), the sun's own transmittance, the moon's sky, the night. While the sun sinks from 5 to 0 degrees the formula gives way to
//! the tables, smoothly; below there is no trace of it. The viewer is taken to stand at the ground whatever the camera's height.

use super::atmosphere::{AEROSOL_HEIGHT_M, Atmosphere, RAYLEIGH_HEIGHT_M};
use super::hosek_wilkie::HosekWilkie;
use super::preetham::Preetham;

/// Sine of the sun's elevation from which a formula is used whole, 5 degrees; at the horizon it is gone.
const WHOLE_FROM: f32 = 0.087_156;

/// A rung of the sky ladder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SkyMethod {
    /// Preetham, Shirley and Smits (1999).
    Preetham,
    /// Hosek and Wilkie (2012).
    HosekWilkie,
    /// Look-up tables after Hillaire (2020).
    #[default]
    ScatteringTables,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Formula {
    Preetham(Preetham),
    HosekWilkie(HosekWilkie),
}

/// See the module.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnalyticSky {
    formula: Formula,
    sun: [f32; 3],
    /// Share of the formula against the tables.
    pub share: f32,
}

/// The air's turbidity.
pub fn turbidity(air: &Atmosphere) -> f32 {
    let molecules = air.at(0.0).rayleigh_per_m[1] * RAYLEIGH_HEIGHT_M;
    1.0 + air.aerosol_per_m * AEROSOL_HEIGHT_M / molecules
}

impl AnalyticSky {
    /// None for the tables, and for a sun at the horizon or below.
    pub fn new(method: SkyMethod, air: &Atmosphere, ground_albedo: [f32; 3], sun: [f32; 3]) -> Option<AnalyticSky> {
        let risen = (sun[2] / WHOLE_FROM).clamp(0.0, 1.0);
        let share = risen * risen * (3.0 - 2.0 * risen);
        let turbidity = turbidity(air);
        let formula = match method {
            SkyMethod::ScatteringTables => return None,
            SkyMethod::Preetham => Formula::Preetham(Preetham::new(turbidity, sun[2])),
            SkyMethod::HosekWilkie => Formula::HosekWilkie(HosekWilkie::new(turbidity, ground_albedo, sun[2])),
        };
        (share > 0.0).then_some(AnalyticSky { formula, sun, share })
    }
    /// Radiance over the sun's irradiance along a unit vector.
    pub fn radiance(&self, direction: [f32; 3]) -> [f32; 3] {
        let sine = direction[2].max(0.0);
        let turn: f32 = (0..3).map(|a| direction[a] * self.sun[a]).sum();
        match &self.formula {
            Formula::Preetham(sky) => sky.radiance(sine, turn),
            Formula::HosekWilkie(sky) => sky.radiance(sine, turn),
        }
    }
    /// The same sky turned about the vertical, the sun at `sun`.
    pub fn towards(self, sun: [f32; 3]) -> AnalyticSky {
        AnalyticSky { sun, ..self }
    }
    /// What the tables say, and this in its share.
    pub fn over(&self, tables: [f32; 3], direction: [f32; 3]) -> [f32; 3] {
        let own = self.radiance(direction);
        [0, 1, 2].map(|c| tables[c] + (own[c] - tables[c]) * self.share)
    }
}
