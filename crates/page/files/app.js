// Joins the connection, the map, the picture and the panels.

import { Camera } from "./camera.js";
import { drawErrors, Pings, signed } from "./charts.js";
import { gradient, LIVE_MODES, MODES, unitRgb } from "./colors.js";
import { Connection } from "./connection.js";
import { History } from "./history.js";
import { LOST_THREAD, MapModel, OLD, summary } from "./map.js";
import { clamp, mix, rotated, shown, sub } from "./math.js";
import { Panels } from "./panels.js";
import { colorRange, drawGizmo, fitted, sceneColors, showRamp, showScale, SIDES } from "./picture.js";
import { Renderer } from "./renderer.js";
import { Scene } from "./scene.js";
import { parse } from "./wire.js";

const $ = (id) => document.getElementById(id);
const SUMMARY_EVERY_MS = 700;
const CHARTS_EVERY_MS = 90;
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
const CALM_AFTER_MS = 900;

const canvas = $("view");
const model = new MapModel();
const past = new History();
const scene = new Scene();
const panels = new Panels();
const pings = new Pings($("ping"), $("waterfall"));
const state = {
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

let renderer = null;
try {
  renderer = new Renderer(canvas);
} catch (error) {
  $("no-webgl").hidden = false;
  $("no-webgl").textContent = `The map cannot be drawn: ${error.message}. Panels and downloads work.`;
}
canvas.addEventListener("webglcontextlost", (event) => {
  event.preventDefault();
  renderer = null;
});
canvas.addEventListener("webglcontextrestored", () => {
  renderer = new Renderer(canvas);
  for (const tile of model.tiles.values()) tile.dirty = [0, tile.count];
  wake();
});

const camera = new Camera(canvas, () => {
  state.movedAt = performance.now();
  wake();
}, (pans) => {
  state.hasFitted = true;
  if (pans) setFollow(false);
});

// ---- what comes ----

const connection = new Connection({
  open() {
    panels.connected(true);
    model.waitsForSnapshot = true;
  },
  lost(why, waitS) {
    panels.connected(false, why, waitS);
  },
  text(message) {
    if (message.kind === "hello") hello(message);
    if (message.kind === "status") takeStatus(message.status);
    if (message.kind === "pose") takePose(message);
    if (message.kind === "error") {
      if (state.errors.length && message.error.dive_s < state.errors.at(-1).dive_s) state.errors = [];
      state.errors.push(message.error);
      showErrors();
    }
    if (message.kind === "epoch") {
      scene.setTrack([]);
      past.clear();
      state.hasFitted = false;
      state.fittedReach = 0;
    }
  },
  binary(buffer) {
    const message = parse(buffer);
    if (message.kind === "ping") takePing(message);
    else takeMap(message);
    if (message.kind === "ping" && state.firstTimeNs === null) state.firstTimeNs = message.header.time_ns;
  },
});

function hello(message) {
  panels.hello(message);
  scene.fanDeg = message.fan_deg;
  scene.setTrack(message.track);
  state.tileEdgeM = message.tile_edge_m;
  state.firstTimeNs = message.first_time_ns ?? state.firstTimeNs;
  state.errors = message.errors;
  showErrors();
  if (message.pose) takePose(message.pose);
  if (message.status) takeStatus(message.status);
}

function takeStatus(status) {
  panels.status(status);
  updateEmpty();
}

function takePose(pose) {
  state.pose = pose;
  state.diveS = pose.dive_s;
  if (state.firstTimeNs === null) state.firstTimeNs = pose.time_ns - pose.dive_s * 1e9;
  past.pose(pose);
  scene.addToTrack(pose.dive_s, pose.position_m);
  if (state.at === null) wake();
  showTime();
}

function takePing({ header, payload, sentMs }) {
  pings.push(header, payload);
  state.pingsSent.set(header.sequence, sentMs);
  if (state.pingsSent.size > 1000) state.pingsSent.delete(state.pingsSent.keys().next().value);
}

function takeMap({ kind, header, payload, sentMs }) {
  const changed = state.firstTimeNs === null ? 0 : (header.time_ns - state.firstTimeNs) * 1e-9;
  const before = model.epoch;
  const became = kind === "snapshot" ? model.snapshot(header, payload, changed) : model.delta(header, payload, changed);
  if (became === LOST_THREAD && performance.now() > state.asksAgainAt) {
    state.asksAgainAt = performance.now() + 1000;
    connection.send("snapshot");
  }
  if (became === LOST_THREAD || became === OLD) return;
  if (before !== model.epoch && before !== null) past.clear();
  state.updates += 1;
  state.updatedAt = performance.now();
  clearTimeout(state.calmTimer);
  state.calmTimer = setTimeout(wake, CALM_AFTER_MS + 100);
  const isWatched = state.at === null && !document.hidden;
  if (kind === "delta" && isWatched && state.waiting.length < 1000) state.waiting.push([sentMs, header.through_ping, Date.now()]);
  past.keep(changed, model);
  if (state.at === null) wake();
}

// ---- the picture ----

function shownTiles() {
  if (state.at === null) return { tiles: [...model.tiles.values()], originM: model.originM, pose: state.pose };
  const { moment, pose } = past.at(state.at);
  return { tiles: moment?.tiles ?? [], originM: moment?.originM ?? model.originM, pose: pose ?? state.pose };
}

let isScheduled = false;
function wake() {
  state.needsPicture = true;
  if (isScheduled) return;
  isScheduled = true;
  requestAnimationFrame(frame);
}

function frame() {
  isScheduled = false;
  const now = performance.now();
  const moves = camera.step();
  const isHeld = now - state.movedAt < STILL_AFTER_MS;
  // Where a picture takes long, the map's changes leave time for everything else.
  if (!moves && !isHeld && now < state.throttledUntil) {
    isScheduled = true;
    setTimeout(() => requestAnimationFrame(frame), state.throttledUntil - now);
    return;
  }
  if (renderer && state.needsPicture) draw(now, moves || isHeld);
  if (moves || state.needsPicture) wake();
  else if (isHeld) setTimeout(wake, STILL_AFTER_MS);
}

function draw(now, isMoving) {
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
  if (now - (state.saidAt ?? 0) < 500) return;
  state.saidAt = now;
  const coarser = renderer.scale < 0.99 ? `, at ${Math.round(renderer.scale * 100)} % of the resolution` : "";
  const thinned = renderer.thinning > 1 ? `, one in ${renderer.thinning}` : "";
  const card = renderer.isSoftware() ? ", without a graphics card" : "";
  $("drawing").textContent = `${shown(renderer.drawn)} Gaussians drawn${thinned}, ${shown(drawMs, 1)} ms a picture${coarser}${card}`;
}

// ---- colours and legend ----

const shownRange = () => colorRange(state.mode, state.summary, state.at ?? state.diveS);

function showLegend() {
  showRamp({ ramp: $("ramp"), ends: $("ramp-ends").children, says: $("ramp-says") }, state.mode, shownRange());
  const { ambiguous } = state.summary ?? { ambiguous: 0 };
  $("ambiguous-count").textContent = `${shown(ambiguous)} ambiguous${state.shows.ambiguous ? "" : ", hidden"}`;
}

function setMode(mode) {
  state.mode = mode;
  localStorage.setItem("echosplat-mode", mode);
  $("mode").value = mode;
  showLegend();
  wake();
}

let palette = null;
function readPalette() {
  const isDark = matchMedia("(prefers-color-scheme: dark)").matches;
  const style = getComputedStyle(document.documentElement);
  const probe = document.createElement("i");
  document.body.append(probe);
  const color = (name) => {
    probe.style.color = style.getPropertyValue(name);
    return getComputedStyle(probe).color;
  };
  palette = {
    ...sceneColors(isDark, unitRgb),
    chart: { line: color("--line"), soft: color("--soft"), accent: color("--accent"), warn: color("--warn") },
  };
  probe.remove();
  wake();
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  readPalette();
  pings.isDirty = true;
  showErrors();
});

