//! The rungs that are measured, and what each ladder's are held against besides traced paths.

use welkin_shaders::cpu::light::analytic_sky::SkyMethod;
use welkin_shaders::cpu::light::march_phase::PHASE_QUADS;
use welkin_shaders::cpu::light::phase_table::PhaseChoice;
use welkin_shaders::cpu::light::sky_table::{SKY_COLUMNS, SKY_HALF_ROWS};
use welkin_shaders::cpu::view::{Lighting, MapKind, Scattering, SunOcclusion, ViewSettings};
use welkin_shaders::gpu::view_stages::ShapeGrid;
use welkin_shaders::view::ViewSteps;

/// Ways through cloud, each with octaves; none is single scattering.
pub(super) const SCATTERINGS: [(Scattering, u32); 8] = [
    (Scattering::Octaves, 0),
    (Scattering::MultipleForward, 0),
    (Scattering::Octaves, 2),
    (Scattering::Octaves, 6),
    (Scattering::Octaves, 8),
    (Scattering::Diffusion, 0),
    (Scattering::Slab, 0),
    (Scattering::SlabCollector, 0),
];
/// Ways to learn how much cloud lies towards the sun.
const OCCLUSIONS: [SunOcclusion; 9] = [
    SunOcclusion::LightGrid,
    SunOcclusion::SecondaryMarch { steps: 4 },
    SunOcclusion::SecondaryMarch { steps: 8 },
    SunOcclusion::SecondaryMarch { steps: 16 },
    map(MapKind::Exponential, 512),
    map(MapKind::Beer, 128),
    map(MapKind::Beer, 512),
    map(MapKind::Fourier, 128),
    map(MapKind::Fourier, 512),
];
/// Steps of the march that they are held against.
const EXACT_STEPS: u32 = 160;
/// Names of the ladders.
pub(super) const LADDERS: [&str; 5] = ["scattering", "sun_occlusion", "view_steps", "phase", "sky"];
/// Optical depth of the steps that others are held against.
const EXACT_STEP: ViewSteps = ViewSteps::ByOpticalDepth { optical_depth: 0.02 };
/// The function of phase that others are held against: Mie's of droplets as in fair-weather cumulus.
const EXACT_PHASE: PhaseChoice = PhaseChoice::Mie {
    effective_radius_um: 9.0,
};

pub(in crate::ladder) const fn map(kind: MapKind, side: u32) -> SunOcclusion {
    SunOcclusion::ShadowMap { kind, side }
}
pub(super) fn scattering_name((scattering, octaves): (Scattering, u32)) -> String {
    match (scattering, octaves) {
        (Scattering::Octaves, 0) => "single".to_owned(),
        (Scattering::Octaves, n) => format!("octaves {n}"),
        (Scattering::MultipleForward, _) => "multiple_forward".to_owned(),
        (Scattering::Diffusion, _) => "diffusion".to_owned(),
        (Scattering::Slab, _) => "slab".to_owned(),
        (Scattering::SlabCollector, _) => "slab_collector".to_owned(),
    }
}

pub(in crate::ladder) fn occlusion_name(occlusion: SunOcclusion) -> String {
    match occlusion {
        SunOcclusion::LightGrid => "light_grid".to_owned(),
        SunOcclusion::SecondaryMarch { steps } => format!("secondary_march {steps}"),
        SunOcclusion::ShadowMap { kind, side } => match kind {
            MapKind::Exponential => format!("exponential_shadow_map {side}"),
            MapKind::Beer => format!("beer_shadow_map {side}"),
            MapKind::Fourier => format!("fourier_opacity_map {side}"),
        },
    }
}

/// One rung, and the view by it.
pub(super) struct Contender {
    pub(super) ladder: &'static str,
    pub(super) rung: String,
    pub(super) settings: ViewSettings,
}

