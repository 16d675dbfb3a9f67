//! A scene: everything that is needed to start a world, as one versioned JSON document.
//!
//! An effect is a block under `effects`: present, it is simulated; absent, it is neither compiled into the plan nor
//! allocated nor run.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::camera::Camera;

/// The scene format this build reads and writes.
pub const SCENE_VERSION: u32 = 1;

/// A piecewise-linear profile: `[height_m, value]` pairs by rising height; constant beyond its ends.
pub type Profile = Vec<[f64; 2]>;

/// A whole scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Format version; this build knows version 1.
    pub version: u32,
    /// Short name, shown in lists.
    pub name: String,
    /// One line on what the scene shows.
    #[serde(default)]
    pub description: String,
    /// Seed of every random number in the scene: the same scene with the same seed gives the same bits.
    #[serde(default)]
    pub seed: u32,
    /// The box of air that is simulated, and where on Earth it stands.
    pub domain: Domain,
    /// Clock.
    pub time: Time,
    /// The air at the start and the reference state of the anelastic equations.
    pub base_state: BaseState,
    /// What is simulated and drawn.
    #[serde(default)]
    pub effects: Effects,
    /// How exactly it is computed; chooses a method on each ladder, and how long a substep may be.
    #[serde(default)]
    pub accuracy: Accuracy,
    /// Methods by name, each in place of what `accuracy` chose.
    #[serde(default)]
    pub methods: Methods,
    /// Where the sun's place comes from.
    #[serde(default)]
    pub sun: Sun,
    /// The default point of view.
    pub camera: Camera,
}

/// See [`Scene::accuracy`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Accuracy {
    /// As `balanced`, in substeps up to 1.4 times as long, which is the most that the method bears.
    Fast,
    /// Flux form and the direct pressure solver: heat and water are conserved to rounding, the mass flux is free of divergence.
    #[default]
    Balanced,
    /// As `balanced`, in substeps half as long; every pixel of live pictures is marched.
    Reference,
}

/// See [`Scene::methods`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Methods {
    /// How the wind carries itself, heat and water. Needs the effect `flow`.
    pub advection: Option<Advection>,
    /// How the mass flux is freed of divergence. Needs the effect `flow`.
    pub pressure: Option<Pressure>,
    /// How the clear sky by the sun is made; `scattering_tables` unless named.
    pub sky: Option<Sky>,
    /// How sunlight is followed through cloud beyond its first scattering; `diffusion` unless named, or `octaves` where the effect `multiple_scattering` says how many. Needs that effect.
    pub scattering: Option<Scattering>,
    /// How pictures learn how much cloud lies towards the sun; `light_grid` unless named. Needs the effect `moisture`.
    pub sun_occlusion: Option<SunOcclusion>,
    /// Where a ray of view looks into cloud; steps `by_distance` unless named. Needs the effect `moisture`.
    pub view_steps: Option<ViewSteps>,
    /// How droplets turn light; those of 18 micrometres by the fit unless named. Needs the effect `moisture`.
    pub phase: Option<Phase>,
    /// How many pixels of a stream's live pictures are marched through cloud; the accuracy's choice unless named. Single and still pictures have them all. Needs
    /// the effect `moisture`.
    pub view_sampling: Option<ViewSampling>,
}

/// See [`Methods::view_sampling`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ViewSampling {
    /// One in sixteen, the others from the viewer's last picture. Single pictures have them all.
    #[serde(rename = "reproject_16")]
    Reproject16,
    /// One in four, the others from the viewer's last picture. Single pictures have them all.
    #[serde(rename = "reproject_4")]
    Reproject4,
    /// All of what is near; clouds farther than 8 km from pictures of them that are kept until they no longer fit. Single pictures march them too.
    Impostors,
    /// One in four, and those between which they disagree, as at edges.
    HalfResolution,
    /// All.
    EveryPixel,
}

