//! The WebSocket of a real server: numbers, frames, commands, and clients that break the rules.

mod common;

use std::time::{Duration, Instant};

use common::{PATIENCE, next, next_frame, next_json, next_of, say, server};
use futures_util::{SinkExt, StreamExt};
use serde_json::json;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::protocol::frame::coding::CloseCode;
use tokio_tungstenite::tungstenite::{Bytes, Message};
use welkin_proto::wire::{FrameHeader, PROTOCOL_VERSION, ServerMessage};
use welkin_server::limits::Limits;

#[tokio::test]
async fn hello_then_ticks_that_count_up() {
    let server = server(Limits::default()).await;
    let url = format!("ws://{}/v1/worlds/w1/stream", server.address);
    let (mut socket, _) = tokio_tungstenite::connect_async(url).await.unwrap();
    let ServerMessage::Hello {
        protocol,
        world,
        scene,
        cells,
        ..
    } = serde_json::from_value(next_json(&mut socket).await).unwrap()
    else {
        panic!("the first message is the hello");
    };
    assert_eq!(
        (protocol, world.as_str(), scene.as_str(), cells),
        (PROTOCOL_VERSION, "w1", "small", [16; 3])
    );
    let mut ticks = Vec::new();
    while ticks.len() < 5 {
        let ServerMessage::Tick { numbers } = serde_json::from_value(next_json(&mut socket).await).unwrap() else {
            panic!("nobody asked for anything but ticks");
        };
        ticks.push(numbers.tick);
    }
    assert!(ticks.windows(2).all(|w| w[0] < w[1]), "{ticks:?}");
}

#[tokio::test]
async fn frames_come_when_asked_for_at_the_rate_that_was_asked_for() {
    let server = server(Limits::default()).await;
    let mut socket = server.stream("w1").await;
    say(
        &mut socket,
        json!({ "type": "frames", "width": 32, "height": 24, "format": "png", "max_fps": 4.0 }),
    )
    .await;
    let began = Instant::now();
    for sequence in 0..5 {
        let message = next_frame(&mut socket).await;
        let (header, image) = FrameHeader::decode(&message).unwrap();
        assert_eq!((header.width, header.height, header.sequence), (32, 24, sequence));
        let image = image::load_from_memory(image).unwrap();
        assert_eq!((image.width(), image.height()), (32, 24));
    }
    // Five frames at no more than four a second span at least four gaps of a quarter; the first gap's clock started before
    // `began`, hence the slack.
    assert!(began.elapsed() > Duration::from_millis(850), "{:?}", began.elapsed());
    // A new wish replaces the old one.
    say(
        &mut socket,
        json!({ "type": "frames", "width": 20, "height": 10, "format": "jpeg", "max_fps": 30.0 }),
    )
    .await;
    let mut widths = Vec::new();
    while widths.last() != Some(&20) {
        widths.push(FrameHeader::decode(&next_frame(&mut socket).await).unwrap().0.width);
        assert!(widths.len() < 4, "{widths:?}");
    }
    say(&mut socket, json!({ "type": "no_frames" })).await;
    // What was under way may still come; then there are ticks only.
    let mut ticks_in_a_row = 0;
    while ticks_in_a_row < 8 {
        ticks_in_a_row = if matches!(next(&mut socket).await, Message::Text(_)) {
            ticks_in_a_row + 1
        } else {
            0
        };
    }
}

#[tokio::test]
async fn a_paused_world_shows_a_moved_camera() {
    let server = server(Limits::default()).await;
    let mut socket = server.stream("w1").await;
    say(
        &mut socket,
        json!({ "type": "command", "command": { "command": "pause" } }),
    )
    .await;
    while next_of(&mut socket, "tick").await["numbers"]["paused"] != true {}
    let mut images = Vec::new();
    for elevation_deg in [-80.0, 80.0] {
        let camera = json!({ "position_m": [800, 800, 200], "azimuth_deg": 0, "elevation_deg": elevation_deg, "vertical_fov_deg": 60 });
        say(
            &mut socket,
            json!({ "type": "frames", "width": 16, "height": 16, "format": "png", "max_fps": 10.0, "camera": camera }),
        )
        .await;
        images.push(FrameHeader::decode(&next_frame(&mut socket).await).unwrap().1.to_vec());
    }
    assert_ne!(images[0], images[1]);
    // The world stands and nothing was asked for anew: nothing more is sent.
    assert!(timeout(Duration::from_millis(700), next(&mut socket)).await.is_err());
}

