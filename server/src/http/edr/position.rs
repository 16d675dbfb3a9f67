//! `GET /collections/{id}/position`: the air at a place, in the column above it, or at several places.

use axum::extract::State;
use axum::response::Response;
use serde_json::json;
use welkin_proto::ApiError;

use super::coverage::{self, Domain, answer, instant};
use super::grid::{Axes, cover};
use super::query::{self, Heights, Query};
use super::wkt::{self, Geometry, Vertex};
use crate::host::View;
use crate::http::error::Refusal;
use crate::http::extract::{Pairs, WorldOf};
use crate::http::route::{Place, Route};
use crate::http::sampling;
use crate::http::state::AppState;
use crate::sample;

/// The route.
pub fn route() -> Route {
    Route::get(
        "/collections/{id}/position",
        "At a place, in the column above it, or at several places (OGC API EDR)",
        position,
    )
    .edr_query()
    .parameter::<String>(
        Place::Query,
        "coords",
        "`POINT(lon lat)`, `POINT Z(lon lat altitude)` or `MULTIPOINT` of such.",
    )
    .edr_z("Altitudes above mean sea level, m: one, a list, `low/high`, or `Rn/low/step`; without it the whole column.")
    .edr_datetime("A simulated instant, or (for a POINT) `from/to` for all that are kept; the newest.")
}

async fn position(
    State(state): State<AppState>,
    WorldOf(host): WorldOf,
    Pairs(pairs): Pairs,
) -> Result<Response, Refusal> {
    let view = host.view().clone();
    drop(host); // the world may be stopped meanwhile
    let asked = query::parse(&pairs, &["coords", "z", "datetime"], &view)?;
    match wkt::parse(query::coords(&asked)?, state.limits().sample_points_max)? {
        Geometry::Point(vertex) => point(state, view, asked, vertex).await,
        Geometry::MultiPoint(vertices) => points(state, view, asked, vertices).await,
        _ => Err(ApiError::new("bad_coords", "`position` takes a POINT or a MULTIPOINT")
            .at("/coords")
            .into()),
    }
}

async fn point(state: AppState, view: View, mut asked: Query, vertex: Vertex) -> Result<Response, Refusal> {
    if let Some(z) = vertex.z {
        asked.heights = one_height(&asked.heights, z)?;
    }
    let [x_m, y_m] = query::inside(&view, vertex.longitude_latitude_deg)?;
    let z_m = query::levels_m(&asked.heights, &view)?;
    let past = query::past(&view, &asked.quantities).await?;
    let moments = query::moments(&past, asked.times)?;
    query::check_values(
        z_m.len(),
        moments.len(),
        asked.quantities.len(),
        state.limits().edr_values_max,
    )?;
    let axes = Axes {
        x_m: vec![x_m],
        y_m: vec![y_m],
        z_m,
    };
    let work = move || cover(&view, &axes, &moments, &asked.quantities, None);
    Ok(answer(sampling::work(&state, work).await?))
}

/// The height that a coordinate gives. Errors: `bad_parameter` where `z` gives one too.
fn one_height(heights: &Heights, z: f64) -> Result<Heights, ApiError> {
    match heights {
        Heights::All => Ok(Heights::At(vec![z])),
        _ => Err(ApiError::new("bad_parameter", "give the height in `coords` or in `z`, not in both").at("/z")),
    }
}

/// Heights of corners: their own, or the one that `z` gives to all.
///
/// Errors: `bad_parameter` where neither or both give one, or `z` gives several.
pub fn heights_of(vertices: &[Vertex], heights: &Heights) -> Result<Vec<f64>, ApiError> {
    let own: Option<Vec<f64>> = vertices.iter().map(|v| v.z).collect();
    match (own, heights) {
        (Some(own), Heights::All) => Ok(own),
        (Some(own), _) => one_height(heights, own[0]).map(|_| own),
        (None, Heights::At(all)) if all.len() == 1 => Ok(vec![all[0]; vertices.len()]),
        (None, _) => {
            let message = "several places need a height each in `coords` (Z), or one for all in `z`";
            Err(ApiError::new("bad_parameter", message).at("/z"))
        }
    }
}

async fn points(state: AppState, view: View, asked: Query, vertices: Vec<Vertex>) -> Result<Response, Refusal> {
    let heights = heights_of(&vertices, &asked.heights)?;
    let places = vertices.iter().zip(&heights).map(|(vertex, &height)| {
        let [x_m, y_m] = query::inside(&view, vertex.longitude_latitude_deg)?;
        let z_m = query::levels_m(&Heights::At(vec![height]), &view)?[0];
        Ok([x_m, y_m, z_m])
    });
    let places = places.collect::<Result<Vec<_>, ApiError>>()?;
    query::check_values(places.len(), 1, asked.quantities.len(), state.limits().edr_values_max)?;
    let past = query::past(&view, &asked.quantities).await?;
    let moments = query::one_moment(&past, asked.times)?;
    let work = move || {
        let columns = sample::sample(&moments, &asked.quantities, &places)?;
        let place = |(vertex, height): (&Vertex, &f64)| {
            let [longitude, latitude] = vertex.longitude_latitude_deg;
            json!([longitude, latitude, height])
        };
        let tuples: Vec<_> = vertices.iter().zip(&heights).map(place).collect();
        let domain = Domain {
            kind: "MultiPoint",
            axes: json!({
                "t": { "values": [instant(moments.utc_unix_s())] },
                "composite": { "dataType": "tuple", "coordinates": ["x", "y", "z"], "values": tuples },
            }),
            axis_names: vec!["composite"],
            shape: vec![places.len()],
        };
        coverage::write(&domain, &asked.quantities, columns)
    };
    Ok(answer(sampling::work(&state, work).await?))
}
