//! Volumes of a world for all who look at it: each distinct view is encoded once, off the world's thread and off the async workers, and its bytes are
//! shared.
//!
//! A view follows its world at the rate of its fastest subscriber and keeps two messages only: the newest, and the keyframe that it builds on. Nobody
//! waits for anybody: a subscriber takes the newest when it is ready for it. A view that nobody holds ends.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use axum::body::Bytes;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::time::sleep_until;
use welkin_proto::ApiError;
use welkin_proto::channel::Channel;
use welkin_proto::volume::subscribe::Subscription;
use welkin_proto::volume::{Bits, Compression, Encoder, Kind, Layout, Moment, Plane, Region, VolumeError};

use crate::host::{Published, View};
use crate::limits::Limits;
use crate::weather::{self, FieldSet, Reach, WeatherInterest};

/// The server's clock on the wire: Unix seconds when it started, and from then on time that only rises.
#[derive(Clone, Copy, Debug)]
pub struct WallClock {
    started: Instant,
    started_unix_s: f64,
}

impl WallClock {
    /// Reads the system's clock once.
    pub fn start() -> Self {
        let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self {
            started: Instant::now(),
            started_unix_s: unix.as_secs_f64(),
        }
    }

    /// Unix seconds of a moment since the start.
    pub fn unix_s(&self, at: Instant) -> f64 {
        self.started_unix_s + at.saturating_duration_since(self.started).as_secs_f64()
    }
}

/// What tells views of one server apart.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Key {
    world: Arc<str>,
    channels: Vec<Channel>,
    region: Region,
    mip: u8,
    bits: Bits,
    compression: Compression,
}

/// A message of a view, coded.
#[derive(Debug)]
pub struct Message {
    /// The whole binary message.
    pub bytes: Bytes,
    /// Its number.
    pub sequence: u32,
}

/// What a view has now.
#[derive(Clone, Debug)]
pub struct Made {
    /// The newest message.
    pub newest: Arc<Message>,
    /// The keyframe that it builds on; the same message where it is one.
    pub keyframe: Arc<Message>,
}

/// A view's newest messages; an error where it can't be made any more, such as when its effect was switched off.
pub type Newest = Option<Result<Made, ApiError>>;

/// A view that is followed.
pub struct Followed {
    number: u32,
    newest: watch::Receiver<Newest>,
    /// Rates of those who hold it.
    rates: watch::Sender<Vec<f64>>,
    task: tokio::task::AbortHandle,
}

impl Drop for Followed {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// A place among those who look at a view; given back when dropped.
pub struct Seat {
    view: Arc<Followed>,
    rate_hz: f64,
}

impl Seat {
    fn take(view: Arc<Followed>, rate_hz: f64) -> Self {
        view.rates.send_modify(|rates| rates.push(rate_hz));
        Self { view, rate_hz }
    }

    /// The view's number on the wire.
    pub fn number(&self) -> u32 {
        self.view.number
    }

    /// Its newest messages; closed when the world has stopped.
    pub fn newest(&self) -> watch::Receiver<Newest> {
        self.view.newest.clone()
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        let mine = |rate: &f64| rate.to_bits() == self.rate_hz.to_bits();
        self.view.rates.send_modify(|rates| {
            if let Some(place) = rates.iter().position(mine) {
                rates.swap_remove(place);
            }
        });
    }
}

/// All views of a server; cheap to clone.
#[derive(Clone)]
pub struct VolumeService {
    shared: Arc<Shared>,
}

struct Shared {
    clock: WallClock,
    views: Mutex<HashMap<Key, Weak<Followed>>>,
    numbers: AtomicU32,
    /// Permits to encode: at most so many cores are taken from ticks and pictures.
    encoders: Arc<Semaphore>,
}

impl Default for VolumeService {
    fn default() -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            shared: Arc::new(Shared {
                clock: WallClock::start(),
                views: Mutex::default(),
                numbers: AtomicU32::new(1),
                encoders: Arc::new(Semaphore::new((cores / 2).max(1))),
            }),
        }
    }
}

