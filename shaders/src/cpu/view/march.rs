//! Stage `march`: rays of view through sky, cloud and to the ground, sixteen at a time.
//!
//! Reads: [`Frame`]. Writes: rows of RGB bytes. Scheme: a packet is 4 x 4 pixels. Each ray is cut to the slab that holds cloud (the Earth curves
//! away by d^2 / 2R), leaps over empty space by [`Shape::empty_distance_m`], and in cloud takes steps of 15 m growing with
//! distance (or of the same optical depth, or logarithmic: [`crate::view::ViewSteps`]); a step's light is integrated in closed form (Hillaire 2015), its source looked up where the pattern's share of the step's light comes from, not of its way: so it is right for any source, and steps of one optical depth
//! make no light. The source is sunlight that passed the cloud (the stored
//! optical depth of the mean cloud, and while the ray is near and little dimmed two finer steps, of which what the detail adds to the mean is taken), scattered once by the droplets' phase function and further by
//! octaves (Wrenninge et al. 2013: each with half the extinction, a share of the light, a rounder phase), and the diffuse
//! light of sky and ground. In place of the stored depth there may be a march from each sample or a map of the sun's rays, in place of the octaves
//! multiple forward scattering, diffused light or that of fitted slabs: [`crate::view::Lighting`]. Octaves and diffused light are as strong as a level slab
//! that lets as much diffuse light pass can give back ([`crate::cpu::light::octave_shares`]); level slabs give back no more than comes in (`welkin ladder light` prints what leaves slabs, and balls). A ray ends below 1 % transmittance. The air between is put in once, at the mean distance of the light; the clouds' shadows in it
//! are stage `light_shafts`.
//!
//! Floor of the cost: a sample gathers 8 words of shape, 4 to 8 of noise, 8 of light, and with two finer steps 24 more: about 45
//! gathers of 16 lanes at 20 cycles and 900 vector operations at 2 a cycle, 1400 cycles a packet; a 640x360 picture is 14,400 packets
//! of some 20 samples, 4e8 cycles or 50 ms on two cores at 4 GHz. Measured on such a machine: 200 to 340 ms of processor time for views
//! filled with cloud, so two to three times the floor: the compiler loads the lanes' words one by one and spills some packets.
//! Light is made apart from the way ([`super::cloud_light`]), so that lanes whose rays are in no cloud cost none: 0.7 of the time that both took together for a broken field, 0.97 for a view filled with cloud.

use multiversion::multiversion;

use super::cloud_light::Noted;
use super::detail_noise::DetailNoise;
use super::ground::Ground;
use super::haze::Haze;
use super::lanes::{LANES, Lanes};
use super::shape::{CARVE_EDGE, Shape};
use super::{ground, light_shafts, tone_map};
use crate::cpu::light::atmosphere::EARTH_RADIUS_M;
use crate::cpu::light::diffusion::Diffuse;
use crate::cpu::light::march_phase::MarchPhase;
use crate::cpu::light::moon::MoonDisc;
use crate::cpu::light::octave_balance::OctaveBalance;
use crate::cpu::light::sky_light::SkyLight;
use crate::cpu::light::sky_table::SkyTable;
use crate::cpu::light::slab_fit::SlabFit;
use crate::cpu::light::stars::StarField;
use crate::cpu::light::sun_map::SunMap;
use crate::cpu::light::sun_optical_depth::SunLight;
use crate::cpu::light::transmittance_table::SUN_ANGULAR_RADIUS;
use crate::view::FrameDetail;

