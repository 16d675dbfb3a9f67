//! A compressible flow in two dimensions, in f64: the truth that tells what an anelastic core must differ by from what its own faults add.
//!
//! Density, momentum and density times potential temperature in flux form on a C grid, periodic along x, free-slip ground and lid. Carried by
//! fifth-order upwind fluxes, pressure gradient and buoyancy centred (second order), one mixing of `mixing_m2_s` on velocities and potential
//! temperature (second order), three-stage Runge-Kutta (Wicker and Skamarock 2002). Nothing is split: a step follows sound, which makes it slow and
//! leaves nothing to argue about. Base state: one potential temperature, hydrostatic; what is subtracted is the discrete base state, so rest stays
//! rest. Keeps: mass and density times potential temperature, to rounding.

use rayon::prelude::*;
use welkin_shaders::constants::{GAS_CONSTANT_DRY_AIR, GRAVITY_M_S2, HEAT_CAPACITY_DRY_AIR, REFERENCE_PRESSURE_PA};

/// Sound crosses at most this share of a cell a step, both directions together.
const SOUND_COURANT: f64 = 0.9;
/// Faster than any sound and wind here, m/s.
const FASTEST_M_S: f64 = 400.0;

/// One state: density less the base's (kg/m3), momentum at west and lower faces (kg/m2/s), density times potential temperature less the base's (K kg/m3).
#[derive(Clone)]
struct State {
    density: Vec<f64>,
    momentum_x: Vec<f64>,
    momentum_z: Vec<f64>,
    heat: Vec<f64>,
}

impl State {
    fn fields(&self) -> [&[f64]; 4] {
        [&self.density, &self.momentum_x, &self.momentum_z, &self.heat]
    }

    /// Becomes `start` and `seconds` of `slope`.
    fn step(&mut self, start: &State, slope: &State, seconds: f64) {
        let fields = [
            &mut self.density,
            &mut self.momentum_x,
            &mut self.momentum_z,
            &mut self.heat,
        ];
        for ((to, from), slope) in fields.into_iter().zip(start.fields()).zip(slope.fields()) {
            for ((to, from), slope) in to.iter_mut().zip(from).zip(slope) {
                *to = from + seconds * slope;
            }
        }
    }
}

/// A running box.
pub(super) struct Compressible {
    cells: [usize; 2],
    cell_m: f64,
    mixing_m2_s: f64,
    potential_temperature_k: f64,
    base_density: Vec<f64>,
    base_pressure: Vec<f64>,
    state: State,
    /// Seconds since the start.
    pub seconds: f64,
}

fn pressure_pa(heat: f64) -> f64 {
    let gamma = HEAT_CAPACITY_DRY_AIR / (HEAT_CAPACITY_DRY_AIR - GAS_CONSTANT_DRY_AIR);
    REFERENCE_PRESSURE_PA * (GAS_CONSTANT_DRY_AIR * heat / REFERENCE_PRESSURE_PA).powf(gamma)
}

/// Fifth-order upwind value between `v[2]` and `v[3]` of six values in a row, for a flux towards higher indices if `speed` is positive.
fn face(v: [f64; 6], speed: f64) -> f64 {
    let even = (37.0 * (v[3] + v[2]) - 8.0 * (v[4] + v[1]) + (v[5] + v[0])) / 60.0;
    let odd = ((v[5] - v[0]) - 5.0 * (v[4] - v[1]) + 10.0 * (v[3] - v[2])) / 60.0;
    even - speed.signum() * odd
}

