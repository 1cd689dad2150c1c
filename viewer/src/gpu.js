// SPDX-License-Identifier: MIT
// WebGL 2: programs, the textures and the uniform block of an export.

const FORMATS = { // by VkFormat: internal format, format, type
  9: ['R8', 'RED', 'UNSIGNED_BYTE'], 16: ['RG8', 'RG', 'UNSIGNED_BYTE'], 37: ['RGBA8', 'RGBA', 'UNSIGNED_BYTE'],
  38: ['RGBA8_SNORM', 'RGBA', 'BYTE'], 43: ['SRGB8_ALPHA8', 'RGBA', 'UNSIGNED_BYTE'],
  76: ['R16F', 'RED', 'HALF_FLOAT'], 83: ['RG16F', 'RG', 'HALF_FLOAT'], 97: ['RGBA16F', 'RGBA', 'HALF_FLOAT'],
  100: ['R32F', 'RED', 'FLOAT'], 103: ['RG32F', 'RG', 'FLOAT'], 109: ['RGBA32F', 'RGBA', 'FLOAT'],
};
const BLOCKS = { // compressed, by VkFormat: names of BPTC
  143: 'COMPRESSED_RGB_BPTC_UNSIGNED_FLOAT_EXT', 144: 'COMPRESSED_RGB_BPTC_SIGNED_FLOAT_EXT',
  145: 'COMPRESSED_RGBA_BPTC_UNORM_EXT', 146: 'COMPRESSED_SRGB_ALPHA_BPTC_UNORM_EXT',
};
const BPTC = 'EXT_texture_compression_bptc', FLOATS = [100, 103, 109];

function typed(bytes, type) {
  if (type === 'UNSIGNED_BYTE') return bytes;
  if (type === 'BYTE') return new Int8Array(bytes.buffer, bytes.byteOffset, bytes.length);
  const aligned = bytes.byteOffset % 4 === 0 ? bytes : bytes.slice();
  return type === 'FLOAT' ? new Float32Array(aligned.buffer, aligned.byteOffset, bytes.length / 4)
    : new Uint16Array(aligned.buffer, aligned.byteOffset, bytes.length / 2);
}

// With a limit that is exceeded goes the option of btf export that keeps within it.
function checkSizes(gl, { entry, width, height, depth, layers }, isArray, isVolume) {
  const side = isVolume ? ['MAX_3D_TEXTURE_SIZE', '--max-3d'] : ['MAX_TEXTURE_SIZE', '--max-size'];
  const sizes = [[width, 'texels wide', ...side], [height, 'texels high', ...side]];
  if (isVolume) sizes.push([depth, 'texels deep', ...side]);
  if (isArray) sizes.push([layers, 'layers', 'MAX_ARRAY_TEXTURE_LAYERS', '--max-layers']);
  for (const [size, what, limit, option] of sizes) {
    const most = gl.getParameter(gl[limit]);
    if (size > most) throw new Error(`${entry.file}: ${size} ${what}, this browser takes ${most};\nexport with btf export ${option} ${most}`);
  }
}

// Adds the texture to `made` as soon as there is one, for whoever frees it after a failure.
function uploadTexture(gl, texture, made) {
  const { entry, format, width, height, depth, layers, levels } = texture;
  const blocks = BLOCKS[format], bptc = blocks && gl.getExtension(BPTC);
  if (blocks && !bptc) throw new Error(`${entry.file}: texel format ${format} needs ${BPTC}, which this browser lacks; btf export without --compress will do`);
  if (!blocks && !FORMATS[format]) throw new Error(`${entry.file}: texel format ${format} is not one that this viewer reads`);
  const linear = entry.min_filter === 'linear';
  if (linear && FLOATS.includes(format) && !gl.getExtension('OES_texture_float_linear'))
    throw new Error(`${entry.file}: this browser does not filter float textures`);
  const target = { '2d': gl.TEXTURE_2D, '2d_array': gl.TEXTURE_2D_ARRAY, '3d': gl.TEXTURE_3D }[entry.dimension];
  if (!target) throw new Error(`${entry.file}: dimension ${entry.dimension} is not read`);
  checkSizes(gl, texture, target === gl.TEXTURE_2D_ARRAY, target === gl.TEXTURE_3D);
  const object = gl.createTexture(), flat = target === gl.TEXTURE_2D;
  const [internal, pixels, type] = FORMATS[format] || [];
  const storage = bptc ? bptc[blocks] : gl[internal];
  made.push({ name: entry.name, object, target });
  gl.bindTexture(target, object);
  if (flat) gl.texStorage2D(target, levels.length, storage, width, height);
  else gl.texStorage3D(target, levels.length, storage, width, height, target === gl.TEXTURE_3D ? depth : layers);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  levels.forEach((bytes, level) => {
    const w = Math.max(1, width >> level), h = Math.max(1, height >> level);
    const slices = target === gl.TEXTURE_3D ? Math.max(1, depth >> level) : layers;
    if (bptc && flat) gl.compressedTexSubImage2D(target, level, 0, 0, w, h, storage, bytes);
    else if (bptc) gl.compressedTexSubImage3D(target, level, 0, 0, 0, w, h, slices, storage, bytes);
    else if (flat) gl.texSubImage2D(target, level, 0, 0, w, h, gl[pixels], gl[type], typed(bytes, type));
    else gl.texSubImage3D(target, level, 0, 0, 0, w, h, slices, gl[pixels], gl[type], typed(bytes, type));
  });
  const set = (name, value) => gl.texParameteri(target, gl[name], gl[value]);
  const within = linear ? 'LINEAR' : 'NEAREST';
  set('TEXTURE_MIN_FILTER', levels.length > 1 ? `${within}_MIPMAP_${within}` : within);
  set('TEXTURE_MAG_FILTER', entry.mag_filter === 'linear' ? 'LINEAR' : 'NEAREST');
  ['S', 'T', 'R'].forEach((axis, i) => set(`TEXTURE_WRAP_${axis}`, entry.wrap[i] === 'repeat' ? 'REPEAT' : 'CLAMP_TO_EDGE'));
}

