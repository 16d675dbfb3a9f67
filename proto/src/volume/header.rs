//! The header and the table of channels; little endian. PROTOCOL.md has the table of bytes.

use super::{Bits, Compression, Curve, Layout, Quantiser, Region, VolumeError};

/// Version of the messages that this build reads and writes.
pub const VOLUME_VERSION: u16 = 1;
/// Bytes of a header before its table of channels.
pub const VOLUME_HEADER_BYTES: usize = 152;

const MAGIC: [u8; 4] = *b"WLKV";
/// Bytes of a channel in the table before its name.
const ENTRY_BYTES: usize = 20;
/// Most channels in a message.
const CHANNELS_MAX: usize = 32;
/// Longest name of a channel.
const NAME_BYTES_MAX: usize = 64;

/// What a message holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Every brick.
    Keyframe,
    /// The bricks that differ from the keyframe's.
    Delta,
}

/// The moment that a message shows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moment {
    /// Tick.
    pub tick: u64,
    /// Simulated seconds since the world's start.
    pub simulated_s: f64,
    /// When the world published this state: the server's clock, seconds since 1970-01-01T00:00:00Z.
    pub published_unix_s: f64,
    /// When the message was made, by the same clock.
    pub encoded_unix_s: f64,
    /// Unit vector towards the sun: x east, y north, z up.
    pub sun_direction: [f32; 3],
    /// How far the cloudy air has moved east and north since the start, m: where detail finer than the grid is looked up.
    pub air_displacement_m: [f32; 2],
}

/// A channel in the table.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelEntry {
    /// The channel's name on the wire, such as `extinction_per_m`.
    pub name: String,
    /// How its codes are read.
    pub quantiser: Quantiser,
}

/// What stands before a message's body.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// Keyframe or delta.
    pub kind: Kind,
    /// How the body is packed.
    pub compression: Compression,
    /// Names the view: one server gives each its own.
    pub view: u32,
    /// Counts the view's messages.
    pub sequence: u32,
    /// Sequence of the keyframe that a delta builds on; a keyframe's own.
    pub keyframe: u32,
    /// Which moment it shows.
    pub moment: Moment,
    /// Which cells it holds.
    pub layout: Layout,
    /// The channels, in the body's order.
    pub channels: Vec<ChannelEntry>,
    /// Bytes of the packed body.
    pub body_bytes: u32,
    /// Bytes of the unpacked body.
    pub raw_bytes: u32,
}

/// Reads little-endian values one after another; the caller has made sure that they are there.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], VolumeError> {
        let short = VolumeError::TooShort {
            got: self.0.len(),
            wanted: N,
        };
        let (value, rest) = self.0.split_first_chunk::<N>().ok_or(short)?;
        self.0 = rest;
        Ok(*value)
    }
    fn u8(&mut self) -> Result<u8, VolumeError> {
        self.take::<1>().map(|[byte]| byte)
    }
    fn u16(&mut self) -> Result<u16, VolumeError> {
        self.take().map(u16::from_le_bytes)
    }
    fn u32(&mut self) -> Result<u32, VolumeError> {
        self.take().map(u32::from_le_bytes)
    }
    fn f32(&mut self, field: &'static str) -> Result<f32, VolumeError> {
        let value = f32::from_le_bytes(self.take()?);
        finite(field, value.into()).map(|_| value)
    }
    fn f64(&mut self, field: &'static str) -> Result<f64, VolumeError> {
        finite(field, f64::from_le_bytes(self.take()?))
    }
    fn three<T: Copy + Default>(
        &mut self,
        mut read: impl FnMut(&mut Self) -> Result<T, VolumeError>,
    ) -> Result<[T; 3], VolumeError> {
        Ok([read(self)?, read(self)?, read(self)?])
    }
}

fn finite(field: &'static str, value: f64) -> Result<f64, VolumeError> {
    if value.is_finite() {
        Ok(value)
    } else {
        Err(VolumeError::header(field, format!("{value} is not finite")))
    }
}

fn is_name(name: &[u8]) -> bool {
    (1..=NAME_BYTES_MAX).contains(&name.len()) && name.iter().all(|b| matches!(b, b'a'..=b'z' | b'0'..=b'9' | b'_'))
}

