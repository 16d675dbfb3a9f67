//! What all requests share: the worlds, the renderer, the limits.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};
use std::time::{Duration, Instant};

use tokio::sync::{Semaphore, oneshot};
use welkin_proto::{ApiError, Scene};

use super::error::internal;
use crate::host::Host;
use crate::host::renderer::RenderService;
use crate::limits::Limits;
use crate::machine::Machine;
use crate::past_sky;
use crate::volume::VolumeService;

/// Idle worlds are looked for ten times in the time that they have, but no more and no less often than this.
const IDLE_CHECK_MIN: Duration = Duration::from_millis(50);
const IDLE_CHECK_MAX: Duration = Duration::from_secs(30);

/// Shared by every request; cheap to clone.
#[derive(Clone)]
pub struct AppState {
    shared: Arc<Shared>,
}

struct Shared {
    limits: Limits,
    machine: Machine,
    started: Instant,
    worlds: Mutex<Worlds>,
    streams: AtomicUsize,
    renders: Arc<Semaphore>,
    samplings: Arc<Semaphore>,
    renderer: RenderService,
    volumes: VolumeService,
    starter: Starter,
}

#[derive(Default)]
struct Worlds {
    running: BTreeMap<u64, Arc<Host>>,
    /// Those that stop when nobody looks.
    passing: BTreeSet<u64>,
    starting: usize,
    made: u64,
}

/// Starts worlds from a thread that has not stepped back ([`crate::priority`]): a world's threads inherit the priority of whoever starts them.
struct Starter {
    orders: mpsc::Sender<Start>,
}

struct Start {
    name: String,
    scene: Scene,
    machine: Machine,
    started: oneshot::Sender<Result<Host, ApiError>>,
}

impl Starter {
    /// The thread inherits the caller's priority and ends with the server. Errors: those of the operating system.
    fn new() -> std::io::Result<Self> {
        let (orders, asked) = mpsc::channel::<Start>();
        let serve = move || {
            for start in asked {
                let failed = start.name.clone();
                let work = move || {
                    let host = Host::spawn(&start.name, start.scene, start.machine);
                    let _ = start.started.send(host); // a server that has stopped needs no world
                };
                // A thread each: a large world takes long to begin, and others need not wait for it. The answer of one that
                // cannot be started is its sender's end.
                if let Err(error) = std::thread::Builder::new().name("world-start".into()).spawn(work) {
                    tracing::error!(%error, world = failed, "cannot start a thread for a world");
                }
            }
        };
        std::thread::Builder::new().name("starter".into()).spawn(serve)?;
        Ok(Self { orders })
    }

    /// Errors: those of [`Host::spawn`].
    async fn start(&self, name: String, scene: Scene, machine: Machine) -> Result<Host, ApiError> {
        let (started, host) = oneshot::channel();
        let order = Start {
            name,
            scene,
            machine,
            started,
        };
        self.orders.send(order).map_err(internal)?;
        host.await.map_err(internal)?
    }
}

/// Counts a stream as long as it lives.
pub struct StreamPermit(AppState);

impl Drop for StreamPermit {
    fn drop(&mut self) {
        self.0.shared.streams.fetch_sub(1, Ordering::Relaxed);
    }
}

impl AppState {
    /// A server without worlds. `machine` is what every world computes on.
    ///
    /// Errors: `internal` where the render thread cannot be started.
    pub fn new(limits: Limits, machine: impl Into<Machine>) -> Result<Self, ApiError> {
        let machine = machine.into();
        let shared = Shared {
            renderer: RenderService::start(machine.compute.clone(), limits.viewer_share).map_err(internal)?,
            machine,
            started: Instant::now(),
            worlds: Mutex::new(Worlds::default()),
            streams: AtomicUsize::new(0),
            renders: Arc::new(Semaphore::new(limits.renders_max)),
            samplings: Arc::new(Semaphore::new(limits.samplings_max)),
            volumes: VolumeService::default(),
            starter: Starter::new().map_err(internal)?,
            limits,
        };
        Ok(Self {
            shared: Arc::new(shared),
        })
    }

    /// The server's limits.
    pub fn limits(&self) -> &Limits {
        &self.shared.limits
    }

    /// What worlds compute on.
    pub fn machine(&self) -> &Machine {
        &self.shared.machine
    }

    /// When the server started.
    pub fn started(&self) -> Instant {
        self.shared.started
    }

    /// The service that renders frames of running worlds.
    pub fn renderer(&self) -> &RenderService {
        &self.shared.renderer
    }

    /// The service that encodes volumes of running worlds.
    pub fn volumes(&self) -> &VolumeService {
        &self.shared.volumes
    }

    /// Permits for renders of scenes of their own.
    pub fn renders(&self) -> &Arc<Semaphore> {
        &self.shared.renders
    }

    /// Permits for sampling.
    pub fn samplings(&self) -> &Arc<Semaphore> {
        &self.shared.samplings
    }

    /// Open streams.
    pub fn stream_count(&self) -> usize {
        self.shared.streams.load(Ordering::Relaxed)
    }

