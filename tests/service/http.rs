//! Every route of a real server, in use and in abuse.

mod common;

use common::{Server, empty_server, scene, server};
use serde_json::{Value, json};
use welkin_server::limits::Limits;

const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";

#[tokio::test]
async fn page_and_its_files_come_with_types_and_a_policy() {
    let server = empty_server(Limits::default()).await;
    let page = server.get("/").await;
    assert_eq!(page.status, 200);
    assert_eq!(page.header("content-type"), Some("text/html; charset=utf-8"));
    let policy = page.header("content-security-policy").unwrap();
    assert!(
        policy.contains("script-src 'self'") && !policy.contains("unsafe-eval"),
        "{policy}"
    );
    let html = String::from_utf8(page.body).unwrap();
    // Every file that the page names, and every module that those import, is served.
    let mut wanted: Vec<String> = html
        .split('"')
        .filter(|part| part.starts_with("/web/"))
        .map(str::to_owned)
        .collect();
    assert!(wanted.len() >= 2, "the page names a style and a script: {wanted:?}");
    let mut seen = 0;
    while seen < wanted.len() {
        let path = wanted[seen].clone();
        seen += 1;
        let file = server.get(&path).await;
        assert_eq!(file.status, 200, "{path}");
        let media_type = file.header("content-type").unwrap();
        assert!(
            media_type.starts_with(if path.ends_with(".css") {
                "text/css"
            } else {
                "text/javascript"
            }),
            "{path}: {media_type}"
        );
        assert_eq!(file.header("x-content-type-options"), Some("nosniff"));
        let text = String::from_utf8(file.body).unwrap();
        let imports = text
            .lines()
            .filter(|line| line.starts_with("import "))
            .filter_map(|line| line.split("\"./").nth(1));
        for import in imports {
            let path = format!("/web/{}", import.split('"').next().unwrap());
            if !wanted.contains(&path) {
                wanted.push(path);
            }
        }
    }
    server
        .get("/web/../Cargo.toml")
        .await
        .assert_refused(404, "not_found", None);
    server.get("/web/none.js").await.assert_refused(404, "not_found", None);
}

#[tokio::test]
async fn health_lists_worlds_that_tick() {
    let server = server(Limits::default()).await;
    let first = server.get("/healthz").await;
    assert_eq!(first.status, 200);
    let first = first.json();
    assert_eq!(first["status"], "ok");
    assert_eq!(first["worlds"][0]["id"], "w1");
    assert_eq!(first["worlds"][0]["running"], true);
    assert!(!first["devices"][0].as_str().unwrap().is_empty());
    wait_for(&server, "/healthz", |health| {
        health["worlds"][0]["tick"].as_u64() > first["worlds"][0]["tick"].as_u64()
    })
    .await;
}

#[tokio::test]
async fn scenes_are_listed_and_each_can_be_posted_back() {
    let server = empty_server(Limits::default()).await;
    let list = server.get("/v1/scenes").await.json();
    let names: Vec<&str> = list
        .as_array()
        .unwrap()
        .iter()
        .map(|s| s["name"].as_str().unwrap())
        .collect();
    assert!(names.len() >= 4, "{names:?}");
    for name in names {
        let scene = server.get(&format!("/v1/scenes/{name}")).await;
        assert_eq!(scene.status, 200, "{name}");
        let text = String::from_utf8(scene.body).unwrap();
        welkin_proto::validate::parse_scene(&text, &Limits::default().scene()).unwrap();
    }
    server
        .get("/v1/scenes/none")
        .await
        .assert_refused(404, "unknown_scene", None);
    let schema = server.get("/v1/schema/scene").await;
    assert_eq!(schema.header("content-type"), Some("application/schema+json"));
    assert!(schema.json()["properties"]["domain"].is_object());
}

