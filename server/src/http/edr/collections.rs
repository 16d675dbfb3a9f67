//! `GET /collections`: every world as a collection of the weather service.

use axum::Json;
use axum::extract::State;
use serde_json::{Value, json};

use super::Base;
use super::collection::describe;
use crate::http::error::Refusal;
use crate::http::route::Route;
use crate::http::state::AppState;

/// The route.
pub fn route() -> Route {
    Route::get(
        "/collections",
        "Worlds as collections of the weather service (OGC API EDR)",
        list,
    )
    .bytes(
        200,
        "The collections, each as `/collections/{id}` has it.",
        &["application/json"],
    )
}

async fn list(State(state): State<AppState>, Base(base): Base) -> Result<Json<Value>, Refusal> {
    let worlds = state.worlds();
    let collections = worlds.iter().map(|host| describe(host.view(), &base));
    let collections = collections.collect::<Result<Vec<Value>, _>>()?;
    Ok(Json(json!({
        "links": [{ "href": format!("{base}/collections"), "rel": "self", "type": "application/json" }],
        "collections": collections,
    })))
}
