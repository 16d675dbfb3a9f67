// @ts-check
// What is drawn over the sky, in its perspective: the wind as arrows at a height, and the place that is followed.

/** @import { Camera } from "./types.js" */

import { element } from "./panel.js";
import { axes } from "./scenery.js";
import { SkyView, clamp } from "./view.js";

/** @typedef {[number, number, number]} Place m east, north, up */
/** @typedef {{x: number, y: number, depth_m: number}} Seen a place on the screen, pixels from its upper left corner */

/**
 * A level of wind, `[y][x]`, which repeats.
 * @typedef {object} WindLevel
 * @property {[number, number]} cells
 * @property {[number, number]} cell_size_m
 * @property {number} height_m
 * @property {Float32Array[]} velocity_m_s east, north, up
 */

/** Arrows across the box, about. */
const ARROWS = 14;
/** Arrows are drawn as far as this, in widths of the box. */
const REACH = 1.1;
const NEAREST_M = 5;
/** The fastest that rises or sinks has the full colour, unless it is slower than this, m/s. */
const FULL_COLOUR_LEAST_M_S = 0.5;
const [SINKING, LEVEL, RISING] = [[86, 170, 255], [255, 236, 178], [255, 104, 72]];

/**
 * Where places are seen in a picture that covers the window.
 * @param {Camera} camera
 * @param {number} height pixels of the whole picture, of which the window may show a part
 * @param {[number, number]} size pixels of the window
 * @returns {(place: Place) => Seen | null} null for what is not in front of the camera
 */
export function projector(camera, height, [wide, high]) {
  const { right, up, ahead } = axes(camera);
  const focal = (0.5 * height) / Math.tan((camera.vertical_fov_deg * Math.PI) / 360);
  const from = camera.position_m;
  return (place) => {
    const way = place.map((p, axis) => p - from[axis]);
    /** @param {number[]} v */
    const along = (v) => v[0] * way[0] + v[1] * way[1] + v[2] * way[2];
    const depth_m = along(ahead);
    if (depth_m < NEAREST_M) {
      return null;
    }
    return { x: 0.5 * wide + (focal * along(right)) / depth_m, y: 0.5 * high - (focal * along(up)) / depth_m, depth_m };
  };
}

/** @param {number} share of the full colour: below 0 it sinks, above it rises */
function colour(share) {
  const to = share < 0 ? SINKING : RISING;
  return LEVEL.map((c, n) => Math.round(c + Math.abs(share) * (to[n] - c)));
}

/** See the module. */
export class Overlay {
  /** @param {SkyView} view whose camera and picture it lies over */
  constructor(view) {
    this.view = view;
    this.canvas = element("overlay", HTMLCanvasElement);
    /** @type {WindLevel | null} */
    this.wind = null;
    /** @type {{place: Place, box_m: [number, number], label: string} | null} */
    this.mark = null;
    this.due = false;
    addEventListener("resize", () => this.changed());
  }

  /** Something that it shows, or from where, is another. */
  changed() {
    if (!this.due) {
      this.due = true;
      requestAnimationFrame(() => {
        this.due = false;
        this.draw();
      });
    }
  }

  draw() {
    const { canvas, view } = this;
    const empty = this.wind === null && this.mark === null;
    canvas.hidden = empty;
    const context = canvas.getContext("2d");
    if (empty || context === null || view.camera === null) {
      return;
    }
    const ratio = Math.min(2, devicePixelRatio || 1);
    canvas.width = Math.round(innerWidth * ratio);
    canvas.height = Math.round(innerHeight * ratio);
    context.scale(ratio, ratio);
    context.lineCap = "round";
    context.lineJoin = "round";
    const project = projector(view.camera, view.pictureHeight, [innerWidth, innerHeight]);
    if (this.wind !== null) {
      this.drawWind(context, project, view.camera, this.wind);
    }
    if (this.mark !== null) {
      this.drawMark(context, project, view.camera, this.mark);
    }
  }

  /**
   * @param {CanvasRenderingContext2D} context @param {(place: Place) => Seen | null} project @param {Camera} camera @param {WindLevel} wind
   */
  drawWind(context, project, camera, { cells, cell_size_m, height_m, velocity_m_s }) {
    const [u, v, w] = velocity_m_s;
    const box_m = Math.max(cells[0] * cell_size_m[0], cells[1] * cell_size_m[1]);
    // Whole cells from one arrow to the next, so that they stand where the numbers are.
    const steps = cell_size_m.map((size_m, axis) => clamp(Math.round(box_m / ARROWS / size_m), 1, cells[axis]));
    const spacing_m = Math.max(steps[0] * cell_size_m[0], steps[1] * cell_size_m[1]);
    let [fastest_m_s, upright_m_s] = [0.1, FULL_COLOUR_LEAST_M_S];
    for (let n = 0; n < u.length; n++) {
      fastest_m_s = Math.max(fastest_m_s, Math.hypot(u[n], v[n], w[n]));
      upright_m_s = Math.max(upright_m_s, Math.abs(w[n]));
    }
    const seconds = (0.9 * spacing_m) / fastest_m_s;
    const reach_m = REACH * box_m;
    /** @param {number} axis */
    const range = (axis) => {
      const step_m = steps[axis] * cell_size_m[axis];
      return [Math.ceil((camera.position_m[axis] - reach_m) / step_m), Math.floor((camera.position_m[axis] + reach_m) / step_m)];
    };
    /** @type {{tail: Seen, tip: Seen, away_m: number, rising: number}[]} */
    const arrows = [];
    const [[west, east], [south, north]] = [range(0), range(1)];
    for (let j = south; j <= north; j++) {
      for (let i = west; i <= east; i++) {
        const [x, y] = [i * steps[0], j * steps[1]];
        const at = (((y % cells[1]) + cells[1]) % cells[1]) * cells[0] + (((x % cells[0]) + cells[0]) % cells[0]);
        const place = [(x + 0.5) * cell_size_m[0], (y + 0.5) * cell_size_m[1], height_m];
        const away_m = Math.hypot(...place.map((p, axis) => p - camera.position_m[axis]));
        if (away_m > reach_m) {
          continue;
        }
        /** @param {number} share */
        const end = (share) =>
          project([place[0] + share * seconds * u[at], place[1] + share * seconds * v[at], place[2] + share * seconds * w[at]]);
        const [tail, tip] = [end(-0.5), end(0.5)];
        if (tail !== null && tip !== null) {
          arrows.push({ tail, tip, away_m, rising: w[at] / upright_m_s });
        }
      }
    }
    arrows.sort((a, b) => b.away_m - a.away_m);
    for (const { tail, tip, away_m, rising } of arrows) {
      // They fade towards the end of their reach, and those at the eye do not cover the view.
      const strength = Math.min(1, 1.6 * (1 - away_m / reach_m)) * clamp(away_m / spacing_m, 0.15, 1);
      drawArrow(context, tail, tip, colour(rising), strength);
    }
  }

