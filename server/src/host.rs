//! A world's life: one OS thread owns it, paces its ticks, takes commands and publishes what it made.
//!
//! Readers hold a `tokio::sync::watch` receiver of immutable [`Published`] values, so a slow reader sees the newest one
//! when it comes back and never holds a tick up.

pub mod renderer;

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::sync::watch;
use welkin_proto::geography::Geography;
use welkin_proto::report::BaseStateReport;
use welkin_proto::scene::Effects;
use welkin_proto::wire::{Command, PlanReport, WorldSummary};
use welkin_proto::{ApiError, Scene, validate};

use crate::change::Change;
use crate::machine::Machine;
use crate::past_sky::{KeptSky, PastSky};
use crate::picture::{self, StageTime};
use crate::sample::When;
use crate::watchdog::Fault;
use crate::weather::{self, Desk, FieldSet, Past, Reach, Weather, WeatherInterest};
use crate::world::{Snapshot, World};

/// While the world runs as fast as it can, it publishes when this much wall time has gone by.
const PUBLISH_EVERY: Duration = Duration::from_millis(150);
/// A tick that is done before its world's pace needs it is published when most ticks of late were done, so that publications follow each other evenly; but
/// no later than this share of the period.
const HOLD_SHARE_MAX: f64 = 0.8;
/// How fast the time that ticks are held for falls when they take less.
const HOLD_FALLS: f64 = 0.05;
/// The measured speed is a mean over this much wall time.
const SPEED_WINDOW: Duration = Duration::from_secs(4);

/// Nobody waits longer for a weather: a tick that takes longer is a large world's.
pub const WEATHER_WITHIN: Duration = Duration::from_secs(20);

/// What a world shows of itself, immutable.
#[derive(Clone, Debug)]
pub struct Published {
    /// Counts publications from 0. It rises where the tick may stand still, such as when the sun is moved while paused.
    pub revision: u64,
    /// When it was published.
    pub at: Instant,
    /// The world's state; its numbers have the host's part filled in.
    pub snapshot: Snapshot,
    /// The fields that were wanted of its weather; none where nobody wanted any.
    pub wanted: Option<FieldSet>,
    /// Its weather, where it is wanted and the device gives it. A lost device leaves the last one, which says of which tick it is.
    pub weather: Option<Arc<Weather>>,
    /// Weathers of the moments before, and this one last; empty where none is wanted.
    pub past: Past,
}

/// What a viewer needs of a world; cheap to clone, and does not keep the world alive.
#[derive(Clone)]
pub struct View {
    /// The world's id.
    pub id: Arc<str>,
    /// Its scene.
    pub scene: Arc<Scene>,
    /// Where its box stands on Earth.
    pub geography: Geography,
    /// The newest publication; closed once the world has stopped.
    pub published: watch::Receiver<Arc<Published>>,
    commands: mpsc::Sender<Order>,
    frame_ms_bits: Arc<AtomicU64>,
    view_times: Arc<Mutex<Vec<StageTime>>>,
    machine: Arc<Machine>,
    device: Arc<str>,
    attention: Arc<Mutex<Attention>>,
    desk: Arc<Desk>,
    past_sky: Arc<PastSky>,
}

/// Who looks at a world.
struct Attention {
    streams: usize,
    last: Instant,
}

/// Counts a viewer as long as it lives.
pub struct Looking(View);

impl Drop for Looking {
    fn drop(&mut self) {
        let mut attention = self.0.attention();
        attention.streams -= 1;
        attention.last = Instant::now();
    }
}

impl View {
    fn attention(&self) -> MutexGuard<'_, Attention> {
        self.attention.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes that somebody has looked.
    pub fn looked_at(&self) {
        self.attention().last = Instant::now();
    }

    /// Notes that somebody looks on until the returned value is dropped.
    pub fn look(&self) -> Looking {
        self.attention().streams += 1;
        Looking(self.clone())
    }

