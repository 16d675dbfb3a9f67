//! `GET /healthz`: whether the server lives, for load balancers and people.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use welkin_proto::wire::HealthState;

use super::route::Route;
use super::state::AppState;
use super::viewing;

/// The server's health.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Health {
    /// `ok`; `degraded` where a world is not good but runs on; `halted` where one has stopped by itself (the status is then 503).
    pub status: String,
    /// The server's version.
    pub version: String,
    /// What the worlds run on, each device once.
    pub devices: Vec<String>,
    /// Wall seconds since the start.
    pub uptime_s: f64,
    /// The server's clock, milliseconds since 1970-01-01T00:00Z: half a round trip away from what a client's clock should say.
    pub unix_ms: f64,
    /// Open streams.
    pub streams: u64,
    /// Bytes kept of viewers' last pictures for their next, where pictures build on one another.
    pub last_picture_bytes: u64,
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
    /// What its watchdog says.
    pub health: HealthState,
    /// Stable code of its last trouble; absent where there was none.
    pub trouble_code: Option<String>,
    /// The last trouble and what was done about it.
    pub trouble_message: Option<String>,
    /// Tick of the last trouble.
    pub trouble_tick: Option<u64>,
    /// Tries of a tick that were thrown away, since the start.
    pub retries: u64,
    /// Times that it went back to an earlier state, since the start.
    pub restores: u64,
}

/// The route.
pub fn route() -> Route {
    Route::get("/healthz", "Whether the server and its worlds are alive", healthz)
        .json::<Health>(200, "Every world runs; one may be degraded.")
        .json::<Health>(503, "A world has stopped by itself.")
}

async fn healthz(State(state): State<AppState>) -> (StatusCode, Json<Health>) {
    let mut devices = Vec::new();
    let mut worlds = Vec::new();
    for host in state.worlds() {
        let newest = host.view().newest();
        let device = host.view().device().to_owned();
        if !devices.contains(&device) {
            devices.push(device);
        }
        let numbers = &newest.snapshot.numbers;
        worlds.push(WorldHealth {
            id: host.view().id.to_string(),
            running: host.view().is_running(),
            paused: numbers.paused,
            tick: numbers.tick,
            tick_age_s: newest.at.elapsed().as_secs_f64(),
            health: numbers.health,
            trouble_code: numbers.trouble_code.clone(),
            trouble_message: numbers.trouble_message.clone(),
            trouble_tick: numbers.trouble_tick,
            retries: numbers.retries,
            restores: numbers.restores,
        });
    }
    let runs = worlds.iter().all(|w| w.running && w.health != HealthState::Halted);
    let good = worlds.iter().all(|w| w.health == HealthState::Good);
    let health = Health {
        status: match (runs, good) {
            (false, _) => "halted",
            (true, false) => "degraded",
            (true, true) => "ok",
        }
        .to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        devices,
        uptime_s: state.started().elapsed().as_secs_f64(),
        unix_ms: viewing::unix_ms(),
        streams: state.stream_count() as u64,
        last_picture_bytes: state.renderer().last_picture_bytes() as u64,
        worlds,
    };
    (
        if runs {
            StatusCode::OK
        } else {
            StatusCode::SERVICE_UNAVAILABLE
        },
        Json(health),
    )
}
