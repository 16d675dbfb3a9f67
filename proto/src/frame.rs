//! Frames on the wire: coding, quality, and the header before the coded image of a binary message.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::ApiError;

/// How a frame's bytes are coded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FrameFormat {
    /// Small, lossy.
    #[default]
    Jpeg,
    /// Lossless.
    Png,
    /// Lossless, smaller, slower.
    Webp,
}

/// How a picture's layers are coded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LayerFormat {
    /// PNG.
    #[default]
    Png,
    /// Little-endian 32-bit floats.
    F32,
}

/// How much a picture may cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FrameQuality {
    /// One ray a pixel.
    #[default]
    Live,
    /// Four rays a pixel, averaged as light, and finer coding of a JPEG: four times the time.
    Still,
    /// Live while anything moves; the still picture once world and camera have rested for half a second.
    Resting,
}

/// What is before a frame's coded image, little endian.
///
/// | bytes | what |
/// |---|---|
/// | 0..4 | `WLKF` |
/// | 4..6 | header version, u16, 1 or 2: the newest that the client said it reads |
/// | 6..8 | format, u16: 1 JPEG, 2 PNG, 3 WebP |
/// | 8..12 | width, u32 |
/// | 12..16 | height, u32 |
/// | 16..24 | tick, u64 |
/// | 24..32 | simulated seconds, f64 |
/// | 32..36 | milliseconds to render, f32 |
/// | 36..40 | milliseconds to encode, f32 |
/// | 40..44 | sequence number of this stream's frames, u32 |
/// | 44..48 | length of the image that follows the header, u32 |
///
/// Version 1 ends here. Version 2 goes on:
///
/// | bytes | what |
/// |---|---|
/// | 48..56 | when the frame was handed to the connection, milliseconds since 1970-01-01T00:00Z by the server's clock, f64 |
/// | 56..60 | milliseconds since the state that it shows was published, f32 |
/// | 60..64 | milliseconds that the frame waited: from when it was asked for or its state was published, whichever was later, until it was handed over, less rendering and encoding, f32 |
/// | 64..66 | quality, u16: 0 live, 1 still |
/// | 66..68 | 0 |
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameHeader {
    /// Coding of the image.
    pub format: FrameFormat,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Tick that is shown.
    pub tick: u64,
    /// Simulated second that is shown.
    pub simulated_s: f64,
    /// Wall milliseconds to render.
    pub render_ms: f32,
    /// Wall milliseconds to encode.
    pub encode_ms: f32,
    /// Counts this stream's frames from 0.
    pub sequence: u32,
    /// Bytes of the image.
    pub image_bytes: u32,
    /// What version 2 says besides; `None` is version 1.
    pub delivery: Option<FrameDelivery>,
}

/// How a frame came to be sent when it was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameDelivery {
    /// When it was handed to the connection, milliseconds since 1970-01-01T00:00Z by the server's clock.
    pub sent_unix_ms: f64,
    /// Wall milliseconds since the state that it shows was published.
    pub age_ms: f32,
    /// Wall milliseconds that it waited to be rendered and sent.
    pub wait_ms: f32,
    /// Whether it is the still picture.
    pub still: bool,
}

/// Bytes of a [`FrameHeader`] of version 1, with which every version begins.
pub const FRAME_HEADER_BYTES: usize = 48;
/// Bytes of a [`FrameHeader`] of version 2.
pub const FRAME_HEADER_2_BYTES: usize = 68;
/// Newest version of the frame header that this build reads and writes.
pub const FRAME_HEADER_VERSION: u16 = 2;
/// Longest side of a frame, pixels.
pub const FRAME_SIDE_MAX: u32 = 16_384;

const FRAME_MAGIC: [u8; 4] = *b"WLKF";

/// `N` bytes of a header from `from`; the header is longer than any such place.
fn bytes_at<const N: usize, const BYTES: usize>(header: &[u8; BYTES], from: usize) -> [u8; N] {
    std::array::from_fn(|i| header[from + i])
}

fn bad(why: String) -> ApiError {
    ApiError::new("bad_frame", why)
}

impl FrameHeader {
    /// The version that a client reads which names none.
    pub fn first_version() -> u16 {
        1
    }

    /// The header's bytes, as the table above says: version 2 where there is a delivery.
    pub fn encode(&self) -> Vec<u8> {
        let format: u16 = match self.format {
            FrameFormat::Jpeg => 1,
            FrameFormat::Png => 2,
            FrameFormat::Webp => 3,
        };
        let version: u16 = if self.delivery.is_some() { 2 } else { 1 };
        let mut bytes = Vec::with_capacity(FRAME_HEADER_2_BYTES);
        bytes.extend(FRAME_MAGIC);
        bytes.extend(version.to_le_bytes());
        bytes.extend(format.to_le_bytes());
        bytes.extend(self.width.to_le_bytes());
        bytes.extend(self.height.to_le_bytes());
        bytes.extend(self.tick.to_le_bytes());
        bytes.extend(self.simulated_s.to_le_bytes());
        bytes.extend(self.render_ms.to_le_bytes());
        bytes.extend(self.encode_ms.to_le_bytes());
        bytes.extend(self.sequence.to_le_bytes());
        bytes.extend(self.image_bytes.to_le_bytes());
        if let Some(delivery) = &self.delivery {
            bytes.extend(delivery.sent_unix_ms.to_le_bytes());
            bytes.extend(delivery.age_ms.to_le_bytes());
            bytes.extend(delivery.wait_ms.to_le_bytes());
            bytes.extend(u16::from(delivery.still).to_le_bytes());
            bytes.extend([0; 2]);
        }
        bytes
    }

