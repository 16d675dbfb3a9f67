//! Radiosonde ascents as text, in the two forms in which they are published: SPC (SHARPpy) tables between `%RAW%` and
//! `%END%`, and the University of Wyoming's fixed-width lists, bare or inside their HTML page.
//!
//! Real files have holes, rows below ground, duplicates and cut ends. What can be mended is mended and noted; what
//! cannot is refused with code `bad_sounding`, naming the line and the column.

use crate::error::ApiError;

mod rows;

/// Longest text that is read, bytes.
pub const MAX_BYTES: usize = 1 << 20;

const KNOT_M_S: f64 = 1852.0 / 3600.0;
const ZERO_CELSIUS_K: f64 = 273.15;
/// Heights in both forms are rounded; a row this little below the station still counts as the surface.
const STATION_TOLERANCE_M: f64 = 5.0;

/// One level of an ascent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SoundingLevel {
    /// Pressure, Pa.
    pub pressure_pa: f64,
    /// Height above the sea, m.
    pub height_m: f64,
    /// Temperature, K.
    pub temperature_k: f64,
    /// Dew point, K, never above the temperature; absent where it was not measured.
    pub dewpoint_k: Option<f64>,
    /// Wind towards the east, m/s; absent only if the whole file holds no wind.
    pub wind_x_m_s: Option<f64>,
    /// Wind towards the north, m/s; absent only if the whole file holds no wind.
    pub wind_y_m_s: Option<f64>,
}

/// An ascent: at least two levels, pressure falling and height rising strictly; the first is the ground.
#[derive(Clone, Debug, PartialEq)]
pub struct Sounding {
    /// Station and time as the file's title says them, if it has one.
    pub title: Option<String>,
    /// From the ground up.
    pub levels: Vec<SoundingLevel>,
    /// What was dropped or filled in, and why.
    pub notes: Vec<String>,
}

/// One row as it stands in the file, SI units, before it is judged.
#[derive(Clone, Copy, Debug, Default)]
struct Row {
    line: usize,
    pressure_pa: Option<f64>,
    height_m: Option<f64>,
    temperature_k: Option<f64>,
    dewpoint_k: Option<f64>,
    /// Towards east and north, m/s.
    wind_m_s: Option<[f64; 2]>,
}

/// What the readers of the two forms hand over.
#[derive(Debug, Default)]
struct RawTable {
    title: Option<String>,
    station_height_m: Option<f64>,
    rows: Vec<Row>,
    notes: Vec<String>,
}

fn bad(message: impl Into<String>) -> ApiError {
    ApiError::new("bad_sounding", message)
}

/// Reads an ascent from a file's bytes. Errors: `bad_sounding`, also where the bytes are no text.
pub fn parse_bytes(bytes: &[u8]) -> Result<Sounding, ApiError> {
    too_long(bytes.len())?;
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let line = 1 + bytes[..error.valid_up_to()]
            .iter()
            .filter(|byte| **byte == b'\n')
            .count();
        bad(format!("line {line} is not text (UTF-8)"))
    })?;
    parse(text)
}

fn too_long(bytes: usize) -> Result<(), ApiError> {
    if bytes > MAX_BYTES {
        return Err(bad(format!("{bytes} bytes are too many; at most {MAX_BYTES} are read")));
    }
    Ok(())
}

/// Reads an ascent. Errors: `bad_sounding`: too long, neither form, something other than a number in a number's place
/// (with line and column), fewer than two usable rows.
pub fn parse(text: &str) -> Result<Sounding, ApiError> {
    too_long(text.len())?;
    if text.trim().is_empty() {
        return Err(bad("the file is empty"));
    }
    let table = rows::read(text)?;
    let RawTable {
        title,
        station_height_m,
        rows,
        mut notes,
    } = table;
    let read = rows.len();
    let winds_of = rows.clone();
    let mut levels = usable(rows, station_height_m, &mut notes);
    if levels.len() < 2 {
        let count = levels.len();
        let mut message = format!(
            "{count} usable row{} of {read}; at least 2 with pressure, height and temperature are needed",
            if count == 1 { "" } else { "s" }
        );
        for note in notes.iter().take(4) {
            message.push_str("; ");
            message.push_str(note);
        }
        return Err(bad(message));
    }
    fill_winds(&mut levels, &winds_of, &mut notes);
    Ok(Sounding { title, levels, notes })
}

/// Lines as a person would list them, the first few by number.
fn line_list(lines: &[usize]) -> String {
    let shown: Vec<String> = lines.iter().take(8).map(usize::to_string).collect();
    let more = if lines.len() > 8 {
        format!(" and {} more", lines.len() - 8)
    } else {
        String::new()
    };
    format!(
        "line{} {}{more}",
        if lines.len() == 1 { "" } else { "s" },
        shown.join(", ")
    )
}

