// @ts-check
// The connection to the server: plain requests, and the stream of one world that comes back by itself.

/** @import { ApiError, ClientMessage, Frame, Hello, Numbers, SceneSummary, ServerMessage, Status, WorldSummary } from "./types.js" */

import { unixMs } from "./latency.js";

/** The stream protocol that this page speaks. */
export const PROTOCOL_VERSION = 1;

/** Bytes of a frame's header by its version. */
const HEADER_BYTES = [0, 48, 68];
/** The frame header that this page asks for. */
export const FRAME_HEADER_VERSION = 2;
const MIMES = ["", "image/jpeg", "image/png", "image/webp"];
const FIRST_RETRY_S = 1;
const LAST_RETRY_S = 20;
const REQUEST_LIMIT_MS = 15_000;
/** A stream that is silent for so long is checked with a request: a paused world is silent, and so is a dead cable. */
const SILENCE_MS = 8_000;

/** An error that the server explained. */
export class ServerError extends Error {
  /** @param {number} status @param {ApiError} error */
  constructor(status, error) {
    super(error.pointer ? `${error.message} (at ${error.pointer})` : error.message);
    this.status = status;
    this.code = error.code;
  }
}

/** @param {string} world */
export const pathOf = (world) => `/v1/worlds/${encodeURIComponent(world)}`;

/** @type {Map<Promise<Response>, string>} requests without an answer yet, with their paths */
const underWay = new Map();

/**
 * Waits until no request is under way whose path begins so.
 * @param {string} path
 */
export async function answered(path) {
  await Promise.allSettled([...underWay].filter(([, asked]) => asked.startsWith(path)).map(([answer]) => answer));
}

/**
 * Asks the server; throws a ServerError where it refuses.
 * @param {string} method
 * @param {string} path
 * @param {unknown} [body]
 * @returns {Promise<Response>} what it says, with its body still to be read
 */
export async function ask(method, path, body) {
  const answer = fetch(path, {
    method,
    headers: body === undefined ? {} : { "content-type": "application/json" },
    body: body === undefined ? undefined : JSON.stringify(body),
    signal: AbortSignal.timeout(REQUEST_LIMIT_MS),
    cache: "no-store",
  });
  underWay.set(answer, path);
  const response = await answer.finally(() => underWay.delete(answer));
  if (!response.ok) {
    const said = await response.json().catch(() => null);
    const known = typeof said?.code === "string" && typeof said.message === "string";
    throw new ServerError(
      response.status,
      known ? said : { code: "http_status", message: `the server answered ${response.status} to ${method} ${path}` },
    );
  }
  return response;
}

/**
 * A request for JSON; throws a ServerError where the server refused, a SyntaxError where it says no JSON.
 * @param {string} method
 * @param {string} path
 * @param {unknown} [body]
 * @returns {Promise<any>} the decoded body, or null where there is none
 */
export async function request(method, path, body) {
  const text = await (await ask(method, path, body)).text();
  return text === "" ? null : JSON.parse(text);
}

/** @returns {Promise<WorldSummary[]>} the worlds that run now */
export async function listWorlds() {
  const value = await request("GET", "/v1/worlds");
  return Array.isArray(value) ? value : [];
}

/** @returns {Promise<SceneSummary[]>} the presets that a world can be made of */
export async function listScenes() {
  const value = await request("GET", "/v1/scenes");
  return Array.isArray(value) ? value : [];
}

/**
 * Takes a binary message apart; the layout is FrameHeader's in the wire protocol.
 * @param {ArrayBuffer} buffer
 * @returns {Frame}
 */
export function decodeFrame(buffer) {
  const arrived_unix_ms = unixMs();
  if (buffer.byteLength < HEADER_BYTES[1]) {
    throw new RangeError(`a frame of ${buffer.byteLength} bytes is shorter than its header`);
  }
  const view = new DataView(buffer);
  // "WLKF" read as a little-endian number.
  if (view.getUint32(0, true) !== 0x464b4c57) {
    throw new RangeError("a binary message does not start as a frame does");
  }
  const version = view.getUint16(4, true);
  if (version !== 1 && version !== 2) {
    throw new RangeError(`frame header version ${version} is not known to this page`);
  }
  const headerBytes = HEADER_BYTES[version];
  const mime = MIMES[view.getUint16(6, true)];
  if (!mime) {
    throw new RangeError(`frame format ${view.getUint16(6, true)} is not known to this page`);
  }
  const imageBytes = view.getUint32(44, true);
  if (imageBytes !== buffer.byteLength - headerBytes) {
    throw new RangeError(`a frame of ${imageBytes} bytes came with ${buffer.byteLength - headerBytes}`);
  }
  return {
    mime,
    width: view.getUint32(8, true),
    height: view.getUint32(12, true),
    tick: Number(view.getBigUint64(16, true)),
    simulated_s: view.getFloat64(24, true),
    render_ms: view.getFloat32(32, true),
    encode_ms: view.getFloat32(36, true),
    sequence: view.getUint32(40, true),
    delivery:
      version === 1
        ? null
        : {
            sent_unix_ms: view.getFloat64(48, true),
            age_ms: view.getFloat32(56, true),
            wait_ms: view.getFloat32(60, true),
            still: view.getUint16(64, true) === 1,
          },
    arrived_unix_ms,
    image: new Uint8Array(buffer, headerBytes),
  };
}

