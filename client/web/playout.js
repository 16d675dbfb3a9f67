// @ts-check
// The server's clock, and playing volumes smoothly by it: proto/PROTOCOL.md, "Time". The twin of client/src/clock.rs.

/** @import { VolumeField } from "./types.js" */

/** Answers to pings that are remembered, messages that the delay is made of, and fields that are kept to be played. */
const [ANSWERS, SPACINGS, FIELDS_MOST] = [16, 32, 64];
/** The delay changes by at most this share of the time that goes by, so that the sky neither jumps nor stands. */
const SLEW = 0.1;
/** A delay that is further off, s, is taken at once: after a world has stood. */
const JUMP_S = 2;
/** A time between publications that is so many times the median is one in which the world stood, and does not count. */
const STOOD = 4;

/** Guesses the server's clock from pings: of the last sixteen, the one with the shortest way there and back is believed. */
export class Clock {
  constructor() {
    /** @type {{way_s: number, offset_s: number}[]} */
    this.answers = [];
  }

  /**
   * Notes the answer to a ping: when it went and came by our clock, and what the server's said in between. What makes no sense is ignored.
   * @param {number} sent_s @param {number} received_s @param {number} server_unix_s
   */
  answered(sent_s, received_s, server_unix_s) {
    const way_s = received_s - sent_s;
    // Written so that what is no number is ignored too.
    if (!(way_s >= 0 && Number.isFinite(server_unix_s) && Number.isFinite(received_s))) {
      return;
    }
    this.answers.push({ way_s, offset_s: server_unix_s - 0.5 * (sent_s + received_s) });
    this.answers = this.answers.slice(-ANSWERS);
  }

  /** What the server's clock says when ours says `now_s`; null before the first answer. @param {number} now_s */
  server_unix_s(now_s) {
    return this.answers.length === 0 ? null : now_s + this.answers.reduce((best, a) => (a.way_s < best.way_s ? a : best)).offset_s;
  }
}

/**
 * What is to be shown at a moment: `before`, or so much of `after` as its weight says, 0 to 1.
 * @typedef {object} Shown
 * @property {VolumeField} before
 * @property {VolumeField | null} after
 * @property {number} weight
 * @property {number} simulated_s
 */

/** @param {VolumeField} field what must be equal for two fields to be mixed */
const shapeOf = ({ header: { world_cells, region, mip, cell_size_m, channels } }) =>
  JSON.stringify([world_cells, region, mip, cell_size_m, channels.map(({ name }) => name)]);

/** Fields in the order of their publication, to be shown smoothly a little later. */
export class Playout {
  /** @param {number | null} [fixed_s] how far behind the server's clock; null takes as much as the messages of late need to be there in time */
  constructor(fixed_s = null) {
    this.fixed_s = fixed_s;
    this.adapted_s = 0;
    /** @type {number | null} */
    this.lastShown_s = null;
    /** @type {VolumeField[]} */
    this.fields = [];
    /** @type {{between_s: number, way_s: number}[]} from the publication before, and from publication to arrival */
    this.spacings = [];
  }

  /**
   * Takes a field that arrived when the server's clock said so. One of another shape begins anew; one that is not newer is dropped.
   * @param {VolumeField} field @param {number} arrived_unix_s
   */
  push(field, arrived_unix_s) {
    let last = this.fields.at(-1);
    if (last !== undefined && shapeOf(last) !== shapeOf(field)) {
      this.fields = [];
      this.spacings = [];
      last = undefined;
    }
    const published_s = field.header.published_unix_s;
    if (last !== undefined) {
      const between_s = published_s - last.header.published_unix_s;
      if (between_s <= 0) {
        return;
      }
      this.spacings.push({ between_s, way_s: arrived_unix_s - published_s });
      this.spacings = this.spacings.slice(-SPACINGS);
    }
    this.fields.push(field);
    this.fields = this.fields.slice(-FIELDS_MOST);
  }

  /** How far behind the server's clock is played now, s. */
  get delay_s() {
    return this.fixed_s ?? this.adapted_s;
  }

  /** @param {number} now_s */
  adapt(now_s) {
    const between = this.spacings.map(({ between_s }) => between_s).sort((a, b) => a - b);
    const median = between[(between.length - 1) >> 1] ?? 0;
    const longest_s = Math.max(0, ...between.filter((s) => s <= STOOD * median));
    const target_s = this.spacings.reduce((most, { way_s }) => Math.max(most, way_s), 0) + longest_s;
    if (this.lastShown_s !== null && this.adapted_s > 0 && Math.abs(target_s - this.adapted_s) <= JUMP_S) {
      const most_s = SLEW * Math.max(0, now_s - this.lastShown_s);
      this.adapted_s += Math.min(most_s, Math.max(-most_s, target_s - this.adapted_s));
    } else {
      // Until there are two fields nothing moves yet, and any delay may be taken at once.
      this.adapted_s = target_s;
    }
    this.lastShown_s = now_s;
  }

  /**
   * What to show when the server's clock says so; null before the first field. Fields that are over are forgotten.
   * @param {number} server_unix_s
   * @returns {Shown | null}
   */
  at(server_unix_s) {
    this.adapt(server_unix_s);
    const shown_s = server_unix_s - this.delay_s;
    while (this.fields.length > 1 && this.fields[1].header.published_unix_s <= shown_s) {
      this.fields.shift();
    }
    const before = this.fields[0];
    if (before === undefined) {
      return null;
    }
    const from = before.header;
    const after = this.fields[1];
    if (after === undefined || from.published_unix_s > shown_s) {
      return { before, after: null, weight: 0, simulated_s: from.simulated_s };
    }
    const to = after.header;
    const weight = Math.min(1, Math.max(0, (shown_s - from.published_unix_s) / (to.published_unix_s - from.published_unix_s)));
    return { before, after, weight, simulated_s: (1 - weight) * from.simulated_s + weight * to.simulated_s };
  }

  /** Whether what is shown goes on changing, if nothing else comes. */
  get moves() {
    return this.fields.length > 1;
  }
}
