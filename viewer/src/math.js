// SPDX-License-Identifier: MIT
// Vectors of three numbers and column-major matrices of sixteen. The world has z up.
export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const normalized = (a) => scaled(a, 1 / (Math.hypot(...a) || 1));
export const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
export const radians = (degrees) => (degrees * Math.PI) / 180;
export const degrees = (radians) => (radians * 180) / Math.PI;

// Azimuth from +x toward +y and elevation, in degrees.
export function directionOf(azimuth, elevation) {
  const a = radians(azimuth), e = radians(elevation);
  return [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
}

// A vector turned about a unit axis.
export function turned(v, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle);
  return add(add(scaled(v, c), scaled(cross(axis, v), s)), scaled(axis, dot(axis, v) * (1 - c)));
}

export function product(a, b) {
  const out = new Float32Array(16);
  for (let column = 0; column < 4; column++)
    for (let row = 0; row < 4; row++)
      for (let k = 0; k < 4; k++) out[column * 4 + row] += a[k * 4 + row] * b[column * 4 + k];
  return out;
}

// World to the frame of right, up and backward axes at a position.
function toFrame(right, up, back, position) {
  return [right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
    -dot(right, position), -dot(up, position), -dot(back, position), 1];
}

// The camera of `btf render`: it looks at the target from an azimuth and an elevation; 36 degrees high, or wide where
// that is less.
export function orbitCamera(target, azimuth, elevation, distance, aspect) {
  const back = directionOf(azimuth, elevation), a = radians(azimuth);
  const right = [-Math.sin(a), Math.cos(a), 0], up = cross(back, right);
  return { position: add(target, scaled(back, distance)), right, up, back, distance, halfHeight: Math.tan(radians(18)) / Math.min(aspect, 1) };
}

export function cameraMatrix(camera, aspect) {
  const near = Math.max(0.01, camera.distance - 4), far = camera.distance + 4, f = 1 / camera.halfHeight;
  const projection = [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (near + far) / (near - far), -1, 0, 0,
    (2 * near * far) / (near - far), 0];
  return product(projection, toFrame(camera.right, camera.up, camera.back, camera.position));
}

// Parallel projection along a light of everything within a radius of the origin.
export function lightMatrix(direction, radius) {
  const seed = Math.abs(direction[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0];
  const right = normalized(cross(seed, direction)), up = cross(direction, right), s = 1 / radius;
  return product([s, 0, 0, 0, 0, s, 0, 0, 0, 0, -s, 0, 0, 0, 0, 1], toFrame(right, up, direction, [0, 0, 0]));
}

// Well spread pairs in 0..1, whatever their number (the plastic number's additive recurrence).
export const spread = (n) => [(0.5 + n * 0.7548776662466927) % 1, (0.5 + n * 0.5698402909980532) % 1];

// Places in a pixel around 0 for the first `count` samples, whose mean is 0, so that the picture is not moved.
export function pixelPlaces(count) {
  const places = Array.from({ length: count }, (_, i) => spread(i));
  const mean = [0, 1].map((k) => places.reduce((sum, place) => sum + place[k], 0) / count);
  return places.map((place) => place.map((x, k) => x - mean[k]));
}
