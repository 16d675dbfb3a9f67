// What the drivers of the page share: a headless Chromium, time limits, and the words for what holds.

import { mkdirSync } from "node:fs";
import { createInterface } from "node:readline";
import { chromium } from "playwright-core";

const WHOLE_LIMIT_MS = 240_000;
const CLOSING_LIMIT_MS = 15_000;

/** Waits until a condition holds; the error says what did not come about, and what was seen last. */
async function wait(what, probe, limitMs) {
  const end = Date.now() + limitMs;
  let seen;
  do {
    seen = await probe();
    if (seen === true || (typeof seen === "object" && seen !== null && seen.ok)) {
      return seen;
    }
    await new Promise((resolve) => setTimeout(resolve, 100));
  } while (Date.now() < end);
  throw new Error(`${what}: not within ${limitMs / 1000} s; seen last: ${JSON.stringify(seen)}`);
}

/** `wait` with a limit for steps that name none. */
export const waiting = (stepLimitMs) => (what, probe, limitMs = stepLimitMs) => wait(what, probe, limitMs);

/** @type {AsyncIterator<string> | undefined} */
let lines;

/** Asks the parent for something by a line on standard output, waits for its line on standard input, and returns it; it must begin with `answer`. */
export async function askParent(request, answer) {
  lines ??= createInterface({ input: process.stdin })[Symbol.asyncIterator]();
  console.log(request);
  const { value, done } = await lines.next();
  if (done || !value.startsWith(answer)) {
    throw new Error(`the parent answered ${JSON.stringify(value)} to ${request.slice(0, 40)}, not ${answer}`);
  }
  return value;
}

/** Sets a slider as a person does, with its events. */
export const slide = (page, selector, value) =>
  page.locator(selector).evaluate((input, v) => {
    input.value = String(v);
    input.dispatchEvent(new Event("input", { bubbles: true }));
    input.dispatchEvent(new Event("change", { bubbles: true }));
  }, value);

export function check(what, holds, seen) {
  if (!holds) {
    throw new Error(`${what}; seen: ${JSON.stringify(seen)}`);
  }
  console.error(`ok: ${what}`);
}

/**
 * Runs `work(browser, url, outDir)` with a Chromium that has these flags beside the usual ones, and ends the process: exit code 0 says that every
 * check held. The script's arguments are URL and OUT_DIR, and WELKIN_CHROMIUM names the browser.
 */
export async function drive(flags, work) {
  const [url, outDir] = process.argv.slice(2);
  const executablePath = process.env.WELKIN_CHROMIUM;
  if (!url || !outDir || !executablePath) {
    console.error(`usage: WELKIN_CHROMIUM=/path/to/chromium node ${process.argv[1]} URL OUT_DIR`);
    process.exit(2);
  }
  mkdirSync(outDir, { recursive: true });
  // Whatever hangs, this ends.
  const watchdog = setTimeout(() => {
    console.error(`FAILED: not done after ${WHOLE_LIMIT_MS / 1000} s`);
    process.exit(3);
  }, WHOLE_LIMIT_MS);
  const browser = await chromium.launch({
    executablePath,
    timeout: 60_000,
    args: [
      "--headless=new",
      "--no-sandbox",
      "--disable-quic",
      "--no-first-run",
      "--disable-background-networking",
      "--disable-component-update",
      "--disable-sync",
      ...flags,
    ],
  });
  let failed = false;
  try {
    await work(browser, url, outDir);
  } catch (error) {
    failed = true;
    console.error(`FAILED: ${error instanceof Error ? error.message : error}`);
  } finally {
    // Closing has been seen to hang: it gets its time, and then the process ends all the same.
    await Promise.race([browser.close().catch(() => null), new Promise((resolve) => setTimeout(resolve, CLOSING_LIMIT_MS))]);
    clearTimeout(watchdog);
  }
  console.log(failed ? "FAILED" : "PASSED");
  process.exit(failed ? 1 : 0);
}