    fn worlds_locked(&self) -> MutexGuard<'_, Worlds> {
        self.shared.worlds.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// All worlds, oldest first.
    pub fn worlds(&self) -> Vec<Arc<Host>> {
        self.worlds_locked().running.values().cloned().collect()
    }

    /// The world of that id; `unknown_world`.
    pub fn world(&self, id: &str) -> Result<Arc<Host>, ApiError> {
        let number = id.strip_prefix('w').and_then(|number| number.parse().ok());
        let found = number.and_then(|number: u64| self.worlds_locked().running.get(&number).cloned());
        found.filter(|host| *host.view().id == *id).ok_or_else(|| {
            ApiError::new(
                "unknown_world",
                format!("there is no world {id:?}; GET /v1/worlds lists them"),
            )
        })
    }

    /// Starts a world that stays until it is deleted and returns once its first state is there. Its id is new, never one that was used
    /// before.
    ///
    /// Errors: `too_many_worlds`, those of [`Host::spawn`].
    pub async fn create_world(&self, scene: Scene) -> Result<Arc<Host>, ApiError> {
        self.start_world(scene, true).await
    }

    /// The same for a visitor's world, which stops when nobody has looked at it for the time that the limits give.
    ///
    /// Errors: those of [`AppState::create_world`].
    pub async fn create_passing_world(&self, scene: Scene) -> Result<Arc<Host>, ApiError> {
        self.start_world(scene, false).await
    }

    async fn start_world(&self, scene: Scene, stays: bool) -> Result<Arc<Host>, ApiError> {
        let most = self.shared.limits.worlds_max;
        let number = {
            let mut worlds = self.worlds_locked();
            if worlds.running.len() + worlds.starting >= most {
                let message = format!("{most} worlds run already, which is the limit; delete one first");
                return Err(ApiError::new("too_many_worlds", message));
            }
            worlds.starting += 1;
            worlds.made += 1;
            worlds.made
        };
        let machine = self.shared.machine.clone();
        let name = format!("w{number}");
        // The reservation is given back here and nowhere else: this task runs to its end even if the client leaves.
        let state = self.clone();
        let started = tokio::spawn(async move {
            let host = state.shared.starter.start(name, scene, machine).await.map(Arc::new);
            let mut worlds = state.worlds_locked();
            worlds.starting -= 1;
            if let Ok(host) = &host {
                let most = state.shared.limits.past_weather_bytes_max;
                host.view().set_past_bytes_max(most);
                let (volumes, limits) = (state.shared.volumes.clone(), state.shared.limits.clone());
                tokio::spawn(past_sky::keep(volumes, host.view().clone(), limits));
                worlds.running.insert(number, host.clone());
                if !stays {
                    worlds.passing.insert(number);
                }
            }
            host
        });
        started.await.map_err(internal)?
    }

    /// Stops a world and waits until it has stopped; its streams end.
    ///
    /// Errors: `unknown_world`.
    pub async fn delete_world(&self, id: &str) -> Result<(), ApiError> {
        let host = self.world(id)?;
        {
            let mut worlds = self.worlds_locked();
            let Worlds { running, passing, .. } = &mut *worlds;
            running.retain(|_, running| !Arc::ptr_eq(running, &host));
            passing.retain(|number| running.contains_key(number));
        }
        self.shared.renderer.forget(&host.view().id);
        tokio::task::spawn_blocking(move || host.shut_down())
            .await
            .map_err(internal)
    }

    /// Stops visitors' worlds as they fall idle, for ever; returns at once where the limits keep them.
    pub async fn stop_idle_worlds(&self) {
        let Some(most) = Duration::try_from_secs_f64(self.shared.limits.idle_world_s)
            .ok()
            .filter(|d| !d.is_zero())
        else {
            return;
        };
        let pause = (most / 10).clamp(IDLE_CHECK_MIN, IDLE_CHECK_MAX);
        loop {
            tokio::time::sleep(pause).await;
            let idle: Vec<Arc<Host>> = {
                let worlds = self.worlds_locked();
                let passing = worlds.passing.iter().filter_map(|number| worlds.running.get(number));
                passing.filter(|host| host.view().idle() > most).cloned().collect()
            };
            for host in idle {
                let id = &host.view().id;
                tracing::info!(world = %id, "nobody has looked at it for {:.0} s; it is stopped", most.as_secs_f64());
                // One that was deleted meanwhile has stopped already.
                let _ = self.delete_world(id).await;
            }
        }
    }

    /// Stops all worlds.
    pub async fn shut_down(&self) {
        for host in self.worlds() {
            // One that was deleted meanwhile has stopped already.
            let _ = self.delete_world(&host.view().id).await;
        }
    }

    /// Counts a stream in, or refuses it with `too_many_streams`.
    pub fn open_stream(&self) -> Result<StreamPermit, ApiError> {
        let most = self.shared.limits.streams_max;
        let before = self.shared.streams.fetch_add(1, Ordering::Relaxed);
        let permit = StreamPermit(self.clone());
        if before >= most {
            return Err(ApiError::new(
                "too_many_streams",
                format!("{most} streams are open, which is the limit"),
            ));
        }
        Ok(permit)
    }
}