/// See [`Methods::scattering`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Scattering {
    /// Octaves of thinner cloud and rounder phase functions; as many as the effect says. Cheapest; too bright just inside clouds, on the side away from the sun.
    Octaves,
    /// Light of the forward peak goes on, the rest is scattered once. The effect's octaves are not looked at.
    MultipleForward,
    /// Light diffuses through the clouds as they stand: the nearest to traced paths. The effect's octaves are not looked at.
    Diffusion,
    /// Light of orders from 2 on as in a level slab fitted to the cloud around, from tables of photons followed through slabs; on the CPU alone. The effect's octaves are not looked at.
    Slab,
    /// The same with a slab for each group of orders, found by iteration over where a place's light came in; on the CPU alone. The effect's octaves are not looked at.
    SlabCollector,
}

/// See [`Methods::view_steps`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "steps", rename_all = "snake_case", deny_unknown_fields)]
pub enum ViewSteps {
    /// Steps of 15 m that grow with the distance from the camera, to 200 m.
    ByDistance {},
    /// Steps of about so much cloud each: short in thick cloud, long in thin.
    ByOpticalDepth {
        /// Optical depth of a step, 0.02 to 4.
        optical_depth: f64,
    },
    /// So many steps from where a ray first meets cloud to where no more can come, each longer than the one before by the same factor (seed 000).
    LogarithmicSegments {
        /// Steps, 2 to 512.
        segments: u32,
    },
}

/// See [`Methods::sun_occlusion`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "method", rename_all = "snake_case", deny_unknown_fields)]
pub enum SunOcclusion {
    /// A grid of optical depths, made once a tick, and what the detail adds near by.
    LightGrid {},
    /// A march towards the sun from every sample.
    SecondaryMarch {
        /// Steps, 1 to 512.
        steps: u32,
    },
    /// A map of where cloud begins.
    ExponentialShadowMap {
        /// Rays along each side, 16 to 4096.
        side: u32,
    },
    /// A map of where cloud begins, its mean extinction and its optical depth.
    BeerShadowMap {
        /// Rays along each side, 16 to 4096.
        side: u32,
    },
    /// A map of seven Fourier coefficients of the extinction.
    FourierOpacityMap {
        /// Rays along each side, 16 to 4096.
        side: u32,
    },
}

/// See [`Methods::phase`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "function", rename_all = "snake_case", deny_unknown_fields)]
pub enum Phase {
    /// Rayleigh's, of molecules: for comparison.
    Rayleigh {},
    /// Henyey and Greenstein's.
    HenyeyGreenstein {
        /// Mean cosine, -0.999 to 0.999.
        asymmetry: f64,
    },
    /// Two of them.
    DoubleHenyeyGreenstein {
        /// Mean cosine of the part that goes on, -0.999 to 0.999.
        forward_asymmetry: f64,
        /// Mean cosine of the other, -0.999 to 0.999; below 0 where it goes back.
        backward_asymmetry: f64,
        /// Share of the first, 0 to 1.
        forward_share: f64,
    },
    /// The fit of Jendersie and d'Eon (2023) to droplets of one size.
    Droplets {
        /// 5 to 50 micrometres.
        diameter_um: f64,
    },
    /// Mie's, of droplets of many sizes, in three colours: with glory and fogbow.
    Mie {
        /// 1 to 50 micrometres.
        effective_radius_um: f64,
    },
    /// That of hexagonal crystals of ice at random, in three colours: with the halos of 22 and 46 degrees.
    Ice {
        /// Length of the crystals over their width, 0.05 (plates) to 20 (columns).
        aspect_ratio: f64,
    },
}

/// See [`Methods::advection`]; cheapest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Advection {
    /// Semi-Lagrangian with linear interpolation: stable at any Courant number, smears.
    SemiLagrangianLinear,
    /// MacCormack with a limiter on the semi-Lagrangian step.
    MacCormack,
    /// Semi-Lagrangian with cubic interpolation and a limiter.
    SemiLagrangianCubic,
    /// Flux form of fifth order with three-stage Runge-Kutta: conserves.
    FluxForm,
}

