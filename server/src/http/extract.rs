//! Reading requests so that whatever is wrong is answered as an `ApiError`.

use axum::body::Bytes;
use axum::extract::{FromRequest, FromRequestParts, Path, Query, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, StatusCode, header};
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::sync::Arc;
use welkin_proto::{ApiError, Scene, presets, validate};

use super::error::Refusal;
use super::state::AppState;
use crate::host::Host;
use crate::limits::Limits;
use crate::methods;

/// The world that the path names; `unknown_world`.
pub struct WorldOf(pub Arc<Host>);

impl FromRequestParts<AppState> for WorldOf {
    type Rejection = Refusal;

    async fn from_request_parts(parts: &mut Parts, state: &AppState) -> Result<Self, Refusal> {
        let Path(id) = name_in_path(parts, state).await?;
        let host = state.world(&id)?;
        host.view().looked_at();
        Ok(Self(host))
    }
}

/// The path's one parameter; `not_found` where it is not text.
pub struct NameOf(pub String);

impl FromRequestParts<AppState> for NameOf {
    type Rejection = Refusal;

    async fn from_request_parts(parts: &mut Parts, state: &AppState) -> Result<Self, Refusal> {
        let Path(name) = name_in_path(parts, state).await?;
        Ok(Self(name))
    }
}

async fn name_in_path(parts: &mut Parts, state: &AppState) -> Result<Path<String>, Refusal> {
    let name = Path::<String>::from_request_parts(parts, state).await;
    name.map_err(|_| {
        Refusal(ApiError::new(
            "not_found",
            "the path is not valid percent-encoded UTF-8",
        ))
    })
}

/// The query as pairs, in order; `bad_query`.
pub struct Pairs(pub Vec<(String, String)>);

impl FromRequestParts<AppState> for Pairs {
    type Rejection = Refusal;

    async fn from_request_parts(parts: &mut Parts, state: &AppState) -> Result<Self, Refusal> {
        let pairs = Query::from_request_parts(parts, state).await;
        let Query(pairs) = pairs.map_err(|e| ApiError::new("bad_query", e.body_text()))?;
        Ok(Self(pairs))
    }
}

/// A JSON body as text, not yet parsed; `unsupported_media_type`, `body_too_large`.
pub struct JsonText(pub Bytes);

impl FromRequest<AppState> for JsonText {
    type Rejection = Refusal;

    async fn from_request(request: Request, state: &AppState) -> Result<Self, Refusal> {
        of_media_type(request.headers(), "application/json")?;
        let bytes = Bytes::from_request(request, state).await.map_err(|rejection| {
            if rejection.status() == StatusCode::PAYLOAD_TOO_LARGE {
                let most = state.limits().body_bytes_max;
                ApiError::new("body_too_large", format!("the body is larger than {most} bytes"))
            } else {
                ApiError::new("bad_body", "the body could not be read")
            }
        })?;
        Ok(Self(bytes))
    }
}

/// Errors: `unsupported_media_type` where the body is said to be anything else.
pub fn of_media_type(headers: &HeaderMap, wanted: &str) -> Result<(), ApiError> {
    let media_type = headers.get(header::CONTENT_TYPE).and_then(|v| v.to_str().ok());
    let media_type = media_type.unwrap_or_default();
    let essence = media_type.split(';').next().unwrap_or_default().trim();
    if essence.eq_ignore_ascii_case(wanted) {
        return Ok(());
    }
    let message = format!("the body's Content-Type is {essence:?}; it must be {wanted}");
    Err(ApiError::new("unsupported_media_type", message))
}

/// Parses a JSON text; `bad_json` names the line and column.
pub fn parse_json(text: &[u8]) -> Result<Value, ApiError> {
    serde_json::from_slice(text).map_err(|e| ApiError::new("bad_json", format!("not JSON: {e}")))
}

/// Reads a value as `T`; `bad_body` says which field is missing, unknown or of a wrong type.
pub fn read<T: DeserializeOwned>(value: Value) -> Result<T, ApiError> {
    serde_json::from_value(value).map_err(|e| ApiError::new("bad_body", e.to_string()))
}

/// Takes the scene out of a document that holds exactly one of `preset` and `scene`; the rest stays.
///
/// Errors: `bad_body`, `unknown_preset`, those of the scene with pointers that begin with `/scene`.
pub fn take_scene(document: &mut Value, limits: &Limits) -> Result<Scene, ApiError> {
    let Value::Object(fields) = document else {
        return Err(ApiError::new("bad_body", "the body must be a JSON object").at(""));
    };
    let given = |v: Option<Value>| v.filter(|v| !v.is_null());
    match (given(fields.remove("preset")), given(fields.remove("scene"))) {
        (Some(Value::String(name)), None) => presets::find(&name).map_err(|error| error.at("/preset")),
        (None, Some(scene)) => validate::parse_scene(&scene.to_string(), &limits.scene())
            .and_then(|scene| methods::choose(&scene).map(|_| scene))
            .map_err(|error| {
                let pointer = format!("/scene{}", error.pointer.as_deref().unwrap_or_default());
                error.at(pointer)
            }),
        (Some(Value::String(_)), Some(_)) | (None, None) => {
            Err(ApiError::new("bad_body", "give exactly one of `preset` and `scene`").at(""))
        }
        (Some(_), _) => Err(ApiError::new("bad_body", "`preset` must be a string").at("/preset")),
    }
}