function updateEmpty() {
  const isEmpty = !state.summary || state.summary.confident + state.summary.ambiguous === 0;
  $("empty").hidden = !isEmpty || !renderer;
}

// ---- views ----

/// The whole map in the picture, from where it is looked at or from another side.
function fit(from = {}, isAtOnce = false) {
  setFollow(false);
  const place = fitted(state.summary);
  if (!place) {
    camera.go(from, isAtOnce);
    return;
  }
  const { targetM, distanceM, reach } = place;
  camera.go({ ...from, targetM, distanceM }, isAtOnce);
  state.fittedReach = reach;
}

/// Until somebody moves the camera, it keeps the growing map in the picture.
function fitWhileGrowing(found) {
  if (state.hasFitted || found.isEmpty || found.confident < 30) return;
  const { reach } = fitted(found);
  if (reach < (state.fittedReach ?? 0) * 1.15) return;
  fit({}, !state.fittedReach);
}

const VIEWS = {
  ...Object.fromEntries(Object.entries(SIDES).map(([name, side]) => [name, () => fit(side)])),
  follow: () => setFollow(!state.follows),
};

function setFollow(follows) {
  if (state.follows === follows) return;
  state.follows = follows;
  if (follows) state.hasFitted = true;
  document.querySelector('[data-view="follow"]').setAttribute("aria-pressed", follows);
  wake();
}

// ---- time ----

function showTime() {
  const span = past.span();
  const slider = $("time");
  slider.disabled = !span;
  if (span) {
    slider.min = span[0];
    slider.max = span[1];
    if (state.at === null) slider.value = span[1];
  }
  const isLive = state.at === null;
  $("live").setAttribute("aria-pressed", isLive);
  const end = span ? span[1] : state.diveS;
  $("time-says").textContent = isLive ? `${state.diveS.toFixed(1)} s` : `${state.at.toFixed(1)} of ${end.toFixed(1)} s`;
}

function lookAt(diveS) {
  state.at = diveS;
  state.summaryAt = 0;
  pings.isDirty = true;
  showTime();
  wake();
}

