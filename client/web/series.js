// @ts-check
// The air at one place as time goes on: the place, a line over the last minutes, and what it says in words.

/** @import { Camera, Hello } from "./types.js" */
/** @import { Overlay } from "./overlay.js" */

import { CHANNELS } from "./layers.js";
import { duration, element } from "./panel.js";
import { axes } from "./scenery.js";
import { pathOf, request } from "./stream.js";

const EVERY_MS = 1_000;
/** Answers that are kept: ten minutes. */
const KEPT = 600;
/** A place is put so far ahead of the camera, m. */
const AHEAD_M = 1_500;

/** Numbers with as many decimals as tell values within a range apart: a temperature changes by less than its third digit. @param {number} range */
function digits(range) {
  const decimals = range > 0 ? Math.min(3, Math.max(0, 1 - Math.floor(Math.log10(range)))) : 2;
  return (/** @type {number} */ value) => value.toFixed(decimals);
}

/** See the module. */
export class Series {
  /** @param {Overlay} overlay @param {() => Camera | null} camera */
  constructor(overlay, camera) {
    this.overlay = overlay;
    this.on = element("point", HTMLInputElement);
    this.controls = element("point-controls", HTMLDivElement);
    this.channel = element("point-channel", HTMLSelectElement);
    this.sliders = ["point-x", "point-y", "point-z"].map((id) => element(id, HTMLInputElement));
    this.canvas = element("series-canvas", HTMLCanvasElement);
    this.text = element("series-text", HTMLParagraphElement);
    /** @type {Hello | null} */
    this.hello = null;
    /** @type {{simulated_s: number, value: number}[]} oldest first */
    this.values = [];
    this.asking = false;
    for (const [name, label] of CHANNELS) {
      this.channel.add(new Option(label, name));
    }
    this.on.addEventListener("input", () => this.changed());
    this.channel.addEventListener("input", () => this.changed());
    this.sliders.forEach((slider) => slider.addEventListener("input", () => this.changed()));
    element("point-ahead", HTMLButtonElement).addEventListener("click", () => {
      const from = camera();
      if (from !== null) {
        this.put(from.position_m.map((p, axis) => p + AHEAD_M * axes(from).ahead[axis]));
      }
    });
    setInterval(() => void this.ask(), EVERY_MS);
  }

  /** @param {Hello} hello the world that is shown */
  setWorld(hello) {
    const another = this.hello?.world !== hello.world;
    this.hello = hello;
    if (another) {
      this.sliders.forEach((slider, axis) => {
        slider.max = String(Math.round(hello.cells[axis] * hello.cell_size_m[axis]));
        slider.valueAsNumber = Math.round(hello.cells[axis] * hello.cell_size_m[axis] * (axis === 2 ? 0.25 : 0.5));
      });
      this.changed();
    }
  }

  /** The box east, north and up, m. @returns {[number, number, number]} */
  get box_m() {
    const [x, y, z] = this.hello?.cells ?? [1, 1, 1];
    const [dx, dy, dz] = this.hello?.cell_size_m ?? [1, 1, 1];
    return [x * dx, y * dy, z * dz];
  }

  /** @param {number[]} place anywhere: the box repeats east and north */
  put(place) {
    const box_m = this.box_m;
    this.sliders.forEach((slider, axis) => {
      const p = place[axis];
      slider.valueAsNumber = Math.round(axis === 2 ? Math.min(box_m[2], Math.max(0, p)) : ((p % box_m[axis]) + box_m[axis]) % box_m[axis]);
    });
    this.changed();
  }

  /** @returns {[number, number, number]} */
  get place_m() {
    return [this.sliders[0].valueAsNumber, this.sliders[1].valueAsNumber, this.sliders[2].valueAsNumber];
  }

  /** Another place, or something else of it, is wanted: the line begins anew. */
  changed() {
    this.controls.hidden = !this.on.checked;
    this.values = [];
    for (const slider of this.sliders) {
      const text = `${slider.valueAsNumber.toFixed(0)} m`;
      element(`${slider.id}-out`, HTMLOutputElement).textContent = text;
      slider.setAttribute("aria-valuetext", text);
    }
    this.show("");
    void this.ask();
  }

