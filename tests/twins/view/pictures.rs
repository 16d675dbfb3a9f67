//! Stages within pictures: byte by byte.

use welkin_server::clouds::{ball, cumulus_field, settings, sun};
use welkin_shaders::CloudVolume;
use welkin_shaders::catalogue::{Devices, Rung};
use welkin_shaders::cpu::light::analytic_sky::SkyMethod;
use welkin_shaders::cpu::light::phase_table::PhaseChoice;
use welkin_shaders::cpu::view::layers::Layer;
use welkin_shaders::cpu::view::{
    Detail, Ground, MapKind, MoonPlace, Prepared, Scattering, StarPlaces, SunOcclusion, ViewSampling, ViewSettings,
    layers, render,
};
use welkin_shaders::gpu::GpuView;
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

/// No GPU has it; the CPU's is judged in `images/sampling.rs`, and here that every kernel's rung says so.
pub(super) fn reproject(_: &mut Bench) -> Vec<Pair> {
    for rung in [Rung::Reproject4, Rung::Reproject16] {
        assert!(matches!(rung.info().devices, Devices::CpuOnly(_)), "{rung:?}");
    }
    Vec::new()
}

pub(super) fn octaves(bench: &mut Bench) -> Vec<Pair> {
    let views = [0, 1, 8].map(|octaves| {
        changed(|v| {
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
