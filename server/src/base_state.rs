//! The air at the start: profiles in hydrostatic balance on the scene's levels, and what they say of clouds to come.
//!
//! One equation is integrated, upwards from the pressure at the ground: `d(exner)/dz = -g / (c_p theta_v)`, in f64 by the
//! classical fourth-order Runge-Kutta scheme in steps of 10 m at most; halving the step changes the pressure at 15 km by less
//! than 0.01 Pa. Water is specific humidity, kg of water in a kg of moist air; where a source speaks of mixing ratio r it is
//! turned into `r / (1 + r)`. Where total water exceeds saturation the temperature comes from saturation adjustment,
//! `T = exner theta_l + (L / c_p) q_l`, with the same constants and formulas that the simulation uses.

use welkin_proto::error::ApiError;
use welkin_proto::report::BaseStateReport;
use welkin_proto::scene::Scene;
use welkin_shaders::constants as c;

mod adiabat;
mod ascent;
mod source;

pub use adiabat::{Adiabat, reversible_equivalent_potential_temperature_k, theta_l_after_ascent};
pub use ascent::{lifting_condensation_level, saturated_ascent};
use source::Source;

/// Longest step of the hydrostatic integration, m.
const STEP_MAX_M: f64 = 10.0;
/// Distance of the levels that a parcel is lifted through, m at most.
const COLUMN_STEP_MAX_M: f64 = 25.0;
/// Depth of the layer whose mean feeds cumulus, m.
const MIXED_LAYER_M: f64 = 500.0;
/// A column beyond this height adds nothing to convection, m.
const COLUMN_TOP_MAX_M: f64 = 20_000.0;
/// Temperatures that the formulas here hold for, K.
const TEMPERATURE_MIN_K: f64 = 100.0;
const TEMPERATURE_MAX_K: f64 = 350.0;

/// Profiles by rising height on the scene's levels, f64; `nz` values at the centres of the levels unless said otherwise.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseState {
    /// Pressure, Pa.
    pub pressure_pa: Vec<f64>,
    /// `(pressure / 1e5 Pa)^(R_d / c_p)`.
    pub exner: Vec<f64>,
    /// Density of the moist air, kg/m3.
    pub density_kg_m3: Vec<f64>,
    /// Density at the `nz + 1` horizontal faces, ground and lid among them, kg/m3: from the pressure and temperature there,
    /// not averaged.
    pub density_at_z_face_kg_m3: Vec<f64>,
    /// Temperature, K.
    pub temperature_k: Vec<f64>,
    /// Liquid-water potential temperature, K.
    pub liquid_water_potential_temperature_k: Vec<f64>,
    /// Vapour and liquid, kg/kg.
    pub total_water_kg_per_kg: Vec<f64>,
    /// Virtual potential temperature with the weight of the liquid, K.
    pub virtual_potential_temperature_k: Vec<f64>,
    /// Wind towards the east, m/s.
    pub wind_x_m_s: Vec<f64>,
    /// Wind towards the north, m/s.
    pub wind_y_m_s: Vec<f64>,
    /// Surface values, condensation levels, CAPE and what was done to the data.
    pub report: BaseStateReport,
}

/// Air at one height, in thermodynamic balance.
#[derive(Clone, Copy, Debug)]
struct Air {
    exner: f64,
    pressure_pa: f64,
    temperature_k: f64,
    liquid_water_potential_temperature_k: f64,
    total_water_kg_per_kg: f64,
    vapour_kg_per_kg: f64,
    virtual_potential_temperature_k: f64,
    wind_m_s: [f64; 2],
}

impl Air {
    fn virtual_temperature_k(&self) -> f64 {
        self.virtual_potential_temperature_k * self.exner
    }
    fn density_kg_m3(&self) -> f64 {
        self.pressure_pa / (c::GAS_CONSTANT_DRY_AIR * self.virtual_temperature_k())
    }
}

fn exner_of(pressure_pa: f64) -> f64 {
    (pressure_pa / c::REFERENCE_PRESSURE_PA).powf(c::KAPPA)
}

fn pressure_of(exner: f64) -> f64 {
    c::REFERENCE_PRESSURE_PA * exner.powf(1.0 / c::KAPPA)
}

