//! What Welkin sends over the wire and keeps in files.
//!
//! This crate is the only wire boundary: scenes, soundings, commands, numbers, frames and errors are
//! typed here, and nothing here knows of a device, a thread or a socket.
//!
//! Coordinates everywhere: x east, y north, z up, in metres, origin at the domain's south-west corner on the
//! ground. Azimuths are degrees clockwise from north. SI units, named in each field's suffix.

pub mod camera;
pub mod channel;
pub mod error;
pub mod frame;
pub mod geography;
pub mod presets;
pub mod report;
pub mod sample;
pub mod scene;
pub mod sounding;
pub mod time;
pub mod validate;
pub mod view;
pub mod volume;
pub mod wire;

pub use camera::Camera;
pub use channel::Channel;
pub use error::ApiError;
pub use scene::Scene;
