//! Stage `reproject` on the GPU: what its kernels are told, a viewer's last picture, and the pictures that build on it.
//!
//! Reads and writes as the twin, [`crate::cpu::view::reproject`], by the same decisions in the same order. The last picture (radiance, transmittance and distance of every pixel, `[row][number][column]`,
//! 20 bytes a pixel) stays in the GPU's memory, in a buffer of the viewer's own. The march binds all eight storage buffers that WebGPU grants, so a picture is drawn in the world's
//! buffer: the bytes, the samples, a copy of the last picture, and what a band of rows meets, which is copied to the viewer's buffer band by band. That is 28 bytes a pixel of a world's largest picture (24 with one
//! pixel in 16), and 5 MiB.

use std::sync::{Arc, Weak};

use super::view::{GpuView, band_rows, row_words};
use super::view_impostors::GpuImpostors;
use super::view_upsample::Sampling;
use super::{Context, GpuError};
use crate::CloudVolume;
use crate::cpu::view::impostors::Moment;
use crate::cpu::view::reproject::{Last, first_sample};
use crate::cpu::view::upsample::SAMPLE_NUMBERS;
use crate::view::{Look, ViewSettings};

crate::gpu_struct! {
    /// What a picture is told of the viewer's last one.
    pub struct Recall {
        /// Where the air that is at the world's origin now would see its camera, m.
        pub position_m: [f32; 4],
        /// Unit vector to its right.
        pub right: [f32; 4],
        /// Unit vector to its top.
        pub up: [f32; 4],
        /// Unit vector ahead of it.
        pub ahead: [f32; 4],
        /// Its pixels to a tangent of 1.
        pub per_pixel: f32,
        /// Whether there is one.
        pub last: u32,
        /// The word at which what it met lies.
        pub last_at: u32,
        /// The word at which what a band of rows meets goes.
        pub next_at: u32,
    }
}

impl Recall {
    fn new(last: Option<&Last>, displacement_m: [f32; 3], [last_at, next_at]: [usize; 2]) -> Recall {
        let places = Recall {
            last_at: last_at as u32,
            next_at: next_at as u32,
            ..Default::default()
        };
        let Some(last) = last else { return places };
        let wide = |[x, y, z]: [f32; 3]| [x, y, z, 0.0];
        let [right, up, ahead] = last.look.axes.map(wide);
        Recall {
            position_m: wide(last.position_m(displacement_m)),
            right,
            up,
            ahead,
            per_pixel: last.per_pixel(),
            last: 1,
            ..places
        }
    }
}

/// What a viewer's last picture leaves to the next, in the GPU's memory; dropped, it is free.
#[derive(Debug, Default)]
pub struct GpuHistory {
    last: Option<Last>,
    numbers: Option<KeptBuffer>,
    pictures: usize,
    /// Far clouds, of the rung that keeps them.
    impostors: GpuImpostors,
}

/// A viewer's buffer, on the device that it was made on: one that was lost takes it with it.
#[derive(Debug)]
pub(super) struct KeptBuffer {
    context: Weak<Context>,
    pub(super) buffer: wgpu::Buffer,
}

impl KeptBuffer {
    /// Of so many bytes. Errors: `TooLarge`, `OutOfMemory`.
    pub(super) fn new(context: &Arc<Context>, what: &str, bytes: u64) -> Result<KeptBuffer, GpuError> {
        let buffer = context.storage(what, bytes)?;
        let context = Arc::downgrade(context);
        Ok(KeptBuffer { context, buffer })
    }
    /// Whether it is that device's.
    pub(super) fn is_of(&self, context: &Arc<Context>) -> bool {
        Weak::ptr_eq(&self.context, &Arc::downgrade(context))
    }
    pub(super) fn bytes(&self) -> u64 {
        self.buffer.size()
    }
}

impl GpuHistory {
    /// Bytes that it holds on the GPU.
    pub fn bytes(&self) -> u64 {
        self.numbers.as_ref().map_or(0, KeptBuffer::bytes) + self.impostors.bytes()
    }
    /// Forgets the last picture and frees its memory: the next one is marched whole.
    pub fn forget(&mut self) {
        self.last = None;
        self.numbers = None;
        self.impostors.forget();
    }

    /// A buffer of just so many bytes on that device: the last picture's where it is one. Errors: `TooLarge`, `OutOfMemory`.
    fn buffer(&mut self, context: &Arc<Context>, bytes: u64) -> Result<wgpu::Buffer, GpuError> {
        let fits = |n: &&KeptBuffer| n.is_of(context) && n.bytes() == padded(bytes);
        if let Some(numbers) = self.numbers.as_ref().filter(fits) {
            return Ok(numbers.buffer.clone());
        }
        // The old one is freed first: there may not be room for both.
        self.forget();
        let numbers = KeptBuffer::new(context, "a viewer's last picture", bytes)?;
        let buffer = numbers.buffer.clone();
        self.numbers = Some(numbers);
        Ok(buffer)
    }
}