/// Rows of a packet, and of what one call draws.
pub const PACKET_ROWS: usize = 4;
crate::constants! {
    /// Octaves at most.
    pub const OCTAVES_MAX: usize = 8;
    /// No cloud is drawn beyond, m; it fades out from the second one on.
    pub(crate) const DRAW_DISTANCE_M: f32 = 60_000.0;
    const DRAW_FADES_FROM_M: f32 = 36_000.0;
    /// Rays stop here even when nothing is met, m.
    pub(crate) const SKY_DISTANCE_M: f32 = 300_000.0;
    /// Small billows are looked up a second time, smaller, nearer than this, m.
    pub(super) const NEAR_DETAIL_M: f32 = 3_500.0;
    /// How much smaller, and the share in the edge's push of its large and small billows.
    const DETAIL_FINER: f32 = 4.3;
    pub(crate) const DETAIL_FINE: f32 = 0.36;
    pub(crate) const DETAIL_FINEST: f32 = 0.24;
    /// Share of the small billows in the push, and the distance at which it is gone, m.
    pub(crate) const DETAIL_SMALL: f32 = 0.75;
    const DETAIL_SMALL_REACH_M: f32 = 14_000.0;
    /// One over the cover at which the push is whole: no cloud out of nothing.
    pub(crate) const DETAIL_HELD: f32 = 5.0;
    /// Width in cover of the ramp from empty to full of carved cloud.
    pub(crate) const CARVE_RAMP: f32 = 0.22;
    /// Length of steps: a share of the distance within bounds, m.
    const MARCH_STEP_GROWTH: f32 = 0.0055;
    const MARCH_STEP_LEAST_M: f32 = 15.0;
    const MARCH_STEP_MOST_M: f32 = 200.0;
    /// Steps by optical depth are no shorter than this, m, and no longer than so many of those by distance.
    const DEPTH_STEP_LEAST_M: f32 = 4.0;
    const DEPTH_STEP_LONGER: f32 = 4.0;
    /// Optical depth of a step below which where its light comes from is a series: its error is below that of the logarithm of numbers near 1.
    const THIN_STEP: f32 = 0.03;
    /// Length that logarithmic segments grow from, m.
    const SEGMENT_UNIT_M: f32 = 50.0;
    /// Steps at most.
    const MARCH_STEPS_MAX: u32 = 600;
    /// Transmittance at which a ray ends.
    const MARCH_THROUGH_END: f32 = 0.01;
    /// Share of light each octave keeps, and of asymmetry.
    pub(crate) const OCTAVE_CONTRIBUTION: f32 = 0.68;
    pub(crate) const OCTAVE_ECCENTRICITY: f32 = 0.75;
    /// Width of the sun's edge, pixels.
    pub(crate) const SUN_EDGE_PIXELS: f32 = 0.7;
    /// Interleaved gradient noise (Jimenez 2014).
    const PATTERN_X: f32 = 0.067_110_56;
    const PATTERN_Y: f32 = 0.005_837_15;
    const PATTERN_SCALE: f32 = 52.982_918;
}
/// The most that the noise can push the edge, a unit of [`FrameDetail::push`]: every billow half its range above the mean.
const PUSH_MOST: f32 = 0.5 * (1.0 + DETAIL_SMALL + DETAIL_FINE + DETAIL_FINEST);
/// What tells how much cloud lies towards the sun.
#[derive(Clone, Copy, Debug)]
pub enum Occlusion<'a> {
    /// The cloud's light and two finer steps.
    Grid,
    /// A march of so many steps.
    Steps(u32),
    /// A map.
    Map(&'a SunMap),
}

/// All that a picture needs, tables made.
pub struct Frame<'a> {
    /// Picture, pixels.
    pub width: usize,
    /// Picture, pixels.
    pub height: usize,
    /// Camera, m.
    pub position_m: [f32; 3],
    /// Unit vectors to the right, up and ahead.
    pub axes: [[f32; 3]; 3],
    /// Tangent of half the vertical angle of view.
    pub half_height: f32,
    /// Unit vector towards the sun.
    pub sun_direction: [f32; 3],
    /// Unit vector towards what throws shadows: the sun, by night the moon.
    pub beam_direction: [f32; 3],
    /// Multiplies radiance.
    pub exposure: f32,
    /// Clear sky from here, by the sun.
    pub sky: &'a SkyTable,
    /// The same by the moon.
    pub moon_sky: Option<&'a SkyTable>,
    /// The moon's disc.
    pub moon: Option<MoonDisc>,
    /// Stars.
    pub stars: Option<StarField<'a>>,
    /// Light for cloud and ground.
    pub light: &'a SkyLight,
    /// Air between; none leaves the cloud clear.
    pub haze: Haze,
    /// Whether haze lies between camera and cloud.
    pub haze_on_cloud: bool,
    /// Cloud, if there is any.
    pub cloud: Option<(&'a Shape, &'a SunLight)>,
    /// What lies under the clouds.
    pub ground: Ground,
    /// Whether the ground shows the clouds' shadow.
    pub shadow: bool,
    /// Where rays look into cloud, as [`crate::view::Look::steps`].
    pub steps: (f32, u32),
    /// Samples of the shadows in the air along a ray; 0 where they are not wanted.
    pub shaft_samples: u32,
    /// Noise tile.
    pub noise: &'a DetailNoise,
    /// Detail, if wanted.
    pub detail: Option<FrameDetail>,
    /// Octaves after the first.
    pub octaves: usize,
    /// How light is turned.
    pub phase: &'a MarchPhase,
    /// What tells how much cloud lies towards the sun.
    pub occlusion: Occlusion<'a>,
    /// Diffuse light in the cloud, in place of octaves.
    pub diffuse: Option<&'a Diffuse>,
    /// What keeps octaves to the light that there is.
    pub balance: Option<&'a OctaveBalance>,
    /// Light of slabs fitted to the cloud, in place of octaves.
    pub slab: Option<&'a SlabFit>,
    /// Sun at the disc: transmittance towards it from the camera.
    pub sun_disc: [f32; 3],
}

