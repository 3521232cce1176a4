// Draws: Gaussians as ellipsoids into a texture with depth, that texture onto the canvas with eye-dome
// lighting, then lines and meshes. One buffer of the graphics card for each tile, updated in place.

import { AMBIGUOUS, MODES, ramp, unitRgb } from "./colors.js";
import { clamp, scaled } from "./math.js";
import * as shaders from "./shaders.js";
import { FIELD, POINT_BYTES, POINT_FLOATS } from "./wire.js";

const ATTRIBUTES = [
  [0, 3, FIELD.x], [1, 1, FIELD.changed], [2, 1, FIELD.opacity], [3, 3, FIELD.scale],
  [4, 4, FIELD.rotation], [5, 1, FIELD.reflectivity], [6, 1, FIELD.sigma], [7, 1, FIELD.confident],
];
const MODE_NAMES = Object.keys(MODES);

export class Renderer {
  constructor(canvas) {
    this.canvas = canvas;
    const options = { antialias: false, alpha: false, powerPreference: "high-performance" };
    const gl = canvas.getContext("webgl2", options);
    if (!gl) throw new Error("this browser has no WebGL2");
    this.gl = gl;
    this.scale = 1;
    /// Only every so many-th Gaussian is drawn, larger.
    this.thinning = 1;
    /// By thinning, the numbers of those Gaussians of a tile that are drawn.
    this.chosen = new Map();
    this.buffers = new Map();
    this.target = null;
    /// What the texture shows, to leave it as it is while only lines and meshes move.
    this.shown = null;
    /// Whether the last picture drew the Gaussians anew.
    this.drewMap = false;
    this.#prepare();
  }

  /// The card's own name, where the browser says it.
  name() {
    const info = this.gl.getExtension("WEBGL_debug_renderer_info");
    return info ? this.gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "unknown";
  }

  /// Whether no graphics card draws.
  isSoftware() {
    return /swiftshader|llvmpipe|software|softpipe/i.test(this.name());
  }

  #prepare() {
    const { gl } = this;
    this.maxPoint = gl.getParameter(gl.ALIASED_POINT_SIZE_RANGE)[1];
    this.gaussians = program(gl, shaders.GAUSSIAN_VERTEX, shaders.GAUSSIAN_FRAGMENT);
    this.screen = program(gl, shaders.SCREEN_VERTEX, shaders.SCREEN_FRAGMENT);
    this.lines = program(gl, shaders.LINE_VERTEX, shaders.FLAT_FRAGMENT);
    this.meshes = program(gl, shaders.MESH_VERTEX, shaders.FLAT_FRAGMENT);
    this.empty = gl.createVertexArray();
    this.ramps = Object.fromEntries(MODE_NAMES.map((name) => [name, this.#ramp(name)]));
  }

  #ramp(name) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, ramp(name));
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    return texture;
  }

  /// Fits canvas and texture to the window; says their sizes.
  #fit() {
    const { gl, canvas } = this;
    const ratio = Math.min(devicePixelRatio || 1, 2);
    // Lines stay sharper than Gaussians.
    const sharp = ratio * clamp(this.scale * 1.4, 0.6, 1);
    const full = [canvas.clientWidth * sharp, canvas.clientHeight * sharp].map((n) => Math.max(1, Math.round(n)));
    if (canvas.width !== full[0] || canvas.height !== full[1]) [canvas.width, canvas.height] = full;
    const inner = [canvas.clientWidth, canvas.clientHeight]
      .map((n) => Math.max(1, Math.round(n * ratio * this.scale)));
    const isSharp = inner[0] === full[0] && inner[1] === full[1];
    if (this.target?.width !== inner[0] || this.target.height !== inner[1] || this.target.isSharp !== isSharp) {
      this.target = makeTarget(gl, this.target, ...inner, isSharp);
      this.shown = null;
    }
    return { full, inner };
  }

