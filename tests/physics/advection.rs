//! Each rung of the advection ladder against what is known of it: order on smooth flow, bounds at jumps, large Courant numbers, budgets.

mod common;

use std::f64::consts::PI;

use common::air;
use welkin_proto::scene::{Advection, BaseState};
use welkin_proto::{Scene, presets};
use welkin_server::world::World;
use welkin_shaders::Grid;
use welkin_shaders::catalogue::{Field, Place, Rung};
use welkin_shaders::cpu::sim::advect::Scratch;
use welkin_shaders::cpu::sim::semi_lagrangian::Carried;
use welkin_shaders::cpu::sim::slab::slab_count;
use welkin_shaders::cpu::sim::{
    Parameters, advect_scalar, centre_wind, departure, mac_cormack, semi_lagrangian_cubic, semi_lagrangian_linear,
};

/// One rung's kernels in a wind that does not change.
struct Carrier {
    rung: Rung,
    parameters: Parameters,
    velocity: [Vec<f32>; 3],
    scratch: Vec<Scratch>,
}

impl Carrier {
    fn new(rung: Rung, grid: Grid, wind: impl Fn([f64; 3]) -> [f64; 3]) -> Self {
        let faces = [Place::XFace, Place::YFace, Place::ZFace];
        let velocity = [0, 1, 2].map(|c| points(&grid, faces[c]).map(|p| wind(p)[c] as f32).collect());
        Self {
            rung,
            velocity,
            scratch: vec![Scratch::new(&grid); slab_count(&grid)],
            parameters: air(grid, None),
        }
    }

    fn step(&mut self, state: &[f32], dt_s: f32) -> Vec<f32> {
        self.step_at(Place::Centre, state, dt_s)
    }

    /// A step for values that lie at `place`; flux form carries scalars at centres only here.
    fn step_at(&mut self, place: Place, state: &[f32], dt_s: f32) -> Vec<f32> {
        let p = &self.parameters;
        let [u, v, w] = &self.velocity;
        let velocity = [u.as_slice(), v.as_slice(), w.as_slice()];
        let mut next = vec![f32::NAN; state.len()];
        if self.rung == Rung::FluxForm {
            let mut stage = state.to_vec();
            for part in [1.0 / 3.0, 0.5, 1.0] {
                advect_scalar::run(
                    p,
                    velocity,
                    &stage,
                    state,
                    &[],
                    dt_s * part,
                    &mut next,
                    &mut self.scratch,
                );
                stage.copy_from_slice(&next);
            }
            return next;
        }
        let three = || [0, 1, 2].map(|_| vec![f32::NAN; state.len()]);
        let mut wind = three();
        let [x, y, z] = &mut wind;
        centre_wind::run(p, velocity, [x, y, z]);
        let displacement = |dt_s: f32| {
            let mut d = three();
            let [x, y, z] = &mut d;
            departure::run(p, [&wind[0], &wind[1], &wind[2]], dt_s, [x, y, z]);
            d
        };
        let back = displacement(dt_s);
        let carried = Carried {
            place,
            state,
            departure: [&back[0], &back[1], &back[2]],
            buoyancy: &[],
            dt_s,
        };
        match self.rung {
            Rung::SemiLagrangianLinear => semi_lagrangian_linear::run(p, &carried, &mut next),
            Rung::SemiLagrangianCubic => semi_lagrangian_cubic::run(p, &carried, &mut next),
            _ => {
                let ahead = displacement(-dt_s);
                let [mut forward, mut low, mut high] = three();
                let arrival = [&ahead[0][..], &ahead[1], &ahead[2]];
                mac_cormack::run(p, &carried, arrival, [&mut forward, &mut low, &mut high], &mut next);
            }
        }
        next
    }
}

