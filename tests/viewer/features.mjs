// SPDX-License-Identifier: MIT
// What the viewer can do beside the sphere under one light: each with one codec's export.
import { cpSync, mkdirSync, readdirSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { pathToFileURL } from 'node:url';
import { read } from '../../viewer/node_modules/ktx-parse/dist/ktx-parse.esm.js';
import { check, launch, meanDifference, openPage } from './harness.mjs';
import { alike, browser, change, close, coded, compare, drag, dropPaths, exported, openViewer, picture, plain, ready, reference, root, said, SIDE, small, source, TENT, work } from './bench.mjs';

const linear = (byte) => (byte / 255 <= 0.04045 ? byte / 255 / 12.92 : ((byte / 255 + 0.055) / 1.055) ** 2.4);
const brightness = (rgb) => rgb.reduce((sum, byte) => sum + byte, 0) / rgb.length;
const centre = (rgb) => rgb[3 * (SIDE * SIDE / 2 + SIDE / 2)] + rgb[3 * (SIDE * SIDE / 2 + SIDE / 2) + 1];
const half = (rgb, right) => rgb.filter((_, i) => {
  const x = (Math.floor(i / 3) % SIDE) - SIDE / 2;
  return Math.abs(x) > 2 && x > 0 === right;
});
// Means of 8 x 8 pixels, without the noise of each. The lights that stand for a map are the same for all pixels of the viewer.
function blocks(rgb) {
  const across = SIDE / 8, sums = new Float64Array(3 * across * across);
  rgb.forEach((byte, i) => {
    const pixel = Math.floor(i / 3);
    sums[3 * (Math.floor(pixel / SIDE / 8) * across + Math.floor((pixel % SIDE) / 8)) + (i % 3)] += byte / 64;
  });
  return sums;
}
const surface = (page, name) => page.evaluate((kind) => globalThis.viewer.setSurface(kind), name);

export async function surfaces(name) {
  const page = await openViewer(name);
  await change(page, plain);
  await surface(page, 'plane');
  await compare(page, 'the plane is that of btf render', name, '--scene', 'plane');
  await surface(page, 'cloth');
  const cloth = await picture(page, 4), theirs = await reference(page, name, '--scene', 'cloth');
  // other threads, the same fall: it covers what the cloth of btf render covers
  const ground = Math.round(coded(0.18)), covered = (rgb, i) => [0, 1, 2].some((c) => Math.abs(rgb[3 * i + c] - ground) > 2);
  let both = 0, either = 0;
  for (let i = 0; i < SIDE * SIDE; i++) {
    both += covered(cloth, i) && covered(theirs, i);
    either += covered(cloth, i) || covered(theirs, i);
  }
  check('the cloth lies as that of btf render', both / either > 0.9, `${both} of ${either} pixels`);
  writeFileSync(join(work, 'tent.obj'), TENT);
  await dropPaths(page, [join(work, 'tent.obj')]);
  await page.waitForFunction(() => globalThis.viewer.state.surface === 'obj');
  await compare(page, 'an OBJ file that is dropped, as btf render draws it', name, '--scene', join(work, 'tent.obj'), '--camera', '-90,20', '--distance', '3.6');
  await close(page, 'surfaces');
}

export async function lights(name) {
  const page = await openViewer(name);
  await change(page, plain);
  await page.keyboard.press('a');
  const [one, two] = await page.evaluate(() => globalThis.viewer.state.lights);
  await change(page, { lights: [one, { ...two, strength: 1, colour: [1, 1, 1] }] });
  const apart = [];
  for (const light of [one, two]) apart.push(await reference(page, name, '--light', `${light.azimuth},${light.elevation}`));
  // what two lights give together is their sum, but for the background
  const ground = linear(Math.round(coded(0.18)));
  const sum = apart[0].map((byte, i) => {
    const x = (Math.floor(i / 3) % SIDE) + 0.5 - SIDE / 2, y = Math.floor(i / 3 / SIDE) + 0.5 - SIDE / 2;
    const onSphere = Math.hypot(x, y) / SIDE < (0.5 * Math.tan(Math.asin(1 / 3.6))) / Math.tan(Math.PI / 10);
    return Math.round(coded(linear(byte) + linear(apart[1][i]) - (onSphere ? 0 : ground)));
  });
  alike('two lights are the sum of each', await picture(page, 8), sum);
  await surface(page, 'sphere');
  await page.evaluate(() => globalThis.viewer.setEnvironment('studio'));
  await change(page, { lights: [], backdrop: false, tone: 'filmic', exposure: 0.5, rotation: 70, background: [0, 0, 0] });
  const turned = await picture(page, 48), options = ['--env', 'studio', '--background', '0,0,0', '--exposure', '0.5', '--spp', '64'];
  alike('studio, turned, exposed and filmic as btf render has it', blocks(turned), blocks(await reference(page, name, ...options, '--rotate', '70')), 0);
  await page.keyboard.press('[');
  check('[ rotates the environment', (await page.evaluate(() => globalThis.viewer.state.rotation)) === 65);
  await change(page, { rotation: -110 });
  check('its rotation shows', meanDifference(await picture(page, 8), turned) > 4);
  writeFileSync(join(work, 'grey.hdr'), Buffer.concat([Buffer.from('#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n'), Buffer.alloc(128, 129)]));
  await dropPaths(page, [join(work, 'grey.hdr')]);
  await page.waitForFunction(() => globalThis.viewer.state.environment === 'file');
  const grey = blocks(await picture(page, 8)), ofFile = ['--env', join(work, 'grey.hdr'), '--background', '0,0,0', '--exposure', '0.5'];
  alike('a .hdr map that is dropped lights as in btf render', grey, blocks(await reference(page, name, ...ofFile)), 0);
  await close(page, 'lights');
}

export async function comparison(name) {
  const page = await openViewer(name);
  await change(page, plain);
  const alone = await picture(page, 4);
  await page.evaluate((url) => globalThis.viewer.open(url, 1), exported(name));
  await change(page, { compare: 'difference' });
  const none = await picture(page, 4);
  const titles = () => page.evaluate(() => [...document.querySelectorAll('.title p')].map((p) => p.textContent));
  check('both are named', new Set(await titles()).size === 1);
  await dropPaths(page, [join(work, 'coarse')], 0.8 * SIDE, 9); // the right half
  await page.waitForFunction(() => globalThis.viewer.state.compare === 'split');
  const named = await titles();
  await change(page, { compare: 'difference' });
  const some = await picture(page, 4);
  check('a difference with itself is black', centre(none) === 0);
  check('a difference with a coarser model, a folder that is dropped, is not', brightness(some) > brightness(none), `${brightness(some).toFixed(2)} over ${brightness(none).toFixed(2)}`);
  await change(page, { compare: 'second' });
  alike('the second alone is that of btf render', await picture(page, 4), await reference(page, 'coarse'));
  await change(page, { compare: 'split' });
  const split = await picture(page, 4);
  check('left of the line is the first', meanDifference(half(split, false), half(alone, false)) < 0.1);
  check('right of it is not', meanDifference(half(split, true), half(alone, true)) > 0.1);
  await drag(page, [SIDE / 2, SIDE / 2], [SIDE - 1, SIDE / 2]);
  const line = await page.evaluate(() => globalThis.viewer.state.line);
  check('the line is dragged', Math.abs(line - (SIDE - 1) / SIDE) < 0.02, line.toFixed(2));
  check('and what is left of it with it', meanDifference(half(await picture(page, 4), false), half(alone, false)) < 0.1);
  await page.keyboard.press(' ');
  check('space swaps the two', named[0] !== named[1] && (await titles()).join() === named.reverse().join(), named.join());
  await close(page, 'comparison');
}

// One clear message each, and what was shown before stays.
export async function errors(name) {
  cpSync(join(work, name), join(work, 'future'), { recursive: true });
  writeFileSync(join(work, 'future/manifest.json'), readFileSync(join(work, name, 'manifest.json'), 'utf8').replace(/"version":\s*1/, '"version":2'));
  cpSync(join(work, name), join(work, 'incomplete'), { recursive: true });
  const lost = readdirSync(join(work, name)).find((file) => file.endsWith('.ktx2'));
  rmSync(join(work, 'incomplete', lost));
  mkdirSync(join(work, 'none'), { recursive: true });
  writeFileSync(join(work, 'none/readme.txt'), 'nothing');
  const page = await openViewer('');
  const expect = async (title, what, open) => {
    await page.evaluate(() => document.querySelector('.message button')?.click());
    await open();
    await page.waitForFunction(() => document.querySelector('.message.shown'));
    const message = await said(page);
    check(`a message for ${title}`, what.test(message) && !/undefined|TypeError|property/.test(message), message);
  };
  const url = (folder) => async () => {
    await page.fill('.welcome input', exported(folder));
    await page.press('.welcome input', 'Enter');
  };
  await expect('a URL without an export', /no export: manifest\.json is missing in .*none\/ \(404/, url('none'));
  await expect('a future version', /version 2.*reads version 1/, url('future'));
  await expect('a missing texture', new RegExp(`not complete: ${lost} is missing in`), url('incomplete'));
  check('the page still asks for an export', await page.evaluate(() => !document.querySelector('.welcome').hidden));
  await expect('a dropped folder without an export', /export folder \(with its manifest\.json\)/, () => dropPaths(page, [join(work, 'none')]));
  await expect('a dropped folder without a texture', new RegExp(`not complete: ${lost} is missing among`), () => dropPaths(page, [join(work, 'incomplete')]));
  await dropPaths(page, [join(work, name)]);
  await page.waitForFunction(() => document.querySelector('.welcome').hidden);
  check('a folder that is dropped opens, and the message is gone', (await said(page)) === '' && centre(await picture(page, 4)) > 20);
  const before = await picture(page, 4);
  await expect('a future version that is dropped', /version 2/, () => dropPaths(page, [join(work, 'future')]));
  check('after an error the material stays', meanDifference(await picture(page, 4), before) === 0);
  page.faults = page.faults.filter((fault) => !/404/.test(fault)); // the browser's own lines
  await close(page, 'errors');

  const old = await launch('--disable-3d-apis'), without = await openPage(old, small);
  await without.goto(`${root}/viewer/index.html?export=${exported(name)}`);
  await without.waitForSelector('.welcome:not([hidden])');
  const text = await without.evaluate(() => [document.querySelector('.welcome').innerText, getComputedStyle(document.querySelector('.panel')).display]);
  check('a message where WebGL 2 is missing', /WebGL 2/.test(text[0]) && text[1] === 'none', text[0].split('\n')[0]);
  check('no WebGL 2: no errors', without.faults.length === 0, without.faults.join(' | '));
  await old.close();
}

// Pages that are opened from disk, where browsers run no modules and read no files, and what a page with an export in it is asked for.
export async function fromDisk(name) {
  const text = (page) => page.evaluate(() => document.body.innerText.trim());
  const alone = await openPage(browser, small);
  await alone.goto(pathToFileURL(join(source, 'viewer/index.html')).href);
  await alone.waitForFunction(() => document.body.innerText.trim());
  check('the page from disk says that it has to be served', /served over HTTP[^]*python3 -m http\.server[^]*btf export/.test(await text(alone)));
  await alone.context().close();

  const served = await openPage(browser, small);
  let before = null;
  await served.route('**/src/main.js', async (route) => {
    await served.waitForFunction(() => document.readyState !== 'loading');
    before = await text(served);
    await route.continue();
  });
  await served.goto(`${root}/viewer/index.html`);
  await ready(served);
  check('a page that is served does not say so, before its modules run or after', before === '' && !/served/.test(await text(served)), before);
  await close(served, 'a page that is served');

  const page = await openPage(browser, small), own = pathToFileURL(join(work, name, 'index.html')).href;
  await page.goto(`${own}?frames=0&second=../coarse`);
  await ready(page);
  const said = await page.evaluate(() => [document.querySelector('.message.shown')?.firstChild.textContent, globalThis.viewer.renderer.slots.map(Boolean).join()]);
  check('?second= from disk: a message says why not, and what to do', /may not read files on disk.*Compare with.*coarse/.test(said[0]) && !/missing/.test(said[0]) && said[1] === 'true,false', said.join());
  await page.context().close();

  const asked = await openPage(browser, small), size = (folder) => JSON.parse(readFileSync(join(work, folder, 'manifest.json'), 'utf8')).cost.texture_bytes;
  await asked.goto(`${exported(name)}/index.html?frames=0&export=../coarse`);
  await ready(asked);
  const shown = await asked.evaluate(() => globalThis.viewer.renderer.slots[0].manifest.cost.texture_bytes);
  check('?export= wins over the export in the page', shown === size('coarse') && shown !== size(name), `${shown}`);
  await close(asked, 'a page with an export in it');
}

// Two exports of one model are told apart.
export async function headings(name) {
  const page = await openViewer(name, { viewport: { width: 1120, height: 780 } }, 'frames=0');
  const titles = async (second) => {
    await page.evaluate((url) => globalThis.viewer.open(url, 1), exported(second));
    return page.evaluate(() => [...document.querySelectorAll('.title')].map((title) => [...title.children].map((line) => line.textContent).join(': ')));
  };
  const same = await titles(`${name}-zstd`);
  check('two exports that are alike are named by their folders', same[0].endsWith(` · ${name}`) && same[1] === `${same[0]}-zstd`, same.join(' | '));
  if (await page.evaluate(() => globalThis.viewer.renderer.gl.getExtension('EXT_texture_compression_bptc') !== null)) {
    const others = await titles(`${name}-bc`), { psnr_db: loss } = JSON.parse(readFileSync(join(work, `${name}-bc`, 'manifest.json'), 'utf8')).cost;
    check('an export in blocks is named so', / · bc · /.test(others[1]) && !/bc/.test(others[0]) && !others[0].endsWith(name), others.join(' | '));
    const cells = await page.evaluate(() => [...[...document.querySelectorAll('table tr')].find((row) => row.cells[0].textContent === 'Blocks').cells].map((cell) => cell.textContent));
    check('statistics: blocks and what they cost', cells[1] === 'none' && cells[2] === `BC7 · ${loss.toFixed(1)} dB`, cells.join(' | '));
  }
  await page.evaluate(() => { document.querySelector('.panel').scrollTop = 1e4; return globalThis.viewer.picture(2); });
  await page.screenshot({ path: join(work, 'headings.png') });
  await close(page, 'headings');
}

// What the canvas holds whenever it is drawn or emptied, while another export, surface and size replace what is there.
export async function flicker(name) {
  const page = await openViewer(name, small, 'panel=0');
  await page.evaluate(() => {
    const { renderer } = globalThis.viewer, { gl, canvas } = renderer, show = renderer.show.bind(renderer), seen = globalThis.seen = { drawn: [], resized: [] };
    const look = (list) => {
      const rgba = new Uint8Array(4 * 64);
      gl.bindFramebuffer(gl.FRAMEBUFFER, null);
      gl.readPixels(0.36 * canvas.width, 0.6 * canvas.height, 8, 8, gl.RGBA, gl.UNSIGNED_BYTE, rgba);
      list.push(rgba.reduce((sum, byte, i) => sum + (i % 4 === 1 ? byte : 0), 0) / 64);
    };
    renderer.show = (state) => { show(state); look(seen.drawn); };
    let known = false; // a watcher is told the size that it starts with
    new ResizeObserver(() => { if (known) look(seen.resized); known = true; }).observe(document.querySelector('.stage'));
  });
  const settled = () => page.waitForFunction(() => globalThis.viewer.renderer.sample >= 4);
  await page.evaluate((url) => globalThis.viewer.open(url), exported('coarse'));
  await settled();
  await page.evaluate((url) => globalThis.viewer.open(url, 1), exported(name));
  await settled();
  await surface(page, 'plane');
  await settled();
  for (const [i, size] of [SIDE + 22, SIDE - 17].entries()) {
    await page.setViewportSize({ width: size, height: size });
    await page.waitForFunction((before) => globalThis.seen.resized.length > before, i);
  }
  const { drawn, resized } = await page.evaluate(() => globalThis.seen), darkest = Math.min(...drawn, ...resized);
  // an empty canvas is 0, the darkest of the lit surface some 100
  check('nothing flickers while things are replaced', resized.length >= 2 && drawn.length > 8 && darkest > 30,
    `drawn ${drawn.length} times, ${resized.length} sizes, the darkest ${darkest.toFixed(0)} of 255`);
  await close(page, 'flicker');
}

export async function desktop(name) {
  const page = await openViewer(name, { viewport: { width: 800, height: 420 } }, 'frames=0');
  const manifest = JSON.parse(readFileSync(join(work, name, 'manifest.json'), 'utf8'));
  const bytes = manifest.textures.reduce((sum, { file }) => sum + read(readFileSync(join(work, name, file))).levels.reduce((s, l) => s + l.levelData.length, 0), 0);
  const rows = await page.evaluate(() => Object.fromEntries([...document.querySelectorAll('table tr')].map((row) => [row.cells[0].textContent, row.cells[1].textContent])));
  const shown = await page.evaluate(async () => { await globalThis.viewer.picture(1); return getComputedStyle(document.querySelector('canvas.view')).opacity; });
  check('a screenshot that follows a picture shows it whole', shown === '1', shown);
  const number = (text) => Number(text.replace(/[^0-9.]/g, ''));
  const size = number(rows.Size) * (/MiB/.test(rows.Size) ? 1 << 20 : 1024);
  check('statistics: bytes of the textures', Math.abs(size / bytes - 1) < 0.01, `${rows.Size} of ${bytes}`);
  check('statistics: fetches, bytes and operations of an evaluation', number(rows.Fetches) === Math.round(manifest.cost.fetches) &&
    number(rows['Bytes read']) === Math.round(manifest.cost.bytes) && number(rows.Operations) === Math.round(manifest.cost.flops), `${rows.Fetches}, ${rows['Bytes read']}, ${rows.Operations}`);
  // the light's dot stays under the pointer that drags it, as on a trackball
  const box = await page.locator('.light canvas').boundingBox(), radius = 0.44 * box.width, middle = [box.x + box.width / 2, box.y + box.height / 2];
  const dot = () => page.evaluate(() => { const { x, y } = globalThis.viewer.ball.dots()[0]; return [x, y]; });
  const from = await dot(), to = [middle[0] + 0.3 * radius, middle[1] + 0.4 * radius];
  await drag(page, [middle[0] + from[0] * radius, middle[1] - from[1] * radius], to);
  const now = await dot();
  check('the light follows the pointer on its ball', Math.hypot(now[0] - 0.3, now[1] + 0.4) < 0.02, now.map((x) => x.toFixed(2)).join(', '));
  const state = () => page.evaluate(() => JSON.stringify([globalThis.viewer.state, document.body.className, document.querySelector('.help').hidden]));
  const dead = [];
  for (const key of ['2', '1', 'e', 'e', 'e', '[', ']', '+', '-', 't', 'l', 'a', 'n', 'i', 'h', 'h', 'ArrowLeft', 'Shift+ArrowUp', '?', 'Escape', 'r']) {
    const before = await state();
    await page.keyboard.press(key);
    if (before === (await state())) dead.push(key);
  }
  check('every key does something', dead.length === 0, dead.join(' '));
  await close(page, 'desktop');
}

// Frames as people see them: the loop runs, a phone gets the sheet and fingers. Of a light model and from afar, for software GL.
export async function phone() {
  const page = await openViewer('', { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true }, '');
  await change(page, { distance: 8 });
  await page.evaluate((url) => globalThis.viewer.open(url), exported('coarse'));
  await page.waitForFunction(() => document.querySelector('canvas.view.ready'));
  const area = () => page.evaluate(() => { const b = document.querySelector('.stage').getBoundingClientRect(); return [b.width, b.height, document.documentElement.scrollWidth]; });
  const box = await area();
  check('a phone: the picture has the width and most of the height', box[0] === 390 && box[1] > 740 && box[2] <= 390, box.join(', '));
  await page.tap('.sheet');
  const less = await area();
  check('a phone: the settings leave half the height', less[1] > 420 && less[1] < box[1], less.join(', '));
  await page.tap('.sheet');
  await page.keyboard.press('i');
  await page.touchscreen.tap(195, 400);
  await page.waitForFunction(() => /texel/.test(document.querySelector('.readout').textContent));
  const discs = await page.locator('.stage .inspected').boundingBox();
  check('a phone: a tap shows the two hemispheres', discs && discs.x >= 0 && discs.x + discs.width <= 390 && discs.y > 400 && discs.y + discs.height <= 844, JSON.stringify(discs));
  await page.screenshot({ path: join(work, 'phone.png') });
  await page.keyboard.press('?');
  const keys = await page.evaluate(() => [!document.querySelector('.help').hidden, document.querySelectorAll('.help dt').length]);
  check('? shows the keys', keys[0] && keys[1] > 15, String(keys));
  await close(page, 'a phone');
}
