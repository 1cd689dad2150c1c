// SPDX-License-Identifier: MIT
// Surfaces: positions, normals and texture coordinates in tiles (before the repeat), and triangles.
import { add, cross, normalized, scaled, sub } from './math.js';

const grid = (columns, rows) => {
  const triangles = new Uint32Array(columns * rows * 6);
  for (let y = 0, at = 0; y < rows; y++)
    for (let x = 0; x < columns; x++, at += 6) {
      const a = y * (columns + 1) + x, d = a + columns + 1;
      triangles.set([a, a + 1, d + 1, a, d + 1, d], at);
    }
  return triangles;
};

export function plane() {
  return { kind: 'plane', target: [0, 0, 0], radius: 1.5, triangles: new Uint32Array([0, 1, 2, 0, 2, 3]),
    positions: new Float32Array([-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0]),
    normals: new Float32Array([0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1]), uvs: new Float32Array([0, 0, 1, 0, 1, 1, 0, 1]) };
}

// The shader moves fragments onto the exact sphere.
export function sphere(rows = 96, columns = 192) {
  const positions = new Float32Array((rows + 1) * (columns + 1) * 3), uvs = new Float32Array((rows + 1) * (columns + 1) * 2);
  for (let row = 0, i = 0; row <= rows; row++)
    for (let column = 0; column <= columns; column++, i++) {
      const latitude = Math.PI * (row / rows - 0.5), longitude = (2 * Math.PI * column) / columns;
      positions.set([Math.cos(latitude) * Math.cos(longitude), Math.cos(latitude) * Math.sin(longitude), Math.sin(latitude)], 3 * i);
      uvs.set([(2 * column) / columns, row / rows], 2 * i);
    }
  return { kind: 'sphere', target: [0, 0, 0], radius: 1, positions, normals: positions, uvs, triangles: grid(columns, rows) };
}

// A cloth falls over a ball: gravity, and lengths kept by repeated projection (Jakobsen 2001). As that of `btf render`
// with fewer threads. What is drawn is the bicubic B-spline surface that the particles control.
const SIDE = 61, STEPS = 220, PROJECTIONS = 12, FACETS = 5;
const BALL = 0.55, FLOOR = -0.62, HALF_SIDE = 1.15;

function fall() {
  const n = SIDE * SIDE, now = new Float64Array(3 * n), rest = (2 * HALF_SIDE) / (SIDE - 1);
  for (let i = 0; i < n; i++) {
    const u = (i % SIDE) / (SIDE - 1), v = Math.floor(i / SIDE) / (SIDE - 1);
    const x = (2 * u - 1) * HALF_SIDE, y = (2 * v - 1) * HALF_SIDE;
    // turned and barely uneven, so that it does not fall symmetrically
    now.set([0.94 * x - 0.342 * y, 0.342 * x + 0.94 * y, BALL + 0.02 + 0.004 * Math.sin(7 * u + 3 * v)], 3 * i);
  }
  const before = now.slice();
  const keep = (a, b, length, onlyCloser) => {
    const x = now[b] - now[a], y = now[b + 1] - now[a + 1], z = now[b + 2] - now[a + 2];
    const apart = Math.sqrt(x * x + y * y + z * z);
    if (apart === 0 || (onlyCloser && apart >= length)) return;
    const f = (0.5 * (apart - length)) / apart;
    now[a] += f * x; now[a + 1] += f * y; now[a + 2] += f * z;
    now[b] -= f * x; now[b + 1] -= f * y; now[b + 2] -= f * z;
  };
  const collide = () => {
    for (let i = 0; i < 3 * n; i += 3) {
      const distance = Math.sqrt(now[i] ** 2 + now[i + 1] ** 2 + now[i + 2] ** 2);
      if (distance < BALL)
        for (let k = i; k < i + 3; k++) {
          now[k] *= BALL / Math.max(distance, 1e-6);
          before[k] += 0.6 * (now[k] - before[k]);
        }
      if (now[i + 2] < FLOOR) {
        now[i + 2] = FLOOR;
        for (let k = i; k < i + 3; k++) before[k] = now[k];
      }
    }
  };
  for (let step = 0; step < STEPS; step++) {
    for (let k = 0; k < 3 * n; k++) {
      const was = now[k];
      now[k] += 0.985 * (was - before[k]) - (k % 3 === 2 ? 8e-4 : 0);
      before[k] = was;
    }
    for (let pass = 0; pass < PROJECTIONS; pass++) {
      for (let y = 0; y < SIDE; y++)
        for (let x = 0; x < SIDE; x++) {
          const i = 3 * (y * SIDE + x), right = x + 1 < SIDE, up = y + 1 < SIDE;
          if (right) keep(i, i + 3, rest);
          if (up) keep(i, i + 3 * SIDE, rest);
          if (right && up) { keep(i, i + 3 * SIDE + 3, rest * Math.SQRT2); keep(i + 3, i + 3 * SIDE, rest * Math.SQRT2); }
          if (pass % 2 === 0) { // threads resist tight folds
            if (x + 3 < SIDE) keep(i, i + 9, 2.5 * rest, true);
            if (y + 3 < SIDE) keep(i, i + 9 * SIDE, 2.5 * rest, true);
          }
        }
      collide();
    }
  }
  return now;
}

function splineWeights(t) {
  const s = 1 - t;
  return { weight: [s ** 3 / 6, (3 * t ** 3 - 6 * t * t + 4) / 6, (3 * s ** 3 - 6 * s * s + 4) / 6, t ** 3 / 6],
    slope: [-0.5 * s * s, 0.5 * t * (3 * t - 4), -0.5 * s * (3 * s - 4), 0.5 * t * t] };
}

