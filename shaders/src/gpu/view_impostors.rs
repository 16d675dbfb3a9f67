//! Stage `impostors` on the GPU: what its kernels are told, a viewer's far clouds, and the pictures that they stand in.
//!
//! Reads and writes as the twin, [`crate::cpu::view::impostors`], which chooses the tiles here too. Tiles stay in the GPU's memory, in slots of 21 780 bytes of a buffer of the viewer's own, as many as have been in view at once (rounded
//! up to 64, kept until the tiles are laid out anew): about 20 bytes a pixel of the picture's middle band. As in [`super::view_reproject`] a picture is drawn in the world's buffer: the tiles are copied to it, and
//! those that were marched are copied back. Which tiles are in view comes back to the host before they are chosen: a picture waits for the GPU twice.

use std::sync::Arc;

use super::view::{GpuView, row_words};
use super::view_reproject::KeptBuffer;
use super::{Context, GpuError};
use crate::cpu::view::impostors::{FAR_SIDE, Impostors, Moment, Taken};
use crate::cpu::view::upsample::SAMPLE_NUMBERS;
use crate::view::{Look, ViewSettings};

/// Words of a slot.
const SLOT_WORDS: usize = FAR_SIDE * FAR_SIDE * SAMPLE_NUMBERS;
/// Slots by which a viewer's buffer grows.
const SLOTS_MORE: usize = 64;
/// In place of a slot where a tile has none.
const NO_SLOT: u32 = u32::MAX;

crate::gpu_struct! {
    /// How a viewer's far clouds are laid out, and where they lie in the picture's buffer, in words.
    pub struct FarClouds {
        /// Nearer than this nothing is far, m.
        pub far_m: f32,
        /// Slope between neighbouring directions.
        pub step: f32,
        /// Tiles along a side of the cube.
        pub tiles_x: u32,
        /// Tiles up.
        pub tiles_y: u32,
        /// Where the slots' numbers lie, one a tile.
        pub slots_at: u32,
        /// Where the tiles are named that are marched.
        pub fresh_at: u32,
        /// Where the slots lie.
        pub numbers_at: u32,
        /// Tiles that are marched.
        pub fresh: u32,
    }
}

/// A viewer's far clouds in the GPU's memory.
#[derive(Debug, Default)]
pub(super) struct GpuImpostors {
    /// Each tile's slot.
    tiles: Impostors<u32>,
    slots: Option<KeptBuffer>,
}

impl GpuImpostors {
    /// Bytes that they hold on the GPU.
    pub(super) fn bytes(&self) -> u64 {
        self.slots.as_ref().map_or(0, KeptBuffer::bytes)
    }
    /// Gives all up.
    pub(super) fn forget(&mut self) {
        *self = GpuImpostors::default();
    }
    fn capacity(&self) -> usize {
        self.bytes() as usize / (4 * SLOT_WORDS)
    }

    /// Room for so many slots, what is in those that there are kept. Errors: `TooLarge`, `OutOfMemory`.
    fn reserve(&mut self, context: &Arc<Context>, slots: usize) -> Result<wgpu::Buffer, GpuError> {
        if let Some(kept) = self.slots.as_ref().filter(|_| self.capacity() >= slots) {
            return Ok(kept.buffer.clone());
        }
        let bytes = slots.next_multiple_of(SLOTS_MORE) * SLOT_WORDS * 4;
        let more = KeptBuffer::new(context, "a viewer's far clouds", bytes as u64)?;
        if let Some(kept) = &self.slots {
            let mut encoder = context.device.create_command_encoder(&Default::default());
            encoder.copy_buffer_to_buffer(&kept.buffer, 0, &more.buffer, 0, kept.bytes());
            context.queue.submit([encoder.finish()]);
        }
        let buffer = more.buffer.clone();
        self.slots = Some(more);
        Ok(buffer)
    }
}

