// Draws one finished map in a document that stands alone. `#map-head` holds JSON: how many Gaussians, how
// their numbers are written, what is known of them; `#map-data` holds the numbers, base64. The elements of
// `#viewer` are the picture, its buttons, its colours, its axes and its scale. Where it cannot draw, the
// document keeps `#flat` instead.

import { Camera } from "./camera.js";
import { MODES, unitRgb } from "./colors.js";
import { summary, Tile } from "./map.js";
import { colorRange, drawGizmo, fitted, sceneColors, showRamp, showScale, SIDES } from "./picture.js";
import { Renderer } from "./renderer.js";
import { Scene } from "./scene.js";
import { FIELD, POINT_FLOATS } from "./wire.js";

/// Bytes of a Gaussian and of a place of the track; the report writes them.
const GAUSSIAN_BYTES = 18;
const PLACE_BYTES = 6;
const TILE_EDGE_M = 4;
/// Frames slower than this are drawn coarser while the picture moves.
const SLOW_MS = 60;
const COARSE = 0.5;
const STILL_AFTER_MS = 300;

const find = (selector) => document.getElementById("viewer").querySelector(selector);
const head = JSON.parse(document.getElementById("map-head").textContent);
const data = bytesOf(document.getElementById("map-data").textContent.trim());
const canvas = find("canvas.view");
const state = { mode: head.has_change ? "change" : head.has_error ? "error" : "height", showsAmbiguous: true, isMoving: false, drawMs: 0 };

function bytesOf(base64) {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i += 1) bytes[i] = text.charCodeAt(i);
  return new DataView(bytes.buffer);
}

const placeAt = (at, box) => [0, 1, 2].map((axis) => box.low[axis] + data.getUint16(at + 2 * axis, true) * box.step[axis]);
/// 0 to 255 over [low, high], both logarithms.
const logarithmic = (byte, [low, high]) => Math.exp(low + (byte / 255) * (high - low));

function tilesOf() {
  const tiles = new Map();
  const point = new Float32Array(POINT_FLOATS);
  const words = new Uint32Array(point.buffer);
  for (let i = 0; i < head.count; i += 1) {
    const at = i * GAUSSIAN_BYTES;
    const byte = (offset) => data.getUint8(at + offset);
    const place = placeAt(at, head.box);
    point.set(place, FIELD.x);
    for (let axis = 0; axis < 3; axis += 1) point[FIELD.scale + axis] = logarithmic(byte(6 + axis), head.scale) * head.larger;
    const turn = [9, 10, 11, 12].map((offset) => data.getInt8(at + offset));
    const norm = Math.hypot(...turn) || 1;
    point.set(turn.map((value) => value / norm), FIELD.rotation);
    point[FIELD.opacity] = byte(13) / 255;
    point[FIELD.reflectivity] = logarithmic(byte(14), head.reflectivity);
    point[FIELD.sigma] = logarithmic(byte(15), head.sigma);
    words[FIELD.confident] = byte(17) & 1;
    const name = place.map((value) => Math.floor(value / TILE_EDGE_M)).join("_");
    if (!tiles.has(name)) tiles.set(name, new Tile(name));
    tiles.get(name).put(i, point, 0, head.has_change ? byte(17) >> 1 : byte(16) * head.error_step);
  }
  return [...tiles.values()];
}

function trackOf() {
  const begin = head.count * GAUSSIAN_BYTES;
  return Array.from({ length: head.track.count }, (_, i) => [i, ...placeAt(begin + i * PLACE_BYTES, head.track)]);
}

const tiles = tilesOf();
const found = summary(tiles);
const scene = new Scene();
scene.setTrack(trackOf());
const night = matchMedia("(prefers-color-scheme: dark)");
let colors = sceneColors(night.matches, unitRgb);
let isScheduled = false;
let stillTimer = null;

function wake() {
  if (isScheduled) return;
  isScheduled = true;
  requestAnimationFrame(frame);
}

function moved() {
  state.isMoving = true;
  clearTimeout(stillTimer);
  stillTimer = setTimeout(() => {
    state.isMoving = false;
    wake();
  }, STILL_AFTER_MS);
  wake();
}

function frame() {
  isScheduled = false;
  if (camera.step()) moved();
  draw();
}

function draw() {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const view = { ...camera.view(width, height), width, height };
  const floorM = found.isEmpty ? -2 : Math.floor((found.low[2] - 0.05) * 2) / 2;
  scene.build({ originM: [0, 0, 0], pose: null, view, targetM: camera.targetM, floorM, colors, until: null, width });
  renderer.scale = state.isMoving && state.drawMs > SLOW_MS ? COARSE : 1;
  const began = performance.now();
  renderer.draw(view, {
    tiles, tileEdgeM: TILE_EDGE_M, mode: state.mode, range: colorRange(state.mode, found, 0), now: 0, extent: 1.6,
    showsAmbiguous: state.showsAmbiguous, lighting: true, background: colors.ground,
    ...scene.layers({ showsGrid: true, showsTrack: true, showsFan: false }),
  });
  // A pixel is asked for, so that the card has really drawn when the clock is read.
  renderer.gl.readPixels(0, 0, 1, 1, renderer.gl.RGBA, renderer.gl.UNSIGNED_BYTE, new Uint8Array(4));
  if (renderer.scale === 1) state.drawMs = performance.now() - began;
  drawGizmo(find("canvas.gizmo"), view);
  showScale(find(".bar i"), find(".bar span"), view);
}

function showLegend() {
  const elements = { ramp: find(".ramp"), ends: find(".ends").children, says: find(".says") };
  showRamp(elements, state.mode, colorRange(state.mode, found, 0));
}

function look(side, isAtOnce = false) {
  camera.go({ ...side, ...fitted(found) }, isAtOnce);
}

/// Only what this map knows: its age is over, its error known where there is a truth.
const knows = { age: false, error: head.has_error, change: head.has_change === true };
const modes = Object.keys(MODES).filter((name) => knows[name] ?? true);
for (const name of modes) find("select").append(new Option(MODES[name].name, name));
find("select").value = state.mode;
find("select").addEventListener("change", (event) => {
  state.mode = event.target.value;
  showLegend();
  wake();
});
find("input").addEventListener("change", (event) => {
  state.showsAmbiguous = event.target.checked;
  wake();
});
for (const button of find(".sides").children) button.addEventListener("click", () => look(SIDES[button.dataset.view]));

const renderer = begin();
const camera = renderer && new Camera(canvas, moved, () => {}, { wheelNeedsFocus: true });
if (renderer) {
  showLegend();
  look({}, true);
  new ResizeObserver(wake).observe(canvas);
  addEventListener("beforeprint", draw);
  night.addEventListener("change", () => {
    colors = sceneColors(night.matches, unitRgb);
    wake();
  });
}

/// The renderer, with the picture shown; null where this browser cannot.
function begin() {
  try {
    document.getElementById("viewer").hidden = false;
    return new Renderer(canvas);
  } catch (error) {
    document.getElementById("viewer").hidden = true;
    const note = document.getElementById("no-viewer");
    note.hidden = false;
    note.textContent = `The map cannot be turned here: ${error.message}. It stands below from three sides.`;
    return null;
  }
}

/// For tests and for whoever is curious.
window.viewer = {
  head, tiles, camera, state, renderer, summary: found,
  /// Draws now and counts the pixels that differ from the ground.
  lit() {
    draw();
    return renderer.lit(colors.ground);
  },
};
