//! The GPU device: one world's fields in GPU buffers, passes recorded and submitted, a small block of numbers read back late.
//!
//! Nothing waits but who asks for a field. A substep's reductions are copied into a ring of staging buffers and read while the next substep
//! runs, so what [`Device::reduce`] answers is one substep old; after the state was written from outside it is fresh once.

use std::borrow::Cow;
use std::cell::{Cell, RefCell};
use std::collections::HashMap;
use std::sync::Arc;

use super::context::Context;
use super::dispatches::{Groups, Use, Work, bytes_per_cell, dispatches, is_there, sequence};
use super::error::GpuError;
use super::kernel::{Bind, Kernel};
use super::pressure;
use super::profiles::{self, Sim, Step, holds};
use super::readback::{Readback, Ring};
use crate::catalogue::{Field, Pass, Phase};
use crate::cpu::sim::Parameters;
use crate::device::{CloudReductions, Device, Reductions, Substep, Vitals};

/// A field's memory. The number stays with the buffer when fields are swapped; bound groups are kept by it.
#[derive(Clone)]
struct Memory {
    buffer: wgpu::Buffer,
    number: u8,
}

/// What a kept bind group is found by: the kernel, the stage's uniform and the memory at each binding.
type GroupKey = (usize, usize, [u8; 8]);

/// The GPU device of one world.
pub struct Gpu {
    context: Arc<Context>,
    parameters: Parameters,
    planned: Vec<Field>,
    sim: wgpu::Buffer,
    profiles: wgpu::Buffer,
    steps: [wgpu::Buffer; 3],
    steps_written: [Cell<Step>; 3],
    memory: Vec<Option<Memory>>,
    nothing: Vec<Memory>,
    /// Working memory, where a pass of the plan uses it.
    work: [Option<Memory>; Work::ALL.len()],
    slots: Vec<Vec<Option<Memory>>>,
    /// The pressures that slots keep beside the state, for solvers that start from the last one, and whether they hold one.
    kept_pressures: Vec<(Option<wgpu::Buffer>, bool)>,
    kernels: HashMap<(&'static str, &'static str), (usize, Arc<Kernel>)>,
    groups: RefCell<HashMap<GroupKey, wgpu::BindGroup>>,
    solver: Option<pressure::Solver>,
    encoder: RefCell<Option<wgpu::CommandEncoder>>,
    readback: RefCell<Readback>,
}

