// The map as the service has it: tiles of Gaussians, kept up by deltas, begun by a snapshot.

import { FIELD, POINT_FLOATS, points, WHY_BYTES } from "./wire.js";

const FIRST_CAPACITY = 64;

/// One tile: an array that grows, where each Gaussian has a slot. `dirty` is the range of slots that
/// the graphics card does not have yet.
export class Tile {
  constructor(name) {
    this.name = name;
    this.index = name.split("_").map(Number);
    this.slots = new Map();
    this.floats = new Float32Array(FIRST_CAPACITY * POINT_FLOATS);
    this.ids = new Uint32Array(this.floats.buffer);
    this.whys = new Uint8Array(FIRST_CAPACITY * WHY_BYTES);
    this.count = 0;
    this.version = 0;
    this.dirty = null;
    /// Holds all centres that were ever here, and the largest sigma of their ellipsoids.
    this.low = [Infinity, Infinity, Infinity];
    this.high = [-Infinity, -Infinity, -Infinity];
    this.reachM = 0;
  }

  /// `why` are the bytes of its reason, if they are known.
  put(id, source, at, changed, why = null) {
    let slot = this.slots.get(id);
    if (slot === undefined) {
      slot = this.count;
      this.count += 1;
      this.slots.set(id, slot);
      if (this.count * POINT_FLOATS > this.floats.length) this.#grow();
    }
    const to = slot * POINT_FLOATS;
    this.floats.set(source.subarray(at, at + POINT_FLOATS), to);
    if (why) this.whys.set(why, slot * WHY_BYTES);
    else this.whys.fill(0, slot * WHY_BYTES, (slot + 1) * WHY_BYTES);
    this.#finish(slot, source, at, changed);
  }

  remove(id) {
    const slot = this.slots.get(id);
    if (slot === undefined) return;
    const last = this.count - 1;
    this.slots.delete(id);
    if (slot !== last) {
      const from = last * POINT_FLOATS;
      this.floats.copyWithin(slot * POINT_FLOATS, from, from + POINT_FLOATS);
      this.whys.copyWithin(slot * WHY_BYTES, last * WHY_BYTES, (last + 1) * WHY_BYTES);
      this.slots.set(this.ids[slot * POINT_FLOATS + FIELD.id], slot);
      this.#touch(slot);
    }
    this.count = last;
    this.version += 1;
  }

  /// Whether a Gaussian is asserted comes as a whole number; the shaders want 0 or 1.
  #finish(slot, source, at, changed) {
    const to = slot * POINT_FLOATS;
    const words = new Uint32Array(source.buffer, source.byteOffset + 4 * (at + FIELD.confident), 1);
    this.floats[to + FIELD.confident] = words[0] === 1 ? 1 : 0;
    this.floats[to + FIELD.changed] = changed;
    for (let axis = 0; axis < 3; axis += 1) {
      const place = this.floats[to + axis];
      if (place < this.low[axis]) this.low[axis] = place;
      if (place > this.high[axis]) this.high[axis] = place;
      this.reachM = Math.max(this.reachM, this.floats[to + FIELD.scale + axis]);
    }
    this.#touch(slot);
  }

  #touch(slot) {
    this.version += 1;
    if (!this.dirty) this.dirty = [slot, slot + 1];
    else this.dirty = [Math.min(this.dirty[0], slot), Math.max(this.dirty[1], slot + 1)];
  }

  #grow() {
    const floats = new Float32Array(this.floats.length * 2);
    floats.set(this.floats);
    this.floats = floats;
    this.ids = new Uint32Array(floats.buffer);
    const whys = new Uint8Array(this.whys.length * 2);
    whys.set(this.whys);
    this.whys = whys;
    this.dirty = [0, this.count];
  }
}

/// What became of a message.
export const APPLIED = "applied";
export const OLD = "old";
export const LOST_THREAD = "lost thread";

export class MapModel {
  constructor() {
    this.tiles = new Map();
    /// A new connection begins with the whole map; until then the one before is shown.
    this.waitsForSnapshot = true;
    this.reset();
  }

  reset() {
    this.epoch = null;
    this.sequence = -1;
    this.chunk = 0;
    this.parts = null;
    this.originM = [0, 0, 0];
    this.timeNs = null;
    this.throughPing = 0;
    this.isFinal = false;
    this.tiles.clear();
  }

