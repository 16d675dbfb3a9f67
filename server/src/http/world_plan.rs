//! `GET /v1/worlds/{id}/plan`: what runs, why, and what it costs.

use axum::Json;
use welkin_proto::wire::PlanReport;

use super::extract::WorldOf;
use super::route::Route;

/// The route.
pub fn route() -> Route {
    Route::get(
        "/v1/worlds/{id}/plan",
        "A world's passes, why each is there, its fields and what they cost",
        plan,
    )
    .of_world()
    .json::<PlanReport>(200, "The plan with the times measured so far.")
}

async fn plan(WorldOf(host): WorldOf) -> Json<PlanReport> {
    Json(host.view().plan())
}
