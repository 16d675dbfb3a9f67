//! What both devices' views share: settings, what follows from them by arithmetic alone, and the keys of what is kept.

use glam::{DQuat, DVec3, Vec3};

use crate::CloudVolume;
use crate::cpu::light::Atmosphere;
use crate::cpu::light::analytic_sky::{AnalyticSky, SkyMethod};
use crate::cpu::light::diffusion_shares::FORWARD_OCTAVES;
use crate::cpu::light::moon::MoonLook;
use crate::cpu::light::phase_table::PhaseChoice;
use crate::cpu::light::sky_table::SkySource;
use crate::cpu::light::stars::STARS_SUN_SINE;
use crate::cpu::view::detail_noise::TILE_BILLOWS;
pub use crate::cpu::view::ground::Ground;
use crate::cpu::view::light_shafts::SHAFT_SAMPLES_MAX;
use crate::cpu::view::march::OCTAVES_MAX;
use crate::cpu::view::tone_map;

// Not used in WGSL, but by other hosts that run it.
crate::constants! {
    /// Steps a unit in each component of the sun's direction that tables are made for.
    pub const SUN_DIRECTIONS: f32 = 1024.0;
    /// Lowest height of a camera above the ground, m.
    pub const CAMERA_LOWEST_M: f32 = 1.5;
    /// Greatest height of a camera, m.
    pub const CAMERA_HIGHEST_M: f32 = 60_000.0;
    /// Largest extinction that is drawn, 1/m.
    pub const EXTINCTION_MAX_PER_M: f32 = 10.0;
    /// A slab of more cells than this is not made finer.
    pub const FINER_CELLS_MAX: usize = 1 << 20;
}

/// Detail finer than the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detail {
    /// 0 leaves the grid's cloud as it is; 1 carves its edge most.
    pub strength: f32,
    /// Size of the largest detail, m.
    pub scale_m: f32,
}

/// Where the moon is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MoonPlace {
    /// Unit vector towards it: x east, y north, z up.
    pub direction: [f32; 3],
    /// Distance, m.
    pub distance_m: f32,
}

/// How the sky of stars is turned, and which of them are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StarPlaces {
    /// Rows that turn a direction of the world into one of the equator's frame of date.
    pub equatorial_from_world: [[f32; 3]; 3],
    /// Years since 2000, for precession.
    pub years_since_2000: f32,
    /// The faintest magnitude that is drawn.
    pub faintest: f32,
}

/// How the march makes of sunlight what comes to the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scattering {
    /// Once, and further by octaves (Wrenninge et al. 2013); their number is the view's, none is single scattering.
    #[default]
    Octaves,
    /// Once, after light of the forward peak has gone on (seed 002, seed 004).
    MultipleForward,
    /// Once, about the sun's way, and diffusely (stage `diffusion`).
    Diffusion,
    /// Once, and further as in a slab fitted to the cloud (stage `slab_fit`); on the CPU.
    Slab,
    /// The same with slabs found by iteration (stage `slab_collector`); on the CPU.
    SlabCollector,
}

impl Scattering {
    /// Octaves that the march sums where a view asks for so many.
    pub fn octaves(self, asked: u32) -> usize {
        match self {
            Scattering::Octaves => (asked as usize).min(OCTAVES_MAX),
            Scattering::Diffusion => FORWARD_OCTAVES,
            Scattering::MultipleForward | Scattering::Slab | Scattering::SlabCollector => 0,
        }
    }
}

/// What a shadow map keeps of a ray; see stage `sun_map`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapKind {
    /// Where cloud begins.
    Exponential,
    /// Also its mean extinction and its optical depth.
    Beer,
    /// The first terms of its extinction's Fourier series.
    Fourier,
}

impl MapKind {
    /// Numbers that are kept of a ray.
    pub fn numbers(self) -> usize {
        match self {
            MapKind::Exponential => 1,
            MapKind::Beer => 3,
            MapKind::Fourier => 7,
        }
    }
}

/// How the march learns how much cloud lies towards the sun.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SunOcclusion {
    /// From the grid of stage `sun_optical_depth`, with what the detail adds near by.
    #[default]
    LightGrid,
    /// By a march from each sample, its steps growing with distance.
    SecondaryMarch {
        /// 1 to [`SECONDARY_STEPS_MAX`].
        steps: u32,
    },
    /// From a map of the sun's rays (stage `sun_map`).
    ShadowMap {
        /// What it keeps.
        kind: MapKind,
        /// Rays along each of its sides, 16 to 4096.
        side: u32,
    },
}

