// @ts-check
// Layers of information beside the sky: a cut through any channel with wind arrows, and the sounding of the column under the cursor.

/** @import { Hello } from "./types.js" */

import { element, readable } from "./panel.js";
import { drawSounding } from "./sounding.js";
import { pathOf } from "./stream.js";
import { channelValues, fetchField } from "./volume.js";

const REFRESH_MS = 1_000;
/** Arrows across a cut, at most. */
const ARROWS = 20;

/** Channels on offer: name on the wire, name, factor and unit to show. @type {[string, string, number, string][]} */
export const CHANNELS = [
  ["extinction_per_m", "Extinction", 1000, "1/km"],
  ["liquid_water_kg_kg", "Cloud water", 1000, "g/kg"],
  ["wind_z_m_s", "Wind, up", 1, "m/s"],
  ["wind_x_m_s", "Wind, east", 1, "m/s"],
  ["wind_y_m_s", "Wind, north", 1, "m/s"],
  ["temperature_k", "Temperature", 1, "K"],
  ["relative_humidity", "Relative humidity", 100, "%"],
  ["total_water_kg_kg", "Water in all", 1000, "g/kg"],
  ["eddy_dissipation_rate_m23_s", "Turbulence (EDR)", 1, "m^⅔/s"],
];

/** What a column's sounding needs. */
const SOUNDING = ["pressure_pa", "temperature_k", "relative_humidity", "wind_x_m_s", "wind_y_m_s"];

/**
 * Cells of the world that is shown; 16 bits, for numbers that are read off.
 * @param {string} world
 * @param {string[]} channels
 * @param {number[]} from
 * @param {number[]} cells
 */
export function fetchCells(world, channels, from, cells) {
  const query = new URLSearchParams({ channels: channels.join(), bits: "16", from: from.join(), cells: cells.join() });
  return fetchField(`${pathOf(world)}/volume.bin?${query}`);
}

/** Dark blue over white to red where values have both signs, black over blue to white else. @param {number} share @param {boolean} signed */
function colour(share, signed) {
  if (signed) {
    const t = 2 * share - 1;
    return t < 0 ? [255 * (1 + t), 255 * (1 + t) * 0.98, 255 * (1 + 0.4 * t)] : [255, 255 * (1 - t), 255 * (1 - t)];
  }
  return [255 * share ** 1.4, 255 * (0.1 + 0.9 * share) * Math.min(1, 0.35 + share), 90 + 165 * share];
}

/** See the module. */
export class Layers {
  constructor() {
    this.cut = element("cut", HTMLSelectElement);
    this.channel = element("cut-channel", HTMLSelectElement);
    this.place = element("cut-place", HTMLInputElement);
    this.placeOut = element("cut-place-out", HTMLOutputElement);
    this.arrows = element("cut-arrows", HTMLInputElement);
    this.controls = element("cut-controls", HTMLDivElement);
    this.canvas = element("cut-canvas", HTMLCanvasElement);
    this.legend = element("cut-legend", HTMLParagraphElement);
    this.soundingCanvas = element("sounding-canvas", HTMLCanvasElement);
    this.soundingText = element("sounding-text", HTMLParagraphElement);
    /** @type {Hello | null} */
    this.hello = null;
    /** @type {[number, number]} the column of the sounding, cells */
    this.column = [0, 0];
    this.busy = false;
    this.due = false;
    for (const [name, label] of CHANNELS) {
      this.channel.add(new Option(label, name));
    }
    for (const control of [this.cut, this.channel, this.place, this.arrows]) {
      control.addEventListener("input", () => this.changed());
    }
    this.canvas.addEventListener("pointermove", (event) => this.point(event));
    this.canvas.addEventListener("pointerdown", (event) => this.point(event));
    this.canvas.addEventListener("keydown", (event) => this.key(event));
    setInterval(() => void this.refresh(), REFRESH_MS);
    this.changed();
  }

  /** @param {Hello} hello the world that is shown */
  setWorld(hello) {
    if (this.hello?.world !== hello.world) {
      this.column = [hello.cells[0] >> 1, hello.cells[1] >> 1];
    }
    this.hello = hello;
    this.changed();
  }

