//! Everybody sees the same weather: many native clients of one world, with losses, late comers, changed regions and cut connections.

mod common;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use common::{PATIENCE, empty_server, scene, server};
use futures_util::{SinkExt, StreamExt};
use tokio::io::copy_bidirectional;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::Message;
use welkin_client::Next;
use welkin_client::clock::{Clock, Delay, Playout};
use welkin_client::load::{self, LoadOptions};
use welkin_client::record::{Writer, replay};
use welkin_client::volume::{Intake, Understood, VolumeEvent, VolumeOptions, subscribe, subscribe_and_record};
use welkin_proto::Scene;
use welkin_proto::volume::subscribe::{RegionCells, Subscription, VolumeClientMessage};
use welkin_proto::volume::{Bits, Compression, DecodeLimits, Header, VolumeField};
use welkin_server::limits::Limits;

type Fields = BTreeMap<u64, Arc<VolumeField>>;

fn wish(bits: Bits, region_cells: Option<RegionCells>) -> Subscription {
    Subscription {
        channels: vec!["extinction_per_m".to_owned(), "wind_z_m_s".to_owned()],
        rate_hz: 60.0,
        bits,
        region_cells,
        compression: Compression::Zstd,
        ..Subscription::default()
    }
}

/// What a client of the test does.
struct Plan {
    seed: u64,
    joins: Duration,
    loss: f64,
    first: Subscription,
    /// Half-way through it asks for this, if for anything.
    then: Option<Subscription>,
    /// Half-way through its connection breaks.
    breaks: bool,
}

/// What it saw.
struct Seen {
    fields: Fields,
    messages: usize,
    lost: usize,
    clock: Clock,
}

/// A client on a bad line: loses binary messages before they are decoded.
async fn client(url: String, plan: Plan, base: Instant, ends: Instant) -> Seen {
    tokio::time::sleep(plan.joins).await;
    let half = Instant::now() + ends.saturating_duration_since(Instant::now()) / 2;
    let mut random = plan.seed;
    let mut seen = Seen {
        fields: Fields::new(),
        messages: 0,
        lost: 0,
        clock: Clock::default(),
    };
    let mut subscription = plan.first;
    let mut then = plan.then;
    let mut intake = Intake::new(DecodeLimits::default());
    'connections: loop {
        let (mut socket, _) = tokio_tungstenite::connect_async(&url).await.unwrap();
        let say = |message: &VolumeClientMessage| Message::text(serde_json::to_string(message).unwrap());
        socket
            .send(say(&VolumeClientMessage::Subscribe(subscription.clone())))
            .await
            .unwrap();
        let mut pings = tokio::time::interval(Duration::from_millis(100));
        loop {
            let now = Instant::now();
            if now >= ends {
                break 'connections;
            }
            if now >= half {
                if let Some(other) = then.take() {
                    subscription = other;
                    socket
                        .send(say(&VolumeClientMessage::Subscribe(subscription.clone())))
                        .await
                        .unwrap();
                } else if plan.breaks && seen.messages > 0 && !then_broken(&mut random) {
                    continue 'connections;
                }
            }
            let message = tokio::select! {
                message = socket.next() => message.unwrap().unwrap(),
                _ = pings.tick() => {
                    let client_s = base.elapsed().as_secs_f64();
                    socket.send(say(&VolumeClientMessage::Ping { client_s })).await.unwrap();
                    continue;
                }
            };
            let understood = match &message {
                Message::Text(text) => intake.text(text, base.elapsed().as_secs_f64()).unwrap(),
                Message::Binary(bytes) => {
                    seen.messages += 1;
                    random = next_random(random);
                    if (random >> 11) as f64 / ((1u64 << 53) as f64) < plan.loss {
                        seen.lost += 1;
                        continue;
                    }
                    intake.binary(bytes, 0.0).unwrap()
                }
                _ => continue,
            };
            match understood {
                Understood::Reply(reply) => socket.send(say(&reply)).await.unwrap(),
                Understood::Event(VolumeEvent::Volume { field, .. }) => {
                    seen.fields.insert(field.moment.tick, field);
                }
                Understood::Event(_) | Understood::Nothing => {}
            }
        }
    }
    seen.clock = intake.clock();
    seen
}

fn next_random(state: u64) -> u64 {
    let mut state = state ^ state << 13;
    state ^= state >> 7;
    state ^ state << 17
}

