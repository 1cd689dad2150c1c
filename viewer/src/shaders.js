// SPDX-License-Identifier: MIT
// Shader texts. Geometry, footprints and light are those of tools/render.

export const MOST_LIGHTS = 12;

const HEAD = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp sampler3D;
precision highp sampler2DArray;
precision highp sampler2DArrayShadow;
`;

export const SURFACE_VERTEX = `${HEAD}
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 uv;
uniform mat4 view_projection;
uniform vec2 jitter, repeat;
out vec3 v_position, v_normal;
out vec2 v_uv;
void main() {
  v_position = position;
  v_normal = normal;
  v_uv = uv * repeat;
  gl_Position = view_projection * vec4(position, 1.0);
  gl_Position.xy += jitter * gl_Position.w;
}
`;

const SURFACE = `
in vec3 v_position, v_normal;
in vec2 v_uv;
uniform vec3 eye, camera_right, camera_up, camera_back;
uniform float pixel;   /* size of a sample at distance 1 */
uniform vec3 material; /* width, height, levels */
uniform vec2 repeat;
uniform bool is_sphere, finest;

struct surface {
  vec3 position, facet, normal, tangent, bitangent, dpdu, dpdv;
  vec2 uv;
};

surface surface_here() {
  const float pi = 3.14159265358979;
  surface s;
  vec3 px = dFdx(v_position), py = dFdy(v_position), from_eye = v_position - eye;
  vec2 tx = dFdx(v_uv), ty = dFdy(v_uv);
  if (is_sphere) {
    s.normal = normalize(v_position);
    s.facet = s.normal;
    s.position = s.normal;
    float radius = length(s.normal.xy), longitude = atan(s.normal.y, s.normal.x);
    s.uv = repeat * vec2(longitude / pi + (longitude < 0.0 ? 2.0 : 0.0), atan(s.normal.z, radius) / pi + 0.5);
    vec2 around = radius > 1e-7 ? s.normal.xy / radius : vec2(1.0, 0.0), tile = pi / repeat;
    s.dpdu = vec3(-around.y, around.x, 0.0) * max(radius, 1e-4) * tile.x;
    s.dpdv = vec3(-s.normal.z * around, radius) * tile.y;
  } else {
    s.position = v_position;
    s.uv = v_uv;
    s.facet = normalize(cross(px, py));
    if (dot(s.facet, from_eye) > 0.0) s.facet = -s.facet;
    s.normal = normalize(v_normal);
    if (dot(s.normal, s.facet) < 0.0) s.normal = -s.normal;
    float determinant = tx.x * ty.y - ty.x * tx.y;
    float inverse = abs(determinant) > 1e-20 ? 1.0 / determinant : 0.0;
    s.dpdu = (px * ty.y - py * tx.y) * inverse;
    s.dpdv = (py * tx.x - px * ty.x) * inverse;
  }
  s.tangent = s.dpdu - dot(s.dpdu, s.normal) * s.normal;
  if (dot(s.tangent, s.tangent) <= 1e-20 * dot(s.dpdu, s.dpdu))
    s.tangent = cross(abs(s.normal.z) < 0.9 ? vec3(0.0, 0.0, 1.0) : vec3(1.0, 0.0, 0.0), s.normal);
  s.tangent = normalize(s.tangent);
  s.bitangent = cross(s.normal, s.tangent);
  if (dot(s.bitangent, s.dpdv) < 0.0) s.bitangent = -s.bitangent;
  return s;
}

vec3 to_local(surface s, vec3 world) {
  return vec3(dot(world, s.tangent), dot(world, s.bitangent), dot(world, s.normal));
}

/* An interpolated normal can turn away where its facet does not. */
vec3 view_of(surface s) {
  vec3 view = to_local(s, normalize(eye - s.position));
  view.z = max(view.z, 1e-3);
  return normalize(view);
}

