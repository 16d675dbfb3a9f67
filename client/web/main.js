// @ts-check
// Ties the stream, the picture and the panel together.

/** @import { Camera, Command, Frame, Hello, Numbers } from "./types.js" */

import { Arrows } from "./arrows.js";
import { Controls } from "./controls.js";
import { Drawing } from "./drawing.js";
import { LatencyBoard, ServerClock } from "./latency.js";
import { Layers } from "./layers.js";
import { LookBack } from "./lookback.js";
import { Overlay } from "./overlay.js";
import { FollowingSlider, NumberBoard, element, readable } from "./panel.js";
import { Series } from "./series.js";
import { showGrowth, showHealth, showNotice, showStatus } from "./status.js";
import { FRAME_HEADER_VERSION, SkyStream, pathOf, request } from "./stream.js";
import { QUALITIES, SkyView, compassPoint } from "./view.js";
import { Worlds, ownWorld } from "./worlds.js";

const MAX_FPS = 8;

/** @type {Hello | null} */
let hello = null;
/** @type {Numbers | null} */
let numbers = null;
/** @type {number | null} simulated seconds of spin-up, where the server says so */
let spinUp_s = null;
let quality = 1;

const board = new NumberBoard();
const layers = new Layers();
const look = element("look", HTMLParagraphElement);
const view = new SkyView(element("sky", HTMLCanvasElement), askForFrames, cameraShown);
const overlay = new Overlay(view);
const stream = new SkyStream({
  hello: onHello,
  tick: onTick,
  // One that was under way when somebody began to look back is not shown.
  frame: (frame) => lookBack.ago_s > 0 || view.show(frame),
  error: showNotice,
  status: showStatus,
});
const controls = new Controls(command, showNotice);
const worlds = new Worlds((world) => stream.open(world), showNotice);
const clock = new ServerClock();
const latency = new LatencyBoard(element("latency-numbers", HTMLDivElement), clock);
/** @param {Frame} frame @param {number} decode_ms */
view.onDrawn = (frame, decode_ms) => latency.drawn(frame, decode_ms, numbers);

/** Who draws; exported so that a test can look at the fields that this page holds. */
export const drawing = new Drawing(
  element("sky-here", HTMLCanvasElement),
  element("draw", HTMLSelectElement),
  element("drawn-by", HTMLParagraphElement),
  {
    changed: (here) => {
      view.fitsWindow = here;
      overlay.changed();
      if (here) {
        stream.send({ type: "no_frames" });
        lookBack.draw();
      } else {
        askForFrames();
      }
    },
    drawn: (drawn) => {
      view.drawnMs.push(performance.now());
      latency.drawnHere(drawn, numbers);
    },
    field: (field) => lookBack.took(field),
    notice: showNotice,
  },
);
const lookBack = new LookBack(drawing, view, {
  turned: () => {
    askForFrames();
    void arrows.refresh();
  },
  size: () => view.frameSize(quality),
  notice: showNotice,
});
const arrows = new Arrows(overlay, () => lookBack.ago_s === 0);
const series = new Series(overlay, () => view.camera);

/** @param {Hello} message */
function onHello(message) {
  const another = hello === null || hello.world !== message.world || hello.scene !== message.scene;
  hello = message;
  element("scene-name", HTMLParagraphElement).textContent = message.scene;
  document.title = `${message.scene} · Welkin`;
  const km = message.cells.map((n, axis) => readable((n * message.cell_size_m[axis]) / 1000, 2));
  element("about", HTMLParagraphElement).textContent =
    `World ${message.world}: ${message.cells.join(" × ")} cells, ${km.join(" × ")} km. Server ${message.server}.`;
  if (another) {
    board.clear();
    spinUp_s = null;
    controls.ground = null;
    view.setCamera(message.camera);
    void learnScene(message.world);
  }
  lookBack.setWorld(message.world);
  drawing.setWorld(message.world);
  layers.setWorld(message);
  arrows.setWorld(message);
  series.setWorld(message);
  askForFrames();
  void clock.measure();
  void worlds.fill();
  void worlds.arrived(message.world);
}

/** @param {string} world */
async function learnScene(world) {
  try {
    const { scene } = await request("GET", pathOf(world));
    if (hello?.world === world) {
      const { latitude_deg, longitude_deg } = scene.domain;
      controls.ground = { latitude_deg, longitude_deg };
      spinUp_s = typeof scene.time?.spin_up_s === "number" ? scene.time.spin_up_s : null;
    }
  } catch {
    // The progress then counts minutes without saying of how many.
  }
}

/** @param {Numbers} now */
function onTick(now) {
  numbers = now;
  drawing.setNumbers(now);
  controls.follow(now);
  showHealth(now);
  showGrowth(now, spinUp_s);
  board.update(now);
  element("utc", HTMLSpanElement).textContent = now.utc.replace("T", " ").replace(/(\.\d+)?Z$/, " UTC");
  const parts = [now.paused ? "paused" : `${readable(now.speed, 2)} × real time`];
  if (now.cloud_cover !== null && now.cloud_cover !== undefined) {
    parts.push(`${readable(100 * now.cloud_cover, 2)} % cloud`);
  }
  element("panel-summary", HTMLSpanElement).textContent = parts.join(" · ");
}