impl Header {
    /// Bytes of the header with its table.
    pub fn bytes(&self) -> usize {
        VOLUME_HEADER_BYTES + self.channels.iter().map(|c| ENTRY_BYTES + c.name.len()).sum::<usize>()
    }

    /// Appends the header's bytes.
    ///
    /// Errors: [`VolumeError::Header`] for a layout, channels or names that no receiver takes.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), VolumeError> {
        self.check()?;
        let Layout {
            world_cells,
            cell_size_m,
            region,
            mip,
            brick,
        } = self.layout;
        let start = out.len();
        out.extend_from_slice(&MAGIC);
        out.extend_from_slice(&VOLUME_VERSION.to_le_bytes());
        out.push(match self.kind {
            Kind::Keyframe => 1,
            Kind::Delta => 2,
        });
        out.push(self.compression.number());
        for value in [self.view, self.sequence, self.keyframe] {
            out.extend_from_slice(&value.to_le_bytes());
        }
        out.push(mip);
        out.push(self.channels.len() as u8);
        out.extend_from_slice(&(self.bytes() as u16).to_le_bytes());
        let m = &self.moment;
        out.extend_from_slice(&m.tick.to_le_bytes());
        let times = [m.simulated_s, m.published_unix_s, m.encoded_unix_s];
        for value in times.iter().chain(&cell_size_m) {
            out.extend_from_slice(&value.to_le_bytes());
        }
        for value in world_cells.iter().chain(&region.from).chain(&region.cells) {
            out.extend_from_slice(&value.to_le_bytes());
        }
        out.extend_from_slice(&brick);
        out.push(0);
        for value in m.sun_direction.iter().chain(&m.air_displacement_m) {
            out.extend_from_slice(&value.to_le_bytes());
        }
        out.extend_from_slice(&self.body_bytes.to_le_bytes());
        out.extend_from_slice(&self.raw_bytes.to_le_bytes());
        out.extend_from_slice(&[0; 4]);
        debug_assert_eq!(out.len() - start, VOLUME_HEADER_BYTES);
        for ChannelEntry { name, quantiser } in &self.channels {
            out.push(name.len() as u8);
            out.push(quantiser.bits.into());
            out.push(match quantiser.curve {
                Curve::Linear => 0,
                Curve::Square => 1,
            });
            out.push(0);
            out.extend_from_slice(&quantiser.offset.to_le_bytes());
            out.extend_from_slice(&quantiser.scale.to_le_bytes());
            out.extend_from_slice(name.as_bytes());
        }
        Ok(())
    }

    /// Reads a header and finds the body behind it, trusting nothing: `message` is one whole binary message. Unpacks nothing.
    ///
    /// Errors: [`VolumeError`], but never those of a body.
    pub fn decode(message: &[u8]) -> Result<(Header, &[u8]), VolumeError> {
        if message.len() < VOLUME_HEADER_BYTES {
            return Err(VolumeError::TooShort {
                got: message.len(),
                wanted: VOLUME_HEADER_BYTES,
            });
        }
        let mut from = Fields(message);
        if from.take::<4>()? != MAGIC {
            return Err(VolumeError::Magic);
        }
        let version = from.u16()?;
        if version != VOLUME_VERSION {
            return Err(VolumeError::Version(version));
        }
        let kind = match from.u8()? {
            1 => Kind::Keyframe,
            2 => Kind::Delta,
            other => {
                return Err(VolumeError::header(
                    "kind",
                    format!("{other} is unknown; known are 1 and 2"),
                ));
            }
        };
        let compression = Compression::of_number(from.u8()?)?;
        let (view, sequence, keyframe) = (from.u32()?, from.u32()?, from.u32()?);
        let (mip, channel_count, header_bytes) = (from.u8()?, usize::from(from.u8()?), usize::from(from.u16()?));
        let tick = u64::from_le_bytes(from.take()?);
        let simulated_s = from.f64("simulated_s")?;
        let published_unix_s = from.f64("published_unix_s")?;
        let encoded_unix_s = from.f64("encoded_unix_s")?;
        let cell_size_m = from.three(|f| f.f64("cell_size_m"))?;
        let world_cells = from.three(Fields::u32)?;
        let region = Region {
            from: from.three(Fields::u32)?,
            cells: from.three(Fields::u32)?,
        };
        let brick = from.three(Fields::u8)?;
        let reserved = from.u8()?;
        let sun_direction = from.three(|f| f.f32("sun_direction"))?;
        let air_displacement_m = [from.f32("air_displacement_m")?, from.f32("air_displacement_m")?];
        let (body_bytes, raw_bytes) = (from.u32()?, from.u32()?);
        if reserved != 0 || from.take::<4>()? != [0; 4] {
            return Err(VolumeError::header("reserved", "bytes that must be 0 are not"));
        }
        let mut channels = Vec::with_capacity(channel_count.min(CHANNELS_MAX));
        for _ in 0..channel_count {
            let [name_bytes, bits, curve, reserved] = from.take()?;
            let bits = Bits::try_from(bits).map_err(|why| VolumeError::header("bits", why))?;
            let curve = match curve {
                0 => Curve::Linear,
                1 => Curve::Square,
                other => {
                    return Err(VolumeError::header(
                        "curve",
                        format!("{other} is unknown; known are 0 and 1"),
                    ));
                }
            };
            if reserved != 0 {
                return Err(VolumeError::header("reserved", "bytes that must be 0 are not"));
            }
            let (offset, scale) = (from.f64("offset")?, from.f64("scale")?);
            let Some((name, rest)) = from.0.split_at_checked(name_bytes.into()) else {
                return Err(VolumeError::TooShort {
                    got: from.0.len(),
                    wanted: name_bytes.into(),
                });
            };
            from.0 = rest;
            let name = std::str::from_utf8(name).map_err(|_| VolumeError::header("name", "it is not text"))?;
            channels.push(ChannelEntry {
                name: name.to_owned(),
                quantiser: Quantiser {
                    bits,
                    curve,
                    offset,
                    scale,
                },
            });
        }
        let body = from.0;
        let header = Header {
            kind,
            compression,
            view,
            sequence,
            keyframe,
            moment: Moment {
                tick,
                simulated_s,
                published_unix_s,
                encoded_unix_s,
                sun_direction,
                air_displacement_m,
            },
            layout: Layout {
                world_cells,
                cell_size_m,
                region,
                mip,
                brick,
            },
            channels,
            body_bytes,
            raw_bytes,
        };
        if header.bytes() != header_bytes {
            return Err(VolumeError::header(
                "header_bytes",
                format!("{header_bytes}, but it has {}", header.bytes()),
            ));
        }
        if body.len() as u64 != u64::from(body_bytes) {
            return Err(VolumeError::header(
                "body_bytes",
                format!("{body_bytes}, but {} follow", body.len()),
            ));
        }
        header.check()?;
        Ok((header, body))
    }

    fn check(&self) -> Result<(), VolumeError> {
        self.layout.check()?;
        let is_own = self.keyframe == self.sequence;
        if is_own != (self.kind == Kind::Keyframe) || self.keyframe > self.sequence {
            let message = format!("{} for message {}", self.keyframe, self.sequence);
            return Err(VolumeError::header("keyframe", message));
        }
        if !(1..=CHANNELS_MAX).contains(&self.channels.len()) {
            return Err(VolumeError::header(
                "channels",
                format!("{} are not 1 to {CHANNELS_MAX}", self.channels.len()),
            ));
        }
        for (n, ChannelEntry { name, quantiser }) in self.channels.iter().enumerate() {
            if !is_name(name.as_bytes()) {
                return Err(VolumeError::header("name", "a name is 1 to 64 of a-z, 0-9 and _"));
            }
            if self.channels[..n].iter().any(|other| other.name == *name) {
                return Err(VolumeError::header("name", format!("{name} stands there twice")));
            }
            let Quantiser {
                offset, scale, curve, ..
            } = *quantiser;
            // So that no code stands for more than single precision holds.
            if !(0.0..=1e14).contains(&scale) {
                return Err(VolumeError::header("scale", format!("{scale} is not 0 to 1e14")));
            }
            if !(offset.is_finite() && offset.abs() <= 1e30) || (curve == Curve::Square && offset != 0.0) {
                return Err(VolumeError::header("offset", format!("{offset} is out of range")));
            }
        }
        Ok(())
    }
}
