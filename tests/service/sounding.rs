//! Soundings as they come: whole, holed, cut, and not soundings at all.

use welkin_proto::sounding::{self, Sounding};

const OMAHA: &str = include_str!("../fixtures/soundings/oax_2014-06-16_19z.spc.txt");
const NORMAN: &str = include_str!("../fixtures/soundings/oun_2018-12-22_12z.uwyo.html");

fn good(text: &str) -> Sounding {
    let read = sounding::parse(text).expect("a usable sounding");
    assert!(read.levels.len() >= 2);
    for pair in read.levels.windows(2) {
        assert!(
            pair[1].pressure_pa < pair[0].pressure_pa && pair[1].height_m > pair[0].height_m,
            "{pair:?}"
        );
    }
    for level in &read.levels {
        assert!(level.dewpoint_k.is_none_or(|k| k <= level.temperature_k), "{level:?}");
    }
    read
}

/// The message of the refusal.
fn refused(text: &str) -> String {
    let error = sounding::parse(text).expect_err("must be refused");
    assert_eq!(error.code, "bad_sounding", "{error}");
    error.message
}

fn table(rows: &str) -> String {
    format!("%TITLE%\n XYZ 260621/1200\n\n   LEVEL HGHT TEMP DWPT WDIR WSPD\n%RAW%\n{rows}\n%END%\n")
}

/// One row of the Wyoming list; `None` leaves its columns blank.
fn wyoming_row(values: [Option<f64>; 6]) -> String {
    let columns = [
        values[0],
        values[1],
        values[2],
        values[3],
        Some(50.0),
        Some(3.4),
        values[4],
        values[5],
    ];
    let mut row: String = columns
        .iter()
        .map(|v| v.map_or(" ".repeat(7), |v| format!("{v:7.1}")))
        .collect();
    row.push_str(&format!("{:7.1}{:7.1}{:7.1}", 280.0, 290.0, 281.0));
    row
}

fn wyoming(rows: &[String]) -> String {
    let rule = "-".repeat(77);
    let names = "   PRES   HGHT   TEMP   DWPT   RELH   MIXR   DRCT   SKNT   THTA   THTE   THTV";
    let units = "    hPa     m      C      C      %    g/kg    deg   knot     K      K      K ";
    format!(
        "72357 OUN Norman Observations at 12Z 22 Dec 2018\n\n{rule}\n{names}\n{units}\n{rule}\n{}\n",
        rows.join("\n")
    )
}

#[test]
fn omaha_in_the_spc_form() {
    let read = good(OMAHA);
    assert_eq!(read.title.as_deref(), Some("OAX 140616/1900"));
    let ground = read.levels[0];
    assert!(
        (ground.pressure_pa - 96_500.0).abs() < 1e-6 && ground.height_m == 350.0,
        "{ground:?}"
    );
    // 23 knots from 150 degrees: towards the west and the north.
    let speed = 23.0 * 1852.0 / 3600.0;
    let (x, y) = (ground.wind_x_m_s.expect("wind"), ground.wind_y_m_s.expect("wind"));
    assert!(
        (x + speed * 0.5).abs() < 1e-9 && (y - speed * 0.866_025_403_784).abs() < 1e-9,
        "{x}, {y}"
    );
    assert!(
        read.notes.iter().any(|note| note.starts_with("line 7:")),
        "row below ground: {:?}",
        read.notes
    );
    // 377.51 m has no wind: between 350 m (150 deg, 23 kt) and 610 m (145 deg, 29.99 kt).
    let second = read.levels[1];
    assert_eq!(second.height_m, 377.51);
    let next = &read.levels[2];
    let share = (377.51 - 350.0) / (610.0 - 350.0);
    let expected = x + share * (next.wind_x_m_s.expect("wind") - x);
    assert!((second.wind_x_m_s.expect("filled") - expected).abs() < 1e-9);
}

