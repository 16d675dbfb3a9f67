// @ts-check
// Going to a new world: the scenes on offer, and the world that this tab has made.

/** @import { SceneSummary } from "./types.js" */

import { element } from "./panel.js";
import { ServerError, answered, listScenes, pathOf, request } from "./stream.js";

/** The worlds that this tab made outlive a reload of it, so that they can still be cleared away: their ids, oldest first, a space between. */
const OWN_WORLDS_KEY = "welkin.own-world";
const ownWorlds = () => (sessionStorage.getItem(OWN_WORLDS_KEY) ?? "").split(" ").filter((id) => id !== "");
/** @param {string[]} ids */
const keep = (ids) => sessionStorage.setItem(OWN_WORLDS_KEY, ids.join(" "));

/** The world that this tab has made last, if it has. */
export const ownWorld = () => ownWorlds().at(-1) ?? null;

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
    const make = () => request("POST", "/v1/worlds", { preset });
    let made;
    try {
      made = await make();
    } catch (error) {
      const own = ownWorld();
      if (!(error instanceof ServerError) || error.code !== "too_many_worlds" || own === null) {
        throw error;
      }
      // This tab's own world takes the last place: give that up for the new one.
      keep(ownWorlds().slice(0, -1));
      await end(own);
      made = await make();
    }
    keep([...ownWorlds(), made.id]);
    this.go(made.id);
  }

  /**
   * Ends the worlds that this tab made before its last and that are not shown: each when nothing that was asked of it is without an answer.
   * @param {string} world that is shown
   */
  async arrived(world) {
    const leaving = ownWorlds().slice(0, -1).filter((own) => own !== world);
    keep(ownWorlds().filter((own) => !leaving.includes(own)));
    for (const left of leaving) {
      await answered(pathOf(left));
      await end(left);
    }
  }
}