/// Where a field's values lie, in order, m.
fn points(grid: &Grid, place: Place) -> impl Iterator<Item = [f64; 3]> + use<> {
    let Grid { cells, cell_size_m } = *grid;
    let at_centre = match place {
        Place::Centre => [true, true, true],
        Place::XFace => [false, true, true],
        Place::YFace => [true, false, true],
        Place::ZFace => [true, true, false],
    };
    (0..cells[0] * cells[1] * cells[2]).map(move |i| {
        let index = [i % cells[0], i / cells[0] % cells[1], i / (cells[0] * cells[1])];
        [0, 1, 2].map(|a| (index[a] as f64 + if at_centre[a] { 0.5 } else { 0.0 }) * cell_size_m[a] as f64)
    })
}

const RUNGS: [Rung; 4] = [
    Rung::SemiLagrangianLinear,
    Rung::MacCormack,
    Rung::SemiLagrangianCubic,
    Rung::FluxForm,
];

/// A steady vortex between ground and lid of a box 2 m long and 1 m high, periodic along x, of at most 1 m/s.
fn vortex([x, _, z]: [f64; 3]) -> [f64; 3] {
    [(PI * x).sin() * (PI * z).cos(), 0.0, -(PI * x).cos() * (PI * z).sin()]
}

/// Where the air at a point of the vortex was `time_s` ago: Runge-Kutta of fourth order in 40 steps, which errs by less than 1e-6 m.
fn back_in_vortex(mut p: [f64; 3], time_s: f64) -> [f64; 3] {
    let h = -time_s / 40.0;
    for _ in 0..40 {
        let moved = |by: [f64; 3], f: f64| [0, 1, 2].map(|a| p[a] + f * by[a]);
        let k1 = vortex(p);
        let k2 = vortex(moved(k1, 0.5 * h));
        let k3 = vortex(moved(k2, 0.5 * h));
        let k4 = vortex(moved(k3, h));
        p = [0, 1, 2].map(|a| p[a] + h / 6.0 * (k1[a] + 2.0 * (k2[a] + k3[a]) + k4[a]));
    }
    p
}

fn mean_error(got: &[f32], exact: impl Iterator<Item = f64>) -> f64 {
    got.iter().zip(exact).map(|(&a, b)| (a as f64 - b).abs()).sum::<f64>() / got.len() as f64
}

/// Slope of the error in a log-log plot between a grid and one twice as fine.
fn order(coarse: f64, fine: f64) -> f64 {
    (coarse / fine).log2()
}

#[test]
fn orders_of_convergence_in_a_uniform_wind() {
    // A wave carried slantwise once through a periodic box; the Courant number (of all three directions) stays at 0.9 while the cells shrink.
    let error = |rung: Rung, n: usize| {
        let grid = Grid {
            cells: [n, n, 3],
            cell_size_m: [1.0 / n as f32; 3],
        };
        let mut carrier = Carrier::new(rung, grid, |_| [1.0, 0.5, 0.0]);
        let wave = |[x, y, _]: [f64; 3]| (2.0 * PI * (x + y)).sin() + 0.5 * (2.0 * PI * (x - 2.0 * y)).cos();
        let mut state: Vec<f32> = points(&grid, Place::Centre).map(|p| wave(p) as f32).collect();
        let steps = n * 5 / 3;
        for _ in 0..steps {
            state = carrier.step(&state, 1.0 / steps as f32);
        }
        mean_error(
            &state,
            points(&grid, Place::Centre).map(|[x, y, z]| wave([x - 1.0, y - 0.5, z])),
        )
    };
    // The least order; flux form gets third from time and fifth from space, the others what their interpolation gives a step, less one for
    // the number of steps. Limiters cost some at the crests.
    for (rung, least) in RUNGS.into_iter().zip([0.7, 1.6, 2.4, 2.8]) {
        let (coarse, fine) = (error(rung, 48), error(rung, 96));
        let order = order(coarse, fine);
        eprintln!("{:24} {coarse:.3e} {fine:.3e} order {order:.2}", rung.info().name);
        assert!(order > least, "{}: order {order:.2}", rung.info().name);
    }
}