/// See [`Methods::sky`]; cheapest first. The formulas hold for a sun above the horizon and a viewer near the ground: as the sun sinks from 5 to 0 degrees they give way to the
/// tables, which also make the haze before clouds and ground, the moon's sky and the night.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Sky {
    /// Preetham, Shirley and Smits (1999): turbidities from 2 to 10; clearer air has the sky of 2.
    Preetham,
    /// Hosek and Wilkie (2012): turbidities from 1 to 10, and the ground's albedo.
    HosekWilkie,
    /// Look-up tables after Hillaire (2020): any sun, any height.
    ScatteringTables,
}

/// See [`Methods::pressure`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "solver", rename_all = "snake_case", deny_unknown_fields)]
pub enum Pressure {
    /// Exact to rounding: FFT in x and y, tridiagonal in z.
    Direct {},
    /// Jacobi's iteration.
    Jacobi {
        /// Sweeps a solve, 1 to 10000.
        sweeps: u32,
    },
    /// Red-black successive over-relaxation.
    RedBlackSor {
        /// Sweeps a solve, 1 to 10000.
        sweeps: u32,
        /// Relaxation factor, 0.1 to 1.99; 1 is Gauss-Seidel.
        relaxation: f64,
    },
    /// Multigrid V-cycles.
    Multigrid {
        /// Cycles a solve, 1 to 100.
        cycles: u32,
    },
}

/// The simulated box: periodic in x and y, rigid ground and lid.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Domain {
    /// Number of cells east, north and up.
    pub cells: [u32; 3],
    /// Size of a cell east, north and up, in metres.
    pub cell_size_m: [f64; 3],
    /// Degrees north.
    pub latitude_deg: f64,
    /// Degrees east.
    pub longitude_deg: f64,
    /// Height of the ground above mean sea level, metres.
    #[serde(default)]
    pub surface_altitude_m: f64,
    /// What the ground is, for pictures.
    #[serde(default)]
    pub ground: Ground,
}

/// What lies under the clouds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Ground {
    /// Fields and woods.
    #[default]
    Land,
    /// Water under a breeze.
    Sea,
}

/// The scene's clock.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Time {
    /// Date and time at simulated second 0, RFC 3339 in UTC, such as `2026-06-21T16:00:00Z`.
    pub start_utc: String,
    /// Simulated seconds in a tick; a tick is cut into as many substeps as stability asks for.
    pub tick_s: f64,
    /// Simulated seconds a wall second once the spin-up is over.
    pub time_scale: f64,
    /// Simulated seconds at the start that run as fast as the device can, so that viewers soon see clouds.
    #[serde(default)]
    pub spin_up_s: f64,
}

