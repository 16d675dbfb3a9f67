//! Samples over HTTP and WebSocket against a real server: answers, moments, moving places, and whatever a stranger may send.

mod common;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use common::{PATIENCE, Server, Socket, next, next_of, processor_s, say, server};
use futures_util::SinkExt;
use serde_json::{Value, json};
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::Message;
use welkin_proto::Channel;
use welkin_proto::sample::{Places, PositionsMessage, Quantity, SamplesMessage};
use welkin_server::limits::Limits;

const SAMPLE: &str = "/v1/worlds/w1/sample";

async fn pause(server: &Server) {
    let paused = server
        .post("/v1/worlds/w1/commands", &json!({ "command": "pause" }))
        .await;
    assert_eq!(paused.status / 100, 2);
    let still = async {
        while server.get("/v1/worlds/w1").await.json()["numbers"]["paused"] != true {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    timeout(PATIENCE, still).await.expect("the world pauses");
}

#[tokio::test(flavor = "multi_thread")]
async fn one_place_in_metres_and_in_degrees_is_the_same_place() {
    let server = server(Limits::default()).await;
    pause(&server).await;
    let local = server.get(&format!("{SAMPLE}?x_m=1600&y_m=1600&z_m=900")).await;
    assert_eq!(local.status, 200, "{:?}", local.json());
    let local = local.json();
    // The middle of the box stands where the scene says.
    let degrees = server.get(&format!("{SAMPLE}?lat=45&lon=10&alt=900")).await.json();
    assert_eq!(local, degrees);
    assert_eq!(local["position_lat_lon_alt"], json!([45.0, 10.0, 900.0]));
    let values = &local["values"];
    let number = |name: &str| values[name].as_f64().unwrap_or_else(|| panic!("{name}: {local}"));
    let (u, v) = (number("wind_x_m_s"), number("wind_y_m_s"));
    assert!((number("wind_speed_m_s") - u.hypot(v)).abs() < 1e-5);
    assert!(
        (number("wind_from_deg") - 270.0).abs() < 60.0,
        "5 m/s from the west and a bubble"
    );
    assert!((285.0..296.0).contains(&number("temperature_k")));
    assert!((88_000.0..92_000.0).contains(&number("pressure_pa")));
    assert!((0.5..1.01).contains(&number("relative_humidity")));
    assert_eq!(local["units"]["wind_from_deg"], "deg");
    // What the scene lacks and what no scene has is not made up, and the reason is said.
    assert!(values.get("eddy_dissipation_rate_m23_s").is_none() && values.get("rain_rate_mm_h").is_none());
    for (name, why) in [
        ("eddy_dissipation_rate_m23_s", "turbulence"),
        ("rain_rate_mm_h", "rain"),
        ("ice_water_kg_kg", "ice"),
    ] {
        assert!(local["unavailable"][name].as_str().unwrap().contains(why), "{local}");
    }
    assert!(local["tick"].is_u64() && local["utc"].as_str().unwrap().starts_with("2026-06-21T11:"));
    let wall_s = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .unwrap()
        .as_secs_f64();
    assert!((wall_s - local["wall_unix_s"].as_f64().unwrap()).abs() < 30.0);
    // A box further east and two further south is the same air; only what was asked for is answered.
    let beside = server
        .get(&format!(
            "{SAMPLE}?x_m=4800&y_m=-4800&z_m=900&channels=temperature_k,wind_speed_m_s"
        ))
        .await
        .json();
    let asked: BTreeMap<String, Value> = serde_json::from_value(beside["values"].clone()).unwrap();
    assert_eq!(asked.keys().collect::<Vec<_>>(), ["temperature_k", "wind_speed_m_s"]);
    assert_eq!(asked["temperature_k"], values["temperature_k"]);
    assert_eq!(beside["unavailable"], json!({}));
}

#[tokio::test(flavor = "multi_thread")]
async fn many_places_and_paths_agree_with_single_places() {
    let server = server(Limits::default()).await;
    pause(&server).await;
    let positions = [
        [0.0, 0.0, 0.0],
        [1600.0, 1500.0, 800.0],
        [100.0, 100.0, -5.0],
        [3200.0, 10.0, 2400.0],
        [0.0, 0.0, 2400.5],
    ];
    let answer = server.post(SAMPLE, &json!({ "positions_m": positions })).await;
    assert_eq!(answer.status, 200, "{:?}", answer.json());
    let many = answer.json();
    assert_eq!(many["outside"], json!([2, 4]));
    for (i, p) in positions.iter().enumerate() {
        let one = server
            .get(&format!("{SAMPLE}?x_m={}&y_m={}&z_m={}", p[0], p[1], p[2]))
            .await;
        if [2, 4].contains(&i) {
            one.assert_refused(400, "outside_domain", None);
            assert!(
                many["values"]
                    .as_object()
                    .unwrap()
                    .values()
                    .all(|column| column[i].is_null())
            );
            continue;
        }
        let one = one.json();
        for (name, value) in one["values"].as_object().unwrap() {
            assert_eq!(many["values"][name][i], *value, "{name} at {p:?}");
        }
    }
    let corners = [[0.0, 0.0, 500.0], [300.0, 0.0, 500.0], [300.0, 400.0, 500.0]];
    let path = json!({ "positions_m": corners, "step_m": 250.0, "channels": ["wind_x_m_s"] });
    let path = server.post(SAMPLE, &path).await.json();
    assert_eq!(path["distance_m"], json!([0.0, 250.0, 500.0, 700.0]));
    let again = json!({ "positions_m": path["positions_m"], "channels": ["wind_x_m_s"] });
    assert_eq!(server.post(SAMPLE, &again).await.json()["values"], path["values"]);
    assert!(
        path["values"]["wind_x_m_s"]
            .as_array()
            .unwrap()
            .iter()
            .all(Value::is_f64)
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn the_last_seconds_are_kept_while_somebody_asks() {
    let server = server(Limits::default()).await;
    let place = "x_m=1600&y_m=1600&z_m=700&channels=wind_z_m_s";
    let first = server.get(&format!("{SAMPLE}?{place}")).await.json();
    tokio::time::sleep(Duration::from_millis(700)).await;
    pause(&server).await;
    let last = server.get(&format!("{SAMPLE}?{place}")).await.json();
    let (t0, t1) = (first["tick"].as_u64().unwrap(), last["tick"].as_u64().unwrap());
    assert!(t1 >= t0 + 2, "{t0} {t1}");
    // The first is still there, unchanged; half-way between two ticks is their mean.
    let then = server.get(&format!("{SAMPLE}?{place}&tick={t0}")).await.json();
    assert_eq!(then, first);
    let at = async |query: String| {
        let answer = server.get(&format!("{SAMPLE}?{place}&{query}")).await.json();
        answer["values"]["wind_z_m_s"]
            .as_f64()
            .unwrap_or_else(|| panic!("{answer}"))
    };
    let [s0, s1] = [
        first["simulated_s"].as_f64().unwrap(),
        last["simulated_s"].as_f64().unwrap(),
    ];
    let a = at(format!("simulated_s={s0}")).await;
    let b = at(format!("simulated_s={}", s0 + 1.0)).await;
    let between = at(format!("simulated_s={}", s0 + 0.25)).await;
    assert!(
        (between - (a + 0.25 * (b - a))).abs() < 1e-6 && a != b,
        "{a} {between} {b}"
    );
    for (query, status, code, pointer) in [
        (format!("tick={}", t1 + 1), 404, "not_yet", "/tick"),
        (format!("simulated_s={}", s1 + 0.5), 404, "not_yet", "/simulated_s"),
        ("simulated_s=-1".to_owned(), 410, "too_old", "/simulated_s"),
    ] {
        let refused = server.get(&format!("{SAMPLE}?{place}&{query}")).await;
        refused.assert_refused(status, code, Some(pointer));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_questions_are_refused_by_name() {
    let limits = Limits {
        sample_points_max: 100,
        ..Limits::default()
    };
    let server = server(limits).await;
    let gets: [(&str, u16, &str, Option<&str>); 24] = [
        ("", 400, "no_positions", None),
        ("lat=45", 400, "bad_parameter", Some("/lon")),
        ("lat=45&lon=10", 400, "bad_parameter", Some("/alt")),
        ("x_m=1&z_m=1", 400, "bad_parameter", Some("/y_m")),
        ("lat=45&lon=10&alt=5&z_m=1", 400, "mixed_coordinates", None),
        ("lat=45&y_m=10&alt=5", 400, "mixed_coordinates", None),
        ("x_m=NaN&y_m=1&z_m=1", 400, "bad_parameter", Some("/x_m")),
        ("x_m=inf&y_m=1&z_m=1", 400, "bad_parameter", Some("/x_m")),
        ("x_m=1e999&y_m=1&z_m=1", 400, "bad_parameter", Some("/x_m")),
        ("x_m=&y_m=1&z_m=1", 400, "bad_parameter", Some("/x_m")),
        ("x_m=1e7&y_m=1&z_m=1", 400, "out_of_range", Some("/x_m")),
        ("lat=91&lon=10&alt=5", 400, "out_of_range", Some("/lat")),
        ("lat=35.6&lon=139.7&alt=5", 400, "outside_domain", Some("/lat")),
        ("lat=45&lon=10&alt=-1", 400, "outside_domain", None),
        ("lat=45&lon=10&alt=2401", 400, "outside_domain", None),
        (
            "x_m=1&y_m=1&z_m=1&channels=",
            400,
            "unknown_channel",
            Some("/channels/0"),
        ),
        (
            "x_m=1&y_m=1&z_m=1&channels=temperature_k,sunshine",
            400,
            "unknown_channel",
            Some("/channels/1"),
        ),
        (
            "x_m=1&y_m=1&z_m=1&channels=rain_rate_mm_h",
            400,
            "channel_unavailable",
            Some("/channels/0"),
        ),
        (
            "x_m=1&y_m=1&z_m=1&channels=eddy_dissipation_rate_m23_s",
            400,
            "channel_unavailable",
            Some("/channels/0"),
        ),
        (
            "x_m=1&y_m=1&z_m=1&channels=temperature_k,temperature_k",
            400,
            "bad_parameter",
            Some("/channels/1"),
        ),
        ("x_m=1&y_m=1&z_m=1&tick=-1", 400, "bad_parameter", Some("/tick")),
        (
            "x_m=1&y_m=1&z_m=1&simulated_s=NaN",
            400,
            "bad_parameter",
            Some("/simulated_s"),
        ),
        (
            "x_m=1&y_m=1&z_m=1&tick=1&simulated_s=1",
            400,
            "bad_parameter",
            Some("/simulated_s"),
        ),
        ("x_m=1&y_m=1&z_m=1&depth=3", 400, "unknown_parameter", Some("/depth")),
    ];
    for (query, status, code, pointer) in gets {
        println!("{query}");
        server
            .get(&format!("{SAMPLE}?{query}"))
            .await
            .assert_refused(status, code, pointer);
    }
    let too_many = vec![[1.0, 1.0, 1.0]; 101];
    let posts: [(Value, u16, &str, Option<&str>); 18] = [
        (json!({}), 400, "no_positions", Some("")),
        (json!({ "positions_m": [] }), 400, "no_positions", Some("/positions_m")),
        (
            json!({ "positions_lat_lon_alt": [] }),
            400,
            "no_positions",
            Some("/positions_lat_lon_alt"),
        ),
        (
            json!({ "positions_m": [[1, 2, 3]], "positions_lat_lon_alt": [[45, 10, 0]] }),
            400,
            "mixed_coordinates",
            Some(""),
        ),
        (json!({ "positions_m": [[1, 2]] }), 400, "bad_body", None),
        (json!({ "positions_m": [["NaN", 2, 3]] }), 400, "bad_body", None),
        (json!({ "positions_m": [[null, 2, 3]] }), 400, "bad_body", None),
        (
            json!({ "positions_m": [[1, 2, 3], [1, 1e9, 3]] }),
            400,
            "out_of_range",
            Some("/positions_m/1/1"),
        ),
        (
            json!({ "positions_lat_lon_alt": [[45, 10, 1], [95, 10, 1]] }),
            400,
            "out_of_range",
            Some("/positions_lat_lon_alt/1/0"),
        ),
        (
            json!({ "positions_lat_lon_alt": [[-45, 10, 1]] }),
            400,
            "outside_domain",
            Some("/positions_lat_lon_alt/0/0"),
        ),
        (
            json!({ "positions_m": too_many }),
            413,
            "too_many_points",
            Some("/positions_m"),
        ),
        (
            json!({ "positions_m": [[0, 0, 1], [1000, 0, 1]], "step_m": 1.0 }),
            413,
            "too_many_points",
            Some("/step_m"),
        ),
        (
            json!({ "positions_m": [[0, 0, 1], [1000, 0, 1]], "step_m": 0.0 }),
            400,
            "out_of_range",
            Some("/step_m"),
        ),
        (
            json!({ "positions_m": [[1, 2, 3]], "channels": [] }),
            400,
            "no_channels",
            Some("/channels"),
        ),
        (
            json!({ "positions_m": [[1, 2, 3]], "channels": ["ice_water_kg_kg"] }),
            400,
            "channel_unavailable",
            Some("/channels/0"),
        ),
        (
            json!({ "positions_m": [[1, 2, 3]], "tick": 1, "simulated_s": 2.0 }),
            400,
            "bad_parameter",
            Some("/simulated_s"),
        ),
        (json!({ "positions_m": [[1, 2, 3]], "tick": -1 }), 400, "bad_body", None),
        (
            json!({ "positions_m": [[1, 2, 3]], "colour": "blue" }),
            400,
            "bad_body",
            None,
        ),
    ];
    for (body, status, code, pointer) in posts {
        println!("{body}");
        server.post(SAMPLE, &body).await.assert_refused(status, code, pointer);
    }
    let head = "Content-Type: application/json\r\n";
    for (body, status, code) in [
        (b"{\"positions_m\": [[1, 1e999, 3]]}".to_vec(), 400, "bad_json"),
        (b"{\"positions_m\": [[1, 2".to_vec(), 400, "bad_json"),
        (vec![b' '; 10 << 20], 413, "body_too_large"),
    ] {
        server
            .request("POST", SAMPLE, head, &body)
            .await
            .assert_refused(status, code, None);
    }
    server
        .get("/v1/worlds/w9/sample?x_m=1&y_m=1&z_m=1")
        .await
        .assert_refused(404, "unknown_world", None);
}

async fn open(server: &Server) -> (Socket, Value) {
    let url = format!("ws://{}/v1/worlds/w1/samples", server.address);
    let (mut socket, _) = tokio_tungstenite::connect_async(url).await.unwrap();
    let hello = next_of(&mut socket, "hello").await;
    (socket, hello)
}

async fn next_binary(socket: &mut Socket) -> SamplesMessage {
    match next(socket).await {
        Message::Binary(bytes) => SamplesMessage::decode(&bytes).unwrap(),
        other => panic!("{other:?}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn moving_places_are_answered_in_both_forms_and_agree() {
    let server = server(Limits::default()).await;
    pause(&server).await;
    let (mut socket, hello) = open(&server).await;
    let channels = hello["channels"].as_array().unwrap();
    assert!(channels.contains(&json!("wind_from_deg")) && !channels.contains(&json!("eddy_dissipation_rate_m23_s")));
    let positions = json!([[1600.0, 1600.0, 800.0], [10.0, 20.0, 30.0], [0.0, 0.0, -1.0]]);
    say(
        &mut socket,
        json!({ "type": "positions", "number": 7, "positions_m": positions }),
    )
    .await;
    say(&mut socket, json!({ "type": "subscribe", "rate_hz": 20.0 })).await;
    let first = next_of(&mut socket, "samples").await;
    assert_eq!((&first["sequence"], &first["number"]), (&json!(0), &json!(7)));
    let posted = server.post(SAMPLE, &json!({ "positions_m": positions })).await.json();
    assert_eq!(first["values"], posted["values"]);
    assert_eq!(first["tick"], posted["tick"]);
    // The same in binary, positions too, and only two channels.
    let wish = json!({ "type": "subscribe", "rate_hz": 20.0, "format": "binary", "channels": ["wind_from_deg", "temperature_k"] });
    say(&mut socket, wish).await;
    let moved = PositionsMessage {
        places: Places::Local,
        number: 8,
        positions: serde_json::from_value(positions).unwrap(),
    };
    socket.send(Message::Binary(moved.encode().into())).await.unwrap();
    let binary = loop {
        match next(&mut socket).await {
            Message::Text(_) => {}
            Message::Binary(bytes) => {
                let message = SamplesMessage::decode(&bytes).unwrap();
                if message.number == 8 {
                    break message;
                }
            }
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(
        binary.quantities,
        [Quantity::WindFromDeg, Quantity::Channel(Channel::TemperatureK)]
    );
    for (name, column) in ["wind_from_deg", "temperature_k"].iter().zip(&binary.columns) {
        for (i, value) in column.iter().enumerate() {
            match posted["values"][name][i].as_f64() {
                Some(there) => assert_eq!(f64::from(*value), f64::from(there as f32), "{name} {i}"),
                None => assert!(value.is_nan()),
            }
        }
    }
    // Nonsense is answered, and the stream goes on as it was.
    for (bad, code) in [
        (Message::Text("{".into()), "bad_json"),
        (Message::Text("{\"type\": \"dance\"}".into()), "bad_message"),
        (
            Message::Text("{\"type\": \"subscribe\", \"rate_hz\": 1e9}".into()),
            "out_of_range",
        ),
        (
            Message::Text("{\"type\": \"subscribe\", \"rate_hz\": 1, \"channels\": [\"x\"]}".into()),
            "unknown_channel",
        ),
        (Message::Text("{\"type\": \"positions\"}".into()), "no_positions"),
        (Message::Binary(vec![1, 2, 3].into()), "bad_message"),
        (
            Message::Binary(
                PositionsMessage {
                    places: Places::Local,
                    number: 0,
                    positions: vec![[f64::NAN; 3]],
                }
                .encode()
                .into(),
            ),
            "out_of_range",
        ),
        (
            Message::Binary(
                PositionsMessage {
                    places: Places::Geographic,
                    number: 0,
                    positions: vec![[0.0, 200.0, 0.0]],
                }
                .encode()
                .into(),
            ),
            "outside_domain",
        ),
        (
            Message::Binary(
                PositionsMessage {
                    places: Places::Local,
                    number: 0,
                    positions: vec![],
                }
                .encode()
                .into(),
            ),
            "no_positions",
        ),
    ] {
        socket.send(bad).await.unwrap();
        let error = next_of(&mut socket, "error").await;
        assert_eq!(error["error"]["code"], code, "{error}");
    }
    let still = next_binary(&mut socket).await;
    assert_eq!((still.number, &still.columns[1][..2]), (8, &binary.columns[1][..2]));
    // The stream ends with its world.
    server.delete("/v1/worlds/w1").await;
    let ended = async {
        loop {
            match next(&mut socket).await {
                Message::Close(frame) => return frame,
                Message::Binary(_) | Message::Text(_) => {}
                other => panic!("{other:?}"),
            }
        }
    };
    assert!(timeout(PATIENCE, ended).await.expect("an end").is_some());
}

#[tokio::test(flavor = "multi_thread")]
async fn the_native_client_asks_once_and_follows() {
    use welkin_client::ClientError;
    use welkin_client::sample::{Samples, sample};
    use welkin_proto::sample::SampleRequest;
    let server = server(Limits::default()).await;
    pause(&server).await;
    let url = format!("http://{}", server.address);
    let request = SampleRequest {
        positions_m: Some(vec![[0.0, 0.0, 100.0], [900.0, 0.0, 100.0]]),
        step_m: Some(300.0),
        ..SampleRequest::default()
    };
    let answer = sample(&url, None, &request).await.unwrap();
    let posted = server.post(SAMPLE, &serde_json::to_value(&request).unwrap()).await;
    assert_eq!(answer, serde_json::from_slice(&posted.body).unwrap());
    assert_eq!(answer.distance_m, Some(vec![0.0, 300.0, 600.0, 900.0]));
    let unknown = SampleRequest {
        channels: Some(vec!["sunshine".to_owned()]),
        ..request.clone()
    };
    match sample(&url, Some("w1"), &unknown).await {
        Err(ClientError::Refused(error)) => assert_eq!(error.code, "unknown_channel"),
        other => panic!("{other:?}"),
    }
    let mut samples = Samples::connect(&url, Some("w1")).await.unwrap();
    samples.place(5, answer.positions_m.clone().unwrap()).await.unwrap();
    samples.subscribe(&["temperature_k"], 20.0).await.unwrap();
    let heard = samples.next().await.unwrap();
    let column: Vec<Option<f32>> = heard.columns[0].iter().map(|&v| Some(v)).collect();
    assert_eq!((heard.number, &column), (5, &answer.values["temperature_k"]));
    // What the server does not take is said, and the answers go on.
    samples.place(6, vec![[f64::NAN; 3]]).await.unwrap();
    let refused = loop {
        match samples.next().await {
            Ok(_) => {}
            Err(error) => break error,
        }
    };
    assert!(
        matches!(&refused, ClientError::Refused(error) if error.code == "out_of_range"),
        "{refused}"
    );
    assert_eq!(samples.next().await.unwrap().number, 5);
    assert!(
        matches!(Samples::connect(&url, Some("w7")).await, Err(ClientError::Refused(e)) if e.code == "unknown_world")
    );
}

/// The default scene at full size in real time; a thousand aircraft in ten clients send their positions and get all channels ten times a second, server
/// and clients in one process. Bounds are several times what one core of a busy machine needed, see the printed line.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_thousand_aircraft_at_ten_hertz() {
    const CLIENTS: u32 = 10;
    const EACH: u32 = 100;
    const SECONDS: f64 = 4.0;
    let server = common::empty_server(Limits::default()).await;
    let mut scene = welkin_proto::presets::find(welkin_proto::presets::DEFAULT).unwrap();
    scene.time.spin_up_s = 0.0;
    scene.time.time_scale = 1.0;
    server.state.create_world(scene).await.unwrap();
    tokio::time::sleep(Duration::from_millis(500)).await;
    let (begin, before) = (Instant::now(), processor_s());
    tokio::time::sleep(Duration::from_secs_f64(SECONDS / 2.0)).await;
    let alone = (processor_s() - before) / begin.elapsed().as_secs_f64();

    let mut sockets = Vec::new();
    for _ in 0..CLIENTS {
        let (mut socket, _) = open(&server).await;
        say(
            &mut socket,
            json!({ "type": "subscribe", "rate_hz": 10.0, "format": "binary" }),
        )
        .await;
        sockets.push(socket);
    }
    let (begin, before) = (Instant::now(), processor_s());
    let clients = sockets.into_iter().enumerate().map(|(c, mut socket)| {
        tokio::spawn(async move {
            let mut sent: Vec<Instant> = Vec::new();
            let mut delays: Vec<Duration> = Vec::new();
            let mut answers = 0;
            let mut due = tokio::time::interval(Duration::from_millis(100));
            while begin.elapsed().as_secs_f64() < SECONDS {
                tokio::select! {
                    _ = due.tick() => {
                        let flown_m = 250.0 * begin.elapsed().as_secs_f64();
                        let place = |i: u32| {
                            let lane = f64::from(c as u32 * EACH + i);
                            [flown_m + 37.0 * lane, 64.0 * lane, 50.0 + 2.9 * lane]
                        };
                        let message = PositionsMessage {
                            places: Places::Local,
                            number: sent.len() as u32,
                            positions: (0..EACH).map(place).collect(),
                        };
                        sent.push(Instant::now());
                        socket.send(Message::Binary(message.encode().into())).await.unwrap();
                    }
                    message = next_binary(&mut socket) => {
                        assert_eq!(message.columns[0].len(), EACH as usize);
                        assert!(message.columns.iter().flatten().all(|v| v.is_finite()));
                        answers += 1;
                        delays.push(sent[message.number as usize].elapsed());
                    }
                }
            }
            (answers, delays)
        })
    });
    let (mut answers, mut delays) = (0, Vec::new());
    for client in clients.collect::<Vec<_>>() {
        let (some, of_them) = client.await.unwrap();
        answers += some;
        delays.extend(of_them);
    }
    let seconds = begin.elapsed().as_secs_f64();
    let with = (processor_s() - before) / seconds;
    delays.sort();
    let percentile = |share: f64| delays[(share * (delays.len() - 1) as f64) as usize].as_secs_f64() * 1e3;
    let rate = f64::from(answers) / f64::from(CLIENTS) / seconds;
    println!(
        "1000 aircraft: {rate:.1} answers a second each; {:.2} cores with them, {alone:.2} without; from position to \
         answer {:.1} ms (median), {:.1} ms (99 %), of which the rate's own wait is up to 100 ms",
        with,
        percentile(0.5),
        percentile(0.99)
    );
    // Ten are asked for; other tests may have the cores for a while.
    assert!(rate > 5.0, "{rate} answers a second");
    assert!(with - alone < 1.0, "{with} cores, {alone} without");
}
