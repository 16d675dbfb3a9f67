// Drives the page in a headless Chromium and says what holds. Started by page.rs:
//
//   node page.mjs URL OUT_DIR      with WELKIN_CHROMIUM naming the browser
//
// It asks its parent for the server's death and return by the lines STOP and START on standard output, and waits for
// STOPPED and STARTED on standard input. Exit code 0 says that every check held; a failed check is named on standard error.

import { askParent, check, drive, slide, waiting } from "./common.mjs";

const STEP_LIMIT_MS = 60_000;
const until = waiting(STEP_LIMIT_MS);

/** A digest of the canvas: its size, the spread of its brightness, and a 16 x 9 thumbnail. */
const picture = (page) =>
  page.evaluate(() => {
    const canvas = document.querySelector("#sky");
    const small = document.createElement("canvas");
    small.width = 16;
    small.height = 9;
    const context = small.getContext("2d");
    context.drawImage(canvas, 0, 0, 16, 9);
    const data = [...context.getImageData(0, 0, 16, 9).data];
    const bright = data.filter((_, i) => i % 4 === 1);
    return {
      width: canvas.width,
      height: canvas.height,
      spread: Math.max(...bright) - Math.min(...bright),
      brightest: Math.max(...bright),
      data,
    };
  });

/** Mean difference of two thumbnails, grey levels. */
const difference = (a, b) => a.data.reduce((sum, v, i) => sum + Math.abs(v - b.data[i]), 0) / a.data.length;

const text = (page, selector) => page.locator(selector).textContent();
const tickOf = async (page) => Number(await text(page, "#n-tick"));

