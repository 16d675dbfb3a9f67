//! CoverageJSON 1.0 (OGC 21-069r2): a domain with its axes and reference systems, parameters with units, one array of values a parameter.

use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde_json::{Map, Value, json};
use welkin_proto::sample::Quantity;
use welkin_proto::time::format_utc;
use welkin_proto::{ApiError, Channel};

use crate::http::error::internal;
use crate::http::sampling::or_null;

/// CoverageJSON's media type.
pub const MEDIA_TYPE: &str = "application/vnd.cov+json";
/// Longitude and latitude.
pub const CRS84: &str = "http://www.opengis.net/def/crs/OGC/1.3/CRS84";
const MEAN_SEA_LEVEL_HEIGHT: &str = "http://www.opengis.net/def/crs/EPSG/0/5714";
const UCUM: &str = "http://www.opengis.net/def/uom/UCUM/";
const CF_NAMES: &str = "http://vocab.nerc.ac.uk/standard_name/";

/// The standard name of the CF conventions, where there is one that means the same.
fn cf_name(quantity: Quantity) -> Option<&'static str> {
    Some(match quantity {
        Quantity::WindSpeedMS => "wind_speed",
        Quantity::WindFromDeg => "wind_from_direction",
        Quantity::Channel(channel) => match channel {
            Channel::WindXMS => "eastward_wind",
            Channel::WindYMS => "northward_wind",
            Channel::WindZMS => "upward_air_velocity",
            Channel::TemperatureK => "air_temperature",
            Channel::PressurePa => "air_pressure",
            Channel::RelativeHumidity => "relative_humidity",
            Channel::VapourKgKg => "specific_humidity",
            Channel::LiquidWaterKgKg => "mass_fraction_of_cloud_liquid_water_in_air",
            Channel::EffectiveRadiusM => "effective_radius_of_cloud_liquid_water_particles",
            Channel::VisibilityM => "visibility_in_air",
            Channel::ExtinctionPerM | Channel::TotalWaterKgKg | Channel::EddyDissipationRateM23S => return None,
        },
    })
}

/// A parameter's description. `words` makes text of it: plain in a collection's document, by language in a coverage.
pub fn parameter(quantity: Quantity, words: fn(&'static str) -> Value) -> Value {
    let unit = quantity.unit();
    // UCUM has whole powers only.
    let symbol = match quantity {
        Quantity::Channel(Channel::EddyDissipationRateM23S) => json!("m^(2/3)/s"),
        _ => json!({ "value": unit, "type": UCUM }),
    };
    let mut property = json!({ "label": words(quantity.what()) });
    if let Some(name) = cf_name(quantity) {
        property["id"] = format!("{CF_NAMES}{name}/").into();
    }
    json!({
        "type": "Parameter",
        "description": words(quantity.what()),
        "unit": { "label": words(unit), "symbol": symbol },
        "observedProperty": property,
    })
}

/// Text by language, as CoverageJSON has it.
pub fn in_english(text: &'static str) -> Value {
    json!({ "en": text })
}

/// A date and time with milliseconds, where it has any.
pub fn instant(unix_s: f64) -> String {
    let ms = (unix_s * 1e3).round();
    let (second, ms) = ((ms / 1e3).floor(), ms.rem_euclid(1e3));
    let text = format_utc(second);
    match ms {
        0.0 => text,
        _ => format!("{}.{ms:03.0}Z", text.trim_end_matches('Z')),
    }
}

/// A domain and the shape of its arrays.
pub struct Domain {
    /// The domain's type, such as `Grid`.
    pub kind: &'static str,
    /// Its axes.
    pub axes: Value,
    /// Names of the arrays' axes, slowest first.
    pub axis_names: Vec<&'static str>,
    /// How many values along each.
    pub shape: Vec<usize>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct NdArray<'a> {
    #[serde(rename = "type")]
    kind: &'static str,
    data_type: &'static str,
    axis_names: &'a [&'static str],
    shape: &'a [usize],
    values: Vec<Option<f32>>,
}

#[derive(Serialize)]
struct Coverage<'a> {
    #[serde(rename = "type")]
    kind: &'static str,
    domain: Value,
    parameters: Map<String, Value>,
    ranges: std::collections::BTreeMap<&'static str, NdArray<'a>>,
}

/// A coverage as text; `columns` has a column a quantity in the order of the domain's shape, NaN where there is nothing. Errors: `internal`.
pub fn write(domain: &Domain, quantities: &[Quantity], columns: Vec<Vec<f32>>) -> Result<String, ApiError> {
    let referencing = json!([
        { "coordinates": ["x", "y"], "system": { "type": "GeographicCRS", "id": CRS84 } },
        { "coordinates": ["z"], "system": { "type": "VerticalCRS", "id": MEAN_SEA_LEVEL_HEIGHT } },
        { "coordinates": ["t"], "system": { "type": "TemporalRS", "calendar": "Gregorian" } },
    ]);
    let parameters = quantities
        .iter()
        .map(|&q| (q.name().to_owned(), parameter(q, in_english)));
    let ranges = quantities.iter().zip(columns).map(|(q, column)| {
        let array = NdArray {
            kind: "NdArray",
            data_type: "float",
            axis_names: &domain.axis_names,
            shape: &domain.shape,
            values: column.into_iter().map(or_null).collect(),
        };
        (q.name(), array)
    });
    let coverage = Coverage {
        kind: "Coverage",
        domain: json!({
            "type": "Domain", "domainType": domain.kind, "axes": domain.axes, "referencing": referencing,
        }),
        parameters: parameters.collect(),
        ranges: ranges.collect(),
    };
    serde_json::to_string(&coverage).map_err(internal)
}

/// A coverage as an answer.
pub fn answer(coverage: String) -> Response {
    let headers = [(header::CONTENT_TYPE, MEDIA_TYPE), (header::CACHE_CONTROL, "no-cache")];
    (headers, coverage).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instants_have_milliseconds_where_they_need_them() {
        for (unix_s, text) in [
            (0.0, "1970-01-01T00:00:00Z"),
            (1_782_039_600.25, "2026-06-21T11:00:00.250Z"),
            (1_782_039_600.999_9, "2026-06-21T11:00:01Z"),
            (-0.5, "1969-12-31T23:59:59.500Z"),
        ] {
            assert_eq!(instant(unix_s), text);
        }
    }
}
