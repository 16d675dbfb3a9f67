// @ts-check
// The sky drawn on this computer: volumes from the server, the server's own kernels, a camera of its own, at the display's rate.

/** @import { Camera, Cloud, Numbers, Scenery, VolumeField } from "./types.js" */

import { Kernels, loadShaders } from "./kernels.js";
import { Past } from "./past.js";
import { Raymarcher } from "./raymarch.js";
import { sunDirection } from "./scenery.js";
import { request } from "./stream.js";
import { VolumeStream, channelValues } from "./volume.js";

/** What a picture may take while things move, ms: more, and it is drawn with fewer pixels. */
const MOVING_MS = 30;
/** A picture at full size that takes no longer is drawn whenever anything changes. */
const ALWAYS_FULL_MS = 60;
/** Nothing has moved for so long: the picture is drawn at full size. */
const REST_MS = 250;
const PIXELS_LEAST = 64 * 36;
const PIXELS_MOST = 2560 * 1440;
const SCENERY_EVERY_MS = 10_000;

const PRESENT = /* wgsl */ `
@group(0) @binding(0) var<storage, read> picture: array<u32>;
// Width, height, words of a row; then width and height of what is shown.
@group(0) @binding(1) var<uniform> size: array<vec4<u32>, 2>;

@vertex
fn corner(@builtin(vertex_index) n: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(f32(n % 2u) * 4.0 - 1.0, f32(n / 2u) * 4.0 - 1.0, 0.0, 1.0);
}

fn pixel(at: vec2<i32>) -> vec3<f32> {
    let p = vec2<u32>(clamp(at, vec2<i32>(0), vec2<i32>(size[0].xy) - 1));
    var c: vec3<f32>;
    for (var i = 0u; i < 3u; i++) {
        let byte = p.x * 3u + i;
        c[i] = f32((picture[p.y * size[0].z + byte / 4u] >> (8u * (byte % 4u))) & 0xffu) / 255.0;
    }
    return c;
}

@fragment
fn show(@builtin(position) place: vec4<f32>) -> @location(0) vec4<f32> {
    let at = place.xy / vec2<f32>(size[1].xy) * vec2<f32>(size[0].xy) - 0.5;
    let f = at - floor(at);
    let i = vec2<i32>(floor(at));
    let low = mix(pixel(i), pixel(i + vec2<i32>(1, 0)), f.x);
    let high = mix(pixel(i + vec2<i32>(0, 1)), pixel(i + vec2<i32>(1, 1)), f.x);
    return vec4<f32>(mix(low, high, f.y), 1.0);
}
`;

/**
 * A volume as the cloud that is drawn; null where it holds no extinction.
 * @param {VolumeField} field
 * @returns {Cloud | null}
 */
export function cloudOf(field) {
  const extinction_per_m = channelValues(field, "extinction_per_m");
  const { cells, cell_size_m, mip, air_displacement_m } = field.header;
  return extinction_per_m === null
    ? null
    : {
        cells,
        cell_size_m: /** @type {[number, number, number]} */ (cell_size_m.map((size) => size * 2 ** mip)),
        extinction_per_m,
        air_displacement_m,
      };
}

/**
 * A GPU that this page may compute on, or why there is none.
 * @returns {Promise<{device: GPUDevice, name: string, software: boolean} | string>}
 */
export async function openDevice() {
  if (navigator.gpu === undefined) {
    return isSecureContext ? "this browser has no WebGPU" : "browsers give WebGPU to secure pages only (HTTPS, or this computer)";
  }
  const adapter = await navigator.gpu.requestAdapter({ powerPreference: "high-performance" });
  if (adapter === null) {
    return "this browser's WebGPU finds no GPU";
  }
  // A field is one binding: more than the 128 MiB that every GPU binds is taken where it is to be had.
  const { maxStorageBufferBindingSize, maxBufferSize } = adapter.limits;
  const device = await adapter.requestDevice({ requiredLimits: { maxStorageBufferBindingSize, maxBufferSize } });
  const { description, device: model, vendor, architecture } = adapter.info;
  const name = description || model || [vendor, architecture].filter(Boolean).join(" ") || "a GPU";
  const software = adapter.info.isFallbackAdapter === true || /swiftshader|llvmpipe|software/i.test(`${name} ${architecture}`);
  return { device, name, software };
}

