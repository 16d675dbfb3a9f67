//! `GET /collections/{id}/area`: the world's own cells in a polygon; null in those of its bounding box that are not in it.

use axum::extract::State;
use axum::response::Response;
use welkin_proto::ApiError;

use super::coverage::answer;
use super::grid::{asked_of, centres_within, cover};
use super::query;
use super::wkt::{self, Geometry, Vertex};
use crate::http::error::Refusal;
use crate::http::extract::{Pairs, WorldOf};
use crate::http::route::{Place, Route};
use crate::http::sampling;
use crate::http::state::AppState;

/// Most edges times columns of cells that are looked at, which takes about a tenth of a second.
const CROSSINGS_MAX: usize = 50_000_000;

/// The route.
pub fn route() -> Route {
    Route::get("/collections/{id}/area", "The cells in a polygon (OGC API EDR)", area)
        .edr_query()
        .parameter::<String>(
            Place::Query,
            "coords",
            "`POLYGON((lon lat, ...))`, with holes if need be. Cells whose centres lie in it are answered.",
        )
        .edr_z("Altitudes above mean sea level, m: one, a list, `low/high`, or `Rn/low/step`; all levels.")
        .edr_datetime("A simulated instant, or `from/to` for all that are kept; the newest.")
}

async fn area(State(state): State<AppState>, WorldOf(host): WorldOf, Pairs(pairs): Pairs) -> Result<Response, Refusal> {
    let view = host.view().clone();
    drop(host); // the world may be stopped meanwhile
    let asked = query::parse(&pairs, &["coords", "z", "datetime"], &view)?;
    let Geometry::Polygon(rings) = wkt::parse(query::coords(&asked)?, state.limits().sample_points_max)? else {
        return Err(ApiError::new("bad_coords", "`area` takes a POLYGON")
            .at("/coords")
            .into());
    };
    let corners = || rings.iter().flatten().map(|v| v.longitude_latitude_deg);
    let bounds = |axis: usize| {
        corners().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], c| {
            [low.min(c[axis]), high.max(c[axis])]
        })
    };
    let ([west, east], [south, north]) = (bounds(0), bounds(1));
    let [x_m, y_m] = centres_within(&view, west, south, east, north);
    if corners().count().saturating_mul(x_m.len() * y_m.len()) > CROSSINGS_MAX {
        let message = "so many corners over so many cells take too long; give fewer of either";
        return Err(ApiError::new("too_large", message).at("/coords").into());
    }
    let (axes, moments) = asked_of(&view, &asked, [x_m, y_m], state.limits().edr_values_max).await?;
    let work = move || {
        let columns = axes
            .y_m
            .iter()
            .flat_map(|&y| axes.x_m.iter().map(move |&x| [x, y, 0.0]));
        let within: Vec<bool> = columns
            .map(|column| {
                let [latitude, longitude, _] = view.geography.latitude_longitude_altitude(column);
                // The polygon may be written on the other side of the date line.
                [0.0, -360.0, 360.0]
                    .iter()
                    .any(|turn| is_within(&rings, [longitude + turn, latitude]))
            })
            .collect();
        if !within.contains(&true) {
            let message = "no cell has its centre in the polygon; see the collection's extent";
            return Err(ApiError::new("outside_domain", message).at("/coords"));
        }
        cover(&view, &axes, &moments, &asked.quantities, Some(&within))
    };
    Ok(answer(sampling::work(&state, work).await?))
}

/// Whether a place is in the outer ring and in no hole: a line from it to the east crosses an odd number of edges.
fn is_within(rings: &[Vec<Vertex>], [x, y]: [f64; 2]) -> bool {
    let edges = rings.iter().flat_map(|ring| ring.windows(2));
    let crossed = edges.filter(|edge| {
        let [[x0, y0], [x1, y1]] = [edge[0].longitude_latitude_deg, edge[1].longitude_latitude_deg];
        (y0 > y) != (y1 > y) && x < x0 + (y - y0) / (y1 - y0) * (x1 - x0)
    });
    crossed.count() % 2 == 1
}
