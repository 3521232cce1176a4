// What is drawn besides the map: grid, axes, track, vehicle and its fan.

import { Lines, Mesh } from "./lines.js";
import { add, dot, rotated, roundStep, scaled, sub, unit } from "./math.js";

const GRID_LINES = 24;
const FAN_STEPS = 16;
const MOST_TRACK = 12000;

export class Scene {
  constructor() {
    this.grid = new Lines(1);
    this.axes = new Lines(2.5);
    this.track = new Lines(2);
    this.measured = new Lines(2.5);
    this.shapes = [];
    this.outlines = [];
    this.fanEdge = new Lines(1.5);
    this.fan = new Mesh(false);
    this.body = new Mesh(true);
    this.trackPoints = [];
    this.fanDeg = [0.8, 50];
  }

  /// Points of time and place, in the poses' frame.
  setTrack(points) {
    this.trackPoints = points;
    this.trackDirty = true;
  }

  /// Lists of places that were measured, and lines through places that show what was, in the poses' frame.
  setMeasured(shapes, outlines) {
    this.shapes = shapes;
    this.outlines = outlines;
    this.measuredKey = null;
  }

  addToTrack(diveS, place) {
    const last = this.trackPoints.at(-1);
    if (last && diveS < last[0]) this.trackPoints = [];
    else if (last && Math.hypot(place[0] - last[1], place[1] - last[2], place[2] - last[3]) < 0.02) return;
    this.trackPoints.push([diveS, ...place]);
    if (this.trackPoints.length > MOST_TRACK) this.trackPoints = this.trackPoints.filter((_, i) => i % 2 === 0);
    this.trackDirty = true;
  }

  /// Builds what changed. `until` cuts the track where somebody looks at an earlier moment.
  build({ originM, pose, view, targetM, floorM, colors, until, width }) {
    this.#buildGrid(view, targetM, floorM, colors);
    const key = `${until ?? ""}|${originM}|${colors.name}`;
    if (this.trackDirty || key !== this.trackKey) {
      this.trackKey = key;
      this.trackDirty = false;
      this.#buildTrack(originM, until, colors);
    }
    this.#buildMeasured(originM, view, colors);
    this.#buildVehicle(pose, originM, view, colors, width);
  }

  layers({ showsGrid, showsTrack, showsFan }) {
    const lines = [];
    if (showsGrid) lines.push(this.grid, this.axes);
    if (showsTrack) lines.push(this.track);
    if (this.measured.count) lines.push(this.measured);
    if (showsFan) lines.push(this.fanEdge);
    return { lines, meshes: showsFan ? [this.body, this.fan] : [this.body] };
  }

