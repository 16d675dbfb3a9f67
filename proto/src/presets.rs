//! The scenes that come with Welkin, usable by name.

use crate::error::ApiError;
use crate::scene::Scene;

/// Name of the scene that a server starts with.
pub const DEFAULT: &str = "fair-weather-cumulus";

/// A scene that comes with Welkin.
#[derive(Clone, Copy, Debug)]
pub struct Preset {
    /// What it is asked for by.
    pub name: &'static str,
    /// The scene's JSON document.
    pub json: &'static str,
}

/// Every preset, the default first.
pub fn all() -> &'static [Preset] {
    &[
        Preset {
            name: DEFAULT,
            json: include_str!("../scenes/fair-weather-cumulus.json"),
        },
        Preset {
            name: "stratocumulus",
            json: include_str!("../scenes/stratocumulus.json"),
        },
        Preset {
            name: "warm-bubble",
            json: include_str!("../scenes/warm-bubble.json"),
        },
        Preset {
            name: "deep-convection",
            json: include_str!("../scenes/deep-convection.json"),
        },
        Preset {
            name: "clear-sky-wind",
            json: include_str!("../scenes/clear-sky-wind.json"),
        },
        Preset {
            name: "density-current",
            json: include_str!("../scenes/density-current.json"),
        },
        Preset {
            name: "wind-tunnel",
            json: include_str!("../scenes/wind-tunnel.json"),
        },
        Preset {
            name: "dry-bubble",
            json: include_str!("../scenes/dry-bubble.json"),
        },
        Preset {
            name: "moist-bubble",
            json: include_str!("../scenes/moist-bubble.json"),
        },
    ]
}

/// The scene of that name. Errors: `unknown_preset`, listing the names.
pub fn find(name: &str) -> Result<Scene, ApiError> {
    let Some(preset) = all().iter().find(|preset| preset.name == name) else {
        let known = all().iter().map(|preset| preset.name).collect::<Vec<_>>().join(", ");
        let shown: String = name.chars().take(60).collect();
        return Err(ApiError::new(
            "unknown_preset",
            format!("no preset is named {shown:?}; there are {known}"),
        ));
    };
    serde_json::from_str(preset.json)
        .map_err(|error| ApiError::new("bad_scene", format!("the preset {name} is broken: {error}")))
}
