//! A world's volumes as a sequence of events that outlives its connections, with the server's clock.

use std::convert::Infallible;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use futures_util::{SinkExt, Stream, StreamExt};
use tokio::net::TcpStream;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::{MissedTickBehavior, interval, timeout};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::Message;
use welkin_proto::volume::subscribe::{Subscription, VolumeClientMessage, VolumeServerMessage};
use welkin_proto::volume::{DecodeLimits, Receiver, Taken, VOLUME_VERSION, VolumeField};

use crate::clock::Clock;
use crate::connection::{End, Follower, SILENCE_LIMIT, follow, handshake, said, silent};
use crate::error::ClientError;
use crate::record::{Record, RecordKind};
use crate::stream::Next;
use crate::url::ServerUrl;

/// Events that may wait for the reader; then the connection is not read either, and the server skips to the newest.
const EVENTS_WAITING_MAX: usize = 4;
/// The clock is asked for this often, at first and then.
const PING_FIRST: Duration = Duration::from_millis(50);
const PING_THEN: Duration = Duration::from_secs(1);
/// So many pings go out quickly.
const PINGS_FIRST: u32 = 5;

/// What is wanted of a server.
#[derive(Clone, Debug)]
pub struct VolumeOptions {
    /// The world's id; `None` takes the server's first.
    pub world: Option<String>,
    /// Which volumes.
    pub subscription: Subscription,
    /// What a message may hold at most.
    pub limits: DecodeLimits,
    /// Pause before the first new attempt; it doubles with every failure and is jittered by a quarter.
    pub retry_first: Duration,
    /// The longest pause.
    pub retry_last: Duration,
}

impl Default for VolumeOptions {
    fn default() -> Self {
        Self {
            world: None,
            subscription: Subscription::default(),
            limits: DecodeLimits::default(),
            retry_first: Duration::from_secs(1),
            retry_last: Duration::from_secs(20),
        }
    }
}

/// What happens on a volume stream.
#[derive(Debug)]
pub enum VolumeEvent {
    /// A connection stands; comes again after every reconnection. Always [`VolumeServerMessage::Hello`].
    Hello(VolumeServerMessage),
    /// What the subscription came to. Always [`VolumeServerMessage::Subscribed`].
    Subscribed(VolumeServerMessage),
    /// A new field.
    Volume {
        /// The field.
        field: Arc<VolumeField>,
        /// Bytes of the message that made it.
        bytes: usize,
        /// When it came: our clock, Unix seconds.
        arrived_unix_s: f64,
    },
    /// Something went wrong.
    Error {
        /// What.
        error: ClientError,
        /// How the stream goes on.
        next: Next,
    },
}

/// Understands a connection's messages, wherever they come from: holds no socket and reads no clock.
#[derive(Debug)]
pub struct Intake {
    receiver: Receiver,
    clock: Arc<Mutex<Clock>>,
    /// Whether a `resync` was sent since the last field.
    resync_asked: bool,
}

/// What [`Intake`] makes of a message.
#[derive(Debug)]
pub enum Understood {
    /// Tell the user.
    Event(VolumeEvent),
    /// Send this.
    Reply(VolumeClientMessage),
    /// Nothing to do.
    Nothing,
}

impl Intake {
    /// With an empty field and a clock of its own.
    pub fn new(limits: DecodeLimits) -> Self {
        Self::with_clock(limits, Arc::default())
    }

    fn with_clock(limits: DecodeLimits, clock: Arc<Mutex<Clock>>) -> Self {
        Self {
            receiver: Receiver::new(limits),
            clock,
            resync_asked: false,
        }
    }

    /// The clock as it is known now.
    pub fn clock(&self) -> Clock {
        locked(&self.clock).clone()
    }

    /// Takes a text message that came when our clock said `now_s`; NaN where that means nothing, then answers to pings are passed over.
    ///
    /// Errors: [`ClientError::BadMessage`], [`ClientError::OtherProtocol`], [`ClientError::Refused`].
    pub fn text(&mut self, text: &str, now_s: f64) -> Result<Understood, ClientError> {
        let value: serde_json::Value =
            serde_json::from_str(text).map_err(|e| ClientError::BadMessage(e.to_string()))?;
        // Of a hello of another protocol no more than the version may be readable.
        if value["type"] == "hello" && value["protocol"] != VOLUME_VERSION {
            return Err(ClientError::OtherProtocol {
                server: value["server"].as_str().unwrap_or("unknown").to_owned(),
                theirs: value["protocol"]
                    .as_u64()
                    .and_then(|p| u32::try_from(p).ok())
                    .unwrap_or(0),
                ours: VOLUME_VERSION.into(),
            });
        }
        let message: VolumeServerMessage =
            serde_json::from_value(value).map_err(|e| ClientError::BadMessage(e.to_string()))?;
        Ok(match message {
            VolumeServerMessage::Hello { .. } => Understood::Event(VolumeEvent::Hello(message)),
            VolumeServerMessage::Subscribed { view, .. } => {
                self.receiver.expect(view);
                self.resync_asked = false;
                Understood::Event(VolumeEvent::Subscribed(message))
            }
            VolumeServerMessage::Pong {
                client_s,
                server_unix_s,
                ..
            } => {
                locked(&self.clock).answered(client_s, now_s, server_unix_s);
                Understood::Nothing
            }
            VolumeServerMessage::Error { error } => return Err(ClientError::Refused(error)),
        })
    }

