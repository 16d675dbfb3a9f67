//! Depth out and in over HTTP: where the cloud of a picture is, and what of it lies before a client's own objects.

mod common;

use common::{Answer, Server, cloudy_server};
use welkin_server::limits::Limits;

const SIZE: &str = "width=64&height=36";
const PIXELS: usize = 64 * 36;

async fn post(server: &Server, query: &str, media_type: &str, body: &[u8]) -> Answer {
    let path = format!("/v1/worlds/w1/frame?{query}");
    server
        .request("POST", &path, &format!("Content-Type: {media_type}\r\n"), body)
        .await
}

fn bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    let words = bytes.chunks_exact(4).map(|b| [b[0], b[1], b[2], b[3]]);
    words.map(f32::from_le_bytes).collect()
}

const OCTETS: &str = "application/octet-stream";

#[tokio::test]
async fn depth_says_where_the_cloud_is_and_objects_are_put_before_and_behind_it() {
    let server = cloudy_server(common::scene()).await;
    let raw = server.get(&format!("/v1/worlds/w1/depth?{SIZE}&format=f32")).await;
    assert_eq!((raw.status, raw.header("content-type")), (200, Some(OCTETS)));
    assert_eq!(raw.header("x-welkin-size"), Some("64x36"));
    let places: Vec<[f32; 2]> = floats(&raw.body).chunks(2).map(|p| [p[0], p[1]]).collect();
    assert_eq!(places.len(), PIXELS);
    assert!(places.iter().any(|p| p[1] > 0.3) && places.iter().any(|p| p[1] == 0.0));
    for [metres, opacity] in &places {
        assert_eq!(*opacity == 0.0, metres.is_infinite());
        assert!(*metres > 0.0 && (0.0..=1.0).contains(opacity), "{metres} {opacity}");
    }
    // The same as PNG: metres and shares of 65535.
    let coded = server.get(&format!("/v1/worlds/w1/depth?{SIZE}")).await;
    assert_eq!(coded.header("content-type"), Some("image/png"));
    let image = image::load_from_memory(&coded.body).unwrap();
    let image = image.as_luma_alpha16().expect("16-bit grey and alpha");
    for (pixel, [metres, opacity]) in image.pixels().zip(&places) {
        let [grey, alpha] = pixel.0;
        if *opacity == 0.0 {
            assert_eq!([grey, alpha], [65_535, 0]);
        } else {
            assert!((f32::from(grey) - metres).abs() <= 0.51 && (f32::from(alpha) - opacity * 65_535.0).abs() <= 0.51);
        }
    }

    // Objects nowhere: the picture itself.
    let plain = server.get(&format!("/v1/worlds/w1/frame?{SIZE}&format=png")).await;
    let plain = image::load_from_memory(&plain.body).unwrap().to_rgb8();
    let nowhere = post(&server, SIZE, OCTETS, &bytes(&[f32::INFINITY; PIXELS])).await;
    assert_eq!(
        (nowhere.status, nowhere.header("content-type")),
        (200, Some("image/png"))
    );
    let nowhere = image::load_from_memory(&nowhere.body).unwrap().to_rgba8();
    for (ours, theirs) in nowhere.pixels().zip(plain.pixels()) {
        assert_eq!((&ours.0[..3], ours.0[3]), (&theirs.0[..], 255));
    }
    // An object right before the camera: nothing lies before it, but where it would stand under the ground.
    let near = post(&server, &format!("{SIZE}&format=f32"), OCTETS, &bytes(&[0.5; PIXELS])).await;
    assert!(floats(&near.body).iter().all(|v| v.abs() < 1e-3));
    // One behind the cloud: as much of it is hidden as the cloud is opaque.
    let behind = post(
        &server,
        &format!("{SIZE}&format=f32"),
        OCTETS,
        &bytes(&[30_000.0; PIXELS]),
    )
    .await;
    let behind = floats(&behind.body);
    let mut seen = 0;
    for (layer, [_, opacity]) in behind.chunks(4).zip(&places).take(PIXELS / 2) {
        assert!((layer[3] - opacity).abs() < 1e-4, "{layer:?} {opacity}");
        seen += usize::from(*opacity > 0.3);
    }
    assert!(seen > 10, "{seen}");
}

#[tokio::test]
async fn distances_that_make_no_sense_are_refused() {
    let limits = Limits {
        object_pixels_max: 5_000,
        ..Limits::default()
    };
    let server = common::server(limits).await;
    let mut odd = [10.0f32; PIXELS];
    odd[7] = f32::NAN;
    let mut negative = [10.0f32; PIXELS];
    negative[9] = -0.1;
    for (query, media_type, body, status, code, pointer) in [
        (SIZE, OCTETS, bytes(&odd), 400, "bad_depth", Some("/7")),
        (SIZE, OCTETS, bytes(&negative), 400, "bad_depth", Some("/9")),
        (SIZE, OCTETS, bytes(&[1.0; PIXELS - 1]), 400, "bad_depth", None),
        (SIZE, OCTETS, bytes(&[1.0; PIXELS + 9]), 400, "bad_depth", None),
        (SIZE, OCTETS, Vec::new(), 400, "bad_depth", None),
        (
            SIZE,
            "image/png",
            bytes(&[1.0; PIXELS]),
            415,
            "unsupported_media_type",
            None,
        ),
        ("width=100&height=51", OCTETS, Vec::new(), 413, "body_too_large", None),
        (
            "width=64&height=0",
            OCTETS,
            Vec::new(),
            400,
            "out_of_range",
            Some("/height"),
        ),
        (
            "width=64&height=36&format=jpeg",
            OCTETS,
            Vec::new(),
            400,
            "bad_parameter",
            Some("/format"),
        ),
        (
            "quality=still",
            OCTETS,
            Vec::new(),
            400,
            "bad_parameter",
            Some("/quality"),
        ),
        (
            "tick=1&simulated_s=2",
            OCTETS,
            Vec::new(),
            400,
            "bad_parameter",
            Some("/simulated_s"),
        ),
    ] {
        let answer = post(&server, query, media_type, &body).await;
        answer.assert_refused(status, code, pointer);
    }
    for (query, code, pointer) in [
        ("format=jpeg", "bad_parameter", "/format"),
        ("width=99999", "out_of_range", "/width"),
        ("depth=1", "unknown_parameter", "/depth"),
    ] {
        let answer = server.get(&format!("/v1/worlds/w1/depth?{query}")).await;
        answer.assert_refused(400, code, Some(pointer));
    }
}
