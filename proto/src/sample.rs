//! Samples: what the air is like at places, asked once (`/v1/worlds/{id}/sample`) or again and again over a WebSocket
//! (`/v1/worlds/{id}/samples`).
//!
//! Places are local metres (`x_m`, `y_m`, `z_m`: east, north and up from the box's south-west corner on the ground) or latitude, longitude
//! (degrees) and altitude above mean sea level (m), turned into each other by [`crate::geography`]. The box repeats east and north, as it
//! does in pictures, so a place beside it has the weather of the place that it repeats. Below the ground and above the lid there
//! is nothing: such a place is `outside`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::channel::Channel;
use crate::error::ApiError;

mod wire;

pub use wire::{
    POSITIONS_HEADER_BYTES, Places, PositionsMessage, SAMPLES_HEADER_BYTES, SAMPLES_VERSION, SamplesMessage,
};

/// What can be asked of a place: a channel, or what follows from several at that place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Quantity {
    /// A channel, linear between the centres of cells.
    Channel(Channel),
    /// Speed of the horizontal wind.
    WindSpeedMS,
    /// Where the wind blows from, degrees clockwise from north, above 0 to 360 (360 is north); 0 in a calm.
    WindFromDeg,
}

impl Quantity {
    /// All quantities.
    pub fn all() -> impl Iterator<Item = Quantity> {
        let channels = Channel::ALL.iter().map(|&c| Quantity::Channel(c));
        channels.chain([Quantity::WindSpeedMS, Quantity::WindFromDeg])
    }

    /// The name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Self::Channel(channel) => channel.name(),
            Self::WindSpeedMS => "wind_speed_m_s",
            Self::WindFromDeg => "wind_from_deg",
        }
    }

    /// The unit, as [`Channel::unit`] has it.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Channel(channel) => channel.unit(),
            Self::WindSpeedMS => "m/s",
            Self::WindFromDeg => "deg",
        }
    }

    /// One line: what it is.
    pub fn what(self) -> &'static str {
        match self {
            Self::Channel(channel) => channel.what(),
            Self::WindSpeedMS => "speed of the horizontal wind",
            Self::WindFromDeg => "where the wind blows from, clockwise from north; 0 in a calm",
        }
    }

    /// The channels that it is made of, beside those that are there or not.
    pub fn channels(self) -> Vec<Channel> {
        match self {
            Self::Channel(channel) => vec![channel],
            Self::WindSpeedMS | Self::WindFromDeg => vec![Channel::WindXMS, Channel::WindYMS],
        }
    }

    /// The quantity of that name. Errors: those of [`Channel::named`].
    pub fn named(name: &str) -> Result<Self, ApiError> {
        match name {
            "wind_speed_m_s" => Ok(Self::WindSpeedMS),
            "wind_from_deg" => Ok(Self::WindFromDeg),
            _ => Channel::named(name).map(Self::Channel),
        }
    }

    /// Its number in binary messages: a channel's own, 64 for the wind's speed, 65 for where it comes from.
    pub fn number(self) -> u8 {
        match self {
            Self::Channel(channel) => channel.number(),
            Self::WindSpeedMS => 64,
            Self::WindFromDeg => 65,
        }
    }

    /// The quantity of that number.
    pub fn numbered(number: u8) -> Option<Self> {
        Self::all().find(|q| q.number() == number)
    }
}

/// The moment that an answer is of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Moment {
    /// Ticks since the world's start; between two ticks that of the earlier one.
    pub tick: u64,
    /// Simulated seconds since the start.
    pub simulated_s: f64,
    /// Simulated date and time, RFC 3339, to the nearest second.
    pub utc: String,
    /// When the world published this weather, by the server's clock, Unix seconds.
    pub wall_unix_s: f64,
}

/// Many places at once, or a path (`POST /v1/worlds/{id}/sample`). Exactly one of `positions_m` and `positions_lat_lon_alt`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SampleRequest {
    /// Metres east, north and up from the box's south-west corner on the ground.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub positions_m: Option<Vec<[f64; 3]>>,
    /// Latitude and longitude in degrees, altitude above mean sea level in metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub positions_lat_lon_alt: Option<Vec<[f64; 3]>>,
    /// With it the positions are the corners of a path, which is sampled at its start, every so many metres, and at its end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step_m: Option<f64>,
    /// Names of channels, and `wind_speed_m_s`, `wind_from_deg`; absent, all that the scene has.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub channels: Option<Vec<String>>,
    /// The weather of this tick, if it is still kept; absent, the newest. Excludes `simulated_s`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tick: Option<u64>,
    /// The weather of this simulated second, linear in time between the two ticks that are kept around it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub simulated_s: Option<f64>,
}

