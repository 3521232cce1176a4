// Programs for the graphics card, WebGL2.

/// One point sprite per Gaussian, just large enough for its ellipsoid. The bounds on the screen are
/// those of the ellipsoid's dual quadric under the projection.
export const GAUSSIAN_VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec3 aPlace;
layout(location = 1) in float aChanged;
layout(location = 2) in float aOpacity;
layout(location = 3) in vec3 aScale;
layout(location = 4) in vec4 aRotation; // w x y z
layout(location = 5) in float aReflectivity;
layout(location = 6) in float aSigma;
layout(location = 7) in float aConfident;

uniform mat4 uClip;      // from places relative to the eye
uniform vec3 uEye;
uniform vec2 uViewport;  // pixels
uniform float uExtent;   // sigmas
uniform float uMaxPoint;
uniform float uMinRadius; // per metre of distance
uniform int uMode;       // 0 height, 1 sigma, 2 strength, 3 age; 4 error and 5 change between maps, which stand in place of its age
uniform vec2 uRange;     // of what is coloured by
uniform float uNow;      // seconds of the dive
uniform float uAmbiguous; // 1 shows what is ambiguous
uniform vec3 uAmbiguousColor;
uniform sampler2D uRamp;

flat out mat3 vSphere;   // directions to those where the ellipsoid is a unit sphere
flat out vec3 vOrigin;   // the eye there
flat out vec4 vColor;    // a: 1 where asserted

