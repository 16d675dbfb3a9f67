//! `welkin serve`.

use std::io::ErrorKind;
use std::net::SocketAddr;

use clap::Args;
use tokio::net::TcpListener;
use welkin_proto::{Scene, presets};

use super::{Failure, Outcome, SceneFlags, print_line};
use crate::http::{AppState, serve_until};
use crate::limits::Limits;
use crate::priority;

pub(super) const EXAMPLES: &str = "\
Examples:
  welkin serve
  welkin serve --scene my-scene.json --listen 0.0.0.0:9000 --max-worlds 8
  welkin serve --scene fair-weather-cumulus --sounding omaha.txt";

#[derive(Args)]
pub(super) struct Options {
    /// Address and port to listen on; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// The first world's scene: a preset's name or the path of a JSON document.
    #[arg(long, value_name = "SCENE", default_value = presets::DEFAULT)]
    scene: String,
    #[command(flatten)]
    flags: SceneFlags,
    /// What the server refuses.
    #[command(flatten, next_help_heading = "Limits")]
    pub(super) limits: Limits,
}

pub(super) fn run(options: Options) -> Result<Outcome, Failure> {
    options.flags.size_pool(Some(priority::DRAWING));
    let scene = options.flags.load(&options.scene, &options.limits.scene())?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .on_thread_start(|| priority::step_back(priority::SERVING))
        .build();
    let runtime = runtime.map_err(|error| Failure(format!("cannot start the async runtime: {error}")))?;
    runtime.block_on(serve(options, scene))
}

async fn serve(options: Options, scene: Scene) -> Result<Outcome, Failure> {
    // The port first: where it is taken, nobody should wait for a world to be told so.
    let listener = TcpListener::bind(options.listen)
        .await
        .map_err(|error| listen_failure(options.listen, &error))?;
    let address = listener.local_addr().map_err(|error| Failure(error.to_string()))?;
    let name = scene.name.clone();
    let state = AppState::new(options.limits, options.flags.machine()?)?;
    let host = state.create_world(scene).await?;
    let device = host.summary().device;
    drop(host);
    print_line(&format!(
        "Welkin is at http://{address}/ (scene {name}, device {device}). Ctrl-C stops it."
    ))?;
    let stopping = async {
        stop_signal().await;
        tracing::info!("stopping");
    };
    serve_until(listener, state, stopping)
        .await
        .map_err(|error| Failure(format!("serving failed: {error}")))?;
    Ok(Outcome::Done)
}

fn listen_failure(address: SocketAddr, error: &std::io::Error) -> Failure {
    Failure(match error.kind() {
        ErrorKind::AddrInUse => format!(
            "{address} is taken, perhaps by another welkin; choose another with --listen, such as --listen {}:0 for any free port",
            address.ip()
        ),
        ErrorKind::PermissionDenied => {
            format!("{address} may not be listened on; choose a port above 1023 with --listen")
        }
        ErrorKind::AddrNotAvailable => {
            format!("{address} is not an address of this machine; choose another with --listen")
        }
        _ => format!("cannot listen on {address}: {error}"),
    })
}

/// Resolves at Ctrl-C or, on Unix, at SIGTERM, which is how service managers and containers stop a program.
async fn stop_signal() {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        if let Ok(mut terminate) = signal(SignalKind::terminate()) {
            tokio::select! {
                result = tokio::signal::ctrl_c() => never_on_error(result).await,
                _ = terminate.recv() => {}
            }
            return;
        }
    }
    never_on_error(tokio::signal::ctrl_c().await).await;
}

async fn never_on_error(result: std::io::Result<()>) {
    if let Err(error) = result {
        tracing::warn!(%error, "Ctrl-C cannot be caught; it will end the process at once");
        std::future::pending::<()>().await;
    }
}
