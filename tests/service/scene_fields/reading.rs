//! Every scene field is read by something in the server: a knob that nothing reads is a defect.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;
use welkin_proto::validate;

/// Names of every property in a schema, each with the pointers of the types that have it.
fn properties(schema: &Value, at: &str, found: &mut BTreeMap<String, Vec<String>>) {
    match schema {
        Value::Object(object) => {
            for (key, inner) in object {
                if key == "properties" {
                    for (name, property) in inner.as_object().expect("properties are an object") {
                        // A tag tells the variants of an enum apart; it is read by the parser itself.
                        if property.get("const").is_none() {
                            found.entry(name.clone()).or_default().push(at.to_owned());
                        }
                    }
                }
                properties(inner, &format!("{at}/{key}"), found);
            }
        }
        Value::Array(list) => list.iter().for_each(|inner| properties(inner, at, found)),
        _ => {}
    }
}

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("the server's sources") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|end| end == "rs") {
            found.push(path);
        }
    }
}

/// Whether code (comments and tests taken out) reads a field: as `.name`, or as a name in a pattern's braces.
fn reads(code: &str, name: &str) -> bool {
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    code.match_indices(name).any(|(place, _)| {
        let (before, after) = (&code[..place], &code[place + name.len()..]);
        if before.ends_with(is_word) || after.starts_with(is_word) {
            return false;
        }
        if before.ends_with('.') {
            return !after.trim_start().starts_with('(');
        }
        let before = before.trim_end();
        (before.ends_with('{') || before.ends_with(',')) && after.trim_start().starts_with([',', '}', ':'])
    })
}

#[test]
fn every_scene_field_is_read() {
    // Read outside the server: `description` is shown in lists as it stands; `version` decides whether the rest is read at
    // all, in `validate`, which the tests above show.
    const ELSEWHERE: [&str; 2] = ["description", "version"];
    let mut files = Vec::new();
    sources(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../server/src"), &mut files);
    let mut code = String::new();
    for file in files {
        let text = fs::read_to_string(&file).expect("a source");
        let text = text.split("#[cfg(test)]\nmod ").next().unwrap_or_default();
        for line in text.lines() {
            code.push_str(line.split("//").next().unwrap_or_default());
            code.push('\n');
        }
    }
    let mut found = BTreeMap::new();
    properties(&validate::schema(), "", &mut found);
    for known in [
        "cells",
        "start_utc",
        "levels",
        "text",
        "droplet_number_per_m3",
        "cloud_shadow",
        "exposure_ev",
        "azimuth_deg",
    ] {
        assert!(
            found.contains_key(known),
            "the walk along the schema has missed {known}"
        );
    }
    let unread: Vec<_> = found
        .iter()
        .filter(|(name, _)| !ELSEWHERE.contains(&name.as_str()) && !reads(&code, name))
        .collect();
    assert!(unread.is_empty(), "no code in the server reads: {unread:#?}");
}

#[test]
fn the_reading_check_can_fail() {
    assert!(reads("let a = scene.domain;", "domain"));
    assert!(reads(
        "Sun::Fixed { elevation_deg, azimuth_deg: a } => 1",
        "azimuth_deg"
    ));
    assert!(!reads("let domain = 3;", "domain"), "a name alone is no reading");
    assert!(!reads("x.domain()", "domain"), "a method is no field");
    assert!(!reads("x.subdomain + x.domain_size", "domain"));
}
