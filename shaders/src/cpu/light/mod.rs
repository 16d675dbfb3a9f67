//! Light on the CPU device: what the air and the clouds do to the sun's light before a ray of view asks for it.
//!
//! Radiances are relative to the sun's irradiance above the atmosphere, which is 1 in each of the three colours (680, 550 and
//! 440 nm stand for red, green and blue).

pub mod analytic_sky;
pub mod atmosphere;
pub(crate) mod between_clouds;
pub mod diffusion;
pub(crate) mod diffusion_grids;
pub mod diffusion_shares;
pub mod hosek_wilkie;
pub mod ice;
pub mod march_phase;
pub mod mie;
pub mod moon;
pub mod multiple_scattering_table;
pub mod octave_balance;
pub mod octave_shares;
pub mod path_tracer;
pub mod phase;
pub mod phase_table;
pub mod preetham;
pub mod sky_light;
pub mod sky_table;
pub mod sky_visibility;
mod slab_balance;
mod slab_blocks;
pub mod slab_collector;
pub mod slab_fit;
pub mod slab_photons;
pub mod slab_tables;
pub mod stars;
pub mod sun_map;
pub mod sun_optical_depth;
pub mod transmittance_table;

pub use atmosphere::Atmosphere;