export function cloth() {
  const particles = fall(), fine = (SIDE - 1) * FACETS, count = (fine + 1) ** 2;
  const positions = new Float32Array(3 * count), normals = new Float32Array(3 * count), uvs = new Float32Array(2 * count);
  const inner = (x, y) => [0, 1, 2].map((k) => particles[3 * (y * SIDE + x) + k]);
  const control = new Float64Array(3 * (SIDE + 2) ** 2), position = [0, 0, 0], alongX = [0, 0, 0], alongY = [0, 0, 0];
  for (let y = -1; y <= SIDE; y++)
    for (let x = -1; x <= SIDE; x++) { // beyond the border the cloth goes on straight
      const cx = Math.min(Math.max(x, 0), SIDE - 1), cy = Math.min(Math.max(y, 0), SIDE - 1);
      const p = cx === x && cy === y ? inner(x, y) : sub(scaled(inner(cx, cy), 2), inner(2 * cx - x, 2 * cy - y));
      control.set(p, 3 * ((y + 1) * (SIDE + 2) + x + 1));
    }
  const places = Array.from({ length: fine + 1 }, (_, i) => {
    const span = Math.min(Math.floor(i / FACETS), SIDE - 2);
    return { first: span - 1, ...splineWeights((i - span * FACETS) / FACETS) };
  });
  for (let y = 0, i = 0; y <= fine; y++)
    for (let x = 0; x <= fine; x++, i++) {
      const px = places[x], py = places[y];
      position.fill(0); alongX.fill(0); alongY.fill(0);
      for (let b = 0; b < 4; b++)
        for (let a = 0; a < 4; a++) {
          const at = 3 * ((py.first + b + 1) * (SIDE + 2) + px.first + a + 1);
          for (let k = 0; k < 3; k++) {
            position[k] += px.weight[a] * py.weight[b] * control[at + k];
            alongX[k] += px.slope[a] * py.weight[b] * control[at + k];
            alongY[k] += px.weight[a] * py.slope[b] * control[at + k];
          }
        }
      positions.set(position, 3 * i);
      normals.set(normalized(cross(alongX, alongY)), 3 * i);
      uvs.set([x / fine, y / fine], 2 * i);
    }
  return { kind: 'cloth', target: [0, 0, -0.15], radius: 1.6, shadows: true, positions, normals, uvs, triangles: grid(fine, fine) };
}

// Wavefront OBJ: v, vt, vn and f. Faces without texture coordinates are projected along their largest axis.
export function readObj(text, name) {
  const v = [], vt = [], vn = [], corners = [];
  const outside = (word) => { throw new Error(`${name}: a face with the index ${word} out of range`); };
  const index = (word, count) => { // negative ones count back from their line
    const value = parseInt(word, 10), i = value < 0 ? count + value : value - 1;
    return i >= 0 ? i : outside(word);
  };
  const lines = text.replace(/^\s*#.*$/gm, '').replace(/\\\r?\n/g, ' ').split('\n'); // a backslash continues a line, but no comment
  for (const line of lines) {
    const [word, ...rest] = line.trim().split(/\s+/);
    if (word === 'v') v.push(rest.slice(0, 3).map(Number));
    else if (word === 'vt') vt.push(rest.slice(0, 2).map(Number));
    else if (word === 'vn') vn.push(normalized(rest.slice(0, 3).map(Number)));
    else if (word === 'f') {
      const face = rest.map((corner) => {
        const [p, t, n] = corner.split('/');
        return { p: index(p, v.length), t: t ? index(t, vt.length) : -1, n: n ? index(n, vn.length) : -1 };
      });
      for (let k = 2; k < face.length; k++) corners.push(face[0], face[k - 1], face[k]);
    }
  }
  if (!corners.length) throw new Error(`${name}: holds no faces; expected a Wavefront OBJ`);
  for (const { p, t, n } of corners) // may come before what they name
    for (const [i, list] of [[p, v], [t, vt], [n, vn]]) if (i >= list.length) outside(i + 1);
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (const { p } of corners)
    for (let k = 0; k < 3; k++) { low[k] = Math.min(low[k], v[p][k]); high[k] = Math.max(high[k], v[p][k]); }
  const centre = scaled(add(low, high), 0.5), size = 0.5 * Math.hypot(...sub(high, low)) || 1;
  const place = (p) => scaled(sub(v[p], centre), 1 / size), averages = new Map();
  const positions = new Float32Array(3 * corners.length), normals = new Float32Array(3 * corners.length);
  const uvs = new Float32Array(2 * corners.length), faces = [];
  for (let i = 0; i < corners.length; i += 3) {
    const [a, b, c] = [0, 1, 2].map((k) => place(corners[i + k].p)), area = cross(sub(b, a), sub(c, a));
    faces.push(area);
    for (let k = 0; k < 3; k++) averages.set(corners[i + k].p, add(averages.get(corners[i + k].p) || [0, 0, 0], area));
  }
  corners.forEach((corner, i) => {
    const p = place(corner.p), area = faces[Math.floor(i / 3)].map(Math.abs), main = area.indexOf(Math.max(...area));
    positions.set(p, 3 * i);
    normals.set(corner.n >= 0 ? vn[corner.n] : normalized(averages.get(corner.p)), 3 * i);
    const projected = [p[main === 0 ? 1 : 0], p[main === 2 ? 1 : 2]].map((x) => 0.5 * (x + 1));
    uvs.set(corner.t >= 0 ? vt[corner.t] : projected, 2 * i);
  });
  if (!positions.every(Number.isFinite) || !uvs.every(Number.isFinite)) throw new Error(`${name}: holds what is not a number`);
  return { kind: 'obj', target: [0, 0, 0], radius: 1, shadows: true, positions, normals, uvs,
    triangles: Uint32Array.from({ length: corners.length }, (_, i) => i) };
}
