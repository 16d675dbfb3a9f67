//! `DELETE /v1/worlds/{id}`: stop a world.

use axum::extract::State;
use axum::http::StatusCode;

use super::error::Refusal;
use super::extract::NameOf;
use super::route::Route;
use super::state::AppState;

/// The route.
pub fn route() -> Route {
    Route::delete("/v1/worlds/{id}", "Stop a world and end its streams", delete)
        .of_world()
        .bytes(204, "It has stopped.", &[])
}

async fn delete(State(state): State<AppState>, NameOf(id): NameOf) -> Result<StatusCode, Refusal> {
    state.delete_world(&id).await?;
    Ok(StatusCode::NO_CONTENT)
}
