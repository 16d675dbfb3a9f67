//! `GET /v1/worlds/{id}/past`: which moments of the last minutes the server has kept.

use axum::Json;
use axum::extract::State;
use welkin_proto::volume::past::PastReport;

use super::extract::WorldOf;
use super::route::{Place, Route};
use super::state::AppState;

/// The route.
pub fn route() -> Route {
    let summary = "Moments of the last minutes whose sky is kept";
    Route::get("/v1/worlds/{id}/past", summary, past)
        .of_world()
        .json::<PastReport>(200, "The moments, oldest first; none where nothing is kept.")
}

impl Route {
    /// With the parameters that name a kept moment for a picture.
    pub(super) fn past_parameters(self) -> Self {
        self.parameter::<u64>(
            Place::Query,
            "tick",
            "The sky of this tick, if the past has kept it; the newest.",
        )
        .parameter::<f64>(
            Place::Query,
            "simulated_s",
            "The sky of this simulated second: the last that the past has kept at or before it.",
        )
    }
    /// With the errors that asking for a kept moment can give.
    pub(super) fn past_errors(mut self) -> Self {
        self.errors
            .extend(["too_old", "not_yet", "tick_not_kept", "past_unavailable"]);
        self
    }
}

async fn past(State(state): State<AppState>, WorldOf(host): WorldOf) -> Json<PastReport> {
    Json(host.view().past_sky().report(state.limits()))
}
