//! Samples: the air at places, from the fields at cell centres.
//!
//! Between centres every channel is linear along the three axes (exact for what is linear in space, second order else), so that a client
//! which interpolates a streamed volume gets the same. East and north the box repeats. In the half cell between the outermost centres
//! and the ground or the lid, where centres end, a channel keeps the outermost centre's value, but for three that physics continues:
//! the vertical wind goes to 0, the temperature follows a dry adiabat (a cell's air has one potential temperature), the pressure is
//! hydrostatic. Pressure is interpolated as its Exner function, which is linear in neutral air. Visibility is made of
//! the interpolated extinction, wind speed and direction of the interpolated wind. Below the ground and above the lid the result is NaN.
//!
//! Time: a tick's weather, or linear between two that are kept.

use std::sync::Arc;

use welkin_proto::sample::{Moment, Quantity};
use welkin_proto::{ApiError, Channel, Scene};
use welkin_shaders::Grid;
use welkin_shaders::constants::{GRAVITY_M_S2, HEAT_CAPACITY_DRY_AIR, KAPPA, REFERENCE_PRESSURE_PA};
use welkin_shaders::cpu::diagnose::visibility_m;

use crate::weather::{FieldSet, Weather, offers};

/// Rate at which dry air cools as it rises, K/m.
const DRY_LAPSE_K_M: f64 = GRAVITY_M_S2 / HEAT_CAPACITY_DRY_AIR;
/// Wind slower than this is a calm, in which it comes from nowhere, m/s.
const CALM_M_S: f64 = 1e-3;

/// Which weather is wanted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum When {
    /// The newest.
    #[default]
    Now,
    /// That of a tick.
    Tick(u64),
    /// That of a simulated second.
    Simulated(f64),
}

impl When {
    /// Why this moment is not to be had, where tick and simulated second of the oldest and the newest that are kept are these.
    pub(crate) fn refused(self, code: &str, [oldest, newest]: [(u64, f64); 2]) -> ApiError {
        let (wanted, pointer) = match self {
            When::Now => ("now".to_owned(), ""),
            When::Tick(tick) => (format!("tick {tick}"), "/tick"),
            When::Simulated(second) => (format!("simulated second {second}"), "/simulated_s"),
        };
        let message = format!(
            "{wanted} is not kept; kept are ticks {} to {}, simulated seconds {} to {}",
            oldest.0, newest.0, oldest.1, newest.1
        );
        ApiError::new(code, message).at(pointer)
    }
}

/// One weather, or two and how far from the first to the second.
#[derive(Clone, Debug)]
pub struct Moments {
    first: Arc<Weather>,
    second: Option<(Arc<Weather>, f64)>,
}

impl Moments {
    /// Finds the wanted moment among those that a world keeps (oldest first).
    ///
    /// Errors: `too_old` before the oldest, `not_yet` after the newest, `tick_not_kept` for a tick between two that are kept;
    /// `weather_unavailable` where none is kept.
    pub fn find(past: &[Arc<Weather>], when: When) -> Result<Self, ApiError> {
        let (Some(oldest), Some(newest)) = (past.first(), past.last()) else {
            return Err(ApiError::new("weather_unavailable", "the world keeps no weather"));
        };
        let kept_from_to = [oldest, newest].map(|kept| (kept.tick, kept.simulated_s));
        let refuse = |code| Err(when.refused(code, kept_from_to));
        match when {
            When::Now => Ok(Self::at(newest)),
            When::Tick(tick) => match past.iter().rev().find(|w| w.tick == tick) {
                Some(weather) => Ok(Self::at(weather)),
                None if tick > newest.tick => refuse("not_yet"),
                None if tick < oldest.tick => refuse("too_old"),
                None => refuse("tick_not_kept"),
            },
            When::Simulated(second) => {
                let after = past.partition_point(|w| w.simulated_s < second);
                match (after.checked_sub(1).and_then(|i| past.get(i)), past.get(after)) {
                    (_, Some(exact)) if exact.simulated_s == second => Ok(Self::at(exact)),
                    (Some(a), Some(b)) => Ok(Self {
                        first: Arc::clone(a),
                        second: Some((
                            Arc::clone(b),
                            (second - a.simulated_s) / (b.simulated_s - a.simulated_s),
                        )),
                    }),
                    (Some(_), None) => refuse("not_yet"),
                    (None, _) => refuse("too_old"),
                }
            }
        }
    }

    /// One weather.
    pub fn at(weather: &Arc<Weather>) -> Self {
        Self {
            first: Arc::clone(weather),
            second: None,
        }
    }

    /// The weather, the earlier one of two.
    pub fn weather(&self) -> &Arc<Weather> {
        &self.first
    }

