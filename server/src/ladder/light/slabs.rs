//! What the march's scattering reflects from plane-parallel slabs, beside discrete ordinates.

use serde::Serialize;
use welkin_shaders::cpu::light::Atmosphere;
use welkin_shaders::cpu::light::diffusion::Diffuse;
use welkin_shaders::cpu::light::march_phase::MarchPhase;
use welkin_shaders::cpu::light::multiple_scattering_table::MultipleScatteringTable;
use welkin_shaders::cpu::light::octave_balance::OctaveBalance;
use welkin_shaders::cpu::light::phase_table::PhaseChoice;
use welkin_shaders::cpu::light::sky_light::SkyLight;
use welkin_shaders::cpu::light::sky_table::{SkySource, SkyTable};
use welkin_shaders::cpu::light::sky_visibility::sky_visibility;
use welkin_shaders::cpu::light::slab_collector::collected;
use welkin_shaders::cpu::light::slab_fit::SlabFit;
use welkin_shaders::cpu::light::slab_tables::SlabSources;
use welkin_shaders::cpu::light::sun_optical_depth::SunLight;
use welkin_shaders::cpu::light::transmittance_table::TransmittanceTable;
use welkin_shaders::cpu::view::Scattering;
use welkin_shaders::cpu::view::detail_noise::DetailNoise;
use welkin_shaders::cpu::view::haze::Haze;
use welkin_shaders::cpu::view::march::{Frame, Occlusion, radiance_rows};
use welkin_shaders::cpu::view::shape::Shape;
use welkin_shaders::view::Ground;
use welkin_shaders::{CloudVolume, Grid};

use crate::clouds::volume;
use crate::validate::slab::{COLUMNS, DEPTHS, REFLECTED};

/// Nodes and weights of Gauss and Legendre's rule of six on 0 to 1.
const RULE: [[f64; 2]; 6] = [
    [0.033_765_242_898, 0.085_662_246_190],
    [0.169_395_306_767, 0.180_380_786_524],
    [0.380_690_406_958, 0.233_956_967_286],
    [0.619_309_593_042, 0.233_956_967_286],
    [0.830_604_693_233, 0.180_380_786_524],
    [0.966_234_757_102, 0.085_662_246_190],
];
/// Directions around, over half the circle.
const AROUND: usize = 6;
/// The slab's levels and their size, m.
const LEVELS: usize = 50;
const LEVEL_M: f32 = 20.0;
const BASE_LEVEL: usize = 10;

/// One slab under one sun.
#[derive(Clone, Debug, Serialize)]
pub struct SlabRow {
    /// From bottom to top.
    pub optical_depth: f64,
    /// Of Henyey and Greenstein's function.
    pub asymmetry: f64,
    /// Cosine of the sun's zenith angle.
    pub sun_cosine: f64,
    /// Reflected share of the flux by discrete ordinates of 64 streams.
    pub discrete_ordinates: f64,
    /// The march's.
    pub march: Vec<SlabShares>,
}

/// What the march makes of a slab with one rung.
#[derive(Clone, Debug, Serialize)]
pub struct SlabShares {
    /// The rung.
    pub rung: String,
    /// Share of the flux that is reflected.
    pub reflected: f64,
    /// Share that leaves in all, upwards, downwards and straight through: above 1 where light is made, below 1 where it is lost.
    pub in_all: f64,
}

fn slab(optical_depth: f64) -> CloudVolume {
    let grid = Grid {
        cells: [4, 4, BASE_LEVEL + LEVELS + 4],
        cell_size_m: [200.0, 200.0, LEVEL_M],
    };
    let extinction = optical_depth as f32 / (LEVELS as f32 * LEVEL_M);
    let cells = (0..grid.len()).map(|n| {
        let level = n / grid.plane();
        if (BASE_LEVEL..BASE_LEVEL + LEVELS).contains(&level) {
            extinction
        } else {
            0.0
        }
    });
    volume(grid, cells.collect())
}

/// A night without air: nothing but the given sun is left.
pub(super) struct Night {
    sky: SkyTable,
    noise: DetailNoise,
    light: SkyLight,
}

