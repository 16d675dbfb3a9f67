//! `GET /v1/worlds/{id}/depth`: where the cloud of a picture is, so that a client can put objects before and behind it.

use axum::extract::State;
use axum::response::Response;

use super::error::Refusal;
use super::extract::{Pairs, WorldOf};
use super::layers::{Wish, parameters};
use super::route::Route;
use super::state::AppState;
use crate::host::renderer::LayersWish;

/// The route.
pub fn route() -> Route {
    let summary = "How far away the cloud of a picture is, and how opaque";
    let answer = "PNG: 16-bit grey and alpha; grey is the mean distance of the cloud along the pixel's ray in metres, 65535 where there is none; alpha its \
                  opacity, 65535 is 1. f32: little-endian 32-bit floats, for each pixel the distance in metres (infinite where there is none) and the opacity \
                  from 0 to 1; rows from the top. With `X-Welkin-Size`, `X-Welkin-Tick`, `X-Welkin-Simulated-S`, `Server-Timing`.";
    parameters(Route::get("/v1/worlds/{id}/depth", summary, depth).of_world(), answer)
}

async fn depth(
    State(state): State<AppState>,
    WorldOf(host): WorldOf,
    Pairs(pairs): Pairs,
) -> Result<Response, Refusal> {
    let view = host.view().clone();
    drop(host); // the world may be stopped while the picture is drawn
    let mut wish = Wish::new(pairs, &view.scene.camera, state.limits())?;
    wish.request.layers = Some(LayersWish::Depth { raw: wish.raw });
    wish.answer(view, &state).await
}
