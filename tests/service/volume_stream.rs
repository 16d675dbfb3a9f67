//! The volume WebSocket of a real server, message by message, and its HTTP sibling.

mod common;

use std::time::{Duration, Instant};

use common::{PATIENCE, Socket, empty_server, next, next_json, next_of, say, scene, server};
use futures_util::SinkExt;
use serde_json::{Value, json};
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::{Bytes, Message};
use welkin_proto::Scene;
use welkin_proto::channel::Channel;
use welkin_proto::volume::{Header, Kind, Receiver, Taken};
use welkin_server::limits::Limits;

async fn open(server: &common::Server) -> (Socket, Value) {
    let url = format!("ws://{}/v1/worlds/w1/volume", server.address);
    let (mut socket, _) = tokio_tungstenite::connect_async(url).await.unwrap();
    let hello = next_json(&mut socket).await;
    assert_eq!(
        (&hello["type"], &hello["protocol"]),
        (&json!("hello"), &json!(1)),
        "{hello}"
    );
    (socket, hello)
}

fn subscription(channels: &[&str], more: Value) -> Value {
    let mut message = json!({ "type": "subscribe", "channels": channels, "rate_hz": 20.0 });
    for (key, value) in more.as_object().unwrap() {
        message[key] = value.clone();
    }
    message
}

async fn volume(socket: &mut Socket) -> Vec<u8> {
    loop {
        if let Message::Binary(bytes) = next(socket).await {
            return bytes.to_vec();
        }
    }
}

#[tokio::test]
async fn volumes_of_every_channel_come_and_count_up() {
    let server = server(Limits::default()).await;
    let (mut socket, hello) = open(&server).await;
    assert_eq!(hello["cells"], json!([16, 16, 16]));
    let channels: Vec<&str> = hello["channels"]
        .as_array()
        .unwrap()
        .iter()
        .map(|c| c.as_str().unwrap())
        .collect();
    assert!(
        channels.contains(&"extinction_per_m") && channels.contains(&"wind_z_m_s"),
        "{channels:?}"
    );
    // The small scene has no turbulence.
    assert!(!channels.contains(&Channel::EddyDissipationRateM23S.name()));
    say(&mut socket, subscription(&channels, json!({ "mip": 1 }))).await;
    let subscribed = next_of(&mut socket, "subscribed").await;
    assert_eq!(subscribed["cells"], json!([8, 8, 8]));
    let mut receiver = Receiver::default();
    let mut last = None;
    for n in 0..20 {
        let message = volume(&mut socket).await;
        let header = Header::decode(&message).unwrap().0;
        assert_eq!(json!(header.view), subscribed["view"]);
        assert!(n > 0 || header.kind == Kind::Keyframe, "the first is a keyframe");
        let Taken::Field(field) = receiver.take(&message).unwrap() else {
            panic!("nothing is lost here")
        };
        let moment = field.moment;
        assert!(moment.encoded_unix_s >= moment.published_unix_s);
        if let Some((tick, simulated_s, published_s)) =
            last.replace((moment.tick, moment.simulated_s, moment.published_unix_s))
        {
            assert!(moment.tick > tick && moment.simulated_s > simulated_s && moment.published_unix_s > published_s);
        }
        for (channel, name) in field.channels.iter().zip(&channels) {
            let values = channel.values();
            let within = |low: f32, high: f32| values.iter().all(|v| (low..=high).contains(v));
            let plausible = match *name {
                "temperature_k" => within(250.0, 310.0),
                "pressure_pa" => within(7e4, 1.01e5),
                "relative_humidity" => within(0.5, 1.1),
                "wind_x_m_s" => within(-20.0, 30.0),
                "vapour_kg_kg" | "total_water_kg_kg" => within(1e-4, 0.03),
                "visibility_m" => within(1e5, 1e6),
                _ => within(-100.0, 100.0),
            };
            assert!(plausible, "{name}: {values:?}");
        }
    }
}