#[test]
fn norman_in_its_html_page() {
    let read = good(NORMAN);
    assert_eq!(
        read.title.as_deref(),
        Some("72357 OUN Norman Observations at 12Z 22 Dec 2018")
    );
    let ground = read.levels[0];
    assert!((ground.pressure_pa - 96_600.0).abs() < 1e-6 && ground.height_m == 345.0);
    assert!(
        (ground.temperature_k - 276.75).abs() < 1e-9 && (ground.dewpoint_k.expect("dew point") - 271.95).abs() < 1e-9
    );
    assert!(
        read.notes
            .iter()
            .any(|note| note.contains("pressure of an earlier row")),
        "duplicates: {:?}",
        read.notes
    );
    let count_431 = read
        .levels
        .iter()
        .filter(|level| (level.pressure_pa - 43_100.0).abs() < 0.1)
        .count();
    assert_eq!(count_431, 1);
    assert!(
        read.levels.iter().all(|level| level.wind_x_m_s.is_some()),
        "the two highest rows have no wind of their own"
    );
}

#[test]
fn the_bare_list_reads_like_the_page() {
    let start = NORMAN.find("-----").expect("a rule");
    let end = NORMAN.find("</PRE>").expect("an end");
    let bare = format!("72357 OUN Norman\n\n{}", &NORMAN[start..end]);
    assert_eq!(good(&bare).levels, good(NORMAN).levels);
    let crlf = bare.replace('\n', "\r\n");
    assert_eq!(good(&crlf).levels, good(NORMAN).levels);
}

#[test]
fn rows_in_any_order_and_twice() {
    let rows = [
        "1000,100,20,15,90,10",
        "900,1000,12,8,-9999,-9999",
        "800,2000,5,0,90,30",
    ];
    let straight = good(&table(&rows.join("\n")));
    let turned = good(&table(&[rows[2], rows[0], rows[1]].join("\n")));
    assert_eq!(straight.levels, turned.levels);
    // The second of two rows at 900 hPa gives only what the first lacked.
    let twice = good(&table(&[rows[0], rows[1], "900,1000,11,9,180,20", rows[2]].join("\n")));
    assert_eq!(twice.levels.len(), 3);
    assert!((twice.levels[1].temperature_k - 285.15).abs() < 1e-9);
    let (x, y) = (
        twice.levels[1].wind_x_m_s.expect("wind"),
        twice.levels[1].wind_y_m_s.expect("wind"),
    );
    assert!(
        x.abs() < 1e-9 && (y - 20.0 * 1852.0 / 3600.0).abs() < 1e-9,
        "from the south: {x}, {y}"
    );
    assert!(
        twice.notes.iter().any(|note| note.contains("earlier row")),
        "{:?}",
        twice.notes
    );
}

#[test]
fn holes_are_filled_or_noted() {
    let read = good(&table(
        "1000,100,20,-9999,-9999,-9999\n900,1000,12,13,-9999,-9999\n800,2000,5,0,-9999,-9999",
    ));
    assert_eq!(read.levels[0].dewpoint_k, None, "a missing dew point stays missing");
    assert_eq!(
        read.levels[1].dewpoint_k,
        Some(read.levels[1].temperature_k),
        "13 above 12 C is set to 12"
    );
    assert!(read.levels.iter().all(|level| level.wind_x_m_s.is_none()));
    for part in ["no winds", "dew point above"] {
        assert!(
            read.notes.iter().any(|note| note.contains(part)),
            "{part}: {:?}",
            read.notes
        );
    }
    // A row with wind and height only is no level, but its wind counts.
    let read = good(&table(
        "1000,0,20,15,90,0\n950,500,-9999,-9999,270,20\n900,1000,12,8,-9999,-9999",
    ));
    assert_eq!(read.levels.len(), 2);
    assert!((read.levels[1].wind_x_m_s.expect("nearest") - 20.0 * 1852.0 / 3600.0).abs() < 1e-9);
}

