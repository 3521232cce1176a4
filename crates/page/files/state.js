// What the parts of the live page share: the map, what is known of the dive, and what is looked at.

import { Pings } from "./charts.js";
import { LIVE_MODES } from "./colors.js";
import { History } from "./history.js";
import { MapModel } from "./map.js";
import { Panels } from "./panels.js";
import { Scene } from "./scene.js";

export const $ = (id) => document.getElementById(id);
export const canvas = $("view");
export const model = new MapModel();
export const past = new History();
export const scene = new Scene();
export const panels = new Panels();
export const pings = new Pings($("ping"), $("waterfall"));
export const state = {
  /// null where nothing can be drawn.
  renderer: null,
  mode: localStorage.getItem("echosplat-mode") ?? "height",
  extent: 1.6,
  shows: { ambiguous: true, track: true, fan: true, grid: true, lighting: true },
  pose: null,
  diveS: 0,
  firstTimeNs: null,
  at: null, // seconds of the dive that are looked back at; null is live
  follows: false,
  hasFitted: false,
  summary: null,
  summaryAt: 0,
  errors: [],
  tileEdgeM: 4,
  /// Name, words and unit of each reason of a verdict, by its number.
  reasons: [],
  needsPicture: true,
  frames: [],
  frameMs: 16,
  /// What the last picture in full took; forgotten by and by.
  fullMs: 0,
  latencies: [],
  waiting: [],
  /// When each of the newest pings was sent here, and how long until a map that holds it was drawn, ms.
  pingsSent: new Map(),
  pingLatencies: [],
  /// Of each delta, ms: until it was here, until a picture with it was begun, until that was drawn.
  stages: { delivered: [], waited: [], drawn: [] },
  movedAt: 0,
  asksAgainAt: 0,
  updates: 0,
  updatedAt: 0,
  throttledUntil: 0,
};
if (!LIVE_MODES[state.mode]) state.mode = "height";
