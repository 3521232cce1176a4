// Joins the connection, the map, the picture and the panels: switches, keys, and what tests look at.

import { gradient, LIVE_MODES } from "./colors.js";
import { draw, lit } from "./drawing.js";
import { wake } from "./frames.js";
import "./incoming.js";
import { nextMode, readPalette, setMode, showLegend } from "./legend.js";
import { clamp, rotated } from "./math.js";
import { isPicking, measured, toggleMeasuring } from "./measure.js";
import { picked } from "./pick.js";
import { showErrors } from "./plots.js";
import { $, canvas, model, panels, past, pings, scene, state } from "./state.js";
import { lookAt } from "./time.js";
import { camera, VIEWS } from "./views.js";

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
  c: nextMode, m: () => toggleMeasuring(),
  " ": () => lookAt(state.at === null ? state.diveS : null),
  escape: () => {
    panels.toggle(false);
    if (isPicking()) toggleMeasuring(false);
    $("picked").hidden = true;
  },
};
addEventListener("keydown", (event) => {
  const isTyping = event.target.closest("input:not([type=range]):not([type=checkbox]), select, textarea");
  const isButton = event.target.closest("button, summary, a, input");
  const act = KEYS[event.key.toLowerCase()];
  if (!act || isTyping || event.ctrlKey || event.metaKey || event.altKey || (event.key === " " && isButton)) return;
  event.preventDefault();
  act();
});
canvas.addEventListener("pointerdown", () => isPicking() || panels.toggle(false));
$("db-ramp").style.background = gradient("echo");
new ResizeObserver(() => {
  pings.isDirty = true;
  showErrors();
  wake();
}).observe(canvas);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  readPalette();
  pings.isDirty = true;
  showErrors();
});
readPalette();
showLegend();

/// For tests and for whoever is curious.
window.echosplat = {
  model, past, camera, state, pings, scene,
  get renderer() { return state.renderer; },
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
      frameMs: state.frameMs, rate: state.rate, scale: state.renderer?.scale, card: state.renderer?.name(),
      confident: state.summary?.confident, ambiguous: state.summary?.ambiguous,
    };
  },
  draw,
  lit,
  measured,
  picked,
  wake,
};