  /** The axis that the cut stands across: 2 for a level, 1 and 0 for upright cuts; null where none is wanted. */
  get across() {
    return { level: 2, "west-east": 1, "south-north": 0 }[this.cut.value] ?? null;
  }

  /** The cell of the cut along its axis. */
  get cell() {
    const { across, hello } = this;
    return across === null || hello === null ? 0 : Math.min(hello.cells[across] - 1, this.place.valueAsNumber);
  }

  changed() {
    const { across, hello } = this;
    this.controls.hidden = across === null;
    if (across === null || hello === null) {
      return;
    }
    this.place.max = String(hello.cells[across] - 1);
    const at_m = (this.cell + 0.5) * hello.cell_size_m[across];
    const text = `${at_m.toFixed(0)} m ${["east", "north", "up"][across]}`;
    this.placeOut.textContent = text;
    this.place.setAttribute("aria-valuetext", text);
    void this.refresh();
  }

  /** The cell along the cut's two axes under the pointer; the sounding is that column's. @param {PointerEvent} event */
  point(event) {
    const box = this.canvas.getBoundingClientRect();
    const share = [(event.clientX - box.left) / box.width, 1 - (event.clientY - box.top) / box.height];
    this.moveColumn(share);
  }

  /** @param {number[]} share of the cut's width and height */
  moveColumn(share) {
    const { across, hello } = this;
    if (across === null || hello === null) {
      return;
    }
    /** @param {number} axis @param {number} part */
    const cell = (axis, part) => Math.min(hello.cells[axis] - 1, Math.max(0, Math.floor(part * hello.cells[axis])));
    this.column =
      across === 2
        ? [cell(0, share[0]), cell(1, share[1])]
        : across === 1
          ? [cell(0, share[0]), this.cell]
          : [this.cell, cell(1, share[0])];
    void this.refresh();
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    const { across, hello } = this;
    if (step === undefined || across === null || hello === null) {
      return;
    }
    event.preventDefault();
    const [x, y] = this.column;
    const sideways = across === 0 ? (y + step[0] + 0.5) / hello.cells[1] : (x + step[0] + 0.5) / hello.cells[0];
    this.moveColumn([sideways, (y + step[1] + 0.5) / hello.cells[1]]);
  }

  async refresh() {
    const { across, hello } = this;
    if (across === null || hello === null || document.hidden || this.canvas.offsetParent === null) {
      return;
    }
    if (this.busy) {
      this.due = true;
      return;
    }
    this.busy = true;
    this.due = false;
    try {
      await Promise.all([this.drawCut(hello, across), this.drawColumn(hello)]);
    } catch (error) {
      this.legend.textContent = error instanceof Error ? error.message : String(error);
    }
    this.busy = false;
    if (this.due) {
      void this.refresh();
    }
  }

