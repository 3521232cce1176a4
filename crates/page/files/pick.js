// What a click tells of the Gaussian there: where it is, how sure, and why the map says so.

import { shownTiles } from "./drawing.js";
import { add, dot, sub } from "./math.js";
import { isPicking, take } from "./measure.js";
import { $, canvas, state } from "./state.js";
import { camera } from "./views.js";
import { FIELD, POINT_FLOATS, WHY_BYTES } from "./wire.js";

/// What moves less, pixels, is a click and turns nothing worth telling of.
const STILL_PX = 5;
/// A small Gaussian is hit this near to its centre, pixels.
const REACH_PX = 6;
const UNITS = { percent: " %", centimetres: " cm", nats: " nats", gaussians: " confident Gaussians" };

/// The nearest to the eye of those at a place of the picture, pixels from its top left; null if there is none.
export function picked(x, y) {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const view = camera.view(width, height);
  const { tiles, originM } = shownTiles();
  let found = null;
  for (const tile of tiles) {
    const f = tile.floats;
    for (let slot = 0; slot < tile.count; slot += 1) {
      const at = slot * POINT_FLOATS;
      const isConfident = f[at + FIELD.confident] > 0.5;
      if (!isConfident && !state.shows.ambiguous) continue;
      const away = sub([f[at], f[at + 1], f[at + 2]], view.eye);
      const depth = dot(away, view.forward);
      if (depth < view.near || (found && depth >= found.depth)) continue;
      const perMetre = height / (2 * depth * view.tanY);
      const dx = width / 2 + dot(away, view.right) * perMetre - x;
      const dy = height / 2 - dot(away, view.up) * perMetre - y;
      const scale = Math.min(f[at + FIELD.scale], f[at + FIELD.scale + 1], f[at + FIELD.scale + 2]);
      if (Math.hypot(dx, dy) <= Math.max(REACH_PX, state.extent * scale * perMetre)) found = { depth, tile, slot, isConfident };
    }
  }
  return found && told(found, originM);
}

function told({ tile, slot, isConfident }, originM) {
  const at = slot * POINT_FLOATS;
  const place = add(originM, [0, 1, 2].map((axis) => tile.floats[at + axis]));
  const [number, clear, measured] = tile.whys.subarray(slot * WHY_BYTES, (slot + 1) * WHY_BYTES);
  return { place, isConfident, sigma: tile.floats[at + FIELD.sigma], reason: state.reasons[number]?.name ?? "unknown", why: words(number, clear, measured) };
}

/// The reason in words, as `echosplat info --why` has it.
function words(number, clear, measured) {
  const reason = state.reasons[number] ?? state.reasons[0];
  if (!reason) return "";
  const orMore = (value) => (value === 255 ? "255 or more" : String(value));
  return reason.words.replaceAll("{}", orMore(measured) + (UNITS[reason.unit] ?? "")).replaceAll("{clear}", orMore(clear));
}

/// Shows it, or nothing.
function show(one) {
  $("picked").hidden = !one;
  if (!one) return;
  const place = one.place.map((value) => value.toFixed(2)).join(", ").replaceAll("-", "−");
  const sigma = Number.isFinite(one.sigma) ? `sigma ${one.sigma.toFixed(2)} m` : "sigma unknown";
  $("picked").firstElementChild.textContent = `${one.isConfident ? "Confident" : "Ambiguous"} at ${place} m, ${sigma}`;
  $("picked").lastElementChild.textContent = one.why;
}

let pressed = null;
canvas.addEventListener("pointerdown", (event) => {
  pressed = event.isPrimary && event.button === 0 ? [event.offsetX, event.offsetY] : null;
});
canvas.addEventListener("pointerup", (event) => {
  const isStill = pressed && Math.hypot(event.offsetX - pressed[0], event.offsetY - pressed[1]) < STILL_PX;
  pressed = null;
  if (!isStill) return;
  const one = picked(event.offsetX, event.offsetY);
  if (isPicking()) take(one?.place);
  else show(one);
});
