// SPDX-License-Identifier: MIT
// What the tests of the viewer share: the command, its exports, a browser, and pictures of both to compare.
import { execFileSync } from 'node:child_process';
import { readFileSync } from 'node:fs';
import { join, resolve } from 'node:path';
import { check, drawnDifference, launch, openPage, pixels, serve } from './harness.mjs';

const [btf, work, ...options] = process.argv.slice(2);
export { btf, work };
export const quick = options.includes('--quick'), onlyPictures = options.includes('--pictures');
export const source = resolve(import.meta.dirname, '../..');
// As many samples of a pixel in both pictures: a sample's footprint, and with it the level of detail, is its share of the pixel.
export const SIDE = quick ? 96 : 128, SAMPLES = 16;
// The contract's bound, on what is drawn. Part of it is noise: samples of a pixel at other places than those of `btf render`.
// How much is printed: the difference of two of its pictures with other seeds.
export const MOST_DIFFERENCE = 2;
const GROUND = 118; // the byte of the linear 0.18 behind the surface, in both pictures
export const small = { viewport: { width: SIDE, height: SIDE } };
export const plain = { tone: 'clip', background: [0.18, 0.18, 0.18] };
export const { server, root } = await serve({ viewer: join(source, 'viewer'), tests: join(source, 'tests/viewer'),
  modules: join(source, 'viewer/node_modules'), models: work });
export const browser = await launch();
export const TENT = 'v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nv 0 0 0.6\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt 0.5 0.5\n' +
  'f 1/1 2/2 5/5\nf 2/2 3/3 5/5\nf 3/3 4/4 5/5\nf 4/4 1/1 5/5\n';
export const coded = (value) => { const x = Math.min(Math.max(value, 0), 1); return 255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055); };

export const run = (...args) => execFileSync(btf, args, { stdio: ['ignore', 'pipe', 'inherit'] }).toString();
export const exported = (name) => `${root}/models/${name}`;
export const ready = (page) => page.waitForFunction(() => globalThis.viewer && globalThis.viewer.ready);
export const change = (page, values) => page.evaluate((v) => globalThis.viewer.change(v), values);
export const said = (page) => page.evaluate(() => [...document.querySelectorAll('.message.shown')].map((m) => m.firstChild.textContent).join('|'));
export const picture = async (page, samples = SAMPLES) => pixels(page, await page.evaluate((n) => globalThis.viewer.picture(n), samples));

// A page of the viewer with an export; frames are drawn on demand unless `query` says otherwise.
export async function openViewer(name, options = small, query = 'frames=0&panel=0') {
  const page = await openPage(browser, options);
  await page.goto(`${root}/viewer/index.html?${query}${name ? `&export=${exported(name)}` : ''}`);
  await ready(page);
  return page;
}
export async function close(page, title) {
  check(`${title}: no errors`, page.faults.length === 0, page.faults.slice(0, 3).join(' | '));
  await page.context().close();
}

let rendered = 0;
export async function reference(page, name, ...args) {
  const path = join(work, `reference${rendered++}.png`);
  run('render', join(work, `${name}.btfz`), '-o', path, '--size', `${SIDE}x${SIDE}`, '--spp', `${SAMPLES}`, '--quiet', ...args);
  return pixels(page, readFileSync(path));
}
const inWords = ({ mean, percentile, pixels: count }) => `mean absolute difference ${mean.toFixed(2)} of 255 over ${count} pixels, 99th percentile ${percentile}`;
export function alike(title, mine, theirs, ground = GROUND) {
  const difference = drawnDifference(mine, theirs, ground);
  check(title, difference.mean < MOST_DIFFERENCE, inWords(difference));
}
// What is left of a difference where only the places of samples are others.
export async function noise(page, title, name, ...args) {
  const difference = drawnDifference(await reference(page, name, ...args), await reference(page, name, ...args, '--seed', '2'), GROUND);
  console.log(`   ${title}, two pictures of btf render: ${inWords(difference)}`);
}
export async function compare(page, title, name, ...args) {
  const samples = args.includes('--spp') ? Number(args[args.indexOf('--spp') + 1]) : SAMPLES, mine = await picture(page, samples);
  alike(title, mine, await reference(page, name, ...args));
  return mine;
}
// Files or folders of this machine, dropped as the browser's user does.
export async function dropPaths(page, paths, x = 5, y = 5) {
  const session = await page.context().newCDPSession(page);
  const data = { items: [], files: paths, dragOperationsMask: 1 };
  for (const type of ['dragEnter', 'dragOver', 'drop']) await session.send('Input.dispatchDragEvent', { type, x, y, data });
}
export async function drag(page, from, to, modifier) {
  if (modifier) await page.keyboard.down(modifier);
  await page.mouse.move(...from);
  await page.mouse.down();
  await page.mouse.move(...to, { steps: 4 });
  await page.mouse.up();
  if (modifier) await page.keyboard.up(modifier);
}
