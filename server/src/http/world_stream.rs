//! `GET /v1/worlds/{id}/stream`: the WebSocket. Numbers after every tick as text, frames as binary when asked for.
//!
//! Nothing is queued for a client. Numbers come from a `watch` channel that holds the newest only; a frame is asked for
//! when the one before has been sent. A client that does not take a message within the stall timeout is dropped.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade, close_code};
use axum::extract::{FromRequestParts, Request, State};
use axum::http::{HeaderMap, header};
use axum::response::Response;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep_until, timeout};
use welkin_proto::wire::{ClientMessage, FRAME_HEADER_BYTES, FrameHeader, PROTOCOL_VERSION, ServerMessage};
use welkin_proto::{ApiError, validate};

use super::checks;
use super::error::Refusal;
use super::extract::WorldOf;
use super::route::{Place, Route};
use super::state::{AppState, StreamPermit};
use crate::host::View;
use crate::host::renderer::{Frame, FrameRequest, Ticket};

/// A client is pinged this often.
const PING_EVERY: Duration = Duration::from_secs(15);
/// A client that has not sent anything, not even a pong, for so long is taken to be gone.
const SILENCE_MAX: Duration = Duration::from_secs(50);
/// After a message that was too long, the close frame is given this long to arrive before the connection is cut.
const CLOSE_GRACE: Duration = Duration::from_millis(500);

/// The route.
pub fn route() -> Route {
    let summary =
        "A live stream (WebSocket): text is `ServerMessage` and `ClientMessage`, binary is a frame behind its header";
    Route::get("/v1/worlds/{id}/stream", summary, open)
        .of_world()
        .parameter::<String>(Place::Header, "Upgrade", "`websocket`")
        .bytes(101, "The connection becomes a WebSocket.", &[])
        .error("upgrade_required")
        .error("foreign_origin")
        .error("too_many_streams")
}

async fn open(State(state): State<AppState>, WorldOf(host): WorldOf, request: Request) -> Result<Response, Refusal> {
    let (mut parts, _) = request.into_parts();
    refuse_foreign_origin(&parts.headers)?;
    let upgrade = WebSocketUpgrade::from_request_parts(&mut parts, &state).await;
    let upgrade = upgrade.map_err(|e| ApiError::new("upgrade_required", e.body_text()))?;
    let permit = state.open_stream()?;
    let most = state.limits().message_bytes_max;
    let view = host.view().clone();
    Ok(upgrade
        .max_message_size(most)
        .max_frame_size(most)
        .on_upgrade(move |socket| run(socket, state, view, permit)))
}

/// A page of another site must not command a world through its visitor's browser. Browsers always say where a page
/// came from; programs that are no browsers say nothing.
fn refuse_foreign_origin(headers: &HeaderMap) -> Result<(), ApiError> {
    let text = |name| {
        headers
            .get(name)
            .map(|v: &header::HeaderValue| v.to_str().unwrap_or_default())
    };
    let Some(origin) = text(header::ORIGIN) else {
        return Ok(());
    };
    let authority = origin.split_once("://").map_or(origin, |(_, authority)| authority);
    if text(header::HOST).is_some_and(|host| host.eq_ignore_ascii_case(authority)) {
        return Ok(());
    }
    Err(ApiError::new(
        "foreign_origin",
        "the stream is open to pages of this server only",
    ))
}

