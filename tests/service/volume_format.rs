//! The volume messages: error bounds, healing, test vectors, a reader in another language, and bytes that strangers send.

#[path = "volume_vectors.rs"]
mod vectors;

use std::path::Path;
use std::process::Command;

use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use vectors::{FOLDER, VIEW, air, layout, message_of, moment};
use welkin_proto::channel::Channel;
use welkin_proto::volume::{
    Bits, Compression, Curve, DecodeLimits, Encoder, Header, Kind, Plane, Quantiser, Receiver, Region, Taken,
    VolumeError,
    subscribe::{RegionCells, RegionM, Subscription},
};

/// Besides the stated bound a value is rounded to single precision once.
const ROUNDING: f64 = 6e-8;

fn cases(count: u32) -> Config {
    Config {
        failure_persistence: None,
        ..Config::with_cases(count)
    }
}

fn cases_run<S: Strategy>(count: u32, strategy: &S, mut test: impl FnMut(S::Value) -> Result<(), TestCaseError>) {
    let test = std::cell::RefCell::new(&mut test);
    TestRunner::new(cases(count))
        .run(strategy, |value| test.borrow_mut()(value))
        .unwrap();
}

fn planes() -> Vec<Plane> {
    ["extinction_per_m", "wind_x_m_s"]
        .map(|name| Plane {
            name: name.to_owned(),
            curve: Channel::named(name).unwrap().curve(),
        })
        .to_vec()
}

/// The means that a message's cells stand for, computed in the plainest way.
fn means(layout: &welkin_proto::volume::Layout, field: &[f32]) -> Vec<f64> {
    let edge = 1 << layout.mip;
    let [wx, wy, _] = layout.world_cells.map(|n| n as usize);
    let [nx, ny, nz] = layout.cells();
    let mut means = Vec::new();
    for cell in 0..nx * ny * nz {
        let at = [cell % nx, cell / nx % ny, cell / nx / ny];
        let (mut sum, mut count) = (0.0, 0.0);
        for inner in 0..edge * edge * edge {
            let inner = [inner % edge, inner / edge % edge, inner / edge / edge];
            let fine = [0, 1, 2].map(|a| at[a] * edge + inner[a]);
            if (0..3).all(|a| fine[a] < layout.region.cells[a] as usize) {
                let [x, y, z] = [0, 1, 2].map(|a| fine[a] + layout.region.from[a] as usize);
                sum += f64::from(field[(z * wy + y) * wx + x]);
                count += 1.0;
            }
        }
        means.push(sum / count);
    }
    means
}

#[test]
fn what_is_decoded_lies_within_the_stated_bound_of_the_mean_of_its_cells() {
    for (bits, mip, share) in [
        (Bits::Eight, 0, 2.7e-3),
        (Bits::Eight, 2, 2.7e-3),
        (Bits::Sixteen, 1, 1.1e-5),
    ] {
        let layout = layout(mip);
        let mut encoder = Encoder::new(VIEW, layout, planes(), bits, Compression::Zstd).unwrap();
        let fields = [air(0.0, 0), air(0.0, 1)];
        let (_, message) = encoder.encode(&moment(1), &[&fields[0], &fields[1]]).unwrap();
        let mut receiver = Receiver::default();
        let Taken::Field(field) = receiver.take(&message).unwrap() else {
            panic!("a keyframe makes a field")
        };
        for (channel, exact) in field.channels.iter().zip(&fields) {
            let exact = means(&layout, exact);
            let (low, high) = exact
                .iter()
                .fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
            assert!(high > low, "the test's field varies");
            for (got, wanted) in channel.values().iter().zip(&exact) {
                let error = (f64::from(*got) - wanted).abs();
                // The mean itself is rounded to single precision before it is quantised.
                let most = channel.quantiser.error_max(*wanted as f32) + 2.0 * ROUNDING * wanted.abs();
                assert!(error <= most, "{}: {got} for {wanted}, bound {most}", channel.name);
            }
            // What PROTOCOL.md promises of the server's scales.
            let stated = match channel.quantiser.curve {
                Curve::Linear => share * (high - low),
                Curve::Square => 2.0 * share * high,
            };
            assert!(channel.quantiser.error_max(high as f32) <= stated, "{}", channel.name);
        }
        // Sum of value times volume, as the world's cells have it: the mean keeps mass, quantising it costs no more than its bound.
        let extinction = field.channel("extinction_per_m").unwrap();
        let mass: f64 = fields[0].iter().map(|v| f64::from(*v)).sum();
        let edge = 1 << mip;
        let [nx, ny, _] = layout.cells();
        let (mut sum, mut bound) = (0.0, 0.0);
        for (n, value) in extinction.values().iter().enumerate() {
            let at = [n % nx, n / nx % ny, n / nx / ny];
            let cells: usize = (0..3)
                .map(|a| edge.min(layout.region.cells[a] as usize - at[a] * edge))
                .product();
            sum += f64::from(*value) * cells as f64;
            bound += extinction.quantiser.error_max(*value) * cells as f64;
        }
        assert!((sum - mass).abs() <= bound, "{sum} for {mass}, bound {bound}");
        // Errors lean to no side, so that the sum is far better than its bound.
        assert!((sum / mass - 1.0).abs() < 0.01, "{sum} for {mass}");
    }
}

