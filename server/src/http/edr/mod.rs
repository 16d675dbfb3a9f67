//! The weather service: OGC API - Environmental Data Retrieval 1.1 (OGC 19-086r6), so that existing weather clients can ask. Each world is a
//! collection; answers are CoverageJSON 1.0 (OGC 21-069r2). One file a route.
//!
//! Coordinates are CRS84 (longitude, latitude in degrees) and altitude above mean sea level in metres; a collection ends at its world's box, unlike
//! samples, which go on where pictures do. Times are those that the world keeps while somebody asks.

mod area;
mod collection;
mod collections;
mod conformance;
mod coverage;
mod cube;
mod grid;
mod landing;
mod position;
mod query;
mod trajectory;
mod wkt;

use axum::extract::FromRequestParts;
use axum::http::header;
use axum::http::request::Parts;

use super::error::Refusal;
use super::route::{Place, Route};
use super::state::AppState;

pub use landing::{landing, wants_json};

/// All routes of the service but the landing page, which the web page shares.
pub fn routes() -> Vec<Route> {
    vec![
        conformance::route(),
        collections::route(),
        collection::route(),
        position::route(),
        area::route(),
        cube::route(),
        trajectory::route(),
    ]
}

impl Route {
    /// A data query of a collection: what all of them take and answer.
    fn edr_query(self) -> Self {
        use Place::Query;
        self.of_world()
            .parameter::<String>(
                Query,
                "parameter-name",
                "Names with commas between, as the collection lists them; all.",
            )
            .parameter::<String>(Query, "crs", "`CRS84`, which is the only one.")
            .parameter::<String>(Query, "f", "`CoverageJSON`, which is the only one.")
            .bytes(200, "A coverage.", &[coverage::MEDIA_TYPE])
            .sample_errors()
            .error("bad_query")
            .error("bad_parameter")
            .error("unknown_parameter")
            .error("bad_coords")
            .error("out_of_range")
            .error("outside_domain")
            .error("no_geography")
            .error("unsupported_crs")
            .error("unsupported_format")
            .error("too_many_points")
            .error("too_large")
    }

    fn edr_z(self, description: &'static str) -> Self {
        self.parameter::<String>(Place::Query, "z", description)
    }

    fn edr_datetime(self, description: &'static str) -> Self {
        self.parameter::<String>(Place::Query, "datetime", description)
    }
}

/// Where this server is reached, as the client wrote it, such as `http://127.0.0.1:8080`: links begin with it. Empty, which makes links relative, where
/// the request does not say.
pub struct Base(pub String);

impl FromRequestParts<AppState> for Base {
    type Rejection = Refusal;

    async fn from_request_parts(parts: &mut Parts, _: &AppState) -> Result<Self, Refusal> {
        let text = |name: &str| parts.headers.get(name).and_then(|v| v.to_str().ok());
        let host = text(header::HOST.as_str()).unwrap_or_default();
        let plain = |c: char| c.is_ascii_alphanumeric() || ".-:[]_".contains(c);
        if host.is_empty() || !host.chars().all(plain) {
            return Ok(Self(String::new()));
        }
        let scheme = match text("x-forwarded-proto") {
            Some("https") => "https",
            _ => "http",
        };
        Ok(Self(format!("{scheme}://{host}")))
    }
}
