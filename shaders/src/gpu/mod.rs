//! The GPU device: the same stages in WGSL, run through wgpu.
//!
//! Within WebGPU's default limits (8 storage buffers a stage, 256 invocations a workgroup, 16 KiB of its memory); larger buffers are used where the
//! adapter has them. No subgroups and no 16-bit floats are required.

pub mod bandwidth;
pub mod context;
mod device;
pub mod dispatches;
pub mod error;
pub mod kernel;
pub mod pressure;
pub mod profiles;
pub mod readback;
pub mod view;
pub mod view_diffusion;
pub mod view_impostors;
pub mod view_kernels;
pub mod view_layers;
pub mod view_octave_balance;
pub mod view_reproject;
pub mod view_stages;
pub mod view_sun_map;
pub mod view_upsample;

pub use context::{AdapterChoice, AdapterReport, Context};
pub use device::Gpu;
pub use error::GpuError;
pub use kernel::{Bind, Kernel};
pub use view::GpuView;
pub use view_reproject::GpuHistory;
pub use view_stages::ViewStages;

use crate::cpu::sim::{advect, cloud_extinction, reduce_cloud, saturation_adjustment, surface_flux};
use crate::cpu::{light, view as view_twins};
use crate::wgsl::Module;
use view_diffusion::DiffusionGrid;
use view_impostors::FarClouds;
use view_layers::Layering;
use view_octave_balance::OctaveBalancing;
use view_reproject::Recall;
use view_stages::{
    Air, MARCH_PHASE, ShapeGrid, SkyLightAsk, SkyLightValues, SkyView, SunMarch, ViewFrame, VisibilitySweep,
};
use view_sun_map::SunMapping;
use view_upsample::Sampling;

macro_rules! modules {
    ($($name:literal constants [$($constants:path),* $(,)?] structs [$($layout:expr),* $(,)?];)*) => {
        /// Every WGSL module: its file and what is generated before it.
        pub const MODULES: &[Module] = &[$(Module {
            name: $name,
            text: include_str!(concat!("../../wgsl/", $name, ".wgsl")),
            constants: &[$($constants),*],
            structs: &[$($layout),*],
        }),*];
    };
}

