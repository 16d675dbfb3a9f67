//! The air at one moment, for samples, volumes and weather services: what a tick publishes to those who asked for it.
//!
//! A [`Weather`] holds a copy of the state's fields, made by the world's thread between two ticks and only while somebody wants them
//! ([`Desk`]). Everything else is derived on the asking thread, at the first asking, with the kernels of the tick, so that
//! what is derived belongs to the same state. A copy of all five fields is 20 bytes a cell: 6 MB and 3 ms for 64 x 64 x 75
//! cells on the CPU device (measured on two busy cores); on a GPU it is five transfers that the world's thread waits for. The copy and all thirteen
//! channels took 38 ms of a core there, as much as two substeps; `tests/service/weather.rs` prints it.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use welkin_proto::{ApiError, Channel, Scene};
use welkin_shaders::catalogue::Field;
use welkin_shaders::cpu::diagnose;
use welkin_shaders::cpu::light::atmosphere::Atmosphere;
use welkin_shaders::cpu::sim::{Parameters, centre_wind, dry_buoyancy, eddy_viscosity, saturation_adjustment};
use welkin_shaders::{CloudVolume, Grid};

/// How long a world goes on publishing its weather after the last who wanted it has left: somebody who asks once a second
/// finds the seconds between.
pub const LINGER: Duration = Duration::from_secs(10);
/// Bytes of past weathers that a world keeps while somebody wants them, where nobody says otherwise.
pub const PAST_BYTES_MAX: usize = 128 << 20;

/// A set of the state's fields. The empty set still is a wish for what costs nothing: time, pressure, the drawn cloud.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FieldSet(u8);

impl FieldSet {
    /// None.
    pub const NONE: FieldSet = FieldSet(0);
    /// All of the state.
    pub const ALL: FieldSet = FieldSet((1 << Field::STATE.len()) - 1);
    const VELOCITY: FieldSet = FieldSet(0b00111);
    const WATER: FieldSet = FieldSet(0b10000);
    const HEAT_AND_WATER: FieldSet = FieldSet(0b11000);

    /// The fields that channels are derived from.
    pub fn of(channels: &[Channel]) -> Self {
        channels.iter().fold(Self::NONE, |set, &channel| {
            set.with(match channel {
                Channel::ExtinctionPerM | Channel::PressurePa | Channel::VisibilityM => Self::NONE,
                Channel::WindXMS | Channel::WindYMS | Channel::WindZMS => Self::VELOCITY,
                Channel::TotalWaterKgKg => Self::WATER,
                Channel::TemperatureK
                | Channel::RelativeHumidity
                | Channel::VapourKgKg
                | Channel::LiquidWaterKgKg
                | Channel::EffectiveRadiusM => Self::HEAT_AND_WATER,
                Channel::EddyDissipationRateM23S => Self::ALL,
            })
        })
    }

    /// Both.
    pub fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Whether all of `other` is in it.
    pub fn covers(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    fn has(self, place: usize) -> bool {
        self.0 >> place & 1 == 1
    }

    /// Its fields.
    pub fn fields(self) -> impl Iterator<Item = Field> {
        let places = (0..Field::STATE.len()).filter(move |&place| self.has(place));
        places.map(|place| Field::STATE[place])
    }
}

type Values = Arc<[f32]>;

/// The air at one moment; immutable. See the module.
#[derive(Debug)]
pub struct Weather {
    /// The world's publication that first showed it.
    pub revision: u64,
    /// Ticks since the world's start.
    pub tick: u64,
    /// Simulated seconds since the world's start.
    pub simulated_s: f64,
    /// Simulated date and time, Unix seconds.
    pub utc_unix_s: f64,
    /// When it was copied.
    pub at: Instant,
    /// The same by the wall's clock, Unix seconds.
    pub wall_unix_s: f64,
    /// The scene with the effects that it had.
    pub scene: Arc<Scene>,
    /// Grid, reference state (pressure, density, Exner function) and the effects' numbers.
    pub parameters: Arc<Parameters>,
    /// The cloud as pictures of this moment have it; none where the scene has no moisture.
    pub volume: Option<Arc<CloudVolume>>,
    held: FieldSet,
    /// By place in [`Field::STATE`]; empty where it is not held or not planned.
    state: [Arc<Vec<f32>>; 5],
    derived: [OnceLock<Values>; Channel::ALL.len()],
    wind: OnceLock<[Values; 3]>,
    /// Cloud water and buoyancy.
    condensed: OnceLock<[Values; 2]>,
}

/// What a world gives to make a [`Weather`] of.
#[derive(Debug)]
pub struct Copied {
    /// The tick.
    pub tick: u64,
    /// Simulated seconds since the start.
    pub simulated_s: f64,
    /// Simulated Unix seconds.
    pub utc_unix_s: f64,
    /// The scene.
    pub scene: Arc<Scene>,
    /// Its numbers.
    pub parameters: Arc<Parameters>,
    /// The drawn cloud.
    pub volume: Option<Arc<CloudVolume>>,
    /// What was asked for.
    pub held: FieldSet,
    /// Its values, by place in [`Field::STATE`]; empty where not asked for or not planned.
    pub state: [Vec<f32>; 5],
}

impl Weather {
    /// A weather of what was copied, in publication `revision`.
    pub fn new(copied: Copied, revision: u64) -> Self {
        let wall = SystemTime::now().duration_since(UNIX_EPOCH);
        Self {
            revision,
            tick: copied.tick,
            simulated_s: copied.simulated_s,
            utc_unix_s: copied.utc_unix_s,
            at: Instant::now(),
            wall_unix_s: wall.map_or(0.0, |d| d.as_secs_f64()),
            scene: copied.scene,
            parameters: copied.parameters,
            volume: copied.volume,
            held: copied.held,
            state: copied.state.map(Arc::new),
            derived: Default::default(),
            wind: OnceLock::new(),
            condensed: OnceLock::new(),
        }
    }

