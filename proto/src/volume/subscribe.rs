//! What is said as text over `/v1/worlds/{id}/volume`; binary messages are volumes behind a [`Header`](super::Header).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Bits, Compression, Curve, Layout, MIP_MAX, Region};
use crate::channel::Channel;
use crate::error::ApiError;

/// Edge of a brick, cells of the message.
const BRICK: [u8; 3] = [8; 3];
/// Most channels of a subscription.
const CHANNELS_MAX: usize = 16;

/// A box of the world's cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RegionCells {
    /// First cell east, north, up.
    pub from: [u32; 3],
    /// Cells east, north, up.
    pub cells: [u32; 3],
}

/// A box in metres from the world's south-west corner on the ground.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RegionM {
    /// Its south-west lower corner.
    pub from: [f64; 3],
    /// Its north-east upper corner.
    pub to: [f64; 3],
}

/// Which volumes are wanted, and how.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Subscription {
    /// Channels by name.
    #[schemars(with = "Vec<Channel>")]
    pub channels: Vec<String>,
    /// Which cells; widened to whole cells of the mip. Absent, with `region_m` absent too, the whole world.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub region_cells: Option<RegionCells>,
    /// The same in metres: every cell that the box touches.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub region_m: Option<RegionM>,
    /// A cell of the volume is the mean of 2^mip of the world's cells along each edge; 0 to 6.
    #[serde(default)]
    pub mip: u8,
    /// At most so many volumes a wall second.
    #[serde(default = "default_rate_hz")]
    pub rate_hz: f64,
    /// At most so many bytes a wall second over some seconds; where volumes are larger fewer come. Absent, the server's limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bytes_per_s: Option<f64>,
    /// Bits a value: 8 or 16.
    #[serde(default)]
    pub bits: Bits,
    /// How bodies are packed.
    #[serde(default)]
    pub compression: Compression,
}

fn default_rate_hz() -> f64 {
    2.0
}

impl Default for Subscription {
    fn default() -> Self {
        Self {
            channels: vec![Channel::ExtinctionPerM.name().to_owned()],
            region_cells: None,
            region_m: None,
            mip: 0,
            rate_hz: default_rate_hz(),
            bytes_per_s: None,
            bits: Bits::default(),
            compression: Compression::default(),
        }
    }
}

impl Channel {
    /// How its codes follow values: what is never negative and mostly zero, or spans decades, by the square root.
    pub fn curve(self) -> Curve {
        match self {
            Self::ExtinctionPerM
            | Self::EffectiveRadiusM
            | Self::LiquidWaterKgKg
            | Self::EddyDissipationRateM23S
            | Self::VisibilityM => Curve::Square,
            Self::WindXMS
            | Self::WindYMS
            | Self::WindZMS
            | Self::TemperatureK
            | Self::PressurePa
            | Self::RelativeHumidity
            | Self::VapourKgKg
            | Self::TotalWaterKgKg => Curve::Linear,
        }
    }
}

impl Subscription {
    /// The channels, in the order in which they were named.
    ///
    /// Errors: `unknown_channel`, `channel_unavailable`, `duplicate_channel`; `out_of_range` for none or too many.
    pub fn named_channels(&self) -> Result<Vec<Channel>, ApiError> {
        let count = self.channels.len();
        if !(1..=CHANNELS_MAX).contains(&count) {
            let message = format!("{count} channels; allowed are 1 to {CHANNELS_MAX}");
            return Err(ApiError::new("out_of_range", message).at("/channels"));
        }
        let mut channels = Vec::with_capacity(count);
        for (n, name) in self.channels.iter().enumerate() {
            let channel = Channel::named(name).map_err(|error| error.at(format!("/channels/{n}")))?;
            if channels.contains(&channel) {
                let message = format!("{name} stands there twice");
                return Err(ApiError::new("duplicate_channel", message).at(format!("/channels/{n}")));
            }
            channels.push(channel);
        }
        Ok(channels)
    }

