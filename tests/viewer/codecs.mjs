// SPDX-License-Identifier: MIT
// What every codec's export must show: the sphere of `btf render`, from the server and from a page of its own.
import { join } from 'node:path';
import { check, meanDifference, openPage } from './harness.mjs';
import { alike, browser, change, close, compare, drag, exported, MOST_DIFFERENCE, noise, openViewer, picture, plain, quick, ready, reference, root, SIDE, small, work } from './bench.mjs';

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
  const far = [...lit, '--distance', '9', '--repeat', '12', '--spp', '64']; // small pixels hold much, which is noise in few samples
  await compare(page, `${name}: small, with levels of detail`, name, ...far);
  await noise(page, `${name}, small`, name, ...far);
  await page.keyboard.press('l');
  check(`${name}: L switches levels of detail off`, !(await page.evaluate(() => globalThis.viewer.state.levels)));
  const finest = roughness(await picture(page, 1));
  await page.keyboard.press('l');
  const coarser = roughness(await picture(page, 1));
  check(`${name}: the finest level alone is rougher`, finest > coarser, `${finest.toFixed(2)} and ${coarser.toFixed(2)}`);
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

// An export in blocks, beside the one that is not. Where the browser has no blocks, one message names the extension that it lacks.
// Where it has them, what blocks lose is what the manifest says, and nothing else is lost: the export that is not in blocks draws
// the same picture from the texels of the blocks.
export async function inBlocks(name) {
  const page = await openViewer('');
  await page.evaluate(() => {
    const { gl } = globalThis.viewer.renderer, get = gl.getExtension.bind(gl);
    gl.getExtension = (extension) => (/bptc/.test(extension) ? null : get(extension));
  });
  await page.fill('.welcome input', exported(`${name}-bc`));
  await page.press('.welcome input', 'Enter');
  await page.waitForFunction(() => document.querySelector('.message.shown'));
  const said = await page.evaluate(() => [...document.querySelectorAll('.message.shown')].map((m) => m.firstChild.textContent));
  check(`${name}: a message where the browser has no blocks`, said.length === 1 && /^\w+\.ktx2: .*EXT_texture_compression_bptc/.test(said[0]), said.join(' | '));
  const taken = await page.evaluate(() => { const { gl } = globalThis.viewer.renderer; delete gl.getExtension; return gl.getExtension('EXT_texture_compression_bptc') !== null; });
  console.log(`   EXT_texture_compression_bptc is ${taken ? '' : 'not '}here`);
  if (taken) {
    await page.evaluate((url) => globalThis.viewer.open(url), exported(`${name}-bc`));
    await change(page, plain);
    const blocks = await picture(page);
    const lost = await page.evaluate(async ([tests, ...folders]) => (await import(`${tests}/blocks.js`)).drawDecoded(globalThis.viewer, ...folders),
      [`${root}/tests`, exported(`${name}-bc`), exported(name)]);
    check(`${name}: has textures in blocks`, lost.length > 0);
    // the manifest has two decimals
    for (const { file, stated, measured } of lost)
      check(`${name}: ${file} loses what is stated`, Math.abs(stated - measured) < 0.01, `${stated} and ${measured.toFixed(3)} dB`);
    alike(`${name}: blocks are drawn as their texels are`, blocks, await picture(page));
    console.log(`   ${name} in blocks: mean absolute difference ${meanDifference(blocks, await reference(page, name)).toFixed(2)} of 255 from btf render`);
  }
  await close(page, name);
}