impl Compressible {
    /// Air of one potential temperature at rest, with the temperature changed by `temperature_k(x_m, z_m)` at constant pressure.
    pub(super) fn new(
        cells: [usize; 2],
        cell_m: f64,
        mixing_m2_s: f64,
        potential_temperature_k: f64,
        temperature_k: impl Fn(f64, f64) -> f64,
    ) -> Self {
        let [nx, nz] = cells;
        let height_m = |k: usize| (k as f64 + 0.5) * cell_m;
        let exner = |k: usize| 1.0 - GRAVITY_M_S2 * height_m(k) / (HEAT_CAPACITY_DRY_AIR * potential_temperature_k);
        let from_exner = |exner: f64| {
            let pressure = REFERENCE_PRESSURE_PA * exner.powf(HEAT_CAPACITY_DRY_AIR / GAS_CONSTANT_DRY_AIR);
            pressure / (GAS_CONSTANT_DRY_AIR * exner * potential_temperature_k)
        };
        let base_density: Vec<f64> = (0..nz).map(|k| from_exner(exner(k))).collect();
        let base_pressure = base_density
            .iter()
            .map(|rho| pressure_pa(rho * potential_temperature_k))
            .collect();
        let mut state = State {
            density: vec![0.0; nx * nz],
            momentum_x: vec![0.0; nx * nz],
            momentum_z: vec![0.0; nx * nz],
            heat: vec![0.0; nx * nz],
        };
        for k in 0..nz {
            for i in 0..nx {
                let warmer_k = temperature_k((i as f64 + 0.5) * cell_m, height_m(k)) / exner(k);
                // At constant pressure density times potential temperature stays.
                state.density[k * nx + i] = -base_density[k] * warmer_k / (potential_temperature_k + warmer_k);
            }
        }
        Self {
            cells,
            cell_m,
            mixing_m2_s,
            potential_temperature_k,
            base_density,
            base_pressure,
            state,
            seconds: 0.0,
        }
    }

    /// Potential temperature less the base's at centres, K, rows from the ground.
    pub(super) fn excess_k(&self) -> Vec<f32> {
        let nx = self.cells[0];
        let theta = self.potential_temperature_k;
        let of = |(n, (rho, heat)): (usize, (&f64, &f64))| {
            let base = self.base_density[n / nx];
            ((base * theta + heat) / (base + rho) - theta) as f32
        };
        self.state
            .density
            .iter()
            .zip(&self.state.heat)
            .enumerate()
            .map(of)
            .collect()
    }

    /// Velocities at west and lower faces, m/s.
    pub(super) fn velocities_m_s(&self) -> [Vec<f32>; 2] {
        let (_, u, w) = self.velocities();
        [u, w].map(|v| v.into_iter().map(|v| v as f32).collect())
    }