impl Night {
    pub(super) fn new() -> Night {
        let air = Atmosphere::new(0.0, None);
        let transmittance = TransmittanceTable::new(&air);
        let multiple = MultipleScatteringTable::new(&air, &transmittance);
        Night {
            sky: SkyTable::new(
                &air,
                &transmittance,
                &multiple,
                &SkySource::sun([0.0, 0.0, -1.0], false),
                None,
                10.0,
            ),
            noise: DetailNoise::new(),
            light: SkyLight::BEAM_ON_CLOUDS,
        }
    }
    /// Sixteen pixels of almost one direction, from outside the slab into it: down, or up from below, at a slope of `cosine` to the vertical.
    fn frame<'a>(
        &'a self,
        cloud: (&'a Shape, &'a SunLight),
        way: &'a Way,
        sun: [f32; 3],
        [cosine, azimuth]: [f64; 2],
        from_above: bool,
    ) -> Frame<'a> {
        let (sine, (east, north)) = ((1.0 - cosine * cosine).sqrt(), azimuth.sin_cos());
        let down = if from_above { 1.0 } else { -1.0 };
        let axes = [
            [north, -east, 0.0],
            [down * cosine * east, down * cosine * north, sine],
            [sine * east, sine * north, -down * cosine],
        ];
        let height_m = if from_above {
            cloud.0.top_m + 300.0
        } else {
            cloud.0.bottom_m - 10.0
        };
        let camera = Camera {
            position_m: [100.0, 100.0, height_m],
            axes: axes.map(|axis| axis.map(|v| v as f32)),
            half_height: 0.01,
            side: 4,
        };
        self.look(cloud, way, sun, &camera)
    }
    /// What a camera sees.
    pub(super) fn look<'a>(
        &'a self,
        cloud: (&'a Shape, &'a SunLight),
        way: &'a Way,
        sun: [f32; 3],
        camera: &Camera,
    ) -> Frame<'a> {
        Frame {
            width: camera.side,
            height: camera.side,
            position_m: camera.position_m,
            axes: camera.axes,
            half_height: camera.half_height,
            sun_direction: sun,
            beam_direction: sun,
            exposure: 1.0,
            sky: &self.sky,
            moon_sky: None,
            moon: None,
            stars: None,
            light: &self.light,
            haze: Haze {
                rayleigh_per_m: [0.0; 3],
                aerosol_per_m: 0.0,
            },
            haze_on_cloud: false,
            cloud: Some(cloud),
            ground: Ground::Land,
            shaft_samples: 0,
            steps: (0.0, 0),
            shadow: false,
            noise: &self.noise,
            detail: None,
            octaves: way.octaves,
            phase: &way.phase,
            occlusion: Occlusion::Grid,
            diffuse: way.diffuse.as_ref(),
            balance: way.balance.as_ref(),
            slab: way.slab.as_ref(),
            sun_disc: [0.0; 3],
        }
    }
}

/// Where a square picture is taken from.
pub(super) struct Camera {
    /// m.
    pub(super) position_m: [f32; 3],
    /// Unit vectors to the right, up and ahead.
    pub(super) axes: [[f32; 3]; 3],
    /// Tangent of half the angle of view.
    pub(super) half_height: f32,
    /// Pixels.
    pub(super) side: usize,
}

/// A rung of scattering with all that it makes of a cloud.
pub(super) struct Way {
    phase: MarchPhase,
    octaves: usize,
    diffuse: Option<Diffuse>,
    balance: Option<OctaveBalance>,
    slab: Option<SlabFit>,
}

impl Way {
    /// `way` is the rung and its octaves; `sources` are the slabs of that asymmetry.
    pub(super) fn new(
        way: (Scattering, u32),
        (shape, sun_light): (&Shape, &SunLight),
        sun: [f32; 3],
        asymmetry: f64,
        sources: &Option<SlabSources>,
    ) -> Way {
        let octaves = way.0.octaves(way.1);
        let phase = MarchPhase::new(one_lobe(asymmetry), way.0, octaves);
        let of_slabs = sources.clone();
        Way {
            balance: (octaves > 0 && way.0 == Scattering::Octaves).then(|| {
                let mut balance = OctaveBalance::default();
                balance.make((shape, sun_light), false, sun, &phase, octaves);
                balance
            }),
            diffuse: (way.0 == Scattering::Diffusion).then(|| Diffuse::new(shape, sun_light, false, phase.asymmetry)),
            slab: match way.0 {
                Scattering::Slab => of_slabs.map(|sources| SlabFit::new(shape, false, sun, sources)),
                Scattering::SlabCollector => of_slabs.map(|sources| collected(shape, false, sun, sources)),
                _ => None,
            },
            phase,
            octaves,
        }
    }
}