#[test]
fn a_quantiser_holds_its_bound_over_its_whole_range() {
    let mut runner = TestRunner::new(cases(20_000));
    let range = (-1e6f32..1e6, 0f32..1.0, -30i32..6, 0f32..=1.0);
    runner
        .run(&range, |(low, width, exponent, part)| {
            let width = width * 10f32.powi(exponent);
            for (curve, low) in [(Curve::Linear, low), (Curve::Square, 0.0)] {
                let high = low + width;
                for bits in [Bits::Eight, Bits::Sixteen] {
                    let quantiser = Quantiser::for_range(curve, bits, low, high);
                    let value = (low + part * (high - low)).clamp(low, high);
                    let got = quantiser.value(quantiser.code(value));
                    let error = (f64::from(got) - f64::from(value)).abs();
                    let most = quantiser.error_max(value) * (1.0 + 1e-9) + ROUNDING * f64::from(value.abs());
                    prop_assert!(error <= most, "{quantiser:?}: {got} for {value}, bound {most}");
                }
            }
            Ok(())
        })
        .unwrap();
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e15, -1e15, 1e-45] {
        for curve in [Curve::Linear, Curve::Square] {
            let quantiser = Quantiser::for_range(curve, Bits::Eight, 0.0, value);
            assert!(quantiser.value(quantiser.code(value)).is_finite(), "{curve:?} {value}");
            assert!(quantiser.scale.is_finite());
        }
    }
}

/// A view's messages as its field drifts.
fn drifting(count: u32, bits: Bits, compression: Compression) -> Vec<(Kind, Vec<u8>)> {
    let mut encoder = Encoder::new(VIEW, layout(0), planes(), bits, compression).unwrap();
    (0..count)
        .map(|n| {
            // The wind changes in one corner only, so that deltas leave bricks out.
            let mut wind = air(0.0, 1);
            wind[0] += 0.5 * n as f32;
            encoder
                .encode(&moment(n.into()), &[&air(0.3 * n as f32, 0), &wind])
                .unwrap()
        })
        .collect()
}

#[test]
fn whatever_is_lost_a_field_is_right_or_not_there_and_heals_with_a_keyframe() {
    let messages = drifting(60, Bits::Eight, Compression::Deflate);
    let keyframes: Vec<usize> = (0..60).filter(|n| messages[*n].0 == Kind::Keyframe).collect();
    assert!(keyframes.len() >= 4 && keyframes.len() < 30, "{keyframes:?}");
    assert!(keyframes.windows(2).all(|k| k[1] - k[0] <= 16), "{keyframes:?}");
    let mut whole = Receiver::default();
    let fields: Vec<_> = messages
        .iter()
        .map(|(_, message)| match whole.take(message).unwrap() {
            Taken::Field(field) => field,
            other => panic!("nothing is lost: {other:?}"),
        })
        .collect();
    let mut runner = TestRunner::new(cases(200));
    // Which messages are lost, and which change places with the one after.
    let plan = (
        prop::collection::vec(any::<bool>(), 60),
        prop::collection::vec(0..10u8, 60),
    );
    runner
        .run(&plan, |(lost, swaps)| {
            let mut order: Vec<usize> = (0..60).filter(|n| !lost[*n]).collect();
            for n in 1..order.len() {
                if swaps[n] == 0 {
                    order.swap(n - 1, n);
                }
            }
            let mut receiver = Receiver::default();
            let mut holds_keyframe = false;
            for n in order {
                match receiver.take(&messages[n].1).unwrap() {
                    Taken::Field(field) => {
                        prop_assert_eq!(&field.channels, &fields[n].channels);
                        prop_assert_eq!(field.sequence as usize, n);
                        holds_keyframe = true;
                    }
                    Taken::NeedsKeyframe => prop_assert_eq!(messages[n].0, Kind::Delta),
                    Taken::Stale => prop_assert!(holds_keyframe),
                }
                // Any keyframe that is not late gives the field at once.
                if messages[n].0 == Kind::Keyframe {
                    prop_assert!(receiver.newest().is_some_and(|f| f.sequence as usize >= n));
                }
            }
            Ok(())
        })
        .unwrap();
}

