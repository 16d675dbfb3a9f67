//! `POST /v1/worlds/{id}/commands`: pause, resume, time scale, sun, wind.

use axum::http::StatusCode;
use welkin_proto::wire::Command;

use super::error::Refusal;
use super::extract::{JsonText, WorldOf, parse_json, read};
use super::route::Route;

/// The route.
pub fn route() -> Route {
    Route::post("/v1/worlds/{id}/commands", "Tell a world what to do", command)
        .of_world()
        .body::<Command>()
        .bytes(202, "The world takes it before its next tick.", &[])
        .error("out_of_range")
        .error("world_stopped")
}

async fn command(WorldOf(host): WorldOf, JsonText(text): JsonText) -> Result<StatusCode, Refusal> {
    let command: Command = read(parse_json(&text)?)?;
    host.view().command(command)?;
    Ok(StatusCode::ACCEPTED)
}
