//! The catalogue: every field and every pass by name, what each pass reads and writes, and what asks for it.
//!
//! The catalogue's order is the order in which passes run. A plan is a selection from it; a device runs a plan.
//! A pass is a stage applied to named fields; a stage is one file, `cpu/sim/STAGE.rs` and later `wgsl/sim/STAGE.wgsl`.

/// Where on the Arakawa C grid a field's values lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Cell centres.
    Centre,
    /// West faces.
    XFace,
    /// South faces.
    YFace,
    /// Lower faces.
    ZFace,
}

impl Place {
    /// The name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Place::Centre => "centre",
            Place::XFace => "x_face",
            Place::YFace => "y_face",
            Place::ZFace => "z_face",
        }
    }
}

macro_rules! fields {
    ($($(#[$doc:meta])* $id:ident $name:literal $place:ident $unit:literal;)*) => {
        /// A field of the grid: one 32-bit float a cell.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum Field { $($(#[$doc])* $id),* }
        impl Field {
            /// All fields.
            pub const ALL: &'static [Field] = &[$(Field::$id),*];
            /// The name in plans and on the wire.
            pub fn name(self) -> &'static str { match self { $(Field::$id => $name),* } }
            /// Where its values lie.
            pub fn place(self) -> Place { match self { $(Field::$id => Place::$place),* } }
            /// Its unit.
            pub fn unit(self) -> &'static str { match self { $(Field::$id => $unit),* } }
        }
    };
}

fields! {
    /// Wind towards the east.
    VelocityX "velocity_x_at_x_face" XFace "m/s";
    /// Wind towards the north.
    VelocityY "velocity_y_at_y_face" YFace "m/s";
    /// Wind upwards; 0 at the ground, and at the lid, which is not stored.
    VelocityZ "velocity_z_at_z_face" ZFace "m/s";
    /// Liquid-water potential temperature less the scene's constant reference.
    Heat "liquid_water_potential_temperature_excess" Centre "K";
    /// Total water: vapour and cloud water.
    Water "total_water" Centre "kg/kg";
    /// `VelocityX` at the substep's start.
    StartVelocityX "velocity_x_at_x_face_start" XFace "m/s";
    /// `VelocityY` at the substep's start.
    StartVelocityY "velocity_y_at_y_face_start" YFace "m/s";
    /// `VelocityZ` at the substep's start.
    StartVelocityZ "velocity_z_at_z_face_start" ZFace "m/s";
    /// `Heat` at the substep's start.
    StartHeat "liquid_water_potential_temperature_excess_start" Centre "K";
    /// `Water` at the substep's start.
    StartWater "total_water_start" Centre "kg/kg";
    /// `VelocityX` after the Runge-Kutta stage, before it is swapped in.
    NextVelocityX "velocity_x_at_x_face_next" XFace "m/s";
    /// `VelocityY` after the stage.
    NextVelocityY "velocity_y_at_y_face_next" YFace "m/s";
    /// `VelocityZ` after the stage.
    NextVelocityZ "velocity_z_at_z_face_next" ZFace "m/s";
    /// `Heat` after the stage.
    NextHeat "liquid_water_potential_temperature_excess_next" Centre "K";
    /// `Water` after the stage.
    NextWater "total_water_next" Centre "kg/kg";
    /// `VelocityX` at centres, for trajectories.
    CentreVelocityX "velocity_x_at_centre" Centre "m/s";
    /// `VelocityY` at centres.
    CentreVelocityY "velocity_y_at_centre" Centre "m/s";
    /// `VelocityZ` at centres.
    CentreVelocityZ "velocity_z_at_centre" Centre "m/s";
    /// How far west the air was a substep ago, in cells.
    DepartureX "departure_displacement_x" Centre "1";
    /// How far south it was.
    DepartureY "departure_displacement_y" Centre "1";
    /// How far below it was.
    DepartureZ "departure_displacement_z" Centre "1";
    /// How far west the air will be a substep ahead, in cells: negative where it goes east.
    ArrivalX "arrival_displacement_x" Centre "1";
    /// How far south it will be.
    ArrivalY "arrival_displacement_y" Centre "1";
    /// How far below it will be.
    ArrivalZ "arrival_displacement_z" Centre "1";
    /// What is being carried, after the way there and before the way back; in its own place and unit.
    Forward "forward_result" Centre "its own";
    /// The least that what is being carried may become.
    ForwardLow "forward_result_low" Centre "its own";
    /// The most that it may become.
    ForwardHigh "forward_result_high" Centre "its own";
    /// Tendency of `VelocityX` that is held over a substep.
    SlowVelocityX "velocity_x_slow_tendency" XFace "m/s2";
    /// Tendency of `VelocityY` that is held over a substep.
    SlowVelocityY "velocity_y_slow_tendency" YFace "m/s2";
    /// Tendency of `VelocityZ` that is held over a substep.
    SlowVelocityZ "velocity_z_slow_tendency" ZFace "m/s2";
    /// Tendency of `Heat` that is held over a substep.
    SlowHeat "liquid_water_potential_temperature_slow_tendency" Centre "K/s";
    /// Tendency of `Water` that is held over a substep.
    SlowWater "total_water_slow_tendency" Centre "1/s";
    /// Buoyant acceleration.
    Buoyancy "buoyancy" Centre "m/s2";
    /// Cloud water.
    CloudWater "cloud_water" Centre "kg/kg";
    /// Eddy viscosity.
    EddyViscosity "eddy_viscosity" Centre "m2/s";
    /// Perturbation pressure over the reference density.
    Pressure "pressure_over_density" Centre "m2/s2";
    /// Extinction of light by cloud droplets.
    Extinction "extinction" Centre "1/m";
}

impl Field {
    /// The effect without which the field makes no sense, and is never allocated.
    pub fn effect(self) -> Effect {
        use Field::*;
        match self {
            Heat | StartHeat | NextHeat | SlowHeat | Buoyancy => Effect::Heat,
            Water | StartWater | NextWater | SlowWater | CloudWater | Extinction => Effect::Moisture,
            EddyViscosity => Effect::Turbulence,
            _ => Effect::Flow,
        }
    }

    /// The fields of the state: given at the start, not computed from other fields.
    pub const STATE: [Field; 5] = [
        Field::VelocityX,
        Field::VelocityY,
        Field::VelocityZ,
        Field::Heat,
        Field::Water,
    ];

    /// Whether it is part of the state.
    pub fn is_state(self) -> bool {
        Self::STATE.contains(&self)
    }

    /// Where a field of the state is kept over a substep.
    pub fn start(self) -> Option<Field> {
        use Field::*;
        match self {
            VelocityX => Some(StartVelocityX),
            VelocityY => Some(StartVelocityY),
            VelocityZ => Some(StartVelocityZ),
            Heat => Some(StartHeat),
            Water => Some(StartWater),
            _ => None,
        }
    }

    /// Where a field of the state is made by a stage, before it is swapped in.
    pub fn next(self) -> Option<Field> {
        use Field::*;
        match self {
            VelocityX => Some(NextVelocityX),
            VelocityY => Some(NextVelocityY),
            VelocityZ => Some(NextVelocityZ),
            Heat => Some(NextHeat),
            Water => Some(NextWater),
            _ => None,
        }
    }

    /// Whether it keeps the state of a substep's start.
    pub fn is_start(self) -> bool {
        use Field::*;
        matches!(
            self,
            StartVelocityX | StartVelocityY | StartVelocityZ | StartHeat | StartWater
        )
    }
}

/// What a scene can ask for. The names are those of the scene's `effects`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Effect {
    /// Momentum.
    Flow,
    /// Heat and buoyancy.
    Heat,
    /// Water and cloud.
    Moisture,
    /// Smagorinsky-Lilly mixing.
    Turbulence,
    /// Mixing by one viscosity everywhere.
    ConstantViscosity,
    /// A push within a part of the box.
    BodyForce,
    /// Fluxes and drag at the ground.
    Surface,
    /// Coriolis force.
    Coriolis,
    /// Subsidence, radiation, moistening.
    LargeScale,
    /// Damping under the lid.
    Sponge,
    /// Detail noise on the drawn cloud.
    CloudDetail,
    /// Octaves of scattering.
    MultipleScattering,
    /// Shadows of clouds on the ground.
    CloudShadow,
    /// Shadows of clouds in the air.
    LightShafts,
    /// Haze.
    AerialPerspective,
    /// The moon and its light.
    Moon,
    /// Stars.
    Stars,
}

impl Effect {
    /// The name in a scene.
    pub fn name(self) -> &'static str {
        match self {
            Effect::Flow => "flow",
            Effect::Heat => "heat",
            Effect::Moisture => "moisture",
            Effect::Turbulence => "turbulence",
            Effect::ConstantViscosity => "constant_viscosity",
            Effect::BodyForce => "body_force",
            Effect::Surface => "surface",
            Effect::Coriolis => "coriolis",
            Effect::LargeScale => "large_scale",
            Effect::Sponge => "sponge",
            Effect::CloudDetail => "cloud_detail",
            Effect::MultipleScattering => "multiple_scattering",
            Effect::CloudShadow => "cloud_shadow",
            Effect::LightShafts => "light_shafts",
            Effect::AerialPerspective => "aerial_perspective",
            Effect::Moon => "moon",
            Effect::Stars => "stars",
        }
    }
}

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
/// Where shadow maps are there.
const MAP_DEVICES: Devices = Devices::CpuOnly(
    "the march binds all eight storage buffers that WebGPU grants, and the light grid is there anyway for what is seen of sky and ground",
);
/// Where diffusion is there.
const DIFFUSION_DEVICES: Devices = Devices::CpuOnly(
    "conjugate gradients join sums over the whole grid twice a step, some fifty steps for a sun and a tick: on a GPU each would wait for the one before",
);
/// Where reprojection is there.
const REPROJECT_DEVICES: Devices = Devices::CpuOnly(
    "each viewer's last picture would have to stay in the GPU's memory beside the worlds, 40 bytes a pixel, and there half resolution leaves little to gain: it was not written",
);
/// Where fitted slabs are there.
const SLAB_DEVICES: Devices = Devices::CpuOnly(
    "the march binds all eight storage buffers that WebGPU grants; slabs and their tables would be two more",
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
        "optical depths towards the sun at the shape's points, once a tick, and two finer steps"
        keeps "edges as fine as the grid, and detail near the camera";
    ExponentialShadowMap SunOcclusion "exponential_shadow_map" MAP_DEVICES, None,
        "where cloud begins on the sun's rays"
        keeps "where cloud begins; one extinction for all";
    BeerShadowMap SunOcclusion "beer_shadow_map" MAP_DEVICES, None,
        "where cloud begins on the sun's rays, its mean extinction, its optical depth"
        keeps "each ray's whole optical depth; not gaps between clouds";
    FourierOpacityMap SunOcclusion "fourier_opacity_map" MAP_DEVICES, None,
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
        "octaves of thinner cloud and rounder phase functions"
        keeps "no energy: thin cloud gets too much light, thick cloud too little";
    Diffusion Scattering "diffusion" DIFFUSION_DEVICES, None,
        "the beam, what goes about its way, and what diffuses"
        keeps "energy, to the solver's bound";
    Slab Scattering "slab" SLAB_DEVICES, None,
        "orders from 2 on as in a level slab fitted to the cloud by one step, from tables of photons followed through slabs"
        keeps "energy in slabs, to the tables' steps; not in clouds that end sideways";
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
    Reproject16 ViewSampling "reproject_16" REPROJECT_DEVICES, None,
        "one pixel in sixteen is marched, the others are looked up in the viewer's last picture"
        keeps "a picture that rests; what changes lags within bounds, and edges soften while the camera moves";
    Reproject4 ViewSampling "reproject_4" REPROJECT_DEVICES, None,
        "one pixel in four is marched, the others are looked up in the viewer's last picture"
        keeps "a picture that rests; what changes lags within bounds, and edges soften while the camera moves";
    Impostors ViewSampling "impostors" REPROJECT_DEVICES, None,
        "what is near is marched, clouds farther than 8 km stand on pictures that are kept while they fit"
        keeps "what is near exactly, what is far to 0.15 degrees; far clouds lag behind the weather by some pictures";
    HalfResolution ViewSampling "half_resolution" Devices::Both, None,
        "one pixel in four is marched, and those between which they disagree"
        keeps "edges, and a quarter of the pixels exactly; relief finer than two pixels is smoothed where it is faint";
    EveryPixel ViewSampling "every_pixel" Devices::Both, None,
        "every pixel is marched"
        keeps "all";
}

