//! Lifting a parcel: where it condenses, how warm it stays, what energy it gains.

use welkin_proto::report::CondensationLevel;
use welkin_shaders::constants as c;

use super::{Air, exner_of, virtual_factor};

/// Longest step of the saturated ascent in the logarithm of pressure.
const LOG_PRESSURE_STEP_MAX: f64 = 0.01;
/// Below this a parcel is too cold for the vapour pressure formula, K.
const COLDEST_K: f64 = 110.0;

/// Pressure (Pa) and temperature (K) at which air of a pressure, temperature and specific humidity becomes saturated when it is
/// lifted dry-adiabatically, by bisection of `q = q_s(p, theta exner(p))`; the air itself where it is saturated already. `None`
/// where it is dry, or would have to cool below 110 K.
///
/// Air of 25 and 18 C at 1000 hPa gives 902 hPa and 16.4 C, as do published tables.
pub fn lifting_condensation_level(pressure_pa: f64, temperature_k: f64, vapour_kg_per_kg: f64) -> Option<(f64, f64)> {
    let lifted_k = |p: f64| temperature_k * (p / pressure_pa).powf(c::KAPPA);
    let unsaturated = |p: f64| vapour_kg_per_kg < c::saturation_specific_humidity(p, lifted_k(p));
    if vapour_kg_per_kg <= 0.0 || temperature_k <= COLDEST_K {
        return None;
    }
    if !unsaturated(pressure_pa) {
        return Some((pressure_pa, temperature_k));
    }
    let mut dry_pa = pressure_pa;
    let mut moist_pa = pressure_pa * (COLDEST_K / temperature_k).powf(1.0 / c::KAPPA);
    if unsaturated(moist_pa) {
        return None;
    }
    while dry_pa - moist_pa > 1e-3 {
        let middle_pa = 0.5 * (dry_pa + moist_pa);
        if unsaturated(middle_pa) {
            dry_pa = middle_pa;
        } else {
            moist_pa = middle_pa;
        }
    }
    let level_pa = 0.5 * (dry_pa + moist_pa);
    Some((level_pa, lifted_k(level_pa)))
}

/// `dT / d(ln p)` of saturated air whose condensate falls out at once, K (Bakhshaii and Stull 2013, as MetPy's documentation of
/// `moist_lapse` quotes it).
fn pseudo_adiabat(pressure_pa: f64, temperature_k: f64) -> f64 {
    let vapour_pa = c::saturation_vapour_pressure_pa(temperature_k).min(0.5 * pressure_pa);
    let mixing_ratio = c::EPSILON * vapour_pa / (pressure_pa - vapour_pa);
    let latent = c::LATENT_HEAT_VAPORISATION;
    let dry = c::GAS_CONSTANT_DRY_AIR * temperature_k;
    (dry + latent * mixing_ratio)
        / (c::HEAT_CAPACITY_DRY_AIR + latent * latent * mixing_ratio * c::EPSILON / (dry * temperature_k))
}

/// Temperature (K) at `to_pa` of saturated air that leaves `from_pa` with `temperature_k` and loses its condensate as it forms
/// (pseudo-adiabatic): fourth-order Runge-Kutta in the logarithm of pressure, latent heat constant. Works downwards too.
pub fn saturated_ascent(from_pa: f64, temperature_k: f64, to_pa: f64) -> f64 {
    let way = (to_pa / from_pa).ln();
    let steps = (way.abs() / LOG_PRESSURE_STEP_MAX).ceil().max(1.0) as usize;
    let h = way / steps as f64;
    let mut t = temperature_k;
    for step in 0..steps {
        let log_p = from_pa.ln() + step as f64 * h;
        let slope = |along: f64, t: f64| pseudo_adiabat((log_p + along).exp(), t);
        let k1 = slope(0.0, t);
        let k2 = slope(0.5 * h, t + 0.5 * h * k1);
        let k3 = slope(0.5 * h, t + 0.5 * h * k2);
        let k4 = slope(h, t + h * k3);
        t += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
    }
    t
}

