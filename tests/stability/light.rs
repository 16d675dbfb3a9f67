//! Hard cases for light: the march and the path tracer give finite radiance, never below 0 and never above what one scattering of the sun
//! straight ahead and its disc together could give.

#[path = "../service/common.rs"]
mod common;

use std::collections::HashSet;
use std::sync::Arc;

use serde_json::json;
use tokio::sync::watch;
use welkin_proto::wire::FrameFormat;
use welkin_server::clouds::{ball, cumulus_field, settings, sun, volume};
use welkin_server::host::renderer::{FrameRequest, RenderService};
use welkin_server::machine::Compute;
use welkin_shaders::catalogue::{Ladder, Rung};
use welkin_shaders::cpu::light::path_tracer::Film;
use welkin_shaders::cpu::light::phase_table::{PhaseChoice, PhaseTable};
use welkin_shaders::cpu::view::reproject::History;
use welkin_shaders::cpu::view::{
    Ground, Lighting, MapKind, Prepared, Scattering, SunOcclusion, ViewSampling, ViewSettings, path_trace, radiance,
    render, render_live,
};
use welkin_shaders::gpu::{AdapterChoice, Context, GpuError, GpuHistory, GpuView, ViewStages};
use welkin_shaders::view::ViewSteps;
use welkin_shaders::{CloudVolume, Grid};

/// A level slab of three cells' depth whose cells have this optical depth each.
fn cells_of(optical_depth: f32, side_m: f32) -> CloudVolume {
    let grid = Grid {
        cells: [6, 5, 8],
        cell_size_m: [side_m; 3],
    };
    let cells = (0..grid.len()).map(|n| {
        let level = n / grid.plane();
        if (2..5).contains(&level) {
            optical_depth / side_m
        } else {
            0.0
        }
    });
    volume(grid, cells.collect())
}

fn judge(prepared: &mut Prepared, what: &str, cloud: &CloudVolume, view: &ViewSettings, albedo: f64) {
    let table = PhaseTable::new(view.lighting.phase);
    let most = table.colours.iter().flatten().fold(0.0, |a: f64, b| a.max(*b)) as f32;
    // The sun's disc, its light scattered straight ahead by the whole function, and the sky.
    let disc = 1.0 / (std::f32::consts::PI * 0.004_65 * 0.004_65);
    let bound = disc + most + 1.0;
    let marched = radiance(Some(cloud), view, prepared);
    assert_eq!(marched.len(), view.width * view.height);
    for v in marched.iter().flatten() {
        assert!(
            (0.0..=bound).contains(v),
            "{what}: the march gives {v}, {bound} at most"
        );
    }
    let picture = render(Some(cloud), view, prepared);
    assert_eq!(picture.len(), 3 * view.width * view.height);
    let mut film = Film::new(view.width * view.height);
    path_trace(Some(cloud), view, prepared, albedo, &mut film, 4);
    for v in film.radiance().iter().flatten() {
        let in_bound = (0.0..=f64::from(bound)).contains(v);
        assert!(
            in_bound,
            "{what}, albedo {albedo}: the tracer gives {v}, {bound} at most"
        );
    }
    assert!(film.relative_error().is_finite(), "{what}");
}

fn small() -> ViewSettings {
    settings(5, 3)
}

#[test]
fn cells_of_any_optical_depth() {
    let mut prepared = Prepared::new();
    for (optical_depth, side_m) in [(0.0, 100.0), (1e-6, 100.0), (1.0, 100.0), (1e4, 1000.0)] {
        let cloud = cells_of(optical_depth, side_m);
        for albedo in [0.0, 1.0] {
            for height_m in [2.0, 3.5 * side_m, 7.5 * side_m] {
                let view = ViewSettings {
                    camera_position_m: [2.2 * side_m, 1.7 * side_m, height_m],
                    elevation_deg: if height_m > 6.0 * side_m { -30.0 } else { 30.0 },
                    ..small()
                };
                judge(
                    &mut prepared,
                    &format!("depth {optical_depth} from {height_m} m"),
                    &cloud,
                    &view,
                    albedo,
                );
            }
        }
    }
}

