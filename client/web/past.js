// @ts-check
// The last minutes of a sky: volumes that this page has seen, and before them what the server has kept.

/** @import { PastMoment, VolumeField } from "./types.js" */

/** How far back, s. */
export const PAST_S = 180;
/** Of what comes, one a second is kept, and no more than this many bytes. */
const BETWEEN_S = 1;
const BYTES_MOST = 96 << 20;
/** Of the server's moments so many are held that were looked at. */
const FETCHED_MOST = 64;

/** @param {VolumeField} field */
const bytesOf = (field) => field.codes.reduce((sum, codes) => sum + codes.byteLength, 0);

/** See the module. */
export class Past {
  constructor() {
    /** @type {VolumeField[]} seen here, oldest first */
    this.fields = [];
    this.bytes = 0;
    /** @type {PastMoment[]} kept by the server, oldest first */
    this.kept = [];
    /** @type {Map<number, VolumeField>} of those what was fetched, by tick */
    this.fetched = new Map();
  }

  clear() {
    this.fields = [];
    this.bytes = 0;
    this.kept = [];
    this.fetched.clear();
  }

  /** @param {VolumeField} field the newest */
  push(field) {
    const newest = this.fields.at(-1);
    if (newest !== undefined && field.header.published_unix_s < newest.header.published_unix_s) {
      this.clear(); // another clock, or another life of the world
    }
    const [before, last] = [this.fields.at(-2), this.fields.at(-1)];
    if (before !== undefined && last !== undefined && last.header.published_unix_s - before.header.published_unix_s < BETWEEN_S) {
      // The newest of all is there, whatever its time; it makes room for the next if it came too soon after the one before.
      this.fields.pop();
      this.bytes -= bytesOf(last);
    }
    this.fields.push(field);
    this.bytes += bytesOf(field);
    while (
      this.fields.length > 1 &&
      (this.bytes > BYTES_MOST || field.header.published_unix_s - this.fields[0].header.published_unix_s > PAST_S)
    ) {
      this.bytes -= bytesOf(/** @type {VolumeField} */ (this.fields.shift()));
    }
  }

  /** @param {PastMoment[]} moments what the server has kept, oldest first */
  learn(moments) {
    this.kept = moments;
    const ticks = new Set(moments.map((moment) => moment.tick));
    for (const tick of this.fetched.keys()) {
      if (!ticks.has(tick)) {
        this.fetched.delete(tick);
      }
    }
  }

  /** @param {number} tick @param {VolumeField} field */
  hold(tick, field) {
    this.fetched.set(tick, field);
    for (const oldest of this.fetched.keys()) {
      if (this.fetched.size <= FETCHED_MOST) {
        break;
      }
      this.fetched.delete(oldest);
    }
  }

  /** When the newest was published, Unix seconds; null where nothing is known. */
  get newest_unix_s() {
    return this.fields.at(-1)?.header.published_unix_s ?? this.kept.at(-1)?.published_unix_s ?? null;
  }

  /** How far back it reaches, s. */
  get span_s() {
    const newest_s = this.newest_unix_s;
    const first_s = Math.min(this.fields[0]?.header.published_unix_s ?? Infinity, this.kept[0]?.published_unix_s ?? Infinity);
    return newest_s === null ? 0 : Math.min(PAST_S, Math.max(0, newest_s - first_s));
  }

  /**
   * What was there so long before the newest, with its field where that is here; null where nothing is known.
   * @param {number} ago_s
   * @returns {{tick: number, simulated_s: number, published_unix_s: number, field: VolumeField | null} | null}
   */
  at(ago_s) {
    const newest_s = this.newest_unix_s;
    if (newest_s === null) {
      return null;
    }
    const then_s = newest_s - ago_s;
    const own = this.fields.map((field) => ({ ...field.header, field }));
    const first_s = own[0]?.published_unix_s ?? Infinity;
    const theirs = this.kept.filter((moment) => moment.published_unix_s < first_s);
    const all = [...theirs.map((moment) => ({ ...moment, field: this.fetched.get(moment.tick) ?? null })), ...own];
    /** @param {{published_unix_s: number}} moment */
    const off = (moment) => Math.abs(moment.published_unix_s - then_s);
    const { tick, simulated_s, published_unix_s, field } = all.reduce((best, moment) => (off(moment) < off(best) ? moment : best));
    return { tick, simulated_s, published_unix_s, field };
  }
}
