// SPDX-License-Identifier: MIT
// The viewer in headless Chromium: node tests/viewer/run.mjs BTF WORK [--pictures]
// With --pictures nothing is tested but that docs/pictures/viewer.png can be made anew.
// WORK holds NAME.btfz for every codec that exports and coarse.btfz, another model of the same material.
import { execFileSync } from 'node:child_process';
import { readdirSync, readFileSync, writeFileSync } from 'node:fs';
import { join, resolve } from 'node:path';
import { attempt, check, counts, launch, meanDifference, openPage, pixels, serve } from './harness.mjs';
import { inThree, roundTrip } from './textures.mjs';

const [btf, work, option] = process.argv.slice(2), source = resolve(import.meta.dirname, '../..');
const SIDE = 128, SAMPLES = 16;
// The contract's bound. Part of it is noise: 16 samples of a pixel at other places than those of `btf render`. How much is
// printed: the difference of two of its pictures with other seeds.
const MOST_DIFFERENCE = 2;
const run = (...args) => execFileSync(btf, args, { stdio: ['ignore', 'pipe', 'inherit'] });
const names = readdirSync(work).filter((file) => file.endsWith('.btfz')).map((file) => file.slice(0, -5)).sort();
const codecs = names.filter((name) => name !== 'coarse');
for (const name of names) run('export', join(work, `${name}.btfz`), '-o', join(work, name), '--viewer', '--quiet');

const { server, root } = await serve({ viewer: join(source, 'viewer'), tests: join(source, 'tests/viewer'), modules: join(source, 'viewer/node_modules'), work });
const browser = await launch();
const small = { viewport: { width: SIDE, height: SIDE } };
const ready = (page) => page.waitForFunction(() => globalThis.viewer && globalThis.viewer.ready);
const change = (page, values) => page.evaluate((v) => globalThis.viewer.change(v), values);
const picture = async (page) => pixels(page, await page.evaluate((samples) => globalThis.viewer.picture(samples), SAMPLES));
const plain = { tone: 'clip', background: [0.18, 0.18, 0.18] };

let rendered = 0;
async function reference(page, name, ...args) {
  const path = join(work, `reference${rendered++}.png`);
  run('render', join(work, `${name}.btfz`), '-o', path, '--size', `${SIDE}x${SIDE}`, '--spp', String(SAMPLES), '--quiet', ...args);
  return pixels(page, readFileSync(path));
}
async function compare(page, title, name, ...args) {
  const mine = await picture(page), difference = meanDifference(mine, await reference(page, name, ...args));
  check(title, difference < MOST_DIFFERENCE, `mean absolute difference ${difference.toFixed(2)} of 255`);
  return mine;
}
async function drag(page, from, to, modifier) {
  if (modifier) await page.keyboard.down(modifier);
  await page.mouse.move(...from);
  await page.mouse.down();
  await page.mouse.move(...to, { steps: 4 });
  await page.mouse.up();
  if (modifier) await page.keyboard.up(modifier);
}

async function likeRender(name) {
  const page = await openPage(browser, small);
  await page.goto(`${root}/viewer/index.html?frames=0&panel=0&export=${root}/work/${name}`);
  await ready(page);
  await change(page, plain);
  const first = await compare(page, `${name}: the sphere is that of btf render`, name);
  const noise = meanDifference(await reference(page, name), await reference(page, name, '--seed', '2'));
  console.log(`   ${name}: two pictures of btf render differ by ${noise.toFixed(2)} of 255`);
  const view = await page.evaluate(() => [...globalThis.viewer.state.camera]);
  await drag(page, [40, 64], [75, 50]);
  const [azimuth, elevation] = await page.evaluate(() => globalThis.viewer.state.camera);
  check(`${name}: dragging turns the camera`, azimuth < view[0] && elevation < view[1], `${azimuth.toFixed(1)}, ${elevation.toFixed(1)}`);
  const camera = ['--camera', `${azimuth},${elevation}`];
  const second = await compare(page, `${name}: from there, too`, name, ...camera);
  check(`${name}: the picture has changed`, meanDifference(first, second) > 2 * MOST_DIFFERENCE);
  await drag(page, [50, 50], [80, 70], 'Shift');
  const light = await page.evaluate(() => globalThis.viewer.state.lights[0]);
  const lit = [...camera, '--light', `${light.azimuth},${light.elevation}`];
  const third = await compare(page, `${name}: under a rolled light`, name, ...lit);
  check(`${name}: the light has moved`, meanDifference(second, third) > 2 * MOST_DIFFERENCE, `${light.azimuth.toFixed(1)}, ${light.elevation.toFixed(1)}`);
  await change(page, { distance: 9, repeat: 12 });
  const far = [...lit, '--distance', '9', '--repeat', '12'], levels = await compare(page, `${name}: small, with levels of detail`, name, ...far);
  await page.keyboard.press('l');
  check(`${name}: L switches levels of detail off`, !(await page.evaluate(() => globalThis.viewer.state.levels)));
  const finest = await picture(page), rough = (p) => roughness(p);
  check(`${name}: the finest level alone is rougher`, rough(finest) > rough(levels), `${rough(finest).toFixed(2)} and ${rough(levels).toFixed(2)}`);
  check(`${name}: no errors`, page.faults.length === 0, page.faults.slice(0, 3).join(' | '));
  await page.context().close();
}

