//! Every stage of light and view on both devices, with the same input: results within the tolerance that the catalogue holds beside the
//! stage. Stages that run within the march are judged by pictures in which they show.
//!
//! Results' buffers are filled with NaN first, so that what a stage leaves out is seen. Without an adapter the tests say so and pass, unless
//! `WELKIN_REQUIRE` names `gpu`.

#[path = "common.rs"]
mod adapter;

use std::sync::Arc;

use adapter::adapter;
use welkin_server::clouds::{Random, ball, cumulus_field, settings, sun, volume};
use welkin_server::machine::Compute;
use welkin_server::picture::{self, Renderer};
use welkin_server::world::World;
use welkin_shaders::catalogue::{Devices, Rung, VIEW_STAGES, Within};
use welkin_shaders::cpu::light::Atmosphere;
use welkin_shaders::cpu::light::analytic_sky::SkyMethod;
use welkin_shaders::cpu::light::multiple_scattering_table::MultipleScatteringTable;
use welkin_shaders::cpu::light::phase_table::PhaseChoice;
use welkin_shaders::cpu::light::sky_light::SkyLight;
use welkin_shaders::cpu::light::sky_table::{SkySource, SkyTable};
use welkin_shaders::cpu::light::sky_visibility::sky_visibility;
use welkin_shaders::cpu::light::sun_optical_depth::SunLight;
use welkin_shaders::cpu::light::transmittance_table::TransmittanceTable;
use welkin_shaders::cpu::view::detail_noise::DetailNoise;
use welkin_shaders::cpu::view::layers::Layer;
use welkin_shaders::cpu::view::occupancy::Occupancy;
use welkin_shaders::cpu::view::shape::Shape;
use welkin_shaders::cpu::view::{
    Detail, Ground, MoonPlace, Prepared, Scattering, StarPlaces, SunOcclusion, ViewSampling, ViewSettings, layers,
    render,
};
use welkin_shaders::gpu::view_stages::{Air, ShapeGrid, SkyLightAsk, SkyView, SunMarch, ViewStages};
use welkin_shaders::gpu::{Context, GpuError, GpuView};
use welkin_shaders::view::{Slab, ViewSteps};
use welkin_shaders::{CloudVolume, Grid};

/// What two devices made of the same input.
struct Pair {
    what: String,
    cpu: Vec<f32>,
    gpu: Vec<f32>,
}

/// What a stage needs beside its input.
struct Bench {
    context: Arc<Context>,
    stages: Arc<ViewStages>,
    random: Random,
}

impl Bench {
    fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.random.next()
    }
    /// A buffer of NaN for a result.
    fn poisoned(&self, bytes: u64) -> wgpu::Buffer {
        let buffer = self.context.storage("a result", bytes).unwrap();
        self.poison(&buffer);
        buffer
    }
    fn poison(&self, buffer: &wgpu::Buffer) {
        let nan = vec![f32::NAN; buffer.size() as usize / 4];
        self.context.queue.write_buffer(buffer, 0, bytemuck::cast_slice(&nan));
    }
    fn input<T: bytemuck::Pod>(&self, values: &[T]) -> wgpu::Buffer {
        let mut bytes = bytemuck::cast_slice(values).to_vec();
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        self.context.storage_of("an input", &bytes).unwrap()
    }
    fn uniform<T: bytemuck::Pod>(&self, value: &T) -> wgpu::Buffer {
        self.context.uniform("an input", bytemuck::bytes_of(value)).unwrap()
    }
    fn words(&self, buffer: &wgpu::Buffer, count: usize) -> Vec<u32> {
        let bytes = self.context.read(buffer, count as u64 * 4).unwrap();
        bytemuck::pod_collect_to_vec(&bytes)
    }
    fn floats(&self, buffer: &wgpu::Buffer, count: usize) -> Vec<f32> {
        self.words(buffer, count).into_iter().map(f32::from_bits).collect()
    }
    /// Three of every four numbers.
    fn colours(&self, buffer: &wgpu::Buffer, texels: usize) -> Vec<f32> {
        let all = self.floats(buffer, texels * 4);
        all.chunks(4).flat_map(|t| t[..3].to_vec()).collect()
    }
    fn air(&mut self) -> Atmosphere {
        let altitude_m = self.between(-200.0, 3_000.0);
        let visibility_m = self.between(3_000.0, 120_000.0);
        Atmosphere::new(altitude_m, Some(visibility_m))
    }
    fn sun(&mut self) -> [f32; 3] {
        let elevation = self.between(-6.0, 80.0);
        let azimuth = self.between(0.0, 360.0);
        sun(elevation, azimuth)
    }
    /// Broken cloud, some cells of it, any extinction.
    fn cells(&mut self, count: usize, share: f32) -> Vec<f32> {
        (0..count)
            .map(|_| {
                let cloudy = self.random.next() < share;
                let extinction = 0.1 * self.random.next();
                if cloudy { extinction } else { 0.0 }
            })
            .collect()
    }
    fn volume(&mut self, cells: [usize; 3], share: f32) -> CloudVolume {
        let cell_size_m = [
            self.between(60.0, 140.0),
            self.between(60.0, 140.0),
            self.between(25.0, 60.0),
        ];
        let grid = Grid { cells, cell_size_m };
        let cells = self.cells(grid.len(), share);
        volume(grid, cells)
    }
}