  count() {
    let count = 0;
    for (const tile of this.tiles.values()) count += tile.count;
    return count;
  }

  /// A message of a snapshot; the map is replaced when the last of its parts is there.
  snapshot(header, payload, changed) {
    if (header.part === 0) this.parts = [];
    if (!this.parts || header.part !== this.parts.length) {
      this.parts = null;
      return LOST_THREAD;
    }
    this.parts.push({ header, points: points(payload, header) });
    if (this.parts.length < header.parts) return APPLIED;
    const parts = this.parts;
    this.reset();
    for (const part of parts) {
      if (part.points.count) this.#put(part.header.tile, part.points, changed);
    }
    this.#stand(header);
    this.chunk = 0;
    this.waitsForSnapshot = false;
    return APPLIED;
  }

  /// A message of a delta.
  delta(header, payload, changed) {
    if (this.waitsForSnapshot) return OLD;
    if (header.epoch !== this.epoch && this.epoch !== null) return LOST_THREAD;
    if (this.epoch === null && header.sequence > 1) return LOST_THREAD;
    if (header.sequence <= this.sequence && !(header.sequence === this.sequence && this.chunk)) return OLD;
    const isNext = this.chunk
      ? header.sequence === this.sequence && header.chunk === this.chunk
      : header.sequence === Math.max(this.sequence, 0) + 1 && header.chunk === 0;
    if (!isNext) return LOST_THREAD;
    const tile = this.tiles.get(header.tile);
    if (tile) for (const id of header.removed) tile.remove(id);
    const cloud = points(payload, header);
    if (cloud.count) this.#put(header.tile, cloud, changed);
    this.#stand(header);
    this.chunk = header.chunk + 1 < header.chunks ? header.chunk + 1 : 0;
    return APPLIED;
  }

  #put(name, cloud, changed) {
    let tile = this.tiles.get(name);
    if (!tile) {
      tile = new Tile(name);
      this.tiles.set(name, tile);
    }
    for (let i = 0; i < cloud.count; i += 1) {
      const at = i * POINT_FLOATS;
      const why = cloud.whys?.subarray(i * WHY_BYTES, (i + 1) * WHY_BYTES);
      tile.put(cloud.ids[at + FIELD.id], cloud.floats, at, changed, why);
    }
  }

  #stand(header) {
    this.epoch = header.epoch;
    this.sequence = header.sequence;
    this.originM = header.origin_m;
    this.timeNs = header.time_ns;
    this.throughPing = header.through_ping;
    this.isFinal = header.final === true;
  }
}

/// What the map holds at a glance: bounds of what is asserted, counts, and the spread of each number
/// that can be coloured by. Looks at some 20,000 Gaussians at most.
export function summary(tiles) {
  const all = [...tiles];
  const total = all.reduce((sum, tile) => sum + tile.count, 0);
  const stride = Math.max(1, Math.ceil(total / 20000));
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  const values = { height: [], sigma: [], strength: [], age: [], error: [], change: [] };
  let confident = 0;
  let ambiguous = 0;
  for (const tile of all) {
    const f = tile.floats;
    for (let i = 0; i < tile.count; i += 1) {
      const at = i * POINT_FLOATS;
      const isConfident = f[at + FIELD.confident] > 0.5;
      confident += isConfident;
      ambiguous += !isConfident;
      if (!isConfident || i % stride) continue;
      for (let axis = 0; axis < 3; axis += 1) {
        low[axis] = Math.min(low[axis], f[at + axis]);
        high[axis] = Math.max(high[axis], f[at + axis]);
      }
      values.height.push(f[at + FIELD.z]);
      values.sigma.push(f[at + FIELD.sigma]);
      values.strength.push(10 * Math.log10(Math.max(1e-12, f[at + FIELD.opacity] * f[at + FIELD.reflectivity])));
      values.age.push(f[at + FIELD.changed]);
      values.error.push(f[at + FIELD.changed]);
      values.change.push(f[at + FIELD.changed]);
    }
  }
  const spread = {};
  for (const [name, list] of Object.entries(values)) {
    list.sort((a, b) => a - b);
    spread[name] = list.length ? [list[Math.floor(list.length * 0.02)], list[Math.floor((list.length - 1) * 0.98)]] : null;
  }
  return { confident, ambiguous, low, high, isEmpty: !values.height.length, spread };
}
