//! `GET /v1/worlds/{id}/past.bin`: the cloud of a kept moment.

use axum::http::header;
use axum::response::{IntoResponse, Response};

use super::error::Refusal;
use super::extract::{Pairs, WorldOf};
use super::query::{moment, unknown};
use super::route::{Place::Query, Route};

/// The route.
pub fn route() -> Route {
    let summary = "The sky of a moment that is over: a keyframe of its extinction, as proto/PROTOCOL.md has it";
    Route::get("/v1/worlds/{id}/past.bin", summary, volume)
        .of_world()
        .parameter::<u64>(
            Query,
            "tick",
            "The moment's tick, as `/past` lists it; the newest kept.",
        )
        .parameter::<f64>(
            Query,
            "simulated_s",
            "A simulated second: the last moment that is kept at or before it.",
        )
        .bytes(
            200,
            "The message: 8 bits, packed by `deflate`.",
            &["application/octet-stream"],
        )
        .past_errors()
        .error("bad_parameter")
        .error("unknown_parameter")
        .error("bad_query")
}

async fn volume(WorldOf(host): WorldOf, Pairs(pairs): Pairs) -> Result<Response, Refusal> {
    let (when, rest) = moment(pairs)?;
    if let Some((name, _)) = rest.first() {
        return Err(unknown(name).into());
    }
    let now_s = host.view().newest().snapshot.numbers.simulated_s;
    let kept = host.view().past_sky().find(when, now_s)?;
    let headers = [
        (header::CONTENT_TYPE, "application/octet-stream"),
        (header::CACHE_CONTROL, "no-cache"),
    ];
    Ok((headers, kept.message.clone()).into_response())
}