fn padded(texels: &[[f32; 3]]) -> Vec<[f32; 4]> {
    texels.iter().map(|t| [t[0], t[1], t[2], f32::NAN]).collect()
}

fn halves(words: &[u32]) -> Vec<f32> {
    words
        .iter()
        .flat_map(|w| [(w & 0xffff) as f32, (w >> 16) as f32])
        .collect()
}

fn tables(bench: &mut Bench) -> (Atmosphere, TransmittanceTable, MultipleScatteringTable) {
    let air = bench.air();
    let transmittance = TransmittanceTable::new(&air);
    let multiple = MultipleScatteringTable::new(&air, &transmittance);
    (air, transmittance, multiple)
}

fn transmittance_table(bench: &mut Bench) -> Vec<Pair> {
    let air = bench.air();
    let cpu = TransmittanceTable::new(&air);
    let table = bench.poisoned(ViewStages::TRANSMITTANCE_BYTES);
    bench
        .stages
        .transmittance_table(&bench.uniform(&Air::new(&air)), &table)
        .unwrap();
    vec![Pair {
        what: format!("{air:?}"),
        gpu: bench.colours(&table, cpu.texels().len()),
        cpu: cpu.texels().concat(),
    }]
}

fn multiple_scattering_table(bench: &mut Bench) -> Vec<Pair> {
    let (air, transmittance, cpu) = tables(bench);
    let table = bench.poisoned(ViewStages::MULTIPLE_BYTES);
    let input = bench.input(&padded(transmittance.texels()));
    bench
        .stages
        .multiple_scattering_table(&bench.uniform(&Air::new(&air)), &input, &table)
        .unwrap();
    vec![Pair {
        what: format!("{air:?}"),
        gpu: bench.colours(&table, cpu.texels().len()),
        cpu: cpu.texels().concat(),
    }]
}

fn sky_table(bench: &mut Bench) -> Vec<Pair> {
    let (air, transmittance, multiple) = tables(bench);
    let inputs = [padded(transmittance.texels()), padded(multiple.texels())].map(|t| bench.input(&t));
    [1.5, 900.0, 30_000.0]
        .into_iter()
        .map(|height_m| {
            let sun = bench.sun();
            let source = SkySource::sun(sun, height_m > 100.0);
            let cpu = SkyTable::new(&air, &transmittance, &multiple, &source, None, height_m);
            let table = bench.poisoned(ViewStages::SKY_BYTES);
            let (air, view) = (bench.uniform(&Air::new(&air)), SkyView::new(&source, height_m));
            bench
                .stages
                .sky_table(&air, &view, &inputs[0], &inputs[1], &table)
                .unwrap();
            let [r, g, b] = cpu.planes();
            Pair {
                what: format!("sun {sun:?} from {height_m} m"),
                gpu: bench.colours(&table, r.len()),
                cpu: (0..r.len()).flat_map(|n| [r[n], g[n], b[n]]).collect(),
            }
        })
        .collect()
}