    /// Takes a binary message that came at `arrived_unix_s`.
    ///
    /// Errors: [`ClientError::BadMessage`]; what was held is held still.
    pub fn binary(&mut self, bytes: &[u8], arrived_unix_s: f64) -> Result<Understood, ClientError> {
        let taken = self.receiver.take(bytes);
        Ok(match taken.map_err(|e| ClientError::BadMessage(e.to_string()))? {
            Taken::Field(field) => {
                self.resync_asked = false;
                Understood::Event(VolumeEvent::Volume {
                    field,
                    bytes: bytes.len(),
                    arrived_unix_s,
                })
            }
            Taken::NeedsKeyframe if !self.resync_asked => {
                self.resync_asked = true;
                Understood::Reply(VolumeClientMessage::Resync {})
            }
            Taken::NeedsKeyframe | Taken::Stale => Understood::Nothing,
        })
    }
}

fn locked(clock: &Mutex<Clock>) -> MutexGuard<'_, Clock> {
    clock.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The events of [`subscribe`] or of [`replay`](crate::record::replay); dropping it closes the connection.
#[derive(Debug)]
pub struct Volumes {
    receiver: mpsc::Receiver<VolumeEvent>,
    wishes: mpsc::UnboundedSender<Subscription>,
    clock: Arc<Mutex<Clock>>,
    began: Instant,
    task: JoinHandle<()>,
}

impl Volumes {
    /// Runs `work` as the source of events.
    pub(crate) fn from_source<F, Fut>(work: F) -> Self
    where
        F: FnOnce(Source) -> Fut,
        Fut: Future<Output = ()> + Send + 'static,
    {
        let (sender, receiver) = mpsc::channel(EVENTS_WAITING_MAX);
        let (wishes, asked) = mpsc::unbounded_channel();
        let clock: Arc<Mutex<Clock>> = Arc::default();
        let began = Instant::now();
        let task = tokio::spawn(work(Source {
            sender,
            asked,
            clock: Arc::clone(&clock),
            began,
        }));
        Self {
            receiver,
            wishes,
            clock,
            began,
            task,
        }
    }

    /// Asks for something else from now on; what comes of it is told by [`VolumeEvent::Subscribed`] or [`VolumeEvent::Error`]. A recording ignores it.
    pub fn resubscribe(&self, subscription: Subscription) {
        // Where the stream has ended there is nobody to ask.
        let _ = self.wishes.send(subscription);
    }

    /// The server's clock now, Unix seconds; none before the first answer to a ping. Of a recording, the clock when it was made.
    pub fn server_unix_s(&self) -> Option<f64> {
        locked(&self.clock).server_unix_s(self.began.elapsed().as_secs_f64())
    }

    /// Largest error of [`Volumes::server_unix_s`], s.
    pub fn clock_error_max_s(&self) -> Option<f64> {
        locked(&self.clock).error_max_s()
    }
}

impl Stream for Volumes {
    type Item = VolumeEvent;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<VolumeEvent>> {
        self.receiver.poll_recv(context)
    }
}

impl Drop for Volumes {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// What a source of events is given.
pub(crate) struct Source {
    pub(crate) sender: mpsc::Sender<VolumeEvent>,
    asked: mpsc::UnboundedReceiver<Subscription>,
    clock: Arc<Mutex<Clock>>,
    began: Instant,
}

impl Source {
    pub(crate) fn intake(&self, limits: DecodeLimits) -> Intake {
        Intake::with_clock(limits, Arc::clone(&self.clock))
    }

    pub(crate) fn now_s(&self) -> f64 {
        self.began.elapsed().as_secs_f64()
    }

    /// Makes the server's clock say this now.
    pub(crate) fn set_clock(&self, server_unix_s: f64) {
        let now_s = self.now_s();
        let mut clock = locked(&self.clock);
        *clock = Clock::default();
        clock.answered(now_s, now_s, server_unix_s);
    }
}

/// Our clock, Unix seconds.
pub fn unix_now_s() -> f64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.unwrap_or_default().as_secs_f64()
}

/// Follows a world of the server at `url` (see [`ServerUrl::parse`]) until the result is dropped or an error is final.
/// Must be called within a tokio runtime.
///
/// Errors: [`ClientError::BadUrl`]; everything later comes as [`VolumeEvent::Error`].
pub fn subscribe(url: &str, options: VolumeOptions) -> Result<Volumes, ClientError> {
    subscribe_and_record(url, options, |_| Ok(()))
}

