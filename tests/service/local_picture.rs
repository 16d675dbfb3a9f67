//! A picture drawn on the client's side from a streamed volume against the server's own of the same tick.

mod common;

use common::{PATIENCE, empty_server, scene};
use futures_util::StreamExt;
use serde_json::json;
use tokio::time::timeout;
use welkin_client::volume::{VolumeEvent, VolumeOptions, subscribe};
use welkin_proto::Scene;
use welkin_server::limits::Limits;
use welkin_server::live_sky;
use welkin_server::machine::Compute;
use welkin_server::picture::Renderer;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_picture_from_volumes_is_the_servers_own() {
    let server = empty_server(Limits::default()).await;
    let mut small = scene();
    // What a picture depends on besides the cloud has to come along too: detail that moves with the air, shadows, haze.
    small["effects"]["cloud_detail"] = json!({ "strength": 0.6, "scale_m": 200.0 });
    small["effects"]["multiple_scattering"] = json!({ "octaves": 4 });
    small["effects"]["cloud_shadow"] = json!({});
    small["effects"]["aerial_perspective"] = json!({ "visibility_m": 40000.0 });
    let small: Scene = serde_json::from_value(small).unwrap();
    let host = server.state.create_world(small.clone()).await.unwrap();
    let mut published = host.view().published.clone();
    let cloudy = |p: &std::sync::Arc<welkin_server::host::Published>| {
        let volume = p.snapshot.volume.as_ref().unwrap();
        volume.extinction_per_m.iter().filter(|v| **v > 1e-3).count() > 50
    };
    timeout(PATIENCE, published.wait_for(cloudy)).await.unwrap().unwrap();
    assert!(
        server
            .post("/v1/worlds/w1/commands", &json!({ "command": "pause" }))
            .await
            .status
            < 300
    );
    let paused = timeout(PATIENCE, published.wait_for(|p| p.snapshot.numbers.paused))
        .await
        .unwrap();
    let tick = paused.unwrap().snapshot.numbers.tick;

    let answer = server.get("/v1/worlds/w1/frame?width=160&height=120&format=png").await;
    assert_eq!(answer.header("x-welkin-tick"), Some(tick.to_string().as_str()));
    let theirs = image::load_from_memory(&answer.body).unwrap().into_rgb8();
    // Mean and largest difference of a colour value of 255, by mip. At the world's own resolution only quantising to 16 bits is left, 0.002 % of the
    // largest extinction; half and quarter resolution blur the cloud's edge, and the mean over the picture tells that it is still the same cloud.
    for (mip, mean_max, largest_max) in [(0, 0.01, 2.0), (1, 6.0, 255.0)] {
        let options = VolumeOptions {
            subscription: live_sky::subscription(mip),
            ..VolumeOptions::default()
        };
        let mut volumes = subscribe(&format!("http://{}", server.address), options).unwrap();
        let field = loop {
            if let VolumeEvent::Volume { field, .. } = timeout(PATIENCE, volumes.next()).await.unwrap().unwrap() {
                break field;
            }
        };
        assert_eq!(field.moment.tick, tick);
        let snapshot = live_sky::snapshot(&field, small.clone()).unwrap();
        let mut renderer = Renderer::new(&Compute::Cpu);
        let ours = renderer
            .render(&snapshot, &snapshot.scene, &small.camera, [160, 120], false)
            .unwrap();
        let differences: Vec<f64> = ours
            .rgb8
            .iter()
            .zip(theirs.as_raw())
            .map(|(a, b)| f64::from(a.abs_diff(*b)))
            .collect();
        let mean = differences.iter().sum::<f64>() / differences.len() as f64;
        let largest = differences.iter().copied().fold(0.0, f64::max);
        eprintln!("mip {mip}: mean {mean:.4}, largest {largest}");
        assert!(
            mean <= mean_max && largest <= largest_max,
            "mip {mip}: mean {mean}, largest {largest}"
        );
    }
    // Without the cloud the picture is another one, so that the comparison above says something.
    let options = VolumeOptions {
        subscription: live_sky::subscription(0),
        ..VolumeOptions::default()
    };
    let mut volumes = subscribe(&format!("http://{}", server.address), options).unwrap();
    let field = loop {
        if let VolumeEvent::Volume { field, .. } = timeout(PATIENCE, volumes.next()).await.unwrap().unwrap() {
            break field;
        }
    };
    let mut clear = live_sky::snapshot(&field, small.clone()).unwrap();
    clear.volume = None;
    let without = Renderer::new(&Compute::Cpu)
        .render(&clear, &clear.scene, &small.camera, [160, 120], false)
        .unwrap();
    let changed = without
        .rgb8
        .iter()
        .zip(theirs.as_raw())
        .filter(|(a, b)| a.abs_diff(**b) > 20)
        .count();
    assert!(changed > 1000, "{changed} values show the cloud");
}

