// @ts-check
// Going to a new world: the scenes on offer, and the world that this tab has made.

/** @import { SceneSummary } from "./types.js" */

import { element } from "./panel.js";
import { ServerError, listScenes, request } from "./stream.js";

/** The worlds that this tab made outlive a reload of it, so that they can still be cleared away. */
const OWN_WORLD_KEY = "welkin.own-world";

/** The world that this tab has made, if it has. */
export const ownWorld = () => sessionStorage.getItem(OWN_WORLD_KEY);

/** See the module. */
export class Worlds {
  /** @param {(world: string) => void} go @param {(message: string) => void} notice */
  constructor(go, notice) {
    this.go = go;
    this.notice = notice;
    this.select = element("scene", HTMLSelectElement);
    /** @type {SceneSummary[]} */
    this.scenes = [];
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
   * Makes a world and goes there; then the one that this tab made before is no longer needed.
   * @param {string} preset
   */
  async make(preset) {
    let own = ownWorld();
    const make = () => request("POST", "/v1/worlds", { preset });
    const drop = async () => {
      if (own !== null) {
        const old = own;
        own = null;
        sessionStorage.removeItem(OWN_WORLD_KEY);
        // Gone already is as good; any other trouble is the server's to log.
        await request("DELETE", `/v1/worlds/${encodeURIComponent(old)}`).catch(() => null);
      }
    };
    let made;
    try {
      made = await make();
    } catch (error) {
      if (!(error instanceof ServerError) || error.code !== "too_many_worlds" || own === null) {
        throw error;
      }
      // This tab's own world takes the last place: give that up for the new one.
      await drop();
      made = await make();
    }
    this.go(made.id);
    await drop();
    sessionStorage.setItem(OWN_WORLD_KEY, made.id);
  }
}