impl Gpu {
    /// Allocates `planned` fields, compiles the kernels of `passes` and plans the pressure solver.
    ///
    /// Errors: `NoShader` for a pass of the CPU device alone; `TooLarge` where a field or a line of the transform exceeds the adapter's limits; those of memory, shaders and loss.
    pub fn new(
        context: Arc<Context>,
        parameters: Parameters,
        planned: &[Field],
        passes: &[Pass],
    ) -> Result<Self, GpuError> {
        if let Some(pass) = passes.iter().find(|p| !is_there(**p)) {
            return Err(GpuError::NoShader { pass: pass.info().name });
        }
        let grid = parameters.grid;
        let bytes = 4 * grid.len() as u64;
        let mut memory = vec![None; Field::ALL.len()];
        for (number, &field) in planned.iter().enumerate() {
            memory[field as usize] = Some(Memory {
                buffer: context.storage(field.name(), bytes)?,
                number: number as u8,
            });
        }
        // What a kernel binds for a field that the plan lacks, one for each binding: two writable bindings may not share memory.
        let nothing = (0..8u8)
            .map(|n| {
                Ok(Memory {
                    buffer: context.storage("nothing", 16)?,
                    number: 200 + n,
                })
            })
            .collect::<Result<Vec<_>, GpuError>>()?;
        let mut kernels = HashMap::new();
        for dispatch in passes.iter().flat_map(|p| dispatches(*p)) {
            let mut binds = vec![Bind::Uniform, Bind::Uniform, Bind::Read];
            binds.extend(dispatch.uses.iter().map(|u| u.bind()));
            let kernel = context.kernel(dispatch.module, dispatch.entry, &binds)?;
            let number = kernels.len();
            kernels
                .entry((dispatch.module, dispatch.entry))
                .or_insert((number, kernel));
        }
        let mut work = [const { None }; Work::ALL.len()];
        for &pass in passes {
            // A substep so long that every kernel runs that a shorter one may ask for.
            for at in sequence(pass, &parameters, 1e6) {
                for kind in dispatches(pass)[at].uses.iter().filter_map(|u| u.work()) {
                    let held: &mut Option<Memory> = &mut work[kind as usize];
                    if held.is_none() {
                        let bytes = match kind {
                            Work::Levels => 16 * (grid.cells[2] as u64 + 1),
                            Work::First | Work::Second => bytes,
                        };
                        *held = Some(Memory {
                            buffer: context.storage("working memory", bytes)?,
                            number: 220 + kind as u8,
                        });
                    }
                }
            }
        }
        let solver = if passes.contains(&Pass::PressureSolve) {
            Some(pressure::Solver::new(&context, &parameters)?)
        } else {
            None
        };
        let sim = context.uniform("sim", bytemuck::bytes_of(&Sim::new(&parameters, planned)))?;
        let profiles = context.storage_of("profiles", bytemuck::cast_slice(&profiles::pack(&parameters)))?;
        let step = || context.uniform("step", bytemuck::bytes_of(&Step::default()));
        Ok(Self {
            steps: [step()?, step()?, step()?],
            steps_written: Default::default(),
            readback: RefCell::new(Readback::new(&context, &grid)?),
            planned: planned.to_vec(),
            sim,
            profiles,
            memory,
            nothing,
            work,
            slots: Vec::new(),
            kept_pressures: Vec::new(),
            kernels,
            groups: RefCell::default(),
            solver,
            encoder: RefCell::default(),
            parameters,
            context,
        })
    }

    fn holds(&self, field: Field) -> bool {
        self.memory[field as usize].is_some()
    }

    /// A field's memory, or at binding `n` nothing's.
    fn memory(&self, field: Field, n: usize) -> &Memory {
        self.memory[field as usize].as_ref().unwrap_or(&self.nothing[n])
    }

    /// Records into the open encoder.
    fn record<T>(&self, work: impl FnOnce(&mut wgpu::CommandEncoder) -> T) -> T {
        let mut open = self.encoder.borrow_mut();
        let encoder = open.get_or_insert_with(|| self.context.device.create_command_encoder(&Default::default()));
        work(encoder)
    }

    /// Hands what was recorded to the GPU.
    fn submit(&self) -> Option<wgpu::SubmissionIndex> {
        let encoder = self.encoder.borrow_mut().take()?;
        Some(self.context.queue.submit([encoder.finish()]))
    }

    /// Makes the stage's uniform hold what `substep` says. A change waits for what was recorded with the old one to be submitted.
    fn set_step(&self, substep: &Substep) {
        let step = Step::new(substep, self.parameters.grid.plane());
        if self.steps_written[substep.stage].get() != step {
            self.submit();
            self.context
                .queue
                .write_buffer(&self.steps[substep.stage], 0, bytemuck::bytes_of(&step));
            self.steps_written[substep.stage].set(step);
        }
    }

    fn workgroups(&self, groups: Groups) -> [u32; 3] {
        let [_, _, levels] = self.parameters.grid.cells.map(|n| n as u32);
        let across = self.parameters.grid.plane().div_ceil(64) as u32;
        match groups {
            Groups::Cells => [across, 1, levels],
            Groups::Climbs => [across, 1, levels.div_ceil(holds::LEVELS_PER_THREAD)],
            Groups::Ground => [across, 1, 1],
            Groups::HalfGround => [across.div_ceil(2), 1, 1],
            Groups::HalfColumn => [(self.parameters.grid.cells[1] / 2).div_ceil(64) as u32, 1, 1],
            Groups::HalfRow => [(self.parameters.grid.cells[0] / 2).div_ceil(64) as u32, 1, 1],
            Groups::Levels => [levels, 1, 1],
            Groups::One => [1, 1, 1],
        }
    }

