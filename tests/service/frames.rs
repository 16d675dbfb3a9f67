//! Frames for thin clients: motion JPEG, still pictures, what one viewer may cost, what a frame says of its way.

mod common;

use std::time::{Duration, Instant};

use common::{PATIENCE, Server, empty_server, next, next_frame, next_of, say, scene, server};
use futures_util::StreamExt;
use futures_util::stream::FuturesUnordered;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio::time::timeout;
use welkin_proto::Camera;
use welkin_proto::wire::{Command, FrameFormat, FrameHeader};
use welkin_server::host::renderer::{FrameRequest, RenderService};
use welkin_server::http::{AppState, serve};
use welkin_server::limits::Limits;
use welkin_server::machine::Compute;

const MJPEG: &str = "/v1/worlds/w1/frame.mjpeg";

async fn ask(mut tcp: TcpStream, path: &str) -> TcpStream {
    let request =
        format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nAccept-Encoding: gzip\r\n\r\n");
    tcp.write_all(request.as_bytes()).await.unwrap();
    tcp
}

/// Reads an endless answer until `count` parts of a motion JPEG are there: the head of the answer, and head and image of each part.
async fn parts(tcp: &mut TcpStream, count: usize) -> (String, Vec<(String, Vec<u8>)>) {
    let mut bytes = Vec::new();
    let reading = async {
        loop {
            let body = unchunked(&bytes);
            if body.windows(9).filter(|w| w == b"--frame\r\n").count() > count {
                return body;
            }
            assert!(tcp.read_buf(&mut bytes).await.unwrap() > 0, "the answer has ended");
        }
    };
    let body = timeout(PATIENCE, reading).await.expect("parts in time");
    let head_end = bytes.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
    let head = String::from_utf8(bytes[..head_end].to_vec()).unwrap();
    let mut rest = body.as_slice();
    let mut found = Vec::new();
    for _ in 0..count {
        rest = rest.strip_prefix(b"--frame\r\n").expect("a boundary");
        let end = rest.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
        let head = String::from_utf8(rest[..end].to_vec()).unwrap();
        let length: usize = field(&head, "Content-Length").unwrap().parse().unwrap();
        found.push((head, rest[end + 4..][..length].to_vec()));
        rest = rest[end + 4 + length..].strip_prefix(b"\r\n").expect("an end of line");
    }
    (head, found)
}

fn field<'a>(head: &'a str, name: &str) -> Option<&'a str> {
    head.lines()
        .filter_map(|line| line.split_once(": "))
        .find(|(known, _)| known.eq_ignore_ascii_case(name))
        .map(|(_, value)| value)
}

/// The body so far of an answer with chunked transfer coding.
fn unchunked(bytes: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    let Some(head) = bytes.windows(4).position(|w| w == b"\r\n\r\n") else {
        return body;
    };
    let mut rest = &bytes[head + 4..];
    while let Some(line) = rest.windows(2).position(|w| w == b"\r\n") {
        let length = usize::from_str_radix(std::str::from_utf8(&rest[..line]).unwrap(), 16).unwrap();
        let chunk = &rest[line + 2..];
        if chunk.len() < length + 2 {
            break;
        }
        body.extend_from_slice(&chunk[..length]);
        rest = &chunk[length + 2..];
    }
    body
}

/// Width and height of a JPEG, from its frame header.
fn jpeg_size(bytes: &[u8]) -> [u16; 2] {
    assert_eq!(
        (&bytes[..2], &bytes[bytes.len() - 2..]),
        (&[0xff, 0xd8][..], &[0xff, 0xd9][..])
    );
    let mut at = 2;
    loop {
        let (marker, length) = (bytes[at + 1], u16::from_be_bytes([bytes[at + 2], bytes[at + 3]]));
        if (0xc0..=0xc2).contains(&marker) {
            return [7, 5].map(|n| u16::from_be_bytes([bytes[at + n], bytes[at + n + 1]]));
        }
        at += 2 + length as usize;
    }
}

