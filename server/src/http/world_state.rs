//! `GET /v1/worlds/{id}`: what a world is and how it stands.

use axum::Json;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use welkin_proto::Scene;
use welkin_proto::report::BaseStateReport;
use welkin_proto::wire::Numbers;

use super::extract::WorldOf;
use super::route::Route;

/// A world's whole state apart from its fields.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WorldState {
    /// Names it in URLs.
    pub id: String,
    /// What it runs on.
    pub device: String,
    /// Its newest numbers.
    pub numbers: Numbers,
    /// The report on its base state: surface values, lifting condensation level, CAPE, warnings on the sounding.
    pub base_state: BaseStateReport,
    /// The scene it was started from.
    pub scene: Scene,
}

/// The route.
pub fn route() -> Route {
    Route::get(
        "/v1/worlds/{id}",
        "A world's scene, base state and newest numbers",
        state,
    )
    .of_world()
    .json::<WorldState>(200, "The world.")
}

async fn state(WorldOf(host): WorldOf) -> Json<WorldState> {
    let summary = host.summary();
    Json(WorldState {
        id: summary.id,
        device: summary.device,
        numbers: summary.numbers,
        base_state: host.base_state().clone(),
        scene: host.view().newest().snapshot.scene.as_ref().clone(),
    })
}
