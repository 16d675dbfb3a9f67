//! Stages within pictures: byte by byte.

use welkin_server::clouds::{ball, cumulus_field, settings, sun};
use welkin_shaders::CloudVolume;
use welkin_shaders::cpu::light::analytic_sky::SkyMethod;
use welkin_shaders::cpu::light::phase_table::PhaseChoice;
use welkin_shaders::cpu::view::layers::Layer;
use welkin_shaders::cpu::view::reproject::History;
use welkin_shaders::cpu::view::{
    Detail, Ground, MapKind, MoonPlace, Prepared, Scattering, StarPlaces, SunOcclusion, ViewSampling, ViewSettings,
    layers, render, render_live,
};
use welkin_shaders::gpu::{GpuHistory, GpuView};
use welkin_shaders::view::ViewSteps;

use super::{Bench, Pair};

pub(super) const WIDTH: usize = 160;
pub(super) const HEIGHT: usize = 90;

pub(super) fn pictures(bench: &mut Bench, volume: Option<&CloudVolume>, views: &[(&str, ViewSettings)]) -> Vec<Pair> {
    let mut prepared = Prepared::new();
    let mut gpu_view = GpuView::new(bench.stages.clone()).unwrap();
    views
        .iter()
        .map(|(name, view)| {
            let cpu = render(volume, view, &mut prepared);
            let gpu = gpu_view.render(volume, view, &mut |_| {}).unwrap();
            save(name, view, &cpu, &gpu);
            Pair {
                what: (*name).to_owned(),
                cpu: cpu.into_iter().map(f32::from).collect(),
                gpu: gpu.into_iter().map(f32::from).collect(),
            }
        })
        .collect()
}

/// Writes both pictures side by side into the folder that `WELKIN_KEEP_PICTURES` names, for eyes.
pub(super) fn save(name: &str, view: &ViewSettings, cpu: &[u8], gpu: &[u8]) {
    let Ok(folder) = std::env::var("WELKIN_KEEP_PICTURES") else {
        return;
    };
    let row = view.width * 3;
    let both: Vec<u8> = cpu
        .chunks(row)
        .zip(gpu.chunks(row))
        .flat_map(|(a, b)| [a, b].concat())
        .collect();
    let path = format!("{folder}/{}.png", name.replace([' ', ','], "_"));
    let (width, height) = (2 * view.width as u32, view.height as u32);
    image::save_buffer(path, &both, width, height, image::ColorType::Rgb8).unwrap();
}

pub(super) fn changed(change: impl FnOnce(&mut ViewSettings)) -> ViewSettings {
    let mut view = settings(WIDTH, HEIGHT);
    change(&mut view);
    view
}

const fn mapped(kind: MapKind, side: u32) -> SunOcclusion {
    SunOcclusion::ShadowMap { kind, side }
}

