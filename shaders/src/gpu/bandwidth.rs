//! What an adapter's memory gives: a copy kernel, timed.

use std::time::Instant;

use super::context::Context;
use super::error::GpuError;
use super::kernel::Bind;

/// Bytes copied at a time: more than caches hold, within WebGPU's default limits. 65535 workgroups of 256 threads copy 256 MiB.
const COPY_BYTES: u64 = 128 << 20;
/// Copies a measurement.
const COPIES: u32 = 4;
/// Measurements, of which the best counts.
const RUNS: usize = 4;

/// Bytes read and written a second by a copy of 128 MiB, the best of four runs; host time around four copies each, so that a fast adapter without a
/// clock is not flattered. Errors: those of memory, shaders and loss.
pub fn copy_bytes_per_s(context: &Context) -> Result<f64, GpuError> {
    let bytes = COPY_BYTES.min(context.binding_bytes_max());
    let from = context.storage("copied from", bytes)?;
    let to = context.storage("copied to", bytes)?;
    let kernel = context.kernel("bench/copy", "main", &[Bind::Read, Bind::Write])?;
    let groups = (bytes / 16).div_ceil(256) as u32;
    let mut best = 0.0f64;
    for _ in 0..RUNS {
        context.wait()?;
        let began = Instant::now();
        let mut encoder = context.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            for _ in 0..COPIES {
                kernel.record(&mut pass, context, &[&from, &to], [groups, 1, 1]);
            }
        }
        context.queue.submit([encoder.finish()]);
        context.wait()?;
        best = best.max(2.0 * bytes as f64 * COPIES as f64 / began.elapsed().as_secs_f64());
    }
    Ok(best)
}
