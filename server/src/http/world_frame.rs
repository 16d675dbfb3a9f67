//! `GET /v1/worlds/{id}/frame`: a picture of a live world.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::str::FromStr;
use std::sync::Arc;

use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use welkin_proto::wire::{FrameFormat, FrameQuality};
use welkin_proto::{ApiError, Camera, validate};

use super::checks;
use super::error::{Refusal, internal};
use super::extract::{Pairs, WorldOf};
use super::query::{invalid, moment, number, unknown};
use super::route::{Place, Route};
use super::state::AppState;
use super::viewing::still_fits;
use crate::host::View;
use crate::host::renderer::{Frame, FrameRequest, LayersWish, Viewer};
use crate::limits::Limits;

/// The size of a frame whose size nobody gave, pixels.
const DEFAULT_SIZE: [u32; 2] = [640, 360];
/// Names the tick that a frame shows.
const TICK_HEADER: HeaderName = HeaderName::from_static("x-welkin-tick");
/// Names the simulated second that a frame shows.
const SIMULATED_HEADER: HeaderName = HeaderName::from_static("x-welkin-simulated-s");
const SERVER_TIMING: HeaderName = HeaderName::from_static("server-timing");

/// Media types of frames.
pub const MEDIA_TYPES: [&str; 3] = ["image/jpeg", "image/png", "image/webp"];

/// Media types of layers.
pub const LAYER_MEDIA_TYPES: [&str; 2] = ["image/png", "application/octet-stream"];

/// The route.
pub fn route() -> Route {
    use Place::Query;
    let route = Route::get("/v1/worlds/{id}/frame", "A picture of a live world", frame).of_world();
    view_parameters(route)
        .parameter::<FrameFormat>(Query, "format", "Coding of the picture; jpeg.")
        .parameter::<FrameQuality>(Query, "quality", "How much the picture may cost, live or still; live.")
        .past_parameters()
        .parameter::<String>(
            Place::Header,
            "If-None-Match",
            "The `ETag` of the frame that the client has.",
        )
        .bytes(
            200,
            "The picture, with `ETag`, `X-Welkin-Tick`, `X-Welkin-Simulated-S`, `Server-Timing`.",
            &MEDIA_TYPES,
        )
        .bytes(304, "The client has the newest one.", &[])
        .past_errors()
        .error("out_of_range")
        .error("bad_parameter")
        .error("unknown_parameter")
        .error("bad_query")
        .error("busy")
        .error("internal")
}

/// With the parameters of a picture's size and camera, which [`parse`] reads.
pub fn view_parameters(route: Route) -> Route {
    use Place::Query;
    route
        .parameter::<u32>(Query, "width", "Pixels across; 640.")
        .parameter::<u32>(Query, "height", "Pixels down; 360.")
        .parameter::<f64>(
            Query,
            "x_m",
            "Camera, metres east of the south-west corner; the scene's.",
        )
        .parameter::<f64>(
            Query,
            "y_m",
            "Camera, metres north of the south-west corner; the scene's.",
        )
        .parameter::<f64>(Query, "z_m", "Camera, metres above the ground; the scene's.")
        .parameter::<f64>(
            Query,
            "azimuth_deg",
            "Direction of view, degrees clockwise from north; the scene's.",
        )
        .parameter::<f64>(
            Query,
            "elevation_deg",
            "Direction of view, degrees above the horizon; the scene's.",
        )
        .parameter::<f64>(
            Query,
            "vertical_fov_deg",
            "Angle of view from bottom to top, degrees; the scene's.",
        )
        .parameter::<f64>(Query, "exposure_ev", "Exposure compensation, stops; the scene's.")
}

async fn frame(
    State(state): State<AppState>,
    WorldOf(host): WorldOf,
    Pairs(pairs): Pairs,
    headers: HeaderMap,
) -> Result<Response, Refusal> {
    let view = host.view().clone();
    drop(host); // the world may be stopped while the frame is rendered
    let (when, pairs) = moment(pairs)?;
    let mut request = parse(&pairs, &view.scene.camera, state.limits())?;
    request.past = view.past_at(when)?;
    let query = fingerprint(&request);
    let revision = request
        .past
        .as_ref()
        .map_or_else(|| view.newest().revision, |p| p.revision);
    let newest = etag(&view.id, revision, query);
    if headers.get_all(header::IF_NONE_MATCH).iter().any(|v| names(v, &newest)) {
        return Ok((
            StatusCode::NOT_MODIFIED,
            [(header::ETAG, newest), (header::CACHE_CONTROL, "no-cache".into())],
        )
            .into_response());
    }
    let frame = single(&state, &view, request).await?;
    let tag = etag(&view.id, frame.revision, query);
    Ok(image_response(
        &frame,
        [(header::ETAG, tag), (header::CACHE_CONTROL, "no-cache".into())],
    ))
}

/// Has a picture drawn that no stream shows. Errors: those of the renderer.
pub async fn single(state: &AppState, view: &View, request: FrameRequest) -> Result<Arc<Frame>, Refusal> {
    let queued_max = state.limits().queued_frames_max;
    let ticket = state.renderer().request(Viewer::SNAPSHOTS, view, request, queued_max)?;
    Ok(ticket.answer.await.map_err(internal)??)
}