#[tokio::test]
async fn a_volume_is_the_worlds_field_within_its_bound() {
    let server = empty_server(Limits::default()).await;
    let scene: Scene = serde_json::from_value(scene()).unwrap();
    let host = server.state.create_world(scene).await.unwrap();
    // Let the bubble condense, then stand still.
    let mut published = host.view().published.clone();
    let cloudy = |p: &std::sync::Arc<welkin_server::host::Published>| {
        let volume = p.snapshot.volume.as_ref().unwrap();
        volume.extinction_per_m.iter().any(|v| *v > 1e-3)
    };
    timeout(PATIENCE, published.wait_for(cloudy)).await.unwrap().unwrap();
    let paused = server
        .post("/v1/worlds/w1/commands", &json!({ "command": "pause" }))
        .await;
    assert!(paused.status < 300, "{:?}", paused.body);
    let standing = timeout(PATIENCE, published.wait_for(|p| p.snapshot.numbers.paused))
        .await
        .unwrap()
        .unwrap()
        .clone();
    let exact = &standing.snapshot.volume.as_ref().unwrap().extinction_per_m;
    for (bits, compression) in [(8, "deflate"), (16, "zstd"), (8, "none")] {
        let path = format!(
            "/v1/worlds/w1/volume.bin?channels=extinction_per_m,wind_x_m_s&bits={bits}&compression={compression}"
        );
        let answer = server.get(&path).await;
        assert_eq!(
            (answer.status, answer.header("content-type")),
            (200, Some("application/octet-stream"))
        );
        let Taken::Field(field) = Receiver::default().take(&answer.body).unwrap() else {
            panic!("a keyframe makes a field")
        };
        assert_eq!(field.moment.tick, standing.snapshot.numbers.tick);
        let channel = field.channel("extinction_per_m").unwrap();
        for (got, wanted) in channel.values().iter().zip(exact) {
            let error = f64::from((got - wanted).abs());
            // Single precision rounds the decoded value once more.
            assert!(
                error <= channel.quantiser.error_max(*wanted) + 6e-8 * f64::from(*wanted),
                "{got} for {wanted}"
            );
        }
        assert!(
            field
                .channel("wind_x_m_s")
                .unwrap()
                .values()
                .iter()
                .any(|v| (v - 5.0).abs() < 1.0)
        );
    }
    // A world that stands sends its state once, and nothing after.
    let (mut socket, _) = open(&server).await;
    say(&mut socket, subscription(&["extinction_per_m"], json!({}))).await;
    let first = volume(&mut socket).await;
    assert_eq!(
        Header::decode(&first).unwrap().0.moment.tick,
        standing.snapshot.numbers.tick
    );
    assert!(timeout(Duration::from_millis(500), volume(&mut socket)).await.is_err());
    // Asked for again, it is the same message, not one made anew.
    say(&mut socket, json!({ "type": "resync" })).await;
    assert_eq!(volume(&mut socket).await, first);
}

#[tokio::test]
async fn a_changed_subscription_begins_with_a_keyframe_and_a_refused_one_changes_nothing() {
    let server = server(Limits::default()).await;
    let (mut socket, _) = open(&server).await;
    let mut receiver = Receiver::default();
    for (region, mip, cells) in [
        (json!({ "from": [0, 0, 0], "cells": [16, 16, 16] }), 0, [16, 16, 16]),
        (json!({ "from": [3, 5, 0], "cells": [4, 4, 9] }), 1, [3, 3, 5]),
        (json!({ "from": [0, 0, 0], "cells": [16, 16, 16] }), 2, [4, 4, 4]),
    ] {
        say(
            &mut socket,
            subscription(&["extinction_per_m"], json!({ "region_cells": region, "mip": mip })),
        )
        .await;
        let subscribed = next_of(&mut socket, "subscribed").await;
        assert_eq!(subscribed["cells"], json!(cells));
        receiver.expect(subscribed["view"].as_u64().unwrap() as u32);
        for n in 0..4 {
            let message = volume(&mut socket).await;
            assert!(n > 0 || Header::decode(&message).unwrap().0.kind == Kind::Keyframe);
            let Taken::Field(field) = receiver.take(&message).unwrap() else {
                panic!("each message is of the new view and readable")
            };
            assert_eq!(field.layout.cells(), cells);
        }
    }
    say(&mut socket, subscription(&["soup"], json!({}))).await;
    assert_eq!(next_of(&mut socket, "error").await["error"]["code"], "unknown_channel");
    assert!(matches!(receiver.take(&volume(&mut socket).await), Ok(Taken::Field(_))));
    say(&mut socket, json!({ "type": "unsubscribe" })).await;
    // What was under way may still come; then there is nothing more.
    tokio::time::sleep(Duration::from_millis(300)).await;
    while timeout(Duration::from_millis(400), volume(&mut socket)).await.is_ok() {}
    say(&mut socket, json!({ "type": "ping", "client_s": 1.5 })).await;
    assert_eq!(next_of(&mut socket, "pong").await["client_s"], 1.5);
}

