// SPDX-License-Identifier: MIT
// Maps of light from all around, latitude by longitude, top row first, as `btf render --env` has them.
import { clamp, dot, normalized, turned } from './math.js';

const CELLS_X = 256, CELLS_Y = 128, MOST_RADIANCE = 65000;

const smoothEdge = (low, high, x) => {
  const t = clamp((x - low) / (high - low), 0, 1);
  return t * t * (3 - 2 * t);
};

function softBox(d, azimuth, elevation, halfWidth, halfHeight) {
  let across = Math.atan2(d[1], d[0]) - azimuth;
  across -= 2 * Math.PI * Math.floor(across / (2 * Math.PI) + 0.5);
  const up = Math.asin(clamp(d[2], -1, 1)) - elevation;
  return (1 - smoothEdge(halfWidth, halfWidth + 0.08, Math.abs(across))) *
    (1 - smoothEdge(halfHeight, halfHeight + 0.08, Math.abs(up)));
}

// A large key light, a cool fill, a narrow rim light, a dim room.
function studio(d) {
  const key = 14 * softBox(d, -2.45, 0.75, 0.38, 0.3), fill = 2.2 * softBox(d, -0.35, 0.35, 0.35, 0.45);
  const rim = 8 * softBox(d, 1.2, 0.55, 0.5, 0.1), room = 0.1 + 0.14 * smoothEdge(-0.3, 1, d[2]);
  return [room + key + 0.85 * fill + rim, room + 0.96 * key + 0.93 * fill + 0.97 * rim,
    1.05 * room + 0.88 * key + fill + 0.92 * rim];
}

const SUN = normalized([-0.55, -0.6, 0.62]);
function sky(d) {
  if (d[2] < 0) return [0.22, 0.2, 0.18];
  const toward = dot(d, SUN), haze = Math.exp(-5 * d[2]), halo = 0.5 * Math.max(toward, 0) ** 24;
  const disc = 900 * smoothEdge(0.9988, 0.9994, toward);
  return [0.2 + 0.45 * haze + halo + disc, 0.36 + 0.38 * haze + 0.9 * halo + 0.93 * disc,
    0.75 + 0.15 * haze + 0.7 * halo + 0.8 * disc];
}

function mapDirection(column, row, width, height) {
  const longitude = 2 * Math.PI * (column / width - 0.5), polar = (Math.PI * row) / height;
  return [Math.sin(polar) * Math.sin(longitude), Math.sin(polar) * Math.cos(longitude), Math.cos(polar)];
}

const BUILT_IN = { studio, sky };
export function builtInEnvironment(name) {
  if (!Object.hasOwn(BUILT_IN, name)) throw new Error(`there is no environment "${name}"; known are ${Object.keys(BUILT_IN).join(', ')} and none`);
  const radiance = BUILT_IN[name], width = 1024, height = 512;
  const rgb = new Float32Array(width * height * 3);
  for (let y = 0, at = 0; y < height; y++)
    for (let x = 0; x < width; x++, at += 3) rgb.set(radiance(mapDirection(x + 0.5, y + 0.5, width, height)), at);
  return prepared({ name, width, height, rgb });
}

