// SPDX-License-Identifier: MIT
// The inspector: what it says of a place is what is drawn there, at all times.
import { execFileSync } from 'node:child_process';
import { cpSync, readFileSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { check } from './harness.mjs';
import { btf, change, close, coded, exported, openViewer, picture, plain, run, SIDE, small, work } from './bench.mjs';

const bytesOf = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
const pixelAt = (rgb, x, y) => [...rgb.subarray(3 * (Math.floor(y * SIDE) * SIDE + Math.floor(x * SIDE)))].slice(0, 3);
const readout = (page) => page.evaluate(() => document.querySelector('.readout').textContent);

// f * cos at the chosen point by `btf eval` is the colour that the inspector shows, and so are its two pictures elsewhere.
export async function inspector(name) {
  const page = await openViewer(name);
  await change(page, { ...plain, levels: false, exposure: -1 });
  const seen = await page.evaluate(() => {
    const { uv, view, light, hex } = globalThis.viewer.inspect(0.45, 0.4), z = Math.sqrt(1 - 0.45 ** 2 - 0.4 ** 2), other = [0.45, -0.4, z];
    const at = (k, sign) => (1 + (sign * other[k]) / (1 + z) / 1.04) * 0.5 * 192;
    const discs = [...document.querySelectorAll('.discs canvas')].map((canvas) => [...canvas.getContext('2d').getImageData(Math.floor(at(0, 1)), Math.floor(at(1, -1)), 1, 1).data.slice(0, 3)]);
    return { uv, view, light, other, colours: [hex, ...discs] };
  });
  seen.colours[0] = bytesOf(seen.colours[0]);
  const queries = [[seen.light, seen.view], [seen.other, seen.view], [seen.light, seen.other]];
  queries.forEach(([light, view], i) => {
    const input = `${[...seen.uv, ...light, ...view].join(' ')}\n`;
    const answer = execFileSync(btf, ['eval', join(work, `${name}.btfz`)], { input }).toString().trim().split(/\s+/).map(Number).slice(-3);
    const worst = Math.max(...answer.map((f, c) => Math.abs(coded(f * Math.PI * light[2] * 0.5) - seen.colours[i][c])));
    // a pixel of the disc is 1/92 wide, a tenth of the distance between lights: part of their contrast
    check(`the inspector ${['names the colour', 'shows it by light', 'shows it by view'][i]} that btf eval says`, worst < 8, `${seen.colours[i]}, off by ${worst.toFixed(1)} of 255`);
  });
  await close(page, 'inspector');
}

// Where no light comes the inspector is as black as the picture, and has no ring by light.
export async function darkSide(name) {
  const page = await openViewer(name);
  const ringed = (hexOfRing) => page.evaluate((ring) => [...document.querySelectorAll('.discs canvas')].map((canvas) => {
    const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    return data.some((_, i) => i % 4 === 0 && ring.every((byte, c) => Math.abs(data[i + c] - byte) < 9));
  }), bytesOf(hexOfRing));
  await change(page, { ...plain, camera: [-90, 20], lights: [{ azimuth: 90, elevation: -20, strength: 1, colour: [1, 1, 1] }] });
  const drawn = await picture(page, 1);
  for (const [x, y] of [[0.5, 0.5], [0.45, 0.4]]) {
    const { hex, light } = await page.evaluate((place) => globalThis.viewer.inspect(...place), [x, y]);
    check('the inspector is black where the light is below the horizon', hex === '#000000' && light[2] < 0 && /below the horizon/.test(await readout(page)) && Math.max(...pixelAt(drawn, x, y)) === 0,
      `${await readout(page)}, drawn ${pixelAt(drawn, x, y)}`);
    check('and has a ring by view alone', (await ringed('#e8bd7c')).join() === 'false,true');
  }
  await change(page, { lights: [{ azimuth: -90, elevation: 20, strength: 1, colour: [1, 1, 1] }] });
  await page.evaluate(() => globalThis.viewer.inspect(0.5, 0.5));
  check('where it is above, the inspector says nothing of it', !/horizon/.test(await readout(page)) && (await ringed('#e8bd7c')).join() === 'true,true', await readout(page));
  await close(page, 'the dark side');
}

// A material that does not repeat: its border goes on.
export async function clamped() {
  const folder = join(work, 'clamped.btfd'), file = join(folder, 'manifest.json');
  cpSync(join(work, 'material.btfd'), folder, { recursive: true });
  writeFileSync(file, JSON.stringify({ ...JSON.parse(readFileSync(file, 'utf8')), wrap: 'clamp' }));
  run('encode', folder, '-o', join(work, 'clamped.btfz'), '--codec', 'fmf', '--quiet');
  run('export', join(work, 'clamped.btfz'), '-o', join(work, 'clamped'), '--quiet');
  const page = await openViewer('clamped');
  await page.evaluate(() => globalThis.viewer.setSurface('plane'));
  await change(page, { ...plain, camera: [-90, 89], repeat: 3, levels: false, exposure: -1.5 });
  const drawn = await picture(page, 1);
  // the material is a third of the plane, left and near; beyond it are its last column and row
  for (const [[x, y], texel] of [[[0.5, 0.5], [31, 31]], [[0.65, 0.35], [31, 31]], [[0.5, 0.69], [31, null]]]) {
    const seen = await page.evaluate((place) => globalThis.viewer.inspect(...place), [x, y]), pixel = pixelAt(drawn, x, y);
    const worst = Math.max(...bytesOf(seen.hex).map((byte, c) => Math.abs(byte - pixel[c])));
    check(`the inspector of a clamped material at ${x}, ${y} is at its border`, texel.every((at, k) => at === null || at === seen.texel[k]), seen.texel.join());
    // as in `inspector`, a pixel of the disc is part of the contrast between lights
    check('and has the colour that is drawn', worst < 8, `${seen.hex}, drawn ${pixel}`);
  }
  await close(page, 'a clamped material');
}

// Frames as people see them: the pointer rests while everything else changes.
export async function follows(name) {
  const page = await openViewer('coarse', small, 'panel=0'), still = () => page.waitForFunction(() => globalThis.viewer.renderer.sample >= 4);
  await change(page, { distance: 8 }); // few pixels, for software GL
  await still();
  await page.keyboard.press('i');
  const [x, y] = [0.64, 0.45];
  await page.mouse.move(x * SIDE, y * SIDE);
  await page.waitForFunction(() => /texel/.test(document.querySelector('.readout').textContent));
  const changes = { 'the light': () => page.keyboard.press('Shift+ArrowLeft'), 'the exposure': () => page.keyboard.press('-'), 'the view': () => page.keyboard.press('ArrowLeft'),
    'the material': () => page.evaluate((url) => globalThis.viewer.open(url), exported(name)) };
  const inspected = () => page.evaluate(() => [document.querySelector('.readout').textContent, ...[...document.querySelectorAll('.discs canvas')].map((canvas) => canvas.toDataURL())]);
  for (const [what, act] of Object.entries(changes)) {
    await still();
    const before = await inspected();
    await act();
    await still();
    const after = await inspected();
    await page.evaluate((place) => { globalThis.viewer.inspect(...place); }, [x, y]);
    const asked = await inspected();
    check(`the inspector follows ${what}`, after.join() === asked.join() && after.join() !== before.join(), `${before[0]}, then ${after[0]}, asked ${asked[0]}`);
  }
  await change(page, { distance: 12 });
  await still();
  check('it says so where the surface is no longer', (await readout(page)) === 'no surface here', await readout(page));
  await close(page, 'the inspector follows');
}
