// SPDX-License-Identifier: MIT
// Pointers: one drags the camera around, two pinch and turn the light; a ball turns directions as a trackball does.
import { add, clamp, cross, degrees, dot, normalized, radians, scaled, turned } from './math.js';

export const aim = (light, direction) => {
  light.azimuth = degrees(Math.atan2(direction[1], direction[0]));
  light.elevation = degrees(Math.asin(clamp(direction[2], -1, 1)));
};

// A place around the ball's centre (radius 1, y up) as a direction; outside, the ball goes on as a hyperbola.
function onBall(x, y) {
  const square = x * x + y * y;
  return normalized([x, y, square < 0.5 ? Math.sqrt(1 - square) : 0.5 / Math.sqrt(square)]);
}

// A direction, turned as a ball would be that is dragged from one place to another.
export function rolled(direction, camera, from, to) {
  const a = onBall(...from), b = onBall(...to), axis = cross(a, b), sine = Math.hypot(...axis);
  if (sine < 1e-9) return direction;
  const world = add(add(scaled(camera.right, axis[0]), scaled(camera.up, axis[1])), scaled(camera.back, axis[2]));
  return turned(direction, scaled(world, 1 / sine), Math.atan2(sine, dot(a, b)));
}

const ZOOM = { near: 1.15, far: 12 };
export const zoomed = (distance, factor) => clamp(distance * factor, ZOOM.near, ZOOM.far);

// events: orbit(dx, dy) in degrees, light(from, to) on the ball, zoom(factor), hover(x, y), tap(x, y), grab(active)
export function watchPointers(canvas, events) {
  const down = new Map();
  let turnsLight = false, moved = 0, pinch = 0;
  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top, width: box.width, height: box.height };
  };
  const onLightBall = (p) => { const r = 0.42 * Math.min(p.width, p.height); return [(p.x - p.width / 2) / r, (p.height / 2 - p.y) / r]; };
  const between = () => {
    const [a, b] = [...down.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, width: a.width, height: a.height, apart: Math.hypot(a.x - b.x, a.y - b.y) };
  };
  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, place(event));
    turnsLight = event.button === 2 || event.shiftKey;
    if (down.size === 1) moved = 0;
    if (down.size === 2) pinch = between().apart;
    events.grab(true);
  });
  canvas.addEventListener('pointermove', (event) => {
    const now = place(event), before = down.get(event.pointerId);
    if (!before) { events.hover(now.x / now.width, now.y / now.height); return; }
    const dx = now.x - before.x, dy = now.y - before.y;
    moved += Math.abs(dx) + Math.abs(dy);
    if (down.size === 2) {
      const old = between();
      down.set(event.pointerId, now);
      const middle = between();
      events.zoom(pinch / middle.apart);
      pinch = middle.apart;
      events.light(onLightBall(old), onLightBall(middle));
      return;
    }
    down.set(event.pointerId, now);
    if (turnsLight) events.light(onLightBall(before), onLightBall(now));
    else events.orbit((-dx * 260) / now.height, (dy * 260) / now.height);
  });
  const up = (event) => {
    if (!down.delete(event.pointerId)) return;
    if (down.size === 0) {
      events.grab(false);
      const p = place(event);
      if (moved < 5 && event.type === 'pointerup') events.tap(p.x / p.width, p.y / p.height);
    }
  };
  canvas.addEventListener('pointerup', up);
  canvas.addEventListener('pointercancel', up);
  canvas.addEventListener('contextmenu', (event) => event.preventDefault());
  canvas.addEventListener('wheel', (event) => {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 30 : 1;
    events.zoom(Math.exp(clamp(event.deltaY * lines, -240, 240) * (event.ctrlKey ? 0.01 : 0.0015)));
  }, { passive: false });
}

// The ball of lights: drag to roll the chosen light, press a dot to choose another.
export class LightBall {
  constructor(canvas, state, camera, changed) {
    Object.assign(this, { canvas, state, camera });
    let last = null;
    const place = (event) => {
      const box = canvas.getBoundingClientRect(), r = 0.44 * box.width;
      return [(event.clientX - box.left - box.width / 2) / r, (box.height / 2 - (event.clientY - box.top)) / r];
    };
    canvas.addEventListener('pointerdown', (event) => {
      canvas.setPointerCapture(event.pointerId);
      last = place(event);
      const near = this.dots().map(({ x, y }, i) => [Math.hypot(x - last[0], y - last[1]), i]).sort((a, b) => a[0] - b[0])[0];
      if (near && near[0] < 0.22) { state.light = near[1]; changed(); }
    });
    canvas.addEventListener('pointermove', (event) => {
      const light = state.lights[state.light];
      if (!last || !light) return;
      const now = place(event);
      aim(light, rolled(this.direction(light), camera(), last, now));
      last = now;
      changed();
    });
    for (const name of ['pointerup', 'pointercancel']) canvas.addEventListener(name, () => { last = null; });
  }

  direction({ azimuth, elevation }) {
    const a = radians(azimuth), e = radians(elevation);
    return [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
  }

  dots() {
    const camera = this.camera();
    return this.state.lights.map((light) => {
      const d = this.direction(light);
      return { x: dot(d, camera.right), y: dot(d, camera.up), front: dot(d, camera.back) >= 0 };
    });
  }

  draw() {
    const { canvas, state } = this, side = 216, r = 0.44 * side, c = side / 2, pen = canvas.getContext('2d');
    if (canvas.width !== side) canvas.width = canvas.height = side;
    pen.clearRect(0, 0, side, side);
    const dots = this.dots(), chosen = dots[state.light];
    const glow = chosen ? [c + chosen.x * r * 0.75, c - chosen.y * r * 0.75] : [c, c];
    const shade = pen.createRadialGradient(...glow, 2, c, c, r * 1.5);
    shade.addColorStop(0, chosen && chosen.front ? '#596169' : '#2b3035');
    shade.addColorStop(0.55, '#22272b');
    shade.addColorStop(1, '#14171a');
    pen.fillStyle = shade;
    pen.beginPath();
    pen.arc(c, c, r, 0, 2 * Math.PI);
    pen.fill();
    dots.forEach(({ x, y, front }, i) => {
      const [red, green, blue] = state.lights[i].colour.map((v) => Math.round(255 * v ** (1 / 2.2)));
      pen.beginPath();
      pen.arc(c + x * r, c - y * r, i === state.light ? 10 : 7, 0, 2 * Math.PI);
      pen.fillStyle = pen.strokeStyle = `rgb(${red} ${green} ${blue})`;
      pen.lineWidth = 2.5;
      if (front) pen.fill();
      else pen.stroke();
      if (i !== state.light) return;
      pen.beginPath();
      pen.arc(c + x * r, c - y * r, 15, 0, 2 * Math.PI);
      pen.strokeStyle = '#e8bd7c';
      pen.lineWidth = 2;
      pen.stroke();
    });
  }
}