    /// The same without what was derived from it: a past moment is asked for less often.
    fn bare(&self) -> Self {
        Self {
            scene: Arc::clone(&self.scene),
            parameters: Arc::clone(&self.parameters),
            volume: self.volume.clone(),
            state: self.state.clone(),
            derived: Default::default(),
            wind: OnceLock::new(),
            condensed: OnceLock::new(),
            ..*self
        }
    }

    /// The grid.
    pub fn grid(&self) -> &Grid {
        &self.parameters.grid
    }

    /// The state's fields that it holds.
    pub fn held(&self) -> FieldSet {
        self.held
    }

    /// Bytes of its fields, copied and derived.
    pub fn bytes(&self) -> usize {
        let state: usize = self.state.iter().map(|v| v.len()).sum();
        let cloud = self.volume.as_ref().map_or(0, |v| v.extinction_per_m.len());
        let derived = self.derived.iter().filter(|d| d.get().is_some()).count();
        let between = 3 * usize::from(self.wind.get().is_some()) + 2 * usize::from(self.condensed.get().is_some());
        4 * (state + cloud + (derived + between) * self.grid().len())
    }

    /// Whether the scene has the effect that a channel needs. Errors: those of [`offers`].
    pub fn offers(&self, channel: Channel) -> Result<(), ApiError> {
        offers(&self.scene, channel)
    }

    /// The channels that the scene has.
    pub fn channels(&self) -> Vec<Channel> {
        let all = Channel::ALL.iter().copied();
        all.filter(|&channel| self.offers(channel).is_ok()).collect()
    }

    /// A channel's values at cell centres, `[z][y][x]`, SI; derived at the first asking, which may take some milliseconds, and kept.
    ///
    /// Errors: `channel_unavailable` where the scene has no such effect; `weather_not_kept` where the fields that it is derived
    /// from were not wanted when this weather was copied.
    pub fn field(&self, channel: Channel) -> Result<Arc<[f32]>, ApiError> {
        self.offers(channel)?;
        if !self.held.covers(FieldSet::of(&[channel])) {
            let message = format!("{} was not wanted at tick {}", channel.name(), self.tick);
            return Err(ApiError::new("weather_not_kept", message));
        }
        let values = self.derived[usize::from(channel.number())].get_or_init(|| self.derive(channel));
        Ok(Arc::clone(values))
    }

