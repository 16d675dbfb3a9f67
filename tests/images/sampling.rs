//! Pictures of which not every pixel is marched, and layers for clients' own objects: near the whole picture, and what of it is exactly that.

use welkin_server::clouds::{ball, cumulus_field, settings, sun};
use welkin_server::ladder::light::flip;
use welkin_shaders::CloudVolume;
use welkin_shaders::cpu::view::layers::{Layer, rgba8};
use welkin_shaders::cpu::view::reproject::History;
use welkin_shaders::cpu::view::{Prepared, ViewSampling, ViewSettings, layers, radiance, render, render_live};

const WIDTH: usize = 160;
const HEIGHT: usize = 90;

fn views() -> Vec<(&'static str, CloudVolume, ViewSettings)> {
    let ground = settings(WIDTH, HEIGHT);
    let mut sunset = ground;
    sunset.sun_direction = sun(4.0, 70.0);
    let mut inside = ground;
    inside.camera_position_m = [3200.0, 3700.0, 1700.0];
    let mut above = ground;
    above.camera_position_m = [3200.0, 0.0, 4200.0];
    above.elevation_deg = -40.0;
    vec![
        ("from the ground", cumulus_field(7, 12), ground),
        ("sunset", cumulus_field(7, 12), sunset),
        ("inside a cloud", ball(1500.0, 700.0, 0.01), inside),
        ("from above", cumulus_field(5, 40), above),
    ]
}

fn half(view: ViewSettings) -> ViewSettings {
    ViewSettings {
        sampling: ViewSampling::HalfResolution,
        ..view
    }
}

/// Root of the mean square difference over the root mean square, the sun's disc and other lights above twenty times the mean cut.
fn relative_error(ours: &[[f32; 3]], truth: &[[f32; 3]]) -> f64 {
    let most = 20.0 * truth.iter().flatten().map(|v| f64::from(*v)).sum::<f64>() / (3 * truth.len()) as f64;
    let cut = |v: &f32| f64::from(*v).min(most);
    let pairs = || ours.iter().flatten().zip(truth.iter().flatten());
    let apart: f64 = pairs().map(|(a, b)| (cut(a) - cut(b)).powi(2)).sum();
    (apart / pairs().map(|(_, b)| cut(b).powi(2)).sum::<f64>()).sqrt()
}

/// Error by radiance and by eye, and the share of rays that it takes. Bounds are some half as much again as was measured, at a size at which a pixel of cloud is four times as
/// coarse as in the page's pictures, so that neighbours differ more.
#[test]
fn half_resolution_is_near_the_whole_picture_for_fewer_rays() {
    for (name, cloud, view) in views() {
        let mut prepared = Prepared::new();
        let whole = radiance(Some(&cloud), &view, &mut prepared);
        assert_eq!(prepared.marched(), (WIDTH * HEIGHT) as u64);
        let ours = radiance(Some(&cloud), &half(view), &mut prepared);
        let rays = prepared.marched() as f64 / (WIDTH * HEIGHT) as f64;
        let error = relative_error(&ours, &whole);
        let pictures = [view, half(view)].map(|view| render(Some(&cloud), &view, &mut prepared));
        let seen = flip(&pictures[1], &pictures[0], WIDTH);
        println!("{name}: error {error:.4}, FLIP {seen:.4}, {rays:.2} rays a pixel");
        assert!(error < 0.09 && seen < 0.02, "{name}: error {error}, FLIP {seen}");
        assert!(rays < 0.85, "{name}: {rays} rays a pixel");
        // Pixels on even rows and columns are the whole picture's, bit for bit.
        for y in (0..HEIGHT).step_by(2) {
            for x in (0..WIDTH).step_by(2) {
                assert_eq!(ours[y * WIDTH + x], whole[y * WIDTH + x], "{name} at {x}, {y}");
            }
        }
    }
}

