// SPDX-License-Identifier: MIT
// An export folder from a URL, from dropped files, or from the page itself: all are a function that reads a file.
import { readKtx2 } from './ktx2.js';

const utf8 = new TextDecoder();

function checked(manifest) {
  if (!manifest || manifest.format !== 'btf-gpu') throw new Error('manifest.json is not that of a GPU export (btf export)');
  if (manifest.version !== 1)
    throw new Error(`the export has version ${manifest.version}; this viewer reads version 1: take the viewer of the libbtf that wrote it`);
  if (!Array.isArray(manifest.textures) || !Array.isArray(manifest.uniforms)) throw new Error('manifest.json lists no textures or no uniforms');
  return manifest;
}

// A texture as its file has it must be the one that the shader was written for.
function agreed(entry, texture) {
  const inWords = (format, { width, height, depth, layers }, levels) =>
    `format ${format}, ${width} × ${height} × ${depth} texels, ${layers} layers, ${levels} levels`;
  const held = inWords(texture.format, texture, texture.levels.length), stated = inWords(entry.vk_format, entry, entry.levels);
  if (held !== stated) throw new Error(`${entry.file} is not the texture of manifest.json: it holds ${held} instead of ${stated}`);
  return { entry, ...texture };
}

// read(name) gives a promise of a Uint8Array; progress is told 0..1.
export async function readExport(read, progress = () => {}) {
  const text = utf8.decode(await read('manifest.json'));
  let parsed = null;
  try { parsed = JSON.parse(text); } catch { throw new Error('manifest.json is not JSON'); }
  const manifest = checked(parsed);
  const glsl = utf8.decode(await read(manifest.shader || 'btf.glsl'));
  let done = 0;
  const textures = await Promise.all(manifest.textures.map(async (entry) => {
    const texture = readKtx2(await read(entry.file), entry.file);
    progress(++done / manifest.textures.length);
    return agreed(entry, texture);
  }));
  const bytes = textures.reduce((sum, t) => sum + t.levels.reduce((s, level) => s + level.length, 0), 0);
  return { manifest, glsl, textures, bytes, folder: read.folder };
}

const missing = (name) => (name === 'manifest.json' ? 'no export: manifest.json is missing' : `the export is not complete: ${name} is missing`);

const inFolder = (path, read) => Object.assign(read, { folder: path.split('/').filter(Boolean).at(-1) });

// The URL of the folder, or of a file in it; a query goes with every file.
export function fromUrl(url) {
  let folder = null;
  try { folder = new URL(url, location.href); } catch { /* said below */ }
  if (!folder || !folder.pathname.startsWith('/')) throw new Error(`"${url}" is not the URL of an export folder`);
  folder.pathname = folder.pathname.replace(/\/[^/]+\.(json|html|glsl|ktx2)$|\/?$/, '/');
  return inFolder(folder.pathname, async (name) => {
    const file = new URL(name, folder);
    file.search = folder.search;
    const answer = await fetch(file).catch((error) => ({ statusText: error.message }));
    if (answer.ok) return new Uint8Array(await answer.arrayBuffer());
    if (folder.protocol === 'file:')
      throw new Error(`a page may not read files on disk by their address, even if it was opened from there: drop the folder here, or choose it with “Open …” or “Compare with …” (${folder.href})`);
    throw new Error(`${missing(name)} in ${folder.href} (${[answer.status, answer.statusText].filter(Boolean).join(' ')})`);
  });
}

const dropped = new WeakMap(); // folders of dropped files, which do not tell them
const folderOf = (file) => dropped.get(file) ?? (file.webkitRelativePath || '').replace(/[^/]*$/, '');

// The exports among files: each folder with a manifest.json is one.
export function fromFiles(files) {
  const folders = new Map();
  for (const file of files) {
    const folder = folderOf(file), byName = folders.get(folder) || new Map();
    if (byName.has(file.name)) throw new Error(`${file.name} is there twice; drop the folders instead of their files`);
    folders.set(folder, byName.set(file.name, file));
  }
  return [...folders.values()].filter((byName) => byName.has('manifest.json')).map(fromFolder);
}

function fromFolder(byName) {
  return inFolder(folderOf(byName.get('manifest.json')), async (name) => {
    const file = byName.get(name);
    if (!file) throw new Error(`${missing(name)} among the files`);
    return new Uint8Array(await file.arrayBuffer());
  });
}

// The export that `btf export --viewer` wrote into this page, or null.
export function fromPage() {
  const find = (name) => document.querySelector(`script[data-file="${CSS.escape(name)}"]`);
  if (!find('manifest.json')) return null;
  return async (name) => {
    const element = find(name);
    if (!element) throw new Error(`${missing(name)} in the page`);
    const text = atob(element.textContent.trim()), bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    element.remove();
    return bytes;
  };
}

// Of a dropped file or folder; `root` keeps folders apart that have one name.
function filesOfEntry(entry, root) {
  if (entry.isFile) return new Promise((resolve, reject) => entry.file((file) => {
    dropped.set(file, root + entry.fullPath.replace(/[^/]*$/, ''));
    resolve([file]);
  }, reject));
  const reader = entry.createReader(), found = [];
  return new Promise((resolve, reject) => {
    // a reader hands out a part at a time and nothing at the end
    const more = () => reader.readEntries((entries) => {
      if (!entries.length) resolve(Promise.all(found.map((inner) => filesOfEntry(inner, root))).then((lists) => lists.flat()));
      else { found.push(...entries); more(); }
    }, reject);
    more();
  });
}

export async function droppedFiles(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry && item.webkitGetAsEntry()).filter(Boolean);
  if (!entries.length) return [...transfer.files];
  return (await Promise.all(entries.map((entry, i) => filesOfEntry(entry, entry.isFile ? '' : `${i}`)))).flat();
}
