//! The past that a server keeps for whoever looks back, through a real server.

mod common;

use std::time::Duration;

use common::{PATIENCE, Server, empty_server, next_of, scene, server};
use serde_json::{Value, json};
use tokio::time::{sleep, timeout};
use welkin_proto::Scene;
use welkin_proto::volume::{Header, Kind, Receiver, Taken};
use welkin_server::limits::Limits;

/// Ten moments a second, so that a test need not wait for minutes.
fn quick() -> Limits {
    Limits {
        past_sky_every_s: 0.1,
        ..Limits::default()
    }
}

async fn moments(server: &Server) -> Vec<Value> {
    let answer = server.get("/v1/worlds/w1/past").await;
    assert_eq!(answer.status, 200);
    answer.json()["moments"].as_array().unwrap().clone()
}

async fn until(server: &Server, what: &str, holds: impl Fn(&[Value]) -> bool) -> Vec<Value> {
    let wait = async {
        loop {
            let moments = moments(server).await;
            if holds(&moments) {
                return moments;
            }
            sleep(Duration::from_millis(50)).await;
        }
    };
    timeout(PATIENCE, wait).await.expect(what)
}

#[tokio::test]
async fn who_comes_late_sees_what_was_there_before() {
    let server = server(quick()).await;
    // Somebody looks on; what is published meanwhile is what whoever comes later must find.
    let mut first = server.stream("w1").await;
    let host = server.state.world("w1").unwrap();
    let mut published = host.view().published.clone();
    let mut seen = Vec::new();
    while seen.len() < 30 {
        timeout(PATIENCE, published.changed()).await.unwrap().unwrap();
        seen.push(published.borrow_and_update().clone());
        next_of(&mut first, "tick").await;
    }
    let kept = until(&server, "ten moments are kept", |m| m.len() >= 10).await;
    let times: Vec<f64> = kept.iter().map(|m| m["published_unix_s"].as_f64().unwrap()).collect();
    assert!(times.is_sorted_by(|a, b| a < b), "{times:?}");

    let mut compared = 0;
    for moment in &kept {
        let tick = moment["tick"].as_u64().unwrap();
        let answer = server.get(&format!("/v1/worlds/w1/past.bin?tick={tick}")).await;
        assert_eq!(
            (answer.status, answer.header("content-type")),
            (200, Some("application/octet-stream"))
        );
        assert_eq!(answer.body.len() as u64, moment["bytes"].as_u64().unwrap());
        let header = Header::decode(&answer.body).unwrap().0;
        assert_eq!((header.kind, header.moment.tick), (Kind::Keyframe, tick));
        let Taken::Field(field) = Receiver::default().take(&answer.body).unwrap() else {
            panic!("a keyframe makes a field")
        };
        let Some(then) = seen.iter().find(|p| p.snapshot.numbers.tick == tick) else {
            continue; // of before this test looked on
        };
        assert_eq!(field.moment.simulated_s, then.snapshot.numbers.simulated_s);
        assert_eq!(field.moment.sun_direction, then.snapshot.sun_direction);
        let channel = field.channel("extinction_per_m").unwrap();
        let exact = &then.snapshot.volume.as_ref().unwrap().extinction_per_m;
        for (got, wanted) in channel.values().iter().zip(exact) {
            let error = f64::from((got - wanted).abs());
            // Single precision rounds the decoded value once more.
            assert!(error <= channel.quantiser.error_max(*wanted) + 6e-8 * f64::from(*wanted));
        }
        compared += 1;
    }
    assert!(compared >= 5, "{compared} moments were compared");

    // A second between two moments gives the earlier one; now gives the newest.
    let (a, b) = (&kept[3], &kept[4]);
    let between = 0.5 * (a["simulated_s"].as_f64().unwrap() + b["simulated_s"].as_f64().unwrap());
    let answer = server
        .get(&format!("/v1/worlds/w1/past.bin?simulated_s={between}"))
        .await;
    assert_eq!(Header::decode(&answer.body).unwrap().0.moment.tick, a["tick"]);
    let newest = server.get("/v1/worlds/w1/past.bin").await;
    assert!(Header::decode(&newest.body).unwrap().0.moment.tick >= kept.last().unwrap()["tick"].as_u64().unwrap());
}