  /// `scene` has view, tiles, mode, range, now, extent, showsAmbiguous, lighting, background, lines and
  /// meshes.
  draw(view, scene) {
    const { gl } = this;
    const size = this.#fit();
    const { full, inner } = size;
    const next = shownBy(view, scene, inner, this.thinning);
    this.drewMap = !isSame(this.shown, next);
    if (this.drewMap) this.#drawGaussians(view, scene, inner);
    this.shown = next;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, ...full);
    gl.disable(gl.BLEND);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.ALWAYS);
    gl.depthMask(true);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.#drawScreen(view, scene, size);
    gl.depthFunc(gl.LEQUAL);
    this.#drawOverlays(view, scene, full);
    gl.bindVertexArray(null);
  }

  /// The texture onto the canvas, where there are Gaussians in it.
  #drawScreen(view, scene, { full, inner }) {
    const { gl } = this;
    const extent = scene.extent * this.thinning ** 0.35;
    const box = boxOf(scene.tiles.filter((tile) => tile.count), view, extent, full);
    if (!box) return;
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(...box);
    const { use, uniform } = this.screen;
    gl.useProgram(use);
    bind(gl, 0, this.target.color, uniform.uColor);
    bind(gl, 1, this.target.depth, uniform.uDepthMap);
    gl.uniform2fv(uniform.uDepth, view.depth);
    gl.uniform2fv(uniform.uTarget, full);
    gl.uniform1f(uniform.uStrength, scene.lighting ? 5 : 0);
    gl.uniform1f(uniform.uSpread, Math.max(1, (1.2 * inner[0]) / this.canvas.clientWidth));
    gl.bindVertexArray(this.empty);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.disable(gl.SCISSOR_TEST);
  }

  #drawGaussians(view, scene, size) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target.framebuffer);
    gl.viewport(0, 0, ...size);
    gl.disable(gl.BLEND);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LESS);
    gl.depthMask(true);
    gl.clearColor(...scene.background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const { use, uniform } = this.gaussians;
    gl.useProgram(use);
    gl.uniformMatrix4fv(uniform.uClip, false, view.clip);
    gl.uniform3fv(uniform.uEye, view.eye);
    gl.uniform2fv(uniform.uViewport, size);
    gl.uniform1f(uniform.uExtent, scene.extent * this.thinning ** 0.35);
    gl.uniform1f(uniform.uMaxPoint, this.maxPoint);
    gl.uniform1f(uniform.uMinRadius, (0.6 * view.tanY) / size[1] * 2);
    gl.uniform1i(uniform.uMode, MODE_NAMES.indexOf(scene.mode));
    gl.uniform2fv(uniform.uRange, scene.range);
    gl.uniform1f(uniform.uNow, scene.now);
    gl.uniform1f(uniform.uAmbiguous, scene.showsAmbiguous ? 1 : 0);
    gl.uniform3fv(uniform.uAmbiguousColor, unitRgb(AMBIGUOUS));
    gl.uniform3fv(uniform.uForward, view.forward);
    gl.uniform3fv(uniform.uRight, scaled(view.right, view.tanX));
    gl.uniform3fv(uniform.uUp, scaled(view.up, view.tanY));
    gl.uniform2fv(uniform.uDepth, view.depth);
    bind(gl, 0, this.ramps[scene.mode], uniform.uRamp);
    let drawn = 0;
    for (const tile of scene.tiles) {
      const buffer = this.#buffer(tile);
      if (!tile.count || !isSeen(tile, view, scene.tileEdgeM)) continue;
      gl.bindVertexArray(buffer.array);
      const count = Math.ceil(tile.count / this.thinning);
      if (this.thinning === 1) {
        gl.drawArrays(gl.POINTS, 0, count);
      } else {
        this.#choose(count);
        gl.drawElements(gl.POINTS, count, gl.UNSIGNED_INT, 0);
      }
      drawn += count;
    }
    this.drawn = drawn;
    this.#forget(scene.tiles);
  }

  /// The tile's buffer with all that changed since.
  #buffer(tile) {
    const { gl } = this;
    let buffer = this.buffers.get(tile);
    if (!buffer) {
      buffer = { array: gl.createVertexArray(), data: gl.createBuffer(), bytes: 0 };
      this.buffers.set(tile, buffer);
      this.#lay(buffer);
    }
    const bytes = tile.floats.byteLength;
    if (buffer.bytes !== bytes) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer.data);
      gl.bufferData(gl.ARRAY_BUFFER, tile.floats, gl.DYNAMIC_DRAW);
      buffer.bytes = bytes;
      tile.dirty = null;
    } else if (tile.dirty) {
      const [from, to] = [tile.dirty[0], Math.min(tile.dirty[1], tile.count)];
      if (to > from) {
        gl.bindBuffer(gl.ARRAY_BUFFER, buffer.data);
        const part = tile.floats.subarray(from * POINT_FLOATS, to * POINT_FLOATS);
        gl.bufferSubData(gl.ARRAY_BUFFER, from * POINT_BYTES, part);
      }
      tile.dirty = null;
    }
    return buffer;
  }

  /// Binds the numbers of at least so many Gaussians, every `thinning`-th of a tile.
  #choose(count) {
    const { gl } = this;
    const known = this.chosen.get(this.thinning);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, known?.data ?? gl.createBuffer());
    if (known && known.count >= count) return;
    const data = gl.getParameter(gl.ELEMENT_ARRAY_BUFFER_BINDING);
    const room = 2 * count;
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, Uint32Array.from({ length: room }, (_, i) => i * this.thinning), gl.STATIC_DRAW);
    this.chosen.set(this.thinning, { data, count: room });
  }

  /// Where in the buffer each number of a Gaussian is.
  #lay(buffer) {
    const { gl } = this;
    gl.bindVertexArray(buffer.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer.data);
    for (const [place, size, word] of ATTRIBUTES) {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, gl.FLOAT, false, POINT_BYTES, word * 4);
    }
  }

  #forget(tiles) {
    if (this.buffers.size <= tiles.length) return;
    const kept = new Set(tiles);
    for (const [tile, buffer] of this.buffers) {
      if (kept.has(tile)) continue;
      this.gl.deleteVertexArray(buffer.array);
      this.gl.deleteBuffer(buffer.data);
      this.buffers.delete(tile);
      tile.dirty = [0, tile.count];
    }
  }

  #drawOverlays(view, scene, full) {
    const { gl } = this;
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    for (const mesh of scene.meshes) {
      gl.useProgram(this.meshes.use);
      gl.uniformMatrix4fv(this.meshes.uniform.uClip, false, view.clip);
      gl.uniform3fv(this.meshes.uniform.uEye, view.eye);
      gl.depthMask(mesh.isSolid);
      gl.bindVertexArray(mesh.upload(gl));
      gl.drawArrays(gl.TRIANGLES, 0, mesh.count);
    }
    gl.depthMask(false);
    for (const lines of scene.lines) {
      if (!lines.count) continue;
      gl.useProgram(this.lines.use);
      gl.uniformMatrix4fv(this.lines.uniform.uClip, false, view.clip);
      gl.uniform3fv(this.lines.uniform.uEye, view.eye);
      gl.uniform2fv(this.lines.uniform.uViewport, full);
      gl.uniform1f(this.lines.uniform.uWidth, lines.width * clamp(full[0] / this.canvas.clientWidth, 1, 2));
      gl.bindVertexArray(lines.upload(gl));
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, lines.count);
    }
    gl.depthMask(true);
  }

  /// How many pixels differ from the ground's colour, right after drawing; for tests.
  lit(ground) {
    const { bytes } = this.pixels();
    const bytesOf = ground.map((c) => Math.round(c * 255));
    let lit = 0;
    for (let i = 0; i < bytes.length; i += 4) {
      lit += bytesOf.reduce((sum, byte, c) => sum + Math.abs(bytes[i + c] - byte), 0) > 24;
    }
    return { lit, total: bytes.length / 4 };
  }

  /// Red, green and blue of a pixel of the canvas, right after drawing; for tests.
  pixels() {
    const { gl, canvas } = this;
    const bytes = new Uint8Array(canvas.width * canvas.height * 4);
    gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    return { width: canvas.width, height: canvas.height, bytes };
  }
}