#[test]
fn half_resolution_knows_odd_sizes_and_any_number_of_threads() {
    let cloud = cumulus_field(7, 12);
    for (width, height) in [(1, 1), (2, 3), (33, 19), (64, 36)] {
        let view = half(settings(width, height));
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| render(Some(&cloud), &view, &mut Prepared::new()))
        };
        let one = with(1);
        assert_eq!(one.len(), width * height * 3);
        assert_eq!(one, with(3), "{width} x {height}");
    }
    // No cloud: nothing is sampled, and the picture is the whole one.
    let view = settings(33, 19);
    let mut prepared = Prepared::new();
    assert_eq!(
        render(None, &half(view), &mut prepared),
        render(None, &view, &mut prepared)
    );
    assert_eq!(prepared.marched(), 0);
}

fn next(view: &ViewSettings, cloud: &CloudVolume, history: &mut History, prepared: &mut Prepared) -> (Vec<u8>, f64) {
    let picture = render_live(Some(cloud), view, history, prepared, &mut |_| {});
    (picture, prepared.marched() as f64 / (view.width * view.height) as f64)
}

/// A picture that rests becomes the whole one, for few rays; after what changes all at once it is whole again at once.
#[test]
fn reprojection_at_rest_becomes_the_whole_picture() {
    let cloud = cumulus_field(7, 12);
    let mut truth = Prepared::new();
    for (sampling, cell) in [(ViewSampling::Reproject4, 4), (ViewSampling::Reproject16, 16)] {
        let view = ViewSettings {
            sampling,
            ..settings(WIDTH, HEIGHT)
        };
        let whole = render(Some(&cloud), &settings(WIDTH, HEIGHT), &mut truth);
        let (mut history, mut prepared) = (History::default(), Prepared::new());
        let (first, rays) = next(&view, &cloud, &mut history, &mut prepared);
        assert!(first == whole && rays >= 1.0, "{sampling:?}: {rays}");
        for n in 0..=cell {
            let (picture, rays) = next(&view, &cloud, &mut history, &mut prepared);
            assert!(picture == whole, "{sampling:?}, picture {n}");
            assert!(rays < 0.6, "{sampling:?}: {rays}");
        }
        assert!(history.bytes() < 2 * 20 * 2 * WIDTH * HEIGHT, "{}", history.bytes());
        // The sun jumps, the size changes, the camera is somewhere else: nothing of before is left.
        let mut jumped = view;
        jumped.sun_direction = sun(15.0, 250.0);
        let mut small = view;
        (small.width, small.height) = (33, 19);
        let mut away = view;
        away.azimuth_deg = 180.0;
        for other in [jumped, small, away, view] {
            let (picture, rays) = next(&other, &cloud, &mut history, &mut prepared);
            let plain = ViewSettings {
                sampling: ViewSampling::EveryPixel,
                ..other
            };
            assert!(picture == render(Some(&cloud), &plain, &mut truth), "{other:?}");
            assert!(rays >= 1.0, "{rays}");
        }
        // Without cloud there is nothing to go on from.
        let clear = render_live(None, &view, &mut history, &mut prepared, &mut |_| {});
        assert!(clear == render(None, &view, &mut truth));
    }
}

/// A camera that turns and flies: rays saved, and pictures near the whole ones. Bounds are half as much again as measured; see `ladder-view.txt` for the page's size.
#[test]
fn reprojection_follows_a_camera_that_moves() {
    let cloud = cumulus_field(7, 12);
    for sampling in [ViewSampling::Reproject4, ViewSampling::Reproject16] {
        let (mut history, mut prepared, mut whole) = (History::default(), Prepared::new(), Prepared::new());
        let mut worst = (0.0f64, 0.0f64);
        for n in 0..12 {
            let mut view = ViewSettings {
                sampling,
                ..settings(WIDTH, HEIGHT)
            };
            view.azimuth_deg = 0.7 * n as f32;
            view.camera_position_m[1] += 5.0 * n as f32;
            let (picture, rays) = next(&view, &cloud, &mut history, &mut prepared);
            view.sampling = ViewSampling::EveryPixel;
            let truth = render(Some(&cloud), &view, &mut whole);
            let squares: f64 = picture
                .iter()
                .zip(&truth)
                .map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2))
                .sum();
            if n > 0 {
                worst = (worst.0.max((squares / truth.len() as f64).sqrt()), worst.1.max(rays));
            }
        }
        println!("{sampling:?}: worst {:.2} of 255, {:.2} rays a pixel", worst.0, worst.1);
        assert!(worst.0 < 6.0 && worst.1 < 0.9, "{sampling:?}: {worst:?}");
    }
}

