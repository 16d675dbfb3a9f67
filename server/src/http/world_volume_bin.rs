//! `GET /v1/worlds/{id}/volume.bin`: one keyframe of what a world shows now, for scripts.

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use welkin_proto::ApiError;
use welkin_proto::volume::subscribe::{RegionCells, Subscription};
use welkin_proto::volume::{Bits, Compression};

use super::error::Refusal;
use super::extract::{Pairs, WorldOf};
use super::query::{invalid, unknown};
use super::route::{Place::Query, Route};
use super::state::AppState;
use crate::volume::Wanted;

/// The route.
pub fn route() -> Route {
    let summary = "One volume: a keyframe as proto/PROTOCOL.md has it";
    Route::get("/v1/worlds/{id}/volume.bin", summary, volume)
        .of_world()
        .parameter::<String>(
            Query,
            "channels",
            "Names of channels, with commas between; `extinction_per_m`.",
        )
        .parameter::<u8>(
            Query,
            "mip",
            "A cell is the mean of 2^mip of the world's along each edge; 0.",
        )
        .parameter::<u8>(Query, "bits", "Bits a value, 8 or 16; 8.")
        .parameter::<Compression>(Query, "compression", "How the body is packed; `deflate`.")
        .parameter::<String>(
            Query,
            "from",
            "First cell east, north, up, with commas between; `0,0,0`.",
        )
        .parameter::<String>(
            Query,
            "cells",
            "Cells east, north, up, with commas between; all from `from` on.",
        )
        .bytes(200, "The message.", &["application/octet-stream"])
        .error("out_of_range")
        .error("bad_parameter")
        .error("unknown_parameter")
        .error("bad_query")
        .error("bad_region")
        .error("unknown_channel")
        .error("duplicate_channel")
        .error("channel_unavailable")
        .error("volume_too_large")
        .error("weather_unavailable")
        .error("world_stopped")
        .error("internal")
}

async fn volume(
    State(state): State<AppState>,
    WorldOf(host): WorldOf,
    Pairs(pairs): Pairs,
) -> Result<Response, Refusal> {
    let world = host.view().clone();
    drop(host); // the world may be stopped meanwhile
    let subscription = parse(&pairs, world.scene.domain.cells)?;
    let wanted = Wanted::of(&subscription, &world, state.limits())?;
    let bytes = state.volumes().keyframe(&world, &wanted).await?;
    let headers = [
        (header::CONTENT_TYPE, "application/octet-stream"),
        (header::CACHE_CONTROL, "no-cache"),
    ];
    Ok((headers, bytes).into_response())
}

fn parse(pairs: &[(String, String)], world_cells: [u32; 3]) -> Result<Subscription, ApiError> {
    let mut subscription = Subscription::default();
    let (mut from, mut cells) = (None, None);
    for (name, value) in pairs {
        let bad = |wanted: &str| invalid(name, value, wanted);
        match name.as_str() {
            "channels" => subscription.channels = value.split(',').map(str::to_owned).collect(),
            "mip" => subscription.mip = value.parse().map_err(|_| bad("a mip, 0 to 6"))?,
            "bits" => {
                let bits = value.parse().ok().and_then(|bits: u8| Bits::try_from(bits).ok());
                subscription.bits = bits.ok_or_else(|| bad("8 or 16"))?;
            }
            "compression" => {
                subscription.compression = match value.as_str() {
                    "none" => Compression::None,
                    "deflate" => Compression::Deflate,
                    "zstd" => Compression::Zstd,
                    _ => return Err(bad("none, deflate or zstd")),
                }
            }
            "from" => from = Some(three(value).ok_or_else(|| bad("three whole numbers with commas between"))?),
            "cells" => cells = Some(three(value).ok_or_else(|| bad("three whole numbers with commas between"))?),
            _ => return Err(unknown(name)),
        }
    }
    if from.is_some() || cells.is_some() {
        let from = from.unwrap_or([0; 3]);
        let rest = [0, 1, 2].map(|a| world_cells[a].saturating_sub(from[a]));
        subscription.region_cells = Some(RegionCells {
            from,
            cells: cells.unwrap_or(rest),
        });
    }
    Ok(subscription)
}

fn three(text: &str) -> Option<[u32; 3]> {
    let numbers: Vec<u32> = text.split(',').map(|n| n.trim().parse().ok()).collect::<Option<_>>()?;
    numbers.try_into().ok()
}
