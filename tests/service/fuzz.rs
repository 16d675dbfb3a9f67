//! What clients and servers read from each other, forged and damaged: nothing panics, nothing is believed beyond the bytes that came, and what is taken
//! is taken whole.
//!
//! Volume messages have tests of their own (`volume_format.rs`). Millions of cases: `cargo test --release -p welkin-tests --test fuzz -- --ignored`.

use proptest::prelude::*;
use proptest::sample::Index;
use proptest::test_runner::{Config, TestCaseError, TestRunner};
use serde_json::{Value, json};
use welkin_client::record::{Reader, Record, RecordKind, Writer};
use welkin_client::volume::Intake;
use welkin_proto::sample::{Places, PositionsMessage, Quantity, SampleClientMessage, SampleRequest, SamplesMessage};
use welkin_proto::volume::DecodeLimits;
use welkin_proto::volume::subscribe::VolumeClientMessage;
use welkin_proto::wire::{ClientMessage, FrameDelivery, FrameFormat, FrameHeader};

/// What is done to a good message.
#[derive(Clone, Debug)]
struct Damage {
    edits: Vec<(Index, u8, u8)>,
    cut: Option<Index>,
    more: Vec<u8>,
}

fn damage() -> impl Strategy<Value = Damage> {
    let edits = prop::collection::vec((any::<Index>(), any::<u8>(), 0..3u8), 0..6);
    let more = prop::collection::vec(any::<u8>(), 0..9);
    (edits, prop::option::weighted(0.3, any::<Index>()), more).prop_map(|(edits, cut, more)| Damage {
        edits,
        cut,
        more,
    })
}

impl Damage {
    fn of(&self, good: &[u8]) -> Vec<u8> {
        let mut bytes = good.to_vec();
        for (at, byte, how) in &self.edits {
            let at = at.index(bytes.len());
            match how {
                0 => bytes[at] = *byte,
                1 => bytes[at] ^= 1 << (byte % 8),
                _ => {
                    let end = (at + 4).min(bytes.len());
                    bytes[at..end].fill(*byte | 0x7f);
                }
            }
        }
        if let Some(cut) = &self.cut {
            bytes.truncate(cut.index(bytes.len() + 1));
        }
        // Half of all messages stay as long as they were.
        if self.more.len() > 4 {
            bytes.extend_from_slice(&self.more);
        }
        bytes
    }
}

fn run<S: Strategy>(count: u32, strategy: &S, test: impl Fn(S::Value) -> Result<(), TestCaseError>) {
    let config = Config {
        failure_persistence: None,
        ..Config::with_cases(count)
    };
    TestRunner::new(config).run(strategy, test).unwrap();
}

fn binary(count: u32) {
    let frame = |delivery| {
        let header = FrameHeader {
            format: FrameFormat::Jpeg,
            width: 640,
            height: 360,
            tick: 17,
            simulated_s: 17.0,
            render_ms: 1.0,
            encode_ms: 1.0,
            sequence: 3,
            image_bytes: 5,
            delivery,
        };
        [header.encode(), vec![1, 2, 3, 4, 5]].concat()
    };
    let delivery = FrameDelivery {
        sent_unix_ms: 1e12,
        age_ms: 3.0,
        wait_ms: 1.0,
        still: false,
    };
    let frames = [frame(None), frame(Some(delivery))];
    let positions = PositionsMessage {
        places: Places::Local,
        number: 9,
        positions: vec![[1.0, 2.0, 3.0]; 20],
    }
    .encode();
    let samples = SamplesMessage {
        sequence: 1,
        number: 9,
        tick: 17,
        simulated_s: 17.0,
        wall_unix_s: 1e9,
        quantities: Quantity::all().take(5).collect(),
        columns: vec![vec![1.5; 20]; 5],
    }
    .encode();
    let mut file = Vec::new();
    let mut writer = Writer::new(&mut file).unwrap();
    for (kind, data) in [(RecordKind::Text, &b"{}"[..]), (RecordKind::Binary, &[7; 100])] {
        let record = Record {
            kind,
            arrived_unix_s: 1e9,
            data,
        };
        writer.write(record).unwrap();
    }
    run(count, &damage(), |damage| {
        for frame in &frames {
            let bytes = damage.of(frame);
            if let Ok((header, image)) = FrameHeader::decode(&bytes) {
                prop_assert_eq!(image.len(), header.image_bytes as usize);
                prop_assert_eq!([header.encode(), image.to_vec()].concat().len(), bytes.len());
            }
        }
        let bytes = damage.of(&positions);
        if let Ok(message) = PositionsMessage::decode(&bytes) {
            prop_assert_eq!(message.encode().len(), bytes.len());
        }
        let bytes = damage.of(&samples);
        if let Ok(message) = SamplesMessage::decode(&bytes) {
            prop_assert_eq!(message.columns.len(), message.quantities.len());
            prop_assert_eq!(message.encode().len(), bytes.len());
        }
        let bytes = damage.of(&file);
        if let Ok(mut reader) = Reader::new(&bytes[..]) {
            let mut read = 0;
            while let Ok(Some(record)) = reader.next_record() {
                read += record.data.len();
            }
            prop_assert!(read <= bytes.len());
        }
        // A client that is told a volume and gets something else holds nothing of it.
        for bytes in [&bytes, &damage.of(&frames[1])] {
            prop_assert!(Intake::new(DecodeLimits::default()).binary(bytes, 0.0).is_err());
        }
        Ok(())
    });
}

