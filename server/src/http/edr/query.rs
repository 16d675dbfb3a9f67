//! What the data queries take: parameters, heights, times, and what is refused.

use std::sync::Arc;

use welkin_proto::ApiError;
use welkin_proto::sample::Quantity;
use welkin_proto::time::parse_utc;

use crate::host::View;
use crate::http::query::{invalid, number, unknown};
use crate::http::sampling::{self, Chosen};
use crate::sample::{self, Moments, When};
use crate::weather::{Reach, Weather};

/// Times this near to the oldest or newest that is kept are taken as that one, s: texts have milliseconds.
const SLACK_S: f64 = 2e-3;
/// Most levels that a list or a repetition of heights may name.
const LEVELS_MAX: usize = 4096;

/// Heights that are wanted, m above mean sea level.
#[derive(Clone, Debug, PartialEq)]
pub enum Heights {
    /// All levels of the world's grid.
    All,
    /// These.
    At(Vec<f64>),
    /// The levels of the world's grid from one to another.
    Between(f64, f64),
}

/// Times that are wanted, Unix seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Times {
    /// The newest.
    Now,
    /// One, between two ticks if need be.
    At(f64),
    /// All that are kept from one to another.
    Between(f64, f64),
}

/// A data query as far as all have it in common.
pub struct Query {
    /// The geometry's text; absent for `cube`.
    pub coords: Option<String>,
    /// West, south, east, north, degrees, and lower and upper altitude where six numbers are given.
    pub bbox: Option<Vec<f64>>,
    /// Heights.
    pub heights: Heights,
    /// Times.
    pub times: Times,
    /// What is answered.
    pub quantities: Vec<Quantity>,
}

/// Reads a query; `own` names the parameters that this route knows beside those of all.
///
/// Errors: `unknown_parameter`, `bad_parameter`, `unsupported_crs`, `unsupported_format`, those of [`Chosen::new`].
pub fn parse(pairs: &[(String, String)], own: &[&str], view: &View) -> Result<Query, ApiError> {
    let (mut coords, mut bbox, mut heights, mut times, mut named) = (None, None, Heights::All, Times::Now, None);
    for (name, value) in pairs {
        match name.as_str() {
            "parameter-name" => {
                let quantities = sampling::quantities(value.split(',').map(str::trim));
                named = Some(quantities.map_err(|e| e.at("/parameter-name"))?);
            }
            "crs" => check_crs(value)?,
            "f" => check_format(value)?,
            other if !own.contains(&other) => return Err(unknown(name)),
            "coords" => coords = Some(value.clone()),
            "bbox" => bbox = Some(parse_bbox(value)?),
            "z" => heights = parse_heights(value)?,
            "datetime" => times = parse_times(value)?,
            _ => return Err(unknown(name)),
        }
    }
    let chosen = Chosen::new(named, view).map_err(|e| e.at("/parameter-name"))?;
    Ok(Query {
        coords,
        bbox,
        heights,
        times,
        quantities: chosen.quantities,
    })
}

fn check_crs(value: &str) -> Result<(), ApiError> {
    let known = [
        "CRS84",
        "CRS:84",
        "OGC:CRS84",
        super::coverage::CRS84,
        "https://www.opengis.net/def/crs/OGC/1.3/CRS84",
    ];
    if known.contains(&value) {
        return Ok(());
    }
    let shown: String = value.chars().take(60).collect();
    Err(ApiError::new("unsupported_crs", format!("{shown:?} is not served; CRS84 is")).at("/crs"))
}

fn check_format(value: &str) -> Result<(), ApiError> {
    if value.eq_ignore_ascii_case("CoverageJSON") || value == super::coverage::MEDIA_TYPE {
        return Ok(());
    }
    let shown: String = value.chars().take(60).collect();
    Err(ApiError::new(
        "unsupported_format",
        format!("{shown:?} is not served; CoverageJSON is"),
    )
    .at("/f"))
}

fn parse_bbox(value: &str) -> Result<Vec<f64>, ApiError> {
    let numbers = value.split(',').map(|part| number("bbox", part.trim()));
    let numbers = numbers.take(7).collect::<Result<Vec<f64>, _>>()?;
    let ordered = match numbers.as_slice() {
        [west, south, east, north] => west <= east && south <= north,
        [west, south, low, east, north, high] => west <= east && south <= north && low <= high,
        _ => false,
    };
    match ordered {
        true => Ok(numbers),
        false => Err(invalid(
            "bbox",
            value,
            "west,south,east,north or west,south,low,east,north,high, the lower first",
        )),
    }
}

