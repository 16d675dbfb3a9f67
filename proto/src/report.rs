//! What the server says of the air that a world starts from.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Where air that is lifted dry-adiabatically becomes saturated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CondensationLevel {
    /// Pressure, Pa.
    pub pressure_pa: f64,
    /// Height above the ground at which the base state has that pressure, m.
    pub height_m: f64,
    /// Temperature of the lifted air there, K.
    pub temperature_k: f64,
}

/// The base state in a few numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct BaseStateReport {
    /// Where the air comes from: the base state's kind, and the station of a sounding.
    pub source: String,
    /// Height of the ground above the sea, m: the sounding's if there is one, else the scene's.
    pub surface_altitude_m: f64,
    /// Pressure at the ground, Pa.
    pub surface_pressure_pa: f64,
    /// Temperature at the ground, K.
    pub surface_temperature_k: f64,
    /// Dew point at the ground, K; absent where the air there holds no water.
    pub surface_dewpoint_k: Option<f64>,
    /// Lifting condensation level of the air at the ground; absent where it is dry or its level is above the column.
    pub surface_condensation_level: Option<CondensationLevel>,
    /// Lifting condensation level of the mean air of the lowest 500 m, lifted from the ground; absent as above. A
    /// field of cumulus has its base near this one.
    pub mixed_layer_condensation_level: Option<CondensationLevel>,
    /// Convective available potential energy of the air at the ground, J/kg: pseudo-adiabatic ascent, virtual
    /// temperature, the sum of all positive area above the condensation level.
    pub cape_j_kg: f64,
    /// Convective inhibition of the same ascent, J/kg, 0 or negative: the negative area below the thickest
    /// (largest in area) positive layer; 0 where there is no positive layer.
    pub cin_j_kg: f64,
    /// Height above the ground of the bottom of that positive layer, m; absent without one.
    pub free_convection_level_m: Option<f64>,
    /// Height above the ground of the top of the highest positive layer, m; absent without one. It is the column's top
    /// where the air is still rising there.
    pub equilibrium_level_m: Option<f64>,
    /// Top of the column that was lifted through, m above the ground: the domain's lid, or a sounding's end if that is higher.
    pub column_top_m: f64,
    /// What was dropped, filled in or extended, in plain words.
    pub notes: Vec<String>,
}
