// @ts-check
// Ties the stream, the picture and the panel together.

/** @import { Camera, Command, Frame, Hello, Numbers, SceneSummary, Status } from "./types.js" */

import { Drawing } from "./drawing.js";
import { Layers } from "./layers.js";
import { FollowingSlider, NumberBoard, duration, element, readable } from "./panel.js";
import { LatencyBoard, ServerClock } from "./latency.js";
import { FRAME_HEADER_VERSION, ServerError, SkyStream, listScenes, request } from "./stream.js";
import { sunPosition, timeOfDay } from "./sun.js";
import { QUALITIES, SkyView, compassPoint } from "./view.js";

const MAX_FPS = 8;
/** The worlds that this tab made outlive a reload of it, so that they can still be cleared away. */
const OWN_WORLD_KEY = "welkin.own-world";

/** @type {Hello | null} */
let hello = null;
/** @type {Numbers | null} */
let numbers = null;
/** @type {number | null} simulated seconds of spin-up, where the server says so */
let spinUp_s = null;
/** @type {{latitude_deg: number, longitude_deg: number} | null} where on Earth the world is */
let ground = null;
/** @type {SceneSummary[]} */
let scenes = [];
let quality = 1;
let creating = false;

const board = new NumberBoard();
const layers = new Layers();
const banner = element("banner", HTMLDivElement);
const notice = element("notice", HTMLDivElement);
const noticeText = element("notice-text", HTMLSpanElement);
const pauseButton = element("pause", HTMLButtonElement);
const sceneSelect = element("scene", HTMLSelectElement);
const qualitySelect = element("quality", HTMLSelectElement);
const look = element("look", HTMLParagraphElement);

const view = new SkyView(element("sky", HTMLCanvasElement), askForFrames, cameraShown);
const stream = new SkyStream({ hello: onHello, tick: onTick, frame: (f) => view.show(f), error: showNotice, status: onStatus });

const clock = new ServerClock();
const latency = new LatencyBoard(element("latency-numbers", HTMLDivElement), clock);
/** @param {Frame} frame @param {number} decode_ms */
view.onDrawn = (frame, decode_ms) => latency.drawn(frame, decode_ms, numbers);

const drawing = new Drawing(
  element("sky-here", HTMLCanvasElement),
  element("draw", HTMLSelectElement),
  element("drawn-by", HTMLParagraphElement),
  {
    changed: (here) => {
      view.fitsWindow = here;
      past.value = "0";
      showPast();
      if (here) {
        stream.send({ type: "no_frames" });
      } else {
        askForFrames();
      }
    },
    drawn: (drawn) => {
      view.drawnMs.push(performance.now());
      latency.drawnHere(drawn, numbers);
    },
    notice: showNotice,
  },
);

/** @type {ReturnType<typeof setTimeout> | undefined} */
let noticeTimer;

/** @param {string} message */
function showNotice(message) {
  noticeText.textContent = message;
  notice.hidden = false;
  clearTimeout(noticeTimer);
  noticeTimer = setTimeout(() => (notice.hidden = true), 12_000);
}

element("notice-close", HTMLButtonElement).addEventListener("click", () => (notice.hidden = true));

/** @param {Status} status */
function onStatus(status) {
  document.body.dataset.connection = status.state;
  if (status.state === "live") {
    banner.hidden = true;
  } else if (status.state === "lost") {
    const seconds = `Connection lost — trying again in ${status.retry_s} s`;
    const text = `${seconds} (${status.why})`;
    if (banner.textContent !== text) {
      banner.textContent = text;
    }
    banner.hidden = false;
  } else if (!banner.hidden) {
    banner.textContent = "Connection lost — trying again now";
  }
}

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
    ground = null;
    view.setCamera(message.camera);
    void learnSpinUp(message.world);
  }
  drawing.setWorld(message.world);
  layers.setWorld(message);
  askForFrames();
  void clock.measure();
  void fillScenes();
}

/** @param {string} world */
async function learnSpinUp(world) {
  try {
    const state = await request("GET", `/v1/worlds/${encodeURIComponent(world)}`);
    if (hello?.world === world) {
      const { latitude_deg, longitude_deg } = state.scene.domain;
      ground = { latitude_deg, longitude_deg };
    }
    const seconds = state?.scene?.time?.spin_up_s;
    if (typeof seconds === "number" && hello?.world === world) {
      spinUp_s = seconds;
    }
  } catch {
    // The progress then counts minutes without saying of how many.
  }
}

