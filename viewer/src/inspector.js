// SPDX-License-Identifier: MIT
// The reflectance of the texel under the cursor as two discs of directions (parabolic: the rim is the horizon).
const RIM = 1.04; // as in the shader of the discs

const place = (direction, side) => [0, 1].map((k) => {
  const at = direction[k] / (1 + Math.max(direction[2], 0)) / RIM;
  return (k === 0 ? 1 + at : 1 - at) * 0.5 * side;
});

export function inspect(renderer, page, state, x, y) {
  const split = state.compare === 'split' && renderer.slots[1] && x > state.line;
  const slot = (state.compare === 'second' || split) && renderer.slots[1] ? 1 : 0;
  const picked = renderer.pick(state, slot, x, y);
  if (!picked) return null;
  const { manifest } = renderer.slots[slot];
  let hex = '';
  page.discs.forEach((canvas, i) => {
    const pen = canvas.getContext('2d'), image = renderer.disc(state, slot, picked, i === 1), side = image.width;
    const [px, py] = place(i === 0 ? picked.light : picked.view, side);
    pen.putImageData(image, 0, 0);
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
  const texel = [Math.floor(picked.uv[0] * manifest.width), Math.floor(picked.uv[1] * manifest.height)];
  const swatch = document.createElement('i');
  swatch.style.background = hex;
  page.readout.replaceChildren(swatch, `${hex} · texel ${texel.join(', ')} · level ${picked.lod.toFixed(1)}`);
  return { ...picked, texel, hex };
}