await drive([], async (browser, url, outDir) => {
  const page = await browser.newPage({ viewport: { width: 1280, height: 720 } });
  page.setDefaultTimeout(STEP_LIMIT_MS);
  /** @type {string[]} */
  const complaints = [];
  // While the server is away, the browser itself logs every request that fails.
  let serverMayBeAway = false;
  page.on("console", (message) => {
    if (message.type() === "error" && !serverMayBeAway) {
      complaints.push(message.text());
    }
  });
  page.on("pageerror", (error) => complaints.push(String(error)));
  const foreign = [];
  /** Pictures of the past that the page asked for. */
  const pastPictures = [];
  page.on("request", (request) => {
    if (/\/frame\?tick=/.test(request.url())) {
      pastPictures.push(request.url());
    }
    const host = new URL(request.url()).host;
    if (host !== new URL(url).host && !request.url().startsWith("blob:")) {
      foreign.push(request.url());
    }
  });
  /** The frame wishes that the page sent, newest last. */
  const wishes = [];
  const commands = [];
  page.on("websocket", (socket) =>
    socket.on("framesent", ({ payload }) => {
      const message = JSON.parse(String(payload));
      (message.type === "frames" ? wishes : commands).push(message);
    }),
  );

  await page.goto(url, { waitUntil: "load" });
  await until("a picture that is not blank", async () => {
    const { spread, brightest, width } = await picture(page);
    return { ok: spread > 10 && brightest > 30, spread, brightest, width };
  });
  check("the picture has the size that the page asked for", (await picture(page)).width === 640, (await picture(page)).width);
  await until("ticks count up", async () => {
    const tick = await tickOf(page);
    return { ok: tick > 0, tick };
  });
  const firstTick = await tickOf(page);
  await until("the tick goes on", async () => (await tickOf(page)) > firstTick);
  for (const id of ["simulated", "tick-ms", "speed", "updraught", "wind"]) {
    await until(`number ${id} is filled in`, async () => {
      const value = await text(page, `#n-${id}`);
      return { ok: /\d/.test(value ?? ""), value };
    });
  }
  await until("a frame's cost is shown", async () => /\d.*ms/.test((await text(page, "#n-frame-ms")) ?? ""));
  check("the simulated time is a date in UTC", /^\d{4}-\d\d-\d\d \d\d:\d\d:\d\d UTC$/.test(await text(page, "#utc")), await text(page, "#utc"));
  await until("the picture rate is counted", async () => {
    const rate = parseFloat((await text(page, "#n-frames")) ?? "");
    return { ok: rate > 0, rate };
  });
  // The rate is counted over three seconds.
  await new Promise((resolve) => setTimeout(resolve, 4000));
  console.error(`figure: ${await text(page, "#n-frames")} pictures at 640x360, ${await text(page, "#n-frame-ms")} a frame`);
  const parts = ["tick", "wait", "render", "encode", "send", "decode", "whole"];
  const latency = await until("every part of the latency is measured", async () => {
    const texts = await Promise.all(parts.map((part) => text(page, `#latency-${part}`)));
    return { ok: texts.every((t) => /^[\d.]+ ms$/.test(t ?? "")), texts };
  });
  console.error(`figure: latency ${parts.map((part, n) => `${part} ${latency.texts[n]}`).join(", ")}`);
  await until("spark lines are drawn", () =>
    page.locator("#n-tick-ms + canvas").evaluate((canvas) => {
      const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
      return pixels.some((v) => v > 0);
    }),
  );
  await page.screenshot({ path: `${outDir}/desktop.png`, timeout: STEP_LIMIT_MS });

  // This browser is started without a GPU: the page says that the server draws, and why.
  await until("the page says who draws", async () => {
    const said = await text(page, "#drawn-by");
    return { ok: /^Drawn by the server: .*WebGPU/.test(said ?? ""), said };
  });

  // Looking around.
  const lookBefore = await text(page, "#look");
  const pictureBefore = await picture(page);
  await page.mouse.move(300, 300);
  await page.mouse.down();
  const wishesBefore = wishes.length;
  const dragStart = Date.now();
  for (let step = 1; step <= 20; step++) {
    await page.mouse.move(300 + 20 * step, 300 + 8 * step);
    await new Promise((resolve) => setTimeout(resolve, 20));
  }
  const dragSeconds = (Date.now() - dragStart) / 1000;
  const sentInDrag = wishes.length - wishesBefore;
  await page.mouse.up();
  const lookAfter = await text(page, "#look");
  check("a drag turns the camera", lookBefore !== lookAfter, { lookBefore, lookAfter });
  check("a drag sends no more than about ten cameras a second", sentInDrag >= 1 && sentInDrag <= 2 + 10.5 * dragSeconds, {
    sentInDrag,
    dragSeconds,
  });
  await until("the picture follows the drag", async () => {
    const moved = difference(pictureBefore, await picture(page));
    return { ok: moved > 2, moved };
  });
  await page.locator("#sky").focus();
  await page.keyboard.press("ArrowRight");
  check("an arrow key turns the camera", (await text(page, "#look")) !== lookAfter, await text(page, "#look"));
  await page.mouse.move(300, 300);
  const fovBefore = await text(page, "#fov-out");
  await page.mouse.wheel(0, -240);
  await until("the wheel changes the angle of view", async () => (await text(page, "#fov-out")) !== fovBefore);
  await page.locator('button[data-place="up"]').click();
  await until("straight up is asked for", async () => wishes.at(-1)?.camera?.elevation_deg === 90);
  await page.locator('button[data-place="aloft"]').click();
  await until("500 m is asked for", async () => wishes.at(-1)?.camera?.position_m[2] === 500);
  await page.locator('button[data-place="scene"]').click();

  // A sky that is still being grown runs flat out and may not be at its pace yet.
  await until("the spin-up ends", async () => page.locator("#spin-up").isHidden());

  await page.locator("#pause").click();
  await until("the button says Resume", async () => (await text(page, "#pause")) === "Resume");
  const stoppedAt = await tickOf(page);
  await new Promise((resolve) => setTimeout(resolve, 1500));
  check("pause stops the tick", (await tickOf(page)) === stoppedAt, { stoppedAt, now: await tickOf(page) });
  await page.locator("#pause").click();
  await until("resume starts it again", async () => (await tickOf(page)) > stoppedAt);

  await slide(page, "#time-scale", 0.3);
  await until("the time scale is sent", async () => commands.some((m) => m.command?.command === "time_scale" && Math.abs(m.command.time_scale - 2) < 0.01));
  await new Promise((resolve) => setTimeout(resolve, 2500));
  check("the server runs at the new time scale", Math.abs((await page.locator("#time-scale").evaluate((e) => e.valueAsNumber)) - 0.3) < 0.03,
    await text(page, "#time-scale-out"));

  // Clouds drift by themselves: a low sun must change the picture by far more than two seconds of weather do.
  const early = await picture(page);
  await new Promise((resolve) => setTimeout(resolve, 2000));
  const noon = await picture(page);
  const drift = difference(early, noon);
  await slide(page, "#sun-elevation", 3);
  await until("the sun sinks in the picture", async () => {
    const changed = difference(noon, await picture(page));
    return { ok: changed > 3 + 2 * drift, changed, drift };
  });
  await new Promise((resolve) => setTimeout(resolve, 2000));
  check("the sun stays where it was put", (await text(page, "#sun-elevation-out")) === "3.0°", await text(page, "#sun-elevation-out"));
  await page.locator("#sun-clock").click();
  await until("the clock has the sun again", async () => (await text(page, "#sun-elevation-out")) !== "3.0°");

  await page.locator("#quality").selectOption("0");
  await until("a smaller picture comes", async () => (await picture(page)).width === 320);

  // The sun as it stands at another hour: the page's own formula against the server's clock.
  await slide(page, "#time-of-day", 12.5);
  await until("noon is asked for", async () => {
    const sent = commands.at(-1)?.command?.sun;
    return { ok: sent?.from === "fixed" && sent.elevation_deg > 20, sent };
  });
  await page.locator("#sun-clock").click();
  await until("the slider of the hour follows the clock again", async () => {
    const [shown, utc] = [await text(page, "#time-of-day-out"), await text(page, "#utc")];
    const minutes = (t) => Number(t.slice(0, 2)) * 60 + Number(t.slice(3, 5));
    const apart = Math.abs(minutes(shown ?? "00:00") - minutes((utc ?? "").slice(11)));
    return { ok: apart <= 7, shown, utc };
  });

  // A cut with wind arrows, and the sounding of a column.
  const cut = () =>
    page.locator("#cut-canvas").evaluate((canvas) => {
      const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
      const seen = new Set();
      let gold = 0;
      for (let n = 0; n < data.length; n += 4) {
        seen.add((data[n] << 16) | (data[n + 1] << 8) | data[n + 2]);
        gold += data[n] > 200 && data[n + 1] > 150 && data[n + 2] < 130 ? 1 : 0;
      }
      return { colours: seen.size, gold };
    });
  await page.locator("#cut").selectOption("level");
  await page.locator("#cut-channel").selectOption("wind_z_m_s");
  const legend = await until("the cut names its values", async () => {
    const said = await text(page, "#cut-legend");
    return { ok: /^Wind, up: -[\d.]+ to [\d.]+ m\/s; blue is negative, red positive$/.test(said ?? ""), said };
  });
  console.error(`figure: ${legend.said}`);
  const plain = await cut();
  check("the cut has many values", plain.colours > 100 && plain.gold < 50, plain);
  await page.locator("#cut-arrows").check();
  await until("arrows are drawn", async () => {
    const seen = await cut();
    return { ok: seen.gold > 200, seen };
  });
  const placeBefore = await text(page, "#cut-place-out");
  await slide(page, "#cut-place", 3);
  check("the cut moves", (await text(page, "#cut-place-out")) !== placeBefore, await text(page, "#cut-place-out"));
  const said = await until("the sounding says what is at the ground", async () => {
    const line = await text(page, "#sounding-text");
    return { ok: /^Sounding \d+ m east, \d+ m north: [\d.]+ °C, dew point [\d.]+ °C at 10\d\d hPa; /.test(line ?? ""), line };
  });
  console.error(`figure: ${said.line}`);
  await page.locator("#cut-canvas").focus();
  await page.keyboard.press("ArrowRight");
  await until("an arrow key chooses another column", async () => {
    const line = await text(page, "#sounding-text");
    return { ok: line?.split(":")[0] !== said.line.split(":")[0], line };
  });
  await page.locator("#sounding-canvas").scrollIntoViewIfNeeded();
  await page.screenshot({ path: `${outDir}/layers.png`, timeout: STEP_LIMIT_MS });
  await page.locator("#cut").selectOption("");

  // The wind as arrows in the sky, and the air at one place as time goes on.
  const overlay = () =>
    page.locator("#overlay").evaluate((canvas) => {
      const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
      let [bright, gold] = [0, 0];
      for (let n = 0; n < data.length; n += 4) {
        const [r, g, b, a] = data.slice(n, n + 4);
        bright += a > 100 && Math.max(r, b) > 200 ? 1 : 0;
        gold += a > 200 && r > 240 && Math.abs(g - 209) < 12 && b < 130 ? 1 : 0;
      }
      return { bright, gold };
    });
  check("nothing lies over the sky unasked", await page.locator("#overlay").isHidden(), null);
  await page.locator("#arrows").focus();
  await page.keyboard.press("Space");
  await slide(page, "#arrows-height", 8);
  const windSaid = await until("the arrows' legend names the wind", async () => {
    const line = await text(page, "#arrows-legend");
    return { ok: /^Wind at 638 m: up to [\d.]+ m\/s\. Red air rises, at most [\d.]+ m\/s; blue sinks, at most [\d.]+ m\/s\.$/.test(line ?? ""), line };
  });
  console.error(`figure: ${windSaid.line}`);
  await until("arrows are in the sky", async () => {
    const seen = await overlay();
    return { ok: seen.bright > 400, seen };
  });
  await page.locator("#point").check();
  await page.locator("#point-channel").selectOption("temperature_k");
  await page.locator("#point-ahead").click();
  const height = await text(page, "#point-z-out");
  const series = await until("the line of a place grows", async () => {
    const line = await text(page, "#series-text");
    return { ok: /^Temperature: [\d.]+ K now; [\d.]+ to [\d.]+ K in (\d+ h )?\d+ min \d+ s simulated\.$/.test(line ?? "") && !/0 min 00 s/.test(line), line };
  });
  console.error(`figure: at ${height}: ${series.line}`);
  await until("it is drawn", () =>
    page.locator("#series-canvas").evaluate((canvas) => {
      const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
      let gold = 0;
      for (let n = 0; n < data.length; n += 4) {
        gold += data[n] > 200 && data[n + 1] > 150 && data[n + 2] < 130 ? 1 : 0;
      }
      return { ok: gold > 100, gold };
    }),
  );
  await until("the place is marked in the sky", async () => {
    const seen = await overlay();
    return { ok: seen.gold > 20, seen };
  });
  await page.locator("#series-canvas").scrollIntoViewIfNeeded();
  await page.screenshot({ path: `${outDir}/arrows.png`, timeout: STEP_LIMIT_MS });
  await page.locator("#point-z").focus();
  await page.keyboard.press("ArrowRight");
  check("an arrow key moves the place", (await text(page, "#point-z-out")) !== height, await text(page, "#point-z-out"));

  // Looking back at pictures that the server draws of what it has kept.
  await until("some seconds are kept", () => page.locator("#past").evaluate((past) => ({ ok: !past.disabled && past.min <= -5, min: past.min })));
  await slide(page, "#past", -4);
  await until("a picture of then is asked for", async () => pastPictures.length > 0);
  await until("the page says of when", async () => {
    const line = await text(page, "#past-out");
    return { ok: /^0 min 04 s ago, .* simulated$/.test(line ?? ""), line };
  });
  check("no new ones are", commands.at(-1)?.type === "no_frames", commands.at(-1));
  await until("arrows of now do not lie over it", async () => /not of what was/.test((await text(page, "#arrows-legend")) ?? ""));
  const asked = pastPictures.length;
  await page.locator("#sky").focus();
  await page.keyboard.press("ArrowLeft");
  await until("the camera turns in the past too", async () => pastPictures.length > asked);
  const wishesThen = wishes.length;
  await slide(page, "#past", 0);
  await until("new pictures are asked for again", async () => wishes.length > wishesThen && (await text(page, "#past-out")) === "live");
  await page.locator("#arrows").uncheck();
  await page.locator("#point").uncheck();
  await until("the sky is clear of them again", async () => page.locator("#overlay").isHidden());

  // Flying.
  const heightBefore = wishes.at(-1)?.camera?.position_m[2];
  await page.locator("#sky").focus();
  await page.keyboard.down("KeyE");
  await until("a held key climbs", async () => {
    const height = wishes.at(-1)?.camera?.position_m[2];
    return { ok: height > heightBefore + 20, height, heightBefore };
  });
  await page.keyboard.up("KeyE");
  await page.locator("#drag").selectOption("orbit");
  const orbitFrom = wishes.at(-1)?.camera;
  await page.mouse.move(300, 300);
  await page.mouse.down();
  await page.mouse.move(420, 300, { steps: 4 });
  await page.mouse.up();
  await until("a drag goes around", async () => {
    const now = wishes.at(-1)?.camera;
    const moved = Math.hypot(now.position_m[0] - orbitFrom.position_m[0], now.position_m[1] - orbitFrom.position_m[1]);
    return { ok: moved > 100 && now.azimuth_deg !== orbitFrom.azimuth_deg, moved };
  });
  await page.locator("#drag").selectOption("look");

  // Another scene.
  const aboutBefore = await text(page, "#about");
  const names = (await page.locator("#scene option").evaluateAll((all) => all.map((o) => o.value))).filter((v) => v !== "");
  check("scenes are on offer", names.length >= 2, names);
  await page.locator("#scene").selectOption(names.find((name) => /clear|wind/.test(name)) ?? names.at(-1));
  await until("the page goes to the new world", async () => (await text(page, "#about")) !== aboutBefore);
  await until("its ticks arrive", async () => (await tickOf(page)) > 0);
  check("nothing went wrong on the way", await page.locator("#notice").isHidden(), await text(page, "#notice-text"));
  const worlds = async () => (await (await fetch(`${url}/v1/worlds`)).json()).length;
  const worldsBefore = await worlds();
  const aboutOwn = await text(page, "#about");
  await page.locator("#scene").selectOption(names[0]);
  await until("a further scene replaces the page's own world", async () => (await text(page, "#about")) !== aboutOwn);
  await until("which is then gone", async () => (await worlds()) === worldsBefore);

  check("no errors in the console", complaints.length === 0, complaints);
  check("nothing is asked of another host", foreign.length === 0, foreign);

  // The server goes, and comes back.
  serverMayBeAway = true;
  await askParent("STOP", "STOPPED");
  await until("the banner says that the connection is lost", async () => {
    const shown = await page.locator("#banner").isVisible();
    return { ok: shown && /Connection lost — trying again in \d+ s/.test((await text(page, "#banner")) ?? ""), shown };
  });
  await page.screenshot({ path: `${outDir}/lost.png`, timeout: STEP_LIMIT_MS });
  await new Promise((resolve) => setTimeout(resolve, 2500));
  await askParent("START", "STARTED");
  await until("the banner goes when the server is back", async () => page.locator("#banner").isHidden());
  await until("ticks go on after the return", async () => {
    const before = await tickOf(page);
    await new Promise((resolve) => setTimeout(resolve, 700));
    return (await tickOf(page)) > before;
  });

  // A tick that cannot be saved: the page says that the sky went back, and why, in words.
  check("a good world has no badge", await page.locator("#health").isHidden(), await text(page, "#health"));
  await askParent("STRIKE", "STRUCK");
  await until("the badge says that the world is degraded", async () => {
    const shown = await page.locator("#health").isVisible();
    return { ok: shown && /Degraded/.test((await text(page, "#health-state")) ?? ""), shown };
  });
  check("it gives the reason and its code", /not finite.*\(not_finite\)/.test((await text(page, "#health-reason")) ?? ""), await text(page, "#health-reason"));
  check("it is announced", (await page.locator("#health").getAttribute("role")) === "status", null);
  const box = await page.locator("#health").boundingBox();
  check("it is within the window", box !== null && box.x >= 0 && box.y >= 0 && box.x + box.width <= 1280 && box.y + box.height <= 720, box);
  await page.screenshot({ path: `${outDir}/degraded.png`, timeout: STEP_LIMIT_MS });
  const struckAt = await tickOf(page);
  await until("it goes on all the same", async () => (await tickOf(page)) > struckAt);
  check("no script failed meanwhile", complaints.length === 0, complaints);
  await page.close();

  // A phone.
  const phone = await browser.newPage({
    viewport: { width: 360, height: 740 },
    deviceScaleFactor: 2,
    isMobile: true,
    hasTouch: true,
  });
  phone.setDefaultTimeout(STEP_LIMIT_MS);
  await phone.goto(url, { waitUntil: "load" });
  await until("a phone gets an upright picture", async () => {
    const { width, height, spread } = await picture(phone);
    return { ok: height > width && spread > 10, width, height, spread };
  });
  const overflow = () => phone.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
  check("no sideways overflow on a phone", (await overflow()) <= 0, await overflow());
  await phone.screenshot({ path: `${outDir}/phone.png`, timeout: STEP_LIMIT_MS });
  await phone.locator("#panel-toggle").tap();
  await until("the panel opens", async () => phone.locator("#panel-body").isVisible());
  check("nor with the panel open", (await overflow()) <= 0, await overflow());
  const outside = await phone.evaluate(() =>
    [...document.querySelectorAll("#panel *")]
      .filter((e) => {
        const box = e.getBoundingClientRect();
        return box.width > 0 && (box.left < -1 || box.right > innerWidth + 1);
      })
      .map((e) => e.id || e.tagName),
  );
  check("every control is within the screen's width", outside.length === 0, outside);
  await phone.screenshot({ path: `${outDir}/phone-panel.png`, timeout: STEP_LIMIT_MS });
  await phone.locator("#arrows").check();
  await phone.locator("#point").check();
  await until("layers work on a phone", async () => /now;/.test((await text(phone, "#series-text")) ?? "") && /^Wind/.test((await text(phone, "#arrows-legend")) ?? ""));
  check("their controls fit", (await overflow()) <= 0, await overflow());
  await phone.locator("#arrows").scrollIntoViewIfNeeded();
  await phone.screenshot({ path: `${outDir}/phone-arrows.png`, timeout: STEP_LIMIT_MS });
  const unnamed = await phone.evaluate(() =>
    [...document.querySelectorAll("input, select, button, canvas[role]")]
      .filter((e) => !e.getAttribute("aria-label") && !(e.labels?.length > 0) && e.textContent.trim() === "")
      .map((e) => e.id || e.outerHTML),
  );
  check("every control has a name", unnamed.length === 0, unnamed);
});