impl Pass {
    /// Whether it is there only for passes that hold tendencies over a substep, and is left out with them.
    pub fn serves_held_tendencies(self) -> bool {
        matches!(self, Pass::SlowClear | Pass::AddTendencies)
    }
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

/// When a pass runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Once a substep, before its Runge-Kutta stages.
    Step,
    /// In each of a substep's stages: three of Runge-Kutta, or one that spans the substep.
    Stage,
    /// Once a tick, at its end: for the snapshot.
    Publish,
}

impl Phase {
    /// The name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Phase::Step => "step",
            Phase::Stage => "stage",
            Phase::Publish => "publish",
        }
    }
}

/// Everything the catalogue knows of a pass.
#[derive(Debug)]
pub struct PassInfo {
    /// Its name, `stage` or `stage:field`.
    pub name: &'static str,
    /// When it runs.
    pub phase: Phase,
    /// The effects that must all be present for it to run; the first is the reason that is shown.
    pub needs: &'static [Effect],
    /// An effect that must be absent: with it another pass does the same work and more.
    pub unless: Option<Effect>,
    /// The rungs it belongs to: of each ladder that is named here, one of the named rungs must be chosen.
    pub rungs: &'static [Rung],
    /// Fields it reads; those that the plan doesn't allocate are skipped.
    pub reads: &'static [Field],
    /// Fields it writes.
    pub writes: &'static [Field],
    /// Largest difference between the devices, over the root mean square of what is written, and why it is that large.
    pub tolerance: (f64, &'static str),
    /// One line: what it does.
    pub what: &'static str,
}

const SAME: (f64, &str) = (
    1e-6,
    "the same operations, in which a device may join multiplications and additions",
);
const DIFFERENCES: (f64, &str) = (
    3e-6,
    "differences of nearly equal numbers are divided by small distances: rounding of the fields counts for more",
);
const WENO: (f64, &str) = (
    1e-5,
    "weights are ratios of fourth powers of differences, so that rounding shifts them; the face value hardly moves",
);
const POWERS: (f64, &str) = (
    6e-5,
    "exponential and powers are good to a few units in the last place on a GPU; condensed water is a difference",
);
const SPECTRAL: (f64, &str) = (5e-5, "single precision in the GPU's transforms, double in the CPU's");

const INTERPOLATED: (f64, &str) = (
    3e-6,
    "means of eight values or 64, weighed by fractions of a cell, summed in another order",
);
const SUMMED: (f64, &str) = (
    1e-6,
    "sums over levels in single precision, of what advection changed, and the rounding of the one factor",
);
const SWEPT: (f64, &str) = (
    1e-5,
    "the implicit scheme divides by the substep what its sweeps changed, a small difference of large numbers",
);
const ITERATED: (f64, &str) = (
    1e-5,
    "means over levels are summed in single precision and another order; sweeps carry rounding on and damp it",
);

macro_rules! passes {
    ($($id:ident $name:literal $phase:ident needs [$($need:ident),*] unless $unless:expr, $(rungs [$($rung:ident),*],)? reads [$($read:ident),*] writes [$($write:ident),*] within $tolerance:ident $what:literal;)*) => {
        /// A pass: a stage applied to named fields, in the order in which passes run.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum Pass { $(#[doc = $what] $id),* }
        impl Pass {
            /// All passes, in order.
            pub const ALL: &'static [Pass] = &[$(Pass::$id),*];
            /// What the catalogue knows of it.
            pub fn info(self) -> &'static PassInfo {
                match self { $(Pass::$id => {
                    const INFO: PassInfo = PassInfo {
                        name: $name, phase: Phase::$phase, needs: &[$(Effect::$need),*], unless: $unless,
                        rungs: &[$($(Rung::$rung),*)?],
                        reads: &[$(Field::$read),*], writes: &[$(Field::$write),*],
                        tolerance: $tolerance, what: $what,
                    };
                    &INFO
                }),* }
            }
        }
    };
}

