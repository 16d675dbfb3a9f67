//! What pictures must show whatever their exact pixels: colours of the sky, light and shade of clouds, shadows, hard cameras, repeatability.

use welkin_server::clouds::{ball, cumulus_field, settings, sun, volume};
use welkin_shaders::Grid;
use welkin_shaders::cpu::light::phase_table::PhaseChoice;
use welkin_shaders::cpu::view::{Prepared, Scattering, ViewSettings, radiance, render};

/// Mean red, green and blue of a block of pixels, as linear light 0 to 1.
fn mean(picture: &[u8], width: usize, columns: std::ops::Range<usize>, rows: std::ops::Range<usize>) -> [f32; 3] {
    let mut sum = [0.0f32; 3];
    let count = (columns.len() * rows.len()) as f32;
    for y in rows {
        for x in columns.clone() {
            for c in 0..3 {
                sum[c] += (picture[(y * width + x) * 3 + c] as f32 / 255.0).powf(2.2);
            }
        }
    }
    sum.map(|s| s / count)
}

fn luminance(c: [f32; 3]) -> f32 {
    0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]
}

fn draw(volume: Option<&welkin_shaders::CloudVolume>, settings: &ViewSettings) -> Vec<u8> {
    render(volume, settings, &mut Prepared::new())
}

#[test]
fn the_sky_is_blue_by_day() {
    let picture = draw(None, &settings(96, 54));
    let high = mean(&picture, 96, 0..96, 0..10);
    assert!(high[2] > 1.5 * high[0] && high[2] > 1.15 * high[1], "{high:?}");
}

#[test]
fn the_sunset_is_redder_near_the_sun() {
    let mut view = settings(96, 54);
    view.sun_direction = sun(1.5, 270.0);
    view.elevation_deg = 12.0;
    view.azimuth_deg = 270.0;
    view.exposure_ev = -2.0;
    let near = mean(&draw(None, &view), 96, 30..66, 20..36);
    view.azimuth_deg = 90.0;
    let far = mean(&draw(None, &view), 96, 30..66, 20..36);
    assert!(near[0] / near[2] > 1.3 * far[0] / far[2], "near {near:?} far {far:?}");
}

#[test]
fn the_zenith_is_darker_than_the_horizon() {
    let mut view = settings(64, 64);
    view.vertical_fov_deg = 20.0;
    view.elevation_deg = 90.0;
    let up = luminance(mean(&draw(None, &view), 64, 0..64, 0..64));
    view.elevation_deg = 12.0;
    let low = luminance(mean(&draw(None, &view), 64, 0..64, 0..64));
    assert!(up < 0.8 * low, "up {up} low {low}");
}

/// A thick ball of cloud, the sun high behind the camera: the lit side against the underside. The underside gets light from sky,
/// ground and through the cloud: it must be grey, not black.
#[test]
fn cloud_is_bright_on_the_suns_side_and_grey_below() {
    let cloud = ball(1500.0, 700.0, 0.06);
    let mut view = settings(64, 64);
    view.sun_direction = sun(65.0, 180.0);
    view.detail = None;
    view.visibility_m = None;
    view.vertical_fov_deg = 12.0;
    view.camera_position_m = [3200.0, -800.0, 1500.0];
    view.elevation_deg = 3.0;
    // Less exposed, so that the tone curve is near a straight line.
    view.exposure_ev = -2.5;
    let lit = luminance(mean(&draw(Some(&cloud), &view), 64, 24..40, 24..40));
    view.camera_position_m = [3200.0, 3200.0, 2.0];
    view.elevation_deg = 90.0;
    view.vertical_fov_deg = 20.0;
    let base = luminance(mean(&draw(Some(&cloud), &view), 64, 24..40, 24..40));
    view.camera_position_m = [3200.0, 20_000.0, 2.0];
    let clear = luminance(mean(&draw(None, &view), 64, 24..40, 24..40));
    // 1.9: the ground is lit by a high sun, and its light turns back from the base.
    assert!(lit > 1.6 * base, "lit {lit} base {base}");
    assert!(base > 0.15 * clear, "base {base} clear zenith {clear}");
}

