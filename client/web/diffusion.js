// @ts-check
// Stage `diffusion` on this computer's GPU: its grids and the order of its kernels. The twin is shaders/src/gpu/view_diffusion.rs.

/** @import { Kernels } from "./kernels.js" */
/** @import { Values } from "./raymarch.js" */

/** The module whose kernels it runs. */
export const DIFFUSION_MODULE = "light/diffusion";

/** @typedef {{cells: number[], size_m: number[]}} Grid cells and their size along x, y and z */

/**
 * A grid with what its kernels are told.
 * @typedef {object} Told
 * @property {number[]} cells
 * @property {GPUBuffer} first the first sweep, and what follows from this grid alone or goes to it from the coarser one
 * @property {GPUBuffer} second the second sweep
 * @property {GPUBuffer} fromFiner with the finer grid as the other
 */

/** @param {number[]} cells */
const count = (cells) => cells.reduce((product, n) => product * n, 1);

/**
 * All grids of a cloud, the finest first: each joins two cells of the one before along every axis that is not much longer than the shortest.
 * @param {Record<string, number>} grid members of `ShapeGrid`
 * @param {Kernels} kernels
 */
function hierarchy(grid, kernels) {
  const below = Math.fround(kernels.constant("DIFFUSION_JOINS_BELOW"));
  /** @type {Grid[]} */
  const grids = [];
  let cells = [grid.cells_x, grid.cells_y, grid.levels];
  let size_m = [grid.cell_size_x_m, grid.cell_size_y_m, grid.cell_size_z_m].map(Math.fround);
  for (;;) {
    grids.push({ cells, size_m });
    const shortest = Math.min(...size_m.filter((_, a) => cells[a] > 1));
    const joined = cells.map((n, a) => n > 1 && size_m[a] < Math.fround(below * shortest));
    if (!joined.includes(true)) {
      return grids;
    }
    cells = cells.map((n, a) => (joined[a] ? Math.ceil(n / 2) : n));
    size_m = size_m.map((size, a) => (joined[a] ? 2 * size : size));
  }
}

/**
 * Words of fluence and flux: one a cell, with one more on each side in x and y.
 * @param {Record<string, number>} grid members of `ShapeGrid`
 */
export const fluenceNumbers = (grid) => (grid.cells_x + 2) * (grid.cells_y + 2) * grid.levels;

/** Runs the stage; keeps what its kernels are told from one cloud to the next of the same extent. */
export class Diffusion {
  /** @param {Kernels} kernels */
  constructor(kernels) {
    this.kernels = kernels;
    /** @type {Told[]} */
    this.told = [];
    this.toldOf = "";
  }

  /**
   * Bytes of the conductances, and of the other numbers.
   * @param {Record<string, number>} grid members of `ShapeGrid`
   */
  bytes(grid) {
    const cells = hierarchy(grid, this.kernels).reduce((sum, one) => sum + count(one.cells), 0);
    return cells * this.kernels.constant("DIFFUSION_PLANES") * 4;
  }

  /**
   * @param {Record<string, number>} grid members of `ShapeGrid`
   * @param {Values} light `carved` and `similarity`
   */
  tell(grid, light) {
    const { kernels } = this;
    const grids = hierarchy(grid, kernels);
    const key = JSON.stringify([grids, light]);
    if (key === this.toldOf) {
      return this.told;
    }
    for (const { first, second, fromFiner } of this.told) {
      first.destroy();
      second.destroy();
      fromFiner.destroy();
    }
    const total = grids.reduce((sum, { cells }) => sum + count(cells), 0);
    let first = 0;
    let finer = grids[0].cells;
    this.told = grids.map(({ cells, size_m }, n) => {
      const coarser = grids[n + 1]?.cells ?? [1, 1, 1];
      /** @param {number[]} other @param {number} other_first */
      const beside = (other, other_first) => ({ other_x: other[0], other_y: other[1], other_levels: other[2], other_first });
      const plain = {
        ...light,
        cells_x: cells[0],
        cells_y: cells[1],
        levels: cells[2],
        first,
        ...beside(coarser, first + count(cells)),
        cell_size_x_m: size_m[0],
        cell_size_y_m: size_m[1],
        cell_size_z_m: size_m[2],
        weight: kernels.constant("DIFFUSION_SWEEP_FIRST"),
        to_spare: true,
        total,
      };
      const then = { ...plain, weight: kernels.constant("DIFFUSION_SWEEP_SECOND"), to_spare: false };
      // The finest has no finer one, and nothing comes to it from there.
      const from = { ...plain, ...beside(finer, n === 0 ? 0 : first - count(finer)) };
      first += count(cells);
      finer = cells;
      return {
        cells,
        first: kernels.uniform("DiffusionGrid", plain),
        second: kernels.uniform("DiffusionGrid", then),
        fromFiner: kernels.uniform("DiffusionGrid", from),
      };
    });
    this.toldOf = key;
    return this.told;
  }

  /**
   * Records the stage; fluence and flux go behind the shadow map.
   * @param {GPUComputePassEncoder} pass
   * @param {Record<string, number>} grid members of `ShapeGrid`
   * @param {Values} light `carved` and `similarity`
   * @param {Record<string, GPUBuffer>} buffers by the names in the kernels' WGSL, but `grid`
   */
  run(pass, grid, light, buffers) {
    const { kernels } = this;
    const told = this.tell(grid, light);
    /** @type {Map<GPUBuffer, GPUBindGroup>} the stage's kernels bind the same */
    const groups = new Map();
    /** @param {string} kernel @param {GPUBuffer} by @param {number[]} cells */
    const step = (kernel, by, cells) => {
      const group = groups.get(by) ?? kernels.bind(kernel, { ...buffers, grid: by }).group;
      groups.set(by, group);
      kernels.record(pass, kernel, group, kernels.groups(kernel, cells));
    };
    /** A grid's two sweeps. @param {Told} of */
    const sweep = ({ cells, first, second }) => {
      step("diffusion_sweep", first, cells);
      step("diffusion_sweep", second, cells);
    };
    /** A V-cycle from a grid on; a whole one goes to the coarser grids twice, first whole and then in a V. @param {number} n @param {boolean} whole */
    const cycle = (n, whole) => {
      const here = told[n];
      if (n + 1 === told.length) {
        step("diffusion_bottom", here.first, [1, 1, 1]);
        return;
      }
      sweep(here);
      step("diffusion_leave_over", here.first, here.cells);
      step("diffusion_take_up", told[n + 1].fromFiner, told[n + 1].cells);
      if (whole) {
        cycle(n + 1, true);
      }
      cycle(n + 1, false);
      step("diffusion_add", here.first, here.cells);
      sweep(here);
    };
    const [finest, ...coarser] = told;
    step("diffusion_sources", finest.first, finest.cells);
    step("diffusion_conduct", finest.first, finest.cells);
    for (const { cells, fromFiner } of coarser) {
      step("diffusion_join", fromFiner, cells);
    }
    for (let n = 0; n < kernels.constant("DIFFUSION_CYCLES"); n++) {
      cycle(0, true);
    }
    const [x, y, z] = finest.cells;
    step("diffusion_meetings", finest.first, [x, y, 1]);
    step("diffusion_between_clouds", finest.first, [1, 1, 1]);
    step("diffusion_flow", finest.first, finest.cells);
    step("diffusion_surface", finest.first, [x + 2, y + 2, z]);
  }
}