/// The air at the start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum BaseState {
    /// A table of levels by rising height, linear between.
    Profile {
        /// Pressure at the ground, Pa.
        surface_pressure_pa: f64,
        /// At least two levels.
        levels: Vec<ProfileLevel>,
    },
    /// A radiosonde ascent as text, in the SPC (`%RAW%`) or the University of Wyoming form.
    Sounding {
        /// The file's text.
        text: String,
    },
    /// Neutrally stratified air: one potential temperature everywhere, no water.
    Isentropic {
        /// Pressure at the ground, Pa.
        surface_pressure_pa: f64,
        /// Potential temperature, K.
        potential_temperature_k: f64,
        /// Wind towards the east, m/s.
        #[serde(default)]
        wind_x_m_s: f64,
        /// Wind towards the north, m/s.
        #[serde(default)]
        wind_y_m_s: f64,
    },
    /// Air of constant Brunt-Vaisala frequency and constant relative humidity.
    ConstantStability {
        /// Pressure at the ground, Pa.
        surface_pressure_pa: f64,
        /// Potential temperature at the ground, K.
        surface_potential_temperature_k: f64,
        /// Brunt-Vaisala frequency N, 1/s; 0.01 is usual for the troposphere.
        buoyancy_frequency_per_s: f64,
        /// Relative humidity over water, 0 to 1.
        relative_humidity: f64,
        /// Wind towards the east, m/s.
        #[serde(default)]
        wind_x_m_s: f64,
        /// Wind towards the north, m/s.
        #[serde(default)]
        wind_y_m_s: f64,
    },
    /// The sounding of Weisman and Klemp (1982) for deep convection.
    WeismanKlemp {
        /// Pressure at the ground, Pa.
        surface_pressure_pa: f64,
        /// Cap on the water vapour mixing ratio near the ground, kg/kg; 0.014 in the paper.
        mixing_ratio_cap_kg_per_kg: f64,
        /// Wind towards the east at 6 km and above, m/s; below it falls linearly to 0 at the ground.
        #[serde(default)]
        wind_shear_m_s: f64,
    },
    /// Cloud from the ground to the lid that is neither stable nor unstable: one reversible moist adiabat with one total water, after
    /// Bryan and Fritsch (2002).
    SaturatedNeutral {
        /// Pressure at the ground, Pa.
        surface_pressure_pa: f64,
        /// Equivalent potential temperature of the reversible ascent at the ground, K.
        surface_equivalent_potential_temperature_k: f64,
        /// Total water (vapour and liquid) over dry air, kg/kg; the air must be saturated with it at the ground.
        total_water_mixing_ratio_kg_per_kg: f64,
        /// Wind towards the east, m/s.
        #[serde(default)]
        wind_x_m_s: f64,
        /// Wind towards the north, m/s.
        #[serde(default)]
        wind_y_m_s: f64,
    },
}

/// One level of a profile table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ProfileLevel {
    /// Height above the ground, m.
    pub height_m: f64,
    /// Liquid-water potential temperature, K.
    pub liquid_water_potential_temperature_k: f64,
    /// Total water (vapour and liquid), kg/kg.
    pub total_water_kg_per_kg: f64,
    /// Wind towards the east, m/s.
    pub wind_x_m_s: f64,
    /// Wind towards the north, m/s.
    pub wind_y_m_s: f64,
}

/// What is simulated and drawn: each block present or absent.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Effects {
    /// The wind is a fluid: momentum is advected and kept free of divergence. Absent, nothing moves.
    pub flow: Option<Flow>,
    /// Heat is carried and lifts air. Needs `flow`.
    pub heat: Option<Heat>,
    /// Water is carried and condenses to cloud. Needs `heat`.
    pub moisture: Option<Moisture>,
    /// Eddies smaller than a cell mix (Smagorinsky-Lilly). Needs `flow`.
    pub turbulence: Option<Turbulence>,
    /// One viscosity mixes everywhere. Needs `flow`, excludes `turbulence`.
    pub constant_viscosity: Option<ConstantViscosity>,
    /// A push within a part of the box, as of a fan. Needs `flow`.
    pub body_force: Option<BodyForce>,
    /// Heat and moisture from the ground, and its drag. Needs `flow`.
    pub surface: Option<Surface>,
    /// Earth's rotation acting on the difference to a geostrophic wind. Needs `flow`.
    pub coriolis: Option<Coriolis>,
    /// What larger weather does to the box: subsidence, radiation, drying. Needs `heat`.
    pub large_scale: Option<LargeScale>,
    /// A layer under the lid that damps waves. Needs `flow`.
    pub sponge: Option<Sponge>,
    /// Small random perturbations at the start. Needs `heat`.
    pub noise: Option<Noise>,
    /// A warm (or cold) bubble at the start. Needs `heat`.
    pub bubble: Option<Bubble>,
    /// Detail finer than a cell on the drawn cloud, from noise that moves with the air. Needs `moisture`.
    pub cloud_detail: Option<CloudDetail>,
    /// Light scattered more than once inside cloud. Needs `moisture`.
    pub multiple_scattering: Option<MultipleScattering>,
    /// Clouds' shadows on the ground. Needs `moisture`.
    pub cloud_shadow: Option<CloudShadow>,
    /// Clouds' shadows in the hazy air, so that light falls through gaps in shafts. Needs `moisture` and `aerial_perspective`.
    pub light_shafts: Option<LightShafts>,
    /// Haze between the viewer and the cloud.
    pub aerial_perspective: Option<AerialPerspective>,
    /// The moon: its disc, and its light on sky, cloud and ground while the sun is down. With `moon` or `stars` pictures adapt to the dark and the night sky
    /// has its own faint light.
    pub moon: Option<Moon>,
    /// The stars that an eye sees, turning with the clock.
    pub stars: Option<Stars>,
}