impl Frame<'_> {
    /// The clear sky's radiance in 16 directions.
    #[inline(always)]
    pub(crate) fn sky_look(&self, direction: &[Lanes; 3]) -> [Lanes; 3] {
        let mut light = self.sky.look(direction);
        if let Some(moon) = self.moon_sky {
            let more = moon.look(direction);
            for c in 0..3 {
                light[c] = light[c] + more[c];
            }
        }
        light
    }
    /// Radiance of the sun's disc, the moon's and the stars in 16 directions, of those lanes where `open` is 1 and not 0.
    #[inline(always)]
    pub(crate) fn beyond_air(&self, d: &[Lanes; 3], open: Lanes) -> [Lanes; 3] {
        let (zero, one) = (Lanes::splat(0.0), Lanes::splat(1.0));
        let scale = 2.0 * self.half_height / self.height as f32;
        let edge = scale * SUN_EDGE_PIXELS;
        let mut light = [zero; 3];
        let sun = self.sun_direction;
        let turn = d[0] * sun[0] + d[1] * sun[1] + d[2] * sun[2];
        // The chord to the sun's centre is its angle for small angles.
        let angle = ((one - turn) * 2.0).sqrt();
        let disc = ((Lanes::splat(SUN_ANGULAR_RADIUS + edge * 0.5) - angle) * (1.0 / edge)).clamp(0.0, 1.0) * open;
        if disc.any_above(0.0) {
            let radiance = 1.0 / (std::f32::consts::PI * SUN_ANGULAR_RADIUS * SUN_ANGULAR_RADIUS);
            for c in 0..3 {
                light[c] = disc * (radiance * self.sun_disc[c]);
            }
        }
        let mut open = open;
        if let Some(moon) = &self.moon {
            let (own, covered) = moon.radiance(d, edge);
            for c in 0..3 {
                light[c] = light[c] + own[c] * open;
            }
            open = open * (one - covered);
        }
        if let Some(stars) = &self.stars {
            let own = stars.radiance(d, scale, open);
            for c in 0..3 {
                light[c] = light[c] + own[c];
            }
        }
        light
    }
}

