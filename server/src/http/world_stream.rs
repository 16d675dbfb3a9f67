//! `GET /v1/worlds/{id}/stream`: the WebSocket. Numbers after every tick as text, frames as binary when asked for.
//!
//! Nothing is queued for a client. Numbers come from a `watch` channel that holds the newest only; a frame is asked for
//! when the one before has been sent. A client that does not take a message within the stall timeout is dropped.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::Message;
use axum::extract::{Request, State};
use axum::response::Response;
use tokio::time::{Instant, sleep_until};
use welkin_proto::wire::{ClientMessage, FRAME_HEADER_BYTES, FrameHeader, PROTOCOL_VERSION, ServerMessage};
use welkin_proto::{ApiError, validate};

use super::checks;
use super::error::Refusal;
use super::extract::WorldOf;
use super::route::Route;
use super::socket::{self, Connection, End, Incoming};
use super::state::AppState;
use crate::host::View;
use crate::host::renderer::{Frame, FrameRequest, Ticket};

/// The route.
pub fn route() -> Route {
    let summary =
        "A live stream (WebSocket): text is `ServerMessage` and `ClientMessage`, binary is a frame behind its header";
    Route::get("/v1/worlds/{id}/stream", summary, open)
        .of_world()
        .web_socket()
}

async fn open(State(state): State<AppState>, WorldOf(host): WorldOf, request: Request) -> Result<Response, Refusal> {
    let view = host.view().clone();
    drop(host); // the world may be stopped while the stream is open
    let (shared, world) = (state.clone(), view.clone());
    let most = state.limits().message_bytes_max;
    socket::open(state, view, request, most, move |connection| async move {
        let mut stream = Stream {
            connection,
            state: shared,
            world,
            wish: None,
            ticket: None,
            next_frame_at: Instant::now(),
            shown: None,
            sequence: 0,
        };
        let end = stream.live().await;
        (stream.connection, end)
    })
    .await
}

/// What the client wants to see, and what it got.
struct Wish {
    request: FrameRequest,
    between: Duration,
}

struct Stream {
    connection: Connection,
    state: AppState,
    world: View,
    wish: Option<Wish>,
    /// The frame under way.
    ticket: Option<Ticket>,
    /// No frame is asked for before.
    next_frame_at: Instant,
    /// The publication that the last frame showed; `None` after a new wish, which is answered even by a world that stands.
    shown: Option<u64>,
    sequence: u32,
}

impl Stream {
    /// Runs until the stream ends, and says why it did.
    async fn live(&mut self) -> End {
        match self.go_on().await {
            Err(end) => end,
            Ok(never) => match never {},
        }
    }

    async fn go_on(&mut self) -> Result<Infallible, End> {
        self.hello().await?;
        self.world.published.mark_changed(); // the first numbers go out at once
        loop {
            let ask_at = self.wants_frame().then_some(self.next_frame_at);
            tokio::select! {
                event = self.connection.event() => match self.connection.take(event).await? {
                    None => {}
                    Some(Incoming::Text(text)) => {
                        if let Err(error) = self.take(text.as_str()) {
                            self.refuse(error).await?;
                        }
                    }
                    Some(Incoming::Binary(_)) => {
                        let message = "this stream takes text messages only; see ClientMessage in /v1/openapi.json";
                        self.refuse(ApiError::new("unexpected_binary", message)).await?;
                    }
                },
                changed = self.world.published.changed() => {
                    changed.map_err(|_| End::WorldStopped)?;
                    let numbers = self.world.published.borrow_and_update().snapshot.numbers.clone();
                    self.connection.say(&ServerMessage::Tick { numbers }).await?;
                }
                answer = answer(&mut self.ticket) => {
                    self.ticket = None;
                    self.answered(answer).await?;
                }
                () = sleep_until_some(ask_at) => self.ask().await?,
            }
        }
    }

    async fn hello(&mut self) -> Result<(), End> {
        let scene = self.world.scene.clone();
        let hello = ServerMessage::Hello {
            protocol: PROTOCOL_VERSION,
            server: env!("CARGO_PKG_VERSION").to_owned(),
            world: self.world.id.to_string(),
            scene: scene.name.clone(),
            cells: scene.domain.cells,
            cell_size_m: scene.domain.cell_size_m,
            camera: scene.camera.clone(),
        };
        self.connection.say(&hello).await
    }