passes! {
    SlowClear "slow_clear" Step needs [Flow] unless None,
        reads [] writes [SlowVelocityX, SlowVelocityY, SlowVelocityZ, SlowHeat, SlowWater] within SAME "sets the tendencies that are held over a substep to 0";
    StepSaturation "saturation_adjustment:step" Step needs [Turbulence, Moisture] unless None, rungs [SmagorinskyLilly],
        reads [Heat, Water] writes [Buoyancy, CloudWater] within POWERS "cloud water and buoyancy for the eddy viscosity's stability";
    StartSaturation "saturation_adjustment:start" Step needs [Moisture] unless Some(Effect::Turbulence), rungs [SaturationAdjustment, SemiLagrangianLinear, MacCormack, SemiLagrangianCubic],
        reads [Heat, Water] writes [Buoyancy, CloudWater] within POWERS "cloud water of the substep's start, for what cloudy air loses as it rises";
    StepDryBuoyancy "dry_buoyancy:step" Step needs [Turbulence, Heat] unless Some(Effect::Moisture), rungs [SmagorinskyLilly],
        reads [Heat] writes [Buoyancy] within SAME "buoyancy for the eddy viscosity's stability";
    EddyViscosity "eddy_viscosity" Step needs [Turbulence] unless None, rungs [SmagorinskyLilly],
        reads [VelocityX, VelocityY, VelocityZ, Buoyancy] writes [EddyViscosity] within DIFFERENCES "Smagorinsky-Lilly viscosity from strain and stability";
    DiffuseMomentum "diffuse_momentum" Step needs [Turbulence] unless None, rungs [SmagorinskyLilly],
        reads [VelocityX, VelocityY, VelocityZ, EddyViscosity] writes [SlowVelocityX, SlowVelocityY, SlowVelocityZ] within DIFFERENCES "mixing of momentum by eddies smaller than a cell";
    DiffuseHeat "diffuse_scalar:heat" Step needs [Turbulence, Heat] unless None, rungs [SmagorinskyLilly],
        reads [Heat, EddyViscosity] writes [SlowHeat] within DIFFERENCES "mixing of heat by eddies smaller than a cell";
    DiffuseWater "diffuse_scalar:water" Step needs [Turbulence, Moisture] unless None, rungs [SmagorinskyLilly],
        reads [Water, EddyViscosity] writes [SlowWater] within DIFFERENCES "mixing of water by eddies smaller than a cell";
    ConstantViscosityMomentum "constant_viscosity:momentum" Step needs [ConstantViscosity] unless None, rungs [ConstantViscosity],
        reads [VelocityX, VelocityY, VelocityZ] writes [SlowVelocityX, SlowVelocityY, SlowVelocityZ] within SWEPT "mixing of momentum by one viscosity";
    ConstantViscosityHeat "constant_viscosity:heat" Step needs [ConstantViscosity, Heat] unless None, rungs [ConstantViscosity],
        reads [Heat] writes [SlowHeat] within SWEPT "mixing of heat by one diffusivity";
    ConstantViscosityWater "constant_viscosity:water" Step needs [ConstantViscosity, Moisture] unless None, rungs [ConstantViscosity],
        reads [Water] writes [SlowWater] within SWEPT "mixing of water by one diffusivity";
    BodyForce "body_force" Step needs [BodyForce] unless None,
        reads [VelocityX, VelocityY, VelocityZ] writes [SlowVelocityX, SlowVelocityY, SlowVelocityZ] within SAME "a push within a part of the box, as of a fan";
    SurfaceFlux "surface_flux" Step needs [Surface] unless None,
        reads [VelocityX, VelocityY] writes [SlowVelocityX, SlowVelocityY, SlowHeat, SlowWater] within SAME "heat and moisture from the ground, and its drag, into the lowest level";
    Coriolis "coriolis" Step needs [Coriolis] unless None,
        reads [VelocityX, VelocityY] writes [SlowVelocityX, SlowVelocityY] within SAME "turns the wind's departure from the geostrophic one";
    LargeScaleHeat "large_scale:heat" Step needs [LargeScale, Heat] unless None,
        reads [Heat] writes [SlowHeat] within SAME "subsidence and radiation";
    LargeScaleWater "large_scale:water" Step needs [LargeScale, Moisture] unless None,
        reads [Water] writes [SlowWater] within SAME "subsidence and moistening";
    LargeScaleMomentum "large_scale:momentum" Step needs [LargeScale, Flow] unless None,
        reads [VelocityX, VelocityY] writes [SlowVelocityX, SlowVelocityY] within SAME "subsidence of momentum";
    Sponge "sponge" Step needs [Sponge] unless None,
        reads [VelocityX, VelocityY, VelocityZ, Heat] writes [SlowVelocityX, SlowVelocityY, SlowVelocityZ, SlowHeat] within SAME "damps waves under the lid";
    AddTendencies "add_tendencies" Step needs [Flow] unless None, rungs [SemiLagrangianLinear, MacCormack, SemiLagrangianCubic],
        reads [VelocityX, VelocityY, VelocityZ, Heat, Water] writes [SlowVelocityX, SlowVelocityY, SlowVelocityZ, SlowHeat, SlowWater] within SAME "adds the held tendencies to the state, to be carried together";
    Saturation "saturation_adjustment" Stage needs [Moisture] unless None, rungs [SaturationAdjustment, FluxForm],
        reads [Heat, Water] writes [Buoyancy, CloudWater] within POWERS "condenses what is above saturation; buoyancy from virtual potential temperature with loading";
    DryBuoyancy "dry_buoyancy" Stage needs [Heat] unless Some(Effect::Moisture), rungs [FluxForm],
        reads [Heat] writes [Buoyancy] within SAME "buoyancy from potential temperature";
    AdvectHeat "advect_scalar:heat" Stage needs [Heat] unless None, rungs [FluxForm],
        reads [VelocityX, VelocityY, VelocityZ, Heat, StartHeat, SlowHeat] writes [NextHeat] within WENO "carries heat, flux form, WENO5";
    AdvectWater "advect_scalar:water" Stage needs [Moisture] unless None, rungs [FluxForm],
        reads [VelocityX, VelocityY, VelocityZ, Water, StartWater, SlowWater] writes [NextWater] within WENO "carries water, flux form, WENO5";
    AdvectMomentum "advect_momentum" Stage needs [Flow] unless None, rungs [FluxForm],
        reads [VelocityX, VelocityY, VelocityZ, StartVelocityX, StartVelocityY, StartVelocityZ, SlowVelocityX, SlowVelocityY, SlowVelocityZ, Buoyancy]
        writes [NextVelocityX, NextVelocityY, NextVelocityZ] within DIFFERENCES "carries momentum, flux form, fifth-order upwind, and adds buoyancy";
    CentreWind "centre_wind" Stage needs [Flow] unless None, rungs [SemiLagrangianLinear, MacCormack, SemiLagrangianCubic],
        reads [VelocityX, VelocityY, VelocityZ] writes [CentreVelocityX, CentreVelocityY, CentreVelocityZ] within SAME "the wind at centres, for trajectories";
    Departure "departure" Stage needs [Flow] unless None, rungs [SemiLagrangianLinear, MacCormack, SemiLagrangianCubic],
        reads [CentreVelocityX, CentreVelocityY, CentreVelocityZ] writes [DepartureX, DepartureY, DepartureZ] within INTERPOLATED "where the air came from";
    Arrival "departure:ahead" Stage needs [Flow] unless None, rungs [MacCormack],
        reads [CentreVelocityX, CentreVelocityY, CentreVelocityZ] writes [ArrivalX, ArrivalY, ArrivalZ] within INTERPOLATED "where the air will go";
    LinearHeat "semi_lagrangian_linear:heat" Stage needs [Heat] unless None, rungs [SemiLagrangianLinear],
        reads [Heat, SlowHeat, DepartureX, DepartureY, DepartureZ] writes [NextHeat] within INTERPOLATED "carries heat, linear interpolation";
    MacCormackHeat "mac_cormack:heat" Stage needs [Heat] unless None, rungs [MacCormack],
        reads [Heat, SlowHeat, DepartureX, DepartureY, DepartureZ, ArrivalX, ArrivalY, ArrivalZ] writes [Forward, ForwardLow, ForwardHigh, NextHeat] within INTERPOLATED "carries heat, there and back";
    CubicHeat "semi_lagrangian_cubic:heat" Stage needs [Heat] unless None, rungs [SemiLagrangianCubic],
        reads [Heat, SlowHeat, DepartureX, DepartureY, DepartureZ] writes [NextHeat] within INTERPOLATED "carries heat, cubic interpolation";
    LinearWater "semi_lagrangian_linear:water" Stage needs [Moisture] unless None, rungs [SemiLagrangianLinear],
        reads [Water, SlowWater, DepartureX, DepartureY, DepartureZ] writes [NextWater] within INTERPOLATED "carries water, linear interpolation";
    MacCormackWater "mac_cormack:water" Stage needs [Moisture] unless None, rungs [MacCormack],
        reads [Water, SlowWater, DepartureX, DepartureY, DepartureZ, ArrivalX, ArrivalY, ArrivalZ] writes [Forward, ForwardLow, ForwardHigh, NextWater] within INTERPOLATED "carries water, there and back";
    CubicWater "semi_lagrangian_cubic:water" Stage needs [Moisture] unless None, rungs [SemiLagrangianCubic],
        reads [Water, SlowWater, DepartureX, DepartureY, DepartureZ] writes [NextWater] within INTERPOLATED "carries water, cubic interpolation";
    FixWater "mass_fixer:water" Stage needs [Moisture] unless None, rungs [SemiLagrangianLinear, MacCormack, SemiLagrangianCubic],
        reads [Water, SlowWater] writes [NextWater] within SUMMED "gives total water its sum again, in proportion to what is there";
    FillWater "hole_filler:water" Stage needs [Moisture, Flow] unless None,
        reads [] writes [NextWater] within SAME "takes what total water is short of below zero from its own column; once a substep";
    CloudyAscent "cloudy_ascent" Stage needs [Moisture] unless None, rungs [SaturationAdjustment],
        reads [VelocityZ, CloudWater] writes [NextHeat] within SAME "what liquid-water potential temperature loses as cloudy air rises; after it has been carried";
    SaturationNext "saturation_adjustment:next" Stage needs [Moisture] unless None, rungs [SaturationAdjustment, SemiLagrangianLinear, MacCormack, SemiLagrangianCubic],
        reads [NextHeat, NextWater] writes [Buoyancy, CloudWater] within POWERS "condenses what is above saturation at the substep's end, for the buoyancy";
    DryBuoyancyNext "dry_buoyancy:next" Stage needs [Heat] unless Some(Effect::Moisture), rungs [SemiLagrangianLinear, MacCormack, SemiLagrangianCubic],
        reads [NextHeat] writes [Buoyancy] within SAME "buoyancy from potential temperature at the substep's end";
    LinearVelocityX "semi_lagrangian_linear:velocity_x" Stage needs [Flow] unless None, rungs [SemiLagrangianLinear],
        reads [VelocityX, SlowVelocityX, DepartureX, DepartureY, DepartureZ] writes [NextVelocityX] within INTERPOLATED "carries velocity x, linear interpolation";
    MacCormackVelocityX "mac_cormack:velocity_x" Stage needs [Flow] unless None, rungs [MacCormack],
        reads [VelocityX, SlowVelocityX, DepartureX, DepartureY, DepartureZ, ArrivalX, ArrivalY, ArrivalZ] writes [Forward, ForwardLow, ForwardHigh, NextVelocityX] within INTERPOLATED "carries velocity x, there and back";
    CubicVelocityX "semi_lagrangian_cubic:velocity_x" Stage needs [Flow] unless None, rungs [SemiLagrangianCubic],
        reads [VelocityX, SlowVelocityX, DepartureX, DepartureY, DepartureZ] writes [NextVelocityX] within INTERPOLATED "carries velocity x, cubic interpolation";
    LinearVelocityY "semi_lagrangian_linear:velocity_y" Stage needs [Flow] unless None, rungs [SemiLagrangianLinear],
        reads [VelocityY, SlowVelocityY, DepartureX, DepartureY, DepartureZ] writes [NextVelocityY] within INTERPOLATED "carries velocity y, linear interpolation";
    MacCormackVelocityY "mac_cormack:velocity_y" Stage needs [Flow] unless None, rungs [MacCormack],
        reads [VelocityY, SlowVelocityY, DepartureX, DepartureY, DepartureZ, ArrivalX, ArrivalY, ArrivalZ] writes [Forward, ForwardLow, ForwardHigh, NextVelocityY] within INTERPOLATED "carries velocity y, there and back";
    CubicVelocityY "semi_lagrangian_cubic:velocity_y" Stage needs [Flow] unless None, rungs [SemiLagrangianCubic],
        reads [VelocityY, SlowVelocityY, DepartureX, DepartureY, DepartureZ] writes [NextVelocityY] within INTERPOLATED "carries velocity y, cubic interpolation";
    LinearVelocityZ "semi_lagrangian_linear:velocity_z" Stage needs [Flow] unless None, rungs [SemiLagrangianLinear],
        reads [VelocityZ, SlowVelocityZ, DepartureX, DepartureY, DepartureZ, Buoyancy] writes [NextVelocityZ] within INTERPOLATED "carries velocity z, linear interpolation";
    MacCormackVelocityZ "mac_cormack:velocity_z" Stage needs [Flow] unless None, rungs [MacCormack],
        reads [VelocityZ, SlowVelocityZ, DepartureX, DepartureY, DepartureZ, ArrivalX, ArrivalY, ArrivalZ, Buoyancy] writes [Forward, ForwardLow, ForwardHigh, NextVelocityZ] within INTERPOLATED "carries velocity z, there and back";
    CubicVelocityZ "semi_lagrangian_cubic:velocity_z" Stage needs [Flow] unless None, rungs [SemiLagrangianCubic],
        reads [VelocityZ, SlowVelocityZ, DepartureX, DepartureY, DepartureZ, Buoyancy] writes [NextVelocityZ] within INTERPOLATED "carries velocity z, cubic interpolation";
    PressureSolve "pressure_solve" Stage needs [Flow] unless None, rungs [Direct],
        reads [NextVelocityX, NextVelocityY, NextVelocityZ] writes [Pressure] within SPECTRAL "the pressure that frees the mass flux of divergence: FFT in x, y and tridiagonal in z";
    PressureJacobi "pressure_jacobi" Stage needs [Flow] unless None, rungs [Jacobi],
        reads [NextVelocityX, NextVelocityY, NextVelocityZ, Pressure] writes [Pressure] within ITERATED "takes divergence from the mass flux: sweeps of Jacobi's method from the last pressure";
    PressureRedBlackSor "pressure_red_black_sor" Stage needs [Flow] unless None, rungs [RedBlackSor],
        reads [NextVelocityX, NextVelocityY, NextVelocityZ, Pressure] writes [Pressure] within ITERATED "takes divergence from the mass flux: columns over-relaxed in two colours, from the last pressure";
    PressureMultigrid "pressure_multigrid" Stage needs [Flow] unless None, rungs [Multigrid],
        reads [NextVelocityX, NextVelocityY, NextVelocityZ, Pressure] writes [Pressure] within ITERATED "takes divergence from the mass flux: V-cycles over grids coarser in x and y, from the last pressure";
    Project "project" Stage needs [Flow] unless None,
        reads [Pressure] writes [NextVelocityX, NextVelocityY, NextVelocityZ] within SAME "subtracts the pressure gradient; the stage's result becomes the state";
    PublishSaturation "saturation_adjustment:publish" Publish needs [Moisture] unless None, rungs [SaturationAdjustment],
        reads [Heat, Water] writes [Buoyancy, CloudWater] within POWERS "cloud water of the tick's last state";
    CloudExtinction "cloud_extinction" Publish needs [Moisture] unless None,
        reads [CloudWater] writes [Extinction] within POWERS "what light meets: extinction from cloud water and droplet number";
}

