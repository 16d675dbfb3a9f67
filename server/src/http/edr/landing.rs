//! `GET /` for programs: the landing page of the weather service. Browsers get the web page there.

use axum::http::{HeaderMap, header};
use serde_json::{Value, json};

/// Whether a request for `/` asks for JSON: by `f=json`, or by an `Accept` that names JSON and not HTML.
pub fn wants_json(headers: &HeaderMap, pairs: &[(String, String)]) -> bool {
    if let Some((_, format)) = pairs.iter().find(|(name, _)| name == "f") {
        return format.eq_ignore_ascii_case("json") || format == "application/json";
    }
    let accepts = headers
        .get(header::ACCEPT)
        .and_then(|v| v.to_str().ok())
        .unwrap_or_default();
    accepts.contains("application/json") && !accepts.contains("text/html")
}

/// The landing page.
pub fn landing(base: &str) -> Value {
    json!({
        "title": "Welkin",
        "description": "A shared, physically simulated sky: wind, temperature, humidity, cloud and turbulence of the worlds that run here.",
        "links": [
            { "href": format!("{base}/?f=json"), "rel": "self", "type": "application/json", "title": "This page" },
            { "href": format!("{base}/"), "rel": "alternate", "type": "text/html", "title": "The live sky" },
            {
                "href": format!("{base}/v1/openapi.json"), "rel": "service-desc",
                "type": "application/vnd.oai.openapi+json;version=3.1", "title": "OpenAPI 3.1 description of all routes",
            },
            { "href": format!("{base}/conformance"), "rel": "conformance", "type": "application/json", "title": "Conformance classes" },
            { "href": format!("{base}/collections"), "rel": "data", "type": "application/json", "title": "Worlds as collections" },
        ],
    })
}