/// Virtual temperature over temperature, less the weight of the liquid.
fn virtual_factor(vapour_kg_per_kg: f64, liquid_kg_per_kg: f64) -> f64 {
    1.0 + (1.0 / c::EPSILON - 1.0) * vapour_kg_per_kg - liquid_kg_per_kg
}

/// Temperature (K) and liquid water (kg/kg) of air with the given conserved values: Newton's method on
/// `T - T_l - (L / c_p) (q_t - q_s(p, T)) = 0` where the air is supersaturated at `T_l`.
fn adjust(pressure_pa: f64, liquid_water_temperature_k: f64, total_water_kg_per_kg: f64) -> (f64, f64) {
    let latent = c::LATENT_HEAT_VAPORISATION / c::HEAT_CAPACITY_DRY_AIR;
    let saturation = |t: f64| c::saturation_specific_humidity(pressure_pa, t);
    let mut t = liquid_water_temperature_k;
    if total_water_kg_per_kg <= saturation(t) {
        return (t, 0.0);
    }
    for _ in 0..20 {
        let residual = t - liquid_water_temperature_k - latent * (total_water_kg_per_kg - saturation(t));
        let slope = 1.0 + latent * (saturation(t + 0.005) - saturation(t - 0.005)) / 0.01;
        let change = residual / slope;
        t -= change;
        if change.abs() < 1e-10 {
            break;
        }
    }
    (t, (t - liquid_water_temperature_k) / latent)
}

/// Temperature (K), liquid water (kg/kg) and virtual potential temperature with the weight of the liquid (K) of air with the given
/// conserved values where the pressure is known by its Exner function; the formulas of the simulation, in f64.
pub fn cloudy_air(exner: f64, theta_l_k: f64, total_water_kg_per_kg: f64) -> (f64, f64, f64) {
    let (temperature_k, liquid) = adjust(pressure_of(exner), exner * theta_l_k, total_water_kg_per_kg);
    let factor = virtual_factor(total_water_kg_per_kg - liquid, liquid);
    (temperature_k, liquid, temperature_k / exner * factor)
}

/// The liquid-water potential temperature (K) at which air of this total water has the virtual potential temperature `theta_v_k`:
/// Newton's method from `near_k`. The relation rises and bends one way only, at saturation, so that it converges from anywhere.
pub fn theta_l_of_theta_v(exner: f64, theta_v_k: f64, total_water_kg_per_kg: f64, near_k: f64) -> f64 {
    let theta_v = |theta_l: f64| cloudy_air(exner, theta_l, total_water_kg_per_kg).2;
    let mut theta_l = near_k;
    for _ in 0..40 {
        let slope = (theta_v(theta_l + 1e-3) - theta_v(theta_l - 1e-3)) / 2e-3;
        let change = (theta_v_k - theta_v(theta_l)) / slope;
        theta_l += change;
        if change.abs() < 1e-9 {
            break;
        }
    }
    theta_l
}

/// The air of a source at a height above the ground, given its pressure.
fn air_at(source: &Source, height_m: f64, exner: f64) -> Air {
    let values = source.at(height_m, exner);
    let pressure_pa = pressure_of(exner);
    let theta_l = values.liquid_water_potential_temperature_k;
    let (temperature_k, liquid) = adjust(pressure_pa, theta_l * exner, values.total_water_kg_per_kg);
    let vapour = values.total_water_kg_per_kg - liquid;
    Air {
        exner,
        pressure_pa,
        temperature_k,
        liquid_water_potential_temperature_k: theta_l,
        total_water_kg_per_kg: values.total_water_kg_per_kg,
        vapour_kg_per_kg: vapour,
        virtual_potential_temperature_k: temperature_k / exner * virtual_factor(vapour, liquid),
        wind_m_s: values.wind_m_s,
    }
}

/// Walks upwards from the ground, handing out the air at rising heights.
struct Climb<'a> {
    source: &'a Source,
    height_m: f64,
    exner: f64,
}

impl<'a> Climb<'a> {
    fn new(source: &'a Source) -> Self {
        Self {
            source,
            height_m: 0.0,
            exner: exner_of(source.surface_pressure_pa()),
        }
    }

