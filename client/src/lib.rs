//! A thin native client of a Welkin server: finds a world, follows its stream, and comes back by itself when the
//! connection is lost. No TLS: put a proxy on the client's side where the server is reached over `https`.
//!
//! ```no_run
//! use futures_util::StreamExt;
//! use welkin_client::{Event, Options, connect};
//!
//! # async fn example() -> Result<(), welkin_client::ClientError> {
//! let mut events = connect("http://127.0.0.1:8080", Options::default())?;
//! while let Some(event) = events.next().await {
//!     match event {
//!         Event::Hello(hello) => println!("watching {} in world {}", hello.scene, hello.world),
//!         Event::Tick(numbers) => println!("tick {}: updraught {:.1} m/s", numbers.tick, numbers.updraught_max_m_s),
//!         Event::Frame(frame) => println!("a picture of {} bytes", frame.image.len()),
//!         Event::Error { error, next } => eprintln!("{error} ({next})"),
//!     }
//! }
//! # Ok(())
//! # }
//! ```

pub mod clock;
mod connection;
mod error;
mod http;
pub mod load;
pub mod record;
pub mod sample;
mod stream;
mod url;
pub mod volume;

pub use error::ClientError;
pub use http::{get_json, list_worlds, post_json};
pub use stream::{Event, Events, Frame, FrameWish, Hello, Next, Options, connect};
pub use url::ServerUrl;
