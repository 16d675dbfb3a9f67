//! Pictures on the CPU device: from a cloud volume and a camera to RGB bytes.
//!
//! Stages in order: `shape` with `occupancy`, `detail_noise`, the light stages of [`crate::cpu::light`], then for each packet of rays `march` (its light is in [`cloud_light`])
//! with `ground`, `haze`, `light_shafts` and `tone_map`, or for fewer pixels with `upsample` or `reproject`. Tables are kept in [`Prepared`] and made again only when what they depend on changes.
//! The same input gives the same bytes whatever the number of threads.

pub mod cloud_light;
pub mod detail_noise;
pub mod ground;
pub mod haze;
pub mod impostors;
pub mod lanes;
pub mod layers;
pub mod light_shafts;
pub mod march;
pub mod occupancy;
pub mod reproject;
pub mod shape;
pub mod tone_map;
pub mod upsample;

use rayon::prelude::*;

use crate::CloudVolume;
use crate::cpu::light::Atmosphere;
use crate::cpu::light::diffusion::Diffuse;
use crate::cpu::light::march_phase::MarchPhase;
use crate::cpu::light::moon::MoonDisc;
use crate::cpu::light::multiple_scattering_table::MultipleScatteringTable;
use crate::cpu::light::octave_balance::OctaveBalance;
use crate::cpu::light::path_tracer::volume::{self, Skies};
use crate::cpu::light::path_tracer::{Film, Scatterer};
use crate::cpu::light::phase_table::PhaseChoice;
use crate::cpu::light::sky_light::{SKY_LIGHT_HEIGHT_M, SkyLight};
use crate::cpu::light::sky_table::SkyTable;
use crate::cpu::light::sky_visibility::sky_visibility;
use crate::cpu::light::slab_collector::collected;
use crate::cpu::light::slab_fit::SlabFit;
use crate::cpu::light::slab_tables::SlabSources;
use crate::cpu::light::stars::{StarField, StarTable};
use crate::cpu::light::sun_map::SunMap;
use crate::cpu::light::sun_optical_depth::SunLight;
use crate::cpu::light::transmittance_table::TransmittanceTable;
use crate::view::{
    BalanceKey, DiffuseKey, LightKey, Look, PhaseKey, SkyKey, SlabKey, SunLightKey, SunMapKey, fingerprint,
};
pub use crate::view::{
    Detail, Ground, Lighting, MapKind, MoonPlace, Scattering, StarPlaces, SunOcclusion, ViewSampling, ViewSettings,
};
use detail_noise::DetailNoise;
use haze::Haze;
use lanes::Lanes;
use layers::Layer;
use march::{Frame, Occlusion, Out, PACKET_ROWS};
use reproject::History;
use shape::Shape;
use tone_map::luminance;
use upsample::Samples;

/// Tables kept from one picture to the next.
#[derive(Default)]
pub struct Prepared {
    noise: Option<DetailNoise>,
    scatterer: Option<(PhaseChoice, Scatterer)>,
    skies: Option<(LightKey, Skies)>,
    phase: Option<(PhaseKey, MarchPhase)>,
    air: Option<(Atmosphere, TransmittanceTable, MultipleScatteringTable)>,
    sky: Option<(SkyKey, SkyTable, Option<SkyTable>)>,
    stars: Option<([f32; 2], StarTable)>,
    light: Option<(LightKey, SkyLight)>,
    shape: Option<(u64, Option<CloudShape>)>,
    sun_light: Option<(SunLightKey, SunLight)>,
    sun_map: Option<(SunMapKey, SunMap)>,
    diffuse: Option<(DiffuseKey, Diffuse)>,
    balance: Option<(BalanceKey, OctaveBalance)>,
    slab_sources: Option<(f32, Option<SlabSources>)>,
    slab: Option<(SlabKey, Option<SlabFit>)>,
    samples: Samples,
}

struct CloudShape {
    shape: Shape,
    visibility: [Vec<f32>; 2],
}

