//! `GET /v1/schema/scene`: the JSON Schema of a scene.

use axum::http::header;
use axum::response::{IntoResponse, Response};
use welkin_proto::validate;

use super::error::{Refusal, internal};
use super::route::Route;

/// The route.
pub fn route() -> Route {
    Route::get("/v1/schema/scene", "The JSON Schema of a scene document", schema).bytes(
        200,
        "The schema.",
        &["application/schema+json"],
    )
}

async fn schema() -> Result<Response, Refusal> {
    let text = serde_json::to_string_pretty(&validate::schema()).map_err(internal)?;
    Ok(([(header::CONTENT_TYPE, "application/schema+json")], text).into_response())
}
