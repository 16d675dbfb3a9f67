//! The CPU device: owns the fields and runs passes on them.

use std::borrow::Cow;

use rayon::prelude::*;

use super::fields::Fields;
use super::sim::advect::Scratch;
use super::sim::parameters::{DiffusionScheme, Parameters, PressureMethod};
use super::sim::slab::slab_count;
use super::sim::*;
use crate::catalogue::{Field, Pass, Rung};
use crate::device::{CloudReductions, Device, Reductions, Substep, Vitals};

const CENTRE_VELOCITY: [Field; 3] = [Field::CentreVelocityX, Field::CentreVelocityY, Field::CentreVelocityZ];
const DEPARTURE: [Field; 3] = [Field::DepartureX, Field::DepartureY, Field::DepartureZ];
const ARRIVAL: [Field; 3] = [Field::ArrivalX, Field::ArrivalY, Field::ArrivalZ];

/// The CPU device of one world.
pub struct Cpu {
    parameters: Parameters,
    fields: Fields,
    scratch: Vec<Scratch>,
    levels: Vec<Reductions>,
    cloud_levels: Vec<reduce_cloud::Level>,
    vital_levels: Vec<Vitals>,
    /// What the last judgement found.
    vitals: Vitals,
    cloud: Option<CloudReductions>,
    sum_levels: Vec<[f64; 2]>,
    /// One number a column, for what it wants on the way up and down.
    columns: Vec<f32>,
    solver: Option<Solver>,
    /// Two fields for the implicit diffusion's sweeps; empty without it.
    diffusion: [Vec<f32>; 2],
    /// The pressures that slots keep beside the state, for solvers that start from the last one; empty where a slot has none.
    kept_pressures: Vec<Vec<f32>>,
}

/// The chosen pressure solver.
enum Solver {
    Direct(pressure_solve::Solver),
    Jacobi(pressure_jacobi::Solver, u32),
    RedBlackSor(pressure_red_black_sor::Solver, u32, f32),
    Multigrid(pressure_multigrid::Solver, u32),
}

impl Solver {
    fn new(parameters: &Parameters) -> Self {
        match parameters.methods.pressure {
            PressureMethod::Direct => Self::Direct(pressure_solve::Solver::new(parameters)),
            PressureMethod::Jacobi { sweeps } => Self::Jacobi(pressure_jacobi::Solver::new(parameters), sweeps),
            PressureMethod::RedBlackSor { sweeps, relaxation } => {
                Self::RedBlackSor(pressure_red_black_sor::Solver::new(parameters), sweeps, relaxation)
            }
            PressureMethod::Multigrid { cycles } => {
                Self::Multigrid(pressure_multigrid::Solver::new(parameters), cycles)
            }
        }
    }

    fn run(&mut self, parameters: &Parameters, velocity: [&[f32]; 3], dt_s: f32, pressure: &mut [f32]) {
        match self {
            Self::Direct(solver) => solver.run(parameters, velocity, dt_s, pressure),
            Self::Jacobi(solver, sweeps) => solver.run(parameters, velocity, dt_s, *sweeps, pressure),
            Self::RedBlackSor(solver, sweeps, relaxation) => {
                solver.run(parameters, velocity, dt_s, *sweeps, *relaxation, pressure);
            }
            Self::Multigrid(solver, cycles) => solver.run(parameters, velocity, dt_s, *cycles, pressure),
        }
    }

    fn bytes(&self) -> usize {
        match self {
            Self::Direct(solver) => solver.bytes(),
            Self::Jacobi(solver, ..) => solver.bytes(),
            Self::RedBlackSor(solver, ..) => solver.bytes(),
            Self::Multigrid(solver, ..) => solver.bytes(),
        }
    }
}

