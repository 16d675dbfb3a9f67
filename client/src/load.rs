//! A load on a server: many volume subscribers and frame viewers at once, slow readers among them, and a storm of reconnections; what it does to the
//! server's ticks is read from the times that the server itself stamps on its volumes.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use futures_util::StreamExt;
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};
use welkin_proto::volume::subscribe::Subscription;
use welkin_proto::wire::FrameFormat;

use crate::error::ClientError;
use crate::stream::{Event, FrameWish, Options, connect};
use crate::volume::{VolumeEvent, VolumeOptions, Volumes, subscribe};

/// Volumes a second of the one subscriber whose stamps tell of the ticks.
const WATCHER_RATE_HZ: f64 = 60.0;
/// A slow reader takes a volume, then nothing for so long.
const SLOW_PAUSE: Duration = Duration::from_secs(3);
/// Nobody waits longer for a first volume.
const FIRST_WITHIN: Duration = Duration::from_secs(60);
/// Subscribers connect this far apart, so that the load comes up in a second or two; the storm comes at once.
const BETWEEN_CONNECTIONS: Duration = Duration::from_millis(4);

/// What to load a server with.
#[derive(Clone, Debug)]
pub struct LoadOptions {
    /// The world's id; `None` takes the server's first.
    pub world: Option<String>,
    /// Volume subscribers.
    pub subscribers: usize,
    /// What each of them asks for.
    pub subscription: Subscription,
    /// So many of them read slowly.
    pub slow: usize,
    /// Frame viewers.
    pub viewers: usize,
    /// What each of them asks for.
    pub frames: FrameWish,
    /// How long the ticks are watched without the load, and then with it.
    pub each: Duration,
    /// The server's process, where its memory is to be told; `/proc` must be there.
    pub server_pid: Option<u32>,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            world: None,
            subscribers: 500,
            subscription: Subscription {
                mip: 2,
                ..Subscription::default()
            },
            slow: 10,
            viewers: 50,
            frames: FrameWish {
                width: 320,
                height: 180,
                format: FrameFormat::Jpeg,
                max_fps: 2.0,
                camera: None,
            },
            each: Duration::from_secs(20),
            server_pid: None,
        }
    }
}

/// Publications of a world as the server stamped them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ticks {
    /// Publications watched.
    pub count: usize,
    /// Mean time from one to the next, s.
    pub mean_s: f64,
    /// Deviation from that in the mean square, as a share of it.
    pub jitter: f64,
    /// The largest time from one to the next, s.
    pub longest_s: f64,
    /// Ticks that were computed for each that was published.
    pub ticks_each: f64,
}

impl Ticks {
    fn of(stamps: &[(u64, f64)]) -> Self {
        let gaps: Vec<f64> = stamps.windows(2).map(|w| w[1].1 - w[0].1).collect();
        let (Some(first), Some(last), false) = (stamps.first(), stamps.last(), gaps.is_empty()) else {
            return Self::default();
        };
        // A publication that the watcher missed would count as a long gap: gaps are told by tick.
        let ticks = (last.0 - first.0).max(1) as f64;
        let mean_s = (last.1 - first.1) / gaps.len() as f64;
        let square = gaps.iter().map(|g| (g - mean_s).powi(2)).sum::<f64>() / gaps.len() as f64;
        Self {
            count: stamps.len(),
            mean_s,
            jitter: square.sqrt() / mean_s,
            longest_s: gaps.iter().copied().fold(0.0, f64::max),
            ticks_each: ticks / gaps.len() as f64,
        }
    }
}

/// What a load did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoadReport {
    /// The ticks without it.
    pub quiet: Ticks,
    /// And with it.
    pub loaded: Ticks,
    /// Volumes that one subscriber who is not slow got, the least and the mean, a second.
    pub volumes_per_s: [f64; 2],
    /// Bytes that such a one got, the mean and the most, a second.
    pub bytes_per_s: [f64; 2],
    /// Volumes that one slow reader got, the mean, a second.
    pub slow_volumes_per_s: f64,
    /// From a volume's publication to its arrival, the mean and the longest, s; of those who are not slow.
    pub age_s: [f64; 2],
    /// Frames that one viewer got, the mean, a second.
    pub frames_per_s: f64,
    /// From the storm to the volume of the last subscriber who came back, s.
    pub storm_s: f64,
    /// Errors that anybody met.
    pub errors: u64,
    /// The server's memory: before, in the first half of the load, at its end, after the storm; MiB.
    pub resident_mib: Option<[f64; 4]>,
}