  async ask() {
    const { hello } = this;
    if (!this.on.checked || hello === null || document.hidden || this.asking) {
      return;
    }
    this.asking = true;
    const [x_m, y_m, z_m] = this.place_m;
    const name = this.channel.value;
    const query = new URLSearchParams({ x_m: String(x_m), y_m: String(y_m), z_m: String(z_m), channels: name });
    try {
      const sample = await request("GET", `${pathOf(hello.world)}/sample?${query}`);
      const asked = [x_m, y_m, z_m].every((p, axis) => p === this.place_m[axis]) && name === this.channel.value;
      if (asked && this.hello?.world === hello.world) {
        this.took(sample.simulated_s, sample.values[name]);
      }
    } catch (error) {
      this.text.textContent = error instanceof Error ? error.message : String(error);
    }
    this.asking = false;
  }

  /** @param {number} simulated_s @param {number | null} value */
  took(simulated_s, value) {
    const [, label, factor, unit] = CHANNELS.find(([known]) => known === this.channel.value) ?? CHANNELS[0];
    if (value === null || value === undefined) {
      this.text.textContent = "There is no air at this place.";
      return;
    }
    // A world that went back in time begins anew; one that stands adds nothing.
    if ((this.values.at(-1)?.simulated_s ?? -Infinity) > simulated_s) {
      this.values = [];
    }
    if (this.values.at(-1)?.simulated_s !== simulated_s) {
      this.values.push({ simulated_s, value: value * factor });
      this.values = this.values.slice(-KEPT);
    }
    const all = this.values.map((one) => one.value);
    const [low, high] = [Math.min(...all), Math.max(...all)];
    const text = digits(high - low);
    const span_s = simulated_s - this.values[0].simulated_s;
    const now = `${text(value * factor)} ${unit}`;
    this.text.textContent = `${label}: ${now} now; ${text(low)} to ${text(high)} ${unit} in ${duration(span_s)} simulated.`;
    this.show(now);
  }

  /** @param {string} now what stands beside the place in the sky */
  show(now) {
    const [east_m, north_m] = this.box_m;
    this.overlay.mark = this.on.checked && this.hello !== null ? { place: this.place_m, box_m: [east_m, north_m], label: now === "" ? "…" : now } : null;
    this.overlay.changed();
    if (this.on.checked) {
      this.draw();
    }
  }

  /** The line, with its largest and least value and the time that it spans. */
  draw() {
    const { canvas, values } = this;
    const ratio = Math.min(2, devicePixelRatio || 1);
    const [wide, high] = [Math.max(1, canvas.clientWidth), 120];
    canvas.width = Math.round(wide * ratio);
    canvas.height = Math.round(high * ratio);
    const context = canvas.getContext("2d");
    if (context === null) {
      return;
    }
    context.scale(ratio, ratio);
    context.fillStyle = "rgb(255 255 255 / 5%)";
    context.fillRect(0, 0, wide, high);
    if (values.length < 2) {
      return;
    }
    const [first, last] = [values[0], values[values.length - 1]];
    const numbers = values.map((one) => one.value);
    const [low, top] = [Math.min(...numbers), Math.max(...numbers)];
    // A flat line lies in the middle instead of filling the height with noise.
    const range = Math.max(top - low, 1e-6 + 0.002 * Math.abs(top));
    const middle = 0.5 * (low + top);
    const [left, right, above, below] = [50, 8, 12, 22];
    /** @param {number} simulated_s */
    const x = (simulated_s) => left + ((simulated_s - first.simulated_s) / (last.simulated_s - first.simulated_s)) * (wide - left - right);
    /** @param {number} value */
    const y = (value) => above + (0.5 - (value - middle) / range) * (high - above - below);
    context.font = "11px system-ui, sans-serif";
    context.fillStyle = "#b3c0cd";
    context.strokeStyle = "rgb(255 255 255 / 14%)";
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (const value of [middle - 0.5 * range, middle, middle + 0.5 * range]) {
      context.fillText(digits(range)(value), left - 6, y(value));
      context.beginPath();
      context.moveTo(left, y(value));
      context.lineTo(wide - right, y(value));
      context.stroke();
    }
    context.textBaseline = "alphabetic";
    context.textAlign = "left";
    context.fillText(`−${duration(last.simulated_s - first.simulated_s)}`, left, high - 6);
    context.textAlign = "right";
    context.fillText("now", wide - right, high - 6);
    context.beginPath();
    values.forEach((one) => context.lineTo(x(one.simulated_s), y(one.value)));
    context.strokeStyle = "#ffd166";
    context.lineWidth = 1.75;
    context.lineJoin = "round";
    context.stroke();
    context.beginPath();
    context.arc(x(last.simulated_s), y(last.value), 3, 0, 2 * Math.PI);
    context.fillStyle = "#ffd166";
    context.fill();
  }
}