    /// Reads a header and finds the image behind it, trusting nothing: `message` is one whole binary message.
    ///
    /// Errors, all with code `bad_frame`: too short, another magic or version, an unknown format or quality, a side of 0 or above
    /// [`FRAME_SIDE_MAX`], a time that is not finite or is negative, no image, or one shorter or longer than the header says.
    pub fn decode(message: &[u8]) -> Result<(FrameHeader, &[u8]), ApiError> {
        let too_short = |needed: usize| {
            let length = message.len();
            bad(format!("{length} bytes are too few: the header has {needed}"))
        };
        let (header, image) = message
            .split_first_chunk::<FRAME_HEADER_BYTES>()
            .ok_or_else(|| too_short(FRAME_HEADER_BYTES))?;
        if bytes_at::<4, _>(header, 0) != FRAME_MAGIC {
            return Err(bad("a frame begins with `WLKF`".to_owned()));
        }
        let (delivery, image) = match u16::from_le_bytes(bytes_at(header, 4)) {
            1 => (None, image),
            2 => {
                let (header, image) = message
                    .split_first_chunk::<FRAME_HEADER_2_BYTES>()
                    .ok_or_else(|| too_short(FRAME_HEADER_2_BYTES))?;
                (Some(FrameDelivery::decode(header)?), image)
            }
            version => {
                return Err(bad(format!(
                    "header version {version} is unknown; this build reads up to {FRAME_HEADER_VERSION}"
                )));
            }
        };
        let format = match u16::from_le_bytes(bytes_at(header, 6)) {
            1 => FrameFormat::Jpeg,
            2 => FrameFormat::Png,
            3 => FrameFormat::Webp,
            other => {
                return Err(bad(format!(
                    "format {other} is unknown; known are 1 JPEG, 2 PNG, 3 WebP"
                )));
            }
        };
        let decoded = FrameHeader {
            format,
            width: u32::from_le_bytes(bytes_at(header, 8)),
            height: u32::from_le_bytes(bytes_at(header, 12)),
            tick: u64::from_le_bytes(bytes_at(header, 16)),
            simulated_s: f64::from_le_bytes(bytes_at(header, 24)),
            render_ms: f32::from_le_bytes(bytes_at(header, 32)),
            encode_ms: f32::from_le_bytes(bytes_at(header, 36)),
            sequence: u32::from_le_bytes(bytes_at(header, 40)),
            image_bytes: u32::from_le_bytes(bytes_at(header, 44)),
            delivery,
        };
        let FrameHeader {
            width,
            height,
            image_bytes,
            ..
        } = decoded;
        if !(1..=FRAME_SIDE_MAX).contains(&width) || !(1..=FRAME_SIDE_MAX).contains(&height) {
            return Err(bad(format!(
                "{width} x {height} pixels; a side has 1 to {FRAME_SIDE_MAX}"
            )));
        }
        times_make_sense(&[
            decoded.simulated_s,
            f64::from(decoded.render_ms),
            f64::from(decoded.encode_ms),
        ])?;
        if image.is_empty() || u64::from(image_bytes) != image.len() as u64 {
            return Err(bad(format!(
                "the header says {image_bytes} bytes of image, {} follow it",
                image.len()
            )));
        }
        Ok((decoded, image))
    }
}

impl FrameDelivery {
    fn decode(header: &[u8; FRAME_HEADER_2_BYTES]) -> Result<Self, ApiError> {
        let delivery = FrameDelivery {
            sent_unix_ms: f64::from_le_bytes(bytes_at(header, 48)),
            age_ms: f32::from_le_bytes(bytes_at(header, 56)),
            wait_ms: f32::from_le_bytes(bytes_at(header, 60)),
            still: match u16::from_le_bytes(bytes_at(header, 64)) {
                0 => false,
                1 => true,
                other => return Err(bad(format!("quality {other} is unknown; known are 0 live, 1 still"))),
            },
        };
        times_make_sense(&[
            delivery.sent_unix_ms,
            f64::from(delivery.age_ms),
            f64::from(delivery.wait_ms),
        ])?;
        Ok(delivery)
    }
}

fn times_make_sense(times: &[f64]) -> Result<(), ApiError> {
    match times.iter().find(|time| !time.is_finite() || **time < 0.0) {
        Some(time) => Err(bad(format!("a time of {time} is neither finite nor positive"))),
        None => Ok(()),
    }
}
