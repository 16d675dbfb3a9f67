//! Stage `upsample` on the GPU: what its kernels are told, and their dispatches.

use super::view_stages::ViewStages;
use super::{GpuError, Kernel};
use crate::cpu::view::upsample::{SAMPLE_NUMBERS, samples_along};

crate::gpu_struct! {
    /// Where the samples of a picture lie in its buffer.
    pub struct Sampling {
        /// Samples across.
        pub columns: u32,
        /// Samples down.
        pub rows: u32,
        /// The first one's word.
        pub samples_at: u32,
        /// Pixels from one to the next.
        pub stride: u32,
        /// The pixel of the first one; it may lie left of the picture.
        pub origin_x: i32,
        /// The same, above it.
        pub origin_y: i32,
        /// Fills 16 bytes.
        pub unused_0: u32,
        /// Fills 16 bytes.
        pub unused_1: u32,
    }
}

impl Sampling {
    /// Of a picture of so many pixels that takes the first `picture_words` words.
    pub fn new(size: [usize; 2], picture_words: usize, stride: usize, origin: [isize; 2]) -> Sampling {
        let [columns, rows] = samples_along(size, stride, origin);
        Sampling {
            columns: columns as u32,
            rows: rows as u32,
            samples_at: picture_words as u32,
            stride: stride as u32,
            origin_x: origin[0] as i32,
            origin_y: origin[1] as i32,
            ..Default::default()
        }
    }
    /// Across and down.
    pub fn size(&self) -> [usize; 2] {
        [self.columns as usize, self.rows as usize]
    }
    /// Words that the samples take.
    pub fn words(&self) -> usize {
        self.columns as usize * self.rows as usize * SAMPLE_NUMBERS
    }
}

impl ViewStages {
    /// The kernel that marches samples. Errors: `Shader`, and those of memory and loss.
    pub fn samples_kernel(&self) -> Result<&Kernel, GpuError> {
        self.samples.get(self.context())
    }
    /// The kernel that draws a picture from them. Errors: as before.
    pub fn upsampled_kernel(&self) -> Result<&Kernel, GpuError> {
        self.upsampled.get(self.context())
    }
    /// Runs a kernel of 8 x 8 invocations a workgroup on `columns` by `rows`.
    pub fn tiles(&self, kernel: &Kernel, bound: &wgpu::BindGroup, [columns, rows]: [usize; 2]) -> Result<(), GpuError> {
        let groups = [columns.div_ceil(8) as u32, rows.div_ceil(8) as u32, 1];
        self.submit(|pass| kernel.dispatch(pass, bound, groups))
    }
}
