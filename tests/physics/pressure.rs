//! The pressure rungs against exact solutions of their equation, and against what each promises at its default setting.

mod common;

use std::f64::consts::PI;

use common::noise;
use welkin_shaders::catalogue::{Field, Pass};
use welkin_shaders::cpu::Cpu;
use welkin_shaders::cpu::sim::parameters::PressureMethod;
use welkin_shaders::cpu::sim::{
    Parameters, pressure_jacobi, pressure_multigrid, pressure_red_black_sor, pressure_solve, project,
};
use welkin_shaders::{Device, Grid, Substep};

fn air(cells: [usize; 3], cell_size_m: [f32; 3], scale_height_m: Option<f64>) -> Parameters {
    common::air(Grid { cells, cell_size_m }, scale_height_m)
}

#[derive(Clone, Copy, Debug)]
enum Rung {
    Direct,
    Jacobi(u32),
    RedBlackSor(u32, f32),
    Multigrid(u32),
}

fn solve(rung: Rung, air: &Parameters, velocity: &[Vec<f32>; 3], dt_s: f32, pressure: &mut [f32]) {
    let v = [&velocity[0][..], &velocity[1][..], &velocity[2][..]];
    match rung {
        Rung::Direct => pressure_solve::Solver::new(air).run(air, v, dt_s, pressure),
        Rung::Jacobi(sweeps) => pressure_jacobi::Solver::new(air).run(air, v, dt_s, sweeps, pressure),
        Rung::RedBlackSor(sweeps, relaxation) => {
            pressure_red_black_sor::Solver::new(air).run(air, v, dt_s, sweeps, relaxation, pressure);
        }
        Rung::Multigrid(cycles) => pressure_multigrid::Solver::new(air).run(air, v, dt_s, cycles, pressure),
    }
}

fn zeros(air: &Parameters) -> Vec<f32> {
    vec![0.0; air.grid.len()]
}

/// The velocity whose divergence asks for exactly `pressure`: its discrete gradient, times dt.
fn gradient(air: &Parameters, pressure: &[f64], dt_s: f64) -> [Vec<f32>; 3] {
    let grid = &air.grid;
    let [nx, ny, nz] = grid.cells;
    let mut velocity = [zeros(air), zeros(air), zeros(air)];
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                let i = grid.index(x, y, z);
                let west = grid.index((x + nx - 1) % nx, y, z);
                let south = grid.index(x, (y + ny - 1) % ny, z);
                let per = |a: usize| dt_s / grid.cell_size_m[a] as f64;
                velocity[0][i] = ((pressure[i] - pressure[west]) * per(0)) as f32;
                velocity[1][i] = ((pressure[i] - pressure[south]) * per(1)) as f32;
                if z > 0 {
                    velocity[2][i] = ((pressure[i] - pressure[i - grid.plane()]) * per(2)) as f32;
                }
            }
        }
    }
    velocity
}

fn random_wind(air: &Parameters) -> [Vec<f32>; 3] {
    let mut velocity: [Vec<f32>; 3] = [0, 1, 2].map(|a| (0..air.grid.len()).map(|i| noise(3 * i + a)).collect());
    velocity[2][..air.grid.plane()].fill(0.0);
    velocity
}

/// Root mean square of the divergence after projection, over that before.
fn divergence_left(air: &Parameters, velocity: &[Vec<f32>; 3], pressure: &[f32], dt_s: f32) -> f64 {
    let mut after = velocity.clone();
    let [u, v, w] = &mut after;
    project::run(air, pressure, dt_s, [u, v, w]);
    divergence_rms(air, &after) / divergence_rms(air, velocity)
}

fn divergence_rms(air: &Parameters, velocity: &[Vec<f32>; 3]) -> f64 {
    let grid = &air.grid;
    let [nx, ny, nz] = grid.cells;
    let [dx, dy, dz] = grid.cell_size_m.map(f64::from);
    let mut sum = 0.0;
    for z in 0..nz {
        let face = |z: usize| air.density_at_z_face_kg_m3[z] as f64 / air.density_kg_m3[z.min(nz - 1)] as f64;
        for y in 0..ny {
            for x in 0..nx {
                let i = grid.index(x, y, z);
                let at = |a: usize, i: usize| velocity[a][i] as f64;
                let up = if z + 1 < nz {
                    air.density_at_z_face_kg_m3[z + 1] as f64 / air.density_kg_m3[z] as f64 * at(2, i + grid.plane())
                } else {
                    0.0
                };
                let d = (at(0, grid.index((x + 1) % nx, y, z)) - at(0, i)) / dx
                    + (at(1, grid.index(x, (y + 1) % ny, z)) - at(1, i)) / dy
                    + (up - face(z) * at(2, i)) / dz;
                sum += d * d;
            }
        }
    }
    (sum / grid.len() as f64).sqrt()
}