// Mean step between neighbours in a row.
function roughness(rgb) {
  let sum = 0;
  for (let i = 3; i < rgb.length; i++) sum += Math.abs(rgb[i] - rgb[i - 3]);
  return sum / rgb.length;
}

// f * cos at the chosen point by `btf eval` is the colour that the inspector shows.
async function inspector(page, name) {
  await change(page, { levels: false, exposure: -1 });
  const { uv, view, light, hex } = await page.evaluate(() => globalThis.viewer.inspect(0.45, 0.4));
  const answer = execFileSync(btf, ['eval', join(work, `${name}.btfz`)], { input: `${[...uv, ...light, ...view].join(' ')}\n` }).toString().trim().split(/\s+/).map(Number).slice(-3);
  const code = (f) => { const x = Math.min(Math.max(f * Math.PI * light[2] * 0.5, 0), 1); return 255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055); };
  const seen = [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16)), worst = Math.max(...answer.map((f, c) => Math.abs(code(f) - seen[c])));
  // a pixel of the disc is 1/92 wide, a tenth of the distance between lights: part of their contrast
  check('the inspector shows what btf eval says', worst < 8, `${hex}, off by ${worst.toFixed(1)} of 255`);
  await change(page, { levels: true, exposure: 0 });
}

async function features(name) {
  const page = await openPage(browser, small);
  await page.goto(`${root}/viewer/index.html?frames=0&panel=0&export=${root}/work/${name}`);
  await ready(page);
  await change(page, plain);
  await inspector(page, name);
  const alone = await picture(page);
  await page.evaluate(([url]) => globalThis.viewer.open(url, 1), [`${root}/work/${name}`]);
  await change(page, { compare: 'difference' });
  const none = await picture(page);
  await page.evaluate(([url]) => globalThis.viewer.open(url, 1), [`${root}/work/coarse`]);
  await change(page, { compare: 'difference' });
  const some = await picture(page), centre = (rgb) => rgb[3 * (SIDE * SIDE / 2 + SIDE / 2)] + rgb[3 * (SIDE * SIDE / 2 + SIDE / 2) + 1];
  const sum = (rgb) => rgb.reduce((a, b) => a + b, 0);
  check('a difference with itself is black', centre(none) === 0);
  check('a difference with a coarser model is not', sum(some) > sum(none), `${sum(some)} over ${sum(none)}`);
  await change(page, { compare: 'split', line: 0.5 });
  const split = await picture(page), half = (rgb, right) => rgb.filter((_, i) => (Math.floor(i / 3) % SIDE >= SIDE / 2 + 2) === right && Math.abs((Math.floor(i / 3) % SIDE) - SIDE / 2) > 2);
  check('left of the line is the first', meanDifference(half(split, false), half(alone, false)) < 0.1);
  check('right of it is not', meanDifference(half(split, true), half(alone, true)) > 0.1);
  await page.evaluate(() => globalThis.viewer.open(location.origin, 1).catch((error) => { globalThis.said = error.message; }));
  check('a folder without a manifest is refused in words', /manifest\.json: 404/.test(await page.evaluate(() => globalThis.said)));
  page.faults.length = 0; // the browser's own line about the 404
  await page.evaluate(() => {
    const obj = 'v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n', transfer = new DataTransfer();
    transfer.items.add(new File([obj], 'square.obj'));
    dispatchEvent(new DragEvent('drop', { dataTransfer: transfer, clientX: 3 }));
  });
  await page.waitForFunction(() => globalThis.viewer.state.surface === 'obj');
  check('an OBJ file can be dropped', await page.evaluate(() => globalThis.viewer.renderer.shape.count === 6));
  await page.evaluate(async () => {
    const head = new TextEncoder().encode('#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n'), bytes = new Uint8Array(head.length + 128).fill(129);
    bytes.set(head);
    await globalThis.viewer.take([new File([bytes], 'grey.hdr')], 0);
  });
  check('a .hdr map can be dropped', (await page.evaluate(() => globalThis.viewer.state.environment)) === 'file');
  await page.evaluate(() => globalThis.viewer.setSurface('sphere'));
  await change(page, { lights: [] });
  const lit = await picture(page);
  check('an environment lights the sphere', centre(lit) > 20);
  check('no errors', page.faults.length === 0, page.faults.slice(0, 3).join(' | '));
  await page.context().close();
}