#[tokio::test]
async fn a_world_is_made_looked_at_commanded_and_stopped() {
    let server = empty_server(Limits::default()).await;
    assert_eq!(server.get("/v1/worlds").await.json(), json!([]));
    let made = server.post("/v1/worlds", &json!({ "scene": scene() })).await;
    assert_eq!(made.status, 201, "{:?}", String::from_utf8_lossy(&made.body));
    let path = made.header("location").unwrap().to_owned();
    let id = made.json()["id"].as_str().unwrap().to_owned();
    assert_eq!(path, format!("/v1/worlds/{id}"));
    assert_eq!(server.get("/v1/worlds").await.json()[0]["id"], id.as_str());

    let state = server.get(&path).await.json();
    assert_eq!(state["scene"]["name"], "small");
    assert_eq!(state["base_state"]["surface_pressure_pa"], 100000.0);
    assert_eq!(
        server.get(&format!("{path}/frame?width=16&height=16")).await.status,
        200
    );
    let plan = server.get(&format!("{path}/plan")).await.json();
    let march = plan["passes"]
        .as_array()
        .unwrap()
        .iter()
        .find(|p| p["stage"] == "march")
        .unwrap();
    assert!(
        march["runs"] == 1 && march["mean_ms"].as_f64().unwrap() > 0.0,
        "{march}"
    );
    assert!(!plan["passes"].as_array().unwrap().is_empty(), "{plan}");
    let sum: u64 = plan["fields"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| f["bytes"].as_u64().unwrap())
        .sum();
    assert_eq!(plan["bytes"].as_u64(), Some(sum));

    let commands = format!("{path}/commands");
    for odd in [json!({ "command": "pause", "x": 1 }), json!({ "command": "fly" })] {
        assert_eq!(server.post(&commands, &odd).await.status, 400, "{odd}");
    }
    assert_eq!(server.post(&commands, &json!({ "command": "pause" })).await.status, 202);
    let paused = wait_for(&server, &path, |state| state["numbers"]["paused"] == true).await;
    let tick = paused["numbers"]["tick"].clone();
    // The sun moves in a world that stands.
    let sun = json!({ "command": "sun", "sun": { "from": "fixed", "elevation_deg": 12.0, "azimuth_deg": 90.0 } });
    assert_eq!(server.post(&commands, &sun).await.status, 202);
    let sunny = wait_for(&server, &path, |state| {
        state["numbers"]["sun_elevation_deg"]
            .as_f64()
            .is_some_and(|e| (e - 12.0).abs() < 1e-6)
    });
    assert_eq!(sunny.await["numbers"]["tick"], tick, "a paused world does not tick");
    let before_m_s = paused["numbers"]["wind_max_m_s"].as_f64().unwrap();
    assert_eq!(
        server
            .post(
                &commands,
                &json!({ "command": "wind", "add_x_m_s": 7.0, "add_y_m_s": 0.0 })
            )
            .await
            .status,
        202
    );
    assert_eq!(
        server
            .post(&commands, &json!({ "command": "time_scale", "time_scale": 50.0 }))
            .await
            .status,
        202
    );
    assert_eq!(
        server.post(&commands, &json!({ "command": "resume" })).await.status,
        202
    );
    let on = wait_for(&server, &path, |state| {
        state["numbers"]["tick"].as_u64() > tick.as_u64()
    })
    .await;
    assert_eq!(on["numbers"]["time_scale"], 50.0);
    let gust_m_s = on["numbers"]["wind_max_m_s"].as_f64().unwrap() - before_m_s;
    assert!(
        (4.0..10.0).contains(&gust_m_s),
        "the wind rose by {gust_m_s} m/s where 7 were added"
    );

    assert_eq!(server.delete(&path).await.status, 204);
    server.get(&path).await.assert_refused(404, "unknown_world", None);
    server.delete(&path).await.assert_refused(404, "unknown_world", None);
    let next = server.post("/v1/worlds", &json!({ "scene": scene() })).await.json();
    assert_ne!(next["id"], id.as_str(), "an id is never used twice");
}

