//! `GET /v1/worlds/{id}/sample`: the air at one place.

use axum::Json;
use axum::extract::State;
use welkin_proto::ApiError;
use welkin_proto::geography::Geography;
use welkin_proto::sample::{PointSample, Quantity};

use super::error::Refusal;
use super::extract::{Pairs, WorldOf};
use super::query::{moment, number, unknown};
use super::route::{Place, Route};
use super::sampling::{self, Chosen};
use super::state::AppState;
use crate::sample::{self, When};

/// The route.
pub fn route() -> Route {
    use Place::Query;
    Route::get("/v1/worlds/{id}/sample", "The air at one place", point)
        .of_world()
        .parameter::<f64>(Query, "lat", "Latitude, degrees north; with `lon` and `alt`.")
        .parameter::<f64>(Query, "lon", "Longitude, degrees east.")
        .parameter::<f64>(Query, "alt", "Altitude above mean sea level, metres.")
        .parameter::<f64>(
            Query,
            "x_m",
            "Metres east of the box's south-west corner; with `y_m` and `z_m`, instead of `lat`, `lon`, `alt`.",
        )
        .parameter::<f64>(Query, "y_m", "Metres north of that corner.")
        .parameter::<f64>(Query, "z_m", "Metres above the ground.")
        .sample_choice()
        .json::<PointSample>(
            200,
            "The air there. East and north the box repeats; below the ground and above the lid is `outside_domain`.",
        )
        .error("bad_query")
        .error("bad_parameter")
        .error("unknown_parameter")
        .error("no_positions")
        .error("mixed_coordinates")
        .error("out_of_range")
        .error("outside_domain")
        .error("no_geography")
}

impl Route {
    /// With the query's choice of channels and moment, and the errors that they and sampling can give.
    fn sample_choice(self) -> Self {
        use Place::Query;
        self.parameter::<String>(
            Query,
            "channels",
            "Names with commas between, `wind_speed_m_s` and `wind_from_deg` among them; all that the scene has.",
        )
        .parameter::<u64>(
            Query,
            "tick",
            "The weather of this tick, if it is still kept; the newest.",
        )
        .parameter::<f64>(
            Query,
            "simulated_s",
            "The weather of this simulated second, between two ticks that are kept.",
        )
        .sample_errors()
    }

    /// With the errors that choosing channels and a moment, and sampling, can give.
    pub(super) fn sample_errors(mut self) -> Self {
        self.errors.extend([
            "no_channels",
            "unknown_channel",
            "channel_unavailable",
            "too_old",
            "not_yet",
            "tick_not_kept",
            "weather_not_kept",
            "weather_unavailable",
            "world_stopped",
            "internal",
        ]);
        self
    }
}

struct Asked {
    place: [f64; 3],
    quantities: Option<Vec<Quantity>>,
    when: When,
}

fn parse(pairs: Vec<(String, String)>, geography: &Geography) -> Result<Asked, ApiError> {
    const NAMES: [[&str; 3]; 2] = [["lat", "lon", "alt"], ["x_m", "y_m", "z_m"]];
    let mut given = [[None; 3]; 2];
    let mut quantities = None;
    let (when, pairs) = moment(pairs)?;
    for (name, value) in &pairs {
        let coordinate = (0..2).flat_map(|s| (0..3).map(move |a| (s, a)));
        if let Some((system, axis)) = coordinate.into_iter().find(|&(s, a)| NAMES[s][a] == name) {
            given[system][axis] = Some(number(name, value)?);
            continue;
        }
        match name.as_str() {
            "channels" => quantities = Some(sampling::quantities(value.split(','))?),
            _ => return Err(unknown(name)),
        }
    }
    let system = match given.map(|system| system.iter().any(Option::is_some)) {
        [true, true] => {
            let message = "give lat, lon and alt, or x_m, y_m and z_m, not parts of both";
            return Err(ApiError::new("mixed_coordinates", message));
        }
        [false, false] => {
            let message = "give a place: lat, lon and alt, or x_m, y_m and z_m";
            return Err(ApiError::new("no_positions", message));
        }
        [geographic, _] => usize::from(!geographic),
    };
    let mut place = [0.0; 3];
    for axis in 0..3 {
        let name = NAMES[system][axis];
        place[axis] = given[system][axis].ok_or_else(|| {
            let message = format!("{name} is missing; give {}", NAMES[system].join(", "));
            ApiError::new("bad_parameter", message).at(format!("/{name}"))
        })?;
    }
    let local = match system {
        0 => geography.local_m(place),
        _ => sampling::check_local(place, ""),
    };
    let place = local.map_err(|error| {
        let axis = error.pointer.as_deref().and_then(|p| p[1..].parse::<usize>().ok());
        match axis {
            Some(axis) => error.at(format!("/{}", NAMES[system][axis])),
            None => error,
        }
    })?;
    Ok(Asked {
        place,
        quantities,
        when,
    })
}

async fn point(
    State(state): State<AppState>,
    WorldOf(host): WorldOf,
    Pairs(pairs): Pairs,
) -> Result<Json<PointSample>, Refusal> {
    let view = host.view().clone();
    drop(host); // the world may be stopped meanwhile
    let Asked {
        place,
        quantities,
        when,
    } = parse(pairs, &view.geography)?;
    let chosen = Chosen::new(quantities, &view)?;
    let moments = sampling::moments(&view, sample::fields_of(&chosen.quantities), when).await?;
    if !sample::is_inside(moments.weather().grid(), place) {
        let message = format!(
            "{:.1} m above the ground; the air reaches from 0 to {} m",
            place[2], view.geography.size_m[2]
        );
        return Err(ApiError::new("outside_domain", message).into());
    }
    let moment = moments.moment();
    let asked = chosen.quantities.clone();
    let columns = sampling::work(&state, move || sample::sample(&moments, &asked, &[place])).await?;
    let value = |(q, column): (&Quantity, &Vec<f32>)| {
        let value = column.first().copied().and_then(sampling::or_null);
        (q.name().to_owned(), value)
    };
    Ok(Json(PointSample {
        world: view.id.to_string(),
        moment,
        position_m: place,
        position_lat_lon_alt: view.geography.latitude_longitude_altitude(place),
        values: chosen.quantities.iter().zip(&columns).map(value).collect(),
        units: chosen.units(),
        unavailable: chosen.unavailable,
    }))
}