#[test]
fn a_delta_costs_what_changed() {
    let mut encoder = Encoder::new(VIEW, layout(0), planes(), Bits::Eight, Compression::None).unwrap();
    let (extinction, wind) = (air(0.0, 0), air(0.0, 1));
    let (_, keyframe) = encoder.encode(&moment(0), &[&extinction, &wind]).unwrap();
    let (kind, still) = encoder.encode(&moment(1), &[&extinction, &wind]).unwrap();
    let header = Header::decode(&still).unwrap().0;
    assert_eq!(kind, Kind::Delta);
    assert_eq!(
        header.raw_bytes as usize,
        2 * header.layout.brick_count(),
        "a mode a brick and nothing else"
    );
    let mut other = extinction.clone();
    let changed = other.iter().position(|v| *v > 0.0).unwrap();
    other[changed] *= 1.5;
    let (_, one) = encoder.encode(&moment(2), &[&other, &wind]).unwrap();
    let more = one.len() - still.len();
    assert!((1..=8 * 8 * 8).contains(&more), "one brick of {more} bytes");
    assert!(keyframe.len() > 2 * one.len());
}

#[test]
fn a_clear_sky_costs_next_to_nothing() {
    let cells = 64 * 64 * 75;
    let layout = welkin_proto::volume::Layout {
        world_cells: [64, 64, 75],
        cell_size_m: [100.0, 100.0, 40.0],
        region: Region::whole([64, 64, 75]),
        mip: 0,
        brick: [8; 3],
    };
    let plane = planes()[..1].to_vec();
    for compression in [Compression::Deflate, Compression::Zstd] {
        let mut encoder = Encoder::new(VIEW, layout, plane.clone(), Bits::Eight, compression).unwrap();
        let (_, message) = encoder.encode(&moment(0), &[&vec![0.0; cells]]).unwrap();
        assert!(message.len() < 230, "{} bytes", message.len());
        let Taken::Field(field) = Receiver::default().take(&message).unwrap() else {
            panic!("a keyframe makes a field")
        };
        assert!(field.channels[0].codes.iter().all(|c| *c == 0));
    }
}

#[test]
fn test_vectors_hold() {
    let folder = Path::new(FOLDER);
    let text = std::fs::read_to_string(folder.join("vectors.json")).unwrap();
    let document: serde_json::Value = serde_json::from_str(&text).unwrap();
    let read = |name: &serde_json::Value| std::fs::read(folder.join(name.as_str().unwrap())).unwrap();
    for vector in document["good"].as_array().unwrap() {
        let mut receiver = Receiver::default();
        let mut result = "";
        for name in vector["messages"].as_array().unwrap() {
            result = match receiver.take(&read(name)).unwrap_or_else(|e| panic!("{name}: {e}")) {
                Taken::Field(_) => "field",
                Taken::Stale => "stale",
                Taken::NeedsKeyframe => "needs_keyframe",
            };
        }
        assert_eq!(vector["result"], result, "{vector}");
        let Some(values) = vector["values"].as_object() else {
            continue;
        };
        let field = receiver.newest().unwrap();
        assert_eq!(vector["header"]["tick"], field.moment.tick);
        assert_eq!(vector["header"]["cells"], serde_json::json!(field.layout.cells()));
        for (name, wanted) in values {
            let wanted: Vec<f32> = serde_json::from_value(wanted.clone()).unwrap();
            assert_eq!(field.channel(name).unwrap().values(), wanted, "{name}");
        }
    }
    for vector in document["bad"].as_array().unwrap() {
        let refused = Receiver::default().take(&read(&vector["message"])).unwrap_err();
        assert_eq!(vectors::kind_of(&refused), vector["rust"], "{vector}: {refused}");
    }
}

#[test]
fn a_reader_of_another_language_reads_the_vectors() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("python/volume_reader.py");
    let ran = Command::new("python3").arg("-B").arg(script).arg(FOLDER).output();
    let output = match ran {
        Ok(output) => output,
        Err(error) => {
            welkin_tests::skip("a_reader_of_another_language_reads_the_vectors", "python", error);
            return;
        }
    };
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(
        output.status.success(),
        "{said}{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert!(said.contains("vectors hold"), "{said}");
}

