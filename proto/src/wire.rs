//! What goes over HTTP and WebSocket while a world runs.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::camera::Camera;
pub use crate::frame::*;
use crate::scene::{Effects, Sun};

/// Version of the stream protocol; the server says it in [`ServerMessage::Hello`].
pub const PROTOCOL_VERSION: u32 = 1;

/// A world's numbers after a tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Numbers {
    /// Ticks since the start.
    pub tick: u64,
    /// Simulated seconds since the start.
    pub simulated_s: f64,
    /// Simulated date and time, RFC 3339.
    pub utc: String,
    /// Wall milliseconds that the last tick took to compute.
    pub tick_ms: f64,
    /// Wall milliseconds that the last frame took to render, of any viewer; absent before the first.
    pub frame_ms: Option<f64>,
    /// Substeps in the last tick.
    pub substeps: u32,
    /// Length of a substep, s.
    pub substep_s: f64,
    /// Simulated seconds a wall second, measured over the last seconds.
    pub speed: f64,
    /// Simulated seconds a wall second that were asked for.
    pub time_scale: f64,
    /// Whether the clock stands.
    pub paused: bool,
    /// Whether the spin-up is still running.
    pub spinning_up: bool,
    /// Share of columns that hold cloud, 0 to 1; absent where the scene has no moisture.
    pub cloud_cover: Option<f64>,
    /// Height of the lowest cloudy cell's bottom, m; absent without cloud.
    pub cloud_base_m: Option<f64>,
    /// Height of the highest cloudy cell's top, m; absent without cloud.
    pub cloud_top_m: Option<f64>,
    /// Horizontal mean of the cloud water path, kg/m2.
    pub liquid_water_path_kg_m2: Option<f64>,
    /// Horizontal mean of all water in the column, kg/m2.
    pub total_water_path_kg_m2: Option<f64>,
    /// Largest updraught, m/s.
    pub updraught_max_m_s: f64,
    /// Largest horizontal wind component, m/s.
    pub wind_max_m_s: f64,
    /// Courant number of the last substep, summed over the directions.
    pub courant: f64,
    /// Largest divergence of the mass flux over the density, 1/s, after the projection.
    pub divergence_max_per_s: f64,
    /// Sun's height above the horizon, degrees.
    pub sun_elevation_deg: f64,
    /// Sun's azimuth, degrees clockwise from north.
    pub sun_azimuth_deg: f64,
    /// Moon's height above the horizon, degrees; absent where the scene has no moon.
    #[serde(default)]
    pub moon_elevation_deg: Option<f64>,
    /// Moon's azimuth, degrees clockwise from north; absent where the scene has no moon.
    #[serde(default)]
    pub moon_azimuth_deg: Option<f64>,
    /// Moon's distance, m; absent where the scene has no moon.
    #[serde(default)]
    pub moon_distance_m: Option<f64>,
    /// Local sidereal time as an angle, degrees: the right ascension that culminates; absent where the scene has no stars.
    #[serde(default)]
    pub sidereal_deg: Option<f64>,
    /// What the watchdog says of the world.
    #[serde(default)]
    pub health: HealthState,
    /// Stable code of the last trouble: `not_finite`, `courant_exceeded`, `divergence_exceeded`, `water_budget_broken`,
    /// `negative_water`, `device_lost`; absent where there was none.
    #[serde(default)]
    pub trouble_code: Option<String>,
    /// The last trouble and what was done about it, for people.
    #[serde(default)]
    pub trouble_message: Option<String>,
    /// Tick that the last trouble was in.
    #[serde(default)]
    pub trouble_tick: Option<u64>,
    /// Tries of a tick that were thrown away and made again with shorter substeps, since the start.
    #[serde(default)]
    pub retries: u64,
    /// Times that the world went back to an earlier good state, since the start.
    #[serde(default)]
    pub restores: u64,
}

/// What a world's watchdog says of it. Whatever it says, what the world shows has passed every check.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum HealthState {
    /// Nothing was lost lately; ticks that were tried again count as nothing lost.
    #[default]
    Good,
    /// It went back to an earlier state, so some minutes of its weather are lost; it goes on.
    Degraded,
    /// It failed again after going back: its clock stands, and it shows its last good state. `resume` lets it try again.
    Halted,
}

impl HealthState {
    /// The name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Degraded => "degraded",
            Self::Halted => "halted",
        }
    }
}

/// What an operator can tell a world to do (`POST /v1/worlds/{id}/commands`, or over the stream).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "command", rename_all = "snake_case", deny_unknown_fields)]
pub enum Command {
    /// Stop the clock.
    Pause {},
    /// Let the clock go on.
    Resume {},
    /// Simulated seconds a wall second.
    TimeScale {
        /// 0.01 to 1000.
        time_scale: f64,
    },
    /// Place the sun by hand, or give it back to the clock.
    Sun {
        /// The new source.
        sun: Sun,
    },
    /// Add a uniform wind to the whole box at once: a gust front arrives, a mean flow turns.
    Wind {
        /// Added towards the east, m/s.
        add_x_m_s: f64,
        /// Added towards the north, m/s.
        add_y_m_s: f64,
    },
    /// Simulate and draw other effects from now on. The world runs on while they are made ready; what both have in common goes on as it is, a field that is
    /// new starts from the base state.
    Effects {
        /// All effects, as in a scene: a block that is missing is switched off.
        effects: Box<Effects>,
    },
}

