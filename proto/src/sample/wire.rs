//! The binary messages of `/v1/worlds/{id}/samples`; all numbers little endian.

use super::Quantity;
use crate::error::ApiError;

/// Version of both messages that this build reads and writes.
pub const SAMPLES_VERSION: u16 = 1;
/// Bytes before the positions of a [`PositionsMessage`].
pub const POSITIONS_HEADER_BYTES: usize = 16;
/// Bytes before the channels' numbers of a [`SamplesMessage`].
pub const SAMPLES_HEADER_BYTES: usize = 48;

const POSITIONS_MAGIC: [u8; 4] = *b"WLKP";
const SAMPLES_MAGIC: [u8; 4] = *b"WLKS";

/// In which words places are given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Places {
    /// Local metres: east, north, up.
    Local,
    /// Latitude (degrees), longitude (degrees), altitude above mean sea level (m).
    Geographic,
}

/// Where everybody is, from the client.
///
/// | bytes | what |
/// |---|---|
/// | 0..4 | `WLKP` |
/// | 4..6 | version, u16, 1 |
/// | 6..8 | places, u16: 1 local metres, 2 latitude, longitude, altitude |
/// | 8..12 | number of positions n, u32 |
/// | 12..16 | the client's number of this message, u32 |
/// | then | n times three f64 |
#[derive(Clone, Debug, PartialEq)]
pub struct PositionsMessage {
    /// What the positions are.
    pub places: Places,
    /// The client's number of this message.
    pub number: u32,
    /// The positions.
    pub positions: Vec<[f64; 3]>,
}

/// The air at those positions, from the server.
///
/// | bytes | what |
/// |---|---|
/// | 0..4 | `WLKS` |
/// | 4..6 | version, u16, 1 |
/// | 6..8 | number of channels c, u16 |
/// | 8..12 | number of positions n, u32 |
/// | 12..16 | sequence of this connection's answers, u32 |
/// | 16..20 | number of the positions message that is answered, u32 |
/// | 20..24 | 0 |
/// | 24..32 | tick, u64 |
/// | 32..40 | simulated seconds, f64 |
/// | 40..48 | when the world published this weather, Unix seconds by the server's clock, f64 |
/// | 48.. | c bytes: the channels' numbers ([`Quantity::number`]); then zeros up to a multiple of four bytes |
/// | then | c columns of n f32 in the channels' order; NaN where a position is outside |
#[derive(Clone, Debug, PartialEq)]
pub struct SamplesMessage {
    /// Sequence of this connection's answers.
    pub sequence: u32,
    /// The number of the positions that are answered.
    pub number: u32,
    /// Tick.
    pub tick: u64,
    /// Simulated seconds.
    pub simulated_s: f64,
    /// When the world published this weather, Unix seconds.
    pub wall_unix_s: f64,
    /// The channels.
    pub quantities: Vec<Quantity>,
    /// A column a channel, all of the same length.
    pub columns: Vec<Vec<f32>>,
}

fn bad(why: String) -> ApiError {
    ApiError::new("bad_message", why)
}

/// `N` bytes from `from`, which the caller knows to be there.
fn bytes_at<const N: usize>(bytes: &[u8], from: usize) -> [u8; N] {
    std::array::from_fn(|i| bytes[from + i])
}

fn checked(message: &[u8], magic: [u8; 4], header_bytes: usize) -> Result<&[u8], ApiError> {
    if message.len() < header_bytes {
        return Err(bad(format!(
            "{} bytes are too few: a header has {header_bytes}",
            message.len()
        )));
    }
    if message[..4] != magic {
        return Err(bad(format!("it must begin with `{}`", String::from_utf8_lossy(&magic))));
    }
    match u16::from_le_bytes(bytes_at(message, 4)) {
        SAMPLES_VERSION => Ok(message),
        other => Err(bad(format!(
            "version {other} is unknown; this build reads {SAMPLES_VERSION}"
        ))),
    }
}