#[tokio::test]
async fn motion_jpeg_shows_ticks_one_after_another_and_is_not_compressed() {
    let server = server(Limits::default()).await;
    let tcp = TcpStream::connect(server.address).await.unwrap();
    let mut tcp = ask(tcp, &format!("{MJPEG}?width=48&height=32&max_fps=5&azimuth_deg=10")).await;
    let began = Instant::now();
    let (head, shown) = parts(&mut tcp, 5).await;
    // Five at no more than five a second span four gaps of a fifth; the first gap's clock started before `began`.
    assert!(began.elapsed() > Duration::from_millis(550), "{:?}", began.elapsed());
    assert_eq!(
        field(&head, "content-type"),
        Some("multipart/x-mixed-replace; boundary=frame")
    );
    assert_eq!(field(&head, "content-encoding"), None);
    let mut ticks = Vec::new();
    for (head, image) in &shown {
        assert_eq!(jpeg_size(image), [48, 32]);
        assert_eq!(field(head, "Content-Type"), Some("image/jpeg"));
        ticks.push(field(head, "X-Welkin-Tick").unwrap().parse::<u64>().unwrap());
        assert!(field(head, "Server-Timing").unwrap().contains("render;dur="), "{head}");
    }
    assert!(ticks.windows(2).all(|w| w[0] < w[1]), "{ticks:?}");
    assert_eq!(server.state.stream_count(), 1);
    drop(tcp);
    gone(&server).await;
}

