//! Channels: what can be asked of the air at a place, by sample or by volume.
//!
//! A channel is a number at each cell centre of a world's grid. Its name is the same in URLs, JSON and binary headers and
//! carries the unit. What a scene does not simulate is refused (`channel_unavailable`) and never made up; what no scene can
//! simulate yet stands in [`ABSENT`] with the reason.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::ApiError;

macro_rules! channels {
    ($($(#[$doc:meta])* $id:ident $name:literal $unit:literal;)*) => {
        /// See the module.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
        #[serde(rename_all = "snake_case")]
        pub enum Channel { $($(#[$doc])* #[serde(rename = $name)] $id),* }

        impl Channel {
            /// All channels, in the order of their numbers on the wire.
            pub const ALL: &'static [Channel] = &[$(Channel::$id),*];
            /// The name on the wire, which ends in the unit.
            pub fn name(self) -> &'static str { match self { $(Channel::$id => $name),* } }
            /// The unit, in UCUM where UCUM has it: `1` has none, `m2/3/s` is metres to the power of two thirds a second.
            pub fn unit(self) -> &'static str { match self { $(Channel::$id => $unit),* } }
        }
    };
}

channels! {
    /// Extinction of visible light by cloud droplets: what the server's pictures are drawn of. Clear air is not in it.
    ExtinctionPerM "extinction_per_m" "/m";
    /// Effective radius of the cloud droplets; 0 where there is no cloud. Needs `moisture`.
    EffectiveRadiusM "effective_radius_m" "m";
    /// Wind towards the east, the mean of a cell's two faces. Needs `flow`, as its fellows do.
    WindXMS "wind_x_m_s" "m/s";
    /// Wind towards the north.
    WindYMS "wind_y_m_s" "m/s";
    /// Wind upwards.
    WindZMS "wind_z_m_s" "m/s";
    /// Air temperature. Without the effect `heat` that of the base state, which then is the world's.
    TemperatureK "temperature_k" "K";
    /// Air pressure: the hydrostatic reference state's, by height alone, which is the pressure that the model's thermodynamics know. The
    /// pressure of the motion itself, some tens of Pa at most in cumulus, is not in it.
    PressurePa "pressure_pa" "Pa";
    /// Relative humidity over water, vapour pressure over saturation vapour pressure (Bolton 1980); 1 is saturated. Needs `moisture`.
    RelativeHumidity "relative_humidity" "1";
    /// Water vapour in a mass of moist air. Needs `moisture`.
    VapourKgKg "vapour_kg_kg" "kg/kg";
    /// Cloud water in a mass of moist air. Needs `moisture`.
    LiquidWaterKgKg "liquid_water_kg_kg" "kg/kg";
    /// Vapour and cloud water. Needs `moisture`.
    TotalWaterKgKg "total_water_kg_kg" "kg/kg";
    /// Turbulence: the cube root of the rate at which eddies smaller than a cell turn motion into heat, which aviation calls EDR (ICAO
    /// Annex 3, for a medium-sized aircraft: light from 0.1, moderate from 0.2, severe from 0.45). From the
    /// Smagorinsky-Lilly viscosity nu and its mixing length l, with production and dissipation in balance (Lilly 1967):
    /// epsilon = nu^3 / l^4. Needs `turbulence`.
    EddyDissipationRateM23S "eddy_dissipation_rate_m23_s" "m2/3/s";
    /// Horizontal visibility by day: 3 over all extinction of green light, by cloud, aerosol and molecules (Koschmieder at 5 %
    /// contrast, the meteorological optical range; the law that the scene's `aerial_perspective.visibility_m` is read by). Between cells
    /// interpolate the extinction and not this.
    VisibilityM "visibility_m" "m";
}

/// What aviation and weather services ask for and no scene simulates yet, with the reason.
pub const ABSENT: &[(&str, &str)] = &[
    (
        "rain_rate_mm_h",
        "the model has no rain: what is above saturation stays cloud",
    ),
    (
        "rain_water_kg_kg",
        "the model has no rain: what is above saturation stays cloud",
    ),
    ("ice_water_kg_kg", "the model has no ice: all condensed water is liquid"),
];

impl Channel {
    /// One line: what it is.
    pub fn what(self) -> &'static str {
        match self {
            Self::ExtinctionPerM => "extinction of light by cloud droplets",
            Self::EffectiveRadiusM => "effective radius of cloud droplets",
            Self::WindXMS => "wind towards the east",
            Self::WindYMS => "wind towards the north",
            Self::WindZMS => "wind upwards",
            Self::TemperatureK => "air temperature",
            Self::PressurePa => "air pressure",
            Self::RelativeHumidity => "relative humidity over water",
            Self::VapourKgKg => "specific humidity",
            Self::LiquidWaterKgKg => "cloud water",
            Self::TotalWaterKgKg => "vapour and cloud water",
            Self::EddyDissipationRateM23S => "turbulence: cube root of the eddy dissipation rate",
            Self::VisibilityM => "horizontal visibility by day, 5 % contrast",
        }
    }

    /// The effect of a scene without which it is not there; none: every world has it.
    pub fn needs(self) -> Option<&'static str> {
        match self {
            Self::WindXMS | Self::WindYMS | Self::WindZMS => Some("flow"),
            Self::EddyDissipationRateM23S => Some("turbulence"),
            Self::ExtinctionPerM
            | Self::EffectiveRadiusM
            | Self::RelativeHumidity
            | Self::VapourKgKg
            | Self::LiquidWaterKgKg
            | Self::TotalWaterKgKg => Some("moisture"),
            Self::TemperatureK | Self::PressurePa | Self::VisibilityM => None,
        }
    }

    /// The channel of that name. Errors: `channel_unavailable` with the reason for those in [`ABSENT`], else `unknown_channel`.
    pub fn named(name: &str) -> Result<Self, ApiError> {
        if let Some(channel) = Self::ALL.iter().find(|c| c.name() == name) {
            return Ok(*channel);
        }
        Err(match ABSENT.iter().find(|(absent, _)| *absent == name) {
            Some((_, why)) => ApiError::new("channel_unavailable", format!("{name}: {why}")),
            None => {
                let shown: String = name.chars().take(40).collect();
                let known: Vec<&str> = Self::ALL.iter().map(|c| c.name()).collect();
                let message = format!("there is no channel {shown:?}; known are {}", known.join(", "));
                ApiError::new("unknown_channel", message)
            }
        })
    }

    /// Its number in binary messages; it never changes.
    pub fn number(self) -> u8 {
        self as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_the_same_everywhere_and_end_in_a_unit() {
        for (number, channel) in Channel::ALL.iter().enumerate() {
            assert_eq!(usize::from(channel.number()), number);
            assert_eq!(Channel::named(channel.name()).as_ref(), Ok(channel));
            let json = serde_json::to_value(channel).expect("a name");
            assert_eq!(json, channel.name());
            assert!(!channel.what().is_empty() && !channel.unit().is_empty());
        }
    }

    #[test]
    fn what_no_scene_has_is_told_from_what_nobody_knows() {
        for (name, why) in ABSENT {
            let error = Channel::named(name).expect_err("no such channel");
            assert_eq!(error.code, "channel_unavailable");
            assert!(error.message.contains(why));
        }
        for name in ["", "Temperature_K", "temperature", "wind_x_m_s ", "\u{0}"] {
            assert_eq!(Channel::named(name).expect_err(name).code, "unknown_channel");
        }
    }
}