impl Cpu {
    /// Allocates `planned` fields and, for a fluid, the pressure solver.
    pub fn new(parameters: Parameters, planned: &[Field]) -> Self {
        let grid = parameters.grid;
        Self {
            fields: Fields::new(grid.len(), planned),
            scratch: if parameters.methods.advection == Rung::FluxForm && planned.contains(&Field::NextVelocityX) {
                vec![Scratch::new(&grid); slab_count(&grid)]
            } else {
                Vec::new()
            },
            levels: vec![Reductions::default(); grid.cells[2]],
            sum_levels: vec![[0.0; 2]; grid.cells[2]],
            columns: if planned.contains(&Field::NextWater) {
                vec![0.0; grid.plane()]
            } else {
                Vec::new()
            },
            cloud_levels: vec![reduce_cloud::Level::default(); grid.cells[2]],
            vital_levels: vec![Vitals::default(); grid.cells[2]],
            vitals: Vitals::default(),
            cloud: None,
            solver: planned.contains(&Field::Pressure).then(|| Solver::new(&parameters)),
            diffusion: match &parameters.constant_viscosity {
                Some(mixing) if mixing.scheme == DiffusionScheme::Implicit => {
                    [vec![0.0; grid.len()], vec![0.0; grid.len()]]
                }
                _ => Default::default(),
            },
            kept_pressures: Vec::new(),
            parameters,
        }
    }

    fn velocity(&self) -> [&[f32]; 3] {
        [Field::VelocityX, Field::VelocityY, Field::VelocityZ].map(|f| self.fields.get(f))
    }

    /// Takes fields out to write them, runs `work` with the rest to read, and puts them back.
    fn writing<const N: usize>(&mut self, written: [Field; N], work: impl FnOnce(&Self, [&mut [f32]; N])) {
        let mut taken = written.map(|f| self.fields.take(f));
        work(self, taken.each_mut().map(Vec::as_mut_slice));
        for (field, values) in written.into_iter().zip(taken) {
            self.fields.put(field, values);
        }
    }

    fn saturate(&mut self, heat: Field, water: Field) {
        self.writing([Field::CloudWater, Field::Buoyancy], |d, [cloud, buoyancy]| {
            saturation_adjustment::run(&d.parameters, d.fields.get(heat), d.fields.get(water), cloud, buoyancy);
        });
    }

    fn dry_buoyancy(&mut self, heat: Field) {
        self.writing([Field::Buoyancy], |d, [buoyancy]| {
            dry_buoyancy::run(&d.parameters, d.fields.get(heat), buoyancy)
        });
    }

    fn depart(&mut self, written: [Field; 3], dt_s: f32) {
        self.writing(written, |d, out| {
            let wind = CENTRE_VELOCITY.map(|f| d.fields.get(f));
            departure::run(&d.parameters, wind, dt_s, out);
        });
    }

    /// Carries one quantity by a semi-Lagrangian rung.
    fn carry(&mut self, rung: Rung, state: Field, slow: Field, next: Field, substep: &Substep) {
        let written = [Field::Forward, Field::ForwardLow, Field::ForwardHigh, next];
        self.writing(written, |d, [forward, low, high, out]| {
            let carried = semi_lagrangian::Carried {
                place: state.place(),
                // Where nothing is held over a substep, the state itself is carried.
                state: d.fields.planned(slow).unwrap_or(d.fields.get(state)),
                departure: DEPARTURE.map(|f| d.fields.get(f)),
                buoyancy: d.fields.get(Field::Buoyancy),
                dt_s: substep.stage_s(),
            };
            match rung {
                Rung::MacCormack => {
                    let arrival = ARRIVAL.map(|f| d.fields.get(f));
                    mac_cormack::run(&d.parameters, &carried, arrival, [forward, low, high], out);
                }
                Rung::SemiLagrangianCubic => semi_lagrangian_cubic::run(&d.parameters, &carried, out),
                _ => semi_lagrangian_linear::run(&d.parameters, &carried, out),
            }
        });
    }

    fn advect_scalar(&mut self, state: Field, start: Field, slow: Field, next: Field, substep: &Substep) {
        let mut scratch = std::mem::take(&mut self.scratch);
        self.writing([next], |d, [out]| {
            // In stage 0 the state is the start; the start's own memory is the one before.
            let start = d.fields.get(if substep.stage == 0 { state } else { start });
            advect_scalar::run(
                &d.parameters,
                d.velocity(),
                d.fields.get(state),
                start,
                d.fields.get(slow),
                substep.stage_s(),
                out,
                &mut scratch,
            );
        });
        self.scratch = scratch;
    }