fn sky_light(bench: &mut Bench) -> Vec<Pair> {
    let (air, transmittance, multiple) = tables(bench);
    let inputs = [padded(transmittance.texels()), padded(multiple.texels())].map(|t| bench.input(&t));
    [Ground::Land, Ground::Sea]
        .into_iter()
        .map(|ground| {
            let sun = bench.sun();
            let base_top_m = [bench.between(100.0, 900.0), bench.between(1_000.0, 9_000.0)];
            let source = SkySource::sun(sun, ground == Ground::Sea);
            let moon = SkySource::moon(bench.sun(), [2.9e-6, 2.5e-6, 2e-6]);
            let share = [0.0, 0.7][usize::from(ground == Ground::Sea)];
            let of = |source| {
                SkyLight::new(
                    &air,
                    &transmittance,
                    &multiple,
                    ground.albedo(),
                    source,
                    None,
                    base_top_m,
                )
            };
            let cpu = of(&source).with_moon(&of(&moon), share, ground.albedo(), moon.direction[2]);
            let values = bench.stages.sky_light_buffer().unwrap();
            bench.poison(&values);
            let air = bench.uniform(&Air::new(&air));
            for ask in [
                SkyLightAsk::new(&source, ground, base_top_m),
                SkyLightAsk::moon(&moon, share, ground, base_top_m),
            ] {
                bench
                    .stages
                    .sky_light(&air, &ask, &inputs[0], &inputs[1], &values)
                    .unwrap();
            }
            let all = [
                cpu.sun_at_base,
                cpu.sun_at_top,
                cpu.sun_at_ground,
                cpu.sky_radiance,
                cpu.sky_irradiance,
                cpu.ground_radiance,
            ];
            Pair {
                what: format!("{ground:?}, sun {sun:?}"),
                gpu: bench.colours(&values, 6),
                cpu: all.concat(),
            }
        })
        .collect()
}

fn shape(bench: &mut Bench) -> Vec<Pair> {
    // Grids that do not fit workgroups, one cell wide, and one too large to be made finer.
    [[37, 21, 18], [1, 9, 6], [6, 1, 5], [1, 1, 4], [128, 96, 90]]
        .into_iter()
        .map(|cells| {
            let volume = bench.volume(cells, 0.2);
            let cpu = Shape::new(&volume).unwrap();
            let slab = Slab::new(&volume).unwrap();
            let grid = ShapeGrid::new(&slab);
            let extinction = bench.input(&slab.extinction_per_m);
            let largest = bench.poisoned(extinction.size());
            let words = bench.poisoned(grid.word_bytes());
            let uniform = bench.uniform(&grid);
            bench
                .stages
                .shape(&grid, &uniform, &extinction, &largest, &words)
                .unwrap();
            Pair {
                what: format!("cells {cells:?}"),
                gpu: halves(&bench.words(&words, cpu.words.len())),
                cpu: halves(&cpu.words),
            }
        })
        .collect()
}

fn occupancy(bench: &mut Bench) -> Vec<Pair> {
    [([33, 27, 19], 0.002), ([64, 1, 9], 0.01), ([7, 5, 40], 0.01)]
        .into_iter()
        .map(|(cells, share)| {
            let mut volume = bench.volume(cells, share);
            volume.extinction_per_m[cells[0] / 2] = 0.1;
            volume.cloudy_levels = [0, cells[2]];
            let slab = Slab::new(&volume).unwrap();
            let cpu = Occupancy::new(&slab.extinction_per_m, slab.cells, slab.cell_size_m);
            let grid = ShapeGrid::new(&slab);
            let largest = bench.input(&slab.extinction_per_m);
            let along = [0, 1].map(|_| bench.poisoned(largest.size()));
            let words = bench.poisoned(grid.occupancy_bytes());
            let uniform = bench.uniform(&grid);
            bench
                .stages
                .occupancy(&grid, &uniform, &largest, [&along[0], &along[1]], &words)
                .unwrap();
            let count = cpu.distances().len();
            let bytes = bench.context.read(&words, count.next_multiple_of(4) as u64).unwrap();
            Pair {
                what: format!("cells {cells:?}"),
                gpu: bytes[..count].iter().map(|b| *b as f32).collect(),
                cpu: cpu.distances().iter().map(|b| *b as f32).collect(),
            }
        })
        .collect()
}

