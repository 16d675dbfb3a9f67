//! Recordings of volume streams: what the server sent, as it came. PROTOCOL.md, "Recordings".

use std::io::{BufReader, Read, Write};
use std::path::Path;
use std::time::Duration;

use welkin_proto::volume::{DecodeLimits, Header};

use crate::error::ClientError;
use crate::stream::Next;
use crate::volume::{Understood, VolumeEvent, Volumes};

const MAGIC: [u8; 4] = *b"WLKR";
const VERSION: u16 = 1;
const FILE_HEADER_BYTES: usize = 8;
const RECORD_HEADER_BYTES: usize = 16;
/// Longest message in a recording, bytes.
const MESSAGE_BYTES_MAX: u32 = 1 << 28;

/// Whether a message was text or binary.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordKind {
    /// JSON.
    Text,
    /// A volume.
    Binary,
}

/// A message as it came.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record<'a> {
    /// Text or binary.
    pub kind: RecordKind,
    /// When it came: the recorder's clock, Unix seconds.
    pub arrived_unix_s: f64,
    /// The message.
    pub data: &'a [u8],
}

/// Writes a recording.
#[derive(Debug)]
pub struct Writer<W: Write> {
    to: W,
}

impl<W: Write> Writer<W> {
    /// Begins a recording. Errors: those of writing.
    pub fn new(mut to: W) -> std::io::Result<Self> {
        let [low, high] = VERSION.to_le_bytes();
        to.write_all(&[MAGIC[0], MAGIC[1], MAGIC[2], MAGIC[3], low, high, 0, 0])?;
        Ok(Self { to })
    }

    /// Appends a message. Errors: those of writing.
    pub fn write(&mut self, record: Record<'_>) -> std::io::Result<()> {
        let length = u32::try_from(record.data.len()).map_err(std::io::Error::other)?;
        let kind = match record.kind {
            RecordKind::Text => 1,
            RecordKind::Binary => 2,
        };
        let mut head = [0; RECORD_HEADER_BYTES];
        head[0..4].copy_from_slice(&length.to_le_bytes());
        head[4] = kind;
        head[8..16].copy_from_slice(&record.arrived_unix_s.to_le_bytes());
        self.to.write_all(&head)?;
        self.to.write_all(record.data)?;
        // A recording that is cut off is good up to there.
        self.to.flush()
    }
}

/// Reads a recording.
#[derive(Debug)]
pub struct Reader<R: Read> {
    from: R,
    data: Vec<u8>,
}

impl<R: Read> Reader<R> {
    /// Errors: [`ClientError::Recording`] where it is none, or of another version.
    pub fn new(mut from: R) -> Result<Self, ClientError> {
        let mut head = [0; FILE_HEADER_BYTES];
        let bad = |why: String| ClientError::Recording(why);
        from.read_exact(&mut head).map_err(|e| bad(e.to_string()))?;
        if head[..4] != MAGIC {
            return Err(bad("a recording begins with `WLKR`".to_owned()));
        }
        let version = u16::from_le_bytes([head[4], head[5]]);
        if version != VERSION {
            return Err(bad(format!("version {version} is unknown; this build reads {VERSION}")));
        }
        Ok(Self { from, data: Vec::new() })
    }

    /// The next message; none at the end, also where a message is cut off there.
    ///
    /// Errors: [`ClientError::Recording`] for what is no record, and those of reading.
    pub fn next_record(&mut self) -> Result<Option<Record<'_>>, ClientError> {
        let bad = |why: String| ClientError::Recording(why);
        let mut head = [0; RECORD_HEADER_BYTES];
        if !fill(&mut self.from, &mut head).map_err(|e| bad(e.to_string()))? {
            return Ok(None);
        }
        let length = u32::from_le_bytes([head[0], head[1], head[2], head[3]]);
        if length > MESSAGE_BYTES_MAX {
            return Err(bad(format!(
                "a message of {length} bytes; at most {MESSAGE_BYTES_MAX} are read"
            )));
        }
        let kind = match head[4..8] {
            [1, 0, 0, 0] => RecordKind::Text,
            [2, 0, 0, 0] => RecordKind::Binary,
            ref other => return Err(bad(format!("a record of kind {other:?}"))),
        };
        let arrived_unix_s = f64::from_le_bytes([8, 9, 10, 11, 12, 13, 14, 15].map(|at: usize| head[at]));
        if !arrived_unix_s.is_finite() {
            return Err(bad("a time that is no number".to_owned()));
        }
        // Grows with what is there, not with what is said to be there.
        self.data.clear();
        let read = (&mut self.from).take(length.into()).read_to_end(&mut self.data);
        if read.map_err(|e| bad(e.to_string()))? < length as usize {
            return Ok(None);
        }
        Ok(Some(Record {
            kind,
            arrived_unix_s,
            data: &self.data,
        }))
    }
}

