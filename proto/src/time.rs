//! Date and time as text: RFC 3339 in UTC, to and from Unix seconds, in the proleptic Gregorian calendar.

use crate::error::ApiError;

const SECONDS_A_DAY: i64 = 86_400;
/// Unix seconds of 0000-01-01T00:00:00Z and of 9999-12-31T23:59:59Z: what four digits of a year can say.
const EARLIEST_UNIX_S: i64 = -62_167_219_200;
const LATEST_UNIX_S: i64 = 253_402_300_799;

/// Days from 1970-01-01 to a date, counted in 400-year cycles that start on 1 March.
fn days_from_date(year: i64, month: i64, day: i64) -> i64 {
    let year = if month <= 2 { year - 1 } else { year };
    let cycle = year.div_euclid(400);
    let year_of_cycle = year.rem_euclid(400);
    let month_from_march = (month + 9) % 12;
    let day_of_year = (153 * month_from_march + 2) / 5 + day - 1;
    let day_of_cycle = year_of_cycle * 365 + year_of_cycle / 4 - year_of_cycle / 100 + day_of_year;
    cycle * 146_097 + day_of_cycle - 719_468
}

/// The date that is `days` after 1970-01-01: the inverse of [`days_from_date`].
fn date_from_days(days: i64) -> (i64, i64, i64) {
    let days = days + 719_468;
    let cycle = days.div_euclid(146_097);
    let day_of_cycle = days.rem_euclid(146_097);
    let year_of_cycle = (day_of_cycle - day_of_cycle / 1_460 + day_of_cycle / 36_524 - day_of_cycle / 146_096) / 365;
    let day_of_year = day_of_cycle - (365 * year_of_cycle + year_of_cycle / 4 - year_of_cycle / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 {
        month_from_march + 3
    } else {
        month_from_march - 9
    };
    let year = cycle * 400 + year_of_cycle + i64::from(month <= 2);
    (year, month, day)
}

fn days_in_month(year: i64, month: i64) -> i64 {
    let leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    match month {
        2 if leap => 29,
        2 => 28,
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    }
}

/// Unix seconds of a date and time such as `2026-06-21T16:00:00Z`; a fraction of a second may follow the seconds.
///
/// Strict: upper-case `T` and `Z`, no other offset, no leap second. Errors: `bad_time`, naming what is wrong.
pub fn parse_utc(text: &str) -> Result<f64, ApiError> {
    let bad = |why: &str| {
        let shown: String = text.chars().take(40).collect();
        ApiError::new(
            "bad_time",
            format!("`{shown}` is not a date and time in UTC such as 2026-06-21T16:00:00Z: {why}"),
        )
    };
    let bytes = text.as_bytes();
    if bytes.len() < 20 || bytes.len() > 40 {
        return Err(bad("its length is wrong"));
    }
    for (place, mark) in [(4, b'-'), (7, b'-'), (10, b'T'), (13, b':'), (16, b':')] {
        if bytes[place] != mark {
            return Err(bad(&format!("character {} must be `{}`", place + 1, char::from(mark))));
        }
    }
    if bytes[bytes.len() - 1] != b'Z' {
        return Err(bad("it must end in `Z`"));
    }
    let number = |from: usize, to: usize| -> Result<i64, ApiError> {
        bytes[from..to].iter().try_fold(0_i64, |sum, byte| {
            if byte.is_ascii_digit() {
                Ok(sum * 10 + i64::from(byte - b'0'))
            } else {
                Err(bad(&format!("characters {} to {to} must be digits", from + 1)))
            }
        })
    };
    let (year, month, day) = (number(0, 4)?, number(5, 7)?, number(8, 10)?);
    let (hour, minute, second) = (number(11, 13)?, number(14, 16)?, number(17, 19)?);
    let mut fraction = 0.0;
    let rest = &bytes[19..bytes.len() - 1];
    if let Some((&point, digits)) = rest.split_first() {
        if point != b'.' || digits.is_empty() {
            return Err(bad("a fraction of a second is a `.` and digits"));
        }
        let mut weight = 0.1;
        for byte in digits {
            if !byte.is_ascii_digit() {
                return Err(bad("a fraction of a second is a `.` and digits"));
            }
            fraction += weight * f64::from(byte - b'0');
            weight *= 0.1;
        }
    }
    if !(1..=12).contains(&month) {
        return Err(bad("the month goes from 01 to 12"));
    }
    if day < 1 || day > days_in_month(year, month) {
        return Err(bad(&format!("that month has {} days", days_in_month(year, month))));
    }
    if hour > 23 || minute > 59 || second > 59 {
        return Err(bad("the time goes from 00:00:00 to 23:59:59"));
    }
    let whole = days_from_date(year, month, day) * SECONDS_A_DAY + hour * 3600 + minute * 60 + second;
    Ok(whole as f64 + fraction)
}

/// Unix seconds as text such as `2026-06-21T16:00:00Z`, rounded to the nearest second and held within the years 0000 to
/// 9999. Not a number is written as 1970-01-01T00:00:00Z.
pub fn format_utc(unix_s: f64) -> String {
    let whole = (unix_s.round() as i64).clamp(EARLIEST_UNIX_S, LATEST_UNIX_S);
    let (year, month, day) = date_from_days(whole.div_euclid(SECONDS_A_DAY));
    let of_day = whole.rem_euclid(SECONDS_A_DAY);
    let (hour, minute, second) = (of_day / 3600, of_day / 60 % 60, of_day % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_instants() {
        for (text, unix_s) in [
            ("1970-01-01T00:00:00Z", 0.0),
            ("1969-12-31T23:59:59Z", -1.0),
            ("2000-02-29T12:00:00Z", 951_825_600.0),
            ("2001-09-09T01:46:40Z", 1_000_000_000.0),
            ("2038-01-19T03:14:08Z", 2_147_483_648.0),
            ("0000-01-01T00:00:00Z", EARLIEST_UNIX_S as f64),
            ("9999-12-31T23:59:59Z", LATEST_UNIX_S as f64),
        ] {
            assert_eq!(parse_utc(text).expect(text), unix_s, "{text}");
            assert_eq!(format_utc(unix_s), text);
        }
        let half = parse_utc("1970-01-01T00:00:00.5Z").expect("a fraction is allowed");
        assert!((half - 0.5).abs() < 1e-12);
    }

    #[test]
    fn every_day_of_eight_centuries_comes_back() {
        let mut last = String::new();
        for day in days_from_date(1600, 1, 1)..days_from_date(2400, 1, 1) {
            let text = format_utc((day * SECONDS_A_DAY) as f64);
            assert!(text > last, "{text} must come after {last}");
            assert_eq!(parse_utc(&text).expect("our own text"), (day * SECONDS_A_DAY) as f64);
            last = text;
        }
    }

    #[test]
    fn nonsense_is_refused() {
        for text in [
            "",
            "now",
            "2026-06-21",
            "2026-06-21T16:00:00",
            "2026-06-21t16:00:00Z",
            "2026-06-21T16:00:00+02:00",
            "2026-02-29T00:00:00Z",
            "1900-02-29T00:00:00Z",
            "2026-13-01T00:00:00Z",
            "2026-00-01T00:00:00Z",
            "2026-06-00T00:00:00Z",
            "2026-06-21T24:00:00Z",
            "2026-06-21T16:60:00Z",
            "2026-06-21T16:00:60Z",
            "2026-06-21T16:00:00.Z",
            "2026-06-21T16:00:00.5e3Z",
            "+026-06-21T16:00:00Z",
            "２０26-06-21T16:00Z",
            "-2026-06-21T16:00:00Z",
            "2026-06-21T16:00:00ZZ",
        ] {
            assert_eq!(parse_utc(text).expect_err(text).code, "bad_time", "{text}");
        }
    }

    #[test]
    fn absurd_seconds_are_held() {
        assert_eq!(format_utc(f64::INFINITY), "9999-12-31T23:59:59Z");
        assert_eq!(format_utc(-1e300), "0000-01-01T00:00:00Z");
        assert_eq!(format_utc(f64::NAN), "1970-01-01T00:00:00Z");
    }
}
