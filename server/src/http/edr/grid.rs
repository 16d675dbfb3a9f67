//! The part of a world's grid that a query is about, and its values: what `cube`, `area` and the column of `position` share.

use serde_json::json;
use welkin_proto::ApiError;
use welkin_proto::sample::Quantity;

use super::coverage::{self, Domain, instant};
use super::query::{self, Query};
use crate::host::View;
use crate::sample::{self, Moments};

/// Places along three axes, local metres.
pub struct Axes {
    /// Metres east.
    pub x_m: Vec<f64>,
    /// Metres north.
    pub y_m: Vec<f64>,
    /// Metres above the ground.
    pub z_m: Vec<f64>,
}

/// Centres of the columns whose longitude and latitude are within bounds.
pub fn centres_within(view: &View, west: f64, south: f64, east: f64, north: f64) -> [Vec<f64>; 2] {
    let domain = &view.scene.domain;
    let centres = |axis: usize| (0..domain.cells[axis]).map(move |i| (f64::from(i) + 0.5) * domain.cell_size_m[axis]);
    let degrees = |x_m: f64, y_m: f64| view.geography.latitude_longitude_altitude([x_m, y_m, 0.0]);
    let [_, middle_y, _] = view.geography.size_m.map(|s| 0.5 * s);
    [
        // The box may stand across the date line, and bounds may be written on either side of it.
        centres(0)
            .filter(|&x| {
                let longitude = degrees(x, middle_y)[1];
                [-360.0, 0.0, 360.0]
                    .iter()
                    .any(|turn| (west..=east).contains(&(longitude + turn)))
            })
            .collect(),
        centres(1)
            .filter(|&y| (south..=north).contains(&degrees(0.0, y)[0]))
            .collect(),
    ]
}

/// What a query asks for of these columns: its levels with them, and its moments.
///
/// Errors: those of [`query::levels_m`], [`query::past`] and [`query::moments`]; of [`query::check_values`], before anything is waited for where one moment
/// would be too much already.
pub async fn asked_of(
    view: &View,
    asked: &Query,
    [x_m, y_m]: [Vec<f64>; 2],
    values_max: usize,
) -> Result<(Axes, Vec<Moments>), ApiError> {
    let z_m = query::levels_m(&asked.heights, view)?;
    let axes = Axes { x_m, y_m, z_m };
    let places = axes.x_m.len() * axes.y_m.len() * axes.z_m.len();
    query::check_values(places, 1, asked.quantities.len(), values_max)?;
    let past = query::past(view, &asked.quantities).await?;
    let moments = query::moments(&past, asked.times)?;
    query::check_values(places, moments.len(), asked.quantities.len(), values_max)?;
    Ok((axes, moments))
}

/// Longitude of each place on the axis, without a jump at the date line.
fn longitudes_deg(view: &View, x_m: &[f64]) -> Vec<f64> {
    let middle_deg = view.geography.middle_deg[1];
    let at = |&x: &f64| {
        let longitude = view.geography.latitude_longitude_altitude([x, 0.0, 0.0])[1];
        middle_deg + (longitude - middle_deg + 180.0).rem_euclid(360.0) - 180.0
    };
    x_m.iter().map(at).collect()
}

/// All values on the axes at the moments, as a coverage of the type that their lengths call for; `within` says
/// which columns are answered, x fastest; none stands for all. Takes milliseconds and more: call it off the async workers.
///
/// Errors: those of [`sample::sample`].
pub fn cover(
    view: &View,
    axes: &Axes,
    moments: &[Moments],
    quantities: &[Quantity],
    within: Option<&[bool]>,
) -> Result<String, ApiError> {
    let longitudes = longitudes_deg(view, &axes.x_m);
    let degrees = |y_m: f64, z_m: f64| view.geography.latitude_longitude_altitude([0.0, y_m, z_m]);
    let latitudes: Vec<f64> = axes.y_m.iter().map(|&y| degrees(y, 0.0)[0]).collect();
    let altitudes: Vec<f64> = axes.z_m.iter().map(|&z| degrees(0.0, z)[2]).collect();
    let times: Vec<String> = moments.iter().map(|m| instant(m.utc_unix_s())).collect();

    let [nx, ny, nz] = [axes.x_m.len(), axes.y_m.len(), axes.z_m.len()];
    let mut places = Vec::with_capacity(nx * ny * nz);
    for &z in &axes.z_m {
        for &y in &axes.y_m {
            places.extend(axes.x_m.iter().map(|&x| [x, y, z]));
        }
    }
    let mut columns: Vec<Vec<f32>> = vec![Vec::with_capacity(places.len() * moments.len()); quantities.len()];
    for moment in moments {
        for (column, values) in columns.iter_mut().zip(sample::sample(moment, quantities, &places)?) {
            column.extend(values);
        }
    }
    if let Some(within) = within {
        for column in &mut columns {
            let values = column.iter_mut().zip(within.iter().cycle());
            values
                .filter(|(_, within)| !**within)
                .for_each(|(value, _)| *value = f32::NAN);
        }
    }
    let kind = match (nx * ny, nz, times.len()) {
        (1, 1, 1) => "Point",
        (1, 1, _) => "PointSeries",
        (1, _, 1) => "VerticalProfile",
        _ => "Grid",
    };
    let domain = Domain {
        kind,
        shape: vec![times.len(), nz, ny, nx],
        axes: json!({
            "x": { "values": longitudes }, "y": { "values": latitudes }, "z": { "values": altitudes }, "t": { "values": times },
        }),
        axis_names: vec!["t", "z", "y", "x"],
    };
    coverage::write(&domain, quantities, columns)
}
