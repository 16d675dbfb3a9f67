// The page's clock, playing and past on made-up fields: what client/src/clock.rs holds of its twin, and where what is looked back at comes from.
//
//   node playout.mjs
//
// Exit code 0 says that all holds.

import assert from "node:assert/strict";
import { mixed } from "../../client/web/local.js";
import { Past } from "../../client/web/past.js";
import { Clock, Playout } from "../../client/web/playout.js";

/** A field of one cell that was published then; the world runs eight times as fast as the clock. */
const field = (published_unix_s, more = {}) => ({
  header: {
    published_unix_s,
    simulated_s: 8 * published_unix_s,
    tick: Math.round(8 * published_unix_s),
    world_cells: [1, 1, 1],
    region: { from: [0, 0, 0], cells: [1, 1, 1] },
    mip: 0,
    cell_size_m: [10, 10, 10],
    channels: [{ name: "extinction_per_m" }],
    ...more,
  },
  codes: [new Uint8Array(1000)],
});

// The clock believes the shortest way: the server is 1000 s ahead, the way there takes 1 ms, the way back far longer and every time differently.
const clock = new Clock();
assert.equal(clock.server_unix_s(0), null);
for (let n = 0; n < 40; n++) {
  clock.answered(n, n + 0.002 + 0.05 * ((n * 7) % 5), n + 1000.001);
}
assert.ok(Math.abs(clock.server_unix_s(50) - 1050) < 1e-6);
const known = structuredClone(clock.answers);
for (const [sent, received, server] of [[5, 4, 0], [NaN, 1, 1], [0, 1, Infinity]]) {
  clock.answered(sent, received, server);
}
assert.deepEqual(clock.answers, known, "what makes no sense is ignored");

// Between two fields their mean by time is shown.
const playout = new Playout(1);
assert.equal(playout.at(100), null);
for (const at of [100, 100.5, 101.5]) {
  playout.push(field(at), 101.6);
}
assert.ok(playout.moves);
for (const [now, before, weight, simulated_s] of [
  [100, 100, 0, 800], // before the first, the first
  [101.25, 100, 0.5, 802],
  [101.5, 100.5, 0, 804],
  [102.25, 100.5, 0.75, 810],
  [109, 101.5, 0, 812], // after the last, the last
]) {
  const shown = playout.at(now);
  assert.deepEqual([shown.before.header.published_unix_s, shown.weight, shown.simulated_s], [before, weight, simulated_s], `at ${now}`);
}
assert.ok(!playout.moves);
playout.push(field(101.5), 102);
playout.push(field(101), 102);
assert.equal(playout.fields.length, 1, "what is not newer is dropped");
playout.push(field(103, { mip: 1 }), 103);
assert.equal(playout.at(105).before.header.mip, 1, "another shape begins anew");

// The sky that is shown goes on at its pace in small steps, whatever the jitter of what comes.
const steady = new Playout();
const times = Array.from({ length: 40 }, (_, n) => 100 + 0.25 * n + 0.1 * ((n * 7) % 3));
const arrivals = times.map((at, n) => ({ at, arrived: at + 0.02 + 0.05 * ((n * 5) % 4) }));
const shown = [];
for (let now = 100.5; now < 109; now += 1 / 60) {
  while (arrivals.length > 0 && arrivals[0].arrived <= now) {
    const { at, arrived } = arrivals.shift();
    steady.push(field(at), arrived);
  }
  const { simulated_s } = steady.at(now) ?? {};
  if (simulated_s !== undefined && now > 104) {
    shown.push(simulated_s);
  }
}
const steps = shown.slice(1).map((s, n) => s - shown[n]);
// 8/60 a picture; the delay may change by a tenth of the time that goes by.
assert.ok(Math.min(...steps) > 0.89 * (8 / 60) && Math.max(...steps) < 1.11 * (8 / 60), `steps of ${Math.min(...steps)} to ${Math.max(...steps)} s`);
assert.ok(steady.delay_s > 0.45 && steady.delay_s < 0.75, `a delay of ${steady.delay_s} s`);

// A world that stood does not hold the sky back.
const stood = new Playout();
[100, 120, 120.5, 121, 121.5, 150, 150.5, 151].forEach((at, n) => {
  stood.push(field(at), at + 0.1);
  stood.at(at + 0.1);
  assert.ok(stood.delay_s <= (n < 2 ? 20.2 : 0.7), `${stood.delay_s} s at message ${n}`);
});

// Two clouds are mixed cell by cell, and their displacement likewise.
const cloud = (values, moved) => ({ cells: [2, 1, 1], cell_size_m: [1, 1, 1], extinction_per_m: new Float32Array(values), air_displacement_m: moved });
const middle = mixed(cloud([0, 0.5], [10, 0]), cloud([1, 0.25], [20, -4]), 0.25);
assert.deepEqual([...middle.extinction_per_m, ...middle.air_displacement_m], [0.25, 0.4375, 12.5, -1]);

// The past: what was seen here, and before it what the server has kept; of what comes one a second, within its bound.
const past = new Past();
assert.equal(past.at(3), null);
past.learn([94, 95, 96, 97, 98, 99, 100, 101].map((at) => ({ tick: at, simulated_s: 8 * at, published_unix_s: at, bytes: 9 })));
assert.equal(past.span_s, 7);
for (let at = 100; at <= 110; at += 0.25) {
  past.push(field(at));
}
assert.equal(past.span_s, 16);
assert.equal(past.fields.length, 11);
assert.deepEqual([past.at(4).published_unix_s, past.at(4).field !== null], [106, true], "seen here");
assert.deepEqual([past.at(13).tick, past.at(13).field], [97, null], "kept by the server, to be fetched");
const fetched = field(97);
past.hold(97, fetched);
assert.equal(past.at(13).field, fetched);
assert.equal(past.at(500).tick, 94, "the oldest there is");
past.learn([{ tick: 98, simulated_s: 784, published_unix_s: 98, bytes: 9 }]);
assert.equal(past.fetched.size, 0, "what the server has forgotten is not held");
past.push(field(50));
assert.deepEqual([past.fields.length, past.kept.length], [1, 0], "another life of the world begins anew");
console.log("PASSED");
