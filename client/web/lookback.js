// @ts-check
// Looking back over the last minutes: by the slider, drawn here of a volume or by the server as a picture, while the world goes on.

/** @import { Camera, VolumeField } from "./types.js" */
/** @import { Drawing } from "./drawing.js" */
/** @import { SkyView } from "./view.js" */

import { duration, element } from "./panel.js";
import { Past } from "./past.js";
import { ServerError, ask, pathOf, request } from "./stream.js";
import { fetchField } from "./volume.js";

/** The server is asked what it has kept this often, and before a look when the list is older than that. */
const LEARN_EVERY_MS = 10_000;
const LEARN_AGAIN_MS = 1_500;

/** See the module. */
export class LookBack {
  /**
   * @param {Drawing} drawing
   * @param {SkyView} view
   * @param {{turned: () => void, size: () => [number, number], notice: (message: string) => void}} handlers `turned` when somebody begins or ends to look back, `size` of the server's pictures
   */
  constructor(drawing, view, handlers) {
    this.drawing = drawing;
    this.view = view;
    this.handlers = handlers;
    this.past = new Past();
    this.slider = element("past", HTMLInputElement);
    this.output = element("past-out", HTMLOutputElement);
    /** How far is looked back, s; 0 shows what comes. */
    this.ago_s = 0;
    /** @type {string | null} */
    this.world = null;
    this.learnedMs = -Infinity;
    this.busy = false;
    this.due = false;
    /** @type {{published_unix_s: number, simulated_s: number} | null} */
    this.shown = null;
    this.slider.addEventListener("input", () => this.look(-this.slider.valueAsNumber));
    setInterval(() => void this.learn(LEARN_EVERY_MS), 1_000);
  }

  /** @param {string} world */
  setWorld(world) {
    if (this.world !== world) {
      this.world = world;
      this.past.clear();
      this.release();
    }
    void this.learn(0);
  }

  /** @param {VolumeField} field that has come */
  took(field) {
    this.past.push(field);
  }

  /** Shows what comes, from now on. */
  release() {
    this.slider.value = "0";
    this.ago_s = 0;
    this.shown = null;
    this.drawing.sky?.showPast(null);
    this.say();
  }

  /**
   * Asks the server what it has kept, unless that was done a while ago.
   * @param {number} older_ms
   */
  async learn(older_ms) {
    const { world } = this;
    if (world === null || document.hidden || performance.now() - this.learnedMs < older_ms) {
      return;
    }
    this.learnedMs = performance.now();
    try {
      const report = await request("GET", `${pathOf(world)}/past`);
      if (this.world === world) {
        this.past.learn(report.moments);
        this.say();
      }
    } catch {
      // What this page has seen is there all the same, and the list is asked for again.
    }
  }

  /** @param {number} ago_s */
  look(ago_s) {
    const before = this.ago_s;
    this.ago_s = ago_s;
    if (ago_s === 0) {
      this.release();
    }
    if (ago_s > 0 !== before > 0) {
      this.handlers.turned();
    }
    this.draw();
    this.say();
  }

  /** Draws the moment that is looked at, by the camera of now; called again meanwhile, it draws once more. */
  draw() {
    if (this.ago_s === 0) {
      return;
    }
    if (this.busy) {
      this.due = true;
      return;
    }
    this.busy = true;
    void this.drawOnce()
      .catch((error) => this.handlers.notice(error instanceof Error ? error.message : String(error)))
      .finally(() => {
        this.busy = false;
        if (this.due) {
          this.draw();
        }
      });
  }

  async drawOnce() {
    this.due = false;
    await this.learn(LEARN_AGAIN_MS);
    const { world, ago_s } = this;
    const moment = this.past.at(ago_s);
    if (world === null || moment === null || ago_s === 0) {
      return;
    }
    const { sky, here } = this.drawing;
    try {
      if (here && sky !== null) {
        const field = moment.field ?? (await this.fetchMoment(world, moment.tick));
        if (this.world === world && this.ago_s > 0) {
          sky.showPast(field);
        }
      } else if (this.view.camera !== null) {
        const picture = await fetchPicture(world, moment.tick, this.view.camera, this.handlers.size());
        if (this.world === world && this.ago_s > 0) {
          this.view.showPicture(picture, moment.tick);
        }
      }
      this.shown = moment;
      this.say();
    } catch (error) {
      // The oldest moment may have been forgotten between the list and the question.
      if (!(error instanceof ServerError) || error.code !== "too_old") {
        throw error;
      }
      this.learnedMs = -Infinity;
      this.due = true;
    }
  }

  /** @param {string} world @param {number} tick */
  async fetchMoment(world, tick) {
    const field = await fetchField(`${pathOf(world)}/past.bin?tick=${tick}`);
    this.past.hold(tick, field);
    return field;
  }

  /** Says what the slider shows. */
  say() {
    const span_s = Math.floor(this.past.span_s);
    this.slider.disabled = span_s < 1;
    this.slider.min = String(-Math.max(1, span_s));
    const text =
      span_s < 1
        ? "–"
        : this.ago_s === 0
          ? "live"
          : `${duration(this.ago_s)} ago` + (this.shown === null ? "" : `, ${duration(this.shown.simulated_s)} simulated`);
    if (this.output.textContent !== text) {
      this.output.textContent = text;
      this.slider.setAttribute("aria-valuetext", text);
    }
  }
}

/**
 * The server's picture of a moment that it has kept.
 * @param {string} world @param {number} tick @param {Camera} camera @param {[number, number]} size
 */
async function fetchPicture(world, tick, camera, [width, height]) {
  const { position_m, azimuth_deg, elevation_deg, vertical_fov_deg, exposure_ev } = camera;
  const [x_m, y_m, z_m] = position_m;
  const wanted = { tick, width, height, x_m, y_m, z_m, azimuth_deg, elevation_deg, vertical_fov_deg, exposure_ev: exposure_ev ?? 0 };
  const query = new URLSearchParams(Object.entries(wanted).map(([name, value]) => [name, String(value)]));
  return (await ask("GET", `${pathOf(world)}/frame?${query}`)).blob();
}
