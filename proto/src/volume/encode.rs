//! Fields of a world to messages.

use super::bricks;
use super::header::{ChannelEntry, Header, Kind, Moment};
use super::layout::Layout;
use super::quantise::{Bits, Curve, Quantiser};
use super::{Compression, VolumeError};

/// A keyframe comes after so many messages at the latest.
const KEYFRAME_EVERY: u32 = 16;
/// And when the last is so old, s.
const KEYFRAME_AGE_MAX_S: f64 = 10.0;

/// A channel of a view.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Plane {
    /// Name on the wire.
    pub name: String,
    /// How its codes follow values.
    pub curve: Curve,
}

/// Makes the messages of one view: certain channels of certain cells, so quantised and so packed. Every message of a view is made once, for all
/// who look at it.
#[derive(Clone, Debug)]
pub struct Encoder {
    view: u32,
    layout: Layout,
    planes: Vec<Plane>,
    bits: Bits,
    compression: Compression,
    next_sequence: u32,
    keyframe: Option<Keyframe>,
    values: Vec<f32>,
    raw: Vec<u8>,
}

#[derive(Clone, Debug)]
struct Keyframe {
    sequence: u32,
    encoded_unix_s: f64,
    channels: Vec<ChannelEntry>,
    codes: Vec<Vec<u16>>,
}

impl Encoder {
    /// Errors: [`VolumeError::Header`] for a layout that does not fit.
    pub fn new(
        view: u32,
        layout: Layout,
        planes: Vec<Plane>,
        bits: Bits,
        compression: Compression,
    ) -> Result<Self, VolumeError> {
        layout.check()?;
        Ok(Self {
            view,
            layout,
            planes,
            bits,
            compression,
            next_sequence: 0,
            keyframe: None,
            values: Vec::new(),
            raw: Vec::new(),
        })
    }

    /// Sequence of the message made last; 0 before the first.
    pub fn last_sequence(&self) -> u32 {
        self.next_sequence.saturating_sub(1)
    }

    /// The next message: a delta where a young keyframe with the same quantisers is there, else a keyframe.
    ///
    /// `fields` are the channels of the whole world at cell centres, `[z][y][x]`. Errors: [`VolumeError::Body`] where a field has another
    /// length, [`VolumeError::Header`] for names that no receiver takes.
    pub fn encode(&mut self, moment: &Moment, fields: &[&[f32]]) -> Result<(Kind, Vec<u8>), VolumeError> {
        let world: usize = self.layout.world_cells.iter().map(|n| *n as usize).product();
        if fields.len() != self.planes.len() || fields.iter().any(|f| f.len() != world) {
            return Err(VolumeError::Body("a field does not fit the world".to_owned()));
        }
        let (mut channels, mut codes) = (Vec::new(), Vec::new());
        for (plane, field) in self.planes.iter().zip(fields) {
            coarsen(&self.layout, field, &mut self.values);
            let (low, high) = self
                .values
                .iter()
                .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), v| {
                    (low.min(*v), high.max(*v))
                });
            let quantiser = Quantiser::for_range(plane.curve, self.bits, low, high);
            let mut coded = Vec::with_capacity(self.values.len());
            quantiser.codes(&self.values, &mut coded);
            codes.push(coded);
            channels.push(ChannelEntry {
                name: plane.name.clone(),
                quantiser,
            });
        }
        let sequence = self.next_sequence;
        let young = |k: &Keyframe| {
            let age_s = moment.encoded_unix_s - k.encoded_unix_s;
            sequence - k.sequence < KEYFRAME_EVERY && (0.0..KEYFRAME_AGE_MAX_S).contains(&age_s)
        };
        let base = self.keyframe.as_ref().filter(|k| young(k) && k.channels == channels);
        self.raw.clear();
        for (n, coded) in codes.iter().enumerate() {
            bricks::write(
                &self.layout,
                self.bits,
                coded,
                base.map(|k| k.codes[n].as_slice()),
                &mut self.raw,
            );
        }
        let body = self.compression.pack(&self.raw)?;
        let size = |n: usize| u32::try_from(n).map_err(|_| VolumeError::Body(format!("{n} bytes are too many")));
        let kind = if base.is_some() { Kind::Delta } else { Kind::Keyframe };
        let header = Header {
            kind,
            compression: self.compression,
            view: self.view,
            sequence,
            keyframe: base.map_or(sequence, |k| k.sequence),
            moment: *moment,
            layout: self.layout,
            channels,
            body_bytes: size(body.len())?,
            raw_bytes: size(self.raw.len())?,
        };
        let mut message = Vec::with_capacity(header.bytes() + body.len());
        header.encode(&mut message)?;
        message.extend_from_slice(&body);
        self.next_sequence += 1;
        if kind == Kind::Keyframe {
            self.keyframe = Some(Keyframe {
                sequence,
                encoded_unix_s: moment.encoded_unix_s,
                channels: header.channels,
                codes,
            });
        }
        Ok((kind, message))
    }
}

/// Cuts a region out of a world's field and makes it coarser: a cell is the mean of the world's cells in it, so that what a volume holds in
/// sum stays the same.
fn coarsen(layout: &Layout, field: &[f32], coarse: &mut Vec<f32>) {
    let [world_x, world_y, _] = layout.world_cells.map(|n| n as usize);
    let from = layout.region.from.map(|n| n as usize);
    let size = layout.region.cells.map(|n| n as usize);
    let row_at = |y: usize, z: usize| ((from[2] + z) * world_y + from[1] + y) * world_x + from[0];
    coarse.clear();
    if layout.mip == 0 {
        for z in 0..size[2] {
            for y in 0..size[1] {
                coarse.extend_from_slice(&field[row_at(y, z)..][..size[0]]);
            }
        }
        return;
    }
    let edge = 1usize << layout.mip;
    let [nx, ny, nz] = layout.cells();
    let mut sums = vec![0f64; nx];
    for z in 0..nz {
        let levels = z * edge..((z + 1) * edge).min(size[2]);
        for y in 0..ny {
            let lines = y * edge..((y + 1) * edge).min(size[1]);
            sums.fill(0.0);
            for level in levels.clone() {
                for line in lines.clone() {
                    let row = &field[row_at(line, level)..][..size[0]];
                    for (sum, cells) in sums.iter_mut().zip(row.chunks(edge)) {
                        *sum += cells.iter().map(|v| f64::from(*v)).sum::<f64>();
                    }
                }
            }
            let in_column = levels.len() * lines.len();
            coarse.extend(sums.iter().enumerate().map(|(x, sum)| {
                let across = edge.min(size[0] - x * edge);
                (sum / (in_column * across) as f64) as f32
            }));
        }
    }
}
