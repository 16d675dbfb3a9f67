//! Pictures on the CPU device: from a cloud volume and a camera to RGB bytes.
//!
//! Stages in order: `shape` with `occupancy`, `detail_noise`, the light stages of [`crate::cpu::light`], then for each packet of rays `march`
//! with `ground`, `haze` and `tone_map`. Tables are kept in [`Prepared`] and made again only when what they depend on changes.
//! The same input gives the same bytes whatever the number of threads.

pub mod detail_noise;
pub mod ground;
pub mod haze;
pub mod lanes;
pub mod march;
pub mod occupancy;
pub mod shape;
pub mod tone_map;

use glam::{DQuat, DVec3, Vec3};
use rayon::prelude::*;

use crate::CloudVolume;
use crate::cpu::light::Atmosphere;
use crate::cpu::light::multiple_scattering_table::MultipleScatteringTable;
use crate::cpu::light::phase::Droplets;
use crate::cpu::light::sky_light::SkyLight;
use crate::cpu::light::sky_table::SkyTable;
use crate::cpu::light::sky_visibility::sky_visibility;
use crate::cpu::light::sun_optical_depth::SunLight;
use crate::cpu::light::transmittance_table::TransmittanceTable;
use detail_noise::{DetailNoise, TILE_BILLOWS};
pub use ground::Ground;
use haze::Haze;
use march::{Frame, FrameDetail, OCTAVES_MAX, PACKET_ROWS};
use shape::Shape;

/// Diameter of droplets for the phase function, micrometres.
const DROPLET_DIAMETER_UM: f32 = 18.0;
/// Steps a unit in each component of the sun's direction that tables are made for.
const SUN_DIRECTIONS: f32 = 1024.0;
/// Lowest height of a camera above the ground, m.
const CAMERA_LOWEST_M: f32 = 1.5;
/// Greatest height of a camera, m.
const CAMERA_HIGHEST_M: f32 = 60_000.0;

/// Detail finer than the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detail {
    /// 0 leaves the grid's cloud as it is; 1 carves its edge most.
    pub strength: f32,
    /// Size of the largest detail, m.
    pub scale_m: f32,
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
    /// What lies under the clouds.
    pub ground: Ground,
    /// Whether clouds shade the ground.
    pub cloud_shadow: bool,
    /// Horizontal visibility near the ground, m; none draws no haze between camera and cloud.
    pub visibility_m: Option<f32>,
    /// Shifts the detail noise.
    pub seed: u32,
    /// Height of the ground above mean sea level, m.
    pub surface_altitude_m: f32,
}

/// Tables kept from one picture to the next.
#[derive(Default)]
pub struct Prepared {
    noise: Option<DetailNoise>,
    air: Option<(Atmosphere, TransmittanceTable, MultipleScatteringTable)>,
    sky: Option<(SkyKey, SkyTable)>,
    light: Option<(LightKey, SkyLight)>,
    shape: Option<(u64, Option<CloudShape>)>,
    sun_light: Option<(SunLightKey, SunLight)>,
}

struct CloudShape {
    shape: Shape,
    visibility: [Vec<f32>; 2],
}

/// Air, sun and camera height.
type SkyKey = (Atmosphere, [f32; 3], f32);
/// Air, ground, sun, the cloud's base and top.
type LightKey = (Atmosphere, Ground, [f32; 3], [f32; 2]);
/// Volume, whether carved, sun.
type SunLightKey = (u64, bool, [f32; 3]);

impl Prepared {
    /// Nothing made yet.
    pub fn new() -> Prepared {
        Prepared::default()
    }
}

/// Draws a picture: RGB, `width * height * 3` bytes, sRGB, rows from top to bottom. An empty volume gives what none gives.
pub fn render(volume: Option<&CloudVolume>, settings: &ViewSettings, prepared: &mut Prepared) -> Vec<u8> {
    render_watched(volume, settings, prepared, &mut |_| {})
}

