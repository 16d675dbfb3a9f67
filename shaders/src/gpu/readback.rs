//! What comes back from the GPU unasked: a tick's few numbers and the passes' times, through rings of staging buffers.
//!
//! A substep's block that is staged now is read when the next one has been staged, so that reading waits only for work that lies one submission back. After
//! [`Readback::forget`] the next answer waits for its own block. A tick's end is read when it is asked for.

use std::collections::VecDeque;
use std::sync::Arc;

use super::context::Context;
use super::error::GpuError;
use super::kernel::{Bind, Kernel};
use crate::catalogue::Pass;
use crate::cpu::sim::Parameters;
use crate::cpu::sim::reduce_cloud::{self, Level};
use crate::device::{CloudReductions, Reductions, Vitals};
use crate::grid::Grid;

/// Staging buffers of a ring: one being filled, one in flight, one being read.
const RING: usize = 3;
/// Time stamps between two blocks, two a pass.
const QUERIES: u32 = 128;
/// Bytes of the block of reductions.
const BLOCK_BYTES: u64 = 32;

crate::constants! {
    /// Place of [`Reductions::courant_rate_per_s`].
    pub const REDUCED_RATE: usize = 0;
    /// Place of [`Reductions::wind_max_m_s`].
    pub const REDUCED_WIND: usize = 1;
    /// Place of [`Reductions::updraught_max_m_s`].
    pub const REDUCED_UPDRAUGHT: usize = 2;
    /// Place of [`Reductions::viscosity_max_m2_s`].
    pub const REDUCED_VISCOSITY: usize = 3;
    /// Place of the count of cells that hold what isn't finite.
    pub const REDUCED_NOT_FINITE: usize = 4;
    /// Numbers in the block.
    pub const REDUCED_NUMBERS: usize = 5;
    /// Place of the largest divergence in the block of vitals.
    pub const VITAL_DIVERGENCE: usize = 0;
    /// Place of the least water, its bits turned so that the least has the largest.
    pub const VITAL_WATER: usize = 1;
    /// Place of the count of cells that hold what isn't finite.
    pub const VITAL_NOT_FINITE: usize = 2;
    /// Numbers in the block of vitals.
    pub const VITAL_NUMBERS: usize = 3;
    /// Numbers a level in the cloud's sums.
    pub const CLOUD_SUMS: usize = 6;
}

/// Which numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ring {
    /// Those of a substep.
    State,
    /// Those of a tick's end.
    Tick,
}

/// A block on its way.
pub(super) struct Staged {
    ring: Ring,
    slot: usize,
    timed: Vec<Pass>,
}

struct Flight {
    staged: Staged,
    submission: wgpu::SubmissionIndex,
}

#[derive(Default)]
struct Pending {
    staging: Vec<wgpu::Buffer>,
    next: usize,
    flights: VecDeque<Flight>,
}

/// Where a pass writes its two time stamps.
pub(super) struct PassTiming {
    queries: wgpu::QuerySet,
    first: u32,
}

impl PassTiming {
    pub(super) fn writes(&self) -> wgpu::ComputePassTimestampWrites<'_> {
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(self.first),
            end_of_pass_write_index: Some(self.first + 1),
        }
    }
}

/// See the module.
pub(super) struct Readback {
    reduce: Arc<Kernel>,
    levels: Arc<Kernel>,
    columns: Arc<Kernel>,
    block: wgpu::Buffer,
    sums: wgpu::Buffer,
    cloudy_columns: wgpu::Buffer,
    judge: Arc<Kernel>,
    vital_block: wgpu::Buffer,
    queries: Option<(wgpu::QuerySet, wgpu::Buffer, f64)>,
    timed: Vec<Pass>,
    state: Pending,
    /// Whether the next answer on the state waits for its own block.
    fresh: bool,
    tick: Pending,
    reductions: Reductions,
    vitals: Vitals,
    clouds: CloudReductions,
    times: Vec<(u64, f64)>,
}

