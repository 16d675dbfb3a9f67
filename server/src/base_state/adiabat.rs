//! Reversible ascent by the simulation's own thermodynamics, and the equivalent potential temperature that it is named by.

use welkin_shaders::constants as c;

use super::{adjust, pressure_of};

/// Step of the integration in the Exner function.
const EXNER_STEP: f64 = 2e-4;
/// Where the ascent ends: about 20 hPa.
const EXNER_TOP: f64 = 0.33;
/// Specific heat of liquid water, J/(kg K), and how the latent heat falls with temperature, J/(kg K): only for theta_e.
const HEAT_CAPACITY_LIQUID: f64 = 4190.0;
const LATENT_HEAT_SLOPE: f64 = 2370.0;

/// Liquid-water potential temperature along a reversible moist adiabat, as a function of the Exner function.
///
/// Condensate stays in the air, its own heat capacity is neglected and the latent heat is constant, as in the simulation:
/// `c_p Pi dtheta = L dq_l`, so that `dtheta_l / dPi = (L / c_p) q_l / Pi2`, with q_l from saturation adjustment. Fourth-order
/// Runge-Kutta from the starting point upwards.
#[derive(Clone, Debug)]
pub struct Adiabat {
    bottom_exner: f64,
    step: f64,
    theta_l_k: Vec<f64>,
    total_water_kg_per_kg: f64,
}

impl Adiabat {
    /// From air with the given conserved values at `exner`.
    pub fn new(exner: f64, theta_l_k: f64, total_water_kg_per_kg: f64) -> Self {
        let steps = ((exner - EXNER_TOP) / EXNER_STEP).ceil().max(1.0) as usize;
        let step = (exner - EXNER_TOP).max(EXNER_STEP) / steps as f64;
        let mut adiabat = Self {
            bottom_exner: exner,
            step,
            theta_l_k: Vec::with_capacity(steps + 1),
            total_water_kg_per_kg,
        };
        let mut theta_l = theta_l_k;
        adiabat.theta_l_k.push(theta_l);
        for i in 0..steps {
            theta_l = ascend(exner - i as f64 * step, -step, theta_l, total_water_kg_per_kg);
            adiabat.theta_l_k.push(theta_l);
        }
        adiabat
    }

    /// Liquid-water potential temperature, K; linear between steps (1e-6 K), constant beyond the ends.
    pub fn theta_l_at(&self, exner: f64) -> f64 {
        let last = self.theta_l_k.len() - 1;
        let at = ((self.bottom_exner - exner) / self.step).clamp(0.0, last as f64);
        let low = (at as usize).min(last - 1);
        self.theta_l_k[low] + (at - low as f64) * (self.theta_l_k[low + 1] - self.theta_l_k[low])
    }

    /// Vapour and liquid, kg/kg.
    pub fn total_water_kg_per_kg(&self) -> f64 {
        self.total_water_kg_per_kg
    }

    /// Temperature (K) and liquid (kg/kg) at a value of the Exner function.
    pub fn air_at(&self, exner: f64) -> (f64, f64) {
        adjust(
            pressure_of(exner),
            exner * self.theta_l_at(exner),
            self.total_water_kg_per_kg,
        )
    }
}

/// Liquid-water potential temperature after a change `by` of the Exner function: one Runge-Kutta step.
fn ascend(exner: f64, by: f64, theta_l_k: f64, total_water_kg_per_kg: f64) -> f64 {
    let latent = c::LATENT_HEAT_VAPORISATION / c::HEAT_CAPACITY_DRY_AIR;
    let slope = |exner: f64, theta_l: f64| {
        let (_, liquid) = adjust(pressure_of(exner), exner * theta_l, total_water_kg_per_kg);
        latent * liquid / (exner * exner)
    };
    let k1 = slope(exner, theta_l_k);
    let k2 = slope(exner + 0.5 * by, theta_l_k + 0.5 * by * k1);
    let k3 = slope(exner + 0.5 * by, theta_l_k + 0.5 * by * k2);
    let k4 = slope(exner + by, theta_l_k + by * k3);
    theta_l_k + by / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
}

/// Liquid-water potential temperature of air that is brought from one value of the Exner function to another along its reversible
/// adiabat, in `steps` Runge-Kutta steps.
pub fn theta_l_after_ascent(
    from_exner: f64,
    to_exner: f64,
    theta_l_k: f64,
    total_water_kg_per_kg: f64,
    steps: usize,
) -> f64 {
    let by = (to_exner - from_exner) / steps.max(1) as f64;
    (0..steps.max(1)).fold(theta_l_k, |theta_l, i| {
        ascend(from_exner + i as f64 * by, by, theta_l, total_water_kg_per_kg)
    })
}

/// Equivalent potential temperature (K) of saturated air for a reversible ascent, with the heat capacity of all its water:
/// `T (p_d / p_0)^(-R_d / c) exp(L r_v / (c T))`, `c = c_p + c_l r_t` (Bryan and Fritsch 2002, equation 4, after Emanuel 1994).
/// `mixing_ratio` is total water over dry air.
pub fn reversible_equivalent_potential_temperature_k(pressure_pa: f64, temperature_k: f64, mixing_ratio: f64) -> f64 {
    let vapour_pa = c::saturation_vapour_pressure_pa(temperature_k).min(0.5 * pressure_pa);
    let dry_pa = pressure_pa - vapour_pa;
    let vapour = c::EPSILON * vapour_pa / dry_pa;
    let heat_capacity = c::HEAT_CAPACITY_DRY_AIR + HEAT_CAPACITY_LIQUID * mixing_ratio;
    let latent = c::LATENT_HEAT_VAPORISATION - LATENT_HEAT_SLOPE * (temperature_k - c::ZERO_CELSIUS_K);
    temperature_k
        * (dry_pa / c::REFERENCE_PRESSURE_PA).powf(-c::GAS_CONSTANT_DRY_AIR / heat_capacity)
        * (latent * vapour / (heat_capacity * temperature_k)).exp()
}