/// Steps of a secondary march at most.
pub const SECONDARY_STEPS_MAX: u32 = 512;

/// Where a ray of view looks into cloud.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum ViewSteps {
    /// Steps that grow with the distance from the camera.
    #[default]
    ByDistance,
    /// Steps of about the same optical depth.
    ByOpticalDepth {
        /// That of a step, 0.02 to 4.
        optical_depth: f32,
    },
    /// Steps from the first cloud on, each longer than the one before by the same factor.
    LogarithmicSegments {
        /// Their number, 2 to 512.
        segments: u32,
    },
}

/// How clouds are lit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lighting {
    /// How droplets turn light.
    pub phase: PhaseChoice,
    /// How light is followed through cloud.
    pub scattering: Scattering,
    /// What takes sunlight away before.
    pub sun_occlusion: SunOcclusion,
}

impl Lighting {
    /// Whether no GPU draws it, this program's or a page's.
    pub fn needs_cpu(&self) -> bool {
        matches!(self.scattering, Scattering::Slab | Scattering::SlabCollector)
    }
}

/// How many of a picture's pixels are marched.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ViewSampling {
    /// All.
    #[default]
    EveryPixel,
    /// One in four, and those between which they disagree (stage `upsample`).
    HalfResolution,
    /// One in 4 of a viewer's live picture, the others from the one before (stage `reproject`). All where there is no viewer.
    Reproject4,
    /// One in 16 of it.
    Reproject16,
    /// All of what is near; far clouds from pictures that a viewer's live picture keeps (stage `impostors`). All where there is no viewer.
    Impostors,
}

impl ViewSampling {
    /// Whether a viewer's picture builds on what the one before has left.
    pub fn builds_on_last(self) -> bool {
        self.cell().is_some() || self == ViewSampling::Impostors
    }
    /// Pixels along the side of a cell of which one is marched a picture, where the others are looked up in the one before.
    pub fn cell(self) -> Option<usize> {
        match self {
            ViewSampling::EveryPixel | ViewSampling::HalfResolution | ViewSampling::Impostors => None,
            ViewSampling::Reproject4 => Some(2),
            ViewSampling::Reproject16 => Some(4),
        }
    }
}

/// What a picture is taken of and how. Numbers that make no sense are bounded, never an error: a camera under the ground stands on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewSettings {
    /// Metres east, north and up from the volume's south-west corner on the ground.
    pub camera_position_m: [f32; 3],
    /// Degrees clockwise from north.
    pub azimuth_deg: f32,
    /// Degrees above the horizon.
    pub elevation_deg: f32,
    /// Angle of view from bottom to top, degrees; bounded to 0.1 to 170.
    pub vertical_fov_deg: f32,
    /// Exposure compensation, stops.
    pub exposure_ev: f32,
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// Unit vector towards the sun: x east, y north, z up.
    pub sun_direction: [f32; 3],
    /// Detail finer than a cell; none draws the grid's cloud.
    pub detail: Option<Detail>,
    /// Octaves of scattering after the first; 0 is single scattering; at most 8.
    pub multiple_scattering_octaves: u32,
    /// How clouds are lit.
    pub lighting: Lighting,
    /// Where rays look into cloud.
    pub steps: ViewSteps,
    /// What lies under the clouds.
    pub ground: Ground,
    /// Whether clouds shade the ground.
    pub cloud_shadow: bool,
    /// Samples a ray of the clouds' shadows in the air; 0 draws none; at most [`SHAFT_SAMPLES_MAX`].
    pub light_shafts: u32,
    /// Horizontal visibility near the ground, m; none draws no haze between camera and cloud.
    pub visibility_m: Option<f32>,
    /// Shifts the detail noise.
    pub seed: u32,
    /// Height of the ground above mean sea level, m.
    pub surface_altitude_m: f32,
    /// The moon, if its light is wanted. With moon or stars pictures adapt to the dark.
    pub moon: Option<MoonPlace>,
    /// The stars, if wanted.
    pub stars: Option<StarPlaces>,
    /// How the clear sky by the sun is made.
    pub sky: SkyMethod,
    /// How many of the pixels are marched.
    pub sampling: ViewSampling,
}