    /// Wants the world's whole weather, with the last moments: as long as the returned value lives, and [`LINGER`](crate::weather::LINGER) longer, each
    /// publication carries it, and the first is made at once, also in a paused world.
    pub fn want_weather(&self) -> WeatherInterest {
        self.want_fields(FieldSet::ALL, Reach::Past)
    }

    /// The same for some of the state's fields, which saves the copies of the others, and with or without the last moments.
    pub fn want_fields(&self, fields: FieldSet, reach: Reach) -> WeatherInterest {
        let interest = self.desk.want(fields, reach);
        let there = self.published.borrow().wanted.is_some_and(|w| w.covers(fields));
        if !there {
            // A world that has stopped closes `published`, which whoever waits for the weather sees.
            let _ = self.commands.send(Order::ShowWeather);
        }
        interest
    }

    /// Sets how many bytes of past weathers the world may keep.
    pub fn set_past_bytes_max(&self, bytes: usize) {
        self.desk.set_past_bytes_max(bytes);
    }

    /// Waits for the newest publication that carries the fields of a live wish.
    ///
    /// Errors: `world_stopped`; `weather_unavailable` where the device is lost or nothing came within [`WEATHER_WITHIN`].
    pub async fn weather(&self, fields: FieldSet) -> Result<Arc<Published>, ApiError> {
        let mut published = self.published.clone();
        let there = published.wait_for(|p| p.wanted.is_some_and(|w| w.covers(fields)));
        let unavailable = |why| ApiError::new("weather_unavailable", why);
        let found = match tokio::time::timeout(WEATHER_WITHIN, there).await {
            Ok(Ok(found)) => Arc::clone(&found),
            Ok(Err(_)) => return Err(world_stopped()),
            Err(_) => return Err(unavailable("the world is busy with a long tick; try again")),
        };
        match &found.weather {
            Some(weather) if weather.held().covers(fields) => Ok(found),
            _ => Err(unavailable("the device that the world ran on is lost")),
        }
    }

    /// The sky of its last minutes.
    pub fn past_sky(&self) -> &PastSky {
        &self.past_sky
    }

    /// The kept sky of a moment; none for now. Errors: those of [`PastSky::find`].
    pub fn past_at(&self, when: When) -> Result<Option<Arc<KeptSky>>, ApiError> {
        if when == When::Now {
            return Ok(None);
        }
        let now_s = self.newest().snapshot.numbers.simulated_s;
        self.past_sky().find(when, now_s).map(Some)
    }

    /// How long nobody has looked.
    pub fn idle(&self) -> Duration {
        let attention = self.attention();
        match attention.streams {
            0 => attention.last.elapsed(),
            _ => Duration::ZERO,
        }
    }

    /// What the world runs on.
    pub fn device(&self) -> &str {
        self.device.as_ref()
    }

    /// The newest publication.
    pub fn newest(&self) -> Arc<Published> {
        self.published.borrow().clone()
    }

    /// Whether the world's thread still runs.
    pub fn is_running(&self) -> bool {
        self.published.has_changed().is_ok()
    }

    /// Checks a command and hands it to the world's thread, which takes it before its next tick.
    ///
    /// Errors: `out_of_range` with a pointer into the command, `world_stopped`.
    pub fn command(&self, command: Command) -> Result<(), ApiError> {
        validate::command(&command)?;
        if let Command::Effects { effects } = &command {
            // Judged here, so that whoever asks is told; what can fail later is memory.
            Change::judge(&self.newest().snapshot.scene, effects.as_ref().clone(), &self.machine)?;
        }
        self.commands.send(Order::Command(command)).map_err(|_| world_stopped())
    }

    /// The plan with what its passes and the view's stages have cost so far.
    pub fn plan(&self) -> PlanReport {
        let newest = self.newest();
        let mut plan = newest.snapshot.plan.as_ref().clone();
        newest.snapshot.timings.put(&mut plan);
        let times = self.view_times.lock().unwrap_or_else(PoisonError::into_inner);
        picture::put_times(&mut plan, &times);
        plan
    }

