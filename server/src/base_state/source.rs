//! Where the profiles come from: a table, a sounding, or an analytic form.

use welkin_proto::error::ApiError;
use welkin_proto::scene;
use welkin_proto::sounding::{self, SoundingLevel};
use welkin_shaders::constants as c;

use super::adiabat::{Adiabat, reversible_equivalent_potential_temperature_k};

/// The sounding of Weisman and Klemp (1982): tropopause and surface.
const WK_TROPOPAUSE_M: f64 = 12_000.0;
const WK_TROPOPAUSE_THETA_K: f64 = 343.0;
const WK_TROPOPAUSE_K: f64 = 213.0;
const WK_SURFACE_THETA_K: f64 = 300.0;
const WK_EXPONENT: f64 = 1.25;
const WK_SHEAR_TOP_M: f64 = 6_000.0;

/// What a source knows at a height.
pub(super) struct Values {
    pub(super) liquid_water_potential_temperature_k: f64,
    pub(super) total_water_kg_per_kg: f64,
    pub(super) wind_m_s: [f64; 2],
}

/// A table of values by rising height above the ground, linear between, constant beyond.
#[derive(Default)]
pub(super) struct Table {
    height_m: Vec<f64>,
    theta_l_k: Vec<f64>,
    water_kg_per_kg: Vec<f64>,
    wind_x_m_s: Vec<f64>,
    wind_y_m_s: Vec<f64>,
}

impl Table {
    fn at(&self, height_m: f64) -> Values {
        let last = self.height_m.len() - 1;
        let above = self.height_m.partition_point(|&level_m| level_m <= height_m);
        let (low, high) = (above.saturating_sub(1), above.min(last));
        let way_m = self.height_m[high] - self.height_m[low];
        let share = if way_m > 0.0 {
            (height_m - self.height_m[low]) / way_m
        } else {
            0.0
        };
        let mix = |list: &[f64]| list[low] + share * (list[high] - list[low]);
        Values {
            liquid_water_potential_temperature_k: mix(&self.theta_l_k),
            total_water_kg_per_kg: mix(&self.water_kg_per_kg),
            wind_m_s: [mix(&self.wind_x_m_s), mix(&self.wind_y_m_s)],
        }
    }

    fn top_m(&self) -> f64 {
        self.height_m[self.height_m.len() - 1]
    }
}

/// One of the scene's base states, ready to be asked.
pub(super) enum Source {
    Profile {
        surface_pressure_pa: f64,
        table: Table,
    },
    Sounding {
        title: Option<String>,
        surface_pressure_pa: f64,
        surface_altitude_m: f64,
        top_virtual_temperature_k: f64,
        table: Table,
    },
    Isentropic {
        surface_pressure_pa: f64,
        theta_k: f64,
        wind_m_s: [f64; 2],
    },
    ConstantStability {
        surface_pressure_pa: f64,
        theta_k: f64,
        per_m: f64,
        relative_humidity: f64,
        wind_m_s: [f64; 2],
    },
    WeismanKlemp {
        surface_pressure_pa: f64,
        cap_kg_per_kg: f64,
        shear_m_s: f64,
    },
    SaturatedNeutral {
        surface_pressure_pa: f64,
        adiabat: Adiabat,
        wind_m_s: [f64; 2],
    },
}

/// Specific humidity of air with a given relative humidity, where water can be that humid at all.
fn humid(relative_humidity: f64, pressure_pa: f64, temperature_k: f64) -> f64 {
    let vapour_pa = relative_humidity * c::saturation_vapour_pressure_pa(temperature_k).min(0.5 * pressure_pa);
    c::EPSILON * vapour_pa / (pressure_pa - (1.0 - c::EPSILON) * vapour_pa)
}

