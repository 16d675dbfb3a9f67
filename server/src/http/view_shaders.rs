//! `GET /v1/shaders/view.json`: the kernels that draw pictures, for clients that draw with them.

use std::sync::OnceLock;

use axum::Json;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use welkin_proto::view::ViewShaders;

use super::error::Refusal;
use super::route::Route;
use crate::scenery;

/// Made once: it says nothing of any world.
static SHADERS: OnceLock<ViewShaders> = OnceLock::new();

/// The route.
pub fn route() -> Route {
    let summary = "The WGSL kernels that draw pictures, with what they bind and how their structs lie in memory";
    Route::get("/v1/shaders/view.json", summary, shaders)
        .json::<ViewShaders>(200, "The kernels.")
        .error("internal")
}

async fn shaders() -> Result<Response, Refusal> {
    let shaders = match SHADERS.get() {
        Some(shaders) => shaders,
        None => {
            let made = scenery::view_shaders()?;
            SHADERS.get_or_init(|| made)
        }
    };
    Ok(([(header::CACHE_CONTROL, "no-cache")], Json(shaders)).into_response())
}