#[test]
fn orders_of_convergence_in_a_vortex() {
    // A smooth field wound up by a steady vortex beside ground and lid; the truth follows trajectories in f64. At lower faces the field is 0
    // at ground and lid, as w is.
    let time_s = 1.0;
    let smooth = |place: Place, [x, _, z]: [f64; 3]| match place {
        Place::ZFace => (PI * z).sin() * (1.0 + 0.5 * (PI * x).sin()),
        _ => (PI * x).cos() + 0.5 * (PI * z).cos(),
    };
    let error = |rung: Rung, place: Place, n: usize| {
        let grid = Grid {
            cells: [2 * n, 1, n],
            cell_size_m: [1.0 / n as f32; 3],
        };
        let mut carrier = Carrier::new(rung, grid, vortex);
        let mut state: Vec<f32> = points(&grid, place).map(|p| smooth(place, p) as f32).collect();
        for _ in 0..n {
            state = carrier.step_at(place, &state, (time_s / n as f64) as f32);
        }
        mean_error(
            &state,
            points(&grid, place).map(|p| smooth(place, back_in_vortex(p, time_s))),
        )
    };
    // The wind is known to second order between faces, so no rung is bound to do better here.
    for (rung, least) in RUNGS.into_iter().zip([0.85, 1.8, 1.8, 1.8]) {
        let places = [Place::Centre, Place::XFace, Place::ZFace];
        let places = if rung == Rung::FluxForm { &places[..1] } else { &places };
        for &place in places {
            let (coarse, fine) = (error(rung, place, 48), error(rung, place, 96));
            let order = order(coarse, fine);
            eprintln!(
                "{:24} {:8} {coarse:.3e} {fine:.3e} order {order:.2}",
                rung.info().name,
                place.name()
            );
            assert!(
                order > least,
                "{} at {}: order {order:.2}",
                rung.info().name,
                place.name()
            );
        }
    }
}

#[test]
fn a_block_stays_within_its_bounds() {
    // Zero outside, one inside, wound up until it is thinner than a cell.
    for (rung, overshoot) in RUNGS.into_iter().zip([1e-6, 1e-6, 1e-6, 0.02]) {
        let grid = Grid {
            cells: [48, 3, 24],
            cell_size_m: [1.0 / 24.0; 3],
        };
        let mut carrier = Carrier::new(rung, grid, |p| {
            let [u, _, w] = vortex(p);
            [u, 0.3, w]
        });
        let mut state: Vec<f32> = points(&grid, Place::Centre)
            .map(|[x, _, z]| {
                if (0.3..0.8).contains(&x) && (0.2..0.7).contains(&z) {
                    1.0
                } else {
                    0.0
                }
            })
            .collect();
        for _ in 0..200 {
            state = carrier.step(&state, 0.8 / 24.0 / 2.0);
        }
        let (low, high) = state
            .iter()
            .fold((f32::MAX, f32::MIN), |(l, h), &v| (l.min(v), h.max(v)));
        eprintln!("{:24} {low:e} {high:e}", rung.info().name);
        assert!(
            low >= -overshoot && high <= 1.0 + overshoot,
            "{}: {low} to {high}",
            rung.info().name
        );
        assert!(high > 0.3, "{}: nothing is left of the block", rung.info().name);
    }
}