mat3 turned(vec4 q) {
  float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(
    1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
    2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
    2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

float quadric(vec4 a, vec4 b) {
  return dot(a.xyz, b.xyz) - a.w * b.w;
}

float value() {
  if (uMode == 0) return aPlace.z;
  if (uMode == 1) return min(aSigma, 1e6);
  if (uMode == 2) return 10.0 * log(max(aOpacity * aReflectivity, 1e-12)) / log(10.0);
  if (uMode >= 4) return aChanged;
  return max(uNow - aChanged, 0.0);
}

void main() {
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  gl_PointSize = 1.0;
  vColor = vec4(0.0);
  vSphere = mat3(1.0);
  vOrigin = vec3(0.0);
  if (aConfident < 0.5 && uAmbiguous < 0.5) return;

  vec3 center = aPlace - uEye;
  mat3 axes = turned(aRotation);
  vec3 radii = max(uExtent * aScale, vec3(uMinRadius * length(center)));
  mat4 world = mat4(
    vec4(axes[0] * radii.x, 0.0), vec4(axes[1] * radii.y, 0.0), vec4(axes[2] * radii.z, 0.0),
    vec4(center, 1.0));
  mat4 t = transpose(uClip * world);
  float ww = quadric(t[3], t[3]);
  // Reaches behind the eye.
  if (ww >= 0.0 || t[3].w <= 0.0) return;
  vec2 middle = vec2(quadric(t[0], t[3]), quadric(t[1], t[3])) / ww;
  vec2 half_ = sqrt(max(middle * middle - vec2(quadric(t[0], t[0]), quadric(t[1], t[1])) / ww, 0.0));
  vec2 low = max(middle - half_, -1.0);
  vec2 high = min(middle + half_, 1.0);
  if (any(greaterThanEqual(low, high))) return;

  vec2 size = 0.5 * (high - low) * uViewport;
  gl_PointSize = min(max(size.x, size.y) + 1.5, uMaxPoint);
  gl_Position = vec4(0.5 * (low + high), 0.0, 1.0);
  vSphere = transpose(axes);
  for (int i = 0; i < 3; i++) vSphere[i] /= radii;
  vOrigin = -(vSphere * center);
  float place = clamp((value() - uRange.x) / max(uRange.y - uRange.x, 1e-9), 0.0, 1.0);
  vec3 color = textureLod(uRamp, vec2(place * 0.996 + 0.002, 0.5), 0.0).rgb;
  vColor = aConfident < 0.5 ? vec4(mix(color, uAmbiguousColor, 0.75), 0.0) : vec4(color, 1.0);
}
`;

/// Where the ray through this pixel first meets the ellipsoid. The ray's step is one metre along the
/// view, so that its parameter is the depth.
export const GAUSSIAN_FRAGMENT = `#version 300 es
precision highp float;
flat in mat3 vSphere;
flat in vec3 vOrigin;
flat in vec4 vColor;
uniform vec2 uViewport;
uniform vec3 uForward;
uniform vec3 uRight;  // times the tangent of half the field of view
uniform vec3 uUp;
uniform vec2 uDepth;  // a + b / depth is the depth in clip space
layout(location = 0) out vec4 color;

const float DITHER[16] = float[16](
  0.0, 8.0, 2.0, 10.0, 12.0, 4.0, 14.0, 6.0, 3.0, 11.0, 1.0, 9.0, 15.0, 7.0, 13.0, 5.0);

void main() {
  if (vColor.a < 0.5) {
    ivec2 pixel = ivec2(gl_FragCoord.xy) & 3;
    if (DITHER[pixel.y * 4 + pixel.x] > 3.5) discard;
  }
  vec2 at = gl_FragCoord.xy / uViewport * 2.0 - 1.0;
  vec3 ray = vSphere * (uForward + at.x * uRight + at.y * uUp);
  float a = dot(ray, ray);
  float nearest = -dot(ray, vOrigin) / a;
  vec3 foot = vOrigin + nearest * ray;
  float inside = 1.0 - dot(foot, foot);
  if (inside < 0.0) discard;
  float depth = nearest - sqrt(inside / a);
  if (depth <= 0.0) discard;
  vec3 hit = vOrigin + depth * ray;
  vec3 normal = normalize(transpose(vSphere) * hit);
  float facing = abs(dot(normal, normalize(uForward + at.x * uRight + at.y * uUp)));
  float light = 0.62 + 0.3 * facing + 0.1 * normal.z;
  // What is ambiguous shades nothing and is not shaded.
  color = vec4(vColor.rgb * light, vColor.a);
  gl_FragDepth = clamp(0.5 * (uDepth.x + uDepth.y / depth) + 0.5, 0.0, 1.0);
}
`;

export const SCREEN_VERTEX = `#version 300 es
void main() {
  vec2 at = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  gl_Position = vec4(at, 0.0, 1.0);
}
`;

/// Eye-dome lighting: a pixel is darker the more its neighbours are nearer, on a logarithmic scale.
export const SCREEN_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D uColor;
uniform highp sampler2D uDepthMap;
uniform vec2 uDepth;
uniform vec2 uTarget;    // pixels of the canvas
uniform float uStrength; // 0 is off
uniform float uSpread;   // pixels of the depth map
out vec4 color;

float logDepth(float stored) {
  return log2(uDepth.y / (2.0 * stored - 1.0 - uDepth.x));
}

void main() {
  vec2 at = gl_FragCoord.xy / uTarget;
  vec2 texel = uSpread / vec2(textureSize(uDepthMap, 0));
  float stored = texture(uDepthMap, at).r;
  vec4 found = texture(uColor, at);
  if (uStrength > 0.0 && found.a > 0.5 && stored < 1.0) {
    float here = logDepth(stored);
    float shade = 0.0;
    vec2 steps[4] = vec2[4](vec2(texel.x, 0.0), vec2(-texel.x, 0.0), vec2(0.0, texel.y), vec2(0.0, -texel.y));
    for (int i = 0; i < 4; i++) {
      float other = texture(uDepthMap, at + steps[i]).r;
      bool casts = texture(uColor, at + steps[i]).a > 0.5;
      if (casts && other < 1.0) shade += max(0.0, here - logDepth(other));
    }
    found.rgb *= max(0.3, exp(-uStrength * shade));
  }
  color = vec4(found.rgb, 1.0);
  gl_FragDepth = stored;
}
`;

/// Lines of some pixels' width, each an instance of a strip of two triangles.
export const LINE_VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec3 aFrom;
layout(location = 1) in vec3 aTo;
layout(location = 2) in vec4 aColor;
uniform mat4 uClip;
uniform vec3 uEye;
uniform vec2 uViewport;
uniform float uWidth;
out vec4 vColor;

void main() {
  vec4 a = uClip * vec4(aFrom - uEye, 1.0);
  vec4 b = uClip * vec4(aTo - uEye, 1.0);
  const float NEAR = 0.02;
  if (a.w < NEAR && b.w < NEAR) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
  if (a.w < NEAR) a = mix(a, b, (NEAR - a.w) / (b.w - a.w));
  if (b.w < NEAR) b = mix(b, a, (NEAR - b.w) / (a.w - b.w));
  vec2 along = (b.xy / b.w - a.xy / a.w) * uViewport;
  vec2 across = length(along) > 1e-6 ? normalize(vec2(-along.y, along.x)) : vec2(0.0, 1.0);
  vec4 end = (gl_VertexID & 1) == 0 ? a : b;
  float side = gl_VertexID < 2 ? -1.0 : 1.0;
  end.xy += side * across * uWidth / uViewport * end.w;
  gl_Position = end;
  vColor = aColor;
}
`;

export const MESH_VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec3 aFrom;
layout(location = 2) in vec4 aColor;
uniform mat4 uClip;
uniform vec3 uEye;
out vec4 vColor;
void main() {
  gl_Position = uClip * vec4(aFrom - uEye, 1.0);
  vColor = aColor;
}
`;

export const FLAT_FRAGMENT = `#version 300 es
precision highp float;
in vec4 vColor;
out vec4 color;
void main() { color = vec4(vColor.rgb * vColor.a, vColor.a); }
`;