/// More octaves of scattering only add light, and it is the cloud that they brighten.
#[test]
fn octaves_brighten_cloud() {
    let cloud = ball(1500.0, 700.0, 0.06);
    let mut view = settings(64, 64);
    view.vertical_fov_deg = 12.0;
    view.camera_position_m = [3200.0, -800.0, 1500.0];
    view.elevation_deg = 0.0;
    view.exposure_ev = -2.0;
    view.lighting.scattering = Scattering::Octaves;
    let mut before = 0.0;
    for octaves in [0, 2, 6] {
        view.multiple_scattering_octaves = octaves;
        let now = luminance(mean(&draw(Some(&cloud), &view), 64, 24..40, 24..40));
        assert!(now > before * 1.05, "{octaves} octaves: {now}, fewer: {before}");
        before = now;
    }
}

/// The phase function as it is seen from above on a thin level cloud that scatters once, in one colour, by the angle from the point opposite the sun in degrees.
/// A pixel's radiance is a + b times the function; a and b are had from the pictures by two known ones, so that neither the slant of rays nor where their steps
/// begin shows.
fn around_the_antisolar_point(phase: PhaseChoice, colour: usize) -> Vec<[f64; 2]> {
    let grid = Grid {
        cells: [8, 8, 16],
        cell_size_m: [200.0, 200.0, 50.0],
    };
    let cells = (0..grid.len()).map(|n| {
        if (6..9).contains(&(n / grid.plane())) {
            0.002
        } else {
            0.0
        }
    });
    let cloud = volume(grid, cells.collect());
    let mut view = settings(1, 1200);
    view.camera_position_m = [800.0, 800.0, 3000.0];
    view.detail = None;
    view.visibility_m = None;
    view.lighting.scattering = Scattering::Octaves;
    view.multiple_scattering_octaves = 0;
    view.sun_direction = sun(40.0, 180.0);
    view.elevation_deg = -40.0;
    view.vertical_fov_deg = 100.0;
    view.ground = welkin_shaders::cpu::view::Ground::Sea;
    let mut prepared = Prepared::new();
    let [light, even, rayleigh] = [
        phase,
        PhaseChoice::HenyeyGreenstein { asymmetry: 0.0 },
        PhaseChoice::Rayleigh,
    ]
    .map(|phase| {
        view.lighting.phase = phase;
        radiance(Some(&cloud), &view, &mut prepared)
    });
    let half = 50f64.to_radians().tan();
    // Below the middle: towards the nadir.
    let rows = (600..1200).map(|row| {
        let angle = ((row as f64 + 0.5) / 600.0 - 1.0) * half;
        let [seen, even, rayleigh] = [&light, &even, &rayleigh].map(|picture| f64::from(picture[row][colour]));
        let spread = 3.0 / 16.0 * (1.0 + angle.atan().cos().powi(2)) - 0.25;
        [angle.atan().to_degrees(), (seen - even) / (rayleigh - even) * spread]
    });
    rows.collect()
}

/// Where between two angles something is brighter than on either side by a hundredth at least, the brightest such place: radiances are 32-bit floats, which
/// make hills of a hundred-thousandth.
fn ring(profile: &[[f64; 2]], from: f64, to: f64) -> Option<f64> {
    let inside: Vec<[f64; 2]> = profile.iter().copied().filter(|p| p[0] > from && p[0] < to).collect();
    let peak = (0..inside.len()).max_by(|a, b| inside[*a][1].total_cmp(&inside[*b][1]))?;
    let least = |part: &[[f64; 2]]| part.iter().map(|p| p[1]).fold(f64::INFINITY, f64::min);
    let lower = 0.99 * inside[peak][1];
    (least(&inside[..peak]) < lower && least(&inside[peak + 1..]) < lower).then_some(inside[peak][0])
}

