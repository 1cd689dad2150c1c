// SPDX-License-Identifier: MIT
import { clamp, directionOf, turned } from './math.js';
import { droppedFiles, fromFiles, fromPage, fromUrl, readExport } from './exports.js';
import { builtInEnvironment, readHdr } from './environment.js';
import { cloth, plane, readObj, sphere } from './shapes.js';
import { aim, LightBall, rolled, watchPointers, zoomed } from './controls.js';
import { buildPage, NARROW } from './panel.js';
import { inspect, inspectNothing } from './inspector.js';
import { Renderer } from './renderer.js';

const SHAPES = { sphere, plane, cloth };
const VIEWS = { sphere: [-90, 20, 3.6], plane: [-90, 50, 3.6], cloth: [-90, 32, 3], obj: [-90, 20, 3.6] };
const MOST_OWN_LIGHTS = 4, MOST_PIXELS = 2.4e6;
const WARM = [1, 0.86, 0.7], COOL = [0.62, 0.8, 1];

function startState() {
  return { surface: 'sphere', camera: [-90, 20], distance: 3.6, repeat: 3,
    lights: [{ azimuth: -130, elevation: 50, strength: 1, colour: [1, 1, 1] }], light: 0,
    environment: 'none', file: '', rotation: 0, backdrop: true, exposure: 0, tone: 'filmic', levels: true, inspect: false,
    compare: 'split', line: 0.5, differenceGain: 8, background: null };
}

