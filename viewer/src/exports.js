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
    return { entry, ...texture };
  }));
  const bytes = textures.reduce((sum, t) => sum + t.levels.reduce((s, level) => s + level.length, 0), 0);
  return { manifest, glsl, textures, bytes, folder: read.folder };
}

const missing = (name) => (name === 'manifest.json' ? 'no export: manifest.json is missing' : `the export is not complete: ${name} is missing`);

const inFolder = (path, read) => Object.assign(read, { folder: path.split('/').filter(Boolean).at(-1) });

export function fromUrl(url) {
  const folder = new URL(url.endsWith('/') ? url : `${url}/`, location.href);
  return inFolder(folder.pathname, async (name) => {
    const answer = await fetch(new URL(name, folder)).catch((error) => ({ statusText: error.message }));
    if (answer.ok) return new Uint8Array(await answer.arrayBuffer());
    if (folder.protocol === 'file:')
      throw new Error(`a page may not read files on disk by their address, even if it was opened from there: drop the folder here, or choose it with “Open …” or “Compare with …” (${folder.href})`);
    throw new Error(`${missing(name)} in ${folder.href} (${[answer.status, answer.statusText].filter(Boolean).join(' ')})`);
  });
}

const dropped = new WeakMap(); // folders of files that do not tell them
const folderOf = (file) => dropped.get(file) ?? (file.webkitRelativePath || '').replace(/[^/]*$/, '');

export function fromFiles(files) {
  const byName = new Map(files.map((file) => [file.name, file]));
  return inFolder(folderOf(files[0]), async (name) => {
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

function filesOfEntry(entry) {
  if (entry.isFile) return new Promise((resolve, reject) => entry.file((file) => {
    dropped.set(file, entry.fullPath.replace(/[^/]*$/, ''));
    resolve([file]);
  }, reject));
  const reader = entry.createReader(), found = [];
  return new Promise((resolve, reject) => {
    // a reader hands out a part at a time and nothing at the end
    const more = () => reader.readEntries((entries) => {
      if (!entries.length) resolve(Promise.all(found.map(filesOfEntry)).then((lists) => lists.flat()));
      else { found.push(...entries); more(); }
    }, reject);
    more();
  });
}

export async function droppedFiles(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry && item.webkitGetAsEntry()).filter(Boolean);
  if (!entries.length) return [...transfer.files];
  return (await Promise.all(entries.map(filesOfEntry))).flat();
}
