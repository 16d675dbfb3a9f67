//! One thread renders for every viewer of every world.
//!
//! The queue is bounded by design: a viewer waits for its answer before it asks again, and asking again while it waits
//! replaces what it asked for. Viewers who want the same picture share one, and a picture is taken of the newest state
//! at the moment when its turn comes, not of the state when it was asked for.
//!
//! Turns are taken in order, but a viewer whose picture took long rests for a while that is as long as its share of the time
//! asks for. Rests count only while somebody else waits: the thread never idles for them.

use std::collections::{HashMap, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::sync::oneshot;
use welkin_proto::wire::FrameFormat;
use welkin_proto::{ApiError, Camera};

use super::View;
use crate::machine::Compute;
use crate::methods;
use crate::past_sky::KeptSky;
use crate::picture::{self, LastPicture, Picture, Renderer, layers};
use crate::priority;

/// Pictures kept for viewers who ask for the one just made, in another coding or at the same tick.
const PICTURES_KEPT: usize = 4;
/// Coded frames kept.
const FRAMES_KEPT: usize = 16;
/// Viewers whose last picture is kept for the next, where pictures build on one another, and the bytes of all of them, in the host's memory and the GPU's.
const HISTORIES_KEPT: usize = 32;
const HISTORY_BYTES_MAX: usize = 128 << 20;
/// A last picture of longer ago than this, in simulated seconds, is of another sky.
const HISTORY_LASTS_S: f64 = 30.0;

/// What a viewer wants to see.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameRequest {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Coding.
    pub format: FrameFormat,
    /// Point of view.
    pub camera: Camera,
    /// Four rays a pixel and finer coding.
    pub still: bool,
    /// Every pixel is marched, whatever the scene's `view_sampling`: a picture on its own, not one of a stream.
    pub whole: bool,
    /// A kept moment to be drawn instead of the newest.
    pub past: Option<Arc<KeptSky>>,
    /// Layers in place of the picture.
    pub layers: Option<LayersWish>,
}

/// What is wanted of a picture's layers.
#[derive(Clone, Debug, PartialEq)]
pub enum LayersWish {
    /// Where the cloud is.
    Depth {
        /// As floats instead of PNG.
        raw: bool,
    },
    /// What lies before objects.
    Before {
        /// Their distances along the pixels' rays, m; one a pixel, rows from the top.
        objects_m: Arc<[f32]>,
        /// As floats instead of PNG.
        raw: bool,
    },
}

/// Who asks: tells viewers apart, so that the renderer's time can be shared among them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Viewer(u64);

impl Viewer {
    /// All who ask for single pictures, together.
    pub const SNAPSHOTS: Viewer = Viewer(0);
}

/// A viewer who is there. When it is dropped the viewer has left, and what is kept of the last picture is freed.
pub struct Present {
    /// The viewer.
    pub viewer: Viewer,
    shared: Arc<Shared>,
}

impl Drop for Present {
    fn drop(&mut self) {
        self.shared.lock().left.push(self.viewer);
        self.shared.wake.notify_one();
    }
}

/// A coded picture.
#[derive(Debug)]
pub struct Frame {
    /// What was asked for.
    pub request: FrameRequest,
    /// The world's publication that is shown.
    pub revision: u64,
    /// The tick that is shown.
    pub tick: u64,
    /// The simulated second that is shown.
    pub simulated_s: f64,
    /// When that publication was made.
    pub published_at: Instant,
    /// Wall milliseconds to render.
    pub render_ms: f64,
    /// Wall milliseconds to encode.
    pub encode_ms: f64,
    /// The coded image.
    pub bytes: Vec<u8>,
}

/// The answer to come.
pub struct Ticket {
    job: u64,
    /// Resolves to the frame; fails only if the service has stopped.
    pub answer: oneshot::Receiver<Result<Arc<Frame>, ApiError>>,
}

/// See the module.
pub struct RenderService {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    queue: Mutex<Queue>,
    wake: Condvar,
    viewers: AtomicU64,
    /// Bytes kept of viewers' last pictures.
    last_picture_bytes: AtomicUsize,
    /// Of the render thread's time, for one viewer while others wait.
    viewer_share: f64,
}

#[derive(Default)]
struct Queue {
    jobs: VecDeque<Job>,
    next_job: u64,
    forgotten: Vec<Arc<str>>,
    left: Vec<Viewer>,
    /// Until when those rest whose pictures took long.
    rests: HashMap<Viewer, Instant>,
    stop: bool,
}

