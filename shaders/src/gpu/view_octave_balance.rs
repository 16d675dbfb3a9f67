//! Stage `octave_balance` on the GPU: what its kernels are told, and their dispatches.

use super::GpuError;
use super::view_stages::{ShapeGrid, ViewStages};
use crate::cpu::light::octave_balance::{BALANCE_RINGS, rings};
use crate::cpu::light::sun_optical_depth::marched_direction;

crate::gpu_struct! {
    /// What the balance of octaves is told.
    pub struct OctaveBalancing {
        /// Towards the sun, never too low to march to.
        pub beam: [f32; 4],
        /// Rings around it: cosine and sine of what the beam is turned by, solid angle, share of what is scattered once.
        pub rings: [[f32; 4]; BALANCE_RINGS],
        /// Whether detail carves the cloud.
        pub carved: u32,
        /// Octaves behind the first scattering.
        pub octaves: u32,
        /// Fills 16 bytes.
        pub unused_0: u32,
        /// Fills 16 bytes.
        pub unused_1: u32,
    }
}

impl OctaveBalancing {
    /// Towards a sun, by the phase function's asymmetry.
    pub fn new(sun_direction: [f32; 3], carved: bool, asymmetry: f32, octaves: usize) -> OctaveBalancing {
        let [x, y, z] = marched_direction(sun_direction);
        OctaveBalancing {
            beam: [x, y, z, 0.0],
            rings: rings(asymmetry).map(|ring| [ring.turn[0], ring.turn[1], ring.even, ring.once]),
            carved: carved as u32,
            octaves: octaves as u32,
            ..Default::default()
        }
    }
}

impl ViewStages {
    /// Stage `octave_balance`; `cloud` is the shape, the occupancy and the light, `columns` has room for three numbers a column. The factors go behind the shadow map.
    pub fn octave_balance(
        &self,
        grid: &ShapeGrid,
        [uniform, phase]: [&wgpu::Buffer; 2],
        told: &OctaveBalancing,
        [shape, occupancy, light]: [&wgpu::Buffer; 3],
        columns: &wgpu::Buffer,
        shadow: &wgpu::Buffer,
    ) -> Result<(), GpuError> {
        let c = self.context();
        let told = c.uniform("the balance of octaves", told.bytes())?;
        let line = (grid.cells_x * grid.cells_y).div_ceil(64);
        let [x, y] = [grid.cells_x, grid.cells_y];
        let dispatched = [
            [x.div_ceil(8), y.div_ceil(8), 1],
            [line, 1, 1],
            [line, 1, 1],
            [line, 1, 1],
            [(x + 2).div_ceil(8), (y + 2).div_ceil(8), 1],
        ];
        let mut kernels = Vec::with_capacity(dispatched.len());
        for kernel in &self.octave_balance {
            kernels.push(kernel.get(c)?);
        }
        self.submit(|pass| {
            let buffers = [uniform, &told, phase, shape, occupancy, light, columns, shadow];
            for (kernel, groups) in kernels.iter().zip(dispatched) {
                kernel.record(pass, c, &buffers, groups);
            }
        })
    }
}
