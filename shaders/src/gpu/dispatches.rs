//! Which kernels a pass of the catalogue runs and what each binds: a table, of which the bytes that a pass must move follow.

use super::kernel::Bind;
use crate::catalogue::{Field, Pass};

/// How a kernel uses a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Use {
    /// Reads it.
    Read(Field),
    /// Writes all of it.
    Write(Field),
    /// Changes it in place.
    Change(Field),
    /// Binds nothing: another entry point of the module reads something there.
    Nothing,
    /// Reads the substep's start: the state itself (first) in the first stage, later where it is kept (second).
    Start(Field, Field),
}

impl Use {
    /// The field.
    pub fn field(self) -> Option<Field> {
        match self {
            Use::Read(f) | Use::Write(f) | Use::Change(f) | Use::Start(f, _) => Some(f),
            Use::Nothing => None,
        }
    }
    /// How it is bound.
    pub fn bind(self) -> Bind {
        match self {
            Use::Read(_) | Use::Start(..) | Use::Nothing => Bind::Read,
            Use::Write(_) | Use::Change(_) => Bind::Write,
        }
    }
    /// Bytes a cell that must travel, were each value to travel once.
    fn bytes(self) -> u64 {
        match self {
            Use::Change(_) => 8,
            _ => 4,
        }
    }
}

/// How many workgroups.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Groups {
    /// A thread a cell.
    Cells,
    /// A thread for some levels of a column.
    Climbs,
    /// A thread a cell of the lowest level.
    Ground,
}

/// One kernel of a pass.
#[derive(Clone, Copy, Debug)]
pub struct Dispatch {
    /// The module.
    pub module: &'static str,
    /// Its entry point.
    pub entry: &'static str,
    /// What stands at bindings 3 and on; the first three are the same for all.
    pub uses: &'static [Use],
    /// How many workgroups.
    pub groups: Groups,
}

use Field::*;
use Groups::{Cells, Climbs, Ground};
use Use::{Change, Nothing, Read, Start, Write};

macro_rules! dispatches {
    ($($module:literal $entry:literal $groups:ident [$($use:expr),* $(,)?]);* $(;)?) => {
        &[$(Dispatch { module: $module, entry: $entry, uses: &[$($use),*], groups: $groups }),*]
    };
}

