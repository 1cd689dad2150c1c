// SPDX-License-Identifier: MIT
// In the page: what textures in blocks decode to, and the export that is not in blocks drawn from that.
import { fromUrl, readExport } from '/viewer/src/exports.js';

const PRECISION = 'precision highp float; precision highp int; precision highp sampler2D; precision highp sampler2DArray; precision highp sampler3D;';
const KINDS = { '2d': ['TEXTURE_2D', 'sampler2D'], '2d_array': ['TEXTURE_2D_ARRAY', 'sampler2DArray'], '3d': ['TEXTURE_3D', 'sampler3D'] };
const RGBA32F = 109;

function compiled(gl, sampler) {
  const program = gl.createProgram(), place = sampler === 'sampler2D' ? 'at' : 'ivec3(at, slice)';
  const texts = { VERTEX_SHADER: 'void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }',
    FRAGMENT_SHADER: `uniform ${sampler} map; uniform int slice, level; out vec4 texel;
      void main() { ivec2 at = ivec2(gl_FragCoord.xy); texel = texelFetch(map, ${place}, level); }` };
  for (const [type, text] of Object.entries(texts)) {
    const shader = gl.createShader(gl[type]);
    gl.shaderSource(shader, `#version 300 es\n${PRECISION}\n${text}`);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  return program;
}

// RGBA floats of each level, slice after slice, of the upper left width x height of level 0.
function texels(gl, object, { dimension, layers, depth, levels }, width, height) {
  const [target, sampler] = KINDS[dimension], program = compiled(gl, sampler), slices = Math.max(layers, depth), out = [];
  const picture = gl.createTexture(), framebuffer = gl.createFramebuffer();
  gl.activeTexture(gl.TEXTURE0);
  gl.bindTexture(gl.TEXTURE_2D, picture);
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, width, height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, picture, 0);
  gl.bindTexture(gl.TEXTURE_2D, null);
  gl.bindTexture(gl[target], object);
  gl.bindVertexArray(null);
  gl.useProgram(program);
  gl.viewport(0, 0, width, height);
  for (let level = 0; level < levels; level++) {
    const w = Math.max(1, width >> level), h = Math.max(1, height >> level), values = new Float32Array(4 * w * h * slices);
    gl.uniform1i(gl.getUniformLocation(program, 'level'), level);
    for (let slice = 0; slice < slices; slice++) {
      gl.uniform1i(gl.getUniformLocation(program, 'slice'), slice);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
      gl.readPixels(0, 0, w, h, gl.RGBA, gl.FLOAT, values.subarray(4 * w * h * slice, 4 * w * h * (slice + 1)));
    }
    out.push(values);
  }
  gl.deleteFramebuffer(framebuffer);
  gl.deleteTexture(picture);
  gl.deleteProgram(program);
  return out;
}

// By the definition in docs/gpu-export.md.
function decibels(meant, seen, slices) {
  let sum = 0, count = 0;
  for (let k = 0; k < 4 * slices; k++) {
    let peak = 0, error = 0, texelCount = 0;
    meant.forEach((values, level) => {
      const size = values.length / slices, first = Math.floor(k / 4) * size + (k % 4);
      for (let i = first; i < first - (k % 4) + size; i += 4) {
        peak = Math.max(peak, Math.abs(values[i]));
        error += (values[i] - seen[level][i]) ** 2;
        texelCount++;
      }
    });
    if (peak > 0) { sum += error / texelCount / peak ** 2; count++; }
  }
  return -10 * Math.log10(sum / count);
}

// `blocks` is what the viewer has open. Opens the export `folder` with the texels of the blocks; says what each lost.
export async function drawDecoded({ renderer }, blocks, folder) {
  const { gl } = renderer, [packed, source] = await Promise.all([blocks, folder].map((url) => readExport(fromUrl(url)))), lost = [];
  const objectOf = (name) => renderer.slots[0].uploaded.textures.find((texture) => texture.name === name).object;
  const decoded = packed.textures.map(({ entry, format }, i) => {
    if (format < 143) return null;
    const { width, height } = source.textures.find((texture) => texture.entry.name === entry.name), levels = texels(gl, objectOf(entry.name), entry, width, height);
    const range = packed.manifest.uniforms.find(({ name }) => name === `btf_range${i}`), slices = Math.max(entry.layers, entry.depth);
    if (!range) return levels;
    return levels.map((values) => values.map((value, at) => {
      const slice = range.count > 2 ? Math.floor(at / (values.length / slices)) : 0, [low, length] = [0, 4].map((k) => range.value[8 * slice + k + (at % 4)]);
      return low + length * value;
    }));
  });
  await renderer.setExport(0, source);
  for (const [i, { entry }] of packed.textures.entries()) {
    if (!decoded[i]) continue;
    const texture = source.textures.find(({ entry: { name } }) => name === entry.name), { width, height } = texture;
    const meant = texels(gl, objectOf(entry.name), texture.entry, width, height);
    lost.push({ file: entry.file, stated: entry.psnr_db, measured: decibels(meant, decoded[i], Math.max(entry.layers, entry.depth)) });
    Object.assign(texture, { format: RGBA32F, levels: decoded[i].map(({ buffer }) => new Uint8Array(buffer)) });
  }
  await renderer.setExport(0, source);
  return lost;
}
