// Colours of the picture and what they say.

import { LIVE_MODES, unitRgb } from "./colors.js";
import { wake } from "./frames.js";
import { shown } from "./math.js";
import { colorRange, sceneColors, showRamp } from "./picture.js";
import { $, state } from "./state.js";

/// What the mode's colours span, in its unit.
export const shownRange = () => colorRange(state.mode, state.summary, state.at ?? state.diveS);

export function showLegend() {
  showRamp({ ramp: $("ramp"), ends: $("ramp-ends").children, says: $("ramp-says") }, state.mode, shownRange());
  const { ambiguous } = state.summary ?? { ambiguous: 0 };
  $("ambiguous-count").textContent = `${shown(ambiguous)} ambiguous${state.shows.ambiguous ? "" : ", hidden"}`;
}

export function setMode(mode) {
  state.mode = mode;
  localStorage.setItem("echosplat-mode", mode);
  $("mode").value = mode;
  showLegend();
  wake();
}

export function nextMode() {
  const names = Object.keys(LIVE_MODES);
  setMode(names[(names.indexOf(state.mode) + 1) % names.length]);
}

/// Of scene and charts, on the ground that the browser prefers.
export const palette = {};

export function readPalette() {
  const isDark = matchMedia("(prefers-color-scheme: dark)").matches;
  const style = getComputedStyle(document.documentElement);
  const probe = document.createElement("i");
  document.body.append(probe);
  const color = (name) => {
    probe.style.color = style.getPropertyValue(name);
    return getComputedStyle(probe).color;
  };
  Object.assign(palette, sceneColors(isDark, unitRgb), {
    chart: { line: color("--line"), soft: color("--soft"), accent: color("--accent"), warn: color("--warn") },
  });
  probe.remove();
  wake();
}

/// Says that there is no map yet.
export function updateEmpty() {
  const isEmpty = !state.summary || state.summary.confident + state.summary.ambiguous === 0;
  $("empty").hidden = !isEmpty || !state.renderer;
}
