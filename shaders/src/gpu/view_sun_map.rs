//! Stage `sun_map` on the GPU: what its kernels are told, and their dispatches.

use super::GpuError;
use super::view_stages::{ShapeGrid, ViewStages};
use crate::cpu::light::sun_map::{MAP_PLANES_LEAST, map_side};
use crate::cpu::light::sun_optical_depth::marched_direction;
use crate::view::{FrameDetail, MapKind};

crate::gpu_struct! {
    /// What a map of the sun's rays is told.
    pub struct SunMapping {
        /// Towards the sun, never too low to march to, and a ray's length from top to bottom, m.
        pub map_sun: [f32; 4],
        /// Added to positions for the detail, m.
        pub detail_offset_m: [f32; 4],
        /// How far detail pushes the edge, in cover.
        pub detail_push: f32,
        /// Share of the carved cloud; 0 is no detail.
        pub detail_blend: f32,
        /// One over the detail tile's edge, 1/m.
        pub detail_tiles_per_m: f32,
        /// Rays along its side.
        pub map_side: u32,
        /// Numbers that it keeps of a ray: 1, 3 or 7.
        pub map_numbers: u32,
        /// Where it lies behind the shadow map.
        pub map_at: u32,
        /// Fills 16 bytes.
        pub unused_0: u32,
        /// Fills 16 bytes.
        pub unused_1: u32,
    }
}

impl SunMapping {
    /// Of a cloud, for a sun, with detail or none; `map_at` is the word of the buffer at which it lies.
    pub fn new(
        grid: &ShapeGrid,
        sun_direction: [f32; 3],
        detail: Option<FrameDetail>,
        kind: MapKind,
        side: u32,
        map_at: u64,
    ) -> SunMapping {
        let [x, y, z] = marched_direction(sun_direction);
        let [east, north, up] = detail.map_or([0.0; 3], |d| d.offset_m);
        SunMapping {
            map_sun: [x, y, z, (grid.top_m - grid.bottom_m) / z],
            detail_offset_m: [east, north, up, 0.0],
            detail_push: detail.map_or(0.0, |d| d.push),
            detail_blend: detail.map_or(0.0, |d| d.blend),
            detail_tiles_per_m: detail.map_or(0.0, |d| d.tiles_per_m),
            map_side: map_side(side) as u32,
            map_numbers: kind.numbers() as u32,
            map_at: map_at as u32,
            ..Default::default()
        }
    }
    /// Bytes that it takes behind the shadow map: the mean extinction, and planes.
    pub fn map_bytes(&self) -> u64 {
        (1 + u64::from(self.map_side).pow(2) * u64::from(self.map_numbers).max(MAP_PLANES_LEAST as u64)) * 4
    }
}

impl ViewStages {
    /// Stage `sun_map`; `cloud` is the shape, the occupancy and the detail tile. The map goes where it says behind the shadow map.
    pub fn sun_map(
        &self,
        uniform: &wgpu::Buffer,
        map: &SunMapping,
        [shape, occupancy, detail]: [&wgpu::Buffer; 3],
        shadow: &wgpu::Buffer,
    ) -> Result<(), GpuError> {
        let c = self.context();
        let [rays, mean] = [self.sun_map[0].get(c)?, self.sun_map[1].get(c)?];
        let told = c.uniform("the map of the sun's rays", map.bytes())?;
        let groups = map.map_side.div_ceil(8);
        self.submit(|pass| {
            let buffers = [uniform, &told, shape, occupancy, detail, shadow];
            rays.record(pass, c, &buffers, [groups, groups, 1]);
            mean.record(pass, c, &buffers, [1, 1, 1]);
        })
    }
}
