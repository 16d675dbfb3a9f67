//! Streams march as few rays as their scene says; single pictures and still ones march them all.

mod common;

use common::{Server, cloudy_server, next_frame, say, scene};
use serde_json::{Value, json};
use welkin_proto::wire::FrameHeader;

/// How often a stage of the view has run.
async fn runs(server: &Server, stage: &str) -> Option<u64> {
    let plan = server.get("/v1/worlds/w1/plan").await.json();
    let passes = plan["passes"].as_array().unwrap();
    let found = passes.iter().find(|p| p["stage"] == stage)?;
    found["runs"].as_u64()
}

fn camera(azimuth_deg: f64) -> Value {
    json!({ "position_m": [1600, -2000, 300], "azimuth_deg": azimuth_deg, "elevation_deg": 10, "vertical_fov_deg": 60 })
}

#[tokio::test]
async fn streams_march_what_the_scene_says_and_single_pictures_every_pixel() {
    for (sampling, stage) in [
        ("reproject_16", "reproject"),
        ("impostors", "impostors"),
        ("half_resolution", "upsample"),
        ("every_pixel", "march"),
    ] {
        let mut scene = scene();
        scene["methods"] = json!({ "view_sampling": sampling });
        let server = cloudy_server(scene).await;
        let mut socket = server.stream("w1").await;
        let mut pictures = Vec::new();
        for n in 0..3 {
            let wish = json!({ "type": "frames", "width": 96, "height": 54, "format": "png", "max_fps": 30.0, "camera": camera(f64::from(n)) });
            say(&mut socket, wish).await;
            let message = next_frame(&mut socket).await;
            pictures.push(FrameHeader::decode(&message).unwrap().1.to_vec());
        }
        assert_eq!(runs(&server, stage).await, Some(3), "{sampling}");
        for other in ["reproject", "impostors", "upsample"].iter().filter(|s| **s != stage) {
            assert_eq!(runs(&server, other).await, None, "{sampling}: {other} is in its plan");
        }
        let marched = runs(&server, "march").await.unwrap();
        for (n, seen) in pictures.iter().enumerate() {
            let path = format!(
                "/v1/worlds/w1/frame?width=96&height=54&format=png&x_m=1600&y_m=-2000&z_m=300&azimuth_deg={n}&elevation_deg=10&vertical_fov_deg=60"
            );
            let whole = server.get(&path).await;
            assert_eq!(whole.status, 200, "{:?}", whole.json());
            let [whole, seen] = [&whole.body, seen].map(|b| image::load_from_memory(b).unwrap().to_rgb8().into_raw());
            let squares: f64 = whole
                .iter()
                .zip(&seen)
                .map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2))
                .sum();
            let rms = (squares / whole.len() as f64).sqrt();
            println!("{sampling}, picture {n}: {rms:.2} of 255");
            // The first picture of a stream has nothing to build on.
            let bound = if sampling == "every_pixel" || (n == 0 && stage == "reproject") {
                0.0
            } else {
                4.0
            };
            assert!(rms <= bound, "{sampling}, picture {n}: {rms}");
        }
        assert_eq!(
            runs(&server, "march").await,
            Some(marched + 3),
            "{sampling}: single pictures are drawn whole"
        );
        assert_eq!(
            runs(&server, stage).await,
            Some(if stage == "march" { 6 } else { 3 }),
            "{sampling}"
        );
    }
}
