// @ts-check
// What the page says of itself and of the world in words: notices, the connection, the health, how far the sky has been grown.

/** @import { Numbers, Status } from "./types.js" */

import { duration, element } from "./panel.js";

const NOTICE_MS = 12_000;

const HEALTH_TEXT = {
  good: "",
  degraded: "Degraded: the sky went back to an earlier moment and goes on.",
  halted: "Halted: the simulation failed and stands at its last good moment. Resume tries again.",
};

const notice = element("notice", HTMLDivElement);
const banner = element("banner", HTMLDivElement);
/** @type {ReturnType<typeof setTimeout> | undefined} */
let noticeTimer;

/** @param {string} message that goes away by itself */
export function showNotice(message) {
  element("notice-text", HTMLSpanElement).textContent = message;
  notice.hidden = false;
  clearTimeout(noticeTimer);
  noticeTimer = setTimeout(() => (notice.hidden = true), NOTICE_MS);
}

element("notice-close", HTMLButtonElement).addEventListener("click", () => (notice.hidden = true));

/** @param {HTMLElement} line @param {string} text written only when it changes, so that a screen reader says it once */
function write(line, text) {
  if (line.textContent !== text) {
    line.textContent = text;
  }
}

/** @param {Status} status of the connection */
export function showStatus(status) {
  document.body.dataset.connection = status.state;
  if (status.state === "live") {
    banner.hidden = true;
  } else if (status.state === "lost") {
    write(banner, `Connection lost — trying again in ${status.retry_s} s (${status.why})`);
    banner.hidden = false;
  } else if (!banner.hidden) {
    banner.textContent = "Connection lost — trying again now";
  }
}

/** @param {Numbers} now */
export function showHealth(now) {
  const box = element("health", HTMLParagraphElement);
  const state = now.health ?? "good";
  box.hidden = state === "good";
  box.dataset.state = state;
  write(element("health-state", HTMLSpanElement), HEALTH_TEXT[state]);
  const reason = state === "good" ? "" : `${now.trouble_message ?? ""} (${now.trouble_code ?? "no code"})`;
  write(element("health-reason", HTMLSpanElement), reason);
}

/** @param {Numbers} now @param {number | null} spinUp_s simulated seconds of growth in all; null where the server has not said */
export function showGrowth(now, spinUp_s) {
  element("spin-up", HTMLDivElement).hidden = !now.spinning_up;
  if (!now.spinning_up) {
    return;
  }
  const text = element("spin-up-text", HTMLParagraphElement);
  const bar = element("spin-up-bar", HTMLProgressElement);
  if (spinUp_s === null) {
    text.textContent = `the sky is being grown: ${duration(now.simulated_s)} so far`;
    bar.removeAttribute("value");
  } else {
    text.textContent = `the sky is being grown: ${Math.floor(now.simulated_s / 60)} of ${Math.round(spinUp_s / 60)} min`;
    bar.value = Math.min(1, now.simulated_s / spinUp_s);
  }
}
