//! The one shape every error has on the wire.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What a client gets when something was refused.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, thiserror::Error)]
#[error("{code}: {message}{}", pointer.as_deref().map(|p| format!(" (at {p})")).unwrap_or_default())]
pub struct ApiError {
    /// Stable, machine readable, snake_case: it never changes once released.
    pub code: String,
    /// For a person: what was wrong, the value that was given and the range that is allowed.
    pub message: String,
    /// JSON pointer (RFC 6901) into the document that was sent, where one place is to blame.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub pointer: Option<String>,
}

impl ApiError {
    /// An error that no single place of a document is to blame for.
    pub fn new(code: &str, message: impl Into<String>) -> Self {
        Self {
            code: code.to_owned(),
            message: message.into(),
            pointer: None,
        }
    }

    /// The same error, with the place in the document.
    pub fn at(mut self, pointer: impl Into<String>) -> Self {
        self.pointer = Some(pointer.into());
        self
    }
}
