//! `GET /v1/worlds/{id}/volume`: the WebSocket that volumes come over; `proto/PROTOCOL.md` tells what is said.
//!
//! Nothing is queued for a client. A volume is sent when the subscription's rate and byte budget allow it and the client has acknowledged all but
//! [`UNANSWERED_MAX`] of those before: behind each goes a WebSocket ping, which every client answers when it gets there. What lies in the
//! buffers of slow connections is bounded so, and whoever is slow gets fewer volumes, each the newest.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::Message as Ws;
use axum::extract::{Request, State};
use axum::response::Response;
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until};
use welkin_proto::ApiError;
use welkin_proto::volume::VOLUME_VERSION;
use welkin_proto::volume::subscribe::{RegionCells, Subscription, VolumeClientMessage, VolumeServerMessage};

use super::checks;
use super::error::Refusal;
use super::extract::{WorldOf, parse_json};
use super::route::Route;
use super::socket::{self, Connection, End, Incoming};
use super::state::AppState;
use crate::host::View;
use crate::volume::{Made, Message, Newest, Seat, Wanted, channels_of};

/// Volumes under way to a client that it has not answered for.
const UNANSWERED_MAX: u32 = 3;
/// A budget that lies unused adds up to what it gives in this time, s.
const BUDGET_SAVED_S: f64 = 1.0;
/// Lowest byte budget that can be asked for, bytes a second.
const BYTES_PER_S_MIN: f64 = 100.0;

/// The route.
pub fn route() -> Route {
    let summary = "Volumes (WebSocket): text is `VolumeServerMessage` and `VolumeClientMessage`, binary is a volume as proto/PROTOCOL.md has it";
    Route::get("/v1/worlds/{id}/volume", summary, open)
        .of_world()
        .web_socket()
}

async fn open(State(state): State<AppState>, world: WorldOf, request: Request) -> Result<Response, Refusal> {
    let most = state.limits().message_bytes_max;
    socket::open(state, world, request, most, |connection, state, world| async move {
        let mut session = Session {
            connection,
            state,
            world,
            subscribed: None,
            pings: 0,
        };
        let Err(end) = session.live().await;
        (session.connection, end)
    })
    .await
}

struct Session {
    connection: Connection,
    state: AppState,
    world: View,
    subscribed: Option<Subscribed>,
    /// Pings sent behind volumes.
    pings: u32,
}

/// A subscription and what was sent of it.
struct Subscribed {
    /// Keeps the view going.
    _seat: Seat,
    newest: watch::Receiver<Newest>,
    between: Duration,
    /// No volume is sent before.
    next_at: Instant,
    budget: Budget,
    /// Sequences of the keyframe and of the last message that were sent.
    keyframe: Option<u32>,
    last: Option<u32>,
}

/// Bytes that may be sent: they come in steadily, a message may put them into debt, and in debt nothing is sent. Over any time no more is sent than came in
/// meanwhile, what was saved, and one message.
struct Budget {
    bytes_per_s: f64,
    left: f64,
    at: Instant,
}

impl Budget {
    fn new(bytes_per_s: f64) -> Self {
        Self {
            bytes_per_s,
            left: 0.0,
            at: Instant::now(),
        }
    }

    fn spend(&mut self, bytes: usize) {
        let now = Instant::now();
        let came_in = (now - self.at).as_secs_f64() * self.bytes_per_s;
        self.left = (self.left + came_in).min(self.bytes_per_s * BUDGET_SAVED_S) - bytes as f64;
        self.at = now;
    }

    /// When it is out of debt.
    fn ready_at(&self) -> Instant {
        let wait_s = (-self.left / self.bytes_per_s).max(0.0);
        self.at + Duration::try_from_secs_f64(wait_s).unwrap_or(Duration::MAX)
    }
}

impl Subscribed {
    /// When there is something to send; none before the view shows something new.
    fn send_at(&self) -> Option<Instant> {
        let newer = match &*self.newest.borrow() {
            None => false,
            Some(Err(_)) => true,
            Some(Ok(made)) => self.last != Some(made.newest.sequence),
        };
        newer.then(|| self.next_at.max(self.budget.ready_at()))
    }
}

impl Session {
    async fn live(&mut self) -> Result<Infallible, End> {
        self.hello().await?;
        loop {
            let may_send = self.unanswered() < UNANSWERED_MAX;
            let send_at = self
                .subscribed
                .as_ref()
                .and_then(Subscribed::send_at)
                .filter(|_| may_send);
            tokio::select! {
                event = self.connection.event() => match self.connection.take(event).await? {
                    None => {}
                    Some(Incoming::Text(text)) => if let Err(error) = self.obey(text.as_str()).await? {
                        self.refuse(error).await?;
                    },
                    Some(Incoming::Binary(_)) => {
                        let message = "this stream takes text messages only; see VolumeClientMessage in /v1/openapi.json";
                        self.refuse(ApiError::new("unexpected_binary", message)).await?;
                    }
                },
                alive = changed(&mut self.subscribed, &mut self.world) => if !alive {
                    return Err(End::WorldStopped);
                },
                () = sleep_until_some(send_at) => self.send_newest().await?,
            }
        }
    }

    async fn refuse(&mut self, error: ApiError) -> Result<(), End> {
        self.connection.say(&VolumeServerMessage::Error { error }).await
    }

    /// Volumes whose ping was not answered yet.
    fn unanswered(&self) -> u32 {
        let answered = <[u8; 4]>::try_from(self.connection.answered()).map_or(0, u32::from_le_bytes);
        // An answer to a ping that was never sent is no answer.
        match self.pings.checked_sub(answered) {
            Some(unanswered) => unanswered,
            None => self.pings,
        }
    }