/// All that the Gaussians' picture depends on.
function shownBy(view, scene, size, thinning) {
  const { mode, range, extent, showsAmbiguous, background } = scene;
  const age = mode === "age" ? scene.now : 0;
  const numbers = [...size, ...view.clip, ...view.eye, ...range, ...background, thinning, extent, age];
  return {
    values: [...numbers, mode, showsAmbiguous, ...scene.tiles],
    versions: scene.tiles.map((tile) => tile.version),
  };
}

function isSame(before, next) {
  if (!before) return false;
  const alike = (a, b) => a.length === b.length && a.every((value, i) => value === b[i]);
  return alike(before.values, next.values) && alike(before.versions, next.versions);
}

/// Left, bottom, width and height, in pixels, of what holds all Gaussians of these tiles on the screen, its
/// border included; null where none of them is in the picture.
export function boxOf(tiles, view, extent, [width, height]) {
  const low = [1, 1];
  const high = [-1, -1];
  for (const { low: from, high: to, reachM } of tiles) {
    for (let corner = 0; corner < 8; corner += 1) {
      const place = [0, 1, 2].map((axis) => (corner & (1 << axis)
        ? to[axis] + extent * reachM
        : from[axis] - extent * reachM) - view.eye[axis]);
      const at = (row) => view.clip[row] * place[0] + view.clip[row + 4] * place[1] + view.clip[row + 8] * place[2] + view.clip[row + 12];
      const depth = at(3);
      // Reaches behind the eye: where it ends on the screen is not told by its corners.
      if (!(depth > view.near)) return [0, 0, width, height];
      for (const axis of [0, 1]) {
        low[axis] = Math.min(low[axis], at(axis) / depth);
        high[axis] = Math.max(high[axis], at(axis) / depth);
      }
    }
  }
  const pixels = (share, size) => Math.round((0.5 + 0.5 * Math.min(1, Math.max(-1, share))) * size);
  const BORDER = 4;
  const [left, bottom] = [pixels(low[0], width) - BORDER, pixels(low[1], height) - BORDER].map((n) => Math.max(0, n));
  const right = Math.min(width, pixels(high[0], width) + BORDER);
  const top = Math.min(height, pixels(high[1], height) + BORDER);
  return right > left && top > bottom && high[0] > low[0] ? [left, bottom, right - left, top - bottom] : null;
}

