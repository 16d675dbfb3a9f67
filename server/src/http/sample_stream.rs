//! `GET /v1/worlds/{id}/samples`: the WebSocket for places that move. The client says where everybody is, as often as it likes; the server
//! answers at the rate that was asked for with all channels of all places in one message.
//!
//! Nothing is queued: an answer is made of the newest weather and the newest positions when it is due, and the next is due no sooner
//! than the last has been sent.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::Message;
use axum::extract::{Request, State};
use axum::response::Response;
use tokio::time::{Instant, sleep_until};
use welkin_proto::ApiError;
use welkin_proto::sample::{
    Places, PositionsMessage, Quantity, SampleClientMessage, SampleFormat, SampleServerMessage, SamplesMessage,
};
use welkin_proto::wire::PROTOCOL_VERSION;

use super::checks;
use super::error::Refusal;
use super::extract::{WorldOf, parse_json};
use super::route::Route;
use super::sampling::{self, Chosen};
use super::socket::{self, Connection, End, Incoming};
use super::state::AppState;
use crate::host::View;
use crate::sample::{self, Moments, When};
use crate::weather::{FieldSet, Reach, WeatherInterest};

/// After an answer that failed, the next try is this much later.
const AFTER_FAILURE: Duration = Duration::from_secs(1);

/// The route.
pub fn route() -> Route {
    let summary = "Samples for places that move (WebSocket): text is `SampleClientMessage` and `SampleServerMessage`, \
                   binary as proto/PROTOCOL.md has it";
    Route::get("/v1/worlds/{id}/samples", summary, open)
        .of_world()
        .web_socket()
}

async fn open(State(state): State<AppState>, world: WorldOf, request: Request) -> Result<Response, Refusal> {
    let most = state.limits().body_bytes_max;
    socket::open(state, world, request, most, |connection, state, world| async move {
        let mut stream = Stream {
            connection,
            state,
            world,
            wish: None,
            positions: None,
            due: Instant::now(),
            sequence: 0,
        };
        let end = match stream.live().await {
            Err(end) => end,
            Ok(never) => match never {},
        };
        (stream.connection, end)
    })
    .await
}

/// What the client wants.
struct Wish {
    named: Option<Vec<Quantity>>,
    between: Duration,
    format: SampleFormat,
    fields: FieldSet,
    _interest: WeatherInterest,
}

struct Stream {
    connection: Connection,
    state: AppState,
    world: View,
    wish: Option<Wish>,
    /// The newest positions with their number.
    positions: Option<(u32, Arc<Vec<[f64; 3]>>)>,
    /// No answer is made before.
    due: Instant,
    sequence: u32,
}

impl Stream {
    async fn live(&mut self) -> Result<Infallible, End> {
        self.hello().await?;
        loop {
            let due = (self.wish.is_some() && self.positions.is_some()).then_some(self.due);
            tokio::select! {
                event = self.connection.event() => {
                    let taken = match self.connection.take(event).await? {
                        None => Ok(()),
                        Some(Incoming::Text(text)) => self.take(text.as_str()),
                        Some(Incoming::Binary(bytes)) => PositionsMessage::decode(&bytes).and_then(|m| match m.places {
                            Places::Local => self.place(m.number, Some(m.positions), None),
                            Places::Geographic => self.place(m.number, None, Some(m.positions)),
                        }),
                    };
                    if let Err(error) = taken {
                        self.connection.say(&SampleServerMessage::Error { error }).await?;
                    }
                }
                changed = self.world.published.changed() => changed.map_err(|_| End::WorldStopped)?,
                () = async { match due {
                    Some(due) => sleep_until(due).await,
                    None => std::future::pending().await,
                } } => self.answer().await?,
            }
        }
    }

