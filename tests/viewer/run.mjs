// SPDX-License-Identifier: MIT
// The viewer in headless Chromium: node tests/viewer/run.mjs BTF WORK [--quick | --pictures]
// --quick: the default layout of each codec, small pictures of few samples, and messages of errors.
// --pictures: nothing is tested but that docs/pictures/viewer.png can be made anew.
// WORK holds NAME.btfz for every codec that exports and coarse.btfz, another model of the same material.
import { copyFileSync, readdirSync } from 'node:fs';
import { join } from 'node:path';
import { attempt, check, counts } from './harness.mjs';
import { browser, close, exported, onlyPictures, openViewer, quick, root, run, server, source, work } from './bench.mjs';
import { likeRender, selfContained } from './codecs.mjs';
import * as features from './features.mjs';
import { inThree, roundTrip } from './textures.mjs';

const names = readdirSync(work).filter((file) => file.endsWith('.btfz')).map((file) => file.slice(0, -5)).sort();
const codecs = names.filter((name) => name !== 'coarse'), first = codecs.includes('fmf') ? 'fmf' : codecs[0];
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

// The textures of a layout, and with zstd; where it is not the codec's first its sphere, too.
async function layout(codec, name, isFirst) {
  const folder = isFirst ? codec : `${codec}-${name}`, compressed = `${folder}-zstd`;
  if (!isFirst) {
    copyFileSync(join(work, `${codec}.btfz`), join(work, `${folder}.btfz`));
    toExport(codec, folder, '--layout', name);
  }
  toExport(codec, compressed, '--layout', name, '--zstd', '3');
  for (const each of [folder, compressed]) roundTrip(join(work, each), each);
  if (quick) return;
  await attempt(`${folder}: three.js`, () => inThree(browser, root, exported(folder), join(work, folder), folder));
  await attempt(`${folder}: the page`, () => selfContained(isFirst ? folder : compressed, codec));
}

check('some codec exports', codecs.length > 0, codecs.join(' '));
for (const name of names) toExport(name, name);
for (const codec of onlyPictures ? [] : codecs) {
  const started = performance.now(), layouts = run('export', join(work, `${codec}.btfz`), '--list').split('\n').map((line) => line.split(/\s/)[0]).filter(Boolean);
  for (const [i, name] of (quick ? layouts.slice(0, 1) : layouts).entries()) await layout(codec, name, i === 0);
  await attempt(`${codec}: the viewer`, () => likeRender(codec));
  console.log(`   ${codec}: ${((performance.now() - started) / 1000).toFixed(0)} s`);
}
if (onlyPictures) await attempt('screenshot', () => screenshot(first));
else {
  await attempt('zstd', () => selfContained(`${first}-zstd`, first));
  const { errors, desktop, ...longer } = features;
  for (const [title, feature] of Object.entries({ errors, desktop, ...(quick ? {} : longer) })) await attempt(title, () => feature(first));
  if (!quick) await attempt('screenshot', () => screenshot(first));
}
await browser.close();
server.close();
console.log(`${counts.passed} passed, ${counts.failed} failed`);
process.exitCode = counts.failed > 0 ? 1 : 0;
