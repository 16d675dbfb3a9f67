//! `GET /v1/scenes`: the scene presets.

use axum::Json;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use welkin_proto::presets;

use super::route::Route;

/// A preset in the list.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SceneSummary {
    /// Names it in `/v1/scenes/{name}`, `POST /v1/worlds` and on the command line.
    pub name: String,
    /// One line on what it shows.
    pub description: String,
}

/// The route.
pub fn route() -> Route {
    Route::get("/v1/scenes", "The scene presets", async || Json(list())).json::<Vec<SceneSummary>>(200, "All presets.")
}

/// All presets with one line each.
pub fn list() -> Vec<SceneSummary> {
    presets::all()
        .iter()
        .filter_map(|preset| {
            let description = presets::find(preset.name).ok()?.description;
            Some(SceneSummary {
                name: preset.name.to_owned(),
                description,
            })
        })
        .collect()
}