/** Asks the server for what the camera sees: frames as they come, or the picture of what was. */
function askForFrames() {
  if (document.hidden || drawing.here || view.camera === null) {
    return;
  }
  if (lookBack.ago_s > 0) {
    stream.send({ type: "no_frames" });
    lookBack.draw();
    return;
  }
  const [width, height] = view.frameSize(quality);
  stream.send({
    type: "frames",
    width,
    height,
    format: "jpeg",
    max_fps: MAX_FPS,
    camera: view.camera,
    quality: "resting",
    header: FRAME_HEADER_VERSION,
  });
}

/** @param {Camera} camera */
function cameraShown(camera) {
  drawing.setCamera(camera);
  overlay.changed();
  const up = camera.elevation_deg;
  const height = camera.position_m[2];
  look.textContent =
    `${compassPoint(camera.azimuth_deg)} ${camera.azimuth_deg.toFixed(0)}°, ` +
    `${Math.abs(up).toFixed(0)}° ${up < 0 ? "down" : "up"}, ${height.toFixed(0)} m above ground`;
  fov.follow(camera.vertical_fov_deg);
}

/** @param {Command} command */
function command(command) {
  if (!stream.send({ type: "command", command })) {
    showNotice("Not connected: nothing was changed.");
  }
}

const fov = new FollowingSlider(
  "fov",
  (v) => `${v.toFixed(0)}°`,
  (v) => {
    if (view.camera !== null) {
      view.setCamera({ ...view.camera, vertical_fov_deg: v });
    }
  },
);

/**
 * The named places of the camera; the sideways place and the angle of view stay the scene's.
 * @param {string} place
 * @returns {Camera | null}
 */
function cameraAt(place) {
  if (hello === null) {
    return null;
  }
  const scene = hello.camera;
  const [x, y] = scene.position_m;
  const azimuth_deg = view.camera?.azimuth_deg ?? scene.azimuth_deg;
  const top_m = numbers?.cloud_top_m ?? 0.6 * hello.cells[2] * hello.cell_size_m[2];
  switch (place) {
    case "ground":
      return { ...scene, position_m: [x, y, 2], azimuth_deg, elevation_deg: 20 };
    case "aloft":
      return { ...scene, position_m: [x, y, 500], azimuth_deg, elevation_deg: 10 };
    case "above":
      return { ...scene, position_m: [x, y, top_m + 800], azimuth_deg, elevation_deg: -30 };
    case "up":
      return { ...scene, position_m: [x, y, 2], azimuth_deg, elevation_deg: 90, vertical_fov_deg: 90 };
    default:
      return scene;
  }
}

for (const button of document.querySelectorAll("button[data-place]")) {
  button.addEventListener("click", () => {
    const camera = cameraAt(/** @type {HTMLButtonElement} */ (button).dataset.place ?? "scene");
    if (camera !== null) {
      fov.release();
      view.setCamera(camera);
    }
  });
}

const dragSelect = element("drag", HTMLSelectElement);
dragSelect.addEventListener("change", () => (view.orbits = dragSelect.value === "orbit"));

element("save", HTMLButtonElement).addEventListener("click", async () => {
  let png = null;
  let tick = view.shownTick?.toString() ?? null;
  if (drawing.here) {
    const captured = await drawing.sky?.capture();
    png = captured?.png ?? null;
    tick = captured?.tick ?? null;
  } else {
    png = await new Promise((resolve) => view.canvas.toBlob(resolve, "image/png"));
  }
  if (png === null || png === undefined) {
    const why = drawing.here ? drawing.sky?.lacks : null;
    showNotice(why ? `There is no picture yet: ${why}.` : "There is no picture yet.");
    return;
  }
  const link = document.createElement("a");
  link.href = URL.createObjectURL(png);
  link.download = `welkin-${hello?.world ?? "sky"}-tick-${tick ?? "none"}.png`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
});

const qualitySelect = element("quality", HTMLSelectElement);
QUALITIES.forEach(([width, height], index) => qualitySelect.add(new Option(`${width} × ${height}`, String(index))));
qualitySelect.value = String(quality);
qualitySelect.addEventListener("change", () => {
  quality = Number(qualitySelect.value);
  askForFrames();
});

const toggle = element("panel-toggle", HTMLButtonElement);
/** @param {boolean} open */
function setPanel(open) {
  toggle.setAttribute("aria-expanded", String(open));
  element("panel-body", HTMLDivElement).hidden = !open;
}
toggle.addEventListener("click", () => setPanel(toggle.getAttribute("aria-expanded") !== "true"));
// On a phone the sky comes first.
setPanel(innerWidth > 640);

document.addEventListener("visibilitychange", () => {
  drawing.setVisible(!document.hidden);
  if (document.hidden) {
    stream.send({ type: "no_frames" });
  } else {
    askForFrames();
  }
});

let upright = innerWidth < innerHeight;
addEventListener("resize", () => {
  if (upright !== innerWidth < innerHeight) {
    upright = !upright;
    askForFrames();
  }
});

setInterval(() => {
  const dropped = view.dropped > 0 ? `, ${view.dropped} overtaken` : "";
  lookBack.say();
  board.frames.textContent = `${view.framesPerSecond.toFixed(1)} /s`;
  const shown = drawing.here ? drawing.canvas : view.canvas;
  board.frames.title = `${shown.width} × ${shown.height}${dropped}`;
}, 1000);

stream.open(new URLSearchParams(location.search).get("world") ?? ownWorld());