/// A subscription that was judged.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// The channels.
    pub channels: Vec<Channel>,
    /// The cells.
    pub layout: Layout,
    /// Bits a code.
    pub bits: Bits,
    /// How bodies are packed.
    pub compression: Compression,
}

impl Wanted {
    /// Judges what a subscription asks of a world; its rates are the stream's affair.
    ///
    /// Errors: those of [`Subscription::named_channels`] and [`Subscription::layout`]; `channel_unavailable`, `volume_too_large`.
    pub fn of(subscription: &Subscription, world: &View, limits: &Limits) -> Result<Self, ApiError> {
        let channels = subscription.named_channels()?;
        let newest = world.newest();
        for (n, channel) in channels.iter().enumerate() {
            weather::offers(&newest.snapshot.scene, *channel).map_err(|error| error.at(format!("/channels/{n}")))?;
        }
        let domain = &world.scene.domain;
        let layout = subscription.layout(domain.cells, domain.cell_size_m)?;
        let values = (layout.len() * channels.len()) as u64;
        let most = limits.volume_values_max;
        if values > most {
            let message = format!(
                "{values} values; at most {most} are sent: ask for a smaller region, a coarser mip or fewer channels"
            );
            return Err(ApiError::new("volume_too_large", message));
        }
        Ok(Self {
            channels,
            layout,
            bits: subscription.bits,
            compression: subscription.compression,
        })
    }

    fn encoder(&self, view: u32) -> Result<Encoder, ApiError> {
        let plane = |channel: &Channel| Plane {
            name: channel.name().to_owned(),
            curve: channel.curve(),
        };
        let planes = self.channels.iter().map(plane).collect();
        Encoder::new(view, self.layout, planes, self.bits, self.compression).map_err(broken)
    }
}

/// Channels that a world shows now.
pub fn channels_of(published: &Published) -> Vec<Channel> {
    let all = Channel::ALL.iter().copied();
    all.filter(|channel| weather::offers(&published.snapshot.scene, *channel).is_ok())
        .collect()
}

/// Keeps the weather coming that channels are derived from; the drawn cloud is published without.
fn interest(world: &View, channels: &[Channel]) -> Option<WeatherInterest> {
    let derived = channels.iter().any(|channel| *channel != Channel::ExtinctionPerM);
    derived.then(|| world.want_fields(FieldSet::of(channels), Reach::Newest))
}

/// An encoder's error is a fault of ours: what is encoded was judged.
fn broken(error: VolumeError) -> ApiError {
    crate::http::internal(error)
}

impl VolumeService {
    /// The server's clock.
    pub fn clock(&self) -> &WallClock {
        &self.shared.clock
    }

    fn views(&self) -> MutexGuard<'_, HashMap<Key, Weak<Followed>>> {
        self.shared.views.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Distinct views that somebody looks at.
    pub fn view_count(&self) -> usize {
        self.views().values().filter(|view| view.strong_count() > 0).count()
    }

