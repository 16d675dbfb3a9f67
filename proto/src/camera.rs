//! Where a picture is taken from.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A pinhole camera with no roll.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Metres east, north and up from the domain's south-west corner on the ground.
    pub position_m: [f64; 3],
    /// Direction of view, degrees clockwise from north: 0 north, 90 east.
    pub azimuth_deg: f64,
    /// Degrees above the horizon: 90 straight up, -90 straight down.
    pub elevation_deg: f64,
    /// Angle of view from the bottom to the top of the picture, degrees.
    pub vertical_fov_deg: f64,
    /// Exposure compensation in stops; 0 exposes for a sunlit scene by day.
    #[serde(default)]
    pub exposure_ev: f64,
}