    /// The cells of a world that are wanted, widened to whole cells of the mip.
    ///
    /// Errors: `out_of_range`; `bad_region` for a region that is given twice, is empty, or does not lie within the world.
    pub fn layout(&self, world_cells: [u32; 3], cell_size_m: [f64; 3]) -> Result<Layout, ApiError> {
        let mip = self.mip;
        if mip > MIP_MAX {
            let message = format!("{mip} is out of range; allowed is 0 to {MIP_MAX}");
            return Err(ApiError::new("out_of_range", message).at("/mip"));
        }
        let bad = |why: String, pointer: &str| Err(ApiError::new("bad_region", why).at(pointer));
        let region = match (&self.region_cells, &self.region_m) {
            (None, None) => Region::whole(world_cells),
            (Some(_), Some(_)) => return bad("give one of region_cells and region_m".to_owned(), "/region_m"),
            (Some(RegionCells { from, cells }), None) => {
                for axis in 0..3 {
                    let end = u64::from(from[axis]) + u64::from(cells[axis]);
                    let world = world_cells[axis];
                    if cells[axis] == 0 || end > world.into() {
                        let why = format!("{} cells from {} do not lie within {world}", cells[axis], from[axis]);
                        return bad(why, &format!("/region_cells/cells/{axis}"));
                    }
                }
                Region {
                    from: *from,
                    cells: *cells,
                }
            }
            (None, Some(RegionM { from, to })) => {
                let mut region = Region::whole(world_cells);
                for axis in 0..3 {
                    let size_m = f64::from(world_cells[axis]) * cell_size_m[axis];
                    // Written so that what is no number is refused too.
                    if !(from[axis] >= 0.0 && to[axis] > from[axis] && to[axis] <= size_m) {
                        let why = format!("{} to {} m does not lie within 0 to {size_m} m", from[axis], to[axis]);
                        return bad(why, &format!("/region_m/to/{axis}"));
                    }
                    let last = world_cells[axis] - 1;
                    let first = ((from[axis] / cell_size_m[axis]).floor() as u32).min(last);
                    let end = ((to[axis] / cell_size_m[axis]).ceil() as u32).clamp(first + 1, last + 1);
                    region.from[axis] = first;
                    region.cells[axis] = end - first;
                }
                region
            }
        };
        let layout = Layout {
            world_cells,
            cell_size_m,
            region: region.widened(mip, world_cells),
            mip,
            brick: BRICK,
        };
        layout
            .check()
            .map_err(|error| ApiError::new("bad_region", error.to_string()))?;
        Ok(layout)
    }
}

/// What a client may send, as text.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum VolumeClientMessage {
    /// Ask for volumes; sent again it replaces the earlier subscription, and the first volume of the new one is a keyframe.
    Subscribe(Subscription),
    /// No more volumes.
    Unsubscribe {},
    /// A keyframe was lost: send it again.
    Resync {},
    /// What time is it?
    Ping {
        /// The client's clock, in whatever it counts; it comes back as it is.
        client_s: f64,
    },
}

/// What the server sends, as text.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum VolumeServerMessage {
    /// The first message.
    Hello {
        /// [`VOLUME_VERSION`](super::VOLUME_VERSION).
        protocol: u16,
        /// The server's version.
        server: String,
        /// The world's id.
        world: String,
        /// The scene's name.
        scene: String,
        /// Cells east, north, up.
        cells: [u32; 3],
        /// Cell sizes, m.
        cell_size_m: [f64; 3],
        /// Length of a tick, simulated s.
        tick_s: f64,
        /// Channels that this world has.
        channels: Vec<Channel>,
    },
    /// What a subscription came to; volumes of this view follow.
    Subscribed {
        /// The view's number, which stands in each of its messages.
        view: u32,
        /// The cells that come, widened to whole cells of the mip.
        region_cells: RegionCells,
        /// Cells of a volume east, north, up.
        cells: [u32; 3],
        /// At most so many volumes a wall second.
        rate_hz: f64,
        /// At most so many bytes a wall second.
        bytes_per_s: f64,
    },
    /// The answer to a ping.
    Pong {
        /// As it was sent.
        client_s: f64,
        /// The server's clock, seconds since 1970-01-01T00:00:00Z.
        server_unix_s: f64,
        /// The newest published tick.
        tick: u64,
        /// Its simulated second.
        simulated_s: f64,
        /// When it was published, by the server's clock.
        published_unix_s: f64,
        /// Simulated seconds a wall second, measured; 0 while the clock stands.
        speed: f64,
    },
    /// Something was refused; the connection goes on. A subscription that is refused leaves the earlier one as it is.
    Error {
        /// What and why.
        error: ApiError,
    },
}
