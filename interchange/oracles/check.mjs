// Reads the samples in a folder with the decoders of Foxglove, and compares what they hold.
//
//     node check.mjs FOLDER
import { readFileSync, readdirSync } from "node:fs";
import { createRequire } from "node:module";
import { join, resolve } from "node:path";

const folder = resolve(process.argv[2]);
const require = createRequire(join(folder, "check.cjs"));
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");

// Where two values differ first, or undefined.
function differs(expected, found, place) {
  if (ArrayBuffer.isView(found)) found = Array.from(found);
  if (Array.isArray(expected)) {
    if (expected.length !== found.length) return `${place}: ${expected.length} and ${found.length} elements`;
    return expected.map((e, i) => differs(e, found[i], `${place}[${i}]`)).find((d) => d);
  }
  if (typeof expected === "object") {
    const names = Object.keys(expected);
    if (names.length !== Object.keys(found).length) return `${place}: ${names} and ${Object.keys(found)}`;
    return names.map((name) => differs(expected[name], found[name], `${place}.${name}`)).find((d) => d);
  }
  const value = typeof found === "bigint" ? String(found) : found;
  const wanted = typeof expected === "string" && typeof value === "number" ? Number(expected) : expected;
  return Object.is(wanted, value) ? undefined : `${place}: ${expected} and ${found}`;
}

let bad = 0;
const names = readdirSync(folder).filter((name) => name.endsWith(".msg"));
for (const name of names) {
  const read = (ending) => readFileSync(join(folder, name.replace(/msg$/, ending)));
  const definitions = parse(read("msg").toString(), { ros2: true });
  const found = new MessageReader(definitions).readMessage(read("cdr"));
  const difference = differs(JSON.parse(read("json").toString()), found, name);
  if (difference) {
    console.log(difference);
    bad += 1;
  }
}
console.log(`${names.length} messages, ${bad} differences`);
process.exit(bad > 0 || names.length === 0 ? 1 : 0);