/// Every kind of boundary and extent: periodic in both, two-dimensional either way, one column, odd and prime extents, two cells.
const EXTENTS: [[usize; 3]; 9] = [
    [8, 8, 8],
    [16, 1, 9],
    [1, 7, 5],
    [1, 1, 6],
    [9, 10, 11],
    [2, 2, 2],
    [5, 7, 3],
    [13, 11, 4],
    [3, 2, 7],
];
const SIZE_M: [f32; 3] = [50.0, 70.0, 30.0];
const DENSITIES: [Option<f64>; 2] = [None, Some(100.0)];

/// A rung that has converged.
const CONVERGED: [Rung; 4] = [
    Rung::Direct,
    Rung::Jacobi(3000),
    Rung::RedBlackSor(200, 1.5),
    Rung::Multigrid(12),
];

#[test]
fn every_rung_finds_the_discrete_solution_for_every_boundary_and_density() {
    for cells in EXTENTS {
        for density in DENSITIES {
            let air = air(cells, SIZE_M, density);
            let plane = air.grid.plane();
            // Any pressure at all, with the constant that the rungs choose: mean 0 in the topmost level.
            let mut truth: Vec<f64> = (0..air.grid.len()).map(|i| noise(i) as f64).collect();
            let top = &truth[air.grid.len() - plane..];
            let mean = top.iter().sum::<f64>() / plane as f64;
            truth.iter_mut().for_each(|p| *p -= mean);
            let velocity = gradient(&air, &truth, 2.0);
            for rung in CONVERGED {
                let mut pressure = zeros(&air);
                solve(rung, &air, &velocity, 2.0, &mut pressure);
                let error = pressure
                    .iter()
                    .zip(&truth)
                    .map(|(&a, b)| (a as f64 - b).abs())
                    .fold(0.0, f64::max);
                // The pressure is about 1; a sum over ten levels of 24-bit numbers keeps five digits.
                assert!(error < 2e-5, "{rung:?} {cells:?} {density:?}: {error:e}");
            }
        }
    }
}

#[test]
fn the_discrete_solution_converges_to_the_continuous_one_with_order_two() {
    let waves = [2.0 * PI, 4.0 * PI, PI];
    for (present, name) in [
        ([true, true, true], "box"),
        ([true, false, true], "x and z"),
        ([false, true, true], "y and z"),
        ([false, false, true], "column"),
        ([true, true, false], "x and y"),
    ] {
        for density in [None, Some(300.0)] {
            for rung in [Rung::Direct, Rung::Multigrid(8)] {
                let error = |n: usize| {
                    let cells = [0, 1, 2].map(|a| if present[a] || a == 2 { n } else { 1 });
                    let length = [400.0, 640.0, 320.0];
                    let air = air(cells, [0, 1, 2].map(|a| (length[a] / cells[a] as f64) as f32), density);
                    let grid = air.grid;
                    // phi = the product of the cosines that are present; its gradient, sampled at the faces, is the velocity.
                    let phase = |a: usize, i: f64| waves[a] * i / cells[a] as f64;
                    let cosine = |a: usize, i: f64| if present[a] { phase(a, i).cos() } else { 1.0 };
                    let slope = |a: usize, i: f64| {
                        if present[a] {
                            -phase(a, i).sin() * waves[a] / length[a]
                        } else {
                            0.0
                        }
                    };
                    let mut velocity = [zeros(&air), zeros(&air), zeros(&air)];
                    let mut truth = vec![0.0; grid.len()];
                    for z in 0..cells[2] {
                        for y in 0..cells[1] {
                            for x in 0..cells[0] {
                                let i = grid.index(x, y, z);
                                let at = [x as f64, y as f64, z as f64];
                                let centre = |a: usize| cosine(a, at[a] + 0.5);
                                truth[i] = centre(0) * centre(1) * centre(2);
                                velocity[0][i] = (slope(0, at[0]) * centre(1) * centre(2)) as f32;
                                velocity[1][i] = (centre(0) * slope(1, at[1]) * centre(2)) as f32;
                                velocity[2][i] = (centre(0) * centre(1) * slope(2, at[2])) as f32;
                            }
                        }
                    }
                    let mut pressure = zeros(&air);
                    solve(rung, &air, &velocity, 1.0, &mut pressure);
                    // Up to a constant.
                    let apart: Vec<f64> = pressure.iter().zip(&truth).map(|(&p, t)| p as f64 - t).collect();
                    let mean = apart.iter().sum::<f64>() / apart.len() as f64;
                    (apart.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / apart.len() as f64).sqrt()
                };
                let (coarse, fine) = (error(12), error(24));
                let ratio = coarse / fine;
                assert!(
                    (3.7..4.3).contains(&ratio) && fine < 0.01,
                    "{rung:?} {name} {density:?}: {coarse:e} to {fine:e}"
                );
            }
        }
    }
}