#[tokio::test]
async fn absurd_subscriptions_are_refused_by_code_and_the_stream_goes_on() {
    let limits = Limits {
        volume_values_max: 5000,
        volume_views_max: 2,
        ..Limits::default()
    };
    let server = server(limits).await;
    let (mut socket, _) = open(&server).await;
    let one = ["extinction_per_m"];
    for (message, code, pointer) in [
        (json!({ "type": "subscribe" }), "bad_message", None),
        (json!({ "type": "dance" }), "bad_message", None),
        (subscription(&[], json!({})), "out_of_range", Some("/channels")),
        (
            subscription(&["soup"], json!({})),
            "unknown_channel",
            Some("/channels/0"),
        ),
        (
            subscription(&["wind_x_m_s", "rain_rate_mm_h"], json!({})),
            "channel_unavailable",
            Some("/channels/1"),
        ),
        (
            subscription(&["eddy_dissipation_rate_m23_s"], json!({})),
            "channel_unavailable",
            Some("/channels/0"),
        ),
        (
            subscription(&["wind_x_m_s"; 2], json!({})),
            "duplicate_channel",
            Some("/channels/1"),
        ),
        (subscription(&one, json!({ "mip": 7 })), "out_of_range", Some("/mip")),
        (subscription(&one, json!({ "mip": 1000 })), "bad_message", None),
        (
            subscription(&one, json!({ "rate_hz": 0.0 })),
            "out_of_range",
            Some("/rate_hz"),
        ),
        (
            subscription(&one, json!({ "rate_hz": 1e9 })),
            "out_of_range",
            Some("/rate_hz"),
        ),
        (
            subscription(&one, json!({ "bytes_per_s": 1.0 })),
            "out_of_range",
            Some("/bytes_per_s"),
        ),
        (
            subscription(&one, json!({ "bytes_per_s": -1.0 })),
            "out_of_range",
            Some("/bytes_per_s"),
        ),
        (subscription(&one, json!({ "bits": 12 })), "bad_message", None),
        (
            subscription(&one, json!({ "compression": "rot13" })),
            "bad_message",
            None,
        ),
        (subscription(&one, json!({ "colour": "red" })), "bad_message", None),
        (
            subscription(
                &one,
                json!({ "region_cells": { "from": [0, 0, 0], "cells": [17, 1, 1] } }),
            ),
            "bad_region",
            Some("/region_cells/cells/0"),
        ),
        (
            subscription(
                &one,
                json!({ "region_cells": { "from": [4294967295u32, 0, 0], "cells": [4294967295u32, 1, 1] } }),
            ),
            "bad_region",
            Some("/region_cells/cells/0"),
        ),
        (
            subscription(&one, json!({ "region_m": { "from": [0, 0, 0], "to": [1e300, 1, 1] } })),
            "bad_region",
            Some("/region_m/to/0"),
        ),
        (
            subscription(&["extinction_per_m", "wind_x_m_s"], json!({})),
            "volume_too_large",
            None,
        ),
    ] {
        say(&mut socket, message.clone()).await;
        let error = next_of(&mut socket, "error").await["error"].clone();
        let got = (error["code"].as_str(), error["pointer"].as_str());
        assert_eq!(got, (Some(code), pointer), "{message}: {error}");
    }
    socket.send(Message::Binary(Bytes::from_static(b"WLKV"))).await.unwrap();
    assert_eq!(
        next_of(&mut socket, "error").await["error"]["code"],
        "unexpected_binary"
    );
    socket.send(Message::Text("{".into())).await.unwrap();
    assert_eq!(next_of(&mut socket, "error").await["error"]["code"], "bad_json");
    // A third view is one too many; the same view from another client is not.
    let mut others = Vec::new();
    for mip in [1, 2] {
        let (mut other, _) = open(&server).await;
        say(&mut other, subscription(&one, json!({ "mip": mip }))).await;
        next_of(&mut other, "subscribed").await;
        others.push(other);
    }
    assert_eq!(server.state.volumes().view_count(), 2);
    say(&mut socket, subscription(&one, json!({ "mip": 3 }))).await;
    assert_eq!(next_of(&mut socket, "error").await["error"]["code"], "too_many_views");
    say(&mut socket, subscription(&one, json!({ "mip": 2 }))).await;
    next_of(&mut socket, "subscribed").await;
    volume(&mut socket).await;
    // Views end with those who look at them.
    drop((socket, others));
    let began = Instant::now();
    while server.state.volumes().view_count() > 0 {
        assert!(began.elapsed() < PATIENCE);
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    for (query, status, code, pointer) in [
        ("mip=9", 400, "out_of_range", Some("/mip")),
        ("mip=x", 400, "bad_parameter", Some("/mip")),
        ("bits=9", 400, "bad_parameter", Some("/bits")),
        ("channels=", 400, "unknown_channel", Some("/channels/0")),
        ("channels=soup", 400, "unknown_channel", Some("/channels/0")),
        ("from=1,2", 400, "bad_parameter", Some("/from")),
        ("from=99,0,0", 400, "bad_region", Some("/region_cells/cells/0")),
        ("colour=red", 400, "unknown_parameter", Some("/colour")),
        ("channels=extinction_per_m,wind_x_m_s", 413, "volume_too_large", None),
    ] {
        let answer = server.get(&format!("/v1/worlds/w1/volume.bin?{query}")).await;
        answer.assert_refused(status, code, pointer);
    }
}

#[tokio::test]
async fn rates_and_byte_budgets_are_kept() {
    let server = server(Limits::default()).await;
    let during = Duration::from_secs(4);
    // The small world publishes ten times a second: at 10 Hz all come, at 3 Hz some, and a budget lets through what it can pay for.
    let run = |more: Value| {
        let server = &server;
        async move {
            let (mut socket, _) = open(server).await;
            say(&mut socket, subscription(&["wind_z_m_s"], more)).await;
            next_of(&mut socket, "subscribed").await;
            let began = Instant::now();
            let (mut count, mut deltas, mut bytes) = (0u32, 0u32, 0usize);
            while let Ok(message) = timeout(during.saturating_sub(began.elapsed()), volume(&mut socket)).await {
                count += 1;
                deltas += u32::from(Header::decode(&message).unwrap().0.kind == Kind::Delta);
                bytes += message.len();
            }
            (count, deltas, bytes as f64)
        }
    };
    let budget = 6000.0;
    let ((all, _, bytes), (_, some, _), (paid, _, paid_bytes)) = tokio::join!(
        run(json!({ "rate_hz": 60.0 })),
        run(json!({ "rate_hz": 3.0 })),
        run(json!({ "rate_hz": 60.0, "bytes_per_s": budget })),
    );
    assert!(all > 15, "{all} of forty came");
    // A delta may come with its keyframe before it: that is one volume.
    assert!((5..=14).contains(&some), "{some} at three a second");
    assert!(
        bytes > 4.0 * budget * 1.5,
        "{bytes} bytes are more than the budget, else it tests nothing"
    );
    // What came in, what was saved in a second before, and one delta behind its keyframe.
    let largest = 2.0 * 5000.0;
    assert!(
        paid_bytes <= budget * 5.0 + largest,
        "{paid_bytes} of {budget} a second"
    );
    assert!(paid_bytes > 0.5 * budget * 4.0, "the budget is used: {paid_bytes}");
    assert!(paid < all);
}

#[tokio::test]
async fn who_does_not_read_gets_fewer_and_holds_nobody_up() {
    let server = server(Limits::default()).await;
    let (mut slow, _) = open(&server).await;
    let (mut quick, _) = open(&server).await;
    for socket in [&mut slow, &mut quick] {
        say(socket, subscription(&["wind_z_m_s"], json!({ "rate_hz": 60.0 }))).await;
        next_of(socket, "subscribed").await;
    }
    let mut newest = 0;
    let mut count = 0;
    let began = Instant::now();
    while began.elapsed() < Duration::from_secs(3) {
        newest = Header::decode(&volume(&mut quick).await).unwrap().0.moment.tick;
        count += 1;
    }
    assert!(count > 10, "{count} in three seconds");
    // The slow one finds no more than three volumes (and a keyframe that goes with one) waiting, then the newest.
    let mut waiting = 0;
    loop {
        let tick = Header::decode(&volume(&mut slow).await).unwrap().0.moment.tick;
        if tick >= newest {
            break;
        }
        waiting += 1;
        assert!(waiting <= 4, "{waiting} old volumes waited");
    }
    assert!(waiting > 0, "it was slow");
}

#[tokio::test]
async fn a_channel_whose_effect_goes_away_ends_the_subscription_with_a_word() {
    let server = server(Limits::default()).await;
    let (mut socket, _) = open(&server).await;
    say(&mut socket, subscription(&["liquid_water_kg_kg"], json!({}))).await;
    volume(&mut socket).await;
    let mut effects = scene()["effects"].clone();
    effects.as_object_mut().unwrap().remove("moisture");
    effects["bubble"]
        .as_object_mut()
        .unwrap()
        .remove("total_water_kg_per_kg");
    let answer = server
        .post(
            "/v1/worlds/w1/commands",
            &json!({ "command": "effects", "effects": effects }),
        )
        .await;
    assert!(answer.status < 300, "{:?}", String::from_utf8_lossy(&answer.body));
    assert_eq!(
        next_of(&mut socket, "error").await["error"]["code"],
        "channel_unavailable"
    );
    // The connection stands, and what is left can be had.
    say(&mut socket, subscription(&["wind_x_m_s"], json!({}))).await;
    next_of(&mut socket, "subscribed").await;
    volume(&mut socket).await;
}

#[tokio::test]
async fn a_stopped_world_ends_its_volumes() {
    let server = server(Limits::default()).await;
    let (mut socket, _) = open(&server).await;
    say(&mut socket, subscription(&["extinction_per_m"], json!({}))).await;
    volume(&mut socket).await;
    assert!(server.delete("/v1/worlds/w1").await.status < 300);
    loop {
        match next(&mut socket).await {
            Message::Close(close) => {
                assert_eq!(close.unwrap().reason, "the world has stopped");
                return;
            }
            Message::Text(_) | Message::Binary(_) => {}
            other => panic!("{other:?}"),
        }
    }
}