    /// Tells the world what the stages of its pictures have cost so far.
    fn set_view_times(&self, times: &[StageTime]) {
        let mut kept = self.view_times.lock().unwrap_or_else(PoisonError::into_inner);
        kept.clear();
        kept.extend_from_slice(times);
    }

    /// Tells the world what its last frame took; shown in the next publication.
    fn set_frame_ms(&self, frame_ms: f64) {
        self.frame_ms_bits.store(frame_ms.to_bits(), Ordering::Relaxed);
    }
}

/// A running world. Dropping it stops the thread and waits for it.
pub struct Host {
    view: View,
    base_state: BaseStateReport,
    thread: Mutex<Option<JoinHandle<()>>>,
}

enum Order {
    Command(Command),
    /// Other effects are ready, or could not be made.
    Adopt(Box<Result<Change, ApiError>>),
    Fault(Fault),
    /// Somebody wants weather that the newest publication does not carry.
    ShowWeather,
    Stop,
}

impl Host {
    /// Starts a world on a thread of its own and returns once its first state is published. Blocks meanwhile, so call it off
    /// the async workers.
    ///
    /// Errors: those of [`World::new`]; `internal` where no thread can be started.
    pub fn spawn(id: &str, scene: Scene, machine: impl Into<Machine>) -> Result<Host, ApiError> {
        let machine = machine.into();
        let (commands, orders) = mpsc::channel();
        let (ready, started) = mpsc::sync_channel(1);
        let frame_ms_bits = Arc::new(AtomicU64::new(f64::NAN.to_bits()));
        let frame_ms = frame_ms_bits.clone();
        let name = id.to_owned();
        let theirs = machine.clone();
        let to_itself = commands.clone();
        let desk = Arc::new(Desk::default());
        let its_desk = Arc::clone(&desk);
        let thread = std::thread::Builder::new()
            .name(format!("world-{id}"))
            .spawn(move || {
                let world = match World::new(scene, theirs) {
                    Ok(world) => world,
                    Err(error) => {
                        let _ = ready.send(Err(error)); // the spawner waits for it and cannot be gone
                        return;
                    }
                };
                let base_state = world.base_state().report.clone();
                let device = Arc::from(world.device().name());
                let pool = Arc::clone(world.pool());
                let (mut runner, published) = Runner::new(world, frame_ms, to_itself, its_desk);
                let scene = Arc::new(runner.world.scene().clone());
                if ready.send(Ok((scene, base_state, published, device))).is_ok() {
                    // The whole life on the world's own threads: no tick is handed over to them.
                    pool.install(move || runner.run(&orders));
                }
                tracing::info!(world = name, "world stopped");
            })
            .map_err(|error| {
                tracing::error!(%error, "cannot start a world's thread");
                ApiError::new("internal", "the world could not be started")
            })?;
        let (scene, base_state, published, device) = match started.recv() {
            Ok(Ok(parts)) => parts,
            Ok(Err(error)) => return Err(error),
            Err(_) => {
                tracing::error!(world = id, "the world's thread died while it started");
                return Err(ApiError::new("internal", "the world could not be started"));
            }
        };
        let view = View {
            id: id.into(),
            geography: Geography::new(&scene.domain, base_state.surface_altitude_m),
            scene,
            published,
            commands,
            frame_ms_bits,
            view_times: Arc::default(),
            machine: Arc::new(machine),
            device,
            attention: Arc::new(Mutex::new(Attention {
                streams: 0,
                last: Instant::now(),
            })),
            desk,
            past_sky: Arc::default(),
        };
        Ok(Host {
            view,
            base_state,
            thread: Mutex::new(Some(thread)),
        })
    }

    /// What viewers get.
    pub fn view(&self) -> &View {
        &self.view
    }

    /// What the scene's base state came to: lifting condensation level, CAPE and so on.
    pub fn base_state(&self) -> &BaseStateReport {
        &self.base_state
    }

