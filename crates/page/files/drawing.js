// The picture: drawn when something is new, as sharp as there is time for.

import { CALM_AFTER_MS, eachFrame, wake, wakeAfter } from "./frames.js";
import { palette, showLegend, shownRange, updateEmpty } from "./legend.js";
import { summary } from "./map.js";
import { mix, shown, sub } from "./math.js";
import { drawGizmo, showScale } from "./picture.js";
import { Renderer } from "./renderer.js";
import { $, canvas, model, past, scene, state } from "./state.js";
import { camera, fitWhileGrowing } from "./views.js";

const SUMMARY_EVERY_MS = 700;
/// Frames slower than this make the picture coarser, faster ones finer.
const SLOW_MS = 40;
const FAST_MS = 22;
const COARSEST = 0.4;
/// Then only every so many-th Gaussian is drawn while the picture moves.
const MOST_THINNED = 16;
/// Fewer are not what makes a picture slow.
const THINNED_FROM = 10000;
/// A still picture may take so long to be drawn in full; longer while the map does not change. What is new
/// should be seen at once rather than sharply.
const STILL_MS = 50;
const CALM_MS = 2500;
const STILL_AFTER_MS = 350;

try {
  state.renderer = new Renderer(canvas);
} catch (error) {
  $("no-webgl").hidden = false;
  $("no-webgl").textContent = `The map cannot be drawn: ${error.message}. Panels and downloads work.`;
}
canvas.addEventListener("webglcontextlost", (event) => {
  event.preventDefault();
  state.renderer = null;
});
canvas.addEventListener("webglcontextrestored", () => {
  state.renderer = new Renderer(canvas);
  for (const tile of model.tiles.values()) tile.dirty = [0, tile.count];
  wake();
});

/// What is looked at: now, or a moment before.
export function shownTiles() {
  if (state.at === null) return { tiles: [...model.tiles.values()], originM: model.originM, pose: state.pose };
  const { moment, pose } = past.at(state.at);
  return { tiles: moment?.tiles ?? [], originM: moment?.originM ?? model.originM, pose: pose ?? state.pose };
}

function frame() {
  const now = performance.now();
  const moves = camera.step();
  const isHeld = now - state.movedAt < STILL_AFTER_MS;
  // Where a picture takes long, the map's changes leave time for everything else.
  if (!moves && !isHeld && now < state.throttledUntil) {
    wakeAfter(state.throttledUntil - now);
    return;
  }
  if (state.renderer && state.needsPicture) draw(now, moves || isHeld);
  if (moves || state.needsPicture) wake();
  else if (isHeld) setTimeout(wake, STILL_AFTER_MS);
}

export function draw(now, isMoving) {
  const { renderer } = state;
  state.needsPicture = false;
  const { tiles, originM, pose } = shownTiles();
  if (now - state.summaryAt > SUMMARY_EVERY_MS || !state.summary) {
    state.summaryAt = now;
    state.summary = summary(tiles);
    showLegend();
    updateEmpty();
  }
  const found = state.summary;
  fitWhileGrowing(found);
  if (state.follows && pose) camera.targetM = mix(camera.targetM, sub(pose.position_m, originM), isMoving ? 0.5 : 0.25);
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  const view = { ...camera.view(width, height), width, height };
  const floorM = found.isEmpty ? -2 : Math.floor((found.low[2] - 0.05) * 2) / 2;
  scene.build({ originM, pose, view, targetM: camera.targetM, floorM, colors: palette, until: state.at, width });
  const range = shownRange();
  const began = performance.now();
  const coarse = { scale: renderer.scale, thinning: renderer.thinning };
  const predicted = Math.max(state.frameMs * coarse.thinning * coarse.scale ** -2, state.fullMs);
  const isCalm = now - state.updatedAt > CALM_AFTER_MS;
  const isStill = !isMoving && (coarse.scale < 1 || coarse.thinning > 1) && predicted < (isCalm ? CALM_MS : STILL_MS);
  if (isStill) Object.assign(renderer, { scale: 1, thinning: 1 });
  renderer.draw(view, {
    tiles,
    tileEdgeM: state.tileEdgeM,
    mode: state.mode,
    range: state.mode === "age" ? [0, range[1]] : range,
    now: state.at ?? state.diveS,
    extent: state.extent,
    showsAmbiguous: state.shows.ambiguous,
    lighting: state.shows.lighting,
    background: palette.ground,
    ...scene.layers({ showsGrid: state.shows.grid, showsTrack: state.shows.track, showsFan: state.shows.fan }),
  });
  const sent = state.waiting.splice(0);
  // A pixel is asked for, so that the card has really drawn when the clock is read.
  if (sent.length || state.measures) renderer.gl.readPixels(0, 0, 1, 1, renderer.gl.RGBA, renderer.gl.UNSIGNED_BYTE, new Uint8Array(4));
  const ended = performance.now();
  const tookMs = performance.now() - now;
  for (const [ms, ping, hereMs] of sent) {
    state.latencies.push(Date.now() - ms);
    state.stages.delivered.push(hereMs - ms);
    state.stages.waited.push(Math.max(0, Date.now() - hereMs - tookMs));
    state.stages.drawn.push(tookMs);
    if (!state.pingsSent.has(ping)) continue;
    state.pingLatencies.push(Date.now() - state.pingsSent.get(ping));
    state.pingsSent.delete(ping);
  }
  for (const list of [state.latencies, state.pingLatencies, ...Object.values(state.stages)]) if (list.length > 2000) list.splice(0, 1000);
  measure(now, ended - began, isMoving, isStill, coarse);
  drawGizmo($("gizmo"), view);
  showScale($("scale").querySelector("i"), $("scale").querySelector("span"), view);
}

