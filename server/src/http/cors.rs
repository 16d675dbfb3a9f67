//! Which pages of other origins may read what is served: those that `--cors-origin` names, and only by methods that change nothing.

use axum::http::request::Parts;
use axum::http::{HeaderName, HeaderValue, Method, header};
use tower_http::cors::{AllowOrigin, CorsLayer};

/// Headers that scripts of those pages may see besides the usual ones.
const EXPOSED: [HeaderName; 4] = [
    header::ETAG,
    HeaderName::from_static("x-welkin-tick"),
    HeaderName::from_static("x-welkin-simulated-s"),
    HeaderName::from_static("server-timing"),
];

/// The layer for these origins, `*` being all; without any it allows none.
pub fn layer(origins: &[String]) -> CorsLayer {
    let origins = origins.to_vec();
    let allowed = move |origin: &HeaderValue, request: &Parts| {
        origin.to_str().is_ok_and(|origin| names(&origins, origin)) && only_reads(request)
    };
    CorsLayer::new()
        .allow_origin(AllowOrigin::predicate(allowed))
        .allow_methods([Method::GET, Method::HEAD, Method::POST])
        .allow_headers([header::CONTENT_TYPE, header::IF_NONE_MATCH])
        .expose_headers(EXPOSED)
}

/// Whether an origin is among those that are named.
pub fn names(origins: &[String], origin: &str) -> bool {
    origins.iter().any(|o| o == "*" || o.eq_ignore_ascii_case(origin))
}

/// Whether a request, or the one that a browser asks leave for, changes nothing. Samples of many places are asked for by POST.
fn only_reads(request: &Parts) -> bool {
    let asked = match request.method {
        Method::OPTIONS => request
            .headers
            .get(header::ACCESS_CONTROL_REQUEST_METHOD)
            .and_then(|method| Method::from_bytes(method.as_bytes()).ok()),
        _ => Some(request.method.clone()),
    };
    match asked {
        Some(Method::GET | Method::HEAD) => true,
        Some(Method::POST) => request.uri.path().ends_with("/sample"),
        _ => false,
    }
}
