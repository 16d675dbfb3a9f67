//! Clouds' shadows in hazy air, against the integral that defines them.

use std::f64::consts::PI;

use welkin_server::clouds::{cumulus_field, settings, sun, volume};
use welkin_shaders::cpu::light::Atmosphere;
use welkin_shaders::cpu::light::transmittance_table::TransmittanceTable;
use welkin_shaders::cpu::view::light_shafts::SHAFT_SAMPLES_MAX;
use welkin_shaders::cpu::view::{Prepared, ViewSettings, radiance, render};
use welkin_shaders::{CloudVolume, Grid};

const BASE_M: f32 = 1000.0;
const VISIBILITY_M: f32 = 15_000.0;
const SIDE: usize = 24;

/// Cloud of an optical depth of 10 from 1000 to 1500 m over the first `covered` of 48 columns of 500 m.
fn deck(covered: usize) -> CloudVolume {
    let grid = Grid {
        cells: [48, 4, 30],
        cell_size_m: [500.0, 500.0, 50.0],
    };
    let of = |n: usize| {
        let (x, z) = (n % 48, n / (48 * 4));
        if x < covered && (20..30).contains(&z) {
            0.02
        } else {
            0.0
        }
    };
    volume(grid, (0..48 * 4 * 30).map(of).collect())
}

/// From 2 m above the ground at x, to the north, without detail.
fn view(x_m: f32, elevation_deg: f32, samples: u32) -> ViewSettings {
    ViewSettings {
        camera_position_m: [x_m, 500.0, 2.0],
        azimuth_deg: 0.0,
        elevation_deg,
        vertical_fov_deg: 1.0,
        detail: None,
        visibility_m: Some(VISIBILITY_M),
        light_shafts: samples,
        sun_direction: sun(50.0, 40.0),
        ..settings(SIDE, SIDE)
    }
}

/// Mean radiance of a small picture, and what shadows take from it.
fn seen_and_taken(cloud: &CloudVolume, x_m: f32, elevation_deg: f32) -> ([f64; 3], [f64; 3]) {
    let mean = |samples| {
        let view = view(x_m, elevation_deg, samples);
        let pixels = radiance(Some(cloud), &view, &mut Prepared::new());
        [0, 1, 2].map(|c| pixels.iter().map(|p| f64::from(p[c])).sum::<f64>() / pixels.len() as f64)
    };
    let (without, with) = (mean(0), mean(SHAFT_SAMPLES_MAX));
    (without, [0, 1, 2].map(|c| without[c] - with[c]))
}

/// What a beam that is wholly blocked up to `BASE_M` takes from a ray at `elevation_deg` to the north, by small steps in 64 bits.
fn taken_under_a_deck(elevation_deg: f64) -> [f64; 3] {
    let air = Atmosphere::new(0.0, Some(VISIBILITY_M));
    let table = TransmittanceTable::new(&air);
    let beam = sun(50.0, 40.0).map(f64::from);
    let (rise, ahead) = elevation_deg.to_radians().sin_cos();
    let turn = ahead * beam[1] + rise * beam[2];
    let rayleigh = 3.0 / (16.0 * PI) * (1.0 + turn * turn);
    let g: f64 = 0.76;
    let aerosol = (1.0 - g * g) / (4.0 * PI * (1.0 + g * g - 2.0 * g * turn).powf(1.5));
    // What the cloud lets through evenly, by two streams: a part of what comes down on level ground, so a fluence of twice that, a share 1 / 4 pi of it to here.
    let spread = 0.45 / (0.105 * 10.0 / beam[2] + 1.0) * 2.0 * beam[2] / (4.0 * PI);
    let mut depth = [0.0f64; 3];
    let mut sum = [0.0f64; 3];
    let step = 1.0;
    let mut t = 0.5;
    loop {
        let height = 2.0 + t * rise + (t * ahead) * (t * ahead) / (2.0 * 6_360_000.0);
        if height >= f64::from(BASE_M) {
            return sum;
        }
        let here = air.at(height as f32);
        let light = table.of_sun(height as f32, beam[2] as f32);
        for c in 0..3 {
            // The share of aerosol's extinction that is absorption, and ozone, are in the extinction.
            let extinction = f64::from(here.extinction_per_m[c]);
            let scattered = f64::from(here.rayleigh_per_m[c]) * (rayleigh - spread)
                + f64::from(here.aerosol_per_m) * (aerosol - spread);
            sum[c] += (-depth[c] - 0.5 * extinction * step).exp() * scattered * f64::from(light[c]) * step;
            depth[c] += extinction * step;
        }
        t += step;
    }
}

#[test]
fn a_closed_deck_takes_what_the_beam_would_have_lit() {
    let cloud = deck(48);
    for elevation_deg in [2.0f32, 8.0, 30.0, 80.0] {
        let (seen, taken) = seen_and_taken(&cloud, 12_000.0, elevation_deg);
        let expected = taken_under_a_deck(f64::from(elevation_deg));
        for c in 0..3 {
            // Light is known at three heights only, the deck's depth by the slab's own smoothing of it.
            let apart = taken[c] / expected[c] - 1.0;
            assert!(
                apart.abs() < 0.05,
                "{elevation_deg} degrees, colour {c}: {} is not {}",
                taken[c],
                expected[c]
            );
            assert!(taken[c] < seen[c], "no less than nothing is seen");
        }
    }
}

#[test]
fn light_falls_through_a_gap() {
    // Cloud from 0 to 12 km, the sun in the north-east at 50 degrees: its edge's shadow stands 0.54 km to the west on the ground.
    let cloud = deck(24);
    let (_, shaded) = seen_and_taken(&cloud, 6_000.0, 20.0);
    let (_, lit) = seen_and_taken(&cloud, 18_000.0, 20.0);
    let (_, edge) = seen_and_taken(&cloud, 11_700.0, 20.0);
    assert!(
        shaded[1] > 0.0 && lit[1].abs() < 0.01 * shaded[1],
        "{shaded:?}, {lit:?}"
    );
    assert!(
        edge[1] > 0.1 * shaded[1] && edge[1] < 0.9 * shaded[1],
        "{edge:?} of {shaded:?}"
    );
}

#[test]
fn more_samples_come_nearer_to_the_same() {
    let cloud = cumulus_field(3, 14);
    let by = |samples| {
        let view = ViewSettings {
            light_shafts: samples,
            visibility_m: Some(VISIBILITY_M),
            sun_direction: sun(25.0, 15.0),
            ..settings(64, 36)
        };
        radiance(Some(&cloud), &view, &mut Prepared::new())
    };
    let truth = by(SHAFT_SAMPLES_MAX);
    let error = |samples| {
        let squares = by(samples)
            .iter()
            .zip(&truth)
            .map(|(a, b)| f64::from(a[1] - b[1]).powi(2))
            .sum::<f64>();
        squares.sqrt()
    };
    let (few, many) = (error(6), error(24));
    assert!(few > 0.0 && many < 0.5 * few, "{few} with 6 samples, {many} with 24");
}

#[test]
fn without_cloud_there_are_no_shadows() {
    let grid = Grid {
        cells: [8, 8, 8],
        cell_size_m: [100.0; 3],
    };
    let empty = volume(grid, vec![0.0; 512]);
    let with = view(100.0, 10.0, 24);
    let without = ViewSettings {
        light_shafts: 0,
        ..with
    };
    for cloud in [None, Some(&empty)] {
        let [a, b] = [with, without].map(|v| render(cloud, &v, &mut Prepared::new()));
        assert_eq!(a, b);
    }
}
