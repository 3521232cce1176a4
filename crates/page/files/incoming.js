// What the service sends, and where it goes.

import { Connection } from "./connection.js";
import { CALM_AFTER_MS, wake } from "./frames.js";
import { updateEmpty } from "./legend.js";
import { LOST_THREAD, OLD } from "./map.js";
import { forget } from "./measure.js";
import { showErrors } from "./plots.js";
import { model, panels, past, pings, scene, state } from "./state.js";
import { showTime } from "./time.js";
import { parse } from "./wire.js";

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
      forget();
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
  state.reasons = message.reasons;
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
