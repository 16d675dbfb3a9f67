//! The dynamics, one file a stage.

pub mod advect;
pub mod advect_momentum;
pub mod advect_scalar;
pub mod body_force;
pub mod cloud_extinction;
pub mod cloudy_ascent;
pub mod constant_viscosity;
pub mod coriolis;
pub mod diffuse_momentum;
pub mod diffuse_scalar;
pub mod dry_buoyancy;
pub mod eddy_viscosity;
pub mod large_scale;
pub mod parameters;
pub mod pressure_columns;
pub mod pressure_jacobi;
pub mod pressure_multigrid;
pub mod pressure_red_black_sor;
pub mod pressure_solve;
pub mod pressure_source;
pub mod project;
pub mod reduce;
pub mod reduce_cloud;
pub mod saturation_adjustment;
pub mod slab;
pub mod sponge;
pub mod surface_flux;
pub mod vitals;

pub use parameters::Parameters;