    async fn refuse(&mut self, error: ApiError) -> Result<(), End> {
        self.connection.say(&ServerMessage::Error { error }).await
    }

    /// Obeys a text message.
    fn take(&mut self, text: &str) -> Result<(), ApiError> {
        let value = super::extract::parse_json(text.as_bytes())?;
        let message: ClientMessage =
            serde_json::from_value(value).map_err(|e| ApiError::new("bad_message", e.to_string()))?;
        match message {
            ClientMessage::NoFrames {} => {
                self.wish = None;
                self.ticket = None;
            }
            ClientMessage::Command { command } => self.world.command(command).map_err(|error| {
                let pointer = error.pointer.as_deref().map(|p| format!("/command{p}"));
                match pointer {
                    Some(pointer) => error.at(pointer),
                    None => error,
                }
            })?,
            ClientMessage::Frames {
                width,
                height,
                format,
                max_fps,
                camera,
            } => {
                checks::size(width, height, self.state.limits())?;
                checks::in_range(max_fps, 0.01, self.state.limits().frames_per_s_max, "/max_fps")?;
                if let Some(camera) = &camera {
                    validate::camera(camera, "/camera")?;
                }
                let camera = camera.unwrap_or_else(|| self.world.scene.camera.clone());
                let request = FrameRequest {
                    width,
                    height,
                    format,
                    camera,
                };
                if let Some(ticket) = &self.ticket {
                    self.state.renderer().replace(ticket, request.clone());
                }
                self.wish = Some(Wish {
                    request,
                    between: Duration::from_secs_f64(1.0 / max_fps),
                });
                self.shown = None;
            }
        }
        Ok(())
    }

    /// Whether there is a frame to ask for: one is wished for, none is under way, and the last shows an older state.
    fn wants_frame(&self) -> bool {
        self.wish.is_some() && self.ticket.is_none() && self.shown != Some(self.world.published.borrow().revision)
    }

    async fn ask(&mut self) -> Result<(), End> {
        let Some(wish) = &self.wish else {
            return Ok(());
        };
        // Due times follow one another, so that a frame asked for late does not lower the rate; a pause does not add up.
        let now = Instant::now();
        self.next_frame_at = (self.next_frame_at + wish.between).max(now);
        let request = wish.request.clone();
        match self
            .state
            .renderer()
            .request(&self.world, request, self.state.limits().queued_frames_max)
        {
            Ok(ticket) => {
                self.ticket = Some(ticket);
                Ok(())
            }
            Err(error) => {
                self.next_frame_at = now + Duration::from_secs(1);
                self.refuse(error).await
            }
        }
    }

    async fn answered(&mut self, answer: Result<Arc<Frame>, ApiError>) -> Result<(), End> {
        let frame = match answer {
            Ok(frame) => frame,
            Err(error) => {
                self.wish = None; // the same wish would fail again and again
                return self.refuse(error).await;
            }
        };
        let Some(wish) = &self.wish else {
            return Ok(());
        };
        let request = &frame.request;
        if wish.request == *request {
            self.shown = Some(frame.revision);
        }
        let header = FrameHeader {
            format: request.format,
            width: request.width,
            height: request.height,
            tick: frame.tick,
            simulated_s: frame.simulated_s,
            render_ms: frame.render_ms as f32,
            encode_ms: frame.encode_ms as f32,
            sequence: self.sequence,
            image_bytes: frame.bytes.len() as u32,
        };
        self.sequence = self.sequence.wrapping_add(1);
        let mut bytes = Vec::with_capacity(FRAME_HEADER_BYTES + frame.bytes.len());
        bytes.extend_from_slice(&header.encode());
        bytes.extend_from_slice(&frame.bytes);
        self.connection.send(Message::Binary(bytes.into())).await
    }
}

/// The frame under way; never, where there is none. Leaves the ticket in its place, so it may be dropped half-way.
async fn answer(ticket: &mut Option<Ticket>) -> Result<Arc<Frame>, ApiError> {
    match ticket {
        None => std::future::pending().await,
        Some(ticket) => (&mut ticket.answer).await.map_err(super::error::internal)?,
    }
}

async fn sleep_until_some(at: Option<Instant>) {
    match at {
        None => std::future::pending().await,
        Some(at) => sleep_until(at).await,
    }
}
