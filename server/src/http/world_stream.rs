//! `GET /v1/worlds/{id}/stream`: the WebSocket. Numbers after every tick as text, frames as binary when asked for.
//!
//! Nothing is queued for a client. Numbers come from a `watch` channel that holds the newest only; for frames see [`Viewing`]. A client that does not take a message within the stall timeout is dropped.

use std::convert::Infallible;
use std::sync::Arc;

use axum::extract::ws::Message;
use axum::extract::{Request, State};
use axum::response::Response;
use welkin_proto::wire::{ClientMessage, FRAME_HEADER_VERSION, FrameHeader, PROTOCOL_VERSION, ServerMessage};
use welkin_proto::{ApiError, validate};

use super::checks;
use super::error::Refusal;
use super::extract::WorldOf;
use super::route::Route;
use super::socket::{self, Connection, End, Incoming};
use super::state::AppState;
use super::viewing::{Viewing, Wish, until};
use crate::host::View;
use crate::host::renderer::{Frame, FrameRequest};

/// The route.
pub fn route() -> Route {
    let summary =
        "A live stream (WebSocket): text is `ServerMessage` and `ClientMessage`, binary is a frame behind its header";
    Route::get("/v1/worlds/{id}/stream", summary, open)
        .of_world()
        .web_socket()
}

async fn open(State(state): State<AppState>, world: WorldOf, request: Request) -> Result<Response, Refusal> {
    let most = state.limits().message_bytes_max;
    socket::open(state, world, request, most, |connection, state, world| async move {
        let mut stream = Stream {
            connection,
            viewing: Viewing::new(&state),
            state,
            world,
            frame_header: FrameHeader::first_version(),
            sequence: 0,
        };
        let end = stream.live().await;
        (stream.connection, end)
    })
    .await
}

struct Stream {
    connection: Connection,
    state: AppState,
    world: View,
    viewing: Viewing,
    /// Version of the frames' header that the client reads.
    frame_header: u16,
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
            let due = self.viewing.due(self.world.published.borrow().revision);
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
                answer = self.viewing.answer() => self.answered(answer).await?,
                still = until(due) => {
                    if let Err(error) = self.viewing.ask(still, &self.state, &self.world) {
                        self.refuse(error).await?;
                    }
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
            ClientMessage::NoFrames {} => self.viewing.stop(),
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
                quality,
                header,
            } => {
                checks::size(width, height, self.state.limits())?;
                checks::in_range(header.into(), 1.0, FRAME_HEADER_VERSION.into(), "/header")?;
                if let Some(camera) = &camera {
                    validate::camera(camera, "/camera")?;
                }
                let camera = camera.unwrap_or_else(|| self.world.scene.camera.clone());
                let request = FrameRequest {
                    width,
                    height,
                    format,
                    camera,
                    still: false,
                    whole: false,
                    past: None,
                    layers: None,
                };
                let wish = Wish::new(request, quality, max_fps, self.state.limits())?;
                self.viewing.wish(wish, &self.state);
                self.frame_header = header;
            }
        }
        Ok(())
    }

    async fn answered(&mut self, answer: Result<Arc<Frame>, ApiError>) -> Result<(), End> {
        let frame = match answer {
            Ok(frame) if self.viewing.wants_frames() => frame,
            Ok(_) => return Ok(()),
            Err(error) => return self.refuse(error).await,
        };
        let header = self.viewing.header(&frame, self.sequence, self.frame_header > 1);
        self.sequence = self.sequence.wrapping_add(1);
        let mut bytes = header.encode();
        bytes.extend_from_slice(&frame.bytes);
        self.connection.send(Message::Binary(bytes.into())).await
    }
}