fn sky_visibility_of_both(bench: &mut Bench) -> Vec<Pair> {
    [[64, 64, 30], [33, 7, 12], [1, 40, 9], [300, 5, 6]]
        .into_iter()
        .map(|cells| {
            let slab = Slab::new(&bench.volume(cells, 0.3)).unwrap();
            let cpu = sky_visibility(&slab.extinction_per_m, [cells[0], cells[1]], slab.cell_size_m);
            let extinction = bench.input(&slab.extinction_per_m);
            let [above, below] = [0, 1].map(|_| bench.poisoned(extinction.size()));
            bench.stages.sky_visibility(&slab, &extinction, &above, &below).unwrap();
            let count = slab.extinction_per_m.len();
            Pair {
                what: format!("cells {cells:?}"),
                gpu: [bench.floats(&above, count), bench.floats(&below, count)].concat(),
                cpu: cpu.concat(),
            }
        })
        .collect()
}

fn sun_optical_depth(bench: &mut Bench) -> Vec<Pair> {
    let field = cumulus_field(31, 9);
    let ragged = bench.volume([24, 31, 14], 0.04);
    let cases = [
        (field, true, false, 35.0),
        (ragged.clone(), false, false, 60.0),
        (ragged.clone(), true, false, 0.5),
        (ragged, true, true, 20.0),
    ];
    cases
        .into_iter()
        .flat_map(|(volume, carved, everywhere, elevation)| {
            let sun = sun(elevation, bench.between(0.0, 360.0));
            let cpu_shape = Shape::new(&volume).unwrap();
            let slab = Slab::new(&volume).unwrap();
            let grid = ShapeGrid::new(&slab);
            let seen: [Vec<f32>; 2] =
                [0, 1].map(|_| slab.extinction_per_m.iter().map(|_| bench.random.next()).collect());
            let cpu = SunLight::new(&cpu_shape, &seen, carved, everywhere, sun);
            let inputs = [
                bench.input(&cpu_shape.words),
                bench.input(&cpu_shape.occupancy().distances()[..]),
                bench.input(&seen[0]),
                bench.input(&seen[1]),
            ];
            let words = bench.poisoned(grid.word_bytes());
            let shadow = bench.poisoned(grid.shadow_bytes());
            bench
                .stages
                .sun_optical_depth(
                    &grid,
                    &bench.uniform(&grid),
                    &SunMarch::along(sun, carved, everywhere),
                    [&inputs[0], &inputs[1], &inputs[2], &inputs[3]],
                    &words,
                    &shadow,
                )
                .unwrap();
            let gpu = bench.words(&words, cpu.words.len());
            let parts = |words: &[u32]| -> Vec<f32> {
                let part = |w: &u32| [(w & 0xffff) as f32, (w >> 16 & 0xff) as f32, (w >> 24) as f32];
                words.iter().flat_map(part).collect()
            };
            // The map in the same steps of a thousandth; the share as one.
            let mut map: Vec<f32> = cpu.shadow.iter().map(|t| t * 1e3).collect();
            map.push(cpu.sunlit_share * 1e3);
            let ours = bench.floats(&shadow, map.len());
            let what = format!("sun at {elevation}, carved {carved}, everywhere {everywhere}");
            [
                Pair {
                    what: format!("{what}: points"),
                    gpu: parts(&gpu),
                    cpu: parts(&cpu.words),
                },
                Pair {
                    what: format!("{what}: shadow"),
                    gpu: ours.iter().map(|t| t * 1e3).collect(),
                    cpu: map,
                },
            ]
        })
        .collect()
}

