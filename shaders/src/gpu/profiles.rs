//! What a world's passes are told on the GPU: one uniform struct, one for each Runge-Kutta stage, and the profiles in one storage buffer.

use crate::catalogue::Field;
use crate::cpu::sim::parameters::PressureMethod;
use crate::cpu::sim::pressure_columns::Columns;
use crate::cpu::sim::{
    Parameters, body_force, cloud_extinction, cloudy_ascent, constant_viscosity, eddy_viscosity, pressure_jacobi,
    pressure_red_black_sor,
};
use crate::device::Substep;

crate::gpu_struct! {
    /// Everything constant over a run that isn't a profile.
    pub struct Sim {
        /// Cells east, north, up, and in a level.
        pub cells: [u32; 4],
        /// One over the cell sizes, 1/m; the last is unused.
        pub per_cell_size_m: [f32; 4],
        /// Cell sizes, m; the last is unused.
        pub cell_size_m: [f32; 4],
        /// The body force's region along each axis: first place and end of centres, then of faces.
        pub force_region: [[u32; 4]; 3],
        /// The body force's acceleration, m/s2, and its drag, 1/s.
        pub force: [f32; 4],
        /// Constant viscosity of horizontal velocities, of w, and diffusivity of scalars, m2/s; the last is unused.
        pub mixing: [f32; 4],
        /// For the same the largest sum of a cell's couplings, 1/s; the last is unused.
        pub mixing_rate_per_s: [f32; 4],
        /// Couplings of the pressure's columns east and north, 1/m2 (0 along an axis of one cell), and the relaxation factor; the last is unused.
        pub columns: [f32; 4],
        /// See [`Parameters::heat_reference_k`].
        pub heat_reference_k: f32,
        /// Viscosity over diffusivity.
        pub prandtl: f32,
        /// Coriolis parameter, 1/s.
        pub coriolis_parameter_per_s: f32,
        /// Kinematic heat flux, K m/s.
        pub heat_flux_k_m_s: f32,
        /// Kinematic moisture flux, kg/kg m/s.
        pub moisture_flux_m_s: f32,
        /// Square of the friction velocity, m2/s2.
        pub friction_velocity_squared_m2_s2: f32,
        /// Which fields the plan holds, the `HOLDS_` bits.
        pub holds: u32,
        /// Unused.
        pub unused: u32,
    }
}

crate::gpu_struct! {
    /// What changes from stage to stage.
    pub struct Step {
        /// Time from the substep's start to the stage's result, s.
        pub stage_s: f32,
        /// Length of the substep, s.
        pub substep_s: f32,
        /// Factor of the mass divergence before its transform: 1 / (stage_s nx ny), 1/s.
        pub divergence_scale_per_s: f32,
        /// Unused.
        pub unused: f32,
    }
}

impl Step {
    /// For one stage of a substep on a grid of `plane` cells a level.
    pub fn new(substep: &Substep, plane: usize) -> Self {
        Self {
            stage_s: substep.stage_s(),
            substep_s: substep.substep_s,
            divergence_scale_per_s: 1.0 / (substep.stage_s() * plane as f32),
            unused: 0.0,
        }
    }
}