#[tokio::test]
async fn what_is_not_understood_is_answered_and_the_stream_goes_on() {
    let server = server(Limits::default()).await;
    let mut socket = server.stream("w1").await;
    let frames = |width: u64, height: u64, max_fps: f64| {
        json!({ "type": "frames", "width": width, "height": height, "max_fps": max_fps }).to_string()
    };
    for (text, code, pointer) in [
        ("hello?".to_owned(), "bad_json", None),
        (String::new(), "bad_json", None),
        ("{}".to_owned(), "bad_message", None),
        (r#"{"type":"dance"}"#.to_owned(), "bad_message", None),
        (frames(0, 0, 5.0), "out_of_range", Some("/width")),
        (frames(100_000, 100_000, 5.0), "out_of_range", Some("/width")),
        (frames(1 << 40, 1, 5.0), "bad_message", None),
        (frames(10, 10, 0.0), "out_of_range", Some("/max_fps")),
        (frames(10, 10, 1e9), "out_of_range", Some("/max_fps")),
        (
            r#"{"type":"command","command":{"command":"time_scale","time_scale":-1}}"#.to_owned(),
            "out_of_range",
            Some("/command/time_scale"),
        ),
    ] {
        socket.send(Message::Text(text.clone().into())).await.unwrap();
        let error = next_of(&mut socket, "error").await["error"].clone();
        assert_eq!(
            (error["code"].as_str(), error["pointer"].as_str()),
            (Some(code), pointer),
            "{text}: {error}"
        );
    }
    socket
        .send(Message::Binary(Bytes::from_static(b"\0\x01\x02")))
        .await
        .unwrap();
    assert_eq!(
        next_of(&mut socket, "error").await["error"]["code"],
        "unexpected_binary"
    );
    next_of(&mut socket, "tick").await;
}

#[tokio::test]
async fn a_message_of_ten_megabytes_ends_the_stream_and_nothing_else() {
    let server = server(Limits::default()).await;
    let mut other = server.stream("w1").await;
    let (mut sender, mut receiver) = server.stream("w1").await.split();
    let sending = tokio::spawn(async move {
        // The server does not read it to its end, so sending may fail: that is its right.
        let _ = sender.send(Message::Text("x".repeat(10 << 20).into())).await;
        sender
    });
    let close = timeout(PATIENCE, async {
        loop {
            match receiver.next().await {
                Some(Ok(Message::Close(Some(frame)))) => return frame.code,
                Some(Ok(_)) => {}
                end => panic!("the stream ended without a close frame: {end:?}"),
            }
        }
    });
    assert_eq!(close.await.expect("it ends in time"), CloseCode::Size);
    drop(receiver);
    sending.abort();
    let before = next_of(&mut other, "tick").await["numbers"]["tick"].as_u64();
    let after = next_of(&mut other, "tick").await["numbers"]["tick"].as_u64();
    assert!(after > before);
    assert_eq!(server.get("/healthz").await.json()["status"], "ok");
}

#[tokio::test]
async fn a_client_that_never_reads_is_dropped_and_holds_nobody_up() {
    let server = server(Limits {
        stall_timeout_s: 1.0,
        ..Limits::default()
    })
    .await;
    // A handshake by hand, with a wish for large frames, and then not one byte is read.
    let mut deaf = tokio::net::TcpStream::connect(server.address).await.unwrap();
    let handshake = format!(
        "GET /v1/worlds/w1/stream HTTP/1.1\r\nHost: {}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n",
        server.address
    );
    deaf.write_all(handshake.as_bytes()).await.unwrap();
    let wish = json!({ "type": "frames", "width": 1280, "height": 720, "format": "png", "max_fps": 60.0 }).to_string();
    let mask = [1u8, 2, 3, 4];
    let mut message = vec![0x81, 0x80 | wish.len() as u8];
    assert!(wish.len() < 126, "the short form of the length");
    message.extend(mask);
    message.extend(wish.bytes().zip(mask.iter().cycle()).map(|(b, m)| b ^ m));
    deaf.write_all(&message).await.unwrap();

    let mut other = server.stream("w1").await;
    let began = Instant::now();
    let mut ticks = Vec::new();
    while ticks.len() < 20 {
        ticks.push(next_of(&mut other, "tick").await["numbers"]["tick"].as_u64().unwrap());
    }
    // Ten ticks a second are asked for: two seconds where nothing holds the other client up.
    assert!(began.elapsed() < Duration::from_secs(20), "{:?}", began.elapsed());
    assert!(ticks.windows(2).all(|w| w[0] < w[1]));
    // The deaf one is given up: its stream is no longer counted.
    let began = Instant::now();
    while server.state.stream_count() > 1 {
        assert!(began.elapsed() < PATIENCE, "the deaf client is still held");
        next_of(&mut other, "tick").await;
    }
    let mut rest = Vec::new();
    let _ = deaf.read_to_end(&mut rest).await; // what lay in the socket, then its end
}

#[tokio::test]
async fn streams_are_limited_in_number_and_closed_to_pages_of_other_sites() {
    let server = server(Limits {
        streams_max: 1,
        ..Limits::default()
    })
    .await;
    let upgrade = "Connection: close, Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    let foreign = format!("{upgrade}Origin: https://elsewhere.example\r\n");
    server
        .request("GET", "/v1/worlds/w1/stream", &foreign, b"")
        .await
        .assert_refused(403, "foreign_origin", None);
    let first = server.stream("w1").await;
    server
        .request("GET", "/v1/worlds/w1/stream", upgrade, b"")
        .await
        .assert_refused(429, "too_many_streams", None);
    drop(first);
    let began = Instant::now();
    while server.state.stream_count() > 0 {
        assert!(began.elapsed() < PATIENCE);
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    server.stream("w1").await;
    server
        .request("GET", "/v1/worlds/none/stream", upgrade, b"")
        .await
        .assert_refused(404, "unknown_world", None);
}

#[tokio::test]
async fn a_stream_ends_with_its_world() {
    let server = server(Limits::default()).await;
    let mut socket = server.stream("w1").await;
    assert_eq!(server.delete("/v1/worlds/w1").await.status, 204);
    for _ in 0..100 {
        if let Message::Close(frame) = next(&mut socket).await {
            assert_eq!(frame.unwrap().code, CloseCode::Away);
            return;
        }
    }
    panic!("the stream outlives its world");
}
