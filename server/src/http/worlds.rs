//! `GET /v1/worlds`: the worlds that run.

use axum::Json;
use axum::extract::State;
use welkin_proto::wire::WorldSummary;

use super::route::Route;
use super::state::AppState;

/// The route.
pub fn route() -> Route {
    Route::get("/v1/worlds", "The worlds that run, oldest first", worlds).json::<Vec<WorldSummary>>(200, "All worlds.")
}

async fn worlds(State(state): State<AppState>) -> Json<Vec<WorldSummary>> {
    Json(state.worlds().iter().map(|host| host.summary()).collect())
}
