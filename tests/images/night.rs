//! The night: moon, stars, dusk; what pictures must show, and radiances against published ones.

use welkin_server::clouds::{ball, cumulus_field, settings, sun, volume};
use welkin_shaders::Grid;
use welkin_shaders::cpu::light::Atmosphere;
use welkin_shaders::cpu::light::moon::{MOON_LAW_DISTANCE_M, MOON_RADIUS_M, MoonLook};
use welkin_shaders::cpu::light::multiple_scattering_table::MultipleScatteringTable;
use welkin_shaders::cpu::light::sky_table::{SkySource, radiance};
use welkin_shaders::cpu::light::stars::{STAR_WORDS, StarTable, catalogue, direction_of_date};
use welkin_shaders::cpu::light::transmittance_table::TransmittanceTable;
use welkin_shaders::cpu::view::{MoonPlace, Prepared, StarPlaces, ViewSettings, render};

const LATITUDE_DEG: f32 = 48.0;

/// Rows from the world to the equator at a sidereal time, by the definition: the pole stands as high as the latitude.
fn equatorial(sidereal_deg: f32) -> [[f32; 3]; 3] {
    let (s, c) = sidereal_deg.to_radians().sin_cos();
    let (up, north) = LATITUDE_DEG.to_radians().sin_cos();
    [[-s, -up * c, north * c], [c, -up * s, north * s], [0.0, north, up]]
}

/// Clean air, no cloud, everything of the night.
fn night(width: usize, height: usize) -> ViewSettings {
    ViewSettings {
        sun_direction: sun(-30.0, 10.0),
        visibility_m: None,
        moon: None,
        stars: Some(StarPlaces {
            equatorial_from_world: equatorial(101.0),
            years_since_2000: 26.0,
            faintest: 6.0,
        }),
        ..settings(width, height)
    }
}

fn moon(elevation_deg: f32, azimuth_deg: f32) -> Option<MoonPlace> {
    Some(MoonPlace {
        direction: sun(elevation_deg, azimuth_deg),
        distance_m: MOON_LAW_DISTANCE_M,
    })
}

fn draw(cloud: Option<&welkin_shaders::CloudVolume>, view: &ViewSettings) -> Vec<u8> {
    render(cloud, view, &mut Prepared::new())
}

fn mean(picture: &[u8]) -> f32 {
    picture.iter().map(|b| f32::from(*b)).sum::<f32>() / picture.len() as f32
}

/// Writes a picture into the folder that `WELKIN_KEEP_PICTURES` names, for eyes.
fn save(name: &str, view: &ViewSettings, picture: &[u8]) {
    if let Ok(folder) = std::env::var("WELKIN_KEEP_PICTURES") {
        let (width, height) = (view.width as u32, view.height as u32);
        image::save_buffer(
            format!("{folder}/{name}.png"),
            picture,
            width,
            height,
            image::ColorType::Rgb8,
        )
        .unwrap();
    }
}

/// Magnitudes a square second of arc of a green radiance over the sun's irradiance.
fn magnitude(radiance: f32) -> f32 {
    let square_seconds = (180.0 * 3600.0 / std::f32::consts::PI).powi(2);
    -26.74 - 2.5 * (radiance / square_seconds).log10()
}

/// Green radiance at sea level of air that takes 0.172 magnitudes in the zenith, as that of Krisciunas and Schaefer.
fn clear_sky(source: &SkySource, elevation_deg: f32, azimuth_deg: f32) -> f32 {
    let air = Atmosphere::new(0.0, Some(94_800.0));
    let transmittance = TransmittanceTable::new(&air);
    let multiple = MultipleScatteringTable::new(&air, &transmittance);
    let d = sun(elevation_deg, azimuth_deg);
    radiance(&air, &transmittance, &multiple, 2.0, d, source, Some(false))[1]
}

/// The moonlit sky by Krisciunas and Schaefer (1991), equations 3, 15, 18, 20 and 21, as magnitudes a square second of arc: measured on Mauna Kea, where they find k = 0.172 in V; they give
/// their formula 8 to 23 % of error.
fn krisciunas_schaefer(moon_zenith_deg: f32, zenith_deg: f32, apart_deg: f32, phase_deg: f32) -> f32 {
    const EXTINCTION: f32 = 0.172;
    let air_mass = |z: f32| (1.0 - 0.96 * z.to_radians().sin().powi(2)).powf(-0.5);
    let passed = |z: f32| 10f32.powf(-0.4 * EXTINCTION * air_mass(z));
    let moon = 10f32.powf(-0.4 * (3.84 + 0.026 * phase_deg + 4e-9 * phase_deg.powi(4)));
    let scattered =
        10f32.powf(5.36) * (1.06 + apart_deg.to_radians().cos().powi(2)) + 10f32.powf(6.15 - apart_deg / 40.0);
    let nanolamberts = scattered * moon * passed(moon_zenith_deg) * (1.0 - passed(zenith_deg));
    (20.7233 - (nanolamberts / 34.08).ln()) / 0.92104
}

