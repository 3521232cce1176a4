// When the next picture is drawn.

import { state } from "./state.js";

/// The map is calm when it did not change for so long.
export const CALM_AFTER_MS = 900;

let isScheduled = false;
let step = () => {};

/// What each frame does.
export function eachFrame(does) {
  step = does;
}

/// A picture is drawn with the browser's next frame.
export function wake() {
  state.needsPicture = true;
  wakeAfter(0);
}

/// As `wake`, but the frame comes only after so many milliseconds, and nothing new asks for it.
export function wakeAfter(ms) {
  if (isScheduled) return;
  isScheduled = true;
  if (ms > 0) setTimeout(() => requestAnimationFrame(frame), ms);
  else requestAnimationFrame(frame);
}

function frame() {
  isScheduled = false;
  step();
}
