// Sizes on the map: places are picked by clicks, the service measures between them and says how sure it is, with
// the figures that `echosplat measure` gives.

import { wake } from "./frames.js";
import { $, scene, state } from "./state.js";

/// What there is to measure, and how many places each takes.
const KINDS = { distance: 2, pile: 1, plane: 1, profile: 2, section: 2 };
const WORDS = {
  distance: ["Click the first place.", "Click the second place."],
  pile: ["Click the pile."],
  plane: ["Click the plane."],
  profile: ["Click where the line begins.", "Click where it ends."],
  section: ["Click where the line begins.", "Click where it ends."],
};
const MOST_KEPT = 20;

/// Places picked so far, metres of the world; null while nothing is picked.
let picking = null;
const kept = [];

export const isPicking = () => picking !== null;

export function toggleMeasuring(isOn = !isPicking()) {
  picking = isOn ? [] : null;
  $("measure-pick").setAttribute("aria-pressed", isOn);
  document.body.classList.toggle("measures", isOn);
  if (isOn) reveal();
  $("measure-says").classList.remove("bad");
  $("measure-says").textContent = isOn ? WORDS[kind()][0] : "";
  mark();
}

const kind = () => $("measure-kind").value;

function reveal() {
  $("panel-measure").open = true;
  $("panel-measure").scrollIntoView({ block: "nearest" });
}

/// A place that was clicked on, metres of the world; null where nothing of the map is.
export function take(place) {
  if (!place) {
    say("Nothing of the map is there: click on a Gaussian.", true);
    return;
  }
  if (state.at !== null) {
    say("The map of now is measured: press Live first.", true);
    return;
  }
  picking.push(place);
  mark();
  if (picking.length < KINDS[kind()]) {
    say(WORDS[kind()][picking.length]);
    return;
  }
  const places = picking;
  picking = [];
  ask(kind(), places);
}

async function ask(what, places) {
  say("…");
  const within = $("measure-within").value.trim();
  const numbers = places.flat().map((value) => value.toFixed(4)).join(",");
  const query = `${what}=${numbers}${within ? `&within=${encodeURIComponent(within)}` : ""}`;
  try {
    const response = await fetch(`measure?${query}`);
    const answer = await response.json().catch(() => ({}));
    if (!response.ok) throw new Error(answer.error ?? `the service answers ${response.status}`);
    keep({ what, answer });
    say(isPicking() ? WORDS[kind()][0] : "");
  } catch (error) {
    say(error.message, true);
  }
  mark();
}

function say(text, isBad = false) {
  $("measure-says").textContent = text;
  $("measure-says").classList.toggle("bad", isBad);
  if (isBad) reveal();
}

function keep(one) {
  kept.push(one);
  if (kept.length > MOST_KEPT) kept.shift();
  show();
}

function show() {
  $("measures").replaceChildren(...kept.toReversed().map((one) => {
    const item = document.createElement("li");
    const away = Object.assign(document.createElement("button"), { type: "button", textContent: "×", title: "Forget it" });
    away.addEventListener("click", () => {
      kept.splice(kept.indexOf(one), 1);
      show();
      mark();
    });
    const points = heights(one);
    const lines = points ? [one.what] : one.answer.lines;
    for (const line of lines) item.append(Object.assign(document.createElement("p"), { textContent: line.replaceAll("-", "−") }));
    if (points) item.append(chart(points));
    item.append(away);
    return item;
  }));
}

/// Along and up, metres, of a profile or a section; null of all else.
function heights({ what, answer }) {
  const rows = answer.facts[what];
  if (!Array.isArray(rows)) return null;
  return rows.filter((row) => row.height_m).map((row) => [row.along_m, row.height_m.value]);
}

const SVG = "http://www.w3.org/2000/svg";

/// Dots, one scale for both ways unless that is too flat, with both ends of both axes.
function chart(points) {
  const [width, height, left, below] = [300, 130, 40, 18];
  const ends = (axis) => [Math.min(...points.map((p) => p[axis])), Math.max(...points.map((p) => p[axis]))];
  const [[x0, x1], [z0, z1]] = [ends(0), ends(1)];
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", "height over the way along the line, metres");
  const add = (name, attributes, text) => {
    const node = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (text) node.textContent = text;
    svg.append(node);
  };
  if (!points.length) {
    add("text", { x: 4, y: 20 }, "nothing of the map lies there");
    return svg;
  }
  const x = (value) => left + ((value - x0) / Math.max(x1 - x0, 1e-6)) * (width - left - 6);
  const y = (value) => height - below - ((value - z0) / Math.max(z1 - z0, 1e-6)) * (height - below - 8);
  for (const [along, up] of points) add("circle", { cx: x(along).toFixed(1), cy: y(up).toFixed(1), r: 1.6 });
  const metres = (value) => `${value.toFixed(2).replace("-", "−")} m`;
  add("text", { x: left, y: height - 4 }, metres(x0));
  add("text", { x: width - 4, y: height - 4, "text-anchor": "end" }, metres(x1));
  add("text", { x: 0, y: height - below }, metres(z0));
  add("text", { x: 0, y: 12 }, metres(z1));
  return svg;
}

const AROUND = 32;

/// A pile as two rings and four lines between them, metres of the world; nothing of all else.
function outlines({ what, answer }) {
  if (what !== "pile") return [];
  const { middle_m: middle, lean_x_deg: leanX, lean_y_deg: leanY, radius_m: radius, bottom_m: bottom, top_m: top } = answer.facts;
  const [slopeX, slopeY] = [leanX, leanY].map((lean) => Math.tan((lean.value * Math.PI) / 180));
  const ring = (z) => Array.from({ length: AROUND + 1 }, (_, index) => {
    const turn = (2 * Math.PI * index) / AROUND;
    const up = z - middle[2];
    return [middle[0] + slopeX * up + radius.value * Math.cos(turn), middle[1] + slopeY * up + radius.value * Math.sin(turn), z];
  });
  const [low, high] = [ring(bottom), ring(top)];
  const sides = [0, 1, 2, 3].map((quarter) => [low[(quarter * AROUND) / 4], high[(quarter * AROUND) / 4]]);
  return [low, high, ...sides];
}

/// Lines and crosses of all that was measured, and of what is being picked.
function mark() {
  const shapes = kept.map(({ answer }) => answer.shape_m);
  if (picking?.length) shapes.push(picking);
  scene.setMeasured(shapes, kept.flatMap(outlines));
  wake();
}

for (const name of Object.keys(KINDS)) $("measure-kind").append(new Option(name[0].toUpperCase() + name.slice(1), name));
$("measure-kind").addEventListener("change", () => {
  if (isPicking()) toggleMeasuring(true);
});
$("measure-pick").addEventListener("click", () => toggleMeasuring());

/// For tests: what is kept.
export const measured = () => kept.map(({ what, answer }) => ({ what, ...answer }));
/// Of a map that was begun anew nothing is known any more.
export function forget() {
  kept.length = 0;
  show();
  mark();
}
