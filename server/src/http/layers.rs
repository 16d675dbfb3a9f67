//! What the routes of a picture's layers share: their parameters, and how they are answered.

use axum::http::header;
use axum::response::Response;
use welkin_proto::wire::LayerFormat;
use welkin_proto::{ApiError, Camera};

use super::error::Refusal;
use super::query::{invalid, moment};
use super::route::{Place::Query, Route};
use super::state::AppState;
use super::world_frame::{LAYER_MEDIA_TYPES, image_response, parse, single, view_parameters};
use crate::host::View;
use crate::host::renderer::FrameRequest;
use crate::limits::Limits;
use crate::sample::When;

/// With the parameters of a picture's layers, and the errors that they can give.
pub fn parameters(route: Route, answer: &'static str) -> Route {
    view_parameters(route)
        .parameter::<LayerFormat>(Query, "format", "Coding; png.")
        .past_parameters()
        .bytes(200, answer, &LAYER_MEDIA_TYPES)
        .past_errors()
        .error("out_of_range")
        .error("bad_parameter")
        .error("unknown_parameter")
        .error("bad_query")
        .error("busy")
        .error("internal")
}

/// What a query asks for: the request of the picture whose layers are wanted, whether as floats, and of when.
pub struct Wish {
    /// The picture, of now.
    pub request: FrameRequest,
    /// Floats instead of PNG.
    pub raw: bool,
    when: When,
}

impl Wish {
    /// Reads it. Errors: those of [`parse`] and [`moment`].
    pub fn new(pairs: Vec<(String, String)>, camera: &Camera, limits: &Limits) -> Result<Wish, ApiError> {
        let (when, pairs) = moment(pairs)?;
        let (format, pairs): (Vec<_>, Vec<_>) = pairs.into_iter().partition(|(name, _)| name == "format");
        let mut raw = false;
        for (name, value) in &format {
            raw = match value.as_str() {
                "png" => false,
                "f32" => true,
                _ => return Err(invalid(name, value, "one of png, f32")),
            };
        }
        if let Some((name, value)) = pairs.iter().find(|(name, _)| name == "quality") {
            return Err(invalid(name, value, "left out: layers have one ray a pixel"));
        }
        let request = parse(&pairs, camera, limits)?;
        Ok(Wish { request, raw, when })
    }

    /// Has it drawn and answers with it. Errors: those of the past and of the renderer.
    pub async fn answer(mut self, view: View, state: &AppState) -> Result<Response, Refusal> {
        self.request.past = view.past_at(self.when)?;
        let frame = single(state, &view, self.request).await?;
        let size = format!("{}x{}", frame.request.width, frame.request.height);
        let more = [
            (header::CACHE_CONTROL, "no-store".to_owned()),
            (header::HeaderName::from_static("x-welkin-size"), size),
        ];
        Ok(image_response(&frame, more))
    }
}