    fn advect_momentum(&mut self, substep: &Substep) {
        let mut scratch = std::mem::take(&mut self.scratch);
        self.writing(
            [Field::NextVelocityX, Field::NextVelocityY, Field::NextVelocityZ],
            |d, out| {
                let start = if substep.stage == 0 {
                    d.velocity()
                } else {
                    [Field::StartVelocityX, Field::StartVelocityY, Field::StartVelocityZ].map(|f| d.fields.get(f))
                };
                let slow = [Field::SlowVelocityX, Field::SlowVelocityY, Field::SlowVelocityZ].map(|f| d.fields.get(f));
                advect_momentum::run(
                    &d.parameters,
                    d.velocity(),
                    start,
                    slow,
                    d.fields.get(Field::Buoyancy),
                    substep.stage_s(),
                    out,
                    &mut scratch,
                );
            },
        );
        self.scratch = scratch;
    }

    fn diffuse_scalar(&mut self, state: Field, slow: Field) {
        self.writing([slow], |d, [out]| {
            diffuse_scalar::run(
                &d.parameters,
                d.fields.get(state),
                d.fields.get(Field::EddyViscosity),
                out,
            )
        });
    }

    fn constant_viscosity<const N: usize>(&mut self, states: [Field; N], slow: [Field; N], substep_s: f32) {
        let mut scratch = std::mem::take(&mut self.diffusion);
        for (state, slow) in states.into_iter().zip(slow) {
            self.writing([slow], |d, [out]| {
                let Some(mixing) = &d.parameters.constant_viscosity else {
                    return;
                };
                let coefficient = match state {
                    Field::Heat | Field::Water => mixing.diffusivity_m2_s,
                    _ => mixing.viscosity_m2_s,
                };
                let at_z_face = state == Field::VelocityZ;
                let field = d.fields.get(state);
                constant_viscosity::run(
                    &d.parameters,
                    coefficient,
                    field,
                    at_z_face,
                    substep_s,
                    &mut scratch,
                    out,
                );
            });
        }
        self.diffusion = scratch;
    }

    fn large_scale(&mut self, state: Field, slow: Field) {
        self.writing([slow], |d, [out]| {
            let source = match (&d.parameters.large_scale, state) {
                (Some(weather), Field::Heat) => weather.heating_k_per_s.as_slice(),
                (Some(weather), Field::Water) => weather.moistening_per_s.as_slice(),
                _ => &[],
            };
            large_scale::run(&d.parameters, d.fields.get(state), source, out);
        });
    }

    fn sponge(&mut self, substep_s: f32) {
        for (state, slow) in [
            (Field::VelocityX, Field::SlowVelocityX),
            (Field::VelocityY, Field::SlowVelocityY),
            (Field::VelocityZ, Field::SlowVelocityZ),
            (Field::Heat, Field::SlowHeat),
        ] {
            self.writing([slow], |d, [out]| {
                let p = &d.parameters;
                let base: &[f32] = match state {
                    Field::VelocityX => &p.base_wind_x_m_s,
                    Field::VelocityY => &p.base_wind_y_m_s,
                    Field::Heat => &p.base_heat_k,
                    _ => &[],
                };
                sponge::run(p, d.fields.get(state), base, state == Field::VelocityZ, substep_s, out);
            });
        }
    }
}

impl Device for Cpu {
    fn name(&self) -> String {
        "cpu".to_owned()
    }

