//! Messages to fields, trusting nothing: what a message can make the receiver allocate is bounded before anything is unpacked.

use std::sync::Arc;

use super::bricks;
use super::header::{Header, Kind};
use super::quantise::Quantiser;
use super::{Layout, Moment, VolumeError};

/// What a receiver takes at most.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DecodeLimits {
    /// Values in a message, over all channels. A value takes 5 bytes at most while it is read, and 2 or 4 for as long as the field is held.
    pub values_max: u64,
}

impl Default for DecodeLimits {
    fn default() -> Self {
        Self { values_max: 1 << 26 }
    }
}

/// A channel of a field.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldChannel {
    /// Name on the wire.
    pub name: String,
    /// How its codes are read.
    pub quantiser: Quantiser,
    /// Codes `[z][y][x]` of the message's cells.
    pub codes: Arc<[u16]>,
}

impl FieldChannel {
    /// The values, `[z][y][x]`, in the unit that the channel's name ends in.
    pub fn values(&self) -> Vec<f32> {
        self.codes.iter().map(|code| self.quantiser.value(*code)).collect()
    }
}

/// A field as a message left it.
#[derive(Clone, Debug, PartialEq)]
pub struct VolumeField {
    /// The view that it belongs to.
    pub view: u32,
    /// The message that made it.
    pub sequence: u32,
    /// Which moment it shows.
    pub moment: Moment,
    /// Which cells it holds.
    pub layout: Layout,
    /// Its channels.
    pub channels: Vec<FieldChannel>,
}

impl VolumeField {
    /// The channel of that name.
    pub fn channel(&self, name: &str) -> Option<&FieldChannel> {
        self.channels.iter().find(|c| c.name == name)
    }

    /// A channel's value at a place, m from the world's south-west corner on the ground: of the cell that holds it, none outside the region. The
    /// world repeats east and north.
    pub fn value_at(&self, name: &str, position_m: [f64; 3]) -> Option<f32> {
        let channel = self.channel(name)?;
        let Layout {
            world_cells,
            cell_size_m,
            region,
            mip,
            ..
        } = self.layout;
        let mut cell = [0usize; 3];
        for axis in 0..3 {
            let mut at = (position_m[axis] / cell_size_m[axis]).floor();
            if axis < 2 {
                at = at.rem_euclid(world_cells[axis].into());
            }
            let from = f64::from(region.from[axis]);
            if !(from..from + f64::from(region.cells[axis])).contains(&at) {
                return None;
            }
            cell[axis] = (at - from) as usize >> mip;
        }
        let [nx, ny, _] = self.layout.cells();
        let code = channel.codes.get((cell[2] * ny + cell[1]) * nx + cell[0])?;
        Some(channel.quantiser.value(*code))
    }
}

/// What a message did.
#[derive(Clone, Debug, PartialEq)]
pub enum Taken {
    /// A new field.
    Field(Arc<VolumeField>),
    /// A delta whose keyframe isn't here: it was lost, or came in before. Ask for a `resync`, or wait for the next keyframe.
    NeedsKeyframe,
    /// It is not newer than what is here, or of another view than the expected one: dropped.
    Stale,
}

/// Reads a view's messages. Whatever is lost, reordered or forged, a field is either right or not there.
#[derive(Clone, Debug, Default)]
pub struct Receiver {
    limits: DecodeLimits,
    expected: Option<u32>,
    keyframe: Option<Arc<VolumeField>>,
    newest: Option<Arc<VolumeField>>,
}

impl Receiver {
    /// A receiver without any field.
    pub fn new(limits: DecodeLimits) -> Self {
        Self {
            limits,
            ..Self::default()
        }
    }

    /// From now on takes messages of this view only; what is held of another is dropped.
    pub fn expect(&mut self, view: u32) {
        self.expected = Some(view);
        let kept = |field: &Arc<VolumeField>| field.view == view;
        self.keyframe = self.keyframe.take().filter(kept);
        self.newest = self.newest.take().filter(kept);
    }

    /// The newest field.
    pub fn newest(&self) -> Option<&Arc<VolumeField>> {
        self.newest.as_ref()
    }

    /// Takes a whole binary message.
    ///
    /// Errors: [`VolumeError`]; what was held before is held still.
    pub fn take(&mut self, message: &[u8]) -> Result<Taken, VolumeError> {
        let (header, body) = Header::decode(message)?;
        if self.expected.is_some_and(|view| view != header.view) {
            return Ok(Taken::Stale);
        }
        let newest = self.newest.as_ref().filter(|field| field.view == header.view);
        if newest.is_some_and(|field| field.sequence >= header.sequence) {
            return Ok(Taken::Stale);
        }
        let is_base = |k: &&Arc<VolumeField>| k.view == header.view && k.sequence == header.keyframe;
        let base = match header.kind {
            Kind::Keyframe => None,
            Kind::Delta => match self.keyframe.as_ref().filter(is_base) {
                Some(base) => Some(base),
                None => return Ok(Taken::NeedsKeyframe),
            },
        };
        let field = Arc::new(read(&header, body, base, &self.limits)?);
        if header.kind == Kind::Keyframe {
            self.keyframe = Some(Arc::clone(&field));
        }
        self.newest = Some(Arc::clone(&field));
        Ok(Taken::Field(field))
    }
}

fn read(
    header: &Header,
    body: &[u8],
    base: Option<&Arc<VolumeField>>,
    limits: &DecodeLimits,
) -> Result<VolumeField, VolumeError> {
    let layout = header.layout;
    let too_large = |what, got, most| VolumeError::TooLarge { what, got, most };
    let cells: u64 = layout.cells().iter().map(|n| *n as u64).product();
    let values = cells.saturating_mul(header.channels.len() as u64);
    if values > limits.values_max {
        return Err(too_large("a number of values", values, limits.values_max));
    }
    let raw_max = bricks::raw_bytes_max(&layout, header.channels.iter().map(|c| c.quantiser.bits));
    if u64::from(header.raw_bytes) > raw_max {
        return Err(too_large("a body", header.raw_bytes.into(), raw_max));
    }
    if let Some(base) = base {
        let same = base.layout == layout
            && base.channels.len() == header.channels.len()
            && base
                .channels
                .iter()
                .zip(&header.channels)
                .all(|(a, b)| a.name == b.name && a.quantiser == b.quantiser);
        if !same {
            return Err(VolumeError::Body("a delta is not of its keyframe's shape".to_owned()));
        }
    }
    let raw = header.compression.unpack(body, header.raw_bytes as usize)?;
    let mut rest = raw.as_slice();
    let mut channels = Vec::with_capacity(header.channels.len());
    for (n, entry) in header.channels.iter().enumerate() {
        let mut codes = match base {
            Some(base) => base.channels[n].codes.to_vec(),
            None => vec![0u16; cells as usize],
        };
        rest = bricks::read(&layout, entry.quantiser.bits, base.is_some(), rest, &mut codes)?;
        channels.push(FieldChannel {
            name: entry.name.clone(),
            quantiser: entry.quantiser,
            codes: codes.into(),
        });
    }
    if !rest.is_empty() {
        return Err(VolumeError::Body(format!("{} bytes are left over", rest.len())));
    }
    Ok(VolumeField {
        view: header.view,
        sequence: header.sequence,
        moment: header.moment,
        layout,
        channels,
    })
}
