//! The frame header: there and back, and bytes that a stranger would send.

use welkin_proto::wire::{
    FRAME_HEADER_2_BYTES, FRAME_HEADER_BYTES, FRAME_SIDE_MAX, FrameDelivery, FrameFormat, FrameHeader,
};

fn header(image: &[u8]) -> FrameHeader {
    FrameHeader {
        format: FrameFormat::Webp,
        width: 640,
        height: 360,
        tick: u64::MAX - 7,
        simulated_s: 5400.25,
        render_ms: 41.5,
        encode_ms: 3.25,
        sequence: 0xDEAD_BEEF,
        image_bytes: u32::try_from(image.len()).expect("a small image"),
        delivery: None,
    }
}

fn second(image: &[u8]) -> FrameHeader {
    FrameHeader {
        delivery: Some(FrameDelivery {
            sent_unix_ms: 1_795_338_000_123.5,
            age_ms: 96.5,
            wait_ms: 20.25,
            still: true,
        }),
        ..header(image)
    }
}

fn message(header: &FrameHeader, image: &[u8]) -> Vec<u8> {
    [header.encode().as_slice(), image].concat()
}

fn refused(bytes: &[u8], part: &str) {
    let error = FrameHeader::decode(bytes).expect_err(part);
    assert_eq!(error.code, "bad_frame");
    assert!(error.message.contains(part), "{part}: {error}");
}

#[test]
fn there_and_back() {
    for format in [FrameFormat::Jpeg, FrameFormat::Png, FrameFormat::Webp] {
        let sent = FrameHeader {
            format,
            ..header(b"image")
        };
        let bytes = message(&sent, b"image");
        assert_eq!(bytes.len(), FRAME_HEADER_BYTES + 5);
        let (read, image) = FrameHeader::decode(&bytes).expect("our own bytes");
        assert_eq!(read, sent);
        assert_eq!(image, b"image");
    }
    let bytes = message(&second(b"image"), b"image");
    assert_eq!(bytes.len(), FRAME_HEADER_2_BYTES + 5);
    assert_eq!(
        FrameHeader::decode(&bytes).expect("our own bytes"),
        (second(b"image"), b"image".as_slice())
    );
}

#[test]
fn the_second_version_goes_on_where_the_first_ends() {
    let (first, second) = (header(b"image").encode(), second(b"image").encode());
    assert_eq!((first.len(), second.len()), (FRAME_HEADER_BYTES, FRAME_HEADER_2_BYTES));
    assert_eq!(second[4..6], [2, 0]);
    assert_eq!(second[6..48], first[6..48]);
    assert_eq!(second[48..56], 1_795_338_000_123.5_f64.to_le_bytes());
    assert_eq!(second[56..60], 96.5_f32.to_le_bytes());
    assert_eq!(second[60..64], 20.25_f32.to_le_bytes());
    assert_eq!(second[64..68], [1, 0, 0, 0]);
}

#[test]
fn the_bytes_lie_where_the_table_says() {
    let bytes = header(b"image").encode();
    assert_eq!(&bytes[0..4], b"WLKF");
    assert_eq!(bytes[4..8], [1, 0, 3, 0]);
    assert_eq!(bytes[8..16], [0x80, 0x02, 0, 0, 0x68, 0x01, 0, 0]);
    assert_eq!(bytes[16..24], (u64::MAX - 7).to_le_bytes());
    assert_eq!(bytes[24..32], 5400.25_f64.to_le_bytes());
    assert_eq!(bytes[32..36], 41.5_f32.to_le_bytes());
    assert_eq!(bytes[36..40], 3.25_f32.to_le_bytes());
    assert_eq!(bytes[40..48], [0xEF, 0xBE, 0xAD, 0xDE, 5, 0, 0, 0]);
}

#[test]
fn truncated_anywhere() {
    for header in [header(b"image"), second(b"image")] {
        let whole = message(&header, b"image");
        for length in 0..whole.len() {
            assert_eq!(
                FrameHeader::decode(&whole[..length]).expect_err("cut").code,
                "bad_frame",
                "{length} bytes"
            );
        }
        refused(&[whole.as_slice(), b"x"].concat(), "follow");
    }
    refused(&message(&header(b""), b""), "follow");
}

#[test]
fn forged() {
    let good = header(b"image");
    let forged = |place: usize, value: &[u8]| {
        let mut bytes = message(&good, b"image");
        bytes[place..place + value.len()].copy_from_slice(value);
        bytes
    };
    refused(&forged(0, b"RIFF"), "WLKF");
    refused(&forged(4, &3_u16.to_le_bytes()), "version");
    refused(&forged(4, &0_u16.to_le_bytes()), "version");
    refused(&forged(4, &2_u16.to_le_bytes()), "too few");
    refused(&forged(6, &0_u16.to_le_bytes()), "format");
    refused(&forged(6, &4_u16.to_le_bytes()), "format");
    refused(&forged(8, &0_u32.to_le_bytes()), "pixels");
    refused(&forged(12, &(FRAME_SIDE_MAX + 1).to_le_bytes()), "pixels");
    refused(&forged(24, &f64::NAN.to_le_bytes()), "time");
    refused(&forged(24, &(-1.0_f64).to_le_bytes()), "time");
    refused(&forged(32, &f32::INFINITY.to_le_bytes()), "time");
    refused(&forged(36, &f32::NAN.to_le_bytes()), "time");
    refused(&forged(44, &u32::MAX.to_le_bytes()), "follow");
    refused(&[0xFF; 64], "WLKF");
    let second = |place: usize, value: &[u8]| {
        let mut bytes = message(&second(b"image"), b"image");
        bytes[place..place + value.len()].copy_from_slice(value);
        bytes
    };
    refused(&second(48, &f64::NAN.to_le_bytes()), "time");
    refused(&second(56, &(-1.0_f32).to_le_bytes()), "time");
    refused(&second(60, &f32::INFINITY.to_le_bytes()), "time");
    refused(&second(64, &2_u16.to_le_bytes()), "quality");
}