    async fn hello(&mut self) -> Result<(), End> {
        let scene = self.world.scene.clone();
        let hello = VolumeServerMessage::Hello {
            protocol: VOLUME_VERSION,
            server: env!("CARGO_PKG_VERSION").to_owned(),
            world: self.world.id.to_string(),
            scene: scene.name.clone(),
            cells: scene.domain.cells,
            cell_size_m: scene.domain.cell_size_m,
            tick_s: scene.time.tick_s,
            channels: channels_of(&self.world.newest()),
        };
        self.connection.say(&hello).await
    }

    /// Does what a text message says.
    async fn obey(&mut self, text: &str) -> Result<Result<(), ApiError>, End> {
        let read = parse_json(text.as_bytes())
            .and_then(|value| serde_json::from_value(value).map_err(|e| ApiError::new("bad_message", e.to_string())));
        match read {
            Err(error) => return Ok(Err(error)),
            Ok(VolumeClientMessage::Subscribe(subscription)) => match self.subscribe(&subscription) {
                Err(error) => return Ok(Err(error)),
                Ok(answer) => self.connection.say(&answer).await?,
            },
            Ok(VolumeClientMessage::Unsubscribe {}) => self.subscribed = None,
            Ok(VolumeClientMessage::Resync {}) => {
                if let Some(subscribed) = &mut self.subscribed {
                    (subscribed.keyframe, subscribed.last) = (None, None);
                }
            }
            Ok(VolumeClientMessage::Ping { client_s }) => {
                let newest = self.world.newest();
                let clock = self.state.volumes().clock();
                let numbers = &newest.snapshot.numbers;
                let pong = VolumeServerMessage::Pong {
                    client_s,
                    server_unix_s: clock.unix_s(std::time::Instant::now()),
                    tick: numbers.tick,
                    simulated_s: numbers.simulated_s,
                    published_unix_s: clock.unix_s(newest.at),
                    speed: numbers.speed,
                };
                self.connection.say(&pong).await?;
            }
        }
        Ok(Ok(()))
    }

    fn subscribe(&mut self, subscription: &Subscription) -> Result<VolumeServerMessage, ApiError> {
        let limits = self.state.limits();
        checks::in_range(subscription.rate_hz, 0.01, limits.volume_rate_max_hz, "/rate_hz")?;
        let most = limits.volume_bytes_per_s_max;
        let bytes_per_s = subscription.bytes_per_s.unwrap_or(most);
        checks::in_range(bytes_per_s, BYTES_PER_S_MIN, most, "/bytes_per_s")?;
        let wanted = Wanted::of(subscription, &self.world, limits)?;
        let rate_hz = subscription.rate_hz;
        let seat = self.state.volumes().follow(&self.world, &wanted, rate_hz, limits)?;
        let region = wanted.layout.region;
        let answer = VolumeServerMessage::Subscribed {
            view: seat.number(),
            region_cells: RegionCells {
                from: region.from,
                cells: region.cells,
            },
            cells: wanted.layout.cells().map(|n| n as u32),
            rate_hz,
            bytes_per_s,
        };
        // Asking for another view again and again buys no bytes.
        let debt = self
            .subscribed
            .as_ref()
            .map_or(0.0, |earlier| earlier.budget.left.min(0.0));
        let mut budget = Budget::new(bytes_per_s);
        budget.left = debt;
        self.subscribed = Some(Subscribed {
            newest: seat.newest(),
            _seat: seat,
            between: Duration::from_secs_f64(1.0 / rate_hz),
            next_at: Instant::now(),
            budget,
            keyframe: None,
            last: None,
        });
        Ok(answer)
    }

    /// Sends what the view shows now, behind its keyframe where the client has another.
    async fn send_newest(&mut self) -> Result<(), End> {
        let Some(subscribed) = &mut self.subscribed else {
            return Ok(());
        };
        let shown = subscribed.newest.borrow_and_update().clone();
        let made = match shown {
            None => return Ok(()),
            Some(Ok(made)) => made,
            Some(Err(error)) => {
                self.subscribed = None; // the same view would fail again and again
                return self.refuse(error).await;
            }
        };
        // Due times follow one another, so that a volume sent late does not lower the rate; a pause does not add up.
        let now = Instant::now();
        subscribed.next_at = (subscribed.next_at + subscribed.between).max(now);
        let Made { newest, keyframe } = made;
        let mut messages: Vec<Arc<Message>> = Vec::with_capacity(2);
        if newest.sequence != keyframe.sequence && subscribed.keyframe != Some(keyframe.sequence) {
            messages.push(Arc::clone(&keyframe));
        }
        subscribed.keyframe = Some(keyframe.sequence);
        subscribed.last = Some(newest.sequence);
        messages.push(newest);
        for message in &messages {
            subscribed.budget.spend(message.bytes.len());
        }
        for message in messages {
            self.connection.send(Ws::Binary(message.bytes.clone())).await?;
        }
        self.pings += 1;
        let number = self.pings.to_le_bytes().to_vec();
        self.connection.send(Ws::Ping(number.into())).await
    }
}

/// Waits for something new of the view, or, without one, of the world; false once the world has stopped.
async fn changed(subscribed: &mut Option<Subscribed>, world: &mut View) -> bool {
    match subscribed {
        Some(subscribed) => subscribed.newest.changed().await.is_ok(),
        None => world.published.changed().await.is_ok(),
    }
}

async fn sleep_until_some(at: Option<Instant>) {
    match at {
        None => std::future::pending().await,
        Some(at) => sleep_until(at).await,
    }
}