#[test]
fn cameras_in_hard_places() {
    let mut prepared = Prepared::new();
    let cloud = cells_of(20.0, 100.0);
    for (what, position) in [
        ("on the top", [250.0, 250.0, 500.0]),
        ("on the bottom", [250.0, 250.0, 200.0]),
        ("on a face between cells", [300.0, 250.0, 350.0]),
        ("on the seam", [0.0, 0.0, 300.0]),
        ("solid inside", [250.0, 250.0, 350.0]),
        ("in the ground", [250.0, 250.0, -40.0]),
        ("far off", [40_000.0, -90_000.0, 1_000.0]),
        ("in space", [250.0, 250.0, 60_000.0]),
    ] {
        for elevation_deg in [-90.0, 0.0, 90.0] {
            let view = ViewSettings {
                camera_position_m: position,
                elevation_deg,
                ground: Ground::Sea,
                ..small()
            };
            judge(
                &mut prepared,
                &format!("{what}, looking to {elevation_deg}"),
                &cloud,
                &view,
                1.0,
            );
        }
    }
}

#[test]
fn suns_everywhere() {
    let mut prepared = Prepared::new();
    let cloud = ball(1500.0, 700.0, 0.03);
    for elevation in [90.0, 20.0, 1e-4, 0.0, -0.5, -30.0, -90.0] {
        // Behind the cloud's middle, where that is above the ground.
        let view = ViewSettings {
            camera_position_m: [3200.0, 1000.0, 1500.0],
            elevation_deg: 0.0,
            sun_direction: sun(elevation, 0.0),
            ..small()
        };
        judge(&mut prepared, &format!("sun at {elevation}"), &cloud, &view, 1.0);
    }
}

#[test]
fn phases_with_sharp_peaks() {
    let mut prepared = Prepared::new();
    let cloud = cumulus_field(7, 12);
    for phase in [
        PhaseChoice::HenyeyGreenstein { asymmetry: 0.999 },
        PhaseChoice::HenyeyGreenstein { asymmetry: -0.999 },
        PhaseChoice::HenyeyGreenstein { asymmetry: f32::NAN },
        PhaseChoice::Mie {
            effective_radius_um: 50.0,
        },
        PhaseChoice::Mie {
            effective_radius_um: 0.0,
        },
        PhaseChoice::Ice { aspect_ratio: 0.0 },
    ] {
        // The sun in the middle of the picture.
        let mut view = ViewSettings {
            sun_direction: sun(18.0, 0.0),
            ..small()
        };
        view.lighting.phase = phase;
        judge(&mut prepared, &format!("{phase:?}"), &cloud, &view, 1.0);
    }
}

/// Every rung of light at its smallest, and its octaves: none is single scattering.
fn lightings() -> Vec<(Lighting, u32)> {
    let default = Lighting::default();
    let octaves = small().multiple_scattering_octaves;
    let scatterings = [
        Scattering::Octaves,
        Scattering::MultipleForward,
        Scattering::Diffusion,
        Scattering::Slab,
        Scattering::SlabCollector,
    ];
    let maps = [MapKind::Exponential, MapKind::Beer, MapKind::Fourier];
    let occlusions = maps.map(|kind| SunOcclusion::ShadowMap { kind, side: 16 });
    let marches = [1, 7].map(|steps| SunOcclusion::SecondaryMarch { steps });
    let by_scattering = scatterings.map(|scattering| Lighting { scattering, ..default });
    let by_occlusion = occlusions.into_iter().chain(marches).map(|sun_occlusion| Lighting {
        sun_occlusion,
        ..default
    });
    let all = by_scattering.into_iter().chain(by_occlusion);
    all.map(|lighting| (lighting, octaves)).chain([(default, 0)]).collect()
}

/// The view, and where clouds are lit as usual, also with steps of other lengths and with shafts.
fn ways(view: &ViewSettings) -> Vec<ViewSettings> {
    let mut ways = vec![*view];
    if view.lighting == Lighting::default() {
        let steps = [
            ViewSteps::ByOpticalDepth { optical_depth: 0.02 },
            ViewSteps::ByOpticalDepth { optical_depth: 4.0 },
            ViewSteps::LogarithmicSegments { segments: 2 },
            ViewSteps::LogarithmicSegments { segments: 512 },
        ];
        ways.extend(steps.map(|steps| ViewSettings { steps, ..*view }));
        ways.extend([4, 128].map(|light_shafts| ViewSettings {
            light_shafts,
            visibility_m: Some(2_000.0),
            ..*view
        }));
    }
    ways
}

