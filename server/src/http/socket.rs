//! What all WebSocket routes share: who may open one, how much a client may send, when a client is given up.
//!
//! A client that does not take a message within the stall timeout is dropped, so is one that has been silent for too long.

use std::future::Future;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::ws::{CloseFrame, Message, Utf8Bytes, WebSocket, WebSocketUpgrade, close_code};
use axum::extract::{FromRequestParts, Request};
use axum::http::{HeaderMap, header};
use axum::response::Response;
use serde::Serialize;
use tokio::time::{Instant, Interval, MissedTickBehavior, interval, timeout};
use welkin_proto::ApiError;

use super::cors;
use super::error::Refusal;
use super::extract::WorldOf;
use super::route::{Place, Route};
use super::state::AppState;
use crate::host::View;

/// A client is pinged this often.
const PING_EVERY: Duration = Duration::from_secs(15);
/// A client that has not sent anything, not even a pong, for so long is taken to be gone.
const SILENCE_MAX: Duration = Duration::from_secs(50);
/// After a message that was too long, the close frame is given this long to arrive before the connection is cut.
const CLOSE_GRACE: Duration = Duration::from_millis(500);

impl Route {
    /// That it becomes a WebSocket, and the errors of [`open`].
    pub fn web_socket(self) -> Self {
        self.parameter::<String>(Place::Header, "Upgrade", "`websocket`")
            .bytes(101, "The connection becomes a WebSocket.", &[])
            .error("upgrade_required")
            .error("foreign_origin")
            .error("too_many_streams")
    }
}

/// Opens a WebSocket to a world and lets `live` run it until it ends; counted as a stream, and as somebody who looks on. The world may be stopped
/// meanwhile: only its view is kept.
///
/// Errors: `foreign_origin`, `upgrade_required`, `too_many_streams`.
pub async fn open<L, F>(
    state: AppState,
    WorldOf(host): WorldOf,
    request: Request,
    message_bytes_max: usize,
    live: L,
) -> Result<Response, Refusal>
where
    L: FnOnce(Connection, AppState, View) -> F + Send + 'static,
    F: Future<Output = (Connection, End)> + Send + 'static,
{
    let world = host.view().clone();
    drop(host);
    let (mut parts, _) = request.into_parts();
    // Who may read may have volumes and samples streamed; commands are for the server's own pages.
    let readers: &[String] = if parts.uri.path().ends_with("/stream") {
        &[]
    } else {
        &state.limits().cors_origins
    };
    refuse_foreign_origin(&parts.headers, readers)?;
    let upgrade = WebSocketUpgrade::from_request_parts(&mut parts, &state).await;
    let upgrade = upgrade.map_err(|e| ApiError::new("upgrade_required", e.body_text()))?;
    let permit = state.open_stream()?;
    let stall = Duration::try_from_secs_f64(state.limits().stall_timeout_s).unwrap_or(Duration::MAX);
    let run = move |socket| async move {
        let _permit = permit;
        let _looking = world.look();
        let mut pings = interval(PING_EVERY);
        pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let connection = Connection {
            socket,
            stall,
            pings,
            heard_at: Instant::now(),
            answered: Bytes::new(),
            world: world.clone(),
        };
        let (connection, end) = live(connection, state, world).await;
        connection.close(end).await;
    };
    Ok(upgrade
        .max_message_size(message_bytes_max)
        .max_frame_size(message_bytes_max)
        .on_upgrade(run))
}

/// A page of another site must not command a world through its visitor's browser. Browsers always say where a page
/// came from; programs that are no browsers say nothing.
fn refuse_foreign_origin(headers: &HeaderMap, readers: &[String]) -> Result<(), ApiError> {
    let text = |name| {
        headers
            .get(name)
            .map(|v: &header::HeaderValue| v.to_str().unwrap_or_default())
    };
    let Some(origin) = text(header::ORIGIN) else {
        return Ok(());
    };
    let authority = origin.split_once("://").map_or(origin, |(_, authority)| authority);
    let own = text(header::HOST).is_some_and(|host| host.eq_ignore_ascii_case(authority));
    if own || cors::names(readers, origin) {
        return Ok(());
    }
    Err(ApiError::new(
        "foreign_origin",
        "the stream is open to pages of this server only, and of those that it was told of",
    ))
}

