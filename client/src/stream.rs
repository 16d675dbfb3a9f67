//! A world's stream as a sequence of events that outlives its connections.

use std::fmt;
use std::hash::{BuildHasher, Hasher};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use futures_util::{SinkExt, Stream, StreamExt};
use tokio::net::TcpStream;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::{self, Message};
use tokio_tungstenite::{WebSocketStream, client_async_with_config};
use welkin_proto::camera::Camera;
use welkin_proto::wire::{
    ClientMessage, FRAME_HEADER_VERSION, FrameFormat, FrameHeader, FrameQuality, Numbers, PROTOCOL_VERSION,
    ServerMessage,
};

use crate::error::ClientError;
use crate::http;
use crate::url::ServerUrl;

/// Events that may wait for the reader; then the connection is not read either, and the server skips to the newest.
const EVENTS_WAITING_MAX: usize = 16;
const MESSAGE_BYTES_MAX: usize = 64 << 20;
const HANDSHAKE_LIMIT: Duration = Duration::from_secs(10);
/// The server pings every 15 s; a stream that brings nothing at all for so long is dead.
pub(crate) const SILENCE_LIMIT: Duration = Duration::from_secs(45);

/// What is wanted of a server.
#[derive(Clone, Debug)]
pub struct Options {
    /// The world's id; `None` takes the server's first.
    pub world: Option<String>,
    /// Pictures that are wanted; `None` for numbers only.
    pub frames: Option<FrameWish>,
    /// Pause before the first new attempt; it doubles with every failure and is jittered by a quarter.
    pub retry_first: Duration,
    /// The longest pause.
    pub retry_last: Duration,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            world: None,
            frames: None,
            retry_first: Duration::from_secs(1),
            retry_last: Duration::from_secs(20),
        }
    }
}

/// Which pictures are wanted.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameWish {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Coding.
    pub format: FrameFormat,
    /// At most so many a wall second.
    pub max_fps: f64,
    /// Point of view; `None` takes the scene's.
    pub camera: Option<Camera>,
}

/// What the server says of itself and the world when a stream begins; see [`ServerMessage::Hello`].
#[derive(Clone, Debug, PartialEq)]
pub struct Hello {
    /// The server's version.
    pub server: String,
    /// The world's id.
    pub world: String,
    /// The scene's name.
    pub scene: String,
    /// Cells east, north, up.
    pub cells: [u32; 3],
    /// Cell sizes, m.
    pub cell_size_m: [f64; 3],
    /// The scene's camera.
    pub camera: Camera,
}

/// A picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// What it shows and what it cost.
    pub header: FrameHeader,
    /// The coded image, as the header says.
    pub image: Vec<u8>,
}

/// What happens on a stream.
#[derive(Debug)]
pub enum Event {
    /// A connection stands; comes again after every reconnection.
    Hello(Hello),
    /// The world's numbers after a tick, the newest only.
    Tick(Numbers),
    /// A picture.
    Frame(Frame),
    /// Something went wrong.
    Error {
        /// What.
        error: ClientError,
        /// How the stream goes on.
        next: Next,
    },
}

/// How a stream goes on after an error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Next {
    /// The connection stands.
    GoesOn,
    /// A new connection is tried after this pause.
    RetryIn(Duration),
    /// Trying again cannot help: this was the last event.
    Ends,
}

impl fmt::Display for Next {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::GoesOn => f.write_str("the stream goes on"),
            Self::RetryIn(pause) => write!(f, "trying again in {:.1} s", pause.as_secs_f64()),
            Self::Ends => f.write_str("giving up"),
        }
    }
}

/// The events of [`connect`]; dropping it closes the connection.
#[derive(Debug)]
pub struct Events {
    receiver: mpsc::Receiver<Event>,
    task: JoinHandle<()>,
}

impl Stream for Events {
    type Item = Event;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Event>> {
        self.receiver.poll_recv(context)
    }
}

