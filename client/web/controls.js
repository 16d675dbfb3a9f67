// @ts-check
// What a visitor may change of the world: its pace and its sun.

/** @import { Command, Numbers } from "./types.js" */

import { FollowingSlider, element, readable } from "./panel.js";
import { sunPosition, timeOfDay } from "./sun.js";
import { compassPoint } from "./view.js";

/** See the module. */
export class Controls {
  /** @param {(command: Command) => void} command @param {(message: string) => void} notice */
  constructor(command, notice) {
    /** @type {Numbers | null} */
    this.numbers = null;
    /** @type {{latitude_deg: number, longitude_deg: number} | null} where on Earth the world is */
    this.ground = null;
    this.pause = element("pause", HTMLButtonElement);
    this.pause.addEventListener("click", () => command({ command: this.numbers?.paused ? "resume" : "pause" }));
    this.timeScale = new FollowingSlider(
      "time-scale",
      (v) => `${readable(10 ** v, 2)} ×`,
      (v) => command({ command: "time_scale", time_scale: Number((10 ** v).toPrecision(3)) }),
    );
    const byHand = () => {
      // Both sliders belong to one command: hold both.
      this.elevation.heldUntilMs = this.azimuth.heldUntilMs = performance.now() + 1_500;
      const [elevation_deg, azimuth_deg] = [this.elevation.input.valueAsNumber, this.azimuth.input.valueAsNumber];
      command({ command: "sun", sun: { from: "fixed", elevation_deg, azimuth_deg } });
    };
    const release = () => {
      this.elevation.release();
      this.azimuth.release();
    };
    this.elevation = new FollowingSlider("sun-elevation", (v) => `${v.toFixed(1)}°`, byHand);
    this.azimuth = new FollowingSlider("sun-azimuth", (v) => `${compassPoint(v)} ${v.toFixed(0)}°`, byHand);
    this.hour = new FollowingSlider(
      "time-of-day",
      (hours) => {
        const minutes = Math.round(60 * hours);
        return `${String(Math.floor(minutes / 60)).padStart(2, "0")}:${String(minutes % 60).padStart(2, "0")} UTC`;
      },
      (hours) => {
        const { ground, numbers } = this;
        if (ground === null || numbers === null) {
          notice("Where the world lies on Earth is not known yet.");
          return;
        }
        const at = timeOfDay(numbers.utc, hours);
        const { elevation_deg, azimuth_deg } = sunPosition(at, ground.latitude_deg, ground.longitude_deg);
        release();
        command({ command: "sun", sun: { from: "fixed", elevation_deg, azimuth_deg } });
      },
    );
    element("sun-clock", HTMLButtonElement).addEventListener("click", () => {
      release();
      command({ command: "sun", sun: { from: "clock" } });
    });
  }

  /** @param {Numbers} now */
  follow(now) {
    this.numbers = now;
    this.pause.textContent = now.paused ? "Resume" : "Pause";
    this.pause.setAttribute("aria-pressed", String(now.paused));
    this.timeScale.follow(Math.log10(now.time_scale));
    this.elevation.follow(now.sun_elevation_deg);
    this.azimuth.follow(now.sun_azimuth_deg);
    if (this.ground === null) {
      return;
    }
    // The hour follows the clock as long as the sun does: one that was placed by hand leaves the slider where it is.
    const byClock = sunPosition(Date.parse(now.utc) / 1000, this.ground.latitude_deg, this.ground.longitude_deg);
    if (Math.abs(byClock.elevation_deg - now.sun_elevation_deg) < 0.2) {
      this.hour.follow((Date.parse(now.utc) - Date.parse(`${now.utc.slice(0, 10)}T00:00:00Z`)) / 3_600_000);
    }
  }
}
