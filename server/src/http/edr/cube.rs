//! `GET /collections/{id}/cube`: the world's own cells in a box of longitude, latitude and altitude.

use axum::extract::State;
use axum::response::Response;
use welkin_proto::ApiError;

use super::coverage::answer;
use super::grid::{asked_of, centres_within, cover};
use super::query::{self, Heights};
use crate::http::error::Refusal;
use crate::http::extract::{Pairs, WorldOf};
use crate::http::route::{Place, Route};
use crate::http::sampling;
use crate::http::state::AppState;

/// The route.
pub fn route() -> Route {
    Route::get("/collections/{id}/cube", "The cells in a box (OGC API EDR)", cube)
        .edr_query()
        .parameter::<String>(
            Place::Query,
            "bbox",
            "west,south,east,north in degrees; or west,south,low,east,north,high with altitudes in metres. Cells whose centres lie in it are answered.",
        )
        .edr_z("Altitudes above mean sea level, m: `low/high`, a list, or `Rn/low/step`; all levels.")
        .edr_datetime("A simulated instant, or `from/to` for all that are kept; the newest.")
}

async fn cube(State(state): State<AppState>, WorldOf(host): WorldOf, Pairs(pairs): Pairs) -> Result<Response, Refusal> {
    let view = host.view().clone();
    drop(host); // the world may be stopped meanwhile
    let mut asked = query::parse(&pairs, &["bbox", "z", "datetime"], &view)?;
    let [west, south, east, north] = match asked.bbox.as_deref() {
        Some(&[west, south, east, north]) => [west, south, east, north],
        Some(&[west, south, low, east, north, high]) => {
            if asked.heights != Heights::All {
                let message = "give altitudes in `bbox` or in `z`, not in both";
                return Err(ApiError::new("bad_parameter", message).at("/z").into());
            }
            asked.heights = Heights::Between(low, high);
            [west, south, east, north]
        }
        _ => {
            let message = "`bbox` is missing: west,south,east,north in degrees";
            return Err(ApiError::new("bad_parameter", message).at("/bbox").into());
        }
    };
    let [x_m, y_m] = centres_within(&view, west, south, east, north);
    if x_m.is_empty() || y_m.is_empty() {
        let message = "no cell has its centre in the box; see the collection's extent";
        return Err(ApiError::new("outside_domain", message).at("/bbox").into());
    }
    let (axes, moments) = asked_of(&view, &asked, [x_m, y_m], state.limits().edr_values_max).await?;
    let work = move || cover(&view, &axes, &moments, &asked.quantities, None);
    Ok(answer(sampling::work(&state, work).await?))
}