/// What a scene chose reaches the kernels of who draws for themselves, and where no kernel has it, they are told to ask for frames.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn scenery_has_the_scenes_light_or_says_that_no_kernel_does() {
    let server = empty_server(Limits::default()).await;
    let mut plain = scene();
    plain["effects"]["multiple_scattering"] = json!({ "octaves": 4 });
    let with = |methods: serde_json::Value| {
        let mut scene = plain.clone();
        scene["methods"] = methods;
        serde_json::from_value::<Scene>(scene).unwrap()
    };
    let mut told = Vec::new();
    for (n, methods) in [
        json!({}),
        json!({ "phase": { "function": "rayleigh" }, "scattering": "multiple_forward",
                "sun_occlusion": { "method": "secondary_march", "steps": 3 } }),
    ]
    .into_iter()
    .enumerate()
    {
        server.state.create_world(with(methods)).await.unwrap();
        let answer = server.get(&format!("/v1/worlds/w{}/scenery", n + 1)).await;
        assert_eq!(answer.status, 200);
        told.push(answer.json()["uniforms"].clone());
    }
    assert_eq!(told[0]["ViewFrame"]["secondary_steps"], json!(0.0));
    assert_eq!(told[1]["ViewFrame"]["secondary_steps"], json!(3.0));
    assert_eq!(told[0]["ViewFrame"]["octaves"], json!(4.0));
    assert_eq!(told[1]["ViewFrame"]["octaves"], json!(0.0));
    assert!(told[1]["ViewFrame"]["depth_scale"].as_f64().unwrap() < 1.0);
    // Sideways Rayleigh's function is 3 / (16 pi), and droplets send next to nothing there.
    let sideways = |told: &serde_json::Value| told["MarchPhase"]["quads"][4 * 511].as_f64().unwrap();
    assert!((sideways(&told[1]) - 3.0 / (16.0 * std::f64::consts::PI)).abs() < 1e-3);
    assert!(sideways(&told[0]) < 0.03);

    server
        .state
        .create_world(with(
            json!({ "scattering": "diffusion", "sun_occlusion": { "method": "beer_shadow_map", "side": 60 } }),
        ))
        .await
        .unwrap();
    let told = server.get("/v1/worlds/w3/scenery").await;
    assert_eq!(told.status, 200);
    let frame = &told.json()["uniforms"]["ViewFrame"];
    // A map's side is whole packets of 16, a Beer map has three numbers a ray, and droplets' asymmetry is 0.8 to 0.9.
    assert_eq!((&frame["map_side"], &frame["map_numbers"]), (&json!(64.0), &json!(3.0)));
    let similarity = frame["similarity"].as_f64().unwrap();
    assert!(similarity > 0.1 && similarity < 0.2, "{similarity}");

    for (n, scattering) in ["slab", "slab_collector"].into_iter().enumerate() {
        let methods = json!({ "scattering": scattering });
        server.state.create_world(with(methods)).await.unwrap();
        let world = format!("/v1/worlds/w{}", n + 4);
        let refused = server.get(&format!("{world}/scenery")).await;
        assert_eq!(
            (refused.status, refused.json()["code"].clone()),
            (400, json!("method_needs_cpu"))
        );
        let frame = server
            .get(&format!("{world}/frame?width=32&height=18&format=png"))
            .await;
        assert_eq!(frame.status, 200);
        assert_eq!(server.delete(&world).await.status, 204);
    }
}
