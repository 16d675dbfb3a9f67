//! Errors on the wire: always [`ApiError`] as JSON, with the status that its code stands for.

use axum::Json;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use welkin_proto::ApiError;

/// An [`ApiError`] on its way to a client.
#[derive(Debug)]
pub struct Refusal(pub ApiError);

impl From<ApiError> for Refusal {
    fn from(error: ApiError) -> Self {
        Self(error)
    }
}

/// The HTTP status of an error code; 400 for the many that blame the request.
pub fn status_of(code: &str) -> StatusCode {
    match code {
        "not_found" | "no_stars" | "unknown_world" | "unknown_scene" | "not_yet" | "tick_not_kept"
        | "weather_not_kept" => StatusCode::NOT_FOUND,
        "foreign_origin" => StatusCode::FORBIDDEN,
        "method_not_allowed" => StatusCode::METHOD_NOT_ALLOWED,
        "world_stopped" | "too_old" => StatusCode::GONE,
        "body_too_large" | "too_large" | "too_many_points" | "volume_too_large" => StatusCode::PAYLOAD_TOO_LARGE,
        "unsupported_media_type" => StatusCode::UNSUPPORTED_MEDIA_TYPE,
        "upgrade_required" => StatusCode::UPGRADE_REQUIRED,
        "too_many_worlds" | "too_many_streams" | "too_many_views" | "busy" => StatusCode::TOO_MANY_REQUESTS,
        "render_too_long" | "weather_unavailable" | "past_unavailable" => StatusCode::SERVICE_UNAVAILABLE,
        "unstable" => StatusCode::UNPROCESSABLE_ENTITY,
        "internal" => StatusCode::INTERNAL_SERVER_ERROR,
        _ => StatusCode::BAD_REQUEST,
    }
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        (status_of(&self.0.code), Json(self.0)).into_response()
    }
}

/// What a client is told when the fault is ours; the cause goes to the log.
pub fn internal(cause: impl std::fmt::Display) -> ApiError {
    tracing::error!(%cause, "internal error");
    ApiError::new("internal", "something went wrong in the server; it is in the log")
}