    /// The group that binds the shared buffers and `uses`.
    fn bound(&self, number: usize, kernel: &Kernel, uses: &[Use], stage: usize) -> wgpu::BindGroup {
        let memory: Vec<&Memory> = uses
            .iter()
            .enumerate()
            .map(|(n, u)| match *u {
                Use::Start(_, start) if stage > 0 => self.memory(start, n),
                Use::Held(held, state) if !self.holds(held) => self.memory(state, n),
                Use::Reads(kind) | Use::Writes(kind) => self.work[kind as usize].as_ref().unwrap_or(&self.nothing[n]),
                u => u.field().map_or(&self.nothing[n], |f| self.memory(f, n)),
            })
            .collect();
        let mut numbers = [255; 8];
        for (to, from) in numbers.iter_mut().zip(&memory) {
            *to = from.number;
        }
        self.groups
            .borrow_mut()
            .entry((number, stage, numbers))
            .or_insert_with(|| {
                let mut buffers = vec![&self.sim, &self.steps[stage], &self.profiles];
                buffers.extend(memory.iter().map(|m| &m.buffer));
                kernel.bind(&self.context, &buffers)
            })
            .clone()
    }

    fn run_kernels(&self, pass: Pass, substep: &Substep) {
        let stage = substep.stage;
        let timing = self.readback.borrow_mut().begin_pass(pass);
        self.record(|encoder| {
            let mut compute = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some(pass.info().name),
                timestamp_writes: timing.as_ref().map(|t| t.writes()),
            });
            if pass == Pass::PressureSolve
                && let Some(solver) = &self.solver
            {
                let velocity = [Field::NextVelocityX, Field::NextVelocityY, Field::NextVelocityZ];
                solver.record(
                    &self.context,
                    &mut compute,
                    [&self.sim, &self.steps[stage], &self.profiles],
                    velocity.map(|f| &self.memory(f, 0).buffer),
                    &self.memory(Field::Pressure, 0).buffer,
                );
            }
            for at in sequence(pass, &self.parameters, substep.substep_s) {
                let dispatch = &dispatches(pass)[at];
                // A kernel whose result nobody holds has nothing to do.
                let wanted = dispatch
                    .uses
                    .iter()
                    .any(|u| u.bind() == Bind::Write && u.field().is_none_or(|f| self.holds(f)));
                let Some((number, kernel)) = self.kernels.get(&(dispatch.module, dispatch.entry)) else {
                    continue;
                };
                if wanted {
                    let group = self.bound(*number, kernel, dispatch.uses, stage);
                    kernel.dispatch(&mut compute, &group, self.workgroups(dispatch.groups));
                }
            }
        });
    }

    /// The pressure, where the solver starts from the last one and a continuation needs it.
    fn lasting_pressure(&self) -> Option<wgpu::Buffer> {
        let pressure = self.memory[Field::Pressure as usize].as_ref()?;
        self.parameters
            .methods
            .pressure
            .is_iterative()
            .then(|| pressure.buffer.clone())
    }

    /// Records the copy of the state to a slot, or back.
    fn copy_state(&self, slot: usize, to_slot: bool) {
        self.record(|encoder| {
            for (field, kept) in Field::STATE.into_iter().zip(&self.slots[slot]) {
                if let (Some(state), Some(kept)) = (&self.memory[field as usize], kept) {
                    let (from, to) = if to_slot { (state, kept) } else { (kept, state) };
                    encoder.copy_buffer_to_buffer(&from.buffer, 0, &to.buffer, 0, from.buffer.size());
                }
            }
        });
    }

    /// Records the reductions of the state and the copy into the ring; submits.
    fn start_reduce(&self) {
        self.record(|encoder| {
            let readback = self.readback.borrow();
            let fields = [
                Field::VelocityX,
                Field::VelocityY,
                Field::VelocityZ,
                Field::EddyViscosity,
            ];
            let mut buffers = vec![&self.sim, &self.steps[0], &self.profiles];
            buffers.extend(fields.iter().enumerate().map(|(n, f)| &self.memory(*f, n).buffer));
            readback.reduce(&self.context, encoder, buffers, self.workgroups(Groups::Cells));
        });
        let staged = self.record(|encoder| self.readback.borrow_mut().stage(encoder, Ring::State));
        if let (Some(staged), Some(submission)) = (staged, self.submit()) {
            self.readback.borrow_mut().submitted(staged, submission);
        }
    }
}

