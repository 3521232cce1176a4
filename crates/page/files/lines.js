// Lines and triangles of the graphics card, filled anew when they change.

const LINE_FLOATS = 10;
const CORNER_FLOATS = 7;

class Geometry {
  constructor(floats) {
    this.floatsEach = floats;
    this.clear();
  }

  clear() {
    this.list = [];
    this.count = 0;
    this.isDirty = true;
  }

  upload(gl) {
    if (!this.array) {
      this.array = gl.createVertexArray();
      this.data = gl.createBuffer();
      gl.bindVertexArray(this.array);
      gl.bindBuffer(gl.ARRAY_BUFFER, this.data);
      this.layout(gl);
    }
    if (this.isDirty) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.data);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(this.list), gl.DYNAMIC_DRAW);
      this.isDirty = false;
    }
    return this.array;
  }
}

/// Lines of one width in pixels.
export class Lines extends Geometry {
  constructor(width) {
    super(LINE_FLOATS);
    this.width = width;
  }

  line(from, to, color) {
    this.list.push(...from, ...to, ...color);
    this.count += 1;
    this.isDirty = true;
  }

  layout(gl) {
    for (const [place, size, word] of [[0, 3, 0], [1, 3, 3], [2, 4, 6]]) {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, gl.FLOAT, false, LINE_FLOATS * 4, word * 4);
      gl.vertexAttribDivisor(place, 1);
    }
  }
}

/// Triangles, each corner with its colour; solid ones hide one another.
export class Mesh extends Geometry {
  constructor(isSolid) {
    super(CORNER_FLOATS);
    this.isSolid = isSolid;
  }

  triangle(a, b, c, color) {
    for (const corner of [a, b, c]) this.list.push(...corner, ...color);
    this.count += 3;
    this.isDirty = true;
  }

  layout(gl) {
    for (const [place, size, word] of [[0, 3, 0], [2, 4, 3]]) {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, gl.FLOAT, false, CORNER_FLOATS * 4, word * 4);
    }
  }
}