/// A ball of cloud on few cells.
fn small_ball() -> welkin_shaders::CloudVolume {
    let grid = Grid {
        cells: [16, 16, 12],
        cell_size_m: [200.0, 200.0, 150.0],
    };
    let away = |n: usize| (n % 16) as f32 - 7.5;
    let cell = |n: usize| {
        let d = [away(n), away(n / 16), (n / 256) as f32 - 5.5];
        if d.iter().map(|v| v * v).sum::<f32>() < 16.0 {
            0.03
        } else {
            0.0
        }
    };
    volume(grid, (0..grid.len()).map(cell).collect())
}

#[test]
fn the_moonlit_sky_is_as_bright_as_measured() {
    // Moon's elevation, phase, elevation and azimuth from the moon's of the place looked at.
    for (moon_deg, phase_deg, up_deg, away_deg) in [
        (60.0f32, 0.0f32, 60.0f32, 180.0f32),
        (60.0, 0.0, 90.0, 0.0),
        (40.0, 0.0, 40.0, 120.0),
        (30.0, 60.0, 70.0, 180.0),
        (70.0, 90.0, 30.0, 90.0),
    ] {
        let direction = sun(moon_deg, 0.0);
        let turned = 180.0 - phase_deg;
        // A sun so far from the moon, below the horizon.
        let sun_at = sun(moon_deg - turned, 0.0);
        let look = MoonLook::new(direction, MOON_LAW_DISTANCE_M, sun_at);
        let d = sun(up_deg, away_deg);
        let apart = (0..3).map(|a| d[a] * direction[a]).sum::<f32>().acos().to_degrees();
        let ours = magnitude(clear_sky(
            &SkySource::moon(direction, look.irradiance),
            up_deg,
            away_deg,
        ));
        let theirs = krisciunas_schaefer(90.0 - moon_deg, 90.0 - up_deg, apart, phase_deg);
        println!("moon {moon_deg}, phase {phase_deg}, {apart:.0} degrees away: {ours:.2}, measured {theirs:.2}");
        // A factor of 1.6: their fit is good to a quarter, and over Mauna Kea the same extinction is of fewer molecules and more aerosol than at sea level.
        assert!((ours - theirs).abs() < 0.5, "{ours} against {theirs}");
    }
}

#[test]
fn the_moonless_sky_is_as_bright_as_measured() {
    let source = SkySource::sun(sun(-40.0, 0.0), true);
    let zenith = magnitude(clear_sky(&source, 90.0, 0.0));
    // Patat (2003): 21.6 in V in the zenith of Paranal; the air takes some and scatters some back.
    assert!((zenith - 21.6).abs() < 0.1, "{zenith}");
    // Van Rhijn's law less the longer way through the air: brighter by some tenths at 60 degrees from the zenith (0.3 to 0.5 as measured there).
    let slanted = magnitude(clear_sky(&source, 30.0, 0.0));
    assert!((0.2..0.8).contains(&(zenith - slanted)), "{zenith} {slanted}");
}

#[test]
fn dusk_falls_in_order_and_night_is_neither_black_nor_grey() {
    let mut before = f32::MAX;
    for (name, elevation) in [
        ("sunset", 0.0),
        ("dusk-4", -4.0),
        ("dusk-8", -8.0),
        ("dusk-12", -12.0),
        ("dusk-18", -18.0),
    ] {
        let mut view = night(160, 90);
        view.sun_direction = sun(elevation, 290.0);
        view.azimuth_deg = 270.0;
        let picture = draw(None, &view);
        save(name, &view, &picture);
        let bright = mean(&picture[..160 * 60 * 3]);
        println!("sun at {elevation}: mean level {bright:.1}");
        assert!(bright < before, "sun at {elevation}: {bright}, higher: {before}");
        before = bright;
    }
    assert!(
        (4.0..60.0).contains(&before),
        "a moonless night has a mean level of {before}"
    );
    // And with the full moon between that and dusk.
    let mut view = night(160, 90);
    view.azimuth_deg = 270.0;
    view.moon = moon(40.0, 150.0);
    view.sun_direction = sun(-40.0, 330.0);
    let lit = draw(None, &view);
    save("moonlit", &view, &lit);
    assert!(mean(&lit) > 1.2 * before, "moonlit {} moonless {before}", mean(&lit));
}

