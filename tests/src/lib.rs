//! What all of Welkin's tests share; they live beside this file, one folder a kind.

use std::fmt::Display;
use std::io::Write;

/// Says loudly that `what` was not tested because something is missing, past the test harness's capture, so that nobody takes it for a test that ran.
///
/// Panics where the environment variable `WELKIN_REQUIRE` (names with commas between) has `needs`.
pub fn skip(what: &str, needs: &str, missing: impl Display) {
    let required = std::env::var("WELKIN_REQUIRE").unwrap_or_default();
    assert!(
        !required.split(',').any(|name| name.trim() == needs),
        "WELKIN_REQUIRE names {needs}; missing: {missing}"
    );
    // Where nobody reads standard error there is nobody to tell.
    let _ = writeln!(
        std::io::stderr(),
        "\n*** SKIP: {what} was NOT tested; missing: {missing}\n"
    );
}
