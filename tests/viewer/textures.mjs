// SPDX-License-Identifier: MIT
// Every KTX2 file passes ktx-parse and comes out of it as the same bytes, and shows its texels in three.js.
import { readdirSync, readFileSync } from 'node:fs';
import { join } from 'node:path';
import { read, write } from '../../viewer/node_modules/ktx-parse/dist/ktx-parse.esm.js';
import { check, openPage } from './harness.mjs';

const COMPONENTS = { 9: 1, 16: 2, 37: 4, 38: 4, 76: 1, 83: 2, 97: 4, 100: 1, 103: 2, 109: 4 };

export function roundTrip(folder, name) {
  for (const file of readdirSync(folder).filter((entry) => entry.endsWith('.ktx2'))) {
    const bytes = readFileSync(join(folder, file)), again = Buffer.from(write(read(bytes), { keepWriter: true }));
    check(`${name}: ${file} through ktx-parse byte for byte`, again.equals(bytes), `${bytes.length} bytes`);
  }
}

// Textures in blocks, BC6H or BC7: the sides of level 0 are multiples of 4, and each level has 16 bytes for every 4 x 4 texels.
export function wholeBlocks(folder, name, some) {
  const { textures, cost } = JSON.parse(readFileSync(join(folder, 'manifest.json'), 'utf8'));
  let count = 0;
  for (const { file, vk_format: format, psnr_db: lost, width, height, depth, layers, levels: levelCount } of textures) {
    const { vkFormat, pixelWidth, pixelHeight, levels } = read(readFileSync(join(folder, file))), blocks = vkFormat >= 143 && vkFormat <= 145;
    check(`${name}: ${file} is in blocks where it says what is lost`, vkFormat === format && blocks === (lost !== undefined), `format ${vkFormat}`);
    if (!blocks) continue;
    count++;
    const expected = Array.from({ length: levelCount }, (_, l) =>
      16 * Math.ceil(Math.max(1, width >> l) / 4) * Math.ceil(Math.max(1, height >> l) / 4) * Math.max(1, depth >> l) * Math.max(1, layers));
    const sizes = levels.map(({ levelData }) => levelData.length);
    check(`${name}: ${file} has whole blocks`, width % 4 === 0 && height % 4 === 0 && pixelWidth === width && pixelHeight === height && sizes.join() === expected.join(),
      `${width} x ${height} x ${Math.max(depth, layers)}, levels of ${sizes.join(', ')} bytes`);
  }
  check(`${name}: ${some ? 'some' : 'no'} texture is in blocks`, some === count > 0 && some === cost.saved_bytes > 0, `${count}, ${cost.saved_bytes} bytes less`);
}

function halfToFloat(h) {
  const sign = h & 0x8000 ? -1 : 1, exponent = (h >> 10) & 31, fraction = h & 1023;
  return exponent === 0 ? sign * fraction * 2 ** -24 : sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
}

// Components of a texel of level 0, decoded here from the file's bytes.
function texel(container, x, y, z) {
  const { vkFormat, pixelWidth, pixelHeight, levels } = container, n = COMPONENTS[vkFormat], data = Buffer.from(levels[0].levelData);
  const at = ((z * Math.max(1, pixelHeight) + y) * pixelWidth + x) * n;
  return Array.from({ length: n }, (_, i) => {
    if (vkFormat >= 100) return data.readFloatLE(4 * (at + i));
    if (vkFormat >= 76) return halfToFloat(data.readUInt16LE(2 * (at + i)));
    return vkFormat === 38 ? Math.max(-1, data.readInt8(at + i) / 127) : data[at + i] / 255;
  });
}

export async function inThree(browser, root, url, folder, name) {
  const manifest = JSON.parse(readFileSync(join(folder, 'manifest.json'), 'utf8'));
  const page = await openPage(browser, { viewport: { width: 64, height: 64 } });
  await page.goto(`${root}/tests/three.html`);
  for (const entry of manifest.textures) {
    const container = read(readFileSync(join(folder, entry.file))), { width, height } = entry;
    const slices = entry.dimension === '3d' ? entry.depth : entry.layers;
    const places = Array.from({ length: 16 }, (_, i) => [(i * 7919) % width, (i * 104729) % height, (i * 31) % slices]);
    const seen = await page.evaluate((args) => globalThis.texelsInThree(...args), [`${url}/${entry.file}`, entry.dimension, places]);
    let worst = 0;
    places.forEach(([x, y, z], i) => texel(container, x, y, z).forEach((value, c) => { worst = Math.max(worst, Math.abs(seen[i][c] - value) / Math.max(1, Math.abs(value))); }));
    // texelFetch is exact; a byte's 255th may be rounded once when it becomes a float, whose step below 1 is 6e-8
    check(`${name}: ${entry.file} in three.js`, worst <= 1e-6, `${entry.dimension}, largest error ${worst.toExponential(1)}`);
  }
  check(`${name}: three.js without errors`, page.faults.length === 0, page.faults.join(' | '));
  await page.context().close();
}