impl Pass {
    /// Whether it adds to what it writes, so that its output is an input too.
    pub fn changes(self) -> bool {
        let held = |f: &Field| {
            use Field::*;
            matches!(f, SlowVelocityX | SlowVelocityY | SlowVelocityZ | SlowHeat | SlowWater)
        };
        let adds = self != Pass::SlowClear && self.info().writes.iter().any(held);
        let starts_from_last = matches!(
            self,
            Pass::PressureJacobi | Pass::PressureRedBlackSor | Pass::PressureMultigrid
        );
        adds || starts_from_last
            || matches!(
                self,
                Pass::Project | Pass::CloudyAscent | Pass::FixWater | Pass::FillWater
            )
    }

    /// Whether it runs in a substep's last stage alone, whose result is the state that stays.
    pub fn ends_substep(self) -> bool {
        self == Pass::FillWater
    }

    /// Bytes a cell that it must move where `planned` fields are held: each value once, neighbours from cache. A pass of the lowest level alone moves
    /// nothing beside a box of many.
    pub fn bytes_per_cell(self, planned: &[Field]) -> u64 {
        let count = |fields: &[Field]| fields.iter().filter(|f| planned.contains(f)).count() as u64;
        let info = self.info();
        match self {
            Pass::SurfaceFlux => 0,
            // Velocities and pressure once; the half spectrum, 4 bytes a cell, written and read twice, its pivots, 2 bytes, twice.
            Pass::PressureSolve => 16 + 16 + 4,
            // With a single sweep or cycle; each further one moves 12, 16 or 80 more.
            Pass::PressureJacobi => 20 + 12 + 8,
            Pass::PressureRedBlackSor => 40 + 16,
            Pass::PressureMultigrid => 40 + 80,
            // It looks; what is negative is rare.
            Pass::FillWater => 4,
            _ => 4 * count(info.reads) + if self.changes() { 8 } else { 4 } * count(info.writes),
        }
    }
}

