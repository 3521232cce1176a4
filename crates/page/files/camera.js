// Looks at a target from around it; moved by mouse, touch and keys.

import { add, clamp, clipFromRelative, cross, mix, scaled, sub, unit } from "./math.js";

const FIELD_OF_VIEW = (50 * Math.PI) / 180;
const STEEPEST = Math.PI / 2 - 1e-4;
const NEAREST_M = 0.2;
const FARTHEST_M = 5000;

export class Camera {
  /// `changed()` is called when it moves, `held(pans)` when somebody moves it. Within a longer document the
  /// wheel zooms only where the canvas was clicked, so that reading on is possible.
  constructor(canvas, changed, held, { wheelNeedsFocus = false } = {}) {
    this.canvas = canvas;
    this.changed = changed;
    this.held = held;
    this.wheelNeedsFocus = wheelNeedsFocus;
    this.targetM = [0, 0, 0];
    this.yaw = -2.2;
    this.pitch = 0.5;
    this.distanceM = 14;
    this.goal = null;
    this.pointers = new Map();
    this.#listen();
  }

  /// Vectors and matrices of this moment for a picture of this size.
  view(width, height) {
    const [cosP, sinP] = [Math.cos(this.pitch), Math.sin(this.pitch)];
    const forward = [-cosP * Math.cos(this.yaw), -cosP * Math.sin(this.yaw), -sinP];
    const right = unit([Math.sin(this.yaw) * -1, Math.cos(this.yaw), 0]);
    const up = cross(right, forward);
    const eye = sub(this.targetM, scaled(forward, this.distanceM));
    const tangent = Math.tan(FIELD_OF_VIEW / 2);
    const [tanX, tanY] = width > height
      ? [(tangent * width) / height, tangent]
      : [tangent, (tangent * height) / width];
    const near = Math.max(0.02, this.distanceM * 0.004);
    const far = this.distanceM * 20 + 400;
    return {
      eye, forward, right, up, tanX, tanY, near, far,
      clip: clipFromRelative(right, up, forward, tanX, tanY, near, far),
      depth: [(far + near) / (far - near), (-2 * far * near) / (far - near)],
      metresPerPixel: (2 * this.distanceM * tanY) / height,
    };
  }

  /// Goes to a yaw, a pitch, a target or a distance, all at once if `isAtOnce`.
  go(to, isAtOnce = false) {
    const calm = isAtOnce || matchMedia("(prefers-reduced-motion: reduce)").matches;
    const end = { targetM: this.targetM, yaw: this.yaw, pitch: this.pitch, distanceM: this.distanceM, ...to };
    while (end.yaw - this.yaw > Math.PI) end.yaw -= 2 * Math.PI;
    while (end.yaw - this.yaw < -Math.PI) end.yaw += 2 * Math.PI;
    if (calm) {
      Object.assign(this, end);
      this.goal = null;
    } else {
      const from = { targetM: this.targetM, yaw: this.yaw, pitch: this.pitch, distanceM: this.distanceM };
      this.goal = { from, end, since: performance.now() };
    }
    this.changed();
  }

  /// One step towards where it goes; whether it still moves.
  step() {
    if (!this.goal) return false;
    const { from, end, since } = this.goal;
    const t = clamp((performance.now() - since) / 450, 0, 1);
    const s = t * t * (3 - 2 * t);
    this.targetM = mix(from.targetM, end.targetM, s);
    this.yaw = from.yaw + (end.yaw - from.yaw) * s;
    this.pitch = from.pitch + (end.pitch - from.pitch) * s;
    this.distanceM = from.distanceM * (end.distanceM / from.distanceM) ** s;
    if (t >= 1) this.goal = null;
    return t < 1;
  }

  orbit(dx, dy) {
    this.goal = null;
    this.yaw -= dx * 0.006;
    this.pitch = clamp(this.pitch + dy * 0.006, -STEEPEST, STEEPEST);
    this.held(false);
    this.changed();
  }

  /// By pixels; the ground follows the finger.
  pan(dx, dy) {
    this.goal = null;
    const { right, up, metresPerPixel } = this.view(this.canvas.clientWidth, this.canvas.clientHeight);
    const moved = add(scaled(right, -dx * metresPerPixel), scaled(up, dy * metresPerPixel));
    this.targetM = add(this.targetM, moved);
    this.held(true);
    this.changed();
  }

  zoom(factor) {
    this.goal = null;
    this.distanceM = clamp(this.distanceM * factor, NEAREST_M, FARTHEST_M);
    this.held(false);
    this.changed();
  }

  #listen() {
    const { canvas } = this;
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      if (this.wheelNeedsFocus && document.activeElement !== canvas) return;
      event.preventDefault();
      const pixels = event.deltaY * (event.deltaMode === 1 ? 24 : 1);
      this.zoom(Math.exp(clamp(pixels, -240, 240) * 0.0016));
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) {
      canvas.addEventListener(kind, (event) => this.pointers.delete(event.pointerId));
    }
    canvas.addEventListener("pointermove", (event) => this.#moved(event));
    canvas.addEventListener("keydown", (event) => this.#key(event));
  }

  #moved(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    if (this.pointers.size === 1) {
      const pans = event.buttons & 6 || event.shiftKey || event.ctrlKey;
      if (pans) this.pan(dx, dy);
      else this.orbit(dx, dy);
    } else {
      const others = [...this.pointers].filter(([id]) => id !== event.pointerId);
      const other = others[0][1];
      const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
      this.zoom(apart(before) / apart(now));
      this.pan(dx / 2, dy / 2);
    }
    this.pointers.set(event.pointerId, now);
  }

  #key(event) {
    const moves = { ArrowLeft: [30, 0], ArrowRight: [-30, 0], ArrowUp: [0, 30], ArrowDown: [0, -30] };
    const move = moves[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (move && event.shiftKey) this.pan(...move);
    else if (move) this.orbit(-move[0], move[1]);
    else if (event.key === "+" || event.key === "=") this.zoom(0.85);
    else if (event.key === "-" || event.key === "_") this.zoom(1 / 0.85);
    else return;
    event.preventDefault();
  }
}
