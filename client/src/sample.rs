//! Samples: the air at places, once over HTTP or again and again, for places that move, over a WebSocket.
//!
//! ```no_run
//! use welkin_client::sample::{Samples, sample};
//! use welkin_proto::sample::SampleRequest;
//!
//! # async fn example() -> Result<(), welkin_client::ClientError> {
//! let request = SampleRequest { positions_m: Some(vec![[1600.0, 1600.0, 900.0]]), ..Default::default() };
//! let once = sample("http://127.0.0.1:8080", None, &request).await?;
//! println!("{:?}", once.values["temperature_k"]);
//!
//! let mut samples = Samples::connect("http://127.0.0.1:8080", None).await?;
//! samples.subscribe(&["wind_x_m_s", "wind_y_m_s", "wind_z_m_s"], 10.0).await?;
//! for second in 0..60 {
//!     samples.place(second, vec![[80.0 * f64::from(second), 0.0, 500.0]]).await?;
//!     let answer = samples.next().await?; // one column a channel
//!     println!("tick {}: {:?}", answer.tick, answer.columns);
//! }
//! # Ok(())
//! # }
//! ```

use futures_util::{SinkExt, StreamExt};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::Message;
use welkin_proto::sample::{
    Places, PositionsMessage, SampleAnswer, SampleClientMessage, SampleFormat, SampleRequest, SampleServerMessage,
    SamplesMessage,
};

use crate::connection::{SILENCE_LIMIT, handshake, percent_encoded};
use crate::error::ClientError;
use crate::http::{post_json, world_or_first};
use crate::url::ServerUrl;

/// The air at many places, or along a path; `world` absent is the server's first.
///
/// Errors: [`ClientError::BadUrl`], [`ClientError::NoWorld`], those of [`post_json`].
pub async fn sample(url: &str, world: Option<&str>, request: &SampleRequest) -> Result<SampleAnswer, ClientError> {
    let server = ServerUrl::parse(url)?;
    let world = world_or_first(&server, world).await?;
    let path = format!("/v1/worlds/{}/sample", percent_encoded(&world));
    let unreadable = |why: serde_json::Error| ClientError::BadAnswer {
        path: path.clone(),
        why: why.to_string(),
    };
    let request = serde_json::to_string(request).map_err(unreadable)?;
    let body = post_json(&server, &path, &request).await?;
    serde_json::from_slice(&body).map_err(unreadable)
}

/// A connection that answers for places that move. It does not come back by itself: after an error connect again and say again what is wanted.
#[derive(Debug)]
pub struct Samples {
    socket: WebSocketStream<TcpStream>,
    /// What the server said of the world's channels: [`SampleServerMessage::Hello`].
    pub hello: SampleServerMessage,
}

impl Samples {
    /// Connects; `world` absent is the server's first.
    ///
    /// Errors: [`ClientError::BadUrl`], [`ClientError::Unreachable`], [`ClientError::TimedOut`], [`ClientError::Refused`],
    /// [`ClientError::NoWorld`], [`ClientError::BadMessage`].
    pub async fn connect(url: &str, world: Option<&str>) -> Result<Self, ClientError> {
        let server = ServerUrl::parse(url)?;
        let mut socket = handshake(&server, world, "samples").await?;
        match understand(next_message(&mut socket).await?)? {
            Some(Heard::Said(hello @ SampleServerMessage::Hello { .. })) => Ok(Self { socket, hello }),
            Some(Heard::Said(SampleServerMessage::Error { error })) => Err(ClientError::Refused(error)),
            _ => Err(ClientError::BadMessage("the server does not say hello".to_owned())),
        }
    }

    /// Says which channels (empty: all) are wanted, and how many answers a second. Errors: [`ClientError::Lost`].
    pub async fn subscribe(&mut self, channels: &[&str], rate_hz: f64) -> Result<(), ClientError> {
        let names = channels.iter().map(|&name| name.to_owned()).collect::<Vec<_>>();
        let message = SampleClientMessage::Subscribe {
            channels: (!names.is_empty()).then_some(names),
            rate_hz,
            format: SampleFormat::Binary,
        };
        let text = serde_json::to_string(&message).map_err(|e| ClientError::BadMessage(e.to_string()))?;
        self.send(Message::Text(text.into())).await
    }

    /// Says where everybody is, local metres; answers repeat `number`. Errors: [`ClientError::Lost`].
    pub async fn place(&mut self, number: u32, positions: Vec<[f64; 3]>) -> Result<(), ClientError> {
        let message = PositionsMessage {
            places: Places::Local,
            number,
            positions,
        };
        self.send(Message::Binary(message.encode().into())).await
    }

    /// Waits for the next answer. May be dropped half-way (`select!`).
    ///
    /// Errors: [`ClientError::Refused`] for what the server did not take, after which the connection goes on; [`ClientError::BadMessage`],
    /// [`ClientError::TimedOut`], [`ClientError::Lost`].
    pub async fn next(&mut self) -> Result<SamplesMessage, ClientError> {
        loop {
            match understand(next_message(&mut self.socket).await?)? {
                Some(Heard::Samples(samples)) => return Ok(samples),
                Some(Heard::Said(SampleServerMessage::Error { error })) => return Err(ClientError::Refused(error)),
                _ => {}
            }
        }
    }

    async fn send(&mut self, message: Message) -> Result<(), ClientError> {
        let sent = self.socket.send(message).await;
        sent.map_err(|e| ClientError::Lost(e.to_string()))
    }
}

enum Heard {
    Said(SampleServerMessage),
    Samples(SamplesMessage),
}

async fn next_message(socket: &mut WebSocketStream<TcpStream>) -> Result<Message, ClientError> {
    let message = timeout(SILENCE_LIMIT, socket.next()).await;
    let message = message.map_err(|_| ClientError::TimedOut {
        what: "sign of life",
        limit: SILENCE_LIMIT,
    })?;
    match message {
        Some(Ok(message)) => Ok(message),
        Some(Err(error)) => Err(ClientError::Lost(error.to_string())),
        None => Err(ClientError::Lost("closed without a word".to_owned())),
    }
}

fn understand(message: Message) -> Result<Option<Heard>, ClientError> {
    match message {
        Message::Text(text) => {
            let said = serde_json::from_str(&text).map_err(|e| ClientError::BadMessage(e.to_string()))?;
            Ok(Some(Heard::Said(said)))
        }
        Message::Binary(bytes) => {
            let samples = SamplesMessage::decode(&bytes).map_err(|e| ClientError::BadMessage(e.to_string()))?;
            Ok(Some(Heard::Samples(samples)))
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
