// SPDX-License-Identifier: MIT
// The viewer in headless Chromium: node tests/viewer/run.mjs BTF WORK [--quick | --pictures]
// --quick: the default layout of each codec, small pictures, messages of errors, and how things are opened and inspected.
// --pictures: nothing is tested but that docs/pictures/viewer.png can be made anew.
// WORK is an empty folder. In it come to be NAME.btfz for every codec that fits, and coarse.btfz, another model of the same material.
import { copyFileSync } from 'node:fs';
import { join } from 'node:path';
import { attempt, check, counts } from './harness.mjs';
import { browser, close, exported, onlyPictures, openViewer, quick, root, run, server, source, work } from './bench.mjs';
import { inBlocks, likeRender, selfContained } from './codecs.mjs';
import * as features from './features.mjs';
import * as inspecting from './inspecting.mjs';
import * as opening from './opening.mjs';
import { inThree, roundTrip, wholeBlocks } from './textures.mjs';

const material = join(work, 'material.btfd');
const encode = (model, codec, ...options) => run('encode', material, '-o', join(work, `${model}.btfz`), '--codec', codec, '--quiet', ...options);
const toExport = (model, folder, ...options) => run('export', join(work, `${model}.btfz`), '-o', join(work, folder), '--viewer', '--quiet', ...options);

async function screenshot(name) {
  const page = await openViewer(name, { viewport: { width: 1120, height: 780 } }, 'frames=0');
  await page.evaluate(async () => {
    const { viewer } = globalThis;
    viewer.state.lights.push({ azimuth: -20, elevation: 25, strength: 0.5, colour: [0.62, 0.8, 1] });
    viewer.change({ inspect: true });
    await viewer.picture(5);
    viewer.inspect(0.42, 0.4);
  });
  await page.screenshot({ path: onlyPictures ? join(source, 'docs/pictures/viewer.png') : join(work, 'viewer.png'), animations: 'disabled' });
  await close(page, 'a picture of the whole page');
}

// Models that a layout which rounds others keeps as they are.
const kept = { 'lpca-bytes': ['-p', 'storage=q8'] };

// The textures of a layout, and with zstd; where it is not the codec's first its sphere, too.
async function layout(codec, name, isFirst) {
  const folder = isFirst ? codec : `${codec}-${name}`, compressed = `${folder}-zstd`, blocks = `${folder}-bc`;
  if (!isFirst) {
    if (kept[folder]) encode(folder, codec, ...kept[folder]);
    else copyFileSync(join(work, `${codec}.btfz`), join(work, `${folder}.btfz`));
    toExport(folder, folder, '--layout', name);
  }
  toExport(folder, compressed, '--layout', name, '--zstd', '3');
  toExport(folder, blocks, '--layout', name, '--compress', 'bc');
  for (const each of [folder, compressed, blocks]) roundTrip(join(work, each), each);
  wholeBlocks(join(work, blocks), blocks, codec !== 'lafortune');
  if (quick) return;
  await attempt(`${folder}: three.js`, () => inThree(browser, root, exported(folder), join(work, folder), folder));
  await attempt(`${folder}: the page`, () => selfContained(isFirst ? folder : compressed, folder));
}

async function test() {
  run('synth', 'bumps', '-o', material, '--size', '32x32', '--directions', 'grid:8x5', '--quiet');
  const codecs = JSON.parse(run('codecs', '--json')).codecs.filter(({ capabilities }) => capabilities.includes('fit')).map(({ id }) => id);
  check('some codec fits', codecs.length > 0, codecs.join(' '));
  const models = [...codecs.map((codec) => [codec, codec]), ['coarse', 'fmf', '-p', 'components=3']];
  for (const [name, ...how] of models) await attempt(`${name}: encode and export`, () => { encode(name, ...how); toExport(name, name); });
  for (const codec of codecs) {
    const started = performance.now();
    await attempt(`${codec}: its layouts`, async () => {
      const layouts = run('export', join(work, `${codec}.btfz`), '--list').split('\n').map((line) => line.split(/\s/)[0]).filter(Boolean);
      check(`${codec}: has layouts`, layouts.length > 0, layouts.join(' '));
      for (const [i, name] of (quick ? layouts.slice(0, 1) : layouts).entries()) await layout(codec, name, i === 0);
    });
    await attempt(`${codec}: the viewer`, () => likeRender(codec));
    console.log(`   ${codec}: ${((performance.now() - started) / 1000).toFixed(0)} s`);
  }
  await attempt('zstd', () => selfContained('fmf-zstd', 'fmf'));
  if (!quick)
    await attempt('halves: its layout', async () => { // BC6H
      encode('halves', 'cmf', '-p', 'storage=f16', '-p', 'codebook=64');
      toExport('halves', 'halves');
      await layout('halves', 'stacks', true);
    });
  for (const name of quick ? ['fmf'] : [...codecs.filter((codec) => codec !== 'lafortune'), 'halves']) await attempt(`${name}: blocks`, () => inBlocks(name));
  const { errors, desktop, fromDisk, headings, ...longer } = features, { inspector, ...always } = inspecting;
  for (const [title, feature] of Object.entries({ errors, desktop, fromDisk, headings, ...opening, ...always, ...(quick ? {} : { inspector, ...longer }) })) await attempt(title, () => feature('fmf'));
  if (!quick) await attempt('screenshot', () => screenshot('fmf'));
}

async function renewPicture() {
  run('synth', 'rings', '-o', material, '--spp', '4', '--bounces', '2', '--quiet');
  encode('fmf', 'fmf', '-p', 'components=16');
  toExport('fmf', 'fmf');
  await screenshot('fmf');
}

await (onlyPictures ? attempt('screenshot', renewPicture) : attempt('tests', test));
await browser.close();
server.close();
console.log(`${counts.passed} passed, ${counts.failed} failed`);
process.exitCode = counts.failed > 0 ? 1 : 0;
