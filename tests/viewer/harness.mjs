// SPDX-License-Identifier: MIT
// A server of static files, a browser, counted checks, and pictures as arrays.
import { createServer } from 'node:http';
import { readFileSync, existsSync, statSync } from 'node:fs';
import { extname, join, normalize } from 'node:path';
import { chromium } from '../../viewer/node_modules/playwright-core/index.mjs';

const TYPES = { '.html': 'text/html', '.js': 'text/javascript', '.css': 'text/css', '.json': 'application/json', '.png': 'image/png' };

// folders: { prefix: path }
export function serve(folders) {
  const server = createServer((request, response) => {
    const path = normalize(decodeURIComponent(new URL(request.url, 'http://x').pathname));
    const prefix = Object.keys(folders).find((name) => path.startsWith(`/${name}/`));
    const file = prefix && join(folders[prefix], path.slice(prefix.length + 1));
    if (!file || !existsSync(file) || !statSync(file).isFile()) { response.writeHead(404).end(); return; }
    response.writeHead(200, { 'content-type': TYPES[extname(file)] || 'application/octet-stream' }).end(readFileSync(file));
  });
  return new Promise((resolve) => { server.listen(0, '127.0.0.1', () => resolve({ server, root: `http://127.0.0.1:${server.address().port}` })); });
}

export const launch = (...more) => chromium.launch({ executablePath: process.env.CHROMIUM || '/usr/bin/chromium', headless: true,
  args: ['--no-sandbox', '--disable-quic', '--no-first-run', '--disable-background-networking', '--disable-component-update',
    '--disable-sync', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', ...more] });

export const counts = { passed: 0, failed: 0 };
export function check(name, ok, detail = '') {
  counts[ok ? 'passed' : 'failed']++;
  console.log(`${ok ? 'ok' : 'FAILED'} ${name}${detail !== '' ? ` (${detail})` : ''}`);
}
export async function attempt(name, body) {
  try { await body(); } catch (error) { check(name, false, String(error.message).split('\n').slice(0, 3).join(' ')); }
}

// Errors of the console and of the page, collected; a page is judged by them at its end.
export async function openPage(browser, options) {
  const page = await (await browser.newContext(options)).newPage();
  page.faults = [];
  page.on('console', (message) => { if (message.type() === 'error' || /WebGL.*(error|INVALID)/i.test(message.text())) page.faults.push(message.text()); });
  page.on('pageerror', (error) => page.faults.push(error.message));
  page.setDefaultTimeout(240000);
  return page;
}

// RGB bytes of a PNG (a Buffer or data URL), decoded by the browser.
export async function pixels(page, png) {
  const url = typeof png === 'string' ? png : `data:image/png;base64,${png.toString('base64')}`;
  const text = await page.evaluate(async (source) => {
    const image = new Image();
    image.src = source;
    await image.decode();
    const canvas = new OffscreenCanvas(image.width, image.height), pen = canvas.getContext('2d');
    pen.drawImage(image, 0, 0);
    const { data } = pen.getImageData(0, 0, image.width, image.height);
    let out = '';
    for (let i = 0; i < data.length; i += 4) out += String.fromCharCode(data[i], data[i + 1], data[i + 2]);
    return btoa(out);
  }, url);
  return Buffer.from(text, 'base64');
}

export function meanDifference(a, b) {
  if (a.length !== b.length) return Infinity;
  let sum = 0;
  for (let i = 0; i < a.length; i++) sum += Math.abs(a[i] - b[i]);
  return sum / a.length;
}

// Mean and 99th percentile of |a - b| over the components of pixels that are not background, `ground` give or take the 1 of
// the viewer's dither, in both pictures.
export function drawnDifference(a, b, ground) {
  if (a.length !== b.length) return { mean: Infinity, percentile: Infinity };
  const differences = [], isGround = (rgb, i) => [0, 1, 2].every((c) => Math.abs(rgb[i + c] - ground) <= 1);
  for (let i = 0; i < a.length; i += 3)
    if (!isGround(a, i) || !isGround(b, i)) for (let c = i; c < i + 3; c++) differences.push(Math.abs(a[c] - b[c]));
  differences.sort((x, y) => x - y);
  return { mean: differences.reduce((sum, x) => sum + x, 0) / differences.length, // NaN, which is within no bound, if nothing is drawn
    percentile: differences[Math.floor(0.99 * differences.length)], pixels: differences.length / 3 };
}