pub(super) fn march(bench: &mut Bench) -> Vec<Pair> {
    let field = cumulus_field(7, 12);
    let mut all = pictures(
        bench,
        Some(&field),
        &[
            ("from the ground", settings(WIDTH, HEIGHT)),
            (
                "from above",
                changed(|v| {
                    v.camera_position_m = [3200.0, -2000.0, 4000.0];
                    v.elevation_deg = -25.0;
                }),
            ),
            (
                "beside the clouds",
                changed(|v| {
                    v.camera_position_m = [3200.0, -2000.0, 1000.0];
                    v.elevation_deg = 0.0;
                }),
            ),
            (
                "into the sun",
                changed(|v| {
                    v.sun_direction = sun(20.0, 10.0);
                    v.detail = Some(Detail {
                        strength: 1.0,
                        scale_m: 150.0,
                    });
                }),
            ),
            (
                "Mie from above, the sun behind",
                changed(|v| {
                    v.camera_position_m = [3200.0, -2000.0, 4000.0];
                    v.elevation_deg = -30.0;
                    v.sun_direction = sun(30.0, 180.0);
                    v.lighting.phase = PhaseChoice::Mie {
                        effective_radius_um: 9.0,
                    };
                }),
            ),
            (
                "multiple forward scattering",
                changed(|v| v.lighting.scattering = Scattering::MultipleForward),
            ),
            (
                "a march from every sample",
                changed(|v| v.lighting.sun_occlusion = SunOcclusion::SecondaryMarch { steps: 5 }),
            ),
            (
                "diffused light",
                changed(|v| v.lighting.scattering = Scattering::Diffusion),
            ),
            (
                "diffused light and an exponential map of a low sun, no detail",
                changed(|v| {
                    v.detail = None;
                    v.lighting.scattering = Scattering::Diffusion;
                    v.lighting.sun_occlusion = mapped(MapKind::Exponential, 40);
                    v.sun_direction = sun(6.0, 70.0);
                }),
            ),
            (
                "a Beer map",
                changed(|v| v.lighting.sun_occlusion = mapped(MapKind::Beer, 200)),
            ),
            (
                "a Fourier map from above",
                changed(|v| {
                    v.lighting.sun_occlusion = mapped(MapKind::Fourier, 128);
                    v.camera_position_m = [3200.0, -2000.0, 4000.0];
                    v.elevation_deg = -25.0;
                }),
            ),
            (
                "dusk",
                changed(|v| {
                    v.azimuth_deg = 250.0;
                    v.sun_direction = sun(3.0, 270.0);
                }),
            ),
            (
                "an odd size, no detail",
                changed(|v| {
                    v.width = 83;
                    v.height = 45;
                    v.detail = None;
                }),
            ),
        ],
    );
    let thick = ball(1500.0, 700.0, 0.06);
    all.extend(pictures(
        bench,
        Some(&thick),
        &[
            (
                "inside a cloud",
                changed(|v| v.camera_position_m = [3200.0, 3200.0, 1500.0]),
            ),
            (
                "diffused light in a ball",
                changed(|v| {
                    v.camera_position_m = [3200.0, -200.0, 300.0];
                    v.lighting.scattering = Scattering::Diffusion;
                }),
            ),
        ],
    ));
    let mut empty = thick;
    empty.extinction_per_m.fill(0.0);
    empty.cloudy_levels = [0, 0];
    all.extend(pictures(
        bench,
        Some(&empty),
        &[("an empty volume", settings(WIDTH, HEIGHT))],
    ));
    all
}

pub(super) fn view_steps(bench: &mut Bench) -> Vec<Pair> {
    let by = |steps| changed(|v| v.steps = steps);
    let views = [
        ("segments", by(ViewSteps::LogarithmicSegments { segments: 5 })),
        ("many segments", by(ViewSteps::LogarithmicSegments { segments: 60 })),
        (
            "steps of a quarter",
            by(ViewSteps::ByOpticalDepth { optical_depth: 0.25 }),
        ),
    ];
    pictures(bench, Some(&cumulus_field(4, 12)), &views)
}

pub(super) fn upsample(bench: &mut Bench) -> Vec<Pair> {
    let half = |change: fn(&mut ViewSettings)| {
        changed(|v| {
            v.sampling = ViewSampling::HalfResolution;
            change(v);
        })
    };
    let mut all = pictures(
        bench,
        Some(&cumulus_field(7, 12)),
        &[
            ("at half the resolution", half(|_| ())),
            (
                "at half the resolution, an odd size, from above",
                half(|v| {
                    v.width = 83;
                    v.height = 45;
                    v.camera_position_m = [3200.0, -2000.0, 4000.0];
                    v.elevation_deg = -25.0;
                }),
            ),
            (
                "at half the resolution into the sun",
                half(|v| v.sun_direction = sun(20.0, 10.0)),
            ),
        ],
    );
    all.extend(pictures(
        bench,
        Some(&ball(1500.0, 700.0, 0.06)),
        &[(
            "at half the resolution inside a cloud",
            half(|v| v.camera_position_m = [3200.0, 3200.0, 1500.0]),
        )],
    ));
    all
}

