//! Four small pictures against those kept in `images/reference`.
//!
//! Tolerance: mean difference below 2 of 255 and 99 % of values within 12. The march uses the same operations in the same order on
//! every instruction set, so what differs between machines is the C library's exp, pow, sin and cos in the tables (a last bit), which now
//! and then moves a ray's step; a change of the method shows as far more. After an intended change, run
//! `cargo test -p welkin-tests --test reference_pictures -- --ignored` and look at the new pictures before keeping them.

use std::path::PathBuf;

use welkin_server::clouds::{cumulus_field, settings, sun};
use welkin_shaders::cpu::view::{Prepared, ViewSettings, render};

const WIDTH: usize = 160;
const HEIGHT: usize = 90;

fn views() -> [(&'static str, ViewSettings); 4] {
    let ground = settings(WIDTH, HEIGHT);
    let mut air = ground;
    air.camera_position_m = [3200.0, -2000.0, 1000.0];
    air.elevation_deg = 0.0;
    let mut dusk = ground;
    dusk.azimuth_deg = 250.0;
    dusk.sun_direction = sun(3.0, 270.0);
    let mut down = ground;
    down.camera_position_m[2] = 5000.0;
    down.elevation_deg = -90.0;
    [("ground", ground), ("air", air), ("dusk", dusk), ("down", down)]
}

fn path(name: &str) -> PathBuf {
    let package = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    package.join("images/reference").join(format!("{name}.png"))
}

fn draw(view: &ViewSettings) -> Vec<u8> {
    render(Some(&cumulus_field(7, 12)), view, &mut Prepared::new())
}

#[test]
fn pictures_are_those_that_were_kept() {
    for (name, view) in views() {
        let kept = image::open(path(name))
            .unwrap_or_else(|e| panic!("{name}: {e}"))
            .to_rgb8();
        assert_eq!(
            (kept.width() as usize, kept.height() as usize),
            (WIDTH, HEIGHT),
            "{name}"
        );
        let drawn = draw(&view);
        let mut differences: Vec<u8> = drawn.iter().zip(kept.as_raw()).map(|(a, b)| a.abs_diff(*b)).collect();
        let mean = differences.iter().map(|d| *d as f64).sum::<f64>() / differences.len() as f64;
        differences.sort_unstable();
        let nearly_all = differences[differences.len() * 99 / 100];
        assert!(
            mean < 2.0 && nearly_all < 12,
            "{name}: mean difference {mean:.2}, 99 % within {nearly_all}"
        );
    }
}

#[test]
#[ignore = "writes the reference pictures anew"]
fn regenerate_reference_pictures() {
    for (name, view) in views() {
        image::save_buffer(
            path(name),
            &draw(&view),
            WIDTH as u32,
            HEIGHT as u32,
            image::ColorType::Rgb8,
        )
        .unwrap_or_else(|e| panic!("{name}: {e}"));
    }
}