#[test]
fn large_courant_numbers_are_borne() {
    // 50 cells a step across, 20 and more round the vortex: values stay within what they were, and a whole number of cells is exact.
    for rung in &RUNGS[..3] {
        let claim = rung.info().advance.expect("advection").courant_max;
        assert!(claim >= 20.0);
        let grid = Grid {
            cells: [32, 5, 16],
            cell_size_m: [1.0 / 16.0; 3],
        };
        let mut state: Vec<f32> = points(&grid, Place::Centre)
            .enumerate()
            .map(|(i, [x, _, z])| ((PI * x).sin() + z) as f32 + ((i * 7919) % 13) as f32 * 0.05)
            .collect();
        let (least, most) = state
            .iter()
            .fold((f32::MAX, f32::MIN), |(l, h), &v| (l.min(v), h.max(v)));
        let mut along = Carrier::new(*rung, grid, |_| [1.0, 0.0, 0.0]);
        let moved = along.step(&state, (claim / 16.0) as f32);
        for (i, &v) in moved.iter().enumerate() {
            let from = i / 32 * 32 + (i + 32 * 4 - claim as usize) % 32;
            assert!((v - state[from]).abs() < 1e-6, "{}: cell {i}", rung.info().name);
        }
        let mut round = Carrier::new(*rung, grid, |p| vortex(p).map(|v| v + 0.1));
        round.velocity[2].iter_mut().take(32 * 5).for_each(|w| *w = 0.0);
        let dt = (0.5 * claim / 16.0) as f32;
        for _ in 0..50 {
            state = round.step(&state, dt);
        }
        assert!(
            state.iter().all(|v| (least - 1e-5..=most + 1e-5).contains(v)),
            "{}: out of bounds",
            rung.info().name
        );
    }
}

fn preset(name: &str) -> Scene {
    presets::find(name).expect("a preset")
}

/// Scene names of the rungs, in the ladder's order.
const ADVECTIONS: [Advection; 4] = [
    Advection::SemiLagrangianLinear,
    Advection::MacCormack,
    Advection::SemiLagrangianCubic,
    Advection::FluxForm,
];

#[test]
fn momentum_converges_on_a_vortex_that_the_wind_carries() {
    // Taylor and Green's vortices in x and y are a steady solution; a uniform wind carries them along. Every stage takes part.
    let error = |advection: Advection, n: usize| {
        let mut scene = preset("clear-sky-wind");
        scene.domain.cells = [n as u32, n as u32, 3];
        scene.domain.cell_size_m = [3200.0 / n as f64; 3];
        scene.methods.advection = Some(advection);
        if let BaseState::Isentropic {
            wind_x_m_s, wind_y_m_s, ..
        } = &mut scene.base_state
        {
            (*wind_x_m_s, *wind_y_m_s) = (10.0, 5.0);
        }
        let mut world = World::new(scene, None).expect("a world");
        let grid = world.parameters().grid;
        let k = 2.0 * PI / 3200.0;
        let wind = |[x, y, _]: [f64; 3], t: f64| {
            let (x, y) = (k * (x - 10.0 * t), k * (y - 5.0 * t));
            [10.0 + 5.0 * x.sin() * y.cos(), 5.0 - 5.0 * x.cos() * y.sin()]
        };
        for (c, field, place) in [(0, Field::VelocityX, Place::XFace), (1, Field::VelocityY, Place::YFace)] {
            let values: Vec<f32> = points(&grid, place).map(|p| wind(p, 0.0)[c] as f32).collect();
            world.write_field(field, &values).expect("planned");
        }
        let steps = n;
        for _ in 0..steps {
            world.advance_by(120.0 / steps as f64);
            assert_eq!(world.numbers().substeps, 1);
        }
        let u = world.device().read(Field::VelocityX).expect("planned");
        mean_error(&u, points(&grid, Place::XFace).map(|p| wind(p, 120.0)[0]))
    };
    // A single stage holds the wind and puts the whole pressure gradient at its end, which is of first order in time; flux form is of second.
    for (advection, least) in ADVECTIONS.into_iter().zip([0.8, 0.8, 0.8, 1.8]) {
        let (coarse, fine) = (error(advection, 24), error(advection, 48));
        let order = order(coarse, fine);
        eprintln!("{advection:?} {coarse:.3e} {fine:.3e} m/s, order {order:.2}");
        assert!(order > least, "{advection:?}: order {order:.2}");
    }
}

