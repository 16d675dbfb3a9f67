//! `welkin bench --scaling`: what a cell costs by the size of the grid, beside the machine's copy bandwidth.

use std::time::{Duration, Instant};

use serde::Serialize;
use welkin_proto::Scene;

use super::BenchError;
use crate::machine::Machine;
use crate::world::World;

/// Cells along an edge.
const EDGES: [u32; 4] = [32, 64, 128, 256];
/// Simulated seconds of a tick: a few substeps of the coarse grids, more of the fine ones.
const TICK_S: f64 = 4.0;

/// One size of the grid.
#[derive(Clone, Debug, Serialize)]
pub struct Size {
    /// Cells along each edge.
    pub edge: u32,
    /// Bytes of fields and solver.
    pub bytes: u64,
    /// Substeps that were timed.
    pub substeps: u32,
    /// Wall milliseconds a substep, a tick's publication included.
    pub substep_ms: f64,
    /// Wall nanoseconds a cell and substep.
    pub ns_per_cell_substep: f64,
    /// Bytes a cell and substep that the passes must move, each value once a pass.
    pub bytes_per_cell_substep: f64,
    /// Those bytes over the time, over what a copy reaches. More than 1 means that fields stay in cache.
    pub share_of_copy: f64,
}

/// Times the scene on cubes of rising size in a box of its own extent, at least one tick each and `window` where that is longer.
///
/// Errors: the scene's.
pub fn measure(
    scene: &Scene,
    machine: &Machine,
    copy_bytes_per_s: f64,
    window: Duration,
) -> Result<Vec<Size>, BenchError> {
    EDGES
        .into_iter()
        .map(|edge| {
            eprintln!("measuring {edge} x {edge} x {edge} cells");
            one(scene, edge, machine, copy_bytes_per_s, window)
        })
        .collect()
}

fn one(
    scene: &Scene,
    edge: u32,
    machine: &Machine,
    copy_bytes_per_s: f64,
    window: Duration,
) -> Result<Size, BenchError> {
    let mut scene = scene.clone();
    for axis in 0..3 {
        scene.domain.cell_size_m[axis] *= f64::from(scene.domain.cells[axis]) / f64::from(edge);
        scene.domain.cells[axis] = edge;
    }
    let mut world = World::new(scene, machine.clone())?;
    // The first substep touches memory for the first time.
    world.advance_by(0.1);
    let before = world.plan_report();
    let (mut substeps, began) = (0, Instant::now());
    while substeps == 0 || began.elapsed() < window {
        world.advance_by(TICK_S);
        substeps += world.numbers().substeps;
    }
    let wall_s = began.elapsed().as_secs_f64();
    let after = world.plan_report();
    let runs = |report: &welkin_proto::wire::PlanReport, i: usize| report.passes[i].runs as f64;
    let moved: f64 = (0..after.passes.len())
        .filter(|&i| after.passes[i].phase != "publish")
        .filter_map(|i| Some((runs(&after, i) - runs(&before, i)) * after.passes[i].bytes_per_cell? as f64))
        .sum();
    let cells = f64::from(edge).powi(3);
    let steps = f64::from(substeps);
    Ok(Size {
        edge,
        bytes: after.bytes,
        substeps,
        substep_ms: 1e3 * wall_s / steps,
        ns_per_cell_substep: 1e9 * wall_s / (steps * cells),
        bytes_per_cell_substep: moved / steps,
        share_of_copy: moved * cells / wall_s / copy_bytes_per_s,
    })
}

/// The table for people.
pub fn table(sizes: &[Size], copy_bytes_per_s: f64) -> String {
    let mut text = format!("a copy reads and writes {:.1} GB/s\n", copy_bytes_per_s / 1e9);
    text += "  cells        MiB   ms a substep   ns a cell substep   bytes a cell substep   share of a copy\n";
    for size in sizes {
        text += &format!(
            "{:>5} cubed {:>7.0} {:>14.1} {:>19.1} {:>22.0} {:>17.2}\n",
            size.edge,
            size.bytes as f64 / f64::from(1 << 20),
            size.substep_ms,
            size.ns_per_cell_substep,
            size.bytes_per_cell_substep,
            size.share_of_copy
        );
    }
    text
}