/// No rung makes light of more than one scattering straight ahead and the octaves' sum of weights.
#[test]
fn every_rung_on_hard_clouds_and_suns() {
    for (optical_depth, side_m) in [(0.0, 100.0), (1e-6, 100.0), (3.0, 100.0), (1e4, 1000.0)] {
        let cloud = cells_of(optical_depth, side_m);
        let mut prepared = Prepared::new();
        for (lighting, multiple_scattering_octaves) in lightings() {
            for elevation in [90.0, 30.0, 0.0, -3.0] {
                for height_m in [2.0, 3.5 * side_m, 7.5 * side_m] {
                    let view = ViewSettings {
                        camera_position_m: [2.2 * side_m, 1.7 * side_m, height_m],
                        elevation_deg: if height_m > 6.0 * side_m { -30.0 } else { 30.0 },
                        // Away from the sun, so that its disc does not hide anything.
                        azimuth_deg: 180.0,
                        sun_direction: sun(elevation, 0.0),
                        lighting,
                        multiple_scattering_octaves,
                        ..small()
                    };
                    // Where the sun is in the zenith the camera may see it scattered straight ahead.
                    let bound = if elevation < 90.0 { 2.0 } else { 20_000.0 };
                    for view in ways(&view) {
                        let marched = radiance(Some(&cloud), &view, &mut prepared);
                        assert!(
                            marched.iter().flatten().all(|v| (0.0..bound).contains(v)),
                            "depth {optical_depth}, {view:?}: {marched:?}"
                        );
                    }
                }
            }
        }
    }
}

/// The rungs that a view is lit and stepped through by. The matches have no catch-all: what is new to the view must be named here to compile.
fn rungs_of(view: &ViewSettings) -> [Rung; 3] {
    let scattering = match view.lighting.scattering {
        // As the server says it.
        Scattering::Octaves if view.multiple_scattering_octaves == 0 => Rung::SingleScattering,
        Scattering::Octaves => Rung::Octaves,
        Scattering::MultipleForward => Rung::MultipleForward,
        Scattering::Diffusion => Rung::Diffusion,
        Scattering::Slab => Rung::Slab,
        Scattering::SlabCollector => Rung::SlabCollector,
    };
    let occlusion = match view.lighting.sun_occlusion {
        SunOcclusion::LightGrid => Rung::LightGrid,
        SunOcclusion::SecondaryMarch { .. } => Rung::SecondaryMarch,
        SunOcclusion::ShadowMap { kind, .. } => match kind {
            MapKind::Exponential => Rung::ExponentialShadowMap,
            MapKind::Beer => Rung::BeerShadowMap,
            MapKind::Fourier => Rung::FourierOpacityMap,
        },
    };
    let steps = match view.steps {
        ViewSteps::ByDistance => Rung::ByDistance,
        ViewSteps::ByOpticalDepth { .. } => Rung::ByOpticalDepth,
        ViewSteps::LogarithmicSegments { .. } => Rung::LogarithmicSegments,
    };
    [scattering, occlusion, steps]
}