    /// Derives a channel that the scene has from fields that are held.
    fn derive(&self, channel: Channel) -> Values {
        let (grid, parameters) = (self.grid(), self.parameters.as_ref());
        let [_, _, _, heat, water] = &self.state;
        match channel {
            Channel::ExtinctionPerM => Arc::from(self.extinction()),
            Channel::WindXMS => Arc::clone(&self.wind()[0]),
            Channel::WindYMS => Arc::clone(&self.wind()[1]),
            Channel::WindZMS => Arc::clone(&self.wind()[2]),
            Channel::LiquidWaterKgKg => Arc::clone(&self.condensed()[0]),
            Channel::TotalWaterKgKg => Arc::from(water.as_slice()),
            Channel::PressurePa => self.filled(|out| {
                let levels = out.chunks_exact_mut(grid.plane()).zip(&parameters.pressure_pa);
                levels.for_each(|(level, pressure)| level.fill(*pressure));
            }),
            Channel::TemperatureK => self.filled(|out| {
                if heat.is_empty() {
                    // Heat is not carried: the air stays as the base state has it.
                    let base: Vec<f32> = parameters
                        .base_heat_k
                        .iter()
                        .flat_map(|h| vec![*h; grid.plane()])
                        .collect();
                    diagnose::temperature(parameters, &base, &[], out);
                } else if self.offers(Channel::LiquidWaterKgKg).is_ok() {
                    diagnose::temperature(parameters, heat, &self.condensed()[0], out);
                } else {
                    diagnose::temperature(parameters, heat, &[], out);
                }
            }),
            Channel::VapourKgKg => self.filled(|out| diagnose::vapour(grid, water, &self.condensed()[0], out)),
            Channel::EffectiveRadiusM => {
                self.filled(|out| diagnose::effective_radius(parameters, &self.condensed()[0], out))
            }
            Channel::RelativeHumidity => {
                let [temperature, vapour] = [Channel::TemperatureK, Channel::VapourKgKg]
                    .map(|c| Arc::clone(self.derived[usize::from(c.number())].get_or_init(|| self.derive(c))));
                self.filled(|out| diagnose::relative_humidity(parameters, &temperature, &vapour, out))
            }
            Channel::EddyDissipationRateM23S => {
                let dry;
                let buoyancy: &[f32] = if heat.is_empty() {
                    &[]
                } else if self.offers(Channel::LiquidWaterKgKg).is_ok() {
                    &self.condensed()[1]
                } else {
                    dry = self.filled(|out| dry_buoyancy::run(parameters, heat, out));
                    &dry
                };
                self.filled(|out| {
                    eddy_viscosity::run(parameters, self.velocity(), buoyancy, out);
                    diagnose::eddy_dissipation_rate(parameters, out);
                })
            }
            Channel::VisibilityM => {
                self.filled(|out| diagnose::visibility(&self.clear_air(), grid, self.extinction(), out))
            }
        }
    }

    /// The clear air that pictures and visibility share.
    pub fn clear_air(&self) -> Atmosphere {
        let haze = self.scene.effects.aerial_perspective.as_ref();
        let visibility_m = haze.map(|a| a.visibility_m as f32);
        Atmosphere::new(self.scene.domain.surface_altitude_m as f32, visibility_m)
    }

    fn extinction(&self) -> &[f32] {
        self.volume.as_ref().map_or(&[], |v| &v.extinction_per_m)
    }

    fn velocity(&self) -> [&[f32]; 3] {
        [0, 1, 2].map(|axis| self.state[axis].as_slice())
    }

    fn wind(&self) -> &[Values; 3] {
        self.wind.get_or_init(|| {
            let mut out: [Values; 3] = std::array::from_fn(|_| self.filled(|_| {}));
            let [x, y, z] = &mut out;
            let out_of = [Arc::make_mut(x), Arc::make_mut(y), Arc::make_mut(z)];
            centre_wind::run(&self.parameters, self.velocity(), out_of);
            out
        })
    }

    fn condensed(&self) -> &[Values; 2] {
        self.condensed.get_or_init(|| {
            let mut out: [Values; 2] = std::array::from_fn(|_| self.filled(|_| {}));
            let [cloud, buoyancy] = &mut out;
            let [_, _, _, heat, water] = &self.state;
            let (cloud, buoyancy) = (Arc::make_mut(cloud), Arc::make_mut(buoyancy));
            saturation_adjustment::run(&self.parameters, heat, water, cloud, buoyancy);
            out
        })
    }

    /// A field of zeros that `fill` writes.
    fn filled(&self, fill: impl FnOnce(&mut [f32])) -> Values {
        let mut values: Values = std::iter::repeat_n(0.0, self.grid().len()).collect();
        fill(Arc::make_mut(&mut values));
        values
    }
}

/// Whether a scene has the effect that a channel needs. Errors: `channel_unavailable`, with the reason.
pub fn offers(scene: &Scene, channel: Channel) -> Result<(), ApiError> {
    let effects = &scene.effects;
    let missing = match channel.needs() {
        Some("flow") => effects.flow.is_none(),
        Some("moisture") => effects.moisture.is_none(),
        Some("turbulence") => effects.turbulence.is_none(),
        _ => false,
    };
    match channel.needs() {
        Some(effect) if missing => Err(ApiError::new(
            "channel_unavailable",
            format!("{}: the scene has no effect `{effect}`", channel.name()),
        )),
        _ => Ok(()),
    }
}

/// Weathers of the last moments, oldest first, by rising simulated time; immutable.
pub type Past = Arc<[Arc<Weather>]>;

/// `past` and then `newest`, as many of the newest as `bytes_max` allows, one at least.
///
/// What a world that went back in time had beyond the newest moment is forgotten; the same moment is replaced.
pub fn remember(past: &[Arc<Weather>], newest: &Arc<Weather>, bytes_max: usize) -> Past {
    let mut bytes = newest.bytes();
    let before = past.iter().filter(|w| w.simulated_s < newest.simulated_s);
    let kept: Vec<Arc<Weather>> = before
        .rev()
        .map_while(|weather| {
            // The one that was the newest until now is kept without what was derived of it.
            let was_newest = past.last().is_some_and(|last| Arc::ptr_eq(last, weather));
            let weather = match was_newest {
                true => Arc::new(weather.bare()),
                false => Arc::clone(weather),
            };
            bytes += weather.bytes();
            (bytes <= bytes_max).then_some(weather)
        })
        .collect();
    kept.into_iter().rev().chain([Arc::clone(newest)]).collect()
}

/// Which moments a wish is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// The newest alone: volumes, pictures.
    Newest,
    /// The last ones too: whoever may name a tick or a time.
    Past,
}

