//! `GET /` and `GET /web/{name}`: the web page, which is part of the binary.

use axum::Json;
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use welkin_proto::ApiError;

use super::edr::{Base, landing, wants_json};
use super::error::Refusal;
use super::extract::{NameOf, Pairs};
use super::route::{Place, Route};

const INDEX: &str = include_str!("../../../client/web/index.html");

/// A file of the page that is a script: its name and its content.
macro_rules! scripts {
    ($($name:literal),* $(,)?) => { &[$(($name, include_str!(concat!("../../../client/web/", $name)))),*] };
}

/// The page's scripts.
const SCRIPTS: &[(&str, &str)] = scripts![
    "main.js",
    "arrows.js",
    "controls.js",
    "diffusion.js",
    "drawing.js",
    "flight.js",
    "kernels.js",
    "latency.js",
    "layers.js",
    "local.js",
    "lookback.js",
    "octave_balance.js",
    "overlay.js",
    "panel.js",
    "past.js",
    "playout.js",
    "raymarch.js",
    "scenery.js",
    "series.js",
    "sounding.js",
    "status.js",
    "stream.js",
    "sun.js",
    "sun_map.js",
    "view.js",
    "volume.js",
    "worlds.js"
];
const STYLE: &str = include_str!("../../../client/web/style.css");
const JAVASCRIPT: &str = "text/javascript; charset=utf-8";

/// Only our own files, frames from memory, and connections to where the page came from.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' blob: data:; \
                      connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The page.
pub fn route() -> Route {
    Route::get(
        "/",
        "The web page; for programs the landing page of the weather service (OGC API EDR)",
        page,
    )
    .parameter::<String>(Place::Query, "f", "`json` for the landing page; else `Accept` decides.")
    .bytes(200, "The page.", &["text/html", "application/json"])
    .error("bad_query")
}

async fn page(headers: HeaderMap, Base(base): Base, Pairs(pairs): Pairs) -> Response {
    let mut answer = match wants_json(&headers, &pairs) {
        true => Json(landing(&base)).into_response(),
        false => file("text/html; charset=utf-8", INDEX),
    };
    answer
        .headers_mut()
        .append(header::VARY, HeaderValue::from_static("accept"));
    answer
}

/// A file of the page.
pub fn file_route() -> Route {
    Route::get("/web/{name}", "A file of the web page", named)
        .parameter::<String>(Place::Path, "name", "The file's name.")
        .bytes(200, "The file.", &["text/javascript", "text/css"])
        .error("not_found")
}

async fn named(NameOf(name): NameOf) -> Result<Response, Refusal> {
    if name == "style.css" {
        return Ok(file("text/css; charset=utf-8", STYLE));
    }
    let found = SCRIPTS.iter().find(|(known, _)| *known == name);
    let (_, content) = found.ok_or_else(|| ApiError::new("not_found", format!("the page has no file {name:?}")))?;
    Ok(file(JAVASCRIPT, content))
}

fn file(media_type: &'static str, content: &'static str) -> Response {
    let headers: [(HeaderName, &'static str); 4] = [
        (header::CONTENT_TYPE, media_type),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-cache"),
    ];
    (headers, content).into_response()
}