/// A picture's layers on both devices, its numbers apart: light, what passes and opacity; distances.
pub(super) fn layers_of_both(bench: &mut Bench) -> Vec<Pair> {
    let field = cumulus_field(7, 12);
    let mut prepared = Prepared::new();
    let mut gpu_view = GpuView::new(bench.stages.clone()).unwrap();
    let size = WIDTH * HEIGHT;
    // Objects anywhere, some in cloud, and none on every third pixel.
    let objects: Vec<f32> = (0..size)
        .map(|n| [bench.between(0.0, 9_000.0), f32::INFINITY][usize::from(n % 3 == 0)])
        .collect();
    let mut clear = settings(WIDTH, HEIGHT);
    clear.visibility_m = None;
    let cases = [
        ("no objects", Some(&field), settings(WIDTH, HEIGHT), None),
        ("objects", Some(&field), settings(WIDTH, HEIGHT), Some(&objects[..])),
        ("objects without haze", Some(&field), clear, Some(&objects[..])),
        (
            "objects without cloud",
            None,
            settings(WIDTH, HEIGHT),
            Some(&objects[..]),
        ),
    ];
    let mut all = Vec::new();
    for (what, volume, view, objects_m) in cases {
        let cpu = layers(volume, &view, objects_m, &mut prepared, &mut |_| {});
        let gpu = gpu_view.layers(volume, &view, objects_m, &mut |_| {}).unwrap();
        let part = |layers: &[Layer], numbers: &[usize]| -> Vec<f32> {
            layers.iter().flat_map(|l| numbers.iter().map(|n| l[*n])).collect()
        };
        let mut parts = vec![("light and shares", &[0, 1, 2, 3, 5][..])];
        if volume.is_some() {
            parts.push(("distances", &[4]));
        }
        for (name, numbers) in parts {
            all.push(Pair {
                what: format!("{what}: {name}"),
                cpu: part(&cpu, numbers),
                gpu: part(&gpu, numbers),
            });
        }
    }
    all
}

/// Viewers' pictures one after another on both devices: still objects and sky, clouds in the wind, a camera that turns and flies, one that is suddenly elsewhere, other sizes, other light, no cloud.
pub(super) fn reproject(bench: &mut Bench) -> Vec<Pair> {
    let (field, thick) = (cumulus_field(7, 12), ball(1500.0, 700.0, 0.06));
    let mut all = vec![second_band(bench)];
    for sampling in [ViewSampling::Reproject4, ViewSampling::Reproject16] {
        let now = |change: &dyn Fn(&mut ViewSettings)| {
            changed(|v| {
                v.sampling = sampling;
                change(v);
            })
        };
        let mut blown = field.clone();
        let mut series: Vec<(String, Option<CloudVolume>, ViewSettings)> = Vec::new();
        for n in 0..2 {
            series.push((format!("at rest, {n}"), Some(field.clone()), now(&|_| ())));
        }
        for n in 1..5 {
            let view = now(&|v| {
                v.azimuth_deg += 0.7 * n as f32;
                v.camera_position_m[1] += 15.0 * n as f32;
            });
            series.push((format!("a moving camera, {n}"), Some(field.clone()), view));
        }
        for n in 1..3 {
            blown.air_displacement_m = [6.0 * n as f32, 2.0 * n as f32, 0.0];
            series.push((format!("wind, {n}"), Some(blown.clone()), now(&|_| ())));
        }
        let among = |v: &mut ViewSettings| {
            v.camera_position_m = [3200.0, -2000.0, 1000.0];
            v.elevation_deg = 0.0;
        };
        // Near clouds uncover far ones.
        series.push(("suddenly among the clouds".to_owned(), Some(field.clone()), now(&among)));
        let aside = now(&|v| {
            among(v);
            v.camera_position_m[0] += 250.0;
        });
        series.push(("a jump aside".to_owned(), Some(field.clone()), aside));
        let small = now(&|v| (v.width, v.height) = (83, 45));
        series.push(("a smaller picture".to_owned(), Some(field.clone()), small));
        let turned = now(&|v| {
            (v.width, v.height) = (83, 45);
            v.azimuth_deg += 1.3;
        });
        series.push(("a smaller picture, turned".to_owned(), Some(field.clone()), turned));
        let low = now(&|v| v.sun_direction = sun(9.0, 40.0));
        series.push(("a low sun".to_owned(), Some(field.clone()), low));
        series.push(("no cloud".to_owned(), None, low));
        let inside = |v: &mut ViewSettings| v.camera_position_m = [3200.0, 3200.0, 1500.0];
        series.push(("inside a cloud".to_owned(), Some(thick.clone()), now(&inside)));
        let rising = now(&|v| {
            inside(v);
            v.camera_position_m[2] += 20.0;
        });
        series.push(("rising inside a cloud".to_owned(), Some(thick.clone()), rising));
        all.extend(streams(bench, sampling, &series));
    }
    all
}

