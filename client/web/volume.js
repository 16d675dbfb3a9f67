// @ts-check
// Volumes of a world: the messages of `/v1/worlds/{id}/volume` taken apart as proto/PROTOCOL.md says, and the connection that brings them.

/** @import { ApiError, VolumeField, VolumeHeader, VolumeSubscription } from "./types.js" */

import { unixMs } from "./latency.js";
import { Clock } from "./playout.js";
import { ask, pathOf } from "./stream.js";

export const VOLUME_VERSION = 1;
const HEADER_BYTES = 152;
const ENTRY_BYTES = 20;
const SIDE_MAX = 1 << 16;
/** Values that a volume may have, of all its channels: what a forged header cannot exceed. */
const VALUES_MAX = 1 << 26;
/** What a brick's mode says; 2 are codes as they are. */
const [SAME, UNIFORM, DIFFERENCED, CHANGES] = [0, 1, 3, 4];
const CHANNELS_MAX = 32;
const FIRST_RETRY_MS = 1_000;
const LAST_RETRY_MS = 20_000;
/** The server's clock is asked for so often at first, so many times, and then so often. */
const [PING_FIRST_MS, PINGS_FIRST, PING_THEN_MS] = [50, 5, 1_000];

/** @param {string} why */
const bad = (why) => new RangeError(`a volume cannot be read: ${why}`);

/**
 * Reads a message's header and table of channels, trusting nothing.
 * @param {ArrayBuffer} message
 * @returns {VolumeHeader}
 */
export function decodeHeader(message) {
  const view = new DataView(message);
  if (message.byteLength < HEADER_BYTES) {
    throw bad(`${message.byteLength} bytes are fewer than a header's`);
  }
  // "WLKV" read as a little-endian number.
  if (view.getUint32(0, true) !== 0x564b4c57) {
    throw bad("it does not start as a volume does");
  }
  const version = view.getUint16(4, true);
  if (version !== VOLUME_VERSION) {
    throw bad(`version ${version} is not known to this page`);
  }
  const kind = view.getUint8(6);
  const compression = view.getUint8(7);
  if ((kind !== 1 && kind !== 2) || compression > 1) {
    throw bad(`kind ${kind} or compression ${compression} is not known to this page`);
  }
  /** @param {number} at @param {(at: number) => number} read @param {number} bytes @returns {[number, number, number]} */
  const three = (at, read, bytes) => [read(at), read(at + bytes), read(at + 2 * bytes)];
  const u32 = (/** @type {number} */ at) => view.getUint32(at, true);
  const f32 = (/** @type {number} */ at) => view.getFloat32(at, true);
  const f64 = (/** @type {number} */ at) => view.getFloat64(at, true);
  const mip = view.getUint8(20);
  const region = { from: three(92, u32, 4), cells: three(104, u32, 4) };
  const header = {
    keyframe: kind === 1,
    compressed: compression === 1,
    view: u32(8),
    sequence: u32(12),
    base: u32(16),
    mip,
    tick: Number(view.getBigUint64(24, true)),
    simulated_s: f64(32),
    published_unix_s: f64(40),
    encoded_unix_s: f64(48),
    cell_size_m: three(56, f64, 8),
    world_cells: three(80, u32, 4),
    region,
    cells: /** @type {[number, number, number]} */ (region.cells.map((n) => Math.ceil(n / 2 ** mip))),
    brick: three(116, (at) => view.getUint8(at), 1),
    sun_direction: three(120, f32, 4),
    air_displacement_m: /** @type {[number, number]} */ ([f32(132), f32(136)]),
    body_bytes: u32(140),
    raw_bytes: u32(144),
    /** @type {VolumeHeader["channels"]} */
    channels: [],
    body_at: 0,
  };
  const { simulated_s, published_unix_s, encoded_unix_s, cell_size_m } = header;
  const numbers = [...cell_size_m, ...header.sun_direction, ...header.air_displacement_m, simulated_s, published_unix_s, encoded_unix_s];
  if (!numbers.every(Number.isFinite) || !cell_size_m.every((size) => size > 0)) {
    throw bad("a number in its header is none");
  }
  if (view.getUint8(119) !== 0 || u32(148) !== 0) {
    throw bad("bytes that must be 0 are not");
  }
  if (header.base > header.sequence || (header.base === header.sequence) !== header.keyframe) {
    throw bad(`message ${header.sequence} builds on ${header.base}`);
  }
  const edge = 2 ** mip;
  const fits = header.world_cells.every((n, a) => {
    const [from, end] = [region.from[a], region.from[a] + region.cells[a]];
    return n >= 1 && n <= SIDE_MAX && end > from && end <= n && from % edge === 0 && (end % edge === 0 || end === n);
  });
  if (mip > 6 || !fits || !header.brick.every((n) => n >= 1 && n <= 64)) {
    throw bad("its region does not lie within its world");
  }
  let at = HEADER_BYTES;
  const count = view.getUint8(21);
  for (let n = 0; n < count; n++) {
    if (at + ENTRY_BYTES > message.byteLength || at + ENTRY_BYTES + view.getUint8(at) > message.byteLength) {
      throw bad("its table of channels is cut off");
    }
    const [length, bits, curve, zero] = [0, 1, 2, 3].map((i) => view.getUint8(at + i));
    const [offset, scale] = [f64(at + 4), f64(at + 12)];
    // Written so that what is no number is refused too.
    const sound = scale >= 0 && scale <= 1e14 && Math.abs(offset) <= 1e30 && (curve === 0 || offset === 0);
    if ((bits !== 8 && bits !== 16) || curve > 1 || zero !== 0 || !sound) {
      throw bad("a channel's numbers make no sense");
    }
    const name = new TextDecoder().decode(new Uint8Array(message, at + ENTRY_BYTES, length));
    if (!/^[a-z0-9_]{1,64}$/.test(name) || header.channels.some((other) => other.name === name)) {
      throw bad("a channel's name is none, or stands there twice");
    }
    header.channels.push({ name, bits, square: curve === 1, offset, scale });
    at += ENTRY_BYTES + length;
  }
  const cells = header.cells[0] * header.cells[1] * header.cells[2];
  const bricks = header.brick.reduce((product, edge, a) => product * Math.ceil(header.cells[a] / edge), 1);
  const raw_max = header.channels.reduce((sum, channel) => sum + bricks + (cells * channel.bits) / 8, 0);
  if (count === 0 || count > CHANNELS_MAX || cells * count > VALUES_MAX || header.raw_bytes > raw_max) {
    throw bad(`${count} channels of ${cells} cells in ${header.raw_bytes} bytes`);
  }
  if (view.getUint16(22, true) !== at || message.byteLength - at !== header.body_bytes) {
    throw bad("its lengths do not agree");
  }
  header.body_at = at;
  return header;
}