/// Coarser when frames are slow, finer when they are fast.
function measure(now, drawMs, isMoving, isStill, coarse) {
  const { renderer } = state;
  state.frames.push(now);
  while (state.frames[0] < now - 2000) state.frames.shift();
  if (renderer.drewMap) {
    state.drawMs = drawMs;
    say(now, drawMs);
  }
  state.throttledUntil = drawMs > SLOW_MS ? now + Math.min(500, drawMs * 2) : 0;
  const rate = state.frames.length > 2 ? (1000 * (state.frames.length - 1)) / (now - state.frames[0]) : 0;
  state.rate = rate;
  if (isStill) {
    Object.assign(renderer, coarse);
    if (renderer.drewMap) state.fullMs = drawMs;
    return;
  }
  if (!renderer.drewMap) return;
  const between = state.frames.length > 1 ? now - state.frames.at(-2) : drawMs;
  const cost = isMoving && between < 400 ? Math.max(drawMs, between) : drawMs;
  state.frameMs += (cost - state.frameMs) * 0.3;
  state.fullMs *= 0.98;
  if (state.frameMs > SLOW_MS && renderer.scale > COARSEST) {
    renderer.scale = Math.max(COARSEST, renderer.scale * 0.85);
    state.frameMs *= 0.8;
  } else if (state.frameMs > SLOW_MS && renderer.thinning < MOST_THINNED && renderer.drawn > THINNED_FROM) {
    renderer.thinning *= 2;
    state.frameMs *= 0.6;
  } else if (state.frameMs < FAST_MS && renderer.thinning > 1) {
    renderer.thinning /= 2;
    state.frameMs *= 1.8;
  } else if (state.frameMs < FAST_MS && renderer.scale < 1) {
    renderer.scale = Math.min(1, renderer.scale * 1.08);
  }
}

function say(now, drawMs) {
  const { renderer } = state;
  if (now - (state.saidAt ?? 0) < 500) return;
  state.saidAt = now;
  const coarser = renderer.scale < 0.99 ? `, at ${Math.round(renderer.scale * 100)} % of the resolution` : "";
  const thinned = renderer.thinning > 1 ? `, one in ${renderer.thinning}` : "";
  const card = renderer.isSoftware() ? ", without a graphics card" : "";
  $("drawing").textContent = `${shown(renderer.drawn)} Gaussians drawn${thinned}, ${shown(drawMs, 1)} ms a picture${coarser}${card}`;
}

/// Draws now and counts the pixels that are not the ground's.
export function lit() {
  state.renderer.thinning = 1;
  draw(performance.now(), true);
  return state.renderer.lit(palette.ground);
}

eachFrame(frame);