impl Device for Gpu {
    fn name(&self) -> String {
        let report = &self.context.report;
        format!("gpu: {} ({}, {})", report.name, report.backend, report.driver)
    }

    fn run(&mut self, pass: Pass, substep: &Substep) {
        // What is published depends on no step.
        if pass.info().phase != Phase::Publish {
            self.set_step(substep);
        }
        if pass == Pass::SlowClear {
            self.record(|encoder| {
                for &field in pass.info().writes {
                    if let Some(memory) = &self.memory[field as usize] {
                        encoder.clear_buffer(&memory.buffer, 0, None);
                    }
                }
            });
        } else {
            self.run_kernels(pass, substep);
        }
    }

    fn accept(&mut self, stage: usize) {
        for state in Field::STATE {
            let (Some(start), Some(next)) = (state.start(), state.next()) else {
                continue;
            };
            if stage == 0 && self.holds(start) {
                self.memory.swap(state as usize, start as usize);
            }
            self.memory.swap(state as usize, next as usize);
        }
    }

    fn reduce(&mut self) -> Reductions {
        self.start_reduce();
        self.readback.borrow_mut().reductions(&self.context)
    }

    fn read(&self, field: Field) -> Option<Cow<'_, [f32]>> {
        let memory = self.memory[field as usize].as_ref()?;
        self.submit();
        let bytes = self
            .context
            .read(&memory.buffer, 4 * self.parameters.grid.len() as u64)
            .ok()?;
        Some(Cow::Owned(bytemuck::pod_collect_to_vec(&bytes)))
    }

    fn write(&mut self, field: Field, values: &[f32]) -> bool {
        let Some(memory) = &self.memory[field as usize] else {
            return false;
        };
        if values.len() != self.parameters.grid.len() {
            return false;
        }
        self.submit();
        self.context
            .queue
            .write_buffer(&memory.buffer, 0, bytemuck::cast_slice(values));
        self.readback.borrow_mut().forget();
        true
    }

    fn reduce_cloud(&mut self) -> Option<CloudReductions> {
        self.holds(Field::CloudWater).then(|| self.readback.borrow().cloud())
    }

    fn judge(&mut self) {
        let shared = [&self.sim, &self.steps[0], &self.profiles];
        let with = |fields: &[Field]| -> Vec<&wgpu::Buffer> {
            let fields = fields.iter().enumerate().map(|(n, f)| &self.memory(*f, n).buffer);
            shared.iter().copied().chain(fields).collect()
        };
        self.record(|encoder| {
            use Field::*;
            let readback = self.readback.borrow();
            let cells = self.workgroups(Groups::Cells);
            let judged = with(&[VelocityX, VelocityY, VelocityZ, Heat, Water, Extinction]);
            readback.judge(&self.context, encoder, judged, cells);
            if self.holds(CloudWater) {
                let clouds = with(&[CloudWater, Water, Extinction, VelocityX, VelocityY]);
                let columns = self.workgroups(Groups::Ground);
                readback.reduce_cloud(&self.context, encoder, clouds, columns, &self.parameters.grid);
            }
        });
        let staged = self.record(|encoder| self.readback.borrow_mut().stage(encoder, Ring::Tick));
        if let (Some(staged), Some(submission)) = (staged, self.submit()) {
            self.readback.borrow_mut().submitted(staged, submission);
        }
    }

    fn vitals(&mut self) -> Vitals {
        let has_water = self.holds(Field::Water);
        self.readback
            .borrow_mut()
            .tick(&self.context, &self.parameters, has_water)
    }

    fn save(&mut self, slot: usize) {
        while self.slots.len() <= slot {
            let number = 50 + 5 * self.slots.len() as u8;
            let bytes = 4 * self.parameters.grid.len() as u64;
            let kept = Field::STATE.iter().enumerate().map(|(n, field)| {
                // Where memory runs out nothing is kept, and restoring says so.
                self.memory[*field as usize].as_ref()?;
                Some(Memory {
                    buffer: self.context.storage("kept state", bytes).ok()?,
                    number: number + n as u8,
                })
            });
            self.slots.push(kept.collect());
        }
        self.copy_state(slot, true);
        if let Some(pressure) = self.lasting_pressure() {
            let bytes = pressure.size();
            while self.kept_pressures.len() <= slot {
                self.kept_pressures
                    .push((self.context.storage("kept pressure", bytes).ok(), false));
            }
            if let (Some(kept), holds) = &mut self.kept_pressures[slot] {
                *holds = true;
                let kept = kept.clone();
                self.record(|encoder| encoder.copy_buffer_to_buffer(&pressure, 0, &kept, 0, bytes));
            }
        }
    }

    fn save_start(&mut self, slot: usize) {
        // The pressure that the substep started from is gone, and the one that it ended with may be what spoilt it.
        if let Some((_, holds)) = self.kept_pressures.get_mut(slot) {
            *holds = false;
        }
        let Some(slot) = self.slots.get_mut(slot) else { return };
        for (field, kept) in Field::STATE.into_iter().zip(slot) {
            // A method of one stage has no use for `Start*`: what was the state is then in the memory of `Next*`.
            let from = [field.start(), field.next()]
                .into_iter()
                .flatten()
                .find(|f| self.memory[*f as usize].is_some());
            if let Some(from) = from {
                std::mem::swap(&mut self.memory[from as usize], kept);
            }
        }
    }

    fn restore(&mut self, slot: usize) -> bool {
        let held = Field::STATE.iter().map(|f| self.holds(*f));
        let whole = self
            .slots
            .get(slot)
            .is_some_and(|kept| kept.iter().zip(held).all(|(kept, held)| kept.is_some() == held));
        if whole {
            self.copy_state(slot, false);
            if let Some(pressure) = self.lasting_pressure() {
                self.record(|encoder| match self.kept_pressures.get(slot) {
                    Some((Some(kept), true)) => encoder.copy_buffer_to_buffer(kept, 0, &pressure, 0, pressure.size()),
                    _ => encoder.clear_buffer(&pressure, 0, None),
                });
            }
            self.readback.borrow_mut().forget();
        }
        whole
    }

    fn saved_bytes(&self) -> usize {
        let kept = self.slots.iter().flatten().flatten();
        let pressures = self.kept_pressures.iter().filter_map(|(kept, _)| kept.as_ref());
        kept.map(|m| &m.buffer)
            .chain(pressures)
            .map(|b| b.size() as usize)
            .sum()
    }

    fn set_parameters(&mut self, parameters: &Parameters) {
        self.submit();
        self.parameters.clone_from(parameters);
        let sim = Sim::new(parameters, &self.planned);
        self.context.queue.write_buffer(&self.sim, 0, bytemuck::bytes_of(&sim));
        self.context
            .queue
            .write_buffer(&self.profiles, 0, bytemuck::cast_slice(&profiles::pack(parameters)));
        self.readback.borrow_mut().forget();
    }

    fn solver_bytes(&self) -> usize {
        let work: usize = self.work.iter().flatten().map(|m| m.buffer.size() as usize).sum();
        self.solver.as_ref().map_or(0, pressure::Solver::bytes) + work
    }

    fn lags(&self) -> bool {
        true
    }

    fn pass_time(&self, pass: Pass) -> Option<(u64, f64)> {
        self.readback.borrow().time(pass)
    }

    fn bytes_per_cell(&self, pass: Pass, planned: &[Field]) -> u64 {
        bytes_per_cell(pass, planned)
    }

    fn trouble(&self) -> Option<GpuError> {
        self.context.check().err()
    }
}