/// Counts who wants which fields of a world. Shared by the world's thread and its viewers; nobody ever waits for it.
#[derive(Debug)]
pub struct Desk {
    /// Wishes by place in [`Field::STATE`], all wishes, and those that reach back.
    wishes: [AtomicUsize; 7],
    /// Until when, in milliseconds since `epoch`, a wish that has ended counts on.
    until_ms: [AtomicU64; 7],
    epoch: Instant,
    past_bytes_max: AtomicUsize,
}

const ANY: usize = Field::STATE.len();
const BACK: usize = ANY + 1;

impl Default for Desk {
    fn default() -> Self {
        Self {
            wishes: Default::default(),
            until_ms: Default::default(),
            epoch: Instant::now(),
            past_bytes_max: AtomicUsize::new(PAST_BYTES_MAX),
        }
    }
}

impl Desk {
    /// Wants the fields until the wish is dropped, and for [`LINGER`] after.
    pub fn want(self: &Arc<Self>, fields: FieldSet, reach: Reach) -> WeatherInterest {
        places(fields, reach).for_each(|place| {
            self.wishes[place].fetch_add(1, Ordering::SeqCst);
        });
        WeatherInterest {
            desk: Arc::clone(self),
            fields,
            reach,
        }
    }

    fn is_wanted(&self, place: usize) -> bool {
        let now_ms = self.epoch.elapsed().as_millis() as u64;
        self.wishes[place].load(Ordering::SeqCst) > 0 || self.until_ms[place].load(Ordering::SeqCst) > now_ms
    }

    /// Whether somebody wants the last moments too.
    pub fn past_wanted(&self) -> bool {
        self.is_wanted(BACK)
    }

    /// The fields that are wanted now; none where nobody wants any weather.
    pub fn wanted(&self) -> Option<FieldSet> {
        let set = (0..ANY)
            .filter(|&place| self.is_wanted(place))
            .fold(0, |set, place| set | 1 << place);
        self.is_wanted(ANY).then_some(FieldSet(set))
    }

    /// How long the last wish that has ended counts on; none while one lives or where all are over.
    pub fn lapses_in(&self) -> Option<Duration> {
        let until = Duration::from_millis(self.until_ms[ANY].load(Ordering::SeqCst));
        let left = until.checked_sub(self.epoch.elapsed())?;
        (self.wishes[ANY].load(Ordering::SeqCst) == 0).then_some(left)
    }

    /// Bytes of past weathers that the world may keep.
    pub fn past_bytes_max(&self) -> usize {
        self.past_bytes_max.load(Ordering::Relaxed)
    }

    /// Sets [`Desk::past_bytes_max`]; counts from the next publication.
    pub fn set_past_bytes_max(&self, bytes: usize) {
        self.past_bytes_max.store(bytes, Ordering::Relaxed);
    }
}

fn places(fields: FieldSet, reach: Reach) -> impl Iterator<Item = usize> {
    let back = (reach == Reach::Past).then_some(BACK);
    (0..ANY)
        .filter(move |&place| fields.has(place))
        .chain([ANY])
        .chain(back)
}

/// A wish for a world's weather, as long as it lives.
#[derive(Debug)]
pub struct WeatherInterest {
    desk: Arc<Desk>,
    fields: FieldSet,
    reach: Reach,
}

impl Drop for WeatherInterest {
    fn drop(&mut self) {
        let until_ms = (self.desk.epoch.elapsed() + LINGER).as_millis() as u64;
        places(self.fields, self.reach).for_each(|place| {
            self.desk.until_ms[place].fetch_max(until_ms, Ordering::SeqCst);
            self.desk.wishes[place].fetch_sub(1, Ordering::SeqCst);
        });
    }
}
