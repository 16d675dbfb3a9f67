//! What the routes that answer with samples share: reading channels, places and times, and the work itself off the async workers.

use std::collections::BTreeMap;
use std::sync::Arc;

use welkin_proto::ApiError;
use welkin_proto::geography::{Geography, REACH_M};
use welkin_proto::sample::Quantity;

use super::error::internal;
use super::state::AppState;
use crate::host::View;
use crate::sample::{self, Moments, When};
use crate::weather::{FieldSet, Reach, Weather};

/// The channels that were named; `None` stands for all. Pointers `/channels`, `/channels/0`, ...
///
/// Errors: `no_channels`, `unknown_channel`, `channel_unavailable` for what no scene has, `bad_parameter` for one named twice.
pub fn quantities<'a>(names: impl IntoIterator<Item = &'a str>) -> Result<Vec<Quantity>, ApiError> {
    let mut found: Vec<Quantity> = Vec::new();
    for (place, name) in names.into_iter().enumerate() {
        let pointer = format!("/channels/{place}");
        let quantity = Quantity::named(name).map_err(|e| e.at(pointer.as_str()))?;
        if found.contains(&quantity) {
            return Err(ApiError::new("bad_parameter", format!("{name} is named twice")).at(pointer));
        }
        found.push(quantity);
    }
    if found.is_empty() {
        return Err(ApiError::new("no_channels", "name a channel, or leave `channels` out for all").at("/channels"));
    }
    Ok(found)
}

/// What is answered: the channels that were named, or all that the scene has and why others are missing.
pub struct Chosen {
    /// In the order of the answer.
    pub quantities: Vec<Quantity>,
    /// Why others are missing; empty where channels were named.
    pub unavailable: BTreeMap<String, String>,
}

impl Chosen {
    /// See the type. Errors: `channel_unavailable` for a named one that the world's scene lacks.
    pub fn new(named: Option<Vec<Quantity>>, view: &View) -> Result<Self, ApiError> {
        let scene = Arc::clone(&view.newest().snapshot.scene);
        let (there, missing) = sample::offered(&scene);
        let Some(named) = named else {
            let why = |(quantity, error): (Quantity, ApiError)| (quantity.name().to_owned(), error.message);
            let absent = welkin_proto::channel::ABSENT.iter();
            let absent = absent.map(|(name, why)| ((*name).to_owned(), (*why).to_owned()));
            return Ok(Self {
                quantities: there,
                unavailable: missing.into_iter().map(why).chain(absent).collect(),
            });
        };
        for (place, quantity) in named.iter().enumerate() {
            if let Some((_, error)) = missing.iter().find(|(missing, _)| missing == quantity) {
                return Err(error.clone().at(format!("/channels/{place}")));
            }
        }
        Ok(Self {
            quantities: named,
            unavailable: BTreeMap::new(),
        })
    }

    /// Unit of each.
    pub fn units(&self) -> BTreeMap<String, String> {
        let unit = |q: &Quantity| (q.name().to_owned(), q.unit().to_owned());
        self.quantities.iter().map(unit).collect()
    }
}

/// `out_of_range` unless a place in local metres is finite and near enough for its numbers to mean something.
pub fn check_local(place: [f64; 3], pointer: &str) -> Result<[f64; 3], ApiError> {
    for (axis, value) in place.iter().enumerate() {
        // NaN is refused too.
        if !(-REACH_M..=REACH_M).contains(value) {
            let message = format!("{value} is out of range; allowed is {} to {REACH_M}", -REACH_M);
            return Err(ApiError::new("out_of_range", message).at(format!("{pointer}/{axis}")));
        }
    }
    Ok(place)
}

/// Places that were given in one of two ways, as local metres; pointers into the list that was given.
///
/// Errors: `no_positions` without any, `mixed_coordinates` with both lists, `too_many_points`, `out_of_range`, those of
/// [`Geography::local_m`].
pub fn places(
    positions_m: Option<Vec<[f64; 3]>>,
    positions_lat_lon_alt: Option<Vec<[f64; 3]>>,
    geography: &Geography,
    most: usize,
) -> Result<Vec<[f64; 3]>, ApiError> {
    const LOCAL: &str = "/positions_m";
    const GEOGRAPHIC: &str = "/positions_lat_lon_alt";
    let (pointer, given) = match (positions_m, positions_lat_lon_alt) {
        (Some(_), Some(_)) => {
            let message = "give `positions_m` or `positions_lat_lon_alt`, not both";
            return Err(ApiError::new("mixed_coordinates", message).at(""));
        }
        (None, None) => {
            let message = "give `positions_m` or `positions_lat_lon_alt`";
            return Err(ApiError::new("no_positions", message).at(""));
        }
        (Some(local), None) => (LOCAL, local),
        (None, Some(geographic)) => (GEOGRAPHIC, geographic),
    };
    if given.is_empty() {
        return Err(ApiError::new("no_positions", "the list is empty").at(pointer));
    }
    if given.len() > most {
        return Err(too_many(given.len() as f64, most).at(pointer));
    }
    let local = given.into_iter().enumerate().map(|(i, place)| match pointer {
        LOCAL => check_local(place, &format!("{pointer}/{i}")),
        _ => geography.local_m(place).map_err(|error| {
            let inner = error.pointer.clone().unwrap_or_default();
            error.at(format!("{pointer}/{i}{inner}"))
        }),
    });
    local.collect()
}

