//! `GET /healthz`: whether the server lives, for load balancers and people.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::route::Route;
use super::state::AppState;

/// The server's health.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Health {
    /// `ok`, or `degraded` where a world has stopped by itself (the status is then 503).
    pub status: String,
    /// The server's version.
    pub version: String,
    /// What the worlds run on, each device once.
    pub devices: Vec<String>,
    /// Wall seconds since the start.
    pub uptime_s: f64,
    /// Open streams.
    pub streams: u64,
    /// Each world.
    pub worlds: Vec<WorldHealth>,
}

/// One world's health.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WorldHealth {
    /// The world's id.
    pub id: String,
    /// Whether its thread runs.
    pub running: bool,
    /// Whether its clock stands because somebody paused it.
    pub paused: bool,
    /// Its newest tick.
    pub tick: u64,
    /// Wall seconds since it last published.
    pub tick_age_s: f64,
}

/// The route.
pub fn route() -> Route {
    Route::get("/healthz", "Whether the server and its worlds are alive", healthz)
        .json::<Health>(200, "All is well.")
        .json::<Health>(503, "A world has stopped by itself.")
}

async fn healthz(State(state): State<AppState>) -> (StatusCode, Json<Health>) {
    let mut devices = Vec::new();
    let mut worlds = Vec::new();
    for host in state.worlds() {
        let newest = host.view().newest();
        let device = newest.snapshot.plan.device.clone();
        if !devices.contains(&device) {
            devices.push(device);
        }
        worlds.push(WorldHealth {
            id: host.view().id.to_string(),
            running: host.view().is_running(),
            paused: newest.snapshot.numbers.paused,
            tick: newest.snapshot.numbers.tick,
            tick_age_s: newest.at.elapsed().as_secs_f64(),
        });
    }
    let well = worlds.iter().all(|w| w.running);
    let health = Health {
        status: if well { "ok" } else { "degraded" }.to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        devices,
        uptime_s: state.started().elapsed().as_secs_f64(),
        streams: state.stream_count() as u64,
        worlds,
    };
    (
        if well {
            StatusCode::OK
        } else {
            StatusCode::SERVICE_UNAVAILABLE
        },
        Json(health),
    )
}
