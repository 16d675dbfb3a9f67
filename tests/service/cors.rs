//! What pages of other origins may read, by what a browser would be told.

mod common;

use common::{Answer, Server, server};
use welkin_server::limits::Limits;

const READER: &str = "https://dashboard.example";

async fn ask(server: &Server, method: &str, path: &str, origin: &str, more: &str) -> Answer {
    let headers = format!("Origin: {origin}\r\n{more}");
    server.request(method, path, &headers, b"").await
}

fn allowed(answer: &Answer) -> Option<&str> {
    answer.header("access-control-allow-origin")
}

#[tokio::test]
async fn nobody_else_reads_unless_told() {
    let server = server(Limits::default()).await;
    for path in [
        "/v1/worlds",
        "/v1/openapi.json",
        "/collections",
        "/v1/worlds/w1/volume.bin",
    ] {
        let answer = ask(&server, "GET", path, READER, "").await;
        assert_eq!((answer.status, allowed(&answer)), (200, None), "{path}");
    }
}

#[tokio::test]
async fn a_named_origin_reads_and_does_not_command() {
    let limits = Limits {
        cors_origins: vec![READER.to_owned()],
        ..Limits::default()
    };
    let server = server(limits).await;
    for path in [
        "/v1/worlds",
        "/v1/openapi.json",
        "/v1/worlds/w1/frame?width=32&height=18",
        "/v1/worlds/w1/volume.bin?mip=2",
        "/v1/worlds/w1/past",
        "/v1/worlds/w1/sample?x_m=1&y_m=1&z_m=1",
        "/collections",
        "/conformance",
        "/collections/w1/position?coords=POINT(10%2045)",
    ] {
        let answer = ask(&server, "GET", path, READER, "").await;
        assert_eq!((answer.status, allowed(&answer)), (200, Some(READER)), "{path}");
        assert!(answer.header("access-control-allow-credentials").is_none(), "{path}");
        let other = ask(&server, "GET", path, "https://elsewhere.example", "").await;
        assert_eq!(allowed(&other), None, "{path}");
        // What is kept on the way for one origin must not be given to another.
        assert!(
            other
                .header("vary")
                .is_some_and(|v| v.to_lowercase().contains("origin")),
            "{path}"
        );
    }
    let picture = ask(&server, "GET", "/v1/worlds/w1/frame?width=32&height=18", READER, "").await;
    let exposed = picture.header("access-control-expose-headers").unwrap_or_default();
    assert!(
        exposed.contains("x-welkin-tick") && exposed.contains("etag"),
        "{exposed}"
    );

    // Errors are read too: a dashboard must be able to say what was wrong.
    let wrong = ask(&server, "GET", "/v1/worlds/w9/sample", READER, "").await;
    assert_eq!((wrong.status, allowed(&wrong)), (404, Some(READER)));

    for (method, path, leave) in [
        ("POST", "/v1/worlds/w1/sample", Some(READER)),
        ("GET", "/v1/worlds/w1", Some(READER)),
        ("POST", "/v1/worlds/w1/commands", None),
        ("POST", "/v1/worlds", None),
        ("POST", "/v1/render", None),
        ("DELETE", "/v1/worlds/w1", None),
        ("PUT", "/v1/worlds/w1/sample", None),
        ("\u{7f}", "/v1/worlds/w1", None),
    ] {
        let more = format!("Access-Control-Request-Method: {method}\r\n");
        let answer = ask(&server, "OPTIONS", path, READER, &more).await;
        assert_eq!(allowed(&answer), leave, "{method} {path}");
    }
    let upgrade = "Connection: close, Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    let refused = ask(&server, "GET", "/v1/worlds/w1/stream", READER, upgrade).await;
    refused.assert_refused(403, "foreign_origin", None);
    let stranger = ask(
        &server,
        "GET",
        "/v1/worlds/w1/volume",
        "https://elsewhere.example",
        upgrade,
    )
    .await;
    stranger.assert_refused(403, "foreign_origin", None);
    for route in ["volume", "samples"] {
        let url = format!("ws://{}/v1/worlds/w1/{route}", server.address);
        let mut request = tokio_tungstenite::tungstenite::client::IntoClientRequest::into_client_request(url).unwrap();
        request.headers_mut().insert("origin", READER.parse().unwrap());
        let (mut socket, _) = tokio_tungstenite::connect_async(request).await.unwrap();
        assert_eq!(common::next_json(&mut socket).await["type"], "hello");
    }
}