fn drawn(cloud: Option<&CloudVolume>, view: &ViewSettings, objects_m: Option<&[f32]>) -> Vec<Layer> {
    layers(cloud, view, objects_m, &mut Prepared::new(), &mut |_| {})
}

#[test]
fn layers_without_objects_are_the_picture() {
    for (name, cloud, view) in views() {
        let picture = render(Some(&cloud), &view, &mut Prepared::new());
        let infinite = vec![f32::INFINITY; WIDTH * HEIGHT];
        for objects in [None, Some(&infinite[..])] {
            let bytes = rgba8(&drawn(Some(&cloud), &view, objects), WIDTH);
            for (n, (theirs, ours)) in picture.chunks(3).zip(bytes.chunks(4)).enumerate() {
                assert_eq!((theirs, 255), (&ours[..3], ours[3]), "{name}, pixel {n}");
            }
        }
    }
}

/// A wall hides what is behind it and nothing of what is before it.
#[test]
fn a_wall_hides_what_is_behind_it() {
    let cloud = ball(1500.0, 700.0, 0.01);
    let mut view = settings(WIDTH, HEIGHT);
    view.visibility_m = None;
    let wall = |distance_m: f32| drawn(Some(&cloud), &view, Some(&vec![distance_m; WIDTH * HEIGHT]));
    let clear = drawn(None, &view, None);
    let whole = drawn(Some(&cloud), &view, None);
    // Against the sky: where the wall would stand behind the ground there is none.
    let sky = |n: usize| n / WIDTH < HEIGHT / 2;
    let clouded: Vec<usize> = (0..whole.len()).filter(|n| sky(*n) && whole[*n][5] > 0.2).collect();
    assert!(clouded.len() > 100, "{}", clouded.len());
    let near = wall(500.0);
    let far = wall(50_000.0);
    let mut last = vec![1.0f32; whole.len()];
    for (n, layer) in near.iter().enumerate().filter(|(n, _)| sky(*n)) {
        assert_eq!(layer[..3], [0.0; 3], "before the wall at pixel {n}");
        assert!(layer[3] > 0.999_999 && layer[4] == 0.0, "{n}: {layer:?}");
    }
    for (n, layer) in far.iter().enumerate().filter(|(n, _)| sky(*n)) {
        // What the cloud sends, and through it the sky: together the whole picture.
        for c in 0..3 {
            let both = layer[c] + layer[3] * clear[n][c];
            let wanted = whole[n][c];
            assert!((both - wanted).abs() <= 2e-4 * (wanted + 0.1), "{n}: {both}, {wanted}");
        }
        assert!((layer[3] - (1.0 - whole[n][5])).abs() < 1e-5, "{n}");
    }
    // Ever more of the cloud is before a wall that moves away: never less than before.
    for distance_m in [2600.0, 3000.0, 3400.0, 4000.0] {
        let layers = wall(distance_m);
        for n in &clouded {
            assert!(layers[*n][3] <= last[*n] + 1e-5, "{n} at {distance_m}");
            last[*n] = layers[*n][3];
            assert!(layers[*n][4] <= 1.0001 * distance_m, "{n}: {:?}", layers[*n]);
        }
    }
    // Within even cloud what passes is exp(-depth), without grain from where steps begin.
    let dense = ball(1500.0, 700.0, 0.01);
    let mut within = view;
    within.camera_position_m = [3200.0, 3200.0, 1500.0];
    within.detail = None;
    for distance_m in [3.0f32, 40.0, 133.0] {
        let objects = vec![distance_m; WIDTH * HEIGHT];
        let wanted = (-0.01 * distance_m).exp();
        // Rays stop at a transmittance of 0.01, and what is left is scaled so that there is no step.
        let wanted = (wanted - 0.01) / 0.99;
        for layer in drawn(Some(&dense), &within, Some(&objects)) {
            assert!((layer[3] - wanted).abs() < 0.01, "{distance_m}: {} {wanted}", layer[3]);
        }
    }
}

