#!/usr/bin/env bash
# @mcap/core 2.2.2 (npm), the reader under web viewers, on an MCAP file that was written without chunks.
# McapIndexedReader opens it, its statistics tell 100 messages, and readMessages() ends after none, without an
# error: it looks only into chunks that the summary indexes. McapStreamReader reads all 100.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export HOME="$folder"
npm init -y >/dev/null
npm install --silent --no-fund --no-audit @mcap/core@2.2.2
cat >read.mjs <<'JS'
import assert from "node:assert";
import { McapIndexedReader, McapStreamReader, McapWriter, TempBuffer } from "@mcap/core";

async function counts(useChunks) {
  const file = new TempBuffer();
  const writer = new McapWriter({ writable: file, useChunks });
  await writer.start({ profile: "", library: "" });
  const channelId = await writer.registerChannel({ schemaId: 0, topic: "/n", messageEncoding: "json", metadata: new Map() });
  for (let i = 0; i < 100; i++) {
    const at = BigInt(i) * 10_000_000n;
    await writer.addMessage({ channelId, sequence: i, logTime: at, publishTime: at, data: new TextEncoder().encode("{}") });
  }
  await writer.end();
  const indexed = await McapIndexedReader.Initialize({ readable: file });
  let byIndex = 0;
  for await (const _ of indexed.readMessages()) byIndex++;
  const stream = new McapStreamReader();
  stream.append(file.get());
  let inOrder = 0;
  for (let record; (record = stream.nextRecord()); ) if (record.type === "Message") inOrder++;
  return { told: Number(indexed.statistics.messageCount), byIndex, inOrder };
}

for (const useChunks of [true, false]) {
  const { told, byIndex, inOrder } = await counts(useChunks);
  console.log(`chunks ${useChunks}: told ${told}, read by index ${byIndex}, read in order ${inOrder}`);
  assert.deepEqual([told, byIndex, inOrder], [100, useChunks ? 100 : 0, 100]);
}
JS
node read.mjs