#[tokio::test]
async fn effects_are_switched_while_a_world_runs() {
    let server = empty_server(Limits::default()).await;
    let made = server.post("/v1/worlds", &json!({ "scene": scene() })).await;
    let path = made.header("location").unwrap().to_owned();
    let commands = format!("{path}/commands");
    let state = server.get(&path).await.json();
    let mut effects = state["scene"]["effects"].clone();
    let stages = |plan: &Value| {
        let passes = plan["passes"].as_array().unwrap();
        passes
            .iter()
            .map(|p| p["stage"].as_str().unwrap().to_owned())
            .collect::<Vec<_>>()
    };
    let before = stages(&server.get(&format!("{path}/plan")).await.json());
    assert!(before.iter().all(|s| s != "sponge"), "{before:?}");

    // Judged at once, by the world's own scene.
    effects["sponge"] = json!({ "depth_m": -1.0, "rate_per_s": 0.01 });
    let refused = server
        .post(&commands, &json!({ "command": "effects", "effects": effects }))
        .await;
    assert_eq!(refused.status, 400);
    assert_eq!(refused.json()["code"], "out_of_range");
    assert_eq!(refused.json()["pointer"], "/effects/sponge/depth_m");

    effects["sponge"] = json!({ "depth_m": 100.0, "rate_per_s": 0.01 });
    let taken = server
        .post(&commands, &json!({ "command": "effects", "effects": effects }))
        .await;
    assert_eq!(taken.status, 202, "{:?}", String::from_utf8_lossy(&taken.body));
    let changed = wait_for(&server, &path, |state| !state["scene"]["effects"]["sponge"].is_null()).await;
    assert!(changed["numbers"]["tick"].as_u64() >= state["numbers"]["tick"].as_u64());
    let after = stages(&server.get(&format!("{path}/plan")).await.json());
    assert!(after.iter().any(|s| s == "sponge"), "{after:?}");
    assert_eq!(
        server.get(&format!("{path}/frame?width=16&height=16")).await.status,
        200
    );
}

#[tokio::test]
async fn worlds_are_limited_in_number() {
    let server = server(Limits {
        worlds_max: 2,
        ..Limits::default()
    })
    .await;
    let body = json!({ "scene": scene() });
    assert_eq!(server.post("/v1/worlds", &body).await.status, 201);
    server
        .post("/v1/worlds", &body)
        .await
        .assert_refused(429, "too_many_worlds", None);
    assert_eq!(server.delete("/v1/worlds/w2").await.status, 204);
    assert_eq!(server.post("/v1/worlds", &body).await.status, 201);
}