/// See [`Effects::flow`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Flow {
    /// Largest Courant number of a substep (sum over the three directions); 1.0 suits the third-order Runge-Kutta, which allows 1.4;
    /// the semi-Lagrangian methods allow 50.
    pub courant_max: f64,
}

/// See [`Effects::heat`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Heat {}

/// See [`Effects::moisture`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Moisture {
    /// Cloud droplets in a cubic metre; 1e8 over sea, 4e8 inland. Sets the droplets' effective radius, and so the cloud's extinction.
    pub droplet_number_per_m3: f64,
}

/// See [`Effects::turbulence`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Turbulence {
    /// Smagorinsky's coefficient; 0.1 to 0.25.
    pub smagorinsky_coefficient: f64,
    /// Eddy viscosity over eddy diffusivity; about 1/3.
    pub turbulent_prandtl_number: f64,
}

/// See [`Effects::constant_viscosity`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ConstantViscosity {
    /// Kinematic viscosity of momentum, m2/s.
    pub viscosity_m2_s: f64,
    /// Diffusivity of heat and of water, m2/s; more than 0 needs `heat`.
    #[serde(default)]
    pub diffusivity_m2_s: f64,
    /// How it steps through time.
    pub scheme: DiffusionScheme,
}

/// See [`ConstantViscosity::scheme`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DiffusionScheme {
    /// From the air as it is; exact for small steps, and large viscosities ask for short ones.
    Explicit,
    /// From the air as it will be, by Jacobi's iteration: stable at any step.
    Implicit,
}

/// See [`Effects::body_force`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BodyForce {
    /// The region's lower corner (west, south, bottom), m.
    pub lower_m: [f64; 3],
    /// The region's upper corner (east, north, top), m; above the lower one along each axis.
    pub upper_m: [f64; 3],
    /// Acceleration east, north and up, m/s2.
    pub acceleration_m_s2: [f64; 3],
    /// Drag within the region, 1/s: air that stays there is brought to acceleration over drag. Without any, the wind grows without end.
    #[serde(default)]
    pub drag_per_s: f64,
}

/// See [`Effects::surface`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Surface {
    /// Kinematic flux of potential temperature, K m/s; positive warms the air.
    pub heat_flux_k_m_s: f64,
    /// Kinematic flux of water, kg/kg m/s; positive moistens the air.
    pub moisture_flux_m_s: f64,
    /// Friction velocity, m/s.
    pub friction_velocity_m_s: f64,
}

/// See [`Effects::coriolis`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Coriolis {
    /// Coriolis parameter, 1/s; absent, it is taken from the domain's latitude.
    #[serde(default)]
    pub parameter_per_s: Option<f64>,
    /// Geostrophic wind towards the east by height, m/s; absent, the base state's wind.
    #[serde(default)]
    pub geostrophic_wind_x_m_s: Option<Profile>,
    /// Geostrophic wind towards the north by height, m/s; absent, the base state's wind.
    #[serde(default)]
    pub geostrophic_wind_y_m_s: Option<Profile>,
}