#[tokio::test]
async fn pictures_of_the_past_are_what_they_were() {
    let server = empty_server(quick()).await;
    let host = server
        .state
        .create_world(serde_json::from_value::<Scene>(scene()).unwrap())
        .await
        .unwrap();
    let mut published = host.view().published.clone();
    let cloudy = |p: &std::sync::Arc<welkin_server::host::Published>| {
        let volume = p.snapshot.volume.as_ref().unwrap();
        volume.extinction_per_m.iter().filter(|v| **v > 1e-3).count() > 50
    };
    timeout(PATIENCE, published.wait_for(cloudy)).await.unwrap().unwrap();
    let command = |body: Value| {
        let server = &server;
        async move { assert!(server.post("/v1/worlds/w1/commands", &body).await.status < 300) }
    };
    command(json!({ "command": "pause" })).await;
    let standing = timeout(PATIENCE, published.wait_for(|p| p.snapshot.numbers.paused))
        .await
        .unwrap()
        .unwrap()
        .snapshot
        .numbers
        .tick;
    until(&server, "the standing tick is kept", |m| {
        m.last().is_some_and(|m| m["tick"] == standing)
    })
    .await;
    let size = "width=160&height=120&format=png";
    let then = server.get(&format!("/v1/worlds/w1/frame?{size}")).await;
    assert_eq!(then.header("x-welkin-tick"), Some(standing.to_string().as_str()));
    command(json!({ "command": "resume" })).await;
    timeout(
        PATIENCE,
        published.wait_for(|p| p.snapshot.numbers.tick > standing + 30),
    )
    .await
    .unwrap()
    .unwrap();

    let path = format!("/v1/worlds/w1/frame?{size}&tick={standing}");
    let back = server.get(&path).await;
    assert_eq!(back.header("x-welkin-tick"), Some(standing.to_string().as_str()));
    let now = server.get(&format!("/v1/worlds/w1/frame?{size}")).await;
    let pixels = |answer: &common::Answer| image::load_from_memory(&answer.body).unwrap().into_rgb8().into_raw();
    let (then, back_pixels, now) = (pixels(&then), pixels(&back), pixels(&now));
    let apart = |a: &[u8], b: &[u8]| {
        let sum: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
        sum / a.len() as f64
    };
    let (same, moved) = (apart(&then, &back_pixels), apart(&now, &back_pixels));
    eprintln!("a picture of the past against what it was: mean {same:.4}; against now: {moved:.3}");
    // The kept cloud has 8-bit codes, half a step of which is up to 0.5 % of the densest cloud; measured 0.005.
    assert!(same < 0.2 && moved > 5.0 * same, "{same} from then, {moved} from now");
    // The past does not change any more: who has the picture is told so.
    let tag = format!("If-None-Match: {}\r\n", back.header("etag").unwrap());
    assert_eq!(server.request("GET", &path, &tag, b"").await.status, 304);
}

#[tokio::test]
async fn the_past_is_bounded_and_nobodys_world_keeps_none() {
    let limits = Limits {
        past_sky_s: 0.5,
        ..quick()
    };
    let server = server(limits).await;
    let watcher = server.stream("w1").await;
    // The list itself counts as a look: it is asked for by way of the state.
    let host = server.state.world("w1").unwrap();
    let past = || host.view().past_sky().all();
    let end = tokio::time::Instant::now() + Duration::from_millis(1500);
    while tokio::time::Instant::now() < end {
        let kept = past();
        if let (Some(first), Some(last)) = (kept.first(), kept.last()) {
            assert!(last.published_unix_s - first.published_unix_s <= 0.5);
        }
        sleep(Duration::from_millis(20)).await;
    }
    let kept = past().len();
    // Ten a second for half a second: six fit, fewer where ticks are late.
    assert!((2..=6).contains(&kept), "{kept} moments");
    drop(watcher);
    let gone = async {
        while !past().is_empty() {
            sleep(Duration::from_millis(50)).await;
        }
    };
    timeout(PATIENCE, gone).await.expect("nobody looks, so nothing is kept");
    server
        .get("/v1/worlds/w1/past.bin")
        .await
        .assert_refused(503, "past_unavailable", None);
    // That question was a look.
    until(&server, "and it is kept again", |m| !m.is_empty()).await;
}

#[tokio::test]
async fn what_is_not_kept_or_makes_no_sense_is_refused() {
    let server = server(quick()).await;
    until(&server, "some moments are kept", |m| m.len() >= 3).await;
    for route in ["past.bin", "frame"] {
        for (query, status, code, pointer) in [
            ("tick=18446744073709551615", 404, "not_yet", "/tick"),
            ("simulated_s=1e9", 404, "not_yet", "/simulated_s"),
            ("simulated_s=-1", 410, "too_old", "/simulated_s"),
            ("simulated_s=NaN", 400, "bad_parameter", "/simulated_s"),
            ("simulated_s=inf", 400, "bad_parameter", "/simulated_s"),
            ("tick=-1", 400, "bad_parameter", "/tick"),
            ("tick=1.5", 400, "bad_parameter", "/tick"),
            ("tick=", 400, "bad_parameter", "/tick"),
            ("tick=1&simulated_s=1", 400, "bad_parameter", "/simulated_s"),
            ("ago=3", 400, "unknown_parameter", "/ago"),
        ] {
            let path = format!("/v1/worlds/w1/{route}?{query}");
            server.get(&path).await.assert_refused(status, code, Some(pointer));
        }
    }
    // A live picture without end has no past.
    server
        .get("/v1/worlds/w1/frame.mjpeg?tick=1")
        .await
        .assert_refused(400, "unknown_parameter", Some("/tick"));

    let none = common::server(Limits {
        past_sky_s: 0.0,
        ..Limits::default()
    })
    .await;
    sleep(Duration::from_millis(300)).await;
    assert!(moments(&none).await.is_empty());
    let refused = none.get("/v1/worlds/w1/past.bin").await;
    refused.assert_refused(503, "past_unavailable", None);
}
