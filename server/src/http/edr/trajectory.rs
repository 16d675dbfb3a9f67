//! `GET /collections/{id}/trajectory`: the air along a path, at its corners and every cell's width between them.

use axum::extract::State;
use axum::response::Response;
use serde_json::json;
use welkin_proto::ApiError;

use super::coverage::{self, Domain, answer, instant};
use super::position::heights_of;
use super::query::{self, Heights, Times};
use super::wkt::{self, Geometry};
use crate::http::error::Refusal;
use crate::http::extract::{Pairs, WorldOf};
use crate::http::route::{Place, Route};
use crate::http::sampling;
use crate::http::state::AppState;
use crate::sample::{self, Moments};

/// The route.
pub fn route() -> Route {
    Route::get("/collections/{id}/trajectory", "Along a path (OGC API EDR)", trajectory)
        .edr_query()
        .parameter::<String>(
            Place::Query,
            "coords",
            "`LINESTRING(lon lat, ...)`; with Z altitudes in metres, with M simulated Unix seconds, with ZM both.",
        )
        .edr_z("One altitude above mean sea level for the whole path, m, where `coords` has no Z.")
        .edr_datetime("One simulated instant for the whole path, where `coords` has no M; the newest.")
}

async fn trajectory(
    State(state): State<AppState>,
    WorldOf(host): WorldOf,
    Pairs(pairs): Pairs,
) -> Result<Response, Refusal> {
    let view = host.view().clone();
    drop(host); // the world may be stopped meanwhile
    let asked = query::parse(&pairs, &["coords", "z", "datetime"], &view)?;
    let most = state.limits().sample_points_max;
    let Geometry::LineString(corners) = wkt::parse(query::coords(&asked)?, most)? else {
        return Err(ApiError::new("bad_coords", "`trajectory` takes a LINESTRING")
            .at("/coords")
            .into());
    };
    let heights = heights_of(&corners, &asked.heights)?;
    let times: Option<Vec<f64>> = corners.iter().map(|v| v.m).collect();
    if times.is_some() && asked.times != Times::Now {
        let message = "give times in `coords` (M) or in `datetime`, not in both";
        return Err(ApiError::new("bad_parameter", message).at("/datetime").into());
    }
    let local = corners.iter().zip(heights).map(|(corner, height)| {
        let [x_m, y_m] = query::inside(&view, corner.longitude_latitude_deg)?;
        Ok([x_m, y_m, query::levels_m(&Heights::At(vec![height]), &view)?[0]])
    });
    let local = local.collect::<Result<Vec<[f64; 3]>, ApiError>>()?;

    // Corners, and between two of them as many places as the path crosses cells' widths.
    let [dx, dy, _] = view.scene.domain.cell_size_m;
    let mut places = vec![local[0]];
    let mut seconds = times.as_ref().map(|t| vec![t[0]]);
    for (i, leg) in local.windows(2).enumerate() {
        let length_m = (leg[1][0] - leg[0][0]).hypot(leg[1][1] - leg[0][1]);
        let steps = (length_m / dx.min(dy)).ceil().max(1.0) as usize;
        if places.len() + steps > most {
            return Err(sampling::too_many((places.len() + steps) as f64, most)
                .at("/coords")
                .into());
        }
        for step in 1..=steps {
            let share = step as f64 / steps as f64;
            places.push([0, 1, 2].map(|a| leg[0][a] + share * (leg[1][a] - leg[0][a])));
            if let (Some(seconds), Some(times)) = (&mut seconds, &times) {
                seconds.push(times[i] + share * (times[i + 1] - times[i]));
            }
        }
    }
    query::check_values(places.len(), 1, asked.quantities.len(), state.limits().edr_values_max)?;
    let past = query::past(&view, &asked.quantities).await?;
    let moments: Vec<Moments> = match &seconds {
        None => vec![query::one_moment(&past, asked.times)?],
        Some(seconds) => {
            let found = seconds.iter().map(|&s| query::one_moment(&past, Times::At(s)));
            found.collect::<Result<_, _>>().map_err(|e: ApiError| e.at("/coords"))?
        }
    };
    let work = move || {
        let columns = match moments.as_slice() {
            [one] => sample::sample(one, &asked.quantities, &places)?,
            many => {
                let mut columns = vec![Vec::with_capacity(places.len()); asked.quantities.len()];
                for (moment, place) in many.iter().zip(&places) {
                    let values = sample::sample(moment, &asked.quantities, &[*place])?;
                    columns
                        .iter_mut()
                        .zip(values)
                        .for_each(|(column, value)| column.extend(value));
                }
                columns
            }
        };
        let tuple = |(i, &place): (usize, &[f64; 3])| {
            let [latitude, longitude, altitude] = view.geography.latitude_longitude_altitude(place);
            let moment = &moments[i.min(moments.len() - 1)];
            json!([instant(moment.utc_unix_s()), longitude, latitude, altitude])
        };
        let tuples: Vec<_> = places.iter().enumerate().map(tuple).collect();
        let domain = Domain {
            kind: "Trajectory",
            axes: json!({
                "composite": { "dataType": "tuple", "coordinates": ["t", "x", "y", "z"], "values": tuples },
            }),
            axis_names: vec!["composite"],
            shape: vec![places.len()],
        };
        coverage::write(&domain, &asked.quantities, columns)
    };
    Ok(answer(sampling::work(&state, work).await?))
}