#[test]
fn the_moon_is_as_wide_as_it_is_and_stands_where_it_stands() {
    let mut view = night(120, 120);
    view.stars = None;
    view.vertical_fov_deg = 1.2;
    view.azimuth_deg = 150.0;
    view.elevation_deg = 40.0;
    view.exposure_ev = -8.0;
    let lit_pixels = |view: &ViewSettings, name: &str| -> Vec<[f32; 2]> {
        let picture = draw(None, view);
        save(name, view, &picture);
        (0..120 * 120)
            .filter(|n| picture[n * 3 + 1] > 40)
            .map(|n| [(n % 120) as f32 + 0.5, (n / 120) as f32 + 0.5])
            .collect()
    };
    let pixel = 2.0 * 0.6f32.to_radians().tan() / 120.0;
    let radius = MOON_RADIUS_M / MOON_LAW_DISTANCE_M / pixel;
    let area = std::f32::consts::PI * radius * radius;
    let middle =
        |pixels: &[[f32; 2]]| [0, 1].map(|a| pixels.iter().map(|p| p[a]).sum::<f32>() / pixels.len() as f32 - 60.0);
    view.moon = moon(40.0, 150.0);
    view.sun_direction = sun(-40.0, 330.0);
    let full = lit_pixels(&view, "full-moon");
    assert!(
        (full.len() as f32 / area - 1.0).abs() < 0.05,
        "{} of {area} pixels",
        full.len()
    );
    assert!(middle(&full).iter().all(|m| m.abs() < 1.0), "{:?}", middle(&full));
    // A third of a degree beside: up is up and right is right.
    view.moon = moon(40.2, 150.3);
    let [right, up] = middle(&lit_pixels(&view, "full-moon-beside"));
    let wanted = [0.3f32 * 40.2f32.to_radians().cos(), -0.2].map(|d| d.to_radians() / pixel);
    assert!(
        (right - wanted[0]).abs() < 1.5 && (up - wanted[1]).abs() < 1.5,
        "{right} {up} wanted {wanted:?}"
    );
    // Half moon: the sun a quarter of the sky to the right of it, so its right half is lit.
    view.moon = moon(40.0, 150.0);
    view.sun_direction = sun(-0.05, 240.0);
    view.exposure_ev = 0.0;
    view.sun_direction = {
        // At a right angle to the moon, to the right and 20 degrees down.
        let (m, right) = (sun(40.0, 150.0), sun(0.0, 240.0));
        let up = [
            m[1] * right[2] - m[2] * right[1],
            m[2] * right[0] - m[0] * right[2],
            m[0] * right[1] - m[1] * right[0],
        ];
        let up = if up[2] > 0.0 { up } else { up.map(|v| -v) };
        let (s, c) = 20f32.to_radians().sin_cos();
        [0, 1, 2].map(|a| c * right[a] - s * up[a])
    };
    view.exposure_ev = -7.0;
    let half = lit_pixels(&view, "half-moon");
    assert!(
        (half.len() as f32 / area - 0.5).abs() < 0.12,
        "{} of {area} pixels",
        half.len()
    );
    let [x, y] = middle(&half);
    assert!(x > 0.25 * radius && y > 0.03 * radius && y < 0.4 * radius, "{x} {y}");
}

