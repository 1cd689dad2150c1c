/* SPDX-License-Identifier: MIT */
/* glsl.c: the whole shader around a codec's part. One text for GLSL ES 3.00, GLSL 3.30 and GLSL 4.50 of
 * Vulkan. */
#include "gpu/gpu.h"

/* Bindings are given where the dialect has them; a host may define BTF_BINDING itself, for another descriptor
 * set. */
static const char head[] = "#ifndef BTF_BINDING\n"
                           "#if defined(VULKAN) || (!defined(GL_ES) && __VERSION__ >= 420)\n"
                           "#define BTF_BINDING(n) layout(binding = n)\n"
                           "#define BTF_BLOCK(n) layout(std140, binding = n)\n"
                           "#else\n"
                           "#define BTF_BINDING(n)\n"
                           "#define BTF_BLOCK(n) layout(std140)\n"
                           "#endif\n"
                           "#endif\n"
                           "#ifdef GL_ES\n"
                           "precision highp float;\n"
                           "precision highp int;\n"
                           "#define BTF_HIGHP highp\n"
                           "#else\n"
                           "#define BTF_HIGHP\n"
                           "#endif\n";

/* By bits: compilers of shaders take comparisons of floats for such as know no NaN. */
static const char finite[] = "bvec3 btf_finite(vec3 v) {\n"
                             "  return notEqual(floatBitsToInt(v) & 0x7f800000, ivec3(0x7f800000));\n"
                             "}\n";

static const char directions[] = "/* The unit disc of directions: (x, y) / (1 + z). */\n"
                                 "vec2 btf_parabolic(vec3 direction) {\n"
                                 "  vec3 d = vec3(direction.xy, max(direction.z, 0.0));\n"
                                 "  return d.xy / (length(d) + d.z);\n"
                                 "}\n";

/* Implementations' own pow() has an absolute error of the logarithm, which exponents of hundreds make a
 * relative one of thousandths. The series is that of the inverse hyperbolic tangent, between the roots of 1/2
 * and 2; what is left out is below 2e-9 of the logarithm. */
static const char powers[] =
    "/* base to the power of an exponent above 0; 0 if the base is not above 0. */\n"
    "float btf_power(float base, float exponent) {\n"
    "  if (!(base > 0.0)) return 0.0;\n"
    "  int bits = floatBitsToInt(base) - 0x3f3504f3;\n"
    "  float mantissa = intBitsToFloat((bits & 0x7fffff) + 0x3f3504f3);\n"
    "  float t = (mantissa - 1.0) / (mantissa + 1.0), s = t * t;\n"
    "  float fraction = t * (2.885390082 + s * (0.961796694 + s * (0.577078016 + s * (0.412198583 +\n"
    "                   s * 0.320598898))));\n"
    "  return exp2(exponent * (float(bits >> 23) + fraction));\n"
    "}\n";

static const char texels[] =
    "ivec2 btf_level_size(int level) {\n"
    "  return max(ivec2(btf_size.xy) >> level, ivec2(1));\n"
    "}\n"
    "/* Two levels and their weights. */\n"
    "void btf_levels(float lod, out ivec2 level, out vec2 weight) {\n"
    "  float clamped = clamp(lod, 0.0, btf_size.z - 1.0);\n"
    "  level.x = int(clamped);\n"
    "  level.y = min(level.x + 1, int(btf_size.z) - 1);\n"
    "  weight.y = clamped - float(level.x);\n"
    "  weight.x = 1.0 - weight.y;\n"
    "}\n"
    "/* Two texels along an axis; weight is of the second. */\n"
    "void btf_linear(float u, int size, out ivec2 texel, out float weight) {\n"
    "  float position = BTF_WRAPPED(u) * float(size) - 0.5;\n"
    "  float below = floor(position);\n"
    "  weight = position - below;\n"
    "  texel = BTF_WRAP(ivec2(int(below), int(below) + 1), size);\n"
    "}\n"
    "/* Four texels of a level, corner by corner (x0 y0, x1 y0, x0 y1, x1 y1), and their weights. */\n"
    "void btf_texels(vec2 uv, int level, out ivec2 x, out ivec2 y, out vec4 weight) {\n"
    "  ivec2 size = btf_level_size(level);\n"
    "  vec2 w;\n"
    "  btf_linear(uv.x, size.x, x, w.x);\n"
    "  btf_linear(uv.y, size.y, y, w.y);\n"
    "  weight = vec4(1.0 - w.x, w.x, 1.0 - w.x, w.x) * vec4(1.0 - w.y, 1.0 - w.y, w.y, w.y);\n"
    "}\n"
    "/* The texels of two levels that a position is made of; those of the second count when share is above "
    "0. */\n"
    "struct btf_place {\n"
    "  ivec2 x0, y0, x1, y1, level;\n"
    "  vec4 weight0, weight1;\n"
    "  float share;\n"
    "};\n"
    "btf_place btf_place_of(vec2 uv, float lod) {\n"
    "  btf_place p;\n"
    "  vec2 shares;\n"
    "  btf_levels(lod, p.level, shares);\n"
    "  btf_texels(uv, p.level.x, p.x0, p.y0, p.weight0);\n"
    "  btf_texels(uv, p.level.y, p.x1, p.y1, p.weight1);\n"
    "  p.weight0 *= shares.x;\n"
    "  p.weight1 *= shares.y;\n"
    "  p.share = shares.y;\n"
    "  return p;\n"
    "}\n"
    "/* Column, row and level of texel i of the eight of a place, and its weight. */\n"
    "ivec3 btf_place_texel(btf_place p, int i, out float weight) {\n"
    "  int column = i & 1, row = (i >> 1) & 1;\n"
    "  if (i < 4) {\n"
    "    weight = p.weight0[i];\n"
    "    return ivec3(p.x0[column], p.y0[row], p.level.x);\n"
    "  }\n"
    "  weight = p.weight1[i - 4];\n"
    "  return ivec3(p.x1[column], p.y1[row], p.level.y);\n"
    "}\n";