/// Where a picture goes: whole rows, at most [`PACKET_ROWS`] of them.
pub(super) enum Out<'a> {
    /// RGB bytes.
    Bytes(&'a mut [u8]),
    /// Radiance of three colours, before exposure and tone map.
    Radiance(&'a mut [[f32; 3]]),
}

/// Draws rows `first_row ..` into `out` (RGB, whole rows, at most [`PACKET_ROWS`]).
pub fn draw_rows(frame: &Frame<'_>, first_row: usize, out: &mut [u8]) {
    march_rows(frame, first_row, Out::Bytes(out));
}

/// As [`draw_rows`], but gives radiance: three floats a pixel, before exposure and tone map.
pub fn radiance_rows(frame: &Frame<'_>, first_row: usize, out: &mut [[f32; 3]]) {
    march_rows(frame, first_row, Out::Radiance(out));
}

fn march_rows(frame: &Frame<'_>, first_row: usize, mut out: Out<'_>) {
    for first_column in (0..frame.width).step_by(LANES / PACKET_ROWS) {
        let rays = Rays::of_packet(frame, first_column, first_row);
        let met = if frame.cloud.is_some() {
            met_by(frame, &rays)
        } else {
            Met::NOTHING
        };
        finish_packet(frame, first_column, first_row, &met, &mut out);
    }
}

// What is compiled once for each instruction set: all pictures call these, a packet at a time.

/// What sixteen rays meet in the cloud; nothing where there is none.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
pub(super) fn met_by(frame: &Frame<'_>, rays: &Rays) -> Met {
    match frame.cloud {
        Some((shape, sun_light)) => {
            let (from, limit) = (Lanes::splat(0.0), Lanes::splat(f32::MAX));
            march::<false>(frame, shape, sun_light, rays, from, limit)
        }
        None => Met::NOTHING,
    }
}

/// The same, but for what lies behind `limit_m`; a step that reaches beyond is cut there.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
pub(super) fn met_before(frame: &Frame<'_>, rays: &Rays, limit_m: &Lanes) -> Met {
    match frame.cloud {
        Some((shape, sun_light)) => march::<true>(frame, shape, sun_light, rays, Lanes::splat(0.0), *limit_m),
        None => Met::NOTHING,
    }
}

/// The same of what lies beyond `from_m`.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
pub(super) fn met_beyond(frame: &Frame<'_>, rays: &Rays, from_m: &Lanes) -> Met {
    match frame.cloud {
        Some((shape, sun_light)) => march::<false>(frame, shape, sun_light, rays, *from_m, Lanes::splat(f32::MAX)),
        None => Met::NOTHING,
    }
}

/// What lies behind the cloud of sixteen rays.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
pub(super) fn behind(frame: &Frame<'_>, rays: &Rays) -> Behind {
    Behind::new(frame, rays)
}

/// Sky, ground, haze and the picture's numbers of sixteen pixels whose cloud is known.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
pub(super) fn finish_packet(frame: &Frame<'_>, first_column: usize, first_row: usize, met: &Met, out: &mut Out<'_>) {
    let width = frame.width;
    let rays = Rays::of_packet(frame, first_column, first_row);
    let behind = behind(frame, &rays);
    let light = composed(frame, &rays, &behind, met);
    match out {
        Out::Bytes(bytes) => {
            let rgb = tone_map::tone_map(light, frame.exposure, rays.pattern);
            for l in 0..LANES {
                let (x, y) = (first_column + l % 4, l / 4);
                if x < width && (y + 1) * width * 3 <= bytes.len() {
                    for c in 0..3 {
                        bytes[(y * width + x) * 3 + c] = rgb[c].0[l] as u8;
                    }
                }
            }
        }
        Out::Radiance(values) => {
            for l in 0..LANES {
                let (x, at) = (first_column + l % 4, l / 4 * width + first_column + l % 4);
                if x < width && at < values.len() {
                    values[at] = [light[0].0[l], light[1].0[l], light[2].0[l]];
                }
            }
        }
    }
}

/// Sixteen rays of view.
pub(super) struct Rays {
    /// Unit vectors.
    pub(super) d: [Lanes; 3],
    /// Height along the ray: camera + d.z t + curve t^2.
    pub(super) curve: Lanes,
    /// 1 where the ground is met, else 0.
    down: Lanes,
    /// Distance at which the ground is met, or at which the ray ends in the sky, m.
    pub(super) end: Lanes,
    /// Cosine of what the beam is turned by towards the camera.
    pub(super) turn: Lanes,
    /// Pattern of the pixels: interleaved gradient noise (Jimenez 2014), for the march's start and against bands.
    pub(super) pattern: Lanes,
}

impl Rays {
    /// Through the pixels of a packet; those beyond the picture's edge are the last ones again.
    #[inline(always)]
    pub(super) fn of_packet(frame: &Frame<'_>, first_column: usize, first_row: usize) -> Rays {
        let px = Lanes::from_fn(|l| (first_column + l % 4).min(frame.width - 1) as f32 + 0.5);
        let py = Lanes::from_fn(|l| (first_row + l / 4).min(frame.height - 1) as f32 + 0.5);
        Rays::new(frame, px, py)
    }
    /// Through places of the picture, pixels from its upper left corner.
    #[inline(always)]
    pub(super) fn new(frame: &Frame<'_>, px: Lanes, py: Lanes) -> Rays {
        let one = Lanes::splat(1.0);
        let scale = 2.0 * frame.half_height / frame.height as f32;
        let sx = (px - frame.width as f32 * 0.5) * scale;
        let sy = (py - frame.height as f32 * 0.5) * -scale;
        let [right, up, ahead] = frame.axes;
        let mut d = [sx; 3];
        for a in 0..3 {
            d[a] = sx * right[a] + sy * up[a] + ahead[a];
        }
        let inverse = one / (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        for v in &mut d {
            *v = *v * inverse;
        }
        Rays::along(frame, d, px, py)
    }
    /// Along unit vectors; the pattern is that of pixels at these places.
    #[inline(always)]
    pub(super) fn along(frame: &Frame<'_>, d: [Lanes; 3], px: Lanes, py: Lanes) -> Rays {
        let zero = Lanes::splat(0.0);
        let one = Lanes::splat(1.0);
        let oz = frame.position_m[2];
        let curve = (one - d[2] * d[2]) * (0.5 / EARTH_RADIUS_M);
        let under_root = d[2] * d[2] - curve * (4.0 * oz);
        let down = Lanes::select_less(d[2], zero, Lanes::select_less(under_root, zero, zero, one), zero);
        let ground_at = Lanes::splat(2.0 * oz) / (under_root.sqrt() - d[2]).max(Lanes::splat(1e-9));
        let sky_end = Lanes::splat(SKY_DISTANCE_M);
        let beam = frame.beam_direction;
        Rays {
            curve,
            down,
            end: Lanes::select_less(zero, down, ground_at.min(sky_end), sky_end),
            turn: d[0] * beam[0] + d[1] * beam[1] + d[2] * beam[2],
            pattern: pattern(px, py),
            d,
        }
    }
}

/// Interleaved gradient noise (Jimenez 2014) of the pixels at these places, 0 to 1.
#[inline(always)]
pub(super) fn pattern(px: Lanes, py: Lanes) -> Lanes {
    let pattern = ((px * PATTERN_X + py * PATTERN_Y).fraction() * PATTERN_SCALE).fraction();
    pattern.clamp(0.0, 1.0)
}

/// What lies behind the cloud.
pub(super) struct Behind {
    /// Radiance of sky, ground, sun, moon and stars through the air.
    pub(super) light: [Lanes; 3],
    /// Radiance of the clear sky.
    sky: [Lanes; 3],
    /// Transmittance of the air to the ray's end.
    whole: [Lanes; 3],
}

impl Behind {
    /// Of sixteen rays.
    #[inline(always)]
    fn new(frame: &Frame<'_>, rays: &Rays) -> Behind {
        let zero = Lanes::splat(0.0);
        let one = Lanes::splat(1.0);
        let Rays { d, down, end, .. } = *rays;
        let [ox, oy, _] = frame.position_m;
        // The table's lower half holds no ground: a ray that just misses the ground must not look there.
        let above = d[2].max(Lanes::splat(frame.sky.horizon_sine + 2e-4));
        let sky = frame.sky_look(&[d[0], d[1], Lanes::select_less(zero, down, d[2], above)]);
        let whole = frame.haze.transmittance(end, d[2]);
        let mut light = sky;
        if down.any_above(0.0) {
            let cloud = if frame.shadow { frame.cloud } else { None };
            let (gx, gy) = (d[0] * end + ox, d[1] * end + oy);
            let mut land = ground::radiance(
                frame.ground,
                frame.light,
                cloud,
                frame.noise,
                frame.beam_direction,
                gx,
                gy,
                end,
            );
            if frame.ground == Ground::Sea {
                let mirrored = frame.sky_look(&ground::mirrored(&d));
                let share = ground::mirror_share(d[2]);
                for c in 0..3 {
                    land[c] = land[c].lerp(mirrored[c], share);
                }
            }
            for c in 0..3 {
                light[c] = light[c] + land[c] * whole[c] * down;
            }
        }
        let beyond = frame.beyond_air(&d, one - down);
        for c in 0..3 {
            light[c] = light[c] + beyond[c];
        }
        Behind { light, sky, whole }
    }
}

/// Radiance of sixteen rays: the cloud and the air before it over what lies behind.
#[inline(always)]
pub(super) fn composed(frame: &Frame<'_>, rays: &Rays, behind: &Behind, cloud: &Met) -> [Lanes; 3] {
    let zero = Lanes::splat(0.0);
    let one = Lanes::splat(1.0);
    let mut light = behind.light;
    if (one - cloud.through).any_above(0.0) {
        let kept = one - faded(cloud.distance_m);
        let between = frame.haze.transmittance(cloud.distance_m, rays.d[2]);
        for c in 0..3 {
            let (t, added) = if frame.haze_on_cloud {
                let share = (one - between[c]) / (one - behind.whole[c]).max(Lanes::splat(1e-6));
                (between[c], behind.sky[c] * share.min(one))
            } else {
                (one, zero)
            };
            let covered = (one - cloud.through) * added + cloud.light[c] * t + light[c] * cloud.through;
            light[c] = light[c].lerp(covered, kept);
        }
    }
    shaded(frame, rays, cloud, rays.end, &mut light);
    light
}

/// Takes from the light to `end_m` what the clouds' shadows in the air take.
#[inline(always)]
fn shaded(frame: &Frame<'_>, rays: &Rays, cloud: &Met, end_m: Lanes, light: &mut [Lanes; 3]) {
    let Some(shone_on) = frame.cloud.filter(|_| frame.shaft_samples > 0) else {
        return;
    };
    let taken = light_shafts::taken(frame, shone_on, rays, cloud, end_m);
    for c in 0..3 {
        light[c] = (light[c] - taken[c]).max(Lanes::splat(0.0));
    }
}

/// Light from before objects at `limit_m`, and the share of the objects' own light that passes cloud and air; three colours each.
#[inline(always)]
pub(super) fn composed_before(
    frame: &Frame<'_>,
    rays: &Rays,
    behind: &Behind,
    cloud: &Met,
    limit_m: Lanes,
) -> ([Lanes; 3], [Lanes; 3]) {
    let one = Lanes::splat(1.0);
    let kept = one - faded(cloud.distance_m);
    let (mut light, mut through) = ([one; 3], [one; 3]);
    let [to_cloud, to_object] = [cloud.distance_m, limit_m].map(|d| frame.haze.transmittance(d, rays.d[2]));
    for c in 0..3 {
        let air = |passed: Lanes| {
            if !frame.haze_on_cloud {
                return (one, Lanes::splat(0.0));
            }
            let share = (one - passed) / (one - behind.whole[c]).max(Lanes::splat(1e-6));
            (passed, behind.sky[c] * share.min(one))
        };
        let (cloud_passes, cloud_air) = air(to_cloud[c]);
        let (object_passes, object_air) = air(to_object[c]);
        let covered = (one - cloud.through) * cloud_air + cloud.light[c] * cloud_passes + object_air * cloud.through;
        light[c] = object_air.lerp(covered, kept);
        through[c] = object_passes.lerp(object_passes * cloud.through, kept);
    }
    shaded(frame, rays, cloud, limit_m, &mut light);
    (light, through)
}

/// How far cloud at a distance has faded: 0 to 1.
#[inline(always)]
pub(super) fn faded(distance_m: Lanes) -> Lanes {
    ((distance_m - DRAW_FADES_FROM_M) * (1.0 / (DRAW_DISTANCE_M - DRAW_FADES_FROM_M))).smoothstep()
}

/// What a packet met in the cloud.
#[derive(Clone, Copy)]
pub(super) struct Met {
    /// Radiance of the cloud, as if no air lay before it.
    pub(super) light: [Lanes; 3],
    /// Transmittance.
    pub(super) through: Lanes,
    /// Mean distance of the cloud, weighted by what it hides of what lies behind, m; 0 where there is none.
    pub(super) distance_m: Lanes,
}

impl Met {
    /// Of rays that meet none.
    pub(super) const NOTHING: Met = Met {
        light: [Lanes([0.0; LANES]); 3],
        through: Lanes([1.0; LANES]),
        distance_m: Lanes([0.0; LANES]),
    };
    /// Light, transmittance, distance.
    #[inline(always)]
    pub(super) fn numbers(&self) -> [Lanes; 5] {
        let [red, green, blue] = self.light;
        [red, green, blue, self.through, self.distance_m]
    }
    /// Takes over another packet's ray.
    #[inline(always)]
    pub(super) fn take(&mut self, lane: usize, other: &Met, from: usize) {
        for c in 0..3 {
            self.light[c].0[lane] = other.light[c].0[from];
        }
        self.through.0[lane] = other.through.0[from];
        self.distance_m.0[lane] = other.distance_m.0[from];
    }
}

/// Rays through the cloud from `from_m` on; `LIMITED` ones end at `limit_m`.
#[inline(always)]
fn march<const LIMITED: bool>(
    frame: &Frame<'_>,
    shape: &Shape,
    sun_light: &SunLight,
    rays: &Rays,
    from_m: Lanes,
    limit_m: Lanes,
) -> Met {
    let Rays {
        d,
        curve,
        end: ground_at,
        pattern,
        ..
    } = *rays;
    let zero = Lanes::splat(0.0);
    let one = Lanes::splat(1.0);
    let [ox, oy, oz] = frame.position_m;
    let (first, last) = slab(oz, d[2], curve, shape.bottom_m, shape.top_m);
    let end = last.min(ground_at).min(Lanes::splat(DRAW_DISTANCE_M));
    // Rays that never meet the slab still take part in the packet's arithmetic: from a finite place, or NaN would spread.
    let first = first.max(from_m).min(end.max(zero));
    let mut met = Met {
        light: [zero; 3],
        through: one,
        distance_m: zero,
    };
    if !(end - first).any_above(0.0) {
        return met;
    }
    let mut through = one;
    let (mut distance, mut weights) = (zero, zero);
    let mut noted = Noted::new();
    let (depth_of_step, segments) = frame.steps;
    // Logarithmic segments: where cloud was met first, and by which share of the way from there they grow.
    let (mut met_at, mut growth) = (Lanes::splat(f32::MAX), zero);
    let mut place = first + pattern * step_m(first);
    for _ in 0..MARCH_STEPS_MAX {
        let t = place;
        let alive = Lanes::select_less(
            t,
            end,
            Lanes::select_less(Lanes::splat(MARCH_THROUGH_END), through, one, zero),
            zero,
        );
        // A sample stands for a step around it: one whose step begins before the limit counts, from the limit's side.
        let begun = t - pattern * step_m(t);
        let alive = if LIMITED {
            Lanes::select_less(begun, limit_m, alive, zero)
        } else {
            alive
        };
        if !alive.any_above(0.0) {
            break;
        }
        let advanced = t;
        let t = if LIMITED { t.min(limit_m) } else { t };
        let p = [d[0] * t + ox, d[1] * t + oy, t * (d[2] + curve * t) + oz];
        let empty = shape.empty_distance_m(p[0], p[1], p[2]);
        let mut step = step_m(t);
        let here = Lanes::select_less(zero, empty, zero, alive);
        if here.any_above(0.0) {
            let close = Lanes::select_less(zero, here, t, Lanes::splat(f32::MAX)).smallest();
            let extinction = extinction(frame, shape, &p, t, close) * here;
            if segments > 0 {
                let whole = ((end - t).max(zero) * (1.0 / SEGMENT_UNIT_M) + 1.0).powf(1.0 / segments as f32) - 1.0;
                let new = Lanes::select_less(t, met_at, here, zero);
                growth = Lanes::select_less(zero, new, whole, growth);
                met_at = Lanes::select_less(zero, new, t, met_at);
                let segment = (t - met_at + SEGMENT_UNIT_M) * growth;
                step = Lanes::select_less(zero, here, segment.max(Lanes::splat(1.0)), step);
            } else if depth_of_step > 0.0 {
                let even = Lanes::splat(depth_of_step) / extinction.max(Lanes::splat(1e-9));
                let bounded = even.max(Lanes::splat(DEPTH_STEP_LEAST_M)).min(step * DEPTH_STEP_LONGER);
                step = Lanes::select_less(zero, extinction, bounded, step);
            }
            if extinction.any_above(0.0) {
                let length = if LIMITED { step.min(limit_m - begun) } else { step };
                let kept = (extinction * length * -std::f32::consts::LOG2_E).exp2();
                let share = through * (one - kept);
                // Where the step's light comes from: more of it from the front.
                let lit = (t + length * (place_of_light(pattern, extinction * length, kept) - pattern)).max(first);
                noted.add(frame, (shape, sun_light), rays, lit, through, share);
                distance = distance + share * t;
                weights = weights + share;
                through = through * kept;
            }
        }
        // A ray that has ended goes on with its packet: bounded, for farther and farther from the slab it would leap to infinity.
        let leap = Lanes::select_less(zero, empty, step.max(empty), step);
        place = (advanced + leap).min(Lanes::splat(2.0 * DRAW_DISTANCE_M));
    }
    met.light = noted.light(frame, (shape, sun_light), rays);
    // Divided, so that a ray that met nothing keeps exactly 1 and costs no haze.
    met.through = ((through - MARCH_THROUGH_END) / Lanes::splat(1.0 - MARCH_THROUGH_END)).clamp(0.0, 1.0);
    met.distance_m = distance / weights.max(Lanes::splat(1e-6));
    met
}

/// The share of a step's length, even in extinction, of optical depth `depth` and passed by `kept` of the light, before which the share `part` lies of the light that reaches the camera from it.
#[inline(always)]
fn place_of_light(part: Lanes, depth: Lanes, kept: Lanes) -> Lanes {
    let thick = (Lanes::splat(1.0) - part * (Lanes::splat(1.0) - kept)).log2() * -std::f32::consts::LN_2;
    let thin = part - depth * part * (Lanes::splat(1.0) - part) * 0.5;
    Lanes::select_less(
        depth,
        Lanes::splat(THIN_STEP),
        thin,
        thick / depth.max(Lanes::splat(THIN_STEP)),
    )
}

/// Length of a step in cloud at distance `t`, m.
#[inline(always)]
fn step_m(t: Lanes) -> Lanes {
    (t * MARCH_STEP_GROWTH).clamp(MARCH_STEP_LEAST_M, MARCH_STEP_MOST_M)
}

/// First and last distance at which a ray is between two heights; heights in between may be left for a while.
#[inline(always)]
pub(crate) fn slab(from_m: f32, rise: Lanes, curve: Lanes, bottom_m: f32, top_m: f32) -> (Lanes, Lanes) {
    let zero = Lanes::splat(0.0);
    let never = Lanes::splat(f32::MAX);
    let (top_real, top_first, top_last) = roots(rise, curve, from_m - top_m);
    let (bottom_real, _, bottom_last) = roots(rise, curve, from_m - bottom_m);
    if from_m > top_m {
        // Into the slab from above, if at all.
        let hit = Lanes::select_less(
            zero,
            top_real,
            Lanes::select_less(zero, top_first, top_first, never),
            never,
        );
        (hit, Lanes::select_less(zero, top_real, top_last, zero))
    } else if from_m < bottom_m {
        // From below a ray comes up once: the earth falls away under it.
        (
            Lanes::select_less(zero, bottom_real, bottom_last.max(zero), zero),
            top_last,
        )
    } else {
        (zero, top_last)
    }
}

/// Roots of `curve t^2 + rise t + gap = 0`, the smaller and the larger, after what is under the root.
#[inline(always)]
fn roots(rise: Lanes, curve: Lanes, gap: f32) -> (Lanes, Lanes, Lanes) {
    let zero = Lanes::splat(0.0);
    let under = rise * rise - curve * (4.0 * gap);
    let root = under.sqrt();
    let q = Lanes::select_less(rise, zero, root - rise, zero - root - rise) * 0.5;
    let a = q / curve.max(Lanes::splat(1e-12));
    let b = Lanes::splat(gap) / Lanes::select_less(q * q, Lanes::splat(1e-12), Lanes::splat(1e-6), q);
    (under, a.min(b), a.max(b))
}

/// Extinction with detail, 1/m.
#[inline(always)]
pub(super) fn extinction(frame: &Frame<'_>, shape: &Shape, p: &[Lanes; 3], t: Lanes, close_m: f32) -> Lanes {
    detailed_extinction(shape, frame.noise, frame.detail, p, t, close_m)
}

/// The same at places `t` from the camera, of which none is closer than `close_m`.
#[inline(always)]
pub(crate) fn detailed_extinction(
    shape: &Shape,
    noise: &DetailNoise,
    detail: Option<FrameDetail>,
    p: &[Lanes; 3],
    t: Lanes,
    close_m: f32,
) -> Lanes {
    let (cover, amplitude) = shape.sample(p[0], p[1], p[2]);
    match detail {
        Some(detail) => carved_extinction(noise, &detail, [cover, amplitude], p, t, close_m),
        None => amplitude * cover,
    }
}

/// Extinction that the detail makes of a cover and an amplitude.
#[inline(always)]
pub(super) fn carved_extinction(
    noise: &DetailNoise,
    detail: &FrameDetail,
    [cover, amplitude]: [Lanes; 2],
    p: &[Lanes; 3],
    t: Lanes,
    close_m: f32,
) -> Lanes {
    let plain = amplitude * cover;
    // Where no noise could push the edge so far out there is nothing to look up: carved cloud is 0 there.
    // The factor keeps rounding from telling this from the whole way, which other rays of the packet may ask for.
    if !cover.any_above(0.999 * CARVE_EDGE / (1.0 + PUSH_MOST * DETAIL_HELD * detail.push)) {
        return plain.lerp(Lanes::splat(0.0), Lanes::splat(detail.blend));
    }
    let mut q = *p;
    for a in 0..3 {
        q[a] = (p[a] + detail.offset_m[a]) * detail.tiles_per_m;
    }
    let (large, small) = noise.look(q[0], q[1], q[2]);
    let one = Lanes::splat(1.0);
    let far = (t * (1.0 / DETAIL_SMALL_REACH_M)).clamp(0.0, 1.0);
    let mut push = (large - 0.5) + (small - 0.5) * DETAIL_SMALL * (one - far);
    if close_m < NEAR_DETAIL_M {
        let (fine, finest) = noise.look(q[1] * DETAIL_FINER, q[2] * DETAIL_FINER, q[0] * DETAIL_FINER);
        let near = (one - t * (1.0 / NEAR_DETAIL_M)).clamp(0.0, 1.0);
        push = push + ((fine - 0.5) * DETAIL_FINE + (finest - 0.5) * DETAIL_FINEST) * near;
    }
    let held = (cover * DETAIL_HELD).clamp(0.0, 1.0);
    let level = cover + push * detail.push * held - CARVE_EDGE;
    let carved = amplitude * (level * (1.0 / CARVE_RAMP)).smoothstep();
    plain.lerp(carved, Lanes::splat(detail.blend))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The pattern is blue noise: means over blocks of pixels, which an eye sees as grain, scatter far less than those of independent numbers would.
    #[test]
    fn the_pattern_is_blue() {
        for side in [8usize, 16, 32] {
            let mut squares = 0.0;
            for block in 0..64 {
                let (left, top) = (block % 8 * side, block / 8 * side);
                let values = (0..side * side).map(|n| {
                    let place = [left + n % side, top + n / side].map(|v| Lanes::splat(v as f32 + 0.5));
                    f64::from(pattern(place[0], place[1]).0[0]) - 0.5
                });
                squares += (values.sum::<f64>() / (side * side) as f64).powi(2) / 64.0;
            }
            let independent = 1.0 / 12.0 / (side * side) as f64;
            // Measured: 0.75, 0.66, 0.67 over the side; numbers spread evenly from 0 to 1 have a variance of 1/12.
            assert!(
                squares * (side as f64) < independent,
                "{side}: {}",
                squares / independent
            );
        }
    }

    /// Half of a step's light comes from before its median, by f64's logarithm; a clear step's from its first half; and the mean of any source over the parts is what the step's equation gives.
    #[test]
    fn a_steps_light_is_looked_up_where_it_comes_from() {
        for depth in [1e-6f32, 0.01, 0.029, 0.031, 0.3, 1.0, 4.0, 12.0, 60.0] {
            let kept = f64::from(-depth).exp();
            let of =
                |part: f32| place_of_light(Lanes::splat(part), Lanes::splat(depth), Lanes::splat(kept as f32)).0[0];
            for n in 0..=100 {
                let part = n as f32 / 100.0 * 0.999;
                let truth = -(f64::from(part) * (kept - 1.0)).ln_1p() / f64::from(depth);
                let ours = f64::from(of(part));
                assert!((ours - truth).abs() < 1e-4, "{depth} {part}: {ours} {truth}");
                assert!((0.0..=1.0).contains(&ours), "{depth} {part}: {ours}");
            }
            // A source that falls as exp(-2 t) with the depth t: its integral has exp(-3 t) in place of exp(-t).
            let mean = (0..2000)
                .map(|n| (-2.0 * f64::from(depth) * f64::from(of((n as f32 + 0.5) / 2000.0))).exp() / 2000.0)
                .sum::<f64>();
            let truth = (1.0 - kept.powi(3)) / 3.0 / -(f64::from(-depth).exp_m1());
            assert!((mean / truth - 1.0).abs() < 2e-3, "{depth}: {mean} {truth}");
        }
    }
}
