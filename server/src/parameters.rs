//! From a scene and its base state to the numbers that passes are told.

use welkin_proto::Scene;
use welkin_proto::scene::{self, Profile};
use welkin_shaders::Grid;
use welkin_shaders::constants::EARTH_ROTATION_PER_S;
use welkin_shaders::cpu::sim::Parameters;
use welkin_shaders::cpu::sim::parameters::{
    BodyForce, ConstantViscosity, Coriolis, DiffusionScheme, LargeScale, Methods, Surface, Turbulence,
};

use crate::base_state::BaseState;

/// The scene's grid.
pub fn grid(scene: &Scene) -> Grid {
    Grid {
        cells: scene.domain.cells.map(|n| n as usize),
        cell_size_m: scene.domain.cell_size_m.map(|d| d as f32),
    }
}

/// A piecewise-linear profile at a height; constant beyond its ends, 0 if it is empty.
pub fn interpolate(profile: &Profile, height_m: f64) -> f64 {
    let above = profile.partition_point(|[z, _]| *z <= height_m);
    match (above.checked_sub(1).map(|i| profile[i]), profile.get(above)) {
        (Some([z0, a]), Some([z1, b])) => a + (b - a) * (height_m - z0) / (z1 - z0),
        (Some([_, a]), None) => a,
        (None, Some([_, b])) => *b,
        (None, None) => 0.0,
    }
}

/// All parameters of the scene's passes, which run the chosen methods.
pub fn parameters(scene: &Scene, base: &BaseState, methods: Methods) -> Parameters {
    let grid = grid(scene);
    let levels = grid.cells[2];
    let single = |values: &[f64]| values.iter().map(|&v| v as f32).collect::<Vec<f32>>();
    let centres = |profile: &Profile| {
        (0..levels)
            .map(|z| interpolate(profile, grid.centre_height_m(z)) as f32)
            .collect::<Vec<f32>>()
    };
    let heat_reference_k = base.liquid_water_potential_temperature_k[0];
    let effects = &scene.effects;
    let wind = [single(&base.wind_x_m_s), single(&base.wind_y_m_s)];
    let lid = grid.size_m()[2] as f64;
    Parameters {
        grid,
        density_kg_m3: single(&base.density_kg_m3),
        density_at_z_face_kg_m3: single(&base.density_at_z_face_kg_m3),
        pressure_pa: single(&base.pressure_pa),
        exner: single(&base.exner),
        virtual_potential_temperature_k: single(&base.virtual_potential_temperature_k),
        heat_reference_k: heat_reference_k as f32,
        base_heat_k: base
            .liquid_water_potential_temperature_k
            .iter()
            .map(|t| (t - heat_reference_k as f32 as f64) as f32)
            .collect(),
        turbulence: effects.turbulence.as_ref().map(|t| Turbulence {
            coefficient: t.smagorinsky_coefficient as f32,
            prandtl: t.turbulent_prandtl_number as f32,
        }),
        constant_viscosity: effects.constant_viscosity.as_ref().map(|c| ConstantViscosity {
            viscosity_m2_s: c.viscosity_m2_s as f32,
            diffusivity_m2_s: c.diffusivity_m2_s as f32,
            scheme: match c.scheme {
                scene::DiffusionScheme::Explicit => DiffusionScheme::Explicit,
                scene::DiffusionScheme::Implicit => DiffusionScheme::Implicit,
            },
        }),
        body_force: effects.body_force.as_ref().map(|f| BodyForce {
            lower_m: f.lower_m.map(|m| m as f32),
            upper_m: f.upper_m.map(|m| m as f32),
            acceleration_m_s2: f.acceleration_m_s2.map(|a| a as f32),
            drag_per_s: f.drag_per_s as f32,
        }),
        surface: effects.surface.as_ref().map(|s| Surface {
            heat_flux_k_m_s: s.heat_flux_k_m_s as f32,
            moisture_flux_m_s: s.moisture_flux_m_s as f32,
            friction_velocity_m_s: s.friction_velocity_m_s as f32,
        }),
        coriolis: effects.coriolis.as_ref().map(|c| Coriolis {
            parameter_per_s: c
                .parameter_per_s
                .unwrap_or_else(|| 2.0 * EARTH_ROTATION_PER_S * scene.domain.latitude_deg.to_radians().sin())
                as f32,
            wind_x_m_s: c
                .geostrophic_wind_x_m_s
                .as_ref()
                .map_or_else(|| wind[0].clone(), centres),
            wind_y_m_s: c
                .geostrophic_wind_y_m_s
                .as_ref()
                .map_or_else(|| wind[1].clone(), centres),
        }),
        large_scale: effects.large_scale.as_ref().map(|l| LargeScale {
            vertical_wind_m_s: centres(&l.vertical_wind_m_s),
            heating_k_per_s: centres(&l.heating_k_per_s),
            moistening_per_s: centres(&l.moistening_per_s),
        }),
        sponge: effects.sponge.as_ref().map(|s| {
            let rate = |height: f64| {
                let depth = ((height - (lid - s.depth_m)) / s.depth_m).clamp(0.0, 1.0);
                (s.rate_per_s * (0.5 * std::f64::consts::PI * depth).sin().powi(2)) as f32
            };
            let dz = grid.cell_size_m[2] as f64;
            [
                (0..levels).map(|z| rate(grid.centre_height_m(z))).collect(),
                (0..levels).map(|z| rate(z as f64 * dz)).collect(),
            ]
        }),
        droplet_number_per_m3: effects.moisture.as_ref().map_or(1e8, |m| m.droplet_number_per_m3) as f32,
        methods,
        base_wind_x_m_s: wind[0].clone(),
        base_wind_y_m_s: wind[1].clone(),
    }
}