#[test]
fn a_converged_rung_leaves_rounding() {
    for cells in EXTENTS {
        for density in DENSITIES {
            let air = air(cells, SIZE_M, density);
            let wind = random_wind(&air);
            for rung in CONVERGED {
                let mut pressure = zeros(&air);
                solve(rung, &air, &wind, 2.0, &mut pressure);
                let left = divergence_left(&air, &wind, &pressure, 2.0);
                assert!(left < 1e-6, "{rung:?} {cells:?} {density:?}: {left:e}");
            }
        }
    }
}

/// A grid of the shape and size of real scenes; the rungs' promises are made for it.
fn scene_air() -> Parameters {
    air([64, 64, 40], [100.0, 100.0, 40.0], Some(8000.0))
}

#[test]
fn each_rung_keeps_its_promise_at_its_default_setting() {
    let air = scene_air();
    // White noise, and the pull of one long wave in x that is not the same at all heights.
    let long: Vec<f64> = (0..air.grid.len())
        .map(|i| {
            let (x, z) = (i % 64, i / air.grid.plane());
            (2.0 * PI * (x as f64 + 0.5) / 64.0).cos() * (PI * (z as f64 + 0.5) / 40.0).cos()
        })
        .collect();
    let winds = [random_wind(&air), gradient(&air, &long, 5.0)];
    // From no first guess: the share of noise's divergence that is left, root mean square, and that of the long wave's pressure that is
    // missing. A rung of few sweeps leaves long waves to the pressure of the stage before.
    for (rung, divergence, missing) in [
        (Rung::Direct, 1e-6, 1e-5),
        (Rung::Multigrid(4), 1e-5, 1e-4),
        (Rung::RedBlackSor(20, 1.7), 2e-3, 0.3),
        (Rung::Jacobi(40), 1e-2, 0.99),
    ] {
        let mut pressure = zeros(&air);
        solve(rung, &air, &winds[0], 5.0, &mut pressure);
        let left = divergence_left(&air, &winds[0], &pressure, 5.0);
        let mut pressure = zeros(&air);
        solve(rung, &air, &winds[1], 5.0, &mut pressure);
        let apart = |p: &[f32]| {
            p.iter()
                .zip(&long)
                .map(|(&p, t)| (p as f64 - t).powi(2))
                .sum::<f64>()
                .sqrt()
        };
        let short = apart(&pressure) / apart(&zeros(&air));
        eprintln!(
            "{rung:?}: {left:.1e} of noise's divergence is left, {short:.1e} of a long wave's pressure is missing"
        );
        assert!(
            left < divergence && short < missing,
            "{rung:?}: {left:e} of {divergence:e}, {short:e} of {missing:e}"
        );
    }
}

