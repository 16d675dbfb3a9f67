//! Welkin's server: scene to plan to world to tick to picture, over HTTP and WebSocket.

pub mod base_state;
pub mod bench;
pub mod change;
pub mod cli;
pub mod endurance;
pub mod host;
pub mod http;
pub mod initial;
pub mod ladder;
pub mod limits;
pub mod live_sky;
pub mod machine;
pub mod methods;
pub mod parameters;
pub mod past_sky;
pub mod picture;
pub mod plan;
pub mod plot;
pub mod sample;
pub mod scenery;
pub mod sun;
pub mod validate;
pub mod volume;
pub mod watchdog;
pub mod weather;
pub mod world;
