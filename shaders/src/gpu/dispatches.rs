//! Which kernels a pass of the catalogue runs and what each binds: a table, of which the bytes that a pass must move follow.

use super::kernel::Bind;
use crate::catalogue::{Field, Pass};
use crate::cpu::sim::Parameters;
use crate::cpu::sim::constant_viscosity::implicit_sweeps;
use crate::cpu::sim::parameters::{DiffusionScheme, PressureMethod};

/// Memory that no field of the plan is: what a pass needs while it runs, and nothing reads afterwards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Work {
    /// As large as a field: one side of sweeps, or scratch.
    First,
    /// As large as a field: the other side of sweeps, or a right side.
    Second,
    /// Some numbers a level.
    Levels,
}

impl Work {
    /// All of it.
    pub const ALL: [Work; 3] = [Work::First, Work::Second, Work::Levels];
}

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
    /// Reads what a semi-Lagrangian stage carries: the state with the tendencies in it (first), or, where none are held, the state itself (second).
    Held(Field, Field),
    /// Reads working memory.
    Reads(Work),
    /// Writes or changes working memory.
    Writes(Work),
}

impl Use {
    /// The field.
    pub fn field(self) -> Option<Field> {
        match self {
            Use::Read(f) | Use::Write(f) | Use::Change(f) | Use::Start(f, _) | Use::Held(f, _) => Some(f),
            Use::Nothing | Use::Reads(_) | Use::Writes(_) => None,
        }
    }
    /// The working memory.
    pub fn work(self) -> Option<Work> {
        match self {
            Use::Reads(w) | Use::Writes(w) => Some(w),
            _ => None,
        }
    }
    /// How it is bound.
    pub fn bind(self) -> Bind {
        match self {
            Use::Read(_) | Use::Start(..) | Use::Held(..) | Use::Reads(_) | Use::Nothing => Bind::Read,
            Use::Write(_) | Use::Change(_) | Use::Writes(_) => Bind::Write,
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
    /// A thread for every second cell of the lowest level.
    HalfGround,
    /// A thread for every second cell along y.
    HalfColumn,
    /// A thread for every second cell along x.
    HalfRow,
    /// A workgroup a level.
    Levels,
    /// A single workgroup.
    One,
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
use Groups::{Cells, Climbs, Ground, HalfColumn, HalfGround, HalfRow, Levels, One};
use Use::{Change, Held, Nothing, Read, Reads, Start, Write, Writes};
use Work::{First, Second};

macro_rules! dispatches {
    ($($module:literal $entry:literal $groups:ident [$($use:expr),* $(,)?]);* $(;)?) => {
        &[$(Dispatch { module: $module, entry: $entry, uses: &[$($use),*], groups: $groups }),*]
    };
}

/// One quantity's kernels of constant viscosity: explicit; a sweep from the state, there and back; the same for the last sweep; the tendency of
/// either side.
macro_rules! mixing {
    ($($state:ident $slow:ident $add:literal $sweep:literal $last:literal);*) => {
        dispatches!($(
            "sim/constant_viscosity" $add Cells [Read($state), Read($state), Change($slow)];
            "sim/constant_viscosity" $sweep Cells [Read($state), Read($state), Writes(First)];
            "sim/constant_viscosity" $sweep Cells [Read($state), Reads(First), Writes(Second)];
            "sim/constant_viscosity" $sweep Cells [Read($state), Reads(Second), Writes(First)];
            "sim/constant_viscosity" $last Cells [Read($state), Read($state), Writes(First)];
            "sim/constant_viscosity" $last Cells [Read($state), Reads(First), Writes(Second)];
            "sim/constant_viscosity" $last Cells [Read($state), Reads(Second), Writes(First)];
            "sim/constant_viscosity" "finish" Cells [Read($state), Reads(First), Change($slow)];
            "sim/constant_viscosity" "finish" Cells [Read($state), Reads(Second), Change($slow)]
        );*)
    };
}
/// Kernels of constant viscosity a quantity.
const MIXING_KERNELS: usize = 9;

macro_rules! semi_lagrangian {
    ($module:literal $entry:literal [$state:ident $slow:ident $next:ident] $buoyancy:expr) => {
        dispatches!(
            $module $entry Cells
            [Held($slow, $state), Read(DepartureX), Read(DepartureY), Read(DepartureZ), Write($next), $buoyancy]
        )
    };
}

macro_rules! mac_cormack {
    ($there:literal $back:literal $limit:literal [$state:ident $slow:ident $next:ident] $buoyancy:expr) => {
        dispatches!(
            "sim/mac_cormack" $there Cells
            [Held($slow, $state), Read(DepartureX), Read(DepartureY), Read(DepartureZ), Write(Forward), Write(ForwardLow), Write(ForwardHigh)];
            "sim/mac_cormack" $back Cells
            [Held($slow, $state), Read(ArrivalX), Read(ArrivalY), Read(ArrivalZ), Write($next), Read(Forward)];
            "sim/mac_cormack" $limit Cells [Change($next), Read(ForwardLow), Read(ForwardHigh), $buoyancy]
        )
    };
}

/// The kernels of a pass, in the order in which [`sequence`] takes them; none where the device does it by other means: `slow_clear`, which is a command of its own, and
/// `pressure_solve`, whose buffers are no fields; and for passes of the CPU device alone.
pub fn dispatches(pass: Pass) -> &'static [Dispatch] {
    match pass {
        Pass::SlowClear | Pass::PressureSolve => &[],
        Pass::StepSaturation | Pass::StartSaturation | Pass::Saturation | Pass::PublishSaturation => {
            dispatches!("sim/saturation_adjustment" "main" Cells [Read(Heat), Read(Water), Write(CloudWater), Write(Buoyancy)])
        }
        Pass::StepDryBuoyancy | Pass::DryBuoyancy => {
            dispatches!("sim/dry_buoyancy" "main" Cells [Read(Heat), Write(Buoyancy)])
        }
        Pass::SaturationNext => {
            dispatches!("sim/saturation_adjustment" "main" Cells [Read(NextHeat), Read(NextWater), Write(CloudWater), Write(Buoyancy)])
        }
        Pass::DryBuoyancyNext => {
            dispatches!("sim/dry_buoyancy" "main" Cells [Read(NextHeat), Write(Buoyancy)])
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
        Pass::ConstantViscosityMomentum => mixing!(
            VelocityX SlowVelocityX "add_velocity" "sweep_velocity" "last_velocity";
            VelocityY SlowVelocityY "add_velocity" "sweep_velocity" "last_velocity";
            VelocityZ SlowVelocityZ "add_velocity_z" "sweep_velocity_z" "last_velocity_z"
        ),
        Pass::ConstantViscosityHeat => mixing!(Heat SlowHeat "add_scalar" "sweep_scalar" "last_scalar"),
        Pass::ConstantViscosityWater => mixing!(Water SlowWater "add_scalar" "sweep_scalar" "last_scalar"),
        Pass::PressureJacobi => dispatches!(
            "sim/pressure_source" "means" Levels [Nothing, Nothing, Read(NextVelocityZ), Writes(Work::Levels), Change(Pressure)];
            "sim/pressure_source" "column" One [Nothing, Nothing, Nothing, Writes(Work::Levels)];
            "sim/pressure_source" "load" Cells
            [Read(NextVelocityX), Read(NextVelocityY), Read(NextVelocityZ), Writes(Work::Levels), Change(Pressure), Writes(Second)];
            "sim/pressure_jacobi" "sweep" Cells [Read(Pressure), Reads(Second), Writes(First)];
            "sim/pressure_jacobi" "sweep" Cells [Reads(First), Reads(Second), Write(Pressure)];
            "sim/pressure_jacobi" "last_sweep" Cells [Read(Pressure), Reads(Second), Writes(First)];
            "sim/pressure_jacobi" "last_sweep" Cells [Reads(First), Reads(Second), Write(Pressure)];
            "sim/pressure_source" "top" One [Reads(First), Nothing, Nothing, Writes(Work::Levels)];
            "sim/pressure_source" "store" Cells [Reads(First), Nothing, Nothing, Writes(Work::Levels), Write(Pressure)];
            "sim/pressure_source" "top" One [Read(Pressure), Nothing, Nothing, Writes(Work::Levels)];
            "sim/pressure_source" "store_in_place" Cells [Nothing, Nothing, Nothing, Writes(Work::Levels), Change(Pressure)]
        ),
        Pass::PressureRedBlackSor => dispatches!(
            "sim/pressure_source" "means" Levels [Nothing, Nothing, Read(NextVelocityZ), Writes(Work::Levels), Change(Pressure)];
            "sim/pressure_source" "column" One [Nothing, Nothing, Nothing, Writes(Work::Levels)];
            "sim/pressure_source" "load" Cells
            [Read(NextVelocityX), Read(NextVelocityY), Read(NextVelocityZ), Writes(Work::Levels), Change(Pressure), Writes(Second)];
            "sim/pressure_red_black_sor" "red" HalfGround [Reads(Second), Change(Pressure), Writes(First)];
            "sim/pressure_red_black_sor" "black" HalfGround [Reads(Second), Change(Pressure), Writes(First)];
            "sim/pressure_red_black_sor" "last_column_even" HalfColumn [Reads(Second), Change(Pressure), Writes(First)];
            "sim/pressure_red_black_sor" "last_column_odd" HalfColumn [Reads(Second), Change(Pressure), Writes(First)];
            "sim/pressure_red_black_sor" "last_row_even" HalfRow [Reads(Second), Change(Pressure), Writes(First)];
            "sim/pressure_red_black_sor" "last_row_odd" HalfRow [Reads(Second), Change(Pressure), Writes(First)];
            "sim/pressure_red_black_sor" "corner" One [Reads(Second), Change(Pressure), Writes(First)];
            "sim/pressure_source" "top" One [Read(Pressure), Nothing, Nothing, Writes(Work::Levels)];
            "sim/pressure_source" "store_in_place" Cells [Nothing, Nothing, Nothing, Writes(Work::Levels), Change(Pressure)]
        ),
        // On the CPU alone; its rung says why.
        Pass::PressureMultigrid => &[],
        Pass::AddTendencies => dispatches!(
            "sim/add_tendencies" "main" Cells [Read(VelocityX), Change(SlowVelocityX)];
            "sim/add_tendencies" "main" Cells [Read(VelocityY), Change(SlowVelocityY)];
            "sim/add_tendencies" "main" Cells [Read(VelocityZ), Change(SlowVelocityZ)];
            "sim/add_tendencies" "main" Cells [Read(Heat), Change(SlowHeat)];
            "sim/add_tendencies" "main" Cells [Read(Water), Change(SlowWater)]
        ),
        Pass::CentreWind => dispatches!(
            "sim/centre_wind" "main" Cells
            [Read(VelocityX), Read(VelocityY), Read(VelocityZ), Write(CentreVelocityX), Write(CentreVelocityY), Write(CentreVelocityZ)]
        ),
        Pass::Departure => dispatches!(
            "sim/departure" "main" Cells
            [Read(CentreVelocityX), Read(CentreVelocityY), Read(CentreVelocityZ), Write(DepartureX), Write(DepartureY), Write(DepartureZ)]
        ),
        Pass::Arrival => dispatches!(
            "sim/departure" "ahead_in_time" Cells
            [Read(CentreVelocityX), Read(CentreVelocityY), Read(CentreVelocityZ), Write(ArrivalX), Write(ArrivalY), Write(ArrivalZ)]
        ),
        Pass::FixWater => dispatches!(
            "sim/mass_fixer" "levels" Levels [Held(SlowWater, Water), Read(NextWater), Writes(Work::Levels)];
            "sim/mass_fixer" "join" One [Nothing, Nothing, Writes(Work::Levels)];
            "sim/mass_fixer" "main" Cells [Nothing, Nothing, Writes(Work::Levels), Change(NextWater)]
        ),
        Pass::FillWater => dispatches!("sim/hole_filler" "main" Ground [Change(NextWater)]),
        Pass::LinearHeat => {
            semi_lagrangian!("sim/semi_lagrangian_linear" "centre" [Heat SlowHeat NextHeat] Nothing)
        }
        Pass::CubicHeat => {
            semi_lagrangian!("sim/semi_lagrangian_cubic" "centre" [Heat SlowHeat NextHeat] Nothing)
        }
        Pass::MacCormackHeat => {
            mac_cormack!("there_centre" "back_again_centre" "limit" [Heat SlowHeat NextHeat] Nothing)
        }
        Pass::LinearWater => {
            semi_lagrangian!("sim/semi_lagrangian_linear" "centre" [Water SlowWater NextWater] Nothing)
        }
        Pass::CubicWater => {
            semi_lagrangian!("sim/semi_lagrangian_cubic" "centre" [Water SlowWater NextWater] Nothing)
        }
        Pass::MacCormackWater => {
            mac_cormack!("there_centre" "back_again_centre" "limit" [Water SlowWater NextWater] Nothing)
        }
        Pass::LinearVelocityX => {
            semi_lagrangian!("sim/semi_lagrangian_linear" "x_face" [VelocityX SlowVelocityX NextVelocityX] Nothing)
        }
        Pass::CubicVelocityX => {
            semi_lagrangian!("sim/semi_lagrangian_cubic" "x_face" [VelocityX SlowVelocityX NextVelocityX] Nothing)
        }
        Pass::MacCormackVelocityX => {
            mac_cormack!("there_x_face" "back_again_x_face" "limit" [VelocityX SlowVelocityX NextVelocityX] Nothing)
        }
        Pass::LinearVelocityY => {
            semi_lagrangian!("sim/semi_lagrangian_linear" "y_face" [VelocityY SlowVelocityY NextVelocityY] Nothing)
        }
        Pass::CubicVelocityY => {
            semi_lagrangian!("sim/semi_lagrangian_cubic" "y_face" [VelocityY SlowVelocityY NextVelocityY] Nothing)
        }
        Pass::MacCormackVelocityY => {
            mac_cormack!("there_y_face" "back_again_y_face" "limit" [VelocityY SlowVelocityY NextVelocityY] Nothing)
        }
        Pass::LinearVelocityZ => {
            semi_lagrangian!("sim/semi_lagrangian_linear" "z_face" [VelocityZ SlowVelocityZ NextVelocityZ] Read(Buoyancy))
        }
        Pass::CubicVelocityZ => {
            semi_lagrangian!("sim/semi_lagrangian_cubic" "z_face" [VelocityZ SlowVelocityZ NextVelocityZ] Read(Buoyancy))
        }
        Pass::MacCormackVelocityZ => {
            mac_cormack!("there_z_face" "back_again_z_face" "limit_z_face" [VelocityZ SlowVelocityZ NextVelocityZ] Read(Buoyancy))
        }
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

/// Which kernels of a pass run, by their place in [`dispatches`]: all of them once, or for passes that iterate as often as the host counts, so that nothing
/// waits for the GPU to decide.
pub fn sequence(pass: Pass, parameters: &Parameters, substep_s: f32) -> Vec<usize> {
    let [nx, ny, _] = parameters.grid.cells;
    match (pass, parameters.methods.pressure) {
        (Pass::PressureJacobi, PressureMethod::Jacobi { sweeps }) => {
            // From the pressure to working memory and back; the last sweep goes half the way; the end depends on where it left the result.
            let mut run = vec![0, 1, 2];
            run.extend((0..sweeps as usize).map(|i| 3 + i % 2 + if i + 1 == sweeps as usize { 2 } else { 0 }));
            run.extend(if sweeps % 2 == 1 { [7, 8] } else { [9, 10] });
            run
        }
        (Pass::PressureRedBlackSor, PressureMethod::RedBlackSor { sweeps, .. }) => {
            // Both colours; then what has a neighbour of its own colour across the seam.
            let mut sweep = Vec::new();
            if nx > 1 && ny > 1 {
                sweep.extend([3, 4]);
            }
            if nx % 2 == 1 && ny > 1 {
                sweep.extend([5, 6]);
            }
            if ny % 2 == 1 {
                if nx > 1 {
                    sweep.extend([7, 8]);
                }
                if nx % 2 == 1 {
                    sweep.push(9);
                }
            }
            let mut run = vec![0, 1, 2];
            (0..sweeps).for_each(|_| run.extend_from_slice(&sweep));
            run.extend([10, 11]);
            run
        }
        (Pass::ConstantViscosityMomentum | Pass::ConstantViscosityHeat | Pass::ConstantViscosityWater, _) => {
            let Some(mixing) = &parameters.constant_viscosity else {
                return Vec::new();
            };
            let momentum = pass == Pass::ConstantViscosityMomentum;
            let mut run = Vec::new();
            for quantity in 0..dispatches(pass).len() / MIXING_KERNELS {
                let first = quantity * MIXING_KERNELS;
                if mixing.scheme == DiffusionScheme::Explicit {
                    run.push(first);
                    continue;
                }
                let coefficient_m2_s = if momentum {
                    mixing.viscosity_m2_s
                } else {
                    mixing.diffusivity_m2_s
                };
                let (_, sweeps) = implicit_sweeps(parameters, coefficient_m2_s, momentum && quantity == 2, substep_s);
                for i in 0..sweeps {
                    let way = if i == 0 { 1 } else { 3 - i % 2 };
                    run.push(first + way + if i + 1 == sweeps { 3 } else { 0 });
                }
                run.push(first + 8 - sweeps % 2);
            }
            run
        }
        _ => (0..dispatches(pass).len()).collect(),
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
        // Means 8, load 24, store 8, and one sweep; each further one moves 12 or 24 more.
        Pass::PressureJacobi => 40 + 12,
        Pass::PressureRedBlackSor => 40 + 24,
        Pass::FillWater => pass.bytes_per_cell(planned),
        // The explicit scheme; the implicit one moves 24, and 12 more each sweep beyond the first.
        Pass::ConstantViscosityMomentum | Pass::ConstantViscosityHeat | Pass::ConstantViscosityWater => {
            pass.bytes_per_cell(planned)
        }
        _ => dispatches(pass)
            .iter()
            .flat_map(|d| d.uses.iter())
            .filter(|u| match **u {
                Use::Held(held, state) => planned.contains(&held) || planned.contains(&state),
                u => u.field().is_some_and(|f| planned.contains(&f)),
            })
            .map(|u| u.bytes())
            .sum(),
    }
}
