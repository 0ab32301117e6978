// Reads what cdcr-view serves with the decoders of Foxglove: each channel that has messages within three seconds.
//
//     node check_live.mjs FOLDER PORT      FOLDER has the node_modules
import { createRequire } from "node:module";
import { join, resolve } from "node:path";

const require = createRequire(join(resolve(process.argv[2]), "check.cjs"));
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");
const { WebSocket } = require("ws");

const wanted = ["/tf", ...["telemetry", "status", "view/tip", "view/cables", "view/scene"].map((name) => `/cdcr/oracle/${name}`)];
const [decoders, read] = [new Map(), new Map()];
const socket = new WebSocket(`ws://127.0.0.1:${process.argv[3]}`, ["foxglove.sdk.v1"]);
socket.binaryType = "arraybuffer";
socket.onmessage = ({ data }) => {
  if (typeof data === "string") {
    const channels = JSON.parse(data).channels ?? [];
    for (const { id, topic, schema } of channels) decoders.set(id, [topic, new MessageReader(parse(schema, { ros2: true }))]);
    const subscriptions = channels.map(({ id }) => ({ id, channelId: id }));
    if (subscriptions.length > 0) socket.send(JSON.stringify({ op: "subscribe", subscriptions }));
    return;
  }
  const view = new DataView(data);
  if (view.getUint8(0) !== 1) return;
  // Operation, subscription and time stand before the message.
  const [topic, decoder] = decoders.get(view.getUint32(1, true));
  decoder.readMessage(new Uint8Array(data, 13));
  read.set(topic, (read.get(topic) ?? 0) + 1);
};
await new Promise((done) => setTimeout(done, 3000));
const missing = wanted.filter((topic) => !read.has(topic));
console.log(`${[...read.values()].reduce((a, b) => a + b, 0)} live messages, missing: ${missing.join(", ") || "none"}`);
process.exit(missing.length > 0 ? 1 : 0);
