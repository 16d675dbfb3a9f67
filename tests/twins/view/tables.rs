//! Stages that fill tables and grids: number by number.

use welkin_server::clouds::{cumulus_field, sun};
use welkin_shaders::cpu::light::Atmosphere;
use welkin_shaders::cpu::light::diffusion::Diffuse;
use welkin_shaders::cpu::light::march_phase::MarchPhase;
use welkin_shaders::cpu::light::multiple_scattering_table::MultipleScatteringTable;
use welkin_shaders::cpu::light::octave_balance::OctaveBalance;
use welkin_shaders::cpu::light::phase_table::PhaseChoice;
use welkin_shaders::cpu::light::sky_light::SkyLight;
use welkin_shaders::cpu::light::sky_table::{SkySource, SkyTable};
use welkin_shaders::cpu::light::sky_visibility::sky_visibility;
use welkin_shaders::cpu::light::sun_map::SunMap;
use welkin_shaders::cpu::light::sun_optical_depth::SunLight;
use welkin_shaders::cpu::light::transmittance_table::TransmittanceTable;
use welkin_shaders::cpu::view::detail_noise::DetailNoise;
use welkin_shaders::cpu::view::occupancy::Occupancy;
use welkin_shaders::cpu::view::shape::Shape;
use welkin_shaders::cpu::view::{Ground, Scattering};
use welkin_shaders::gpu::view_octave_balance::OctaveBalancing;
use welkin_shaders::gpu::view_stages::{Air, ShapeGrid, SkyLightAsk, SkyView, SunMarch, ViewStages};
use welkin_shaders::gpu::view_sun_map::SunMapping;
use welkin_shaders::view::{FrameDetail, MapKind, Slab};

use super::{Bench, Pair};

pub(super) fn padded(texels: &[[f32; 3]]) -> Vec<[f32; 4]> {
    texels.iter().map(|t| [t[0], t[1], t[2], f32::NAN]).collect()
}

pub(super) fn halves(words: &[u32]) -> Vec<f32> {
    words
        .iter()
        .flat_map(|w| [(w & 0xffff) as f32, (w >> 16) as f32])
        .collect()
}

pub(super) fn tables(bench: &mut Bench) -> (Atmosphere, TransmittanceTable, MultipleScatteringTable) {
    let air = bench.air();
    let transmittance = TransmittanceTable::new(&air);
    let multiple = MultipleScatteringTable::new(&air, &transmittance);
    (air, transmittance, multiple)
}