/// JSON with absurd values in the places of sensible ones.
fn absurd() -> impl Strategy<Value = Value> {
    prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
        any::<i64>().prop_map(Value::from),
        any::<u64>().prop_map(Value::from),
        prop::num::f64::ANY.prop_map(|v| json!(v)),
        Just(json!(1e308)),
        Just(json!("")),
        ".{0,12}".prop_map(Value::from),
        prop::collection::vec(any::<i64>(), 0..5).prop_map(Value::from),
        prop::collection::vec(prop::num::f64::ANY, 3).prop_map(|v| json!(v)),
        Just(json!({ "from": [0, 0, 0], "cells": [4294967295u32, 1, 1] })),
        Just(json!({ "from": [4294967295u32, 4294967295u32, 1], "cells": [4294967295u32, 0, 1] })),
        Just(json!({ "from": [-1e300, 0.0, 0.0], "to": [1e300, 1e300, 1e300] })),
        prop::collection::vec("[a-z_]{1,30}", 0..40).prop_map(Value::from),
    ]
}

/// What a server does with the text of its clients before any state is touched, and a client with that of its server.
fn text(count: u32) {
    let good = [
        json!({ "type": "subscribe", "channels": ["extinction_per_m"], "mip": 2, "rate_hz": 2.0, "bytes_per_s": 1e5, "bits": 8,
            "compression": "deflate", "region_cells": { "from": [0, 0, 0], "cells": [4, 4, 4] }, "region_m": null }),
        json!({ "type": "subscribe", "rate_hz": 10.0, "format": "binary", "channels": ["wind_x_m_s"] }),
        json!({ "type": "positions", "number": 1, "positions_m": [[1.0, 2.0, 3.0]] }),
        json!({ "positions_m": [[1.0, 2.0, 3.0]], "step_m": 5.0, "tick": 1, "simulated_s": 1.0, "channels": [] }),
        json!({ "type": "frames", "width": 64, "height": 64, "format": "jpeg", "max_fps": 8.0, "camera": null, "quality": "live", "header": 2 }),
        json!({ "type": "command", "command": { "command": "time_scale", "time_scale": 2.0 } }),
        json!({ "type": "hello", "protocol": 1, "server": "1", "world": "w1", "cells": [1, 1, 1], "cell_size_m": [1.0, 1.0, 1.0], "tick_s": 1.0, "channels": [] }),
        json!({ "type": "subscribed", "view": 1, "region_from": [0, 0, 0], "cells": [1, 1, 1] }),
        json!({ "type": "pong", "client_s": 1.0, "server_unix_s": 1.0, "tick": 1 }),
    ];
    let edits = prop::collection::vec((any::<Index>(), absurd()), 0..4);
    run(count, &(any::<Index>(), edits, damage()), |(which, edits, damage)| {
        let mut message = good[which.index(good.len())].clone();
        for (place, value) in edits {
            let fields = message.as_object_mut().unwrap();
            let name = fields.keys().nth(place.index(fields.len())).unwrap().clone();
            fields.insert(name, value);
        }
        let whole = message.to_string();
        let damaged = String::from_utf8_lossy(&damage.of(whole.as_bytes())).into_owned();
        for text in [&whole, &damaged] {
            if let Ok(VolumeClientMessage::Subscribe(subscription)) = serde_json::from_str(text) {
                let _ = subscription.named_channels();
                if let Ok(layout) = subscription.layout([64, 64, 75], [100.0, 100.0, 40.0]) {
                    prop_assert!(layout.check().is_ok() && layout.len() <= 64 * 64 * 75);
                    let region = layout.region;
                    prop_assert!((0..3).all(|a| region.from[a] + region.cells[a] <= layout.world_cells[a]));
                }
            }
            let _ = serde_json::from_str::<SampleClientMessage>(text);
            let _ = serde_json::from_str::<SampleRequest>(text);
            let _ = serde_json::from_str::<ClientMessage>(text);
            let mut intake = Intake::new(DecodeLimits::default());
            let _ = intake.text(text, 5.0);
            // No answer to a ping makes the clock say what is no number.
            prop_assert!(intake.clock().server_unix_s(6.0).is_none_or(f64::is_finite));
        }
        Ok(())
    });
}

#[test]
fn forged_binary_messages_do_no_harm() {
    binary(20_000);
}

#[test]
fn absurd_text_does_no_harm() {
    text(20_000);
}

#[test]
#[ignore = "some minutes: two million cases each"]
fn forged_messages_do_no_harm_for_long() {
    binary(2_000_000);
    text(2_000_000);
}