/// The answer to a [`SampleRequest`], one column a channel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SampleAnswer {
    /// The world's id.
    pub world: String,
    /// When.
    #[serde(flatten)]
    pub moment: Moment,
    /// Of a path, where it was sampled, local metres; absent for positions, which are those that were sent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub positions_m: Option<Vec<[f64; 3]>>,
    /// Of a path, metres along it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distance_m: Option<Vec<f64>>,
    /// Unit of each channel.
    pub units: BTreeMap<String, String>,
    /// A value a position for each channel; null where the position is outside.
    pub values: BTreeMap<String, Vec<Option<f32>>>,
    /// Which positions are below the ground or above the lid, from 0.
    pub outside: Vec<usize>,
    /// Why a channel is missing, where all were asked for.
    pub unavailable: BTreeMap<String, String>,
}

/// The air at one place (`GET /v1/worlds/{id}/sample`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PointSample {
    /// The world's id.
    pub world: String,
    /// When.
    #[serde(flatten)]
    pub moment: Moment,
    /// Where: metres east, north and up from the box's south-west corner on the ground.
    pub position_m: [f64; 3],
    /// Where: latitude (degrees), longitude (degrees), altitude above mean sea level (m).
    pub position_lat_lon_alt: [f64; 3],
    /// A value for each channel.
    pub values: BTreeMap<String, Option<f32>>,
    /// Unit of each channel.
    pub units: BTreeMap<String, String>,
    /// Why a channel is missing, where all were asked for.
    pub unavailable: BTreeMap<String, String>,
}

/// How samples over a WebSocket are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SampleFormat {
    /// Text: [`SampleServerMessage::Samples`].
    #[default]
    Json,
    /// Binary: [`SamplesMessage`].
    Binary,
}

/// What a client may send over `/v1/worlds/{id}/samples`: this as text, or positions as a binary [`PositionsMessage`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum SampleClientMessage {
    /// What to answer, how often and how; sent again it replaces the earlier wish.
    Subscribe {
        /// Names of channels; absent, all that the scene has.
        #[serde(default)]
        channels: Option<Vec<String>>,
        /// Answers a wall second.
        rate_hz: f64,
        /// How answers are written.
        #[serde(default)]
        format: SampleFormat,
    },
    /// Where everybody is now; replaces all positions. Exactly one of the two lists.
    Positions {
        /// The client's own number of this message, which the answers repeat.
        #[serde(default)]
        number: u32,
        /// Local metres.
        #[serde(default)]
        positions_m: Option<Vec<[f64; 3]>>,
        /// Latitude and longitude in degrees, altitude above mean sea level in metres.
        #[serde(default)]
        positions_lat_lon_alt: Option<Vec<[f64; 3]>>,
    },
}

/// What the server sends over `/v1/worlds/{id}/samples` as text.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum SampleServerMessage {
    /// The first message.
    Hello {
        /// [`crate::wire::PROTOCOL_VERSION`].
        protocol: u32,
        /// The server's version.
        server: String,
        /// The world's id.
        world: String,
        /// Names of the channels that the scene has, in the order of binary answers where none are named.
        channels: Vec<String>,
        /// Unit of each.
        units: BTreeMap<String, String>,
        /// Why others are missing.
        unavailable: BTreeMap<String, String>,
    },
    /// The air at the positions that came last.
    Samples {
        /// Counts this connection's answers from 0.
        sequence: u32,
        /// The number of the positions that are answered.
        number: u32,
        /// When.
        #[serde(flatten)]
        moment: Moment,
        /// A value a position for each channel; null where the position is outside.
        values: BTreeMap<String, Vec<Option<f32>>>,
    },
    /// Something that the client sent was refused, or cannot be answered for now; the connection goes on.
    Error {
        /// What and why.
        error: ApiError,
    },
}
