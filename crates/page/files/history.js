// What this page has received, to go back to: the map at moments of the dive, pings, poses. Tiles that
// did not change between two moments are held once. When the room is full every other moment goes.

const MAX_BYTES = 96e6;
const FIRST_STEP_S = 0.5;
const MAX_POSES = 20000;

export class History {
  constructor() {
    this.clear();
  }

  clear() {
    this.moments = [];
    this.stepS = FIRST_STEP_S;
    this.poses = [];
    this.copies = new Map();
    this.bytes = 0;
  }

  /// Keeps the map as it is at this time of the dive, if it is time for another moment.
  keep(diveS, model) {
    const last = this.moments.at(-1);
    if (last && diveS < last.diveS) this.clear();
    else if (last && diveS < last.diveS + this.stepS) return;
    const tiles = [];
    for (const tile of model.tiles.values()) {
      let copy = this.copies.get(tile.name);
      if (copy?.source !== tile || copy.version !== tile.version) {
        copy = {
          source: tile,
          name: tile.name,
          index: tile.index,
          version: tile.version,
          count: tile.count,
          floats: tile.floats.slice(0, tile.count * 16),
          whys: tile.whys.slice(0, tile.count * 3),
          low: [...tile.low],
          high: [...tile.high],
          reachM: tile.reachM,
          dirty: [0, tile.count],
        };
        this.copies.set(tile.name, copy);
        this.bytes += copy.floats.byteLength;
      }
      tiles.push(copy);
    }
    this.moments.push({ diveS, tiles, originM: model.originM });
    if (this.bytes > MAX_BYTES) this.#thin();
  }

  #thin() {
    this.moments = this.moments.filter((_, i) => i % 2 === 0);
    this.stepS *= 2;
    const kept = new Set();
    for (const moment of this.moments) for (const tile of moment.tiles) kept.add(tile);
    this.bytes = 0;
    for (const tile of kept) this.bytes += tile.floats.byteLength;
  }

  pose(pose) {
    const last = this.poses.at(-1);
    if (last && pose.dive_s < last.dive_s) this.poses = [];
    this.poses.push(pose);
    if (this.poses.length > MAX_POSES) this.poses = this.poses.filter((_, i) => i % 2 === 0);
  }

  /// From the first to the last moment kept, seconds of the dive.
  span() {
    return this.moments.length > 1 ? [this.moments[0].diveS, this.moments.at(-1).diveS] : null;
  }

  /// The newest moment at or before a time, and the pose nearest to it.
  at(diveS) {
    const moment = lastBefore(this.moments, diveS, (m) => m.diveS) ?? this.moments[0];
    const pose = lastBefore(this.poses, diveS, (p) => p.dive_s);
    return { moment, pose };
  }
}

export function lastBefore(list, time, timeOf) {
  let [low, high] = [0, list.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (timeOf(list[middle]) <= time) low = middle + 1;
    else high = middle;
  }
  return list[low - 1];
}