/// Fills the buffer; false where the source ends before.
fn fill(from: &mut impl Read, buffer: &mut [u8]) -> std::io::Result<bool> {
    match from.read_exact(buffer) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => Ok(false),
        Err(error) => Err(error),
    }
}

/// Plays a recording as [`subscribe`](crate::volume::subscribe) plays a server, `speed` times as fast as it was recorded; infinitely fast for
/// infinity. Its clock is the server's when it was recorded. Must be called within a tokio runtime.
///
/// Errors: [`ClientError::Recording`]; what is found later comes as [`VolumeEvent::Error`], the last.
pub fn replay(path: &Path, speed: f64, limits: DecodeLimits) -> Result<Volumes, ClientError> {
    let failed = |e: std::io::Error| ClientError::Recording(format!("{}: {e}", path.display()));
    if speed.is_nan() || speed <= 0.0 {
        return Err(ClientError::Recording(format!("a speed of {speed} is not above 0")));
    }
    let file = std::fs::File::open(path).map_err(failed)?;
    let mut reader = Reader::new(BufReader::new(file))?;
    Ok(Volumes::from_source(move |source| async move {
        let mut intake = source.intake(limits);
        let mut first_s = None;
        loop {
            let record = match reader.next_record() {
                Ok(None) => return,
                Ok(Some(record)) => record,
                Err(error) => {
                    // Where nobody listens any more there is nobody to tell.
                    let next = Next::Ends;
                    let _ = source.sender.send(VolumeEvent::Error { error, next }).await;
                    return;
                }
            };
            let first_s = *first_s.get_or_insert(record.arrived_unix_s);
            let due_s = (record.arrived_unix_s - first_s).max(0.0) / speed;
            if let Ok(wait) = Duration::try_from_secs_f64(due_s - source.now_s()) {
                tokio::time::sleep(wait).await;
            }
            let understood = match record.kind {
                RecordKind::Binary => {
                    // Pings of then mean nothing now: the clock is what the messages say.
                    if let Ok((header, _)) = Header::decode(record.data) {
                        source.set_clock(header.moment.encoded_unix_s);
                    }
                    intake.binary(record.data, record.arrived_unix_s)
                }
                RecordKind::Text => match std::str::from_utf8(record.data) {
                    Ok(text) => intake.text(text, f64::NAN),
                    Err(error) => Err(ClientError::BadMessage(error.to_string())),
                },
            };
            let event = match understood {
                Ok(Understood::Event(event)) => event,
                Ok(Understood::Reply(_) | Understood::Nothing) => continue,
                Err(error) => VolumeEvent::Error {
                    error,
                    next: Next::GoesOn,
                },
            };
            if source.sender.send(event).await.is_err() {
                return;
            }
        }
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_recorded_is_read_and_what_was_cut_off_is_not() {
        let mut file = Vec::new();
        let mut writer = Writer::new(&mut file).expect("memory");
        let records = [
            (RecordKind::Text, 1.5, b"{}".as_slice()),
            (RecordKind::Binary, 2.5, b"WLKV"),
            (RecordKind::Binary, 3.5, b""),
        ];
        for (kind, arrived_unix_s, data) in records {
            let record = Record {
                kind,
                arrived_unix_s,
                data,
            };
            writer.write(record).expect("memory");
        }
        for end in 0..=file.len() {
            let Ok(mut reader) = Reader::new(&file[..end]) else {
                assert!(end < FILE_HEADER_BYTES);
                continue;
            };
            let mut read = 0;
            while let Some(record) = reader.next_record().expect("nothing is wrong with it") {
                assert_eq!((record.kind, record.arrived_unix_s, record.data), records[read]);
                read += 1;
            }
            let whole = [8 + 16 + 2, 8 + 2 * 16 + 6, 8 + 3 * 16 + 6];
            assert_eq!(read, whole.iter().filter(|bytes| **bytes <= end).count(), "{end}");
        }
    }

    #[test]
    fn what_is_no_recording_is_refused() {
        for file in [b"".as_slice(), b"WLKV\x01\0\0\0", b"WLKR\x02\0\0\0"] {
            assert!(Reader::new(file).is_err(), "{file:?}");
        }
        for record in [
            b"\xff\xff\xff\xff\x01\0\0\0\0\0\0\0\0\0\0\0".as_slice(),
            b"\0\0\0\0\x03\0\0\0\0\0\0\0\0\0\0\0",
            b"\0\0\0\0\x01\0\0\x01\0\0\0\0\0\0\0\0",
            b"\0\0\0\0\x01\0\0\0\xff\xff\xff\xff\xff\xff\xff\xff",
        ] {
            let file = [b"WLKR\x01\0\0\0".as_slice(), record].concat();
            let mut reader = Reader::new(file.as_slice()).expect("its head is good");
            assert!(reader.next_record().is_err(), "{record:?}");
        }
    }
}
