// Reads a recording with @mcap/core and the decoders of Foxglove, and compares cycles with the table that cdcrctl made of it.
//
//     node check_recording.mjs FOLDER FILE.mcap telemetry.csv      FOLDER has the node_modules
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join, resolve } from "node:path";

const require = createRequire(join(resolve(process.argv[2]), "check.cjs"));
const { McapStreamReader } = require("@mcap/core");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");
const { loadDecompressHandlers } = require("@mcap/support");

const [heads, ...rows] = readFileSync(process.argv[4]).toString().trim().split("\n").map((row) => row.split(","));
const number = (text) => ({ NaN, inf: Infinity })[text] ?? Number(text);
const cell = (row, name) => number(row[heads.indexOf(name)]);

const reader = new McapStreamReader({ validateCrcs: true, decompressHandlers: await loadDecompressHandlers() });
reader.append(readFileSync(process.argv[3]));
const [schemas, decoders] = [new Map(), new Map()];
let [count, bad] = [0, 0];
for (let record; (record = reader.nextRecord()); ) {
  if (record.type === "Schema") schemas.set(record.id, record);
  if (record.type === "Channel") {
    const schema = schemas.get(record.schemaId);
    const text = new TextDecoder().decode(schema.data);
    decoders.set(record.id, [schema.name, new MessageReader(parse(text, { ros2: true }))]);
  }
  if (record.type !== "Message") continue;
  const [name, decoder] = decoders.get(record.channelId);
  const message = decoder.readMessage(record.data);
  if (name !== "cdcr_msgs/msg/Telemetry") continue;
  const row = rows[count++];
  const same =
    Number(message.cycle) === cell(row, "cycle") &&
    Object.is(message.bend_rad[0], cell(row, "bend_rad[0]")) &&
    Object.is(message.clearance_m, cell(row, "clearance_m")) &&
    Object.is(message.position_error_m, cell(row, "position_error_m"));
  if (!same) bad += 1;
}
console.log(`${count} cycles of a recording, ${bad} differences`);
process.exit(bad > 0 || count === 0 || count !== rows.length || !reader.done() ? 1 : 0);