/// The march's pictures have the glory and the fogbow with Mie's function and with no other. Angles as in `mie_has_a_fogbow_where_airy_says` and
/// `mie_has_a_glory_of_the_right_width` of the phase table: the bow 36 to 44 degrees from the antisolar point, the glory's first ring at 2.75 to 4.2
/// over the size parameter.
#[test]
fn glory_and_fogbow_are_where_mie_has_them() {
    let radius = 12.0;
    let mie = PhaseChoice::Mie {
        effective_radius_um: radius,
    };
    for (colour, wavelength_um) in [(0, 0.68), (1, 0.55), (2, 0.44)] {
        let profile = around_the_antisolar_point(mie, colour);
        let bow = ring(&profile, 34.0, 46.0).expect("a bow");
        assert!((36.0..44.0).contains(&bow), "{colour}: bow at {bow}");
        let unit = (wavelength_um / (2.0 * std::f64::consts::PI * f64::from(radius))).to_degrees();
        let glory = ring(&profile, 1.8 * unit, 5.0 * unit).expect("a glory") / unit;
        assert!((2.75..4.2).contains(&glory), "{colour}: glory at {glory} / x");
    }
    for other in [
        PhaseChoice::default(),
        PhaseChoice::HenyeyGreenstein { asymmetry: 0.85 },
        PhaseChoice::Rayleigh,
    ] {
        let profile = around_the_antisolar_point(other, 1);
        assert_eq!(
            (ring(&profile, 34.0, 46.0), ring(&profile, 1.0, 5.0)),
            (None, None),
            "{other:?}"
        );
    }
}

#[test]
fn an_empty_volume_draws_what_no_volume_draws() {
    let grid = Grid {
        cells: [16, 16, 16],
        cell_size_m: [100.0, 100.0, 50.0],
    };
    let view = settings(97, 55);
    let none = draw(None, &view);
    assert_eq!(draw(Some(&volume(grid, vec![0.0; grid.len()])), &view), none);
    let mut claims = volume(grid, vec![0.0; grid.len()]);
    claims.cloudy_levels = [2, 9];
    assert_eq!(draw(Some(&claims), &view), none);
    claims.extinction_per_m.truncate(7);
    assert_eq!(
        draw(Some(&claims), &view),
        none,
        "a volume whose numbers do not fit its grid holds no cloud"
    );
}

#[test]
fn the_number_of_threads_changes_no_byte() {
    let cloud = cumulus_field(7, 12);
    let view = settings(161, 91);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a thread pool");
        pool.install(|| draw(Some(&cloud), &view))
    };
    let one = with(1);
    assert_eq!(one, with(2));
    assert_eq!(one, with(5));
}

/// Kept tables must never show through: a second picture with the same tables equals one made from nothing.
#[test]
fn kept_tables_change_no_byte() {
    let clouds = [cumulus_field(7, 12), cumulus_field(8, 9)];
    let mut views = [settings(80, 45); 4];
    views[1].sun_direction = sun(10.0, 250.0);
    views[2].visibility_m = None;
    views[3].detail = None;
    let mut kept = Prepared::new();
    for view in &views {
        for cloud in &clouds {
            assert_eq!(render(Some(cloud), view, &mut kept), draw(Some(cloud), view));
        }
    }
}

#[test]
fn hard_cameras_give_whole_pictures() {
    let cloud = cumulus_field(7, 12);
    let base = settings(33, 19);
    let mut kept = Prepared::new();
    let mut check = |what: &str, view: ViewSettings| {
        let picture = render(Some(&cloud), &view, &mut kept);
        assert_eq!(picture.len(), view.width * view.height * 3, "{what}");
        let brightest = picture.iter().max().copied().unwrap_or(0);
        assert!(brightest > 20, "{what}: black, brightest {brightest}");
    };
    for elevation_deg in [90.0, -90.0, 0.0, 1e9, -400.0, f32::NAN] {
        for position in [
            [3200.0, 3200.0, 2.0],
            [3200.0, 3200.0, -500.0],
            [0.0, 0.0, 0.0],
            [1000.0, 2000.0, 900.0],
            [1000.0, 2000.0, 600.0],
            [1e30, -1e30, 20_000.0],
            [f32::NAN, f32::INFINITY, f32::NEG_INFINITY],
            [3200.0, 3200.0, f32::INFINITY],
        ] {
            let view = ViewSettings {
                elevation_deg,
                camera_position_m: position,
                ..base
            };
            check(&format!("at {position:?} looking {elevation_deg}"), view);
        }
    }
    for fov in [0.0, 1e-9, 179.999, 1e9, f32::NAN] {
        check(
            &format!("field of view {fov}"),
            ViewSettings {
                vertical_fov_deg: fov,
                ..base
            },
        );
    }
    for (width, height) in [(1, 1), (2, 1), (1, 7), (17, 5)] {
        check(&format!("{width} x {height}"), ViewSettings { width, height, ..base });
    }
    for direction in [[0.0, 0.0, 1.0], [0.0; 3], [f32::NAN; 3], [1.0, 0.0, 0.0]] {
        check(
            &format!("sun {direction:?}"),
            ViewSettings {
                sun_direction: direction,
                ..base
            },
        );
    }
    let empty = render(Some(&cloud), &ViewSettings { width: 0, ..base }, &mut kept);
    assert!(empty.is_empty());
}

