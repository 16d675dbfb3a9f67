//! The volume stream's wire format: fields of a world as quantised, compressed bricks. `proto/PROTOCOL.md` says it byte by byte.
//!
//! A message is a [`Header`], a table of channels and a body of bricks. A keyframe holds every brick; a delta holds those whose codes differ from
//! its keyframe's, so that any delta can be read by whoever holds that keyframe, whatever was lost between the two.
//!
//! - [`Layout`]: which cells of a world a message holds, how coarse, in which bricks.
//! - [`Quantiser`]: numbers to codes of 8 or 16 bits and back, with the largest error.
//! - [`Encoder`]: fields to messages. [`Receiver`]: messages to a [`VolumeField`], trusting nothing.
//! - [`subscribe`]: what is said as text on the same connection. [`past`]: what is told of moments that are over.

mod bricks;
mod compression;
mod encode;
mod error;
mod header;
mod layout;
pub mod past;
mod quantise;
mod receive;
pub mod subscribe;

pub use compression::Compression;
pub use encode::{Encoder, Plane};
pub use error::VolumeError;
pub use header::{ChannelEntry, Header, Kind, Moment, VOLUME_HEADER_BYTES, VOLUME_VERSION};
pub use layout::{Layout, MIP_MAX, Region};
pub use quantise::{Bits, Curve, Quantiser};
pub use receive::{DecodeLimits, FieldChannel, Receiver, Taken, VolumeField};
