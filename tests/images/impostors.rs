//! Far clouds on kept pictures: near the whole picture, marched anew when the metrics say so and not before, in turn when the weather goes on.

use welkin_server::clouds::{cumulus_field, settings, sun};
use welkin_server::ladder::light::flip;
use welkin_shaders::CloudVolume;
use welkin_shaders::cpu::view::impostors::{FAR_LEAST_M, FAR_TRANSLATION_RAD};
use welkin_shaders::cpu::view::reproject::History;
use welkin_shaders::cpu::view::{Prepared, ViewSampling, ViewSettings, render, render_live};

const WIDTH: usize = 160;
const HEIGHT: usize = 90;
const PIXELS: u64 = (WIDTH * HEIGHT) as u64;

/// From the ground to the horizon, where the far clouds are.
fn view() -> ViewSettings {
    ViewSettings {
        elevation_deg: 12.0,
        sampling: ViewSampling::Impostors,
        ..settings(WIDTH, HEIGHT)
    }
}

fn whole(cloud: &CloudVolume, view: &ViewSettings) -> Vec<u8> {
    let every = ViewSettings {
        sampling: ViewSampling::EveryPixel,
        ..*view
    };
    render(Some(cloud), &every, &mut Prepared::new())
}

#[derive(Default)]
struct Viewer {
    history: History,
    prepared: Prepared,
}

impl Viewer {
    /// The next picture, and how many directions of far clouds were marched for it.
    fn sees(&mut self, cloud: &CloudVolume, view: &ViewSettings) -> (Vec<u8>, u64) {
        let picture = render_live(Some(cloud), view, &mut self.history, &mut self.prepared, &mut |_| {});
        let far = self.prepared.marched() - (view.width * view.height) as u64;
        (picture, far)
    }
}

#[test]
fn far_clouds_are_those_of_the_whole_picture() {
    let field = cumulus_field(7, 12);
    let mut low = view();
    low.sun_direction = sun(4.0, 70.0);
    let mut beside = view();
    beside.camera_position_m = [3200.0, -2000.0, 1000.0];
    beside.elevation_deg = 0.0;
    let mut above = view();
    above.camera_position_m = [3200.0, 0.0, 3500.0];
    above.elevation_deg = -8.0;
    above.azimuth_deg = 45.0;
    for (name, view) in [
        ("ground", view()),
        ("sunset", low),
        ("beside", beside),
        ("above", above),
    ] {
        let (picture, far) = Viewer::default().sees(&field, &view);
        let whole = whole(&field, &view);
        let seen = flip(&picture, &whole, WIDTH);
        let share =
            picture.iter().zip(&whole).filter(|(a, b)| a.abs_diff(**b) > 12).count() as f64 / whole.len() as f64;
        println!(
            "{name}: FLIP {seen:.4}, {:.1} % differ, {far} directions",
            100.0 * share
        );
        // Far clouds are ragged at a size of pixels, and here stand between directions: what differs are their edges. From above, before dark ground, 0.0202.
        assert!(seen < 0.025 && share < 0.05, "{name}: FLIP {seen}, {share}");
        assert!(far > 0, "{name}");
    }
}

#[test]
fn a_camera_may_move_a_little_and_turn_at_will() {
    let field = cumulus_field(7, 12);
    let mut viewer = Viewer::default();
    let (first, far) = viewer.sees(&field, &view());
    assert!(far > 0);
    let (again, more) = viewer.sees(&field, &view());
    assert!(first == again && more == 0, "{more} at rest");
    // Within the translation metric nothing far is marched, beyond it all in view.
    let allowed_m = FAR_TRANSLATION_RAD.tan() * FAR_LEAST_M;
    let mut moved = view();
    moved.camera_position_m[0] += 0.9 * allowed_m;
    assert_eq!(viewer.sees(&field, &moved).1, 0);
    moved.camera_position_m[0] = view().camera_position_m[0] + 1.1 * allowed_m;
    assert_eq!(viewer.sees(&field, &moved).1, far);
    // Turning brings tiles into view, and only those are marched.
    let mut turned = moved;
    turned.azimuth_deg += 10.0;
    let (picture, some) = viewer.sees(&field, &turned);
    assert!(some > 0 && some < far / 2, "{some} of {far}");
    let seen = flip(&picture, &whole(&field, &turned), WIDTH);
    assert!(seen < 0.02, "{seen}");
    // The air that moves with the camera keeps everything: it is the same cloud from the same place.
    let mut carried = field.clone();
    carried.air_displacement_m = [30.0, 0.0, 0.0];
    let mut along = turned;
    along.camera_position_m[0] += 30.0;
    let in_turn = viewer.sees(&carried, &along).1;
    assert!(in_turn < far / 2, "{in_turn} of {far}");
}

