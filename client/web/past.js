// @ts-check
// The last minutes of a sky: volumes that this page has seen, kept to look at again.

/** @import { VolumeField } from "./types.js" */

/** How far back, s. */
export const PAST_S = 180;
/** One a second is kept, and no more than this many bytes. */
const BETWEEN_S = 1;
const BYTES_MOST = 96 << 20;

/** @param {VolumeField} field */
const bytesOf = (field) => field.codes.reduce((sum, codes) => sum + codes.byteLength, 0);

/** See the module. */
export class Past {
  constructor() {
    /** @type {VolumeField[]} oldest first */
    this.fields = [];
    this.bytes = 0;
  }

  clear() {
    this.fields = [];
    this.bytes = 0;
  }

  /** @param {VolumeField} field the newest */
  push(field) {
    const newest = this.fields.at(-1);
    if (newest !== undefined && field.header.published_unix_s < newest.header.published_unix_s) {
      this.clear(); // another clock, or another life of the world
    }
    const before = this.fields.at(-2);
    if (before !== undefined && field.header.published_unix_s - before.header.published_unix_s < BETWEEN_S) {
      this.bytes -= bytesOf(/** @type {VolumeField} */ (this.fields.pop()));
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

  /** How far back it reaches, s. */
  get span_s() {
    const [first, last] = [this.fields[0], this.fields.at(-1)];
    return last === undefined ? 0 : last.header.published_unix_s - first.header.published_unix_s;
  }

  /**
   * What was shown so long before the newest; null where nothing is kept.
   * @param {number} ago_s
   */
  at(ago_s) {
    const newest = this.fields.at(-1);
    if (newest === undefined) {
      return null;
    }
    const then = newest.header.published_unix_s - ago_s;
    /** @param {VolumeField} field */
    const off = (field) => Math.abs(field.header.published_unix_s - then);
    return this.fields.reduce((best, field) => (off(field) < off(best) ? field : best));
  }
}
