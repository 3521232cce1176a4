// What every picture of a map has: range of its colours, where it is looked at from, the axes in its
// corner and its scale. No element of the page is known here but those given.

import { gradient, MODES } from "./colors.js";
import { length, roundStep, scaled, sub } from "./math.js";

/// What a map's numbers span as colours, [low, high] in the unit of the mode. `summary` as map.js makes it.
export function colorRange(mode, summary, nowS) {
  const spread = summary?.spread[mode];
  if (!spread) return [0, 1];
  if (mode === "sigma") return [0, roundStep(Math.max(0.02, Math.min(spread[1], 10)))];
  if (mode === "error") return [0, 0.1];
  if (mode === "change") return [0, 5];
  if (mode === "age") return [0, Math.max(1, roundStep(nowS - spread[0]))];
  const low = Math.floor(spread[0] * 10) / 10;
  return [low, Math.max(Math.ceil(spread[1] * 10) / 10, low + 0.1)];
}

/// Colours of a mode over a range of its numbers, both ends of it and what they say.
export function showRamp({ ramp, ends, says }, mode, range) {
  const { unit, says: words } = MODES[mode];
  // The names of changes stand beside the picture.
  ramp.style.background = mode === "change" ? "none" : gradient(mode);
  [...ends].forEach((end, index) => {
    end.textContent = mode === "change" ? "" : ended(range[index], range, unit);
  });
  says.textContent = words;
}

/// A length or another number of an axis, with its unit.
function ended(value, range, unit) {
  const digits = range[1] - range[0] < 0.5 ? 2 : 1;
  return `${value.toFixed(digits)} ${unit}`.replace("-", "−");
}

/// Target and distance from which the whole map is in the picture; null without a map. `reach` is half
/// its diagonal, metres.
export function fitted(summary) {
  if (!summary || summary.isEmpty) return null;
  const targetM = scaled([0, 1, 2].map((i) => summary.low[i] + summary.high[i]), 0.5);
  const reach = Math.max(1, length(sub(summary.high, summary.low)) / 2);
  return { targetM, distanceM: (reach / Math.tan(0.42)) * 1.12, reach };
}

/// Sides to look from, as camera.js has them.
export const SIDES = {
  fit: {},
  top: { yaw: -Math.PI / 2, pitch: Math.PI / 2 - 1e-4 },
  south: { yaw: -Math.PI / 2, pitch: 0.02 },
  east: { yaw: 0, pitch: 0.02 },
};

/// East, north and up as the view has them, on a canvas of 128 by 128.
export function drawGizmo(gizmo, view) {
  const context = gizmo.getContext("2d");
  context.clearRect(0, 0, 128, 128);
  const ends = [["E", "#e5534b"], ["N", "#4caf6d"], ["Up", "#4a8df0"]].map(([name, color], axis) => ({
    name, color, x: view.right[axis] * 42, y: -view.up[axis] * 42, depth: view.forward[axis],
  }));
  ends.sort((a, b) => b.depth - a.depth);
  context.font = '600 20px system-ui, "DejaVu Sans", sans-serif';
  context.textAlign = "center";
  context.textBaseline = "middle";
  for (const { name, color, x, y } of ends) {
    context.strokeStyle = color;
    context.lineWidth = 5;
    context.beginPath();
    context.moveTo(64, 64);
    context.lineTo(64 + x, 64 + y);
    context.stroke();
    context.fillStyle = color;
    if (Math.hypot(x, y) > 14) context.fillText(name, 64 + x * 1.28, 64 + y * 1.28);
  }
}

/// A bar of a round length at the depth of the target: `bar` gets its width, `text` says it.
export function showScale(bar, text, view) {
  const widthM = roundStep(view.metresPerPixel * 60);
  bar.style.width = `${widthM / view.metresPerPixel}px`;
  text.textContent = widthM < 1 ? `${+(widthM * 100).toFixed(1)} cm` : `${widthM} m`;
}

/// Colours of what is drawn besides the map, on a light or a dark ground; each is three numbers from 0 to 1.
export function sceneColors(isDark, unitRgb) {
  return {
    name: isDark ? "dark" : "light",
    ground: unitRgb(isDark ? "#0a141d" : "#eef2f5"),
    grid: unitRgb(isDark ? "#5b7b92" : "#7d93a3"),
    track: unitRgb(isDark ? "#ffd166" : "#b26a00"),
    fan: unitRgb(isDark ? "#5cc8da" : "#0b7285"),
    measured: unitRgb(isDark ? "#ff8a80" : "#b3261e"),
    vehicle: unitRgb(isDark ? "#ffd166" : "#f2a516"),
    axes: ["#e5534b", "#4caf6d", "#4a8df0"].map(unitRgb),
  };
}