    /// One line on this world.
    pub fn summary(&self) -> WorldSummary {
        let newest = self.view.newest();
        WorldSummary {
            id: self.view.id.to_string(),
            scene: self.view.scene.name.clone(),
            cells: self.view.scene.domain.cells,
            device: self.view.device().to_owned(),
            numbers: newest.snapshot.numbers.clone(),
        }
    }

    /// Plants a fault in the running world, to prove its watchdog: for tests; nothing on the wire does it.
    pub fn inject(&self, fault: Fault) -> Result<(), ApiError> {
        self.view
            .commands
            .send(Order::Fault(fault))
            .map_err(|_| world_stopped())
    }

    /// Stops the thread and waits for it: at most one tick. Streams of this world end. Does nothing the second time.
    pub fn shut_down(&self) {
        let _ = self.view.commands.send(Order::Stop); // gone already is as good
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        if thread.is_some_and(|t| t.join().is_err()) {
            tracing::error!(world = %self.view.id, "the world's thread panicked");
        }
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        self.shut_down();
    }
}

fn world_stopped() -> ApiError {
    ApiError::new("world_stopped", "the world has stopped")
}

/// The thread's side: the world, its clock and what was measured of it.
struct Runner {
    world: World,
    publisher: watch::Sender<Arc<Published>>,
    /// For what other threads make ready for the world.
    orders: mpsc::Sender<Order>,
    revision: u64,
    frame_ms_bits: Arc<AtomicU64>,
    desk: Arc<Desk>,
    /// Whether the state has changed since its weather was copied last.
    changed: bool,
    paused: bool,
    time_scale: f64,
    speed: SpeedMeter,
    /// What the slowest ticks of late took.
    hold: Duration,
    /// When the newest tick is to be published; none where it is.
    publish_at: Option<Instant>,
}

impl Runner {
    fn new(
        world: World,
        frame_ms_bits: Arc<AtomicU64>,
        orders: mpsc::Sender<Order>,
        desk: Arc<Desk>,
    ) -> (Self, watch::Receiver<Arc<Published>>) {
        let time_scale = world.scene().time.time_scale;
        let first = Arc::new(Published {
            revision: 0,
            at: Instant::now(),
            snapshot: world.snapshot(),
            wanted: None,
            weather: None,
            past: Arc::default(),
        });
        let (publisher, published) = watch::channel(first);
        let speed = SpeedMeter::default();
        let mut runner = Self {
            world,
            publisher,
            orders,
            revision: 0,
            frame_ms_bits,
            desk,
            changed: true,
            paused: false,
            time_scale,
            speed,
            hold: Duration::ZERO,
            publish_at: None,
        };
        runner.publish();
        (runner, published)
    }

    fn publish(&mut self) {
        self.publish_at = None;
        self.world.settle();
        self.revision += 1;
        let spinning_up = self.world.spinning_up();
        let mut snapshot = self.world.snapshot();
        if snapshot.volume.is_none() && snapshot.scene.effects.moisture.is_some() {
            // A device that was lost gives no cloud any more: the last one stays in sight.
            snapshot.volume = self.publisher.borrow().snapshot.volume.clone();
        }
        let numbers = &mut snapshot.numbers;
        let frame_ms = f64::from_bits(self.frame_ms_bits.load(Ordering::Relaxed));
        numbers.frame_ms = frame_ms.is_finite().then_some(frame_ms);
        numbers.paused = self.paused;
        numbers.time_scale = self.time_scale;
        numbers.spinning_up = spinning_up;
        numbers.speed = if self.paused {
            0.0
        } else {
            self.speed.simulated_s_per_wall_s()
        };
        let wanted = self.desk.wanted();
        let (weather, past) = match wanted {
            None => (None, Arc::default()),
            Some(fields) => self.weather(fields, &snapshot),
        };
        self.publisher.send_replace(Arc::new(Published {
            revision: self.revision,
            at: Instant::now(),
            snapshot,
            wanted,
            weather,
            past,
        }));
    }