macro_rules! profiles {
    ($($(#[$doc:meta])* $name:ident = $place:literal;)*) => {
        crate::constants! {
            $($(#[$doc])* pub const $name: u32 = $place;)*
            /// Number of profiles.
            pub const PROFILES: u32 = [$($place),*].len() as u32;
        }
    };
}

profiles! {
    /// Reference density, kg/m3.
    PROFILE_DENSITY = 0;
    /// Reference density at lower faces and the lid, kg/m3.
    PROFILE_FACE_DENSITY = 1;
    /// Reference pressure, Pa.
    PROFILE_PRESSURE = 2;
    /// Exner function.
    PROFILE_EXNER = 3;
    /// Reference virtual potential temperature, K.
    PROFILE_THETA_V = 4;
    /// Heat of the base state, K.
    PROFILE_BASE_HEAT = 5;
    /// Base wind towards the east, m/s.
    PROFILE_BASE_WIND_X = 6;
    /// Base wind towards the north, m/s.
    PROFILE_BASE_WIND_Y = 7;
    /// Geostrophic wind towards the east, m/s.
    PROFILE_GEOSTROPHIC_X = 8;
    /// Geostrophic wind towards the north, m/s.
    PROFILE_GEOSTROPHIC_Y = 9;
    /// Large-scale vertical wind, m/s.
    PROFILE_SUBSIDENCE = 10;
    /// Large-scale heating, K/s.
    PROFILE_HEATING = 11;
    /// Large-scale moistening, 1/s.
    PROFILE_MOISTENING = 12;
    /// Damping rate of the sponge at centres, 1/s.
    PROFILE_SPONGE = 13;
    /// Damping rate of the sponge at lower faces, 1/s.
    PROFILE_SPONGE_FACE = 14;
    /// Extinction over (cloud water)^(2/3), 1/m.
    PROFILE_EXTINCTION_SCALE = 15;
    /// Square of the mixing length with the wall's damping, m2.
    PROFILE_LENGTH_SQUARED = 16;
    /// What cloudy air loses of theta_l a metre of rise and unit of cloud water, at lower faces, K/m.
    PROFILE_CLOUDY_ASCENT = 17;
    /// Jacobi's weight of the pressures west and east.
    PROFILE_JACOBI_X = 18;
    /// Jacobi's weight of those south and north.
    PROFILE_JACOBI_Y = 19;
    /// Jacobi's weight of the one below.
    PROFILE_JACOBI_BELOW = 20;
    /// Jacobi's weight of the one above.
    PROFILE_JACOBI_ABOVE = 21;
    /// Jacobi's weight of the source, m5/kg.
    PROFILE_JACOBI_SOURCE = 22;
    /// Coupling of a column's pressure to the one below, kg/m5.
    PROFILE_COLUMN_BELOW = 23;
    /// To the one above.
    PROFILE_COLUMN_ABOVE = 24;
    /// One over the pivots of a column's elimination, m5/kg.
    PROFILE_COLUMN_PIVOT = 25;
}

/// Constants beside the profiles' places.
pub mod holds {
    crate::constants! {
        /// The plan holds heat.
        pub const HOLDS_HEAT: u32 = 1;
        /// The plan holds water.
        pub const HOLDS_WATER: u32 = 2;
        /// The plan holds tendencies over a substep.
        pub const HOLDS_SLOW: u32 = 4;
        /// The plan holds buoyancy.
        pub const HOLDS_BUOYANCY: u32 = 8;
        /// The plan holds the eddy viscosity.
        pub const HOLDS_VISCOSITY: u32 = 16;
        /// The plan holds velocities.
        pub const HOLDS_FLOW: u32 = 32;
        /// Levels that one thread of the advection climbs.
        pub const LEVELS_PER_THREAD: u32 = 8;
    }
}

impl Sim {
    /// For a world that holds `planned` fields.
    pub fn new(p: &Parameters, planned: &[Field]) -> Self {
        let cells = p.grid.cells.map(|n| n as u32);
        let [dx, dy, dz] = p.grid.cell_size_m;
        let bit = |field: Field, bit: u32| if planned.contains(&field) { bit } else { 0 };
        let surface = p.surface.as_ref();
        Self {
            cells: [cells[0], cells[1], cells[2], cells[0] * cells[1]],
            per_cell_size_m: [1.0 / dx, 1.0 / dy, 1.0 / dz, 0.0],
            cell_size_m: [dx, dy, dz, 0.0],
            force_region: [0, 1, 2].map(|a| {
                p.body_force.as_ref().map_or([0; 4], |f| {
                    let [centres, faces] = [false, true].map(|at_face| body_force::range(&p.grid, f, a, at_face));
                    [centres.start, centres.end, faces.start, faces.end].map(|i| i as u32)
                })
            }),
            force: p.body_force.as_ref().map_or([0.0; 4], |f| {
                let [x, y, z] = f.acceleration_m_s2;
                [x, y, z, f.drag_per_s]
            }),
            mixing: p.constant_viscosity.as_ref().map_or([0.0; 4], |m| {
                [m.viscosity_m2_s, m.viscosity_m2_s, m.diffusivity_m2_s, 0.0]
            }),
            mixing_rate_per_s: p.constant_viscosity.as_ref().map_or([0.0; 4], |m| {
                let rate =
                    |coefficient, at_z_face| constant_viscosity::implicit_sweeps(p, coefficient, at_z_face, 1.0).0;
                [
                    rate(m.viscosity_m2_s, false),
                    rate(m.viscosity_m2_s, true),
                    rate(m.diffusivity_m2_s, false),
                    0.0,
                ]
            }),
            columns: match p.methods.pressure {
                PressureMethod::RedBlackSor { relaxation, .. } => {
                    let [x, y] = Columns::finest(p).coupling.map(|c| c as f32);
                    [
                        x,
                        y,
                        pressure_red_black_sor::relaxation_on(p.grid.cells, relaxation),
                        0.0,
                    ]
                }
                _ => [0.0; 4],
            },
            heat_reference_k: p.heat_reference_k,
            prandtl: p.turbulence.as_ref().map_or(1.0, |t| t.prandtl),
            coriolis_parameter_per_s: p.coriolis.as_ref().map_or(0.0, |c| c.parameter_per_s),
            heat_flux_k_m_s: surface.map_or(0.0, |s| s.heat_flux_k_m_s),
            moisture_flux_m_s: surface.map_or(0.0, |s| s.moisture_flux_m_s),
            friction_velocity_squared_m2_s2: surface.map_or(0.0, |s| s.friction_velocity_m_s.powi(2)),
            holds: bit(Field::Heat, holds::HOLDS_HEAT)
                | bit(Field::Water, holds::HOLDS_WATER)
                | bit(Field::SlowVelocityX, holds::HOLDS_SLOW)
                | bit(Field::Buoyancy, holds::HOLDS_BUOYANCY)
                | bit(Field::EddyViscosity, holds::HOLDS_VISCOSITY)
                | bit(Field::VelocityX, holds::HOLDS_FLOW),
            unused: 0,
        }
    }
}

/// All profiles, `[profile][level]`, one level more than the grid has for those at lower faces.
pub fn pack(p: &Parameters) -> Vec<f32> {
    let grid = &p.grid;
    let levels = grid.cells[2];
    let mut packed = vec![0.0; PROFILES as usize * (levels + 1)];
    let mut put = |profile: u32, values: &[f32]| {
        let at = profile as usize * (levels + 1);
        let n = values.len().min(levels + 1);
        packed[at..at + n].copy_from_slice(&values[..n]);
    };
    put(PROFILE_DENSITY, &p.density_kg_m3);
    put(PROFILE_FACE_DENSITY, &p.density_at_z_face_kg_m3);
    put(PROFILE_PRESSURE, &p.pressure_pa);
    put(PROFILE_EXNER, &p.exner);
    put(PROFILE_THETA_V, &p.virtual_potential_temperature_k);
    put(PROFILE_BASE_HEAT, &p.base_heat_k);
    put(PROFILE_BASE_WIND_X, &p.base_wind_x_m_s);
    put(PROFILE_BASE_WIND_Y, &p.base_wind_y_m_s);
    if let Some(rotation) = &p.coriolis {
        put(PROFILE_GEOSTROPHIC_X, &rotation.wind_x_m_s);
        put(PROFILE_GEOSTROPHIC_Y, &rotation.wind_y_m_s);
    }
    if let Some(weather) = &p.large_scale {
        put(PROFILE_SUBSIDENCE, &weather.vertical_wind_m_s);
        put(PROFILE_HEATING, &weather.heating_k_per_s);
        put(PROFILE_MOISTENING, &weather.moistening_per_s);
    }
    if let Some([centres, faces]) = &p.sponge {
        put(PROFILE_SPONGE, centres);
        put(PROFILE_SPONGE_FACE, faces);
    }
    let scale: Vec<f32> = (0..levels).map(|z| cloud_extinction::scale(p, z)).collect();
    put(PROFILE_EXTINCTION_SCALE, &scale);
    let ascent: Vec<f32> = (0..=levels).map(|z| cloudy_ascent::rate_at_face(p, z)).collect();
    put(PROFILE_CLOUDY_ASCENT, &ascent);
    match p.methods.pressure {
        PressureMethod::Jacobi { .. } => {
            let weights = pressure_jacobi::weights(p);
            for (n, profile) in [
                PROFILE_JACOBI_X,
                PROFILE_JACOBI_Y,
                PROFILE_JACOBI_BELOW,
                PROFILE_JACOBI_ABOVE,
                PROFILE_JACOBI_SOURCE,
            ]
            .into_iter()
            .enumerate()
            {
                let row: Vec<f32> = weights.iter().map(|w| w[n]).collect();
                put(profile, &row);
            }
        }
        PressureMethod::RedBlackSor { .. } => {
            let columns = Columns::finest(p);
            put(PROFILE_COLUMN_BELOW, &columns.below);
            put(PROFILE_COLUMN_ABOVE, &columns.above);
            put(PROFILE_COLUMN_PIVOT, &columns.pivots);
        }
        PressureMethod::Direct | PressureMethod::Multigrid { .. } => {}
    }
    if let Some(turbulence) = &p.turbulence {
        let squares: Vec<f32> = (0..levels)
            .map(|z| eddy_viscosity::length_squared_m2(grid, turbulence.coefficient, z))
            .collect();
        put(PROFILE_LENGTH_SQUARED, &squares);
    }
    packed
}