async function selfContained(name) {
  const page = await openPage(browser, small), asked = [];
  page.on('request', (request) => { if (!/^(file|data|blob):/.test(request.url())) asked.push(request.url()); });
  await page.goto(`file://${join(work, name, 'index.html')}?panel=0&frames=0`);
  await ready(page);
  await change(page, plain);
  await compare(page, `${name}: the page of export --viewer, from file://`, name);
  check(`${name}: it asks for nothing`, asked.length === 0 && page.faults.length === 0, [...asked, ...page.faults].join(' | '));
  await page.context().close();
}

// Frames as people see them: the loop runs, keys work, a phone gets the sheet.
async function phone(name) {
  const page = await openPage(browser, { viewport: { width: 180, height: 320 }, hasTouch: true, isMobile: true });
  await page.goto(`${root}/viewer/index.html?export=${root}/work/${name}`);
  await ready(page);
  await page.waitForFunction(() => document.querySelector('canvas.view.ready'));
  const box = await page.evaluate(() => { const b = document.querySelector('.stage').getBoundingClientRect(); return [b.width, b.height, document.documentElement.scrollWidth]; });
  check('a phone: the picture has the width and most of the height', box[0] === 180 && box[1] > 240 && box[2] <= 180, box.join(', '));
  await page.keyboard.press('?');
  check('? shows the keys', await page.evaluate(() => !document.querySelector('.help').hidden));
  check('a phone: no errors', page.faults.length === 0, page.faults.slice(0, 3).join(' | '));
  await page.context().close();
}

async function screenshot(name) {
  const page = await openPage(browser, { viewport: { width: 1120, height: 780 } });
  await page.goto(`${root}/viewer/index.html?frames=0&export=${root}/work/${name}`);
  await ready(page);
  await page.evaluate(async () => {
    const { viewer } = globalThis;
    viewer.state.lights.push({ azimuth: -20, elevation: 25, strength: 0.5, colour: [0.62, 0.8, 1] });
    viewer.change({ inspect: true });
    await viewer.picture(5);
    viewer.inspect(0.42, 0.4);
  });
  await page.screenshot({ path: option === '--pictures' ? join(source, 'docs/pictures/viewer.png') : join(work, 'viewer.png'), animations: 'disabled' });
  check('a picture of the whole page', page.faults.length === 0, page.faults.slice(0, 3).join(' | '));
}

check('some codec exports', codecs.length > 0, codecs.join(' '));
for (const name of option === '--pictures' ? [] : codecs) {
  roundTrip(join(work, name), name);
  run('export', join(work, `${name}.btfz`), '-o', join(work, `${name}-zstd`), '--zstd', '3', '--viewer', '--quiet');
  roundTrip(join(work, `${name}-zstd`), `${name} --zstd`);
  await attempt(`${name}: three.js`, () => inThree(browser, root, join(work, name), name));
  await attempt(`${name}: the viewer`, () => likeRender(name));
  await attempt(`${name}: the page`, () => selfContained(name));
}
if (codecs.length > 0) {
  const first = codecs.includes('fmf') ? 'fmf' : codecs[0];
  if (option !== '--pictures') {
    writeFileSync(join(work, `${first}-zstd.btfz`), readFileSync(join(work, `${first}.btfz`)));
    await attempt('zstd', () => selfContained(`${first}-zstd`));
    await attempt('features', () => features(first));
    await attempt('phone', () => phone(first));
  }
  await attempt('screenshot', () => screenshot(first));
}
await browser.close();
server.close();
console.log(`${counts.passed} passed, ${counts.failed} failed`);
process.exitCode = counts.failed > 0 ? 1 : 0;