async function run() {
  document.querySelector('.welcome')?.remove(); // what index.html says where modules do not run
  const state = startState(), sources = [null, null], shapes = {};
  const loads = [0, 0]; // begun for each slot; the latest counts, whichever ends first
  let renderer = null, moving = 0, last = 0, asked = false, mapFile = null;
  let pointed = null, inspected = null; // places of the canvas: the newest, and the last one on the surface
  let changed = false; // since it was inspected
  let frozen = new URLSearchParams(location.search).get('frames') === '0';

  const ask = () => { if (!asked) { asked = true; requestAnimationFrame(draw); } };
  const touch = () => { moving = performance.now() + 160; changed = true; renderer.restart(); ask(); };
  const change = (values) => {
    Object.assign(state, values);
    page.update();
    place();
    touch();
  };

  const actions = {
    change, mostLights: MOST_OWN_LIGHTS, hasSecond: () => Boolean(sources[1]),
    togglePanel: () => { document.body.classList.toggle('wide'); resize(); },
    addLight: () => {
      if (state.lights.length >= MOST_OWN_LIGHTS) return;
      const k = state.lights.length;
      state.lights.push({ azimuth: -130 + 95 * k, elevation: 35, strength: 0.6, colour: k % 2 ? COOL : WARM });
      change({ light: k });
    },
    removeLight: () => {
      state.lights.splice(state.light, 1);
      change({ light: Math.max(0, state.light - 1) });
    },
    environment: (name) => (name === 'open' ? chooseFiles('.hdr', false) : setEnvironment(name)).catch(report),
    surface: (name) => (name === 'obj' && (!shapes.obj || state.surface === 'obj') ? chooseFiles('.obj', false) : setSurface(name)),
    open: (slot) => chooseFiles('', true, slot),
    openUrl: (url, slot) => openUrl(url, slot).catch(report),
    swap: () => {
      sources.reverse();
      renderer.slots.reverse();
      showSources();
    },
    closeSecond: () => load(null, 1),
  };
  const page = buildPage(state, actions), canvas = page.view;
  const report = (error) => {
    page.say(error.message);
    page.welcome.hidden = Boolean(sources[0]);
  };
  const camera = () => renderer.camera(state);
  try { renderer = new Renderer(canvas); } catch (error) { page.stop(error.message); return; }
  const ball = new LightBall(page.ball, state, camera, () => change({}));

  // ---- what is shown ----
  function showSources() {
    page.describe(sources);
    page.welcome.hidden = Boolean(sources[0]);
    page.update();
    place();
    touch();
    moving = 0;
  }
  async function load(read, slot) {
    const mine = ++loads[slot], isLatest = () => loads[slot] === mine;
    try {
      let source = null;
      if (read) {
        page.say('');
        page.progress(0.05);
        source = await readExport(read, (share) => { if (isLatest()) page.progress(0.05 + 0.8 * share); });
      }
      if (!isLatest() || !(await renderer.setExport(slot, source, isLatest))) return;
      if (source) source.textures = null; // their bytes are on the GPU now
      sources[slot] = source;
      if (source && slot === 1) state.compare = 'split';
      page.progress(1);
      showSources();
    } catch (error) {
      if (!isLatest()) return;
      page.progress(1);
      throw error;
    }
  }
  const openUrl = async (url, slot) => load(fromUrl(url), slot);
  function setSurface(name) {
    if (!shapes[name]) shapes[name] = SHAPES[name]();
    renderer.setShape(shapes[name]);
    const [azimuth, elevation, distance] = VIEWS[name];
    change({ surface: name, camera: [azimuth, elevation], distance });
  }
  async function setEnvironment(name) {
    const map = name === 'none' ? null : name === 'file' && mapFile ? mapFile : builtInEnvironment(name);
    renderer.setEnvironment(map);
    change({ environment: name });
  }
  async function take(files, slot) {
    const named = (ending) => files.find((file) => file.name.toLowerCase().endsWith(ending));
    const bytes = async (file) => new Uint8Array(await file.arrayBuffer());
    page.say('');
    const exports = fromFiles(files);
    if (exports.length > 2) throw new Error(`${exports.length} exports at once; one can be shown, and two compared`);
    if (exports.length === 2) for (const i of [0, 1]) await load(exports[i], i);
    else if (exports.length === 1) await load(exports[0], slot);
    else if (named('.hdr')) {
      mapFile = readHdr(await bytes(named('.hdr')), named('.hdr').name);
      state.file = mapFile.name;
      await setEnvironment('file');
    } else if (named('.obj')) {
      shapes.obj = readObj(await named('.obj').text(), named('.obj').name);
      setSurface('obj');
    } else throw new Error('an export folder (with its manifest.json), a .hdr map or an .obj mesh is expected');
  }
  async function chooseFiles(accept, folder, slot = 0) {
    const input = document.createElement('input');
    Object.assign(input, { type: 'file', accept, multiple: true, webkitdirectory: folder });
    input.onchange = () => take([...input.files], slot).catch(report);
    input.click();
    page.update();
  }

  // ---- drawing ----
  function place() {
    const split = state.compare === 'split' && Boolean(sources[1]);
    page.divider.classList.toggle('shown', split);
    page.divider.style.left = `${100 * state.line}%`;
    page.titles[0].style.opacity = sources[1] && state.compare === 'second' ? 0 : 1;
    page.titles[1].style.opacity = state.compare === 'first' ? 0 : 1;
    canvas.classList.toggle('inspecting', state.inspect);
  }
  function resize() {
    page.update();
    const box = page.stage.getBoundingClientRect(), most = Math.sqrt(MOST_PIXELS / Math.max(1, box.width * box.height));
    const ratio = Math.min(devicePixelRatio || 1, most);
    const emptied = renderer.resize(Math.max(1, Math.round(box.width * ratio)), Math.max(1, Math.round(box.height * ratio)));
    if (emptied) changed = true;
    // the browser paints next: an empty canvas would flash
    if (emptied && renderer.slots[0] && !frozen) { moving = performance.now() + 160; paint(performance.now()); }
    ask();
  }
  function draw(now) {
    asked = false;
    if (!frozen) paint(now);
  }
  function paint(now) {
    const isMoving = now < moving, more = renderer.frame(state, isMoving, now - last);
    if (isMoving || more) ask();
    last = now;
    ball.draw();
    if (renderer.slots[0] && renderer.shape) canvas.classList.add('ready');
    if (state.inspect && sources[0]) inspectAgain();
    page.frames.textContent = `${Math.min(renderer.sample, renderer.samplesWanted)} of ${renderer.samplesWanted} samples, ${canvas.width} × ${canvas.height}`;
  }

  // Beside the surface the last place on it is kept, so that a way to the panel does not lose it.
  function inspectAgain() {
    if (pointed && inspect(renderer, page, state, ...pointed)) inspected = pointed;
    else if (changed && inspected && !inspect(renderer, page, state, ...inspected)) inspectNothing(page);
    pointed = null;
    changed = false;
  }

  // ---- input ----
  const orbit = (dx, dy) => change({ camera: [(state.camera[0] + dx) % 360, clamp(state.camera[1] + dy, -89.9, 89.9)] });
  const moveLight = (dx, dy) => {
    const light = state.lights[state.light], view = camera();
    if (!light) return;
    const direction = directionOf(light.azimuth, light.elevation);
    aim(light, turned(turned(direction, view.up, dx), view.right, dy));
    change({});
  };
  const cycle = (list, value) => list[(list.indexOf(value) + 1) % list.length];
  function point(x, y) {
    pointed = [x, y];
    if (state.inspect) ask();
  }
  watchPointers(canvas, {
    orbit,
    light: (from, to) => {
      const light = state.lights[state.light];
      if (!light) return;
      aim(light, rolled(ball.direction(light), camera(), from, to));
      change({});
    },
    zoom: (factor) => change({ distance: zoomed(state.distance, factor) }),
    hover: point,
    tap: point,
    grab: (active) => canvas.classList.toggle('dragging', active),
  });
  page.divider.addEventListener('pointerdown', (event) => page.divider.setPointerCapture(event.pointerId));
  page.divider.addEventListener('pointermove', (event) => {
    if (!page.divider.hasPointerCapture(event.pointerId)) return;
    const box = page.stage.getBoundingClientRect();
    state.line = clamp((event.clientX - box.left) / box.width, 0, 1);
    place();
    changed = renderer.dirty = true;
    ask();
  });
  const STEP = 4;
  const keys = {
    1: () => setSurface('sphere'), 2: () => setSurface('plane'), 3: () => setSurface('cloth'),
    e: () => setEnvironment(cycle(['none', 'studio', 'sky', ...(mapFile ? ['file'] : [])], state.environment)),
    '[': () => change({ rotation: state.rotation - 5 }), ']': () => change({ rotation: state.rotation + 5 }),
    '+': () => change({ exposure: Math.min(6, state.exposure + 0.25) }), '-': () => change({ exposure: Math.max(-6, state.exposure - 0.25) }),
    t: () => change({ tone: cycle(['clip', 'filmic'], state.tone) }), l: () => change({ levels: !state.levels }),
    n: () => change({ light: state.lights.length ? (state.light + 1) % state.lights.length : 0 }), a: actions.addLight,
    s: () => sources[1] && change({ compare: state.compare === 'split' ? 'first' : 'split' }),
    d: () => sources[1] && change({ compare: state.compare === 'difference' ? 'split' : 'difference' }),
    ' ': () => sources[1] && actions.swap(), i: () => change({ inspect: !state.inspect }),
    p: save, r: () => { setSurface(state.surface); change({ lights: startState().lights, light: 0, rotation: 0, exposure: 0 }); },
    h: actions.togglePanel, '?': () => { page.help.hidden = !page.help.hidden; }, Escape: () => { page.help.hidden = true; page.say(''); },
  };
  keys['='] = keys['+'];
  const arrows = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName)) return;
    if (event.key === ' ' && event.target.tagName === 'BUTTON') return;
    const arrow = arrows[event.key], key = keys[event.key] || keys[event.key.toLowerCase()];
    if (arrow && event.shiftKey) moveLight(-arrow[0] * 0.07, -arrow[1] * 0.07);
    else if (arrow) orbit(arrow[0] * STEP, arrow[1] * STEP);
    else if (key) key();
    else return;
    event.preventDefault();
  });
  async function save() {
    await renderer.complete(state, renderer.samplesWanted);
    canvas.toBlob((blob) => {
      const link = document.createElement('a');
      link.href = URL.createObjectURL(blob);
      link.download = `${(sources[0] && sources[0].manifest.name) || 'material'}.png`;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    });
  }

  const [left, right] = page.drop.children;
  const dropSlot = (event) => (sources[0] && event.clientX > page.stage.getBoundingClientRect().width / 2 ? 1 : 0);
  addEventListener('dragover', (event) => {
    event.preventDefault();
    page.drop.hidden = false;
    right.style.display = sources[0] ? '' : 'none';
    left.textContent = sources[0] ? 'Drop to replace' : 'Drop to open';
    right.textContent = 'Drop to compare';
    [left, right].forEach((half, i) => half.classList.toggle('over', dropSlot(event) === i));
  });
  addEventListener('dragleave', (event) => { if (!event.relatedTarget) page.drop.hidden = true; });
  addEventListener('drop', (event) => {
    event.preventDefault();
    page.drop.hidden = true;
    const slot = dropSlot(event);
    droppedFiles(event.dataTransfer).then((files) => take(files, slot)).catch(report);
  });
  canvas.addEventListener('webglcontextlost', (event) => { event.preventDefault(); report(new Error('the graphics driver gave up; reload the page')); });

  // ---- start ----
  new ResizeObserver(resize).observe(page.stage);
  resize();
  setSurface('sphere');
  const wanted = new URLSearchParams(location.search), embedded = fromPage();
  if (wanted.get('panel') === '0') document.body.classList.add('bare');
  if (matchMedia(NARROW).matches) document.body.classList.add('wide');
  resize();
  let unknown = null;
  if (wanted.get('env')) await setEnvironment(wanted.get('env')).catch((error) => { unknown = error; });
  page.welcome.hidden = Boolean(embedded || wanted.get('export'));
  // for tests, and for pages that embed this one
  globalThis.viewer = {
    state, renderer, ball, change, setSurface, setEnvironment, take, swap: actions.swap,
    open: (url, slot = 0) => openUrl(url, slot),
    inspect: (x, y) => inspect(renderer, page, state, x, y),
    async picture(samples) {
      const before = frozen;
      frozen = true;
      await renderer.complete(state, samples);
      const url = canvas.toDataURL('image/png');
      canvas.style.transition = 'none'; // a screenshot that follows shows it whole
      canvas.classList.add('ready');
      ball.draw();
      frozen = before;
      return url;
    },
  };
  try {
    if (wanted.get('export')) await openUrl(wanted.get('export'), 0);
    else if (embedded) await load(embedded, 0);
    if (wanted.get('second')) await openUrl(wanted.get('second'), 1);
    if (unknown) throw unknown; // after what clears messages
  } catch (error) { report(error); }
  globalThis.viewer.ready = true;
}

run();