    /// The weather that belongs to `snapshot`, copied unless the last one is of the same state and holds enough, and the past with it.
    fn weather(&mut self, fields: FieldSet, snapshot: &Snapshot) -> (Option<Arc<Weather>>, Past) {
        let last = Arc::clone(&self.publisher.borrow());
        if !self.changed && last.weather.as_ref().is_some_and(|w| w.held().covers(fields)) {
            return (last.weather.clone(), Arc::clone(&last.past));
        }
        let Some(copied) = self.world.weather(fields, snapshot.volume.clone()) else {
            return (last.weather.clone(), Arc::clone(&last.past));
        };
        self.changed = false;
        let weather = Arc::new(Weather::new(copied, self.revision));
        let bytes_max = if self.desk.past_wanted() {
            self.desk.past_bytes_max()
        } else {
            0
        };
        let past = weather::remember(&last.past, &weather, bytes_max);
        (Some(weather), past)
    }

    /// Wall time that one tick should take; `None` runs flat out.
    fn period(&self) -> Option<Duration> {
        let period_s = self.world.scene().time.tick_s / self.time_scale;
        if self.world.spinning_up() {
            None
        } else {
            Duration::try_from_secs_f64(period_s).ok()
        }
    }

    /// Publishes a tick that began then, or says when.
    fn publish_evenly(&mut self, began: Instant, period: Duration) {
        let took = began.elapsed();
        self.hold = took.max(self.hold.mul_f64(1.0 - HOLD_FALLS) + took.mul_f64(HOLD_FALLS));
        let at = began + self.hold.min(period.mul_f64(HOLD_SHARE_MAX));
        if at > Instant::now() {
            self.publish_at = Some(at);
        } else {
            self.publish();
        }
    }

    fn run(&mut self, orders: &mpsc::Receiver<Order>) {
        self.speed.mark(self.world.simulated_s());
        let mut tick_began: Option<Instant> = None;
        loop {
            // What a paused world waits for is the next order; a world that is ahead of its clock waits for whichever is first.
            let wait = match (self.paused, tick_began, self.period()) {
                _ if self.publish_at.is_some() => {
                    self.publish_at.map(|at| at.saturating_duration_since(Instant::now()))
                }
                (true, _, _) => self.lapse(),
                (false, Some(began), Some(period)) => Some(period.saturating_sub(began.elapsed())),
                (false, _, _) => Some(Duration::ZERO),
            };
            let order = match wait {
                None => orders.recv().map_err(|_| mpsc::RecvTimeoutError::Disconnected),
                Some(Duration::ZERO) => orders.try_recv().map_err(|e| match e {
                    mpsc::TryRecvError::Empty => mpsc::RecvTimeoutError::Timeout,
                    mpsc::TryRecvError::Disconnected => mpsc::RecvTimeoutError::Disconnected,
                }),
                Some(wait) => orders.recv_timeout(wait),
            };
            match order {
                Ok(Order::Stop) | Err(mpsc::RecvTimeoutError::Disconnected) => return,
                Ok(Order::Adopt(made)) => match *made {
                    Ok(change) => {
                        self.world.adopt(change);
                        self.changed = true;
                        self.publish();
                    }
                    Err(error) => {
                        tracing::error!(%error, "other effects could not be made ready; the world goes on as it is")
                    }
                },
                Ok(Order::Fault(fault)) => self.world.inject(fault),
                Ok(Order::ShowWeather) => {
                    let shown = self.publisher.borrow().wanted;
                    let wanted = self.desk.wanted();
                    if wanted.is_some_and(|w| !shown.is_some_and(|s| s.covers(w))) {
                        self.publish();
                    }
                }
                Ok(Order::Command(command)) => {
                    self.obey(command);
                    self.publish();
                }
                Err(mpsc::RecvTimeoutError::Timeout) if self.publish_at.is_some() => self.publish(),
                Err(mpsc::RecvTimeoutError::Timeout) if self.paused => {
                    // Those who wanted the weather of a standing world have been gone for long enough: its memory is given back.
                    if self.desk.wanted().is_none() {
                        self.publish();
                    }
                }
                Err(mpsc::RecvTimeoutError::Timeout) => {
                    // Deadlines run from one tick's due time to the next, so that short oversleeping does not add up; a
                    // tick that is late by more than a period starts a new count instead of being caught up with.
                    let now = Instant::now();
                    tick_began = Some(match (tick_began, self.period()) {
                        (Some(began), Some(period)) if now < began + 2 * period => began + period,
                        _ => now,
                    });
                    let flat_out = self.period().is_none_or(|period| period < PUBLISH_EVERY / 8);
                    if flat_out {
                        self.world.tick_ahead();
                    } else {
                        self.world.tick();
                    }
                    self.changed = true;
                    self.speed.mark(self.world.simulated_s());
                    if self.world.is_halted() {
                        self.paused = true;
                        self.publish();
                        continue;
                    }
                    match self.period().filter(|_| !flat_out) {
                        Some(period) => self.publish_evenly(tick_began.unwrap_or(now), period),
                        None if self.publisher.borrow().at.elapsed() >= PUBLISH_EVERY => self.publish(),
                        None => {}
                    }
                }
            }
        }
    }