/// Straight up, where the box's copies do not stand behind one another: the distance of a thick ball is that of its near side, some free paths in, that of a thin one its middle's, and
/// nothing is where there is no cloud.
#[test]
fn depth_is_where_the_cloud_is() {
    let mut view = settings(WIDTH, HEIGHT);
    view.camera_position_m = [3200.0, 3200.0, 2.0];
    view.elevation_deg = 90.0;
    view.vertical_fov_deg = 60.0;
    view.detail = None;
    let thick = drawn(Some(&ball(1500.0, 700.0, 0.06)), &view, None);
    let middle = thick[HEIGHT / 2 * WIDTH + WIDTH / 2];
    // 798 m to its surface, which the smoothed shape leaves within a cell of 50 m; a free path is 17 m.
    assert!((740.0..860.0).contains(&middle[4]), "{middle:?}");
    assert!(middle[5] > 0.99, "{middle:?}");
    let corner = thick[0];
    assert_eq!(corner[4..], [0.0, 0.0]);
    let thin = drawn(Some(&ball(1500.0, 700.0, 1e-4)), &view, None);
    let middle = thin[HEIGHT / 2 * WIDTH + WIDTH / 2];
    assert!((1460.0..1540.0).contains(&middle[4]), "{middle:?}");
    assert!((0.11..0.16).contains(&middle[5]), "{middle:?}");
}

/// Hard cameras, suns and objects: pictures are whole and layers finite, whatever the sampling.
#[test]
fn hard_cameras_give_whole_pictures_and_finite_layers() {
    let cloud = cumulus_field(7, 12);
    let base = settings(33, 19);
    let mut prepared = Prepared::new();
    let mut history = History::default();
    let odd = [0.0, f32::MIN_POSITIVE, 1e-3, 1e30, f32::MAX, f32::INFINITY];
    let objects: Vec<f32> = (0..33 * 19).map(|n| odd[n % odd.len()]).collect();
    for elevation_deg in [90.0, -90.0, f32::NAN] {
        for camera_position_m in [
            [3200.0, 3200.0, -500.0],
            [1000.0, 2000.0, 600.0],
            [f32::NAN, f32::INFINITY, f32::NEG_INFINITY],
        ] {
            for sun_direction in [base.sun_direction, [f32::NAN; 3]] {
                let mut view = ViewSettings {
                    elevation_deg,
                    camera_position_m,
                    sun_direction,
                    ..base
                };
                for sampling in [ViewSampling::HalfResolution, ViewSampling::Reproject16] {
                    view.sampling = sampling;
                    let (picture, _) = next(&view, &cloud, &mut history, &mut prepared);
                    let brightest = picture.iter().max().copied().unwrap_or(0);
                    assert!(picture.len() == 33 * 19 * 3 && brightest > 20, "{view:?}");
                }
                for layer in layers(Some(&cloud), &view, Some(&objects), &mut prepared, &mut |_| {}) {
                    assert!(
                        layer.iter().all(|v| v.is_finite() && *v >= 0.0),
                        "{layer:?} of {view:?}"
                    );
                    assert!(layer[3] <= 1.0 && layer[5] <= 1.0, "{layer:?} of {view:?}");
                }
            }
        }
    }
}

#[test]
#[ignore = "writes pictures for eyes, whole and at half the resolution side by side, into the folder that WELKIN_KEEP_PICTURES names"]
fn pictures_for_eyes() {
    let folder = std::env::var("WELKIN_KEEP_PICTURES").expect("a folder");
    for (name, cloud, view) in views() {
        let (width, height) = (640, 360);
        let view = ViewSettings { width, height, ..view };
        let pair = [view, half(view)].map(|view| render(Some(&cloud), &view, &mut Prepared::new()));
        let rows = pair[0].chunks(3 * width).zip(pair[1].chunks(3 * width));
        let both: Vec<u8> = rows.flat_map(|(a, b)| [a, b].concat()).collect();
        let path = format!("{folder}/{}.png", name.replace(' ', "-"));
        image::save_buffer(path, &both, 2 * width as u32, height as u32, image::ColorType::Rgb8).unwrap();
    }
}