/// Dew point over water, K (Bolton's formula turned round); `None` where there is no water.
pub(super) fn dewpoint_k(pressure_pa: f64, vapour_kg_per_kg: f64) -> Option<f64> {
    if vapour_kg_per_kg <= 0.0 {
        return None;
    }
    let vapour_pa = vapour_kg_per_kg * pressure_pa / (c::EPSILON + (1.0 - c::EPSILON) * vapour_kg_per_kg);
    let log = (vapour_pa / 611.2).ln();
    Some(c::ZERO_CELSIUS_K + 243.5 * log / (17.67 - log))
}

/// The condensation level of air that starts at the column's foot, and the height at which the column has its pressure.
pub(super) fn condensation_level(
    column: &[(f64, Air)],
    temperature_k: f64,
    vapour_kg_per_kg: f64,
) -> Option<CondensationLevel> {
    let (pressure_pa, level_k) = lifting_condensation_level(column[0].1.pressure_pa, temperature_k, vapour_kg_per_kg)?;
    let above = column.partition_point(|(_, air)| air.pressure_pa > pressure_pa);
    let (high_m, high) = column.get(above)?;
    let height_m = match above.checked_sub(1).map(|i| &column[i]) {
        // Between two levels the Exner function is as good as linear in height.
        Some((low_m, low)) => low_m + (high_m - low_m) * (low.exner - exner_of(pressure_pa)) / (low.exner - high.exner),
        None => *high_m,
    };
    Some(CondensationLevel {
        pressure_pa,
        height_m,
        temperature_k: level_k,
    })
}

/// What a parcel gains and pays on its way up.
#[derive(Debug, Default)]
pub(super) struct Energy {
    pub(super) cape_j_kg: f64,
    pub(super) cin_j_kg: f64,
    pub(super) free_convection_level_m: Option<f64>,
    pub(super) equilibrium_level_m: Option<f64>,
}

/// Lifts air from the column's foot: dry-adiabatically to its condensation level, pseudo-adiabatically above.
pub(super) fn lift(column: &[(f64, Air)], temperature_k: f64, vapour_kg_per_kg: f64) -> Energy {
    let foot = &column[0].1;
    let Some((level_pa, level_k)) = lifting_condensation_level(foot.pressure_pa, temperature_k, vapour_kg_per_kg)
    else {
        return Energy::default();
    };
    let (mut last_pa, mut last_k) = (level_pa, level_k);
    let buoyancy: Vec<f64> = column
        .iter()
        .map(|(_, air)| {
            let (parcel_k, vapour) = if air.pressure_pa >= level_pa {
                (temperature_k * air.exner / foot.exner, vapour_kg_per_kg)
            } else {
                let parcel_k = saturated_ascent(last_pa, last_k, air.pressure_pa);
                (last_pa, last_k) = (air.pressure_pa, parcel_k);
                (parcel_k, c::saturation_specific_humidity(air.pressure_pa, parcel_k))
            };
            let parcel_virtual_k = parcel_k * virtual_factor(vapour, 0.0);
            c::GRAVITY_M_S2 * (parcel_virtual_k / air.virtual_temperature_k() - 1.0)
        })
        .collect();
    areas(column, &buoyancy, level_pa)
}

/// Sums buoyancy (m/s2) over height, layer by layer, and finds the thickest positive part above the condensation level.
fn areas(column: &[(f64, Air)], buoyancy: &[f64], level_pa: f64) -> Energy {
    let mut energy = Energy::default();
    let mut negative_so_far = 0.0;
    // The positive part being summed: its bottom, its area, and what had been paid below it.
    let mut part: Option<(f64, f64, f64)> = None;
    let mut largest = 0.0;
    for i in 1..column.len() {
        let (low_m, high_m) = (column[i - 1].0, column[i].0);
        let area = 0.5 * (buoyancy[i - 1] + buoyancy[i]) * (high_m - low_m);
        let above_level = column[i].1.pressure_pa < level_pa;
        if area > 0.0 && above_level {
            energy.cape_j_kg += area;
            energy.equilibrium_level_m = Some(high_m);
            let (bottom_m, sum, paid) = part.unwrap_or((low_m, 0.0, negative_so_far));
            part = Some((bottom_m, sum + area, paid));
            if sum + area > largest {
                largest = sum + area;
                energy.free_convection_level_m = Some(bottom_m);
                energy.cin_j_kg = paid;
            }
        } else {
            part = None;
            negative_so_far += area.min(0.0);
        }
    }
    energy
}
