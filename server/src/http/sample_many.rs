//! `POST /v1/worlds/{id}/sample`: the air at many places, or along a path.

use axum::Json;
use axum::extract::State;
use welkin_proto::sample::{SampleAnswer, SampleRequest};

use super::error::Refusal;
use super::extract::{JsonText, WorldOf, parse_json, read};
use super::query::when;
use super::route::Route;
use super::sampling::{self, Chosen};
use super::state::AppState;
use crate::sample;

/// The route.
pub fn route() -> Route {
    Route::post(
        "/v1/worlds/{id}/sample",
        "The air at many places, or along a path",
        many,
    )
    .of_world()
    .body::<SampleRequest>()
    .json::<SampleAnswer>(
        200,
        "A column a channel. East and north the box repeats; places below the ground or above the lid are `outside`.",
    )
    .sample_errors()
    .error("no_positions")
    .error("mixed_coordinates")
    .error("too_many_points")
    .error("out_of_range")
    .error("outside_domain")
    .error("no_geography")
    .error("bad_parameter")
}

async fn many(
    State(state): State<AppState>,
    WorldOf(host): WorldOf,
    JsonText(text): JsonText,
) -> Result<Json<SampleAnswer>, Refusal> {
    let view = host.view().clone();
    drop(host); // the world may be stopped meanwhile
    let request: SampleRequest = read(parse_json(&text)?)?;
    let most = state.limits().sample_points_max;
    let places = sampling::places(
        request.positions_m,
        request.positions_lat_lon_alt,
        &view.geography,
        most,
    )?;
    let path = request.step_m.map(|step_m| sampling::along(&places, step_m, most));
    let (places, distance_m) = match path.transpose()? {
        Some((places, distance_m)) => (places, Some(distance_m)),
        None => (places, None),
    };
    let names = request.channels.as_ref();
    let named = names.map(|names| sampling::quantities(names.iter().map(String::as_str)));
    let chosen = Chosen::new(named.transpose()?, &view)?;
    let when = when(request.tick, request.simulated_s)?;
    let moments = sampling::moments(&view, sample::fields_of(&chosen.quantities), when).await?;
    let (moment, weather) = (moments.moment(), moments.weather().clone());
    let asked = chosen.quantities.clone();
    let (places, columns) = sampling::work(&state, move || {
        let columns = sample::sample(&moments, &asked, &places)?;
        Ok((places, columns))
    })
    .await?;
    Ok(Json(SampleAnswer {
        world: view.id.to_string(),
        moment,
        outside: sampling::outside(&weather, &places),
        positions_m: distance_m.is_some().then_some(places),
        distance_m,
        units: chosen.units(),
        values: sampling::by_name(&chosen.quantities, columns),
        unavailable: chosen.unavailable,
    }))
}