/// Whether the tile's cube, with a margin for what reaches out of it, lies before the eye.
function isSeen(tile, view, edgeM) {
  const radius = edgeM * 1.2;
  const center = tile.index.map((i, axis) => (i + 0.5) * edgeM - view.eye[axis]);
  const along = (axis) => center[0] * axis[0] + center[1] * axis[1] + center[2] * axis[2];
  const depth = along(view.forward);
  if (depth < -radius) return false;
  const reach = Math.max(depth, 0) + radius;
  return Math.abs(along(view.right)) < reach * view.tanX + radius
    && Math.abs(along(view.up)) < reach * view.tanY + radius;
}

function bind(gl, unitIndex, texture, place) {
  gl.activeTexture(gl.TEXTURE0 + unitIndex);
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.uniform1i(place, unitIndex);
}

/// `isSharp`: as many pixels as the canvas has, so that nothing is mixed.
function makeTarget(gl, before, width, height, isSharp) {
  if (before) {
    gl.deleteFramebuffer(before.framebuffer);
    gl.deleteTexture(before.color);
    gl.deleteTexture(before.depth);
  }
  const texture = (format, inner, kind, filter) => {
    const made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.texImage2D(gl.TEXTURE_2D, 0, inner, width, height, 0, format, kind, null);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, filter);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
    return made;
  };
  const color = texture(gl.RGBA, gl.RGBA8, gl.UNSIGNED_BYTE, isSharp ? gl.NEAREST : gl.LINEAR);
  const depth = texture(gl.DEPTH_COMPONENT, gl.DEPTH_COMPONENT24, gl.UNSIGNED_INT, gl.NEAREST);
  const framebuffer = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, color, 0);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, depth, 0);
  return { framebuffer, color, depth, width, height, isSharp };
}

function program(gl, vertex, fragment) {
  const use = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(use, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) {
      throw new Error(`shader: ${gl.getShaderInfoLog(shader)}`);
    }
  }
  gl.linkProgram(use);
  if (!gl.getProgramParameter(use, gl.LINK_STATUS)) throw new Error(`program: ${gl.getProgramInfoLog(use)}`);
  const uniform = {};
  const count = gl.getProgramParameter(use, gl.ACTIVE_UNIFORMS);
  for (let i = 0; i < count; i += 1) {
    const { name } = gl.getActiveUniform(use, i);
    uniform[name] = gl.getUniformLocation(use, name);
  }
  return { use, uniform };
}