impl Readback {
    pub(super) fn new(context: &Context, grid: &Grid) -> Result<Self, GpuError> {
        use Bind::{Read, Uniform, Write};
        let sums_bytes = (4 * CLOUD_SUMS * grid.cells[2]) as u64;
        let ring = |what: &str, bytes: u64| {
            use wgpu::BufferUsages as Usage;
            let staging = (0..RING)
                .map(|_| context.buffer(what, bytes, Usage::MAP_READ | Usage::COPY_DST))
                .collect::<Result<Vec<_>, _>>()?;
            Ok(Pending {
                staging,
                ..Pending::default()
            })
        };
        let queries = if context.timestamps {
            let resolved = context.buffer(
                "time stamps",
                8 * QUERIES as u64,
                wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            )?;
            let set = context.guarded("time stamps", |device| {
                device.create_query_set(&wgpu::QuerySetDescriptor {
                    label: Some("passes"),
                    ty: wgpu::QueryType::Timestamp,
                    count: QUERIES,
                })
            })?;
            Some((set, resolved, context.queue.get_timestamp_period() as f64 * 1e-9))
        } else {
            None
        };
        let clouds = [Uniform, Uniform, Read, Read, Read, Read, Read, Read, Write, Write];
        Ok(Self {
            reduce: context.kernel(
                "sim/reduce",
                "main",
                &[Uniform, Uniform, Read, Read, Read, Read, Read, Write],
            )?,
            levels: context.kernel("sim/reduce_cloud", "levels", &clouds)?,
            columns: context.kernel("sim/reduce_cloud", "columns", &clouds)?,
            judge: context.kernel(
                "sim/vitals",
                "main",
                &[Uniform, Uniform, Read, Read, Read, Read, Read, Read, Read, Write],
            )?,
            vital_block: context.storage("vitals", 16)?,
            block: context.storage("reductions", BLOCK_BYTES)?,
            sums: context.storage("sums over levels", sums_bytes)?,
            cloudy_columns: context.storage("columns with cloud", 16)?,
            queries,
            timed: Vec::new(),
            state: ring("reductions, read", BLOCK_BYTES + 8 * QUERIES as u64)?,
            fresh: true,
            tick: ring("numbers of a tick, read", sums_bytes + 32)?,
            reductions: Reductions::default(),
            vitals: Vitals::default(),
            clouds: CloudReductions::default(),
            times: vec![(0, 0.0); Pass::ALL.len()],
        })
    }

    /// Runs and seconds of a pass so far; none where the adapter has no clock.
    pub(super) fn time(&self, pass: Pass) -> Option<(u64, f64)> {
        self.queries.is_some().then(|| self.times[pass as usize])
    }

    /// Time stamps for a pass that is about to be recorded.
    pub(super) fn begin_pass(&mut self, pass: Pass) -> Option<PassTiming> {
        let (queries, ..) = self.queries.as_ref()?;
        let first = 2 * self.timed.len() as u32;
        if first + 2 > QUERIES {
            return None;
        }
        self.timed.push(pass);
        Some(PassTiming {
            queries: queries.clone(),
            first,
        })
    }

