//! Stage `diffusion` on the GPU: what its kernels are told, and their dispatches.

use super::view_kernels::LateKernel;
use super::view_stages::{ShapeGrid, ViewStages};
use super::{GpuError, Kernel};
use crate::cpu::light::diffusion::similarity;
use crate::cpu::light::diffusion_grids::{
    DIFFUSION_CYCLES, DIFFUSION_PLANES, DIFFUSION_SWEEP_FIRST, DIFFUSION_SWEEP_SECOND, coarser,
};

crate::gpu_struct! {
    /// A grid of the diffusion's hierarchy, and the one beside it that a kernel goes to or comes from.
    pub struct DiffusionGrid {
        /// Cells east.
        pub cells_x: u32,
        /// Cells north.
        pub cells_y: u32,
        /// Levels of cells.
        pub levels: u32,
        /// Where its cells begin in a plane.
        pub first: u32,
        /// As `cells_x`, of the other grid.
        pub other_x: u32,
        /// As `cells_y`, of the other grid.
        pub other_y: u32,
        /// As `levels`, of the other grid.
        pub other_levels: u32,
        /// As `first`, of the other grid.
        pub other_first: u32,
        /// Cell size, m.
        pub cell_size_x_m: f32,
        /// Cell size, m.
        pub cell_size_y_m: f32,
        /// Cell size, m.
        pub cell_size_z_m: f32,
        /// A sweep's weight.
        pub weight: f32,
        /// Whether a sweep goes from the plane of fluence to the spare one, or back.
        pub to_spare: u32,
        /// Cells of a plane.
        pub total: u32,
        /// Whether detail carves the cloud.
        pub carved: u32,
        /// 1 less the phase function's asymmetry.
        pub similarity: f32,
    }
}

/// The kernels of the stage.
#[derive(Debug)]
pub(super) struct DiffusionKernels {
    sources: LateKernel,
    conduct: LateKernel,
    join: LateKernel,
    sweep: LateKernel,
    leave_over: LateKernel,
    take_up: LateKernel,
    bottom: LateKernel,
    add: LateKernel,
    meetings: LateKernel,
    between_clouds: LateKernel,
    flow: LateKernel,
    surface: LateKernel,
}

impl DiffusionKernels {
    pub(super) const fn new() -> DiffusionKernels {
        DiffusionKernels {
            sources: LateKernel::new("diffusion_sources"),
            conduct: LateKernel::new("diffusion_conduct"),
            join: LateKernel::new("diffusion_join"),
            sweep: LateKernel::new("diffusion_sweep"),
            leave_over: LateKernel::new("diffusion_leave_over"),
            take_up: LateKernel::new("diffusion_take_up"),
            bottom: LateKernel::new("diffusion_bottom"),
            add: LateKernel::new("diffusion_add"),
            meetings: LateKernel::new("diffusion_meetings"),
            between_clouds: LateKernel::new("diffusion_between_clouds"),
            flow: LateKernel::new("diffusion_flow"),
            surface: LateKernel::new("diffusion_surface"),
        }
    }
}

/// A grid with what its kernels are told, by the grid that they go to.
struct Told {
    cells: [usize; 3],
    /// The first sweep, and what follows from this grid alone or goes to it from the coarser one.
    first: wgpu::Buffer,
    /// The second sweep.
    second: wgpu::Buffer,
    /// With the finer grid as the other.
    from_finer: wgpu::Buffer,
}

/// A grid's step in a cycle.
enum Step {
    Sweep,
    LeaveOver,
    TakeUp,
    Bottom,
    Add,
}

/// The steps of a V-cycle; a whole one goes to the coarser grids twice, first whole and then in a V.
fn cycle(told: &[Told], whole: bool, run: &mut impl FnMut(Step, &wgpu::Buffer, [usize; 3])) {
    let [grid, coarser @ ..] = told else { return };
    if coarser.is_empty() {
        run(Step::Bottom, &grid.first, [1; 3]);
        return;
    }
    run(Step::Sweep, &grid.first, grid.cells);
    run(Step::Sweep, &grid.second, grid.cells);
    run(Step::LeaveOver, &grid.first, grid.cells);
    run(Step::TakeUp, &coarser[0].from_finer, coarser[0].cells);
    if whole {
        cycle(coarser, true, run);
    }
    cycle(coarser, false, run);
    run(Step::Add, &grid.first, grid.cells);
    run(Step::Sweep, &grid.first, grid.cells);
    run(Step::Sweep, &grid.second, grid.cells);
}

impl ViewStages {
    /// Cells of all grids of the hierarchy.
    pub(super) fn diffusion_cells(grid: &ShapeGrid) -> u64 {
        let grids = hierarchy(grid);
        grids
            .iter()
            .map(|(cells, _)| cells.iter().product::<usize>() as u64)
            .sum()
    }

    /// Bytes of the conductances, and of the other numbers, of stage `diffusion`.
    pub fn diffusion_bytes(grid: &ShapeGrid) -> u64 {
        Self::diffusion_cells(grid) * DIFFUSION_PLANES as u64 * 4
    }

