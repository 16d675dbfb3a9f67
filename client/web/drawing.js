// @ts-check
// Who draws the sky: this computer, where WebGPU finds a GPU, or the server. The page says which, and why.

/** @import { Camera, Numbers, VolumeField } from "./types.js" */
/** @import { Drawn } from "./local.js" */

import { LocalSky, openDevice } from "./local.js";

/** @typedef {"auto" | "here" | "server"} Choice */

/** @param {string | null} value @returns {value is Choice} */
const isChoice = (value) => value === "auto" || value === "here" || value === "server";

/** See the module. */
export class Drawing {
  /**
   * @param {HTMLCanvasElement} canvas the one that is drawn into here
   * @param {HTMLSelectElement} select
   * @param {HTMLElement} note
   * @param {{changed: (here: boolean) => void, drawn: (drawn: Drawn) => void, field: (field: VolumeField) => void, notice: (message: string) => void}} handlers `changed` when the other one draws from now on, `field` of each volume that comes
   */
  constructor(canvas, select, note, handlers) {
    this.canvas = canvas;
    this.select = select;
    this.note = note;
    this.handlers = handlers;
    /** Whether pictures are drawn here now. */
    this.here = false;
    /** @type {ReturnType<typeof openDevice> | null} asked for once; a string says why there is none */
    this.opening = null;
    /** @type {Promise<LocalSky | string> | null} made once, when it is needed */
    this.making = null;
    /** @type {LocalSky | null} */
    this.sky = null;
    /** @type {string | null} */
    this.world = null;
    /** @type {Camera | null} */
    this.camera = null;
    this.visible = true;
    const asked = new URLSearchParams(location.search).get("draw");
    select.value = isChoice(asked) ? asked : "auto";
    select.addEventListener("change", () => void this.decide());
    this.say("the server");
  }

  /** @param {string} who @param {string} [why] */
  say(who, why) {
    const text = why === undefined ? `Drawn by ${who}.` : `Drawn by ${who}: ${why}.`;
    if (this.note.textContent !== text) {
      this.note.textContent = text;
    }
  }

  /** @returns {Choice} */
  get choice() {
    return isChoice(this.select.value) ? this.select.value : "auto";
  }

  /** @param {string} world that is shown from now on */
  setWorld(world) {
    this.world = world;
    void this.decide();
  }

  /** @param {Camera} camera */
  setCamera(camera) {
    this.camera = camera;
    this.sky?.setCamera(camera);
  }

  /** @param {Numbers} numbers */
  setNumbers(numbers) {
    this.numbers = numbers;
    this.sky?.setNumbers(numbers);
  }

  /** @param {boolean} visible a page that nobody sees draws nothing */
  setVisible(visible) {
    this.visible = visible;
    void this.decide();
  }

  /** Finds out who draws, and lets them. */
  async decide() {
    const { world, choice } = this;
    if (choice === "server" || world === null || !this.visible) {
      this.sky?.stop();
      this.serverDraws();
      return;
    }
    const stale = () => this.world !== world || this.choice !== choice || !this.visible;
    this.opening ??= openDevice().catch((error) => (error instanceof Error ? error.message : String(error)));
    const gpu = await this.opening;
    if (stale()) {
      return; // decided anew meanwhile
    }
    if (typeof gpu === "string") {
      this.serverDraws(gpu);
      return;
    }
    if (choice === "auto" && gpu.software) {
      this.sky?.stop();
      this.serverDraws(`WebGPU is here, but computes on the processor (${gpu.name})`);
      return;
    }
    if (this.making === null) {
      this.say("the server", `kernels are being compiled for ${gpu.name}`);
      this.making = this.make(gpu);
    }
    const sky = await this.making;
    if (stale()) {
      return;
    }
    if (typeof sky === "string") {
      this.serverDraws(sky);
      return;
    }
    this.sky = sky;
    if (this.camera !== null) {
      sky.setCamera(this.camera);
    }
    if (this.numbers !== undefined) {
      sky.setNumbers(this.numbers);
    }
    await sky.start(world);
  }

  /** @param {{device: GPUDevice, name: string}} gpu @returns {Promise<LocalSky | string>} */
  async make(gpu) {
    try {
      return await LocalSky.make(this.canvas, gpu, {
        drawn: (drawn) => this.drawn(drawn),
        field: (field) => this.handlers.field(field),
        trouble: (why) => this.trouble(why),
      });
    } catch (error) {
      return error instanceof Error ? error.message : String(error);
    }
  }

  /** @param {Drawn} drawn */
  drawn(drawn) {
    if (this.sky === null || !this.sky.running) {
      return;
    }
    this.say("this computer", this.sky.name);
    if (!this.here) {
      this.here = true;
      this.canvas.hidden = false;
      document.body.dataset.drawn = "here";
      this.handlers.changed(true);
    }
    this.handlers.drawn(drawn);
  }

  /** @param {string} why */
  trouble(why) {
    if (this.here && this.sky?.running) {
      this.handlers.notice(why); // what is shown goes on
      return;
    }
    if (this.sky !== null && !this.sky.running) {
      // Its GPU may be gone: the next choice begins anew.
      this.sky = null;
      this.making = null;
      this.opening = null;
    }
    this.serverDraws(why);
  }

  /** @param {string} [why] */
  serverDraws(why) {
    this.say("the server", why);
    document.body.dataset.drawn = "server";
    if (this.here) {
      this.here = false;
      this.canvas.hidden = true;
      this.handlers.changed(false);
    }
  }
}
