// SPDX-License-Identifier: MIT
// The reflectance of the texel under the cursor as two discs of directions (parabolic: the rim is the horizon).
const RIM = 1.04; // as in the shader of the discs

// Of a direction above the horizon.
const place = (direction, side) => [0, 1].map((k) => {
  const at = direction[k] / (1 + direction[2]) / RIM;
  return (k === 0 ? 1 + at : 1 - at) * 0.5 * side;
});

// What is known of the texel at a place of the canvas (0..1, y down), shown in the page; null where there is no surface, and then
// nothing is shown anew.
export function inspect(renderer, page, state, x, y) {
  const split = state.compare === 'split' && renderer.slots[1] && x > state.line;
  const slot = (state.compare === 'second' || split) && renderer.slots[1] ? 1 : 0;
  const picked = renderer.pick(state, slot, x, y);
  if (!picked) return null;
  const { manifest } = renderer.slots[slot], below = picked.light[2] <= 0;
  let hex = '#000000';
  page.discs.forEach((canvas, i) => {
    const pen = canvas.getContext('2d'), image = renderer.disc(state, slot, picked, i === 1), side = image.width;
    pen.putImageData(image, 0, 0);
    if (i === 0 && below) return; // no place of the hemisphere
    const [px, py] = place(i === 0 ? picked.light : picked.view, side);
    if (i === 0) {
      const at = 4 * (Math.min(side - 1, Math.floor(py)) * side + Math.min(side - 1, Math.floor(px)));
      hex = `#${[0, 1, 2].map((k) => image.data[at + k].toString(16).padStart(2, '0')).join('')}`;
    }
    for (const [style, width] of [['#000a', 4], ['#e8bd7c', 2]]) {
      pen.strokeStyle = style;
      pen.lineWidth = width;
      pen.beginPath();
      pen.arc(px, py, 6, 0, 2 * Math.PI);
      pen.stroke();
    }
  });
  const texel = [manifest.width, manifest.height].map((size, k) => Math.min(size - 1, Math.floor(picked.uv[k] * size)));
  const swatch = document.createElement('i');
  swatch.style.background = hex;
  page.readout.replaceChildren(swatch, `${hex} · texel ${texel.join(', ')} · level ${picked.lod.toFixed(1)}${below ? ' · the light is below the horizon' : ''}`);
  return { ...picked, texel, hex };
}

export function inspectNothing(page) {
  for (const canvas of page.discs) canvas.getContext('2d').clearRect(0, 0, canvas.width, canvas.height);
  page.readout.replaceChildren('no surface here');
}