static const char *sampler_of(uint32_t dimension) {
  return dimension == BTF_TEXTURE_3D         ? "sampler3D"
         : dimension == BTF_TEXTURE_CUBE     ? "samplerCube"
         : dimension == BTF_TEXTURE_2D_ARRAY ? "sampler2DArray"
                                             : "sampler2D";
}

static void put_uniform(const btf_gpu_uniform *u, btfi_buffer *out) {
  const char *type = u->type == BTF_UNIFORM_FLOAT  ? "float"
                     : u->type == BTF_UNIFORM_VEC2 ? "vec2"
                     : u->type == BTF_UNIFORM_VEC3 ? "vec3"
                     : u->type == BTF_UNIFORM_VEC4 ? "vec4"
                     : u->type == BTF_UNIFORM_INT  ? "int"
                                                   : "ivec4";
  btfi_put_text(out, "  %s %s", type, u->name);
  if (u->count > 1) btfi_put_text(out, "[%u]", (unsigned)u->count);
  btfi_put_text(out, ";\n");
}

static void put_declarations(const btf_gpu_builder *b, btfi_buffer *out) {
  for (uint32_t i = 0; i < b->texture_count; i++)
    btfi_put_text(out, "BTF_BINDING(%u) uniform BTF_HIGHP %s %s;\n", (unsigned)i + 1,
                  sampler_of(b->texture[i].dimension), b->texture[i].name);
  btfi_put_text(out, "BTF_BLOCK(0) uniform btf_uniforms {\n");
  for (uint32_t i = 0; i < b->uniform_count; i++) put_uniform(&b->uniform[i], out);
  btfi_put_text(out, "};\n");
}

void btfi_gpu_put_glsl(const btf_gpu_builder *b, uint32_t wrap, uint32_t channels, bool divide,
                       btfi_buffer *out) {
  btfi_put_text(out, "%s", head);
  put_declarations(b, out);
  btfi_put_text(out, "%s",
                wrap == BTF_WRAP_CLAMP ? "#define BTF_WRAPPED(u) clamp(u, 0.0, 1.0)\n"
                                         "#define BTF_WRAP(i, size) clamp(i, ivec2(0), ivec2(size - 1))\n"
                                       : "#define BTF_WRAPPED(u) fract(u)\n"
                                         "#define BTF_WRAP(i, size) ((i + size) % size)\n");
  btfi_put_text(out, "%s%s%s%s", finite, directions, powers, texels);
  btfi_gpu_put_accessors(b, out);
  btfi_put_bytes(out, b->search.data, b->search.size);
  btfi_put_bytes(out, b->source.data, b->source.size);
  btfi_put_text(
      out,
      "vec3 btf_eval(vec3 light, vec3 view, vec2 uv, float lod) {\n"
      "  if (!(light.z > 0.0 && view.z > 0.0)) return vec3(0.0);\n"
      "  if (!all(btf_finite(light)) || !all(btf_finite(view)) || !all(btf_finite(vec3(uv, lod))))\n"
      "    return vec3(0.0);\n"
      "  vec3 f = btf_stored(light, view, uv, lod)%s;\n"
      "  f = mix(vec3(0.0), f, btf_finite(f));\n"
      "  return %s;\n}\n",
      divide ? " / max(light.z, 0.02)" : "",
      channels == 1   ? "f.xxx"
      : channels == 2 ? "vec3(f.xy, 0.0)"
                      : "f");
}
