//! `GET /v1/worlds/{id}/stars.bin`: the table of stars over a world, for clients that draw with the kernels of the view.

use axum::http::header;
use axum::response::{IntoResponse, Response};
use welkin_proto::ApiError;

use super::error::Refusal;
use super::extract::WorldOf;
use super::route::Route;
use crate::scenery;

/// The route.
pub fn route() -> Route {
    let summary = "The table of stars over a world as the view's kernels bind it: 32-bit words, little endian";
    Route::get("/v1/worlds/{id}/stars.bin", summary, of)
        .of_world()
        .bytes(200, "The words of `star_words`.", &["application/octet-stream"])
        .error("no_stars")
}

async fn of(WorldOf(host): WorldOf) -> Result<Response, Refusal> {
    let words = scenery::star_words(&host.view().newest().snapshot)
        .ok_or_else(|| ApiError::new("no_stars", "the world's scene does not name the effect `stars`"))?;
    Ok(([(header::CONTENT_TYPE, "application/octet-stream")], words).into_response())
}
