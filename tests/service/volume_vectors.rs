//! The test vectors of `proto/PROTOCOL.md`: made by `cargo test -p welkin-tests --test volume_format -- --ignored write_vectors`.

use std::path::Path;

use serde_json::{Value, json};
use welkin_proto::volume::{
    Bits, Compression, Curve, Encoder, Header, Kind, Layout, Moment, Plane, Receiver, Region, Taken, VolumeError,
};

pub const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/volume");
pub const VIEW: u32 = 7;
const WORLD: [u32; 3] = [20, 12, 10];

pub fn layout(mip: u8) -> Layout {
    Layout {
        world_cells: WORLD,
        cell_size_m: [100.0, 100.0, 40.0],
        region: Region::whole(WORLD),
        mip,
        brick: [8; 3],
    }
}

pub fn moment(tick: u64) -> Moment {
    Moment {
        tick,
        simulated_s: 3600.0 + tick as f64,
        published_unix_s: 1.75e9 + 0.125 * tick as f64,
        encoded_unix_s: 1.75e9 + 0.125 * tick as f64 + 0.002,
        sun_direction: [0.6, 0.0, 0.8],
        air_displacement_m: [-31500.0, 12.5],
    }
}

/// A field of the world: two clouds that have moved by `shift` cells, or a wind.
pub fn air(shift: f32, kind: usize) -> Vec<f32> {
    let [nx, ny, nz] = WORLD.map(|n| n as usize);
    let mut field = Vec::new();
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                let [x, y, z] = [x, y, z].map(|n| n as f32);
                let bump = |cx: f32, cy: f32, cz: f32, r: f32| {
                    let [dx, dy, dz] = [x - cx - shift, y - cy, z - cz];
                    (1.0 - (dx * dx + dy * dy + dz * dz) / (r * r)).max(0.0)
                };
                field.push(match kind {
                    0 => 0.08 * bump(5.0, 5.0, 6.0, 3.5) + 0.011 * bump(14.0, 7.5, 4.0, 2.6),
                    _ => -8.75 + 0.4 * z + 1.5 * (0.5 * x + 0.8 * y).sin(),
                });
            }
        }
    }
    field
}

fn encoder(mip: u8, bits: Bits, compression: Compression) -> Encoder {
    let planes = [("extinction_per_m", Curve::Square), ("wind_x_m_s", Curve::Linear)].map(|(name, curve)| Plane {
        name: name.to_owned(),
        curve,
    });
    Encoder::new(VIEW, layout(mip), planes.to_vec(), bits, compression).unwrap()
}

pub fn message_of(bits: Bits, compression: Compression) -> Vec<u8> {
    let mut encoder = encoder(0, bits, compression);
    encoder.encode(&moment(0), &[&air(0.0, 0), &air(0.0, 1)]).unwrap().1
}

/// The variant's name.
pub fn kind_of(error: &VolumeError) -> String {
    let text = format!("{error:?}");
    text.split([' ', '(', '{']).next().unwrap_or_default().to_owned()
}

fn good(folder: &Path, name: &str, encoder: &mut Encoder, ticks: u64, vectors: &mut Vec<Value>) -> Vec<Vec<u8>> {
    let mut receiver = Receiver::default();
    let (mut files, mut messages): (Vec<String>, Vec<Vec<u8>>) = (Vec::new(), Vec::new());
    for tick in 0..ticks {
        // Only the clouds move, so that a delta leaves the wind's bricks out.
        let fields = [air(0.5 * tick as f32, 0), air(0.0, 1)];
        let (kind, message) = encoder.encode(&moment(tick), &[&fields[0], &fields[1]]).unwrap();
        assert_eq!(kind == Kind::Keyframe, tick == 0);
        let file = format!("{name}-{}.bin", if tick == 0 { "keyframe" } else { "delta" });
        std::fs::write(folder.join(&file), &message).unwrap();
        files.push(file);
        let Taken::Field(field) = receiver.take(&message).unwrap() else {
            panic!("it is good")
        };
        let header = Header::decode(&message).unwrap().0;
        let m = header.moment;
        let values: serde_json::Map<String, Value> = field
            .channels
            .iter()
            .map(|c| (c.name.clone(), json!(c.values())))
            .collect();
        vectors.push(json!({
            "messages": files,
            "result": "field",
            "header": {
                "kind": if tick == 0 { "keyframe" } else { "delta" },
                "view": header.view, "sequence": header.sequence, "keyframe": header.keyframe,
                "mip": header.layout.mip, "tick": m.tick, "simulated_s": m.simulated_s,
                "published_unix_s": m.published_unix_s, "encoded_unix_s": m.encoded_unix_s,
                "cell_size_m": header.layout.cell_size_m, "world_cells": header.layout.world_cells,
                "region_from": header.layout.region.from, "region_cells": header.layout.region.cells,
                "brick": header.layout.brick, "cells": header.layout.cells(), "raw_bytes": header.raw_bytes,
            },
            "values": values,
        }));
        messages.push(message);
    }
    let replay = |files: &[&String], result| json!({ "messages": files, "result": result });
    if let [keyframe, delta] = files.as_slice() {
        vectors.push(replay(&[delta], "needs_keyframe"));
        vectors.push(replay(&[keyframe, delta, delta], "stale"));
        vectors.push(replay(&[keyframe, delta, keyframe], "stale"));
    }
    messages
}

