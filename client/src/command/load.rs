//! `load`: many clients at once against one server.

use std::time::Duration;

use clap::Args;
use welkin_client::load::{LoadOptions, run};

use super::volume::Wish;
use super::{Failure, print_line};

/// `load`.
#[derive(Args)]
pub struct Load {
    /// The server, such as http://127.0.0.1:8080; one of your own, started with `--max-streams` above the sum of both.
    url: String,
    /// The world's id; otherwise the server's first.
    #[arg(long, value_name = "ID")]
    world: Option<String>,
    /// Volume subscribers.
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = clap::value_parser!(u16).range(1..=10_000))]
    subscribers: u16,
    /// So many of them read slowly.
    #[arg(long, value_name = "N", default_value_t = 10)]
    slow: u16,
    /// Frame viewers, 320x180 at 2 frames a second.
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u16).range(0..=10_000))]
    viewers: u16,
    #[command(flatten)]
    wish: Wish,
    /// How long ticks are watched without the load, and then with it.
    #[arg(long, value_name = "TIME", default_value = "20s", value_parser = crate::duration)]
    each: Duration,
    /// The server's process id, to tell its memory where there is /proc.
    #[arg(long, value_name = "PID")]
    server_pid: Option<u32>,
}

/// Runs it.
pub async fn load(arguments: &Load) -> Result<(), Failure> {
    let options = LoadOptions {
        world: arguments.world.clone(),
        subscribers: arguments.subscribers.into(),
        subscription: arguments.wish.subscription(),
        slow: arguments.slow.into(),
        viewers: arguments.viewers.into(),
        each: arguments.each,
        server_pid: arguments.server_pid,
        ..LoadOptions::default()
    };
    let report = run(&arguments.url, &options).await?;
    print_line(report.to_string().trim_end()).map(|_| ())
}
