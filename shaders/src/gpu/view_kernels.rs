//! The kernels of light and view as a list: what is compiled by whoever draws with them, this GPU device or a browser.

use std::sync::OnceLock;

use super::view_diffusion::DiffusionGrid;
use super::view_impostors::FarClouds;
use super::view_layers::Layering;
use super::view_octave_balance::OctaveBalancing;
use super::view_reproject::Recall;
use super::view_stages::{
    Air, MARCH_PHASE, ShapeGrid, SkyLightAsk, SkyLightValues, SkyView, SunMarch, ViewFrame, VisibilitySweep,
};
use super::view_sun_map::SunMapping;
use super::view_upsample::Sampling;
use super::{Bind, Context, GpuError, Kernel};
use crate::cpu::light::diffusion_grids;
use crate::wgsl::{self, Constant, Layout};
use Bind::{Read, Uniform, Write};

/// A kernel of the view.
#[derive(Clone, Copy, Debug)]
pub struct ViewKernel {
    /// Its name.
    pub name: &'static str,
    /// The module that it is in.
    pub module: &'static str,
    /// Its entry point.
    pub entry: &'static str,
    /// What it binds, in the order of the bindings.
    pub binds: &'static [Bind],
}

const TABLES: &[Bind] = &[Uniform, Uniform, Read, Read, Write];
const VISIBILITY: &[Bind] = &[Uniform, Read, Write, Write];
const SHAPE: &[Bind] = &[Uniform, Read, Write, Write];
const OCCUPANCY: &[Bind] = &[Uniform, Read, Write, Write, Write];
const SUN: &[Bind] = &[Uniform, Uniform, Read, Read, Read, Read, Write, Write];
const DIFFUSION: &[Bind] = &[Uniform, Uniform, Read, Read, Read, Write, Write, Write];
const BALANCE: &[Bind] = &[Uniform, Uniform, Uniform, Read, Read, Read, Write, Write];
const MAP: &[Bind] = &[Uniform, Uniform, Read, Read, Read, Write];
const NOISE: &[Bind] = &[Write, Write, Write];
const MARCH: &[Bind] = &[
    Uniform, Uniform, Uniform, Read, Read, Read, Read, Read, Read, Read, Write, Uniform, Uniform,
];

/// Those of the march and a uniform of their own.
const SAMPLED: &[Bind] = &[
    Uniform, Uniform, Uniform, Read, Read, Read, Read, Read, Read, Read, Write, Uniform, Uniform, Uniform,
];

/// Those and another.
const REPROJECTED: &[Bind] = &[
    Uniform, Uniform, Uniform, Read, Read, Read, Read, Read, Read, Read, Write, Uniform, Uniform, Uniform, Uniform,
];

macro_rules! kernels {
    ($list:ident $what:literal $($name:literal $module:literal $entry:literal $binds:expr;)*) => {
        #[doc = $what]
        pub const $list: &[ViewKernel] = &[$(ViewKernel { name: $name, module: $module, entry: $entry, binds: $binds }),*];
    };
}

kernels! {
    VIEW_KERNELS "The kernels of the view that draw a picture, here or in a browser."
    "transmittance" "light/transmittance_table" "transmittance" &[Uniform, Write];
    "multiple_scattering" "light/multiple_scattering_table" "multiple_scattering" &[Uniform, Read, Write];
    "sky" "light/sky_table" "sky" TABLES;
    "sky_light" "light/sky_light" "sky_light" TABLES;
    "visibility_straight" "light/sky_visibility" "straight" VISIBILITY;
    "visibility_slanted" "light/sky_visibility" "slanted" VISIBILITY;
    "shape_neighbours" "view/shape" "neighbours" SHAPE;
    "shape_points" "view/shape" "points" SHAPE;
    "nearest_x" "view/occupancy" "nearest_x" OCCUPANCY;
    "nearest_xy" "view/occupancy" "nearest_xy" OCCUPANCY;
    "nearest_xyz" "view/occupancy" "nearest_xyz" OCCUPANCY;
    "sun_points" "light/sun_optical_depth" "points" SUN;
    "ground_shadow" "light/sun_optical_depth" "ground_shadow" SUN;
    "sunlit_share" "light/sun_optical_depth" "sunlit_share" SUN;
    "noise_values" "view/detail_noise" "values" NOISE;
    "noise_spread" "view/detail_noise" "spread" NOISE;
    "noise_pack" "view/detail_noise" "pack" NOISE;
    "march" "view/march" "pixels" MARCH;
}

kernels! {
    SERVER_KERNELS "Kernels of the view that this GPU device alone runs, compiled when they are first asked for."
    "samples" "view/upsample" "samples" SAMPLED;
    "upsampled" "view/upsample" "upsampled" SAMPLED;
    "reprojected" "view/reproject" "reprojected" REPROJECTED;
    "far_mark" "view/impostors" "mark" SAMPLED;
    "far_tiles" "view/impostors" "tiles" SAMPLED;
    "impostors" "view/impostors" "impostors" SAMPLED;
    "layers" "view/layers" "layers" SAMPLED;
}