#[derive(Default)]
struct Count {
    volumes: AtomicU64,
    bytes: AtomicU64,
    age_us: AtomicU64,
    age_max_us: AtomicU64,
    frames: AtomicU64,
    errors: Arc<AtomicU64>,
}

/// Runs the load against the server at `url`: quiet, load, storm; ends by itself after a little more than twice `each`.
///
/// Errors: those of [`subscribe`], and whatever the first subscriber meets.
pub async fn run(url: &str, options: &LoadOptions) -> Result<LoadReport, ClientError> {
    let memory = || options.server_pid.and_then(resident_mib);
    let mut watcher = Watcher::start(url, options).await?;
    let before = memory();
    let quiet = Ticks::of(&watcher.stamps(options.each).await?);

    let errors: Arc<AtomicU64> = Arc::default();
    let counts: Vec<Arc<Count>> = (0..options.subscribers + options.viewers)
        .map(|_| {
            Arc::new(Count {
                errors: Arc::clone(&errors),
                ..Count::default()
            })
        })
        .collect();
    let mut crowd = JoinSet::new();
    let mut everybody = Vec::new();
    for (n, count) in counts.iter().enumerate() {
        if n < options.subscribers {
            let volumes = subscribe(url, volume_options(options, options.subscription.clone()))?;
            let slow = n < options.slow;
            everybody.push(crowd.spawn(take_volumes(volumes, Arc::clone(count), slow)));
        } else {
            let wish = Options {
                world: options.world.clone(),
                frames: Some(options.frames.clone()),
                ..Options::default()
            };
            let frames = connect(url, wish)?;
            crowd.spawn(take_frames(frames, Arc::clone(count)));
        }
        sleep(BETWEEN_CONNECTIONS).await;
    }
    let began = Instant::now();
    let subscribed = counts[..options.subscribers].iter();
    while subscribed.clone().any(|c| c.volumes.load(Ordering::Relaxed) == 0) && began.elapsed() < FIRST_WITHIN {
        sleep(Duration::from_millis(20)).await;
    }
    let at_start: Vec<[u64; 3]> = counts.iter().map(|c| c.read()).collect();
    let began = Instant::now();
    let half = options.each / 2;
    let mut seen = watcher.stamps(half).await?;
    let filled = memory();
    seen.extend(watcher.stamps(half).await?);
    let loaded = Ticks::of(&seen);
    let took_s = began.elapsed().as_secs_f64();
    let at_end = memory();
    let got: Vec<[f64; 3]> = counts
        .iter()
        .zip(&at_start)
        .map(|(c, start)| {
            let now = c.read();
            [0, 1, 2].map(|i| (now[i] - start[i]) as f64 / took_s)
        })
        .collect();
    let (slow, rest) = got[..options.subscribers].split_at(options.slow.min(options.subscribers));
    // An empty sum is minus zero.
    let mean = |of: &[[f64; 3]], i: usize| (0.0 + of.iter().map(|g| g[i]).sum::<f64>()) / of.len().max(1) as f64;
    let patient = &counts[options.slow.min(options.subscribers)..options.subscribers];
    let volumes: u64 = patient.iter().map(|c| c.volumes.load(Ordering::Relaxed)).sum();
    let age_us: u64 = patient.iter().map(|c| c.age_us.load(Ordering::Relaxed)).sum();
    let age_max_us = patient.iter().map(|c| c.age_max_us.load(Ordering::Relaxed)).max();

    // The storm: every subscriber is cut off without a word, and all come back at once.
    for subscriber in everybody {
        subscriber.abort();
    }
    let began = Instant::now();
    let mut storm = JoinSet::new();
    for _ in 0..options.subscribers {
        let volumes = subscribe(url, volume_options(options, options.subscription.clone()))?;
        let errors = Arc::clone(&errors);
        storm.spawn(async move { first_volume(volumes, &errors).await });
    }
    while storm.join_next().await.is_some() {}
    let storm_s = began.elapsed().as_secs_f64();
    crowd.shutdown().await;
    let after = memory();
    Ok(LoadReport {
        quiet,
        loaded,
        volumes_per_s: [
            rest.iter().map(|g| g[0]).fold(f64::INFINITY, f64::min).min(f64::MAX),
            mean(rest, 0),
        ],
        bytes_per_s: [mean(rest, 1), rest.iter().map(|g| g[1]).fold(0.0, f64::max)],
        slow_volumes_per_s: mean(slow, 0),
        age_s: [
            age_us as f64 / volumes.max(1) as f64 / 1e6,
            age_max_us.unwrap_or(0) as f64 / 1e6,
        ],
        frames_per_s: mean(&got[options.subscribers..], 2),
        storm_s,
        errors: errors.load(Ordering::Relaxed),
        resident_mib: match (before, filled, at_end, after) {
            (Some(before), Some(filled), Some(at_end), Some(after)) => Some([before, filled, at_end, after]),
            _ => None,
        },
    })
}

