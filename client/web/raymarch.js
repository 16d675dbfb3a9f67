// @ts-check
// Pictures drawn on this computer's GPU by the server's kernels: the same stages in the same order as shaders/src/gpu/view.rs, and tables that
// are made again only when what they depend on has changed.

/** @import { Camera, Cloud, Lights, Scenery } from "./types.js" */
/** @import { Kernels } from "./kernels.js" */

import { DIFFUSION_MODULE, Diffusion, fluenceNumbers } from "./diffusion.js";
import { BALANCE_MODULE, balanceNumbers, isBalanced, makeBalance } from "./octave_balance.js";
import { beamDirection, cameraPlace, cloudySlab, horizonSine, marchedSun, moonLook, tableSun, viewFrame } from "./scenery.js";
import { SUN_MAP_MODULE, drawSunMap, mapNumbers, sunMapping } from "./sun_map.js";

/** Pixels that one submission draws at most, so that the page's other work on the GPU gets its turn. */
const BAND_PIXELS = 1 << 18;

/** @typedef {Record<string, number | boolean | ArrayLike<number>>} Values */

/**
 * A cloud's shape on the GPU.
 * @typedef {object} Shape
 * @property {Values} grid
 * @property {GPUBuffer} uniform
 * @property {GPUBuffer} words
 * @property {GPUBuffer} occupancy
 * @property {GPUBuffer} above
 * @property {GPUBuffer} below
 */

/** Draws pictures; keeps what pictures of the same cloud or sky share. */
export class Raymarcher {
  /** @param {Kernels} kernels */
  constructor(kernels) {
    this.kernels = kernels;
    this.device = kernels.device;
    this.diffusion = new Diffusion(kernels);
    /** @type {Map<string, GPUBuffer>} buffers that grow when they must */
    this.buffers = new Map();
    /** @type {Map<string, string>} what each table was made for */
    this.made = new Map();
    /** @type {Cloud | null} */
    this.cloud = null;
    /** @type {Shape | null} */
    this.shape = null;
    this.shapeIsOld = true;
    /** @type {{numbers: object, buffer: GPUBuffer} | null} the phase function that is drawn with */
    this.phase = null;
    this.blank = this.storage("blank", 64);
    this.noCloud = this.device.createBuffer({
      label: "no cloud",
      size: kernels.shaders.structs.ShapeGrid.size_bytes,
      usage: GPUBufferUsage.UNIFORM,
    });
    this.starWords = this.device.createBuffer({
      label: "stars",
      size: kernels.constant("STAR_WORDS") * 4,
      usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST,
    });
    this.frame = kernels.device.createBuffer({
      label: "frame",
      size: kernels.shaders.structs.ViewFrame.size_bytes,
      usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST,
    });
  }

  /**
   * Compiles what a world's light takes and is not compiled yet.
   * @param {Scenery} scenery
   */
  async prepare(scenery) {
    const { similarity, map_side } = scenery.uniforms.ViewFrame;
    await Promise.all([
      Number(similarity) > 0 ? this.kernels.prepare(DIFFUSION_MODULE) : null,
      isBalanced(scenery) ? this.kernels.prepare(BALANCE_MODULE) : null,
      Number(map_side) > 0 ? this.kernels.prepare(SUN_MAP_MODULE) : null,
    ]);
  }

  /**
   * The cloud that is drawn from now on.
   * @param {Cloud | null} cloud
   */
  setCloud(cloud) {
    this.cloud = cloud;
    this.shapeIsOld = true;
  }

  /**
   * The stars that are drawn from now on.
   * @param {ArrayBuffer} words
   */
  setStars(words) {
    this.device.queue.writeBuffer(this.starWords, 0, words);
  }

  /**
   * A buffer of at least so many bytes, kept under a name.
   * @param {string} name
   * @param {number} bytes
   * @param {number} [more] further usages
   */
  storage(name, bytes, more = 0) {
    const kept = this.buffers.get(name);
    if (kept !== undefined && kept.size >= bytes) {
      return kept;
    }
    const limit = this.device.limits.maxStorageBufferBindingSize;
    if (bytes > limit) {
      throw new Error(`${name} takes ${bytes} bytes, and this GPU binds ${limit} at most`);
    }
    kept?.destroy();
    const buffer = this.device.createBuffer({
      label: name,
      size: bytes,
      usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_SRC | GPUBufferUsage.COPY_DST | more,
    });
    this.buffers.set(name, buffer);
    return buffer;
  }

