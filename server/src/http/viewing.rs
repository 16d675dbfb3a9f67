//! What one viewer of a live world wants to see and what it got so far, whatever carries the frames to it.
//!
//! Nothing is queued for a viewer: a frame is asked for when the one before has been sent.

use std::future::pending;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use tokio::time::{Instant, sleep_until};
use welkin_proto::ApiError;
use welkin_proto::wire::{FrameDelivery, FrameHeader, FrameQuality};

use super::checks;
use super::error::internal;
use super::state::AppState;
use crate::host::View;
use crate::host::renderer::{Frame, FrameRequest, Present, Ticket};
use crate::limits::Limits;
use crate::picture::STILL_RAYS_A_SIDE;

/// World and camera have rested when no new picture was due for so long.
const REST: Duration = Duration::from_millis(500);

/// What a viewer wants to see.
pub struct Wish {
    request: FrameRequest,
    quality: FrameQuality,
    between: Duration,
}

impl Wish {
    /// A live picture's request at a rate. Errors: `out_of_range` for a rate beyond the limits (pointer `/max_fps`), or for a still
    /// picture whose rays are more than the largest frame's pixels (`/quality`).
    pub fn new(request: FrameRequest, quality: FrameQuality, max_fps: f64, limits: &Limits) -> Result<Self, ApiError> {
        checks::in_range(max_fps, 0.01, limits.frames_per_s_max, "/max_fps")?;
        if quality == FrameQuality::Still {
            still_fits(request.width, request.height, limits)?;
        }
        let quality = match quality {
            // One that is too large to rest stays live.
            FrameQuality::Resting if still_fits(request.width, request.height, limits).is_err() => FrameQuality::Live,
            other => other,
        };
        Ok(Self {
            request,
            quality,
            between: Duration::from_secs_f64(1.0 / max_fps),
        })
    }

    fn request(&self, still: bool) -> FrameRequest {
        FrameRequest {
            still,
            ..self.request.clone()
        }
    }
}

/// `out_of_range` at `/quality` for a still picture of more rays than the largest frame has pixels.
pub fn still_fits(width: u32, height: u32, limits: &Limits) -> Result<(), ApiError> {
    let side = u64::from(STILL_RAYS_A_SIDE);
    let rays = u64::from(width) * u64::from(height) * side * side;
    let most = u64::from(limits.width_max) * u64::from(limits.height_max);
    if rays <= most {
        return Ok(());
    }
    let message = format!("a still picture of {width} x {height} takes {rays} rays; at most {most} are allowed");
    Err(ApiError::new("out_of_range", message).at("/quality"))
}

struct Shown {
    revision: u64,
    still: bool,
    at: Instant,
}

/// See the module.
pub struct Viewing {
    wish: Option<Wish>,
    /// The frame under way.
    ticket: Option<Ticket>,
    asked_at: std::time::Instant,
    /// No frame is asked for before.
    next_frame_at: Instant,
    /// What the last frame showed; `None` after a new wish, which is answered even by a world that stands.
    shown: Option<Shown>,
    /// Dropped after the ticket: who has left waits for nothing.
    present: Present,
}

impl Viewing {
    /// A new viewer who wants nothing yet.
    pub fn new(state: &AppState) -> Self {
        Self {
            wish: None,
            ticket: None,
            asked_at: std::time::Instant::now(),
            next_frame_at: Instant::now(),
            shown: None,
            present: state.renderer().viewer(),
        }
    }

    /// Replaces the wish; a frame that waits is replaced in its place in the queue.
    pub fn wish(&mut self, wish: Wish, state: &AppState) {
        if let Some(ticket) = &self.ticket {
            let still = wish.quality == FrameQuality::Still;
            state.renderer().replace(ticket, wish.request(still));
        }
        self.wish = Some(wish);
        self.shown = None;
    }

    /// No more frames.
    pub fn stop(&mut self) {
        self.wish = None;
        self.ticket = None;
    }