impl Queue {
    /// The first job of a viewer who does not rest; where all rest, the one whose rest ends first.
    fn next(&mut self, now: Instant) -> Option<Job> {
        self.rests.retain(|_, until| *until > now);
        let rest = |job: &Job| job.waiters.iter().map(|w| self.rests.get(&w.viewer)).min().flatten();
        let next = (0..self.jobs.len()).min_by_key(|n| self.jobs.get(*n).and_then(rest))?;
        self.jobs.remove(next)
    }
}

struct Job {
    id: u64,
    world: View,
    request: FrameRequest,
    waiters: Vec<Waiter>,
}

struct Waiter {
    viewer: Viewer,
    sender: oneshot::Sender<Result<Arc<Frame>, ApiError>>,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl RenderService {
    /// Starts the render thread, which draws on `compute` and gives a viewer `viewer_share` of its time, 0.01 to 1, while others wait.
    ///
    /// Errors: those of the operating system.
    pub fn start(compute: Compute, viewer_share: f64) -> std::io::Result<Self> {
        let shared = Arc::new(Shared {
            queue: Mutex::new(Queue::default()),
            wake: Condvar::new(),
            viewers: AtomicU64::new(1),
            last_picture_bytes: AtomicUsize::new(0),
            viewer_share: viewer_share.clamp(0.01, 1.0),
        });
        let theirs = shared.clone();
        let thread = std::thread::Builder::new()
            .name("render".into())
            .spawn(move || render_loop(&theirs, compute))?;
        Ok(Self {
            shared,
            thread: Some(thread),
        })
    }

    /// A viewer apart from all others, there until it is dropped.
    pub fn viewer(&self) -> Present {
        Present {
            viewer: Viewer(self.shared.viewers.fetch_add(1, Ordering::Relaxed)),
            shared: self.shared.clone(),
        }
    }

    /// Bytes that are kept of viewers' last pictures for their next, in the host's memory and the GPU's.
    pub fn last_picture_bytes(&self) -> usize {
        self.shared.last_picture_bytes.load(Ordering::Relaxed)
    }

    /// Queues a frame; one that is the same as a waiting one is shared with it, and so is its cost.
    ///
    /// Errors: `busy` where `queued_max` frames wait already.
    pub fn request(
        &self,
        viewer: Viewer,
        world: &View,
        request: FrameRequest,
        queued_max: usize,
    ) -> Result<Ticket, ApiError> {
        let (sender, answer) = oneshot::channel();
        let waiter = Waiter { viewer, sender };
        let mut queue = self.shared.lock();
        if let Some(job) = queue
            .jobs
            .iter_mut()
            .find(|j| j.world.id == world.id && j.request == request)
        {
            job.waiters.push(waiter);
            return Ok(Ticket { job: job.id, answer });
        }
        if queue.jobs.len() >= queued_max {
            return Err(ApiError::new(
                "busy",
                format!("{queued_max} frames are waiting to be rendered; try again"),
            ));
        }
        let id = queue.next_job;
        queue.next_job += 1;
        queue.jobs.push_back(Job {
            id,
            world: world.clone(),
            request,
            waiters: vec![waiter],
        });
        drop(queue);
        self.shared.wake.notify_one();
        Ok(Ticket { job: id, answer })
    }

    /// Changes what a waiting ticket will get, in its place in the queue. Leaves it alone where the work has begun or is
    /// shared with another viewer.
    pub fn replace(&self, ticket: &Ticket, request: FrameRequest) {
        let mut queue = self.shared.lock();
        if let Some(job) = queue
            .jobs
            .iter_mut()
            .find(|j| j.id == ticket.job && j.waiters.len() == 1)
        {
            job.request = request;
        }
    }

    /// Drops what is kept for a world that is gone.
    pub fn forget(&self, world: &Arc<str>) {
        self.shared.lock().forgotten.push(world.clone());
        self.shared.wake.notify_one();
    }
}

impl Drop for RenderService {
    fn drop(&mut self) {
        self.shared.lock().stop = true;
        self.shared.wake.notify_one();
        if self.thread.take().is_some_and(|t| t.join().is_err()) {
            tracing::error!("the render thread panicked");
        }
    }
}

struct PictureKey {
    world: Arc<str>,
    revision: u64,
    camera: Camera,
    size: [u32; 2],
    still: bool,
    whole: bool,
    past: bool,
}

impl PictureKey {
    fn is(&self, world: &View, revision: u64, request: &FrameRequest) -> bool {
        self.world == world.id
            && self.revision == revision
            && self.size == [request.width, request.height]
            && self.camera == request.camera
            && self.still == request.still
            && self.whole == request.whole
            && self.past == request.past.is_some()
    }
}

/// What the render thread keeps between frames.
struct Kept {
    compute: Compute,
    /// A world's, and another for its past, so that whoever looks back does not undo what is made ready for the others.
    renderers: HashMap<(Arc<str>, bool), Renderer>,
    pictures: VecDeque<(PictureKey, Arc<Picture>)>,
    frames: VecDeque<(PictureKey, FrameFormat, Arc<Frame>)>,
    /// What viewers' last pictures leave to their next, the one used last at the end.
    histories: Vec<Lasting>,
}

/// What a viewer's last picture leaves to the next.
struct Lasting {
    viewer: Viewer,
    world: Arc<str>,
    simulated_s: f64,
    last: LastPicture,
}

fn bytes_of(all: &[Lasting]) -> usize {
    all.iter().map(|h| h.last.bytes()).sum()
}

fn render_loop(shared: &Shared, compute: Compute) {
    priority::step_back(priority::DRAWING);
    let mut kept = Kept {
        compute,
        renderers: HashMap::new(),
        pictures: VecDeque::new(),
        frames: VecDeque::new(),
        histories: Vec::new(),
    };
    loop {
        let mut queue = shared.lock();
        let job = loop {
            for world in std::mem::take(&mut queue.forgotten) {
                kept.forget(&world);
            }
            for viewer in std::mem::take(&mut queue.left) {
                kept.histories.retain(|h| h.viewer != viewer);
            }
            shared
                .last_picture_bytes
                .store(bytes_of(&kept.histories), Ordering::Relaxed);
            if queue.stop {
                return;
            }
            match queue.next(Instant::now()) {
                Some(job) => break job,
                None => queue = shared.wake.wait(queue).unwrap_or_else(PoisonError::into_inner),
            }
        };
        drop(queue);
        // One who is still there: what is kept for one who has left would stay.
        let Some(viewer) = job.waiters.iter().find(|w| !w.sender.is_closed()).map(|w| w.viewer) else {
            continue; // every viewer has left
        };
        let began = Instant::now();
        let frame =
            catch_unwind(AssertUnwindSafe(|| kept.frame(&job.world, &job.request, viewer))).unwrap_or_else(|_| {
                tracing::error!(world = %job.world.id, request = ?job.request, "the renderer panicked");
                kept.forget(&job.world.id);
                Err(ApiError::new("internal", "the frame could not be rendered"))
            });
        let own = began.elapsed().div_f64(job.waiters.len() as f64);
        let rest = own.mul_f64(1.0 / shared.viewer_share - 1.0);
        let now = Instant::now();
        if rest > Duration::ZERO {
            let mut queue = shared.lock();
            for waiter in &job.waiters {
                queue.rests.insert(waiter.viewer, now + rest);
            }
        }
        for waiter in job.waiters {
            let _ = waiter.sender.send(frame.clone()); // a viewer who has left needs nothing
        }
    }
}

impl Kept {
    fn forget(&mut self, world: &Arc<str>) {
        self.renderers.retain(|(id, _), _| id != world);
        self.pictures.retain(|(key, _)| key.world != *world);
        self.frames.retain(|(key, _, _)| key.world != *world);
        self.histories.retain(|h| h.world != *world);
    }

