//! Packing and unpacking of bodies. What a body unpacks to is known before it is unpacked, and no more is ever written.

use std::io::Write;

use flate2::{Decompress, FlushDecompress, Status, write::ZlibEncoder};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::VolumeError;

/// zlib's level: bodies are small, and each is packed once for all who see it.
const ZLIB_LEVEL: u32 = 6;
/// zstd's level.
const ZSTD_LEVEL: i32 = 6;

/// How a body is packed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Compression {
    /// Not at all.
    None,
    /// zlib (RFC 1950): a browser's `DecompressionStream("deflate")` and Python's `zlib` unpack it.
    #[default]
    Deflate,
    /// Zstandard (RFC 8878): as small, and faster for large volumes; for native clients.
    Zstd,
}

impl Compression {
    pub(crate) fn number(self) -> u8 {
        match self {
            Self::None => 0,
            Self::Deflate => 1,
            Self::Zstd => 2,
        }
    }

    pub(crate) fn of_number(number: u8) -> Result<Self, VolumeError> {
        match number {
            0 => Ok(Self::None),
            1 => Ok(Self::Deflate),
            2 => Ok(Self::Zstd),
            other => Err(VolumeError::header(
                "compression",
                format!("{other} is unknown; known are 0 to 2"),
            )),
        }
    }

    pub(crate) fn pack(self, raw: &[u8]) -> Result<Vec<u8>, VolumeError> {
        let failed = |e: std::io::Error| VolumeError::Compression(e.to_string());
        match self {
            Self::None => Ok(raw.to_vec()),
            Self::Deflate => {
                let mut encoder = ZlibEncoder::new(Vec::new(), flate2::Compression::new(ZLIB_LEVEL));
                encoder.write_all(raw).map_err(failed)?;
                encoder.finish().map_err(failed)
            }
            Self::Zstd => zstd::bulk::compress(raw, ZSTD_LEVEL).map_err(failed),
        }
    }

    /// Unpacks into exactly `raw_bytes` bytes; the caller has bounded them.
    pub(crate) fn unpack(self, packed: &[u8], raw_bytes: usize) -> Result<Vec<u8>, VolumeError> {
        let bad = VolumeError::Compression;
        match self {
            Self::None if packed.len() == raw_bytes => Ok(packed.to_vec()),
            Self::None => Err(bad(format!("{} bytes, not {raw_bytes}", packed.len()))),
            Self::Deflate => {
                let mut raw = vec![0; raw_bytes];
                let mut stream = Decompress::new(true);
                let status = stream.decompress(packed, &mut raw, FlushDecompress::Finish);
                let status = status.map_err(|e| bad(e.to_string()))?;
                let whole = status == Status::StreamEnd
                    && stream.total_out() == raw_bytes as u64
                    && stream.total_in() == packed.len() as u64;
                whole
                    .then_some(raw)
                    .ok_or_else(|| bad(format!("it does not end after {raw_bytes} bytes")))
            }
            Self::Zstd => {
                let mut raw = vec![0; raw_bytes];
                let written = zstd::bulk::decompress_to_buffer(packed, raw.as_mut_slice());
                match written {
                    Ok(written) if written == raw_bytes => Ok(raw),
                    Ok(written) => Err(bad(format!("{written} bytes, not {raw_bytes}"))),
                    Err(e) => Err(bad(e.to_string())),
                }
            }
        }
    }
}