    fn between(&self, of: fn(&Weather) -> f64) -> f64 {
        let from = of(&self.first);
        let second = self.second.as_ref();
        second.map_or(from, |(b, share)| from + share * (of(b) - from))
    }

    /// Simulated date and time, Unix seconds.
    pub fn utc_unix_s(&self) -> f64 {
        self.between(|w| w.utc_unix_s)
    }

    /// What an answer says of its moment.
    pub fn moment(&self) -> Moment {
        Moment {
            tick: self.first.tick,
            simulated_s: self.between(|w| w.simulated_s),
            utc: welkin_proto::time::format_utc(self.utc_unix_s()),
            wall_unix_s: self.between(|w| w.wall_unix_s),
        }
    }
}

/// The fields that quantities are made of.
pub fn fields_of(quantities: &[Quantity]) -> FieldSet {
    let channels: Vec<Channel> = quantities.iter().flat_map(|q| q.channels()).collect();
    FieldSet::of(&channels)
}

/// The quantities that a scene has, and why it lacks the others.
pub fn offered(scene: &Scene) -> (Vec<Quantity>, Vec<(Quantity, ApiError)>) {
    let mut there = Vec::new();
    let mut missing = Vec::new();
    for quantity in Quantity::all() {
        match quantity.channels().into_iter().try_for_each(|c| offers(scene, c)) {
            Ok(()) => there.push(quantity),
            Err(error) => missing.push((quantity, error)),
        }
    }
    (there, missing)
}

/// Whether a place is between ground and lid; east and north there is no end.
pub fn is_inside(grid: &Grid, [_, _, z_m]: [f64; 3]) -> bool {
    (0.0..=lid_m(grid)).contains(&z_m)
}

fn lid_m(grid: &Grid) -> f64 {
    grid.cells[2] as f64 * f64::from(grid.cell_size_m[2])
}

/// Eight cells around a place with their weights, and how far it lies beyond the outermost centre.
pub(crate) struct Stencil {
    cells: [usize; 8],
    weights: [f64; 8],
    levels: [usize; 2],
    up: f64,
    /// Metres above the centre that stands for it, outside the centres; negative below.
    beyond_m: f64,
}

impl Stencil {
    /// Of a place in local metres: sideways the box repeats, below and above the outermost centres those are held.
    pub(crate) fn new(grid: &Grid, [x_m, y_m, z_m]: [f64; 3]) -> Self {
        let wrapped = |axis: usize, at_m: f64| {
            let n = grid.cells[axis];
            let at = (at_m / f64::from(grid.cell_size_m[axis]) - 0.5).rem_euclid(n as f64);
            let low = (at as usize).min(n - 1);
            ([low, (low + 1) % n], at - low as f64)
        };
        let ([x0, x1], east) = wrapped(0, x_m);
        let ([y0, y1], north) = wrapped(1, y_m);
        let (top, dz) = (grid.cells[2] - 1, f64::from(grid.cell_size_m[2]));
        let level = z_m / dz - 0.5;
        let held = level.clamp(0.0, top as f64);
        let z0 = held as usize;
        let levels = [z0, (z0 + 1).min(top)];
        let up = held - z0 as f64;
        let [e, n, u] = [east, north, up].map(|f| [1.0 - f, f]);
        let corner = |i: usize| [i & 1, i >> 1 & 1, i >> 2];
        Self {
            cells: std::array::from_fn(|i| {
                let [a, b, c] = corner(i);
                grid.index([x0, x1][a], [y0, y1][b], levels[c])
            }),
            weights: std::array::from_fn(|i| {
                let [a, b, c] = corner(i);
                e[a] * n[b] * u[c]
            }),
            levels,
            up,
            beyond_m: (level - held) * dz,
        }
    }

    /// The trilinear mean of a field at centres.
    pub(crate) fn mean(&self, field: &[f32]) -> f64 {
        (0..8).map(|i| self.weights[i] * f64::from(field[self.cells[i]])).sum()
    }

    fn value(&self, weather: &Weather, channel: Channel, field: &[f32]) -> f64 {
        let p = &weather.parameters;
        match channel {
            Channel::PressurePa => {
                let [low, high] = self.levels.map(|z| f64::from(p.exner[z]));
                let theta_v_k = f64::from(p.virtual_potential_temperature_k[self.levels[0]]);
                let exner = low + self.up * (high - low) - DRY_LAPSE_K_M * self.beyond_m / theta_v_k;
                REFERENCE_PRESSURE_PA * exner.powf(1.0 / KAPPA)
            }
            Channel::TemperatureK => self.mean(field) - DRY_LAPSE_K_M * self.beyond_m,
            Channel::WindZMS => {
                let half_m = 0.5 * f64::from(weather.grid().cell_size_m[2]);
                self.mean(field) * (1.0 - self.beyond_m.abs() / half_m)
            }
            _ => self.mean(field),
        }
    }
}