/// Bytes that are no message, or that were one: never a panic, never more memory than the limits, and what is taken is a field of its header's size.
fn fuzz(count: u32) {
    let limits = DecodeLimits { values_max: 1 << 16 };
    let all: Vec<Vec<u8>> = [Compression::None, Compression::Deflate, Compression::Zstd]
        .into_iter()
        .flat_map(|compression| [Bits::Eight, Bits::Sixteen].map(|bits| drifting(2, bits, compression)))
        .flatten()
        .map(|(_, message)| message)
        .collect();
    let edits = prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..6u8), 0..6);
    let plan = (
        any::<prop::sample::Index>(),
        edits,
        any::<prop::sample::Index>(),
        0..4u8,
        any::<u32>(),
    );
    let mut runner = TestRunner::new(cases(count));
    runner
        .run(&plan, |(which, edits, cut, how, word)| {
            let n = which.index(all.len());
            let mut message = all[n].clone();
            for (at, byte, how) in edits {
                // Half of the edits go to the header, where every byte means something.
                let within = if how < 3 { 200.min(message.len()) } else { message.len() };
                let at = at.index(within);
                match how % 3 {
                    0 => message[at] = byte,
                    1 => message[at] ^= 1 << (byte % 8),
                    _ => {
                        let word = word.rotate_left(byte.into()).to_le_bytes();
                        let end = (at + 4).min(message.len());
                        message[at..end].copy_from_slice(&word[..end - at]);
                    }
                }
            }
            match how {
                0 => message.truncate(cut.index(message.len() + 1)),
                1 => message.extend_from_slice(&word.to_le_bytes()),
                _ => {}
            }
            let mut receiver = Receiver::new(limits);
            // A delta finds the keyframe before it.
            if n % 2 == 1 {
                receiver.take(&all[n - 1]).expect("it is good");
            }
            let held = receiver.newest().cloned();
            match receiver.take(&message) {
                Ok(Taken::Field(field)) => {
                    for channel in &field.channels {
                        prop_assert_eq!(channel.codes.len(), field.layout.len());
                    }
                    prop_assert!((field.layout.len() * field.channels.len()) as u64 <= limits.values_max);
                }
                Ok(_) | Err(_) => prop_assert_eq!(receiver.newest(), held.as_ref()),
            }
            Ok(())
        })
        .unwrap();
}

#[test]
fn forged_messages_do_no_harm() {
    fuzz(100_000);
}

#[test]
#[ignore = "some minutes: five million cases"]
fn forged_messages_do_no_harm_for_long() {
    fuzz(5_000_000);
}

#[test]
fn random_bytes_are_refused() {
    let mut runner = TestRunner::new(cases(20_000));
    runner
        .run(&prop::collection::vec(any::<u8>(), 0..600), |mut bytes| {
            prop_assert!(Receiver::default().take(&bytes).is_err());
            // Past the first checks too.
            if bytes.len() > 8 {
                bytes[..8].copy_from_slice(b"WLKV\x01\0\x01\x01");
                prop_assert!(Receiver::default().take(&bytes).is_err());
            }
            Ok(())
        })
        .unwrap();
}

#[test]
fn whatever_region_is_asked_for_it_lies_within_the_world_or_is_refused() {
    let number = prop_oneof![
        -10.0..3000.0f64,
        any::<f64>(),
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(2000.0),
        Just(0.0)
    ];
    let index = prop_oneof![0..25u32, any::<u32>()];
    let metres = prop::option::of((prop::array::uniform3(number.clone()), prop::array::uniform3(number)));
    let cells = prop::option::of((prop::array::uniform3(index.clone()), prop::array::uniform3(index)));
    let world = (prop::array::uniform3(1..40u32), prop::array::uniform3(0.1..200.0f64));
    let mut taken = 0;
    cases_run(
        20_000,
        &(metres, cells, world, 0..9u8),
        |(metres, cells, (world, size_m), mip)| {
            let subscription = Subscription {
                region_m: metres.map(|(from, to)| RegionM { from, to }),
                region_cells: cells.map(|(from, cells)| RegionCells { from, cells }),
                mip,
                ..Subscription::default()
            };
            if let Ok(layout) = subscription.layout(world, size_m) {
                taken += 1;
                prop_assert_eq!(layout.check(), Ok(()));
                let cells = layout.cells();
                prop_assert!((0..3).all(|a| cells[a] >= 1 && cells[a] <= world[a] as usize));
                // What was asked for is in it.
                if let Some((from, cells)) = cells_asked(&subscription) {
                    let region = layout.region;
                    prop_assert!((0..3).all(|a| region.from[a] <= from[a]));
                    prop_assert!((0..3).all(|a| region.from[a] + region.cells[a] >= from[a] + cells[a]));
                }
            }
            Ok(())
        },
    );
    assert!(taken > 1000, "{taken} were taken");
}