/// The view with every way to scatter light, every way to shade it and every way to step, each with each.
fn matrix(view: &ViewSettings) -> Vec<ViewSettings> {
    let scatterings = [
        (Scattering::Octaves, 0),
        (Scattering::Octaves, 6),
        (Scattering::MultipleForward, 0),
        (Scattering::Diffusion, 0),
        (Scattering::Slab, 0),
        (Scattering::SlabCollector, 0),
    ];
    let map = |kind| SunOcclusion::ShadowMap { kind, side: 16 };
    let occlusions = [
        SunOcclusion::LightGrid,
        SunOcclusion::SecondaryMarch { steps: 1 },
        SunOcclusion::SecondaryMarch { steps: 7 },
        map(MapKind::Exponential),
        map(MapKind::Beer),
        map(MapKind::Fourier),
    ];
    let steps = [
        ViewSteps::ByDistance,
        ViewSteps::ByOpticalDepth { optical_depth: 0.02 },
        ViewSteps::ByOpticalDepth { optical_depth: 4.0 },
        ViewSteps::LogarithmicSegments { segments: 2 },
        ViewSteps::LogarithmicSegments { segments: 512 },
    ];
    let mut views = Vec::new();
    for (scattering, multiple_scattering_octaves) in scatterings {
        for sun_occlusion in occlusions {
            for steps in steps {
                let mut view = ViewSettings {
                    multiple_scattering_octaves,
                    steps,
                    ..*view
                };
                view.lighting.scattering = scattering;
                view.lighting.sun_occlusion = sun_occlusion;
                views.push(view);
            }
        }
    }
    views
}

/// A rung that the catalogue gains and the matrix doesn't is found here.
#[test]
fn every_rung_is_in_the_matrix() {
    let tried: HashSet<Rung> = matrix(&small()).iter().flat_map(rungs_of).collect();
    for ladder in [Ladder::Scattering, Ladder::SunOcclusion, Ladder::ViewSteps] {
        for rung in ladder.rungs().filter(|rung| rung.is_there()) {
            assert!(tried.contains(&rung), "{} is not tried", rung.info().name);
        }
    }
}

/// A lump of cloud in the middle of a small box, its centre at 400 m east, north and up.
fn lump() -> CloudVolume {
    let grid = Grid {
        cells: [8, 8, 8],
        cell_size_m: [100.0; 3],
    };
    let inside = |n: usize| (3..5).contains(&n);
    let cells = (0..grid.len()).map(|n| {
        let [x, y, z] = [n % 8, n / 8 % 8, n / 64];
        if inside(x) && inside(y) && inside(z) { 0.03 } else { 0.0 }
    });
    volume(grid, cells.collect())
}

/// Cosine of the angle between the sun and where the middle of a pixel looks.
fn sun_cosine(view: &ViewSettings, pixel: usize) -> f64 {
    let [azimuth, elevation] = [view.azimuth_deg, view.elevation_deg].map(|v| f64::from(v).to_radians());
    let ahead = [
        elevation.cos() * azimuth.sin(),
        elevation.cos() * azimuth.cos(),
        elevation.sin(),
    ];
    let up = [
        -elevation.sin() * azimuth.sin(),
        -elevation.sin() * azimuth.cos(),
        elevation.cos(),
    ];
    let right = [azimuth.cos(), -azimuth.sin(), 0.0];
    let scale = 2.0 * (0.5 * f64::from(view.vertical_fov_deg).to_radians()).tan() / view.height as f64;
    let x = (pixel % view.width) as f64 + 0.5 - 0.5 * view.width as f64;
    let y = (pixel / view.width) as f64 + 0.5 - 0.5 * view.height as f64;
    let d = [0, 1, 2].map(|a| scale * (x * right[a] - y * up[a]) + ahead[a]);
    let length = d.iter().map(|v| v * v).sum::<f64>().sqrt();
    (0..3).map(|a| d[a] * f64::from(view.sun_direction[a])).sum::<f64>() / length
}

/// What it is, cloud, camera, its azimuth and elevation, the sun's elevation and azimuth, angle of view.
type HardCase<'a> = (&'a str, &'a CloudVolume, [f32; 3], [f32; 2], [f32; 2], f32);