fn sun_of(cosine: f64) -> [f32; 3] {
    [0.0, (1.0 - cosine * cosine).sqrt() as f32, cosine as f32]
}

/// All slabs with the march of these ways through cloud.
pub(super) fn all(ways: &[(Scattering, u32)]) -> Vec<SlabRow> {
    let night = Night::new();
    let sources = COLUMNS.map(|[asymmetry, _]| SlabSources::kept(asymmetry as f32));
    let mut rows = Vec::new();
    for (depth, published) in DEPTHS.iter().zip(REFLECTED) {
        let volume = slab(*depth);
        let Some(shape) = Shape::new(&volume) else { continue };
        let [nx, ny, _] = volume.grid.cells;
        let seen = sky_visibility(&shape.slab_per_m, [nx, ny], volume.grid.cell_size_m);
        for (([asymmetry, sun_cosine], sources), published) in COLUMNS.iter().zip(&sources).zip(published) {
            let sun = sun_of(*sun_cosine);
            let sun_light = SunLight::new(&shape, &seen, false, false, sun);
            let straight = (-depth / sun_cosine).exp();
            let shares = ways.iter().map(|way| {
                let made = Way::new(*way, (&shape, &sun_light), sun, *asymmetry, sources);
                let leaves = |from_above: bool| {
                    let mut flux = 0.0;
                    for [cosine, weight] in RULE {
                        for n in 0..AROUND {
                            let azimuth = std::f64::consts::PI * (n as f64 + 0.5) / AROUND as f64;
                            let frame = night.frame((&shape, &sun_light), &made, sun, [cosine, azimuth], from_above);
                            let mut pixels = [[0.0f32; 3]; 16];
                            radiance_rows(&frame, 0, &mut pixels);
                            let mean = pixels.iter().map(|p| f64::from(p[1])).sum::<f64>() / 16.0;
                            flux += mean * cosine * weight * 2.0 * std::f64::consts::PI / AROUND as f64;
                        }
                    }
                    flux / sun_cosine
                };
                let reflected = leaves(true);
                SlabShares {
                    rung: super::rungs::scattering_name(*way),
                    reflected,
                    in_all: reflected + leaves(false) + straight,
                }
            });
            rows.push(SlabRow {
                optical_depth: *depth,
                asymmetry: *asymmetry,
                sun_cosine: *sun_cosine,
                discrete_ordinates: published,
                march: shares.collect(),
            });
        }
    }
    rows
}

fn one_lobe(asymmetry: f64) -> PhaseChoice {
    PhaseChoice::HenyeyGreenstein {
        asymmetry: asymmetry as f32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A furnace: light that is the same from all sides is the same in cloud, however thick, and behind it.
    #[test]
    fn even_light_stays_even() {
        let mut night = Night::new();
        night.light = SkyLight {
            sun_at_base: [0.0; 3],
            sun_at_top: [0.0; 3],
            sky_radiance: [1.0; 3],
            ground_radiance: [1.0; 3],
            ..night.light
        };
        let sun = sun_of(0.5);
        for depth in [0.1, 1.0, 4.0, 16.0, 64.0] {
            let volume = slab(depth);
            let shape = Shape::new(&volume).unwrap();
            let [nx, ny, _] = volume.grid.cells;
            let seen = sky_visibility(&shape.slab_per_m, [nx, ny], volume.grid.cell_size_m);
            let mut sun_light = SunLight::new(&shape, &seen, false, false, sun);
            // No shadow on the ground.
            sun_light.sunlit_share = 1.0;
            let made = Way::new((Scattering::Octaves, 0), (&shape, &sun_light), sun, 0.85, &None);
            for from_above in [true, false] {
                for cosine in [0.3, 1.0] {
                    let frame = night.frame((&shape, &sun_light), &made, sun, [cosine, 0.4], from_above);
                    let mut pixels = [[0.0f32; 3]; 16];
                    radiance_rows(&frame, 0, &mut pixels);
                    let mean = pixels.iter().map(|p| f64::from(p[1])).sum::<f64>() / 16.0;
                    // What shines through is black here: the night behind.
                    let even = mean + (-depth / cosine).exp();
                    // Visibilities are kept in 255 steps, and steps of the march cut a slab's edge.
                    assert!(
                        (even - 1.0).abs() < 0.02,
                        "depth {depth}, cosine {cosine}, from above {from_above}: {even}"
                    );
                }
            }
        }
    }
}
