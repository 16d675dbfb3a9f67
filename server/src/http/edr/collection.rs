//! `GET /collections/{id}`: a world as a collection: where and when it is, what it can be asked.

use axum::Json;
use serde_json::{Map, Value, json};
use welkin_proto::ApiError;
use welkin_proto::time::parse_utc;

use super::Base;
use super::coverage::{CRS84, MEDIA_TYPE, instant, parameter};
use crate::host::View;
use crate::http::error::Refusal;
use crate::http::extract::WorldOf;
use crate::http::route::Route;
use crate::sample;

const CRS84_WKT: &str = "GEOGCRS[\"WGS 84 (CRS84)\",DATUM[\"World Geodetic System 1984\",ELLIPSOID[\"WGS 84\",6378137,298.257223563]],\
                         CS[ellipsoidal,2],AXIS[\"longitude\",east],AXIS[\"latitude\",north],ANGLEUNIT[\"degree\",0.0174532925199433]]";
const HEIGHT_WKT: &str = "VERTCRS[\"MSL height\",VDATUM[\"Mean Sea Level\"],CS[vertical,1],AXIS[\"gravity-related height (H)\",up],\
                          LENGTHUNIT[\"metre\",1]]";
const TIME_WKT: &str =
    "TIMECRS[\"DateTime\",TDATUM[\"Gregorian Calendar\"],CS[TemporalDateTime,1],AXIS[\"Time (T)\",future]]";

/// The route.
pub fn route() -> Route {
    Route::get(
        "/collections/{id}",
        "A world as a collection of the weather service",
        one,
    )
    .of_world()
    .bytes(
        200,
        "Extent, parameters with units, and the queries that it answers.",
        &["application/json"],
    )
    .error("bad_time")
}

async fn one(WorldOf(host): WorldOf, Base(base): Base) -> Result<Json<Value>, Refusal> {
    Ok(Json(describe(host.view(), &base)?))
}

/// A world as a collection. Errors: `bad_time`, which a validated scene does not give.
pub fn describe(view: &View, base: &str) -> Result<Value, ApiError> {
    let newest = view.newest();
    let scene = &newest.snapshot.scene;
    let start_unix_s = parse_utc(&scene.time.start_utc)?;
    let now_s = newest.snapshot.numbers.simulated_s;
    // Those that are kept; while nobody asks none are, and the newest would be made.
    let mut kept_s: Vec<f64> = newest.past.iter().map(|w| w.simulated_s).collect();
    if kept_s.is_empty() {
        kept_s.push(now_s);
    }
    let times: Vec<String> = kept_s.iter().map(|s| instant(start_unix_s + s)).collect();
    let id = &view.id;
    let here = format!("{base}/collections/{id}");
    let [low, high] = [[0.0; 3], view.geography.size_m].map(|p| view.geography.latitude_longitude_altitude(p));
    let levels = (0..scene.domain.cells[2])
        .map(|k| (f64::from(k) + 0.5) * scene.domain.cell_size_m[2] + view.geography.surface_altitude_m);
    let query = |kind: &str, title: &str| {
        json!({ "link": {
            "href": format!("{here}/{kind}"), "rel": "data", "type": MEDIA_TYPE, "title": title,
            "variables": {
                "title": title, "query_type": kind, "output_formats": ["CoverageJSON"], "default_output_format": "CoverageJSON",
                "crs_details": [{ "crs": "CRS84", "wkt": CRS84_WKT }],
            },
        } })
    };
    let (quantities, _) = sample::offered(scene);
    let parameters: Map<String, Value> = quantities
        .iter()
        .map(|&q| (q.name().to_owned(), parameter(q, Value::from)))
        .collect();
    Ok(json!({
        "id": id.as_ref(),
        "title": scene.name,
        "description": scene.description,
        "keywords": ["weather", "simulation", "clouds"],
        "links": [
            { "href": here, "rel": "self", "type": "application/json" },
            { "href": format!("{base}/collections"), "rel": "collection", "type": "application/json" },
            { "href": format!("{base}/v1/worlds/{id}"), "rel": "alternate", "type": "application/json", "title": "The world" },
        ],
        "extent": {
            "spatial": { "bbox": [[low[1], low[0], high[1], high[0]]], "crs": CRS84 },
            "temporal": {
                "interval": [[times.first(), times.last()]],
                "values": times,
                "trs": TIME_WKT,
            },
            "vertical": {
                "interval": [[low[2].to_string(), high[2].to_string()]],
                "values": levels.map(|m| m.to_string()).collect::<Vec<_>>(),
                "vrs": HEIGHT_WKT,
            },
        },
        "data_queries": {
            "position": query("position", "At a place, or the column above it"),
            "area": query("area", "The cells in a polygon"),
            "cube": query("cube", "The cells in a box"),
            "trajectory": query("trajectory", "Along a path"),
        },
        "crs": ["CRS84"],
        "output_formats": ["CoverageJSON"],
        "parameter_names": parameters,
    }))
}
