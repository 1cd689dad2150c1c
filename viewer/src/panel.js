// SPDX-License-Identifier: MIT
// The page: elements, and the panel that edits the state.

export function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(properties)) {
    if (key.startsWith('aria') || key === 'role') element.setAttribute(key.replace(/([A-Z])/, '-$1').toLowerCase(), value);
    else element[key] = value;
  }
  element.append(...children);
  return element;
}

const press = (button, on) => button.setAttribute('aria-pressed', on ? 'true' : 'false');

// Buttons of which one is chosen: [[value, label], ...]
function segments(options, get, set) {
  const buttons = options.map(([value, label]) => [value, make('button', { textContent: label, onclick: () => set(value) })]);
  const element = make('div', { className: 'segments' }, ...buttons.map(([, button]) => button));
  return { element, update: () => buttons.forEach(([value, button]) => press(button, value === get())) };
}

function slider(label, low, high, step, get, set, write) {
  const input = make('input', { type: 'range', min: low, max: high, step, ariaLabel: label }), output = make('output');
  input.oninput = () => set(Number(input.value));
  const element = make('label', { className: 'row' }, make('span', { textContent: label }), input, output);
  return { element, update: () => { input.value = get(); output.textContent = write(get()); } };
}

function toggle(label, get, set, title = '') {
  const element = make('button', { textContent: label, title, onclick: () => set(!get()) });
  return { element, update: () => press(element, get()) };
}

const toHex = (colour) => `#${colour.map((v) => Math.round(255 * Math.min(v, 1) ** (1 / 2.2)).toString(16).padStart(2, '0')).join('')}`;
const fromHex = (text) => [1, 3, 5].map((at) => (parseInt(text.slice(at, at + 2), 16) / 255) ** 2.2);
const mebibytes = (bytes) => (bytes < 1 << 20 ? `${(bytes / 1024).toFixed(1)} KiB` : `${(bytes / (1 << 20)).toFixed(2)} MiB`);
const BLOCK_NAMES = { 143: 'BC6H', 144: 'BC6H', 145: 'BC7', 146: 'BC7' }; // by VkFormat
const blocksOf = ({ textures }) => [...new Set(textures.map((texture) => BLOCK_NAMES[texture.vk_format]).filter(Boolean))];
// A material's name, and how it was exported.
const headingOf = ({ manifest: m, bytes }) => [m.name || m.codec, [m.codec, m.layout, ...(blocksOf(m).length ? ['bc'] : []), mebibytes(bytes)].join(' · ')];
const signed = (x) => `${x > 0 ? '+' : ''}${x.toFixed(1)}`;

const KEYS = [
  ['drag', 'turn the camera'], ['wheel, pinch', 'nearer, farther'], ['shift + drag', 'roll the light'], ['two fingers', 'roll the light'],
  ['1 2 3', 'sphere, plane, cloth'], ['E', 'next environment'], ['[ ]', 'rotate the environment'], ['+ −', 'exposure'],
  ['T', 'tone curve'], ['L', 'level of detail'], ['N', 'next light'], ['A', 'add a light'],
  ['S', 'side by side'], ['D', 'difference'], ['space', 'swap the two'], ['I', 'inspect colours'],
  ['arrows', 'turn the camera'], ['shift + arrows', 'move the light'], ['P', 'save a picture'], ['R', 'start view again'],
  ['H', 'hide the panel'], ['?', 'this help'],
];

export const NARROW = '(max-width: 760px)'; // as in style.css

