// SPDX-License-Identifier: MIT
// How exports, maps and meshes come in: what cannot be shown is refused in clear words, and what is newer stays.
import { cpSync, existsSync, readdirSync, readFileSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { check } from './harness.mjs';
import { change, close, coded, dropPaths, exported, openViewer, picture, plain, root, said, small, TENT, work } from './bench.mjs';

const manifestOf = (name) => JSON.parse(readFileSync(join(work, name, 'manifest.json'), 'utf8'));
// '' where the export opens, or why it does not.
const refusal = (page, name) => page.evaluate((url) => globalThis.viewer.open(url).then(() => '', (error) => error.message), exported(name));
const shown = (page) => page.evaluate(() => globalThis.viewer.renderer.slots.map((slot) => slot && slot.manifest.cost.texture_bytes));
const sizeOf = (name) => manifestOf(name).cost.texture_bytes;

export async function addresses(name) {
  const page = await openViewer(''), asked = [];
  page.on('request', (request) => asked.push(request.url()));
  for (const [ending, query] of [['', ''], ['/', ''], ['/manifest.json', ''], ['/index.html', ''], ['?key=a/b', '?key=a/b'], ['/btf.glsl?x=1#y', '?x=1']]) {
    const codec = await page.evaluate(async ([module, url]) => {
      const bytes = await (await import(module)).fromUrl(url)('manifest.json');
      return JSON.parse(new TextDecoder().decode(bytes)).codec;
    }, [`${root}/viewer/src/exports.js`, exported(name) + ending]);
    check(`an export is found by FOLDER${ending}`, codec === manifestOf(name).codec && asked.at(-1) === `${exported(name)}/manifest.json${query}`, asked.at(-1));
  }
  for (const bad of ['http://:', 'localhost:8000/wool']) {
    await page.fill('.welcome input', bad);
    await page.press('.welcome input', 'Enter');
    await page.waitForFunction((url) => document.querySelector('.message.shown')?.textContent.includes(url), bad);
    check(`a message for ${bad}`, (await said(page)) === `"${bad}" is not the URL of an export folder`, await said(page));
  }
  await close(page, 'addresses');
  const other = await openViewer(name, small, 'frames=0&env=nonsense');
  const environment = await other.evaluate(() => [globalThis.viewer.state.environment, document.querySelector('select').value, globalThis.viewer.renderer.map]);
  check('a message for an unknown environment, and none is there', /no environment "nonsense".*studio/.test(await said(other)) && environment.join() === 'none,none,', `${await said(other)} ${environment}`);
  check('the export is there nevertheless', (await shown(other))[0] === sizeOf(name));
  await close(other, 'an unknown environment');
}

// The largest texture of all exports by what a browser limits, one texel too large for a browser that is made to say so.
export async function limits() {
  const textures = readdirSync(work).filter((name) => existsSync(join(work, `${name}.btfz`)) && existsSync(join(work, name, 'manifest.json')))
    .flatMap((folder) => manifestOf(folder).textures.map((texture) => ({ folder, ...texture })));
  const page = await openViewer('');
  for (const [dimensions, sizes, limit, option] of [
    [['2d', '2d_array'], ['width', 'height'], 'MAX_TEXTURE_SIZE', '--max-size'],
    [['3d'], ['width', 'height', 'depth'], 'MAX_3D_TEXTURE_SIZE', '--max-3d'],
    [['2d_array'], ['layers'], 'MAX_ARRAY_TEXTURE_LAYERS', '--max-layers']]) {
    const size = (texture) => Math.max(...sizes.map((key) => texture[key]));
    // the first of equals: sorting is stable
    const [largest] = textures.filter(({ dimension }) => dimensions.includes(dimension)).sort((a, b) => size(b) - size(a));
    await page.evaluate(([name, most]) => {
      const { gl } = globalThis.viewer.renderer, get = gl.getParameter.bind(gl);
      gl.getParameter = (parameter) => (parameter === gl[name] ? most : get(parameter));
    }, [limit, size(largest) - 1]);
    const message = await refusal(page, largest.folder);
    check(`beyond ${limit}: texture, sizes and option are named`, message.startsWith(`${largest.file}: ${size(largest)} `) &&
      message.includes(`takes ${size(largest) - 1};`) && message.endsWith(`${option} ${size(largest) - 1}`), message);
    check('and the page waits for nothing', await page.evaluate(() => !document.querySelector('.bar.busy')));
    await page.evaluate(() => { delete globalThis.viewer.renderer.gl.getParameter; });
  }
  await close(page, 'limits');
}

// Textures that are not those of the manifest.
export async function mismatch(name) {
  const { textures } = manifestOf(name), [one, other] = [textures[0], textures.find(({ width }) => width !== textures[0].width)];
  cpSync(join(work, name), join(work, 'mixed'), { recursive: true });
  cpSync(join(work, name, other.file), join(work, 'mixed', one.file));
  const page = await openViewer(''), message = await refusal(page, 'mixed');
  check('a message for a texture of another size', message.startsWith(`${one.file} is not the texture of manifest.json: it holds`) &&
    message.includes(`${other.width} ×`) && message.includes(`instead of format ${one.vk_format}, ${one.width} × ${one.height}`), message);
  for (const key of ['vk_format', 'width', 'height', 'depth', 'layers', 'levels']) {
    const said = await page.evaluate(async ([module, url, changed]) => {
      const { fromUrl, readExport } = await import(module), read = fromUrl(url);
      return readExport(async (file) => {
        const bytes = await read(file);
        if (file !== 'manifest.json') return bytes;
        const manifest = JSON.parse(new TextDecoder().decode(bytes));
        manifest.textures.at(-1)[changed]++;
        return new TextEncoder().encode(JSON.stringify(manifest));
      }).then(() => '', (error) => error.message);
    }, [`${root}/viewer/src/exports.js`, exported(name), key]);
    check(`a texture of another ${key} is refused`, said.startsWith(`${textures.at(-1).file} is not the texture`), said);
  }
  await close(page, 'mismatch');
}

export async function folders(name) {
  const page = await openViewer('');
  for (const [first, second] of [[name, 'coarse'], ['coarse', name]]) {
    await dropPaths(page, [join(work, first), join(work, second)]);
    await page.waitForFunction(([one, two]) => globalThis.viewer.renderer.slots.map((slot) => slot?.manifest.cost.texture_bytes).join() === `${one},${two}`,
      [sizeOf(first), sizeOf(second)], { timeout: 60000 });
    check(`two folders that are dropped are first and second: ${first}, ${second}`, (await said(page)) === '');
  }
  const before = await shown(page);
  await dropPaths(page, [name, 'coarse', 'lafortune'].map((folder) => join(work, folder)));
  await page.waitForFunction(() => document.querySelector('.message.shown'), null, { timeout: 60000 });
  check('three are refused', /^3 exports at once/.test(await said(page)) && (await shown(page)).join() === before.join(), await said(page));
  await close(page, 'folders');
}

// The newer of two loads stays, wherever the older one is held up, and nothing of the older is kept.
export async function overlapping(name) {
  const page = await openViewer('coarse');
  await page.evaluate(() => {
    const { gl } = globalThis.viewer.renderer;
    globalThis.living = 0;
    for (const kind of ['Program', 'Texture', 'Buffer'])
      for (const [verb, step] of [['create', 1], ['delete', -1]]) {
        const call = gl[verb + kind].bind(gl);
        gl[verb + kind] = (...args) => { globalThis.living += step; return call(...args); };
      }
  });
  const overtaken = async (what, older, begun, release) => {
    await page.evaluate((url) => { globalThis.older = globalThis.viewer.open(url).then(() => 'silent', (error) => error.message); }, older);
    await begun();
    await page.evaluate((url) => globalThis.viewer.open(url), exported('coarse'));
    await release();
    const [outcome, living] = await page.evaluate(async () => [await globalThis.older, globalThis.living]);
    const [bytes] = await shown(page), title = await page.evaluate(() => document.querySelector('.title p').textContent);
    check(`${what}: the newer export stays, and nothing of the older`, outcome === 'silent' && bytes === sizeOf('coarse') && living === 0,
      `${outcome}, ${title}, ${living} objects more than before`);
  };
  for (const [what, folder] of [['an older, slower export', name], ['an older, slower failure', 'gone']]) {
    let arrive = null, release = null;
    const arrived = new Promise((resolve) => { arrive = resolve; }), held = new Promise((resolve) => { release = resolve; });
    await page.route(`**/${folder}/manifest.json`, async (route) => { arrive(); await held; await route.continue(); });
    await overtaken(what, exported(folder), () => arrived, release);
    await page.unroute(`**/${folder}/manifest.json`);
  }
  await page.evaluate(() => {
    const { renderer } = globalThis.viewer, make = renderer.makeMaterial, held = new Promise((resolve) => { globalThis.release = resolve; });
    renderer.makeMaterial = async (source) => {
      renderer.makeMaterial = make;
      const made = await renderer.makeMaterial(source);
      globalThis.begun = true;
      await held;
      return made;
    };
  });
  await overtaken('an older export that compiles longer', exported(name), () => page.waitForFunction(() => globalThis.begun), () => page.evaluate(() => globalThis.release()));
  page.faults = page.faults.filter((fault) => !/404/.test(fault)); // the browser's own line
  await close(page, 'overlapping');
}

// A map that is wider than the browser's textures, and what an error of WebGL before it does to an export.
export async function maps(name) {
  const page = await openViewer('coarse', small, 'frames=0&panel=0'), most = await page.evaluate(() => {
    const { gl } = globalThis.viewer.renderer;
    return gl.getParameter(gl.MAX_TEXTURE_SIZE);
  });
  const wide = Buffer.concat([Buffer.from(`#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X ${most + 100}\n`),
    Buffer.alloc(8 * (most + 100), Uint8Array.of(100, 100, 100, 128))]);
  writeFileSync(join(work, 'wide.hdr'), wide);
  await dropPaths(page, [join(work, 'wide.hdr')]);
  await page.waitForFunction(() => globalThis.viewer.state.environment === 'file');
  await change(page, { ...plain, lights: [] });
  const [corner] = await picture(page, 4), expected = coded(100.5 / 256); // an exponent of 128 is a factor of 1; 0 to 1 are 256 steps
  check('a map wider than a texture is the backdrop', Math.abs(corner - expected) <= 1, `${corner}, ${expected.toFixed(1)} expected`);
  const means = await page.evaluate(async (module) => {
    const { environmentTexels, readHdr } = await import(module), head = new TextEncoder().encode('#?RADIANCE\n\n-Y 1 +X 8\n');
    const bytes = new Uint8Array(head.length + 32);
    bytes.set(head);
    for (let x = 0; x < 8; x++) bytes.set([16 * x, 16 * x, 16 * x, 136], head.length + 4 * x); // 136: the mantissa is the value
    const { width, height, texels } = environmentTexels(readHdr(bytes, 'ramp.hdr'), 4);
    return [width, height, ...texels.filter((_, i) => i % 4 === 1)];
  }, `${root}/viewer/src/environment.js`);
  check('it is made smaller by means', means.join() === '4,1,8.5,40.5,72.5,104.5', means.join());
  await page.evaluate(() => globalThis.viewer.renderer.gl.enable(1));
  const message = await refusal(page, name);
  check('an error of WebGL before does not refuse an export', message === '', message);
  page.faults = page.faults.filter((fault) => !/enable/.test(fault));
  await close(page, 'maps');
}

// Meshes that say the same in other words, and another mesh in place of one.
export async function meshes() {
  const page = await openViewer('coarse', { viewport: { width: 800, height: 420 } }, 'frames=0');
  const lines = TENT.trim().split('\n'), faces = lines.filter((line) => line.startsWith('f')), others = lines.filter((line) => !line.startsWith('f'));
  const words = { 'faces before their vertices': [...faces, ...others].join('\n'),
    'continued lines': TENT.replaceAll(' 5/5', ' \\\n5/5'), 'continued lines of Windows': `# C:\\\r\n${TENT.replaceAll('\n', '\r\n').replaceAll(' 5/5', '\\\r\n 5/5')}`,
    'negative indices': TENT.replaceAll('1/1', '-5/-5').replaceAll('5/5\n', '-1/-1\n') };
  const bad = { 0: 'f 0 1 2', '-6': 'f -6 1 2', 6: 'f 1 2 6', '1/6': 'f 1/6 2 3', x: 'f x 1 2' };
  const [same, refused] = await page.evaluate(async ([module, tent, ...texts]) => {
    const { readObj } = await import(module), read = (text) => { try { return JSON.stringify(readObj(text, 'a.obj')); } catch (error) { return error.message; } };
    const expected = read(tent), [others, wrong] = texts.map((list) => Object.entries(list).map(([what, text]) => [what, read(text)]));
    return [others.map(([what, mesh]) => [what, mesh === expected ? '' : mesh.slice(0, 80)]), wrong];
  }, [`${root}/viewer/src/shapes.js`, TENT, words, Object.fromEntries(Object.entries(bad).map(([what, face]) => [what, TENT + face]))]);
  for (const [what, difference] of same) check(`an OBJ file with ${what} is the same mesh`, difference === '', difference);
  for (const [what, message] of refused) check(`an OBJ file with the index ${what} is refused`, /^a\.obj: a face with the index \S+ out of range$/.test(message), message);
  for (const [i, text] of [TENT, `${TENT}f 1 2 3\n`].entries()) {
    const chooser = page.waitForEvent('filechooser', { timeout: 20000 });
    await page.click('text=OBJ …');
    await (await chooser).setFiles({ name: `${i}.obj`, mimeType: 'text/plain', buffer: Buffer.from(text) });
    await page.waitForFunction((corners) => globalThis.viewer.state.surface === 'obj' && globalThis.viewer.renderer.shape.count === corners, 12 + 3 * i);
  }
  await page.click('text=Plane');
  await page.click('text=OBJ …');
  check('OBJ takes the mesh that is there, and asks for another where it is shown', await page.evaluate(() => globalThis.viewer.renderer.shape.count) === 15);
  await close(page, 'meshes');
}
