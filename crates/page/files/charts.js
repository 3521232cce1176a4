// Charts on 2-D canvases: the newest ping, the waterfall of pings, error against time.

import { ramp } from "./colors.js";
import { clamp, roundStep, shown } from "./math.js";
import { lastBefore } from "./history.js";

const LEFT = 42;
const RIGHT = 6;
const MOST_PINGS = 4000;
/// What the colours of the waterfall and the axis of the ping span, decibels.
const SPAN_DB = 60;
/// Share of the bins that do not set the scale.
const RINGING = 0.06;

export class Pings {
  constructor(plot, waterfall) {
    this.plot = plot;
    this.waterfall = waterfall;
    this.list = [];
    this.topDb = null;
    this.colors = ramp("echo");
    this.isDirty = true;
  }

  clear() {
    this.list = [];
    this.isDirty = true;
  }

  push(header, payload) {
    const bins = new Uint8Array(payload);
    const ping = { ...header, bins, timeS: header.time_ns * 1e-9 };
    const last = this.list.at(-1);
    if (last && ping.timeS < last.timeS - 5) this.list = [];
    this.list.push(ping);
    if (this.list.length > MOST_PINGS * 1.2) this.list.splice(0, this.list.length - MOST_PINGS);
    // The scale follows the strongest echo, at once upwards and slowly down.
    // The transducer itself rings in the first bins.
    const strongest = bins.subarray(Math.ceil(bins.length * RINGING)).reduce((most, byte) => Math.max(most, byte), 0);
    const top = ping.floor_db + ping.step_db * strongest + 3;
    this.topDb = this.topDb === null ? top : Math.max(top, this.topDb + (top - this.topDb) * 0.005);
    this.isDirty = true;
  }

  /// Draws the pings up to a time, or all. Says what is shown.
  draw(untilS, style) {
    this.isDirty = false;
    let end = this.list.length;
    if (untilS !== null) {
      const found = lastBefore(this.list, untilS, (ping) => ping.timeS);
      end = found ? this.list.indexOf(found) + 1 : 0;
    }
    const newest = this.list[end - 1];
    const topDb = Math.ceil((this.topDb ?? 0) / 5) * 5;
    this.#drawPlot(newest, topDb, style);
    this.#drawWaterfall(end, newest, topDb, style);
    return newest ? { newest, topDb, lowDb: topDb - SPAN_DB } : null;
  }

  #drawPlot(ping, topDb, style) {
    const { context, width, height } = fitted(this.plot);
    if (!ping) return hint(context, width, height, "no ping yet", style);
    const [top, bottom] = [6, height - 18];
    const x = (range) => LEFT + ((width - LEFT - RIGHT) * (range - ping.range_start_m)) / ping.range_length_m;
    const y = (db) => bottom - ((bottom - top) * (db - (topDb - SPAN_DB))) / SPAN_DB;
    for (let db = topDb; db >= topDb - SPAN_DB; db -= 20) {
      rule(context, LEFT, y(db), width - RIGHT, y(db), style.line);
      label(context, db === topDb ? `${signed(db)} dB` : signed(db), LEFT - 5, y(db), "right", style.soft);
    }
    const stepM = roundStep(ping.range_length_m / 6);
    for (let m = Math.ceil(ping.range_start_m / stepM) * stepM; m <= ping.range_start_m + ping.range_length_m * 1.001; m += stepM) {
      rule(context, x(m), top, x(m), bottom, style.line);
      label(context, `${+m.toFixed(2)} m`, clamp(x(m), 14, width - 16), height - 8, "center", style.soft);
    }
    context.beginPath();
    ping.bins.forEach((byte, i) => {
      const db = ping.floor_db + ping.step_db * byte;
      const at = [x(ping.range_start_m + (ping.range_length_m * (i + 0.5)) / ping.bins.length), y(clamp(db, topDb - SPAN_DB, topDb))];
      if (i) context.lineTo(...at);
      else context.moveTo(...at);
    });
    context.strokeStyle = style.accent;
    context.lineWidth = 1.3;
    context.stroke();
    return undefined;
  }

  /// The newest above; a row a ping.
  #drawWaterfall(end, newest, topDb, style) {
    const { context, width, height, ratio } = fitted(this.waterfall);
    if (!newest) return;
    const columns = Math.round((width - LEFT - RIGHT) * ratio);
    const rows = Math.round(height * ratio);
    const image = new ImageData(columns, rows);
    for (let row = 0; row < rows; row += 1) {
      const ping = this.list[end - 1 - row];
      if (!ping) break;
      image.data.set(this.#row(ping, columns, topDb), row * columns * 4);
    }
    context.putImageData(image, Math.round(LEFT * ratio), 0);
    const seconds = (index) => newest.timeS - (this.list[end - 1 - index]?.timeS ?? newest.timeS);
    const rowCount = Math.min(rows, end);
    for (const part of [0, 0.5, 1]) {
      const row = Math.round(part * (rowCount - 1));
      const y = clamp(row / ratio, 6, height - 6);
      label(context, part ? `−${seconds(row).toFixed(1)} s` : "now", LEFT - 4, y, "right", style.soft);
    }
  }

  /// A ping's row of the waterfall, its columns' strongest bins; kept while columns and scale stay.
  #row(ping, columns, topDb) {
    if (ping.row?.columns === columns && ping.row.topDb === topDb) return ping.row.pixels;
    const pixels = new Uint8ClampedArray(4 * columns);
    const perColumn = ping.bins.length / columns;
    for (let column = 0; column < columns; column += 1) {
      const from = Math.floor(column * perColumn);
      const to = Math.max(from + 1, Math.floor((column + 1) * perColumn));
      let byte = 0;
      for (let i = from; i < to; i += 1) byte = Math.max(byte, ping.bins[i]);
      const db = ping.floor_db + ping.step_db * byte;
      const shade = clamp(Math.round(255 * (1 - (topDb - db) / SPAN_DB)), 0, 255) * 4;
      for (let c = 0; c < 4; c += 1) pixels[4 * column + c] = this.colors[shade + c];
    }
    ping.row = { columns, topDb, pixels };
    return pixels;
  }
}