  /**
   * Whether a table must be made; notes what it is made for.
   * @param {string} table
   * @param {...unknown} parts
   */
  isNew(table, ...parts) {
    const key = JSON.stringify(parts);
    if (this.made.get(table) === key) {
      return false;
    }
    this.made.set(table, key);
    return true;
  }

  /**
   * Records and submits a picture; its bytes are in the returned buffer when the GPU is done, three a pixel, rows filled up to whole words.
   * @param {Scenery} scenery
   * @param {Camera} camera
   * @param {Lights} lights
   * @param {[number, number]} size pixels
   */
  draw(scenery, camera, lights, size) {
    const { kernels } = this;
    const encoder = this.device.createCommandEncoder();
    const pass = encoder.beginComputePass();
    const detail = this.detailNoise(pass);
    const air = this.airTables(pass, scenery);
    const height_m = cameraPlace(camera, kernels)[2];
    const sky = this.skyTable(pass, scenery, air, lights, height_m);
    if (this.shapeIsOld) {
      this.makeShape(pass);
      this.shapeIsOld = false;
    }
    const light = this.skyLight(pass, scenery, air, lights);
    const cloud = this.sunLight(pass, scenery, tableSun(beamDirection(lights, kernels), kernels), detail);
    pass.end();
    this.device.queue.submit([encoder.finish()]);

    const [width, height] = size;
    const frame = { ...viewFrame(scenery, camera, lights, this.shape === null ? null : this.cloud, size, kernels), ...cloud.map };
    const picture = this.storage("picture", frame.row_words * height * 4);
    const { pipeline, group } = kernels.bind("march", {
      frame: this.frame,
      light,
      shape: this.shape?.uniform ?? this.noCloud,
      transmittance_table: air.transmittance,
      sky_table: sky,
      shape_words: this.shape?.words ?? this.blank,
      occupancy_words: this.shape?.occupancy ?? this.blank,
      light_words: cloud.words,
      shadow: cloud.shadow,
      detail_words: detail,
      picture,
      star_words: this.starWords,
      phase: this.phaseFunction(scenery),
    });
    const band = Math.max(8, Math.ceil(BAND_PIXELS / width / 8) * 8);
    for (let row = 0; row < height; row += band) {
      kernels.write(this.frame, "ViewFrame", { ...frame, first_row: row });
      const bandEncoder = this.device.createCommandEncoder();
      const bandPass = bandEncoder.beginComputePass();
      bandPass.setPipeline(pipeline);
      bandPass.setBindGroup(0, group);
      const [x, y] = kernels.groups("march", [width, Math.min(band, height - row)]);
      bandPass.dispatchWorkgroups(x, y);
      bandPass.end();
      this.device.queue.submit([bandEncoder.finish()]);
    }
    return { picture, row_words: frame.row_words };
  }

  /**
   * How clouds turn light.
   * @param {Scenery} scenery
   */
  phaseFunction(scenery) {
    const numbers = scenery.uniforms.MarchPhase;
    if (this.phase === null || this.phase.numbers !== numbers) {
      this.phase?.buffer.destroy();
      this.made.delete("octave balance");
      this.phase = { numbers, buffer: this.kernels.uniform("MarchPhase", numbers) };
    }
    return this.phase.buffer;
  }

  /** @param {GPUComputePassEncoder} pass */
  detailNoise(pass) {
    const { kernels } = this;
    const points = kernels.constant("TILE_POINTS") ** 3;
    const words = this.storage("detail tile", points * 4);
    if (this.isNew("detail noise")) {
      const buffers = {
        values_at: this.storage("billows", points * 8),
        sums: this.storage("sums of billows", (points / 256) * 16),
        words,
      };
      const groups = kernels.groups("noise_values", [points]);
      kernels.dispatch(pass, "noise_values", buffers, groups);
      kernels.dispatch(pass, "noise_spread", buffers, [1]);
      kernels.dispatch(pass, "noise_pack", buffers, groups);
    }
    return words;
  }