/// A frame as an answer.
pub fn image_response(frame: &Frame, more: [(HeaderName, String); 2]) -> Response {
    let timing = format!("render;dur={:.1}, encode;dur={:.1}", frame.render_ms, frame.encode_ms);
    let headers = [
        (header::CONTENT_TYPE, media_type(&frame.request).to_owned()),
        (TICK_HEADER, frame.tick.to_string()),
        (SIMULATED_HEADER, frame.simulated_s.to_string()),
        (SERVER_TIMING, timing),
    ];
    (headers, more, frame.bytes.clone()).into_response()
}

fn media_type(request: &FrameRequest) -> &'static str {
    match &request.layers {
        None => {}
        Some(LayersWish::Depth { raw } | LayersWish::Before { raw, .. }) => {
            return LAYER_MEDIA_TYPES[usize::from(*raw)];
        }
    }
    match request.format {
        FrameFormat::Jpeg => MEDIA_TYPES[0],
        FrameFormat::Png => MEDIA_TYPES[1],
        FrameFormat::Webp => MEDIA_TYPES[2],
    }
}

fn etag(world: &str, revision: u64, query: u64) -> String {
    format!("\"{world}-{revision}-{query:016x}\"")
}

/// Whether an `If-None-Match` header lists this tag (weak comparison, RFC 9110 section 13.1.2).
fn names(value: &HeaderValue, tag: &str) -> bool {
    let listed = value.to_str().unwrap_or_default().split(',').map(str::trim);
    listed
        .map(|t| t.strip_prefix("W/").unwrap_or(t))
        .any(|t| t == tag || t == "*")
}

fn fingerprint(request: &FrameRequest) -> u64 {
    let FrameRequest {
        width,
        height,
        format,
        camera,
        still,
        whole: _, // always
        past,
        layers: _, // an answer of layers has no tag
    } = request;
    let mut hasher = DefaultHasher::new();
    // A kept sky is coded more coarsely than the newest one, so that the same publication gives another picture.
    (width, height, format, still, past.is_some()).hash(&mut hasher);
    let angles = [
        camera.azimuth_deg,
        camera.elevation_deg,
        camera.vertical_fov_deg,
        camera.exposure_ev,
    ];
    for value in camera.position_m.iter().chain(&angles) {
        value.to_bits().hash(&mut hasher);
    }
    hasher.finish()
}

/// Reads the query of [`view_parameters`], format and quality; what is absent comes from the scene's camera.
pub fn parse(pairs: &[(String, String)], scene_camera: &Camera, limits: &Limits) -> Result<FrameRequest, ApiError> {
    let [width, height] = DEFAULT_SIZE;
    let mut request = FrameRequest {
        width,
        height,
        format: FrameFormat::default(),
        camera: scene_camera.clone(),
        still: false,
        whole: true,
        past: None,
        layers: None,
    };
    let camera = &mut request.camera;
    for (name, value) in pairs {
        match name.as_str() {
            "width" => request.width = pixels(name, value)?,
            "height" => request.height = pixels(name, value)?,
            "format" => request.format = format_named(value)?,
            "quality" => {
                request.still = match value.as_str() {
                    "live" => false,
                    "still" => true,
                    _ => return Err(invalid(name, value, "one of live, still")),
                }
            }
            "x_m" => camera.position_m[0] = number(name, value)?,
            "y_m" => camera.position_m[1] = number(name, value)?,
            "z_m" => camera.position_m[2] = number(name, value)?,
            "azimuth_deg" => camera.azimuth_deg = number(name, value)?,
            "elevation_deg" => camera.elevation_deg = number(name, value)?,
            "vertical_fov_deg" => camera.vertical_fov_deg = number(name, value)?,
            "exposure_ev" => camera.exposure_ev = number(name, value)?,
            _ => return Err(unknown(name)),
        }
    }
    checks::size(request.width, request.height, limits)?;
    if request.still {
        still_fits(request.width, request.height, limits)?;
    }
    validate::camera(&request.camera, "").map_err(|error| match error.pointer.as_deref() {
        Some("/position_m/0") => error.at("/x_m"),
        Some("/position_m/1") => error.at("/y_m"),
        Some("/position_m/2") => error.at("/z_m"),
        _ => error,
    })?;
    Ok(request)
}

fn format_named(value: &str) -> Result<FrameFormat, ApiError> {
    match value {
        "jpeg" => Ok(FrameFormat::Jpeg),
        "png" => Ok(FrameFormat::Png),
        "webp" => Ok(FrameFormat::Webp),
        _ => Err(invalid("format", value, "one of jpeg, png, webp")),
    }
}

/// A number of pixels; one too large for the type is out of range, not malformed.
fn pixels(name: &str, value: &str) -> Result<u32, ApiError> {
    match i128::from_str(value) {
        Ok(pixels) => u32::try_from(pixels).map_err(|_| {
            ApiError::new("out_of_range", format!("{name} is {value}; it must be at least 1")).at(format!("/{name}"))
        }),
        Err(_) => Err(invalid(name, value, "a whole number")),
    }
}