fn detail_noise(bench: &mut Bench) -> Vec<Pair> {
    let cpu = DetailNoise::new();
    let words = bench.poisoned(ViewStages::DETAIL_BYTES);
    bench.stages.detail_noise(&words).unwrap();
    let bytes = |words: &[u32]| {
        words
            .iter()
            .flat_map(|w| w.to_le_bytes().map(f32::from))
            .collect::<Vec<f32>>()
    };
    vec![Pair {
        what: "the tile".to_owned(),
        gpu: bytes(&bench.words(&words, cpu.words().len())),
        cpu: bytes(cpu.words()),
    }]
}

const WIDTH: usize = 160;
const HEIGHT: usize = 90;

fn pictures(bench: &mut Bench, volume: Option<&CloudVolume>, views: &[(&str, ViewSettings)]) -> Vec<Pair> {
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
fn save(name: &str, view: &ViewSettings, cpu: &[u8], gpu: &[u8]) {
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

fn changed(change: impl FnOnce(&mut ViewSettings)) -> ViewSettings {
    let mut view = settings(WIDTH, HEIGHT);
    change(&mut view);
    view
}

fn march(bench: &mut Bench) -> Vec<Pair> {
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
        &[(
            "inside a cloud",
            changed(|v| v.camera_position_m = [3200.0, 3200.0, 1500.0]),
        )],
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

fn view_steps(bench: &mut Bench) -> Vec<Pair> {
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

fn upsample(bench: &mut Bench) -> Vec<Pair> {
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
fn layers_of_both(bench: &mut Bench) -> Vec<Pair> {
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
fn reproject(_: &mut Bench) -> Vec<Pair> {
    for rung in [Rung::Reproject4, Rung::Reproject16] {
        assert!(matches!(rung.info().devices, Devices::CpuOnly(_)), "{rung:?}");
    }
    Vec::new()
}

fn octaves(bench: &mut Bench) -> Vec<Pair> {
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

fn ground(bench: &mut Bench) -> Vec<Pair> {
    let down = |kind| {
        changed(|v| {
            v.ground = kind;
            v.camera_position_m[2] = 1800.0;
            v.elevation_deg = -20.0;
        })
    };
    pictures(bench, None, &[("land", down(Ground::Land)), ("sea", down(Ground::Sea))])
}

fn ground_shadow(bench: &mut Bench) -> Vec<Pair> {
    let view = changed(|v| {
        v.camera_position_m[2] = 5000.0;
        v.elevation_deg = -90.0;
    });
    pictures(bench, Some(&cumulus_field(5, 14)), &[("shadows from above", view)])
}

fn haze(bench: &mut Bench) -> Vec<Pair> {
    let view = changed(|v| {
        v.visibility_m = Some(6_000.0);
        v.surface_altitude_m = 800.0;
        v.elevation_deg = 8.0;
    });
    pictures(bench, Some(&cumulus_field(3, 12)), &[("thick haze", view)])
}

fn light_shafts(bench: &mut Bench) -> Vec<Pair> {
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

fn march_phase(bench: &mut Bench) -> Vec<Pair> {
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

fn tone_map(bench: &mut Bench) -> Vec<Pair> {
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

fn analytic_sky(bench: &mut Bench) -> Vec<Pair> {
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

fn by_night(change: impl FnOnce(&mut ViewSettings)) -> ViewSettings {
    changed(|v| {
        v.sun_direction = sun(-25.0, 200.0);
        change(v);
    })
}

fn moon(bench: &mut Bench) -> Vec<Pair> {
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

fn stars(bench: &mut Bench) -> Vec<Pair> {
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

type Case = (&'static str, fn(&mut Bench) -> Vec<Pair>);

const CASES: &[Case] = &[
    ("transmittance_table", transmittance_table),
    ("multiple_scattering_table", multiple_scattering_table),
    ("sky_table", sky_table),
    ("analytic_sky", analytic_sky),
    ("sky_light", sky_light),
    ("shape", shape),
    ("occupancy", occupancy),
    ("sky_visibility", sky_visibility_of_both),
    ("sun_optical_depth", sun_optical_depth),
    ("detail_noise", detail_noise),
    ("march:octaves", octaves),
    ("march", march),
    ("march:steps", view_steps),
    ("upsample", upsample),
    ("reproject", reproject),
    ("layers", layers_of_both),
    ("ground", ground),
    ("ground:shadow", ground_shadow),
    ("haze", haze),
    ("light_shafts", light_shafts),
    ("march_phase", march_phase),
    ("tone_map", tone_map),
    ("moon", moon),
    ("stars", stars),
];

#[test]
fn every_stage_of_the_view_agrees_with_its_twin() {
    let has_shader = |rung: &Rung| rung.info().devices == Devices::Both;
    for stage in VIEW_STAGES {
        if !stage.rungs.is_empty() && !stage.rungs.iter().any(has_shader) {
            continue;
        }
        assert!(
            CASES.iter().any(|(name, _)| *name == stage.name),
            "{} is not compared",
            stage.name
        );
    }
    let Some(context) = adapter("twins of the view") else {
        return;
    };
    let only = std::env::var("WELKIN_STAGE").ok();
    let mut bench = Bench {
        stages: Arc::new(ViewStages::new(context.clone()).unwrap()),
        context,
        random: Random(20_261_122),
    };
    let mut wrong = Vec::new();
    for (name, case) in CASES {
        if only.as_ref().is_some_and(|o| o != name) {
            continue;
        }
        let stage = VIEW_STAGES
            .iter()
            .find(|s| s.name == *name)
            .expect("a stage of the catalogue");
        let tolerance = stage.tolerance;
        for pair in case(&mut bench) {
            assert_eq!(pair.cpu.len(), pair.gpu.len(), "{name}, {}", pair.what);
            let spread =
                pair.cpu.iter().fold(f32::MAX, |a, b| a.min(*b))..pair.cpu.iter().fold(f32::MIN, |a, b| a.max(*b));
            assert!(
                spread.end > spread.start,
                "{name}, {}: all values are {}",
                pair.what,
                spread.start
            );
            let largest = spread.start.abs().max(spread.end.abs());
            let (mut outside, mut worst, mut sum) = (0usize, 0.0f32, 0.0f64);
            for (a, b) in pair.cpu.iter().zip(&pair.gpu) {
                let apart = (a - b).abs();
                let (within, unit) = match tolerance.within {
                    Within::Relative(share) => (share, a.abs().max(b.abs()) + 0.01 * largest),
                    Within::Absolute(steps) => (steps, 1.0),
                };
                let apart = apart / unit;
                // Not a number is outside too.
                let agrees = apart <= within;
                outside += usize::from(!agrees);
                worst = if apart > worst || apart.is_nan() { apart } else { worst };
                sum += apart as f64;
            }
            let count = pair.cpu.len();
            let share = outside as f32 / count as f32;
            let line = format!(
                "{name}, {}: {count} values, worst {worst:.3e}, mean {:.3e}, {outside} outside {:?}",
                pair.what,
                sum / count as f64,
                tolerance.within
            );
            println!("{line}");
            if share > tolerance.outside {
                wrong.push(line);
            }
        }
    }
    assert!(wrong.is_empty(), "too far apart:\n{}", wrong.join("\n"));
}

/// Tables and buffers that one picture leaves to the next: larger and smaller clouds, other suns, other air, no cloud.
#[test]
fn what_a_gpu_view_keeps_changes_no_byte() {
    let Some(context) = adapter("what_a_gpu_view_keeps_changes_no_byte") else {
        return;
    };
    let stages = Arc::new(ViewStages::new(context).unwrap());
    let (field, thick) = (cumulus_field(7, 12), ball(1500.0, 300.0, 0.06));
    let small = settings(48, 27);
    let mut low = small;
    low.sun_direction = sun(8.0, 40.0);
    let mut dusty = small;
    dusty.visibility_m = Some(9_000.0);
    let mut wide = settings(72, 40);
    wide.detail = None;
    wide.ground = Ground::Sea;
    let mut moonlit = small;
    moonlit.sun_direction = sun(-20.0, 40.0);
    moonlit.stars = Some(StarPlaces {
        equatorial_from_world: [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]],
        years_since_2000: 26.0,
        faintest: 5.0,
    });
    moonlit.moon = Some(MoonPlace {
        direction: sun(30.0, 90.0),
        distance_m: 380_000_000.0,
    });
    let mut moonless = moonlit;
    moonless.moon = None;
    let series = [
        (Some(&thick), small),
        (Some(&field), small),
        (Some(&field), low),
        (Some(&thick), wide),
        (None, small),
        (Some(&thick), dusty),
        (Some(&field), moonlit),
        (Some(&field), moonless),
        (Some(&field), small),
    ];
    let mut kept = GpuView::new(stages.clone()).unwrap();
    for (n, (volume, view)) in series.into_iter().enumerate() {
        let with = kept.render(volume, &view, &mut |_| {}).unwrap();
        let mut fresh = GpuView::new(stages.clone()).unwrap();
        assert!(with == fresh.render(volume, &view, &mut |_| {}).unwrap(), "picture {n}");
        let mut ran = Vec::new();
        let again = kept.render(volume, &view, &mut |stage| ran.push(stage)).unwrap();
        assert!(again == with, "picture {n}, again");
        assert_eq!(ran, ["march"], "picture {n}, again");
    }
}

#[test]
fn a_cloud_that_is_too_large_is_refused_and_leaves_the_view_sound() {
    let Some(context) = adapter("a_cloud_that_is_too_large_is_refused_and_leaves_the_view_sound") else {
        return;
    };
    let mut view = GpuView::new(Arc::new(ViewStages::new(context).unwrap())).unwrap();
    let grid = Grid {
        cells: [1100, 1, 3],
        cell_size_m: [50.0; 3],
    };
    let long = volume(grid, vec![0.02; grid.len()]);
    let settings = settings(32, 18);
    let refused = view.render(Some(&long), &settings, &mut |_| {});
    assert!(matches!(refused, Err(GpuError::TooLarge { .. })), "{refused:?}");
    let cloud = ball(1500.0, 300.0, 0.06);
    let drawn = view.render(Some(&cloud), &settings, &mut |_| {}).unwrap();
    let cpu = render(Some(&cloud), &settings, &mut Prepared::new());
    assert!(drawn.iter().zip(&cpu).all(|(a, b)| a.abs_diff(*b) <= 3));
}

/// The server's renderer draws on the device that was chosen: the same world, its cloud and the stages' times; and on the adapter opened
/// again after it was lost.
#[test]
fn the_servers_renderer_draws_on_the_gpu() {
    if adapter("the_servers_renderer_draws_on_the_gpu").is_none() {
        return;
    }
    let mut scene = welkin_proto::presets::find("warm-bubble").unwrap();
    scene.domain.cells = [16, 16, 20];
    let mut world = World::new(scene, None).unwrap();
    world.tick();
    let mut snapshot = world.snapshot();
    snapshot.volume = Some(Arc::new(ball(1500.0, 500.0, 0.05)));
    let camera = world.scene().camera.clone();
    let compute = Compute::choose("gpu").unwrap();
    let mut gpu = Renderer::new(&compute);
    let mut cpu = Renderer::new(&Compute::Cpu);
    let draw = |renderer: &mut Renderer| renderer.render(&snapshot, world.scene(), &camera, [64, 36], false);
    let wanted = draw(&mut cpu).unwrap().rgb8;
    let near = |drawn: &[u8]| {
        let far = drawn.iter().zip(&wanted).filter(|(a, b)| a.abs_diff(**b) > 1).count();
        assert!(
            drawn.len() == wanted.len() && far * 200 < wanted.len(),
            "{far} values are off"
        );
    };
    near(&draw(&mut gpu).unwrap().rgb8);
    let mut plan = world.plan_report();
    picture::put_times(&mut plan, gpu.times());
    let march = plan.passes.iter().find(|p| p.stage == "march").unwrap();
    assert!(march.runs == 1 && march.mean_ms.unwrap() > 0.0);

    compute.context().unwrap().device.destroy();
    let lost = draw(&mut gpu).err().expect("a picture on a destroyed device");
    // Whichever is noticed first: the loss, or what the destroyed device refuses.
    assert!(
        ["device_lost", "device_error"].contains(&lost.code.as_ref()),
        "{lost:?}"
    );
    near(&draw(&mut gpu).unwrap().rgb8);
}
