// @ts-check
// How long it takes from the simulation to the eye, part by part.

/** @import { Frame, Numbers } from "./types.js" */
/** @import { Drawn } from "./local.js" */

import { addNumber, readable } from "./panel.js";

const PROBES = 5;
const PROBE_LIMIT_MS = 5_000;

/** This computer's clock, milliseconds since 1970 with fractions. */
export const unixMs = () => performance.timeOrigin + performance.now();

/** What the server's clock says, from a few round trips: the quickest is the most exact. */
export class ServerClock {
  constructor() {
    /** @type {number | null} the server's clock less ours, ms */
    this.offset_ms = null;
    /** Half the quickest round trip: the offset is no further off, ms. */
    this.error_ms = Infinity;
  }

  async measure() {
    let best_ms = Infinity;
    for (let probe = 0; probe < PROBES; probe++) {
      try {
        const asked = unixMs();
        const answer = await fetch("/healthz", { signal: AbortSignal.timeout(PROBE_LIMIT_MS), cache: "no-store" });
        const heard = unixMs();
        const health = await answer.json();
        if (typeof health.unix_ms === "number" && heard - asked < best_ms) {
          best_ms = heard - asked;
          this.offset_ms = health.unix_ms - 0.5 * (asked + heard);
          this.error_ms = 0.5 * best_ms;
        }
      } catch {
        // Without an answer the clock stays as it was known.
      }
    }
  }
}

/** @typedef {"tick" | "wait" | "render" | "encode" | "send" | "decode" | "held" | "whole"} Part */

/** @type {[Part, string, string][]} */
const PARTS = [
  ["tick", "Tick", "Time to compute the tick that is shown"],
  ["wait", "Wait", "From when the picture was asked for, or its tick was there, to its turn; of a volume, until it was packed"],
  ["render", "Render", "Time to draw the picture, on the server or here"],
  ["encode", "Encode", "Time to code the server’s picture as JPEG"],
  ["send", "Send", "On the way, by both clocks; their difference is measured with a few requests"],
  ["decode", "Decode", "Time to decode and draw it here"],
  ["held", "Held back", "A volume waits until the next one is there too, so that the sky moves smoothly between the two"],
  ["whole", "In all", "From the tick's beginning to the eye"],
];

/** The read-out. */
export class LatencyBoard {
  /** @param {HTMLElement} parent @param {ServerClock} clock */
  constructor(parent, clock) {
    this.clock = clock;
    /** @type {Map<Part, HTMLElement>} */
    this.values = new Map();
    for (const [part, name, hint] of PARTS) {
      const { value } = addNumber(parent, `latency-${part}`, name, hint);
      this.values.set(part, value);
    }
  }

  /** @param {Partial<Record<Part, number>>} parts_ms */
  write(parts_ms) {
    for (const [part, value] of this.values) {
      const ms = parts_ms[part];
      value.textContent = ms === undefined ? "–" : `${readable(ms, 2)} ms`;
    }
  }

  /**
   * A picture has been drawn here; the way of a volume is known when its first picture is.
   * @param {Drawn} drawn
   * @param {Numbers | null} numbers the newest
   */
  drawnHere({ volume, ms }, numbers) {
    if (volume === null) {
      return;
    }
    /** @type {Partial<Record<Part, number>>} */
    const parts = {
      tick: numbers?.tick_ms,
      wait: Math.max(0, 1000 * (volume.encoded_unix_s - volume.published_unix_s)),
      decode: volume.decode_ms,
      held: volume.held_ms,
      render: ms,
    };
    if (this.clock.offset_ms !== null) {
      parts.send = Math.max(0, volume.arrived_unix_ms + this.clock.offset_ms - 1000 * volume.encoded_unix_s);
    }
    parts.whole = Object.values(parts).reduce((sum, part) => sum + (part ?? 0), 0);
    this.write(parts);
  }

  /**
   * A picture of the server's has been drawn.
   * @param {Frame} frame
   * @param {number} decode_ms
   * @param {Numbers | null} numbers the newest
   */
  drawn(frame, decode_ms, numbers) {
    // A still picture comes after a rest: how long it took says nothing of a moving one.
    if (frame.delivery === null || frame.delivery.still) {
      return;
    }
    /** @type {Partial<Record<Part, number>>} */
    const parts = {
      tick: numbers?.tick_ms,
      wait: frame.delivery.wait_ms,
      render: frame.render_ms,
      encode: frame.encode_ms,
      decode: decode_ms,
    };
    if (this.clock.offset_ms !== null) {
      parts.send = Math.max(0, frame.arrived_unix_ms + this.clock.offset_ms - frame.delivery.sent_unix_ms);
    }
    parts.whole = Object.values(parts).reduce((sum, ms) => sum + (ms ?? 0), 0);
    this.write(parts);
  }
}