  /**
   * @param {CanvasRenderingContext2D} context @param {(place: Place) => Seen | null} project @param {Camera} camera
   * @param {{place: Place, box_m: [number, number], label: string}} mark
   */
  drawMark(context, project, camera, { place, box_m, label }) {
    // The box repeats: of all copies of the place the one nearest to where the camera looks is shown.
    const { ahead } = axes(camera);
    /** @param {0 | 1} axis */
    const nearest = (axis) => {
      const wanted_m = camera.position_m[axis] + 0.3 * box_m[axis] * ahead[axis];
      return place[axis] + Math.round((wanted_m - place[axis]) / box_m[axis]) * box_m[axis];
    };
    const [x, y] = [nearest(0), nearest(1)];
    const [top, foot] = [project([x, y, place[2]]), project([x, y, 0])];
    if (top === null) {
      return;
    }
    if (foot !== null) {
      context.setLineDash([4, 5]);
      line(context, top, foot, "rgb(255 255 255 / 55%)", 1.5);
      context.setLineDash([]);
    }
    context.beginPath();
    context.arc(top.x, top.y, 7, 0, 2 * Math.PI);
    context.lineWidth = 4;
    context.strokeStyle = "rgb(8 16 24 / 60%)";
    context.stroke();
    context.lineWidth = 2;
    context.strokeStyle = "#ffd166";
    context.stroke();
    context.font = '600 13px system-ui, -apple-system, "Segoe UI", sans-serif';
    const wide = context.measureText(label).width;
    const left = clamp(top.x + 14, 4, innerWidth - wide - 12);
    context.fillStyle = "rgb(13 20 29 / 72%)";
    context.beginPath();
    context.roundRect(left - 6, top.y - 12, wide + 12, 24, 7);
    context.fill();
    context.fillStyle = "#eef3f8";
    context.textBaseline = "middle";
    context.fillText(label, left, top.y + 0.5);
  }
}

/** @param {CanvasRenderingContext2D} context @param {Seen} from @param {Seen} to @param {string} style @param {number} width */
function line(context, from, to, style, width) {
  context.strokeStyle = style;
  context.lineWidth = width;
  context.beginPath();
  context.moveTo(from.x, from.y);
  context.lineTo(to.x, to.y);
  context.stroke();
}

/**
 * @param {CanvasRenderingContext2D} context @param {Seen} tail @param {Seen} tip @param {number[]} rgb @param {number} strength 0 to 1
 */
function drawArrow(context, tail, tip, rgb, strength) {
  const [dx, dy] = [tip.x - tail.x, tip.y - tail.y];
  const length = Math.hypot(dx, dy);
  const margin = 200;
  const outside = [tail, tip].every(({ x, y }) => x < -margin || y < -margin || x > innerWidth + margin || y > innerHeight + margin);
  if (length < 2 || outside || strength <= 0.02) {
    return;
  }
  const width = clamp(length / 26, 1, 3.2);
  const head = clamp(0.34 * length, 3, 16);
  const [ex, ey] = [dx / length, dy / length];
  const neck = { x: tip.x - 0.8 * head * ex, y: tip.y - 0.8 * head * ey, depth_m: tip.depth_m };
  // A dark edge, so that they stand out from bright cloud as from blue sky.
  line(context, tail, neck, `rgb(8 16 24 / ${0.5 * strength})`, width + 2);
  line(context, tail, neck, `rgb(${rgb.join(" ")} / ${strength})`, width);
  context.beginPath();
  context.moveTo(tip.x, tip.y);
  context.lineTo(tip.x - head * ex - 0.45 * head * ey, tip.y - head * ey + 0.45 * head * ex);
  context.lineTo(tip.x - head * ex + 0.45 * head * ey, tip.y - head * ey - 0.45 * head * ex);
  context.closePath();
  context.lineWidth = 1.5;
  context.strokeStyle = `rgb(8 16 24 / ${0.5 * strength})`;
  context.stroke();
  context.fillStyle = `rgb(${rgb.join(" ")} / ${strength})`;
  context.fill();
}
