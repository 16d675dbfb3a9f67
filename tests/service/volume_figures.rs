//! What volumes of the default scene cost: bytes, ratios, errors, milliseconds. Prints a table and judges nothing but the aim of 150 kB/s.
//!
//! `cargo test --release -p welkin-tests --test volume_figures -- --ignored --nocapture`; the results stand in `tests/validation/volumes.txt`.

use std::sync::Arc;
use std::time::Instant;

use welkin_proto::channel::Channel;
use welkin_proto::presets;
use welkin_proto::volume::subscribe::Subscription;
use welkin_proto::volume::{Bits, Compression, Encoder, Kind, Moment, Plane, Receiver, Taken};
use welkin_server::weather::{FieldSet, Weather};
use welkin_server::world::World;

/// Simulated seconds from message to message: two a wall second at the default scene's eight times real time.
const STEP_S: f64 = 4.0;
/// Messages of a keyframe's life.
const MESSAGES: usize = 16;

#[test]
#[ignore = "simulates two hours; prints figures"]
fn figures() {
    let mut world = World::new(presets::find(presets::DEFAULT).unwrap(), Some(2)).unwrap();
    world.advance_to(6300.0, |_| true);
    let channels = [
        Channel::ExtinctionPerM,
        Channel::WindXMS,
        Channel::WindZMS,
        Channel::TemperatureK,
        Channel::VapourKgKg,
        Channel::EddyDissipationRateM23S,
    ];
    let mut fields: Vec<Vec<Arc<[f32]>>> = Vec::new();
    for n in 0..MESSAGES {
        if n > 0 {
            world.advance_by(STEP_S);
        }
        let volume = world.snapshot().volume;
        let weather = Weather::new(world.weather(FieldSet::ALL, volume).unwrap(), n as u64);
        fields.push(channels.iter().map(|c| weather.field(*c).unwrap()).collect());
    }
    let domain = &world.scene().domain;
    println!(
        "{} at {:.0} s, {:?} cells; a message every {STEP_S} s",
        world.scene().name,
        world.simulated_s(),
        domain.cells
    );
    println!(
        "channel, mip, bits, packing: keyframe bytes, mean delta bytes, share of single precision, kB/s at 2 Hz, largest error, encode ms, decode ms"
    );
    for (c, channel) in channels.iter().enumerate() {
        for (mip, bits, compression) in [
            (2, Bits::Eight, Compression::Deflate),
            (2, Bits::Eight, Compression::Zstd),
            (2, Bits::Sixteen, Compression::Zstd),
            (1, Bits::Eight, Compression::Deflate),
            (0, Bits::Eight, Compression::Deflate),
            (0, Bits::Eight, Compression::Zstd),
        ] {
            let subscription = Subscription {
                mip,
                ..Subscription::default()
            };
            let layout = subscription.layout(domain.cells, domain.cell_size_m).unwrap();
            let plane = Plane {
                name: channel.name().to_owned(),
                curve: channel.curve(),
            };
            let mut encoder = Encoder::new(1, layout, vec![plane], bits, compression).unwrap();
            let mut receiver = Receiver::default();
            let (mut keyframes, mut deltas) = ((0, 0), (0, 0));
            let (mut encode_ms, mut decode_ms, mut error) = (0.0, 0.0, 0.0);
            for (n, field) in fields.iter().enumerate() {
                let moment = Moment {
                    tick: n as u64,
                    encoded_unix_s: 0.5 * n as f64,
                    ..Moment::default()
                };
                let began = Instant::now();
                let (kind, message) = encoder.encode(&moment, &[&field[c]]).unwrap();
                encode_ms += began.elapsed().as_secs_f64() * 1e3 / MESSAGES as f64;
                let began = Instant::now();
                let Taken::Field(taken) = receiver.take(&message).unwrap() else {
                    panic!("nothing is lost")
                };
                decode_ms += began.elapsed().as_secs_f64() * 1e3 / MESSAGES as f64;
                let values = taken.channels[0].values();
                error = values
                    .iter()
                    .fold(error, |e: f64, v| e.max(taken.channels[0].quantiser.error_max(*v)));
                let count = if kind == Kind::Keyframe {
                    &mut keyframes
                } else {
                    &mut deltas
                };
                *count = (count.0 + 1, count.1 + message.len());
            }
            let mean = |(count, bytes): (usize, usize)| bytes as f64 / count.max(1) as f64;
            let per_s = (keyframes.1 + deltas.1) as f64 / (0.5 * MESSAGES as f64);
            println!(
                "{}, {mip}, {}, {compression:?}: {:.0}, {:.0}, {:.1} %, {:.1}, {error:.2e} {}, {encode_ms:.2}, {decode_ms:.2}",
                channel.name(),
                u8::from(bits),
                mean(keyframes),
                mean(deltas),
                100.0 * per_s / 2.0 / (4 * layout.len()) as f64,
                per_s / 1e3,
                channel.unit(),
            );
            assert!(
                mip < 2 || per_s < 150e3,
                "{} at a quarter of the resolution",
                channel.name()
            );
        }
    }
}