// Radiance pictures (.hdr), rows from the top, flat or run-length coded.
export function readHdr(bytes, name) {
  const fail = (what) => { throw new Error(`${name}: ${what}`); };
  let at = 0, exposure = 1;
  const line = () => {
    const start = at;
    while (at < bytes.length && bytes[at] !== 10) at++;
    return String.fromCharCode(...bytes.subarray(start, at++)).trim();
  };
  if (!line().startsWith('#?')) fail('not a Radiance picture (.hdr)');
  for (let text = line(); text !== ''; text = line()) {
    if (at >= bytes.length) fail('the header has no end');
    if (text.startsWith('EXPOSURE=')) exposure *= Number(text.slice(9)) || 1;
  }
  const size = /^-Y (\d+) \+X (\d+)$/.exec(line());
  if (!size) fail('rows must run from the top (-Y H +X W)');
  const height = Number(size[1]), width = Number(size[2]);
  if (!(width > 0 && height > 0 && width * height <= 1 << 26)) fail('a size out of range');
  const rgb = new Float32Array(width * height * 3), row = new Uint8Array(width * 4);
  for (let y = 0; y < height; y++) {
    if (bytes[at] === 2 && bytes[at + 1] === 2 && ((bytes[at + 2] << 8) | bytes[at + 3]) === width) {
      at += 4;
      for (let component = 0; component < 4; component++)
        for (let x = 0; x < width;) {
          const code = bytes[at++], run = code > 128 ? code - 128 : code;
          if (!(run > 0 && run <= width - x) || at >= bytes.length) fail('the picture is cut short');
          for (let i = 0; i < run; i++) row[4 * x++ + component] = code > 128 ? bytes[at] : bytes[at + i];
          at += code > 128 ? 1 : run;
        }
    } else {
      if (at + width * 4 > bytes.length) fail('the picture is cut short');
      row.set(bytes.subarray(at, at + width * 4));
      at += width * 4;
    }
    for (let x = 0, to = y * width * 3; x < width; x++, to += 3) {
      const e = row[4 * x + 3], factor = e > 0 ? 2 ** (e - 136) / exposure : 0;
      for (let c = 0; c < 3; c++) rgb[to + c] = (row[4 * x + c] + 0.5) * factor;
    }
  }
  return prepared({ name, width, height, rgb });
}

// Mean radiances of a map's parts.
function cellsOf(map, columns, rows) {
  const cells = new Float32Array(columns * rows * 3), counts = new Uint32Array(columns * rows);
  for (let y = 0, at = 0; y < map.height; y++)
    for (let x = 0; x < map.width; x++, at += 3) {
      const cell = Math.floor((y * rows) / map.height) * columns + Math.floor((x * columns) / map.width);
      for (let c = 0; c < 3; c++) cells[3 * cell + c] += map.rgb[at + c];
      counts[cell]++;
    }
  return cells.map((sum, i) => sum / Math.max(1, counts[Math.floor(i / 3)]));
}

// Cells, and sums along which they are drawn in proportion to the light they give.
function prepared(map) {
  const columns = Math.min(CELLS_X, map.width), rows = Math.min(CELLS_Y, map.height), cells = cellsOf(map, columns, rows);
  const sums = new Float64Array(columns * rows + 1);
  for (let cell = 0; cell < columns * rows; cell++) sums[cell + 1] = sums[cell] + luminance(cells, cell) * solidAngle(cell, columns, rows);
  return { ...map, columns, rows, cells, sums };
}

const luminance = (cells, cell) => 0.2126 * cells[3 * cell] + 0.7152 * cells[3 * cell + 1] + 0.0722 * cells[3 * cell + 2];
const solidAngle = (cell, columns, rows) => {
  const row = Math.floor(cell / columns), step = Math.PI / rows;
  return ((2 * Math.PI) / columns) * (Math.cos(row * step) - Math.cos((row + 1) * step));
};

// A distant light that stands for 1 / count of the map; x and y in 0..1 choose which.
export function sampleEnvironment(map, x, y, count, rotation) {
  const total = map.sums[map.sums.length - 1], wanted = x * total;
  let low = 0, high = map.sums.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (map.sums[middle] <= wanted) low = middle;
    else high = middle;
  }
  const weight = map.sums[low + 1] - map.sums[low], inside = weight > 0 ? (wanted - map.sums[low]) / weight : 0.5;
  const direction = mapDirection((low % map.columns) + inside, Math.floor(low / map.columns) + y, map.columns, map.rows);
  const factor = weight > 0 ? (total / weight) * (solidAngle(low, map.columns, map.rows) / count) : 0;
  return { direction: turned(direction, [0, 0, 1], rotation),
    irradiance: [0, 1, 2].map((c) => map.cells[3 * low + c] * factor) };
}

// The map as a texture of at most `most` texels a side.
export function environmentTexels(map, most) {
  const width = Math.min(map.width, most), height = Math.min(map.height, most), fits = width === map.width && height === map.height;
  const rgb = fits ? map.rgb : cellsOf(map, width, height), texels = new Float32Array(width * height * 4);
  for (let i = 0; i < width * height; i++)
    for (let c = 0; c < 3; c++) texels[4 * i + c] = Math.min(rgb[3 * i + c], MOST_RADIANCE);
  return { width, height, texels };
}