fn cells_asked(subscription: &Subscription) -> Option<([u32; 3], [u32; 3])> {
    subscription.region_cells.map(|r| (r.from, r.cells))
}

#[test]
fn a_bomb_is_refused_before_it_is_unpacked() {
    // A header that announces more than its cells can have, one that announces more cells than are taken, and a body that goes on after its announced end.
    let good = message_of(Bits::Eight, Compression::Deflate);
    let mut bomb = good.clone();
    bomb[144..148].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(matches!(
        Receiver::default().take(&bomb),
        Err(VolumeError::TooLarge { .. })
    ));
    let mut vast = good.clone();
    for at in [80, 84, 88, 104, 108, 112] {
        vast[at..at + 4].copy_from_slice(&65536u32.to_le_bytes());
    }
    assert!(matches!(
        Receiver::default().take(&vast),
        Err(VolumeError::TooLarge { .. })
    ));
    let (header, body) = Header::decode(&good).unwrap();
    for less in [1, header.raw_bytes / 2] {
        let mut long = good[..good.len() - body.len()].to_vec();
        long[144..148].copy_from_slice(&(header.raw_bytes - less).to_le_bytes());
        long.extend_from_slice(body);
        assert!(matches!(
            Receiver::default().take(&long),
            Err(VolumeError::Compression(_))
        ));
    }
}

#[test]
fn subscriptions_are_judged() {
    let (cells, size_m) = ([20, 12, 10], [100.0, 100.0, 40.0]);
    let of = |edit: &dyn Fn(&mut Subscription)| {
        let mut subscription = Subscription::default();
        edit(&mut subscription);
        subscription
    };
    let whole = Subscription::default().layout(cells, size_m).unwrap();
    assert_eq!((whole.region, whole.cells()), (Region::whole(cells), [20, 12, 10]));
    // Metres and cells that mean the same are the same view; both are widened to whole cells of the mip.
    let in_cells = of(&|s| {
        s.mip = 2;
        s.region_cells = Some(RegionCells {
            from: [5, 0, 0],
            cells: [2, 12, 9],
        });
    });
    let in_metres = of(&|s| {
        s.mip = 2;
        s.region_m = Some(RegionM {
            from: [501.0, 0.0, 0.0],
            to: [699.0, 1200.0, 350.0],
        });
    });
    let layout = in_cells.layout(cells, size_m).unwrap();
    assert_eq!(
        layout.region,
        Region {
            from: [4, 0, 0],
            cells: [4, 12, 10]
        }
    );
    assert_eq!(layout, in_metres.layout(cells, size_m).unwrap());
    let region_m = |from, to| of(&|s| s.region_m = Some(RegionM { from, to }));
    let region_cells = |from, cells| of(&|s| s.region_cells = Some(RegionCells { from, cells }));
    let inf = f64::INFINITY;
    for (subscription, code) in [
        (of(&|s| s.mip = 7), "out_of_range"),
        (of(&|s| s.mip = 255), "out_of_range"),
        (region_cells([0; 3], [0, 1, 1]), "bad_region"),
        (region_cells([0; 3], [21, 1, 1]), "bad_region"),
        (region_cells([u32::MAX; 3], [u32::MAX; 3]), "bad_region"),
        (region_m([0.0; 3], [0.0; 3]), "bad_region"),
        (region_m([-1.0, 0.0, 0.0], [10.0; 3]), "bad_region"),
        (region_m([f64::NAN; 3], [10.0; 3]), "bad_region"),
        (region_m([0.0; 3], [inf; 3]), "bad_region"),
        (region_m([0.0; 3], [2000.1, 10.0, 10.0]), "bad_region"),
    ] {
        let error = subscription.layout(cells, size_m).expect_err("it is absurd");
        assert_eq!(error.code, code, "{subscription:?}");
        assert!(error.pointer.is_some());
    }
    let named = |names: &[&str]| {
        let channels = names.iter().map(|n| (*n).to_owned()).collect();
        Subscription {
            channels,
            ..Subscription::default()
        }
        .named_channels()
    };
    assert_eq!(named(&["wind_x_m_s"]).unwrap(), [Channel::WindXMS]);
    for (names, code) in [
        (&[][..], "out_of_range"),
        (&["wind_x_m_s"; 17], "out_of_range"),
        (&["wind_x_m_s"; 2], "duplicate_channel"),
        (&["soup"], "unknown_channel"),
        (&["rain_rate_mm_h"], "channel_unavailable"),
    ] {
        assert_eq!(named(names).expect_err("it is absurd").code, code, "{names:?}");
    }
}