/// The channels that a column is kept of before quantities are made of them.
fn base_channels(weather: &Weather, quantities: &[Quantity]) -> Vec<Channel> {
    let mut channels: Vec<Channel> = quantities
        .iter()
        .flat_map(|q| q.channels())
        .map(|channel| match channel {
            Channel::VisibilityM => Channel::ExtinctionPerM,
            other => other,
        })
        // Where nothing condenses visibility is that of clear air.
        .filter(|&c| {
            c != Channel::ExtinctionPerM || weather.offers(c).is_ok() || quantities.contains(&Quantity::Channel(c))
        })
        .collect();
    channels.sort();
    channels.dedup();
    channels
}

/// A column a channel, in f64; NaN where a place is outside.
fn base_columns(weather: &Weather, channels: &[Channel], places: &[[f64; 3]]) -> Result<Vec<Vec<f64>>, ApiError> {
    let fields: Vec<Arc<[f32]>> = channels.iter().map(|&c| weather.field(c)).collect::<Result<_, _>>()?;
    let grid = weather.grid();
    let mut columns = vec![vec![f64::NAN; places.len()]; channels.len()];
    for (i, &place) in places.iter().enumerate().filter(|(_, place)| is_inside(grid, **place)) {
        let stencil = Stencil::new(grid, place);
        for ((column, &channel), field) in columns.iter_mut().zip(channels).zip(&fields) {
            column[i] = stencil.value(weather, channel, field);
        }
    }
    Ok(columns)
}

/// The quantities at places (finite local metres): a column each, NaN where a place is outside. May derive fields, which takes milliseconds: call it off the
/// async workers.
///
/// Errors: those of [`Weather::field`].
pub fn sample(moments: &Moments, quantities: &[Quantity], places: &[[f64; 3]]) -> Result<Vec<Vec<f32>>, ApiError> {
    let weather = &moments.first;
    let channels = base_channels(weather, quantities);
    let mut columns = base_columns(weather, &channels, places)?;
    if let Some((later, share)) = &moments.second {
        for (a, b) in columns.iter_mut().zip(base_columns(later, &channels, places)?) {
            a.iter_mut().zip(b).for_each(|(a, b)| *a += share * (b - *a));
        }
    }
    let column = |channel: Channel| {
        let place = channels.iter().position(|&c| c == channel);
        place.map_or(&[] as &[f64], |place| &columns[place])
    };
    let made = quantities.iter().map(|&quantity| match quantity {
        Quantity::Channel(Channel::VisibilityM) => {
            let (air, extinction) = (weather.clear_air(), column(Channel::ExtinctionPerM));
            let at = |(i, place): (usize, &[f64; 3])| match is_inside(weather.grid(), *place) {
                true => visibility_m(&air, place[2] as f32, extinction.get(i).map_or(0.0, |&e| e as f32)),
                false => f32::NAN,
            };
            places.iter().enumerate().map(at).collect()
        }
        Quantity::Channel(channel) => column(channel).iter().map(|&v| v as f32).collect(),
        Quantity::WindSpeedMS | Quantity::WindFromDeg => {
            let wind = column(Channel::WindXMS).iter().zip(column(Channel::WindYMS));
            let of = match quantity {
                Quantity::WindSpeedMS => |u: f64, v: f64| u.hypot(v) as f32,
                _ => wind_from_deg,
            };
            wind.map(|(&u, &v)| of(u, v)).collect()
        }
    });
    Ok(made.collect())
}

/// Where a wind towards the east and north blows from, degrees clockwise from north, above 0 to 360; 0 in a calm.
pub fn wind_from_deg(x_m_s: f64, y_m_s: f64) -> f32 {
    if x_m_s.hypot(y_m_s) < CALM_M_S {
        return 0.0;
    }
    let degrees = (-x_m_s).atan2(-y_m_s).to_degrees() as f32;
    if degrees <= 0.0 { degrees + 360.0 } else { degrees }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wind_is_named_by_where_it_comes_from() {
        for (x, y, from) in [
            (0.0, -5.0, 360.0),
            (-5.0, 0.0, 90.0),
            (0.0, 5.0, 180.0),
            (5.0, 0.0, 270.0),
            (3.0, 3.0, 225.0),
            (0.0, 0.0, 0.0),
            (1e-5, -1e-5, 0.0),
        ] {
            assert!((wind_from_deg(x, y) - from).abs() < 1e-4, "{x} {y}");
        }
        assert!(wind_from_deg(f64::NAN, 1.0).is_nan());
        // A hair west of north still is above 0.
        let hair = wind_from_deg(1e-9, -5.0);
        assert!(hair > 0.0 && hair <= 360.0, "{hair}");
    }
}
