//! The `welkin` binary. Nothing but this file reads the environment.

use std::process::ExitCode;

fn main() -> ExitCode {
    welkin_server::cli::run(std::env::args_os(), std::env::var("RUST_LOG").ok())
}