/**
 * What a picture took.
 * @typedef {object} Drawn
 * @property {number} ms from the first command to the last pixel
 * @property {number} width
 * @property {number} height
 * @property {boolean} full
 * @property {{published_unix_s: number, encoded_unix_s: number, arrived_unix_ms: number, decode_ms: number} | null} volume of the first picture of a volume
 */

/** Draws one world's sky into a canvas. */
export class LocalSky {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {{device: GPUDevice, name: string}} gpu
   * @param {Kernels} kernels
   * @param {{drawn: (drawn: Drawn) => void, trouble: (why: string) => void}} handlers
   */
  constructor(canvas, gpu, kernels, handlers) {
    this.canvas = canvas;
    this.device = gpu.device;
    this.name = gpu.name;
    this.handlers = handlers;
    this.raymarcher = new Raymarcher(kernels);
    this.context = /** @type {GPUCanvasContext} */ (canvas.getContext("webgpu"));
    this.format = navigator.gpu.getPreferredCanvasFormat();
    this.context.configure({ device: this.device, format: this.format, alphaMode: "opaque" });
    const module = this.device.createShaderModule({ label: "present", code: PRESENT });
    this.present = this.device.createRenderPipeline({
      label: "present",
      layout: "auto",
      vertex: { module, entryPoint: "corner" },
      fragment: { module, entryPoint: "show", targets: [{ format: this.format }] },
    });
    this.sizes = this.device.createBuffer({ size: 32, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
    this.volumes = new VolumeStream({
      field: (field, timing) => this.took(field, timing),
      absent: () => {
        this.ready = true; // a world without moisture has no cloud
        this.changed();
      },
      error: (message) => handlers.trouble(message),
    });
    /** @type {Scenery | null} */
    this.scenery = null;
    /** @type {Camera | null} */
    this.camera = null;
    /** @type {number[] | null} */
    this.sun = null;
    /** @type {string | null} */
    this.world = null;
    /** Whether the cloud, or that there is none, is known: a clear sky is not to be shown for one that has not come. */
    this.ready = false;
    this.past = new Past();
    /** @type {VolumeField | null} shown instead of what comes */
    this.shownPast = null;
    /** @type {number | null} the tick of the cloud */
    this.tick = null;
    /** @type {Drawn["volume"]} */
    this.newVolume = null;
    this.msPerPixel = 1e-4;
    this.changedMs = -Infinity;
    this.dirty = false;
    this.shownFull = false;
    this.drawing = false;
    this.running = false;
    this.lastSceneryMs = -Infinity;
    void this.device.lost.then((lost) => {
      if (lost.reason !== "destroyed") {
        this.stop();
        handlers.trouble(`the GPU was lost: ${lost.message}`);
      }
    });
  }

  /**
   * Compiles everything.
   * @param {HTMLCanvasElement} canvas
   * @param {{device: GPUDevice, name: string}} gpu
   * @param {{drawn: (drawn: Drawn) => void, trouble: (why: string) => void}} handlers
   */
  static async make(canvas, gpu, handlers) {
    return new LocalSky(canvas, gpu, await Kernels.compile(gpu.device, await loadShaders()), handlers);
  }

  /** @param {string} world begins, or goes on with another world */
  async start(world) {
    this.running = true;
    if (this.world !== world) {
      this.world = world;
      this.scenery = null;
      this.tick = null;
      this.ready = false;
      this.past.clear();
      this.shownPast = null;
      this.raymarcher.setCloud(null);
    }
    await this.learnScenery();
    if (this.running && this.world === world) {
      this.volumes.open(world, { channels: ["extinction_per_m"], rate_hz: 8, bits: 8, compression: "deflate" });
      this.changed();
    }
  }

  stop() {
    this.running = false;
    this.world = null;
    this.volumes.close();
  }

  async learnScenery() {
    const { world } = this;
    if (world === null) {
      return;
    }
    this.lastSceneryMs = performance.now();
    try {
      /** @type {Scenery} */
      const scenery = await request("GET", `/v1/worlds/${encodeURIComponent(world)}/scenery`);
      if (this.world === world && JSON.stringify(scenery) !== JSON.stringify(this.scenery)) {
        this.scenery = scenery;
        this.changed();
      }
    } catch (error) {
      if (this.scenery === null) {
        this.handlers.trouble(error instanceof Error ? error.message : String(error));
      }
    }
  }

  /** @param {Camera} camera */
  setCamera(camera) {
    this.camera = camera;
    this.changed();
  }

  /** @param {Numbers} numbers */
  setNumbers(numbers) {
    const sun = sunDirection(numbers.sun_elevation_deg, numbers.sun_azimuth_deg);
    if (this.sun === null || sun.some((c, n) => c !== this.sun?.[n])) {
      this.sun = sun;
      this.changed();
    }
    // Effects can change while a world runs, and then what it tells the kernels does.
    if (this.running && performance.now() - this.lastSceneryMs > SCENERY_EVERY_MS) {
      void this.learnScenery();
    }
  }

  /** @param {VolumeField} field @param {{arrived_unix_ms: number, decode_ms: number}} timing */
  took(field, timing) {
    this.past.push(field);
    if (this.shownPast === null) {
      const { published_unix_s, encoded_unix_s } = field.header;
      this.newVolume = { published_unix_s, encoded_unix_s, ...timing };
      this.showField(field);
    }
  }

  /** @param {VolumeField} field */
  showField(field) {
    this.raymarcher.setCloud(cloudOf(field));
    this.tick = field.header.tick;
    this.ready = true;
    this.changed();
  }

  /**
   * Shows what was there before, or, with 0, what comes. Gives the field that is shown; null where nothing is kept.
   * @param {number} ago_s
   */
  lookBack(ago_s) {
    const field = this.past.at(ago_s);
    const before = this.shownPast;
    this.shownPast = ago_s > 0 ? field : null;
    if (field !== null && (this.shownPast !== before || before === null)) {
      this.showField(field);
    }
    return field;
  }

  /** Towards the sun that is shown: the past has its own. */
  shownSun() {
    return this.shownPast?.header.sun_direction ?? this.sun;
  }

  /** Something is to be drawn anew. */
  changed() {
    this.changedMs = performance.now();
    this.shownFull = false;
    this.schedule(true);
  }

  /** @param {boolean} dirty */
  schedule(dirty) {
    this.dirty ||= dirty;
    if (!this.drawing && this.running) {
      this.drawing = true;
      requestAnimationFrame(() => void this.step());
    }
  }

  /** The canvas's pixels, no more than are worth drawing. */
  fullSize() {
    const ratio = Math.min(2, devicePixelRatio || 1);
    const [width, height] = [innerWidth * ratio, innerHeight * ratio];
    const shrink = Math.min(1, Math.sqrt(PIXELS_MOST / (width * height)));
    return [Math.max(1, Math.round(width * shrink)), Math.max(1, Math.round(height * shrink))];
  }

  async step() {
    const [fullWidth, fullHeight] = this.fullSize();
    const resting = performance.now() - this.changedMs >= REST_MS;
    const quick = this.msPerPixel * fullWidth * fullHeight <= ALWAYS_FULL_MS;
    const { scenery, camera } = this;
    const sun = this.shownSun();
    if (this.running && this.ready && scenery !== null && camera !== null && sun !== null && (this.dirty || (resting && !this.shownFull))) {
      const full = resting || quick;
      const pixels = Math.max(PIXELS_LEAST, MOVING_MS / this.msPerPixel);
      const shrink = full ? 1 : Math.min(1, Math.sqrt(pixels / (fullWidth * fullHeight)));
      const width = Math.max(1, Math.round(fullWidth * shrink));
      const height = Math.max(1, Math.round(fullHeight * shrink));
      this.dirty = false;
      const volume = this.newVolume;
      this.newVolume = null;
      const began = performance.now();
      try {
        this.paint(this.raymarcher.draw(scenery, camera, sun, [width, height]), [width, height], [fullWidth, fullHeight]);
        await this.device.queue.onSubmittedWorkDone();
        const ms = performance.now() - began;
        // What a new cloud's shape takes does not depend on the pixels.
        if (volume === null) {
          this.msPerPixel += 0.3 * (Math.max(ms - 1, 0.1) / (width * height) - this.msPerPixel);
        }
        this.shownFull = width === fullWidth && height === fullHeight && !this.dirty;
        this.handlers.drawn({ ms, width, height, full: this.shownFull, volume });
      } catch (error) {
        this.stop();
        this.handlers.trouble(error instanceof Error ? error.message : String(error));
      }
    }
    this.drawing = false;
    // Without what it needs there is nothing to wait for here: what comes calls again.
    const able = this.ready && scenery !== null && camera !== null && sun !== null;
    if (this.running && able && (this.dirty || !this.shownFull)) {
      this.schedule(false);
    }
  }

  /**
   * What is seen now at full size, as a PNG, with the tick of the cloud in it; null where nothing is.
   * @returns {Promise<{png: Blob, tick: number | null} | null>}
   */
  async capture() {
    const { scenery, camera, tick } = this;
    const sun = this.shownSun();
    if (!this.ready || scenery === null || camera === null || sun === null) {
      return null;
    }
    const [width, height] = this.fullSize();
    const { picture, row_words } = this.raymarcher.draw(scenery, camera, sun, [width, height]);
    const bytes = row_words * height * 4;
    const copy = this.device.createBuffer({ size: bytes, usage: GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST });
    const encoder = this.device.createCommandEncoder();
    encoder.copyBufferToBuffer(picture, 0, copy, 0, bytes);
    this.device.queue.submit([encoder.finish()]);
    await copy.mapAsync(GPUMapMode.READ);
    const rgb8 = new Uint8Array(copy.getMappedRange());
    const image = new ImageData(width, height);
    for (let y = 0; y < height; y++) {
      let from = y * row_words * 4;
      for (let to = y * width * 4; to < (y + 1) * width * 4; to += 4) {
        image.data[to] = rgb8[from++];
        image.data[to + 1] = rgb8[from++];
        image.data[to + 2] = rgb8[from++];
        image.data[to + 3] = 255;
      }
    }
    copy.destroy();
    const canvas = new OffscreenCanvas(width, height);
    /** @type {OffscreenCanvasRenderingContext2D} */ (canvas.getContext("2d")).putImageData(image, 0, 0);
    return { png: await canvas.convertToBlob({ type: "image/png" }), tick };
  }

  /**
   * @param {{picture: GPUBuffer, row_words: number}} drawn
   * @param {[number, number]} size
   * @param {[number, number] | number[]} shown
   */
  paint({ picture, row_words }, [width, height], [shownWidth, shownHeight]) {
    if (this.canvas.width !== shownWidth || this.canvas.height !== shownHeight) {
      this.canvas.width = shownWidth;
      this.canvas.height = shownHeight;
    }
    this.device.queue.writeBuffer(this.sizes, 0, new Uint32Array([width, height, row_words, 0, shownWidth, shownHeight, 0, 0]));
    const group = this.device.createBindGroup({
      layout: this.present.getBindGroupLayout(0),
      entries: [
        { binding: 0, resource: { buffer: picture } },
        { binding: 1, resource: { buffer: this.sizes } },
      ],
    });
    const encoder = this.device.createCommandEncoder();
    const view = this.context.getCurrentTexture().createView();
    const pass = encoder.beginRenderPass({ colorAttachments: [{ view, loadOp: "clear", storeOp: "store" }] });
    pass.setPipeline(this.present);
    pass.setBindGroup(0, group);
    pass.draw(3);
    pass.end();
    this.device.queue.submit([encoder.finish()]);
  }
}