    /// The air at a height that is not below the last one. Errors: `out_of_range` where it would be too cold or too hot.
    fn to(&mut self, height_m: f64) -> Result<Air, ApiError> {
        let slope = |z: f64, exner: f64| {
            let theta_v = air_at(self.source, z, exner).virtual_potential_temperature_k;
            -c::GRAVITY_M_S2 / (c::HEAT_CAPACITY_DRY_AIR * theta_v)
        };
        let way_m = height_m - self.height_m;
        let steps = (way_m / STEP_MAX_M).ceil().max(0.0) as usize;
        let h = if steps > 0 { way_m / steps as f64 } else { 0.0 };
        for step in 0..steps {
            let z = self.height_m + step as f64 * h;
            let k1 = slope(z, self.exner);
            let k2 = slope(z + 0.5 * h, self.exner + 0.5 * h * k1);
            let k3 = slope(z + 0.5 * h, self.exner + 0.5 * h * k2);
            let k4 = slope(z + h, self.exner + h * k3);
            self.exner += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
        }
        self.height_m = height_m;
        let air = air_at(self.source, height_m, self.exner);
        // Written so that a value that is not a number fails too: air that ended in vacuum gives one.
        if !(air.temperature_k >= TEMPERATURE_MIN_K && air.temperature_k <= TEMPERATURE_MAX_K) {
            let message = format!(
                "the temperature {height_m:.0} m above the ground would be {:.1} K; allowed is {TEMPERATURE_MIN_K} to \
                 {TEMPERATURE_MAX_K} K from the ground to the lid",
                air.temperature_k
            );
            return Err(ApiError::new("out_of_range", message).at("/base_state"));
        }
        Ok(air)
    }
}

/// The base state of a valid scene.
///
/// Errors: `bad_sounding`; `out_of_range` where the profiles give a temperature outside 100 to 350 K between the ground and the
/// lid, such as a domain that is higher than its neutral air.
pub fn build(scene: &Scene) -> Result<BaseState, ApiError> {
    let nz = scene.domain.cells[2] as usize;
    let dz = scene.domain.cell_size_m[2];
    let lid_m = nz as f64 * dz;
    let mut notes = Vec::new();
    let source = Source::new(&scene.base_state, lid_m, &mut notes)?;

    let (mut centres, mut faces) = (Vec::with_capacity(nz), Vec::with_capacity(nz + 1));
    let mut climb = Climb::new(&source);
    faces.push(climb.to(0.0)?);
    for k in 0..nz {
        centres.push(climb.to((k as f64 + 0.5) * dz)?);
        faces.push(climb.to((k + 1) as f64 * dz)?);
    }

    let cloudy = centres
        .iter()
        .filter(|air| air.total_water_kg_per_kg > air.vapour_kg_per_kg)
        .count();
    if cloudy > 0 {
        notes.push(format!(
            "{cloudy} of {nz} levels start saturated: their excess water is cloud"
        ));
    }
    let surface_altitude_m = match source.surface_altitude_m() {
        Some(altitude_m) => {
            let scene_m = scene.domain.surface_altitude_m;
            if (altitude_m - scene_m).abs() > 100.0 {
                notes.push(format!(
                    "the sounding's ground lies {altitude_m:.0} m above the sea, the scene's {scene_m:.0} m; heights and \
                     pressures follow the sounding"
                ));
            }
            altitude_m
        }
        None => scene.domain.surface_altitude_m,
    };
    let report = report(&source, lid_m, surface_altitude_m, notes)?;
    let list = |value: fn(&Air) -> f64| centres.iter().map(value).collect::<Vec<f64>>();
    Ok(BaseState {
        pressure_pa: list(|air| air.pressure_pa),
        exner: list(|air| air.exner),
        density_kg_m3: list(Air::density_kg_m3),
        density_at_z_face_kg_m3: faces.iter().map(Air::density_kg_m3).collect(),
        temperature_k: list(|air| air.temperature_k),
        liquid_water_potential_temperature_k: list(|air| air.liquid_water_potential_temperature_k),
        total_water_kg_per_kg: list(|air| air.total_water_kg_per_kg),
        virtual_potential_temperature_k: list(|air| air.virtual_potential_temperature_k),
        wind_x_m_s: list(|air| air.wind_m_s[0]),
        wind_y_m_s: list(|air| air.wind_m_s[1]),
        report,
    })
}

