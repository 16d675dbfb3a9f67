//! What the passes are told besides fields: the grid, the reference state and each effect's numbers.

use crate::catalogue::Rung;
use crate::grid::Grid;

/// Everything constant over a run. Profiles have one value a level, at cell centres, unless said otherwise.
#[derive(Clone, Debug)]
pub struct Parameters {
    /// The grid.
    pub grid: Grid,
    /// Reference density, kg/m3.
    pub density_kg_m3: Vec<f32>,
    /// Reference density at the faces, ground to lid, kg/m3; one value more than levels.
    pub density_at_z_face_kg_m3: Vec<f32>,
    /// Reference pressure, Pa.
    pub pressure_pa: Vec<f32>,
    /// `(p / p_ref) ^ kappa`.
    pub exner: Vec<f32>,
    /// Reference virtual potential temperature, K.
    pub virtual_potential_temperature_k: Vec<f32>,
    /// Liquid-water potential temperature that `Field::Heat` counts from, K: one number for the scene.
    pub heat_reference_k: f32,
    /// `Field::Heat` of the base state, K; what the sponge draws to.
    pub base_heat_k: Vec<f32>,
    /// Base wind towards the east, m/s.
    pub base_wind_x_m_s: Vec<f32>,
    /// Base wind towards the north, m/s.
    pub base_wind_y_m_s: Vec<f32>,
    /// Smagorinsky-Lilly.
    pub turbulence: Option<Turbulence>,
    /// One viscosity everywhere.
    pub constant_viscosity: Option<ConstantViscosity>,
    /// A push within a part of the box.
    pub body_force: Option<BodyForce>,
    /// The ground's fluxes.
    pub surface: Option<Surface>,
    /// Rotation.
    pub coriolis: Option<Coriolis>,
    /// Larger weather.
    pub large_scale: Option<LargeScale>,
    /// Damping rates under the lid, 1/s, at centres and at lower faces.
    pub sponge: Option<[Vec<f32>; 2]>,
    /// Droplets a cubic metre of cloud; sets extinction.
    pub droplet_number_per_m3: f32,
    /// The chosen rungs and their numbers.
    pub methods: Methods,
}

/// Which method does a job that several can do, with its numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Methods {
    /// The rung of the advection ladder.
    pub advection: Rung,
    /// The rung of the pressure ladder.
    pub pressure: PressureMethod,
}

impl Default for Methods {
    /// Flux form and the direct solver.
    fn default() -> Self {
        Self {
            advection: Rung::FluxForm,
            pressure: PressureMethod::Direct,
        }
    }
}

impl Methods {
    /// Stages of a substep.
    pub fn stages(&self) -> usize {
        self.advection.info().advance.map_or(1, |a| a.stages)
    }
}

/// A pressure solver and its numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PressureMethod {
    /// FFT and tridiagonal.
    Direct,
    /// Jacobi's iteration.
    Jacobi {
        /// Sweeps a solve.
        sweeps: u32,
    },
    /// Red-black successive over-relaxation.
    RedBlackSor {
        /// Sweeps (both colours) a solve.
        sweeps: u32,
        /// Relaxation factor, above 0 and below 2.
        relaxation: f32,
    },
    /// Multigrid V-cycles.
    Multigrid {
        /// Cycles a solve.
        cycles: u32,
    },
}

impl PressureMethod {
    /// Whether it starts from the last pressure, which is then part of what a continuation needs.
    pub fn is_iterative(&self) -> bool {
        *self != Self::Direct
    }

    /// Its rung.
    pub fn rung(&self) -> Rung {
        match self {
            Self::Direct => Rung::Direct,
            Self::Jacobi { .. } => Rung::Jacobi,
            Self::RedBlackSor { .. } => Rung::RedBlackSor,
            Self::Multigrid { .. } => Rung::Multigrid,
        }
    }
}

/// Parameters of the eddy viscosity.
#[derive(Clone, Debug)]
pub struct Turbulence {
    /// Smagorinsky's coefficient.
    pub coefficient: f32,
    /// Viscosity over diffusivity.
    pub prandtl: f32,
}

/// Parameters of the constant viscosity.
#[derive(Clone, Debug)]
pub struct ConstantViscosity {
    /// Of momentum, m2/s.
    pub viscosity_m2_s: f32,
    /// Of heat and water, m2/s.
    pub diffusivity_m2_s: f32,
    /// How time is stepped.
    pub scheme: DiffusionScheme,
}

/// How diffusion steps through time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DiffusionScheme {
    /// From the state as it is; bounds the substep.
    Explicit,
    /// From the state to come, by Jacobi's iteration; bounds nothing.
    Implicit,
}

/// Parameters of the body force.
#[derive(Clone, Debug)]
pub struct BodyForce {
    /// The region's lower corner, m.
    pub lower_m: [f32; 3],
    /// The region's upper corner, m.
    pub upper_m: [f32; 3],
    /// Acceleration, m/s2.
    pub acceleration_m_s2: [f32; 3],
    /// Drag, 1/s.
    pub drag_per_s: f32,
}

/// Parameters of the ground.
#[derive(Clone, Debug)]
pub struct Surface {
    /// Kinematic heat flux, K m/s.
    pub heat_flux_k_m_s: f32,
    /// Kinematic moisture flux, kg/kg m/s.
    pub moisture_flux_m_s: f32,
    /// Friction velocity, m/s.
    pub friction_velocity_m_s: f32,
}

/// Parameters of the rotation.
#[derive(Clone, Debug)]
pub struct Coriolis {
    /// Coriolis parameter, 1/s.
    pub parameter_per_s: f32,
    /// Geostrophic wind towards the east, m/s.
    pub wind_x_m_s: Vec<f32>,
    /// Geostrophic wind towards the north, m/s.
    pub wind_y_m_s: Vec<f32>,
}

/// Parameters of the larger weather.
#[derive(Clone, Debug)]
pub struct LargeScale {
    /// Vertical wind, m/s.
    pub vertical_wind_m_s: Vec<f32>,
    /// Heating, K/s.
    pub heating_k_per_s: Vec<f32>,
    /// Moistening, 1/s.
    pub moistening_per_s: Vec<f32>,
}