    fn run(&mut self, pass: Pass, substep: &Substep) {
        match pass {
            Pass::SlowClear => {
                for &field in Pass::SlowClear.info().writes {
                    self.fields
                        .get_mut(field)
                        .par_chunks_mut(1 << 14)
                        .for_each(|c| c.fill(0.0));
                }
            }
            Pass::StepSaturation | Pass::StartSaturation | Pass::Saturation | Pass::PublishSaturation => {
                self.saturate(Field::Heat, Field::Water)
            }
            Pass::StepDryBuoyancy | Pass::DryBuoyancy => self.dry_buoyancy(Field::Heat),
            Pass::SaturationNext => self.saturate(Field::NextHeat, Field::NextWater),
            Pass::DryBuoyancyNext => self.dry_buoyancy(Field::NextHeat),
            Pass::AddTendencies => {
                for (state, slow) in [
                    (Field::VelocityX, Field::SlowVelocityX),
                    (Field::VelocityY, Field::SlowVelocityY),
                    (Field::VelocityZ, Field::SlowVelocityZ),
                    (Field::Heat, Field::SlowHeat),
                    (Field::Water, Field::SlowWater),
                ] {
                    self.writing([slow], |d, [out]| {
                        add_tendencies::run(d.fields.get(state), substep.substep_s, out);
                    });
                }
            }
            Pass::CentreWind => self.writing(CENTRE_VELOCITY, |d, out| {
                centre_wind::run(&d.parameters, d.velocity(), out);
            }),
            Pass::Departure => self.depart(DEPARTURE, substep.stage_s()),
            Pass::Arrival => self.depart(ARRIVAL, -substep.stage_s()),
            Pass::FixWater => {
                let mut levels = std::mem::take(&mut self.sum_levels);
                self.writing([Field::NextWater], |d, [out]| {
                    let before = d.fields.planned(Field::SlowWater).unwrap_or(d.fields.get(Field::Water));
                    mass_fixer::run(&d.parameters, before, &mut levels, out);
                });
                self.sum_levels = levels;
            }
            Pass::FillWater => {
                let mut columns = std::mem::take(&mut self.columns);
                self.writing([Field::NextWater], |d, [out]| {
                    hole_filler::run(&d.parameters, &mut columns, out);
                });
                self.columns = columns;
            }
            Pass::LinearHeat => self.carry(
                Rung::SemiLagrangianLinear,
                Field::Heat,
                Field::SlowHeat,
                Field::NextHeat,
                substep,
            ),
            Pass::MacCormackHeat => {
                self.carry(Rung::MacCormack, Field::Heat, Field::SlowHeat, Field::NextHeat, substep)
            }
            Pass::CubicHeat => self.carry(
                Rung::SemiLagrangianCubic,
                Field::Heat,
                Field::SlowHeat,
                Field::NextHeat,
                substep,
            ),
            Pass::LinearWater => self.carry(
                Rung::SemiLagrangianLinear,
                Field::Water,
                Field::SlowWater,
                Field::NextWater,
                substep,
            ),
            Pass::MacCormackWater => self.carry(
                Rung::MacCormack,
                Field::Water,
                Field::SlowWater,
                Field::NextWater,
                substep,
            ),
            Pass::CubicWater => self.carry(
                Rung::SemiLagrangianCubic,
                Field::Water,
                Field::SlowWater,
                Field::NextWater,
                substep,
            ),
            Pass::LinearVelocityX => self.carry(
                Rung::SemiLagrangianLinear,
                Field::VelocityX,
                Field::SlowVelocityX,
                Field::NextVelocityX,
                substep,
            ),
            Pass::MacCormackVelocityX => self.carry(
                Rung::MacCormack,
                Field::VelocityX,
                Field::SlowVelocityX,
                Field::NextVelocityX,
                substep,
            ),
            Pass::CubicVelocityX => self.carry(
                Rung::SemiLagrangianCubic,
                Field::VelocityX,
                Field::SlowVelocityX,
                Field::NextVelocityX,
                substep,
            ),
            Pass::LinearVelocityY => self.carry(
                Rung::SemiLagrangianLinear,
                Field::VelocityY,
                Field::SlowVelocityY,
                Field::NextVelocityY,
                substep,
            ),
            Pass::MacCormackVelocityY => self.carry(
                Rung::MacCormack,
                Field::VelocityY,
                Field::SlowVelocityY,
                Field::NextVelocityY,
                substep,
            ),
            Pass::CubicVelocityY => self.carry(
                Rung::SemiLagrangianCubic,
                Field::VelocityY,
                Field::SlowVelocityY,
                Field::NextVelocityY,
                substep,
            ),
            Pass::LinearVelocityZ => self.carry(
                Rung::SemiLagrangianLinear,
                Field::VelocityZ,
                Field::SlowVelocityZ,
                Field::NextVelocityZ,
                substep,
            ),
            Pass::MacCormackVelocityZ => self.carry(
                Rung::MacCormack,
                Field::VelocityZ,
                Field::SlowVelocityZ,
                Field::NextVelocityZ,
                substep,
            ),
            Pass::CubicVelocityZ => self.carry(
                Rung::SemiLagrangianCubic,
                Field::VelocityZ,
                Field::SlowVelocityZ,
                Field::NextVelocityZ,
                substep,
            ),
            Pass::EddyViscosity => self.writing([Field::EddyViscosity], |d, [out]| {
                eddy_viscosity::run(&d.parameters, d.velocity(), d.fields.get(Field::Buoyancy), out);
            }),
            Pass::DiffuseMomentum => self.writing(
                [Field::SlowVelocityX, Field::SlowVelocityY, Field::SlowVelocityZ],
                |d, out| {
                    diffuse_momentum::run(&d.parameters, d.velocity(), d.fields.get(Field::EddyViscosity), out);
                },
            ),
            Pass::DiffuseHeat => self.diffuse_scalar(Field::Heat, Field::SlowHeat),
            Pass::DiffuseWater => self.diffuse_scalar(Field::Water, Field::SlowWater),
            Pass::ConstantViscosityMomentum => self.constant_viscosity(
                [Field::VelocityX, Field::VelocityY, Field::VelocityZ],
                [Field::SlowVelocityX, Field::SlowVelocityY, Field::SlowVelocityZ],
                substep.substep_s,
            ),
            Pass::ConstantViscosityHeat => {
                self.constant_viscosity([Field::Heat], [Field::SlowHeat], substep.substep_s);
            }
            Pass::ConstantViscosityWater => {
                self.constant_viscosity([Field::Water], [Field::SlowWater], substep.substep_s);
            }
            Pass::BodyForce => {
                for (axis, (state, slow)) in [
                    (Field::VelocityX, Field::SlowVelocityX),
                    (Field::VelocityY, Field::SlowVelocityY),
                    (Field::VelocityZ, Field::SlowVelocityZ),
                ]
                .into_iter()
                .enumerate()
                {
                    self.writing([slow], |d, [out]| {
                        body_force::run(&d.parameters, axis, d.fields.get(state), substep.substep_s, out);
                    });
                }
            }
            Pass::SurfaceFlux => {
                self.writing(
                    [
                        Field::SlowVelocityX,
                        Field::SlowVelocityY,
                        Field::SlowHeat,
                        Field::SlowWater,
                    ],
                    |d, [u, v, heat, water]| {
                        surface_flux::run(
                            &d.parameters,
                            d.fields.get(Field::VelocityX),
                            d.fields.get(Field::VelocityY),
                            u,
                            v,
                            heat,
                            water,
                        );
                    },
                );
            }
            Pass::Coriolis => self.writing([Field::SlowVelocityX, Field::SlowVelocityY], |d, [u, v]| {
                coriolis::run(
                    &d.parameters,
                    d.fields.get(Field::VelocityX),
                    d.fields.get(Field::VelocityY),
                    u,
                    v,
                );
            }),
            Pass::LargeScaleHeat => self.large_scale(Field::Heat, Field::SlowHeat),
            Pass::LargeScaleWater => self.large_scale(Field::Water, Field::SlowWater),
            Pass::LargeScaleMomentum => {
                self.large_scale(Field::VelocityX, Field::SlowVelocityX);
                self.large_scale(Field::VelocityY, Field::SlowVelocityY);
            }
            Pass::Sponge => self.sponge(substep.substep_s),
            Pass::AdvectHeat => {
                self.advect_scalar(Field::Heat, Field::StartHeat, Field::SlowHeat, Field::NextHeat, substep)
            }
            Pass::CloudyAscent => self.writing([Field::NextHeat], |d, [heat]| {
                let [cloud, w] = [Field::CloudWater, Field::VelocityZ].map(|f| d.fields.get(f));
                cloudy_ascent::run(&d.parameters, cloud, w, substep.stage_s(), heat);
            }),
            Pass::AdvectWater => self.advect_scalar(
                Field::Water,
                Field::StartWater,
                Field::SlowWater,
                Field::NextWater,
                substep,
            ),
            Pass::AdvectMomentum => self.advect_momentum(substep),
            Pass::PressureSolve | Pass::PressureJacobi | Pass::PressureRedBlackSor | Pass::PressureMultigrid => {
                let Some(mut solver) = self.solver.take() else { return };
                self.writing([Field::Pressure], |d, [out]| {
                    let velocity =
                        [Field::NextVelocityX, Field::NextVelocityY, Field::NextVelocityZ].map(|f| d.fields.get(f));
                    solver.run(&d.parameters, velocity, substep.stage_s(), out);
                });
                self.solver = Some(solver);
            }
            Pass::Project => self.writing(
                [Field::NextVelocityX, Field::NextVelocityY, Field::NextVelocityZ],
                |d, out| {
                    project::run(&d.parameters, d.fields.get(Field::Pressure), substep.stage_s(), out);
                },
            ),
            Pass::CloudExtinction => self.writing([Field::Extinction], |d, [out]| {
                cloud_extinction::run(&d.parameters, d.fields.get(Field::CloudWater), out);
            }),
        }
    }