    async fn hello(&mut self) -> Result<(), End> {
        let hello = match Chosen::new(None, &self.world) {
            Ok(chosen) => SampleServerMessage::Hello {
                protocol: PROTOCOL_VERSION,
                server: env!("CARGO_PKG_VERSION").to_owned(),
                world: self.world.id.to_string(),
                channels: chosen.quantities.iter().map(|q| q.name().to_owned()).collect(),
                units: chosen.units(),
                unavailable: chosen.unavailable,
            },
            Err(error) => SampleServerMessage::Error { error },
        };
        self.connection.say(&hello).await
    }

    /// Obeys a text message.
    fn take(&mut self, text: &str) -> Result<(), ApiError> {
        let message = serde_json::from_value(parse_json(text.as_bytes())?);
        match message.map_err(|e| ApiError::new("bad_message", e.to_string()))? {
            SampleClientMessage::Subscribe {
                channels,
                rate_hz,
                format,
            } => {
                checks::in_range(rate_hz, 0.01, self.state.limits().sample_rate_max_hz, "/rate_hz")?;
                let names = channels.as_ref();
                let named = names.map(|names| sampling::quantities(names.iter().map(String::as_str)));
                let named = named.transpose()?;
                let fields = sample::fields_of(&Chosen::new(named.clone(), &self.world)?.quantities);
                self.wish = Some(Wish {
                    named,
                    between: Duration::from_secs_f64(1.0 / rate_hz),
                    format,
                    fields,
                    _interest: self.world.want_fields(fields, Reach::Newest),
                });
                self.due = Instant::now();
                Ok(())
            }
            SampleClientMessage::Positions {
                number,
                positions_m,
                positions_lat_lon_alt,
            } => self.place(number, positions_m, positions_lat_lon_alt),
        }
    }

    fn place(
        &mut self,
        number: u32,
        positions_m: Option<Vec<[f64; 3]>>,
        positions_lat_lon_alt: Option<Vec<[f64; 3]>>,
    ) -> Result<(), ApiError> {
        let most = self.state.limits().sample_points_max;
        let places = sampling::places(positions_m, positions_lat_lon_alt, &self.world.geography, most)?;
        self.positions = Some((number, Arc::new(places)));
        Ok(())
    }

    async fn answer(&mut self) -> Result<(), End> {
        let (Some(wish), Some((number, places))) = (&self.wish, &self.positions) else {
            return Ok(());
        };
        // Due times follow one another, so that an answer made late does not lower the rate; a pause does not add up.
        let now = Instant::now();
        self.due = (self.due + wish.between).max(now);
        let made = make(
            &self.state,
            &self.world,
            wish,
            *number,
            Arc::clone(places),
            self.sequence,
        );
        match made.await {
            Ok(message) => {
                self.sequence = self.sequence.wrapping_add(1);
                self.connection.send(message).await
            }
            Err(error) => {
                self.due = now + AFTER_FAILURE.max(wish.between);
                self.connection.say(&SampleServerMessage::Error { error }).await
            }
        }
    }
}

/// Makes an answer of the newest weather.
async fn make(
    state: &AppState,
    world: &View,
    wish: &Wish,
    number: u32,
    places: Arc<Vec<[f64; 3]>>,
    sequence: u32,
) -> Result<Message, ApiError> {
    let published = world.weather(wish.fields).await?;
    let moments = Moments::find(&published.past, When::Now)?;
    let quantities = Chosen::new(wish.named.clone(), world)?.quantities;
    let format = wish.format;
    sampling::work(state, move || {
        let columns = sample::sample(&moments, &quantities, &places)?;
        let moment = moments.moment();
        Ok(match format {
            SampleFormat::Binary => {
                let message = SamplesMessage {
                    sequence,
                    number,
                    tick: moment.tick,
                    simulated_s: moment.simulated_s,
                    wall_unix_s: moment.wall_unix_s,
                    quantities,
                    columns,
                };
                Message::Binary(message.encode().into())
            }
            SampleFormat::Json => {
                let message = SampleServerMessage::Samples {
                    sequence,
                    number,
                    moment,
                    values: sampling::by_name(&quantities, columns),
                };
                let text = serde_json::to_string(&message).map_err(super::error::internal)?;
                Message::Text(text.into())
            }
        })
    })
    .await
}