#[test]
fn stars_stand_where_almanacs_have_them() {
    let mut view = night(101, 101);
    view.vertical_fov_deg = 4.0;
    // Sirius culminates at its right ascension of 2026: 101.287 + 26 x (3.075 + 1.336 sin a tan d) s = 101.573, declination -16.716 + 26 x 20.04" cos a = -16.745.
    let mut at = |sidereal: f32, elevation: f32, azimuth: f32, name: &str| {
        view.stars = Some(StarPlaces {
            equatorial_from_world: equatorial(sidereal),
            years_since_2000: 26.0,
            faintest: 6.0,
        });
        view.azimuth_deg = azimuth;
        view.elevation_deg = elevation;
        let picture = draw(None, &view);
        save(name, &view, &picture);
        let level = |n: usize| picture[n * 3..][..3].iter().map(|b| u32::from(*b)).sum::<u32>();
        let brightest = (0..101 * 101).max_by_key(|n| level(*n)).unwrap();
        [(brightest % 101) as f32 - 50.0, (brightest / 101) as f32 - 50.0]
    };
    let sirius = at(101.573, 90.0 - LATITUDE_DEG - 16.745, 180.0, "sirius");
    assert!(sirius.iter().all(|p| p.abs() <= 1.0), "Sirius is at {sirius:?}");
    // An hour later it has moved west, 15 degrees times the cosine of its declination.
    let later = at(101.573 + 0.5, 90.0 - LATITUDE_DEG - 16.745, 180.0, "sirius-later");
    let wanted = 0.5 * (-16.745f32).to_radians().cos() / 4.0 * 101.0;
    assert!((later[0] - wanted).abs() <= 1.5, "{later:?} wanted {wanted}");
    // The pole star of 2026: declination 89.37, right ascension 3 h 04 min: due north, 0.63 degrees over the pole when it culminates.
    let pole = at(46.0, LATITUDE_DEG + 0.63, 0.0, "polaris");
    assert!(pole.iter().all(|p| p.abs() <= 2.0), "Polaris is at {pole:?}");
}

#[test]
fn the_catalogue_is_the_sky() {
    let stars: Vec<_> = catalogue().collect();
    // Known counts: Sirius leads; 22 stars to magnitude 1.5, some 500 to 4, some 1600 to 5, 5000 to 6.
    assert_eq!(stars.len(), 5044);
    let brighter = |v: f32| stars.iter().filter(|s| s.magnitude <= v).count();
    assert!((20..=24).contains(&brighter(1.5)), "{}", brighter(1.5));
    assert!((470..=530).contains(&brighter(4.0)), "{}", brighter(4.0));
    assert!((1_550..=1_700).contains(&brighter(5.0)), "{}", brighter(5.0));
    assert!(stars.is_sorted_by(|a, b| a.magnitude <= b.magnitude));
    let table = StarTable::new(6.0, 26.0);
    assert_eq!(table.words().len(), STAR_WORDS);
    // Every star is found where it is, with its own light, by any tile it may be looked up in.
    let pixel = 1e-3;
    for star in stars.iter().step_by(3) {
        let d = direction_of_date(star.ascension_deg, star.declination_deg, 26.0).map(|v| v as f32);
        let peak = 10f32.powf(-0.4 * (star.magnitude + 26.74)) / (2.0 * std::f32::consts::PI * 0.25 * pixel * pixel);
        for (axis, shift) in [(0, 0.0), (0, 4e-4), (1, -4e-4), (2, 4e-4)] {
            let mut q = d;
            q[axis] += shift;
            let length = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2]).sqrt();
            let q = q.map(|v| v / length);
            let away: f32 = (0..3).map(|a| (q[a] - d[a]).powi(2)).sum();
            let wanted = peak * (-0.5 * away / (0.25 * pixel * pixel)).exp();
            let found = table.radiance(q, pixel)[1];
            // Others may add; directions are packed to 3e-5.
            assert!(found > 0.85 * wanted, "{star:?}: {found} of {wanted}");
        }
    }
    // And none of them twice: the light of all is that of the catalogue.
    let (mut sum, n) = (0.0f64, 500);
    for i in 0..n {
        for j in 0..2 * n {
            let z = 2.0 * (i as f32 + 0.5) / n as f32 - 1.0;
            let a = (j as f32 + 0.5) / n as f32 * std::f32::consts::PI;
            let side = (1.0 - z * z).sqrt();
            sum += f64::from(table.radiance([side * a.cos(), side * a.sin(), z], 6e-3)[1]);
        }
    }
    let sum = sum * 4.0 * std::f64::consts::PI / (2 * n * n) as f64;
    let wanted: f64 = stars
        .iter()
        .map(|s| 10f64.powf(-0.4 * (f64::from(s.magnitude) + 26.74)))
        .sum();
    assert!((sum / wanted - 1.0).abs() < 0.05, "{sum} of {wanted}");
}