#[test]
fn multigrid_converges_alike_on_cubes_flat_cells_and_odd_extents() {
    for (cells, size_m, factor) in [
        ([32, 32, 16], [40.0, 40.0, 40.0], 0.08),
        // Vertical coupling a million times the horizontal one: the column solve does it all, down to the rounding of such pressures.
        ([32, 32, 16], [40_000.0, 40_000.0, 40.0], 0.08),
        ([32, 32, 16], [40.0, 40.0, 4000.0], 0.1),
        ([31, 37, 16], [100.0, 100.0, 40.0], 0.15),
        ([3, 61, 9], [100.0, 100.0, 40.0], 0.15),
        ([32, 32, 16], [100.0, 60.0, 40.0], 0.1),
        ([32, 32, 16], [100.0, 3000.0, 40.0], 0.1),
        ([64, 1, 16], [100.0, 100.0, 40.0], 0.08),
        ([1, 33, 16], [100.0, 100.0, 40.0], 0.1),
    ] {
        let air = air(cells, size_m, Some(8000.0));
        let wind = random_wind(&air);
        let after = |cycles: u32| {
            let mut pressure = zeros(&air);
            solve(Rung::Multigrid(cycles), &air, &wind, 5.0, &mut pressure);
            divergence_left(&air, &wind, &pressure, 5.0)
        };
        let (one, three) = (after(1), after(3));
        let mut pressure = zeros(&air);
        solve(Rung::Direct, &air, &wind, 5.0, &mut pressure);
        let rounding = divergence_left(&air, &wind, &pressure, 5.0);
        let mean = (three / one).sqrt();
        eprintln!("{cells:?} of {size_m:?} m: {one:.1e} after a cycle, {three:.1e} after three, {mean:.3} a cycle");
        assert!(three < 2.0 * rounding || mean < factor, "{cells:?} {size_m:?}: {mean}");
        assert!(three < 1e-3, "{cells:?} {size_m:?}: {three:e}");
    }
}

#[test]
fn jacobi_shrinks_a_wave_as_theory_says_and_removes_the_checkerboard() {
    // Cells so tall that only x and y count.
    let air = air([24, 24, 3], [10.0, 10.0, 1e4], None);
    let grid = air.grid;
    let truth: Vec<f64> = (0..grid.len())
        .map(|i| (2.0 * PI * ((i % 24) as f64 + 0.5) / 12.0).cos())
        .collect();
    let velocity = gradient(&air, &truth, 1.0);
    let c = (PI / 12.0).sin().powi(2) / 2.0;
    for sweeps in [1, 2, 7, 40] {
        let mut pressure = zeros(&air);
        solve(Rung::Jacobi(sweeps), &air, &velocity, 1.0, &mut pressure);
        let left = (truth[0] - pressure[0] as f64) / truth[0];
        // The last sweep goes half the way.
        let expected = (1.0 - 2.0 * c).powi(sweeps as i32 - 1) * (1.0 - c);
        assert!((left - expected).abs() < 1e-5, "{sweeps} sweeps: {left} for {expected}");
    }
    let checkerboard: Vec<f64> = (0..grid.len())
        .map(|i| {
            if (i % 24 + i / 24 % 24 + i / 576) % 2 == 0 {
                1.0
            } else {
                -1.0
            }
        })
        .collect();
    let velocity = gradient(&air, &checkerboard, 1.0);
    for sweeps in [3, 4] {
        let mut pressure = zeros(&air);
        solve(Rung::Jacobi(sweeps), &air, &velocity, 1.0, &mut pressure);
        let error = pressure
            .iter()
            .zip(&checkerboard)
            .map(|(&p, t)| (p as f64 - t).abs())
            .fold(0.0, f64::max);
        assert!(error < 1e-4, "{sweeps} sweeps leave {error} of a checkerboard");
    }
}

#[test]
fn over_relaxation_pays_as_theory_says() {
    let air = air([32, 32, 4], [10.0, 10.0, 1e3], None);
    let truth: Vec<f64> = (0..air.grid.len())
        .map(|i| (2.0 * PI * ((i % 32) as f64 + 0.5) / 32.0).cos())
        .collect();
    let velocity = gradient(&air, &truth, 1.0);
    let left = |sweeps: u32, relaxation: f32| {
        let mut pressure = zeros(&air);
        solve(
            Rung::RedBlackSor(sweeps, relaxation),
            &air,
            &velocity,
            1.0,
            &mut pressure,
        );
        divergence_left(&air, &velocity, &pressure, 1.0)
    };
    let m = 0.5 * (1.0 + (2.0 * PI / 32.0).cos());
    let best = 2.0 / (1.0 + (1.0 - m * m).sqrt());
    let rate = |relaxation: f32| (left(60, relaxation) / left(30, relaxation)).powf(1.0 / 30.0);
    let (plain, relaxed) = (rate(1.0), rate(best as f32));
    // Gauss and Seidel's method leaves m squared a sweep, the best relaxation itself less 1 (times the sweep's number, at the optimum).
    assert!((plain - m * m).abs() < 2e-3, "{plain} for {}", m * m);
    let expected = (best - 1.0) * 2.0f64.powf(1.0 / 30.0);
    assert!((relaxed - expected).abs() < 0.03, "{relaxed} for {expected}");
}