/// Every rung of scattering, shading and stepping, each with each, on the hard places together: on the cloud's faces and edges, in the ground, along its top and base,
/// suns at and under the horizon, the sun behind the cloud's middle, in the whole function's peak and in one a thousand times sharper.
///
/// A pixel holds one scattering by the function's value at its own angle at most, and 1 for the sky and for what is turned by wide angles: no weight of an octave, no share of a
/// slab and no step's length makes light. The sharp function turns light many times before it leaves the sun's surroundings: that may be more than one scattering there, but what falls off
/// from the sun outwards and is no more than came in holds at most one over the solid angle within. Only a pixel that shows the sun's disc may hold that too.
#[test]
fn every_rung_on_every_hard_case() {
    // Half the disc's angle, and a hundredth of a degree for directions in 32 bits and tables' suns.
    let disc_cosine = 0.277_f64.to_radians().cos();
    let disc = 1.0 / (std::f32::consts::PI * 0.004_65 * 0.004_65);
    let behind = |height_m: f64| (400.0 - height_m).atan2(1_000.0).to_degrees() as f32;
    let layer = cells_of(3.0, 100.0);
    let lump = lump();
    let cases: [HardCase<'_>; 9] = [
        (
            "on the top",
            &layer,
            [250.0, 250.0, 500.0],
            [0.0, 0.0],
            [30.0, 180.0],
            55.0,
        ),
        (
            "on a cells' face",
            &layer,
            [300.0, 250.0, 350.0],
            [90.0, 5.0],
            [0.3, 90.0],
            20.0,
        ),
        (
            "on the seam and base",
            &layer,
            [0.0, 0.0, 200.0],
            [45.0, 90.0],
            [90.0, 0.0],
            5.0,
        ),
        (
            "in the ground",
            &layer,
            [250.0, 250.0, -40.0],
            [10.0, 40.0],
            [40.0, 10.0],
            5.0,
        ),
        (
            "along the top",
            &layer,
            [250.0, 250.0, 501.0],
            [0.0, -0.2],
            [1e-4, 0.0],
            3.0,
        ),
        (
            "along the base",
            &layer,
            [250.0, 250.0, 199.0],
            [0.0, 0.2],
            [-0.5, 0.0],
            3.0,
        ),
        (
            "before the sun",
            &lump,
            [400.0, -600.0, 2.0],
            [0.0, behind(2.0)],
            [behind(2.0), 0.0],
            3.0,
        ),
        (
            "before a low sun",
            &lump,
            [400.0, -600.0, 400.0],
            [0.0, 0.0],
            [0.0, 0.0],
            3.0,
        ),
        (
            "in the middle",
            &lump,
            [400.0, 400.0, 400.0],
            [0.0, 60.0],
            [60.0, 0.0],
            3.0,
        ),
    ];
    let phases = [
        PhaseChoice::default(),
        PhaseChoice::HenyeyGreenstein { asymmetry: 0.999 },
    ];
    let mut discs = 0;
    for phase in phases {
        let table = PhaseTable::new(phase);
        let most = table.colours.iter().flatten().fold(0.0, |a: f64, b| a.max(*b));
        let mut prepared = Prepared::new();
        for (what, cloud, camera_position_m, [azimuth_deg, elevation_deg], [sun_elevation, sun_azimuth], fov) in cases {
            let mut view = ViewSettings {
                camera_position_m,
                azimuth_deg,
                elevation_deg,
                vertical_fov_deg: fov,
                sun_direction: sun(sun_elevation, sun_azimuth),
                ..small()
            };
            view.lighting.phase = phase;
            for view in matrix(&view) {
                let marched = radiance(Some(cloud), &view, &mut prepared);
                assert_eq!(marched.len(), view.width * view.height);
                let mut shows_disc = 0;
                for (pixel, light) in marched.iter().enumerate() {
                    let cosine = sun_cosine(&view, pixel);
                    let scattered = table.look(cosine).into_iter().fold(0.0, f64::max);
                    let once = matches!(rungs_of(&view)[0], Rung::SingleScattering | Rung::MultipleForward);
                    let bound = if cosine > disc_cosine {
                        shows_disc += 1;
                        f64::from(disc) + most + 1.0
                    } else if once || phase == PhaseChoice::default() {
                        1.0 + scattered
                    } else {
                        1.0 + 1.0 / (std::f64::consts::TAU * (1.0 - cosine))
                    };
                    for v in light {
                        assert!(
                            (0.0..=bound).contains(&f64::from(*v)),
                            "{what}, pixel {pixel}, {bound} at most: {light:?}, {view:?}"
                        );
                    }
                }
                assert!(shows_disc <= 1, "{what}: only the middle pixel looks at the sun");
                discs += shows_disc;
            }
        }
    }
    assert!(discs > 0, "no picture has the sun in its middle");
}

