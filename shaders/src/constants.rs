//! Physical constants, written once. SI units.

crate::constants! {
    /// Acceleration of gravity, m/s2.
    pub const GRAVITY_M_S2: f64 = 9.81;
    /// Gas constant of dry air, J/(kg K).
    pub const GAS_CONSTANT_DRY_AIR: f64 = 287.04;
    /// Gas constant of water vapour, J/(kg K).
    pub const GAS_CONSTANT_VAPOUR: f64 = 461.5;
    /// Specific heat of dry air at constant pressure, J/(kg K).
    pub const HEAT_CAPACITY_DRY_AIR: f64 = 1004.64;
    /// Latent heat of vaporisation at 0 C, J/kg.
    pub const LATENT_HEAT_VAPORISATION: f64 = 2.501e6;
    /// Pressure that potential temperature refers to, Pa.
    pub const REFERENCE_PRESSURE_PA: f64 = 1.0e5;
    /// Density of liquid water, kg/m3.
    pub const WATER_DENSITY_KG_M3: f64 = 1000.0;
    /// R_d over c_p.
    pub const KAPPA: f64 = GAS_CONSTANT_DRY_AIR / HEAT_CAPACITY_DRY_AIR;
    /// R_d over R_v.
    pub const EPSILON: f64 = GAS_CONSTANT_DRY_AIR / GAS_CONSTANT_VAPOUR;
    /// Temperature of 0 degrees Celsius, K.
    pub const ZERO_CELSIUS_K: f64 = 273.15;
    /// Earth's rotation, 1/s.
    pub const EARTH_ROTATION_PER_S: f64 = 7.2921e-5;
    /// von Karman's constant.
    pub const VON_KARMAN: f64 = 0.4;
}

/// Saturation vapour pressure over water, Pa, at `temperature_k` (Bolton 1980, equation 10; within 0.3 % from -35 to 35 C).
pub fn saturation_vapour_pressure_pa(temperature_k: f64) -> f64 {
    let t = temperature_k - ZERO_CELSIUS_K;
    611.2 * (17.67 * t / (t + 243.5)).exp()
}

/// Saturation specific humidity, kg/kg, at a pressure in Pa and a temperature in K; bounded to 1 where the vapour
/// pressure nears the pressure.
pub fn saturation_specific_humidity(pressure_pa: f64, temperature_k: f64) -> f64 {
    let e = saturation_vapour_pressure_pa(temperature_k).min(0.5 * pressure_pa);
    EPSILON * e / (pressure_pa - (1.0 - EPSILON) * e)
}