modules! {
    "shared/constants" constants [crate::constants::WGSL] structs [];
    "bench/copy" constants [] structs [];
    "shared/largest" constants [] structs [];
    "shared/largest_by_subgroups" constants [] structs [];
    "shared/grid" constants [profiles::WGSL, profiles::holds::WGSL] structs [profiles::Sim::LAYOUT, profiles::Step::LAYOUT];
    "shared/advect" constants [advect::WGSL] structs [];
    "sim/saturation_adjustment" constants [saturation_adjustment::WGSL] structs [];
    "sim/dry_buoyancy" constants [] structs [];
    "sim/eddy_viscosity" constants [] structs [];
    "sim/diffuse_momentum" constants [] structs [];
    "sim/diffuse_scalar" constants [] structs [];
    "sim/surface_flux" constants [surface_flux::WGSL] structs [];
    "sim/coriolis" constants [] structs [];
    "sim/large_scale" constants [] structs [];
    "sim/body_force" constants [] structs [];
    "sim/sponge" constants [] structs [];
    "sim/advect_scalar" constants [] structs [];
    "sim/advect_momentum" constants [] structs [];
    "sim/cloudy_ascent" constants [] structs [];
    "shared/semi_lagrangian" constants [] structs [];
    "shared/carried" constants [] structs [];
    "sim/add_tendencies" constants [] structs [];
    "sim/centre_wind" constants [] structs [];
    "sim/departure" constants [] structs [];
    "sim/semi_lagrangian_linear" constants [] structs [];
    "sim/semi_lagrangian_cubic" constants [] structs [];
    "sim/mac_cormack" constants [] structs [];
    "sim/mass_fixer" constants [] structs [];
    "sim/hole_filler" constants [] structs [];
    "sim/constant_viscosity" constants [] structs [];
    "sim/pressure_source" constants [] structs [];
    "sim/pressure_jacobi" constants [] structs [];
    "sim/pressure_red_black_sor" constants [] structs [];
    "sim/pressure_solve" constants [pressure::WGSL] structs [pressure::Transforms::LAYOUT];
    "sim/project" constants [] structs [];
    "sim/cloud_extinction" constants [cloud_extinction::WGSL] structs [];
    "sim/reduce" constants [readback::WGSL] structs [];
    "sim/vitals" constants [readback::WGSL] structs [];
    "sim/reduce_cloud" constants [readback::WGSL, reduce_cloud::WGSL] structs [];
    "shared/atmosphere" constants [light::atmosphere::WGSL] structs [Air::LAYOUT];
    "shared/phase" constants [] structs [];
    "shared/air_transmittance" constants [light::transmittance_table::WGSL] structs [];
    "shared/sky_radiance" constants [light::multiple_scattering_table::WGSL, light::sky_table::WGSL] structs [];
    "shared/shape" constants [view_twins::occupancy::WGSL, view_twins::shape::WGSL] structs [ShapeGrid::LAYOUT];
    "shared/spline" constants [] structs [];
    "shared/detail" constants [view_twins::detail_noise::WGSL] structs [];
    "shared/extinction" constants [view_twins::march::WGSL] structs [];
    "shared/light_words" constants [light::sun_optical_depth::WGSL] structs [];
    "shared/diffuse_light" constants [light::diffusion::WGSL] structs [ViewFrame::LAYOUT];
    "shared/octaves" constants [light::march_phase::WGSL, light::octave_shares::WGSL] structs [MARCH_PHASE];
    "shared/sun_map" constants [] structs [ViewFrame::LAYOUT];
    "shared/sky_look" constants [light::sky_table::WGSL] structs [ViewFrame::LAYOUT];
    "shared/stars" constants [light::stars::WGSL] structs [];
    "shared/moon" constants [light::moon::WGSL] structs [];
    "light/transmittance_table" constants [light::transmittance_table::WGSL] structs [];
    "light/multiple_scattering_table" constants [light::multiple_scattering_table::WGSL] structs [];
    "light/sky_table" constants [] structs [SkyView::LAYOUT];
    "light/sky_light" constants [light::sky_light::WGSL] structs [SkyLightAsk::LAYOUT, SkyLightValues::LAYOUT];
    "light/sky_visibility" constants [light::sky_visibility::WGSL, view_stages::WGSL] structs [VisibilitySweep::LAYOUT];
    "light/sun_optical_depth" constants [light::sun_optical_depth::WGSL] structs [SunMarch::LAYOUT];
    "light/diffusion" constants [light::diffusion::WGSL, light::between_clouds::WGSL, light::sun_optical_depth::WGSL] structs [DiffusionGrid::LAYOUT];
    "light/octave_balance" constants [light::octave_balance::WGSL, light::sun_optical_depth::WGSL] structs [OctaveBalancing::LAYOUT];
    "light/sun_map" constants [light::sun_map::WGSL] structs [SunMapping::LAYOUT];
    "view/shape" constants [] structs [ShapeGrid::LAYOUT];
    "view/occupancy" constants [view_twins::occupancy::WGSL] structs [ShapeGrid::LAYOUT];
    "view/detail_noise" constants [view_twins::detail_noise::WGSL] structs [];
    "view/haze" constants [light::atmosphere::WGSL] structs [ViewFrame::LAYOUT];
    "view/ground" constants [view_twins::ground::WGSL, light::sky_visibility::WGSL] structs [SkyLightValues::LAYOUT, ViewFrame::LAYOUT];
    "view/tone_map" constants [view_twins::tone_map::WGSL] structs [];
    "view/light_shafts" constants [view_twins::light_shafts::WGSL, light::sun_optical_depth::WGSL] structs [ViewFrame::LAYOUT, SkyLightValues::LAYOUT];
    "view/march" constants [view_twins::march::WGSL, view_twins::cloud_light::WGSL, light::sun_optical_depth::WGSL, light::march_phase::WGSL] structs [ViewFrame::LAYOUT, SkyLightValues::LAYOUT, MARCH_PHASE];
    "view/upsample" constants [view_twins::upsample::WGSL] structs [Sampling::LAYOUT];
    "view/reproject" constants [view_twins::reproject::WGSL, light::atmosphere::WGSL] structs [Recall::LAYOUT];
    "view/impostors" constants [view_twins::impostors::WGSL, view_twins::upsample::WGSL] structs [FarClouds::LAYOUT];
    "view/layers" constants [view_twins::layers::WGSL] structs [Layering::LAYOUT];
}