$("time").addEventListener("input", () => lookAt(Number($("time").value)));
$("live").addEventListener("click", () => lookAt(null));

// ---- charts ----

function showErrors() {
  $("panel-error").hidden = !state.errors.length;
  if (state.errors.length && !state.hasShownErrors) {
    state.hasShownErrors = true;
    $("panel-error").open = true;
  }
  if ($("panel-error").open && palette) drawErrors($("error"), state.errors, palette.chart);
}

setInterval(() => {
  if (!pings.isDirty || !$("panel-ping").open || document.hidden || !palette || !$("ping").clientWidth) return;
  const untilS = state.at === null || state.firstTimeNs === null ? null : state.firstTimeNs * 1e-9 + state.at;
  const drawn = pings.draw(untilS, palette.chart);
  if (!drawn) return;
  const { newest, topDb, lowDb } = drawn;
  $("ping-says").textContent = `№ ${shown(newest.sequence)}`;
  $("db-low").textContent = `${signed(lowDb)} dB`;
  $("db-high").textContent = `${signed(topDb)} dB`;
}, CHARTS_EVERY_MS);

// ---- switches and keys ----

const SWITCHES = { "shows-ambiguous": "ambiguous", "shows-track": "track", "shows-fan": "fan", "shows-grid": "grid", lighting: "lighting" };
for (const [id, name] of Object.entries(SWITCHES)) {
  $(id).checked = state.shows[name];
  $(id).addEventListener("change", () => {
    state.shows[name] = $(id).checked;
    showLegend();
    wake();
  });
}
const flip = (id) => $(id).click();
$("extent").addEventListener("input", () => {
  state.extent = Number($("extent").value);
  $("extent").nextElementSibling.textContent = `${state.extent.toFixed(1)} σ`;
  wake();
});
$("extent").nextElementSibling.textContent = "1.6 σ";
for (const [name, { name: label }] of Object.entries(LIVE_MODES)) $("mode").append(new Option(label, name));
$("mode").value = state.mode;
$("mode").addEventListener("change", () => setMode($("mode").value));
for (const button of document.querySelectorAll("[data-view]")) {
  button.addEventListener("click", () => VIEWS[button.dataset.view]());
}
const KEYS = {
  h: VIEWS.fit, t: VIEWS.top, s: VIEWS.south, e: VIEWS.east, f: VIEWS.follow,
  a: () => flip("shows-ambiguous"), k: () => flip("shows-track"), n: () => flip("shows-fan"),
  g: () => flip("shows-grid"), l: () => flip("lighting"),
  c: () => {
    const names = Object.keys(LIVE_MODES);
    setMode(names[(names.indexOf(state.mode) + 1) % names.length]);
  },
  " ": () => lookAt(state.at === null ? state.diveS : null),
  escape: () => panels.toggle(false),
};
addEventListener("keydown", (event) => {
  const isTyping = event.target.closest("input:not([type=range]):not([type=checkbox]), select, textarea");
  const isButton = event.target.closest("button, summary, a, input");
  const act = KEYS[event.key.toLowerCase()];
  if (!act || isTyping || event.ctrlKey || event.metaKey || event.altKey || (event.key === " " && isButton)) return;
  event.preventDefault();
  act();
});
canvas.addEventListener("pointerdown", () => panels.toggle(false));
$("db-ramp").style.background = gradient("echo");
new ResizeObserver(() => {
  pings.isDirty = true;
  showErrors();
  wake();
}).observe(canvas);
$("panel-error").addEventListener("toggle", showErrors);
$("panel-ping").addEventListener("toggle", () => (pings.isDirty = true));
readPalette();
showLegend();

/// For tests and for whoever is curious.
window.echosplat = {
  model, past, camera, state, pings, scene,
  get renderer() { return renderer; },
  forward: () => rotated(state.pose?.orientation_wxyz ?? [1, 0, 0, 0], [1, 0, 0]),
  stats() {
    const spread = (list) => {
      const sorted = list.toSorted((a, b) => a - b);
      const part = (share) => sorted[clamp(Math.floor(sorted.length * share), 0, sorted.length - 1)];
      return { p50: part(0.5), p90: part(0.9), p99: part(0.99), count: sorted.length };
    };
    return {
      epoch: model.epoch, sequence: model.sequence, gaussians: model.count(), isFinal: model.isFinal,
      updates: state.updates, latencyMs: spread(state.latencies), pingToScreenMs: spread(state.pingLatencies),
      stagesMs: Object.fromEntries(Object.entries(state.stages).map(([name, list]) => [name, spread(list)])),
      frameMs: state.frameMs, rate: state.rate, scale: renderer?.scale, card: renderer?.name(),
      confident: state.summary?.confident, ambiguous: state.summary?.ambiguous,
    };
  },
  draw,
  /// Draws now and counts the pixels that are not the ground's.
  lit() {
    renderer.thinning = 1;
    draw(performance.now(), true);
    return renderer.lit(palette.ground);
  },
  wake,
};
