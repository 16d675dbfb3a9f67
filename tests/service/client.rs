//! The native client against real servers and against ones that misbehave.

use std::net::SocketAddr;
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::timeout;
use tokio_tungstenite::accept_async;
use tokio_tungstenite::tungstenite::Message;
use welkin_client::{ClientError, Event, Events, FrameWish, Next, Options, ServerUrl, connect, get_json, list_worlds};
use welkin_proto::camera::Camera;
use welkin_proto::presets;
use welkin_proto::wire::{ClientMessage, FrameFormat, FrameHeader, FrameQuality, Numbers, ServerMessage};
use welkin_server::http::{AppState, serve};
use welkin_server::limits::Limits;

const LIMIT: Duration = Duration::from_secs(60);

async fn next(events: &mut Events) -> Event {
    timeout(LIMIT, events.next())
        .await
        .expect("an event in time")
        .expect("the stream goes on")
}

fn quick(world: Option<&str>) -> Options {
    let retry_first = Duration::from_millis(20);
    Options {
        world: world.map(str::to_owned),
        retry_first,
        retry_last: retry_first,
        ..Options::default()
    }
}

fn hello(protocol: u32) -> ServerMessage {
    ServerMessage::Hello {
        protocol,
        server: "0.0.0".to_owned(),
        world: "w1".to_owned(),
        scene: "paper".to_owned(),
        cells: [4, 5, 6],
        cell_size_m: [100.0; 3],
        camera: Camera {
            position_m: [0.0; 3],
            azimuth_deg: 0.0,
            elevation_deg: 0.0,
            vertical_fov_deg: 60.0,
            exposure_ev: 0.0,
        },
    }
}

fn text(message: &ServerMessage) -> Message {
    Message::text(serde_json::to_string(message).expect("it is JSON"))
}

async fn listen() -> (TcpListener, String) {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address: SocketAddr = listener.local_addr().expect("it is bound");
    (listener, format!("http://{address}"))
}

async fn accept(listener: &TcpListener) -> TcpStream {
    timeout(LIMIT, listener.accept())
        .await
        .expect("a connection in time")
        .expect("a connection")
        .0
}

#[tokio::test(flavor = "multi_thread")]
async fn a_real_world_is_found_and_followed_with_pictures() {
    let (listener, url) = listen().await;
    let state = AppState::new(Limits::default(), Some(1)).expect("the server starts");
    let mut scene = presets::find("clear-sky-wind").expect("the preset is there");
    scene.domain.cells = [16, 16, 16];
    state.create_world(scene.clone()).await.expect("the scene is good");
    let server = tokio::spawn(serve(listener, state));

    let address = ServerUrl::parse(&url).expect("an address");
    let worlds = list_worlds(&address).await.expect("a list");
    assert_eq!(worlds.len(), 1);
    assert_eq!(worlds[0].cells, [16, 16, 16]);
    let refused = get_json(&address, "/v1/worlds/nowhere").await;
    assert!(
        matches!(&refused, Err(ClientError::Refused(e)) if e.code == "unknown_world"),
        "{refused:?}"
    );

    let wish = FrameWish {
        width: 64,
        height: 36,
        format: FrameFormat::Png,
        max_fps: 20.0,
        camera: None,
    };
    let mut events = connect(
        &url,
        Options {
            frames: Some(wish),
            ..Options::default()
        },
    )
    .expect("an address");
    let Event::Hello(hello) = next(&mut events).await else {
        panic!("the hello comes first")
    };
    assert_eq!((hello.world, hello.scene), (worlds[0].id.clone(), scene.name));
    let (mut ticks, mut frames) = (Vec::new(), Vec::new());
    while ticks.len() < 2 || frames.len() < 2 {
        match next(&mut events).await {
            Event::Tick(numbers) => ticks.push(numbers.tick),
            Event::Frame(frame) => frames.push(frame),
            other => panic!("{other:?}"),
        }
    }
    assert!(
        ticks.windows(2).all(|pair| pair[0] <= pair[1]),
        "ticks go back: {ticks:?}"
    );
    for (number, frame) in frames.iter().enumerate() {
        let picture = image::load_from_memory(&frame.image).expect("a PNG");
        assert_eq!((picture.width(), picture.height()), (64, 36));
        assert_eq!((frame.header.width, frame.header.height), (64, 36));
        assert_eq!(frame.header.sequence as usize, number);
    }

    let mut nowhere = connect(&url, quick(Some("w99"))).expect("an address");
    let last = next(&mut nowhere).await;
    assert!(
        matches!(&last, Event::Error { error: ClientError::Refused(e), next: Next::Ends } if e.code == "unknown_world"),
        "{last:?}"
    );
    assert!(timeout(LIMIT, nowhere.next()).await.expect("an end in time").is_none());
    server.abort();
}

