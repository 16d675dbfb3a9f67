//! `GET /v1/worlds/{id}/frame.mjpeg`: pictures of a live world one after another, which an `<img>` shows.
//!
//! The answer has no end. A part is made when the connection has room for it, so that a slow client gets fewer pictures, each the newest, and
//! nothing is queued; one that takes nothing at all is dropped with its connection after the stall timeout.

use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use futures_util::stream::unfold;
use welkin_proto::ApiError;
use welkin_proto::wire::{FrameFormat, FrameQuality};

use super::error::Refusal;
use super::extract::{Pairs, WorldOf};
use super::query::{invalid, number};
use super::route::{Place, Route};
use super::state::{AppState, StreamPermit};
use super::viewing::{Viewing, Wish, until};
use super::world_frame::{parse, view_parameters};
use crate::host::renderer::{Frame, FrameRequest};
use crate::host::{Looking, View};

/// The rate of a client that names none, pictures a wall second.
const DEFAULT_FPS: f64 = 8.0;
const MEDIA_TYPE: &str = "multipart/x-mixed-replace; boundary=frame";

/// The route.
pub fn route() -> Route {
    let summary = "Pictures of a live world without end, as motion JPEG";
    view_parameters(Route::get("/v1/worlds/{id}/frame.mjpeg", summary, frames).of_world())
        .parameter::<f64>(Place::Query, "max_fps", "At most so many pictures a wall second; 8.")
        .parameter::<FrameQuality>(Place::Query, "quality", "How much a picture may cost; live.")
        .bytes(
            200,
            "A part a picture, each with `X-Welkin-Tick`, `X-Welkin-Simulated-S` and `Server-Timing`.",
            &["multipart/x-mixed-replace"],
        )
        .error("out_of_range")
        .error("bad_parameter")
        .error("unknown_parameter")
        .error("bad_query")
        .error("too_many_streams")
}

async fn frames(
    State(state): State<AppState>,
    WorldOf(host): WorldOf,
    Pairs(pairs): Pairs,
) -> Result<Response, Refusal> {
    let world = host.view().clone();
    drop(host); // the world may be stopped while pictures are sent
    let wish = wish(pairs, &world, &state)?;
    let permit = state.open_stream()?;
    let mut viewing = Viewing::new(&state);
    viewing.wish(wish, &state);
    let show = Show {
        _looking: world.look(),
        _permit: permit,
        viewing,
        state,
        world,
        begun: false,
    };
    let parts = unfold(show, |mut show| async {
        let part = show.next().await?;
        Some((Ok::<_, std::convert::Infallible>(part), show))
    });
    let headers = [(header::CONTENT_TYPE, MEDIA_TYPE), (header::CACHE_CONTROL, "no-store")];
    Ok((headers, Body::from_stream(parts)).into_response())
}

fn wish(pairs: Vec<(String, String)>, world: &View, state: &AppState) -> Result<Wish, ApiError> {
    let (own, view): (Vec<_>, Vec<_>) = pairs
        .into_iter()
        .partition(|(name, _)| ["max_fps", "quality"].contains(&name.as_str()));
    let (mut max_fps, mut quality) = (DEFAULT_FPS, FrameQuality::Live);
    for (name, value) in &own {
        match name.as_str() {
            "max_fps" => max_fps = number(name, value)?,
            _ => {
                quality = match value.as_str() {
                    "live" => FrameQuality::Live,
                    "still" => FrameQuality::Still,
                    "resting" => FrameQuality::Resting,
                    _ => return Err(invalid(name, value, "one of live, still, resting")),
                }
            }
        }
    }
    if let Some((name, value)) = view.iter().find(|(name, value)| name == "format" && value != "jpeg") {
        return Err(invalid(name, value, "jpeg"));
    }
    let request = FrameRequest {
        whole: false,
        ..parse(&view, &world.scene.camera, state.limits())?
    };
    debug_assert_eq!(request.format, FrameFormat::Jpeg);
    Wish::new(request, quality, max_fps, state.limits())
}

struct Show {
    _looking: Looking,
    _permit: StreamPermit,
    viewing: Viewing,
    state: AppState,
    world: View,
    begun: bool,
}

impl Show {
    /// The next picture; `None` when the world has stopped or cannot be drawn.
    async fn next(&mut self) -> Option<Bytes> {
        loop {
            let due = self.viewing.due(self.world.published.borrow().revision);
            tokio::select! {
                changed = self.world.published.changed() => changed.ok()?,
                answer = self.viewing.answer() => {
                    let frame = answer.ok()?;
                    return Some(self.part(&frame));
                }
                still = until(due) => {
                    if let Err(error) = self.viewing.ask(still, &self.state, &self.world) {
                        tracing::debug!(%error, "a viewer's picture waits");
                    }
                }
            }
        }
    }

    /// A part with the boundary behind it: browsers show a part when they have seen its end.
    fn part(&mut self, frame: &Frame) -> Bytes {
        let before = if std::mem::replace(&mut self.begun, true) {
            ""
        } else {
            "--frame\r\n"
        };
        let delivery = self.viewing.delivery(frame);
        let head = format!(
            "{before}Content-Type: image/jpeg\r\nContent-Length: {}\r\nX-Welkin-Tick: {}\r\nX-Welkin-Simulated-S: {}\r\n\
             Server-Timing: wait;dur={:.1}, render;dur={:.1}, encode;dur={:.1}\r\n\r\n",
            frame.bytes.len(),
            frame.tick,
            frame.simulated_s,
            delivery.wait_ms,
            frame.render_ms,
            frame.encode_ms,
        );
        Bytes::from([head.as_bytes(), &frame.bytes, b"\r\n--frame\r\n"].concat())
    }
}