/// The pictures of one viewer on both devices.
fn streams(
    bench: &mut Bench,
    sampling: ViewSampling,
    series: &[(String, Option<CloudVolume>, ViewSettings)],
) -> Vec<Pair> {
    let (mut prepared, mut history) = (Prepared::new(), History::default());
    let mut gpu_view = GpuView::new(bench.stages.clone()).unwrap();
    let mut gpu_history = GpuHistory::default();
    let mut pairs = Vec::new();
    for (name, volume, view) in series {
        let volume = volume.as_ref();
        let whole_view = ViewSettings {
            sampling: ViewSampling::EveryPixel,
            ..*view
        };
        let cpu = render_live(volume, view, &mut history, &mut prepared, &mut |_| {});
        let mut ran = Vec::new();
        let gpu = gpu_view
            .render_live(volume, view, &mut gpu_history, &mut |stage| ran.push(stage))
            .unwrap();
        let stage = match volume {
            Some(_) if sampling == ViewSampling::Impostors => "impostors",
            Some(_) => "reproject",
            None => "march",
        };
        assert_eq!(ran.last(), Some(&stage), "{name}");
        let bytes = gpu_history.bytes();
        match stage {
            "reproject" => assert_eq!(
                bytes,
                (20 * view.width * view.height).next_multiple_of(16) as u64,
                "{name}"
            ),
            "impostors" => assert!(bytes > 0 && bytes <= 128 * 21_780, "{name}: {bytes}"),
            _ => assert_eq!(bytes, 0, "{name}"),
        }
        save(&format!("{sampling:?} {name}"), view, &cpu, &gpu);
        let rests = name.starts_with("at rest");
        if rests
            || ["a moving camera", "nearer by 45 m"]
                .iter()
                .any(|n| name.starts_with(n))
        {
            let whole = gpu_view.render(volume, &whole_view, &mut |_| {}).unwrap();
            let softer = changed_values(&gpu, &whole);
            println!("{sampling:?}, {name}: {softer} values are not the whole picture's");
            assert_eq!(softer > gpu.len() / 100, !rests, "{sampling:?}, {name}");
        }
        pairs.push(Pair {
            what: format!("{sampling:?}, {name}"),
            cpu: cpu.into_iter().map(f32::from).collect(),
            gpu: gpu.into_iter().map(f32::from).collect(),
        });
    }
    pairs
}

/// The same of far clouds on kept pictures: rest, little and larger moves, turns, weather that goes on, other fields of view, views where nothing is far.
pub(super) fn impostors(bench: &mut Bench) -> Vec<Pair> {
    let field = cumulus_field(7, 12);
    let view = |change: &dyn Fn(&mut ViewSettings)| {
        changed(|v| {
            v.sampling = ViewSampling::Impostors;
            v.elevation_deg = 12.0;
            change(v);
        })
    };
    let mut series: Vec<(String, Option<CloudVolume>, ViewSettings)> = Vec::new();
    let mut add =
        |name: &str, volume: Option<&CloudVolume>, view| series.push((name.to_owned(), volume.cloned(), view));
    add("far clouds", Some(&field), view(&|_| ()));
    add("far clouds again", Some(&field), view(&|_| ()));
    add(
        "nearer by 15 m",
        Some(&field),
        view(&|v| v.camera_position_m[1] += 15.0),
    );
    add(
        "nearer by 45 m",
        Some(&field),
        view(&|v| v.camera_position_m[1] += 45.0),
    );
    let turned = |v: &mut ViewSettings| {
        v.camera_position_m[1] += 45.0;
        v.azimuth_deg += 10.0;
    };
    add("turned", Some(&field), view(&turned));
    // Weather that goes on by a tenth, three times.
    let mut later = field.clone();
    for n in 1..4 {
        later.extinction_per_m.iter_mut().for_each(|e| *e *= 1.1);
        add(&format!("later weather, {n}"), Some(&later), view(&turned));
    }
    add("wider", Some(&later), view(&|v| v.vertical_fov_deg = 60.0));
    add("narrower", Some(&later), view(&|v| v.vertical_fov_deg = 25.0));
    add("nothing far", Some(&later), view(&|v| v.elevation_deg = 85.0));
    let beside = |v: &mut ViewSettings| {
        v.camera_position_m = [3200.0, -2000.0, 1000.0];
        v.elevation_deg = 0.0;
        // The cube's corner.
        v.azimuth_deg = 45.0;
    };
    add("beside the clouds, to the north-east", Some(&field), view(&beside));
    let small = |v: &mut ViewSettings| {
        beside(v);
        (v.width, v.height) = (83, 45);
    };
    add("small, beside the clouds", Some(&field), view(&small));
    let low = |v: &mut ViewSettings| v.sun_direction = sun(9.0, 40.0);
    add("far clouds by a low sun", Some(&field), view(&low));
    add("a sky without them", None, view(&low));
    add("far clouds by a low sun again", Some(&field), view(&low));
    streams(bench, ViewSampling::Impostors, &series)
}