kernels! {
    LIGHT_KERNELS "Kernels of light that few scenes want, here or in a browser: compiled when they are first asked for."
    "sun_map_rays" "light/sun_map" "rays" MAP;
    "sun_map_mean" "light/sun_map" "mean_extinction" MAP;
    "balance_sums" "light/octave_balance" "sums" BALANCE;
    "balance_brought_along_x" "light/octave_balance" "brought_along_x" BALANCE;
    "balance_left_over_brought" "light/octave_balance" "left_over_brought" BALANCE;
    "balance_shares_along_x" "light/octave_balance" "shares_along_x" BALANCE;
    "balance_factors" "light/octave_balance" "factors" BALANCE;
    "diffusion_sources" "light/diffusion" "sources" DIFFUSION;
    "diffusion_conduct" "light/diffusion" "conduct" DIFFUSION;
    "diffusion_join" "light/diffusion" "join" DIFFUSION;
    "diffusion_sweep" "light/diffusion" "sweep" DIFFUSION;
    "diffusion_leave_over" "light/diffusion" "leave_over" DIFFUSION;
    "diffusion_take_up" "light/diffusion" "take_up" DIFFUSION;
    "diffusion_bottom" "light/diffusion" "bottom" DIFFUSION;
    "diffusion_add" "light/diffusion" "add" DIFFUSION;
    "diffusion_meetings" "light/diffusion" "meetings" DIFFUSION;
    "diffusion_between_clouds" "light/diffusion" "between_clouds" DIFFUSION;
    "diffusion_flow" "light/diffusion" "flow" DIFFUSION;
    "diffusion_surface" "light/diffusion" "surface" DIFFUSION;
}

/// A kernel of [`LIGHT_KERNELS`] or [`SERVER_KERNELS`], compiled when it is first asked for.
#[derive(Debug)]
pub struct LateKernel {
    name: &'static str,
    made: OnceLock<Kernel>,
}

impl LateKernel {
    /// Not compiled yet.
    pub const fn new(name: &'static str) -> LateKernel {
        LateKernel {
            name,
            made: OnceLock::new(),
        }
    }
    /// The kernel. Errors: `Shader`, and those of memory and loss.
    pub fn get(&self, context: &Context) -> Result<&Kernel, GpuError> {
        if let Some(made) = self.made.get() {
            return Ok(made);
        }
        let made = compiled(context, self.name)?;
        Ok(self.made.get_or_init(|| made))
    }
}

/// Compiles the kernel of that name. Errors: `Shader`, and those of memory and loss.
pub fn compiled(context: &Context, name: &'static str) -> Result<Kernel, GpuError> {
    let found = view_kernel(name).ok_or_else(|| GpuError::Other {
        message: format!("there is no kernel {name}"),
    })?;
    Kernel::new(context, found.module, found.entry, found.binds)
}

/// Structs that the kernels bind.
pub const VIEW_STRUCTS: &[Layout] = &[
    Air::LAYOUT,
    SkyView::LAYOUT,
    SkyLightAsk::LAYOUT,
    SkyLightValues::LAYOUT,
    VisibilitySweep::LAYOUT,
    ShapeGrid::LAYOUT,
    SunMarch::LAYOUT,
    ViewFrame::LAYOUT,
    MARCH_PHASE,
    Sampling::LAYOUT,
    Recall::LAYOUT,
    FarClouds::LAYOUT,
    Layering::LAYOUT,
    DiffusionGrid::LAYOUT,
    OctaveBalancing::LAYOUT,
    SunMapping::LAYOUT,
];

/// The kernel of that name.
pub fn view_kernel(name: &str) -> Option<&'static ViewKernel> {
    let late = LIGHT_KERNELS.iter().chain(SERVER_KERNELS);
    VIEW_KERNELS.iter().chain(late).find(|k| k.name == name)
}

/// Numbers of the view: the hosts' own, then those that WGSL is given, each once.
pub fn view_constants() -> Vec<Constant> {
    let mut all: Vec<Constant> = [crate::view::WGSL, diffusion_grids::WGSL].concat();
    let used = VIEW_KERNELS
        .iter()
        .chain(LIGHT_KERNELS)
        .flat_map(|k| wgsl::with_used(k.module));
    for constant in used.flat_map(|m| m.constants.iter().copied().flatten()) {
        if !all.iter().any(|known| known.name == constant.name) {
            all.push(*constant);
        }
    }
    all
}

/// A binding of a module, as its WGSL says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Binding {
    /// Its name.
    pub name: String,
    /// Its number.
    pub binding: u32,
    /// How it is bound.
    pub bind: Bind,
    /// The struct of a uniform.
    pub uniform: Option<String>,
}

/// What a module's WGSL says of itself.
#[derive(Clone, Debug, Default)]
pub struct Reflection {
    /// Its bindings, by number.
    pub bindings: Vec<Binding>,
    /// Entry points with the size of their workgroups.
    pub entries: Vec<(String, [u32; 3])>,
}

/// Reads a module's bindings and workgroup sizes out of its whole text. None where that does not parse.
pub fn reflect(source: &str) -> Option<Reflection> {
    use wgpu::naga::{AddressSpace, StorageAccess, front::wgsl::parse_str};
    let module = parse_str(source).ok()?;
    let mut bindings = Vec::new();
    for (_, variable) in module.global_variables.iter() {
        let Some(place) = &variable.binding else {
            continue;
        };
        let (bind, uniform) = match variable.space {
            AddressSpace::Uniform => (Uniform, module.types[variable.ty].name.clone()),
            AddressSpace::Storage { access } if access.contains(StorageAccess::STORE) => (Write, None),
            AddressSpace::Storage { .. } => (Read, None),
            _ => continue,
        };
        bindings.push(Binding {
            name: variable.name.clone()?,
            binding: place.binding,
            bind,
            uniform,
        });
    }
    bindings.sort_by_key(|b| b.binding);
    let entries = module.entry_points.iter();
    Some(Reflection {
        bindings,
        entries: entries.map(|e| (e.name.clone(), e.workgroup_size)).collect(),
    })
}
