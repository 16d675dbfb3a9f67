//! A real server on a free port, a small scene, and a client that sends whatever bytes a test wants.
#![allow(dead_code)] // each test binary uses its part

use std::net::SocketAddr;
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream};
use welkin_proto::Scene;
use welkin_server::http::{AppState, serve};
use welkin_server::limits::Limits;

/// Nothing in these tests may take longer.
pub const PATIENCE: Duration = Duration::from_secs(60);

pub type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

/// A moist box of 16 x 16 x 16 cells with a warm bubble, ticking ten times a wall second.
pub fn scene() -> Value {
    json!({
        "version": 1,
        "name": "small",
        "description": "A small box for tests.",
        "seed": 1,
        "domain": {
            "cells": [16, 16, 16],
            "cell_size_m": [200.0, 200.0, 150.0],
            "latitude_deg": 45.0,
            "longitude_deg": 10.0,
        },
        "time": { "start_utc": "2026-06-21T11:00:00Z", "tick_s": 1.0, "time_scale": 10.0 },
        "base_state": {
            "kind": "constant_stability",
            "surface_pressure_pa": 100000.0,
            "surface_potential_temperature_k": 295.0,
            "buoyancy_frequency_per_s": 0.01,
            "relative_humidity": 0.9,
            "wind_x_m_s": 5.0,
        },
        "effects": {
            "flow": { "courant_max": 1.0 },
            "heat": {},
            "moisture": { "droplet_number_per_m3": 1e8 },
            "bubble": {
                "centre_m": [1600.0, 1600.0, 700.0],
                "radius_m": [600.0, 600.0, 500.0],
                "potential_temperature_k": 2.0,
                "total_water_kg_per_kg": 0.003,
            },
        },
        "sun": { "from": "fixed", "elevation_deg": 50.0, "azimuth_deg": 180.0 },
        "camera": { "position_m": [1600.0, -2000.0, 300.0], "azimuth_deg": 0.0, "elevation_deg": 10.0, "vertical_fov_deg": 60.0 },
    })
}

/// A server that ends with the test.
pub struct Server {
    pub address: SocketAddr,
    pub state: AppState,
}

/// A server without worlds.
pub async fn empty_server(limits: Limits) -> Server {
    let state = AppState::new(limits, Some(1)).unwrap();
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    tokio::spawn(serve(listener, state.clone()));
    Server { address, state }
}

/// A server with the small scene as world `w1`.
pub async fn server(limits: Limits) -> Server {
    let server = empty_server(limits).await;
    let scene: Scene = serde_json::from_value(scene()).unwrap();
    let host = server.state.create_world(scene).await.unwrap();
    assert_eq!(host.summary().id, "w1");
    server
}

/// A server with this scene, the small one or like it, as world `w1`, paused with cloud in the picture.
pub async fn cloudy_server(mut scene: Value) -> Server {
    let server = empty_server(Limits::default()).await;
    scene["time"]["time_scale"] = json!(1000.0);
    let made = server.post("/v1/worlds", &json!({ "scene": scene })).await;
    assert_eq!(made.status, 201, "{:?}", made.json());
    let host = server.state.world("w1").unwrap();
    let began = std::time::Instant::now();
    while host.view().newest().snapshot.numbers.cloud_cover.unwrap_or_default() < 0.02 {
        assert!(began.elapsed() < PATIENCE, "no cloud forms");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    host.view().command(welkin_proto::wire::Command::Pause {}).unwrap();
    while !host.view().newest().snapshot.numbers.paused {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    server
}

/// An HTTP answer.
#[derive(Debug)]
pub struct Answer {
    pub status: u16,
    pub headers: Vec<(String, String)>,
    pub body: Vec<u8>,
}

impl Answer {
    pub fn header(&self, name: &str) -> Option<&str> {
        self.headers
            .iter()
            .find(|(known, _)| known.eq_ignore_ascii_case(name))
            .map(|(_, value)| value.as_str())
    }

    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body)
            .unwrap_or_else(|e| panic!("{e}: {} {:?}", self.status, String::from_utf8_lossy(&self.body)))
    }

    /// Asserts that this is an error of ours, and nothing but its three fields.
    #[track_caller]
    pub fn assert_refused(&self, status: u16, code: &str, pointer: Option<&str>) {
        let body = self.json();
        assert_eq!((self.status, body["code"].as_str()), (status, Some(code)), "{body}");
        assert_eq!(body["pointer"].as_str(), pointer, "{body}");
        assert!(body["message"].as_str().is_some_and(|m| !m.is_empty()), "{body}");
        assert!(
            body.as_object()
                .unwrap()
                .keys()
                .all(|k| ["code", "message", "pointer"].contains(&k.as_str())),
            "{body}"
        );
    }
}