impl Source {
    /// Errors: `bad_sounding`; `out_of_range` for a table without levels.
    pub(super) fn new(base: &scene::BaseState, lid_m: f64, notes: &mut Vec<String>) -> Result<Self, ApiError> {
        Ok(match base {
            scene::BaseState::Profile {
                surface_pressure_pa,
                levels,
            } => {
                let Some(top) = levels.last() else {
                    let error = ApiError::new("out_of_range", "0 rows are out of range; at least 2 are needed");
                    return Err(error.at("/base_state/levels"));
                };
                if top.height_m < lid_m {
                    notes.push(format!(
                        "the table ends at {:.0} m, below the lid at {lid_m:.0} m: constant above",
                        top.height_m
                    ));
                }
                let mut table = Table::default();
                for level in levels {
                    table.height_m.push(level.height_m);
                    table.theta_l_k.push(level.liquid_water_potential_temperature_k);
                    table.water_kg_per_kg.push(level.total_water_kg_per_kg);
                    table.wind_x_m_s.push(level.wind_x_m_s);
                    table.wind_y_m_s.push(level.wind_y_m_s);
                }
                Self::Profile {
                    surface_pressure_pa: *surface_pressure_pa,
                    table,
                }
            }
            scene::BaseState::Sounding { text } => {
                let read = sounding::parse(text).map_err(|error| error.at("/base_state/text"))?;
                notes.extend(read.notes);
                from_sounding(read.title, &read.levels, lid_m, notes)
            }
            scene::BaseState::Isentropic {
                surface_pressure_pa,
                potential_temperature_k,
                wind_x_m_s,
                wind_y_m_s,
            } => Self::Isentropic {
                surface_pressure_pa: *surface_pressure_pa,
                theta_k: *potential_temperature_k,
                wind_m_s: [*wind_x_m_s, *wind_y_m_s],
            },
            scene::BaseState::ConstantStability {
                surface_pressure_pa,
                surface_potential_temperature_k,
                buoyancy_frequency_per_s,
                relative_humidity,
                wind_x_m_s,
                wind_y_m_s,
            } => Self::ConstantStability {
                surface_pressure_pa: *surface_pressure_pa,
                theta_k: *surface_potential_temperature_k,
                // N2 = g d(ln theta)/dz, so theta grows exponentially; N is that of the air without its water.
                per_m: buoyancy_frequency_per_s.powi(2) / c::GRAVITY_M_S2,
                relative_humidity: *relative_humidity,
                wind_m_s: [*wind_x_m_s, *wind_y_m_s],
            },
            scene::BaseState::WeismanKlemp {
                surface_pressure_pa,
                mixing_ratio_cap_kg_per_kg,
                wind_shear_m_s,
            } => Self::WeismanKlemp {
                surface_pressure_pa: *surface_pressure_pa,
                cap_kg_per_kg: *mixing_ratio_cap_kg_per_kg,
                shear_m_s: *wind_shear_m_s,
            },
            scene::BaseState::SaturatedNeutral {
                surface_pressure_pa,
                surface_equivalent_potential_temperature_k,
                total_water_mixing_ratio_kg_per_kg,
                wind_x_m_s,
                wind_y_m_s,
            } => Self::SaturatedNeutral {
                surface_pressure_pa: *surface_pressure_pa,
                adiabat: saturated_adiabat(
                    *surface_pressure_pa,
                    *surface_equivalent_potential_temperature_k,
                    *total_water_mixing_ratio_kg_per_kg,
                )?,
                wind_m_s: [*wind_x_m_s, *wind_y_m_s],
            },
        })
    }

    pub(super) fn surface_pressure_pa(&self) -> f64 {
        match self {
            Self::Profile {
                surface_pressure_pa, ..
            }
            | Self::Sounding {
                surface_pressure_pa, ..
            }
            | Self::Isentropic {
                surface_pressure_pa, ..
            }
            | Self::ConstantStability {
                surface_pressure_pa, ..
            }
            | Self::WeismanKlemp {
                surface_pressure_pa, ..
            }
            | Self::SaturatedNeutral {
                surface_pressure_pa, ..
            } => *surface_pressure_pa,
        }
    }

    /// Height of a sounding's ground above the sea, m.
    pub(super) fn surface_altitude_m(&self) -> Option<f64> {
        match self {
            Self::Sounding { surface_altitude_m, .. } => Some(*surface_altitude_m),
            _ => None,
        }
    }

    /// Where a sounding ends, m above the ground.
    pub(super) fn data_top_m(&self) -> Option<f64> {
        match self {
            Self::Sounding { table, .. } => Some(table.top_m()),
            _ => None,
        }
    }

    pub(super) fn name(&self) -> String {
        match self {
            Self::Profile { .. } => "profile".to_owned(),
            Self::Sounding { title: Some(title), .. } => format!("sounding: {title}"),
            Self::Sounding { title: None, .. } => "sounding".to_owned(),
            Self::Isentropic { .. } => "isentropic".to_owned(),
            Self::ConstantStability { .. } => "constant stability".to_owned(),
            Self::WeismanKlemp { .. } => "Weisman and Klemp (1982)".to_owned(),
            Self::SaturatedNeutral { .. } => "saturated and neutral".to_owned(),
        }
    }

