//! The sky of the last minutes, for whoever looks back: a keyframe of the cloud every second or so, bounded in time and in bytes.
//!
//! The cloud that pictures are drawn of is published anyway, so keeping it costs the world's thread nothing; it is coded by the encoder of the
//! volume stream, off the async workers, and only the message is kept. A world that nobody looks at keeps nothing new, unless the limits say so, and
//! forgets what it kept once that is older than the time that is kept.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use axum::body::Bytes;
use welkin_proto::channel::Channel;
use welkin_proto::volume::past::{PastMoment, PastReport};
use welkin_proto::volume::subscribe::Subscription;
use welkin_proto::volume::{Bits, Compression, MIP_MAX, Receiver, Taken};
use welkin_proto::{ApiError, Scene};

use crate::host::{Published, View};
use crate::limits::Limits;
use crate::live_sky;
use crate::sample::When;
use crate::volume::{VolumeService, Wanted};
use crate::world::Snapshot;

/// A world that is not looked at is asked again after this long.
const ASK_AGAIN: Duration = Duration::from_secs(1);

/// One kept moment.
#[derive(Debug)]
pub struct KeptSky {
    /// The world's publication that it was.
    pub revision: u64,
    /// When that was made.
    pub published_at: Instant,
    /// The same by the server's clock, Unix seconds.
    pub published_unix_s: f64,
    /// Its tick.
    pub tick: u64,
    /// Its simulated second.
    pub simulated_s: f64,
    /// The scene with the effects that it had.
    pub scene: Arc<Scene>,
    /// A keyframe of the extinction of the whole world.
    pub message: Bytes,
}

/// Two are the same where they are of the same publication of one world.
impl PartialEq for KeptSky {
    fn eq(&self, other: &Self) -> bool {
        self.revision == other.revision
    }
}

impl KeptSky {
    /// What pictures are drawn of. Errors: `internal`.
    pub fn snapshot(&self) -> Result<Snapshot, ApiError> {
        match Receiver::default().take(&self.message) {
            Ok(Taken::Field(field)) => {
                live_sky::snapshot(&field, self.scene.as_ref().clone()).map_err(crate::http::internal)
            }
            Ok(Taken::Stale | Taken::NeedsKeyframe) => Err(crate::http::internal("a kept sky is no keyframe")),
            Err(error) => Err(crate::http::internal(error)),
        }
    }
}

/// What one world keeps; oldest first, by rising simulated time.
#[derive(Debug, Default)]
pub struct PastSky {
    kept: Mutex<VecDeque<Arc<KeptSky>>>,
}

impl PastSky {
    fn locked(&self) -> MutexGuard<'_, VecDeque<Arc<KeptSky>>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// All that is kept.
    pub fn all(&self) -> Vec<Arc<KeptSky>> {
        self.locked().iter().cloned().collect()
    }

    /// Keeps one more and forgets what the limits do not allow. What a world that went back in time had beyond it is forgotten; the same moment
    /// is replaced.
    fn push(&self, sky: KeptSky, limits: &Limits) {
        let mut kept = self.locked();
        while kept.back().is_some_and(|last| last.simulated_s >= sky.simulated_s) {
            kept.pop_back();
        }
        let newest_s = sky.published_unix_s;
        kept.push_back(Arc::new(sky));
        let mut bytes: usize = kept.iter().map(|k| k.message.len()).sum();
        while let Some(oldest) = kept.front() {
            let within = bytes <= limits.past_sky_bytes_max && newest_s - oldest.published_unix_s <= limits.past_sky_s;
            if within || kept.len() == 1 {
                return;
            }
            bytes -= oldest.message.len();
            kept.pop_front();
        }
    }

