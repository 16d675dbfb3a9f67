// Reads the test vectors of the volume protocol with the page's own decoder:
//
//   node volume.mjs VECTORS_DIR
//
// Exit code 0 says that every good message gave the values that the vectors name and every bad one was refused.

import { readFileSync } from "node:fs";
import { VolumeReceiver, channelValues } from "../../client/web/volume.js";

const folder = process.argv[2];
const vectors = JSON.parse(readFileSync(`${folder}/vectors.json`, "utf8"));
const message = (name) => {
  const bytes = readFileSync(`${folder}/${name}`);
  return bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
};
let failed = 0;
const fail = (what) => {
  failed += 1;
  console.error(`FAILED: ${what}`);
};

let values = 0;
let read = 0;
for (const { messages, result, header, values: wanted } of vectors.good) {
  const what = messages.join(", ");
  if (messages.some((name) => name.startsWith("zstd"))) {
    console.error(`not for browsers, which have no zstd: ${what}`);
    continue;
  }
  const receiver = new VolumeReceiver();
  let last;
  try {
    for (const name of messages) {
      last = await receiver.take(message(name));
    }
  } catch (error) {
    fail(`${what}: ${error}`);
    continue;
  }
  const said = typeof last === "string" ? last.replace(" ", "_") : "field";
  if (said !== result) {
    fail(`${what} gave ${said}, not ${result}`);
    continue;
  }
  read += 1;
  if (said !== "field") {
    continue;
  }
  for (const [name, expected] of Object.entries({ tick: header.tick, sequence: header.sequence, base: header.keyframe, simulated_s: header.simulated_s })) {
    if (last.header[name] !== expected) {
      fail(`${what}: ${name} is ${last.header[name]}, not ${expected}`);
    }
  }
  for (const [name, numbers] of Object.entries(wanted)) {
    const got = channelValues(last, name);
    // Every receiver gets the same bits.
    const wrong = numbers.findIndex((number, n) => got?.[n] !== Math.fround(number));
    if (got?.length !== numbers.length || wrong >= 0) {
      fail(`${what}: ${name}[${wrong}] is ${got?.[wrong]}, not ${numbers[wrong]}`);
    }
    values += numbers.length;
  }
}
for (const { message: name, why } of vectors.bad) {
  const receiver = new VolumeReceiver();
  try {
    // Those whose fault shows only in a delta need its keyframe.
    await receiver.take(message("deflate-8-keyframe.bin"));
    receiver.newest = null;
    const taken = await receiver.take(message(name));
    fail(`${name} was taken (${typeof taken === "string" ? taken : "a field"}), although ${why}`);
  } catch (error) {
    if (!(error instanceof RangeError || error instanceof TypeError)) {
      fail(`${name}: ${error}`);
    }
  }
}
if (read < 5 || values < 10_000) {
  fail(`only ${read} messages with ${values} values`);
}
console.log(failed === 0 ? `PASSED ${read} good, ${vectors.bad.length} bad` : "FAILED");
process.exit(failed === 0 ? 0 : 1);