/// Detail noise of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameDetail {
    /// How far the edge is pushed, in cover.
    pub push: f32,
    /// Share of the carved cloud against the grid's.
    pub blend: f32,
    /// One over the tile's edge, 1/m.
    pub tiles_per_m: f32,
    /// Added to positions, m.
    pub offset_m: [f32; 3],
}

/// Air, what lights the sky, camera height: what the sky table depends on.
pub type SkyKey = (Atmosphere, Sources, f32);
/// Air, ground, what lights the sky, the cloud's base and top: what the light on clouds and ground depends on.
pub type LightKey = (Atmosphere, Ground, Sources, [f32; 2]);
/// Volume, whether carved, whether wanted away from clouds, where the beam comes from: what the cloud's optical depths depend on.
pub type SunLightKey = (u64, bool, bool, [f32; 3]);

/// What lights the sky, directions as tables are made for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sources {
    /// The sun, and the night sky's own light.
    pub sun: SkySource,
    /// A formula in place of the tables, while the sun is up.
    pub analytic: Option<AnalyticSky>,
    /// The moon, where its light is worth a sky, and the share of its beam that is let in.
    pub moon: Option<(SkySource, f32)>,
}

/// Volume, detail, map, its side, sun: what a map of the sun's rays depends on.
pub type SunMapKey = (u64, Option<FrameDetail>, MapKind, u32, [f32; 3]);
/// Phase function, method, octaves: what the numbers that the march turns light by depend on.
pub type PhaseKey = (PhaseChoice, Scattering, usize);
/// Volume, whether carved, sun, phase function: what the diffuse light depends on.
pub type DiffuseKey = (u64, bool, [f32; 3], PhaseChoice);
/// What diffuse light depends on, and octaves: what their balance depends on.
pub type BalanceKey = (DiffuseKey, usize);
/// Which slabs, and what diffuse light depends on: what the light of fitted slabs depends on.
pub type SlabKey = (Scattering, DiffuseKey);

/// Settings made sense of: bounded, with what follows from them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Camera, m.
    pub position_m: [f32; 3],
    /// Unit vectors to the right, up and ahead.
    pub axes: [[f32; 3]; 3],
    /// Tangent of half the vertical angle of view.
    pub half_height: f32,
    /// Unit vector towards the sun.
    pub sun_direction: [f32; 3],
    /// The sun's direction that tables are made for, the nearest of directions a twentieth of a degree apart: a sun that creeps with the
    /// clock keeps them for a while. The disc and the phase functions see the sun where it is.
    pub table_sun: [f32; 3],
    /// The moon.
    pub moon: Option<MoonLook>,
    /// Unit vector towards what throws shadows: the sun, by night the moon.
    pub beam_direction: [f32; 3],
    /// The same as tables are made for it.
    pub table_beam: [f32; 3],
    /// Stars, while it is dark enough for any.
    pub stars: Option<StarPlaces>,
    /// Whether pictures adapt to the dark.
    pub night: bool,
    /// How the clear sky by the sun is made.
    pub sky: SkyMethod,
    /// Factor on the exposure.
    pub exposure_gain: f32,
    /// The clear air.
    pub air: Atmosphere,
    /// What lies under the clouds.
    pub ground: Ground,
    /// Detail, if wanted.
    pub detail: Option<FrameDetail>,
    /// Octaves after the first.
    pub octaves: usize,
    /// How clouds are lit.
    pub lighting: Lighting,
    /// Where rays look into cloud: optical depth of a step, or 0; number of segments, or 0. With neither steps go by distance.
    pub steps: (f32, u32),
    /// Samples a ray of the clouds' shadows in the air.
    pub shaft_samples: u32,
}