  /** @param {GPUComputePassEncoder} pass @param {Scenery} scenery */
  airTables(pass, scenery) {
    const { kernels } = this;
    const texels = kernels.constant("TRANSMITTANCE_HEIGHTS") * kernels.constant("TRANSMITTANCE_DIRECTIONS");
    const higher = kernels.constant("MULTIPLE_HEIGHTS") * kernels.constant("MULTIPLE_SUNS");
    const transmittance = this.storage("transmittance", texels * 16);
    const multiple = this.storage("multiple scattering", higher * 16);
    const values = scenery.uniforms.Air;
    if (this.isNew("air", values)) {
      this.airUniform?.destroy();
      this.airUniform = kernels.uniform("Air", values);
      const first = { air: this.airUniform, table: transmittance };
      kernels.dispatch(pass, "transmittance", first, kernels.groups("transmittance", [texels]));
      // A workgroup a texel.
      const second = { air: this.airUniform, transmittance_table: transmittance, table: multiple };
      kernels.dispatch(pass, "multiple_scattering", second, [higher]);
    }
    return { uniform: /** @type {GPUBuffer} */ (this.airUniform), transmittance, multiple };
  }

  /**
   * What lights the sky: the sun with the night sky's own light, and the moon where its light is worth a sky.
   * @param {Lights} lights
   */
  sources(lights) {
    const { kernels } = this;
    const moon = moonLook(lights, kernels);
    const dark = { scattered_glow: [0, 0, 0], layer_glow: [0, 0, 0] };
    const sun = { direction: tableSun(lights.sun, kernels), strength: [1, 1, 1] };
    return moon?.lights_sky
      ? [sun, { direction: tableSun(moon.direction, kernels), strength: moon.irradiance, ...dark }]
      : [sun];
  }

  /**
   * @param {GPUComputePassEncoder} pass
   * @param {Scenery} scenery
   * @param {{uniform: GPUBuffer, transmittance: GPUBuffer, multiple: GPUBuffer}} air
   * @param {Lights} lights
   * @param {number} height_m
   */
  skyTable(pass, scenery, air, lights, height_m) {
    const { kernels } = this;
    const texels = 2 * kernels.constant("SKY_HALF_ROWS") * kernels.constant("SKY_COLUMNS");
    const table = this.storage("sky", 2 * texels * 16);
    const sources = this.sources(lights);
    if (this.isNew("sky", this.made.get("air"), scenery.uniforms.SkyView, sources, height_m)) {
      sources.forEach((source, n) => {
        const view = kernels.uniform("SkyView", {
          ...scenery.uniforms.SkyView,
          ...source,
          horizon_sine: horizonSine(height_m, kernels),
          height_m,
          first_texel: n * texels,
        });
        const buffers = {
          air: air.uniform,
          view,
          transmittance_table: air.transmittance,
          multiple_scattering_table: air.multiple,
          table,
        };
        kernels.dispatch(pass, "sky", buffers, kernels.groups("sky", [texels]));
      });
    }
    return table;
  }

  /**
   * @param {GPUComputePassEncoder} pass
   * @param {Scenery} scenery
   * @param {{uniform: GPUBuffer, transmittance: GPUBuffer, multiple: GPUBuffer}} air
   * @param {Lights} lights
   */
  skyLight(pass, scenery, air, lights) {
    const { kernels } = this;
    const values = this.storage("sky light", kernels.shaders.structs.SkyLightValues.size_bytes, GPUBufferUsage.UNIFORM);
    const grid = this.shape?.grid;
    const beam_share = moonLook(lights, kernels)?.beam_share ?? 0;
    const asks = this.sources(lights).map((source, n) => ({
      ...scenery.uniforms.SkyLightAsk,
      ...source,
      beam_share: n === 1 ? beam_share : 0,
      adds: n === 1,
      base_m: grid === undefined ? 0 : Math.max(1, Number(grid.bottom_m)),
      top_m: grid === undefined ? 1000 : Number(grid.top_m),
    }));
    if (this.isNew("sky light", this.made.get("air"), asks)) {
      for (const ask of asks) {
        const buffers = {
          air: air.uniform,
          ask: kernels.uniform("SkyLightAsk", ask),
          transmittance_table: air.transmittance,
          multiple_scattering_table: air.multiple,
          light: values,
        };
        kernels.dispatch(pass, "sky_light", buffers, [1]);
      }
    }
    return values;
  }