    /// Takes a seat at the view of a world that shows what is wanted; the first to want it starts it. Within a tokio runtime.
    ///
    /// Errors: `too_many_views`, `internal`.
    pub fn follow(&self, world: &View, wanted: &Wanted, rate_hz: f64, limits: &Limits) -> Result<Seat, ApiError> {
        let key = Key {
            world: Arc::clone(&world.id),
            channels: wanted.channels.clone(),
            region: wanted.layout.region,
            mip: wanted.layout.mip,
            bits: wanted.bits,
            compression: wanted.compression,
        };
        let mut views = self.views();
        // A view whose world has stopped, or that failed, is over; the next who asks begins anew.
        let goes_on = |view: &Arc<Followed>| {
            let failed = matches!(&*view.newest.borrow(), Some(Err(_)));
            !failed && view.newest.has_changed().is_ok()
        };
        if let Some(view) = views.get(&key).and_then(Weak::upgrade).filter(goes_on) {
            return Ok(Seat::take(view, rate_hz));
        }
        views.retain(|_, view| view.strong_count() > 0);
        let most = limits.volume_views_max;
        if views.len() >= most {
            let message =
                format!("{most} different views are followed already, which is the limit; ask for one of the others'");
            return Err(ApiError::new("too_many_views", message));
        }
        let number = self.shared.numbers.fetch_add(1, Ordering::Relaxed);
        let (publisher, newest) = watch::channel(None);
        let (rates, wishes) = watch::channel(Vec::new());
        let encoder = wanted.encoder(number)?;
        let follow = follow(
            self.clone(),
            world.clone(),
            wanted.channels.clone(),
            encoder,
            publisher,
            wishes,
        );
        let view = Arc::new(Followed {
            number,
            newest,
            rates,
            task: tokio::spawn(follow).abort_handle(),
        });
        views.insert(key, Arc::downgrade(&view));
        Ok(Seat::take(view, rate_hz))
    }

    /// One keyframe of what a world shows now.
    ///
    /// Errors: `channel_unavailable`, `weather_unavailable`, `world_stopped`, `internal`.
    pub async fn keyframe(&self, world: &View, wanted: &Wanted) -> Result<Bytes, ApiError> {
        let interest = interest(world, &wanted.channels);
        let published = match interest {
            Some(_) => world.weather(FieldSet::of(&wanted.channels)).await?,
            None => world.newest(),
        };
        self.coded(published, wanted).await
    }

    /// One keyframe of a publication.
    ///
    /// Errors: `channel_unavailable`, `weather_unavailable` where it does not carry the weather that is needed, `internal`.
    pub async fn coded(&self, published: Arc<Published>, wanted: &Wanted) -> Result<Bytes, ApiError> {
        let (permit, encoder) = (self.permit().await?, wanted.encoder(0)?);
        let (_, made) = self.encode(permit, published, &wanted.channels, encoder).await?;
        let missing = || ApiError::new("weather_unavailable", "the world does not give its weather now");
        made?.map(|(_, bytes)| bytes.into()).ok_or_else(missing)
    }

    /// Waits until a core is free to encode on.
    async fn permit(&self) -> Result<OwnedSemaphorePermit, ApiError> {
        let permit = Arc::clone(&self.shared.encoders).acquire_owned().await;
        permit.map_err(crate::http::internal)
    }

    /// Encodes on a thread of its own, and gives the encoder back.
    async fn encode(
        &self,
        permit: OwnedSemaphorePermit,
        published: Arc<Published>,
        channels: &[Channel],
        mut encoder: Encoder,
    ) -> Result<(Encoder, Result<Option<Coded>, ApiError>), ApiError> {
        let clock = self.shared.clock;
        let channels = channels.to_vec();
        let work = move || {
            let made = encode_now(&published, &channels, &mut encoder, &clock);
            drop(permit);
            (encoder, made)
        };
        tokio::task::spawn_blocking(work).await.map_err(crate::http::internal)
    }
}

type Coded = (Kind, Vec<u8>);

