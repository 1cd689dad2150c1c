/* SPDX-License-Identifier: MIT */
/* svd_material.c: every texel has a height, a normal, a diffuse colour, a gloss lobe, a soft mask and a fuzz
 * term. Relief shifts what a view sees of the texture and casts shadows, which gives singular values that
 * fall off as slowly as those of measured materials do. */
#include "svd_material.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct texel_optics {
  float normal[3], diffuse[3], gloss[3];
  float exponent, mask, fuzz, height;
  float mirror[3]; /* normal of a facet that only rare texels have; length 0 without */
  float flare;     /* gain at the special direction pairs */
} texel_optics;

typedef struct material {
  int kind;
  uint32_t size, lights;
  const float *light, *view;
  texel_optics *texel;
  float *image; /* lights x size x size x 3 of one view */
  uint32_t view_index;
} material;

static uint32_t mix_bits(uint32_t x) {
  x ^= x >> 16;
  x *= 0x7feb352du;
  x ^= x >> 15;
  x *= 0x846ca68bu;
  return x ^ x >> 16;
}

/* Uniform in -1..1. */
static float noise_of(uint32_t a, uint32_t b, uint32_t c) {
  return (float)(mix_bits(a + mix_bits(b + mix_bits(c))) >> 8) * (2.0f / 16777216.0f) - 1;
}