impl Look {
    /// From settings, and how far the cloudy air has moved, m.
    pub fn new(settings: &ViewSettings, air_displacement_m: [f32; 3]) -> Look {
        let finite = |v: f32, or: f32| if v.is_finite() { v } else { or };
        let [x, y, z] = settings.camera_position_m;
        let sun = unit(settings.sun_direction.map(|v| finite(v, 0.0).clamp(-1e6, 1e6)));
        let fov = finite(settings.vertical_fov_deg, 60.0).clamp(0.1, 170.0).to_radians();
        let detail = settings.detail.filter(|d| d.strength > 0.0 && d.strength.is_finite());
        let moon = settings.moon.map(|moon| {
            let direction = unit(moon.direction.map(|v| finite(v, 0.0).clamp(-1e6, 1e6)));
            MoonLook::new(direction, moon.distance_m, sun)
        });
        let by_moon = moon.filter(|m| m.beam_share > 0.0);
        let beam_direction = by_moon.map_or(sun, |m| m.direction);
        Look {
            position_m: [
                finite(x, 0.0).clamp(-1e6, 1e6),
                finite(y, 0.0).clamp(-1e6, 1e6),
                finite(z, CAMERA_LOWEST_M).clamp(CAMERA_LOWEST_M, CAMERA_HIGHEST_M),
            ],
            axes: axes(finite(settings.azimuth_deg, 0.0), finite(settings.elevation_deg, 0.0)),
            half_height: (0.5 * fov).tan(),
            sun_direction: sun,
            table_sun: table_direction(sun),
            moon,
            beam_direction,
            table_beam: table_direction(beam_direction),
            stars: settings.stars.filter(|_| sun[2] < STARS_SUN_SINE),
            night: settings.moon.is_some() || settings.stars.is_some(),
            sky: settings.sky,
            exposure_gain: tone_map::exposure_gain(settings.exposure_ev),
            air: Atmosphere::new(settings.surface_altitude_m, settings.visibility_m),
            ground: settings.ground,
            detail: detail.map(|d| frame_detail(d, air_displacement_m, settings.seed)),
            octaves: settings
                .lighting
                .scattering
                .octaves(settings.multiple_scattering_octaves),
            lighting: settings.lighting,
            steps: match settings.steps {
                ViewSteps::ByDistance => (0.0, 0),
                ViewSteps::ByOpticalDepth { optical_depth } => (finite(optical_depth, 0.25).clamp(0.02, 4.0), 0),
                ViewSteps::LogarithmicSegments { segments } => (0.0, segments.clamp(2, 512)),
            },
            shaft_samples: settings.light_shafts.min(SHAFT_SAMPLES_MAX),
        }
    }
    /// Whether the light towards the sun is wanted away from clouds too.
    pub fn lit_everywhere(&self) -> bool {
        self.shaft_samples > 0
    }
    /// Key of the sky table.
    pub fn sky_key(&self) -> SkyKey {
        (self.air, self.sources(), self.position_m[2])
    }
    /// What lights the sky.
    pub fn sources(&self) -> Sources {
        let moon = self.moon.filter(|m| m.lights_sky);
        Sources {
            sun: SkySource::sun(self.table_sun, self.night),
            // The formula and the moon's sky are never there together: the one has the sun up, the other down.
            analytic: AnalyticSky::new(self.sky, &self.air, self.ground.albedo(), self.table_sun)
                .filter(|_| self.sun_direction[2] >= 0.0),
            moon: moon.map(|m| {
                (
                    SkySource::moon(table_direction(m.direction), m.irradiance),
                    m.beam_share,
                )
            }),
        }
    }
    /// Key of the light on clouds and ground; `slab` is the cloud's, if there is any.
    pub fn light_key(&self, slab: Option<[f32; 2]>) -> LightKey {
        let base_top = slab.map_or([0.0, 1_000.0], |[bottom_m, top_m]| [bottom_m.max(1.0), top_m]);
        (self.air, self.ground, self.sources(), base_top)
    }
    /// Key of the numbers that the march turns light by.
    pub fn phase_key(&self) -> PhaseKey {
        (self.lighting.phase, self.lighting.scattering, self.octaves)
    }

