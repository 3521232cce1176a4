// Colour maps, and what a map is coloured by.

const MAPS = {
  // Deep to shallow; light enough on a dark ground and dark enough on a light one.
  height: ["#4a3fb5", "#2f6fd0", "#1b9ab4", "#2bb07f", "#8cc04b", "#e3b23c", "#e8733c", "#d6455f"],
  sigma: ["#1f9e89", "#6cbf5f", "#d9c43f", "#ee8a3a", "#d8435c"],
  strength: ["#3d3a86", "#7a3b98", "#b9437e", "#e66a57", "#f5a54a", "#f3dc7a"],
  age: ["#ffd166", "#f2915c", "#c0628a", "#7f5ba8", "#5a6bb0", "#5c7f9e"],
  error: ["#12806f", "#6fa53f", "#d9a520", "#e8762c", "#cc1f2f"],
  // By the number of what became of a Gaussian between two maps; the report has the names.
  change: ["#96a0a8", "#1f9e57", "#d62f45", "#f0a040", "#2f6fd0", "#c9b27c"],
  echo: ["#081224", "#10315c", "#15608c", "#1c9a9a", "#7cc77b", "#f2d95c", "#fff6d6"],
};

export const AMBIGUOUS = "#a78bda";

export const MODES = {
  height: { name: "Height", unit: "m", says: "up, in the frame of the poses" },
  sigma: { name: "Sigma", unit: "m", says: "uncertainty of the place, one sigma" },
  strength: { name: "Strength", unit: "dB", says: "opacity × reflectivity" },
  age: { name: "Age", unit: "s", says: "of the dive since it last changed here" },
  error: { name: "Error", unit: "m", says: "distance from the nearest truth; further is the last colour" },
  change: { name: "Change", unit: "", says: "between two maps" },
};

/// What can be coloured by while a dive goes on, when nobody knows the truth.
export const LIVE_MODES = Object.fromEntries(Object.entries(MODES).filter(([name]) => name !== "error" && name !== "change"));

const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));

/// 256 colours, four bytes each.
export function ramp(name) {
  const stops = MAPS[name].map(rgb);
  const bytes = new Uint8ClampedArray(256 * 4);
  for (let i = 0; i < 256; i += 1) {
    const place = (i / 255) * (stops.length - 1);
    const from = Math.min(Math.floor(place), stops.length - 2);
    const t = place - from;
    for (let c = 0; c < 3; c += 1) bytes[4 * i + c] = stops[from][c] + (stops[from + 1][c] - stops[from][c]) * t;
    bytes[4 * i + 3] = 255;
  }
  return bytes;
}

export const gradient = (name) => `linear-gradient(90deg, ${MAPS[name].join(", ")})`;

/// Colour as three numbers from 0 to 1.
export const unitRgb = (hex) => rgb(hex).map((value) => value / 255);