    /// The values at a height above the ground where the Exner function is known.
    pub(super) fn at(&self, height_m: f64, exner: f64) -> Values {
        match self {
            Self::Profile { table, .. } => table.at(height_m),
            Self::Sounding {
                table,
                top_virtual_temperature_k,
                ..
            } => {
                let mut values = table.at(height_m);
                let beyond_m = height_m - table.top_m();
                if beyond_m > 0.0 {
                    // Isothermal and of one humidity above the data: theta grows as the hydrostatic pressure falls.
                    let per_m = c::GRAVITY_M_S2 / (c::HEAT_CAPACITY_DRY_AIR * top_virtual_temperature_k);
                    values.liquid_water_potential_temperature_k *= (per_m * beyond_m).exp();
                }
                values
            }
            Self::Isentropic { theta_k, wind_m_s, .. } => Values {
                liquid_water_potential_temperature_k: *theta_k,
                total_water_kg_per_kg: 0.0,
                wind_m_s: *wind_m_s,
            },
            Self::ConstantStability {
                theta_k,
                per_m,
                relative_humidity,
                wind_m_s,
                ..
            } => {
                let theta_k = theta_k * (per_m * height_m).exp();
                Values {
                    liquid_water_potential_temperature_k: theta_k,
                    total_water_kg_per_kg: humid(*relative_humidity, super::pressure_of(exner), theta_k * exner),
                    wind_m_s: *wind_m_s,
                }
            }
            Self::WeismanKlemp {
                cap_kg_per_kg,
                shear_m_s,
                ..
            } => weisman_klemp(height_m, exner, *cap_kg_per_kg, *shear_m_s),
            Self::SaturatedNeutral { adiabat, wind_m_s, .. } => Values {
                liquid_water_potential_temperature_k: adiabat.theta_l_at(exner),
                total_water_kg_per_kg: adiabat.total_water_kg_per_kg(),
                wind_m_s: *wind_m_s,
            },
        }
    }
}

/// The reversible adiabat through saturated air at the ground. Errors: `out_of_range` where the air would not be saturated.
fn saturated_adiabat(pressure_pa: f64, theta_e_k: f64, mixing_ratio: f64) -> Result<Adiabat, ApiError> {
    // theta_e of saturated air rises with temperature throughout, so the root is found by halving.
    let (mut cold_k, mut hot_k) = (super::TEMPERATURE_MIN_K, super::TEMPERATURE_MAX_K);
    while hot_k - cold_k > 1e-10 {
        let middle_k = 0.5 * (cold_k + hot_k);
        if reversible_equivalent_potential_temperature_k(pressure_pa, middle_k, mixing_ratio) > theta_e_k {
            hot_k = middle_k;
        } else {
            cold_k = middle_k;
        }
    }
    let water = mixing_ratio / (1.0 + mixing_ratio);
    let saturated = c::saturation_specific_humidity(pressure_pa, cold_k);
    if water < saturated {
        let message = format!(
            "{mixing_ratio} is out of range: at the ground ({:.2} K) it takes at least {:.5} kg/kg to be saturated",
            cold_k,
            saturated / (1.0 - saturated)
        );
        return Err(ApiError::new("out_of_range", message).at("/base_state/total_water_mixing_ratio_kg_per_kg"));
    }
    let latent = c::LATENT_HEAT_VAPORISATION / c::HEAT_CAPACITY_DRY_AIR;
    let exner = super::exner_of(pressure_pa);
    let theta_l_k = (cold_k - latent * (water - saturated)) / exner;
    Ok(Adiabat::new(exner, theta_l_k, water))
}