/// Chamfer and Hausdorff distance over the dive, logarithmic.
export function drawErrors(canvas, errors, style) {
  const { context, width, height } = fitted(canvas);
  const values = errors.flatMap((e) => [e.cd_m, e.hd_m]).filter((v) => v > 0);
  if (!values.length) {
    hint(context, width, height, "the map asserts nothing yet", style);
    return;
  }
  const [top, bottom] = [20, height - 18];
  const low = Math.floor(Math.log10(Math.min(...values)));
  const high = Math.max(low + 1, Math.ceil(Math.log10(Math.max(...values))));
  const lastS = Math.max(...errors.map((e) => e.dive_s), 1);
  const x = (s) => LEFT + 8 + ((width - LEFT - 8 - RIGHT) * s) / lastS;
  const y = (m) => bottom - ((bottom - top) * (Math.log10(m) - low)) / (high - low);
  for (let power = low; power <= high; power += 1) {
    const m = 10 ** power;
    rule(context, LEFT + 8, y(m), width - RIGHT, y(m), style.line);
    label(context, `${+m.toPrecision(1)} m`, LEFT + 4, y(m), "right", style.soft);
  }
  const stepS = roundStep(lastS / 5);
  for (let s = 0; s <= lastS; s += stepS) label(context, `${s} s`, clamp(x(s), 20, width - 16), height - 8, "center", style.soft);
  const series = [["cd_m", "Chamfer", style.accent], ["hd_m", "Hausdorff", style.warn]];
  let at = LEFT + 8;
  for (const [key, name, color] of series) {
    const points = errors.filter((e) => e[key] > 0);
    context.beginPath();
    points.forEach((e, i) => (i ? context.lineTo(x(e.dive_s), y(e[key])) : context.moveTo(x(e.dive_s), y(e[key]))));
    context.strokeStyle = color;
    context.lineWidth = 1.8;
    context.stroke();
    const last = points.at(-1);
    if (last) {
      context.beginPath();
      context.arc(x(last.dive_s), y(last[key]), 3, 0, 7);
      context.fillStyle = color;
      context.fill();
    }
    const words = last ? `${name} ${shown(last[key])} m` : name;
    label(context, words, at, 9, "left", color);
    at += context.measureText(words).width + 14;
  }
}

function fitted(canvas) {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  const width = canvas.clientWidth;
  canvas.cssHeight ??= canvas.height;
  const height = canvas.cssHeight;
  const size = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== size[0] || canvas.height !== size[1]) {
    [canvas.width, canvas.height] = size;
    canvas.style.height = `${height}px`;
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = '11px system-ui, "DejaVu Sans", sans-serif';
  return { context, width, height, ratio };
}

function rule(context, x0, y0, x1, y1, color) {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.strokeStyle = color;
  context.lineWidth = 1;
  context.stroke();
}

function label(context, text, x, y, align, color) {
  context.textAlign = align;
  context.textBaseline = "middle";
  context.fillStyle = color;
  context.fillText(text, x, y);
}

/// With a minus as long as a plus.
export const signed = (number) => String(number).replace("-", "−");

function hint(context, width, height, text, style) {
  label(context, text, width / 2, height / 2, "center", style.soft);
}
