// Vectors are arrays of three, matrices sixteen numbers by columns, quaternions w x y z.

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scaled = (a, k) => [a[0] * k, a[1] * k, a[2] * k];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
export const length = (a) => Math.hypot(a[0], a[1], a[2]);
export const unit = (a) => scaled(a, 1 / (length(a) || 1));
export const mix = (a, b, t) => a.map((value, i) => value + (b[i] - value) * t);
export const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

/// Turns a vector by a unit quaternion.
export function rotated([w, x, y, z], v) {
  const axis = [x, y, z];
  const t = scaled(cross(axis, v), 2);
  return add(add(v, scaled(t, w)), cross(axis, t));
}

/// World to clip, for a camera at the origin: positions are taken relative to it.
export function clipFromRelative(right, up, forward, tanX, tanY, near, far) {
  const a = (far + near) / (far - near);
  const b = (-2 * far * near) / (far - near);
  return [
    right[0] / tanX, up[0] / tanY, a * forward[0], forward[0],
    right[1] / tanX, up[1] / tanY, a * forward[1], forward[1],
    right[2] / tanX, up[2] / tanY, a * forward[2], forward[2],
    0, 0, b, 0,
  ];
}

/// 1, 2 or 5 times a power of ten, the nearest at or above.
export function roundStep(value) {
  const power = 10 ** Math.floor(Math.log10(Math.max(value, 1e-9)));
  for (const factor of [1, 2, 5, 10]) {
    if (factor * power >= value * 0.999) return factor * power;
  }
  return 10 * power;
}

/// With as many digits as are worth reading.
export function shown(value, digits = 3) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  const size = Math.abs(value);
  if (Number.isInteger(value) && size < 1e15) return value.toLocaleString("en").replaceAll(",", "\u202f");
  const places = size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : digits;
  return value.toFixed(places);
}