/// As [`subscribe`], and hands every message as it came to `record`, which ends the stream by an error.
///
/// Errors: [`ClientError::BadUrl`].
pub fn subscribe_and_record(
    url: &str,
    options: VolumeOptions,
    record: impl FnMut(Record<'_>) -> std::io::Result<()> + Send + 'static,
) -> Result<Volumes, ClientError> {
    let server = ServerUrl::parse(url)?;
    Ok(Volumes::from_source(move |source| {
        follow(Following {
            server,
            options,
            source,
            record,
        })
    }))
}

async fn say(socket: &mut WebSocketStream<TcpStream>, message: &VolumeClientMessage) -> Result<(), ClientError> {
    let text = serde_json::to_string(message).map_err(|e| ClientError::BadMessage(e.to_string()))?;
    let sent = socket.send(Message::text(text)).await;
    sent.map_err(|e| ClientError::Lost(e.to_string()))
}

/// One world's volumes.
struct Following<R> {
    server: ServerUrl,
    options: VolumeOptions,
    source: Source,
    record: R,
}

impl<R> Follower for Following<R>
where
    R: FnMut(Record<'_>) -> std::io::Result<()> + Send,
{
    type Event = VolumeEvent;

    fn sender(&self) -> &mpsc::Sender<VolumeEvent> {
        &self.source.sender
    }

    fn pauses(&self) -> [Duration; 2] {
        [self.options.retry_first, self.options.retry_last]
    }

    fn trouble(error: ClientError, next: Next) -> VolumeEvent {
        VolumeEvent::Error { error, next }
    }

    async fn connect_once(&mut self, failures: &mut u32) -> Result<Infallible, End> {
        let Self {
            server,
            options,
            source,
            record,
        } = self;
        let mut socket = handshake(server, options.world.as_deref(), "volume").await?;
        let mut intake = source.intake(options.limits);
        let mut pings = interval(PING_FIRST);
        pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut pinged = 0;
        let silence = tokio::time::sleep(SILENCE_LIMIT);
        tokio::pin!(silence);
        loop {
            let message = tokio::select! {
                message = socket.next() => message,
                () = source.sender.closed() => return Err(End::Unheard),
                () = &mut silence => {
                    return Err(silent().into());
                }
                wish = source.asked.recv() => {
                    let Some(wish) = wish else { return Err(End::Unheard) };
                    options.subscription = wish.clone();
                    say(&mut socket, &VolumeClientMessage::Subscribe(wish)).await?;
                    continue;
                }
                _ = pings.tick() => {
                    pinged += 1;
                    if pinged == PINGS_FIRST {
                        pings = interval(PING_THEN);
                        pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
                    }
                    say(&mut socket, &VolumeClientMessage::Ping { client_s: source.now_s() }).await?;
                    continue;
                }
            };
            silence.as_mut().reset(tokio::time::Instant::now() + SILENCE_LIMIT);
            let message = said(message)?;
            let arrived_unix_s = unix_now_s();
            let mut keep = |kind, data: &[u8]| {
                let kept = record(Record {
                    kind,
                    arrived_unix_s,
                    data,
                });
                kept.map_err(|e| ClientError::Recording(e.to_string()))
            };
            let understood = match &message {
                Message::Text(text) => {
                    keep(RecordKind::Text, text.as_bytes())?;
                    intake.text(text, source.now_s())
                }
                Message::Binary(bytes) => {
                    keep(RecordKind::Binary, bytes)?;
                    intake.binary(bytes, arrived_unix_s)
                }
                Message::Ping(_) | Message::Pong(_) | Message::Frame(_) | Message::Close(_) => continue,
            };
            let event = match understood {
                Ok(Understood::Nothing) => continue,
                Ok(Understood::Reply(reply)) => {
                    say(&mut socket, &reply).await?;
                    continue;
                }
                Ok(Understood::Event(event)) => event,
                Err(error @ ClientError::OtherProtocol { .. }) => return Err(error.into()),
                Err(error) => VolumeEvent::Error {
                    error,
                    next: Next::GoesOn,
                },
            };
            if let VolumeEvent::Hello(_) = event {
                *failures = 0;
                say(
                    &mut socket,
                    &VolumeClientMessage::Subscribe(options.subscription.clone()),
                )
                .await?;
            }
            // A user who does not take events for a long time must not keep pongs from being sent for ever: reading stops, the server notices.
            let sent = timeout(SILENCE_LIMIT, source.sender.send(event)).await;
            match sent {
                Ok(Ok(())) => {}
                Ok(Err(_)) => return Err(End::Unheard),
                Err(_) => return Err(ClientError::Lost("nobody took the events".to_owned()).into()),
            }
            silence.as_mut().reset(tokio::time::Instant::now() + SILENCE_LIMIT);
        }
    }
}
