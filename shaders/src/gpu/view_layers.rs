//! Stage `layers` on the GPU.

use super::GpuError;
use super::view::GpuView;
use crate::CloudVolume;
use crate::cpu::view::layers::{LAYER_NUMBERS, Layer};
use crate::view::ViewSettings;

crate::gpu_struct! {
    /// What the layers of a picture are told.
    pub struct Layering {
        /// Whether there are objects.
        pub objects: u32,
        /// The word of the first one's distance in the picture's buffer.
        pub objects_at: u32,
        /// Fills 16 bytes.
        pub unused_0: u32,
        /// Fills 16 bytes.
        pub unused_1: u32,
    }
}

impl GpuView {
    /// As [`crate::cpu::view::layers()`]. Errors: as of [`GpuView::render`].
    pub fn layers(
        &mut self,
        volume: Option<&CloudVolume>,
        settings: &ViewSettings,
        objects_m: Option<&[f32]>,
        after: &mut dyn FnMut(&'static str),
    ) -> Result<Vec<Layer>, GpuError> {
        if settings.width == 0 || settings.height == 0 {
            return Ok(Vec::new());
        }
        self.drawn(volume, settings, objects_m, after)
            .map_err(|error| self.cause(error))
    }

    fn drawn(
        &mut self,
        volume: Option<&CloudVolume>,
        settings: &ViewSettings,
        objects_m: Option<&[f32]>,
        after: &mut dyn FnMut(&'static str),
    ) -> Result<Vec<Layer>, GpuError> {
        let look = self.prepare(volume, settings, after)?;
        let pixels = settings.width * settings.height;
        let objects_at = pixels * LAYER_NUMBERS;
        let objects_m = objects_m.filter(|objects| objects.len() == pixels);
        let buffer = self.picture_buffer((objects_at + pixels) as u64 * 4)?;
        let context = self.context().clone();
        if let Some(objects_m) = objects_m {
            let bytes = bytemuck::cast_slice(objects_m);
            context.queue.write_buffer(&buffer, objects_at as u64 * 4, bytes);
        }
        let layering = Layering {
            objects: u32::from(objects_m.is_some()),
            objects_at: objects_at as u32,
            ..Default::default()
        };
        let own = context.uniform("the layering", layering.bytes())?;
        let stages = self.stages();
        let size = [settings.width, settings.height];
        self.in_bands(stages.layers.get(&context)?, &look, settings, size, &buffer, &[&own])?;
        let bytes = context.read(&buffer, objects_at as u64 * 4)?;
        let numbers: Vec<f32> = bytemuck::pod_collect_to_vec(&bytes);
        after("layers");
        let layer = |n: &[f32]| [n[0], n[1], n[2], n[3], n[4], n[5]];
        Ok(numbers.chunks_exact(LAYER_NUMBERS).map(layer).collect())
    }
}