impl Count {
    fn read(&self) -> [u64; 3] {
        [&self.volumes, &self.bytes, &self.frames].map(|count| count.load(Ordering::Relaxed))
    }
}

fn volume_options(options: &LoadOptions, subscription: Subscription) -> VolumeOptions {
    VolumeOptions {
        world: options.world.clone(),
        subscription,
        retry_first: Duration::from_millis(100),
        retry_last: Duration::from_secs(1),
        ..VolumeOptions::default()
    }
}

/// One subscriber to every publication, of as few values as there can be. It has a thread of its own, so that the crowd's work in this process does not
/// make it miss any.
struct Watcher {
    seen: mpsc::UnboundedReceiver<Result<(u64, f64), ClientError>>,
}

impl Watcher {
    /// Returns when the first publication is seen. Errors: those of [`subscribe`], and whatever it meets until then.
    async fn start(url: &str, options: &LoadOptions) -> Result<Self, ClientError> {
        let subscription = Subscription {
            channels: options.subscription.channels[..1].to_vec(),
            mip: welkin_proto::volume::MIP_MAX,
            rate_hz: WATCHER_RATE_HZ,
            ..Subscription::default()
        };
        let (url, options) = (url.to_owned(), volume_options(options, subscription));
        let (tell, mut seen) = mpsc::unbounded_channel();
        let broken = |error: std::io::Error| ClientError::Lost(format!("the watcher cannot run: {error}"));
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(broken)?;
        let work = move || runtime.block_on(watch(&url, options, &tell));
        std::thread::Builder::new()
            .name("watcher".into())
            .spawn(work)
            .map_err(broken)?;
        match timeout(FIRST_WITHIN, seen.recv()).await {
            Ok(Some(Ok(_))) => Ok(Self { seen }),
            Ok(Some(Err(error))) => Err(error),
            Ok(None) | Err(_) => Err(ClientError::Lost("no subscription came about".to_owned())),
        }
    }

    /// Tick and time of the publications that come in so long.
    async fn stamps(&mut self, during: Duration) -> Result<Vec<(u64, f64)>, ClientError> {
        while self.seen.try_recv().is_ok() {} // what came before does not count
        let end = Instant::now() + during;
        let mut stamps: Vec<(u64, f64)> = Vec::new();
        loop {
            match timeout(end.saturating_duration_since(Instant::now()), self.seen.recv()).await {
                Err(_) => return Ok(stamps),
                Ok(None) => return Err(ClientError::Lost("the watcher's stream ended".to_owned())),
                Ok(Some(seen)) => stamps.push(seen?),
            }
        }
    }
}

/// Tells of every publication until nobody listens or something goes wrong.
async fn watch(url: &str, options: VolumeOptions, tell: &mpsc::UnboundedSender<Result<(u64, f64), ClientError>>) {
    let mut volumes = match subscribe(url, options) {
        Ok(volumes) => volumes,
        Err(error) => {
            let _ = tell.send(Err(error)); // nobody to tell is as good
            return;
        }
    };
    loop {
        let event = tokio::select! {
            event = volumes.next() => event,
            () = tell.closed() => return,
        };
        let (told, last) = match event {
            None => return,
            Some(VolumeEvent::Volume { field, .. }) => {
                (tell.send(Ok((field.moment.tick, field.moment.published_unix_s))), false)
            }
            Some(VolumeEvent::Error { error, .. }) => (tell.send(Err(error)), true),
            Some(VolumeEvent::Hello(_) | VolumeEvent::Subscribed(_)) => continue,
        };
        if told.is_err() || last {
            return;
        }
    }
}

