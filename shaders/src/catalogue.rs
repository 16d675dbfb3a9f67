//! The catalogue: every field and every pass by name, what each pass reads and writes, and what asks for it.
//!
//! The catalogue's order is the order in which passes run. A plan is a selection from it; a device runs a plan.
//! A pass is a stage applied to named fields; a stage is one file, `cpu/sim/STAGE.rs` and later `wgsl/sim/STAGE.wgsl`.

mod ladders;
mod view_stages;

pub use ladders::{Advance, Devices, Ladder, Rung, RungInfo};
pub use view_stages::{Tolerance, VIEW_STAGES, ViewStage, Within};

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

impl Pass {
    /// Whether it is there only for passes that hold tendencies over a substep, and is left out with them.
    pub fn serves_held_tendencies(self) -> bool {
        matches!(self, Pass::SlowClear | Pass::AddTendencies)
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