#[test]
fn blanks_in_the_wyoming_list() {
    let rows = [
        wyoming_row([Some(1000.0), Some(65.0), None, None, None, None]),
        wyoming_row([Some(966.0), Some(345.0), Some(3.6), Some(-1.2), Some(90.0), Some(10.0)]),
        wyoming_row([Some(900.0), Some(900.0), Some(7.2), None, None, None]),
        wyoming_row([Some(850.0), Some(1400.0), Some(5.0), Some(-4.0), Some(90.0), Some(20.0)]),
    ];
    let read = good(&wyoming(&rows));
    assert_eq!(read.levels.len(), 3);
    assert_eq!(read.levels[1].dewpoint_k, None);
    assert!(read.levels[1].wind_x_m_s.expect("filled") < -5.0);
    // Newer pages give the wind in m/s.
    let newer = wyoming(&rows).replace("SKNT", "SPED").replace("knot", " m/s");
    assert!((good(&newer).levels[0].wind_x_m_s.expect("wind") + 10.0).abs() < 1e-9);
}

#[test]
fn levels_below_the_station_are_dropped() {
    let rows: Vec<String> = [(1000.0, 65.0), (966.0, 345.0), (900.0, 900.0)]
        .map(|(p, z)| wyoming_row([Some(p), Some(z), Some(5.0), Some(0.0), Some(90.0), Some(10.0)]))
        .into();
    let with_station = format!(
        "<PRE>\n{}</PRE><PRE>\n   Station elevation: 345.0\n</PRE>",
        wyoming(&rows)
    );
    let read = good(&with_station);
    assert_eq!(read.levels[0].height_m, 345.0);
    assert!(
        read.notes.iter().any(|note| note.contains("below the station")),
        "{:?}",
        read.notes
    );
    assert_eq!(
        good(&wyoming(&rows)).levels[0].height_m,
        65.0,
        "without an elevation the lowest complete row is the ground"
    );
}

#[test]
fn cut_in_half_anywhere() {
    // Whatever the place of the cut: a sounding of fewer levels, or a refusal; never a level that the whole file lacks.
    for (name, text) in [("Omaha", OMAHA), ("Norman", NORMAN)] {
        let whole = good(text);
        let (mut read, mut refused) = (0, 0);
        for cut in (0..text.len()).filter(|cut| text.is_char_boundary(*cut)) {
            match sounding::parse(&text[..cut]) {
                Ok(part) => {
                    read += 1;
                    for level in &part.levels {
                        let twin = whole.levels.iter().find(|other| other.pressure_pa == level.pressure_pa);
                        let twin = twin.unwrap_or_else(|| panic!("{name} cut at {cut}: invented {level:?}"));
                        assert_eq!(
                            (level.height_m, level.temperature_k),
                            (twin.height_m, twin.temperature_k),
                            "{name} cut at {cut}"
                        );
                    }
                }
                Err(error) => {
                    refused += 1;
                    assert_eq!(error.code, "bad_sounding", "{name} cut at {cut}");
                    assert!(
                        !error.message.contains("is not a number"),
                        "{name} cut at {cut}: {error}"
                    );
                }
            }
        }
        assert!(read > 1000 && refused > 100, "{name}: {read} read, {refused} refused");
    }
    let half = sounding::parse(&OMAHA[..OMAHA.len() / 2 + 3]).expect("half a sounding is one");
    assert!(half.notes.iter().any(|note| note.contains("cut")), "{:?}", half.notes);
}

