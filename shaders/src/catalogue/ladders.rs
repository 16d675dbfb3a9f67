//! The ladders: methods for one job, of which a world runs one each.

use super::Pass;

/// A family of methods for one job, of which a world runs exactly one: its rung.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Ladder {
    /// How the wind carries itself, heat and water.
    Advection,
    /// How the mass flux is freed of divergence.
    Pressure,
    /// What stands for eddies smaller than a cell.
    Subgrid,
    /// What water does beside being carried.
    Microphysics,
    /// How the clear sky by the sun is made.
    Sky,
    /// How pictures learn how much cloud lies towards the sun.
    SunOcclusion,
    /// How sunlight is followed through cloud.
    Scattering,
    /// How droplets turn light.
    Phase,
    /// Where a ray of view looks into cloud.
    ViewSteps,
    /// How many of a picture's pixels are marched through cloud.
    ViewSampling,
}

impl Ladder {
    /// All ladders.
    pub const ALL: &'static [Ladder] = &[
        Ladder::Advection,
        Ladder::Pressure,
        Ladder::Subgrid,
        Ladder::Microphysics,
        Ladder::Sky,
        Ladder::SunOcclusion,
        Ladder::Scattering,
        Ladder::Phase,
        Ladder::ViewSteps,
        Ladder::ViewSampling,
    ];

    /// The name in scenes and plans.
    pub fn name(self) -> &'static str {
        match self {
            Ladder::Advection => "advection",
            Ladder::Pressure => "pressure",
            Ladder::Subgrid => "subgrid",
            Ladder::Microphysics => "microphysics",
            Ladder::Sky => "sky",
            Ladder::SunOcclusion => "sun_occlusion",
            Ladder::Scattering => "scattering",
            Ladder::Phase => "phase",
            Ladder::ViewSteps => "view_steps",
            Ladder::ViewSampling => "view_sampling",
        }
    }

    /// Its rungs, cheapest first.
    pub fn rungs(self) -> impl Iterator<Item = Rung> {
        Rung::ALL.iter().copied().filter(move |r| r.info().ladder == self)
    }
}

/// Where a rung is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Devices {
    /// On the CPU and on the GPU.
    Both,
    /// On the CPU alone, and why.
    CpuOnly(&'static str),
}

/// How a rung of the advection ladder goes through a substep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Advance {
    /// Largest Courant number (sum over the three directions) at which it is claimed, and tested, to be stable.
    pub courant_max: f64,
    /// Stages of a substep: 3 for Runge-Kutta, 1 where one stage spans the whole substep.
    pub stages: usize,
}

/// Everything the catalogue knows of a rung.
#[derive(Debug)]
pub struct RungInfo {
    /// Its ladder.
    pub ladder: Ladder,
    /// Its name in scenes and plans.
    pub name: &'static str,
    /// One line: what it does.
    pub what: &'static str,
    /// What it keeps, and what it does not.
    pub keeps: &'static str,
    /// Where it is there.
    pub devices: Devices,
    /// How it goes through a substep; for advection only.
    pub advance: Option<Advance>,
}

macro_rules! rungs {
    ($($id:ident $ladder:ident $name:literal $devices:expr, $advance:expr, $what:literal keeps $keeps:literal;)*) => {
        /// A method on a ladder; each ladder's stand in order, cheapest first.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Rung { $(#[doc = $what] $id),* }
        impl Rung {
            /// All rungs of all ladders.
            pub const ALL: &'static [Rung] = &[$(Rung::$id),*];
            /// What the catalogue knows of it.
            pub fn info(self) -> &'static RungInfo {
                match self { $(Rung::$id => {
                    const INFO: RungInfo = RungInfo {
                        ladder: Ladder::$ladder, name: $name, what: $what, keeps: $keeps, devices: $devices, advance: $advance,
                    };
                    &INFO
                }),* }
            }
        }
    };
}

/// Where multigrid is there.
const MULTIGRID_DEVICES: Devices = Devices::CpuOnly(
    "on a GPU the direct solver moves 60 bytes a cell in five dispatches and leaves nothing but rounding; a single cycle would move 120 in dozens, most of them too small to fill it",
);
/// Where fitted slabs are there.
const SLAB_DEVICES: Devices = Devices::CpuOnly(
    "fitting marches both ways along the sun from every point near cloud, seconds of a processor for a sun and a tick, and its pictures miss more than diffusion's: a rung for comparison and still pictures",
);
/// One stage spans a substep of any length that trajectories can follow.
const SEMI_LAGRANGIAN: Option<Advance> = Some(Advance {
    courant_max: 50.0,
    stages: 1,
});