#[test]
#[ignore = "writes the test vectors anew"]
fn write_vectors() {
    let folder = Path::new(FOLDER);
    let mut vectors = Vec::new();
    let mut make = |name: &str, mip, bits, compression, ticks| {
        good(folder, name, &mut encoder(mip, bits, compression), ticks, &mut vectors)
    };
    let messages = make("deflate-8", 0, Bits::Eight, Compression::Deflate, 2);
    make("deflate-16", 0, Bits::Sixteen, Compression::Deflate, 2);
    make("none-8-mip1", 1, Bits::Eight, Compression::None, 1);
    make("zstd-16-mip2", 2, Bits::Sixteen, Compression::Zstd, 1);
    let keyframe = &messages[0];
    let mut bad = Vec::new();
    let mut spoil = |name: &str, why: &str, edit: &dyn Fn(&mut Vec<u8>)| {
        let mut message = keyframe.clone();
        edit(&mut message);
        let file = format!("bad-{name}.bin");
        std::fs::write(folder.join(&file), &message).unwrap();
        let refused = Receiver::default().take(&message).expect_err(why);
        bad.push(json!({ "message": file, "why": why, "rust": kind_of(&refused) }));
    };
    let put = |at: usize, bytes: &'static [u8]| move |m: &mut Vec<u8>| m[at..at + bytes.len()].copy_from_slice(bytes);
    spoil("short", "it ends within the header", &|m| m.truncate(151));
    spoil("cut", "it ends within the body", &|m| m.truncate(m.len() - 9));
    spoil("long", "a byte follows the body", &|m| m.push(0));
    spoil("magic", "another magic", &put(0, b"WLKF"));
    spoil("version", "version 2", &put(4, &[2]));
    spoil("kind", "kind 3", &put(6, &[3]));
    spoil("keyframe", "a keyframe that builds on another", &put(16, &[9]));
    spoil("mip", "mip 7", &put(20, &[7]));
    spoil("channels", "no channels", &put(21, &[0]));
    spoil("nan", "a time that is no number", &put(32, &[0xff; 8]));
    spoil("region", "a region beyond the world", &put(104, &[21]));
    spoil("brick", "a brick without extent", &put(116, &[0]));
    spoil("bomb", "a body that unpacks to 4 GiB", &put(144, &[0xff; 4]));
    spoil("raw", "a body that unpacks to less than it has", &|m| m[144] -= 1);
    spoil("bits", "12 bits", &put(153, &[12]));
    spoil("scale", "a negative scale", &|m| m[171] |= 0x80);
    spoil("name", "a capital in a name", &put(172, b"E"));
    spoil("body", "a body that does not unpack", &|m| {
        let at = m.len() - 40;
        m[at..].fill(0x55);
    });
    // A body with a mode that there is none of, and one that is too short for its modes.
    let none = message_of(Bits::Eight, Compression::None);
    let (header, body) = Header::decode(&none).unwrap();
    let body_at = none.len() - body.len();
    assert_eq!(header.layout.brick_count(), 12);
    let mut spoil_none = |name: &str, why: &str, edit: &dyn Fn(&mut Vec<u8>)| {
        let mut message = none.clone();
        edit(&mut message);
        spoil(name, why, &|m| m.clone_from(&message));
    };
    spoil_none("mode", "a brick of mode 5", &|m| m[body_at] = 5);
    spoil_none("mode-4", "a keyframe with a brick of mode 4", &|m| {
        m[body_at..body_at + 12].fill(4)
    });
    spoil_none("missing-brick", "modes that announce more than there is", &|m| {
        m[body_at..body_at + 12].fill(2);
    });
    spoil_none("left-over", "modes that announce less than there is", &|m| {
        m[body_at..body_at + 12].fill(0)
    });
    let document = json!({
        "about": "See proto/PROTOCOL.md. `good`: take the messages one after another; the last gives `result`, and after `field` the field has these values. `bad`: must be refused.",
        "good": vectors,
        "bad": bad,
    });
    std::fs::write(
        folder.join("vectors.json"),
        serde_json::to_string(&document).unwrap() + "\n",
    )
    .unwrap();
}