  /** @param {GPUComputePassEncoder} pass */
  makeShape(pass) {
    const { kernels } = this;
    const slab = this.cloud === null ? null : cloudySlab(this.cloud, kernels);
    this.made.delete("sun light");
    this.shape?.uniform.destroy();
    if (slab === null) {
      this.shape = null;
      return;
    }
    const { grid, extinction_per_m } = slab;
    const cells = [grid.cells_x, grid.cells_y, grid.levels];
    const bytes = extinction_per_m.byteLength;
    const extinction = this.storage("extinction", bytes);
    const largest = this.storage("largest extinction", bytes);
    const words = this.storage("shape", grid.stride_x * grid.stride_y * grid.points_z * 4);
    const occupancy = this.storage("occupancy", Math.ceil(extinction_per_m.length / 4) * 4);
    const above = this.storage("above", bytes);
    const below = this.storage("below", bytes);
    const uniform = kernels.uniform("ShapeGrid", grid);
    this.device.queue.writeBuffer(extinction, 0, extinction_per_m);

    const shape = { shape: uniform, extinction_per_m: extinction, largest_per_m: largest, words };
    kernels.dispatch(pass, "shape_neighbours", shape, kernels.groups("shape_neighbours", cells));
    kernels.dispatch(pass, "shape_points", shape, kernels.groups("shape_points", cells));

    const near = {
      shape: uniform,
      largest_per_m: largest,
      along_x: this.storage("along x", bytes),
      along_xy: this.storage("along x and y", bytes),
      words: occupancy,
    };
    const rows = Math.ceil(Math.ceil(extinction_per_m.length / 4) / grid.occupancy_row);
    kernels.dispatch(pass, "nearest_x", near, kernels.groups("nearest_x", cells));
    kernels.dispatch(pass, "nearest_xy", near, kernels.groups("nearest_xy", cells));
    kernels.dispatch(pass, "nearest_xyz", near, kernels.groups("nearest_xyz", [grid.occupancy_row, rows, 1]));

    this.visibility(pass, grid, { extinction_per_m: extinction, above, below });
    this.shape = { grid, uniform, words, occupancy, above, below };
  }

  /**
   * @param {GPUComputePassEncoder} pass
   * @param {{cells_x: number, cells_y: number, levels: number, cell_size_x_m: number, cell_size_y_m: number, cell_size_z_m: number}} grid
   * @param {Record<string, GPUBuffer>} buffers
   */
  visibility(pass, grid, buffers) {
    const { kernels } = this;
    const tile = kernels.constant("VISIBILITY_TILE");
    const { cells_x, cells_y, levels } = grid;
    if (Math.max(cells_x, cells_y) > tile) {
      throw new Error(`a line of ${Math.max(cells_x, cells_y)} cells is longer than the ${tile} that a workgroup keeps`);
    }
    const straight = {
      cells_x,
      cells_y,
      levels,
      axis: 0,
      lines_per_tile: 1,
      path_m: grid.cell_size_z_m,
      reach: 0,
      scale: 1,
    };
    const [groups] = kernels.groups("visibility_straight", [cells_x * cells_y]);
    const first = { ...buffers, sweep: kernels.uniform("VisibilitySweep", straight) };
    kernels.dispatch(pass, "visibility_straight", first, [groups, 2]);
    for (const axis of [0, 1]) {
      const along = axis === 0 ? cells_x : cells_y;
      const across = axis === 0 ? cells_y : cells_x;
      // One cell an invocation where lines are short; eight columns beside each other are read at once.
      const lines = Math.min(Math.max(Math.floor(256 / along), 8), Math.floor(tile / along));
      const size_m = axis === 0 ? grid.cell_size_x_m : grid.cell_size_y_m;
      const sweep = kernels.uniform("VisibilitySweep", {
        ...straight,
        axis,
        lines_per_tile: lines,
        path_m: grid.cell_size_z_m * kernels.constant("SLANT_PATH"),
        reach: (kernels.constant("SLANT_SIDEWAYS") * grid.cell_size_z_m) / size_m,
        // The second of the two ends the mean over five directions.
        scale: axis === 0 ? 1 : 0.2,
      });
      kernels.dispatch(pass, "visibility_slanted", { ...buffers, sweep }, [Math.ceil(across / lines), 2]);
    }
  }

