// @ts-check
// The sky drawn on this computer: volumes from the server, the server's own kernels, a camera of its own, at the display's rate.

/** @import { Camera, Cloud, Lights, Numbers, Scenery, VolumeField } from "./types.js" */
/** @import { Shown } from "./playout.js" */

import { Kernels, loadShaders } from "./kernels.js";
import { Playout } from "./playout.js";
import { Raymarcher } from "./raymarch.js";
import { earlier, sunDirection } from "./scenery.js";
import { unixMs } from "./latency.js";
import { ask, pathOf, request } from "./stream.js";
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
/** What a world tells the kernels is asked for again so long after it could not be had, ms: nothing is drawn without. */
const SCENERY_RETRY_MS = 2_000;
/** Volumes a second that are asked for: what lies between two of them is mixed. */
const VOLUMES_HZ = 4;
/** Between two volumes the cloud changes in so many steps at most. */
const STEPS_BETWEEN = 30;
/** Of the GPU's time new clouds take at most one part in so many. */
const CLOUD_SHARE = 2;

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
 * What lies between two fields of one shape, cell by cell; the later one's share is `weight`.
 * @param {Cloud} a
 * @param {Cloud} b
 * @param {number} weight
 * @returns {Cloud}
 */
export function mixed(a, b, weight) {
  const extinction_per_m = new Float32Array(a.extinction_per_m.length);
  for (let n = 0; n < extinction_per_m.length; n++) {
    extinction_per_m[n] = (1 - weight) * a.extinction_per_m[n] + weight * b.extinction_per_m[n];
  }
  /** @param {0 | 1} axis */
  const moved = (axis) => (1 - weight) * a.air_displacement_m[axis] + weight * b.air_displacement_m[axis];
  return { ...a, extinction_per_m, air_displacement_m: [moved(0), moved(1)] };
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
 * @property {VolumeTiming | null} volume of the first picture of a volume
 */

/**
 * When a volume was published, coded and received, and how long it was held back.
 * @typedef {object} VolumeTiming
 * @property {number} published_unix_s
 * @property {number} encoded_unix_s
 * @property {number} arrived_unix_ms
 * @property {number} decode_ms
 * @property {number} held_ms
 */

/**
 * @typedef {object} LocalHandlers
 * @property {(drawn: Drawn) => void} drawn
 * @property {(field: VolumeField) => void} field that has come
 * @property {(why: string) => void} trouble
 */

/** Draws one world's sky into a canvas. */
export class LocalSky {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {{device: GPUDevice, name: string}} gpu
   * @param {Kernels} kernels
   * @param {LocalHandlers} handlers
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
    /** @type {string | null} why it could not be had, the last time */
    this.failed = null;
    /** @type {Camera | null} */
    this.camera = null;
    /** @type {Lights | null} */
    this.lights = null;
    /** Simulated seconds that the lights are of. */
    this.lights_s = 0;
    /** @type {string | null} the stars that are there */
    this.starsAre = null;
    /** @type {string | null} */
    this.world = null;
    /** Whether the cloud, or that there is none, is known: a clear sky is not to be shown for one that has not come. */
    this.ready = false;
    this.playout = new Playout();
    /** @type {WeakMap<VolumeField, {arrived_unix_ms: number, decode_ms: number}>} of fields whose way has not been told yet */
    this.timings = new WeakMap();
    /** @type {{field: VolumeField, cloud: Cloud | null}[]} the last ones that were decoded: two are mixed again and again */
    this.clouds = [];
    /** @type {Shown | null} what the cloud was made of */
    this.shown = null;
    /** @type {VolumeField | null} shown instead of what comes */
    this.shownPast = null;
    this.cloudMs = 0;
    this.lastCloudMs = -Infinity;
    /** @type {string | null} the tick of the cloud, or the two that it lies between: `11-to-12` */
    this.tick = null;
    /** @type {VolumeTiming | null} */
    this.newVolume = null;
    this.newCloud = false;
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
   * @param {LocalHandlers} handlers
   */
  static async make(canvas, gpu, handlers) {
    return new LocalSky(canvas, gpu, await Kernels.compile(gpu.device, await loadShaders()), handlers);
  }

  /** @param {string} world begins, or goes on with another world */
  async start(world) {
    this.running = true;
    if (this.world !== world) {
      this.volumes.close();
      this.world = world;
      this.scenery = null;
      this.failed = null;
      this.tick = null;
      this.ready = false;
      this.playout = new Playout();
      this.shown = null;
      this.shownPast = null;
      this.raymarcher.setCloud(null);
    }
    await this.learnScenery();
    if (this.running && this.world === world) {
      this.volumes.open(world, { channels: ["extinction_per_m"], rate_hz: VOLUMES_HZ, bits: 8, compression: "deflate" });
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
      const scenery = await request("GET", `${pathOf(world)}/scenery`);
      if (this.world === world && JSON.stringify(scenery) !== JSON.stringify(this.scenery)) {
        if (scenery.server_draws) {
          this.stop();
          this.handlers.trouble(scenery.server_draws);
          return;
        }
        await this.learnStars(world, scenery);
        await this.raymarcher.prepare(scenery);
        if (this.world === world) {
          this.scenery = scenery;
          this.changed();
        }
      }
    } catch (error) {
      if (this.scenery === null) {
        this.failed = error instanceof Error ? error.message : String(error);
        this.handlers.trouble(this.failed);
        // The world may stand, so that nothing else asks again.
        setTimeout(() => {
          if (this.running && this.world === world && this.scenery === null) {
            void this.learnScenery();
          }
        }, SCENERY_RETRY_MS);
      }
    }
  }

  /** @param {string} world @param {Scenery} scenery */
  async learnStars(world, { stars }) {
    const wanted = stars ? `${stars.faintest_magnitude} ${stars.years_since_2000}` : null;
    if (wanted !== null && wanted !== this.starsAre) {
      const answer = await ask("GET", `${pathOf(world)}/stars.bin`);
      this.raymarcher.setStars(await answer.arrayBuffer());
      this.starsAre = wanted;
    }
  }

  /** @param {Camera} camera */
  setCamera(camera) {
    this.camera = camera;
    this.changed();
  }

  /** @param {Numbers} numbers */
  setNumbers(numbers) {
    const { moon_elevation_deg, moon_azimuth_deg, moon_distance_m } = numbers;
    /** @type {Lights} */
    const lights = {
      sun: sunDirection(numbers.sun_elevation_deg, numbers.sun_azimuth_deg),
      moon:
        moon_elevation_deg == null || moon_azimuth_deg == null || moon_distance_m == null
          ? null
          : { direction: sunDirection(moon_elevation_deg, moon_azimuth_deg), distance_m: moon_distance_m },
      sidereal_deg: numbers.sidereal_deg ?? null,
    };
    if (JSON.stringify(lights) !== JSON.stringify(this.lights)) {
      this.lights = lights;
      this.lights_s = numbers.simulated_s;
      this.changed();
    }
    // Effects can change while a world runs, and then what it tells the kernels does.
    if (this.running && performance.now() - this.lastSceneryMs > SCENERY_EVERY_MS) {
      void this.learnScenery();
    }
  }

  /** @param {VolumeField} field @param {{arrived_unix_ms: number, decode_ms: number}} timing */
  took(field, timing) {
    this.handlers.field(field);
    this.timings.set(field, timing);
    this.playout.push(field, this.whenArrived_unix_s(timing.arrived_unix_ms));
    this.schedule(false);
  }

  /** What the server's clock said when ours said so: when a message came, not now that it has been read. @param {number} arrived_unix_ms */
  whenArrived_unix_s(arrived_unix_ms) {
    return this.volumes.server_unix_s - (unixMs() - arrived_unix_ms) / 1000;
  }

  /** @param {VolumeField} field */
  cloud(field) {
    const known = this.clouds.find((one) => one.field === field) ?? { field, cloud: cloudOf(field) };
    this.clouds = [known, ...this.clouds.filter((one) => one !== known)].slice(0, 2);
    return known.cloud;
  }

  /** Makes the cloud what it is to be now: of the moment that is looked back at, or between the two volumes around what is played. */
  play() {
    if (this.shownPast !== null) {
      return;
    }
    const shown = this.playout.at(this.volumes.server_unix_s);
    const last = this.shown;
    if (shown === null) {
      return;
    }
    const { before, after, weight } = shown;
    // A volume that is there whole is always shown, and the first steps towards the next come in their time.
    const another = last === null || last.before !== before || (last.after === null) !== (after === null);
    const moved = last === null || weight - last.weight >= 1 / STEPS_BETWEEN;
    const affordable = performance.now() - this.lastCloudMs >= CLOUD_SHARE * this.cloudMs;
    if (!another && !(moved && affordable)) {
      return;
    }
    const timing = this.timings.get(before);
    if (timing !== undefined) {
      this.timings.delete(before);
      const { published_unix_s, encoded_unix_s } = before.header;
      const way_s = this.whenArrived_unix_s(timing.arrived_unix_ms) - published_unix_s;
      const held_ms = Math.max(0, 1000 * (this.playout.delay_s - way_s) - timing.decode_ms);
      this.newVolume = { published_unix_s, encoded_unix_s, ...timing, held_ms };
    }
    const [a, b] = [this.cloud(before), after === null ? null : this.cloud(after)];
    this.shown = shown;
    if (a !== null && b !== null && after !== null && weight > 0) {
      this.setCloud(mixed(a, b, weight), `${before.header.tick}-to-${after.header.tick}`);
    } else {
      this.setCloud(a, `${before.header.tick}`);
    }
  }

  /** @param {Cloud | null} cloud @param {string} tick */
  setCloud(cloud, tick) {
    this.raymarcher.setCloud(cloud);
    this.lastCloudMs = performance.now();
    this.newCloud = true;
    this.tick = tick;
    this.ready = true;
    this.dirty = true;
    this.changedMs = performance.now();
    this.shownFull = false;
  }

  /**
   * Shows what was there before, or, with null, what comes.
   * @param {VolumeField | null} field
   */
  showPast(field) {
    if (field === this.shownPast) {
      return;
    }
    this.shownPast = field;
    this.shown = null;
    if (field !== null) {
      this.setCloud(this.cloud(field), `${field.header.tick}`);
    }
    this.schedule(true);
  }

  /** What stands in the sky that is shown: the past has its own sun, and moon and stars as far back as they have turned since. */
  shownLights() {
    const { lights, shownPast } = this;
    if (lights === null || shownPast === null) {
      return lights;
    }
    const { simulated_s, sun_direction } = shownPast.header;
    return { ...earlier(lights, this.lights_s - simulated_s, this.scenery?.stars?.latitude_deg ?? null), sun: sun_direction };
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
    this.play();
    const [fullWidth, fullHeight] = this.fullSize();
    const resting = performance.now() - this.changedMs >= REST_MS;
    const quick = this.msPerPixel * fullWidth * fullHeight <= ALWAYS_FULL_MS;
    const { scenery, camera } = this;
    const lights = this.shownLights();
    if (this.running && this.ready && scenery !== null && camera !== null && lights !== null && (this.dirty || (resting && !this.shownFull))) {
      const full = resting || quick;
      const pixels = Math.max(PIXELS_LEAST, MOVING_MS / this.msPerPixel);
      const shrink = full ? 1 : Math.min(1, Math.sqrt(pixels / (fullWidth * fullHeight)));
      const width = Math.max(1, Math.round(fullWidth * shrink));
      const height = Math.max(1, Math.round(fullHeight * shrink));
      this.dirty = false;
      const { newVolume: volume, newCloud } = this;
      this.newVolume = null;
      this.newCloud = false;
      const began = performance.now();
      try {
        this.paint(this.raymarcher.draw(scenery, camera, lights, [width, height]), [width, height], [fullWidth, fullHeight]);
        await this.device.queue.onSubmittedWorkDone();
        const ms = performance.now() - began;
        // What a new cloud's shape and light take does not depend on the pixels.
        if (newCloud) {
          this.cloudMs += 0.3 * (Math.max(0, ms - this.msPerPixel * width * height) - this.cloudMs);
        } else {
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
    // Without what it needs there is nothing to wait for here: what comes calls again. What came while this picture was made found it under way, so it is what holds now that counts.
    const able = (this.ready || this.playout.fields.length > 0) && this.scenery !== null && this.camera !== null && this.shownLights() !== null;
    const plays = this.shownPast === null && this.playout.moves;
    if (this.running && able && (this.dirty || plays || !this.shownFull)) {
      this.schedule(false);
    }
  }

  /** Why there is no picture; null where there is one. */
  get lacks() {
    const { scenery, camera, ready, volumes, failed } = this;
    if (scenery === null) {
      return `what the world tells its kernels is not known${failed === null ? "" : ` (${failed})`}`;
    }
    if (camera === null || this.shownLights() === null) {
      return "the world has said nothing of itself";
    }
    const connection = volumes.socket === null ? "no connection" : `connection ${["being made", "open", "closing", "closed"][volumes.socket.readyState]}`;
    return ready ? null : `no volume has come (${connection}, ${this.playout.fields.length} waiting${this.drawing ? ", a picture under way" : ""})`;
  }

  /**
   * What is seen now at full size, as a PNG, with the tick of the cloud in it, or the two that it lies between (`11-to-12`); null where nothing is.
   * @returns {Promise<{png: Blob, tick: string | null} | null>}
   */
  async capture() {
    const { scenery, camera, tick } = this;
    const lights = this.shownLights();
    if (this.lacks !== null || scenery === null || camera === null || lights === null) {
      return null;
    }
    const [width, height] = this.fullSize();
    const { picture, row_words } = this.raymarcher.draw(scenery, camera, lights, [width, height]);
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