    /// The kept moment that is wanted: a tick's own; for a simulated second the last at or before it. `now_s` is the world's simulated second.
    ///
    /// Errors: `too_old`, `not_yet`, `tick_not_kept` for a tick between two that are kept; `past_unavailable` where none is kept.
    pub fn find(&self, when: When, now_s: f64) -> Result<Arc<KeptSky>, ApiError> {
        let kept = self.locked();
        let (Some(oldest), Some(newest)) = (kept.front(), kept.back()) else {
            let message = "the world keeps no past sky: it has no clouds, nobody has looked at it, or the server is told to keep none";
            return Err(ApiError::new("past_unavailable", message));
        };
        let kept_from_to = [oldest, newest].map(|kept| (kept.tick, kept.simulated_s));
        let refuse = |code| Err(when.refused(code, kept_from_to));
        match when {
            When::Now => Ok(Arc::clone(newest)),
            When::Tick(tick) => match kept.iter().rev().find(|k| k.tick == tick) {
                Some(found) => Ok(Arc::clone(found)),
                None if tick > newest.tick => refuse("not_yet"),
                None if tick < oldest.tick => refuse("too_old"),
                None => refuse("tick_not_kept"),
            },
            When::Simulated(second) if second > now_s.max(newest.simulated_s) => refuse("not_yet"),
            When::Simulated(second) => match kept.iter().rev().find(|k| k.simulated_s <= second) {
                Some(found) => Ok(Arc::clone(found)),
                None => refuse("too_old"),
            },
        }
    }

    /// What can be asked for.
    pub fn report(&self, limits: &Limits) -> PastReport {
        let moment = |k: &Arc<KeptSky>| PastMoment {
            tick: k.tick,
            simulated_s: k.simulated_s,
            published_unix_s: k.published_unix_s,
            bytes: k.message.len() as u64,
        };
        PastReport {
            kept_s: limits.past_sky_s,
            every_s: limits.past_sky_every_s,
            moments: self.locked().iter().map(moment).collect(),
        }
    }
}

/// The finest mip at which a message holds no more than so many values, of those at which the box repeats as the world does.
fn mip_within(cells: [u32; 3], values_max: u64) -> u8 {
    let repeats = |mip: &u8| cells[..2].iter().all(|n| n.is_multiple_of(1 << mip));
    let values = |mip: u8| cells.iter().map(|n| u64::from(n.div_ceil(1 << mip))).product::<u64>();
    let fitting = (0..=MIP_MAX).filter(repeats).find(|mip| values(*mip) <= values_max);
    let coarsest = (0..=MIP_MAX).rfind(repeats);
    fitting.or(coarsest).unwrap_or(0)
}

/// Keeps a world's past until the world stops; returns at once where the limits keep none. Within a tokio runtime.
pub async fn keep(volumes: VolumeService, world: View, limits: Limits) {
    let between = Duration::try_from_secs_f64(limits.past_sky_every_s).unwrap_or(Duration::MAX);
    if limits.past_sky_s <= 0.0 {
        return;
    }
    let subscription = Subscription {
        channels: vec![Channel::ExtinctionPerM.name().to_owned()],
        mip: mip_within(world.scene.domain.cells, limits.past_sky_values_max),
        bits: Bits::Eight,
        compression: Compression::Deflate, // browsers unpack it
        ..Subscription::default()
    };
    let mut published = world.published.clone();
    published.mark_changed();
    let mut due = tokio::time::Instant::now();
    loop {
        tokio::time::sleep_until(due).await;
        if !limits.past_sky_unwatched && world.idle().as_secs_f64() > limits.past_sky_s {
            world.past_sky().locked().clear();
            due = tokio::time::Instant::now() + ASK_AGAIN;
            if !world.is_running() {
                return;
            }
            continue;
        }
        if published.changed().await.is_err() {
            return; // the world has stopped
        }
        // Due times follow one another, so that waiting for a tick does not thin the past out; a pause does not add up.
        due = (due + between).max(tokio::time::Instant::now());
        let newest = published.borrow_and_update().clone();
        match code(&volumes, &world, newest, &subscription, &limits).await {
            Ok(sky) => world.past_sky().push(sky, &limits),
            Err(error) if error.code == "internal" => return, // it is in the log, and would be every second
            // The scene has no clouds now; that may change.
            Err(error) => tracing::debug!(world = %world.id, %error, "no past is kept"),
        }
    }
}