/// Waits until no stream is counted any more.
async fn gone(server: &Server) {
    let began = Instant::now();
    while server.state.stream_count() > 0 {
        assert!(began.elapsed() < PATIENCE, "a viewer who has left is still counted");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test]
async fn motion_jpeg_is_refused_where_a_frame_would_be_and_ends_with_its_world() {
    let server = server(Limits {
        streams_max: 1,
        ..Limits::default()
    })
    .await;
    for (query, code, pointer) in [
        ("width=0", "out_of_range", "/width"),
        ("z_m=x", "bad_parameter", "/z_m"),
        ("max_fps=0", "out_of_range", "/max_fps"),
        ("max_fps=NaN", "bad_parameter", "/max_fps"),
        ("quality=best", "bad_parameter", "/quality"),
        ("quality=still&width=3840&height=2160", "out_of_range", "/quality"),
        ("format=png", "bad_parameter", "/format"),
        ("fps=3", "unknown_parameter", "/fps"),
    ] {
        let answer = server.get(&format!("{MJPEG}?{query}")).await;
        answer.assert_refused(400, code, Some(pointer));
    }
    let tcp = TcpStream::connect(server.address).await.unwrap();
    let mut tcp = ask(tcp, &format!("{MJPEG}?width=16&height=16")).await;
    parts(&mut tcp, 1).await;
    server.get(MJPEG).await.assert_refused(429, "too_many_streams", None);
    assert_eq!(server.delete("/v1/worlds/w1").await.status, 204);
    let mut rest = Vec::new();
    timeout(PATIENCE, tcp.read_to_end(&mut rest))
        .await
        .expect("it ends")
        .unwrap();
    assert!(rest.ends_with(b"0\r\n\r\n"), "the answer ends in order");
}

#[tokio::test]
async fn a_reader_of_motion_jpeg_that_stalls_loses_its_connection_and_holds_nobody_up() {
    let limits = Limits {
        stall_timeout_s: 1.0,
        ..Limits::default()
    };
    let state = AppState::new(limits, Some(1)).unwrap();
    state
        .create_world(serde_json::from_value(scene()).unwrap())
        .await
        .unwrap();
    // Small buffers on both sides, so that a few pictures fill them; connections have those of their listener.
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_send_buffer_size(4096).unwrap();
    socket.bind(([127, 0, 0, 1], 0).into()).unwrap();
    let listener = socket.listen(16).unwrap();
    let address = listener.local_addr().unwrap();
    tokio::spawn(serve(listener, state.clone()));
    let server = Server { address, state };
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_recv_buffer_size(4096).unwrap();
    let deaf = socket.connect(server.address).await.unwrap();
    let deaf = ask(deaf, &format!("{MJPEG}?width=640&height=360&max_fps=60")).await;
    let mut other = server.stream("w1").await;
    let began = Instant::now();
    while server.state.stream_count() < 2 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    // Its buffers are filled, then nothing moves for a second, then it is gone; the other one gets its ticks all the while.
    let mut ticks = 0;
    while server.state.stream_count() > 1 {
        assert!(began.elapsed() < PATIENCE, "the deaf client is still held");
        next_of(&mut other, "tick").await;
        ticks += 1;
    }
    assert!(ticks >= 5, "{ticks} ticks in {:?}", began.elapsed());
    drop(deaf);
}

/// Runs of the march so far, that is pictures rendered.
async fn marches(server: &Server) -> u64 {
    let plan = server.get("/v1/worlds/w1/plan").await.json();
    let passes = plan["passes"].as_array().unwrap();
    let march = passes.iter().find(|p| p["stage"] == "march").unwrap();
    march["runs"].as_u64().unwrap()
}

async fn pause(server: &Server) {
    let host = server.state.world("w1").unwrap();
    host.view().command(Command::Pause {}).unwrap();
    while !host.view().newest().snapshot.numbers.paused {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

#[tokio::test]
async fn viewers_with_the_same_camera_share_one_picture() {
    let server = server(Limits::default()).await;
    pause(&server).await;
    let wish = |azimuth_deg: f64| {
        let camera = json!({ "position_m": [800, 800, 200], "azimuth_deg": azimuth_deg, "elevation_deg": 20, "vertical_fov_deg": 60 });
        json!({ "type": "frames", "width": 40, "height": 30, "format": "png", "max_fps": 30.0, "camera": camera })
    };
    // The plan is of the newest publication but with the newest counts, so the world may stand.
    let mut first = server.stream("w1").await;
    say(&mut first, wish(1.0)).await;
    next_frame(&mut first).await;
    let before = marches(&server).await;
    let mut viewers = Vec::new();
    for _ in 0..6 {
        viewers.push(server.stream("w1").await);
    }
    for viewer in &mut viewers {
        say(viewer, wish(2.0)).await;
    }
    let mut images = Vec::new();
    for viewer in &mut viewers {
        let message = next_frame(viewer).await;
        images.push(FrameHeader::decode(&message).unwrap().1.to_vec());
    }
    assert!(images.windows(2).all(|w| w[0] == w[1]));
    assert_eq!(marches(&server).await, before + 1, "six viewers, one picture");
    say(&mut first, wish(3.0)).await;
    next_frame(&mut first).await;
    assert_eq!(marches(&server).await, before + 2, "another camera is another picture");
}

#[tokio::test]
async fn a_viewer_whose_pictures_take_long_lets_others_pass() {
    let server = server(Limits::default()).await;
    let host = server.state.world("w1").unwrap();
    let world = host.view();
    let mut turned = 0.0;
    let mut request = |side: u32| {
        turned += 1.0;
        FrameRequest {
            width: side,
            height: side,
            format: FrameFormat::Jpeg,
            // Never the same picture twice.
            camera: Camera {
                azimuth_deg: turned,
                ..world.scene.camera.clone()
            },
            still: false,
            whole: false,
            past: None,
            layers: None,
        }
    };
    for (share, heavy_first) in [(0.5, false), (1.0, true)] {
        let renderer = RenderService::start(Compute::Cpu, share).unwrap();
        let present = [renderer.viewer(), renderer.viewer()];
        let [heavy, light] = [0, 1].map(|n| present[n].viewer);
        let ask = |viewer, request| renderer.request(viewer, world, request, 10).unwrap();
        // Asked for in this order while the first is being rendered, which takes far longer than the asking.
        let first = ask(heavy, request(600));
        let second = ask(heavy, request(600));
        let small = ask(light, request(16));
        // In the order in which they are answered, however late this task gets to look.
        let mut answers: FuturesUnordered<_> = [("first", first), ("second", second), ("small", small)]
            .map(|(name, ticket)| async move { (name, ticket.answer.await.unwrap().unwrap().render_ms) })
            .into_iter()
            .collect();
        let mut order = Vec::new();
        let mut second_ms = 0.0;
        while let Some((name, render_ms)) = answers.next().await {
            order.push(name);
            if name == "second" {
                second_ms = render_ms;
            }
        }
        let expected = if heavy_first {
            ["first", "second", "small"]
        } else {
            ["first", "small", "second"]
        };
        assert_eq!(order, expected, "share {share}");
        // Alone it waits for nobody: its next picture comes although it would have to rest for as long as the last one took.
        let waiting = Instant::now();
        ask(heavy, request(16)).answer.await.unwrap().unwrap();
        let waited_ms = waiting.elapsed().as_secs_f64() * 1e3;
        assert!(waited_ms < second_ms, "{waited_ms} of {second_ms} ms");
    }
}

fn times(message: &[u8]) -> (FrameHeader, Vec<u8>) {
    let (header, image) = FrameHeader::decode(message).unwrap();
    (header, image.to_vec())
}

#[tokio::test]
async fn a_resting_camera_on_a_resting_world_gets_the_still_picture_once() {
    let server = server(Limits::default()).await;
    pause(&server).await;
    let mut socket = server.stream("w1").await;
    let wish = json!({ "type": "frames", "width": 48, "height": 32, "format": "png", "max_fps": 20.0, "quality": "resting", "header": 2 });
    say(&mut socket, wish).await;
    let (live, live_image) = times(&next_frame(&mut socket).await);
    let asked = Instant::now();
    let (still, still_image) = times(&next_frame(&mut socket).await);
    assert!(asked.elapsed() > Duration::from_millis(400), "{:?}", asked.elapsed());
    let delivery = (live.delivery.unwrap(), still.delivery.unwrap());
    assert_eq!((delivery.0.still, delivery.1.still), (false, true));
    assert_eq!((live.tick, still.sequence), (still.tick, 1));
    assert!(
        timeout(Duration::from_millis(900), next(&mut socket)).await.is_err(),
        "once is enough"
    );

    // The still picture is the mean light of two by two pixels of a live one twice as large.
    let twice = server.get("/v1/worlds/w1/frame?format=png&width=96&height=64").await;
    let fine = image::load_from_memory(&twice.body).unwrap().to_rgb8();
    let seen = image::load_from_memory(&still_image).unwrap().to_rgb8();
    assert_ne!(live_image, still_image);
    let light = |byte: u8| {
        let value = f64::from(byte) / 255.0;
        if value <= 0.04045 {
            value / 12.92
        } else {
            ((value + 0.055) / 1.055).powf(2.4)
        }
    };
    for (x, y, pixel) in seen.enumerate_pixels() {
        for c in 0..3 {
            let quad = [(0, 0), (1, 0), (0, 1), (1, 1)];
            let mean = quad
                .iter()
                .map(|(i, j)| light(fine.get_pixel(2 * x + i, 2 * y + j)[c]))
                .sum::<f64>()
                / 4.0;
            // A byte is the nearest: half a byte away, and a hair more for the table of 50,000 steps.
            let (low, high) = (light(pixel[c].saturating_sub(1)), light(pixel[c].saturating_add(1)));
            assert!(mean >= low && mean <= high, "{x}, {y}, {c}: {mean} in {low} to {high}");
        }
    }

    // The snapshot of the same view is the same picture, under a tag of its own.
    let snapshot = |quality: &str| format!("/v1/worlds/w1/frame?format=png&width=48&height=32&quality={quality}");
    let (a, b) = (
        server.get(&snapshot("still")).await,
        server.get(&snapshot("live")).await,
    );
    assert_eq!((&a.body, &b.body), (&still_image, &live_image));
    let tag = a.header("etag").unwrap().to_owned();
    assert_ne!(Some(tag.as_str()), b.header("etag"));
    let held = format!("If-None-Match: {tag}\r\n");
    assert_eq!(server.request("GET", &snapshot("still"), &held, b"").await.status, 304);
    let large = server
        .get("/v1/worlds/w1/frame?quality=still&width=3840&height=2160")
        .await;
    large.assert_refused(400, "out_of_range", Some("/quality"));
}

#[tokio::test]
async fn a_frame_says_what_its_way_took() {
    let server = server(Limits::default()).await;
    let unix_ms = |health: &Value| health["unix_ms"].as_f64().unwrap();
    let before = unix_ms(&server.get("/healthz").await.json());
    let mut socket = server.stream("w1").await;
    let wish =
        |header: u32| json!({ "type": "frames", "width": 320, "height": 180, "max_fps": 20.0, "header": header });
    say(&mut socket, wish(2)).await;
    let mut last_sent = before;
    for _ in 0..4 {
        let (header, _) = times(&next_frame(&mut socket).await);
        let delivery = header.delivery.expect("version 2 was asked for");
        let worked_ms = header.render_ms + header.encode_ms;
        // Rendering begins after the publication, so an age holds the work and, up to rounding, the wait.
        assert!(delivery.age_ms >= worked_ms, "{delivery:?}, worked {worked_ms}");
        assert!(
            delivery.wait_ms >= 0.0 && delivery.wait_ms + worked_ms <= delivery.age_ms + 0.01,
            "{delivery:?}"
        );
        assert!(delivery.sent_unix_ms >= last_sent, "{delivery:?}");
        last_sent = delivery.sent_unix_ms;
    }
    let after = unix_ms(&server.get("/healthz").await.json());
    assert!(last_sent <= after && after - before < PATIENCE.as_millis() as f64);
    // Who names no version gets the first.
    let mut old = server.stream("w1").await;
    say(
        &mut old,
        json!({ "type": "frames", "width": 16, "height": 16, "max_fps": 20.0 }),
    )
    .await;
    assert_eq!(times(&next_frame(&mut old).await).0.delivery, None);
    say(&mut old, wish(3)).await;
    let error = next_of(&mut old, "error").await["error"].clone();
    assert_eq!(
        (error["code"].as_str(), error["pointer"].as_str()),
        (Some("out_of_range"), Some("/header"))
    );
}

/// The niceness of this process's threads whose names begin so.
#[cfg(target_os = "linux")]
fn niceness(name: &str) -> Vec<i32> {
    let tasks = std::fs::read_dir("/proc/self/task").unwrap();
    // A thread may end between its listing and its reading.
    let read = |task: std::io::Result<std::fs::DirEntry>| {
        let path = task.ok()?.path();
        let known = std::fs::read_to_string(path.join("comm")).ok()?;
        let stat = std::fs::read_to_string(path.join("stat")).ok()?;
        // The nineteenth field; the second is the name in brackets.
        let nice = stat[stat.rfind(')')? + 2..].split(' ').nth(16)?.parse().ok()?;
        known.starts_with(name).then_some(nice)
    };
    tasks.filter_map(read).collect()
}

#[cfg(target_os = "linux")]
#[test]
fn drawing_and_serving_step_back_and_worlds_do_not() {
    use welkin_server::priority::{DRAWING, SERVING, step_back};
    // As `welkin serve` has it.
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .thread_name("serves")
        .enable_all()
        .on_thread_start(|| step_back(SERVING))
        .build()
        .unwrap();
    runtime.block_on(async {
        let server = empty_server(Limits::default()).await;
        // By a request, so that a thread that has stepped back asks for it.
        let made = server.post("/v1/worlds", &json!({ "scene": common::scene() })).await;
        assert_eq!(made.status, 201, "{:?}", made.json());
        assert_eq!(server.get("/v1/worlds/w1/frame?width=32&height=18").await.status, 200);
        assert_eq!(server.get("/v1/worlds/w1/volume.bin").await.status, 200);
        let own = std::fs::read_to_string(format!("/proc/self/task/{}/stat", std::process::id())).unwrap();
        let base: i32 = own[own.rfind(')').unwrap() + 2..]
            .split(' ')
            .nth(16)
            .unwrap()
            .parse()
            .unwrap();
        for (threads, more) in [("world-", 0), ("render", DRAWING), ("serves", SERVING)] {
            let seen = niceness(threads);
            assert!(!seen.is_empty(), "{threads}");
            assert!(seen.iter().all(|n| *n == (base + more).min(19)), "{threads}: {seen:?}");
        }
    });
}
