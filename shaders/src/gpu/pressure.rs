//! What the direct pressure solver needs beside fields: factors of the transforms' lengths, twiddles, pivots, the spectrum.

use std::sync::Arc;

use super::context::Context;
use super::error::GpuError;
use super::kernel::{Bind, Kernel};
use crate::cpu::sim::Parameters;
use crate::cpu::sim::pressure_solve::for_each_pivot;

/// Entry points in the order in which they run.
const ENTRIES: [&str; 5] = ["forward_x", "forward_y", "solve_z", "inverse_y", "inverse_x"];

crate::constants! {
    /// Longest line that a transform takes: two of them fill 16 KiB of workgroup memory.
    pub const TRANSFORM_LENGTH_MAX: usize = 1024;
    /// Threads that work on the lines of a workgroup.
    pub const TRANSFORM_THREADS: usize = 256;
}

crate::gpu_struct! {
    /// How lines along x and y are transformed.
    pub struct Transforms {
        /// Length, number of factors, lines a workgroup takes at once, workgroups abreast.
        pub x: [u32; 4],
        /// As `x`.
        pub y: [u32; 4],
        /// Factors of the length along x.
        pub factors_x: [[u32; 4]; 3],
        /// Factors of the length along y.
        pub factors_y: [[u32; 4]; 3],
    }
}

/// Factors of `n`: fours first, then primes. A line of 1024 has five, the most is ten.
fn factors(mut n: usize) -> Vec<u32> {
    let mut found = Vec::new();
    while n.is_multiple_of(4) {
        found.push(4);
        n /= 4;
    }
    let mut p = 2;
    while n > 1 {
        if n.is_multiple_of(p) {
            found.push(p as u32);
            n /= p;
        } else {
            p += 1;
        }
    }
    found
}

fn packed(factors: &[u32]) -> [[u32; 4]; 3] {
    let mut packed = [[1; 4]; 3];
    for (n, factor) in factors.iter().enumerate() {
        packed[n / 4][n % 4] = *factor;
    }
    packed
}

/// The solver's buffers and kernels.
pub(super) struct Solver {
    kernels: [Arc<Kernel>; 5],
    groups: [[u32; 3]; 5],
    transforms: wgpu::Buffer,
    twiddles: wgpu::Buffer,
    pivots: wgpu::Buffer,
    spectrum: wgpu::Buffer,
}

impl Solver {
    /// Plans the solve. Errors: `TooLarge` for lines of more than [`TRANSFORM_LENGTH_MAX`] cells; those of memory and shaders.
    pub(super) fn new(context: &Context, parameters: &Parameters) -> Result<Self, GpuError> {
        let [nx, ny, levels] = parameters.grid.cells;
        if nx.max(ny) > TRANSFORM_LENGTH_MAX {
            return Err(GpuError::TooLarge {
                what: "a line of the pressure solver's transform".to_owned(),
                needed: 8 * nx.max(ny) as u64,
                allowed: 8 * TRANSFORM_LENGTH_MAX as u64,
            });
        }
        let half = nx / 2 + 1;
        let (factors_x, factors_y) = (factors(nx), factors(ny));
        let lines_x = (TRANSFORM_LENGTH_MAX / nx).min((ny * levels).div_ceil(2));
        let lines_y = (TRANSFORM_LENGTH_MAX / ny).min(half);
        let groups_x = (ny * levels).div_ceil(2).div_ceil(lines_x) as u32;
        let groups_y = half.div_ceil(lines_y) as u32;
        // A dispatch has at most 65535 groups in a direction.
        let abreast = groups_x.min(32_768);
        let transforms = Transforms {
            x: [nx as u32, factors_x.len() as u32, lines_x as u32, abreast],
            y: [ny as u32, factors_y.len() as u32, lines_y as u32, groups_y],
            factors_x: packed(&factors_x),
            factors_y: packed(&factors_y),
        };
        let turns = |n: usize| {
            (0..n).map(move |j| {
                let angle = -2.0 * std::f64::consts::PI * j as f64 / n as f64;
                [angle.cos() as f32, angle.sin() as f32]
            })
        };
        let twiddles: Vec<[f32; 2]> = turns(nx).chain(turns(ny)).collect();
        let mut pivots = vec![0.0f32; levels * ny * half];
        for_each_pivot(parameters, |m, j, z, pivot| {
            pivots[(z * ny + j) * half + m] = pivot as f32
        });
        use Bind::{Read, Uniform, Write};
        let binds = [
            Uniform, Uniform, Read, Read, Read, Read, Read, Read, Write, Write, Uniform,
        ];
        let kernel = |entry| context.kernel("sim/pressure_solve", entry, &binds);
        let along_x = [abreast, groups_x.div_ceil(abreast), 1];
        let along_y = [groups_y, levels as u32, 1];
        Ok(Self {
            kernels: [
                kernel(ENTRIES[0])?,
                kernel(ENTRIES[1])?,
                kernel(ENTRIES[2])?,
                kernel(ENTRIES[3])?,
                kernel(ENTRIES[4])?,
            ],
            groups: [
                along_x,
                along_y,
                [(ny * half).div_ceil(64) as u32, 1, 1],
                along_y,
                along_x,
            ],
            transforms: context.uniform("transforms", bytemuck::bytes_of(&transforms))?,
            twiddles: context.storage_of("twiddles", bytemuck::cast_slice(&twiddles))?,
            pivots: context.storage_of("pivots", bytemuck::cast_slice(&pivots))?,
            spectrum: context.storage("spectrum", 8 * (levels * ny * half) as u64)?,
        })
    }

    /// Bytes that it holds.
    pub(super) fn bytes(&self) -> usize {
        [&self.transforms, &self.twiddles, &self.pivots, &self.spectrum]
            .iter()
            .map(|b| b.size() as usize)
            .sum()
    }

    /// Records the solve. `shared` are the buffers at bindings 0 to 2.
    pub(super) fn record(
        &self,
        context: &Context,
        pass: &mut wgpu::ComputePass<'_>,
        shared: [&wgpu::Buffer; 3],
        velocity: [&wgpu::Buffer; 3],
        pressure: &wgpu::Buffer,
    ) {
        let [sim, step, profiles] = shared;
        let [u, v, w] = velocity;
        let buffers = [
            sim,
            step,
            profiles,
            u,
            v,
            w,
            &self.twiddles,
            &self.pivots,
            &self.spectrum,
            pressure,
            &self.transforms,
        ];
        for (kernel, groups) in self.kernels.iter().zip(self.groups) {
            kernel.record(pass, context, &buffers, groups);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factors_multiply_to_the_length() {
        for n in 1..=TRANSFORM_LENGTH_MAX {
            let found = factors(n);
            assert_eq!(found.iter().product::<u32>() as usize, n);
            assert!(found.len() <= 12, "{n} has {} factors", found.len());
        }
    }
}