/**
 * Unpacks a body, never beyond the bytes that it says.
 * @param {VolumeHeader} header
 * @param {ArrayBuffer} message
 */
async function unpack(header, message) {
  const packed = new Uint8Array(message, header.body_at);
  if (!header.compressed) {
    if (packed.length !== header.raw_bytes) {
      throw bad(`${packed.length} bytes instead of ${header.raw_bytes}`);
    }
    return packed;
  }
  const raw = new Uint8Array(header.raw_bytes);
  const reader = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate")).getReader();
  let filled = 0;
  for (;;) {
    const { done, value } = await reader.read();
    if (done) {
      break;
    }
    if (filled + value.length > raw.length) {
      await reader.cancel();
      throw bad(`it unpacks to more than ${raw.length} bytes`);
    }
    raw.set(value, filled);
    filled += value.length;
  }
  if (filled !== raw.length) {
    throw bad(`it unpacks to ${filled} bytes instead of ${raw.length}`);
  }
  return raw;
}

/**
 * Reads one channel's bricks over `codes`; returns where the next channel begins.
 * @param {VolumeHeader} header
 * @param {number} bits
 * @param {Uint8Array} raw
 * @param {number} start
 * @param {Uint8Array | Uint16Array} codes
 */
function readBricks(header, bits, raw, start, codes) {
  const [nx, ny, nz] = header.cells;
  const bricks = header.cells.map((n, a) => Math.ceil(n / header.brick[a]));
  const count = bricks[0] * bricks[1] * bricks[2];
  if (start + count > raw.length) {
    throw bad("its body ends within a channel's bricks");
  }
  const mask = bits === 8 ? 0xff : 0xffff;
  let at = start + count;
  const brick = new Uint16Array(header.brick[0] * header.brick[1] * header.brick[2]);
  for (let index = 0; index < count; index++) {
    const mode = raw[start + index];
    if (mode === SAME) {
      continue;
    }
    const place = [index % bricks[0], Math.floor(index / bricks[0]) % bricks[1], Math.floor(index / (bricks[0] * bricks[1]))];
    const [fx, fy, fz] = place.map((p, a) => p * header.brick[a]);
    const [sx, sy, sz] = [Math.min(header.brick[0], nx - fx), Math.min(header.brick[1], ny - fy), Math.min(header.brick[2], nz - fz)];
    const cells = sx * sy * sz;
    const sent = mode === UNIFORM ? 1 : cells;
    const bytes = (sent * bits) / 8;
    if (mode > (header.keyframe ? DIFFERENCED : CHANGES) || at + bytes > raw.length) {
      throw bad(`brick ${index} is cut off or of an unknown mode`);
    }
    for (let n = 0; n < sent; n++) {
      brick[n] = bits === 8 ? raw[at + n] : (raw[at + n] << 8) | raw[at + sent + n];
    }
    at += bytes;
    if (mode === UNIFORM) {
      brick.fill(brick[0], 0, cells);
    } else if (mode === DIFFERENCED) {
      // Differences along x, y and z are added up again, z first; 16 bits run over as they should.
      const level = sx * sy;
      for (let n = level; n < cells; n++) {
        brick[n] += brick[n - level];
      }
      for (let z = 0; z < sz; z++) {
        for (let n = z * level + sx; n < (z + 1) * level; n++) {
          brick[n] += brick[n - sx];
        }
      }
      for (let row = 0; row < cells; row += sx) {
        for (let n = row + 1; n < row + sx; n++) {
          brick[n] += brick[n - 1];
        }
      }
    }
    let n = 0;
    for (let z = fz; z < fz + sz; z++) {
      for (let y = fy; y < fy + sy; y++) {
        let to = (z * ny + y) * nx + fx;
        for (let x = 0; x < sx; x++) {
          codes[to] = ((mode === CHANGES ? codes[to] : 0) + brick[n++]) & mask;
          to += 1;
        }
      }
    }
  }
  return at;
}