    /// Density at centres, velocities at west and lower faces.
    fn velocities(&self) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
        let state = &self.state;
        let nx = self.cells[0];
        let rho: Vec<f64> = (0..state.density.len())
            .map(|n| self.base_density[n / nx] + state.density[n])
            .collect();
        let u = (0..rho.len())
            .map(|n| {
                let west = if n % nx == 0 { n + nx - 1 } else { n - 1 };
                2.0 * state.momentum_x[n] / (rho[n] + rho[west])
            })
            .collect();
        let w = (0..rho.len())
            .map(|n| {
                if n < nx {
                    0.0
                } else {
                    2.0 * state.momentum_z[n] / (rho[n] + rho[n - nx])
                }
            })
            .collect();
        (rho, u, w)
    }

    /// Writes the rates of change to `out`.
    fn tendency(&self, out: &mut State) {
        let state = &self.state;
        let [nx, nz] = self.cells;
        let theta0 = self.potential_temperature_k;
        let (rho, u, w) = self.velocities();
        let theta: Vec<f64> = (0..rho.len())
            .map(|n| (self.base_density[n / nx] * theta0 + state.heat[n]) / rho[n])
            .collect();
        let pressure: Vec<f64> = (0..rho.len())
            .into_par_iter()
            .with_min_len(nx)
            .map(|n| pressure_pa(self.base_density[n / nx] * theta0 + state.heat[n]) - self.base_pressure[n / nx])
            .collect();
        let (mx, mz) = (&state.momentum_x, &state.momentum_z);
        let over = 1.0 / self.cell_m;
        let mixing = self.mixing_m2_s * over * over;
        let east = |i: usize, by: isize| (i as isize + by).rem_euclid(nx as isize) as usize;
        // Level of a centre or of what lies beside a west face, mirrored at ground and lid.
        let level = |k: isize| {
            let n = nz as isize;
            (if k < 0 {
                -1 - k
            } else if k >= n {
                2 * n - 1 - k
            } else {
                k
            }) as usize
        };
        // Something at a lower face, odd about ground and lid; the lid's face is not stored and holds none.
        let at_face = |values: &[f64], i: usize, k: isize| {
            let n = nz as isize;
            match k {
                k if k < 0 => -values[(-k) as usize * nx + i],
                k if k == n => 0.0,
                k if k > n => -values[(2 * n - k) as usize * nx + i],
                k => values[k as usize * nx + i],
            }
        };
        let along_x = |v: &[f64], i: usize, k: usize, first: isize| -> [f64; 6] {
            std::array::from_fn(|n| v[k * nx + east(i, first + n as isize)])
        };
        let along_z = |v: &[f64], i: usize, k: usize, first: isize| -> [f64; 6] {
            std::array::from_fn(|n| v[level(k as isize + first + n as isize) * nx + i])
        };
        let faces_along_z = |v: &[f64], i: usize, k: usize, first: isize| -> [f64; 6] {
            std::array::from_fn(|n| at_face(v, i, k as isize + first + n as isize))
        };
        let State {
            density,
            momentum_x,
            momentum_z,
            heat,
        } = out;
        density
            .par_chunks_mut(nx)
            .zip(momentum_x.par_chunks_mut(nx))
            .zip(momentum_z.par_chunks_mut(nx))
            .zip(heat.par_chunks_mut(nx))
            .enumerate()
            .for_each(|(k, (((density, momentum_x), momentum_z), heat))| {
                for i in 0..nx {
                    let n = k * nx + i;
                    let (e, west) = (east(i, 1), east(i, -1));
                    let above = at_face(mz, i, k as isize + 1);
                    density[i] = -over * (mx[k * nx + e] - mx[n] + above - mz[n]);
                    // Potential temperature through the four faces.
                    let flux_x = |i: usize| {
                        let m = mx[k * nx + i];
                        m * face(along_x(&theta, i, k, -3), m)
                    };
                    let flux_z = |k: usize| {
                        let m = at_face(mz, i, k as isize);
                        m * face(along_z(&theta, i, k, -3), m)
                    };
                    let around = theta[k * nx + e]
                        + theta[k * nx + west]
                        + theta[level(k as isize - 1) * nx + i]
                        + theta[level(k as isize + 1) * nx + i];
                    heat[i] = -over * (flux_x(e) - flux_x(i) + flux_z(k + 1) - flux_z(k))
                        + mixing * rho[n] * (around - 4.0 * theta[n]);
                    // Momentum at the west face.
                    let through_x = |i: usize| {
                        let m = 0.5 * (mx[k * nx + i] + mx[k * nx + east(i, 1)]);
                        m * face(along_x(&u, i, k, -2), m)
                    };
                    let through_z = |k: usize| {
                        let m = 0.5 * (at_face(mz, i, k as isize) + at_face(mz, west, k as isize));
                        m * face(along_z(&u, i, k, -3), m)
                    };
                    let around = u[k * nx + e]
                        + u[k * nx + west]
                        + u[level(k as isize - 1) * nx + i]
                        + u[level(k as isize + 1) * nx + i];
                    let rho_face = 0.5 * (rho[n] + rho[k * nx + west]);
                    momentum_x[i] = -over
                        * (through_x(i) - through_x(west) + through_z(k + 1) - through_z(k) + pressure[n]
                            - pressure[k * nx + west])
                        + mixing * rho_face * (around - 4.0 * u[n]);
                    // Momentum at the lower face; the ground's holds none.
                    momentum_z[i] = 0.0;
                    if k > 0 {
                        let through_x = |i: usize| {
                            let m = 0.5 * (mx[k * nx + i] + mx[(k - 1) * nx + i]);
                            m * face(along_x(&w, i, k, -3), m)
                        };
                        let through_z = |k: usize| {
                            let m = 0.5 * (at_face(mz, i, k as isize) + at_face(mz, i, k as isize + 1));
                            m * face(faces_along_z(&w, i, k, -2), m)
                        };
                        let around = w[k * nx + e] + w[k * nx + west] + w[n - nx] + at_face(&w, i, k as isize + 1);
                        let rho_face = 0.5 * (rho[n] + rho[n - nx]);
                        let lighter = 0.5 * (state.density[n] + state.density[n - nx]);
                        momentum_z[i] = -over
                            * (through_x(e) - through_x(i) + through_z(k) - through_z(k - 1) + pressure[n]
                                - pressure[n - nx])
                            - GRAVITY_M_S2 * lighter
                            + mixing * rho_face * (around - 4.0 * w[n]);
                    }
                }
            });
    }

    /// Advances to `until_s` in equal steps; `progress` is told the seconds now and then and stops it by `false`.
    pub(super) fn advance_to(&mut self, until_s: f64, mut progress: impl FnMut(&Self) -> bool) -> bool {
        let longest_s = SOUND_COURANT * self.cell_m / (FASTEST_M_S * std::f64::consts::SQRT_2);
        let steps = ((until_s - self.seconds) / longest_s).ceil().max(1.0);
        let step_s = (until_s - self.seconds) / steps;
        let mut slope = self.state.clone();
        for step in 0..steps as usize {
            let start = self.state.clone();
            for share in [1.0 / 3.0, 0.5, 1.0] {
                self.tendency(&mut slope);
                self.state.step(&start, &slope, share * step_s);
            }
            self.seconds += step_s;
            if step.is_multiple_of(64) && !progress(self) {
                return false;
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rest_stays_rest() {
        let mut air = Compressible::new([32, 16], 200.0, 75.0, 300.0, |_, _| 0.0);
        assert!(air.advance_to(60.0, |_| true));
        let [u, w] = air.velocities_m_s();
        assert!(u.iter().chain(&w).all(|&v| v == 0.0));
    }

    #[test]
    fn a_warm_bubble_rises_with_its_buoyancy_and_keeps_mass() {
        let warm = |x: f64, z: f64| {
            let r2 = ((x - 6400.0) / 2000.0).powi(2) + ((z - 3200.0) / 1000.0).powi(2);
            if r2 < 1.0 {
                0.5 * (0.5 * std::f64::consts::PI * r2.sqrt()).cos().powi(2)
            } else {
                0.0
            }
        };
        let mut air = Compressible::new([64, 32], 200.0, 0.0, 300.0, warm);
        let sums = |air: &Compressible| [&air.state.density, &air.state.heat].map(|f| f.iter().sum::<f64>());
        let before = sums(&air);
        assert!(air.advance_to(60.0, |_| true));
        for (before, after) in before.into_iter().zip(sums(&air)) {
            // 2048 values, densities of 1 and 300 K: their rounding.
            assert!((after - before).abs() < 1e-6, "{before} became {after}");
        }
        let [u, w] = air.velocities_m_s();
        let most = w.iter().copied().fold(0.0f32, f32::max);
        // An ellipse twice as wide as high moves twice its own mass of air around it: a third of its buoyancy of 0.5 / 300 g, over a minute.
        let theory = 0.5 / 300.0 * 9.81 / 3.0 * 60.0;
        assert!((most / theory - 1.0).abs() < 0.1, "{most} m/s, by theory {theory}");
        // The same to both sides.
        for row in u.chunks(64) {
            for i in 1..64 {
                assert!((row[i] + row[64 - i]).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn sound_travels_at_its_speed() {
        // A little warmth without room to spread is pressure: it leaves as two waves along x.
        let mut air = Compressible::new([200, 4], 50.0, 0.0, 300.0, |_, _| 0.0);
        for n in 0..800 {
            let x = ((n % 200) as f64 - 99.5) / 6.0;
            air.state.heat[n] = 1e-3 * (-x * x).exp();
        }
        assert!(air.advance_to(10.0, |_| true));
        let heat = &air.state.heat[..200];
        let front = (100..200).max_by(|&a, &b| heat[a].total_cmp(&heat[b])).unwrap_or(0);
        let metres = (front as f64 - 99.5) * 50.0;
        // sqrt(1.4 R T) near the ground, 347 m/s; a cell is 50 m.
        assert!((metres - 3470.0).abs() < 60.0, "{metres} m");
    }
}