const HEALTH_TEXT = {
  good: "",
  degraded: "Degraded: the sky went back to an earlier moment and goes on.",
  halted: "Halted: the simulation failed and stands at its last good moment. Resume tries again.",
};

/** @param {Numbers} now */
function showHealth(now) {
  const box = element("health", HTMLParagraphElement);
  const state = now.health ?? "good";
  box.hidden = state === "good";
  box.dataset.state = state;
  // Written only when it changes, so that a screen reader says it once.
  for (const [id, text] of [
    ["health-state", HEALTH_TEXT[state]],
    ["health-reason", state === "good" ? "" : `${now.trouble_message ?? ""} (${now.trouble_code ?? "no code"})`],
  ]) {
    const line = element(id, HTMLSpanElement);
    if (line.textContent !== text) {
      line.textContent = text;
    }
  }
}

/** @param {Numbers} now */
function onTick(now) {
  numbers = now;
  drawing.setNumbers(now);
  showHealth(now);
  board.update(now);
  element("utc", HTMLSpanElement).textContent = now.utc.replace("T", " ").replace(/(\.\d+)?Z$/, " UTC");
  pauseButton.textContent = now.paused ? "Resume" : "Pause";
  pauseButton.setAttribute("aria-pressed", String(now.paused));
  timeScale.follow(Math.log10(now.time_scale));
  sunElevation.follow(now.sun_elevation_deg);
  sunAzimuth.follow(now.sun_azimuth_deg);
  followTimeOfDay(now);
  const box = element("spin-up", HTMLDivElement);
  box.hidden = !now.spinning_up;
  if (now.spinning_up) {
    const grown_min = Math.floor(now.simulated_s / 60);
    const text = element("spin-up-text", HTMLParagraphElement);
    const bar = element("spin-up-bar", HTMLProgressElement);
    if (spinUp_s === null) {
      text.textContent = `the sky is being grown: ${duration(now.simulated_s)} so far`;
      bar.removeAttribute("value");
    } else {
      text.textContent = `the sky is being grown: ${grown_min} of ${Math.round(spinUp_s / 60)} min`;
      bar.value = Math.min(1, now.simulated_s / spinUp_s);
    }
  }
  const parts = [now.paused ? "paused" : `${readable(now.speed, 2)} × real time`];
  if (now.cloud_cover !== null && now.cloud_cover !== undefined) {
    parts.push(`${readable(100 * now.cloud_cover, 2)} % cloud`);
  }
  element("panel-summary", HTMLSpanElement).textContent = parts.join(" · ");
}