  /** @param {Hello} hello @param {number} across */
  async drawCut(hello, across) {
    const from = [0, 0, 0];
    const cells = [...hello.cells];
    from[across] = this.cell;
    cells[across] = 1;
    const [name, label, factor, unit] = CHANNELS.find(([known]) => known === this.channel.value) ?? CHANNELS[0];
    const along = across === 0 ? 1 : 0;
    const upright = across === 2 ? 1 : 2;
    const winds = ["wind_x_m_s", "wind_y_m_s", "wind_z_m_s"];
    const wanted = this.arrows.checked ? [...new Set([name, winds[along], winds[upright]])] : [name];
    const field = await fetchCells(hello.world, wanted, from, cells);
    const values = channelValues(field, name);
    if (values === null) {
      throw new Error(`the server sent no ${name}`);
    }
    let low = Infinity;
    let high = -Infinity;
    for (const value of values) {
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
    const signed = low < 0 && high > 0;
    const [bottom, top] = signed ? [-Math.max(-low, high), Math.max(-low, high)] : [low, high];
    const [nx, ny] = [cells[along], cells[upright]];
    const image = new ImageData(nx, ny);
    for (let y = 0; y < ny; y++) {
      for (let x = 0; x < nx; x++) {
        // Rows of a picture go down, the cut's go up.
        const share = top > bottom ? (values[(ny - 1 - y) * nx + x] - bottom) / (top - bottom) : 0;
        image.data.set([...colour(share, signed), 255], (y * nx + x) * 4);
      }
    }
    const canvas = this.canvas;
    const ratio = Math.min(2, devicePixelRatio || 1);
    const sizes = hello.cell_size_m;
    const aspect = (ny * sizes[upright]) / (nx * sizes[along]);
    canvas.width = Math.round(Math.max(1, canvas.clientWidth) * ratio);
    canvas.height = Math.round(canvas.width * Math.min(1.2, Math.max(0.25, aspect)));
    const context = canvas.getContext("2d");
    if (context === null) {
      return;
    }
    const small = new OffscreenCanvas(nx, ny);
    small.getContext("2d")?.putImageData(image, 0, 0);
    context.imageSmoothingEnabled = false;
    context.drawImage(small, 0, 0, canvas.width, canvas.height);
    if (this.arrows.checked) {
      this.drawArrows(context, nx, ny, channelValues(field, winds[along]), channelValues(field, winds[upright]), ratio);
    }
    this.markColumn(context, across, nx, ny, ratio);
    this.legend.textContent =
      `${label}: ${readable(low * factor)} to ${readable(high * factor)} ${unit}` +
      (signed ? "; blue is negative, red positive" : "; dark is low, light high");
  }

  /**
   * Arrows of the wind within the cut, the longest as long as the way to the next.
   * @param {CanvasRenderingContext2D} context @param {number} nx @param {number} ny
   * @param {Float32Array | null} u @param {Float32Array | null} v @param {number} ratio
   */
  drawArrows(context, nx, ny, u, v, ratio) {
    if (u === null || v === null) {
      return;
    }
    const { width, height } = context.canvas;
    const step = Math.max(1, Math.ceil(Math.max(nx, ny) / ARROWS));
    let largest = 1e-3;
    for (let n = 0; n < u.length; n++) {
      largest = Math.max(largest, Math.hypot(u[n], v[n]));
    }
    const length = (0.9 * step * Math.min(width / nx, height / ny)) / largest;
    context.strokeStyle = "#ffd166";
    context.lineWidth = 1.2 * ratio;
    context.beginPath();
    for (let y = step >> 1; y < ny; y += step) {
      for (let x = step >> 1; x < nx; x += step) {
        const [du, dv] = [u[y * nx + x] * length, -v[y * nx + x] * length];
        const [fromX, fromY] = [((x + 0.5) / nx) * width, (1 - (y + 0.5) / ny) * height];
        context.moveTo(fromX, fromY);
        context.lineTo(fromX + du, fromY + dv);
        context.lineTo(fromX + 0.7 * du - 0.15 * dv, fromY + 0.7 * dv + 0.15 * du);
      }
    }
    context.stroke();
  }

  /**
   * @param {CanvasRenderingContext2D} context @param {number} across @param {number} nx @param {number} ny @param {number} ratio
   */
  markColumn(context, across, nx, ny, ratio) {
    const { width, height } = context.canvas;
    const x = ((this.column[across === 0 ? 1 : 0] + 0.5) / nx) * width;
    context.strokeStyle = "#ffffff";
    context.lineWidth = ratio;
    context.beginPath();
    if (across === 2) {
      const y = (1 - (this.column[1] + 0.5) / ny) * height;
      context.arc(x, y, 5 * ratio, 0, 2 * Math.PI);
    } else {
      context.moveTo(x, 0);
      context.lineTo(x, height);
    }
    context.stroke();
  }

  /** @param {Hello} hello */
  async drawColumn(hello) {
    const [x, y] = this.column;
    const field = await fetchCells(hello.world, SOUNDING, [x, y, 0], [1, 1, hello.cells[2]]);
    const [pressure_pa, temperature_k, humidity, wind_x_m_s, wind_y_m_s] = SOUNDING.map(
      (name) => channelValues(field, name) ?? new Float32Array(),
    );
    const said = drawSounding(this.soundingCanvas, { pressure_pa, temperature_k, humidity, wind_x_m_s, wind_y_m_s });
    const [east_m, north_m] = [(x + 0.5) * hello.cell_size_m[0], (y + 0.5) * hello.cell_size_m[1]];
    this.soundingText.textContent = `Sounding ${east_m.toFixed(0)} m east, ${north_m.toFixed(0)} m north: ${said}`;
  }
}
