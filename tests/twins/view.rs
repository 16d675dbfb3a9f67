//! Every stage of light and view on both devices, with the same input: results within the tolerance that the catalogue holds beside the
//! stage. Stages that run within the march are judged by pictures in which they show.
//!
//! Results' buffers are filled with NaN first, so that what a stage leaves out is seen. Without an adapter the tests say so and pass, unless
//! `WELKIN_REQUIRE` names `gpu`.

#[path = "common.rs"]
mod adapter;

#[path = "view/pictures.rs"]
mod pictures;
#[path = "view/tables.rs"]
mod tables;

use std::sync::Arc;

use adapter::adapter;
use welkin_server::clouds::{Random, ball, cumulus_field, settings, sun, volume};
use welkin_server::machine::Compute;
use welkin_server::picture::{self, LastPicture, Renderer};
use welkin_server::world::World;
use welkin_shaders::catalogue::{Devices, Rung, VIEW_STAGES, Within};
use welkin_shaders::cpu::light::Atmosphere;
use welkin_shaders::cpu::view::{Ground, MapKind, MoonPlace, Prepared, Scattering, StarPlaces, SunOcclusion, render};
use welkin_shaders::gpu::view_stages::ViewStages;
use welkin_shaders::gpu::{Context, GpuError, GpuView};
use welkin_shaders::{CloudVolume, Grid};

use pictures::{
    analytic_sky, ground, ground_shadow, haze, impostors, layers_of_both, light_shafts, march, march_phase, moon,
    octaves, reproject, stars, tone_map, upsample, view_steps,
};
use tables::{
    detail_noise, diffusion, multiple_scattering_table, occupancy, octave_balance, shape, sky_light, sky_table,
    sky_visibility_of_both, sun_map, sun_optical_depth, transmittance_table,
};

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
    ("sun_map", sun_map),
    ("octave_balance", octave_balance),
    ("diffusion", diffusion),
    ("detail_noise", detail_noise),
    ("march:octaves", octaves),
    ("march", march),
    ("march:steps", view_steps),
    ("upsample", upsample),
    ("reproject", reproject),
    ("impostors", impostors),
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
    // What lies behind the shadow map: fluence, a map, both, each by itself again.
    let lit = |scattering, sun_occlusion| {
        let mut view = small;
        (view.lighting.scattering, view.lighting.sun_occlusion) = (scattering, sun_occlusion);
        view
    };
    let beer = SunOcclusion::ShadowMap {
        kind: MapKind::Beer,
        side: 64,
    };
    let diffused = lit(Scattering::Diffusion, SunOcclusion::LightGrid);
    let mapped = lit(Scattering::Octaves, beer);
    let series = [
        (Some(&thick), small),
        (Some(&field), small),
        (Some(&field), low),
        (Some(&thick), wide),
        (None, small),
        (Some(&thick), dusty),
        (Some(&field), moonlit),
        (Some(&field), moonless),
        (Some(&field), diffused),
        (Some(&field), mapped),
        (Some(&field), lit(Scattering::Diffusion, beer)),
        (Some(&thick), mapped),
        (Some(&thick), diffused),
        (Some(&field), diffused),
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

    // A viewer's pictures build on one another, in the memory of the device that draws.
    let mut live_scene = world.scene().clone();
    live_scene.methods.view_sampling = Some(welkin_proto::scene::ViewSampling::Reproject4);
    let mut last = LastPicture::default();
    let live = |renderer: &mut Renderer, last: &mut LastPicture| {
        renderer
            .live(&snapshot, &live_scene, &camera, [64, 36], last)
            .map(|p| p.rgb8)
    };
    for _ in 0..2 {
        near(&live(&mut gpu, &mut last).unwrap());
        assert_eq!(last.bytes(), 20 * 64 * 36);
    }
    let mut on_host = LastPicture::default();
    near(&live(&mut cpu, &mut on_host).unwrap());
    assert_eq!(on_host.bytes(), 40 * 64 * 36);

    compute.context().unwrap().device.destroy();
    let lost = draw(&mut gpu).err().expect("a picture on a destroyed device");
    // Whichever is noticed first: the loss, or what the destroyed device refuses.
    assert!(
        ["device_lost", "device_error"].contains(&lost.code.as_ref()),
        "{lost:?}"
    );
    near(&draw(&mut gpu).unwrap().rgb8);
    near(&live(&mut gpu, &mut last).unwrap());
}