rungs! {
    SemiLagrangianLinear Advection "semi_lagrangian_linear" Devices::Both, SEMI_LAGRANGIAN,
        "looks back along the wind, interpolates linearly"
        keeps "extrema, and total water by a fixer; not heat, and it smears what is a few cells wide";
    MacCormack Advection "mac_cormack" Devices::Both, SEMI_LAGRANGIAN,
        "semi-Lagrangian there and back, corrected by half the difference, limited"
        keeps "extrema, and total water by a fixer; not heat";
    SemiLagrangianCubic Advection "semi_lagrangian_cubic" Devices::Both, SEMI_LAGRANGIAN,
        "looks back along the wind, interpolates by cubics, limited"
        keeps "extrema, and total water by a fixer; not heat";
    FluxForm Advection "flux_form" Devices::Both, Some(Advance { courant_max: 1.4, stages: 3 }),
        "fluxes through faces, fifth order and WENO5, three-stage Runge-Kutta"
        keeps "mass-weighted sums of heat and water to rounding; extrema nearly";
    Jacobi Pressure "jacobi" Devices::Both, None,
        "sweeps that each take the mean of the neighbours"
        keeps "some divergence, the more the fewer sweeps";
    RedBlackSor Pressure "red_black_sor" Devices::Both, None,
        "sweeps over the columns of a chessboard's two colours, over-relaxed"
        keeps "some divergence, less than Jacobi at the same cost";
    Multigrid Pressure "multigrid" MULTIGRID_DEVICES, None,
        "V-cycles over grids ever coarser in x and y, columns relaxed as a whole"
        keeps "little divergence, a tenth or less of it a cycle";
    Direct Pressure "direct" Devices::Both, None,
        "FFT in x and y, tridiagonal in z"
        keeps "no divergence but rounding";
    NoSubgrid Subgrid "none" Devices::Both, None,
        "nothing mixes but what the grid resolves"
        keeps "all";
    ConstantViscosity Subgrid "constant_viscosity" Devices::Both, None,
        "one viscosity and one diffusivity everywhere"
        keeps "sums of momentum, heat and water";
    SmagorinskyLilly Subgrid "smagorinsky_lilly" Devices::Both, None,
        "viscosity from strain and stability"
        keeps "sums of momentum, heat and water";
    NoMicrophysics Microphysics "none" Devices::Both, None,
        "no water"
        keeps "all";
    SaturationAdjustment Microphysics "saturation_adjustment" Devices::Both, None,
        "what is above saturation is cloud"
        keeps "water and energy";
    Preetham Sky "preetham" Devices::Both, None,
        "a fitted formula for a sun that is up, computed on the CPU for either device"
        keeps "the zenith's luminance as measured for turbidities 2 to 6; not the ground's light, no height of the viewer, no dusk";
    HosekWilkie Sky "hosek_wilkie" Devices::Both, None,
        "a fitted formula with the ground's albedo for a sun that is up, computed on the CPU for either device"
        keeps "the radiance of traced skies for turbidities 1 to 10; no height of the viewer, no dusk";
    ScatteringTables Sky "scattering_tables" Devices::Both, None,
        "single scattering along rays, higher orders from a table"
        keeps "energy as the air has it, at any height, by any sun; higher orders are even in all directions";
    LightGrid SunOcclusion "light_grid" Devices::Both, None,
        "optical depths towards the sun at the shape's points, once a tick, and what the detail adds near by"
        keeps "edges as fine as the grid, and detail near the camera";
    ExponentialShadowMap SunOcclusion "exponential_shadow_map" Devices::Both, None,
        "where cloud begins on the sun's rays"
        keeps "where cloud begins; one extinction for all";
    BeerShadowMap SunOcclusion "beer_shadow_map" Devices::Both, None,
        "where cloud begins on the sun's rays, its mean extinction, its optical depth"
        keeps "each ray's whole optical depth; not gaps between clouds";
    FourierOpacityMap SunOcclusion "fourier_opacity_map" Devices::Both, None,
        "seven Fourier coefficients of the extinction along the sun's rays"
        keeps "each ray's whole optical depth; edges swing";
    SecondaryMarch SunOcclusion "secondary_march" Devices::Both, None,
        "a march towards the sun from every sample"
        keeps "all that its steps meet, detail included";
    SingleScattering Scattering "single" Devices::Both, None,
        "light is scattered once"
        keeps "energy, in that it loses what is scattered again";
    MultipleForward Scattering "multiple_forward" Devices::Both, None,
        "light of the forward peak goes on, the rest is scattered once"
        keeps "energy, in that it loses what the rest scatters again";
    Octaves Scattering "octaves" Devices::Both, None,
        "octaves of thinner cloud and rounder phase functions, as strong as clouds send out what they take from the beam"
        keeps "energy, to some parts in a hundred, clouds within 2 km together; how it lies within the cloud is a level slab's, too bright on sides away from the sun, too dim on sides towards a low one";
    Diffusion Scattering "diffusion" Devices::Both, None,
        "the beam, what goes about its way, and what diffuses, together as strong as a level slab gives back"
        keeps "energy in level slabs, to some parts in a hundred, and between clouds, as far as their light is even there";
    Slab Scattering "slab" SLAB_DEVICES, None,
        "orders from 2 on as in a level slab fitted to the cloud by one step, from tables of photons followed through slabs"
        keeps "energy: each cloud sends out what it takes from the beam; how it lies within the cloud is a slab's, too bright inside edges";
    SlabCollector Scattering "slab_collector" SLAB_DEVICES, None,
        "orders from 2 on as in a level slab for each group of them, found by iteration: the mean of what lies under the part of the lit side through which almost all of a place's light came"
        keeps "energy: each cloud sends out what it takes from the beam; neighbours may end in different slabs";
    Rayleigh Phase "rayleigh" Devices::Both, None,
        "molecules'"
        keeps "the integral over the sphere, as all";
    HenyeyGreenstein Phase "henyey_greenstein" Devices::Both, None,
        "one lobe"
        keeps "the mean cosine";
    DoubleHenyeyGreenstein Phase "double_henyey_greenstein" Devices::Both, None,
        "two lobes"
        keeps "the mean cosine and a bright back";
    Droplets Phase "droplets" Devices::Both, None,
        "the fit of Jendersie and d'Eon to droplets of one size"
        keeps "the lobes of Mie's function; neither glory nor fogbow";
    Mie Phase "mie" Devices::Both, None,
        "Mie's series over a distribution of droplets, in three colours"
        keeps "glory, fogbow and their colours";
    Ice Phase "ice" Devices::Both, None,
        "rays through hexagonal crystals of ice that lie at random, and diffraction, in three colours"
        keeps "the halos of 22 and 46 degrees and their colours";
    LogarithmicSegments ViewSteps "logarithmic_segments" Devices::Both, None,
        "so many steps from the first cloud to the last place where there can be some, each longer by the same factor"
        keeps "the near edge of the first cloud; farther clouds are met by few steps";
    ByOpticalDepth ViewSteps "by_optical_depth" Devices::Both, None,
        "steps of about the same optical depth"
        keeps "what light does within a step, whatever the cloud; thin wisps behind a thick edge may be stepped over";
    ByDistance ViewSteps "by_distance" Devices::Both, None,
        "steps that grow with the distance from the camera"
        keeps "what a pixel resolves";
    Reproject16 ViewSampling "reproject_16" Devices::Both, None,
        "one pixel in sixteen is marched, the others are looked up in the viewer's last picture"
        keeps "a picture that rests; what changes lags within bounds, and edges soften while the camera moves";
    Reproject4 ViewSampling "reproject_4" Devices::Both, None,
        "one pixel in four is marched, the others are looked up in the viewer's last picture"
        keeps "a picture that rests; what changes lags within bounds, and edges soften while the camera moves";
    Impostors ViewSampling "impostors" Devices::Both, None,
        "what is near is marched, clouds farther than 8 km stand on pictures that are kept while they fit"
        keeps "what is near exactly, what is far to 0.15 degrees; far clouds lag behind the weather by some pictures";
    HalfResolution ViewSampling "half_resolution" Devices::Both, None,
        "one pixel in four is marched, and those between which they disagree"
        keeps "edges, and a quarter of the pixels exactly; relief finer than two pixels is smoothed where it is faint";
    EveryPixel ViewSampling "every_pixel" Devices::Both, None,
        "every pixel is marched"
        keeps "all";
}

impl Rung {
    /// Whether it is written: some pass belongs to it, or it is a ladder's `none`, or one of pictures, which are no passes.
    pub fn is_there(self) -> bool {
        let of_pictures = [
            Ladder::Sky,
            Ladder::SunOcclusion,
            Ladder::Scattering,
            Ladder::Phase,
            Ladder::ViewSteps,
            Ladder::ViewSampling,
        ]
        .contains(&self.info().ladder);
        of_pictures
            || matches!(self, Rung::NoSubgrid | Rung::NoMicrophysics)
            || Pass::ALL.iter().any(|p| p.info().rungs.contains(&self))
    }
}