/**
 * What a stream tells its owner.
 * @typedef {object} StreamHandlers
 * @property {(hello: Hello) => void} hello
 * @property {(numbers: Numbers) => void} tick
 * @property {(frame: Frame) => void} frame
 * @property {(message: string) => void} error
 * @property {(status: Status) => void} status
 */

/** The stream of one world. Lost, it tries again with growing, jittered pauses until it is back. */
export class SkyStream {
  /** @param {StreamHandlers} handlers */
  constructor(handlers) {
    this.handlers = handlers;
    /** @type {string | null} the world that is wanted; null takes the server's first */
    this.world = null;
    /** @type {WebSocket | null} */
    this.socket = null;
    this.failures = 0;
    this.lastMessageMs = 0;
    this.probing = false;
    /** @type {ReturnType<typeof setInterval> | undefined} */
    this.countdown = undefined;
    // Counts connections: what arrives late from an older one is ignored.
    this.generation = 0;
    setInterval(() => void this.probe(), 2_000);
    window.addEventListener("online", () => this.retryNow());
  }

  /**
   * Goes to a world, or to the server's first one, leaving the present one.
   * @param {string | null} world
   */
  open(world) {
    this.world = world;
    this.failures = 0;
    void this.connect();
  }

  /** Tries at once instead of at the end of the pause. */
  retryNow() {
    if (this.countdown !== undefined) {
      void this.connect();
    }
  }

  /**
   * Sends if the stream is live; a message that cannot be sent is dropped, since it would be stale later.
   * @param {ClientMessage} message
   * @returns {boolean} whether it was sent
   */
  send(message) {
    if (this.socket === null || this.socket.readyState !== WebSocket.OPEN) {
      return false;
    }
    this.socket.send(JSON.stringify(message));
    return true;
  }

  async connect() {
    this.generation += 1;
    const generation = this.generation;
    clearInterval(this.countdown);
    this.countdown = undefined;
    this.socket?.close();
    this.socket = null;
    this.handlers.status({ state: "connecting" });
    try {
      const worlds = await listWorlds();
      if (generation !== this.generation) {
        return;
      }
      const found = worlds.find((world) => world.id === this.world) ?? worlds[0];
      if (found === undefined) {
        throw new Error("the server runs no world");
      }
      this.world = found.id;
      this.attach(found.id, generation);
    } catch (error) {
      if (generation === this.generation) {
        this.lose(error instanceof ServerError ? error.message : "the server does not answer");
      }
    }
  }

  /**
   * @param {string} world
   * @param {number} generation
   */
  attach(world, generation) {
    const url = new URL(`${pathOf(world)}/stream`, location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(url);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.lastMessageMs = performance.now();
    socket.addEventListener("message", (event) => {
      if (generation === this.generation) {
        this.lastMessageMs = performance.now();
        this.receive(event.data);
      }
    });
    socket.addEventListener("close", (event) => {
      if (generation === this.generation) {
        this.lose(event.reason || "the stream ended");
      }
    });
  }

  /** @param {string | ArrayBuffer} data */
  receive(data) {
    try {
      if (data instanceof ArrayBuffer) {
        this.handlers.frame(decodeFrame(data));
        return;
      }
      /** @type {ServerMessage} */
      const message = JSON.parse(data);
      if (message.type === "hello") {
        if (message.protocol !== PROTOCOL_VERSION) {
          this.handlers.error(
            `The server speaks stream protocol ${message.protocol}, this page ${PROTOCOL_VERSION}: reload the page.`,
          );
        }
        this.failures = 0;
        this.handlers.status({ state: "live" });
        this.handlers.hello(message);
      } else if (message.type === "tick") {
        this.handlers.tick(message.numbers);
      } else if (message.type === "error") {
        this.handlers.error(new ServerError(0, message.error).message);
      }
    } catch (error) {
      this.handlers.error(`A message could not be read: ${error instanceof Error ? error.message : error}`);
    }
  }

  /** @param {string} why */
  lose(why) {
    this.generation += 1;
    this.socket?.close();
    this.socket = null;
    const ceiling = Math.min(LAST_RETRY_S, FIRST_RETRY_S * 2 ** this.failures);
    this.failures += 1;
    // Jitter, so that many pages do not come back in the same instant.
    const wait_s = ceiling * (0.75 + 0.5 * Math.random());
    const dueMs = performance.now() + 1000 * wait_s;
    clearInterval(this.countdown);
    const step = () => {
      const left_s = (dueMs - performance.now()) / 1000;
      if (left_s <= 0) {
        void this.connect();
      } else {
        this.handlers.status({ state: "lost", retry_s: Math.ceil(left_s), why });
      }
    };
    this.countdown = setInterval(step, 250);
    step();
  }

  /** Asks for a sign of life where the stream has been silent. */
  async probe() {
    if (this.socket === null || this.probing || performance.now() - this.lastMessageMs < SILENCE_MS) {
      return;
    }
    this.probing = true;
    const generation = this.generation;
    try {
      const answer = await fetch("/healthz", { signal: AbortSignal.timeout(5_000), cache: "no-store" });
      await answer.text();
      this.lastMessageMs = performance.now();
    } catch {
      if (generation === this.generation) {
        this.lose("the server does not answer");
      }
    } finally {
      this.probing = false;
    }
  }
}