    /// Stage `diffusion`; `cloud` is the shape, the occupancy and the light, `scratch` two buffers of [`ViewStages::diffusion_bytes`]. Fluence and flux go behind the shadow map.
    pub fn diffusion(
        &self,
        grid: &ShapeGrid,
        uniform: &wgpu::Buffer,
        (carved, asymmetry): (bool, f32),
        [shape, occupancy, light]: [&wgpu::Buffer; 3],
        [conductance, numbers]: [&wgpu::Buffer; 2],
        shadow: &wgpu::Buffer,
    ) -> Result<(), GpuError> {
        let c = self.context();
        let k = &self.diffusion;
        let [sources, conduct, join] = [&k.sources, &k.conduct, &k.join].map(|k| k.get(c));
        let [sweep, leave_over, take_up] = [&k.sweep, &k.leave_over, &k.take_up].map(|k| k.get(c));
        let [bottom, add, flow, surface] = [&k.bottom, &k.add, &k.flow, &k.surface].map(|k| k.get(c));
        let (sources, conduct, join, sweep, leave_over) = (sources?, conduct?, join?, sweep?, leave_over?);
        let (take_up, bottom, add, flow, surface) = (take_up?, bottom?, add?, flow?, surface?);
        let (meetings, between_clouds) = (k.meetings.get(c)?, k.between_clouds.get(c)?);
        let mut told = Vec::new();
        let grids = hierarchy(grid);
        let total = Self::diffusion_cells(grid) as u32;
        let mut first = 0u32;
        let mut last = grids[0].0;
        for (n, (cells, size_m)) in grids.iter().enumerate() {
            let count = cells.iter().product::<usize>() as u32;
            let last_count = last.iter().product::<usize>() as u32;
            let coarser = grids.get(n + 1).map_or([1; 3], |(cells, _)| *cells);
            let plain = DiffusionGrid {
                cells_x: cells[0] as u32,
                cells_y: cells[1] as u32,
                levels: cells[2] as u32,
                first,
                other_x: coarser[0] as u32,
                other_y: coarser[1] as u32,
                other_levels: coarser[2] as u32,
                other_first: first + count,
                cell_size_x_m: size_m[0],
                cell_size_y_m: size_m[1],
                cell_size_z_m: size_m[2],
                weight: DIFFUSION_SWEEP_FIRST,
                to_spare: 1,
                total,
                carved: u32::from(carved),
                similarity: similarity(asymmetry),
            };
            let second = DiffusionGrid {
                weight: DIFFUSION_SWEEP_SECOND,
                to_spare: 0,
                ..plain
            };
            let from_finer = DiffusionGrid {
                other_x: last[0] as u32,
                other_y: last[1] as u32,
                other_levels: last[2] as u32,
                other_first: first.wrapping_sub(last_count),
                ..plain
            };
            let tell = |told: &DiffusionGrid| c.uniform("a grid of the diffusion", told.bytes());
            told.push(Told {
                cells: *cells,
                first: tell(&plain)?,
                second: tell(&second)?,
                from_finer: tell(&from_finer)?,
            });
            first += count;
            last = *cells;
        }
        let groups = |[x, y, z]: [usize; 3]| [x.div_ceil(32) as u32, y.div_ceil(2) as u32, z.div_ceil(2) as u32];
        self.submit(|pass| {
            let mut run = |kernel: &Kernel, by: &wgpu::Buffer, cells: [usize; 3]| {
                let buffers = [uniform, by, shape, occupancy, light, conductance, numbers, shadow];
                kernel.record(pass, c, &buffers, groups(cells));
            };
            let finest = &told[0];
            run(sources, &finest.first, finest.cells);
            run(conduct, &finest.first, finest.cells);
            for grid in &told[1..] {
                run(join, &grid.from_finer, grid.cells);
            }
            for _ in 0..DIFFUSION_CYCLES {
                cycle(&told, true, &mut |step, by, cells| {
                    let kernel = match step {
                        Step::Sweep => sweep,
                        Step::LeaveOver => leave_over,
                        Step::TakeUp => take_up,
                        Step::Bottom => bottom,
                        Step::Add => add,
                    };
                    run(kernel, by, cells);
                });
            }
            let [x, y, z] = finest.cells;
            run(meetings, &finest.first, [x, y, 1]);
            run(between_clouds, &finest.first, [1; 3]);
            run(flow, &finest.first, finest.cells);
            run(surface, &finest.first, [x + 2, y + 2, z]);
        })
    }
}

/// Cells and their sizes of all grids, the finest first.
fn hierarchy(grid: &ShapeGrid) -> Vec<([usize; 3], [f32; 3])> {
    let cells = [grid.cells_x, grid.cells_y, grid.levels].map(|n| n as usize);
    let size_m = [grid.cell_size_x_m, grid.cell_size_y_m, grid.cell_size_z_m];
    std::iter::successors(Some((cells, size_m)), |(cells, size_m)| coarser(*cells, *size_m)).collect()
}