fn report(
    source: &Source,
    lid_m: f64,
    surface_altitude_m: f64,
    mut notes: Vec<String>,
) -> Result<BaseStateReport, ApiError> {
    // A sounding is lifted through as far as it goes, also above a low lid: CAPE is the air's, not the box's.
    let top_m = source
        .data_top_m()
        .map_or(lid_m, |data_m| lid_m.max(data_m.min(COLUMN_TOP_MAX_M)));
    let levels = (top_m / COLUMN_STEP_MAX_M).ceil().max(8.0) as usize;
    let mut climb = Climb::new(source);
    let mut column = Vec::with_capacity(levels + 1);
    for i in 0..=levels {
        let height_m = top_m * i as f64 / levels as f64;
        column.push((height_m, climb.to(height_m)?));
    }
    let surface = column[0].1;

    let (mut mass, mut theta_l, mut water) = (0.0, 0.0, 0.0);
    for (_, air) in column.iter().filter(|(height_m, _)| *height_m <= MIXED_LAYER_M) {
        let weight = air.density_kg_m3();
        mass += weight;
        theta_l += weight * air.liquid_water_potential_temperature_k;
        water += weight * air.total_water_kg_per_kg;
    }
    let (theta_l, water) = (theta_l / mass, water / mass);
    let (mixed_k, mixed_liquid) = adjust(surface.pressure_pa, theta_l * surface.exner, water);

    let surface_condensation_level =
        ascent::condensation_level(&column, surface.temperature_k, surface.vapour_kg_per_kg);
    let mixed_layer_condensation_level = ascent::condensation_level(&column, mixed_k, water - mixed_liquid);
    let energy = ascent::lift(&column, surface.temperature_k, surface.vapour_kg_per_kg);
    if surface.total_water_kg_per_kg > surface.vapour_kg_per_kg {
        notes.push("the air at the ground is saturated: fog".to_owned());
    }
    Ok(BaseStateReport {
        source: source.name(),
        surface_altitude_m,
        surface_pressure_pa: surface.pressure_pa,
        surface_temperature_k: surface.temperature_k,
        surface_dewpoint_k: ascent::dewpoint_k(surface.pressure_pa, surface.vapour_kg_per_kg),
        surface_condensation_level,
        mixed_layer_condensation_level,
        cape_j_kg: energy.cape_j_kg,
        cin_j_kg: energy.cin_j_kg,
        free_convection_level_m: energy.free_convection_level_m,
        equilibrium_level_m: energy.equilibrium_level_m,
        column_top_m: top_m,
        notes,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn adjustment_closes_and_leaves_dry_air_alone() {
        for (p, t_l, q) in [
            (1e5, 290.0, 0.02),
            (8e4, 280.0, 0.012),
            (3e4, 230.0, 0.004),
            (9e4, 300.0, 0.05),
        ] {
            let (t, liquid) = adjust(p, t_l, q);
            assert!(liquid > 0.0, "{t_l} K with {q} is supersaturated");
            let saturated = c::saturation_specific_humidity(p, t);
            assert!((q - liquid - saturated).abs() < 1e-10, "vapour must be at saturation");
        }
        assert_eq!(adjust(1e5, 290.0, 0.001), (290.0, 0.0));
    }

    #[test]
    fn shorter_steps_change_nothing() {
        let base = welkin_proto::scene::BaseState::WeismanKlemp {
            surface_pressure_pa: 1e5,
            mixing_ratio_cap_kg_per_kg: 0.014,
            wind_shear_m_s: 0.0,
        };
        let source = Source::new(&base, 15e3, &mut Vec::new()).expect("a valid base state");
        let once = Climb::new(&source).to(15e3).expect("it reaches 15 km").pressure_pa;
        let mut climb = Climb::new(&source);
        let mut fine = 0.0;
        for i in 1..=7500 {
            fine = climb.to(f64::from(i) * 2.0).expect("it reaches 15 km").pressure_pa;
        }
        assert!((once - fine).abs() < 0.01, "{once} against {fine} Pa");
    }
}
