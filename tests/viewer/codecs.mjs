// SPDX-License-Identifier: MIT
// What every codec's export must show: the sphere of `btf render`, from the server and from a page of its own.
import { join } from 'node:path';
import { check, meanDifference, openPage } from './harness.mjs';
import { browser, change, close, compare, drag, exported, MOST_DIFFERENCE, noise, openViewer, picture, plain, quick, ready, SIDE, small, work } from './bench.mjs';

// Mean step between neighbours in a row.
function roughness(rgb) {
  let sum = 0;
  for (let i = 3; i < rgb.length; i++) sum += Math.abs(rgb[i] - rgb[i - 3]);
  return sum / rgb.length;
}

export async function likeRender(name) {
  const page = await openViewer(name);
  await change(page, plain);
  const first = await compare(page, `${name}: the sphere is that of btf render`, name);
  await noise(page, name, name);
  const view = await page.evaluate(() => [...globalThis.viewer.state.camera]);
  await drag(page, [0.3 * SIDE, 0.5 * SIDE], [0.58 * SIDE, 0.4 * SIDE]);
  const [azimuth, elevation] = await page.evaluate(() => globalThis.viewer.state.camera);
  check(`${name}: dragging turns the camera`, azimuth < view[0] && elevation < view[1], `${azimuth.toFixed(1)}, ${elevation.toFixed(1)}`);
  const camera = ['--camera', `${azimuth},${elevation}`];
  let turned = null;
  if (!quick) {
    turned = await compare(page, `${name}: from there, too`, name, ...camera);
    check(`${name}: the picture has changed`, meanDifference(first, turned) > 2 * MOST_DIFFERENCE);
  }
  await drag(page, [0.4 * SIDE, 0.4 * SIDE], [0.62 * SIDE, 0.55 * SIDE], 'Shift');
  const light = await page.evaluate(() => globalThis.viewer.state.lights[0]);
  const lit = [...camera, '--light', `${light.azimuth},${light.elevation}`];
  const third = await compare(page, `${name}: under a rolled light`, name, ...lit);
  check(`${name}: the light has moved`, meanDifference(turned || first, third) > 2 * MOST_DIFFERENCE, `${light.azimuth.toFixed(1)}, ${light.elevation.toFixed(1)}`);
  await change(page, { distance: 9, repeat: 12 });
  const far = [...lit, '--distance', '9', '--repeat', '12'], levels = await compare(page, `${name}: small, with levels of detail`, name, ...far);
  await noise(page, `${name}, small`, name, ...far);
  await page.keyboard.press('l');
  check(`${name}: L switches levels of detail off`, !(await page.evaluate(() => globalThis.viewer.state.levels)));
  const finest = await picture(page);
  check(`${name}: the finest level alone is rougher`, roughness(finest) > roughness(levels), `${roughness(finest).toFixed(2)} and ${roughness(levels).toFixed(2)}`);
  await close(page, name);
}

// The page that `btf export --viewer` writes, opened from disk: nothing else is asked for.
export async function selfContained(name, model) {
  const page = await openPage(browser, small), asked = [], file = `file://${join(work, name, 'index.html')}`;
  page.on('request', (request) => { if (!/^(data|blob):/.test(request.url()) && request.url().split('?')[0] !== file) asked.push(request.url()); });
  await page.goto(`${file}?panel=0&frames=0`);
  await ready(page);
  await change(page, plain);
  await compare(page, `${name}: the page of export --viewer, from file://`, model);
  check(`${name}: it asks for nothing`, asked.length === 0, asked.join(' | '));
  await close(page, name);
}

// An export in blocks: the sphere where the browser takes them, and where it does not one message that names what it lacks.
export async function inBlocks(name, model) {
  const page = await openViewer('');
  await page.evaluate(() => {
    const { gl } = globalThis.viewer.renderer, get = gl.getExtension.bind(gl);
    gl.getExtension = (extension) => (/bptc/.test(extension) ? null : get(extension));
  });
  await page.fill('.welcome input', exported(name));
  await page.press('.welcome input', 'Enter');
  await page.waitForFunction(() => document.querySelector('.message.shown'));
  const said = await page.evaluate(() => [...document.querySelectorAll('.message.shown')].map((m) => m.firstChild.textContent));
  check(`${name}: a message where the browser has no such blocks`, said.length === 1 && /^\w+\.ktx2: .*14[345].*browser/.test(said[0]), said.join(' | '));
  const taken = await page.evaluate(() => { const { gl } = globalThis.viewer.renderer; delete gl.getExtension; return gl.getExtension('EXT_texture_compression_bptc') !== null; });
  console.log(`   EXT_texture_compression_bptc is ${taken ? '' : 'not '}here`);
  if (taken) {
    await page.evaluate((url) => globalThis.viewer.open(url), exported(name));
    await change(page, plain);
    await compare(page, `${name}: the sphere of textures in blocks`, model);
  }
  await close(page, name);
}
