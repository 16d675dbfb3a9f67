//! Streams march as few rays as their scene says; single pictures and still ones march them all.

mod common;

use common::{Server, cloudy_server, next_frame, say, scene};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use welkin_proto::scene::{Pressure, Scene};
use welkin_proto::wire::{FrameFormat, FrameHeader};
use welkin_server::host::renderer::{FrameRequest, RenderService};
use welkin_server::machine::Compute;
use welkin_server::plan::Plan;

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

/// What is kept of a viewer's last picture is as much as is said, on either device, and is freed when the viewer leaves. A world of either device may march like that; what a GPU has no kernel for it refuses.
#[tokio::test]
async fn last_pictures_are_kept_while_their_viewers_are_there() {
    let mut scene = scene();
    scene["methods"] = json!({ "view_sampling": "reproject_4" });
    let mut typed: Scene = serde_json::from_value(scene.clone()).unwrap();
    let server = cloudy_server(scene).await;
    let host = server.state.world("w1").unwrap();
    let mut devices = vec![(Compute::Cpu, 40)];
    match Compute::choose("gpu") {
        Ok(gpu) => devices.push((gpu, 20)),
        Err(error) => welkin_tests::skip("last_pictures_are_kept_while_their_viewers_are_there", "gpu", error),
    }
    for (compute, pixel_bytes) in devices {
        let plan = Plan::new(&typed).unwrap();
        compute.supports(&plan).unwrap();
        typed.methods.pressure = Some(Pressure::Multigrid { cycles: 4 });
        let refused = compute.supports(&Plan::new(&typed).unwrap()).err();
        let code = refused.map(|error| error.code.to_string());
        assert_eq!(code.as_deref(), (pixel_bytes == 20).then_some("method_needs_cpu"));
        typed.methods.pressure = None;

        let renderer = RenderService::start(compute, 1.0).unwrap();
        let present = [renderer.viewer(), renderer.viewer()];
        let mut pictures = Vec::new();
        for n in 0..3 {
            for (side, viewer) in [64, 32].iter().zip(&present) {
                let request = FrameRequest {
                    width: *side,
                    height: *side,
                    format: FrameFormat::Png,
                    camera: serde_json::from_value(camera(f64::from(n))).unwrap(),
                    still: false,
                    whole: false,
                    past: None,
                    layers: None,
                };
                let ticket = renderer.request(viewer.viewer, host.view(), request, 10).unwrap();
                pictures.push(ticket.answer.await.unwrap().unwrap());
            }
        }
        assert!(pictures.windows(2).all(|pair| pair[0].bytes != pair[1].bytes));
        let comes_to = |bytes: usize| {
            let began = Instant::now();
            while renderer.last_picture_bytes() != bytes {
                let now = renderer.last_picture_bytes();
                assert!(began.elapsed() < Duration::from_secs(20), "{now} bytes, not {bytes}");
                std::thread::sleep(Duration::from_millis(5));
            }
        };
        comes_to(pixel_bytes * (64 * 64 + 32 * 32));
        let [first, second] = present;
        drop(first);
        comes_to(pixel_bytes * 32 * 32);
        drop(second);
        comes_to(0);
    }
}

#[tokio::test]
async fn a_stream_that_ends_leaves_no_picture() {
    let mut scene = scene();
    scene["methods"] = json!({ "view_sampling": "reproject_16" });
    let server = cloudy_server(scene).await;
    let kept = async || {
        server.get("/healthz").await.json()["last_picture_bytes"]
            .as_u64()
            .unwrap()
    };
    let mut socket = server.stream("w1").await;
    let wish =
        json!({ "type": "frames", "width": 96, "height": 54, "format": "png", "max_fps": 30.0, "camera": camera(0.0) });
    say(&mut socket, wish).await;
    next_frame(&mut socket).await;
    let began = Instant::now();
    for wanted in [40 * 96 * 54, 0] {
        while kept().await != wanted {
            assert!(began.elapsed() < Duration::from_secs(20), "not {wanted} bytes");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        if wanted > 0 {
            socket.close(None).await.unwrap();
        }
    }
}