/// Why a stream ends.
enum End {
    /// The client closed it, or its connection broke, or it stalled.
    Gone,
    /// The client broke a rule; it is told which.
    Rule(u16, &'static str),
    /// The world has stopped.
    WorldStopped,
}

/// What the client wants to see, and what it got.
struct Wish {
    request: FrameRequest,
    between: Duration,
}

struct Stream {
    socket: WebSocket,
    state: AppState,
    world: View,
    stall: Duration,
    wish: Option<Wish>,
    /// The frame under way.
    ticket: Option<Ticket>,
    /// No frame is asked for before.
    next_frame_at: Instant,
    /// The publication that the last frame showed; `None` after a new wish, which is answered even by a world that stands.
    shown: Option<u64>,
    sequence: u32,
    heard_at: Instant,
}

async fn run(socket: WebSocket, state: AppState, world: View, _permit: StreamPermit) {
    let _looking = world.look();
    let stall = Duration::try_from_secs_f64(state.limits().stall_timeout_s).unwrap_or(Duration::MAX);
    let now = Instant::now();
    let mut stream = Stream {
        socket,
        state,
        world,
        stall,
        wish: None,
        ticket: None,
        next_frame_at: now,
        shown: None,
        sequence: 0,
        heard_at: now,
    };
    let end = match stream.live().await {
        Ok(()) => return,
        Err(end) => end,
    };
    let (code, reason) = match end {
        End::Gone => return,
        End::Rule(code, reason) => (code, reason),
        End::WorldStopped => (close_code::AWAY, "the world has stopped"),
    };
    let close = Message::Close(Some(CloseFrame {
        code,
        reason: reason.into(),
    }));
    if stream.send(close).await.is_ok() && code == close_code::SIZE {
        // What the client still sends is not read; cutting the connection at once would take the close frame with it.
        tokio::time::sleep(CLOSE_GRACE).await;
    }
}

impl Stream {
    async fn live(&mut self) -> Result<(), End> {
        self.hello().await?;
        let mut pings = interval(PING_EVERY);
        pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
        self.world.published.mark_changed(); // the first numbers go out at once
        loop {
            let ask_at = self.wants_frame().then_some(self.next_frame_at);
            tokio::select! {
                message = self.socket.recv() => match message {
                    None => return Ok(()),
                    Some(message) => self.heard(message).await?,
                },
                changed = self.world.published.changed() => {
                    changed.map_err(|_| End::WorldStopped)?;
                    let numbers = self.world.published.borrow_and_update().snapshot.numbers.clone();
                    self.say(&ServerMessage::Tick { numbers }).await?;
                }
                answer = answer(&mut self.ticket) => {
                    self.ticket = None;
                    self.answered(answer).await?;
                }
                () = sleep_until_some(ask_at) => self.ask().await?,
                _ = pings.tick() => {
                    if self.heard_at.elapsed() > SILENCE_MAX {
                        return Err(End::Gone);
                    }
                    self.send(Message::Ping(Default::default())).await?;
                }
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
        self.say(&hello).await
    }

    /// Sends, and gives a client that does not take it up.
    async fn send(&mut self, message: Message) -> Result<(), End> {
        match timeout(self.stall, self.socket.send(message)).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_)) => Err(End::Gone),
            Err(_) => {
                tracing::info!(world = %self.world.id, "a stalled client was dropped");
                Err(End::Gone)
            }
        }
    }

    async fn say(&mut self, message: &ServerMessage) -> Result<(), End> {
        match serde_json::to_string(message) {
            Ok(text) => self.send(Message::Text(text.into())).await,
            Err(error) => {
                tracing::error!(%error, "a message could not be written as JSON");
                Err(End::Rule(close_code::ERROR, "internal error"))
            }
        }
    }

    async fn refuse(&mut self, error: ApiError) -> Result<(), End> {
        self.say(&ServerMessage::Error { error }).await
    }

    async fn heard(&mut self, message: Result<Message, axum::Error>) -> Result<(), End> {
        self.heard_at = Instant::now();
        match message {
            Ok(Message::Text(text)) => match self.take(text.as_str()) {
                Ok(()) => Ok(()),
                Err(error) => self.refuse(error).await,
            },
            Ok(Message::Binary(_)) => {
                let message = "this stream takes text messages only; see ClientMessage in /v1/openapi.json";
                self.refuse(ApiError::new("unexpected_binary", message)).await
            }
            Ok(Message::Ping(_) | Message::Pong(_)) => Ok(()),
            Ok(Message::Close(_)) => Ok(()), // answered by the library; the next read ends the stream
            Err(error) if is_too_long(&error) => Err(End::Rule(close_code::SIZE, "the message is too long")),
            Err(_) => Err(End::Gone),
        }
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
        self.send(Message::Binary(bytes.into())).await
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

/// Whether reading failed because a message is longer than allowed.
fn is_too_long(error: &axum::Error) -> bool {
    // axum does not say which kind of error the library below it had, except in words.
    std::error::Error::source(error).is_some_and(|source| source.to_string().contains("too long"))
}