    /// Records the reductions; `buffers` are the shared ones, the velocities and the viscosity.
    pub(super) fn reduce<'a>(
        &'a self,
        context: &Context,
        encoder: &mut wgpu::CommandEncoder,
        mut buffers: Vec<&'a wgpu::Buffer>,
        groups: [u32; 3],
    ) {
        encoder.clear_buffer(&self.block, 0, None);
        buffers.push(&self.block);
        let mut pass = encoder.begin_compute_pass(&Default::default());
        self.reduce.record(&mut pass, context, &buffers, groups);
    }

    /// Records the cloud's reductions; `buffers` are the shared ones, cloud water, water, extinction and the horizontal velocities.
    pub(super) fn reduce_cloud<'a>(
        &'a self,
        context: &Context,
        encoder: &mut wgpu::CommandEncoder,
        mut buffers: Vec<&'a wgpu::Buffer>,
        columns: [u32; 3],
        grid: &Grid,
    ) {
        encoder.clear_buffer(&self.cloudy_columns, 0, None);
        buffers.push(&self.sums);
        buffers.push(&self.cloudy_columns);
        let mut pass = encoder.begin_compute_pass(&Default::default());
        self.levels
            .record(&mut pass, context, &buffers, [grid.cells[2] as u32, 1, 1]);
        self.columns.record(&mut pass, context, &buffers, columns);
    }

    /// Records the copy of the newest numbers into the ring. None if all of the ring is in flight, which reading in time prevents.
    pub(super) fn stage(&mut self, encoder: &mut wgpu::CommandEncoder, ring: Ring) -> Option<Staged> {
        let timed = match ring {
            Ring::State => std::mem::take(&mut self.timed),
            Ring::Tick => Vec::new(),
        };
        let pending = match ring {
            Ring::State => &mut self.state,
            Ring::Tick => &mut self.tick,
        };
        if pending.flights.len() >= RING {
            return None;
        }
        let slot = pending.next;
        pending.next = (slot + 1) % RING;
        let staging = &pending.staging[slot];
        match ring {
            Ring::State => {
                encoder.copy_buffer_to_buffer(&self.block, 0, staging, 0, BLOCK_BYTES);
                if let Some((set, resolved, _)) = &self.queries
                    && !timed.is_empty()
                {
                    let count = 2 * timed.len() as u32;
                    encoder.resolve_query_set(set, 0..count, resolved, 0);
                    encoder.copy_buffer_to_buffer(resolved, 0, staging, BLOCK_BYTES, 8 * count as u64);
                }
            }
            Ring::Tick => {
                encoder.copy_buffer_to_buffer(&self.cloudy_columns, 0, staging, 0, 16);
                encoder.copy_buffer_to_buffer(&self.vital_block, 0, staging, 16, 16);
                let sums_bytes = self.sums.size().min(staging.size() - 32);
                encoder.copy_buffer_to_buffer(&self.sums, 0, staging, 32, sums_bytes);
            }
        }
        Some(Staged { ring, slot, timed })
    }

    /// Notes that a staged block was submitted, and asks for it.
    pub(super) fn submitted(&mut self, staged: Staged, submission: wgpu::SubmissionIndex) {
        let pending = match staged.ring {
            Ring::State => &mut self.state,
            Ring::Tick => &mut self.tick,
        };
        pending.staging[staged.slot].map_async(wgpu::MapMode::Read, .., |_| {});
        pending.flights.push_back(Flight { staged, submission });
    }

    /// The next answers are of the state as it is when they are asked for.
    pub(super) fn forget(&mut self) {
        self.fresh = true;
    }

    /// Blocks that are due: all but the newest `leave`, which are still being computed.
    fn arrived(pending: &mut Pending, leave: usize, context: &Context) -> Vec<(Staged, Vec<u8>)> {
        let mut blocks = Vec::new();
        while pending.flights.len() > leave {
            let Some(flight) = pending.flights.pop_front() else {
                break;
            };
            let waited = context.device.poll(wgpu::PollType::Wait {
                submission_index: Some(flight.submission),
                timeout: None,
            });
            let staging = &pending.staging[flight.staged.slot];
            // A device that is lost answers neither; its context knows.
            if waited.is_ok()
                && context.check().is_ok()
                && let Ok(view) = staging.get_mapped_range(..)
            {
                blocks.push((flight.staged, view.to_vec()));
            }
            staging.unmap();
        }
        blocks
    }

    /// The newest reductions that have arrived.
    pub(super) fn reductions(&mut self, context: &Context) -> Reductions {
        // Where a fresh answer is wanted, all of them.
        let leave = usize::from(!std::mem::take(&mut self.fresh));
        for (staged, bytes) in Self::arrived(&mut self.state, leave, context) {
            let block: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes[..BLOCK_BYTES as usize]);
            let number = |place: usize| f32::from_bits(block[place]);
            self.reductions = Reductions {
                courant_rate_per_s: number(REDUCED_RATE),
                wind_max_m_s: number(REDUCED_WIND),
                updraught_max_m_s: number(REDUCED_UPDRAUGHT),
                viscosity_max_m2_s: number(REDUCED_VISCOSITY),
                finite: block[REDUCED_NOT_FINITE] == 0,
            };
            let stamps: Vec<u64> = bytemuck::pod_collect_to_vec(&bytes[BLOCK_BYTES as usize..]);
            let period_s = self.queries.as_ref().map_or(0.0, |q| q.2);
            for (pass, stamps) in staged.timed.iter().zip(stamps.chunks_exact(2)) {
                let time = &mut self.times[*pass as usize];
                time.0 += 1;
                time.1 += stamps[1].saturating_sub(stamps[0]) as f64 * period_s;
            }
        }
        self.reductions
    }

    /// Records what a tick's end is judged by; `buffers` are the shared ones, the velocities, heat, water and extinction.
    pub(super) fn judge<'a>(
        &'a self,
        context: &Context,
        encoder: &mut wgpu::CommandEncoder,
        mut buffers: Vec<&'a wgpu::Buffer>,
        groups: [u32; 3],
    ) {
        encoder.clear_buffer(&self.vital_block, 0, None);
        buffers.push(&self.vital_block);
        let mut pass = encoder.begin_compute_pass(&Default::default());
        self.judge.record(&mut pass, context, &buffers, groups);
    }

    /// The numbers of the tick's end that was staged last.
    pub(super) fn tick(&mut self, context: &Context, parameters: &Parameters, has_water: bool) -> Vitals {
        if let Some((_, bytes)) = Self::arrived(&mut self.tick, 0, context).pop() {
            let head: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes[..32]);
            let sums: Vec<f32> = bytemuck::pod_collect_to_vec(&bytes[32..]);
            let levels: Vec<Level> = sums
                .chunks_exact(CLOUD_SUMS)
                .take(parameters.grid.cells[2])
                .map(|s| Level {
                    water: s[0] as f64,
                    liquid: s[1] as f64,
                    momentum: [s[2] as f64, s[3] as f64],
                    cloudy: s[4] > reduce_cloud::CLOUDY_KG_PER_KG,
                    lit: s[5] > 0.0,
                })
                .collect();
            self.clouds = reduce_cloud::join(parameters, &levels, head[0] as usize);
            let vital = |place: usize| head[4 + place];
            let falling = vital(VITAL_WATER);
            let water_bits = if falling & 0x8000_0000 == 0 {
                !falling & 0x7fff_ffff
            } else {
                falling
            };
            self.vitals = Vitals {
                finite: vital(VITAL_NOT_FINITE) == 0,
                divergence_max_per_s: f32::from_bits(vital(VITAL_DIVERGENCE)),
                water_min_kg_per_kg: if has_water { f32::from_bits(water_bits) } else { 0.0 },
            };
        }
        self.vitals
    }

    /// The cloud's numbers that came with the newest of a tick's end.
    pub(super) fn cloud(&self) -> CloudReductions {
        self.clouds
    }
}