    fn accept(&mut self, stage: usize) {
        for state in Field::STATE {
            let (Some(start), Some(next)) = (state.start(), state.next()) else {
                continue;
            };
            if stage == 0 {
                self.fields.swap(state, start);
            }
            self.fields.swap(state, next);
        }
    }

    fn reduce(&mut self) -> Reductions {
        let mut levels = std::mem::take(&mut self.levels);
        let reductions = reduce::run(
            &self.parameters,
            self.velocity(),
            self.fields.get(Field::EddyViscosity),
            &mut levels,
        );
        self.levels = levels;
        reductions
    }

    fn read(&self, field: Field) -> Option<Cow<'_, [f32]>> {
        self.fields.planned(field).map(Cow::Borrowed)
    }

    fn write(&mut self, field: Field, values: &[f32]) -> bool {
        let to = self.fields.get_mut(field);
        if to.len() != values.len() {
            return false;
        }
        to.copy_from_slice(values);
        true
    }

    fn judge(&mut self) {
        let mut levels = std::mem::take(&mut self.vital_levels);
        self.vitals = vitals::run(
            &self.parameters,
            self.velocity(),
            self.fields.get(Field::Heat),
            self.fields.get(Field::Water),
            self.fields.get(Field::Extinction),
            &mut levels,
        );
        self.vital_levels = levels;
        let wind = [Field::VelocityX, Field::VelocityY].map(|f| self.fields.get(f));
        self.cloud = self.fields.planned(Field::CloudWater).map(|cloud| {
            reduce_cloud::run(
                &self.parameters,
                cloud,
                self.fields.get(Field::Water),
                self.fields.get(Field::Extinction),
                wind,
                &mut self.cloud_levels,
            )
        });
    }

    fn reduce_cloud(&mut self) -> Option<CloudReductions> {
        self.cloud
    }

    fn set_parameters(&mut self, parameters: &Parameters) {
        self.parameters.clone_from(parameters);
    }

    fn solver_bytes(&self) -> usize {
        self.solver.as_ref().map_or(0, Solver::bytes) + 4 * self.diffusion.iter().map(Vec::len).sum::<usize>()
    }

    fn vitals(&mut self) -> Vitals {
        self.vitals
    }

    fn save(&mut self, slot: usize) {
        self.fields.save(slot);
        if self.parameters.methods.pressure.is_iterative() {
            while self.kept_pressures.len() <= slot {
                self.kept_pressures.push(Vec::new());
            }
            let kept = &mut self.kept_pressures[slot];
            kept.clear();
            kept.extend_from_slice(self.fields.get(Field::Pressure));
        }
    }

    fn save_start(&mut self, slot: usize) {
        self.fields.exchange_start(slot);
        // The pressure that the substep started from is gone, and the one that it ended with may be what spoilt it.
        if let Some(kept) = self.kept_pressures.get_mut(slot) {
            kept.clear();
        }
    }

    fn restore(&mut self, slot: usize) -> bool {
        let restored = self.fields.restore(slot);
        if restored && self.parameters.methods.pressure.is_iterative() {
            let kept: &[f32] = self.kept_pressures.get(slot).map_or(&[], Vec::as_slice);
            let pressure = self.fields.get_mut(Field::Pressure);
            if kept.len() == pressure.len() {
                pressure.copy_from_slice(kept);
            } else {
                pressure.fill(0.0);
            }
        }
        restored
    }

    fn saved_bytes(&self) -> usize {
        self.fields.saved_bytes() + 4 * self.kept_pressures.iter().map(Vec::len).sum::<usize>()
    }
}