/** Reads a view's messages: whatever is lost or out of order, a field is right or not there. */
export class VolumeReceiver {
  constructor() {
    /** @type {VolumeField | null} */
    this.keyframe = null;
    /** @type {VolumeField | null} */
    this.newest = null;
    /** @type {number | null} the view that is expected; null takes any */
    this.view = null;
  }

  /** @param {number} view from now on messages of this view only */
  expect(view) {
    this.view = view;
    this.keyframe = this.keyframe?.header.view === view ? this.keyframe : null;
    this.newest = this.newest?.header.view === view ? this.newest : null;
  }

  /**
   * Takes a message: a field, or what became of it.
   * @param {ArrayBuffer} message
   * @returns {Promise<VolumeField | "stale" | "needs keyframe">}
   */
  async take(message) {
    const header = decodeHeader(message);
    if ((this.view !== null && this.view !== header.view) || (this.newest !== null && this.newest.header.view === header.view && this.newest.header.sequence >= header.sequence)) {
      return "stale";
    }
    const base = this.keyframe;
    if (!header.keyframe && (base === null || base.header.view !== header.view || base.header.sequence !== header.base)) {
      return "needs keyframe";
    }
    const raw = await unpack(header, message);
    const cells = header.cells[0] * header.cells[1] * header.cells[2];
    let at = 0;
    const codes = header.channels.map((channel, n) => {
      const own = channel.bits === 8 ? new Uint8Array(cells) : new Uint16Array(cells);
      if (!header.keyframe) {
        const before = base?.codes[n];
        const known = base?.header.channels[n];
        const same = known?.name === channel.name && known.bits === channel.bits && known.square === channel.square
          && known.offset === channel.offset && known.scale === channel.scale;
        if (before === undefined || before.length !== cells || !same) {
          throw bad("a delta is not of its keyframe's shape");
        }
        own.set(before);
      }
      at = readBricks(header, channel.bits, raw, at, own);
      return own;
    });
    if (at !== raw.length) {
      throw bad(`${raw.length - at} bytes are left over`);
    }
    const field = { header, codes };
    this.keyframe = header.keyframe ? field : this.keyframe;
    this.newest = field;
    return field;
  }
}

/**
 * A channel's values, `[z][y][x]`; null where the field hasn't got it.
 * @param {VolumeField} field
 * @param {string} name
 */
export function channelValues(field, name) {
  const n = field.header.channels.findIndex((channel) => channel.name === name);
  if (n < 0) {
    return null;
  }
  const { bits, square, offset, scale } = field.header.channels[n];
  const table = new Float32Array(2 ** bits);
  for (let code = 0; code < table.length; code++) {
    const step = code * scale;
    table[code] = offset + (square ? step * step : step);
  }
  const codes = field.codes[n];
  const values = new Float32Array(codes.length);
  for (let i = 0; i < codes.length; i++) {
    values[i] = table[codes[i]];
  }
  return values;
}

/**
 * One volume over plain HTTP.
 * @param {string} path
 * @returns {Promise<VolumeField>}
 */
export async function fetchField(path) {
  const field = await new VolumeReceiver().take(await (await ask("GET", path)).arrayBuffer());
  if (typeof field === "string") {
    throw new Error("the server sent no keyframe");
  }
  return field;
}

/**
 * @typedef {object} VolumeHandlers
 * @property {(field: VolumeField, timing: {arrived_unix_ms: number, decode_ms: number}) => void} field
 * @property {() => void} absent the world has none of the channels that are wanted
 * @property {(message: string) => void} error
 */

