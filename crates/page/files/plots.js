// The charts of the panels, as they come due.

import { drawErrors, signed } from "./charts.js";
import { palette } from "./legend.js";
import { shown } from "./math.js";
import { $, pings, state } from "./state.js";

const CHARTS_EVERY_MS = 90;

export function showErrors() {
  $("panel-error").hidden = !state.errors.length;
  if (state.errors.length && !state.hasShownErrors) {
    state.hasShownErrors = true;
    $("panel-error").open = true;
  }
  if ($("panel-error").open && palette.chart) drawErrors($("error"), state.errors, palette.chart);
}

function showPings() {
  if (!pings.isDirty || !$("panel-ping").open || document.hidden || !palette.chart || !$("ping").clientWidth) return;
  const untilS = state.at === null || state.firstTimeNs === null ? null : state.firstTimeNs * 1e-9 + state.at;
  const drawn = pings.draw(untilS, palette.chart);
  if (!drawn) return;
  const { newest, topDb, lowDb } = drawn;
  $("ping-says").textContent = `№ ${shown(newest.sequence)}`;
  $("db-low").textContent = `${signed(lowDb)} dB`;
  $("db-high").textContent = `${signed(topDb)} dB`;
}

setInterval(showPings, CHARTS_EVERY_MS);
$("panel-error").addEventListener("toggle", showErrors);
$("panel-ping").addEventListener("toggle", () => (pings.isDirty = true));