    /// When a frame is to be asked for, and whether a still one; `None` while one is under way or nothing is new. `newest` is the
    /// newest publication.
    pub fn due(&self, newest: u64) -> Option<(Instant, bool)> {
        let wish = self.wish.as_ref().filter(|_| self.ticket.is_none())?;
        match &self.shown {
            Some(shown) if shown.revision == newest => {
                let better = wish.quality == FrameQuality::Resting && !shown.still;
                better.then(|| (self.next_frame_at.max(shown.at + REST), true))
            }
            _ => Some((self.next_frame_at, wish.quality == FrameQuality::Still)),
        }
    }

    /// Asks for a frame. Errors: `busy`; it is asked for again a second later.
    pub fn ask(&mut self, still: bool, state: &AppState, world: &View) -> Result<(), ApiError> {
        let Some(wish) = &self.wish else {
            return Ok(());
        };
        // Due times follow one another, so that a frame asked for late does not lower the rate; a pause does not add up.
        let now = Instant::now();
        self.next_frame_at = (self.next_frame_at + wish.between).max(now);
        let queued_max = state.limits().queued_frames_max;
        match state
            .renderer()
            .request(self.present.viewer, world, wish.request(still), queued_max)
        {
            Ok(ticket) => {
                self.ticket = Some(ticket);
                self.asked_at = now.into_std();
                Ok(())
            }
            Err(error) => {
                self.next_frame_at = now + Duration::from_secs(1);
                Err(error)
            }
        }
    }

    /// The frame under way, or never. Leaves it in its place, so it may be dropped half-way. Where it failed the wish is
    /// forgotten: it would fail again and again.
    pub async fn answer(&mut self) -> Result<Arc<Frame>, ApiError> {
        let Some(ticket) = &mut self.ticket else {
            return pending().await;
        };
        let answer = (&mut ticket.answer).await.map_err(internal).and_then(|answer| answer);
        self.ticket = None;
        match &answer {
            Err(_) => self.wish = None,
            Ok(frame) => {
                if let Some(wish) = &self.wish
                    && wish.request(frame.request.still) == frame.request
                {
                    self.shown = Some(Shown {
                        revision: frame.revision,
                        still: frame.request.still,
                        at: Instant::now(),
                    });
                }
            }
        }
        answer
    }

    /// Whether frames are wanted.
    pub fn wants_frames(&self) -> bool {
        self.wish.is_some()
    }

    /// The header of a frame that is handed over now; with its delivery if `delivery`.
    pub fn header(&self, frame: &Frame, sequence: u32, delivery: bool) -> FrameHeader {
        let request = &frame.request;
        FrameHeader {
            format: request.format,
            width: request.width,
            height: request.height,
            tick: frame.tick,
            simulated_s: frame.simulated_s,
            render_ms: frame.render_ms as f32,
            encode_ms: frame.encode_ms as f32,
            sequence,
            image_bytes: frame.bytes.len() as u32,
            delivery: delivery.then(|| self.delivery(frame)),
        }
    }

    /// How a frame that is handed over now came to be sent when it is.
    pub fn delivery(&self, frame: &Frame) -> FrameDelivery {
        let ms = |since: std::time::Instant| since.elapsed().as_secs_f64() * 1e3;
        let worked_ms = frame.render_ms + frame.encode_ms;
        FrameDelivery {
            sent_unix_ms: unix_ms(),
            age_ms: ms(frame.published_at) as f32,
            // One that another viewer caused was rendered before this one asked.
            wait_ms: (ms(self.asked_at.max(frame.published_at)) - worked_ms).max(0.0) as f32,
            still: frame.request.still,
        }
    }
}

/// The server's clock, milliseconds since 1970-01-01T00:00Z.
pub fn unix_ms() -> f64 {
    let since_epoch = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    since_epoch.map_or(0.0, |d| d.as_secs_f64() * 1e3)
}

/// Waits until a frame is due and says whether a still one is; never, where none is.
pub async fn until(due: Option<(Instant, bool)>) -> bool {
    match due {
        None => pending().await,
        Some((at, still)) => {
            sleep_until(at).await;
            still
        }
    }
}
