//! `GET /v1/scenes/{name}`: a preset as a whole document.

use axum::Json;
use welkin_proto::{ApiError, Scene, presets};

use super::error::Refusal;
use super::extract::NameOf;
use super::route::{Place, Route};

/// The route.
pub fn route() -> Route {
    Route::get(
        "/v1/scenes/{name}",
        "A scene preset, ready to be changed and posted",
        scene,
    )
    .parameter::<String>(Place::Path, "name", "A preset's name, as `GET /v1/scenes` lists it.")
    .json::<Scene>(200, "The scene.")
    .error("unknown_scene")
}

async fn scene(NameOf(name): NameOf) -> Result<Json<Scene>, Refusal> {
    // Here the name is the resource itself, so that an unknown one is 404.
    let scene = presets::find(&name).map_err(|error| ApiError {
        code: "unknown_scene".to_owned(),
        ..error
    })?;
    Ok(Json(scene))
}
