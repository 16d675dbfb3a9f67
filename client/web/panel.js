// @ts-check
// The numbers, their sparklines, and small helpers for the controls.

/** @import { Numbers } from "./types.js" */

/** How far back a sparkline looks. */
const WINDOW_MS = 5 * 60_000;
const SAMPLES_MAX = 600;

/**
 * Adds a line with a name and a value that is not known yet.
 * @param {HTMLElement} parent @param {string} id of the value @param {string} name @param {string} hint
 */
export function addNumber(parent, id, name, hint) {
  const line = document.createElement("div");
  line.className = "number";
  line.title = hint;
  const label = document.createElement("span");
  label.className = "name";
  label.textContent = name;
  const value = document.createElement("span");
  value.className = "value";
  value.id = id;
  value.textContent = "–";
  line.append(label, value);
  parent.append(line);
  return { line, value };
}

/**
 * Finds an element that the page must have.
 * @template {HTMLElement} T
 * @param {string} id
 * @param {new () => T} kind
 * @returns {T}
 */
export function element(id, kind) {
  const found = document.getElementById(id);
  if (!(found instanceof kind)) {
    throw new Error(`the page has no #${id}`);
  }
  return found;
}

/**
 * A number with as many digits as are worth reading.
 * @param {number} value
 * @param {number} digits significant digits
 */
export function readable(value, digits = 3) {
  if (!Number.isFinite(value)) {
    return "–";
  }
  const size = Math.abs(value) < 1e-9 ? 0 : Math.floor(Math.log10(Math.abs(value)));
  return value.toFixed(Math.min(3, Math.max(0, digits - 1 - size)));
}

/**
 * A span of simulated time, such as `2 h 05 min`.
 * @param {number} seconds
 */
export function duration(seconds) {
  const whole = Math.max(0, Math.floor(seconds));
  const h = Math.floor(whole / 3600);
  const min = Math.floor((whole % 3600) / 60);
  const s = whole % 60;
  const two = (/** @type {number} */ n) => String(n).padStart(2, "0");
  return h > 0 ? `${h} h ${two(min)} min` : `${min} min ${two(s)} s`;
}

/** The last minutes of one number, as a line. */
class Sparkline {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    /** @type {{atMs: number, value: number}[]} */
    this.samples = [];
  }

  /** @param {number} atMs @param {number} value */
  push(atMs, value) {
    // Ticks may come often: a sample a pixel or so is enough, so points nearer than that are replaced.
    const last = this.samples.at(-2);
    if (last !== undefined && atMs - last.atMs < WINDOW_MS / SAMPLES_MAX) {
      this.samples.pop();
    }
    this.samples.push({ atMs, value });
    while (this.samples.length > 0 && this.samples[0].atMs < atMs - WINDOW_MS) {
      this.samples.shift();
    }
  }

  clear() {
    this.samples = [];
  }

  /** @param {number} nowMs */
  draw(nowMs) {
    const ratio = Math.min(3, devicePixelRatio || 1);
    const width = Math.round(this.canvas.clientWidth * ratio);
    const height = Math.round(this.canvas.clientHeight * ratio);
    const context = this.canvas.getContext("2d");
    if (context === null || width === 0 || height === 0) {
      return;
    }
    this.canvas.width = width; // which also clears it
    this.canvas.height = height;
    if (this.samples.length < 2) {
      return;
    }
    let low = Infinity;
    let high = -Infinity;
    for (const { value } of this.samples) {
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
    // The line soon fills the width; once it spans the whole window, it slides.
    const span = Math.min(WINDOW_MS, Math.max(5_000, nowMs - this.samples[0].atMs));
    const range = Math.max(high - low, 1e-9 + 0.02 * Math.abs(high));
    const middle = 0.5 * (low + high);
    const pad = 2 * ratio;
    context.beginPath();
    for (const { atMs, value } of this.samples) {
      const x = width - pad - ((nowMs - atMs) / span) * (width - 2 * pad);
      const y = height / 2 - ((value - middle) / range) * (height - 2 * pad);
      context.lineTo(x, y);
    }
    context.strokeStyle = "#8ec8ff";
    context.lineWidth = 1.25 * ratio;
    context.lineJoin = "round";
    context.stroke();
  }
}

/**
 * One line of the panel.
 * @typedef {object} Row
 * @property {string} id
 * @property {string} name
 * @property {string} hint
 * @property {(n: Numbers) => number | null} value what the sparkline draws; null where there is none
 * @property {(n: Numbers) => string} text
 */

/** @param {number | null} value @param {(v: number) => string} show */
const orDash = (value, show) => (value === null || value === undefined ? "–" : show(value));

/** @type {Row[]} */
const SKY_ROWS = [
  {
    id: "cover", name: "Cloud cover", hint: "Share of columns that hold cloud",
    value: (n) => n.cloud_cover,
    text: (n) => orDash(n.cloud_cover, (v) => `${readable(100 * v)} %`),
  },
  {
    id: "base", name: "Base", hint: "Height of the lowest cloud",
    value: (n) => n.cloud_base_m,
    text: (n) => orDash(n.cloud_base_m, (v) => `${v.toFixed(0)} m`),
  },
  {
    id: "top", name: "Top", hint: "Height of the highest cloud",
    value: (n) => n.cloud_top_m,
    text: (n) => orDash(n.cloud_top_m, (v) => `${v.toFixed(0)} m`),
  },
  {
    id: "lwp", name: "Liquid water path", hint: "Cloud water above a square metre, mean of the whole box",
    value: (n) => n.liquid_water_path_kg_m2,
    text: (n) => orDash(n.liquid_water_path_kg_m2, (v) => `${readable(1000 * v)} g/m²`),
  },
  {
    id: "updraught", name: "Updraught", hint: "Largest upward wind",
    value: (n) => n.updraught_max_m_s,
    text: (n) => `${n.updraught_max_m_s.toFixed(2)} m/s`,
  },
  {
    id: "wind", name: "Wind", hint: "Largest horizontal wind component",
    value: (n) => n.wind_max_m_s,
    text: (n) => `${n.wind_max_m_s.toFixed(1)} m/s`,
  },
];

