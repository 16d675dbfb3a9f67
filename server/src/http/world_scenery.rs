//! `GET /v1/worlds/{id}/scenery`: what a world tells the kernels of the view, for clients that draw with them.

use axum::Json;
use welkin_proto::view::Scenery;

use super::error::Refusal;
use super::extract::WorldOf;
use super::route::Route;
use crate::scenery;

/// The route.
pub fn route() -> Route {
    let summary = "What a world tells the kernels of the view; it changes only with the world's effects";
    Route::get("/v1/worlds/{id}/scenery", summary, of)
        .of_world()
        .json::<Scenery>(200, "Values of members of uniforms.")
        .error("method_needs_cpu")
}

async fn of(WorldOf(host): WorldOf) -> Result<Json<Scenery>, Refusal> {
    Ok(Json(scenery::scenery(&host.view().newest().snapshot)?))
}
