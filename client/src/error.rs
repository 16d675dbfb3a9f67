//! What can go wrong between a client and a server.

use std::time::Duration;

use welkin_proto::error::ApiError;

/// What went wrong.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The server's address cannot be used.
    #[error("{url:?} is no server address: {why}; an example is http://127.0.0.1:8080")]
    BadUrl {
        /// What was given.
        url: String,
        /// What is wrong with it.
        why: &'static str,
    },
    /// No connection came about.
    #[error("cannot reach {authority}: {source}")]
    Unreachable {
        /// Host and port.
        authority: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// An answer did not come in time.
    #[error("no {what} within {} s", limit.as_secs())]
    TimedOut {
        /// What was waited for.
        what: &'static str,
        /// How long.
        limit: Duration,
    },
    /// What came back is not HTTP, or more of it than is taken.
    #[error("the answer of {path} cannot be read: {why}")]
    BadAnswer {
        /// The request's path.
        path: String,
        /// What is wrong with it.
        why: String,
    },
    /// The server refused a request or something that was sent over the stream.
    #[error("the server refused: {0}")]
    Refused(ApiError),
    /// The server runs no world.
    #[error("the server runs no world")]
    NoWorld,
    /// The server's stream protocol is another one.
    #[error(
        "the server (version {server}) speaks stream protocol {theirs}, this client {ours}: use the client of that version"
    )]
    OtherProtocol {
        /// The server's version.
        server: String,
        /// The server's protocol.
        theirs: u32,
        /// This client's.
        ours: u32,
    },
    /// A message over the stream is not of the protocol.
    #[error("a message cannot be read: {0}")]
    BadMessage(String),
    /// A recording cannot be read or written.
    #[error("the recording: {0}")]
    Recording(String),
    /// The stream ended or broke.
    #[error("the stream ended: {0}")]
    Lost(String),
}

impl ClientError {
    /// Whether trying again cannot help.
    pub fn is_final(&self) -> bool {
        match self {
            Self::BadUrl { .. } | Self::OtherProtocol { .. } | Self::Recording(_) => true,
            Self::Refused(error) => error.code == "unknown_world",
            _ => false,
        }
    }
}
