// @ts-check
// Moving the camera: flying with keys that are held, and going around a place while looking at it.

/** @import { Camera } from "./types.js" */

import { axes } from "./scenery.js";

/** Speed along each axis of the view, m/s, at the ground; it grows with height, and fivefold with the shift key. */
const SPEED_M_S = 120;
const SPEED_PER_S_OF_HEIGHT = 0.25;
const FAST = 5;
const LOWEST_M = 2;
const HIGHEST_M = 20_000;
/** A camera goes around a place so far ahead, m, unless the ground is nearer. */
const ORBIT_M = 3_000;

/** Keys, by their place on the keyboard: ahead, right, up. @type {Record<string, [number, number, number]>} */
const KEYS = {
  KeyW: [1, 0, 0],
  KeyS: [-1, 0, 0],
  KeyD: [0, 1, 0],
  KeyA: [0, -1, 0],
  KeyE: [0, 0, 1],
  KeyQ: [0, 0, -1],
};

/**
 * The place that a camera goes around: on its line of view.
 * @param {Camera} camera
 */
export function pivotDistance(camera) {
  const down = -axes(camera).ahead[2];
  const ground_m = down > 0.02 ? camera.position_m[2] / down : Infinity;
  return Math.min(ORBIT_M, Math.max(100, ground_m));
}

/**
 * The camera turned around the place at a distance ahead of it.
 * @param {Camera} camera
 * @param {number} azimuth_deg
 * @param {number} elevation_deg
 * @param {number} distance_m
 * @returns {Camera}
 */
export function around(camera, azimuth_deg, elevation_deg, distance_m) {
  const before = axes(camera).ahead;
  const turned = { ...camera, azimuth_deg, elevation_deg: Math.min(80, Math.max(-85, elevation_deg)) };
  const after = axes(turned).ahead;
  const [x, y, z] = camera.position_m.map((p, n) => p + distance_m * (before[n] - after[n]));
  return z < LOWEST_M ? camera : { ...turned, position_m: [x, y, Math.min(HIGHEST_M, z)] };
}

/** Flies while keys are held. */
export class Flight {
  /**
   * @param {HTMLElement} target that has the keyboard
   * @param {() => Camera | null} camera
   * @param {(camera: Camera) => void} fly
   */
  constructor(target, camera, fly) {
    this.camera = camera;
    this.fly = fly;
    /** @type {Set<string>} */
    this.held = new Set();
    this.fast = false;
    this.lastMs = 0;
    this.flying = false;
    target.addEventListener("keydown", (event) => {
      this.fast = event.shiftKey;
      if (!(event.code in KEYS) || event.ctrlKey || event.metaKey || event.altKey) {
        return;
      }
      event.preventDefault();
      this.held.add(event.code);
      if (!this.flying) {
        this.flying = true;
        this.lastMs = performance.now();
        requestAnimationFrame(() => this.step());
      }
    });
    target.addEventListener("keyup", (event) => {
      this.fast = event.shiftKey;
      this.held.delete(event.code);
    });
    target.addEventListener("blur", () => this.held.clear());
  }

  step() {
    const now = performance.now();
    const dt_s = Math.min(0.1, (now - this.lastMs) / 1000);
    this.lastMs = now;
    const camera = this.camera();
    if (this.held.size === 0 || camera === null) {
      this.flying = false;
      return;
    }
    const { ahead, right } = axes(camera);
    const wish = [0, 0, 0];
    for (const key of this.held) {
      const [forward, sideways, up] = KEYS[key];
      for (let n = 0; n < 3; n++) {
        wish[n] += forward * ahead[n] + sideways * right[n] + (n === 2 ? up : 0);
      }
    }
    const speed = (SPEED_M_S + SPEED_PER_S_OF_HEIGHT * camera.position_m[2]) * (this.fast ? FAST : 1);
    const [x, y, z] = camera.position_m.map((p, n) => p + wish[n] * speed * dt_s);
    this.fly({ ...camera, position_m: [x, y, Math.min(HIGHEST_M, Math.max(LOWEST_M, z))] });
    requestAnimationFrame(() => this.step());
  }
}