impl Prepared {
    /// Nothing made yet.
    pub fn new() -> Prepared {
        Prepared::default()
    }
    /// Rays that the last picture marched through the cloud.
    pub fn marched(&self) -> u64 {
        self.samples.marched()
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
    let width = settings.width;
    let mut picture = vec![0u8; width * settings.height * 3];
    if picture.is_empty() {
        return picture;
    }
    let look = prepare(volume, settings, prepared, after);
    let mut samples = std::mem::take(&mut prepared.samples);
    if let Some(frame) = prepared.frame(&look, settings) {
        if settings.sampling == ViewSampling::HalfResolution && frame.cloud.is_some() {
            upsample::march_samples(&frame, &mut samples);
            after("march");
            upsample::draw(&frame, &mut samples, Out::Bytes(&mut picture));
            after("upsample");
        } else {
            picture
                .par_chunks_mut(PACKET_ROWS * width * 3)
                .enumerate()
                .for_each(|(n, rows)| march::draw_rows(&frame, n * PACKET_ROWS, rows));
            samples.all_marched(&frame);
            after("march");
        }
    }
    prepared.samples = samples;
    picture
}

/// As [`render_watched`], but of a viewer who sees one picture after another: where the settings say so it builds on what the last one left in `history`.
pub fn render_live(
    volume: Option<&CloudVolume>,
    settings: &ViewSettings,
    history: &mut History,
    prepared: &mut Prepared,
    after: &mut dyn FnMut(&'static str),
) -> Vec<u8> {
    if !settings.sampling.builds_on_last() || settings.width * settings.height == 0 {
        return render_watched(volume, settings, prepared, after);
    }
    let look = prepare(volume, settings, prepared, after);
    let mut samples = std::mem::take(&mut prepared.samples);
    let mut picture = vec![0u8; settings.width * settings.height * 3];
    let frame = prepared.frame(&look, settings).filter(|frame| frame.cloud.is_some());
    let drawn = frame.is_some();
    if let Some(frame) = frame {
        let displacement_m = volume.map_or([0.0; 3], |v| v.air_displacement_m);
        if let Some(cell) = settings.sampling.cell() {
            reproject::draw(&frame, &look, displacement_m, cell, history, &mut samples, &mut picture);
            after("reproject");
        } else if let Some((shape, _)) = frame.cloud {
            let slab = [shape.bottom_m, shape.top_m];
            let weather = volume.map_or(0, fingerprint);
            let kept = &mut history.impostors;
            impostors::draw(
                &frame,
                &look,
                (slab, weather, displacement_m),
                kept,
                &mut samples,
                &mut picture,
            );
            after("impostors");
        }
    }
    prepared.samples = samples;
    if drawn {
        return picture;
    }
    // A sky without cloud leaves nothing to the next.
    history.forget();
    render_watched(volume, settings, prepared, after)
}

/// As [`render`], but gives radiance relative to the sun's irradiance above the air, three floats a pixel, before exposure and tone map.
pub fn radiance(volume: Option<&CloudVolume>, settings: &ViewSettings, prepared: &mut Prepared) -> Vec<[f32; 3]> {
    let width = settings.width;
    let mut pixels = vec![[0.0f32; 3]; width * settings.height];
    if pixels.is_empty() {
        return pixels;
    }
    let look = prepare(volume, settings, prepared, &mut |_| {});
    let mut samples = std::mem::take(&mut prepared.samples);
    if let Some(frame) = prepared.frame(&look, settings) {
        if settings.sampling == ViewSampling::HalfResolution && frame.cloud.is_some() {
            upsample::march_samples(&frame, &mut samples);
            upsample::draw(&frame, &mut samples, Out::Radiance(&mut pixels));
        } else {
            pixels
                .par_chunks_mut(PACKET_ROWS * width)
                .enumerate()
                .for_each(|(n, rows)| march::radiance_rows(&frame, n * PACKET_ROWS, rows));
            samples.all_marched(&frame);
        }
    }
    prepared.samples = samples;
    pixels
}

/// What a client needs to put objects into a picture (stage `layers`), a layer a pixel, rows from the top; `objects_m` holds the distance of its objects along each
/// pixel's ray, m, if it has any. Every pixel is marched, whatever the settings say.
pub fn layers(
    volume: Option<&CloudVolume>,
    settings: &ViewSettings,
    objects_m: Option<&[f32]>,
    prepared: &mut Prepared,
    after: &mut dyn FnMut(&'static str),
) -> Vec<Layer> {
    if settings.width * settings.height == 0 {
        return Vec::new();
    }
    let look = prepare(volume, settings, prepared, after);
    let frame = prepared.frame(&look, settings);
    let drawn = frame.map(|frame| layers::draw(&frame, objects_m)).unwrap_or_default();
    after("layers");
    drawn
}

/// Adds `samples` paths a pixel to a film of the same picture (stage `path_tracer`); `albedo` is the share of extinction by cloud that is scattering.
/// Of the view's lighting the phase function alone is looked at: a path scatters as often as it will.
pub fn path_trace(
    volume: Option<&CloudVolume>,
    settings: &ViewSettings,
    prepared: &mut Prepared,
    albedo: f64,
    film: &mut Film,
    samples: u32,
) {
    if settings.width * settings.height == 0 {
        return;
    }
    let look = prepare(volume, settings, prepared, &mut |_| {});
    let phase = settings.lighting.phase;
    if prepared.scatterer.as_ref().is_none_or(|(choice, _)| *choice != phase) {
        prepared.scatterer = Some((phase, Scatterer::new(phase)));
    }
    let (Some((air, transmittance, multiple)), Some((light_key, _))) = (&prepared.air, &prepared.light) else {
        return;
    };
    if prepared.skies.as_ref().is_none_or(|(key, _)| key != light_key) {
        let sources = look.sources();
        let at = |height_m: f32| {
            let table = |source, formula| SkyTable::new(air, transmittance, multiple, source, formula, height_m);
            let moon = sources.moon.as_ref().map(|(moon, _)| table(moon, None));
            (table(&sources.sun, sources.analytic.as_ref()), moon)
        };
        let [base_m, top_m] = light_key.3;
        let skies = Skies {
            at_ground: at(SKY_LIGHT_HEIGHT_M),
            at_clouds: at(0.5 * (base_m + top_m)),
        };
        prepared.skies = Some((*light_key, skies));
    }
    if let (Some(frame), Some((_, scatterer)), Some((_, skies))) =
        (prepared.frame(&look, settings), &prepared.scatterer, &prepared.skies)
    {
        volume::trace(&frame, skies, scatterer, albedo, film, samples);
    }
}

/// Bytes of radiances as [`render`] would have them, but for the pattern against bands.
pub fn developed(
    volume: Option<&CloudVolume>,
    settings: &ViewSettings,
    prepared: &mut Prepared,
    radiance: &[[f32; 3]],
) -> Vec<u8> {
    let look = prepare(volume, settings, prepared, &mut |_| {});
    let exposure = prepared.frame(&look, settings).map_or(1.0, |frame| frame.exposure);
    radiance
        .iter()
        .flat_map(|pixel| {
            let rgb = tone_map::tone_map(pixel.map(Lanes::splat), exposure, Lanes::splat(0.5));
            rgb.map(|c| c.0[0] as u8)
        })
        .collect()
}

/// Makes what a picture needs and is not there yet.
fn prepare(
    volume: Option<&CloudVolume>,
    settings: &ViewSettings,
    prepared: &mut Prepared,
    after: &mut dyn FnMut(&'static str),
) -> Look {
    let look = Look::new(settings, volume.map_or([0.0; 3], |v| v.air_displacement_m));
    if prepared.noise.is_none() {
        prepared.noise = Some(DetailNoise::new());
        after("detail_noise");
    }
    let key = look.air;
    if prepared.air.as_ref().is_none_or(|(air, ..)| *air != key) {
        let transmittance = TransmittanceTable::new(&key);
        after("transmittance_table");
        let multiple = MultipleScatteringTable::new(&key, &transmittance);
        after("multiple_scattering_table");
        prepared.air = Some((key, transmittance, multiple));
    }
    let Some((air, transmittance, multiple)) = &prepared.air else {
        return look;
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

    let sky_key = look.sky_key();
    let sources = look.sources();
    if prepared.sky.as_ref().is_none_or(|(k, ..)| *k != sky_key) {
        let table = |source, formula| SkyTable::new(air, transmittance, multiple, source, formula, look.position_m[2]);
        let moon = sources.moon.as_ref().map(|(moon, _)| table(moon, None));
        prepared.sky = Some((sky_key, table(&sources.sun, sources.analytic.as_ref()), moon));
        after("sky_table");
    }
    if let Some(places) = look.stars {
        let key = [places.faintest, places.years_since_2000];
        if prepared.stars.as_ref().is_none_or(|(k, _)| *k != key) {
            prepared.stars = Some((key, StarTable::new(places.faintest, places.years_since_2000)));
            after("stars");
        }
    }
    let light_key = look.light_key(cloud.map(|c| [c.shape.bottom_m, c.shape.top_m]));
    if prepared.light.as_ref().is_none_or(|(k, _)| *k != light_key) {
        let (.., base_top) = light_key;
        let albedo = settings.ground.albedo();
        let of = |source, formula| SkyLight::new(air, transmittance, multiple, albedo, source, formula, base_top);
        let mut light = of(&sources.sun, sources.analytic.as_ref());
        if let Some((moon, beam_share)) = &sources.moon {
            light = light.with_moon(&of(moon, None), *beam_share, albedo, moon.direction[2]);
        }
        prepared.light = Some((light_key, light));
        after("sky_light");
    }
    let phase_key = look.phase_key();
    if prepared.phase.as_ref().is_none_or(|(k, _)| *k != phase_key) {
        prepared.phase = Some((phase_key, MarchPhase::new(phase_key.0, phase_key.1, phase_key.2)));
        after("march_phase");
    }
    if let Some(cloud) = cloud {
        let key = look.sun_light_key(cloud_key);
        if prepared.sun_light.as_ref().is_none_or(|(k, _)| *k != key) {
            let carved = look.detail.is_some();
            let sun_light = SunLight::new(
                &cloud.shape,
                &cloud.visibility,
                carved,
                look.lit_everywhere(),
                look.table_beam,
            );
            prepared.sun_light = Some((key, sun_light));
            after("sun_optical_depth");
        }
        if let (Some(key), Some(noise)) = (look.sun_map_key(cloud_key), &prepared.noise)
            && prepared.sun_map.as_ref().is_none_or(|(k, _)| *k != key)
        {
            let (_, detail, kind, side, sun) = key;
            prepared.sun_map = Some((key, SunMap::new(&cloud.shape, noise, detail, kind, side, sun)));
            after("sun_map");
        }
        if let (Some(key), Some((_, sun_light)), Some((_, phase))) =
            (look.diffuse_key(cloud_key), &prepared.sun_light, &prepared.phase)
            && prepared.diffuse.as_ref().is_none_or(|(k, _)| *k != key)
        {
            let mut diffuse = prepared.diffuse.take().map(|(_, last)| last).unwrap_or_default();
            diffuse.make(&cloud.shape, sun_light, key.1, phase.asymmetry);
            prepared.diffuse = Some((key, diffuse));
            after("diffusion");
        }
        if let (Some(key), Some((_, sun_light)), Some((_, phase))) =
            (look.balance_key(cloud_key), &prepared.sun_light, &prepared.phase)
            && prepared.balance.as_ref().is_none_or(|(k, _)| *k != key)
        {
            let mut balance = prepared.balance.take().map(|(_, last)| last).unwrap_or_default();
            balance.make(
                (&cloud.shape, sun_light),
                look.detail.is_some(),
                look.table_beam,
                phase,
                look.octaves,
            );
            prepared.balance = Some((key, balance));
            after("octave_balance");
        }
        if let (Some(key), Some((_, phase))) = (look.slab_key(cloud_key), &prepared.phase)
            && prepared.slab.as_ref().is_none_or(|(k, _)| *k != key)
        {
            let (scattering, (_, carved, beam, _)) = key;
            let asymmetry = phase.asymmetry;
            if prepared.slab_sources.as_ref().is_none_or(|(of, _)| *of != asymmetry) {
                prepared.slab_sources = Some((asymmetry, SlabSources::kept(asymmetry)));
            }
            let sources = prepared.slab_sources.as_ref().and_then(|(_, sources)| sources.clone());
            if scattering == Scattering::SlabCollector {
                let slabs = sources.map(|sources| collected(&cloud.shape, carved, beam, sources));
                prepared.slab = Some((key, slabs));
                after("slab_collector");
            } else {
                let slabs = sources.map(|sources| SlabFit::new(&cloud.shape, carved, beam, sources));
                prepared.slab = Some((key, slabs));
                after("slab_fit");
            }
        }
    }
    look
}

impl Prepared {
    /// The frame of a picture; none if something was not prepared.
    fn frame(&self, look: &Look, settings: &ViewSettings) -> Option<Frame<'_>> {
        let (_, sky, moon_sky) = self.sky.as_ref()?;
        let (_, light) = self.light.as_ref()?;
        let (air, transmittance, _) = self.air.as_ref()?;
        let cloud = self.shape.as_ref().and_then(|(_, shape)| shape.as_ref());
        let sun = look.sun_direction;
        let beam = look.beam_direction;
        let on_ground = luminance(light.sun_at_ground) * beam[2].max(0.0) + luminance(light.sky_irradiance);
        let height_m = look.position_m[2];
        Some(Frame {
            width: settings.width,
            height: settings.height,
            position_m: look.position_m,
            axes: look.axes,
            half_height: look.half_height,
            sun_direction: sun,
            beam_direction: beam,
            exposure: tone_map::exposure(on_ground, look.exposure_gain, look.night),
            sky,
            moon_sky: moon_sky.as_ref(),
            moon: look.moon.map(|m| MoonDisc::new(m, sun, transmittance, height_m)),
            stars: look
                .stars
                .zip(self.stars.as_ref())
                .map(|(places, (_, table))| StarField {
                    table,
                    equatorial_from_world: places.equatorial_from_world,
                    transmittance,
                    height_m,
                }),
            light,
            haze: Haze::new(air, height_m),
            haze_on_cloud: settings.visibility_m.is_some(),
            cloud: cloud.and_then(|c| self.sun_light.as_ref().map(|(_, s)| (&c.shape, s))),
            ground: settings.ground,
            shadow: settings.cloud_shadow,
            shaft_samples: look.shaft_samples,
            steps: look.steps,
            noise: self.noise.as_ref()?,
            detail: look.detail,
            octaves: look.octaves,
            phase: self.phase.as_ref().map(|(_, phase)| phase)?,
            occlusion: match (look.lighting.sun_occlusion, &self.sun_map) {
                (SunOcclusion::SecondaryMarch { .. }, _) => Occlusion::Steps(look.secondary_steps()),
                (SunOcclusion::ShadowMap { .. }, Some((_, map))) => Occlusion::Map(map),
                _ => Occlusion::Grid,
            },
            diffuse: match (look.lighting.scattering, &self.diffuse) {
                (Scattering::Diffusion, Some((_, diffuse))) => Some(diffuse),
                _ => None,
            },
            balance: match (look.balance_key(0), &self.balance) {
                (Some(_), Some((_, balance))) => Some(balance),
                _ => None,
            },
            slab: match (look.lighting.scattering, &self.slab) {
                (Scattering::Slab | Scattering::SlabCollector, Some((_, slab))) => slab.as_ref(),
                _ => None,
            },
            sun_disc: transmittance.of_sun(height_m, sun[2]),
        })
    }
}