/// Values that differ by more than a level.
fn changed_values(a: &[u8], b: &[u8]) -> usize {
    a.iter().zip(b).filter(|(a, b)| a.abs_diff(**b) > 1).count()
}

/// A picture so tall that a GPU draws it in two bands: what the second one, clouds below the camera, has left shows in the next picture, which is softer there than a whole one.
fn second_band(bench: &mut Bench) -> Pair {
    const COLUMNS: usize = 64;
    const FIRST_BAND: usize = 4096;
    let field = cumulus_field(5, 40);
    let at = |azimuth_deg: f32, sampling| {
        changed(|v| {
            (v.width, v.height) = (COLUMNS, FIRST_BAND + 64);
            v.camera_position_m = [3200.0, -2000.0, 4000.0];
            // The sky above, a strip of cloud at the bottom.
            v.elevation_deg = 38.0;
            v.vertical_fov_deg = 100.0;
            v.azimuth_deg = azimuth_deg;
            v.sampling = sampling;
        })
    };
    let (mut prepared, mut history) = (Prepared::new(), History::default());
    let mut gpu_view = GpuView::new(bench.stages.clone()).unwrap();
    let mut gpu_history = GpuHistory::default();
    let (mut cpu, mut gpu) = (Vec::new(), Vec::new());
    for azimuth_deg in [0.0, 0.31] {
        let view = at(azimuth_deg, ViewSampling::Reproject16);
        cpu = render_live(Some(&field), &view, &mut history, &mut prepared, &mut |_| {});
        gpu = gpu_view
            .render_live(Some(&field), &view, &mut gpu_history, &mut |_| {})
            .unwrap();
    }
    let whole = gpu_view.render(Some(&field), &at(0.31, ViewSampling::EveryPixel), &mut |_| {});
    let below = FIRST_BAND * COLUMNS * 3..;
    let (cpu, gpu, whole) = (&cpu[below.clone()], &gpu[below.clone()], &whole.unwrap()[below]);
    let softer = changed_values(gpu, whole);
    println!("the second band: {softer} values are not the whole picture's");
    assert!(softer > gpu.len() / 50, "{softer} of {} values", gpu.len());
    Pair {
        what: "the second band".to_owned(),
        cpu: cpu.iter().map(|v| f32::from(*v)).collect(),
        gpu: gpu.iter().map(|v| f32::from(*v)).collect(),
    }
}

pub(super) fn octaves(bench: &mut Bench) -> Vec<Pair> {
    let views = [0, 1, 8].map(|octaves| {
        changed(|v| {
            v.lighting.scattering = Scattering::Octaves;
            v.multiple_scattering_octaves = octaves;
            v.visibility_m = None;
        })
    });
    let named = [
        ("no octave", views[0]),
        ("one octave", views[1]),
        ("eight octaves", views[2]),
    ];
    pictures(bench, Some(&cumulus_field(11, 10)), &named)
}

pub(super) fn ground(bench: &mut Bench) -> Vec<Pair> {
    let down = |kind| {
        changed(|v| {
            v.ground = kind;
            v.camera_position_m[2] = 1800.0;
            v.elevation_deg = -20.0;
        })
    };
    pictures(bench, None, &[("land", down(Ground::Land)), ("sea", down(Ground::Sea))])
}

pub(super) fn ground_shadow(bench: &mut Bench) -> Vec<Pair> {
    let view = changed(|v| {
        v.camera_position_m[2] = 5000.0;
        v.elevation_deg = -90.0;
    });
    pictures(bench, Some(&cumulus_field(5, 14)), &[("shadows from above", view)])
}

pub(super) fn haze(bench: &mut Bench) -> Vec<Pair> {
    let view = changed(|v| {
        v.visibility_m = Some(6_000.0);
        v.surface_altitude_m = 800.0;
        v.elevation_deg = 8.0;
    });
    pictures(bench, Some(&cumulus_field(3, 12)), &[("thick haze", view)])
}