async fn code(
    volumes: &VolumeService,
    world: &View,
    published: Arc<Published>,
    subscription: &Subscription,
    limits: &Limits,
) -> Result<KeptSky, ApiError> {
    let wanted = Wanted::of(subscription, world, limits)?;
    let message = volumes.coded(Arc::clone(&published), &wanted).await?;
    let numbers = &published.snapshot.numbers;
    Ok(KeptSky {
        revision: published.revision,
        published_at: published.at,
        published_unix_s: volumes.clock().unix_s(published.at),
        tick: numbers.tick,
        simulated_s: numbers.simulated_s,
        scene: Arc::clone(&published.snapshot.scene),
        message,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use welkin_proto::presets;

    fn sky(revision: u64, simulated_s: f64, published_unix_s: f64, bytes: usize) -> KeptSky {
        KeptSky {
            revision,
            published_at: Instant::now(),
            published_unix_s,
            tick: simulated_s as u64 / 10,
            simulated_s,
            scene: Arc::new(presets::find(presets::DEFAULT).expect("the default preset is there")),
            message: vec![0; bytes].into(),
        }
    }

    #[test]
    fn time_and_bytes_bound_what_is_kept() {
        let limits = Limits {
            past_sky_s: 60.0,
            past_sky_bytes_max: 1000,
            ..Limits::default()
        };
        let past = PastSky::default();
        for n in 0..100 {
            past.push(sky(n, 10.0 * n as f64, n as f64, 10), &limits);
        }
        let ticks = |past: &PastSky| past.all().iter().map(|k| k.tick).collect::<Vec<_>>();
        assert_eq!(ticks(&past), (39..100).collect::<Vec<_>>(), "a minute");
        past.push(sky(100, 1000.0, 100.0, 960), &limits);
        assert_eq!(ticks(&past), [96, 97, 98, 99, 100], "a thousand bytes");
        past.push(sky(101, 1010.0, 101.0, 5000), &limits);
        assert_eq!(ticks(&past), [101], "the newest stays whatever it takes");
        // The world went back: what it had beyond is forgotten.
        for (revision, simulated_s) in [(102, 1020.0), (103, 1030.0), (104, 1020.0)] {
            past.push(sky(revision, simulated_s, revision as f64, 10), &limits);
        }
        assert_eq!(past.all().last().map(|k| k.revision), Some(104));
        assert_eq!(ticks(&past).last(), Some(&102));
    }

    #[test]
    fn a_moment_is_found_or_refused_with_a_reason() {
        let past = PastSky::default();
        let code = |when, now_s| past.find(when, now_s).map(|k| k.tick).map_err(|e| e.code);
        assert_eq!(code(When::Now, 0.0), Err("past_unavailable".to_owned()));
        for n in [10, 12, 14] {
            past.push(sky(n, 10.0 * n as f64, n as f64, 10), &Limits::default());
        }
        assert_eq!(code(When::Now, 150.0), Ok(14));
        assert_eq!(code(When::Tick(12), 150.0), Ok(12));
        assert_eq!(code(When::Tick(11), 150.0), Err("tick_not_kept".to_owned()));
        assert_eq!(code(When::Tick(9), 150.0), Err("too_old".to_owned()));
        assert_eq!(code(When::Tick(u64::MAX), 150.0), Err("not_yet".to_owned()));
        assert_eq!(code(When::Simulated(139.9), 150.0), Ok(12));
        assert_eq!(
            code(When::Simulated(150.0), 150.0),
            Ok(14),
            "the newest kept stands for now"
        );
        assert_eq!(code(When::Simulated(150.1), 150.0), Err("not_yet".to_owned()));
        assert_eq!(code(When::Simulated(99.9), 150.0), Err("too_old".to_owned()));
        assert_eq!(
            code(When::Simulated(f64::NEG_INFINITY), 150.0),
            Err("too_old".to_owned())
        );
    }

    #[test]
    fn large_worlds_are_kept_coarser_as_long_as_they_repeat() {
        assert_eq!(mip_within([64, 64, 75], 1 << 19), 0);
        assert_eq!(mip_within([256, 256, 256], 1 << 19), 2);
        assert_eq!(mip_within([250, 256, 256], 1 << 19), 1, "250 is no multiple of 4");
        assert_eq!(mip_within([1, 512, 512], 1000), 0);
    }
}