/// The kernels of a pass, in order; none where the device does it by other means: `slow_clear`, which is a command of its own, and
/// `pressure_solve`, whose buffers are no fields; and for passes of the CPU device alone.
pub fn dispatches(pass: Pass) -> &'static [Dispatch] {
    match pass {
        Pass::SlowClear | Pass::PressureSolve => &[],
        Pass::StepSaturation | Pass::Saturation | Pass::PublishSaturation => {
            dispatches!("sim/saturation_adjustment" "main" Cells [Read(Heat), Read(Water), Write(CloudWater), Write(Buoyancy)])
        }
        Pass::StepDryBuoyancy | Pass::DryBuoyancy => {
            dispatches!("sim/dry_buoyancy" "main" Cells [Read(Heat), Write(Buoyancy)])
        }
        Pass::EddyViscosity => dispatches!(
            "sim/eddy_viscosity" "main" Cells
            [Read(VelocityX), Read(VelocityY), Read(VelocityZ), Read(Buoyancy), Write(EddyViscosity)]
        ),
        Pass::DiffuseMomentum => dispatches!(
            "sim/diffuse_momentum" "main" Cells
            [Read(VelocityX), Read(VelocityY), Read(VelocityZ), Read(EddyViscosity), Change(SlowVelocityX), Change(SlowVelocityY), Change(SlowVelocityZ)]
        ),
        Pass::DiffuseHeat => {
            dispatches!("sim/diffuse_scalar" "main" Cells [Read(Heat), Read(EddyViscosity), Change(SlowHeat)])
        }
        Pass::DiffuseWater => {
            dispatches!("sim/diffuse_scalar" "main" Cells [Read(Water), Read(EddyViscosity), Change(SlowWater)])
        }
        Pass::BodyForce => dispatches!(
            "sim/body_force" "velocity_x" Cells [Read(VelocityX), Change(SlowVelocityX)];
            "sim/body_force" "velocity_y" Cells [Read(VelocityY), Change(SlowVelocityY)];
            "sim/body_force" "velocity_z" Cells [Read(VelocityZ), Change(SlowVelocityZ)]
        ),
        // On the CPU alone; their rungs say why.
        Pass::ConstantViscosityMomentum | Pass::ConstantViscosityHeat | Pass::ConstantViscosityWater => &[],
        Pass::PressureJacobi | Pass::PressureRedBlackSor | Pass::PressureMultigrid => &[],
        Pass::StartSaturation
        | Pass::AddTendencies
        | Pass::CentreWind
        | Pass::Departure
        | Pass::Arrival
        | Pass::FixWater
        | Pass::SaturationNext
        | Pass::DryBuoyancyNext
        | Pass::LinearHeat
        | Pass::MacCormackHeat
        | Pass::CubicHeat
        | Pass::LinearWater
        | Pass::MacCormackWater
        | Pass::CubicWater
        | Pass::LinearVelocityX
        | Pass::MacCormackVelocityX
        | Pass::CubicVelocityX
        | Pass::LinearVelocityY
        | Pass::MacCormackVelocityY
        | Pass::CubicVelocityY
        | Pass::LinearVelocityZ
        | Pass::MacCormackVelocityZ
        | Pass::CubicVelocityZ => &[],
        Pass::SurfaceFlux => dispatches!(
            "sim/surface_flux" "main" Ground
            [Read(VelocityX), Read(VelocityY), Change(SlowVelocityX), Change(SlowVelocityY), Change(SlowHeat), Change(SlowWater)]
        ),
        Pass::Coriolis => dispatches!(
            "sim/coriolis" "main" Cells
            [Read(VelocityX), Read(VelocityY), Change(SlowVelocityX), Change(SlowVelocityY)]
        ),
        Pass::LargeScaleHeat => dispatches!("sim/large_scale" "heat" Cells [Read(Heat), Change(SlowHeat)]),
        Pass::LargeScaleWater => dispatches!("sim/large_scale" "water" Cells [Read(Water), Change(SlowWater)]),
        Pass::LargeScaleMomentum => dispatches!(
            "sim/large_scale" "momentum" Cells [Read(VelocityX), Change(SlowVelocityX)];
            "sim/large_scale" "momentum" Cells [Read(VelocityY), Change(SlowVelocityY)]
        ),
        Pass::Sponge => dispatches!(
            "sim/sponge" "velocity_x" Cells [Read(VelocityX), Change(SlowVelocityX)];
            "sim/sponge" "velocity_y" Cells [Read(VelocityY), Change(SlowVelocityY)];
            "sim/sponge" "velocity_z" Cells [Read(VelocityZ), Change(SlowVelocityZ)];
            "sim/sponge" "heat" Cells [Read(Heat), Change(SlowHeat)]
        ),
        Pass::AdvectHeat => dispatches!(
            "sim/advect_scalar" "main" Climbs
            [Read(VelocityX), Read(VelocityY), Read(VelocityZ), Read(Heat), Start(Heat, StartHeat), Read(SlowHeat), Write(NextHeat)]
        ),
        Pass::AdvectWater => dispatches!(
            "sim/advect_scalar" "main" Climbs
            [Read(VelocityX), Read(VelocityY), Read(VelocityZ), Read(Water), Start(Water, StartWater), Read(SlowWater), Write(NextWater)]
        ),
        Pass::AdvectMomentum => dispatches!(
            "sim/advect_momentum" "velocity_x" Climbs
            [Read(VelocityX), Read(VelocityY), Read(VelocityZ), Start(VelocityX, StartVelocityX), Read(SlowVelocityX), Nothing, Write(NextVelocityX)];
            "sim/advect_momentum" "velocity_y" Climbs
            [Read(VelocityX), Read(VelocityY), Read(VelocityZ), Start(VelocityY, StartVelocityY), Read(SlowVelocityY), Nothing, Write(NextVelocityY)];
            "sim/advect_momentum" "velocity_z" Climbs
            [Read(VelocityX), Read(VelocityY), Read(VelocityZ), Start(VelocityZ, StartVelocityZ), Read(SlowVelocityZ), Read(Buoyancy), Write(NextVelocityZ)]
        ),
        Pass::CloudyAscent => {
            dispatches!("sim/cloudy_ascent" "main" Cells [Read(CloudWater), Read(VelocityZ), Change(NextHeat)])
        }
        Pass::Project => dispatches!(
            "sim/project" "main" Cells [Read(Pressure), Change(NextVelocityX), Change(NextVelocityY), Change(NextVelocityZ)]
        ),
        Pass::CloudExtinction => dispatches!("sim/cloud_extinction" "main" Cells [Read(CloudWater), Write(Extinction)]),
    }
}

/// Whether a pass runs on this device; if not, its rung in the catalogue says why.
pub fn is_there(pass: Pass) -> bool {
    matches!(pass, Pass::SlowClear | Pass::PressureSolve) || !dispatches(pass).is_empty()
}

/// See [`Device::bytes_per_cell`](crate::Device::bytes_per_cell): each value once a kernel.
pub fn bytes_per_cell(pass: Pass, planned: &[Field]) -> u64 {
    match pass {
        Pass::SlowClear => 4 * pass.info().writes.iter().filter(|f| planned.contains(f)).count() as u64,
        // Velocities and pressure once, the half spectrum (4 bytes a cell) ten times, its pivots (2 bytes) twice.
        Pass::PressureSolve => 16 + 40 + 4,
        // A single level: nothing beside a box of many.
        Pass::SurfaceFlux => 0,
        _ => dispatches(pass)
            .iter()
            .flat_map(|d| d.uses.iter())
            .filter(|u| u.field().is_some_and(|f| planned.contains(&f)))
            .map(|u| u.bytes())
            .sum(),
    }
}