    /// Steps of the march from each sample towards the sun; 0 where there is none.
    pub fn secondary_steps(&self) -> u32 {
        match self.lighting.sun_occlusion {
            SunOcclusion::SecondaryMarch { steps } => steps.clamp(1, SECONDARY_STEPS_MAX),
            SunOcclusion::LightGrid | SunOcclusion::ShadowMap { .. } => 0,
        }
    }
    /// Key of the map of the sun's rays through the volume with this fingerprint, where there is to be one.
    pub fn sun_map_key(&self, volume: u64) -> Option<SunMapKey> {
        match self.lighting.sun_occlusion {
            SunOcclusion::ShadowMap { kind, side } => Some((volume, self.detail, kind, side, self.table_beam)),
            SunOcclusion::LightGrid | SunOcclusion::SecondaryMarch { .. } => None,
        }
    }
    /// Key of the diffuse light in the volume with this fingerprint, where it is wanted.
    pub fn diffuse_key(&self, volume: u64) -> Option<DiffuseKey> {
        (self.lighting.scattering == Scattering::Diffusion).then_some(self.scattered_key(volume))
    }
    /// Key of the octaves' balance in the volume with this fingerprint, where it is wanted.
    pub fn balance_key(&self, volume: u64) -> Option<BalanceKey> {
        (self.lighting.scattering == Scattering::Octaves && self.octaves > 0)
            .then_some((self.scattered_key(volume), self.octaves))
    }
    /// Key of the slabs fitted to the volume with this fingerprint, where they are wanted.
    pub fn slab_key(&self, volume: u64) -> Option<SlabKey> {
        let scattering = self.lighting.scattering;
        matches!(scattering, Scattering::Slab | Scattering::SlabCollector)
            .then_some((scattering, self.scattered_key(volume)))
    }
    fn scattered_key(&self, volume: u64) -> DiffuseKey {
        (volume, self.detail.is_some(), self.table_beam, self.lighting.phase)
    }
    /// Key of the optical depths of the volume with this fingerprint.
    pub fn sun_light_key(&self, volume: u64) -> SunLightKey {
        (volume, self.detail.is_some(), self.lit_everywhere(), self.table_beam)
    }
}

fn frame_detail(detail: Detail, displacement_m: [f32; 3], seed: u32) -> FrameDetail {
    let scale_m = if detail.scale_m.is_finite() {
        detail.scale_m.clamp(1.0, 1e5)
    } else {
        200.0
    };
    let tile_m = scale_m * TILE_BILLOWS as f32;
    let strength = detail.strength.min(1.0);
    let shift = |a: u32| (seed.wrapping_mul(0x9e37_79b9).rotate_left(11 * a) & 0xffff) as f32 / 65_536.0 * tile_m;
    FrameDetail {
        push: 1.6 * strength,
        blend: (strength * 4.0).min(1.0),
        tiles_per_m: 1.0 / tile_m,
        offset_m: [0, 1, 2].map(|a| {
            let moved = displacement_m[a as usize];
            (if moved.is_finite() { -moved } else { 0.0 } + shift(a)).rem_euclid(tile_m)
        }),
    }
}

/// Unit vectors right, up and ahead of a camera without roll.
fn axes(azimuth_deg: f32, elevation_deg: f32) -> [[f32; 3]; 3] {
    // Turned about the vertical (clockwise, so backwards) after being raised about the axis to the right.
    let azimuth = DQuat::from_rotation_z(-(azimuth_deg as f64).rem_euclid(360.0).to_radians());
    let elevation = DQuat::from_rotation_x((elevation_deg as f64).clamp(-90.0, 90.0).to_radians());
    [DVec3::X, DVec3::Z, DVec3::Y].map(|axis| (azimuth * elevation * axis).as_vec3().to_array())
}

/// The nearest of the directions that tables are made for.
fn table_direction(direction: [f32; 3]) -> [f32; 3] {
    unit(direction.map(|c| (c * SUN_DIRECTIONS).round() / SUN_DIRECTIONS))
}

/// The direction of `v`; straight up where it has none.
fn unit(v: [f32; 3]) -> [f32; 3] {
    Vec3::from_array(v).try_normalize().unwrap_or(Vec3::Z).to_array()
}