  #buildGrid(view, targetM, floorM, colors) {
    const stepM = roundStep((view.metresPerPixel * view.height) / 10);
    const center = [0, 1].map((axis) => Math.round(targetM[axis] / stepM) * stepM);
    const key = `${stepM}|${center}|${floorM}|${colors.name}`;
    this.stepM = stepM;
    if (key === this.gridKey) return;
    this.gridKey = key;
    this.grid.clear();
    this.axes.clear();
    const half = (GRID_LINES / 2) * stepM;
    for (let i = -GRID_LINES / 2; i <= GRID_LINES / 2; i += 1) {
      const fade = 1 - Math.abs(i) / (GRID_LINES / 2 + 1);
      for (const axis of [0, 1]) {
        const at = center[axis] + i * stepM;
        const isMajor = Math.round(at / stepM) % 5 === 0;
        const alpha = (isMajor ? 0.5 : 0.24) * fade;
        for (const side of [-1, 1]) {
          const from = [0, 0, floorM];
          const to = [0, 0, floorM];
          from[axis] = at;
          to[axis] = at;
          from[1 - axis] = center[1 - axis];
          to[1 - axis] = center[1 - axis] + side * half;
          this.grid.line(from, to, [...colors.grid, alpha]);
        }
      }
    }
    const foot = [center[0] - half * 0.5, center[1] - half * 0.5, floorM];
    colors.axes.forEach((color, axis) => {
      const end = [...foot];
      end[axis] += stepM;
      this.axes.line(foot, end, [...color, 1]);
    });
  }

  #buildTrack(originM, until, colors) {
    this.track.clear();
    let before = null;
    for (const [diveS, ...place] of this.trackPoints) {
      if (until !== null && diveS > until) break;
      const at = sub(place, originM);
      if (before) this.track.line(before, at, [...colors.track, 0.85]);
      before = at;
    }
  }

  /// A cross at each place, of the same size on the screen from afar, and a line between both ends; outlines as they are.
  #buildMeasured(originM, view, colors) {
    const reach = view.metresPerPixel * 7;
    const key = `${reach.toPrecision(2)}|${originM}|${colors.name}`;
    if (key === this.measuredKey) return;
    this.measuredKey = key;
    this.measured.clear();
    for (const outline of this.outlines) {
      const places = outline.map((place) => sub(place, originM));
      for (let at = 1; at < places.length; at += 1) this.measured.line(places[at - 1], places[at], [...colors.measured, 0.85]);
    }
    for (const shape of this.shapes) {
      const places = shape.map((place) => sub(place, originM));
      if (places.length === 2) this.measured.line(...places, [...colors.measured, 1]);
      for (const place of places) {
        for (const axis of [0, 1, 2]) {
          const step = [0, 0, 0];
          step[axis] = reach;
          this.measured.line(sub(place, step), add(place, step), [...colors.measured, 1]);
        }
      }
    }
  }

  #buildVehicle(pose, originM, view, colors, width) {
    for (const geometry of [this.fan, this.fanEdge, this.body]) geometry.clear();
    if (!pose) return;
    const place = sub(pose.position_m, originM);
    const turned = (v) => rotated(pose.orientation_wxyz, v);
    const far = Math.max(0.1, dot(sub(place, view.eye), view.forward));
    const size = Math.max(0.28, (far * 2 * view.tanX * 13) / width);
    this.#buildBody(place, turned, size, colors);
    const half = ((this.fanDeg[1] / 2) * Math.PI) / 180;
    const reach = pose.range_end_m;
    const rim = [];
    for (let i = 0; i <= FAN_STEPS; i += 1) {
      const angle = -half + (2 * half * i) / FAN_STEPS;
      rim.push(add(place, scaled(turned([Math.cos(angle), 0, Math.sin(angle)]), reach)));
    }
    for (let i = 0; i < FAN_STEPS; i += 1) {
      this.fan.triangle(place, rim[i], rim[i + 1], [...colors.fan, 0.07]);
      this.fanEdge.line(rim[i], rim[i + 1], [...colors.fan, 0.55]);
    }
    this.fanEdge.line(place, rim[0], [...colors.fan, 0.55]);
    this.fanEdge.line(place, rim[FAN_STEPS], [...colors.fan, 0.55]);
  }

  #buildBody(place, turned, size, colors) {
    const corner = (x, y, z) => add(place, scaled(turned([x, y, z]), size));
    const nose = corner(1, 0, 0);
    const ring = [corner(-0.7, 0.45, 0), corner(-0.7, 0, 0.35), corner(-0.7, -0.45, 0), corner(-0.7, 0, -0.35)];
    const light = unit([0.3, 0.2, 0.9]);
    ring.forEach((a, i) => {
      const b = ring[(i + 1) % 4];
      const middle = sub(scaled(add(a, b), 0.5), place);
      const shade = 0.72 + 0.28 * dot(unit(middle), light);
      this.body.triangle(nose, a, b, [...scaled(colors.vehicle, shade), 1]);
    });
    const back = scaled(colors.vehicle, 0.55);
    this.body.triangle(ring[0], ring[1], ring[2], [...back, 1]);
    this.body.triangle(ring[0], ring[2], ring[3], [...back, 1]);
  }
}