  /**
   * Optical depths towards the sun. Behind the shadow map and its share lies what else the march looks up of light: the diffuse light's fluence or the octaves' balance, then a map of the sun's rays.
   * @param {GPUComputePassEncoder} pass
   * @param {Scenery} scenery
   * @param {number[]} sun
   * @param {GPUBuffer} detail
   */
  sunLight(pass, scenery, sun, detail) {
    const { kernels, shape } = this;
    if (shape === null) {
      return { words: this.blank, shadow: this.blank, map: { map_sun: [0, 0, 0, 0], map_at: 0 } };
    }
    const grid = /** @type {Record<string, number>} */ (shape.grid);
    const similarity = Number(scenery.uniforms.ViewFrame.similarity);
    const shadowNumbers = grid.stride_x * grid.stride_y + 1;
    const balanced = isBalanced(scenery);
    const scattered = similarity > 0 ? fluenceNumbers(grid) : balanced ? balanceNumbers(grid) : 0;
    const map_at = shadowNumbers + scattered;
    const map = sunMapping(scenery, grid, this.cloud, sun, map_at, kernels);
    const numbers = map_at + (map === null ? 0 : mapNumbers(map, kernels));
    const words = this.storage("light", grid.stride_x * grid.stride_y * grid.points_z * 4);
    const shadow = this.storage("shadow", numbers * 4);
    const march = { ...scenery.uniforms.SunMarch, direction: marchedSun(sun, kernels) };
    if (this.isNew("sun light", march, numbers)) {
      this.made.delete("diffusion");
      this.made.delete("octave balance");
      this.made.delete("sun map");
      const buffers = {
        shape: shape.uniform,
        sun: kernels.uniform("SunMarch", march),
        shape_words: shape.words,
        occupancy_words: shape.occupancy,
        above: shape.above,
        below: shape.below,
        light_words: words,
        shadow,
      };
      const points = [grid.stride_x, grid.stride_y, grid.points_z];
      kernels.dispatch(pass, "sun_points", buffers, kernels.groups("sun_points", points));
      kernels.dispatch(pass, "ground_shadow", buffers, kernels.groups("ground_shadow", points.slice(0, 2)));
      kernels.dispatch(pass, "sunlit_share", buffers, [1]);
    }
    const cloud = { shape: shape.uniform, shape_words: shape.words, occupancy_words: shape.occupancy, shadow };
    const light = { carved: scenery.uniforms.SunMarch.carved, similarity };
    if (similarity > 0 && this.isNew("diffusion", light)) {
      const bytes = this.diffusion.bytes(grid);
      const planes = { conductance: this.storage("conductance", bytes), numbers: this.storage("diffuse light", bytes) };
      this.diffusion.run(pass, grid, light, { ...cloud, ...planes, light_words: words });
    }
    if (balanced && this.isNew("octave balance", scenery.uniforms.OctaveBalancing)) {
      const columns = this.storage("columns", grid.cells_x * grid.cells_y * 12);
      const balance = { ...scenery.uniforms.OctaveBalancing, beam: march.direction };
      makeBalance(pass, kernels, grid, balance, { ...cloud, columns, phase: this.phaseFunction(scenery), light_words: words });
    }
    if (map !== null && this.isNew("sun map", map)) {
      drawSunMap(pass, kernels, map, { ...cloud, detail_words: detail });
    }
    return { words, shadow, map: { map_sun: map?.map_sun ?? [0, 0, 0, 0], map_at } };
  }
}
