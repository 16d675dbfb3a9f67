//! `GET /conformance`: the conformance classes that this service claims.

use axum::Json;
use serde_json::{Value, json};

use crate::http::route::Route;

/// What is claimed. OpenAPI is 3.1, for which EDR 1.1 has no class.
const CLASSES: [&str; 6] = [
    "http://www.opengis.net/spec/ogcapi-common-1/1.0/conf/core",
    "http://www.opengis.net/spec/ogcapi-common-2/1.0/conf/collections",
    "http://www.opengis.net/spec/ogcapi-edr-1/1.1/conf/core",
    "http://www.opengis.net/spec/ogcapi-edr-1/1.1/conf/collections",
    "http://www.opengis.net/spec/ogcapi-edr-1/1.1/conf/json",
    "http://www.opengis.net/spec/ogcapi-edr-1/1.1/conf/covjson",
];

/// The route.
pub fn route() -> Route {
    Route::get(
        "/conformance",
        "Conformance classes of the weather service",
        async || Json(document()),
    )
    .bytes(200, "The classes, under `conformsTo`.", &["application/json"])
}

fn document() -> Value {
    json!({ "conformsTo": CLASSES })
}
