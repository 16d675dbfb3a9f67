//! The two text forms, row by row.

use super::{KNOT_M_S, RawTable, Row, ZERO_CELSIUS_K, bad};
use crate::error::ApiError;

/// Finds out which form the text has, and reads its rows.
pub(super) fn read(text: &str) -> Result<RawTable, ApiError> {
    if text.lines().any(|line| line.trim() == "%RAW%") {
        return spc(text);
    }
    if let Some((place, header)) = text.lines().enumerate().find(|(_, line)| is_wyoming_header(line)) {
        return wyoming(text, place, header);
    }
    Err(bad(
        "neither an SPC table (with a line `%RAW%`) nor a University of Wyoming list (with a line `PRES HGHT TEMP DWPT ...`)",
    ))
}

fn is_wyoming_header(line: &str) -> bool {
    let mut words = line.split_ascii_whitespace();
    ["PRES", "HGHT", "TEMP", "DWPT"]
        .iter()
        .all(|name| words.next() == Some(name))
}

/// A column: its name, its unit in the file, and what is believable there.
struct Column {
    name: &'static str,
    unit: &'static str,
    least: f64,
    most: f64,
}

const PRESSURE: Column = Column {
    name: "pressure",
    unit: "hPa",
    least: 0.01,
    most: 1100.0,
};
const HEIGHT: Column = Column {
    name: "height",
    unit: "m",
    least: -1000.0,
    most: 80_000.0,
};
const TEMPERATURE: Column = Column {
    name: "temperature",
    unit: "C",
    least: -130.0,
    most: 60.0,
};
const DEWPOINT: Column = Column {
    name: "dew point",
    unit: "C",
    least: -200.0,
    most: 60.0,
};
const DIRECTION: Column = Column {
    name: "wind direction",
    unit: "deg",
    least: 0.0,
    most: 360.0,
};
const SPEED: Column = Column {
    name: "wind speed",
    unit: "kt or m/s",
    least: 0.0,
    most: 400.0,
};

impl Column {
    /// The number in a field; `None` where it is missing (blank, or a code such as -9999 or 999999).
    fn number(&self, field: &str, line: usize, column: usize) -> Result<Option<f64>, ApiError> {
        let field = field.trim();
        if field.is_empty() {
            return Ok(None);
        }
        let refuse = |why: String| bad(format!("line {line}, column {column} ({}): {why}", self.name));
        // `parse` also knows `nan` and `inf`; a number here begins with a digit, a sign or a point and holds no letters.
        let plain = field
            .bytes()
            .all(|byte| byte.is_ascii_digit() || matches!(byte, b'+' | b'-' | b'.'));
        let Some(value) = field.parse::<f64>().ok().filter(|_| plain) else {
            let shown: String = field.chars().take(20).collect();
            return Err(refuse(format!("{shown:?} is not a number")));
        };
        // Every missing code in use (-9999, 9999, -999, 999999) lies outside what any column can hold.
        let missing_code =
            value.abs() >= 9998.0 && self.most < 9998.0 || matches!(value, -9999.0 | -999.0 | 99999.0 | 999999.0);
        if missing_code {
            return Ok(None);
        }
        if value < self.least || value > self.most {
            let (least, most, unit) = (self.least, self.most, self.unit);
            return Err(refuse(format!(
                "{value} {unit} is out of range; allowed is {least} to {most} {unit}"
            )));
        }
        Ok(Some(value))
    }
}

/// Six fields in the common order to a row; `speed_unit_m_s` is one unit of wind speed.
fn row(fields: [&str; 6], line: usize, speed_unit_m_s: f64) -> Result<Row, ApiError> {
    let pressure_hpa = PRESSURE.number(fields[0], line, 1)?;
    let height_m = HEIGHT.number(fields[1], line, 2)?;
    let temperature_c = TEMPERATURE.number(fields[2], line, 3)?;
    let dewpoint_c = DEWPOINT.number(fields[3], line, 4)?;
    let direction_deg = DIRECTION.number(fields[4], line, 5)?;
    let speed = SPEED.number(fields[5], line, 6)?;
    let wind_m_s = direction_deg.zip(speed).map(|(direction_deg, speed)| {
        // The direction is where the wind comes from: from 90 degrees (east) it blows towards the west.
        let (sine, cosine) = direction_deg.to_radians().sin_cos();
        let speed_m_s = speed * speed_unit_m_s;
        [-speed_m_s * sine, -speed_m_s * cosine]
    });
    Ok(Row {
        line,
        pressure_pa: pressure_hpa.map(|hpa| hpa * 100.0),
        height_m,
        temperature_k: temperature_c.map(|c| c + ZERO_CELSIUS_K),
        dewpoint_k: dewpoint_c.map(|c| c + ZERO_CELSIUS_K),
        wind_m_s,
    })
}

/// A title fit to be shown: no tags, no control characters, single blanks, at most 120 characters.
fn tidy(title: &str) -> Option<String> {
    let mut plain = String::new();
    let mut in_tag = false;
    for character in title.chars() {
        match character {
            '<' => in_tag = true,
            '>' => in_tag = false,
            _ if in_tag => {}
            _ => plain.push(if character.is_control() { ' ' } else { character }),
        }
    }
    let plain: String = plain
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ")
        .chars()
        .take(120)
        .collect();
    (!plain.is_empty()).then_some(plain)
}

