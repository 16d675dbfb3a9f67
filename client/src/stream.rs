//! A world's stream as a sequence of events that outlives its connections.

use std::convert::Infallible;
use std::fmt;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use futures_util::{SinkExt, Stream, StreamExt};
use tokio::net::TcpStream;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::timeout;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::Message;
use welkin_proto::camera::Camera;
use welkin_proto::wire::{
    ClientMessage, FRAME_HEADER_VERSION, FrameFormat, FrameHeader, FrameQuality, Numbers, PROTOCOL_VERSION,
    ServerMessage,
};

use crate::connection::{End, Follower, SILENCE_LIMIT, follow, handshake, said, silent};
use crate::error::ClientError;
use crate::url::ServerUrl;

/// Events that may wait for the reader; then the connection is not read either, and the server skips to the newest.
const EVENTS_WAITING_MAX: usize = 16;

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
    let task = tokio::spawn(follow(Following {
        server,
        options,
        sender,
    }));
    Ok(Events { receiver, task })
}

/// One world's stream.
struct Following {
    server: ServerUrl,
    options: Options,
    sender: mpsc::Sender<Event>,
}

impl Follower for Following {
    type Event = Event;

    fn sender(&self) -> &mpsc::Sender<Event> {
        &self.sender
    }

    fn pauses(&self) -> [Duration; 2] {
        [self.options.retry_first, self.options.retry_last]
    }

    fn trouble(error: ClientError, next: Next) -> Event {
        Event::Error { error, next }
    }

    async fn connect_once(&mut self, failures: &mut u32) -> Result<Infallible, End> {
        let mut socket = handshake(&self.server, self.options.world.as_deref(), "stream").await?;
        loop {
            let message = tokio::select! {
                message = timeout(SILENCE_LIMIT, socket.next()) => message.map_err(|_| silent())?,
                () = self.sender.closed() => return Err(End::Unheard),
            };
            let event = match understand(said(message)?) {
                Ok(None) => continue,
                Ok(Some(event)) => event,
                Err(error @ (ClientError::Lost(_) | ClientError::OtherProtocol { .. })) => return Err(error.into()),
                Err(error) => Event::Error {
                    error,
                    next: Next::GoesOn,
                },
            };
            if let Event::Hello(_) = event {
                *failures = 0;
                if let Some(wish) = &self.options.frames {
                    ask_for(&mut socket, wish).await?;
                }
            }
            if self.sender.send(event).await.is_err() {
                return Err(End::Unheard);
            }
        }
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
        Message::Ping(_) | Message::Pong(_) | Message::Frame(_) | Message::Close(_) => Ok(None),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hello_of_a_far_future_is_named_as_such() {
        let text = r#"{"type":"hello","protocol":7,"server":"9.9","planet":"Mars"}"#;
        let error = understand(Message::text(text))
            .map(|_| ())
            .expect_err("another protocol must not be taken");
        assert!(matches!(error, ClientError::OtherProtocol { theirs: 7, .. }), "{error}");
        assert!(error.is_final());
    }
}
