//! A live world's sky as its volumes have it: what another machine needs to draw it by itself.

use std::sync::Arc;

use welkin_proto::channel::Channel;
use welkin_proto::volume::VolumeField;
use welkin_proto::volume::{Bits, Compression, subscribe::Subscription};
use welkin_proto::wire::Numbers;
use welkin_proto::{ApiError, Scene};
use welkin_shaders::{CloudVolume, Grid};

use crate::world::Snapshot;

/// The subscription that pictures are drawn from: the whole world's extinction, finely quantised.
pub fn subscription(mip: u8) -> Subscription {
    Subscription {
        channels: vec![Channel::ExtinctionPerM.name().to_owned()],
        mip,
        bits: Bits::Sixteen,
        compression: Compression::Zstd,
        ..Subscription::default()
    }
}

/// What [`Renderer::render`](crate::picture::Renderer::render) draws, of a field of [`subscription`] and the world's scene. A cell at the top that the world's end
/// makes thinner is drawn whole.
///
/// Errors: `bad_volume` where the field holds no extinction, or not of the whole world, or its sides do not repeat at this mip.
pub fn snapshot(field: &VolumeField, scene: Scene) -> Result<Snapshot, ApiError> {
    let bad = |why: &str| ApiError::new("bad_volume", why);
    let channel = field.channel(Channel::ExtinctionPerM.name());
    let extinction_per_m = channel.ok_or_else(|| bad("it holds no extinction"))?.values();
    let layout = &field.layout;
    if layout.region.cells != layout.world_cells {
        return Err(bad("it is not the whole world"));
    }
    let edge = 1u32 << layout.mip;
    if !(0..2).all(|axis| layout.world_cells[axis].is_multiple_of(edge)) {
        return Err(bad(
            "the world's sides are no multiple of this mip's cells, so that it would not repeat",
        ));
    }
    let grid = Grid {
        cells: layout.cells(),
        cell_size_m: layout.message_cell_size_m().map(|s| s as f32),
    };
    let levels = extinction_per_m.chunks_exact(grid.plane());
    let cloudy = |level: &[f32]| level.iter().any(|v| *v > 0.0);
    let first = levels.clone().position(cloudy);
    let last = levels.rev().position(cloudy).map(|from_top| grid.cells[2] - from_top);
    let [east_m, north_m] = field.moment.air_displacement_m;
    Ok(Snapshot {
        numbers: Numbers {
            tick: field.moment.tick,
            simulated_s: field.moment.simulated_s,
            ..Numbers::default()
        },
        volume: Some(Arc::new(CloudVolume {
            grid,
            cloudy_levels: [first.unwrap_or(0), last.unwrap_or(0)],
            extinction_per_m,
            air_displacement_m: [east_m, north_m, 0.0],
        })),
        sun_direction: field.moment.sun_direction,
        scene: Arc::new(scene),
        plan: Arc::default(),
        timings: Arc::default(),
    })
}