impl Server {
    /// Sends bytes and reads the answer to its end.
    pub async fn raw(&self, request: &[u8]) -> Answer {
        let exchange = async {
            let mut tcp = TcpStream::connect(self.address).await.unwrap();
            // A server that refuses a body early may close while it is still being sent: what it said counts.
            let _ = tcp.write_all(request).await;
            let mut bytes = Vec::new();
            let _ = tcp.read_to_end(&mut bytes).await;
            bytes
        };
        let bytes = timeout(PATIENCE, exchange).await.expect("an answer in time");
        let head_end = bytes
            .windows(4)
            .position(|w| w == b"\r\n\r\n")
            .unwrap_or_else(|| panic!("no HTTP answer: {bytes:?}"));
        let head = std::str::from_utf8(&bytes[..head_end]).unwrap();
        let mut lines = head.split("\r\n");
        let status = lines.next().unwrap().split(' ').nth(1).unwrap().parse().unwrap();
        let headers: Vec<(String, String)> = lines
            .filter_map(|line| line.split_once(": "))
            .map(|(k, v)| (k.to_owned(), v.to_owned()))
            .collect();
        let answer = Answer {
            status,
            headers,
            body: bytes[head_end + 4..].to_vec(),
        };
        assert_ne!(
            answer.header("transfer-encoding"),
            Some("chunked"),
            "this client reads whole bodies only"
        );
        answer
    }

    /// A request with extra header lines, each ended by CRLF.
    pub async fn request(&self, method: &str, path: &str, headers: &str, body: &[u8]) -> Answer {
        let length = if body.is_empty() && method == "GET" {
            String::new()
        } else {
            format!("Content-Length: {}\r\n", body.len())
        };
        let connection = if headers.contains("Connection:") {
            ""
        } else {
            "Connection: close\r\n"
        };
        let head = format!(
            "{method} {path} HTTP/1.1\r\nHost: {}\r\n{connection}{length}{headers}\r\n",
            self.address
        );
        self.raw(&[head.as_bytes(), body].concat()).await
    }

    pub async fn get(&self, path: &str) -> Answer {
        self.request("GET", path, "", b"").await
    }

    pub async fn delete(&self, path: &str) -> Answer {
        self.request("DELETE", path, "", b"").await
    }

    pub async fn post(&self, path: &str, body: &Value) -> Answer {
        self.request(
            "POST",
            path,
            "Content-Type: application/json\r\n",
            body.to_string().as_bytes(),
        )
        .await
    }

    pub async fn stream(&self, world: &str) -> Socket {
        let url = format!("ws://{}/v1/worlds/{world}/stream", self.address);
        let (mut socket, _) = tokio_tungstenite::connect_async(url).await.unwrap();
        let hello = next_json(&mut socket).await;
        assert_eq!(hello["type"], "hello", "{hello}");
        socket
    }
}

/// The next message that is not a ping or pong.
pub async fn next(socket: &mut Socket) -> Message {
    let wanted = async {
        loop {
            match socket.next().await.expect("the stream goes on").unwrap() {
                Message::Ping(_) | Message::Pong(_) => {}
                message => return message,
            }
        }
    };
    timeout(PATIENCE, wanted).await.expect("a message in time")
}

/// The next text message, as JSON; frames are passed over.
pub async fn next_json(socket: &mut Socket) -> Value {
    loop {
        match next(socket).await {
            Message::Text(text) => return serde_json::from_str(&text).unwrap(),
            Message::Binary(_) => {}
            other => panic!("neither text nor binary: {other:?}"),
        }
    }
}

/// The next message of that type.
pub async fn next_of(socket: &mut Socket, kind: &str) -> Value {
    for _ in 0..1000 {
        let message = next_json(socket).await;
        if message["type"] == kind {
            return message;
        }
    }
    panic!("no {kind} among 1000 messages");
}

/// The next frame.
pub async fn next_frame(socket: &mut Socket) -> Vec<u8> {
    loop {
        if let Message::Binary(bytes) = next(socket).await {
            return bytes.to_vec();
        }
    }
}

pub async fn say(socket: &mut Socket, message: Value) {
    socket.send(Message::Text(message.to_string().into())).await.unwrap();
}

/// Processor seconds that this process has used.
pub fn processor_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap();
    let fields: Vec<&str> = stat[stat.rfind(')').unwrap() + 2..].split(' ').collect();
    // utime and stime, in ticks of 10 ms on every Linux that Rust runs on.
    (fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap()) / 100.0
}