/// A volume of no extent is no cloud, whatever lights it.
#[test]
fn volumes_of_nothing_are_no_cloud() {
    let view = small();
    let none = render(None, &view, &mut Prepared::new());
    for cells in [[0, 5, 8], [6, 0, 8], [6, 5, 0]] {
        let grid = Grid {
            cells,
            cell_size_m: [100.0; 3],
        };
        let cloud = volume(grid, Vec::new());
        for (lighting, multiple_scattering_octaves) in lightings() {
            let view = ViewSettings {
                lighting,
                multiple_scattering_octaves,
                ..view
            };
            assert!(render(Some(&cloud), &view, &mut Prepared::new()) == none, "{cells:?}");
        }
    }
    // Cells of no size.
    let mut flat = cells_of(3.0, 100.0);
    flat.grid.cell_size_m[2] = 0.0;
    assert!(render(Some(&flat), &view, &mut Prepared::new()) == none);
}

/// Rays along the axes, exactly: their inverse directions are infinite.
#[test]
fn rays_along_axes() {
    let mut prepared = Prepared::new();
    let cloud = cells_of(2.0, 100.0);
    for (lighting, multiple_scattering_octaves) in lightings() {
        for (azimuth_deg, elevation_deg) in [
            (0.0, 0.0),
            (90.0, 0.0),
            (180.0, 0.0),
            (270.0, 0.0),
            (0.0, 90.0),
            (0.0, -90.0),
        ] {
            let view = ViewSettings {
                camera_position_m: [310.0, 220.0, 350.0],
                azimuth_deg,
                elevation_deg,
                vertical_fov_deg: 0.1,
                width: 1,
                height: 1,
                lighting,
                multiple_scattering_octaves,
                ..small()
            };
            let what = format!("{azimuth_deg} {elevation_deg} {lighting:?} {multiple_scattering_octaves}");
            // Paths don't look at how the march is lit.
            if lighting == Lighting::default() {
                judge(&mut prepared, &what, &cloud, &view, 1.0);
            }
            for view in ways(&view) {
                let marched = radiance(Some(&cloud), &view, &mut prepared);
                assert!(
                    marched.iter().flatten().all(|v| (0.0..2.0).contains(v)),
                    "{view:?}: {marched:?}"
                );
            }
        }
    }
}

/// An 8k picture's width, cut to one row of packets.
#[test]
fn pictures_as_wide_as_8k() {
    let view = ViewSettings {
        width: 7680,
        height: 4,
        vertical_fov_deg: 0.1,
        ..small()
    };
    let marched = radiance(Some(&cumulus_field(7, 12)), &view, &mut Prepared::new());
    assert!(marched.len() == 7680 * 4 && marched.iter().flatten().all(|v| (0.0..2.0).contains(v)));
}

/// Diffusion and maps are made by all threads together; their bits are those of one.
#[test]
fn threads_change_no_bit_of_light() {
    let cloud = cumulus_field(7, 12);
    for (lighting, multiple_scattering_octaves) in lightings() {
        let view = ViewSettings {
            lighting,
            multiple_scattering_octaves,
            ..settings(24, 16)
        };
        for view in ways(&view) {
            let [alone, many] = [1, 3].map(|threads| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| radiance(Some(&cloud), &view, &mut Prepared::new()))
            });
            assert!(alone == many, "{view:?}");
        }
    }
}