/* How u and v change from here to where a neighbouring ray meets the tangent plane. */
vec2 step_to(surface s, vec3 ray) {
  float facing = dot(ray, s.facet);
  if (facing >= -1e-3) return vec2(0.0);
  vec3 moved = eye + ray * (dot(s.position - eye, s.facet) / facing) - s.position;
  float uu = dot(s.dpdu, s.dpdu), uv = dot(s.dpdu, s.dpdv), vv = dot(s.dpdv, s.dpdv);
  float determinant = uu * vv - uv * uv, mu = dot(moved, s.dpdu), mv = dot(moved, s.dpdv);
  if (determinant <= 1e-12 * uu * vv) return vec2(0.0);
  return vec2(mu * vv - mv * uv, mv * uu - mu * uv) / determinant;
}

float lod_of(surface s) {
  if (finest) return 0.0;
  vec3 ray = s.position - eye;
  ray /= -dot(ray, camera_back);
  vec2 x = step_to(s, normalize(ray + pixel * camera_right)) * material.xy;
  vec2 y = step_to(s, normalize(ray - pixel * camera_up)) * material.xy;
  float longest = max(length(x), length(y));
  return longest > 1.0 ? min(log2(longest), material.z - 1.0) : 0.0;
}
`;

export const shadeFragment = (glsl, shadows) => `${HEAD}${glsl}
#define MOST_LIGHTS ${MOST_LIGHTS}
${SURFACE}
uniform int light_count;
uniform vec3 light_direction[MOST_LIGHTS], light_irradiance[MOST_LIGHTS];
${shadows ? `uniform bool has_shadows;
uniform mat4 light_matrix[MOST_LIGHTS];
uniform sampler2DArrayShadow shadow_map;
float arrives(surface s, int i, float cosine) {
  if (!has_shadows) return 1.0;
  vec3 lifted = s.position + s.normal * (0.004 + 0.012 * (1.0 - cosine));
  vec3 place = (light_matrix[i] * vec4(lifted, 1.0)).xyz * 0.5 + 0.5;
  float sum = 0.0, step = 0.6 / 1024.0;
  for (int k = 0; k < 4; ++k) {
    vec2 offset = vec2(float(k % 2) - 0.5, float(k / 2) - 0.5) * 2.0 * step;
    sum += texture(shadow_map, vec4(place.xy + offset, float(i), place.z - 0.0015));
  }
  return sum * 0.25;
}` : 'float arrives(surface s, int i, float cosine) { return 1.0; }'}
out vec4 result;
void main() {
  surface s = surface_here();
  vec3 view = view_of(s), sum = vec3(0.0);
  float lod = lod_of(s);
  for (int i = 0; i < light_count; ++i) {
    vec3 light = to_local(s, light_direction[i]);
    if (light.z <= 0.0) continue;
    float share = arrives(s, i, light.z);
    if (share > 0.0) sum += btf_eval(light, view, s.uv, lod) * light_irradiance[i] * (light.z * share);
  }
  result = vec4(sum, 1.0);
}
`;

export const PICK_FRAGMENT = `${HEAD}${SURFACE}
uniform vec3 picked_light;
uniform bool is_clamped; /* beyond its sides the material goes on as at them */
layout(location = 0) out vec4 place;
layout(location = 1) out vec4 view;
layout(location = 2) out vec4 light;
void main() {
  surface s = surface_here();
  place = vec4(is_clamped ? clamp(s.uv, 0.0, 1.0) : fract(s.uv), lod_of(s), 1.0);
  view = vec4(view_of(s), 1.0);
  light = vec4(to_local(s, picked_light), 1.0);
}
`;

export const SHADOW_VERTEX = `${HEAD}
layout(location = 0) in vec3 position;
uniform mat4 light;
void main() { gl_Position = light * vec4(position, 1.0); }
`;
export const SHADOW_FRAGMENT = `${HEAD}void main() {}\n`;

export const SCREEN_VERTEX = `${HEAD}
out vec2 place; /* 0..1, v up */
void main() {
  place = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0;
  gl_Position = vec4(place * 2.0 - 1.0, 0.9999, 1.0);
}
`;

export const BACKDROP_FRAGMENT = `${HEAD}
in vec2 place;
uniform sampler2D map;
uniform vec3 camera_right, camera_up, camera_back;
uniform vec2 half_size;
uniform float rotation, level;
out vec4 result;
void main() {
  vec2 at = (place * 2.0 - 1.0) * half_size;
  vec3 d = normalize(at.x * camera_right + at.y * camera_up - camera_back);
  float c = cos(rotation), s = sin(rotation);
  d.xy = vec2(c * d.x + s * d.y, c * d.y - s * d.x);
  result = vec4(textureLod(map, vec2(atan(d.x, d.y) / 6.28318530718 + 0.5, acos(clamp(d.z, -1.0, 1.0)) / 3.14159265359), level).rgb, 1.0);
}
`;

/* The running mean of samples. */
export const MEAN_FRAGMENT = `${HEAD}
uniform sampler2D before, fresh;
uniform float share;
out vec4 result;
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec4 value = texelFetch(fresh, at, 0);
  result = share >= 1.0 ? value : mix(texelFetch(before, at, 0), value, share);
}
`;

const TONE = `
uniform float gain;
uniform bool filmic;
vec3 coded(vec3 value) {
  value = clamp(value, 0.0, 1.0);
  return mix(1.055 * pow(max(value, 1e-8), vec3(1.0 / 2.4)) - 0.055, 12.92 * value, vec3(lessThanEqual(value, vec3(0.0031308))));
}
vec3 toned(vec3 value) {
  value *= gain;
  return filmic ? max(value, 0.0) * (1.0 + value / 16.0) / (1.0 + max(value, 0.0)) : value;
}
`;

export const SHOW_FRAGMENT = `${HEAD}
in vec2 place;
uniform sampler2D first, second;
uniform int mode; /* 0 the first, 1 both beside a line, 2 difference */
uniform float line, line_width, difference_gain;
uniform vec2 used; /* share of the pictures that is drawn */
uniform vec3 background_low, background_high;
out vec4 result;
${TONE}
vec3 background() {
  return mix(background_high, background_low, smoothstep(0.0, 1.1, length((place - vec2(0.5, 0.58)) * vec2(1.0, 1.2))));
}
vec3 over(vec4 value) {
  /* tone of the surface alone: a background keeps its colour whatever the exposure */
  vec3 seen = value.a > 0.0 ? toned(value.rgb / value.a) : vec3(0.0);
  return coded(mix(background(), clamp(seen, 0.0, 1.0), value.a));
}
void main() {
  vec2 at = place * used;
  vec4 a = texture(first, at);
  vec3 colour = over(a);
  if (mode == 1) {
    if (place.x > line) colour = over(texture(second, at));
    if (abs(place.x - line) < line_width) colour = vec3(0.93, 0.76, 0.5);
  } else if (mode == 2) {
    vec3 difference = abs(over(texture(second, at)) - colour) * difference_gain;
    colour = a.a > 0.0 ? difference : colour * 0.5;
  }
  /* half a step of noise keeps the dark background from banding */
  float noise = fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715)))) - 0.5;
  result = vec4(colour + noise * (1.0 - a.a) / 255.0, 1.0);
}
`;

export const discFragment = (glsl) => `${HEAD}${glsl}
in vec2 place;
uniform vec2 uv;
uniform float lod;
uniform vec3 fixed_direction;
uniform bool light_is_fixed;
out vec4 result;
${TONE}
void main() {
  vec2 at = (place * 2.0 - 1.0) * 1.04;
  float r = dot(at, at);
  vec3 d = vec3(2.0 * at, 1.0 - r) / (1.0 + r);
  vec3 f = light_is_fixed ? btf_eval(fixed_direction, d, uv, lod) * max(fixed_direction.z, 0.0) : btf_eval(d, fixed_direction, uv, lod) * d.z;
  float edge = 1.0 - smoothstep(1.0 - fwidth(r), 1.0, r);
  result = vec4(coded(toned(f * 3.14159265)), 1.0) * edge;
}
`;