impl GpuView {
    /// A picture with the far clouds that are kept; there is cloud between the heights `slab_m`. Errors: `TooLarge` and those of memory and loss, after which nothing is kept.
    pub(super) fn impostors(
        &mut self,
        look: &Look,
        settings: &ViewSettings,
        slab_m: [f32; 2],
        now: &Moment,
        kept: &mut GpuImpostors,
    ) -> Result<Vec<u8>, GpuError> {
        let context = self.context().clone();
        let stages = self.stages();
        // Taken out: a picture that fails leaves nothing to the next.
        let mut far = std::mem::take(kept);
        if far.slots.as_ref().is_some_and(|slots| !slots.is_of(&context)) {
            far.forget();
        }
        let size = [settings.width, settings.height];
        let picture_words = row_words(size[0]) * size[1];
        let taken = far.tiles.laid_out(Taken::new(look, size[1], slab_m));
        if far.tiles.kept().all(|tile| tile.is_none()) {
            far.slots = None;
        }
        let count = taken.count();
        let told = FarClouds {
            far_m: taken.far_m,
            step: taken.step,
            tiles_x: taken.tiles[0] as u32,
            tiles_y: taken.tiles[1] as u32,
            ..Default::default()
        };

        let picture = self.picture_buffer(count.max(picture_words) as u64 * 4)?;
        let mut encoder = context.device.create_command_encoder(&Default::default());
        encoder.clear_buffer(&picture, 0, Some(count as u64 * 4));
        context.queue.submit([encoder.finish()]);
        let uniform = context.uniform("the far clouds", told.bytes())?;
        let [mark, tiles, draw] = &stages.impostors;
        self.in_bands(mark.get(&context)?, look, settings, size, &picture, &[&uniform])?;
        let seen: Vec<u32> = bytemuck::pod_collect_to_vec(&context.read(&picture, count as u64 * 4)?);

        let fresh = far.tiles.choose(&taken, now, |number| seen[number] != 0);
        let in_view = seen.iter().filter(|s| **s != 0).count();
        let slots = far.reserve(&context, in_view)?;
        let capacity = far.capacity();
        // A tile that is marched again keeps its slot; the others take those that are free.
        let mut places: Vec<u32> = far.tiles.kept().map(|slot| slot.copied().unwrap_or(NO_SLOT)).collect();
        let mut used = vec![false; capacity];
        for slot in places.iter().filter(|slot| **slot != NO_SLOT) {
            used[*slot as usize] = true;
        }
        let mut free = (0..capacity).filter(|slot| !used[*slot]);
        let mut named = Vec::with_capacity(2 * fresh.len());
        for number in fresh {
            if places[number] == NO_SLOT {
                // There are as many slots as tiles in view.
                let slot = free.next().unwrap_or_default();
                places[number] = slot as u32;
            }
            named.extend([number as u32, places[number]]);
            far.tiles.put(number, now, places[number]);
        }
        let slots_at = picture_words.max(count);
        let fresh_at = slots_at + count;
        let numbers_at = fresh_at + named.len();
        let told = FarClouds {
            slots_at: slots_at as u32,
            fresh_at: fresh_at as u32,
            numbers_at: numbers_at as u32,
            fresh: named.len() as u32 / 2,
            ..told
        };
        let words = numbers_at + capacity * SLOT_WORDS;
        let picture = self.picture_buffer(words as u64 * 4)?;
        let uniform = context.uniform("the far clouds", told.bytes())?;
        let queue = &context.queue;
        queue.write_buffer(&picture, slots_at as u64 * 4, bytemuck::cast_slice(&places));
        queue.write_buffer(&picture, fresh_at as u64 * 4, bytemuck::cast_slice(&named));
        let all = (capacity * SLOT_WORDS) as u64 * 4;
        let mut encoder = context.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(&slots, 0, &picture, numbers_at as u64 * 4, all);
        queue.submit([encoder.finish()]);
        if told.fresh > 0 {
            let directions = [FAR_SIDE, FAR_SIDE * told.fresh as usize];
            self.in_bands(tiles.get(&context)?, look, settings, directions, &picture, &[&uniform])?;
            let mut encoder = context.device.create_command_encoder(&Default::default());
            for slot in named.iter().skip(1).step_by(2) {
                let at = (*slot as usize * SLOT_WORDS) as u64 * 4;
                let from = numbers_at as u64 * 4 + at;
                encoder.copy_buffer_to_buffer(&picture, from, &slots, at, SLOT_WORDS as u64 * 4);
            }
            queue.submit([encoder.finish()]);
        }
        self.in_bands(draw.get(&context)?, look, settings, size, &picture, &[&uniform])?;
        let rgb8 = self.read_picture(&picture, size)?;
        *kept = far;
        Ok(rgb8)
    }
}