/** @type {Row[]} */
const RUN_ROWS = [
  { id: "tick", name: "Tick", hint: "Ticks since the start", value: () => null, text: (n) => String(n.tick) },
  {
    id: "simulated", name: "Simulated", hint: "Simulated time since the start",
    value: () => null,
    text: (n) => duration(n.simulated_s),
  },
  {
    id: "speed", name: "Speed", hint: "Simulated seconds a second, measured",
    value: (n) => n.speed,
    text: (n) => (n.paused ? "paused" : `${readable(n.speed)} × real`),
  },
  {
    id: "tick-ms", name: "Tick takes", hint: "Time to compute a tick",
    value: (n) => n.tick_ms,
    text: (n) => `${readable(n.tick_ms)} ms`,
  },
  {
    id: "health", name: "Health", hint: "What the server's watchdog says; ticks that it had to try again",
    value: () => null,
    text: (n) => (n.retries > 0 ? `${n.health ?? "good"}, ${n.retries} retries` : (n.health ?? "good")),
  },
  {
    id: "frame-ms", name: "Frame takes", hint: "Time to render a picture, of any viewer",
    value: (n) => n.frame_ms,
    text: (n) => orDash(n.frame_ms, (v) => `${readable(v)} ms`),
  },
];

/** The read-outs. */
export class NumberBoard {
  constructor() {
    /** @type {{row: Row, value: HTMLElement, line: Sparkline}[]} */
    this.lines = [];
    this.build(element("sky-numbers", HTMLDivElement), SKY_ROWS);
    this.build(element("run-numbers", HTMLDivElement), RUN_ROWS);
    this.drawDue = false;
    this.lastDrawMs = -Infinity;
    this.frames = this.addPlain("frames", "Pictures here", "Pictures that this page drew a second");
  }

  /** @param {HTMLElement} parent @param {Row[]} rows */
  build(parent, rows) {
    for (const row of rows) {
      const { value, canvas } = this.addRow(parent, row.id, row.name, row.hint);
      this.lines.push({ row, value, line: new Sparkline(canvas) });
    }
  }

  /** @param {HTMLElement} parent @param {string} id @param {string} name @param {string} hint */
  addRow(parent, id, name, hint) {
    const { line, value } = addNumber(parent, `n-${id}`, name, hint);
    const canvas = document.createElement("canvas");
    canvas.setAttribute("aria-hidden", "true");
    line.append(canvas);
    return { value, canvas };
  }

  /** @param {string} id @param {string} name @param {string} hint */
  addPlain(id, name, hint) {
    return this.addRow(element("run-numbers", HTMLDivElement), id, name, hint).value;
  }

  /** Forgets the past: another world's numbers follow. */
  clear() {
    for (const { line, value } of this.lines) {
      line.clear();
      value.textContent = "–";
    }
  }

  /** @param {Numbers} numbers */
  update(numbers) {
    const nowMs = performance.now();
    for (const { row, line, value } of this.lines) {
      const sample = row.value(numbers);
      if (sample !== null && sample !== undefined) {
        line.push(nowMs, sample);
      }
      const text = row.text(numbers);
      if (value.textContent !== text) {
        value.textContent = text;
      }
    }
    this.scheduleDraw();
  }

  scheduleDraw() {
    if (this.drawDue || performance.now() - this.lastDrawMs < 400) {
      return;
    }
    this.drawDue = true;
    requestAnimationFrame(() => {
      this.drawDue = false;
      this.lastDrawMs = performance.now();
      for (const { line } of this.lines) {
        line.draw(this.lastDrawMs);
      }
    });
  }
}

/**
 * A slider that follows the server except while a person moves it.
 */
export class FollowingSlider {
  /**
   * @param {string} id
   * @param {(value: number) => string} text what stands beside it
   * @param {(value: number) => void} changed called at most ten times a second while it is moved
   */
  constructor(id, text, changed) {
    this.input = element(id, HTMLInputElement);
    this.output = element(`${id}-out`, HTMLOutputElement);
    this.text = text;
    this.heldUntilMs = -Infinity;
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    let timer;
    this.input.addEventListener("input", () => {
      this.heldUntilMs = performance.now() + 1_500;
      this.write();
      timer ??= setTimeout(() => {
        timer = undefined;
        changed(this.input.valueAsNumber);
      }, 100);
    });
  }

  write() {
    const text = this.text(this.input.valueAsNumber);
    this.output.textContent = text;
    this.input.setAttribute("aria-valuetext", text);
  }

  /** @param {number} value */
  follow(value) {
    if (performance.now() >= this.heldUntilMs && Number.isFinite(value)) {
      this.input.valueAsNumber = value;
      this.write();
    }
  }

  /** Follows again at once. */
  release() {
    this.heldUntilMs = -Infinity;
  }
}