#[test]
fn text_in_a_number_column() {
    let message = refused(&table(
        "1000,100,20,15,90,10\n900,1000,warm,8,90,10\n800,2000,5,0,90,10",
    ));
    for part in ["line 7", "column 3", "temperature", "warm"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    for junk in ["nan", "inf", "1e3", "0x10", "12,5;", "--5", "5-", "１２"] {
        let text = table(&format!(
            "1000,100,20,15,90,10\n900,{junk},12,8,90,10\n800,2000,5,0,90,10"
        ));
        refused(&text);
    }
    let rows = [(1000.0, 65.0), (900.0, 900.0), (800.0, 1900.0)]
        .map(|(p, z)| wyoming_row([Some(p), Some(z), Some(5.0), Some(0.0), Some(90.0), Some(10.0)]));
    let message = refused(&wyoming(&rows).replace("  900.0  900.0    5.0", "  900.0  900.0    hot"));
    assert!(message.contains("line 8") && message.contains("column 3"), "{message}");
}

#[test]
fn numbers_that_cannot_be() {
    for (row, part) in [
        ("1e9,100,20,15,90,10", "pressure"),
        ("-5,100,20,15,90,10", "pressure"),
        ("2000,100,20,15,90,10", "pressure"),
        ("1000,100,80,15,90,10", "temperature"),
        ("1000,100,20,15,400,10", "wind direction"),
        ("1000,100,20,15,90,-3", "wind speed"),
        ("1000,90000,20,15,90,10", "height"),
        ("1000,100,20,15,90", "columns"),
        ("1000,100,20,15,90,10,7", "columns"),
    ] {
        let message = refused(&table(&format!("{row}\n900,1000,12,8,90,10\n800,2000,5,0,90,10")));
        assert!(message.contains(part) && message.contains("line 6"), "{row}: {message}");
    }
}

#[test]
fn pressures_that_rise() {
    let message = refused(&table("800,100,20,15,90,10\n900,1000,12,8,90,10\n1000,2000,5,0,90,10"));
    assert!(
        message.contains("at least 2") && message.contains("1 usable row of 3") && message.contains("next higher"),
        "{message}"
    );
    // One bad row among good ones goes alone.
    let read = good(&table(
        "1000,100,20,15,90,10\n900,1000,12,8,90,10\n850,900,12,8,90,10\n800,2000,5,0,90,10",
    ));
    assert_eq!(read.levels.len(), 3);
    assert!(
        read.notes
            .iter()
            .any(|note| note.starts_with("line 8:") && note.contains("not above")),
        "{:?}",
        read.notes
    );
}

#[test]
fn too_few_rows() {
    assert!(refused(&table("")).contains("0 usable rows"));
    assert!(refused(&table("1000,100,20,15,90,10")).contains("1 usable row of 1"));
    assert!(refused(&table("1000,100,20,15,90,10\n1000,100,20,15,90,10")).contains("1 usable row of 2"));
    assert!(refused(&table("1000,-9999,20,15,90,10\n900,1000,-9999,8,90,10")).contains("0 usable rows of 2"));
    assert!(refused(&wyoming(&[])).contains("0 usable rows"));
}

#[test]
fn not_soundings_at_all() {
    assert!(refused("").contains("empty"));
    assert!(refused(" \n\t\n").contains("empty"));
    assert!(refused("{\"version\": 1}").contains("neither"));
    assert!(refused("%RAW").contains("neither"));
    assert!(refused(&"PRES HGHT TEMP DWPT\n\0\u{1}\u{2}junk\n".repeat(3)).contains("line 2"));
    let large = table(&"1000,100,20,15,90,10\n".repeat(60_000));
    assert!(large.len() > sounding::MAX_BYTES && refused(&large).contains("too many"));
    let binary: Vec<u8> = (0..4096_u32)
        .map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8)
        .collect();
    assert_eq!(sounding::parse_bytes(&binary).expect_err("binary").code, "bad_sounding");
    assert_eq!(sounding::parse_bytes(OMAHA.as_bytes()).expect("text"), good(OMAHA));
}

#[test]
fn no_bent_byte_panics() {
    // Every byte of both files turned into something else: read or refused, never more.
    for text in [OMAHA, NORMAN] {
        for place in (0..text.len().min(4000)).step_by(3) {
            for byte in [0, b'-', b'.', b',', b'<', b'%', b'9', 0xC3] {
                let mut bent = text.as_bytes().to_vec();
                bent[place] = byte;
                if let Err(error) = sounding::parse_bytes(&bent) {
                    assert_eq!(error.code, "bad_sounding");
                }
            }
        }
    }
}