#[test]
fn orders_of_the_time_schemes() {
    // A smooth bubble that rises through dry air, on one grid in ever shorter substeps: differences between runs fall with the order.
    let run = |advection: Advection, steps: usize| {
        let mut scene = preset("dry-bubble");
        scene.domain.cells = [50, 1, 25];
        scene.domain.cell_size_m = [400.0; 3];
        scene.effects.turbulence = None;
        scene.methods.advection = Some(advection);
        let mut world = World::new(scene, None).expect("a world");
        for _ in 0..steps {
            world.advance_by(320.0 / steps as f64);
            assert_eq!(world.numbers().substeps, 1);
        }
        world.device().read(Field::VelocityZ).expect("planned").to_vec()
    };
    let difference = |a: &[f32], b: &[f32]| mean_error(a, b.iter().map(|&v| v as f64));
    for (advection, least) in ADVECTIONS.into_iter().zip([0.8, 0.8, 0.8, 1.8]) {
        let [a, b, c] = [16, 32, 64].map(|steps| run(advection, steps));
        let (coarse, fine) = (difference(&a, &b), difference(&b, &c));
        let order = order(coarse, fine);
        eprintln!("{advection:?} {coarse:.3e} {fine:.3e} m/s, order {order:.2}");
        assert!(order > least, "{advection:?}: order {order:.2}");
    }
}

#[test]
fn budgets_close_or_drift_as_stated() {
    // A bubble that rises for ten minutes in a closed box without fluxes or sponge.
    let mut scene = preset("warm-bubble");
    scene.domain.cells = [32, 32, 48];
    scene.effects.surface = None;
    scene.effects.large_scale = None;
    scene.effects.sponge = None;
    if let Some(bubble) = &mut scene.effects.bubble {
        bubble.centre_m = [1600.0, 1600.0, 900.0];
    }
    // Without water heat has no source at all.
    let mut dry = scene.clone();
    dry.effects.moisture = None;
    dry.effects.cloud_detail = None;
    dry.effects.multiple_scattering = None;
    dry.effects.cloud_shadow = None;
    if let Some(bubble) = &mut dry.effects.bubble {
        bubble.total_water_kg_per_kg = 0.0;
    }
    let mean = |world: &World, field: Field| {
        let p = world.parameters();
        let values = world.device().read(field).expect("planned");
        let weighted = |(i, &v): (usize, &f32)| v as f64 * p.density_kg_m3[i / p.grid.plane()] as f64;
        let mass: f64 = p.density_kg_m3.iter().map(|&d| d as f64 * p.grid.plane() as f64).sum();
        values.iter().enumerate().map(weighted).sum::<f64>() / mass
    };
    let drift = |scene: &Scene, advection: Advection, field: Field| {
        let mut scene = scene.clone();
        scene.methods.advection = Some(advection);
        let mut world = World::new(scene, None).expect("a world");
        let before = mean(&world, field);
        world.advance_to(600.0, |_| true);
        assert!(
            world.numbers().updraught_max_m_s > 0.5,
            "the bubble must rise for this to mean anything"
        );
        // Whatever is carried, the wind is left free of divergence.
        assert!(world.numbers().divergence_max_per_s < 1e-6);
        (mean(&world, field) - before, before)
    };
    // Heat in kelvin: f32 sums in flux form against what looking back loses; the bubble itself warms the box by some hundredths. Water as
    // a share: flux form by rounding, the others by the fixer's rounding, a few 1e-8 a substep.
    for (advection, heat_bound_k, water_bound) in [
        (Advection::SemiLagrangianLinear, 5e-3, 3e-6),
        (Advection::MacCormack, 5e-3, 3e-6),
        (Advection::SemiLagrangianCubic, 5e-3, 3e-6),
        (Advection::FluxForm, 3e-6, 3e-6),
    ] {
        let (heat_k, _) = drift(&dry, advection, Field::Heat);
        let (water, of) = drift(&scene, advection, Field::Water);
        eprintln!(
            "{advection:?}: heat drifts by {heat_k:e} K, water by {:e} of itself",
            water / of
        );
        assert!(heat_k.abs() < heat_bound_k, "{advection:?}: {heat_k:e} K");
        assert!((water / of).abs() < water_bound, "{advection:?}: {:e}", water / of);
    }
}