/// SPC: comma-separated rows between `%RAW%` and `%END%`.
fn spc(text: &str) -> Result<RawTable, ApiError> {
    let mut table = RawTable::default();
    let mut lines = text.lines().enumerate().map(|(i, line)| (i + 1, line.trim()));
    while let Some((_, line)) = lines.next() {
        match line {
            "%TITLE%" => table.title = lines.next().and_then(|(_, title)| tidy(title)),
            "%RAW%" => break,
            _ => {}
        }
    }
    let rest: Vec<(usize, &str)> = lines.filter(|(_, line)| !line.is_empty()).collect();
    let end = rest.iter().position(|(_, line)| line.starts_with('%'));
    let body = &rest[..end.unwrap_or(rest.len())];
    if end.is_none() {
        table.notes.push("no `%END%`: the file seems to be cut".to_owned());
    }
    for (i, &(line, content)) in body.iter().enumerate() {
        let fields: Vec<&str> = content.split(',').collect();
        // A file cut in mid-row: short, or cut in its last number, which one cannot tell; so it goes.
        let cut = end.is_none() && i + 1 == body.len() && (fields.len() < 6 || !text.ends_with('\n'));
        if cut {
            table.notes.push(format!("line {line}: the last row is cut; dropped"));
            continue;
        }
        let Ok(fields) = <[&str; 6]>::try_from(fields) else {
            return Err(bad(format!(
                "line {line}: {} columns; 6 are needed",
                content.split(',').count()
            )));
        };
        table.rows.push(row(fields, line, KNOT_M_S)?);
    }
    Ok(table)
}

/// Width of a column of the Wyoming list, characters, and the number of its columns.
const WIDTH: usize = 7;
const COLUMNS: usize = 11;

/// Wyoming: columns of seven characters below a ruled header, to the end of the `<PRE>` or of the text.
fn wyoming(text: &str, header_place: usize, header: &str) -> Result<RawTable, ApiError> {
    let lines: Vec<&str> = text.lines().collect();
    let mut table = RawTable {
        title: wyoming_title(&lines[..header_place]),
        ..RawTable::default()
    };
    for line in &lines[header_place..] {
        if let Some((_, value)) = line.split_once("Station elevation:") {
            table.station_height_m = value
                .trim()
                .parse::<f64>()
                .ok()
                .filter(|m| (-1000.0..=9000.0).contains(m));
        }
    }
    // Newer pages give the wind in m/s: the header says SPED, and the line of units under it m/s.
    let units = lines.get(header_place + 1).copied().unwrap_or_default();
    let speed_unit_m_s = if header.contains("SPED") && units.contains("m/s") {
        1.0
    } else {
        KNOT_M_S
    };

    let first = header_place + 1;
    let is_end = |line: &str| line.trim_start().starts_with('<') || line.trim_start().starts_with("Station ");
    let end = lines
        .iter()
        .skip(first)
        .position(|line| is_end(line))
        .map_or(lines.len(), |place| first + place);
    // A file cut in mid-row ends with neither the page's rest nor a line feed, in a row that is not full.
    let cut = end == lines.len() && !text.ends_with('\n') && lines[end - 1].len() < WIDTH * COLUMNS;
    for (i, content) in lines.iter().enumerate().take(end).skip(first) {
        let line = i + 1;
        let trimmed = content.trim();
        if trimmed.is_empty() || trimmed.starts_with("---") || (i == first && trimmed.starts_with("hPa")) {
            continue;
        }
        if cut && line == end {
            table
                .notes
                .push(format!("line {line}: the last row seems to be cut; dropped"));
            continue;
        }
        match wyoming_fields(content) {
            Some(fields) => table.rows.push(row(fields, line, speed_unit_m_s)?),
            None => {
                return Err(bad(format!(
                    "line {line}: not plain text in columns of {WIDTH} characters"
                )));
            }
        }
    }
    Ok(table)
}

/// Pressure, height, temperature, dew point, wind direction and speed out of the eleven columns; `None` where the line is not ASCII.
fn wyoming_fields(content: &str) -> Option<[&str; 6]> {
    if !content.is_ascii() {
        return None;
    }
    let columns: Vec<&str> = {
        let words: Vec<&str> = content.split_ascii_whitespace().collect();
        if words.len() == COLUMNS {
            // Nothing is missing, so blanks alone tell the columns, also where an editor has moved them.
            words
        } else {
            (0..COLUMNS)
                .map(|i| {
                    content
                        .get(i * WIDTH..((i + 1) * WIDTH).min(content.len()))
                        .unwrap_or_default()
                })
                .collect()
        }
    };
    Some([columns[0], columns[1], columns[2], columns[3], columns[6], columns[7]])
}

/// The heading of an HTML page, or the last written line above the table.
fn wyoming_title(above: &[&str]) -> Option<String> {
    let heading = above.iter().find(|line| line.to_ascii_uppercase().contains("<H2>"));
    let written = || {
        above.iter().rev().find(|line| {
            let line = line.trim();
            !line.is_empty() && !line.starts_with('-') && !line.starts_with('<')
        })
    };
    heading.or_else(written).and_then(|line| tidy(line))
}
