// Where the map is looked at from.

import { Camera } from "./camera.js";
import { wake } from "./frames.js";
import { fitted, SIDES } from "./picture.js";
import { canvas, state } from "./state.js";

export const camera = new Camera(canvas, () => {
  state.movedAt = performance.now();
  wake();
}, (pans) => {
  state.hasFitted = true;
  if (pans) setFollow(false);
});

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
export function fitWhileGrowing(found) {
  if (state.hasFitted || found.isEmpty || found.confident < 30) return;
  const { reach } = fitted(found);
  if (reach < (state.fittedReach ?? 0) * 1.15) return;
  fit({}, !state.fittedReach);
}

export const VIEWS = {
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