#[tokio::test]
async fn a_lost_stream_comes_back_and_asks_for_its_pictures_again() {
    let (listener, url) = listen().await;
    let wish = FrameWish {
        width: 8,
        height: 4,
        format: FrameFormat::Webp,
        max_fps: 1.0,
        camera: None,
    };
    let mut events = connect(
        &url,
        Options {
            frames: Some(wish),
            ..quick(Some("w1"))
        },
    )
    .expect("an address");
    for round in 0..3u32 {
        let mut socket = accept_async(accept(&listener).await).await.expect("a handshake");
        socket.send(text(&hello(1))).await.expect("it is sent");
        let asked = timeout(LIMIT, socket.next())
            .await
            .expect("a wish in time")
            .expect("a message")
            .expect("no error");
        let asked: ClientMessage = serde_json::from_str(asked.to_text().expect("text")).expect("a known message");
        let wanted = ClientMessage::Frames {
            width: 8,
            height: 4,
            format: FrameFormat::Webp,
            max_fps: 1.0,
            camera: None,
            quality: FrameQuality::Live,
            header: 2,
        };
        assert_eq!(asked, wanted);
        let header = FrameHeader {
            format: FrameFormat::Webp,
            width: 8,
            height: 4,
            tick: 7,
            simulated_s: 70.0,
            render_ms: 1.0,
            encode_ms: 1.0,
            sequence: round,
            image_bytes: 3,
            delivery: None,
        };
        let mut bytes = header.encode();
        bytes.extend(b"abc");
        socket
            .send(text(&ServerMessage::Tick {
                numbers: Numbers {
                    tick: 7,
                    ..Numbers::default()
                },
            }))
            .await
            .expect("sent");
        socket.send(Message::binary(bytes)).await.expect("it is sent");
        assert!(matches!(next(&mut events).await, Event::Hello(h) if h.cells == [4, 5, 6]));
        assert!(matches!(next(&mut events).await, Event::Tick(n) if n.tick == 7));
        assert!(matches!(next(&mut events).await, Event::Frame(f) if f.header == header && f.image == b"abc"));
        drop(socket); // without a close frame, as a crash does it
        let lost = next(&mut events).await;
        assert!(
            matches!(
                lost,
                Event::Error {
                    error: ClientError::Lost(_),
                    next: Next::RetryIn(_)
                }
            ),
            "{lost:?}"
        );
    }
}

#[tokio::test]
async fn rubbish_on_the_stream_is_reported_and_does_not_end_it() {
    let (listener, url) = listen().await;
    let mut events = connect(&url, quick(Some("w1"))).expect("an address");
    let mut socket = accept_async(accept(&listener).await).await.expect("a handshake");
    socket.send(text(&hello(1))).await.expect("it is sent");
    assert!(matches!(next(&mut events).await, Event::Hello(_)));
    for rubbish in [
        Message::text("{"),
        Message::text(r#"{"type":"weather"}"#),
        Message::binary(b"WLKF".to_vec()),
        Message::binary(vec![0; 4096]),
    ] {
        socket.send(rubbish.clone()).await.expect("it is sent");
        let event = next(&mut events).await;
        let told = matches!(
            event,
            Event::Error {
                error: ClientError::BadMessage(_),
                next: Next::GoesOn
            }
        );
        assert!(told, "{rubbish:?} gave {event:?}");
    }
    socket
        .send(text(&ServerMessage::Tick {
            numbers: Numbers::default(),
        }))
        .await
        .expect("it is sent");
    assert!(matches!(next(&mut events).await, Event::Tick(_)));
}

#[tokio::test]
async fn another_protocol_is_named_and_not_tried_again() {
    let (listener, url) = listen().await;
    let mut events = connect(&url, quick(Some("w1"))).expect("an address");
    let mut socket = accept_async(accept(&listener).await).await.expect("a handshake");
    socket.send(text(&hello(2))).await.expect("it is sent");
    let event = next(&mut events).await;
    let told = matches!(
        event,
        Event::Error {
            error: ClientError::OtherProtocol { theirs: 2, ours: 1, .. },
            next: Next::Ends
        }
    );
    assert!(told, "{event:?}");
    assert!(timeout(LIMIT, events.next()).await.expect("an end in time").is_none());
}

#[tokio::test]
async fn what_is_no_welkin_server_gives_a_clear_error() {
    let (listener, url) = listen().await;
    let server = ServerUrl::parse(&url).expect("an address");
    for (answer, why) in [
        ("SSH-2.0-OpenSSH_9.2\r\n\r\n".to_owned(), "begins with"),
        (
            "HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\n<htm>".to_owned(),
            "expected value",
        ),
        (
            "HTTP/1.1 200 OK\r\nContent-Length: 999999999\r\n\r\n".to_owned(),
            "more than",
        ),
        (
            format!("HTTP/1.1 200 OK\r\nX: {}\r\n\r\n", "x".repeat(100_000)),
            "more than",
        ),
        (
            "HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n5\r\n[".to_owned(),
            "too early",
        ),
        ("HTTP/1.1 503 Busy\r\n\r\nbusy".to_owned(), "HTTP status 503"),
    ] {
        let serve = async {
            let mut tcp = accept(&listener).await;
            let mut request = [0; 1024];
            let read = tcp.read(&mut request).await.expect("a request");
            assert!(
                request[..read].starts_with(b"GET /v1/worlds HTTP/1.1\r\n"),
                "{:?}",
                &request[..read]
            );
            // A client that has seen enough may hang up before the end.
            let _ = tcp.write_all(answer.as_bytes()).await;
        };
        let (listed, ()) = tokio::join!(list_worlds(&server), serve);
        let error = listed.expect_err("no list").to_string();
        assert!(
            error.contains(why),
            "{:?} gave {error:?}",
            &answer[..answer.len().min(60)]
        );
    }
    drop(listener);
    let gone = list_worlds(&server).await;
    assert!(matches!(gone, Err(ClientError::Unreachable { .. })), "{gone:?}");
}