async fn take_volumes(mut volumes: Volumes, count: Arc<Count>, slow: bool) {
    while let Some(event) = volumes.next().await {
        match event {
            VolumeEvent::Volume { field, bytes, .. } => {
                count.volumes.fetch_add(1, Ordering::Relaxed);
                count.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
                if let Some(now_s) = volumes.server_unix_s() {
                    let age_us = ((now_s - field.moment.published_unix_s).max(0.0) * 1e6) as u64;
                    count.age_us.fetch_add(age_us, Ordering::Relaxed);
                    count.age_max_us.fetch_max(age_us, Ordering::Relaxed);
                }
                if slow {
                    sleep(SLOW_PAUSE).await;
                }
            }
            VolumeEvent::Error { .. } => {
                count.errors.fetch_add(1, Ordering::Relaxed);
            }
            VolumeEvent::Hello(_) | VolumeEvent::Subscribed(_) => {}
        }
    }
}

async fn take_frames(mut frames: crate::stream::Events, count: Arc<Count>) {
    while let Some(event) = frames.next().await {
        match event {
            Event::Frame(_) => {
                count.frames.fetch_add(1, Ordering::Relaxed);
            }
            Event::Error { .. } => {
                count.errors.fetch_add(1, Ordering::Relaxed);
            }
            Event::Hello(_) | Event::Tick(_) => {}
        }
    }
}

async fn first_volume(mut volumes: Volumes, errors: &AtomicU64) {
    let first = async {
        loop {
            match volumes.next().await {
                Some(VolumeEvent::Volume { .. }) => return true,
                Some(VolumeEvent::Error { .. }) => {
                    errors.fetch_add(1, Ordering::Relaxed);
                }
                Some(_) => {}
                None => return false,
            }
        }
    };
    if timeout(FIRST_WITHIN, first).await != Ok(true) {
        errors.fetch_add(1, Ordering::Relaxed);
    }
}

/// Resident memory of a process, MiB, where `/proc` tells it.
pub fn resident_mib(pid: u32) -> Option<f64> {
    let path: PathBuf = ["/proc", &pid.to_string(), "status"].iter().collect();
    let status = std::fs::read_to_string(path).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / 1024.0)
}

impl std::fmt::Display for LoadReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (what, t) in [("without load", self.quiet), ("with load", self.loaded)] {
            writeln!(
                f,
                "ticks {what}: {} publications, {:.1} ms apart, jitter {:.1} %, longest gap {:.1} ms, {:.2} ticks each",
                t.count,
                1e3 * t.mean_s,
                100.0 * t.jitter,
                1e3 * t.longest_s,
                t.ticks_each
            )?;
        }
        let [least, mean] = self.volumes_per_s;
        let [bytes, bytes_max] = self.bytes_per_s;
        writeln!(
            f,
            "a subscriber: {mean:.2} volumes/s (least {least:.2}), {:.1} kB/s (most {:.1}), age on arrival {:.1} ms (longest {:.0})",
            bytes / 1e3,
            bytes_max / 1e3,
            1e3 * self.age_s[0],
            1e3 * self.age_s[1]
        )?;
        writeln!(f, "a slow reader: {:.2} volumes/s", self.slow_volumes_per_s)?;
        writeln!(f, "a frame viewer: {:.2} frames/s", self.frames_per_s)?;
        writeln!(
            f,
            "storm: all are back after {:.2} s; errors met in all: {}",
            self.storm_s, self.errors
        )?;
        if let Some([before, filled, at_end, after]) = self.resident_mib {
            writeln!(
                f,
                "server's memory, MiB: {before:.1} before, {filled:.1} at half of the load, {at_end:.1} at its end, {after:.1} after the storm"
            )?;
        }
        Ok(())
    }
}