/// On a GPU the same hard cases, as bytes: none is far from the CPU's.
#[test]
fn a_gpu_draws_hard_cases_as_the_cpu_does() {
    let context = match Context::open(&AdapterChoice::Any) {
        Ok(context) => context,
        Err(error) => return welkin_tests::skip("a_gpu_draws_hard_cases_as_the_cpu_does", "gpu", error),
    };
    let mut gpu = GpuView::new(Arc::new(ViewStages::new(context).unwrap())).unwrap();
    for (optical_depth, side_m) in [(1e-6, 100.0), (3.0, 100.0), (1e4, 1000.0)] {
        let cloud = cells_of(optical_depth, side_m);
        let mut prepared = Prepared::new();
        for (lighting, multiple_scattering_octaves) in lightings() {
            for (elevation, height_m) in [(90.0, 2.0), (0.0, 3.5 * side_m), (30.0, 7.5 * side_m)] {
                let view = ViewSettings {
                    camera_position_m: [2.2 * side_m, 1.7 * side_m, height_m],
                    elevation_deg: 30.0,
                    sun_direction: sun(elevation, 0.0),
                    lighting,
                    multiple_scattering_octaves,
                    ..small()
                };
                for view in ways(&view) {
                    let drawn = gpu.render(Some(&cloud), &view, &mut |_| {});
                    if lighting.needs_cpu() {
                        assert!(matches!(drawn, Err(GpuError::NoShader { .. })), "{lighting:?}");
                        continue;
                    }
                    let wanted = render(Some(&cloud), &view, &mut prepared);
                    let far = drawn
                        .unwrap()
                        .iter()
                        .zip(&wanted)
                        .filter(|(a, b)| a.abs_diff(**b) > 3)
                        .count();
                    // A ray at the sun's edge or on a cell's border may differ: one pixel of fifteen.
                    assert!(far <= 3, "depth {optical_depth}, {view:?}: {far} values");
                }
            }
        }
    }
}

/// Viewers' pictures of the same, one after another, on every way to march fewer pixels that a GPU has: small and odd sizes, one pixel, cameras that jump.
#[test]
fn a_gpu_draws_live_pictures_of_hard_cases_as_the_cpu_does() {
    let context = match Context::open(&AdapterChoice::Any) {
        Ok(context) => context,
        Err(error) => return welkin_tests::skip("a_gpu_draws_live_pictures_of_hard_cases", "gpu", error),
    };
    let mut gpu = GpuView::new(Arc::new(ViewStages::new(context).unwrap())).unwrap();
    let samplings = [
        ViewSampling::HalfResolution,
        ViewSampling::Reproject4,
        ViewSampling::Reproject16,
        ViewSampling::Impostors,
    ];
    let sizes = [(5, 3), (5, 3), (1, 1), (1, 1), (2, 9), (2, 9), (17, 4)];
    for (optical_depth, side_m) in [(1e-6, 100.0), (3.0, 100.0), (1e4, 1000.0)] {
        let cloud = cells_of(optical_depth, side_m);
        let mut prepared = Prepared::new();
        for (elevation, height_m) in [(90.0, 2.0), (0.0, 3.5 * side_m), (30.0, 7.5 * side_m)] {
            for sampling in samplings {
                // Each jump marches whole tiles of far clouds.
                let sizes = &sizes[if sampling == ViewSampling::Impostors { 4 } else { 0 }..];
                let (mut history, mut gpu_history) = (History::default(), GpuHistory::default());
                // Each twice, so that the second has something to build on.
                for n in 0..2 * sizes.len() {
                    let step = (n / 2) as f32;
                    let (width, height) = sizes[n / 2];
                    let view = ViewSettings {
                        camera_position_m: [(2.2 + 0.1 * step) * side_m, 1.7 * side_m, height_m],
                        elevation_deg: 60.0 - 15.0 * step,
                        sun_direction: sun(elevation, 0.0),
                        width,
                        height,
                        sampling,
                        ..small()
                    };
                    let drawn = gpu.render_live(Some(&cloud), &view, &mut gpu_history, &mut |_| {});
                    let drawn = drawn.unwrap();
                    let wanted = render_live(Some(&cloud), &view, &mut history, &mut prepared, &mut |_| {});
                    let far = drawn.iter().zip(&wanted).filter(|(a, b)| a.abs_diff(**b) > 3).count();
                    // As of single pictures.
                    assert!(
                        drawn.len() == wanted.len() && far <= 3,
                        "depth {optical_depth}, {view:?}: {far} values"
                    );
                }
            }
        }
    }
}

#[test]
fn pictures_of_one_pixel_and_of_none() {
    let cloud = cumulus_field(7, 12);
    judge(&mut Prepared::new(), "1 x 1", &cloud, &settings(1, 1), 1.0);
    let none = settings(0, 3);
    let mut film = Film::new(0);
    path_trace(Some(&cloud), &none, &mut Prepared::new(), 1.0, &mut film, 4);
    assert!(radiance(Some(&cloud), &none, &mut Prepared::new()).is_empty() && film.radiance().is_empty());
}

