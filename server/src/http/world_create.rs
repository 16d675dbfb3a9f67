//! `POST /v1/worlds`: start a world from a preset or a posted scene.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderName, StatusCode, header};
use welkin_proto::wire::{CreateWorld, WorldSummary};

use super::error::Refusal;
use super::extract::{JsonText, parse_json, read, take_scene};
use super::route::Route;
use super::state::AppState;

/// The route.
pub fn route() -> Route {
    Route::post(
        "/v1/worlds",
        "Start a world from a preset or a scene; it stops when nobody has looked at it for a while",
        create,
    )
    .body::<CreateWorld>()
    .json::<WorldSummary>(201, "It runs; `Location` names it.")
    .error("out_of_range")
    .error("unknown_preset")
    .error("too_many_worlds")
    .error("unstable")
}

async fn create(
    State(state): State<AppState>,
    JsonText(text): JsonText,
) -> Result<(StatusCode, [(HeaderName, String); 1], Json<WorldSummary>), Refusal> {
    let mut document = parse_json(&text)?;
    let scene = take_scene(&mut document, state.limits())?;
    let CreateWorld { .. } = read(document)?; // refuses fields that nobody knows
    let summary = state.create_passing_world(scene).await?.summary();
    let location = format!("/v1/worlds/{}", summary.id);
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], Json(summary)))
}