impl Drop for Events {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Follows a world of the server at `url` (see [`ServerUrl::parse`]) until the result is dropped or an error is final.
/// Must be called within a tokio runtime.
///
/// Errors: [`ClientError::BadUrl`]; everything later comes as [`Event::Error`].
pub fn connect(url: &str, options: Options) -> Result<Events, ClientError> {
    let server = ServerUrl::parse(url)?;
    let (sender, receiver) = mpsc::channel(EVENTS_WAITING_MAX);
    let task = tokio::spawn(follow(server, options, sender));
    Ok(Events { receiver, task })
}

/// Why a connection ended.
pub(crate) enum End {
    Error(ClientError),
    /// Nobody listens any more.
    Unheard,
}

impl From<ClientError> for End {
    fn from(error: ClientError) -> Self {
        Self::Error(error)
    }
}

async fn follow(server: ServerUrl, options: Options, sender: mpsc::Sender<Event>) {
    let mut failures = 0;
    loop {
        let End::Error(error) = one_connection(&server, &options, &sender, &mut failures).await else {
            return;
        };
        if error.is_final() {
            // Where nobody listens any more there is nobody to tell.
            let _ = sender
                .send(Event::Error {
                    error,
                    next: Next::Ends,
                })
                .await;
            return;
        }
        let pause = pause_after(failures, options.retry_first, options.retry_last);
        failures += 1;
        if sender
            .send(Event::Error {
                error,
                next: Next::RetryIn(pause),
            })
            .await
            .is_err()
        {
            return;
        }
        tokio::time::sleep(pause).await;
    }
}

/// The pause after that many failures in a row, jittered so that many clients do not come back in the same instant.
pub(crate) fn pause_after(failures: u32, first: Duration, last: Duration) -> Duration {
    let grown = first.saturating_mul(2u32.saturating_pow(failures)).min(last);
    // A fresh hasher is seeded at random.
    let random = std::collections::hash_map::RandomState::new().build_hasher().finish();
    grown.mul_f64(0.75 + 0.5 * (random >> 11) as f64 / (1u64 << 53) as f64)
}

async fn one_connection(
    server: &ServerUrl,
    options: &Options,
    sender: &mpsc::Sender<Event>,
    failures: &mut u32,
) -> End {
    let mut socket = match handshake(server, options.world.as_deref(), "stream").await {
        Ok(socket) => socket,
        Err(error) => return End::Error(error),
    };
    loop {
        let message = tokio::select! {
            message = timeout(SILENCE_LIMIT, socket.next()) => message,
            () = sender.closed() => return End::Unheard,
        };
        let heard = match message {
            Err(_) => {
                return End::Error(ClientError::TimedOut {
                    what: "sign of life",
                    limit: SILENCE_LIMIT,
                });
            }
            Ok(None) => return End::Error(ClientError::Lost("closed without a word".to_owned())),
            Ok(Some(Err(error))) => return End::Error(ClientError::Lost(error.to_string())),
            Ok(Some(Ok(message))) => message,
        };
        let event = match understand(heard) {
            Ok(None) => continue,
            Ok(Some(event)) => event,
            Err(error @ (ClientError::Lost(_) | ClientError::OtherProtocol { .. })) => return End::Error(error),
            Err(error) => Event::Error {
                error,
                next: Next::GoesOn,
            },
        };
        if let Event::Hello(_) = event {
            *failures = 0;
            if let Some(wish) = &options.frames
                && let Err(error) = ask_for(&mut socket, wish).await
            {
                return End::Error(error);
            }
        }
        if sender.send(event).await.is_err() {
            return End::Unheard;
        }
    }
}

/// Opens the WebSocket `route` of a world; `None` is the server's first.
pub(crate) async fn handshake(
    server: &ServerUrl,
    world: Option<&str>,
    route: &str,
) -> Result<WebSocketStream<TcpStream>, ClientError> {
    let world = http::world_or_first(server, world).await?;
    let tcp = http::open(server).await?;
    let url = format!(
        "ws://{}/v1/worlds/{}/{route}",
        server.authority(),
        percent_encoded(&world)
    );
    let config = WebSocketConfig::default()
        .max_message_size(Some(MESSAGE_BYTES_MAX))
        .max_frame_size(Some(MESSAGE_BYTES_MAX));
    let upgraded = timeout(HANDSHAKE_LIMIT, client_async_with_config(url, tcp, Some(config))).await;
    match upgraded.map_err(|_| ClientError::TimedOut {
        what: "answer",
        limit: HANDSHAKE_LIMIT,
    })? {
        Ok((socket, _)) => Ok(socket),
        Err(tungstenite::Error::Http(response)) => {
            let body = response.body().as_deref().unwrap_or_default();
            let status = response.status().as_u16();
            let mut error = http::refusal(status, body);
            // The handshake may bring the head alone; the status says enough then.
            if status == 404 && error.code == "http_status" {
                error.code = "unknown_world".to_owned();
                error.message = format!("there is no world {world:?}");
            }
            Err(ClientError::Refused(error))
        }
        Err(error) => Err(ClientError::Lost(error.to_string())),
    }
}

async fn ask_for(socket: &mut WebSocketStream<TcpStream>, wish: &FrameWish) -> Result<(), ClientError> {
    let FrameWish {
        width,
        height,
        format,
        max_fps,
        ref camera,
    } = *wish;
    let message = ClientMessage::Frames {
        width,
        height,
        format,
        max_fps,
        camera: camera.clone(),
        quality: FrameQuality::Live,
        header: FRAME_HEADER_VERSION,
    };
    let text = serde_json::to_string(&message).map_err(|e| ClientError::BadMessage(e.to_string()))?;
    socket
        .send(Message::text(text))
        .await
        .map_err(|e| ClientError::Lost(e.to_string()))
}

/// The event that a message is; `None` for those that concern the connection only.
fn understand(message: Message) -> Result<Option<Event>, ClientError> {
    match message {
        Message::Text(text) => {
            let message = serde_json::from_str(&text).map_err(|e| ClientError::BadMessage(e.to_string()));
            // Of a hello of another protocol no more than the version may be readable.
            let message = message.map_err(|error| other_protocol(&text).unwrap_or(error))?;
            match message {
                ServerMessage::Hello { protocol, server, .. } if protocol != PROTOCOL_VERSION => {
                    Err(ClientError::OtherProtocol {
                        server,
                        theirs: protocol,
                        ours: PROTOCOL_VERSION,
                    })
                }
                ServerMessage::Hello {
                    protocol: _,
                    server,
                    world,
                    scene,
                    cells,
                    cell_size_m,
                    camera,
                } => Ok(Some(Event::Hello(Hello {
                    server,
                    world,
                    scene,
                    cells,
                    cell_size_m,
                    camera,
                }))),
                ServerMessage::Tick { numbers } => Ok(Some(Event::Tick(numbers))),
                ServerMessage::Error { error } => Err(ClientError::Refused(error)),
            }
        }
        Message::Binary(bytes) => {
            let (header, image) = FrameHeader::decode(&bytes).map_err(|e| ClientError::BadMessage(e.message))?;
            Ok(Some(Event::Frame(Frame {
                header,
                image: image.to_vec(),
            })))
        }
        Message::Close(close) => {
            let reason = close.map(|c| c.reason.to_string()).filter(|r| !r.is_empty());
            Err(ClientError::Lost(
                reason.unwrap_or_else(|| "closed by the server".to_owned()),
            ))
        }
        Message::Ping(_) | Message::Pong(_) | Message::Frame(_) => Ok(None),
    }
}

fn other_protocol(text: &str) -> Option<ClientError> {
    let value: serde_json::Value = serde_json::from_str(text).ok()?;
    let theirs = u32::try_from(value.get("protocol")?.as_u64()?).ok()?;
    let server = value
        .get("server")
        .and_then(|v| v.as_str())
        .unwrap_or("unknown")
        .to_owned();
    let hello = value.get("type")?.as_str()? == "hello";
    (hello && theirs != PROTOCOL_VERSION).then_some(ClientError::OtherProtocol {
        server,
        theirs,
        ours: PROTOCOL_VERSION,
    })
}

/// A path segment with everything but unreserved characters encoded.
pub(crate) fn percent_encoded(segment: &str) -> String {
    segment.bytes().fold(String::new(), |mut text, byte| {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'_' | b'.' | b'~' => text.push(char::from(byte)),
            _ => text.push_str(&format!("%{byte:02X}")),
        }
        text
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_to_a_ceiling() {
        let options = Options::default();
        for (failures, middle_s) in [(0, 1.0), (1, 2.0), (4, 16.0), (5, 20.0), (40, 20.0)] {
            let pause_s = pause_after(failures, options.retry_first, options.retry_last).as_secs_f64();
            assert!(
                (0.75 * middle_s..=1.25 * middle_s).contains(&pause_s),
                "{pause_s} s after {failures} failures"
            );
        }
    }

    #[test]
    fn a_hello_of_a_far_future_is_named_as_such() {
        let text = r#"{"type":"hello","protocol":7,"server":"9.9","planet":"Mars"}"#;
        let error = understand(Message::text(text))
            .map(|_| ())
            .expect_err("another protocol must not be taken");
        assert!(matches!(error, ClientError::OtherProtocol { theirs: 7, .. }), "{error}");
        assert!(error.is_final());
    }

    #[test]
    fn ids_cannot_leave_their_place_in_the_path() {
        assert_eq!(percent_encoded("a/../b?c d"), "a%2F..%2Fb%3Fc%20d");
    }
}
