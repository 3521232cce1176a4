// Which moment of the dive is looked at.

import { wake } from "./frames.js";
import { $, past, pings, state } from "./state.js";

export function showTime() {
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

/// Seconds of the dive; null is live.
export function lookAt(diveS) {
  state.at = diveS;
  state.summaryAt = 0;
  pings.isDirty = true;
  showTime();
  wake();
}

$("time").addEventListener("input", () => lookAt(Number($("time").value)));
$("live").addEventListener("click", () => lookAt(null));