/// What a client may send over `/v1/worlds/{id}/stream`, as text.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum ClientMessage {
    /// Ask for frames; sent again it replaces the earlier wish (a camera that moves).
    Frames {
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
        /// Coding.
        #[serde(default)]
        format: FrameFormat,
        /// At most this many frames a wall second.
        max_fps: f64,
        /// Point of view; absent, the scene's.
        #[serde(default)]
        camera: Option<Camera>,
        /// How much a picture may cost.
        #[serde(default)]
        quality: FrameQuality,
        /// Version of the [`FrameHeader`] that the client reads: 1, or 2 with times and quality; absent, 1.
        #[serde(default = "FrameHeader::first_version")]
        header: u16,
    },
    /// No more frames.
    NoFrames {},
    /// A command to the world.
    Command {
        /// What to do.
        command: Command,
    },
}

/// What the server sends over the stream, as text. Frames are binary, see [`FrameHeader`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case")]
#[allow(clippy::large_enum_variant)] // one a tick and viewer: a box would only hide the fields
pub enum ServerMessage {
    /// The first message.
    Hello {
        /// [`PROTOCOL_VERSION`].
        protocol: u32,
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
        /// The scene's camera.
        camera: Camera,
    },
    /// After a tick (the newest; a slow client misses some).
    Tick {
        /// The numbers.
        numbers: Numbers,
    },
    /// Something that the client sent was refused; the stream goes on.
    Error {
        /// What and why.
        error: crate::error::ApiError,
    },
}

/// One world in a list.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WorldSummary {
    /// Names it in URLs.
    pub id: String,
    /// The scene's name.
    pub scene: String,
    /// Cells east, north, up.
    pub cells: [u32; 3],
    /// `cpu`, or the adapter's name.
    pub device: String,
    /// Its numbers.
    pub numbers: Numbers,
}

/// How to make a world (`POST /v1/worlds`): exactly one of the two.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CreateWorld {
    /// A preset's name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub preset: Option<String>,
    /// A whole scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene: Option<crate::scene::Scene>,
}

/// A picture of a scene of its own (`POST /v1/render`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RenderRequest {
    /// A preset's name; exactly one of `preset` and `scene`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub preset: Option<String>,
    /// A whole scene; exactly one of `preset` and `scene`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene: Option<crate::scene::Scene>,
    /// Simulated seconds to run before the picture is taken.
    #[serde(default)]
    pub simulated_s: f64,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Coding.
    #[serde(default)]
    pub format: FrameFormat,
    /// Point of view; absent, the scene's.
    #[serde(default)]
    pub camera: Option<Camera>,
    /// Whether four rays a pixel are averaged, in four times the time.
    #[serde(default)]
    pub still: bool,
}

/// The plan of a world: what runs, why, and what it costs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PlanReport {
    /// The device that runs it.
    pub device: String,
    /// The method chosen on each ladder, and why.
    pub ladders: Vec<LadderReport>,
    /// Largest Courant number of a substep; absent where nothing flows.
    pub courant_max: Option<f64>,
    /// In the order in which they run.
    pub passes: Vec<PassReport>,
    /// What is allocated.
    pub fields: Vec<FieldReport>,
    /// Sum of the fields' bytes.
    pub bytes: u64,
}

/// A ladder and the method chosen on it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LadderReport {
    /// The ladder's name: `advection`, `pressure`, `subgrid`, `microphysics`.
    pub ladder: String,
    /// The chosen rung.
    pub rung: String,
    /// Who chose it.
    pub why: String,
    /// What it does.
    pub what: String,
    /// What it keeps, and what not.
    pub keeps: String,
    /// All rungs of the ladder that this build has, cheapest first.
    pub rungs: Vec<String>,
}

/// A pass of the plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PassReport {
    /// The stage's name in the catalogue.
    pub stage: String,
    /// When in a tick it runs: `start`, `step`, `stage` (three times a substep, or once: as the advection's method asks), `end`, `publish`, `view`.
    pub phase: String,
    /// Which effect or output asks for it.
    pub why: String,
    /// Fields it reads.
    pub reads: Vec<String>,
    /// Fields it writes.
    pub writes: Vec<String>,
    /// Bytes a cell that it must move, each value once: its floor on any memory. Absent for stages of the view.
    pub bytes_per_cell: Option<u64>,
    /// Mean milliseconds of one run, by the device's clock where it has one, else by the wall's; absent before the first.
    pub mean_ms: Option<f64>,
    /// Runs so far.
    pub runs: u64,
}

/// A field of the plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FieldReport {
    /// Name in the catalogue.
    pub name: String,
    /// Place on the grid: `centre`, `x_face`, `y_face`, `z_face`, `profile`.
    pub place: String,
    /// Unit.
    pub unit: String,
    /// Bytes allocated.
    pub bytes: u64,
}