    /// What the viewer's last picture of that world has left, taken out; nothing of a sky of another time.
    fn history(&mut self, viewer: Viewer, world: &Arc<str>, simulated_s: f64) -> LastPicture {
        let found = self
            .histories
            .iter()
            .position(|h| h.viewer == viewer && h.world == *world);
        let Some(found) = found else {
            return LastPicture::default();
        };
        let mut lasting = self.histories.remove(found);
        if !(0.0..=HISTORY_LASTS_S).contains(&(simulated_s - lasting.simulated_s)) {
            lasting.last.forget();
        }
        lasting.last
    }

    /// Keeps what a picture leaves, and drops what was used longest ago where that is too much.
    fn keep_history(&mut self, viewer: Viewer, world: Arc<str>, simulated_s: f64, last: LastPicture) {
        self.histories.push(Lasting {
            viewer,
            world,
            simulated_s,
            last,
        });
        while self.histories.len() > HISTORIES_KEPT
            || (self.histories.len() > 1 && bytes_of(&self.histories) > HISTORY_BYTES_MAX)
        {
            self.histories.remove(0);
        }
    }

    fn frame(&mut self, world: &View, request: &FrameRequest, viewer: Viewer) -> Result<Arc<Frame>, ApiError> {
        let published = world.newest();
        let past = request.past.as_ref();
        let (revision, published_at) =
            past.map_or((published.revision, published.at), |p| (p.revision, p.published_at));
        if let Some(wish) = &request.layers {
            return self.layers(world, request, wish, (revision, published_at));
        }
        let key = || PictureKey {
            world: world.id.clone(),
            revision,
            camera: request.camera.clone(),
            size: [request.width, request.height],
            still: request.still,
            whole: request.whole,
            past: past.is_some(),
        };
        let same = |(k, format, _): &&(PictureKey, FrameFormat, Arc<Frame>)| {
            *format == request.format && k.is(world, revision, request)
        };
        if let Some((_, _, frame)) = self.frames.iter().find(same) {
            return Ok(frame.clone());
        }
        let picture = match self.pictures.iter().find(|(k, _)| k.is(world, revision, request)) {
            Some((_, picture)) => picture.clone(),
            None => {
                let kept = past.map(|p| p.snapshot()).transpose()?;
                let snapshot = kept.as_ref().unwrap_or(&published.snapshot);
                let simulated_s = snapshot.numbers.simulated_s;
                let size = [request.width, request.height];
                // The past has no viewers who go on from picture to picture.
                let live = !request.whole && !request.still && past.is_none();
                let builds = live && methods::view_sampling(&snapshot.scene).builds_on_last();
                let mut last = if builds {
                    self.history(viewer, &world.id, simulated_s)
                } else {
                    LastPicture::default()
                };
                let renderer = self
                    .renderers
                    .entry((world.id.clone(), past.is_some()))
                    .or_insert_with(|| Renderer::new(&self.compute));
                let (scene, camera) = (&snapshot.scene, &request.camera);
                let picture = Arc::new(if live {
                    renderer.live(snapshot, scene, camera, size, &mut last)?
                } else {
                    renderer.render(snapshot, scene, camera, size, request.still)?
                });
                world.set_frame_ms(picture.render_ms);
                if past.is_none() {
                    world.set_view_times(renderer.times());
                }
                if builds {
                    self.keep_history(viewer, world.id.clone(), simulated_s, last);
                }
                keep(&mut self.pictures, (key(), picture.clone()), PICTURES_KEPT);
                picture
            }
        };
        let began = Instant::now();
        let bytes = picture::encode(&picture, request.format, request.still)?;
        let numbers = &published.snapshot.numbers;
        let (tick, simulated_s) = past.map_or((numbers.tick, numbers.simulated_s), |p| (p.tick, p.simulated_s));
        let frame = Arc::new(Frame {
            request: request.clone(),
            revision,
            published_at,
            tick,
            simulated_s,
            render_ms: picture.render_ms,
            encode_ms: began.elapsed().as_secs_f64() * 1e3,
            bytes,
        });
        keep(&mut self.frames, (key(), request.format, frame.clone()), FRAMES_KEPT);
        Ok(frame)
    }
}

impl Kept {
    /// Layers of a picture; nothing of them is kept, for who asks has objects of his own.
    fn layers(
        &mut self,
        world: &View,
        request: &FrameRequest,
        wish: &LayersWish,
        (revision, published_at): (u64, Instant),
    ) -> Result<Arc<Frame>, ApiError> {
        let published = world.newest();
        let past = request.past.as_ref();
        let kept = past.map(|p| p.snapshot()).transpose()?;
        let snapshot = kept.as_ref().unwrap_or(&published.snapshot);
        let renderer = self
            .renderers
            .entry((world.id.clone(), past.is_some()))
            .or_insert_with(|| Renderer::new(&self.compute));
        let size = [request.width, request.height];
        let objects_m = match wish {
            LayersWish::Depth { .. } => None,
            LayersWish::Before { objects_m, .. } => Some(&objects_m[..]),
        };
        let began = Instant::now();
        let layers = renderer.layers(snapshot, &snapshot.scene, &request.camera, size, objects_m)?;
        let render_ms = began.elapsed().as_secs_f64() * 1e3;
        if past.is_none() {
            world.set_view_times(renderer.times());
        }
        let began = Instant::now();
        let bytes = match wish {
            LayersWish::Depth { raw } => layers::depth(&layers, size, *raw)?,
            LayersWish::Before { raw, .. } => layers::before(&layers, size, *raw)?,
        };
        let numbers = &snapshot.numbers;
        let (tick, simulated_s) = past.map_or((numbers.tick, numbers.simulated_s), |p| (p.tick, p.simulated_s));
        Ok(Arc::new(Frame {
            request: request.clone(),
            revision,
            published_at,
            tick,
            simulated_s,
            render_ms,
            encode_ms: began.elapsed().as_secs_f64() * 1e3,
            bytes,
        }))
    }
}

fn keep<T>(kept: &mut VecDeque<T>, one: T, most: usize) {
    if kept.len() >= most {
        kept.pop_front();
    }
    kept.push_back(one);
}
