// @ts-check
// Stage `octave_balance` on this computer's GPU: its dispatches. The twin is shaders/src/gpu/view_octave_balance.rs.

/** @import { Scenery } from "./types.js" */
/** @import { Kernels } from "./kernels.js" */
/** @import { Values } from "./raymarch.js" */

/** The module whose kernels it runs. */
export const BALANCE_MODULE = "light/octave_balance";

/**
 * Whether a world's clouds scatter by octaves.
 * @param {Scenery} scenery
 */
export const isBalanced = ({ uniforms: { ViewFrame } }) => Number(ViewFrame.octaves) > 0 && Number(ViewFrame.similarity) === 0;

/**
 * Numbers that it takes behind the shadow map: one a column of cells, with one more on each side.
 * @param {Record<string, number>} grid members of `ShapeGrid`
 */
export const balanceNumbers = (grid) => (grid.cells_x + 2) * (grid.cells_y + 2);

/**
 * Records the stage.
 * @param {GPUComputePassEncoder} pass
 * @param {Kernels} kernels
 * @param {Record<string, number>} grid members of `ShapeGrid`
 * @param {Values} balance members of `OctaveBalancing`
 * @param {Record<string, GPUBuffer>} buffers by the names in the kernels' WGSL, but `balance`
 */
export function makeBalance(pass, kernels, grid, balance, buffers) {
  const all = { ...buffers, balance: kernels.uniform("OctaveBalancing", balance) };
  const { cells_x, cells_y } = grid;
  kernels.dispatch(pass, "balance_sums", all, kernels.groups("balance_sums", [cells_x, cells_y]));
  for (const kernel of ["balance_brought_along_x", "balance_left_over_brought", "balance_shares_along_x"]) {
    kernels.dispatch(pass, kernel, all, kernels.groups(kernel, [cells_x * cells_y]));
  }
  kernels.dispatch(pass, "balance_factors", all, kernels.groups("balance_factors", [cells_x + 2, cells_y + 2]));
}