    /// How long a standing world waits for an order before it forgets weather that nobody wants any more; none: for ever.
    fn lapse(&self) -> Option<Duration> {
        self.publisher.borrow().wanted?;
        match self.desk.wanted() {
            None => Some(Duration::from_millis(1)),
            // A millisecond more, so that the wish is over when the time is.
            Some(_) => Some(self.desk.lapses_in().unwrap_or(weather::LINGER) + Duration::from_millis(1)),
        }
    }

    /// Makes other effects ready on a thread of its own; ticks go on meanwhile.
    fn prepare(&self, effects: Effects) {
        let (scene, machine) = (self.world.scene().clone(), self.world.machine().clone());
        let ready = self.orders.clone();
        let work = move || {
            let change = Change::prepare(&scene, effects, &machine);
            let _ = ready.send(Order::Adopt(Box::new(change))); // a world that has stopped needs none
        };
        if let Err(error) = std::thread::Builder::new().name("effects".into()).spawn(work) {
            tracing::error!(%error, "cannot start a thread for other effects");
        }
    }

    fn obey(&mut self, command: Command) {
        match command {
            Command::Pause {} => self.paused = true,
            Command::Resume {} if self.paused => {
                self.paused = false;
                self.world.resume();
                self.speed = SpeedMeter::default();
                self.speed.mark(self.world.simulated_s());
            }
            Command::Resume {} => {}
            Command::TimeScale { time_scale } => self.time_scale = time_scale,
            Command::Sun { sun } => self.world.set_sun(sun),
            Command::Wind { add_x_m_s, add_y_m_s } => {
                self.world.add_wind(add_x_m_s, add_y_m_s);
                self.changed = true;
            }
            Command::Effects { effects } => self.prepare(*effects),
        }
    }
}

/// Simulated seconds a wall second over the last [`SPEED_WINDOW`].
#[derive(Default)]
struct SpeedMeter {
    marks: VecDeque<(Instant, f64)>,
}

impl SpeedMeter {
    fn mark(&mut self, simulated_s: f64) {
        let now = Instant::now();
        // A world that went back to an earlier state starts a new count.
        if self.marks.back().is_some_and(|last| last.1 > simulated_s) {
            self.marks.clear();
        }
        self.marks.push_back((now, simulated_s));
        // One mark older than the window stays, so that ticks longer than the window are measured too.
        while self.marks.len() > 2 && self.marks.get(1).is_some_and(|m| now - m.0 > SPEED_WINDOW) {
            self.marks.pop_front();
        }
    }

    fn simulated_s_per_wall_s(&self) -> f64 {
        match (self.marks.front(), self.marks.back()) {
            (Some(first), Some(last)) if last.0 > first.0 => (last.1 - first.1) / (last.0 - first.0).as_secs_f64(),
            _ => 0.0,
        }
    }
}