#[test]
fn a_finer_picture_needs_finer_directions() {
    let field = cumulus_field(7, 12);
    let mut viewer = Viewer::default();
    let (_, all) = viewer.sees(&field, &view());
    let with = |fov: f32| ViewSettings {
        vertical_fov_deg: fov,
        ..view()
    };
    // A little wider keeps what it has and marches what came into view; half as wide marches all, finer.
    let (_, wider) = viewer.sees(&field, &with(60.0));
    assert!(wider < all, "{wider} of {all}");
    let (picture, narrow) = viewer.sees(&field, &with(25.0));
    let (alone, all_of_narrow) = Viewer::default().sees(&field, &with(25.0));
    assert!(narrow == all_of_narrow && picture == alone, "{narrow} {all_of_narrow}");
}

#[test]
fn weather_is_followed_in_turn() {
    let before = cumulus_field(7, 12);
    // Between the same heights, so that what is far begins at the same distance.
    let mut after = before.clone();
    let [nx, ..] = before.grid.cells;
    for (n, row) in after.extinction_per_m.chunks_exact_mut(nx).enumerate() {
        row.rotate_left(17 + n % 2);
    }
    let mut viewer = Viewer::default();
    let (_, all) = viewer.sees(&before, &view());
    let mut last = Vec::new();
    let mut spent = 0;
    for _ in 0..4 {
        let (picture, far) = viewer.sees(&after, &view());
        assert!(far > 0 && far < all / 2, "{far} of {all}");
        spent += far;
        last = picture;
    }
    assert_eq!(spent, all, "each tile once");
    let (rest, far) = viewer.sees(&after, &view());
    assert_eq!(far, 0);
    assert!(rest == last && rest == Viewer::default().sees(&after, &view()).0);
    // Another sun leaves nothing.
    let mut evening = view();
    evening.sun_direction = sun(10.0, 250.0);
    assert_eq!(viewer.sees(&after, &evening).1, all);
}

#[test]
fn steep_views_and_small_pictures_need_no_far_clouds() {
    let field = cumulus_field(7, 12);
    for elevation_deg in [90.0, -90.0] {
        let mut steep = view();
        steep.elevation_deg = elevation_deg;
        steep.vertical_fov_deg = 40.0;
        steep.camera_position_m[2] = if elevation_deg < 0.0 { 4000.0 } else { 2.0 };
        let (picture, far) = Viewer::default().sees(&field, &steep);
        assert!(far == 0 && picture == whole(&field, &steep), "{elevation_deg}: {far}");
    }
    for (width, height) in [(1, 1), (3, 2), (33, 19)] {
        let small = ViewSettings {
            width,
            height,
            ..view()
        };
        let (picture, _) = Viewer::default().sees(&field, &small);
        assert_eq!(picture.len(), 3 * width * height);
    }
    // What is kept is bounded by what is in view: a band of it, with tiles' edges.
    let mut viewer = Viewer::default();
    viewer.sees(&field, &view());
    let held = viewer.history.bytes() as u64;
    assert!(held < 4 * 20 * PIXELS, "{held}");
    // Clouds are gone, and so is what was kept of them.
    render_live(None, &view(), &mut viewer.history, &mut viewer.prepared, &mut |_| {});
    assert!((viewer.history.bytes() as u64) < held / 4);
}

/// Who keeps histories of viewers keeps those that something builds on, and no others.
#[test]
fn what_builds_on_the_last_picture_says_so() {
    let field = cumulus_field(7, 12);
    for sampling in [
        ViewSampling::EveryPixel,
        ViewSampling::HalfResolution,
        ViewSampling::Reproject4,
        ViewSampling::Reproject16,
        ViewSampling::Impostors,
    ] {
        let small = ViewSettings {
            sampling,
            ..settings(33, 19)
        };
        let mut viewer = Viewer::default();
        render_live(
            Some(&field),
            &small,
            &mut viewer.history,
            &mut viewer.prepared,
            &mut |_| {},
        );
        assert_eq!(viewer.history.bytes() > 0, sampling.builds_on_last(), "{sampling:?}");
    }
}