fn of_length(message: &[u8], wanted: u64) -> Result<(), ApiError> {
    if message.len() as u64 == wanted {
        return Ok(());
    }
    Err(bad(format!("its header says {wanted} bytes, it has {}", message.len())))
}

impl PositionsMessage {
    /// The message's bytes, as the table above says.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(POSITIONS_HEADER_BYTES + 24 * self.positions.len());
        bytes.extend(POSITIONS_MAGIC);
        bytes.extend(SAMPLES_VERSION.to_le_bytes());
        let places: u16 = match self.places {
            Places::Local => 1,
            Places::Geographic => 2,
        };
        bytes.extend(places.to_le_bytes());
        bytes.extend((self.positions.len() as u32).to_le_bytes());
        bytes.extend(self.number.to_le_bytes());
        bytes.extend(self.positions.iter().flatten().flat_map(|v| v.to_le_bytes()));
        bytes
    }

    /// Reads a message, trusting nothing; values that are not finite are left to who uses them. Errors: `bad_message`.
    pub fn decode(message: &[u8]) -> Result<Self, ApiError> {
        let message = checked(message, POSITIONS_MAGIC, POSITIONS_HEADER_BYTES)?;
        let places = match u16::from_le_bytes(bytes_at(message, 6)) {
            1 => Places::Local,
            2 => Places::Geographic,
            other => {
                return Err(bad(format!(
                    "places {other} are unknown; known are 1 local, 2 geographic"
                )));
            }
        };
        let count = u32::from_le_bytes(bytes_at(message, 8));
        of_length(message, POSITIONS_HEADER_BYTES as u64 + 24 * u64::from(count))?;
        let positions = message[POSITIONS_HEADER_BYTES..].chunks_exact(24);
        Ok(Self {
            places,
            number: u32::from_le_bytes(bytes_at(message, 12)),
            positions: positions
                .map(|p| [0, 8, 16].map(|from| f64::from_le_bytes(bytes_at(p, from))))
                .collect(),
        })
    }
}

impl SamplesMessage {
    /// The message's bytes, as the table above says.
    pub fn encode(&self) -> Vec<u8> {
        let count = self.columns.first().map_or(0, Vec::len);
        let head = SAMPLES_HEADER_BYTES + self.quantities.len().next_multiple_of(4);
        let mut bytes = Vec::with_capacity(head + 4 * count * self.columns.len());
        bytes.extend(SAMPLES_MAGIC);
        bytes.extend(SAMPLES_VERSION.to_le_bytes());
        bytes.extend((self.quantities.len() as u16).to_le_bytes());
        bytes.extend((count as u32).to_le_bytes());
        bytes.extend(self.sequence.to_le_bytes());
        bytes.extend(self.number.to_le_bytes());
        bytes.extend([0; 4]);
        bytes.extend(self.tick.to_le_bytes());
        bytes.extend(self.simulated_s.to_le_bytes());
        bytes.extend(self.wall_unix_s.to_le_bytes());
        bytes.extend(self.quantities.iter().map(|q| q.number()));
        bytes.resize(head, 0);
        bytes.extend(self.columns.iter().flatten().flat_map(|v| v.to_le_bytes()));
        bytes
    }