/// `100`, `100,200`, `100/500` or `R5/100/50` (five levels from 100 in steps of 50).
fn parse_heights(value: &str) -> Result<Heights, ApiError> {
    let metres = |text: &str| number("z", text.trim());
    let wrong = || invalid("z", value, "a height, heights with commas, `low/high` or `Rn/low/step`");
    if let Some(repeated) = value.strip_prefix('R') {
        let mut parts = repeated.split('/');
        let (Some(count), Some(low), Some(step), None) = (parts.next(), parts.next(), parts.next(), parts.next())
        else {
            return Err(wrong());
        };
        let count: usize = count.parse().map_err(|_| wrong())?;
        if !(1..=LEVELS_MAX).contains(&count) {
            return Err(wrong());
        }
        let (low, step) = (metres(low)?, metres(step)?);
        return rising((0..count).map(|i| low + step * i as f64).collect()).ok_or_else(wrong);
    }
    if let Some((low, high)) = value.split_once('/') {
        let (low, high) = (metres(low)?, metres(high)?);
        return match low <= high {
            true => Ok(Heights::Between(low, high)),
            false => Err(wrong()),
        };
    }
    let heights = value.split(',').map(metres).take(LEVELS_MAX + 1);
    rising(heights.collect::<Result<_, _>>()?).ok_or_else(wrong)
}

/// A coverage's axis rises.
fn rising(heights: Vec<f64>) -> Option<Heights> {
    let rises = heights.windows(2).all(|w| w[0] < w[1]) && heights.len() <= LEVELS_MAX;
    rises.then_some(Heights::At(heights))
}

/// An instant, or `from/to` with `..` for an open end.
fn parse_times(value: &str) -> Result<Times, ApiError> {
    let time = |text: &str| parse_utc(text).map_err(|_| invalid("datetime", value, "RFC 3339 in UTC, or from/to"));
    let Some((from, to)) = value.split_once('/') else {
        return time(value).map(Times::At);
    };
    let from = if matches!(from, ".." | "") {
        f64::NEG_INFINITY
    } else {
        time(from)?
    };
    let to = if matches!(to, ".." | "") {
        f64::INFINITY
    } else {
        time(to)?
    };
    match from <= to {
        true => Ok(Times::Between(from, to)),
        false => Err(invalid("datetime", value, "an interval whose start is before its end")),
    }
}

/// Weather for a query, waiting for it where nobody wanted any until now.
pub async fn past(view: &View, quantities: &[Quantity]) -> Result<Arc<[Arc<Weather>]>, ApiError> {
    let fields = sample::fields_of(quantities);
    let _interest = view.want_fields(fields, Reach::Past);
    let published = view.weather(fields).await?;
    Ok(Arc::clone(&published.past))
}

/// The moments that are wanted of those that are kept. Errors: those of [`Moments::find`] with the pointer `/datetime`.
pub fn moments(past: &[Arc<Weather>], times: Times) -> Result<Vec<Moments>, ApiError> {
    let (Some(oldest), Some(newest)) = (past.first(), past.last()) else {
        return Ok(vec![Moments::find(past, When::Now)?]);
    };
    let start_unix_s = newest.utc_unix_s - newest.simulated_s;
    let simulated_s = |unix_s: f64| {
        let second = unix_s - start_unix_s;
        let ends = [oldest.simulated_s, newest.simulated_s];
        ends.into_iter()
            .find(|end| (second - end).abs() < SLACK_S)
            .unwrap_or(second)
    };
    let find = |when| Moments::find(past, when).map_err(|e| e.at("/datetime"));
    match times {
        Times::Now => Ok(vec![find(When::Now)?]),
        Times::At(unix_s) => Ok(vec![find(When::Simulated(simulated_s(unix_s)))?]),
        Times::Between(from, to) => {
            let (from, to) = (simulated_s(from), simulated_s(to));
            let within = past.iter().filter(|w| (from..=to).contains(&w.simulated_s));
            let found: Vec<Moments> = within.map(Moments::at).collect();
            match found.is_empty() {
                // Between two that are kept, or beyond an end: the start says which.
                true => Ok(vec![find(When::Simulated(if to < oldest.simulated_s {
                    to
                } else {
                    from
                }))?]),
                false => Ok(found),
            }
        }
    }
}

/// One moment. Errors: those of [`moments`], `bad_parameter` for an interval.
pub fn one_moment(past: &[Arc<Weather>], times: Times) -> Result<Moments, ApiError> {
    if let Times::Between(..) = times {
        let message = "this query takes one time; `position` and `cube` take intervals";
        return Err(ApiError::new("bad_parameter", message).at("/datetime"));
    }
    let mut found = moments(past, times)?;
    found
        .pop()
        .ok_or_else(|| ApiError::new("weather_unavailable", "the world keeps no weather"))
}

