//! Connections to a server that are made again when they are lost: what the streams of numbers and of volumes share.

use std::convert::Infallible;
use std::hash::{BuildHasher, Hasher};
use std::time::Duration;

use tokio::net::TcpStream;
use tokio::sync::mpsc;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::{self, Message};
use tokio_tungstenite::{WebSocketStream, client_async_with_config};

use crate::error::ClientError;
use crate::http;
use crate::stream::Next;
use crate::url::ServerUrl;

const MESSAGE_BYTES_MAX: usize = 64 << 20;
const HANDSHAKE_LIMIT: Duration = Duration::from_secs(10);
/// The server pings every 15 s; a stream that brings nothing at all for so long is dead.
pub(crate) const SILENCE_LIMIT: Duration = Duration::from_secs(45);

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

/// What follows a server through one connection after another.
pub(crate) trait Follower: Send {
    /// What it tells its user.
    type Event: Send;

    /// Where it tells it.
    fn sender(&self) -> &mpsc::Sender<Self::Event>;

    /// The first pause after a loss and the longest.
    fn pauses(&self) -> [Duration; 2];

    /// What a connection's end is told as.
    fn trouble(error: ClientError, next: Next) -> Self::Event;

    /// Follows one connection to its end, and sets `failures` to 0 once it stands.
    fn connect_once(&mut self, failures: &mut u32) -> impl Future<Output = Result<Infallible, End>> + Send;
}

/// Follows until nobody listens or an error is final, with pauses that grow from one failure to the next.
pub(crate) async fn follow<F: Follower>(mut follower: F) {
    let mut failures = 0;
    loop {
        let Err(End::Error(error)) = follower.connect_once(&mut failures).await else {
            return;
        };
        let [first, last] = follower.pauses();
        let pause = pause_after(failures, first, last);
        failures += 1;
        let next = if error.is_final() {
            Next::Ends
        } else {
            Next::RetryIn(pause)
        };
        let told = follower.sender().send(F::trouble(error, next)).await;
        if told.is_err() || next == Next::Ends {
            return;
        }
        tokio::time::sleep(pause).await;
    }
}

/// What a socket brought, if it was no end. Errors: [`ClientError::Lost`].
pub(crate) fn said(message: Option<Result<Message, tungstenite::Error>>) -> Result<Message, ClientError> {
    match message {
        None => Err(ClientError::Lost("closed without a word".to_owned())),
        Some(Err(error)) => Err(ClientError::Lost(error.to_string())),
        Some(Ok(Message::Close(close))) => {
            let reason = close.map(|c| c.reason.to_string()).filter(|r| !r.is_empty());
            Err(ClientError::Lost(
                reason.unwrap_or_else(|| "closed by the server".to_owned()),
            ))
        }
        Some(Ok(message)) => Ok(message),
    }
}

/// The error where [`SILENCE_LIMIT`] has passed.
pub(crate) fn silent() -> ClientError {
    ClientError::TimedOut {
        what: "sign of life",
        limit: SILENCE_LIMIT,
    }
}

/// The pause after that many failures in a row, jittered so that many clients do not come back in the same instant.
fn pause_after(failures: u32, first: Duration, last: Duration) -> Duration {
    let grown = first.saturating_mul(2u32.saturating_pow(failures)).min(last);
    // A fresh hasher is seeded at random.
    let random = std::collections::hash_map::RandomState::new().build_hasher().finish();
    grown.mul_f64(0.75 + 0.5 * (random >> 11) as f64 / (1u64 << 53) as f64)
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
        for (failures, middle_s) in [(0, 1.0), (1, 2.0), (4, 16.0), (5, 20.0), (40, 20.0)] {
            let pause_s = pause_after(failures, Duration::from_secs(1), Duration::from_secs(20)).as_secs_f64();
            assert!(
                (0.75 * middle_s..=1.25 * middle_s).contains(&pause_s),
                "{pause_s} s after {failures} failures"
            );
        }
    }

    #[test]
    fn ids_cannot_leave_their_place_in_the_path() {
        assert_eq!(percent_encoded("a/../b?c d"), "a%2F..%2Fb%3Fc%20d");
    }
}
