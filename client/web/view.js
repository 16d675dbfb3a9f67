// @ts-check
// The picture: draws the newest frame, and turns drags, keys and the wheel into a camera.

/** @import { Camera, Frame } from "./types.js" */

import { Flight, around, pivotDistance } from "./flight.js";

/** Frame sizes on offer, pixels of a picture that is wider than high. */
export const QUALITIES = [
  [320, 180],
  [640, 360],
  [960, 540],
  [1280, 720],
];

const FOV_MIN_DEG = 10;
const FOV_MAX_DEG = 110;
const KEY_STEP_DEG = 3;
/** A camera that moves is sent at most so often. */
const SEND_INTERVAL_MS = 100;
const COMPASS = ["N", "NE", "E", "SE", "S", "SW", "W", "NW"];

/** @param {number} value @param {number} low @param {number} high */
export const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

/** @param {number} azimuth_deg */
export function compassPoint(azimuth_deg) {
  return COMPASS[Math.round(azimuth_deg / 45) % 8];
}

/** The canvas and the camera behind it. */
export class SkyView {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {(camera: Camera) => void} cameraMoved called at most ten times a second, and once more when the move ends
   * @param {(camera: Camera) => void} cameraShown called for every change, for read-outs
   */
  constructor(canvas, cameraMoved, cameraShown) {
    this.canvas = canvas;
    this.context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { alpha: false }));
    this.cameraMoved = cameraMoved;
    this.cameraShown = cameraShown;
    /** @type {Camera | null} */
    this.camera = null;
    /** @type {{image: Blob, tick: number, frame: Frame | null} | null} the newest picture that waits for the decoder; null for one that is no frame of the stream */
    this.waiting = null;
    this.decoding = false;
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.sendTimer = undefined;
    this.lastSentMs = -Infinity;
    /** @type {Map<number, {x: number, y: number}>} */
    this.pointers = new Map();
    /** @type {number[]} times at which pictures were drawn */
    this.drawnMs = [];
    this.dropped = 0;
    /** @type {number | null} the tick of the server's picture */
    this.shownTick = null;
    /** Whether drags go around what is looked at instead of turning the view. */
    this.orbits = false;
    /** @type {number | null} how far away that is, as long as a drag lasts */
    this.orbitDistance_m = null;
    /** Whether the picture fills the window as it is: one that is drawn here does. */
    this.fitsWindow = false;
    /** @type {((frame: Frame, decode_ms: number) => void) | null} */
    this.onDrawn = null;
    this.listen();
  }

  /** Pictures drawn a second, over the last three seconds. */
  get framesPerSecond() {
    const since = performance.now() - 3000;
    this.drawnMs = this.drawnMs.filter((t) => t > since);
    return this.drawnMs.length / 3;
  }

  /**
   * The size to ask for: the chosen one, turned upright where the window is.
   * @param {number} quality index in QUALITIES
   * @returns {[number, number]}
   */
  frameSize(quality) {
    const [long, short] = QUALITIES[quality];
    return innerWidth >= innerHeight ? [long, short] : [short, long];
  }

  /** @param {Camera} camera */
  setCamera(camera) {
    this.camera = {
      ...camera,
      azimuth_deg: ((camera.azimuth_deg % 360) + 360) % 360,
      elevation_deg: clamp(camera.elevation_deg, -90, 90),
      vertical_fov_deg: clamp(camera.vertical_fov_deg, FOV_MIN_DEG, FOV_MAX_DEG),
    };
    this.cameraShown(this.camera);
    this.scheduleSend();
  }

  scheduleSend() {
    if (this.sendTimer !== undefined) {
      return;
    }
    const wait = Math.max(0, this.lastSentMs + SEND_INTERVAL_MS - performance.now());
    this.sendTimer = setTimeout(() => {
      this.sendTimer = undefined;
      this.lastSentMs = performance.now();
      if (this.camera !== null) {
        this.cameraMoved(this.camera);
      }
    }, wait);
  }

  /**
   * Shows a frame; one that a newer frame overtakes before it is decoded is never shown.
   * @param {Frame} frame
   */
  show(frame) {
    this.decode({ image: new Blob([frame.image], { type: frame.mime }), tick: frame.tick, frame });
  }

  /**
   * Shows a picture that did not come by the stream.
   * @param {Blob} image @param {number} tick
   */
  showPicture(image, tick) {
    this.decode({ image, tick, frame: null });
  }

  /** @param {{image: Blob, tick: number, frame: Frame | null}} picture */
  decode(picture) {
    if (this.waiting !== null) {
      this.dropped += 1;
    }
    this.waiting = picture;
    if (!this.decoding) {
      void this.decodeWaiting();
    }
  }

  async decodeWaiting() {
    this.decoding = true;
    while (this.waiting !== null) {
      const { image, tick, frame } = this.waiting;
      this.waiting = null;
      const began = performance.now();
      try {
        const bitmap = await createImageBitmap(image);
        if (this.canvas.width !== bitmap.width || this.canvas.height !== bitmap.height) {
          this.canvas.width = bitmap.width;
          this.canvas.height = bitmap.height;
        }
        this.context.drawImage(bitmap, 0, 0);
        bitmap.close();
        this.shownTick = tick;
        this.drawnMs.push(performance.now());
        if (frame !== null) {
          this.onDrawn?.(frame, performance.now() - began);
        }
      } catch (error) {
        console.warn("a frame could not be decoded", error);
      }
    }
    this.decoding = false;
  }

  /** Pixels of the window that the whole picture is high: the server's covers the window, so it may be higher than what is seen of it. */
  get pictureHeight() {
    const scale = Math.max(innerWidth / this.canvas.width, innerHeight / this.canvas.height);
    return this.fitsWindow ? innerHeight : this.canvas.height * scale;
  }

  /** @param {number} dx pixels to the right @param {number} dy pixels down */
  turnByPixels(dx, dy) {
    if (this.camera === null) {
      return;
    }
    const degreesPerPixel = this.camera.vertical_fov_deg / this.pictureHeight;
    // Near the zenith a turn of the azimuth moves the picture less; follow the finger, within reason.
    const spread = Math.max(0.2, Math.cos((this.camera.elevation_deg * Math.PI) / 180));
    const azimuth_deg = this.camera.azimuth_deg - (dx * degreesPerPixel) / spread;
    const elevation_deg = this.camera.elevation_deg + dy * degreesPerPixel;
    if (this.orbits) {
      // A third of a turn for a width of the window: what is looked at stays in the middle.
      this.orbitDistance_m ??= pivotDistance(this.camera);
      const turn = 120 / innerWidth;
      const { azimuth_deg: a, elevation_deg: e } = this.camera;
      this.setCamera(around(this.camera, a + dx * turn, e - dy * turn, this.orbitDistance_m));
    } else {
      this.setCamera({ ...this.camera, azimuth_deg, elevation_deg });
    }
  }

  /** @param {number} factor above 1 widens the angle of view */
  zoom(factor) {
    if (this.camera !== null) {
      this.setCamera({ ...this.camera, vertical_fov_deg: this.camera.vertical_fov_deg * factor });
    }
  }

  listen() {
    const canvas = this.canvas;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      canvas.classList.add("dragging");
      this.orbitDistance_m = null;
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = this.pointers.get(event.pointerId);
      if (before === undefined) {
        return;
      }
      const spreadBefore = this.fingerSpread();
      this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      const spreadAfter = this.fingerSpread();
      if (spreadBefore !== null && spreadAfter !== null) {
        this.zoom(spreadBefore / Math.max(1, spreadAfter));
      } else {
        this.turnByPixels(event.clientX - before.x, event.clientY - before.y);
      }
    });
    /** @param {PointerEvent} event */
    const release = (event) => {
      this.pointers.delete(event.pointerId);
      if (this.pointers.size === 0) {
        canvas.classList.remove("dragging");
      }
    };
    canvas.addEventListener("pointerup", release);
    canvas.addEventListener("pointercancel", release);
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 20 : 1;
        this.zoom(Math.exp(clamp(event.deltaY * lines, -300, 300) / 600));
      },
      { passive: false },
    );
    canvas.addEventListener("keydown", (event) => this.key(event));
    this.flight = new Flight(canvas, () => this.camera, (camera) => this.setCamera(camera));
  }

  /** Distance of two fingers in pixels; null unless there are two. */
  fingerSpread() {
    if (this.pointers.size !== 2) {
      return null;
    }
    const [a, b] = [...this.pointers.values()];
    return Math.hypot(a.x - b.x, a.y - b.y);
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (this.camera === null || event.ctrlKey || event.metaKey || event.altKey) {
      return;
    }
    const step = event.shiftKey ? 4 * KEY_STEP_DEG : KEY_STEP_DEG;
    const camera = { ...this.camera };
    if (event.key === "ArrowLeft") {
      camera.azimuth_deg -= step;
    } else if (event.key === "ArrowRight") {
      camera.azimuth_deg += step;
    } else if (event.key === "ArrowUp") {
      camera.elevation_deg += step;
    } else if (event.key === "ArrowDown") {
      camera.elevation_deg -= step;
    } else if (event.key === "+" || event.key === "=") {
      camera.vertical_fov_deg /= 1.1;
    } else if (event.key === "-") {
      camera.vertical_fov_deg *= 1.1;
    } else {
      return;
    }
    event.preventDefault();
    this.setCamera(camera);
  }
}
