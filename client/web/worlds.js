// @ts-check
// Going to a new world: the scenes on offer, and the world that this tab has made.

/** @import { SceneSummary } from "./types.js" */

import { element } from "./panel.js";
import { ServerError, answered, listScenes, request } from "./stream.js";

/** The worlds that this tab made outlive a reload of it, so that they can still be cleared away. */
const OWN_WORLD_KEY = "welkin.own-world";

/** The world that this tab has made, if it has. */
export const ownWorld = () => sessionStorage.getItem(OWN_WORLD_KEY);

/** @param {string} world */
const pathOf = (world) => `/v1/worlds/${encodeURIComponent(world)}`;

/**
 * Ends a world. One that is gone already is as good; any other trouble is the server's to log.
 * @param {string} world
 */
const end = (world) => request("DELETE", pathOf(world)).catch(() => null);

/** See the module. */
export class Worlds {
  /** @param {(world: string) => void} go @param {(message: string) => void} notice */
  constructor(go, notice) {
    this.go = go;
    this.notice = notice;
    this.select = element("scene", HTMLSelectElement);
    /** @type {SceneSummary[]} */
    this.scenes = [];
    /** @type {string[]} what this tab made before, to be ended once another world is shown */
    this.left = [];
    this.select.addEventListener("change", () => void this.chosen());
  }

  /** Fills the list, once. */
  async fill() {
    if (this.scenes.length > 0) {
      return;
    }
    try {
      this.scenes = await listScenes();
      for (const scene of this.scenes) {
        const option = new Option(scene.name, scene.name);
        option.title = scene.description;
        this.select.add(option);
      }
    } catch (error) {
      this.notice(`The list of scenes could not be read: ${error instanceof Error ? error.message : error}`);
    }
  }

  async chosen() {
    const preset = this.select.value;
    const hint = element("scene-description", HTMLParagraphElement);
    hint.textContent = this.scenes.find((scene) => scene.name === preset)?.description ?? "";
    if (preset === "") {
      return;
    }
    this.select.disabled = true;
    try {
      await this.make(preset);
    } catch (error) {
      const full = error instanceof ServerError && error.code === "too_many_worlds";
      const why = error instanceof Error ? error.message : String(error);
      this.notice(
        full
          ? `The server runs as many worlds as it may, so “${preset}” was not started. Try again when one has ended. (${why})`
          : `“${preset}” could not be started: ${why}`,
      );
      this.select.value = "";
    } finally {
      this.select.disabled = false;
    }
  }

  /**
   * Makes a world and goes there; the one that this tab made before is ended when the new one is shown.
   * @param {string} preset
   */
  async make(preset) {
    const own = ownWorld();
    const make = () => request("POST", "/v1/worlds", { preset });
    let made;
    try {
      made = await make();
    } catch (error) {
      if (!(error instanceof ServerError) || error.code !== "too_many_worlds" || own === null) {
        throw error;
      }
      // This tab's own world takes the last place: give that up for the new one.
      sessionStorage.removeItem(OWN_WORLD_KEY);
      await end(own);
      made = await make();
    }
    const before = ownWorld();
    if (before !== null) {
      this.left.push(before);
    }
    sessionStorage.setItem(OWN_WORLD_KEY, made.id);
    this.go(made.id);
  }

  /**
   * Ends the worlds that were left, now that another is shown: each when nothing that was asked of it is without an answer.
   * @param {string} world that is shown
   */
  async arrived(world) {
    const leaving = this.left.filter((left) => left !== world);
    this.left = [];
    for (const left of leaving) {
      await answered(pathOf(left));
      await end(left);
    }
  }
}