/// Heights above the ground of the wanted levels. Errors: `outside_domain` where none is in the box, or one that was named is not; pointer `/z`.
pub fn levels_m(heights: &Heights, view: &View) -> Result<Vec<f64>, ApiError> {
    let ground_m = view.geography.surface_altitude_m;
    let lid_m = view.geography.size_m[2];
    let cells = view.scene.domain.cells[2];
    let centres = (0..cells).map(|k| (f64::from(k) + 0.5) * lid_m / f64::from(cells));
    let levels: Vec<f64> = match heights {
        Heights::All => centres.collect(),
        Heights::Between(low, high) => centres.filter(|z| (*low..=*high).contains(&(z + ground_m))).collect(),
        Heights::At(heights) => heights.iter().map(|h| h - ground_m).collect(),
    };
    if levels.is_empty() || !levels.iter().all(|z| (0.0..=lid_m).contains(z)) {
        let message = format!(
            "the air reaches from {ground_m} to {} m above mean sea level",
            ground_m + lid_m
        );
        return Err(ApiError::new("outside_domain", message).at("/z"));
    }
    Ok(levels)
}

/// Local metres east and north of a place that must lie in the box. Errors: `outside_domain` with the pointer `/coords`, `no_geography`.
pub fn inside(view: &View, [longitude_deg, latitude_deg]: [f64; 2]) -> Result<[f64; 2], ApiError> {
    let geography = &view.geography;
    let local = geography.local_m([latitude_deg, longitude_deg, geography.surface_altitude_m]);
    let [x_m, y_m, _] = local.map_err(|e| e.at("/coords"))?;
    let within = |axis: usize, at_m: f64| (-1e-6..=geography.size_m[axis] + 1e-6).contains(&at_m);
    if within(0, x_m) && within(1, y_m) {
        return Ok([x_m, y_m]);
    }
    let message = format!("{longitude_deg} {latitude_deg} is beside the collection; see its extent");
    Err(ApiError::new("outside_domain", message).at("/coords"))
}

/// The geometry's text. Errors: `bad_coords` without any.
pub fn coords(query: &Query) -> Result<&str, ApiError> {
    let missing = || ApiError::new("bad_coords", "`coords` is missing: well-known text, longitude first").at("/coords");
    query.coords.as_deref().ok_or_else(missing)
}

/// Refuses an answer of too many values: `too_large`.
pub fn check_values(places: usize, moments: usize, quantities: usize, most: usize) -> Result<(), ApiError> {
    let values = places.saturating_mul(moments).saturating_mul(quantities);
    if values <= most {
        return Ok(());
    }
    Err(ApiError::new(
        "too_large",
        format!("{values} values, at most {most} are answered; narrow the area, `z`, `datetime` or `parameter-name`"),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_and_times_are_read_or_refused() {
        for (text, heights) in [
            ("100", Heights::At(vec![100.0])),
            ("100, 250.5", Heights::At(vec![100.0, 250.5])),
            ("-5/1e3", Heights::Between(-5.0, 1000.0)),
            ("R3/100/50", Heights::At(vec![100.0, 150.0, 200.0])),
        ] {
            assert_eq!(parse_heights(text), Ok(heights), "{text}");
        }
        for text in [
            "",
            "a",
            "NaN",
            "1,,2",
            "2,1",
            "5/1",
            "1/2/3",
            "R",
            "R0/1/1",
            "R2/1",
            "R2/1/0",
            "R99999999999/1/1",
            "R-1/0/1",
            "inf",
        ] {
            assert_eq!(parse_heights(text).expect_err(text).code, "bad_parameter", "{text}");
        }
        let noon = 1_782_039_600.0;
        for (text, times) in [
            ("2026-06-21T11:00:00Z", Times::At(noon)),
            (
                "2026-06-21T11:00:00Z/2026-06-21T11:00:01.5Z",
                Times::Between(noon, noon + 1.5),
            ),
            ("../2026-06-21T11:00:00Z", Times::Between(f64::NEG_INFINITY, noon)),
            ("2026-06-21T11:00:00Z/..", Times::Between(noon, f64::INFINITY)),
        ] {
            assert_eq!(parse_times(text), Ok(times), "{text}");
        }
        for text in [
            "",
            "now",
            "2026-06-21",
            "2026-06-21T11:00:00Z/2026-06-21T10:00:00Z",
            "1/2/3",
            "noon/..",
        ] {
            assert_eq!(parse_times(text).expect_err(text).code, "bad_parameter", "{text}");
        }
        for text in [
            "",
            "1,2,3",
            "1,2,3,4,5",
            "3,2,1,4",
            "1,4,2,3",
            "1,2,NaN,4",
            "1,2,5,3,4,3",
            "1,2,3,4,5,6,7",
        ] {
            assert_eq!(parse_bbox(text).expect_err(text).code, "bad_parameter", "{text}");
        }
        assert_eq!(parse_bbox("1,2,3,4"), Ok(vec![1.0, 2.0, 3.0, 4.0]));
    }
}