/// A number that tells volumes apart: a hash of grid and extinction. The displacement is left out, nothing kept depends on it.
pub fn fingerprint(volume: &CloudVolume) -> u64 {
    let mut sums = [
        0x9e37_79b9_7f4a_7c15u64,
        0xc2b2_ae3d_27d4_eb4f,
        0x1656_67b1_9e37_79f9,
        0x27d4_eb2f_1656_67c5,
    ];
    let mix = |sum: &mut u64, bits: u32| *sum = (sum.rotate_left(5) ^ bits as u64).wrapping_mul(0x9fb2_1c65_1e98_df25);
    for a in 0..3 {
        mix(&mut sums[a], volume.grid.cells[a] as u32);
        mix(&mut sums[a], volume.grid.cell_size_m[a].to_bits());
    }
    mix(&mut sums[3], volume.cloudy_levels[0] as u32);
    mix(&mut sums[3], volume.cloudy_levels[1] as u32);
    let mut quads = volume.extinction_per_m.chunks_exact(4);
    for quad in &mut quads {
        for (sum, v) in sums.iter_mut().zip(quad) {
            mix(sum, v.to_bits());
        }
    }
    for v in quads.remainder() {
        mix(&mut sums[0], v.to_bits());
    }
    sums.iter()
        .fold(1, |h, s| (h ^ s).wrapping_mul(0x9fb2_1c65_1e98_df25).rotate_left(29))
        .max(1)
}

/// The levels of a volume that hold cloud, cleaned, with one empty level below and above (at the ground the cloud goes on below), and
/// the grid of points that the shape is made on.
#[derive(Clone, Debug)]
pub struct Slab {
    /// Cells east, north, and levels.
    pub cells: [usize; 3],
    /// Cell sizes, m.
    pub cell_size_m: [f32; 3],
    /// Points along an edge of a cell.
    pub finer: usize,
    /// Lowest height with cloud, m.
    pub bottom_m: f32,
    /// Highest height with cloud, m.
    pub top_m: f32,
    /// Largest extinction, 1/m.
    pub largest_per_m: f32,
    /// Extinction at cell centres, `[level][y][x]`, 1/m.
    pub extinction_per_m: Vec<f32>,
}

impl Slab {
    /// The slab of `volume`; none if it holds no cloud or if its numbers do not fit its grid. What is not finite or is negative counts as
    /// empty.
    pub fn new(volume: &CloudVolume) -> Option<Slab> {
        let grid = &volume.grid;
        let [nx, ny, nz] = grid.cells;
        let [k0, k1] = [volume.cloudy_levels[0], volume.cloudy_levels[1].min(nz)];
        let sizes_ok = grid.cell_size_m.iter().all(|s| s.is_finite() && *s > 0.0);
        if k0 >= k1 || nx == 0 || ny == 0 || volume.extinction_per_m.len() != grid.len() || !sizes_ok {
            return None;
        }
        let plane = grid.plane();
        let levels = k1 - k0 + 2;
        let mut extinction_per_m = vec![0.0f32; levels * plane];
        let mut largest_per_m = 0.0f32;
        for level in 0..levels {
            let k = (k0 + level).saturating_sub(1);
            if (k >= k0 || k0 == 0) && k < k1 {
                let from = &volume.extinction_per_m[k * plane..][..plane];
                for (to, v) in extinction_per_m[level * plane..][..plane].iter_mut().zip(from) {
                    *to = if v.is_finite() && *v > 0.0 {
                        v.min(EXTINCTION_MAX_PER_M)
                    } else {
                        0.0
                    };
                    largest_per_m = largest_per_m.max(*to);
                }
            }
        }
        let bottom_m = (k0 as f32 - 1.0) * grid.cell_size_m[2];
        (largest_per_m > 0.0).then(|| Slab {
            cells: [nx, ny, levels],
            cell_size_m: grid.cell_size_m,
            finer: if extinction_per_m.len() <= FINER_CELLS_MAX {
                2
            } else {
                1
            },
            bottom_m,
            top_m: bottom_m + levels as f32 * grid.cell_size_m[2],
            largest_per_m,
            extinction_per_m,
        })
    }
    /// Points east, north, up.
    pub fn points(&self) -> [usize; 3] {
        self.cells.map(|n| n * self.finer)
    }
    /// Distance between points, m.
    pub fn point_spacing_m(&self) -> [f32; 3] {
        self.cell_size_m.map(|s| s / self.finer as f32)
    }
    /// Amplitude a unit of the packed 16 bits, 1/m.
    pub fn amplitude_unit_per_m(&self) -> f32 {
        self.largest_per_m / 65_535.0
    }
    /// One over the periods in x and y, 1/m.
    pub fn per_period(&self) -> [f32; 2] {
        [0, 1].map(|a| 1.0 / (self.cells[a] as f32 * self.cell_size_m[a]))
    }
}