pub(super) fn transmittance_table(bench: &mut Bench) -> Vec<Pair> {
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

pub(super) fn multiple_scattering_table(bench: &mut Bench) -> Vec<Pair> {
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

pub(super) fn sky_table(bench: &mut Bench) -> Vec<Pair> {
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

pub(super) fn sky_light(bench: &mut Bench) -> Vec<Pair> {
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

pub(super) fn shape(bench: &mut Bench) -> Vec<Pair> {
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

pub(super) fn occupancy(bench: &mut Bench) -> Vec<Pair> {
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

pub(super) fn sky_visibility_of_both(bench: &mut Bench) -> Vec<Pair> {
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

pub(super) fn sun_optical_depth(bench: &mut Bench) -> Vec<Pair> {
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

/// Odd grids, flat ones and single cells too: what joins two cells must do with one.
pub(super) fn diffusion(bench: &mut Bench) -> Vec<Pair> {
    let cases = [
        (cumulus_field(31, 9), true, 35.0, 0.85),
        (bench.volume([33, 21, 13], 0.5), false, 60.0, 0.3),
        (bench.volume([24, 31, 14], 0.05), true, 8.0, 0.995),
        (bench.volume([1, 7, 9], 0.7), false, 90.0, 0.0),
        (bench.volume([2, 1, 3], 1.0), false, 30.0, 0.8),
        (bench.volume([1, 1, 1], 1.0), false, 45.0, 0.85),
    ];
    cases
        .into_iter()
        .map(|(volume, carved, elevation, asymmetry)| {
            let sun = sun(elevation, bench.between(0.0, 360.0));
            let shape = Shape::new(&volume).unwrap();
            let slab = Slab::new(&volume).unwrap();
            let grid = ShapeGrid::new(&slab);
            let seen = [0, 1].map(|_| vec![0.5; slab.extinction_per_m.len()]);
            let light = SunLight::new(&shape, &seen, carved, false, sun);
            let cpu = Diffuse::new(&shape, &light, carved, asymmetry);
            let inputs = [
                bench.input(&shape.words),
                bench.input(&shape.occupancy().distances()[..]),
                bench.input(&light.words),
            ];
            let scratch = [0, 1].map(|_| bench.poisoned(ViewStages::diffusion_bytes(&grid)));
            let shadow = bench.poisoned(grid.shadow_bytes() + grid.fluence_bytes());
            bench
                .stages
                .diffusion(
                    &grid,
                    &bench.uniform(&grid),
                    (carved, asymmetry),
                    [&inputs[0], &inputs[1], &inputs[2]],
                    [&scratch[0], &scratch[1]],
                    &shadow,
                )
                .unwrap();
            let before = grid.shadow_bytes() as usize / 4;
            let all = bench.words(&shadow, before + cpu.words.len());
            assert!(
                all[..before].iter().all(|v| f32::from_bits(*v).is_nan()),
                "the shadow map is another stage's"
            );
            let what = format!("cells {:?}, carved {carved}, asymmetry {asymmetry}", slab.cells);
            // Fluence and the flux along each axis, as codes: what lies on a code's border may fall to either side.
            let codes = |words: &[u32]| -> Vec<f32> {
                let of =
                    |word: &u32| [word & 0x3ff, word >> 10 & 127, word >> 17 & 127, word >> 24].map(|code| code as f32);
                words.iter().flat_map(of).collect()
            };
            let (cpu, gpu) = (codes(&cpu.words), codes(&all[before..]));
            let apart = cpu.iter().zip(&gpu).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(apart <= 1.0, "{what}: codes are {apart} apart");
            Pair { what, gpu, cpu }
        })
        .collect()
}

pub(super) fn octave_balance(bench: &mut Bench) -> Vec<Pair> {
    let cases = [
        (cumulus_field(31, 9), true, 35.0, 0.85, 6),
        (bench.volume([33, 21, 13], 0.5), false, 60.0, 0.3, 2),
        (bench.volume([24, 31, 14], 0.05), true, 8.0, 0.9, 8),
        (bench.volume([2, 1, 3], 1.0), false, 30.0, 0.8, 4),
    ];
    cases
        .into_iter()
        .map(|(volume, carved, elevation, asymmetry, octaves)| {
            let sun = sun(elevation, bench.between(0.0, 360.0));
            let shape = Shape::new(&volume).unwrap();
            let slab = Slab::new(&volume).unwrap();
            let grid = ShapeGrid::new(&slab);
            let seen = sky_visibility(&slab.extinction_per_m, [slab.cells[0], slab.cells[1]], slab.cell_size_m);
            let light = SunLight::new(&shape, &seen, carved, false, sun);
            let phase = MarchPhase::new(
                PhaseChoice::HenyeyGreenstein { asymmetry },
                Scattering::Octaves,
                octaves,
            );
            let mut cpu = OctaveBalance::default();
            cpu.make((&shape, &light), carved, sun, &phase, octaves);
            let inputs = [
                bench.input(&shape.words),
                bench.input(&shape.occupancy().distances()[..]),
                bench.input(&light.words),
            ];
            let numbers = bench.context.uniform("an input", phase.bytes()).unwrap();
            let columns = bench.poisoned(u64::from(grid.cells_x * grid.cells_y) * 12);
            let shadow = bench.poisoned(grid.shadow_bytes() + grid.balance_bytes());
            bench
                .stages
                .octave_balance(
                    &grid,
                    [&bench.uniform(&grid), &numbers],
                    &OctaveBalancing::new(sun, carved, phase.asymmetry, octaves),
                    [&inputs[0], &inputs[1], &inputs[2]],
                    &columns,
                    &shadow,
                )
                .unwrap();
            let before = grid.shadow_bytes() as usize / 4;
            let all = bench.floats(&shadow, before + cpu.columns.len());
            assert!(
                all[..before].iter().all(|v| v.is_nan()),
                "the shadow map is another stage's"
            );
            Pair {
                what: format!("cells {:?}, carved {carved}, {octaves} octaves", slab.cells),
                gpu: all[before..].to_vec(),
                cpu: cpu.columns,
            }
        })
        .collect()
}

pub(super) fn sun_map(bench: &mut Bench) -> Vec<Pair> {
    let noise = DetailNoise::new();
    let tile = bench.input(noise.words());
    let detail = FrameDetail {
        push: 1.0,
        blend: 1.0,
        tiles_per_m: 1.0 / 800.0,
        offset_m: [30.0, 400.0, 7.0],
    };
    let field = cumulus_field(31, 9);
    // A flat world with cloud in one place.
    let mut flat = bench.volume([9, 1, 6], 1.0);
    for (n, v) in flat.extinction_per_m.iter_mut().enumerate() {
        *v = if n == 9 * 2 + 3 { 0.05 } else { 0.0 };
    }
    let mut all = Vec::new();
    for kind in [MapKind::Exponential, MapKind::Beer, MapKind::Fourier] {
        for (volume, detail, elevation, side) in [
            (&field, Some(detail), 40.0, 50),
            (&field, None, 1.0, 16),
            (&flat, None, 80.0, 33),
        ] {
            let sun = sun(elevation, bench.between(0.0, 360.0));
            let shape = Shape::new(volume).unwrap();
            let grid = ShapeGrid::new(&Slab::new(volume).unwrap());
            let cpu = SunMap::new(&shape, &noise, detail, kind, side, sun);
            let map = SunMapping::new(&grid, sun, detail, kind, side, 3);
            let buffer = bench.poisoned(12 + map.map_bytes());
            let inputs = [
                bench.input(&shape.words),
                bench.input(&shape.occupancy().distances()[..]),
            ];
            bench
                .stages
                .sun_map(&bench.uniform(&grid), &map, [&inputs[0], &inputs[1], &tile], &buffer)
                .unwrap();
            let gpu = bench.floats(&buffer, 4 + cpu.planes.len());
            assert!(
                gpu[..3].iter().all(|v| v.is_nan()),
                "what lies before is another stage's"
            );
            let what = format!("{kind:?}, sun at {elevation}, side {side}");
            let plane = cpu.planes.len() / kind.numbers();
            if kind == MapKind::Exponential {
                all.push(Pair {
                    what: format!("{what}: mean extinction"),
                    gpu: vec![gpu[3], 0.0],
                    cpu: vec![cpu.mean_per_m, 0.0],
                });
            }
            // Lengths, extinctions and depths apart, for each is judged by its largest.
            for (k, cpu) in cpu.planes.chunks(plane).enumerate() {
                all.push(Pair {
                    what: format!("{what}: number {k}"),
                    gpu: gpu[4 + k * plane..][..plane].to_vec(),
                    cpu: cpu.to_vec(),
                });
            }
        }
    }
    all
}

pub(super) fn detail_noise(bench: &mut Bench) -> Vec<Pair> {
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