#[test]
fn clouds_dim_stars_and_the_moon_lights_clouds() {
    let cloud = ball(1500.0, 700.0, 0.06);
    let mut view = night(96, 96);
    view.detail = None;
    view.vertical_fov_deg = 20.0;
    view.camera_position_m = [3200.0, 3200.0, 2.0];
    view.elevation_deg = 90.0;
    let specks = |picture: &[u8]| {
        let level = |n: usize| i32::from(picture[n * 3 + 1]);
        (97..96 * 95 - 1)
            .filter(|n| level(*n) > level(n - 1).max(level(n + 1)).max(level(n - 96)).max(level(n + 96)) + 6)
            .count()
    };
    let (open, covered) = (draw(None, &view), draw(Some(&cloud), &view));
    save("stars-above", &view, &open);
    save("stars-behind-cloud", &view, &covered);
    assert!(specks(&open) >= 8, "{} stars", specks(&open));
    assert_eq!(specks(&covered), 0, "stars through a cloud");
    // The moon behind the camera, on the cloud's side.
    view.moon = moon(45.0, 180.0);
    view.sun_direction = sun(-45.0, 0.0);
    view.camera_position_m = [3200.0, -800.0, 1500.0];
    view.elevation_deg = 0.0;
    view.vertical_fov_deg = 60.0;
    let by_moon = draw(Some(&cloud), &view);
    save("moonlit-cloud", &view, &by_moon);
    let middle = |p: &[u8]| f32::from(p[(40 * 96 + 48) * 3 + 1]);
    let sky = f32::from(by_moon[(6 * 96 + 5) * 3 + 1]);
    assert!(middle(&by_moon) > 2.0 * sky, "cloud {} sky {sky}", middle(&by_moon));
}

/// By day the moon is pale and pictures are what they were but for its disc; without the effects not a byte changes.
#[test]
fn the_day_is_left_alone() {
    let cloud = cumulus_field(7, 12);
    let day = settings(96, 54);
    let mut with = day;
    with.moon = moon(-30.0, 0.0);
    with.stars = night(1, 1).stars;
    let (before, after) = (draw(Some(&cloud), &day), draw(Some(&cloud), &with));
    let most = before
        .iter()
        .zip(&after)
        .map(|(a, b)| a.abs_diff(*b))
        .max()
        .unwrap_or(0);
    // Exposure bends at another place: less than a hundredth by day.
    assert!(most <= 2, "{most} levels");
    with.moon = moon(18.0, 5.0);
    let pale = draw(None, &with);
    let clear = draw(None, &day);
    let changed = pale.iter().zip(&clear).filter(|(a, b)| a.abs_diff(**b) > 3).count();
    assert!((1..60).contains(&changed), "{changed} values show the moon");
}

#[test]
fn hard_nights_give_whole_pictures() {
    let cloud = small_ball();
    let mut kept = Prepared::new();
    let mut check = |what: &str, view: ViewSettings| {
        let picture = render(Some(&cloud), &view, &mut kept);
        let mut fresh = Prepared::new();
        assert!(
            picture == render(Some(&cloud), &view, &mut fresh),
            "{what}: kept tables show"
        );
        assert!(
            mean(&picture) > 0.3 && mean(&picture) < 252.0,
            "{what}: {}",
            mean(&picture)
        );
    };
    let base = night(33, 19);
    for sun_deg in [90.0, -2.0, -5.0, -90.0] {
        for moon_deg in [90.0, -0.2, -3.3] {
            let mut view = base;
            view.sun_direction = sun(sun_deg, 10.0);
            view.moon = moon(moon_deg, 10.0);
            check(&format!("sun {sun_deg}, moon {moon_deg}"), view);
        }
    }
    for (place, distance_m) in [
        ([f32::NAN; 3], 0.0),
        ([0.0; 3], f32::NAN),
        ([1e30, 0.0, 1e30], f32::INFINITY),
        ([0.0, 0.0, 1.0], -1.0),
    ] {
        let mut view = base;
        view.moon = Some(MoonPlace {
            direction: place,
            distance_m,
        });
        check(&format!("moon {place:?} at {distance_m}"), view);
    }
    for (elevation, fov) in [(90.0, 170.0), (-90.0, 60.0), (0.0, 0.1), (48.0, 1.0)] {
        let mut view = base;
        view.moon = moon(48.0, 0.0);
        view.elevation_deg = elevation;
        view.vertical_fov_deg = fov;
        check(&format!("looking {elevation}, {fov} wide"), view);
    }
    let mut odd = base;
    odd.stars = Some(StarPlaces {
        equatorial_from_world: [[f32::NAN; 3]; 3],
        years_since_2000: f32::NAN,
        faintest: f32::NAN,
    });
    check("stars nowhere", odd);
}