/** The volumes of one world; lost, the connection is made again. */
export class VolumeStream {
  /** @param {VolumeHandlers} handlers */
  constructor(handlers) {
    this.handlers = handlers;
    /** @type {WebSocket | null} */
    this.socket = null;
    /** @type {VolumeSubscription | null} */
    this.subscription = null;
    this.receiver = new VolumeReceiver();
    this.clock = new Clock();
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.nextPing = undefined;
    /** @type {{message: ArrayBuffer, arrived_unix_ms: number}[]} */
    this.waiting = [];
    this.reading = false;
    this.failures = 0;
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.retry = undefined;
    /** @type {string | null} */
    this.world = null;
  }

  /** @param {string} world @param {VolumeSubscription} subscription */
  open(world, subscription) {
    if (this.world === world && this.socket !== null) {
      this.subscription = subscription;
      this.send({ type: "subscribe", ...subscription });
      return;
    }
    this.close();
    this.world = world;
    this.subscription = subscription;
    this.connect();
  }

  connect() {
    if (this.world === null) {
      return;
    }
    const url = new URL(`${pathOf(this.world)}/volume`, location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(url);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.receiver = new VolumeReceiver();
    this.clock = new Clock();
    this.waiting = [];
    socket.addEventListener("open", () => this.ping(socket, 0));
    socket.addEventListener("message", (event) => {
      if (this.socket !== socket) {
        return;
      }
      if (event.data instanceof ArrayBuffer) {
        this.waiting.push({ message: event.data, arrived_unix_ms: unixMs() });
        void this.readWaiting();
      } else {
        this.heard(JSON.parse(event.data));
      }
    });
    socket.addEventListener("close", () => {
      if (this.socket === socket) {
        this.socket = null;
        const wait = Math.min(LAST_RETRY_MS, FIRST_RETRY_MS * 2 ** this.failures) * (0.75 + 0.5 * Math.random());
        this.failures += 1;
        this.retry = setTimeout(() => this.connect(), wait);
      }
    });
  }

  /** No more volumes. */
  close() {
    clearTimeout(this.retry);
    clearTimeout(this.nextPing);
    const socket = this.socket;
    this.socket = null;
    this.world = null;
    this.waiting = [];
    socket?.close();
  }

  /** Asks for the server's clock, again and again while the connection stands. @param {WebSocket} socket @param {number} asked */
  ping(socket, asked) {
    if (this.socket === socket) {
      this.send({ type: "ping", client_s: unixMs() / 1000 });
      clearTimeout(this.nextPing);
      this.nextPing = setTimeout(() => this.ping(socket, asked + 1), asked < PINGS_FIRST ? PING_FIRST_MS : PING_THEN_MS);
    }
  }

  /** The server's clock now, Unix seconds; ours until the server's is known. */
  get server_unix_s() {
    const now_s = unixMs() / 1000;
    return this.clock.server_unix_s(now_s) ?? now_s;
  }

  /** @param {object} message */
  send(message) {
    if (this.socket?.readyState === WebSocket.OPEN) {
      this.socket.send(JSON.stringify(message));
    }
  }

  /** @param {{type: string, view?: number, channels?: string[], client_s?: number, server_unix_s?: number, error?: ApiError}} message */
  heard(message) {
    if (message.type === "hello") {
      this.failures = 0;
      if (this.subscription?.channels.some((name) => message.channels?.includes(name))) {
        this.send({ type: "subscribe", ...this.subscription });
      } else {
        this.handlers.absent();
      }
    } else if (message.type === "subscribed" && message.view !== undefined) {
      this.receiver.expect(message.view);
    } else if (message.type === "pong" && message.client_s !== undefined && message.server_unix_s !== undefined) {
      this.clock.answered(message.client_s, unixMs() / 1000, message.server_unix_s);
    } else if (message.type === "error" && message.error !== undefined) {
      this.handlers.error(message.error.message);
    }
  }

  async readWaiting() {
    if (this.reading) {
      return;
    }
    this.reading = true;
    while (this.waiting.length > 0) {
      const { message, arrived_unix_ms } = this.waiting.splice(0, 1)[0];
      const { receiver } = this;
      try {
        // A delta builds on a keyframe alone: one that a newer message has overtaken need not be read.
        if (this.waiting.length > 0 && !decodeHeader(message).keyframe) {
          continue;
        }
        const began = performance.now();
        const field = await receiver.take(message);
        if (receiver !== this.receiver) {
          continue; // of a connection that is gone
        }
        if (field === "needs keyframe") {
          this.send({ type: "resync" });
        } else if (field !== "stale") {
          this.handlers.field(field, { arrived_unix_ms, decode_ms: performance.now() - began });
        }
      } catch (error) {
        this.handlers.error(error instanceof Error ? error.message : String(error));
      }
    }
    this.reading = false;
  }
}