/// Drops what cannot be used, merges duplicates, sorts from the ground up.
fn usable(rows: Vec<Row>, station_height_m: Option<f64>, notes: &mut Vec<String>) -> Vec<SoundingLevel> {
    let mut levels: Vec<(usize, SoundingLevel)> = Vec::new();
    let (mut incomplete, mut below_ground, mut supersaturated) = (vec![], vec![], vec![]);
    for row in rows {
        let (Some(pressure_pa), Some(height_m), Some(temperature_k)) =
            (row.pressure_pa, row.height_m, row.temperature_k)
        else {
            incomplete.push(row.line);
            continue;
        };
        if station_height_m.is_some_and(|ground_m| height_m < ground_m - STATION_TOLERANCE_M) {
            below_ground.push(row.line);
            continue;
        }
        if row.dewpoint_k.is_some_and(|dewpoint_k| dewpoint_k > temperature_k) {
            supersaturated.push(row.line);
        }
        let level = SoundingLevel {
            pressure_pa,
            height_m,
            temperature_k,
            dewpoint_k: row.dewpoint_k.map(|dewpoint_k| dewpoint_k.min(temperature_k)),
            wind_x_m_s: row.wind_m_s.map(|wind| wind[0]),
            wind_y_m_s: row.wind_m_s.map(|wind| wind[1]),
        };
        levels.push((row.line, level));
    }
    // A stable sort: of rows with the same pressure the file's first stays first.
    levels.sort_by(|a, b| b.1.pressure_pa.total_cmp(&a.1.pressure_pa));
    let mut kept: Vec<SoundingLevel> = Vec::with_capacity(levels.len());
    let (mut duplicate, mut not_above) = (vec![], vec![]);
    for (line, level) in levels {
        match kept.last_mut() {
            Some(last) if last.pressure_pa == level.pressure_pa => {
                last.dewpoint_k = last.dewpoint_k.or(level.dewpoint_k.map(|k| k.min(last.temperature_k)));
                if last.wind_x_m_s.is_none() {
                    last.wind_x_m_s = level.wind_x_m_s;
                    last.wind_y_m_s = level.wind_y_m_s;
                }
                duplicate.push(line);
            }
            Some(last) if level.height_m <= last.height_m => not_above.push(line),
            _ => kept.push(level),
        }
    }
    let mut note = |lines: &mut Vec<usize>, what: &str| {
        if !lines.is_empty() {
            lines.sort_unstable();
            notes.push(format!("{}: {what}", line_list(lines)));
        }
    };
    note(
        &mut incomplete,
        "no pressure, height or temperature (such as levels below ground); dropped as a level",
    );
    note(&mut below_ground, "below the station; dropped");
    note(
        &mut supersaturated,
        "dew point above the temperature; set to the temperature",
    );
    note(
        &mut duplicate,
        "the pressure of an earlier row; only what that one lacked was taken",
    );
    note(&mut not_above, "not above the row of next higher pressure; dropped");
    kept
}

/// Gives every level a wind: between measured heights linear in each component, beyond them the nearest.
fn fill_winds(levels: &mut [SoundingLevel], rows: &[Row], notes: &mut Vec<String>) {
    let ground_m = levels.first().map_or(f64::NEG_INFINITY, |level| level.height_m);
    let mut winds: Vec<(f64, [f64; 2])> = rows
        .iter()
        .filter_map(|row| Some((row.height_m?, row.wind_m_s?)))
        .filter(|(height_m, _)| *height_m >= ground_m)
        .collect();
    winds.sort_by(|a, b| a.0.total_cmp(&b.0));
    if winds.is_empty() {
        notes.push("no winds in the file".to_owned());
        return;
    }
    let mut filled = 0;
    for level in levels.iter_mut().filter(|level| level.wind_x_m_s.is_none()) {
        let above = winds.partition_point(|(height_m, _)| *height_m < level.height_m);
        let wind = match (above.checked_sub(1).map(|i| winds[i]), winds.get(above)) {
            (Some((low_m, low)), Some(&(high_m, high))) => {
                let share = (level.height_m - low_m) / (high_m - low_m);
                [0, 1].map(|axis| low[axis] + share * (high[axis] - low[axis]))
            }
            (Some((_, nearest)), None) | (None, Some(&(_, nearest))) => nearest,
            (None, None) => continue,
        };
        (level.wind_x_m_s, level.wind_y_m_s) = (Some(wind[0]), Some(wind[1]));
        filled += 1;
    }
    if filled > 0 {
        notes.push(format!(
            "{filled} of {} levels without wind: interpolated in height",
            levels.len()
        ));
    }
}