/// A stage of light or view: it runs for a picture, on a published cloud, outside the tick, and writes no field of the state.
#[derive(Debug)]
pub struct ViewStage {
    /// The stage's name; its file is `cpu/light/NAME.rs` or `cpu/view/NAME.rs`, and `wgsl/light/NAME.wgsl` or `wgsl/view/NAME.wgsl` (a part of a
    /// stage stands behind a colon).
    pub name: &'static str,
    /// The effects that must all be present; none: every picture needs it.
    pub needs: &'static [Effect],
    /// The rungs of which one must be chosen; none: it runs whatever is.
    pub rungs: &'static [Rung],
    /// What it reads.
    pub reads: &'static [&'static str],
    /// What it writes.
    pub writes: &'static [&'static str],
    /// One line: what it does.
    pub what: &'static str,
    /// How far its results on the two devices may be apart.
    pub tolerance: Tolerance,
}

/// How far a stage's results on two devices may be apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// The largest difference of two values.
    pub within: Within,
    /// Share of the values that may be farther apart.
    pub outside: f32,
    /// Why so much, and no more.
    pub why: &'static str,
}

/// A bound on a difference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Within {
    /// A share of the value and of a hundredth of the largest value.
    Relative(f32),
    /// In the result's own unit; packed numbers in steps, pictures in levels of 8 bits.
    Absolute(f32),
}