static void normalise(float v[3]) {
  const float length = sqrtf(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
  for (int k = 0; k < 3; k++) v[k] /= length;
}

static float dot3(const float *a, const float *b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Periodic sum of waves, some octaves of them; `which` picks the field. */
static float field(uint32_t which, float u, float v, int octaves) {
  float sum = 0, weight = 1;
  for (int octave = 0; octave < octaves; octave++, weight *= 0.62f) {
    for (uint32_t k = 0; k < 3; k++) {
      const uint32_t id = which * 97 + (uint32_t)octave * 7 + k;
      const float fu = floorf(noise_of(id, 1, 0) * 3 * (float)(1 << octave));
      const float fv = floorf(noise_of(id, 2, 0) * 3 * (float)(1 << octave)) + 1;
      sum += weight * sinf(6.2831853f * (fu * u + fv * v) + 3 * noise_of(id, 3, 0));
    }
  }
  return sum / 3;
}

static void shade_texel(const material *m, uint32_t x, uint32_t y, texel_optics *t) {
  const float u = ((float)x + 0.5f) / (float)m->size, v = ((float)y + 0.5f) / (float)m->size;
  memset(t, 0, sizeof *t);
  t->normal[0] = 0.35f * field(1, u, v, 5);
  t->normal[1] = 0.35f * field(2, u, v, 5);
  t->normal[2] = 1;
  normalise(t->normal);
  for (uint32_t c = 0; c < 3; c++) {
    t->diffuse[c] = 0.25f + 0.12f * field(3, u, v, 6) + 0.05f * field(4 + c, u, v, 6);
    t->gloss[c] = fmaxf(0.02f, 0.25f + 0.2f * field(7, u, v, 5) + 0.02f * field(8 + c, u, v, 3));
  }
  t->exponent = expf(2.6f + 0.9f * field(11, u, v, 4));
  t->mask = 0.5f + 0.4f * field(12, u, v, 5);
  t->fuzz = 0.05f + 0.05f * field(13, u, v, 6);
  t->height = field(14, u, v, 6);
  t->flare = fmaxf(0, noise_of(x, y, 77));
  if (m->kind == MATERIAL_SMOOTH) return;
  /* One texel in three thousand or so, in six kinds, shows a mirror that is tilted its own way. */
  const uint32_t draw = mix_bits(x + 4096 * y + 12345) % 3000;
  if (draw != 0) return;
  const uint32_t which = mix_bits(x * 31 + y) % 6;
  t->mirror[0] = 0.5f * cosf((float)which);
  t->mirror[1] = 0.5f * sinf((float)which * 2.1f);
  t->mirror[2] = 1;
  normalise(t->mirror);
}

/* A dozen pairs of the 81 x 81 where the sheen of single fibres flashes up. */
static float flare_of(const material *m, uint32_t light) {
  if (m->kind == MATERIAL_SMOOTH) return 0;
  return mix_bits(m->view_index * 8192 + light + 777) % 500 == 0 ? 3.0f : 0;
}

/* The texel that lies `rise` heights along a direction from this one, round the periodic texture. */
static const texel_optics *texel_along(const material *m, uint32_t x, uint32_t y, const float *direction,
                                       float rise) {
  const float reach = rise / fmaxf(direction[2], 0.25f) * (float)m->size / 256;
  const uint32_t tx = (uint32_t)((int)(x + m->size) + (int)lrintf(direction[0] * reach)) % m->size;
  const uint32_t ty = (uint32_t)((int)(y + m->size) + (int)lrintf(direction[1] * reach)) % m->size;
  return m->texel + (size_t)ty * m->size + tx;
}

static void shade_light(const material *m, uint32_t light) {
  const float *l = m->light + 3 * (size_t)light, *v = m->view + 3 * (size_t)m->view_index;
  const size_t texels = (size_t)m->size * m->size;
  float half[3] = {l[0] + v[0], l[1] + v[1], l[2] + v[2]};
  normalise(half);
  const float grazing = powf(1 - v[2], 3), flare = flare_of(m, light);
  const float shade = 0.6f * (2 - l[2] - v[2]);
  float *out = m->image + texels * 3 * light;
  for (size_t t = 0; t < texels; t++, out += 3) {
    const uint32_t x = (uint32_t)(t % m->size), y = (uint32_t)(t / m->size);
    const texel_optics *here = m->texel + t, *o = texel_along(m, x, y, v, 1.5f * here->height);
    const float over = texel_along(m, x, y, l, 2)->height - here->height - 0.4f * l[2];
    const float lit = 1 / (1 + expf(fminf(8 * over, 60)));
    const float lambert = fmaxf(0, dot3(o->normal, l)), facing = fmaxf(0, dot3(o->normal, half));
    const float lobe = exp2f(o->exponent * log2f(fmaxf(facing, 1e-4f)));
    const float seen = 1 / (1 + o->mask * shade * shade);
    float extra = o->fuzz * grazing + flare * here->flare;
    if (here->mirror[2] > 0) {
      const float at = fmaxf(0, dot3(here->mirror, half));
      extra += 12 * powf(at, 250);
    }
    for (int c = 0; c < 3; c++) {
      float value = (o->diffuse[c] * lambert + o->gloss[c] * lobe) * seen * lit + extra;
      if (m->kind == MATERIAL_NOISY)
        value *= 1 + 0.01f * noise_of((uint32_t)t * 3 + (uint32_t)c, light, m->view_index);
      out[c] = fmaxf(0, value);
    }
  }
}

btf_status material_write(btf_context *ctx, const char *folder, int kind, uint32_t size,
                          const char *directions) {
  btf_dirset *set = NULL;
  btf_status status = btf_dirset_create_named(ctx, directions, &set);
  if (status != BTF_OK) return status;
  material m = {
      kind, size, btf_dirset_count(set), btf_dirset_directions(set), btf_dirset_directions(set), NULL,
      NULL, 0};
  const size_t texels = (size_t)size * size;
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  desc.lights = desc.views = set;
  desc.width = desc.height = size;
  desc.channels = 3;
  desc.sample_type = BTF_SAMPLE_F16;
  desc.quantity = BTF_QUANTITY_BRDF_COS;
  desc.name = "bench_svd";
  btf_dataset_writer *writer = NULL;
  m.texel = malloc(texels * sizeof *m.texel);
  m.image = malloc(texels * 3 * m.lights * sizeof(float));
  if (m.texel == NULL || m.image == NULL) status = BTF_E_NOMEM;
  if (status == BTF_OK) status = btf_dataset_writer_create(ctx, folder, &desc, BTF_ORDER_VLYXC, &writer);
  for (uint32_t t = 0; status == BTF_OK && t < texels; t++) shade_texel(&m, t % size, t / size, m.texel + t);
  for (m.view_index = 0; status == BTF_OK && m.view_index < m.lights; m.view_index++) {
    const btf_block block = {m.view_index, 1, 0, m.lights, 0, 0, size, size};
    const ptrdiff_t pixel = 3 * sizeof(float), image = pixel * (ptrdiff_t)texels;
    const btf_strides strides = {image * (ptrdiff_t)m.lights, image, pixel * (ptrdiff_t)size, pixel,
                                 sizeof(float)};
#ifdef _OPENMP
#pragma omp parallel for schedule(dynamic)
#endif
    for (uint32_t light = 0; light < m.lights; light++) shade_light(&m, light);
    status = btf_dataset_writer_put(writer, &block, m.image, &strides);
    fprintf(stderr, "\rbench_svd: writing %s: view %u of %u", folder, m.view_index + 1, m.lights);
  }
  fprintf(stderr, "\n");
  if (writer != NULL) {
    if (status == BTF_OK)
      status = btf_dataset_writer_finish(writer);
    else
      btf_dataset_writer_abort(writer);
  }
  free(m.texel);
  free(m.image);
  btf_dirset_release(set);
  return status;
}
