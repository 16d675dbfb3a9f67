//! Stage `pressure_red_black_sor`: the pressure that frees the mass flux of divergence, by successive over-relaxation of columns in two colours.
//!
//! Reads the velocities at their faces (m/s) and `Pressure` (m2/s2) at centres as a first guess; writes `Pressure`. The discrete problem is that of
//! `pressure_solve`, second order. A sweep solves each column with its neighbours held (`pressure_columns`), first all columns of one colour, then
//! those of the other, and moves each by `relaxation` times the way. With 1 that is Gauss and Seidel's method. The best value is
//! `2 / (1 + sqrt(1 - m2))` (Young 1954), m the share of its error that a sweep of Jacobi's method on columns would leave of the box's longest
//! wave, `(1 + cos(2 pi / n)) / 2` for n by n columns: 1.87 for 64. The error then falls by about `relaxation - 1` a sweep. Any value below 2
//! converges. Columns, not cells, because cells are often flat. The mean column is solved exactly (`pressure_source`). The first guess is the pressure of the stage before, which makes
//! `Pressure` part of the state with this rung. Tolerances: `tests/physics/pressure.rs`. Errors: none.
//! Bytes a cell: 40 to load and store, about 16 a sweep. Holds about 10 bytes a cell.

use super::parameters::Parameters;
use super::pressure_columns::{Columnar, Columns};

/// The relaxation factor on a grid: one column alone is solved at once, and to go beyond its solution would only spoil it.
pub fn relaxation_on(cells: [usize; 3], relaxation: f32) -> f32 {
    if cells[..2] == [1, 1] { 1.0 } else { relaxation }
}

/// Buffers and factors, made once for a grid.
pub struct Solver {
    columns: Columns,
    columnar: Columnar,
    scratch: Vec<f32>,
}

impl Solver {
    /// Makes room for `parameters.grid`.
    pub fn new(parameters: &Parameters) -> Self {
        let columns = Columns::finest(parameters);
        Self {
            columnar: Columnar::new(&columns),
            scratch: vec![0.0; columns.scratch_len()],
            columns,
        }
    }

    /// Bytes that the solver holds.
    pub fn bytes(&self) -> usize {
        self.columnar.bytes() + 4 * self.scratch.len()
    }

    /// Improves `pressure` by `sweeps` sweeps for a stage of length `dt_s`.
    pub fn run(
        &mut self,
        parameters: &Parameters,
        velocity: [&[f32]; 3],
        dt_s: f32,
        sweeps: u32,
        relaxation: f32,
        pressure: &mut [f32],
    ) {
        let relaxation = relaxation_on(parameters.grid.cells, relaxation);
        self.columnar.load(parameters, velocity, dt_s, pressure);
        for _ in 0..sweeps {
            let Columnar {
                source_rows, values, ..
            } = &mut self.columnar;
            self.columns.sweep(relaxation, source_rows, values, &mut self.scratch);
        }
        self.columnar.store(parameters, pressure);
    }
}
