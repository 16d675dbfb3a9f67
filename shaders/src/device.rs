//! What a device is: it owns fields and runs passes. The tick's logic is above it, the same for every device.

use std::borrow::Cow;

use crate::catalogue::{Field, Pass};
use crate::cpu::sim::Parameters;
use crate::gpu::GpuError;

/// Which part of a substep is being computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Substep {
    /// Length of the whole substep, s.
    pub substep_s: f32,
    /// Which stage, from 0.
    pub stage: usize,
    /// How many stages a substep has: 3 (Runge-Kutta) or 1 (semi-Lagrangian).
    pub stages: usize,
}

impl Substep {
    /// Time from the substep's start to this stage's result, s: of three a third, a half, the whole
    /// (three-stage Runge-Kutta after Wicker and Skamarock 2002), of one the whole.
    pub fn stage_s(&self) -> f32 {
        if self.stages == 3 {
            self.substep_s * [1.0 / 3.0, 0.5, 1.0][self.stage]
        } else {
            self.substep_s
        }
    }
}

/// A tick's small block of reductions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reductions {
    /// Largest sum over the directions of speed over cell size, 1/s: a substep's Courant number over its length.
    pub courant_rate_per_s: f32,
    /// Largest horizontal wind component, m/s.
    pub wind_max_m_s: f32,
    /// Largest upward wind, m/s.
    pub updraught_max_m_s: f32,
    /// Largest eddy viscosity, m2/s.
    pub viscosity_max_m2_s: f32,
    /// Whether every number seen is finite.
    pub finite: bool,
}

/// What a tick's end is judged by, beside [`Reductions`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vitals {
    /// Whether every value of every field of the state, and of the extinction, is finite.
    pub finite: bool,
    /// Largest divergence of the mass flux over the density, 1/s; 0 without a flow.
    pub divergence_max_per_s: f32,
    /// Least total water, kg/kg; 0 without moisture.
    pub water_min_kg_per_kg: f32,
}

/// A tick's few numbers on the cloud.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CloudReductions {
    /// Share of columns with cloud, 0 to 1.
    pub cover: f64,
    /// Bottom of the lowest cloudy cell, m.
    pub base_m: Option<f64>,
    /// Top of the highest cloudy cell, m.
    pub top_m: Option<f64>,
    /// Mean cloud water path, kg/m2.
    pub liquid_water_path_kg_m2: f64,
    /// Mean path of all water, kg/m2.
    pub total_water_path_kg_m2: f64,
    /// Rate at which the named sources (ground, larger weather) change that path in this state, kg/m2/s.
    pub water_source_kg_m2_s: f64,
    /// Levels with any extinction: first, and one past the last; equal where there is none.
    pub lit_levels: [usize; 2],
    /// Mean wind of the cloudy air east and north, weighted by cloud water, m/s.
    pub wind_m_s: Option<[f64; 2]>,
}

/// Owns the fields of one world and runs passes on them.
pub trait Device: Send {
    /// Its name, for people: `cpu`, or the adapter's.
    fn name(&self) -> String;
    /// Runs one pass.
    fn run(&mut self, pass: Pass, substep: &Substep);
    /// Makes a stage's result the state. In stage 0 the old state becomes the substep's start.
    fn accept(&mut self, stage: usize);
    /// Reductions over the state; on a device that [lags](Device::lags) over the state at the call before.
    fn reduce(&mut self) -> Reductions;
    /// A field's values, `[z][y][x]`; none if the plan doesn't hold it or the device is lost. Waits for a device that lags.
    fn read(&self, field: Field) -> Option<Cow<'_, [f32]>>;
    /// Replaces a field's values; `false` (and nothing written) if the plan doesn't hold the field or the length differs.
    fn write(&mut self, field: Field, values: &[f32]) -> bool;
    /// Reductions over the cloud, of the last [`Device::judge`] and valid after [`Device::vitals`]; none if the plan has no cloud.
    fn reduce_cloud(&mut self) -> Option<CloudReductions>;
    /// Whether reductions are answered one call late, so that nothing waits.
    fn lags(&self) -> bool {
        false
    }
    /// Starts to reduce what a tick's end is judged by: the state, the cloud and the extinction as they are now, once the publish passes have run.
    /// Waits for nothing.
    fn judge(&mut self);
    /// How often a pass ran and how long in all, s, where the device has a clock of its own.
    fn pass_time(&self, _pass: Pass) -> Option<(u64, f64)> {
        None
    }
    /// Bytes a cell that a pass must move on this device where it holds `planned` fields, each value once: the floor of a pass whose
    /// neighbours come from cache.
    fn bytes_per_cell(&self, pass: Pass, planned: &[Field]) -> u64 {
        pass.bytes_per_cell(planned)
    }
    /// What went wrong with the device for good, if anything has.
    fn trouble(&self) -> Option<GpuError> {
        None
    }
    /// Replaces the parameters of effects and the base wind; the grid and the reference state stay.
    fn set_parameters(&mut self, parameters: &Parameters);
    /// Bytes held beside fields: a pressure solver's factors and spectra.
    fn solver_bytes(&self) -> usize;
    /// What the last [`Device::judge`] found. Waits for it where the device lags, for nothing that was begun since.
    fn vitals(&mut self) -> Vitals;
    /// Copies what a continuation needs, the fields of the state, to `slot`: a place on the device, made at the first use.
    fn save(&mut self, slot: usize);
    /// Gives `slot` the state that the last substep started from, by exchanging memory with it: nothing is copied, and what
    /// `Start*` and `Next*` hold is undefined until the next substep. Call it after a substep's last stage and on a slot that was saved to before.
    fn save_start(&mut self, slot: usize);
    /// Makes what `slot` keeps the state again, bit for bit; the slot keeps it too. `false`, and nothing is changed, where nothing
    /// was saved.
    fn restore(&mut self, slot: usize) -> bool;
    /// Bytes that the slots hold.
    fn saved_bytes(&self) -> usize;
}