/// Weisman and Klemp (1982): potential temperature and relative humidity as powers of height up to the tropopause, isothermal
/// above with a quarter of saturation; the mixing ratio is capped.
fn weisman_klemp(height_m: f64, exner: f64, cap_kg_per_kg: f64, shear_m_s: f64) -> Values {
    let share = (height_m / WK_TROPOPAUSE_M).powf(WK_EXPONENT);
    let (theta_k, relative_humidity) = if height_m <= WK_TROPOPAUSE_M {
        let theta_k = WK_SURFACE_THETA_K + (WK_TROPOPAUSE_THETA_K - WK_SURFACE_THETA_K) * share;
        (theta_k, 1.0 - 0.75 * share)
    } else {
        let per_m = c::GRAVITY_M_S2 / (c::HEAT_CAPACITY_DRY_AIR * WK_TROPOPAUSE_K);
        (
            WK_TROPOPAUSE_THETA_K * (per_m * (height_m - WK_TROPOPAUSE_M)).exp(),
            0.25,
        )
    };
    let pressure_pa = super::pressure_of(exner);
    let vapour_pa = c::saturation_vapour_pressure_pa(theta_k * exner).min(0.5 * pressure_pa);
    let saturation_mixing_ratio = c::EPSILON * vapour_pa / (pressure_pa - vapour_pa);
    let mixing_ratio = (relative_humidity * saturation_mixing_ratio).min(cap_kg_per_kg);
    Values {
        liquid_water_potential_temperature_k: theta_k,
        total_water_kg_per_kg: mixing_ratio / (1.0 + mixing_ratio),
        wind_m_s: [shear_m_s * (height_m / WK_SHEAR_TOP_M).min(1.0), 0.0],
    }
}

/// A sounding as a table: potential temperature from each level's own pressure, specific humidity from its dew point.
fn from_sounding(title: Option<String>, levels: &[SoundingLevel], lid_m: f64, notes: &mut Vec<String>) -> Source {
    let (ground, top) = (levels[0], levels[levels.len() - 1]);
    let dewpoints_k = fill_dewpoints(levels, notes);
    let mut table = Table::default();
    for (level, dewpoint_k) in levels.iter().zip(dewpoints_k) {
        table.height_m.push(level.height_m - ground.height_m);
        table
            .theta_l_k
            .push(level.temperature_k / super::exner_of(level.pressure_pa));
        table
            .water_kg_per_kg
            .push(dewpoint_k.map_or(0.0, |k| c::saturation_specific_humidity(level.pressure_pa, k)));
        table.wind_x_m_s.push(level.wind_x_m_s.unwrap_or(0.0));
        table.wind_y_m_s.push(level.wind_y_m_s.unwrap_or(0.0));
    }
    let top_water = table.water_kg_per_kg.last().copied().unwrap_or(0.0);
    if table.top_m() < lid_m {
        notes.push(format!(
            "the sounding ends {:.0} m above the ground, below the lid at {lid_m:.0} m: isothermal above",
            table.top_m()
        ));
    }
    Source::Sounding {
        title,
        surface_pressure_pa: ground.pressure_pa,
        surface_altitude_m: ground.height_m,
        top_virtual_temperature_k: top.temperature_k * super::virtual_factor(top_water, 0.0),
        table,
    }
}

/// Missing dew points from those of the levels around them: the depression below the temperature, linear in height between
/// two, the nearest one's beyond them. A sounding without any is dry.
fn fill_dewpoints(levels: &[SoundingLevel], notes: &mut Vec<String>) -> Vec<Option<f64>> {
    let known: Vec<(f64, f64)> = levels
        .iter()
        .filter_map(|level| Some((level.height_m, level.temperature_k - level.dewpoint_k?)))
        .collect();
    if known.is_empty() {
        notes.push("no dew points in the sounding: the air is taken as dry".to_owned());
        return vec![None; levels.len()];
    }
    let missing = levels.len() - known.len();
    if missing > 0 {
        notes.push(format!(
            "{missing} of {} levels without dew point: filled from those around them",
            levels.len()
        ));
    }
    let depression_k = |height_m: f64| {
        let above = known.partition_point(|(known_m, _)| *known_m < height_m);
        match (above.checked_sub(1).map(|i| known[i]), known.get(above)) {
            (Some((low_m, low_k)), Some((high_m, high_k))) => {
                low_k + (height_m - low_m) / (high_m - low_m) * (high_k - low_k)
            }
            (Some((_, nearest_k)), None) => nearest_k,
            (None, nearest) => nearest.map_or(0.0, |(_, nearest_k)| *nearest_k),
        }
    };
    levels
        .iter()
        .map(|level| {
            Some(
                level
                    .dewpoint_k
                    .unwrap_or(level.temperature_k - depression_k(level.height_m)),
            )
        })
        .collect()
}