/// Why a connection ends.
#[derive(Debug)]
pub enum End {
    /// The client closed it, or it broke, or the client stalled.
    Gone,
    /// The client broke a rule, or the server failed; the client is told by a close code and a few words.
    Rule(u16, &'static str),
    /// The world has stopped.
    WorldStopped,
}

/// What a client has sent.
#[derive(Debug)]
pub enum Incoming {
    /// Text.
    Text(Utf8Bytes),
    /// Bytes.
    Binary(Bytes),
}

/// Something that a connection wants to be handled, see [`Connection::take`].
pub enum Event {
    /// What reading gave.
    Read(Option<Result<Message, axum::Error>>),
    /// It is time for a ping.
    PingDue,
}

/// An open WebSocket.
pub struct Connection {
    socket: WebSocket,
    stall: Duration,
    pings: Interval,
    heard_at: Instant,
    answered: Bytes,
    world: View,
}

impl Connection {
    /// Waits for the client's next message, or for the time of a ping. May be dropped half-way (`select!`): nothing is lost.
    pub async fn event(&mut self) -> Event {
        tokio::select! {
            message = self.socket.recv() => Event::Read(message),
            _ = self.pings.tick() => Event::PingDue,
        }
    }

    /// Handles an event; gives what the client said, if it said something.
    pub async fn take(&mut self, event: Event) -> Result<Option<Incoming>, End> {
        let message = match event {
            Event::PingDue if self.heard_at.elapsed() > SILENCE_MAX => return Err(End::Gone),
            Event::PingDue => {
                self.send(Message::Ping(Bytes::new())).await?;
                return Ok(None);
            }
            Event::Read(None) => return Err(End::Gone),
            Event::Read(Some(message)) => message,
        };
        self.heard_at = Instant::now();
        match message {
            Ok(Message::Text(text)) => Ok(Some(Incoming::Text(text))),
            Ok(Message::Binary(bytes)) => Ok(Some(Incoming::Binary(bytes))),
            Ok(Message::Pong(carried)) => {
                if !carried.is_empty() {
                    self.answered = carried;
                }
                Ok(None)
            }
            // A close is answered by the library; the next read ends the connection.
            Ok(Message::Ping(_) | Message::Close(_)) => Ok(None),
            Err(error) if is_too_long(&error) => Err(End::Rule(close_code::SIZE, "the message is too long")),
            Err(_) => Err(End::Gone),
        }
    }

    /// Sends, and gives a client that does not take it up.
    pub async fn send(&mut self, message: Message) -> Result<(), End> {
        match timeout(self.stall, self.socket.send(message)).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_)) => Err(End::Gone),
            Err(_) => {
                tracing::info!(world = %self.world.id, "a stalled client was dropped");
                Err(End::Gone)
            }
        }
    }

    /// What the last of the route's own pings that was answered carried; empty before the first.
    pub fn answered(&self) -> &[u8] {
        &self.answered
    }

    /// Sends a message as JSON text.
    pub async fn say(&mut self, message: &impl Serialize) -> Result<(), End> {
        match serde_json::to_string(message) {
            Ok(text) => self.send(Message::Text(text.into())).await,
            Err(error) => {
                tracing::error!(%error, "a message could not be written as JSON");
                Err(End::Rule(close_code::ERROR, "internal error"))
            }
        }
    }

    async fn close(mut self, end: End) {
        let (code, reason) = match end {
            End::Gone => return,
            End::Rule(code, reason) => (code, reason),
            End::WorldStopped => (close_code::AWAY, "the world has stopped"),
        };
        let close = Message::Close(Some(CloseFrame {
            code,
            reason: reason.into(),
        }));
        if self.send(close).await.is_ok() && code == close_code::SIZE {
            // What the client still sends is not read; cutting the connection at once would take the close frame with it.
            tokio::time::sleep(CLOSE_GRACE).await;
        }
    }
}

/// Whether reading failed because a message is longer than allowed.
fn is_too_long(error: &axum::Error) -> bool {
    // axum does not say which kind of error the library below it had, except in words.
    std::error::Error::source(error).is_some_and(|source| source.to_string().contains("too long"))
}