function askForFrames() {
  if (document.hidden || drawing.here || view.camera === null) {
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

const timeScale = new FollowingSlider(
  "time-scale",
  (v) => `${readable(10 ** v, 2)} ×`,
  (v) => command({ command: "time_scale", time_scale: Number((10 ** v).toPrecision(3)) }),
);

function sunByHand() {
  // Both sliders belong to one command: hold both.
  sunElevation.heldUntilMs = sunAzimuth.heldUntilMs = performance.now() + 1_500;
  command({
    command: "sun",
    sun: { from: "fixed", elevation_deg: sunElevation.input.valueAsNumber, azimuth_deg: sunAzimuth.input.valueAsNumber },
  });
}

const sunElevation = new FollowingSlider("sun-elevation", (v) => `${v.toFixed(1)}°`, sunByHand);
const sunAzimuth = new FollowingSlider("sun-azimuth", (v) => `${compassPoint(v)} ${v.toFixed(0)}°`, sunByHand);
const timeOfDaySlider = new FollowingSlider(
  "time-of-day",
  (hours) => {
    const minutes = Math.round(60 * hours);
    return `${String(Math.floor(minutes / 60)).padStart(2, "0")}:${String(minutes % 60).padStart(2, "0")} UTC`;
  },
  (hours) => {
    if (ground === null || numbers === null) {
      showNotice("Where the world lies on Earth is not known yet.");
      return;
    }
    const at = timeOfDay(numbers.utc, hours);
    const { elevation_deg, azimuth_deg } = sunPosition(at, ground.latitude_deg, ground.longitude_deg);
    sunElevation.release();
    sunAzimuth.release();
    command({ command: "sun", sun: { from: "fixed", elevation_deg, azimuth_deg } });
  },
);

/**
 * Lets the slider follow the clock as long as the sun does: one that was placed by hand leaves it where it is.
 * @param {Numbers} now
 */
function followTimeOfDay(now) {
  if (ground === null) {
    return;
  }
  const byClock = sunPosition(Date.parse(now.utc) / 1000, ground.latitude_deg, ground.longitude_deg);
  if (Math.abs(byClock.elevation_deg - now.sun_elevation_deg) < 0.2) {
    timeOfDaySlider.follow((Date.parse(now.utc) - Date.parse(`${now.utc.slice(0, 10)}T00:00:00Z`)) / 3_600_000);
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

element("sun-clock", HTMLButtonElement).addEventListener("click", () => {
  sunElevation.release();
  sunAzimuth.release();
  command({ command: "sun", sun: { from: "clock" } });
});

pauseButton.addEventListener("click", () => command({ command: numbers?.paused ? "resume" : "pause" }));

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

const past = element("past", HTMLInputElement);
const pastOut = element("past-out", HTMLOutputElement);

/** Says what the slider shows. */
function showPast() {
  const sky = drawing.here ? drawing.sky : null;
  past.disabled = sky === null;
  past.min = String(-Math.max(1, Math.floor(sky?.past.span_s ?? 1)));
  const ago_s = -past.valueAsNumber;
  const field = sky?.shownPast ?? null;
  const text =
    sky === null ? "–" : field === null ? "live" : `${duration(ago_s)} ago, ${duration(field.header.simulated_s)} simulated`;
  if (pastOut.textContent !== text) {
    pastOut.textContent = text;
    past.setAttribute("aria-valuetext", text);
  }
}

past.addEventListener("input", () => {
  drawing.sky?.lookBack(-past.valueAsNumber);
  showPast();
});

const dragSelect = element("drag", HTMLSelectElement);
dragSelect.addEventListener("change", () => (view.orbits = dragSelect.value === "orbit"));

element("save", HTMLButtonElement).addEventListener("click", async () => {
  let png = null;
  let tick = view.shownTick;
  if (drawing.here) {
    const captured = await drawing.sky?.capture();
    png = captured?.png ?? null;
    tick = captured?.tick ?? null;
  } else {
    png = await new Promise((resolve) => view.canvas.toBlob(resolve, "image/png"));
  }
  if (png === null || png === undefined) {
    showNotice("There is no picture yet.");
    return;
  }
  const link = document.createElement("a");
  link.href = URL.createObjectURL(png);
  link.download = `welkin-${hello?.world ?? "sky"}-tick-${tick ?? "none"}.png`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
});

QUALITIES.forEach(([width, height], index) => qualitySelect.add(new Option(`${width} × ${height}`, String(index))));
qualitySelect.value = String(quality);
qualitySelect.addEventListener("change", () => {
  quality = Number(qualitySelect.value);
  askForFrames();
});

async function fillScenes() {
  if (scenes.length > 0) {
    return;
  }
  try {
    scenes = await listScenes();
    for (const scene of scenes) {
      const option = new Option(scene.name, scene.name);
      option.title = scene.description;
      sceneSelect.add(option);
    }
  } catch (error) {
    showNotice(`The list of scenes could not be read: ${error instanceof Error ? error.message : error}`);
  }
}

/**
 * Makes a world and goes there; then the one that this tab made before is no longer needed.
 * @param {string} preset
 */
async function createWorld(preset) {
  let own = sessionStorage.getItem(OWN_WORLD_KEY);
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
  stream.open(made.id);
  await drop();
  sessionStorage.setItem(OWN_WORLD_KEY, made.id);
}

sceneSelect.addEventListener("change", async () => {
  const preset = sceneSelect.value;
  const hint = element("scene-description", HTMLParagraphElement);
  hint.textContent = scenes.find((scene) => scene.name === preset)?.description ?? "";
  if (preset === "" || creating) {
    return;
  }
  creating = true;
  sceneSelect.disabled = true;
  try {
    await createWorld(preset);
  } catch (error) {
    const full = error instanceof ServerError && error.code === "too_many_worlds";
    const why = error instanceof Error ? error.message : String(error);
    showNotice(
      full
        ? `The server runs as many worlds as it may, so “${preset}” was not started. Try again when one has ended. (${why})`
        : `“${preset}” could not be started: ${why}`,
    );
    sceneSelect.value = "";
  } finally {
    creating = false;
    sceneSelect.disabled = false;
  }
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
  showPast();
  board.frames.textContent = `${view.framesPerSecond.toFixed(1)} /s`;
  const shown = drawing.here ? drawing.canvas : view.canvas;
  board.frames.title = `${shown.width} × ${shown.height}${dropped}`;
}, 1000);

stream.open(new URLSearchParams(location.search).get("world") ?? sessionStorage.getItem(OWN_WORLD_KEY));
