// SPDX-License-Identifier: MIT
// Draws the scene: samples of a pixel and of the environment are taken one frame after another and averaged while
// nothing moves. While something moves, single samples are shown, at a resolution that keeps up.
import { cameraMatrix, clamp, directionOf, lightMatrix, orbitCamera, pixelPlaces, spread } from './math.js';
import { bindExport, freeExport, freeTarget, makeProgram, makeProgramAside, makeTarget, uploadExport } from './gpu.js';
import { BACKDROP_FRAGMENT, discFragment, MEAN_FRAGMENT, MOST_LIGHTS, PICK_FRAGMENT, SCREEN_VERTEX } from './shaders.js';
import { shadeFragment, SHADOW_FRAGMENT, SHADOW_VERTEX, SHOW_FRAGMENT, SURFACE_VERTEX } from './shaders.js';
import { environmentTexels, sampleEnvironment } from './environment.js';

const SHADOW_SIZE = 1024, ENVIRONMENT_LIGHTS = 8, DISC_SIZE = 192;
const MOVING_SCALES = [1, 0.7, 0.5, 0.35], HIDDEN_SAMPLES = 4;
const IDLE_SAMPLES = { light: 16, environment: 48 };

export class Renderer {
  constructor(canvas) {
    const gl = canvas.getContext('webgl2', { antialias: false, alpha: false, powerPreference: 'high-performance' });
    if (!gl) throw new Error('WebGL 2 is switched off or missing in this browser');
    this.full = gl.getExtension('EXT_color_buffer_float');
    if (!this.full && !gl.getExtension('EXT_color_buffer_half_float')) throw new Error('this browser draws no float pictures');
    Object.assign(this, { gl, canvas, slots: [null, null], shape: null, map: null, sample: 0, scaleStep: 0, dirty: true });
    this.programs = {
      shadow: makeProgram(gl, SHADOW_VERTEX, SHADOW_FRAGMENT),
      pick: makeProgram(gl, SURFACE_VERTEX, PICK_FRAGMENT),
      backdrop: makeProgram(gl, SCREEN_VERTEX, BACKDROP_FRAGMENT),
      mean: makeProgram(gl, SCREEN_VERTEX, MEAN_FRAGMENT),
      show: makeProgram(gl, SCREEN_VERTEX, SHOW_FRAGMENT),
    };
    this.nothing = gl.createVertexArray();
    this.makeShadowMaps();
    const picked = this.full ? gl.RGBA32F : gl.RGBA16F;
    this.pickTarget = makeTarget(gl, [picked, picked, picked], 1, 1, true);
    this.discTarget = makeTarget(gl, [gl.RGBA8], DISC_SIZE, DISC_SIZE, false);
  }