/// Pictures: the same samples of the same field, summed in the same order.
const PICTURE: Tolerance = Tolerance {
    within: Within::Absolute(1.0),
    outside: 0.001,
    why: "levels are rounded down, so the last bit of a sum can cost one; where it moves a ray over a cell's border of the occupancy, the \
          samples behind shift by a step and the pixel by some levels: one in thousands",
};

/// The stages of light and view, in order.
pub const VIEW_STAGES: &[ViewStage] = &[
    ViewStage {
        name: "transmittance_table",
        needs: &[],
        rungs: &[],
        reads: &["atmosphere"],
        writes: &["air_transmittance"],
        what: "sunlight through clear air, by height and direction",
        tolerance: Tolerance {
            within: Within::Relative(1e-4),
            outside: 0.0,
            why: "heights and distances are 32-bit floats here and 64-bit ones in the twin: 1e-7 of the Earth's radius is half a metre, 1e-4 of a scale height",
        },
    },
    ViewStage {
        name: "multiple_scattering_table",
        needs: &[],
        rungs: &[],
        reads: &["atmosphere", "air_transmittance"],
        writes: &["air_multiple_scattering"],
        what: "light scattered more than once in clear air",
        tolerance: Tolerance {
            within: Within::Relative(3e-4),
            outside: 0.0,
            why: "sums over 32 directions in another order, of lookups at heights that differ by half a metre",
        },
    },
    ViewStage {
        name: "sky_table",
        needs: &[],
        rungs: &[],
        reads: &[
            "atmosphere",
            "air_transmittance",
            "air_multiple_scattering",
            "sun_direction",
        ],
        writes: &["sky_radiance"],
        what: "the clear sky as seen from the camera",
        tolerance: Tolerance {
            within: Within::Relative(4e-4),
            outside: 0.0,
            why: "28 steps, each looking up two tables at heights that differ by half a metre",
        },
    },
    ViewStage {
        name: "analytic_sky",
        needs: &[],
        rungs: &[Rung::Preetham, Rung::HosekWilkie],
        reads: &["atmosphere", "sun_direction"],
        writes: &["sky_radiance", "sun_and_sky_on_cloud_and_ground"],
        what: "the sky by a formula in place of the tables', where the scene's methods name one (within sky_table and sky_light)",
        tolerance: Tolerance {
            within: Within::Absolute(1.0),
            outside: 0.001,
            why: "computed on the CPU for both devices; judged by pictures",
        },
    },
    ViewStage {
        name: "sky_light",
        needs: &[],
        rungs: &[],
        reads: &["air_transmittance", "air_multiple_scattering", "sun_direction"],
        writes: &["sun_and_sky_on_cloud_and_ground"],
        what: "what sun, sky and ground give to clouds and land",
        tolerance: Tolerance {
            within: Within::Relative(1e-4),
            outside: 0.0,
            why: "a mean over rays as those of the sky table",
        },
    },
    ViewStage {
        name: "shape",
        needs: &[Effect::Moisture],
        rungs: &[],
        reads: &["extinction"],
        writes: &["cloud_cover_and_amplitude"],
        what: "the cloud as a smooth field, twice as fine as the grid",
        tolerance: Tolerance {
            within: Within::Absolute(1.0),
            outside: 0.0,
            why: "16-bit steps are rounded down, so the last bit of a sum can cost one",
        },
    },
    ViewStage {
        name: "occupancy",
        needs: &[Effect::Moisture],
        rungs: &[],
        reads: &["cloud_cover_and_amplitude"],
        writes: &["empty_distance"],
        what: "how far a ray may leap over empty air (within shape)",
        tolerance: Tolerance {
            within: Within::Absolute(0.0),
            outside: 0.0,
            why: "small whole numbers of metres, squared: exact in both",
        },
    },
    ViewStage {
        name: "sky_visibility",
        needs: &[Effect::Moisture],
        rungs: &[],
        reads: &["extinction"],
        writes: &["sky_and_ground_visibility"],
        what: "how much light of sky and ground reaches the inside of clouds",
        tolerance: Tolerance {
            within: Within::Absolute(1e-6),
            outside: 0.0,
            why: "the same sums in the same order, fused or not",
        },
    },
    ViewStage {
        name: "sun_optical_depth",
        needs: &[Effect::Moisture],
        rungs: &[],
        reads: &[
            "cloud_cover_and_amplitude",
            "sky_and_ground_visibility",
            "sun_direction",
        ],
        writes: &["sun_optical_depth", "ground_shadow"],
        what: "how much cloud lies towards the sun",
        tolerance: Tolerance {
            within: Within::Absolute(2.0),
            outside: 0.0001,
            why: "16-bit steps of a sum of some 50 samples; a sample on a cell's border of the occupancy may be leapt over on one side",
        },
    },
    ViewStage {
        name: "march_phase",
        needs: &[Effect::Moisture],
        rungs: &[],
        reads: &[],
        writes: &["phase_of_single_scattering_and_octaves"],
        what: "how droplets turn light, as the march looks it up",
        tolerance: Tolerance {
            within: Within::Absolute(1.0),
            outside: 0.001,
            why: "computed on the CPU for both devices; judged by pictures",
        },
    },
    ViewStage {
        name: "sun_map",
        needs: &[Effect::Moisture],
        rungs: &[Rung::ExponentialShadowMap, Rung::BeerShadowMap, Rung::FourierOpacityMap],
        reads: &["cloud_cover_and_amplitude", "detail_tile", "sun_direction"],
        writes: &["sun_map"],
        what: "what the sun's rays meet, a map as seen from the sun",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "diffusion",
        needs: &[Effect::Moisture],
        rungs: &[Rung::Diffusion],
        reads: &["cloud_cover_and_amplitude", "sun_optical_depth"],
        writes: &["diffuse_fluence"],
        what: "sunlight that cloud has scattered so often that it goes all ways",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "detail_noise",
        needs: &[Effect::CloudDetail],
        rungs: &[],
        reads: &[],
        writes: &["detail_tile"],
        what: "the pattern that carves edges finer than a cell",
        tolerance: Tolerance {
            within: Within::Absolute(1.0),
            outside: 0.0,
            why: "bytes are rounded, so the last bit of a sum can cost one",
        },
    },
    ViewStage {
        name: "march:octaves",
        needs: &[Effect::MultipleScattering],
        rungs: &[],
        reads: &["sun_optical_depth"],
        writes: &["scattered_octaves"],
        what: "light scattered more than once inside cloud (within march)",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "march",
        needs: &[],
        rungs: &[],
        reads: &[
            "sky_radiance",
            "sun_and_sky_on_cloud_and_ground",
            "cloud_cover_and_amplitude",
            "sun_optical_depth",
            "detail_tile",
        ],
        writes: &["radiance"],
        what: "rays of view through sky and cloud to the ground",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "march:steps",
        needs: &[Effect::Moisture],
        rungs: &[Rung::LogarithmicSegments, Rung::ByOpticalDepth],
        reads: &["cloud_cover_and_amplitude"],
        writes: &["radiance"],
        what: "other lengths of the steps through cloud (within march)",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "upsample",
        needs: &[Effect::Moisture],
        rungs: &[Rung::HalfResolution],
        reads: &["radiance", "cloud_transmittance", "cloud_distance"],
        writes: &["picture"],
        what: "a live picture from one pixel in four and those between which they disagree (march is then those one in four, and the rest of it within this)",
        tolerance: Tolerance {
            within: Within::Absolute(1.0),
            outside: 0.002,
            why: "as of march; and where samples disagree by just the bound, one device marches a pixel that the other fills: one in thousands, some levels apart",
        },
    },
    ViewStage {
        name: "reproject",
        needs: &[Effect::Moisture],
        rungs: &[Rung::Reproject4, Rung::Reproject16],
        reads: &["radiance", "cloud_transmittance", "cloud_distance", "last_picture"],
        writes: &["picture"],
        what: "a live picture from one pixel in 4 or 16 and the viewer's last one (march within it)",
        tolerance: Tolerance {
            within: Within::Absolute(1.0),
            outside: 0.0,
            why: "on the CPU alone",
        },
    },
    ViewStage {
        name: "impostors",
        needs: &[Effect::Moisture],
        rungs: &[Rung::Impostors],
        reads: &["radiance", "cloud_transmittance", "cloud_distance", "far_clouds_kept"],
        writes: &["picture"],
        what: "a live picture whose far clouds stand on pictures kept of them (march within it)",
        tolerance: Tolerance {
            within: Within::Absolute(1.0),
            outside: 0.0,
            why: "on the CPU alone",
        },
    },
    ViewStage {
        name: "layers",
        needs: &[],
        rungs: &[],
        reads: &["radiance", "objects_distance"],
        writes: &["layers"],
        what: "what a client needs to put objects into a picture: light before them, what passes, where the cloud is (when asked for)",
        tolerance: Tolerance {
            within: Within::Relative(2e-3),
            outside: 0.002,
            why: "sums of some 20 samples of packed numbers; where rounding moves a ray over a cell's border of the occupancy, the samples behind shift by a step: one in thousands",
        },
    },
    ViewStage {
        name: "ground",
        needs: &[],
        rungs: &[],
        reads: &["sun_and_sky_on_cloud_and_ground"],
        writes: &["radiance"],
        what: "the land (within march)",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "ground:shadow",
        needs: &[Effect::CloudShadow],
        rungs: &[],
        reads: &["ground_shadow"],
        writes: &["radiance"],
        what: "the clouds' shadow on the land (within march)",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "haze",
        needs: &[Effect::AerialPerspective],
        rungs: &[],
        reads: &["atmosphere"],
        writes: &["radiance"],
        what: "the air between the camera and the cloud (within march)",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "light_shafts",
        needs: &[Effect::LightShafts],
        rungs: &[],
        reads: &[
            "atmosphere",
            "sun_and_sky_on_cloud_and_ground",
            "sun_optical_depth",
            "ground_shadow",
        ],
        writes: &["radiance"],
        what: "the clouds' shadows in the air (within march)",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "moon",
        needs: &[Effect::Moon],
        rungs: &[],
        reads: &["moon_direction", "sun_direction", "air_transmittance"],
        writes: &["sky_radiance", "sun_and_sky_on_cloud_and_ground", "radiance"],
        what: "the moon's disc, and by night its sky and its beam in place of the sun's (within sky_table, sky_light and march)",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "stars",
        needs: &[Effect::Stars],
        rungs: &[],
        reads: &["star_catalogue", "sidereal_time", "air_transmittance"],
        writes: &["star_table", "radiance"],
        what: "the stars by night: a table once, then within march",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "tone_map",
        needs: &[],
        rungs: &[],
        reads: &["radiance"],
        writes: &["picture"],
        what: "exposure, filmic curve, sRGB (within march)",
        tolerance: PICTURE,
    },
];