#[test]
fn the_last_pressure_helps_and_a_spoilt_one_is_forgotten() {
    let air = air([24, 20, 12], [100.0, 100.0, 40.0], Some(8000.0));
    let wind = random_wind(&air);
    for rung in [Rung::Jacobi(20), Rung::RedBlackSor(10, 1.5), Rung::Multigrid(1)] {
        let mut pressure = zeros(&air);
        solve(rung, &air, &wind, 5.0, &mut pressure);
        let once = divergence_left(&air, &wind, &pressure, 5.0);
        let first = pressure.clone();
        solve(rung, &air, &wind, 5.0, &mut pressure);
        let twice = divergence_left(&air, &wind, &pressure, 5.0);
        assert!(twice < 0.7 * once, "{rung:?}: {once:e} to {twice:e}");
        // A first guess that is not finite counts as none, to the bit; so does one that differs by a constant a level, nearly.
        for spoilt in [f32::NAN, f32::INFINITY] {
            let mut pressure = vec![spoilt; air.grid.len()];
            solve(rung, &air, &wind, 5.0, &mut pressure);
            assert!(pressure == first, "{rung:?} kept a first guess of {spoilt}");
        }
    }
}

#[test]
fn same_bits_for_any_number_of_threads() {
    // Large enough to be cut into many tasks, odd enough to have a last row and column.
    let air = air([45, 43, 17], [100.0, 100.0, 40.0], Some(8000.0));
    let wind = random_wind(&air);
    for rung in [
        Rung::Direct,
        Rung::Jacobi(9),
        Rung::RedBlackSor(5, 1.7),
        Rung::Multigrid(2),
    ] {
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("threads");
            pool.install(|| {
                let mut pressure = zeros(&air);
                solve(rung, &air, &wind, 5.0, &mut pressure);
                pressure.iter().map(|p| p.to_bits()).collect::<Vec<_>>()
            })
        };
        let one = run(1);
        assert!(
            one == run(2) && one == run(3),
            "{rung:?}: bits differ with the number of threads"
        );
    }
}

#[test]
fn a_slot_keeps_the_pressure_that_the_next_solve_starts_from() {
    use Field::*;
    for (pass, method) in [
        (Pass::PressureJacobi, PressureMethod::Jacobi { sweeps: 5 }),
        (
            Pass::PressureRedBlackSor,
            PressureMethod::RedBlackSor {
                sweeps: 3,
                relaxation: 1.5,
            },
        ),
        (Pass::PressureMultigrid, PressureMethod::Multigrid { cycles: 1 }),
    ] {
        let mut air = air([12, 9, 7], [100.0, 100.0, 40.0], Some(8000.0));
        air.methods.pressure = method;
        let wind = random_wind(&air);
        let planned = [
            VelocityX,
            VelocityY,
            VelocityZ,
            NextVelocityX,
            NextVelocityY,
            NextVelocityZ,
            StartVelocityX,
            StartVelocityY,
            StartVelocityZ,
            Pressure,
        ];
        let mut device = Cpu::new(air, &planned);
        for (field, values) in planned[3..6].iter().zip(&wind) {
            assert!(device.write(*field, values));
        }
        let substep = Substep {
            substep_s: 5.0,
            stage: 0,
            stages: 1,
        };
        let solve = |device: &mut Cpu| {
            device.run(pass, &substep);
            device.read(Pressure).expect("planned").to_vec()
        };
        let cold = solve(&mut device);
        device.save(0);
        let warm = solve(&mut device);
        assert!(cold != warm, "{method:?} does not start from the last pressure");
        solve(&mut device);
        assert!(device.restore(0));
        assert!(
            solve(&mut device) == warm,
            "{method:?} goes on otherwise after a restoration"
        );
        // Where the pressure of a substep's start is gone, the solve starts from none.
        device.save_start(0);
        assert!(device.restore(0));
        assert!(solve(&mut device) == cold, "{method:?}");
    }
}