  makeShadowMaps() {
    const { gl } = this;
    this.shadowMaps = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.shadowMaps);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.DEPTH_COMPONENT24, SHADOW_SIZE, SHADOW_SIZE, MOST_LIGHTS);
    const set = (name, value) => gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl[name], value);
    set('TEXTURE_COMPARE_MODE', gl.COMPARE_REF_TO_TEXTURE);
    for (const name of ['TEXTURE_MIN_FILTER', 'TEXTURE_MAG_FILTER']) set(name, gl.LINEAR);
    for (const name of ['TEXTURE_WRAP_S', 'TEXTURE_WRAP_T']) set(name, gl.CLAMP_TO_EDGE);
    this.shadowTarget = gl.createFramebuffer();
  }

  // Both programs and the textures of an export, or none of them.
  async makeMaterial(source) {
    const { gl } = this, { manifest, glsl } = source;
    const shadows = manifest.textures.length < gl.getParameter(gl.MAX_TEXTURE_IMAGE_UNITS);
    const making = [makeProgramAside(gl, SURFACE_VERTEX, shadeFragment(glsl, shadows)),
      makeProgramAside(gl, SCREEN_VERTEX, discFragment(glsl))];
    try {
      const [shade, disc] = await Promise.all(making);
      return { manifest, shadows, shade, disc, uploaded: uploadExport(gl, source), means: null };
    } catch (error) {
      for (const { value } of await Promise.allSettled(making)) if (value) gl.deleteProgram(value.program);
      throw error;
    }
  }

  freeMaterial({ uploaded, shade, disc }) {
    freeExport(this.gl, uploaded);
    for (const { program } of [shade, disc]) this.gl.deleteProgram(program);
  }

  // The material before stays until the new one can be drawn. False where that was no longer wanted by then.
  async setExport(slot, source, isWanted = () => true) {
    const made = source && await this.makeMaterial(source), old = this.slots[slot];
    if (!isWanted()) {
      if (made) this.freeMaterial(made);
      return false;
    }
    this.slots[slot] = made;
    if (made && old) made.means = old.means;
    if (old) this.freeMaterial(old);
    if (old && old.means && !made) old.means.forEach((target) => freeTarget(this.gl, target));
    this.restart();
    return true;
  }

  setShape(shape) {
    const { gl } = this, vao = gl.createVertexArray();
    const buffer = (kind, data) => {
      const object = gl.createBuffer();
      gl.bindBuffer(kind, object);
      gl.bufferData(kind, data, gl.STATIC_DRAW);
      return object;
    };
    gl.bindVertexArray(vao);
    const buffers = [shape.positions, shape.normals, shape.uvs].map((data, i) => {
      const object = buffer(gl.ARRAY_BUFFER, data);
      gl.enableVertexAttribArray(i);
      gl.vertexAttribPointer(i, i < 2 ? 3 : 2, gl.FLOAT, false, 0, 0);
      return object;
    });
    buffers.push(buffer(gl.ELEMENT_ARRAY_BUFFER, shape.triangles));
    gl.bindVertexArray(null);
    if (this.shape) {
      this.shape.buffers.forEach((object) => gl.deleteBuffer(object));
      gl.deleteVertexArray(this.shape.vao);
    }
    const { kind, target, radius, shadows } = shape;
    this.shape = { kind, target, radius, shadows: Boolean(shadows), vao, buffers, count: shape.triangles.length };
    this.restart();
  }

  setEnvironment(map) {
    const { gl } = this;
    if (this.mapTexture) gl.deleteTexture(this.mapTexture);
    Object.assign(this, { map, mapTexture: null });
    if (map) {
      this.mapTexture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, this.mapTexture);
      const { width, height, texels } = environmentTexels(map, gl.getParameter(gl.MAX_TEXTURE_SIZE));
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, width, height, 0, gl.RGBA, gl.FLOAT, texels);
      this.backdropLevel = 3.5 + Math.log2(width / 1024);
      gl.generateMipmap(gl.TEXTURE_2D);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    }
    this.restart();
  }

  restart() {
    this.sample = 0;
    this.dirty = true;
  }

  get samplesWanted() { return this.map ? IDLE_SAMPLES.environment : IDLE_SAMPLES.light; }

  camera(state) {
    return orbitCamera(this.shape.target, state.camera[0], state.camera[1], state.distance, this.canvas.width / this.canvas.height);
  }

  // True where the canvas was emptied.
  resize(width, height) {
    if (this.canvas.width === width && this.canvas.height === height && this.fresh) return false;
    const { gl } = this;
    Object.assign(this.canvas, { width, height });
    if (this.fresh) freeTarget(gl, this.fresh);
    this.fresh = makeTarget(gl, [gl.RGBA16F], width, height, true);
    for (const slot of this.slots)
      if (slot && slot.means) { slot.means.forEach((target) => freeTarget(gl, target)); slot.means = null; }
    this.restart();
    return true;
  }

  lightsOf(state, sample) {
    const lights = state.lights.filter((light) => light.strength > 0).map(({ azimuth, elevation, strength, colour }) => ({
      direction: directionOf(azimuth, elevation), irradiance: colour.map((c) => c * strength * Math.PI) }));
    if (!this.map) return lights;
    const [shiftX, shiftY] = spread(sample);
    for (let i = 0; i < ENVIRONMENT_LIGHTS; i++) {
      const [x, y] = [(i + shiftX) / ENVIRONMENT_LIGHTS, (spread(i)[1] + shiftY) % 1];
      lights.push(sampleEnvironment(this.map, x, y, ENVIRONMENT_LIGHTS, (state.rotation * Math.PI) / 180));
    }
    return lights;
  }

  drawShape() {
    this.gl.bindVertexArray(this.shape.vao);
    this.gl.drawElements(this.gl.TRIANGLES, this.shape.count, this.gl.UNSIGNED_INT, 0);
  }

  drawShadows(lights) {
    const { gl } = this, { program, uniforms } = this.programs.shadow;
    gl.useProgram(program);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadowTarget);
    gl.viewport(0, 0, SHADOW_SIZE, SHADOW_SIZE);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1.5, 2);
    lights.forEach(({ matrix }, i) => {
      gl.framebufferTextureLayer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, this.shadowMaps, 0, i);
      gl.clear(gl.DEPTH_BUFFER_BIT);
      gl.uniformMatrix4fv(uniforms.light, false, matrix);
      this.drawShape();
    });
    gl.disable(gl.POLYGON_OFFSET_FILL);
    gl.disable(gl.DEPTH_TEST);
  }

  // Uniforms that all programs of surfaces have.
  setSurface(uniforms, slot, state, camera, width, height, jitter, share) {
    const { gl } = this, { manifest } = slot, aspect = manifest.width / manifest.height, { kind } = this.shape;
    // whole tiles go around a sphere, or a seam would show
    const repeat = kind === 'sphere' ? Math.max(Math.round(2 * state.repeat), 1) / 2 : state.repeat;
    gl.uniformMatrix4fv(uniforms.view_projection, false, cameraMatrix(camera, width / height));
    gl.uniform2f(uniforms.jitter, (2 * jitter[0]) / width, (2 * jitter[1]) / height);
    gl.uniform2f(uniforms.repeat, repeat, repeat * aspect);
    gl.uniform3fv(uniforms.eye, camera.position);
    gl.uniform3fv(uniforms.camera_right, camera.right);
    gl.uniform3fv(uniforms.camera_up, camera.up);
    gl.uniform3fv(uniforms.camera_back, camera.back);
    gl.uniform1f(uniforms.pixel, (2 * camera.halfHeight * share) / height);
    gl.uniform3f(uniforms.material, manifest.width, manifest.height, manifest.levels);
    gl.uniform1i(uniforms.is_sphere, kind === 'sphere' ? 1 : 0);
    gl.uniform1i(uniforms.finest, state.levels ? 0 : 1);
  }

  drawBackdrop(camera, state, width, height) {
    const { gl } = this, { program, uniforms } = this.programs.backdrop;
    gl.useProgram(program);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.mapTexture);
    gl.uniform1i(uniforms.map, 0);
    gl.uniform3fv(uniforms.camera_right, camera.right);
    gl.uniform3fv(uniforms.camera_up, camera.up);
    gl.uniform3fv(uniforms.camera_back, camera.back);
    gl.uniform2f(uniforms.half_size, (camera.halfHeight * width) / height, camera.halfHeight);
    gl.uniform1f(uniforms.rotation, (state.rotation * Math.PI) / 180);
    gl.uniform1f(uniforms.level, this.backdropLevel);
    this.drawScreen();
  }

  drawScreen() {
    this.gl.bindVertexArray(this.nothing);
    this.gl.drawArrays(this.gl.TRIANGLES, 0, 3);
  }

  drawSample(slot, state, lights, camera, width, height, jitter, share) {
    const { gl } = this, { program, uniforms } = slot.shade, units = slot.uploaded.textures.length;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.fresh.framebuffer);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    if (this.map && state.backdrop) { gl.depthMask(false); this.drawBackdrop(camera, state, width, height); gl.depthMask(true); }
    gl.useProgram(program);
    bindExport(gl, slot.uploaded, slot.shade);
    this.setSurface(uniforms, slot, state, camera, width, height, jitter, share);
    gl.uniform1i(uniforms.light_count, lights.length);
    if (lights.length) {
      gl.uniform3fv(uniforms.light_direction, lights.flatMap((light) => light.direction));
      gl.uniform3fv(uniforms.light_irradiance, lights.flatMap((light) => light.irradiance));
    }
    if (slot.shadows) {
      gl.activeTexture(gl.TEXTURE0 + units);
      gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.shadowMaps);
      gl.uniform1i(uniforms.shadow_map, units);
      gl.uniform1i(uniforms.has_shadows, this.shape.shadows ? 1 : 0);
      if (this.shape.shadows && lights.length)
        gl.uniformMatrix4fv(uniforms.light_matrix, false, lights.flatMap((light) => [...light.matrix]));
    }
    this.drawShape();
    gl.disable(gl.DEPTH_TEST);
  }

  average(slot, share, width, height) {
    const { gl } = this, { program, uniforms } = this.programs.mean;
    if (!slot.means) slot.means = [0, 1].map(() => makeTarget(gl, [gl.RGBA16F], this.fresh.width, this.fresh.height, false));
    slot.means.reverse();
    gl.useProgram(program);
    gl.bindFramebuffer(gl.FRAMEBUFFER, slot.means[0].framebuffer);
    gl.viewport(0, 0, width, height);
    [[slot.means[1].textures[0], uniforms.before], [this.fresh.textures[0], uniforms.fresh]].forEach(([texture, at], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.uniform1i(at, unit);
    });
    gl.uniform1f(uniforms.share, share);
    this.drawScreen();
  }

  // One more sample of every material that is shown. `of` = how many samples the picture will have.
  addSample(state, of, scale) {
    const width = Math.max(1, Math.round(this.fresh.width * scale)), height = Math.max(1, Math.round(this.fresh.height * scale));
    const camera = this.camera(state), lights = this.lightsOf(state, of === 1 ? 0 : this.sample);
    const jitter = pixelPlaces(of)[this.sample % of];
    if (this.shape.shadows) {
      for (const light of lights) light.matrix = lightMatrix(light.direction, this.shape.radius);
      this.drawShadows(lights);
    }
    for (const slot of this.slots) {
      if (!slot) continue;
      this.drawSample(slot, state, lights, camera, width, height, jitter, 1 / Math.sqrt(of));
      this.average(slot, of === 1 ? 1 : 1 / (this.sample + 1), width, height);
    }
    this.used = [width / this.fresh.width, height / this.fresh.height];
    this.sample++;
  }

  show(state) {
    const { gl } = this, { program, uniforms } = this.programs.show, both = this.slots[0] && this.slots[1];
    const shown = this.slots[state.compare === 'second' && both ? 1 : 0];
    if (!shown || !shown.means) return;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.useProgram(program);
    const pictures = [shown, both && this.slots[1].means ? this.slots[1] : shown];
    pictures.forEach((slot, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, slot.means[0].textures[0]);
    });
    gl.uniform1i(uniforms.first, 0);
    gl.uniform1i(uniforms.second, 1);
    gl.uniform1i(uniforms.mode, both ? { split: 1, difference: 2 }[state.compare] || 0 : 0);
    gl.uniform1f(uniforms.line, state.line);
    gl.uniform1f(uniforms.line_width, 0.75 / this.canvas.clientWidth);
    gl.uniform1f(uniforms.difference_gain, state.differenceGain);
    gl.uniform2fv(uniforms.used, this.used);
    gl.uniform3fv(uniforms.background_low, state.background || [0.0045, 0.005, 0.006]);
    gl.uniform3fv(uniforms.background_high, state.background || [0.022, 0.0245, 0.0285]);
    this.setTone(uniforms, state);
    this.drawScreen();
  }

  setTone(uniforms, state) {
    this.gl.uniform1f(uniforms.gain, 2 ** state.exposure);
    this.gl.uniform1i(uniforms.filmic, state.tone === 'filmic' ? 1 : 0);
  }

  // True while more frames are wanted.
  frame(state, moving, elapsed) {
    if (!this.shape || !this.slots[0]) return false;
    if (moving) {
      this.adapt(elapsed);
      this.sample = 0;
      this.addSample(state, 1, MOVING_SCALES[this.scaleStep]);
      this.sample = 0;
      this.show(state);
      this.dirty = false;
      return true;
    }
    const wanted = this.samplesWanted;
    if (this.sample < wanted) {
      if (this.sample === 0 && !this.slots.some((slot) => slot && slot.means)) this.used = [1, 1];
      const keep = this.sample === 0 ? HIDDEN_SAMPLES : 1; // few samples alone would show as a flash
      for (let i = 0; i < keep; i++) this.addSample(state, wanted, 1);
      this.dirty = true;
    }
    if (this.dirty) this.show(state);
    this.dirty = false;
    return this.sample < wanted;
  }

  adapt(elapsed) {
    this.pace = clamp(elapsed, 4, 200) * 0.25 + (this.pace || 16) * 0.75;
    if (this.pace > 40 && this.scaleStep < MOVING_SCALES.length - 1) { this.scaleStep++; this.pace = 20; }
    else if (this.pace < 14 && this.scaleStep > 0) { this.scaleStep--; this.pace = 20; }
  }

  // The whole picture at once, for files and tests: what the canvas shows is complete when this returns.
  async complete(state, samples) {
    this.sample = 0;
    while (this.sample < samples) {
      this.addSample(state, samples, 1);
      if (this.sample % 4 === 0) { this.gl.finish(); await new Promise((resolve) => { setTimeout(resolve); }); }
    }
    this.show(state);
  }

  // What lies under a place of the canvas (0..1, y down), or null.
  pick(state, slotNumber, x, y) {
    const { gl } = this, slot = this.slots[slotNumber], { program, uniforms } = this.programs.pick;
    if (!slot || !this.shape) return null;
    const { width, height } = this.canvas, camera = this.camera(state), light = state.lights[state.light] || state.lights[0];
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.pickTarget.framebuffer);
    // the one pixel of the target is the chosen one of the whole picture
    gl.viewport(-Math.floor(x * width), -Math.floor((1 - y) * height), width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.useProgram(program);
    this.setSurface(uniforms, slot, state, camera, width, height, [0, 0], 1);
    gl.uniform1i(uniforms.is_clamped, slot.manifest.wrap === 'clamp' ? 1 : 0);
    gl.uniform3fv(uniforms.picked_light, light ? directionOf(light.azimuth, light.elevation) : [0, 0, 1]);
    this.drawShape();
    gl.disable(gl.DEPTH_TEST);
    const read = (i) => {
      const values = new Float32Array(4);
      gl.readBuffer(gl.COLOR_ATTACHMENT0 + i);
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.FLOAT, values);
      return [...values];
    };
    const place = read(0), view = read(1).slice(0, 3), toLight = read(2).slice(0, 3);
    return place[3] > 0 ? { uv: place.slice(0, 2), lod: place[2], view, light: light ? toLight : [0, 0, 1] } : null;
  }

  // A hemisphere of f * cos at a place, by light (the view fixed) or by view (the light fixed), as coded pixels.
  disc(state, slotNumber, picked, lightIsFixed) {
    const { gl } = this, slot = this.slots[slotNumber], { program, uniforms } = slot.disc;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.discTarget.framebuffer);
    gl.viewport(0, 0, DISC_SIZE, DISC_SIZE);
    gl.useProgram(program);
    bindExport(gl, slot.uploaded, slot.disc);
    gl.uniform2fv(uniforms.uv, picked.uv);
    gl.uniform1f(uniforms.lod, picked.lod);
    gl.uniform3fv(uniforms.fixed_direction, lightIsFixed ? picked.light : picked.view);
    gl.uniform1i(uniforms.light_is_fixed, lightIsFixed ? 1 : 0);
    this.setTone(uniforms, state);
    this.drawScreen();
    const rows = new Uint8ClampedArray(DISC_SIZE * DISC_SIZE * 4), flipped = new ImageData(DISC_SIZE, DISC_SIZE);
    gl.readPixels(0, 0, DISC_SIZE, DISC_SIZE, gl.RGBA, gl.UNSIGNED_BYTE, rows);
    for (let y = 0; y < DISC_SIZE; y++)
      flipped.data.set(rows.subarray(y * DISC_SIZE * 4, (y + 1) * DISC_SIZE * 4), (DISC_SIZE - 1 - y) * DISC_SIZE * 4);
    return flipped;
  }
}