/// The highest bit of the seed tells whether a connection was broken already; the first call is the break.
fn then_broken(random: &mut u64) -> bool {
    let broken = *random >> 63 == 1;
    *random |= 1 << 63;
    broken
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn ten_clients_hold_the_same_field_at_the_same_tick() {
    let server = server(Limits::default()).await;
    let url = format!("ws://{}/v1/worlds/w1/volume", server.address);
    let base = Instant::now();
    let ends = base + Duration::from_secs(8);
    let corner = RegionCells {
        from: [4, 4, 0],
        cells: [8, 8, 16],
    };
    let mut crowd = JoinSet::new();
    for n in 0..10u64 {
        let sixteen = n == 9;
        let plan = Plan {
            seed: 0x1234_5678_9abc_def1 >> 1 ^ n << 40 ^ n,
            joins: Duration::from_millis(300 * n),
            loss: [0.0, 0.1, 0.3, 0.5, 0.7][n as usize % 5],
            first: if n == 8 {
                wish(Bits::Eight, Some(corner))
            } else {
                wish(if sixteen { Bits::Sixteen } else { Bits::Eight }, None)
            },
            then: (n == 8).then(|| wish(Bits::Eight, None)),
            breaks: n == 3 || n == 6,
        };
        let url = url.clone();
        crowd.spawn(async move { (n, client(url, plan, base, ends).await) });
    }
    let mut seen: BTreeMap<u64, Seen> = BTreeMap::new();
    while let Some(done) = timeout(PATIENCE, crowd.join_next()).await.unwrap() {
        let (n, theirs) = done.unwrap();
        seen.insert(n, theirs);
    }
    // All were served, lost what they were to lose, and got well again.
    let first = &seen[&0];
    assert!(
        first.lost == 0 && first.fields.len() > 20,
        "{} fields",
        first.fields.len()
    );
    for (n, theirs) in &seen {
        let share = theirs.fields.len() as f64 / theirs.messages as f64;
        let expected = 1.0 - [0.0, 0.1, 0.3, 0.5, 0.7][*n as usize % 5];
        // What is not lost is read, but for the deltas of a lost keyframe until it has come again.
        assert!(
            share > 0.5 * expected,
            "client {n}: {} of {}",
            theirs.fields.len(),
            theirs.messages
        );
    }
    // Same settings, same bits; other settings, within both bounds.
    let mut compared = [0; 3];
    for (n, theirs) in seen.iter().skip(1) {
        for (tick, field) in &theirs.fields {
            let Some(reference) = first.fields.get(tick) else {
                continue;
            };
            if field.layout == reference.layout && *n != 9 {
                assert_eq!(field.channels, reference.channels, "client {n}, tick {tick}");
                compared[0] += 1;
            } else if *n == 9 {
                for (fine, coarse) in field.channels.iter().zip(&reference.channels) {
                    for (a, b) in fine.values().iter().zip(coarse.values()) {
                        let bound = fine.quantiser.error_max(*a) + coarse.quantiser.error_max(*a);
                        // The square curve's bound is that of the exact value, which is half a fine step from `a`; both values are rounded.
                        let most = bound * 1.01 + 2e-7 * f64::from(a.abs()) + 1e-12;
                        assert!(
                            f64::from((a - b).abs()) <= most,
                            "{}: {a} and {b}, tick {tick}",
                            fine.name
                        );
                    }
                }
                compared[1] += 1;
            } else {
                // The corner is the same cells of the same field, with quantisers of its own.
                for channel in &field.channels {
                    let whole = reference.channel(&channel.name).unwrap();
                    for cell in 0..8 * 8 * 16 {
                        let at = [cell % 8 + 4, cell / 8 % 8 + 4, cell / 64];
                        let a = channel.quantiser.value(channel.codes[cell]);
                        let b = whole.quantiser.value(whole.codes[(at[2] * 16 + at[1]) * 16 + at[0]]);
                        let larger = a.abs().max(b.abs());
                        let bound = channel.quantiser.error_max(larger) + whole.quantiser.error_max(larger);
                        assert!(
                            f64::from((a - b).abs()) <= bound + 2e-7 * f64::from(larger),
                            "{}: {a} and {b}",
                            channel.name
                        );
                    }
                }
                compared[2] += 1;
            }
        }
    }
    assert!(compared[0] > 100 && compared[1] > 3 && compared[2] > 0, "{compared:?}");
    // The clocks agree with the server's, and so with one another.
    let now = Instant::now();
    let true_s = server.state.volumes().clock().unix_s(now);
    let mut errors_s = Vec::new();
    for (n, theirs) in &seen {
        let theirs_s = theirs
            .clock
            .server_unix_s((now - base).as_secs_f64())
            .expect("it asked");
        // What a clock says of its own error holds however busy the machine is.
        let error_s = (theirs_s - true_s).abs();
        let stated_s = theirs.clock.error_max_s().expect("it asked");
        assert!(
            error_s <= stated_s + 1e-3,
            "client {n} is {error_s} s off and says {stated_s}"
        );
        errors_s.push(error_s);
    }
    // Two of these are within 20 ms of one another.
    errors_s.sort_by(f64::total_cmp);
    assert!(
        errors_s[errors_s.len() / 2] < 0.01,
        "half of the clocks are off by more: {errors_s:?}"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn clients_with_the_same_delay_show_the_same_moment() {
    let server = server(Limits::default()).await;
    let url = format!("http://{}", server.address);
    // One gets every tick, the other every third or so.
    let mut players = Vec::new();
    for rate_hz in [60.0, 4.0] {
        let subscription = Subscription {
            rate_hz,
            ..wish(Bits::Sixteen, None)
        };
        let options = VolumeOptions {
            subscription,
            ..VolumeOptions::default()
        };
        players.push((subscribe(&url, options).unwrap(), Playout::new(Delay::Fixed(1.0))));
    }
    let (mut shown, mut compared) = (Vec::new(), 0);
    let ends = Instant::now() + Duration::from_secs(6);
    while Instant::now() < ends {
        shown.clear();
        for (volumes, playout) in &mut players {
            while let Ok(Some(event)) = timeout(Duration::from_millis(1), volumes.next()).await {
                if let VolumeEvent::Volume { field, .. } = event {
                    let now_s = volumes.server_unix_s().unwrap_or(0.0);
                    playout.push(field, now_s);
                }
            }
        }
        // The same moment by each one's own clock.
        for (volumes, playout) in &mut players {
            if let Some(now_s) = volumes.server_unix_s()
                && let Some(moment) = playout.at(now_s)
                && moment.after.is_some()
            {
                shown.push(moment);
            }
        }
        if let [quick, slow] = shown.as_slice() {
            compared += 1;
            // The world runs at ten times real time and its clock is not quite even: between two volumes a quarter of a second apart the slow one's time is
            // a straight line, the quick one's has corners.
            let apart_s = (quick.simulated_s - slow.simulated_s).abs();
            assert!(apart_s < 1.5, "{apart_s} simulated seconds apart");
            let at = [1600.0, 1600.0, 900.0];
            let [a, b] = [quick, slow].map(|s| s.value_at("wind_z_m_s", at).unwrap());
            assert!((a - b).abs() < 0.5, "updraughts of {a} and {b}");
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert!(compared > 50, "{compared} moments compared");
}

/// Passes connections on, and cuts them all when told to.
async fn proxy(to: std::net::SocketAddr) -> (String, Arc<Mutex<JoinSet<()>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let lines = Arc::new(Mutex::new(JoinSet::new()));
    let open = Arc::clone(&lines);
    tokio::spawn(async move {
        while let Ok((mut from, _)) = listener.accept().await {
            open.lock().unwrap().spawn(async move {
                if let Ok(mut onward) = TcpStream::connect(to).await {
                    // A cut line ends in an error at both ends.
                    let _ = copy_bidirectional(&mut from, &mut onward).await;
                }
            });
        }
    });
    (url, lines)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_cut_line_and_a_new_wish_heal_at_once() {
    let server = server(Limits::default()).await;
    let (url, lines) = proxy(server.address).await;
    let options = VolumeOptions {
        subscription: wish(Bits::Eight, None),
        retry_first: Duration::from_millis(50),
        ..VolumeOptions::default()
    };
    let mut volumes = subscribe(&url, options).unwrap();
    let steady_options = VolumeOptions {
        subscription: wish(Bits::Eight, None),
        ..VolumeOptions::default()
    };
    let mut steady = subscribe(&format!("http://{}", server.address), steady_options).unwrap();
    let mut reference = Fields::new();
    let mut seen = Fields::new();
    let (mut hellos, mut errors, mut resubscribed, mut cut) = (0, 0, false, false);
    let ends = Instant::now() + Duration::from_secs(6);
    let mut corner = 0;
    while Instant::now() < ends {
        tokio::select! {
            event = steady.next() => if let Some(VolumeEvent::Volume { field, .. }) = event {
                reference.insert(field.moment.tick, field);
            },
            event = volumes.next() => match event.expect("it comes back for ever") {
                VolumeEvent::Hello(_) => hellos += 1,
                VolumeEvent::Subscribed(_) => {}
                VolumeEvent::Error { next, .. } => {
                    assert!(matches!(next, Next::RetryIn(_)));
                    errors += 1;
                }
                VolumeEvent::Volume { field, .. } => {
                    if field.layout.cells() == [8, 8, 16] {
                        corner += 1;
                    }
                    seen.insert(field.moment.tick, field);
                    if seen.len() == 8 && !cut {
                        cut = true;
                        lines.lock().unwrap().abort_all();
                    }
                    if seen.len() == 16 && !resubscribed {
                        resubscribed = true;
                        volumes.resubscribe(wish(Bits::Eight, Some(RegionCells { from: [4, 4, 0], cells: [8, 8, 16] })));
                    }
                }
            },
        }
    }
    assert_eq!((hellos, errors), (2, 1));
    assert!(corner > 3, "the new wish was granted: {corner}");
    let same = seen
        .iter()
        .filter_map(|(tick, field)| Some((field, reference.get(tick)?)));
    let whole: Vec<_> = same.filter(|(field, _)| field.layout.cells() == [16; 3]).collect();
    assert!(whole.len() > 8);
    for (field, reference) in whole {
        assert_eq!(field.channels, reference.channels);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_recording_plays_what_was_seen() {
    let server = server(Limits::default()).await;
    let file = std::env::temp_dir().join(format!("welkin-{}.wlkr", std::process::id()));
    let mut writer = Writer::new(std::fs::File::create(&file).unwrap()).unwrap();
    let options = VolumeOptions {
        subscription: wish(Bits::Eight, None),
        ..VolumeOptions::default()
    };
    let url = format!("http://{}", server.address);
    let mut volumes = subscribe_and_record(&url, options, move |record| writer.write(record)).unwrap();
    let mut live = Vec::new();
    while live.len() < 25 {
        if let VolumeEvent::Volume { field, .. } = timeout(PATIENCE, volumes.next()).await.unwrap().unwrap() {
            live.push(field);
        }
    }
    drop(volumes);
    for speed in [f64::INFINITY, 4.0] {
        let began = Instant::now();
        let mut played = replay(&file, speed, DecodeLimits::default()).unwrap();
        let (mut fields, mut heads) = (Vec::new(), 0);
        while let Some(event) = timeout(PATIENCE, played.next()).await.unwrap() {
            match event {
                VolumeEvent::Hello(_) | VolumeEvent::Subscribed(_) => heads += 1,
                VolumeEvent::Volume { field, .. } => {
                    // The clock is the server's when it was recorded.
                    let age_s = played.server_unix_s().unwrap() - field.moment.published_unix_s;
                    assert!((0.0..5.0).contains(&age_s), "{age_s}");
                    fields.push(field);
                }
                VolumeEvent::Error { error, .. } => panic!("{error}"),
            }
        }
        assert_eq!(heads, 2);
        // What came between the last that was looked at and the end is in the file too.
        assert!(fields.len() >= live.len());
        for (played, live) in fields.iter().zip(&live) {
            assert_eq!(played, live);
        }
        let recorded_s = live[24].moment.encoded_unix_s - live[0].moment.encoded_unix_s;
        if speed == 4.0 {
            let took_s = began.elapsed().as_secs_f64();
            assert!(
                took_s > 0.2 * recorded_s,
                "{took_s} s for {recorded_s} s at four times the speed"
            );
        }
    }
    std::fs::remove_file(&file).unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_crowd_a_storm_and_slow_readers_leave_the_server_well() {
    let limits = Limits::default();
    let server = empty_server(limits).await;
    let scene: Scene = serde_json::from_value(scene()).unwrap();
    server.state.create_world(scene).await.unwrap();
    let url = format!("http://{}", server.address);
    let options = LoadOptions {
        subscribers: 40,
        subscription: Subscription {
            rate_hz: 4.0,
            ..wish(Bits::Eight, None)
        },
        slow: 4,
        viewers: 4,
        each: Duration::from_secs(4),
        server_pid: Some(std::process::id()),
        ..LoadOptions::default()
    };
    let report = timeout(PATIENCE, load::run(&url, &options)).await.unwrap().unwrap();
    eprintln!("{report}");
    assert_eq!(report.errors, 0, "{report}");
    // Four a second on an idle machine; pictures and other tests take most of a busy one.
    assert!(report.volumes_per_s[0] > 0.7, "{report}");
    assert!(report.slow_volumes_per_s < 0.5 * report.volumes_per_s[1], "{report}");
    assert!(report.storm_s < 30.0, "{report}");
    assert!(report.loaded.count >= 5, "{report}");
    // Forty who want the same are one view and the watcher another; after the storm they are gone.
    let began = Instant::now();
    while server.state.volumes().view_count() > 0 || server.state.stream_count() > 0 {
        assert!(began.elapsed() < PATIENCE, "views or streams stay behind");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    // The server goes on.
    let answer = server.get("/v1/worlds/w1/volume.bin").await;
    assert_eq!(Header::decode(&answer.body).unwrap().0.layout.cells(), [16; 3]);
}