/// `too_many_points`.
pub fn too_many(count: f64, most: usize) -> ApiError {
    ApiError::new(
        "too_many_points",
        format!("{count} places; at most {most} are allowed in one request"),
    )
}

/// Where a path is sampled, and metres along it: at its start, every `step_m` metres, at its end.
///
/// Errors: `out_of_range` for a step that is not above 0, `too_many_points`; pointer `/step_m`.
pub fn along(corners: &[[f64; 3]], step_m: f64, most: usize) -> Result<(Vec<[f64; 3]>, Vec<f64>), ApiError> {
    if !step_m.is_finite() || step_m <= 0.0 {
        let message = format!("{step_m} is out of range; a step is above 0 m");
        return Err(ApiError::new("out_of_range", message).at("/step_m"));
    }
    let length = |a: &[f64; 3], b: &[f64; 3]| (0..3).map(|i| (b[i] - a[i]).powi(2)).sum::<f64>().sqrt();
    let total_m: f64 = corners.windows(2).map(|pair| length(&pair[0], &pair[1])).sum();
    let steps = (total_m / step_m).ceil();
    if steps + 1.0 > most as f64 {
        return Err(too_many(steps + 1.0, most).at("/step_m"));
    }
    let (mut places, mut distances) = (Vec::new(), Vec::new());
    let mut before_m = 0.0;
    let mut next = 0.0; // whole steps, counted so that rounding does not add up
    for pair in corners.windows(2) {
        let leg_m = length(&pair[0], &pair[1]);
        while next * step_m < before_m + leg_m {
            let share = (next * step_m - before_m) / leg_m;
            places.push([0, 1, 2].map(|i| pair[0][i] + share * (pair[1][i] - pair[0][i])));
            distances.push(next * step_m);
            next += 1.0;
        }
        before_m += leg_m;
    }
    places.extend(corners.last());
    distances.push(total_m);
    Ok((places, distances))
}

/// Weather that holds `fields`, waiting for it where nobody wanted any until now, and the wanted moment of it.
///
/// Errors: those of [`View::weather`] and [`Moments::find`].
pub async fn moments(view: &View, fields: FieldSet, when: When) -> Result<Moments, ApiError> {
    let _interest = view.want_fields(fields, Reach::Past);
    let published = view.weather(fields).await?;
    Moments::find(&published.past, when)
}

/// Runs work on weather off the async workers, as one of a bounded number at once. Errors: those of the work, `internal`.
pub async fn work<T: Send + 'static>(
    state: &AppState,
    work: impl FnOnce() -> Result<T, ApiError> + Send + 'static,
) -> Result<T, ApiError> {
    let permit = state.samplings().clone().acquire_owned().await.map_err(internal)?;
    let work = move || {
        let _permit = permit; // held until the work is over, even if the client leaves
        work()
    };
    tokio::task::spawn_blocking(work).await.map_err(internal)?
}

/// What JSON says of a value: null where it is none.
pub fn or_null(value: f32) -> Option<f32> {
    value.is_finite().then_some(value)
}

/// Columns by name, as JSON has them.
pub fn by_name(quantities: &[Quantity], columns: Vec<Vec<f32>>) -> BTreeMap<String, Vec<Option<f32>>> {
    let named = quantities.iter().zip(columns);
    named
        .map(|(q, column)| (q.name().to_owned(), column.into_iter().map(or_null).collect()))
        .collect()
}

/// Which places are below the ground or above the lid.
pub fn outside(weather: &Weather, places: &[[f64; 3]]) -> Vec<usize> {
    let inside = |i: &usize| sample::is_inside(weather.grid(), places[*i]);
    (0..places.len()).filter(|i| !inside(i)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_sampled_at_both_ends_and_at_every_step_between() {
        let corners = [[0.0, 0.0, 0.0], [300.0, 0.0, 0.0], [300.0, 400.0, 0.0]];
        let (places, distances) = along(&corners, 250.0, 10).expect("a path");
        assert_eq!(distances, [0.0, 250.0, 500.0, 700.0]);
        assert_eq!(
            places,
            [[0.0; 3], [250.0, 0.0, 0.0], [300.0, 200.0, 0.0], [300.0, 400.0, 0.0]]
        );
        // An exact number of steps ends once; a path of one corner is a place, a leg of no length is none.
        assert_eq!(along(&corners, 350.0, 3).expect("two steps").1, [0.0, 350.0, 700.0]);
        assert_eq!(along(&corners[..1], 5.0, 1).expect("a place").1, [0.0]);
        let twice = [corners[0], corners[0], corners[1]];
        assert_eq!(along(&twice, 150.0, 9).expect("a path").1, [0.0, 150.0, 300.0]);
        for (step, code) in [
            (0.0, "out_of_range"),
            (-1.0, "out_of_range"),
            (f64::NAN, "out_of_range"),
            (1e-9, "too_many_points"),
            (349.0, "too_many_points"),
        ] {
            assert_eq!(along(&corners, step, 3).expect_err("refused").code, code, "{step}");
        }
    }
}