/// Without cloud both draw the same sky, sun and haze; the ground's light is that of the sky's mean in the march and sampled in the tracer.
#[test]
fn the_tracer_draws_the_same_world_as_the_march() {
    let view = ViewSettings {
        elevation_deg: 40.0,
        sun_direction: sun(45.0, 10.0),
        ..settings(24, 16)
    };
    let mut prepared = Prepared::new();
    let mut traced = |view: &ViewSettings, paths| {
        let mut film = Film::new(view.width * view.height);
        path_trace(None, view, &mut prepared, 1.0, &mut film, paths);
        film.radiance()
    };
    let marched = radiance(None, &view, &mut Prepared::new());
    for (ours, theirs) in marched.iter().flatten().zip(traced(&view, 2).iter().flatten()) {
        // Directions in 32 and 64 bits: at the sun's edge that shifts the disc by a thousandth of its light.
        let allowed = 1e-4 * f64::from(*ours) + if *ours > 1.0 { 30.0 } else { 1e-6 };
        assert!((f64::from(*ours) - theirs).abs() < allowed, "{ours} {theirs}");
    }
    let down = ViewSettings {
        elevation_deg: -40.0,
        vertical_fov_deg: 20.0,
        ..view
    };
    let (ours, theirs) = (radiance(None, &down, &mut Prepared::new()), traced(&down, 64));
    let mean = |v: Vec<f64>| v.iter().sum::<f64>() / v.len() as f64;
    let ours = mean(ours.iter().flatten().map(|v| f64::from(*v)).collect());
    let theirs = mean(theirs.into_iter().flatten().collect());
    // 96 directions stand for the sky in the march.
    assert!((ours / theirs - 1.0).abs() < 0.02, "{ours} {theirs}");
}

/// What a viewer's last picture has left is of another sky an hour later, and where the world went back: the next picture is the one that a new viewer gets. Ten
/// seconds later it is still used, by the same pictures (those that impostors keep are the ones that a new viewer would make).
#[tokio::test]
async fn an_hour_later_nothing_of_the_last_picture_is_used() {
    for sampling in ["reproject_4", "reproject_16", "impostors"] {
        let mut scene = common::scene();
        scene["methods"] = json!({ "view_sampling": sampling });
        let server = common::cloudy_server(scene).await;
        let host = server.state.world("w1").unwrap();
        let newest = host.view().newest();
        // The same cloud under the same sun at another time, so that nothing but the time forbids what was kept.
        let at = |later_s: f64| {
            let mut published = (*newest).clone();
            published.revision += 1_000 + later_s.abs() as u64;
            published.snapshot.numbers.simulated_s += later_s;
            let mut view = host.view().clone();
            view.published = watch::channel(Arc::new(published)).1;
            view
        };
        for (later_s, used) in [(10.0, true), (3_600.0, false), (-10.0, false)] {
            let mut seen = Vec::new();
            for times in [vec![0.0, later_s], vec![later_s]] {
                let renderer = RenderService::start(Compute::Cpu, 1.0).unwrap();
                let present = renderer.viewer();
                let mut last = Vec::new();
                for time in times {
                    let azimuth_deg = if time == 0.0 { 0.0 } else { 1.3 };
                    let camera = json!({
                        "position_m": [1600, -2000, 300], "azimuth_deg": azimuth_deg, "elevation_deg": 10, "vertical_fov_deg": 60
                    });
                    let request = FrameRequest {
                        width: 48,
                        height: 32,
                        format: FrameFormat::Png,
                        camera: serde_json::from_value(camera).unwrap(),
                        still: false,
                        whole: false,
                        past: None,
                        layers: None,
                    };
                    let ticket = renderer.request(present.viewer, &at(time), request, 10).unwrap();
                    let frame = ticket.answer.await.unwrap().unwrap();
                    last = image::load_from_memory(&frame.bytes).unwrap().to_rgb8().into_raw();
                }
                seen.push(last);
            }
            assert_eq!(seen[0].len(), 3 * 48 * 32);
            let used = used && sampling != "impostors";
            assert_eq!(seen[0] != seen[1], used, "{sampling}, {later_s} s later");
        }
    }
}