/// See [`Effects::large_scale`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LargeScale {
    /// Large-scale vertical wind by height, m/s; negative sinks.
    #[serde(default)]
    pub vertical_wind_m_s: Profile,
    /// Radiative tendency of potential temperature by height, K/s; negative cools.
    #[serde(default)]
    pub heating_k_per_s: Profile,
    /// Tendency of total water by height, 1/s (kg/kg a second).
    #[serde(default)]
    pub moistening_per_s: Profile,
}

/// See [`Effects::sponge`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sponge {
    /// Depth below the lid, m.
    pub depth_m: f64,
    /// Rate of damping at the lid, 1/s; it falls to 0 at the sponge's bottom.
    pub rate_per_s: f64,
}

/// See [`Effects::noise`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Noise {
    /// Noise is put into the cells below this height, m.
    pub depth_m: f64,
    /// Half-width of the uniform noise in potential temperature, K.
    pub potential_temperature_k: f64,
    /// Half-width of the uniform noise in total water, kg/kg.
    pub total_water_kg_per_kg: f64,
}

/// See [`Effects::bubble`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Bubble {
    /// Centre, m.
    pub centre_m: [f64; 3],
    /// Half-axes, m.
    pub radius_m: [f64; 3],
    /// Liquid-water potential temperature added at the centre, K; falls off as cos2 of the distance. Negative for a cold bubble.
    #[serde(default)]
    pub potential_temperature_k: f64,
    /// Temperature added at the centre at unchanged pressure, K, with the same fall-off; where it is cloudy, before water condenses or
    /// evaporates.
    #[serde(default)]
    pub temperature_k: f64,
    /// Share by which virtual potential temperature (with the weight of the liquid) is raised at the centre, with the same fall-off and
    /// total water unchanged: 2/300 makes a cloudy bubble as buoyant as a dry one of 2 K in air of 300 K (Bryan and Fritsch 2002).
    #[serde(default)]
    pub virtual_potential_temperature_share: f64,
    /// Total water added at the centre, kg/kg, with the same fall-off.
    #[serde(default)]
    pub total_water_kg_per_kg: f64,
}

/// See [`Effects::cloud_detail`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CloudDetail {
    /// 0 leaves the grid's cloud as it is; 1 carves its edge most.
    pub strength: f64,
    /// Size of the largest detail, m; about two cells.
    pub scale_m: f64,
}

/// See [`Effects::multiple_scattering`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MultipleScattering {
    /// Octaves of scattering after the first, 1 to 8, of a scene that is lit by them; 6 unless named. A scene that names them and no `methods.scattering` is lit by octaves.
    pub octaves: Option<u32>,
}

/// See [`Effects::cloud_shadow`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CloudShadow {}

/// See [`Effects::light_shafts`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LightShafts {
    /// Samples along a ray of view, 4 to 128; 24 show shafts with little grain.
    pub samples: u32,
}

/// See [`Effects::aerial_perspective`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AerialPerspective {
    /// Horizontal visibility near the ground, m (Koschmieder, 5 % contrast is 3.0 over the extinction).
    pub visibility_m: f64,
}

/// See [`Effects::moon`]. The scene's sun lights it, so its phase follows from where both stand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "from", rename_all = "snake_case", deny_unknown_fields)]
pub enum Moon {
    /// Its place from the scene's clock, latitude and longitude.
    Clock {},
    /// Fixed in the sky.
    Fixed {
        /// Degrees above the horizon.
        elevation_deg: f64,
        /// Degrees clockwise from north.
        azimuth_deg: f64,
    },
}

/// See [`Effects::stars`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Stars {
    /// The faintest magnitude that is drawn, -2 to 6; 6 is what an eye sees.
    pub faintest_magnitude: f64,
}

/// Where the sun's place comes from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "from", rename_all = "snake_case", deny_unknown_fields)]
pub enum Sun {
    /// From the scene's clock, latitude and longitude.
    #[default]
    Clock,
    /// Fixed in the sky.
    Fixed {
        /// Degrees above the horizon.
        elevation_deg: f64,
        /// Degrees clockwise from north.
        azimuth_deg: f64,
    },
}