    /// Reads a message, trusting nothing. Errors: `bad_message`.
    pub fn decode(message: &[u8]) -> Result<Self, ApiError> {
        let message = checked(message, SAMPLES_MAGIC, SAMPLES_HEADER_BYTES)?;
        let channels = usize::from(u16::from_le_bytes(bytes_at(message, 6)));
        let count = u32::from_le_bytes(bytes_at(message, 8));
        let head = SAMPLES_HEADER_BYTES + channels.next_multiple_of(4);
        of_length(message, head as u64 + 4 * channels as u64 * u64::from(count))?;
        let quantities = message[SAMPLES_HEADER_BYTES..][..channels].iter().map(|&number| {
            Quantity::numbered(number).ok_or_else(|| bad(format!("channel {number} is unknown to this build")))
        });
        let quantities = quantities.collect::<Result<Vec<Quantity>, ApiError>>()?;
        let column = |bytes: &[u8]| {
            bytes
                .chunks_exact(4)
                .map(|v| f32::from_le_bytes(bytes_at(v, 0)))
                .collect()
        };
        let bytes = 4 * count as usize;
        Ok(Self {
            sequence: u32::from_le_bytes(bytes_at(message, 12)),
            number: u32::from_le_bytes(bytes_at(message, 16)),
            tick: u64::from_le_bytes(bytes_at(message, 24)),
            simulated_s: f64::from_le_bytes(bytes_at(message, 32)),
            wall_unix_s: f64::from_le_bytes(bytes_at(message, 40)),
            columns: (0..channels)
                .map(|c| column(&message[head + c * bytes..][..bytes]))
                .collect(),
            quantities,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::channel::Channel;

    fn positions() -> PositionsMessage {
        PositionsMessage {
            places: Places::Geographic,
            number: 7,
            positions: vec![[45.0, 10.0, 1200.5], [-1.0, 2.0, 3.0]],
        }
    }

    fn samples() -> SamplesMessage {
        SamplesMessage {
            sequence: 3,
            number: 7,
            tick: 1 << 40,
            simulated_s: 12.5,
            wall_unix_s: 1.75e9,
            quantities: vec![Quantity::Channel(Channel::TemperatureK), Quantity::WindFromDeg],
            columns: vec![vec![288.15, 280.0, 270.5], vec![10.0, 20.0, 360.0]],
        }
    }

    #[test]
    fn messages_come_back_and_lie_where_the_tables_say() {
        let bytes = positions().encode();
        assert_eq!(bytes.len(), 16 + 2 * 24);
        assert_eq!(&bytes[..16], b"WLKP\x01\0\x02\0\x02\0\0\0\x07\0\0\0");
        assert_eq!(bytes[32..40], 1200.5f64.to_le_bytes());
        assert_eq!(PositionsMessage::decode(&bytes), Ok(positions()));

        let bytes = samples().encode();
        assert_eq!(bytes.len(), 48 + 4 + 2 * 3 * 4);
        assert_eq!(&bytes[..20], b"WLKS\x01\0\x02\0\x03\0\0\0\x03\0\0\0\x07\0\0\0");
        assert_eq!(bytes[48..52], [Channel::TemperatureK.number(), 65, 0, 0]);
        assert_eq!(bytes[52..56], 288.15f32.to_le_bytes());
        assert_eq!(bytes[72..76], 360f32.to_le_bytes());
        assert_eq!(SamplesMessage::decode(&bytes), Ok(samples()));
    }

    #[test]
    fn every_cut_and_every_flipped_byte_is_read_or_refused_but_never_trusted() {
        let (p, s) = (positions().encode(), samples().encode());
        for end in 0..p.len() {
            assert_eq!(
                PositionsMessage::decode(&p[..end]).expect_err("cut").code,
                "bad_message"
            );
        }
        for end in 0..s.len() {
            assert_eq!(SamplesMessage::decode(&s[..end]).expect_err("cut").code, "bad_message");
        }
        for at in 0..s.len() {
            for flip in 1..=255 {
                let (mut p, mut s) = (p.clone(), s.clone());
                s[at] ^= flip;
                let read = SamplesMessage::decode(&s);
                assert!(at > 11 || read.is_err(), "byte {at} ^ {flip}");
                if let Some(byte) = p.get_mut(at) {
                    *byte ^= flip;
                    assert!(
                        PositionsMessage::decode(&p).is_err() || at == 6 || at > 11,
                        "byte {at} ^ {flip}"
                    );
                }
            }
        }
        // A count whose bytes would not fit any memory.
        let mut huge = p;
        huge[8..12].fill(255);
        assert_eq!(PositionsMessage::decode(&huge).expect_err("huge").code, "bad_message");
    }
}
