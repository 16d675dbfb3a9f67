//! Clouds and cameras for the picture tests, made by arithmetic alone so that every machine draws the same.
#![allow(dead_code, unused_imports, reason = "each test file uses some of these")]

pub use welkin_server::clouds::{Random, ball, cumulus_field, sun, volume};
use welkin_shaders::cpu::view::{Detail, Lighting, ViewSettings};

/// A camera near the ground that looks north and a little up, by day.
pub fn settings(width: usize, height: usize) -> ViewSettings {
    ViewSettings {
        camera_position_m: [3200.0, 300.0, 2.0],
        azimuth_deg: 0.0,
        elevation_deg: 18.0,
        vertical_fov_deg: 55.0,
        exposure_ev: 0.0,
        width,
        height,
        sun_direction: sun(45.0, 130.0),
        detail: Some(Detail {
            strength: 0.6,
            scale_m: 220.0,
        }),
        multiple_scattering_octaves: 6,
        lighting: Lighting::default(),
        ground: welkin_shaders::cpu::view::Ground::Land,
        cloud_shadow: true,
        visibility_m: Some(40_000.0),
        seed: 1,
        surface_altitude_m: 0.0,
        moon: None,
        stars: None,
        sky: Default::default(),
    }
}