export function buildPage(state, actions) {
  const { change } = actions, set = (key) => (value) => change({ [key]: value }), get = (key) => () => state[key];
  let pictureSection = null;
  const parts = [], add = (part) => { parts.push(part); return part.element; };
  const light = () => state.lights[state.light];
  const setLight = (key) => (value) => { if (light()) { light()[key] = value; change({}); } };
  const section = (title, ...children) => make('section', {}, make('h2', { textContent: title }), ...children);
  const page = {
    view: make('canvas', { className: 'view', tabIndex: 0, ariaLabel: 'The material: drag to turn it, press ? for help' }),
    bar: make('div', { className: 'bar' }), message: make('div', { className: 'message', role: 'alert' }),
    divider: make('div', { className: 'divider', ariaLabel: 'Line between the two exports' }),
    titles: [make('div', { className: 'title' }), make('div', { className: 'title right' })],
    ball: make('canvas', { ariaLabel: 'Drag to roll the light' }),
    discs: [make('canvas', { width: 192, height: 192 }), make('canvas', { width: 192, height: 192 })],
    readout: make('p', { className: 'readout' }), statistics: make('table'), frames: make('p', { className: 'note' }),
  };

  const chips = make('div', { className: 'chips' }), colour = make('input', { type: 'color', ariaLabel: 'Colour of the light' });
  colour.oninput = () => setLight('colour')(fromHex(colour.value));
  const remove = make('button', { textContent: 'Remove', onclick: actions.removeLight });
  parts.push({ update: () => {
    const buttons = state.lights.map((_, i) => {
      const button = make('button', { textContent: i + 1, ariaLabel: `Light ${i + 1}`, onclick: () => change({ light: i }) });
      press(button, i === state.light);
      return button;
    });
    if (state.lights.length < actions.mostLights) buttons.push(make('button', { textContent: '+', title: 'Add a light', onclick: actions.addLight }));
    if (chips.childElementCount !== buttons.length || [...chips.children].some((b, i) => b.ariaPressed !== buttons[i].ariaPressed)) chips.replaceChildren(...buttons);
    colour.disabled = remove.disabled = !light();
    if (light()) colour.value = toHex(light().colour);
  } });

  const environment = make('select', { ariaLabel: 'Environment', onchange: () => actions.environment(environment.value) });
  parts.push({ update: () => {
    const names = [['none', 'No environment'], ['studio', 'Studio'], ['sky', 'Sky'], ...(state.file ? [['file', state.file]] : []), ['open', 'Open .hdr …']];
    if (environment.dataset.names !== String(names)) {
      environment.replaceChildren(...names.map(([value, textContent]) => make('option', { value, textContent })));
      environment.dataset.names = String(names);
    }
    environment.value = state.environment;
  } });

  const compare = section('Compare', add(segments([['first', 'First'], ['second', 'Second'], ['split', 'Split'], ['difference', 'Differ.']], get('compare'), set('compare'))),
    add(slider('Difference', 1, 32, 1, get('differenceGain'), set('differenceGain'), (x) => `× ${x}`)),
    make('div', { className: 'toggles' }, make('button', { textContent: 'Swap', onclick: actions.swap }), make('button', { textContent: 'Close second', onclick: actions.closeSecond })));
  const second = make('section', {}, make('div', { className: 'toggles' },
    make('button', { textContent: 'Open another …', onclick: () => actions.open(0) }), make('button', { textContent: 'Compare with …', onclick: () => actions.open(1) })));
  const inspected = make('div', { className: 'inspected' }, make('div', { className: 'discs' },
    make('figure', {}, page.discs[0], make('figcaption', { textContent: 'by light, view fixed' })),
    make('figure', {}, page.discs[1], make('figcaption', { textContent: 'by view, light fixed' }))), page.readout);
  parts.push({ update: () => {
    compare.hidden = !actions.hasSecond();
    inspected.hidden = !state.inspect;
    // on a phone, and where the panel is hidden, over the picture
    const over = matchMedia(NARROW).matches || document.body.classList.contains('wide'), home = over ? page.stage : pictureSection;
    if (inspected.parentElement !== home) home.append(inspected);
  } });

  page.panel = make('div', { className: 'panel', role: 'region', ariaLabel: 'Settings' },
    make('button', { className: 'sheet', ariaLabel: 'Show or hide the settings', onclick: actions.togglePanel }),
    section('Surface', add(segments([['sphere', 'Sphere'], ['plane', 'Plane'], ['cloth', 'Cloth'], ['obj', 'OBJ …']], get('surface'), actions.surface)),
      add(slider('Tiles', 0.5, 16, 0.5, get('repeat'), set('repeat'), (x) => String(x)))),
    section('Lights', make('div', { className: 'light' }, page.ball, make('div', { className: 'side' }, chips, make('div', { className: 'toggles' }, colour, remove))),
      add(slider('Strength', 0, 4, 0.05, () => (light() ? light().strength : 0), setLight('strength'), (x) => x.toFixed(2)))),
    section('Environment', make('div', { className: 'toggles' }, environment, add(toggle('Backdrop', get('backdrop'), set('backdrop'), 'Show the environment behind the surface'))),
      add(slider('Rotation', -180, 180, 1, get('rotation'), set('rotation'), (x) => `${Math.round(x)}°`))),
    (pictureSection = section('Picture', add(segments([['clip', 'Linear'], ['filmic', 'Filmic']], get('tone'), set('tone'))),
      add(slider('Exposure', -6, 6, 0.1, get('exposure'), set('exposure'), signed)),
      make('div', { className: 'toggles' }, add(toggle('Level of detail', get('levels'), set('levels'), 'Coarser levels where texels are smaller than pixels')),
        add(toggle('Inspect', get('inspect'), set('inspect'), 'The reflectance under the cursor by light and by view'))))),
    compare, section('Export', page.statistics, page.frames), second);

  page.help = make('div', { className: 'help', hidden: true, role: 'dialog', ariaLabel: 'Help' },
    make('div', {}, make('h2', { textContent: 'Keys and gestures' }), make('dl', {}, ...KEYS.flatMap(([key, what]) => [
      make('dt', {}, make('kbd', { textContent: key })), make('dd', { textContent: what })])),
    make('p', { className: 'note', textContent: 'Drop an export folder, a .hdr map or an .obj mesh anywhere.' })));
  page.help.onclick = () => { page.help.hidden = true; };

  const url = make('input', { type: 'text', placeholder: 'URL of an export folder', ariaLabel: 'URL of an export folder' });
  url.onkeydown = (event) => { if (event.key === 'Enter' && url.value) actions.openUrl(url.value, 0); };
  page.welcome = make('div', { className: 'welcome', hidden: true }, make('h1', { textContent: 'Drop an export folder here' }),
    make('p', { textContent: 'A folder that btf export MODEL.btfz -o DIR has written: manifest.json, btf.glsl and .ktx2 files.' }),
    make('button', { textContent: 'Open folder …', onclick: () => actions.open(0) }), url);
  page.drop = make('div', { className: 'drop', hidden: true }, make('div'), make('div'));
  page.stage = make('div', { className: 'stage' }, page.view, ...page.titles, page.divider, page.bar, page.welcome, page.drop, page.message,
    make('div', { className: 'corner' }, make('button', { className: 'desk', textContent: 'Panel', title: 'H', onclick: actions.togglePanel }), make('button', { textContent: '?', ariaLabel: 'Help', onclick: () => { page.help.hidden = false; } })));
  document.body.append(page.stage, page.panel, page.help);

  page.update = () => parts.forEach((part) => part.update());

  page.describe = (sources) => {
    const present = sources.filter(Boolean), alike = present.length > 1 && new Set(present.map((source) => headingOf(source).join())).size === 1;
    sources.forEach((source, i) => {
      const title = page.titles[i];
      title.replaceChildren();
      if (!source) return;
      const [name, how] = headingOf(source);
      title.append(make('h1', { textContent: name }), make('p', { textContent: alike && source.folder ? `${how} · ${source.folder}` : how }));
    });
    const row = (label, write) => make('tr', {}, make('td', { textContent: label }), ...present.map((s) => make('td', { textContent: write(s) })));
    page.statistics.replaceChildren(
      row('Codec', ({ manifest: m }) => m.codec), row('Layout', ({ manifest: m }) => m.layout),
      row('Texels', ({ manifest: m }) => `${m.width} × ${m.height}`), row('Levels', ({ manifest: m }) => m.levels),
      row('Textures', ({ manifest: m }) => m.textures.length), row('Size', ({ bytes }) => mebibytes(bytes)),
      row('Blocks', ({ manifest: m }) => (blocksOf(m).length ? `${blocksOf(m).join(', ')} · ${m.cost.psnr_db.toFixed(1)} dB` : 'none')),
      row('Fetches', ({ manifest: m }) => Math.round(m.cost.fetches).toLocaleString('en')),
      row('Bytes read', ({ manifest: m }) => Math.round(m.cost.bytes).toLocaleString('en')),
      row('Operations', ({ manifest: m }) => Math.round(m.cost.flops).toLocaleString('en')),
      row('Rounding', ({ manifest: m }) => (m.cost.rounding > 0 ? m.cost.rounding.toPrecision(2) : 'none')));
  };

  // Stays until the next thing is opened, or is closed.
  page.say = (text) => {
    page.message.replaceChildren(text, make('button', { textContent: '×', ariaLabel: 'Close the message', onclick: () => page.say('') }));
    page.message.classList.toggle('shown', Boolean(text));
  };
  page.stop = (text) => {
    document.body.classList.add('bare');
    page.welcome.hidden = false;
    page.welcome.replaceChildren(make('h1', { textContent: text }), make('p', { role: 'alert',
      textContent: 'Materials are drawn with it: a current Firefox, Chrome, Edge or Safari with graphics acceleration switched on has it.' }));
  };
  page.progress = (share) => {
    page.bar.classList.toggle('busy', share < 1);
    page.bar.style.width = `${100 * share}%`;
  };
  return page;
}
