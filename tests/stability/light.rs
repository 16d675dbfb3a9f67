//! Hard cases for light: the march and the path tracer give finite radiance, never below 0 and never above what one scattering of the sun
//! straight ahead and its disc together could give.

use std::sync::Arc;

use welkin_server::clouds::{ball, cumulus_field, settings, sun, volume};
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

/// Every rung of light at its smallest.
fn lightings() -> Vec<Lighting> {
    let default = Lighting::default();
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
    by_scattering.into_iter().chain(by_occlusion).collect()
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
        for lighting in lightings() {
            for elevation in [90.0, 30.0, 0.0, -3.0] {
                for height_m in [2.0, 3.5 * side_m, 7.5 * side_m] {
                    let view = ViewSettings {
                        camera_position_m: [2.2 * side_m, 1.7 * side_m, height_m],
                        elevation_deg: if height_m > 6.0 * side_m { -30.0 } else { 30.0 },
                        // Away from the sun, so that its disc does not hide anything.
                        azimuth_deg: 180.0,
                        sun_direction: sun(elevation, 0.0),
                        lighting,
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
        for lighting in lightings() {
            let view = ViewSettings { lighting, ..view };
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
    for lighting in lightings() {
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
                ..small()
            };
            let what = format!("{azimuth_deg} {elevation_deg} {lighting:?}");
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
    for lighting in lightings() {
        let view = ViewSettings {
            lighting,
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
        for lighting in lightings() {
            for (elevation, height_m) in [(90.0, 2.0), (0.0, 3.5 * side_m), (30.0, 7.5 * side_m)] {
                let view = ViewSettings {
                    camera_position_m: [2.2 * side_m, 1.7 * side_m, height_m],
                    elevation_deg: 30.0,
                    sun_direction: sun(elevation, 0.0),
                    lighting,
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
