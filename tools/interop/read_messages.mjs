// Messages of each channel that @mcap/core reads by the file's index: read_messages.mjs FILE, with the folder of
// node modules in NODE_MODULES.
import { open } from "node:fs/promises";
import { createRequire } from "node:module";

const require = createRequire(`${process.env.NODE_MODULES}/x.js`);
const { McapIndexedReader } = require("@mcap/core");
const file = await open(process.argv[2], "r");
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, length) => {
    const bytes = new Uint8Array(Number(length));
    await file.read(bytes, 0, bytes.length, Number(offset));
    return bytes;
  },
};
const reader = await McapIndexedReader.Initialize({ readable });
const counts = {};
for await (const message of reader.readMessages()) {
  const { topic } = reader.channelsById.get(message.channelId);
  counts[topic] = (counts[topic] ?? 0) + 1;
}
console.log(JSON.stringify(counts));