/// All of them on one scene.
pub(super) fn contenders(base: &ViewSettings) -> Vec<Contender> {
    let scatterings = SCATTERINGS.map(|way| {
        let settings = ViewSettings {
            multiple_scattering_octaves: way.1,
            lighting: Lighting {
                scattering: way.0,
                ..base.lighting
            },
            ..*base
        };
        (scattering_name(way), settings)
    });
    let occlusions = OCCLUSIONS.map(|way| (occlusion_name(way), occluded(base, way)));
    let steps = [
        (
            "logarithmic_segments 10",
            ViewSteps::LogarithmicSegments { segments: 10 },
        ),
        (
            "logarithmic_segments 60",
            ViewSteps::LogarithmicSegments { segments: 60 },
        ),
        ("by_optical_depth 0.5", ViewSteps::ByOpticalDepth { optical_depth: 0.5 }),
        ("by_optical_depth 0.2", ViewSteps::ByOpticalDepth { optical_depth: 0.2 }),
        ("by_distance", ViewSteps::ByDistance),
    ]
    .map(|(name, steps)| (name.to_owned(), ViewSettings { steps, ..*base }));
    let phases = [
        ("rayleigh", PhaseChoice::Rayleigh),
        (
            "henyey_greenstein 0.85",
            PhaseChoice::HenyeyGreenstein { asymmetry: 0.85 },
        ),
        (
            "double_henyey_greenstein",
            PhaseChoice::DoubleHenyeyGreenstein {
                forward_asymmetry: 0.9,
                backward_asymmetry: -0.4,
                forward_share: 0.95,
            },
        ),
        ("droplets 18", PhaseChoice::Droplets { diameter_um: 18.0 }),
        ("mie 9", EXACT_PHASE),
        ("ice 1", PhaseChoice::Ice { aspect_ratio: 1.0 }),
    ]
    .map(|(name, phase)| (name.to_owned(), turned(base, phase)));
    let skies = [
        ("preetham", SkyMethod::Preetham),
        ("hosek_wilkie", SkyMethod::HosekWilkie),
        ("scattering_tables", SkyMethod::ScatteringTables),
    ]
    .map(|(name, sky)| (name.to_owned(), ViewSettings { sky, ..*base }));
    let of = |n: usize, rungs: Vec<(String, ViewSettings)>| {
        rungs.into_iter().map(move |(rung, settings)| Contender {
            ladder: LADDERS[n],
            rung,
            settings,
        })
    };
    of(0, scatterings.into())
        .chain(of(1, occlusions.into()))
        .chain(of(2, steps.into()))
        .chain(of(3, phases.into()))
        .chain(of(4, skies.into()))
        .collect()
}

/// The view by what a ladder's rungs are held against: the exact way, with all else as it is, for the error of that would hide theirs. Scatterings are held against traced paths.
pub(in crate::ladder) fn exact(ladder: &str, base: &ViewSettings) -> Option<ViewSettings> {
    match ladder {
        "sun_occlusion" => Some(occluded(base, SunOcclusion::SecondaryMarch { steps: EXACT_STEPS })),
        "view_steps" => Some(ViewSettings {
            steps: EXACT_STEP,
            ..*base
        }),
        "phase" => Some(turned(base, EXACT_PHASE)),
        "sky" => Some(ViewSettings {
            sky: SkyMethod::ScatteringTables,
            ..*base
        }),
        _ => None,
    }
}

fn turned(base: &ViewSettings, phase: PhaseChoice) -> ViewSettings {
    let lighting = Lighting { phase, ..base.lighting };
    ViewSettings { lighting, ..*base }
}

pub(in crate::ladder) fn occluded(base: &ViewSettings, sun_occlusion: SunOcclusion) -> ViewSettings {
    let lighting = Lighting {
        sun_occlusion,
        ..base.lighting
    };
    ViewSettings { lighting, ..*base }
}

/// Bytes that are kept for what the ladder is about: the diffuse light or the fitted slabs; the grid's depths with the ground's shadow, which every way towards the sun has, and
/// a map besides; the march's tables of a phase function; the sky's. Steps keep nothing.
pub(super) fn bytes_of(ladder: &str, lighting: &Lighting, grid: &ShapeGrid) -> u64 {
    match (ladder, lighting.scattering, lighting.sun_occlusion) {
        ("scattering", Scattering::Diffusion, _) => grid.fluence_bytes(),
        ("scattering", Scattering::Slab, _) => 2 * grid.word_bytes(),
        ("scattering", Scattering::SlabCollector, _) => 8 * grid.word_bytes(),
        ("sun_occlusion", _, occlusion) => {
            let map = match occlusion {
                SunOcclusion::ShadowMap { kind, side } => 4 * kind.numbers() as u64 * u64::from(side).pow(2),
                SunOcclusion::LightGrid | SunOcclusion::SecondaryMarch { .. } => 0,
            };
            grid.word_bytes() + grid.shadow_bytes() + map
        }
        ("phase", ..) => (PHASE_QUADS * size_of::<[f32; 4]>()) as u64,
        ("sky", ..) => (2 * SKY_HALF_ROWS * SKY_COLUMNS * size_of::<[f32; 3]>()) as u64,
        _ => 0,
    }
}