/// As [`render`], and calls `after` with a stage's name when the stage has run, so that a caller with a clock can tell what each
/// costs. `march` includes what runs within it: ground, haze, tone map.
pub fn render_watched(
    volume: Option<&CloudVolume>,
    settings: &ViewSettings,
    prepared: &mut Prepared,
    after: &mut dyn FnMut(&'static str),
) -> Vec<u8> {
    let (width, height) = (settings.width, settings.height);
    let mut picture = vec![0u8; width * height * 3];
    if picture.is_empty() {
        return picture;
    }
    let finite = |v: f32, or: f32| if v.is_finite() { v } else { or };
    let position_m = [
        finite(settings.camera_position_m[0], 0.0).clamp(-1e6, 1e6),
        finite(settings.camera_position_m[1], 0.0).clamp(-1e6, 1e6),
        finite(settings.camera_position_m[2], CAMERA_LOWEST_M).clamp(CAMERA_LOWEST_M, CAMERA_HIGHEST_M),
    ];
    let sun = unit(settings.sun_direction.map(|v| finite(v, 0.0).clamp(-1e6, 1e6)));

    if prepared.noise.is_none() {
        prepared.noise = Some(DetailNoise::new());
        after("detail_noise");
    }
    let key = Atmosphere::new(settings.surface_altitude_m, settings.visibility_m);
    if prepared.air.as_ref().is_none_or(|(air, ..)| *air != key) {
        let transmittance = TransmittanceTable::new(&key);
        after("transmittance_table");
        let multiple = MultipleScatteringTable::new(&key, &transmittance);
        after("multiple_scattering_table");
        prepared.air = Some((key, transmittance, multiple));
    }
    let (Some(noise), Some((air, transmittance, multiple))) = (&prepared.noise, &prepared.air) else {
        return picture;
    };

    let cloud_key = volume.map_or(0, fingerprint);
    if prepared.shape.as_ref().is_none_or(|(k, _)| *k != cloud_key) {
        let shape = volume.and_then(Shape::new).map(|shape| {
            after("shape");
            let grid = volume.map(|v| v.grid).unwrap_or(crate::Grid {
                cells: [1; 3],
                cell_size_m: [1.0; 3],
            });
            let visibility = sky_visibility(&shape.slab_per_m, [grid.cells[0], grid.cells[1]], grid.cell_size_m);
            after("sky_visibility");
            CloudShape { shape, visibility }
        });
        prepared.shape = Some((cloud_key, shape));
    }
    let cloud = prepared.shape.as_ref().and_then(|(_, shape)| shape.as_ref());

    // Tables are made for the nearest of directions a twentieth of a degree apart: a sun that creeps with the clock keeps them for a
    // while. The disc and the phase functions see the sun where it is.
    let table_sun = unit(sun.map(|c| (c * SUN_DIRECTIONS).round() / SUN_DIRECTIONS));
    let sky_key = (*air, table_sun, position_m[2]);
    if prepared.sky.as_ref().is_none_or(|(k, _)| *k != sky_key) {
        prepared.sky = Some((
            sky_key,
            SkyTable::new(air, transmittance, multiple, table_sun, position_m[2]),
        ));
        after("sky_table");
    }
    let base_top = cloud.map_or([0.0, 1_000.0], |c| [c.shape.bottom_m.max(1.0), c.shape.top_m]);
    let light_key = (*air, settings.ground, table_sun, base_top);
    if prepared.light.as_ref().is_none_or(|(k, _)| *k != light_key) {
        prepared.light = Some((
            light_key,
            SkyLight::new(
                air,
                transmittance,
                multiple,
                settings.ground.albedo(),
                table_sun,
                base_top,
            ),
        ));
        after("sky_light");
    }
    let detail = settings.detail.filter(|d| d.strength > 0.0 && d.strength.is_finite());
    if let Some(cloud) = cloud {
        let key = (cloud_key, detail.is_some(), table_sun);
        if prepared.sun_light.as_ref().is_none_or(|(k, _)| *k != key) {
            let sun_light = SunLight::new(&cloud.shape, &cloud.visibility, detail.is_some(), table_sun);
            prepared.sun_light = Some((key, sun_light));
            after("sun_optical_depth");
        }
    }
    let (Some((_, sky)), Some((_, light))) = (&prepared.sky, &prepared.light) else {
        return picture;
    };

    let luminance = |c: [f32; 3]| 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
    let on_ground = luminance(light.sun_at_ground) * sun[2].max(0.0) + luminance(light.sky_irradiance);
    let fov = finite(settings.vertical_fov_deg, 60.0).clamp(0.1, 170.0).to_radians();
    let frame = Frame {
        width,
        height,
        position_m,
        axes: axes(finite(settings.azimuth_deg, 0.0), finite(settings.elevation_deg, 0.0)),
        half_height: (0.5 * fov).tan(),
        sun_direction: sun,
        exposure: tone_map::exposure(on_ground, settings.exposure_ev),
        sky,
        light,
        haze: Haze::new(air, position_m[2]),
        haze_on_cloud: settings.visibility_m.is_some(),
        cloud: cloud.and_then(|c| prepared.sun_light.as_ref().map(|(_, s)| (&c.shape, s))),
        ground: settings.ground,
        shadow: settings.cloud_shadow,
        noise,
        detail: detail.map(|d| frame_detail(d, volume.map_or([0.0; 3], |v| v.air_displacement_m), settings.seed)),
        octaves: (settings.multiple_scattering_octaves as usize).min(OCTAVES_MAX),
        droplets: Droplets::new(DROPLET_DIAMETER_UM),
        sun_disc: transmittance.of_sun(position_m[2], sun[2]),
    };
    picture
        .par_chunks_mut(PACKET_ROWS * width * 3)
        .enumerate()
        .for_each(|(n, rows)| march::draw_rows(&frame, n * PACKET_ROWS, rows));
    after("march");
    picture
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

/// The direction of `v`; straight up where it has none.
fn unit(v: [f32; 3]) -> [f32; 3] {
    Vec3::from_array(v).try_normalize().unwrap_or(Vec3::Z).to_array()
}

/// A number that tells volumes apart: a hash of grid and extinction. The displacement is left out, nothing kept depends on it.
fn fingerprint(volume: &CloudVolume) -> u64 {
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
