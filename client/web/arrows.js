// @ts-check
// The control of the wind arrows over the sky, and the level of wind that they show.

/** @import { Hello } from "./types.js" */
/** @import { Overlay } from "./overlay.js" */

import { fetchCells } from "./layers.js";
import { element } from "./panel.js";
import { channelValues } from "./volume.js";

const REFRESH_MS = 1_500;
const WINDS = ["wind_x_m_s", "wind_y_m_s", "wind_z_m_s"];

/** See the module. */
export class Arrows {
  /** @param {Overlay} overlay @param {() => boolean} live whether the sky that is shown is that of now, as the wind is */
  constructor(overlay, live) {
    this.overlay = overlay;
    this.live = live;
    this.on = element("arrows", HTMLInputElement);
    this.controls = element("arrows-controls", HTMLDivElement);
    this.height = element("arrows-height", HTMLInputElement);
    this.heightOut = element("arrows-height-out", HTMLOutputElement);
    this.legend = element("arrows-legend", HTMLParagraphElement);
    /** @type {Hello | null} */
    this.hello = null;
    this.busy = false;
    this.due = false;
    this.on.addEventListener("input", () => this.changed());
    this.height.addEventListener("input", () => this.changed());
    setInterval(() => void this.refresh(), REFRESH_MS);
  }

  /** @param {Hello} hello the world that is shown */
  setWorld(hello) {
    if (this.hello?.world !== hello.world) {
      this.overlay.wind = null;
      this.height.max = String(hello.cells[2] - 1);
      this.height.valueAsNumber = Math.round(0.2 * hello.cells[2]);
    }
    this.hello = hello;
    this.changed();
  }

  /** The level's height, m; of the middle of its cells. */
  get height_m() {
    return this.hello === null ? 0 : (this.height.valueAsNumber + 0.5) * this.hello.cell_size_m[2];
  }

  changed() {
    this.controls.hidden = !this.on.checked;
    const text = `${this.height_m.toFixed(0)} m`;
    this.heightOut.textContent = text;
    this.height.setAttribute("aria-valuetext", text);
    void this.refresh();
  }

  async refresh() {
    const { hello } = this;
    if (!this.on.checked || hello === null || !this.live()) {
      if (this.overlay.wind !== null) {
        this.overlay.wind = null;
        this.overlay.changed();
      }
      if (this.on.checked && !this.live()) {
        this.legend.textContent = "Arrows show the wind of now, not of what was.";
      }
      return;
    }
    if (document.hidden || this.busy) {
      this.due = !document.hidden;
      return;
    }
    this.busy = true;
    this.due = false;
    try {
      const [nx, ny] = hello.cells;
      const height_m = this.height_m;
      const field = await fetchCells(hello.world, WINDS, [0, 0, this.height.valueAsNumber], [nx, ny, 1]);
      const velocity_m_s = WINDS.map((name) => channelValues(field, name) ?? new Float32Array(nx * ny));
      if (this.on.checked && this.hello?.world === hello.world && this.live()) {
        const [dx, dy] = hello.cell_size_m;
        this.overlay.wind = { cells: [nx, ny], cell_size_m: [dx, dy], height_m, velocity_m_s };
        this.overlay.changed();
        this.describe(height_m, velocity_m_s);
      }
    } catch (error) {
      this.legend.textContent = error instanceof Error ? error.message : String(error);
    }
    this.busy = false;
    if (this.due) {
      void this.refresh();
    }
  }

  /** @param {number} height_m @param {Float32Array[]} velocity_m_s */
  describe(height_m, [u, v, w]) {
    let [fastest, rising, sinking] = [0, 0, 0];
    for (let n = 0; n < u.length; n++) {
      fastest = Math.max(fastest, Math.hypot(u[n], v[n]));
      rising = Math.max(rising, w[n]);
      sinking = Math.max(sinking, -w[n]);
    }
    this.legend.textContent =
      `Wind at ${height_m.toFixed(0)} m: up to ${fastest.toFixed(1)} m/s. ` +
      `Red air rises, at most ${rising.toFixed(1)} m/s; blue sinks, at most ${sinking.toFixed(1)} m/s.`;
  }
}
