// @ts-check
// Stage `sun_map` on this computer's GPU: what its kernels are told, and their dispatches. The twin is shaders/src/gpu/view_sun_map.rs.

/** @import { Cloud, Scenery } from "./types.js" */
/** @import { Kernels } from "./kernels.js" */
/** @import { Values } from "./raymarch.js" */

import { detailOffset, marchedSun } from "./scenery.js";

/** The module whose kernels it runs. */
export const SUN_MAP_MODULE = "light/sun_map";

/**
 * What a map of the sun's rays is told; null where the world wants none.
 * @param {Scenery} scenery
 * @param {Record<string, number>} grid members of `ShapeGrid`
 * @param {Cloud | null} cloud
 * @param {number[]} sun that tables are made for
 * @param {number} map_at where it lies behind the shadow map
 * @param {Kernels} kernels
 */
export function sunMapping(scenery, grid, cloud, sun, map_at, kernels) {
  const { map_side, map_numbers, detail_push, detail_blend, detail_tiles_per_m } = scenery.uniforms.ViewFrame;
  if (Number(map_side) === 0) {
    return null;
  }
  const towards = marchedSun(sun, kernels);
  return {
    map_sun: [...towards, (grid.top_m - grid.bottom_m) / towards[2]],
    detail_offset_m: detailOffset(scenery, cloud),
    detail_push,
    detail_blend,
    detail_tiles_per_m,
    map_side: Number(map_side),
    map_numbers: Number(map_numbers),
    map_at,
  };
}

/**
 * Numbers that it takes behind the shadow map: the mean extinction, and planes.
 * @param {{map_side: number, map_numbers: number}} map
 * @param {Kernels} kernels
 */
export const mapNumbers = ({ map_side, map_numbers }, kernels) => 1 + map_side ** 2 * Math.max(map_numbers, kernels.constant("MAP_PLANES_LEAST"));

/**
 * Records the stage.
 * @param {GPUComputePassEncoder} pass
 * @param {Kernels} kernels
 * @param {Values & {map_side: number}} map
 * @param {Record<string, GPUBuffer>} buffers by the names in the kernels' WGSL, but `frame`
 */
export function drawSunMap(pass, kernels, map, buffers) {
  const all = { ...buffers, frame: kernels.uniform("SunMapping", map) };
  kernels.dispatch(pass, "sun_map_rays", all, kernels.groups("sun_map_rays", [map.map_side, map.map_side]));
  kernels.dispatch(pass, "sun_map_mean", all, [1]);
}