#[tokio::test]
async fn a_visitors_world_stops_when_nobody_looks_and_the_servers_own_stays() {
    let server = server(Limits {
        idle_world_s: 1.5,
        ..Limits::default()
    })
    .await;
    let body = json!({ "scene": scene() });
    for path in ["/v1/worlds/w2", "/v1/worlds/w3"] {
        let made = server.post("/v1/worlds", &body).await;
        assert_eq!(made.header("location"), Some(path));
    }
    // A stream looks on; a listing does not, and asking for the world itself would count as looking.
    let socket = server.stream("w3").await;
    let ids = async || {
        let list = server.get("/v1/worlds").await.json();
        let ids = list.as_array().unwrap().iter();
        ids.map(|w| w["id"].as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    let until = async |wanted: &[&str]| {
        let began = std::time::Instant::now();
        while ids().await != wanted {
            assert!(began.elapsed() < common::PATIENCE, "{:?}, not {wanted:?}", ids().await);
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        }
        began.elapsed()
    };
    until(&["w1", "w3"]).await;
    tokio::time::sleep(std::time::Duration::from_secs(2)).await;
    assert_eq!(ids().await, ["w1", "w3"]);
    drop(socket);
    let gone = until(&["w1"]).await;
    assert!(
        gone.as_secs_f64() > 1.0,
        "it stopped after {gone:?}, its viewer had just left"
    );
    server
        .get("/v1/worlds/w3")
        .await
        .assert_refused(404, "unknown_world", None);
    assert_eq!(server.get("/v1/worlds/w1").await.status, 200);
}

#[tokio::test]
async fn bad_scenes_are_refused_with_their_place() {
    let server = empty_server(Limits {
        cells_max: 100_000,
        ..Limits::default()
    })
    .await;
    let changed = |pointer: &str, value: Value| {
        let mut body = json!({ "scene": scene() });
        *body.pointer_mut(pointer).unwrap() = value;
        body
    };
    for (pointer, value) in [
        ("/scene/domain/cell_size_m/1", json!(0.0)),
        ("/scene/domain/cell_size_m/2", json!(-40.0)),
        ("/scene/time/tick_s", json!(0.0)),
        ("/scene/camera/elevation_deg", json!(91.0)),
    ] {
        let answer = server.post("/v1/worlds", &changed(pointer, value)).await;
        answer.assert_refused(400, "out_of_range", Some(pointer));
    }
    for cells in [
        json!([0, 16, 16]),
        json!([4_000_000_000u32, 4_000_000_000u32, 4_000_000_000u32]),
        json!([64, 64, 64]),
    ] {
        let answer = server.post("/v1/worlds", &changed("/scene/domain/cells", cells)).await;
        let pointer = answer.json()["pointer"].as_str().unwrap().to_owned();
        assert!(
            answer.status == 400 && pointer.starts_with("/scene/domain/cells"),
            "{} {pointer}",
            answer.status
        );
    }
    // JSON has no NaN: as a word, as null and as a number beyond all bounds.
    for text in ["NaN", "null", "1e999"] {
        let body = changed("/scene/time/tick_s", json!(123456.0))
            .to_string()
            .replace("123456.0", text);
        let answer = server
            .request(
                "POST",
                "/v1/worlds",
                "Content-Type: application/json\r\n",
                body.as_bytes(),
            )
            .await;
        assert_eq!(answer.status, 400, "{text}: {}", answer.json());
    }
    server
        .post("/v1/worlds", &json!({}))
        .await
        .assert_refused(400, "bad_body", Some(""));
    server
        .post("/v1/worlds", &json!([]))
        .await
        .assert_refused(400, "bad_body", Some(""));
    let both = json!({ "preset": "warm-bubble", "scene": scene() });
    server
        .post("/v1/worlds", &both)
        .await
        .assert_refused(400, "bad_body", Some(""));
    server
        .post("/v1/worlds", &json!({ "preset": 3 }))
        .await
        .assert_refused(400, "bad_body", Some("/preset"));
    server
        .post("/v1/worlds", &json!({ "preset": "none" }))
        .await
        .assert_refused(400, "unknown_preset", Some("/preset"));
    let more = json!({ "preset": "warm-bubble", "colour": "blue" });
    server
        .post("/v1/worlds", &more)
        .await
        .assert_refused(400, "bad_body", None);
    assert_eq!(server.get("/v1/worlds").await.json(), json!([]), "nothing was started");
}

#[tokio::test]
async fn frames_come_in_every_format_and_size() {
    let server = server(Limits::default()).await;
    let frame = "/v1/worlds/w1/frame";
    let starts: [(&str, &str, &[u8]); 3] = [
        ("jpeg", "image/jpeg", b"\xff\xd8\xff"),
        ("png", "image/png", PNG),
        ("webp", "image/webp", b"RIFF"),
    ];
    for (format, media_type, start) in starts {
        let answer = server.get(&format!("{frame}?format={format}&width=48&height=32")).await;
        assert_eq!((answer.status, answer.header("content-type")), (200, Some(media_type)));
        assert!(answer.body.starts_with(start), "{format}");
        assert!(answer.header("x-welkin-tick").unwrap().parse::<u64>().is_ok());
        let timing = answer.header("server-timing").unwrap();
        assert!(
            timing.contains("render;dur=") && timing.contains("encode;dur="),
            "{timing}"
        );
    }
    let answer = server.get(&format!("{frame}?format=png&width=50&height=20")).await;
    let image = image::load_from_memory(&answer.body).unwrap().to_rgb8();
    assert_eq!(image.dimensions(), (50, 20));
    let down = server
        .get(&format!(
            "{frame}?format=png&width=50&height=20&elevation_deg=-90&z_m=900"
        ))
        .await;
    let down = image::load_from_memory(&down.body).unwrap().to_rgb8();
    assert_ne!(image, down, "the camera is heeded");
    let default = server.get(&format!("{frame}?format=png")).await;
    let default = image::load_from_memory(&default.body).unwrap();
    assert_eq!((default.width(), default.height()), (640, 360));
}

#[tokio::test]
async fn frame_requests_out_of_bounds_are_refused_with_their_parameter() {
    let server = server(Limits::default()).await;
    for (query, code, pointer) in [
        ("width=0&height=0", "out_of_range", "/width"),
        ("width=10&height=0", "out_of_range", "/height"),
        ("width=100000&height=100000", "out_of_range", "/width"),
        ("width=3840&height=2161", "out_of_range", "/height"),
        ("width=-1", "out_of_range", "/width"),
        ("width=99999999999999999999", "out_of_range", "/width"),
        ("width=wide", "bad_parameter", "/width"),
        ("width=1.5", "bad_parameter", "/width"),
        ("format=gif", "bad_parameter", "/format"),
        ("x_m=NaN", "bad_parameter", "/x_m"),
        ("y_m=inf", "bad_parameter", "/y_m"),
        ("z_m=1e30", "out_of_range", "/z_m"),
        ("elevation_deg=91", "out_of_range", "/elevation_deg"),
        ("vertical_fov_deg=0", "out_of_range", "/vertical_fov_deg"),
        ("exposure_ev=1000", "out_of_range", "/exposure_ev"),
        ("colour=blue", "unknown_parameter", "/colour"),
    ] {
        server
            .get(&format!("/v1/worlds/w1/frame?{query}"))
            .await
            .assert_refused(400, code, Some(pointer));
    }
    server
        .get("/v1/worlds/none/frame")
        .await
        .assert_refused(404, "unknown_world", None);
    server
        .get("/v1/worlds/w01/frame")
        .await
        .assert_refused(404, "unknown_world", None);
}

#[tokio::test]
async fn a_frame_that_the_client_has_is_not_sent_again() {
    let server = server(Limits::default()).await;
    server
        .post("/v1/worlds/w1/commands", &json!({ "command": "pause" }))
        .await;
    wait_for(&server, "/v1/worlds/w1", |state| state["numbers"]["paused"] == true).await;
    let path = "/v1/worlds/w1/frame?width=32&height=32&format=png";
    let first = server.get(path).await;
    let tag = first.header("etag").unwrap().to_owned();
    let again = server
        .request("GET", path, &format!("If-None-Match: \"other\", {tag}\r\n"), b"")
        .await;
    assert_eq!(
        (again.status, again.body.len(), again.header("etag")),
        (304, 0, Some(tag.as_str()))
    );
    let other = server
        .request(
            "GET",
            &format!("{path}&azimuth_deg=90"),
            &format!("If-None-Match: {tag}\r\n"),
            b"",
        )
        .await;
    assert_eq!(other.status, 200, "another view is another frame");
    // The sun moves while the tick stands: another picture, so another tag.
    let sun = json!({ "command": "sun", "sun": { "from": "fixed", "elevation_deg": 5.0, "azimuth_deg": 250.0 } });
    server.post("/v1/worlds/w1/commands", &sun).await;
    wait_for(&server, "/v1/worlds/w1", |s| {
        s["numbers"]["sun_elevation_deg"]
            .as_f64()
            .is_some_and(|e| (e - 5.0).abs() < 1e-6)
    })
    .await;
    let moved = server
        .request("GET", path, &format!("If-None-Match: {tag}\r\n"), b"")
        .await;
    assert_eq!(moved.status, 200);
    assert_eq!(moved.header("x-welkin-tick"), first.header("x-welkin-tick"));
    assert_ne!(moved.body, first.body);
}

#[tokio::test]
async fn bad_commands_are_refused() {
    let server = server(Limits::default()).await;
    let path = "/v1/worlds/w1/commands";
    for (body, code, pointer) in [
        (
            json!({ "command": "time_scale", "time_scale": 0.0 }),
            "out_of_range",
            Some("/time_scale"),
        ),
        (
            json!({ "command": "time_scale", "time_scale": 1e9 }),
            "out_of_range",
            Some("/time_scale"),
        ),
        (
            json!({ "command": "wind", "add_x_m_s": 1e6, "add_y_m_s": 0.0 }),
            "out_of_range",
            Some("/add_x_m_s"),
        ),
        (json!({ "command": "explode" }), "bad_body", None),
        (json!("pause"), "bad_body", None),
    ] {
        server.post(path, &body).await.assert_refused(400, code, pointer);
    }
    let sun = json!({ "command": "sun", "sun": { "from": "fixed", "elevation_deg": 95.0, "azimuth_deg": 0.0 } });
    server
        .post(path, &sun)
        .await
        .assert_refused(400, "out_of_range", Some("/sun/elevation_deg"));
    server
        .post("/v1/worlds/none/commands", &json!({ "command": "pause" }))
        .await
        .assert_refused(404, "unknown_world", None);
}

#[tokio::test]
async fn a_scene_of_ones_own_is_rendered() {
    let server = empty_server(Limits::default()).await;
    let body = json!({ "scene": scene(), "simulated_s": 5.0, "width": 40, "height": 30, "format": "png" });
    let answer = server.post("/v1/render", &body).await;
    assert_eq!(answer.status, 200, "{:?}", String::from_utf8_lossy(&answer.body));
    let image = image::load_from_memory(&answer.body).unwrap();
    assert_eq!((image.width(), image.height()), (40, 30));
    assert!(answer.header("x-welkin-simulated-s").unwrap().parse::<f64>().unwrap() >= 5.0);
    assert!(answer.header("x-welkin-simulate-ms").is_some());

    let changed = |name: &str, value: Value| {
        let mut body = body.clone();
        body[name] = value;
        body
    };
    server
        .post("/v1/render", &changed("width", json!(0)))
        .await
        .assert_refused(400, "out_of_range", Some("/width"));
    server
        .post("/v1/render", &changed("height", json!(100000)))
        .await
        .assert_refused(400, "out_of_range", Some("/height"));
    server
        .post("/v1/render", &changed("simulated_s", json!(-1.0)))
        .await
        .assert_refused(400, "out_of_range", Some("/simulated_s"));
    server
        .post("/v1/render", &changed("format", json!("gif")))
        .await
        .assert_refused(400, "bad_body", None);
    let camera = json!({ "position_m": [0, 0, 0], "azimuth_deg": 0, "elevation_deg": 200, "vertical_fov_deg": 50 });
    server
        .post("/v1/render", &changed("camera", camera))
        .await
        .assert_refused(400, "out_of_range", Some("/camera/elevation_deg"));
}

#[tokio::test]
async fn a_render_that_takes_too_long_is_given_up_and_one_too_many_is_refused() {
    let limits = Limits {
        render_time_max_s: 1.5,
        renders_max: 1,
        ..Limits::default()
    };
    let server = empty_server(limits).await;
    let long = json!({ "scene": scene(), "simulated_s": 86000.0, "width": 16, "height": 16 });
    let short = json!({ "scene": scene(), "simulated_s": 0.0, "width": 16, "height": 16 });
    let (first, second) = tokio::join!(server.post("/v1/render", &long), async {
        tokio::time::sleep(std::time::Duration::from_millis(400)).await;
        server.post("/v1/render", &short).await
    });
    first.assert_refused(503, "render_too_long", None);
    second.assert_refused(429, "busy", None);
    assert_eq!(
        server.post("/v1/render", &short).await.status,
        200,
        "its place is free again"
    );
}

#[tokio::test]
async fn requests_that_are_no_requests_get_an_error_of_ours() {
    let server = server(Limits {
        body_bytes_max: 20_000,
        ..Limits::default()
    })
    .await;
    server.get("/nothing").await.assert_refused(404, "not_found", None);
    server
        .get("/v1/worlds/%ff%fe")
        .await
        .assert_refused(404, "not_found", None);
    server
        .delete("/v1/scenes")
        .await
        .assert_refused(405, "method_not_allowed", None);
    server
        .get("/v1/render")
        .await
        .assert_refused(405, "method_not_allowed", None);
    let json_type = "Content-Type: application/json\r\n";
    server
        .request("POST", "/v1/worlds", "", b"{}")
        .await
        .assert_refused(415, "unsupported_media_type", None);
    server
        .request("POST", "/v1/worlds", "Content-Type: text/plain\r\n", b"{}")
        .await
        .assert_refused(415, "unsupported_media_type", None);
    server
        .request("POST", "/v1/worlds", json_type, b"{\"preset\": ")
        .await
        .assert_refused(400, "bad_json", None);
    server
        .request("POST", "/v1/worlds", json_type, b"\xff\xfe\x00")
        .await
        .assert_refused(400, "bad_json", None);
    server
        .request("POST", "/v1/worlds", json_type, b"")
        .await
        .assert_refused(400, "bad_json", None);
    let deep = "[".repeat(10_000);
    server
        .request("POST", "/v1/worlds", json_type, deep.as_bytes())
        .await
        .assert_refused(400, "bad_json", None);
    let large = vec![b' '; 30_000];
    server
        .request("POST", "/v1/worlds", json_type, &large)
        .await
        .assert_refused(413, "body_too_large", None);
    server
        .get("/v1/worlds/w1/stream")
        .await
        .assert_refused(426, "upgrade_required", None);
    assert_eq!(server.get("/healthz").await.json()["status"], "ok");
}

/// Asks again and again until the answer is as wanted.
async fn wait_for(server: &Server, path: &str, wanted: impl Fn(&Value) -> bool) -> Value {
    let began = std::time::Instant::now();
    loop {
        let answer = server.get(path).await.json();
        if wanted(&answer) {
            return answer;
        }
        assert!(began.elapsed() < common::PATIENCE, "it never came: {answer}");
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
}