/// The next message of a view; none where the publication does not carry the weather that it needs.
fn encode_now(
    published: &Published,
    channels: &[Channel],
    encoder: &mut Encoder,
    clock: &WallClock,
) -> Result<Option<Coded>, ApiError> {
    let snapshot = &published.snapshot;
    let mut tick = (snapshot.numbers.tick, snapshot.numbers.simulated_s);
    let mut volume = snapshot.volume.as_deref();
    let derived = channels.iter().any(|channel| *channel != Channel::ExtinctionPerM);
    let weather = published.weather.as_deref().filter(|_| derived);
    if derived {
        // All channels of a message are of one moment: that of the weather.
        let Some(weather) = weather.filter(|w| w.held().covers(FieldSet::of(channels))) else {
            return Ok(None);
        };
        tick = (weather.tick, weather.simulated_s);
        volume = weather.volume.as_deref();
    }
    let mut held: Vec<Arc<[f32]>> = Vec::with_capacity(channels.len());
    for channel in channels {
        weather::offers(&snapshot.scene, *channel)?;
        if *channel == Channel::ExtinctionPerM {
            continue;
        }
        match weather {
            Some(weather) => held.push(weather.field(*channel)?),
            None => return Ok(None),
        }
    }
    let mut others = held.iter();
    let fields = channels.iter().map(|channel| match channel {
        Channel::ExtinctionPerM => volume.map(|v| v.extinction_per_m.as_slice()),
        _ => others.next().map(|values| &values[..]),
    });
    let Some(fields) = fields.collect::<Option<Vec<&[f32]>>>() else {
        return Ok(None);
    };
    let shift_m = volume.map_or([0.0; 3], |v| v.air_displacement_m);
    let moment = Moment {
        tick: tick.0,
        simulated_s: tick.1,
        published_unix_s: clock.unix_s(published.at),
        encoded_unix_s: clock.unix_s(Instant::now()),
        sun_direction: snapshot.sun_direction,
        air_displacement_m: [shift_m[0], shift_m[1]],
    };
    encoder.encode(&moment, &fields).map(Some).map_err(broken)
}

/// A view's life: waits for its rate, for a new publication, for a thread to encode on; then shows what it made.
async fn follow(
    service: VolumeService,
    world: View,
    channels: Vec<Channel>,
    encoder: Encoder,
    publisher: watch::Sender<Newest>,
    mut wishes: watch::Receiver<Vec<f64>>,
) {
    let _interest = interest(&world, &channels);
    let mut published = world.published.clone();
    published.mark_changed();
    let mut encoder = Some(encoder);
    let mut due = tokio::time::Instant::now();
    let mut keyframe: Option<Arc<Message>> = None;
    loop {
        // A faster subscriber may come while the view waits for a slower one's time.
        let began = due;
        loop {
            let fastest_hz = wishes.borrow_and_update().iter().fold(0.0, |a: f64, b| a.max(*b));
            due = if keyframe.is_some() && fastest_hz > 0.0 {
                began + Duration::try_from_secs_f64(1.0 / fastest_hz).unwrap_or(Duration::MAX)
            } else {
                began
            };
            tokio::select! {
                () = sleep_until(due) => break,
                changed = wishes.changed() => if changed.is_err() {
                    return;
                },
            }
        }
        if published.changed().await.is_err() {
            return; // the world has stopped: dropping the publisher tells
        }
        // Due times follow one another, so that waiting does not lower the rate; a pause does not add up.
        due = due.max(tokio::time::Instant::now() - Duration::from_millis(100));
        let Ok(permit) = service.permit().await else { return };
        let newest = published.borrow_and_update().clone();
        let Some(idle) = encoder.take() else { return };
        let made = match service.encode(permit, newest, &channels, idle).await {
            Ok((back, made)) => {
                encoder = Some(back);
                match made {
                    Ok(None) => continue, // published before its weather was wanted
                    Ok(Some(made)) => Ok(made),
                    Err(error) => Err(error),
                }
            }
            Err(error) => Err(error),
        };
        let shown = made.map(|(kind, bytes)| {
            let sequence = encoder.as_ref().map_or(0, Encoder::last_sequence);
            let message = Arc::new(Message {
                bytes: bytes.into(),
                sequence,
            });
            let base = match (&keyframe, kind) {
                (Some(base), Kind::Delta) => Arc::clone(base),
                _ => Arc::clone(&message),
            };
            keyframe = Some(Arc::clone(&base));
            Made {
                newest: message,
                keyframe: base,
            }
        });
        let failed = shown.is_err();
        publisher.send_replace(Some(shown));
        if failed {
            return std::future::pending().await; // until nobody holds the view any more
        }
    }
}