// The block's bytes by std140: elements of an array are 16 bytes apart.
function uniformBlock(manifest) {
  const view = new DataView(new ArrayBuffer(Math.max(16, manifest.uniform_block ? manifest.uniform_block.size : 0)));
  for (const { type, offset, count, value } of manifest.uniforms) {
    const components = value.length / count, whole = type[0] === 'i';
    value.forEach((x, i) => {
      const at = offset + Math.floor(i / components) * 16 + (i % components) * 4;
      if (whole) view.setInt32(at, x, true);
      else view.setFloat32(at, x, true);
    });
  }
  return view.buffer;
}

function start(gl, vertex, fragment) {
  const program = gl.createProgram();
  const shaders = [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]].map(([type, text]) => {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
    return shader;
  });
  gl.linkProgram(program);
  return { program, shaders };
}

function finish(gl, { program, shaders }) {
  const linked = gl.getProgramParameter(program, gl.LINK_STATUS);
  const log = linked ? '' : shaders.map((s) => gl.getShaderInfoLog(s)).join('\n') || gl.getProgramInfoLog(program);
  shaders.forEach((shader) => gl.deleteShader(shader));
  if (!linked) {
    gl.deleteProgram(program);
    throw new Error(`the shader does not compile: ${log}`);
  }
  const uniforms = {}, count = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS);
  for (let i = 0; i < count; i++) {
    const { name } = gl.getActiveUniform(program, i);
    uniforms[name.replace('[0]', '')] = gl.getUniformLocation(program, name);
  }
  return { program, uniforms };
}

export const makeProgram = (gl, vertex, fragment) => finish(gl, start(gl, vertex, fragment));

// Compiles beside the page where the browser can, so that the picture before stays alive.
export async function makeProgramAside(gl, vertex, fragment) {
  const parallel = gl.getExtension('KHR_parallel_shader_compile'), started = start(gl, vertex, fragment);
  while (parallel && !gl.getProgramParameter(started.program, parallel.COMPLETION_STATUS_KHR))
    await new Promise((resolve) => { setTimeout(resolve, 15); });
  return finish(gl, started);
}

export function uploadExport(gl, source) {
  const { manifest } = source, most = gl.getParameter(gl.MAX_TEXTURE_IMAGE_UNITS);
  if (manifest.textures.length > most) throw new Error(`the export has ${manifest.textures.length} textures, this browser takes ${most};\nexport with btf export --max-textures ${most}`);
  while (gl.getError() !== gl.NO_ERROR); // of what came before
  const uploaded = { textures: [], block: gl.createBuffer(), blockName: (manifest.uniform_block || {}).name };
  try {
    source.textures.forEach((texture) => uploadTexture(gl, texture, uploaded.textures));
    const code = gl.getError();
    if (code !== gl.NO_ERROR) throw new Error(`the textures could not be uploaded (WebGL error ${code})`);
    gl.bindBuffer(gl.UNIFORM_BUFFER, uploaded.block);
    gl.bufferData(gl.UNIFORM_BUFFER, uniformBlock(manifest), gl.STATIC_DRAW);
  } catch (error) {
    freeExport(gl, uploaded);
    throw error;
  }
  return uploaded;
}

export function bindExport(gl, uploaded, { program, uniforms }) {
  uploaded.textures.forEach(({ name, object, target }, unit) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(target, object);
    if (uniforms[name]) gl.uniform1i(uniforms[name], unit);
  });
  const index = gl.getUniformBlockIndex(program, uploaded.blockName || 'btf_uniforms');
  if (index !== gl.INVALID_INDEX) gl.uniformBlockBinding(program, index, 0);
  gl.bindBufferBase(gl.UNIFORM_BUFFER, 0, uploaded.block);
}

export function freeExport(gl, uploaded) {
  uploaded.textures.forEach(({ object }) => gl.deleteTexture(object));
  gl.deleteBuffer(uploaded.block);
}

export function makeTarget(gl, formats, width, height, withDepth) {
  const framebuffer = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  const textures = formats.map((format, i) => {
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
    const filter = format === gl.RGBA32F ? gl.NEAREST : gl.LINEAR;
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, filter);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + i, gl.TEXTURE_2D, texture, 0);
    return texture;
  });
  let depth = null;
  if (withDepth) {
    depth = gl.createRenderbuffer();
    gl.bindRenderbuffer(gl.RENDERBUFFER, depth);
    gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT24, width, height);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, depth);
  }
  gl.drawBuffers(formats.map((_, i) => gl.COLOR_ATTACHMENT0 + i));
  return { framebuffer, textures, depth, width, height };
}

export function freeTarget(gl, target) {
  target.textures.forEach((texture) => gl.deleteTexture(texture));
  if (target.depth) gl.deleteRenderbuffer(target.depth);
  gl.deleteFramebuffer(target.framebuffer);
}