/// Bytes that a buffer of so many takes.
fn padded(bytes: u64) -> u64 {
    bytes.next_multiple_of(16)
}

impl GpuView {
    /// As [`GpuView::render`], but of a viewer who sees one picture after another: where the settings say so it builds on what the last one left in `history`. Errors: as of
    /// [`GpuView::render`]; after one the next picture is marched whole.
    pub fn render_live(
        &mut self,
        volume: Option<&CloudVolume>,
        settings: &ViewSettings,
        history: &mut GpuHistory,
        after: &mut dyn FnMut(&'static str),
    ) -> Result<Vec<u8>, GpuError> {
        if !settings.sampling.builds_on_last() || settings.width * settings.height == 0 {
            return self.render(volume, settings, after);
        }
        self.draw_live(volume, settings, history, after)
            .map_err(|error| self.cause(error))
    }

    fn draw_live(
        &mut self,
        volume: Option<&CloudVolume>,
        settings: &ViewSettings,
        history: &mut GpuHistory,
        after: &mut dyn FnMut(&'static str),
    ) -> Result<Vec<u8>, GpuError> {
        let look = self.prepare(volume, settings, after)?;
        let Some((weather, slab_m)) = self.cloud() else {
            // A sky without cloud leaves nothing to the next.
            history.forget();
            return self.march(&look, settings, after);
        };
        let displacement_m = volume.map_or([0.0; 3], |v| v.air_displacement_m);
        let (stage, picture) = match settings.sampling.cell() {
            Some(cell) => (
                "reproject",
                self.reproject(&look, settings, displacement_m, cell, history)?,
            ),
            None => {
                let now = Moment::new(look.position_m, displacement_m, weather);
                let kept = &mut history.impostors;
                ("impostors", self.impostors(&look, settings, slab_m, &now, kept)?)
            }
        };
        after(stage);
        Ok(picture)
    }

    fn reproject(
        &mut self,
        look: &Look,
        settings: &ViewSettings,
        displacement_m: [f32; 3],
        cell: usize,
        history: &mut GpuHistory,
    ) -> Result<Vec<u8>, GpuError> {
        let size = [settings.width, settings.height];
        let [width, height] = size;
        let context = self.context().clone();
        let stages = self.stages();
        let row_numbers = SAMPLE_NUMBERS * width;
        let kept_bytes = (row_numbers * height) as u64 * 4;
        let kept = history.buffer(&context, kept_bytes)?;
        // Taken out: a picture that fails leaves nothing to the next.
        let last = history.last.take().filter(|last| last.serves(size, look));

        let picture_words = row_words(width) * height;
        let sampling = Sampling::new(size, picture_words, cell, first_sample(cell, history.pictures));
        history.pictures = history.pictures.wrapping_add(1);
        let last_at = picture_words + sampling.words();
        let next_at = last_at + row_numbers * height;
        let words = next_at + row_numbers * band_rows(width).min(height);
        let picture = self.picture_buffer(words as u64 * 4)?;
        if last.is_some() {
            let mut encoder = context.device.create_command_encoder(&Default::default());
            encoder.copy_buffer_to_buffer(&kept, 0, &picture, last_at as u64 * 4, kept_bytes);
            context.queue.submit([encoder.finish()]);
        }
        let told = context.uniform("the sampling", sampling.bytes())?;
        let kernel = stages.samples_kernel()?;
        self.in_bands(kernel, look, settings, sampling.size(), &picture, &[&told])?;
        let recall = Recall::new(last.as_ref(), displacement_m, [last_at, next_at]);
        let recall = context.uniform("the last picture's camera", recall.bytes())?;
        let kernel = stages.reprojected.get(&context)?;
        self.in_bands_then(
            kernel,
            look,
            settings,
            size,
            (&picture, &[&told, &recall]),
            |first_row, rows| {
                let bytes = |rows: usize| (rows * row_numbers) as u64 * 4;
                let mut encoder = context.device.create_command_encoder(&Default::default());
                encoder.copy_buffer_to_buffer(&picture, next_at as u64 * 4, &kept, bytes(first_row), bytes(rows));
                context.queue.submit([encoder.finish()]);
            },
        )?;
        let rgb8 = self.read_picture(&picture, size)?;
        history.last = Some(Last {
            size,
            look: *look,
            displacement_m,
        });
        Ok(rgb8)
    }
}
