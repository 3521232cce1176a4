// Reads the binary messages of the WebSocket: a head, a JSON header, and a payload, which for the map
// is the CDR of a sensor_msgs/msg/PointCloud2 with points of 92 bytes.

const KINDS = { 1: "delta", 2: "snapshot", 3: "ping" };
const HEAD_BYTES = 16;
/// Of a point as it comes; the page keeps what it draws, without covariance and probability.
const SENT_BYTES = 92;
const SENT_WORDS = SENT_BYTES / 4;
export const POINT_BYTES = 64;
export const POINT_FLOATS = 16;
/// Beside each point: number of the reason of its verdict, clear observations, what the test measured.
export const WHY_BYTES = 3;

/// Where the numbers of a point that is kept are, in words of four bytes: as they come, but for the last.
export const FIELD = {
  x: 0, y: 1, z: 2, changed: 3, id: 4, opacity: 5, scale: 6, rotation: 9,
  reflectivity: 13, sigma: 14, confident: 15,
};

const text = new TextDecoder();

/// Kind, header and payload of a message.
export function parse(buffer) {
  const view = new DataView(buffer);
  const headerBytes = view.getUint32(4, true);
  // Epochs have 64 bits, which only a text holds here.
  const json = text.decode(new Uint8Array(buffer, HEAD_BYTES, headerBytes));
  const header = JSON.parse(json.replace(/"epoch":(\d+)/, '"epoch":"$1"'));
  const start = HEAD_BYTES + headerBytes;
  return {
    kind: KINDS[view.getUint8(0)],
    sentMs: view.getFloat64(8, true),
    header,
    payload: buffer.slice(start),
  };
}

/// The points of a cloud as words: { count, floats, ids } over the same bytes, and `whys` beside them as the header has
/// them, null if it has none.
export function points(cdr, header = {}) {
  const reader = new CdrReader(cdr);
  reader.u32(); // seconds
  reader.u32(); // nanoseconds
  reader.string(); // frame
  const height = reader.u32();
  const width = reader.u32();
  const fieldCount = reader.u32();
  for (let i = 0; i < fieldCount; i += 1) {
    reader.string();
    reader.u32();
    reader.u8();
    reader.u32();
  }
  reader.u8(); // big-endian
  const step = reader.u32();
  reader.u32(); // row step
  const bytes = reader.u32();
  const count = height * width;
  if (step !== SENT_BYTES || bytes !== count * SENT_BYTES) {
    throw new Error(`points of ${step} bytes, ${bytes} in all: another version of the service?`);
  }
  const sent = new Uint32Array(cdr.slice(reader.at, reader.at + bytes));
  const kept = new Uint32Array(count * POINT_FLOATS);
  for (let i = 0; i < count; i += 1) {
    const from = i * SENT_WORDS;
    kept.set(sent.subarray(from, from + FIELD.confident), i * POINT_FLOATS);
    kept[i * POINT_FLOATS + FIELD.confident] = sent[from + SENT_WORDS - 1];
  }
  return { count, floats: new Float32Array(kept.buffer), ids: kept, whys: whysOf(header, count) };
}

function whysOf({ why }, count) {
  if (!why) return null;
  const text = atob(why);
  if (text.length !== count * WHY_BYTES) return null;
  return Uint8Array.from(text, (c) => c.charCodeAt(0));
}

/// Little-endian CDR behind four bytes of encapsulation, from whose end alignment counts.
class CdrReader {
  constructor(buffer) {
    this.view = new DataView(buffer);
    this.at = 4;
  }

  u8() {
    this.at += 1;
    return this.view.getUint8(this.at - 1);
  }

  u32() {
    this.at = 4 + 4 * Math.ceil((this.at - 4) / 4) + 4;
    return this.view.getUint32(this.at - 4, true);
  }

  string() {
    const bytes = this.u32();
    this.at += bytes;
  }
}
