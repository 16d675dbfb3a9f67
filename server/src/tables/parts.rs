//! A file of finished slabs, to go on from another time.
//!
//! A line of text says which study it is of; then a record a slab: number (4 bytes), body, and a hash of both (8 bytes), little endian. What follows the last whole record was cut off when the
//! program was killed, and is written anew.

use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::Path;

use welkin_shaders::cpu::light::slab_photons::LEAVING;
use welkin_shaders::cpu::light::slab_tables::{CASE_BYTES, CASES};

use super::{Finished, Summary, TablesError};

/// Numbers of a summary.
const NUMBERS: usize = 8 + 2 * LEAVING;
const RECORD_BYTES: usize = 4 + CASE_BYTES + 8 * NUMBERS + 8;

/// An open file of parts.
pub(super) struct Parts {
    file: File,
    name: String,
}

impl Parts {
    /// Opens or begins the file of the study that says `of` of itself, and gives what is in it. Errors: [`TablesError`].
    pub(super) fn open(path: &Path, of: &str) -> Result<(Parts, Vec<Option<Finished>>), TablesError> {
        let name = path.display().to_string();
        let failed = |error| TablesError::Parts(name.clone(), error);
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .map_err(failed)?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(failed)?;
        let mut finished = vec![None; CASES];
        let head = format!("{of}\n");
        let mut whole = head.len();
        if bytes.len() < head.len() && head.as_bytes().starts_with(&bytes) {
            // New, or killed while its first line was written.
            file.seek(SeekFrom::Start(0)).map_err(failed)?;
            file.write_all(head.as_bytes()).map_err(failed)?;
        } else if let Some(records) = bytes.strip_prefix(head.as_bytes()) {
            for record in records.chunks_exact(RECORD_BYTES) {
                let Some((n, slab)) = read(record) else { break };
                finished[n] = Some(slab);
                whole += RECORD_BYTES;
            }
        } else {
            let first = bytes.split(|b| *b == b'\n').next().unwrap_or_default();
            let first = String::from_utf8_lossy(&first[..first.len().min(400)]).into_owned();
            return Err(TablesError::Others(name, first));
        }
        file.set_len(whole as u64).map_err(failed)?;
        file.seek(SeekFrom::End(0)).map_err(failed)?;
        Ok((Parts { file, name }, finished))
    }

    /// Keeps a slab. Errors: [`TablesError`].
    pub(super) fn keep(&mut self, n: usize, slab: &Finished) -> Result<(), TablesError> {
        self.file
            .write_all(&written(n, slab))
            .and_then(|()| self.file.flush())
            .map_err(|error| TablesError::Parts(self.name.clone(), error))
    }
}

fn hash(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

fn written(n: usize, slab: &Finished) -> Vec<u8> {
    let Summary {
        photons,
        reflected,
        transmitted,
        reflected_sets,
        transmitted_sets,
        fluence_error,
        direction_error,
    } = slab.summary;
    let mut record = (n as u32).to_le_bytes().to_vec();
    record.extend(&slab.bytes);
    let numbers = [photons as f64].into_iter().chain(reflected).chain(transmitted);
    let numbers = numbers.chain(reflected_sets).chain(transmitted_sets);
    let numbers = numbers.chain(fluence_error).chain([direction_error]);
    record.extend(numbers.flat_map(f64::to_le_bytes));
    record.extend(hash(&record).to_le_bytes());
    record
}

fn read(record: &[u8]) -> Option<(usize, Finished)> {
    let (body, sum) = record.split_last_chunk::<8>()?;
    if hash(body) != u64::from_le_bytes(*sum) {
        return None;
    }
    let (n, body) = body.split_first_chunk::<4>()?;
    let n = u32::from_le_bytes(*n) as usize;
    let (bytes, numbers) = body.split_at_checked(CASE_BYTES)?;
    let numbers: Vec<f64> = numbers
        .chunks_exact(8)
        .filter_map(|b| Some(f64::from_le_bytes(b.try_into().ok()?)))
        .collect();
    let numbers: [f64; NUMBERS] = numbers.try_into().ok()?;
    let sets = |first: usize| std::array::from_fn(|k| numbers[first + k]);
    let summary = Summary {
        photons: numbers[0] as u64,
        reflected: [numbers[1], numbers[2]],
        transmitted: [numbers[3], numbers[4]],
        reflected_sets: sets(5),
        transmitted_sets: sets(5 + LEAVING),
        fluence_error: [numbers[NUMBERS - 3], numbers[NUMBERS - 2]],
        direction_error: numbers[NUMBERS - 1],
    };
    let bytes = bytes.to_vec();
    (n < CASES).then_some((n, Finished { bytes, summary }))
}