pub(super) fn light_shafts(bench: &mut Bench) -> Vec<Pair> {
    let shafts = |change: fn(&mut ViewSettings)| {
        changed(|v| {
            v.visibility_m = Some(12_000.0);
            v.light_shafts = 24;
            v.sun_direction = sun(25.0, 15.0);
            change(v);
        })
    };
    let views = [
        ("shafts towards the sun", shafts(|_| {})),
        (
            "shafts from above",
            shafts(|v| {
                v.camera_position_m = [3200.0, -2000.0, 4000.0];
                v.elevation_deg = -25.0;
            }),
        ),
        (
            "shafts beside the clouds of a low sun",
            shafts(|v| {
                v.camera_position_m = [3200.0, -2000.0, 1000.0];
                v.elevation_deg = 0.0;
                v.sun_direction = sun(2.0, 80.0);
            }),
        ),
    ];
    pictures(bench, Some(&cumulus_field(6, 14)), &views)
}

pub(super) fn march_phase(bench: &mut Bench) -> Vec<Pair> {
    let by = |choice| changed(|v| v.lighting.phase = choice);
    let views = [
        ("one lobe", by(PhaseChoice::HenyeyGreenstein { asymmetry: 0.8 })),
        (
            "Mie's phase function",
            by(PhaseChoice::Mie {
                effective_radius_um: 8.0,
            }),
        ),
    ];
    pictures(bench, Some(&cumulus_field(8, 12)), &views)
}

pub(super) fn tone_map(bench: &mut Bench) -> Vec<Pair> {
    let at = |elevation, exposure| {
        changed(|v| {
            v.sun_direction = sun(elevation, 20.0);
            v.exposure_ev = exposure;
        })
    };
    let views = [
        ("dim", at(50.0, -4.0)),
        ("bright", at(50.0, 4.0)),
        ("the sun", at(25.0, 0.0)),
        ("night", at(-12.0, 0.0)),
    ];
    pictures(bench, None, &views)
}

pub(super) fn analytic_sky(bench: &mut Bench) -> Vec<Pair> {
    let by = |sky, elevation| {
        changed(|v| {
            v.sky = sky;
            v.sun_direction = sun(elevation, 60.0);
        })
    };
    let views = [
        ("Preetham's sky", by(SkyMethod::Preetham, 40.0)),
        ("Hosek and Wilkie's sky", by(SkyMethod::HosekWilkie, 40.0)),
        ("half way to the tables", by(SkyMethod::HosekWilkie, 1.5)),
    ];
    pictures(bench, Some(&cumulus_field(9, 8)), &views)
}

pub(super) fn by_night(change: impl FnOnce(&mut ViewSettings)) -> ViewSettings {
    changed(|v| {
        v.sun_direction = sun(-25.0, 200.0);
        change(v);
    })
}

pub(super) fn moon(bench: &mut Bench) -> Vec<Pair> {
    let place = |elevation, azimuth| {
        Some(MoonPlace {
            direction: sun(elevation, azimuth),
            distance_m: 370_000_000.0,
        })
    };
    let views = [
        ("moonlight", by_night(|v| v.moon = place(35.0, 120.0))),
        (
            "the moon's disc",
            by_night(|v| {
                v.moon = place(20.0, 2.0);
                v.vertical_fov_deg = 2.0;
                v.azimuth_deg = 2.0;
                v.elevation_deg = 20.0;
            }),
        ),
        (
            "the moon at dusk over the sea",
            by_night(|v| {
                v.sun_direction = sun(-5.0, 270.0);
                v.moon = place(8.0, 10.0);
                v.ground = Ground::Sea;
            }),
        ),
        ("the moon by day", changed(|v| v.moon = place(20.0, 350.0))),
    ];
    pictures(bench, Some(&cumulus_field(9, 10)), &views)
}

pub(super) fn stars(bench: &mut Bench) -> Vec<Pair> {
    let turned = |years_since_2000, faintest| {
        by_night(|v| {
            v.stars = Some(StarPlaces {
                equatorial_from_world: [[0.36, -0.64, 0.68], [-0.48, 0.48, 0.735], [-0.8, -0.6, 0.0]],
                years_since_2000,
                faintest,
            });
        })
    };
    let views = [("stars", turned(26.0, 6.0)), ("few stars", turned(-40.0, 3.0))];
    pictures(bench, Some(&cumulus_field(9, 4)), &views)
}
