//! What a server tells of the past that it keeps.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The sky of the last minutes, as far as the server has kept it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PastReport {
    /// Wall seconds that are kept at most.
    pub kept_s: f64,
    /// Wall seconds from one moment to the next, at least.
    pub every_s: f64,
    /// The moments, oldest first.
    pub moments: Vec<PastMoment>,
}

/// A moment of which `GET /v1/worlds/{id}/past.bin` has the volume.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PastMoment {
    /// Its tick, which names it.
    pub tick: u64,
    /// Simulated seconds since the world's start.
    pub simulated_s: f64,
    /// When the world published it, Unix seconds by the server's clock.
    pub published_unix_s: f64,
    /// Bytes of its volume.
    pub bytes: u64,
}