/// A night is dark and finite, and twilight is brighter than night.
#[test]
fn night_is_dark() {
    let mut view = settings(48, 27);
    let mut at = |elevation: f32| {
        view.sun_direction = sun(elevation, 270.0);
        luminance(mean(&draw(None, &view), 48, 0..48, 0..20))
    };
    let (day, twilight, night) = (at(40.0), at(-5.0), at(-40.0));
    assert!(
        night < twilight && twilight < day,
        "day {day} twilight {twilight} night {night}"
    );
}

#[test]
fn clouds_shade_the_ground() {
    let cloud = ball(1500.0, 700.0, 0.06);
    let mut view = settings(48, 48);
    view.sun_direction = sun(60.0, 90.0);
    view.camera_position_m = [3200.0 - 1500.0 / 60f32.to_radians().tan(), 3200.0, 100.0];
    view.elevation_deg = -90.0;
    let shaded = luminance(mean(&draw(Some(&cloud), &view), 48, 0..48, 0..48));
    view.cloud_shadow = false;
    let open = luminance(mean(&draw(Some(&cloud), &view), 48, 0..48, 0..48));
    assert!(shaded < 0.6 * open, "shaded {shaded} open {open}");
}

/// Detail moves with the air: noise shifted with the camera and the cloud alike gives the same edge; the noise alone shifted gives another.
#[test]
fn detail_moves_with_the_air() {
    let still = cumulus_field(7, 12);
    let mut moved = still.clone();
    moved.air_displacement_m = [70.0, 30.0, 0.0];
    let mut view = settings(96, 54);
    let difference =
        |a: &[u8], b: &[u8]| a.iter().zip(b).map(|(a, b)| a.abs_diff(*b) as f64).sum::<f64>() / a.len() as f64;
    let first = draw(Some(&still), &view);
    assert!(
        difference(&first, &draw(Some(&moved), &view)) > 0.2,
        "displaced noise must show"
    );
    view.detail = None;
    let plain = draw(Some(&still), &view);
    assert_eq!(
        plain,
        draw(Some(&moved), &view),
        "without detail the displacement shows nowhere"
    );
    assert!(difference(&first, &plain) > 0.5, "detail must show");
}

/// The same noise after a whole tile of displacement: the shift is the lookup's, not a reshuffle.
#[test]
fn a_whole_tile_of_displacement_changes_next_to_nothing() {
    let still = cumulus_field(7, 12);
    let mut moved = still.clone();
    // A tile is four times the detail's scale of 220 m.
    moved.air_displacement_m = [880.0, -1760.0, 880.0];
    let mut view = settings(96, 54);
    // Beyond the second, finer look-up, whose tile is another.
    view.camera_position_m = [3200.0, -2000.0, 9000.0];
    view.elevation_deg = -60.0;
    let (a, b) = (draw(Some(&still), &view), draw(Some(&moved), &view));
    let worst = a.iter().zip(&b).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0);
    assert!(worst <= 2, "worst difference {worst}");
}

/// Rays that have left the cloud's heights while others of their packet are still in cloud: each pixel by day has some light.
#[test]
fn no_pixel_is_black_by_day() {
    let cloud = cumulus_field(7, 12);
    let mut view = settings(83, 45);
    view.detail = None;
    let picture = draw(Some(&cloud), &view);
    let black = picture.chunks(3).filter(|rgb| rgb.iter().all(|c| *c == 0)).count();
    assert_eq!(black, 0);
}
