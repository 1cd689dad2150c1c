/* SPDX-License-Identifier: MIT */
#include "test_cmf_fits.h"

static uint64_t random_state = 1;

float cmf_draw(void) {
  return (float)btf_random_unit(&random_state);
}

void cmf_draw_direction(float d[3]) {
  const float z = cmf_draw(), phi = 6.2831853f * cmf_draw(), r = sqrtf(1.0f - z * z);
  d[0] = r * cosf(phi);
  d[1] = r * sinf(phi);
  d[2] = z;
}

const char *const cmf_cases[CMF_CASES] = {
    "codebook=8 levels=0",
    "codebook=0 storage=f16 chain=hd:2,io:2 resolution=6 sweeps=0",
    "codebook=300 storage=f32 method=nonnegative chain=h,io:2 cluster=tree",
    "codebook=6 rotate=1 factors=4 resolution=6 storage=f16 cluster=mediancut",
    "codebook=0 method=homomorphic edge=12",
    "codebook=12 map=cube edge=32",
    "codebook=0 map=cube edge=16 factors=4 resolution=6 rotate=1 storage=f32 sweeps=0",
    "codebook=5 edge=9 average=uniform grid=parabolic residue=ratio symmetric=1 chain=h,io samples=20",
};

void cmf_case_with(size_t index, const char *of_stages, const char *others, char *text, size_t size) {
  const bool homomorphic = strstr(cmf_cases[index], "homomorphic") != NULL;
  snprintf(text, size, "%s %s %s", cmf_cases[index], homomorphic ? "" : of_stages, others);
}

/* A tilted glossy facet with a dark side and a side that is hidden. */
static float facet(const float n[3], float hidden, const float l[3], const float v[3], uint32_t c) {
  float h[3];
  btfi_cmf_half(l, v, h);
  const float nl = fmaxf(0.0f, n[0] * l[0] + n[1] * l[1] + n[2] * l[2]);
  const float nh = fmaxf(0.0f, n[0] * h[0] + n[1] * h[1] + n[2] * h[2]);
  const float seen = 1.0f / (1.0f + expf(-hidden * (n[0] * v[0] + n[1] * v[1] + 0.2f)));
  return seen * (0.1f + 0.2f * (float)(c % 3)) * nl / fmaxf(l[2], 0.1f) + seen * powf(nh, 24.0f) + 0.002f;
}

static float value_of(int kind, uint32_t x, uint32_t y, const float l[3], const float v[3], uint32_t c) {
  if (kind == ZERO) return 0.0f;
  if (kind == CONSTANT) return 0.1f + 0.07f * (float)c;
  float tilt = 0.15f + 0.5f * (float)((3 * x + 5 * y) % 16) / 16.0f, turn = 0.7f * (float)(x + 3 * y % 7);
  float hidden = 4.0f + (float)(x % 3);
  if (kind == ROTATED) { /* four facets, each turned by a random angle */
    uint64_t state = 977u * y + x;
    const uint32_t prototype = (x + y) % 4;
    tilt = 0.3f + 0.12f * (float)prototype;
    hidden = 2.0f + 2.0f * (float)prototype;
    turn = 6.2831853f * (float)btf_random_unit(&state);
  }
  const float n[3] = {sinf(tilt) * cosf(turn), sinf(tilt) * sinf(turn), cosf(tilt)};
  return facet(n, hidden, l, v, c);
}

material material_create(btf_context *ctx, int kind, const char *directions, uint32_t width, uint32_t height,
                         uint32_t channels) {
  material m = {.width = width, .height = height, .channels = channels};
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  const float up[3] = {0.0f, 0.0f, 1.0f};
  if (strcmp(directions, "one") == 0)
    assert_ok(btf_dirset_create(ctx, up, 1, &m.set));
  else
    assert_ok(btf_dirset_create_named(ctx, directions, &m.set));
  m.count = btf_dirset_count(m.set);
  m.samples = malloc((size_t)m.count * m.count * channels * width * height * sizeof *m.samples);
  const float *xyz = btf_dirset_directions(m.set);
  size_t i = 0;
  for (uint32_t y = 0; y < height; y++)
    for (uint32_t x = 0; x < width; x++)
      for (uint32_t v = 0; v < m.count; v++)
        for (uint32_t l = 0; l < m.count; l++)
          for (uint32_t c = 0; c < channels; c++)
            m.samples[i++] = value_of(kind, x, y, xyz + 3 * l, xyz + 3 * v, c);
  const ptrdiff_t pixel = (ptrdiff_t)(sizeof(float) * channels), abrdf = pixel * m.count * m.count;
  desc.lights = desc.views = m.set;
  desc.width = width;
  desc.height = height;
  desc.channels = channels;
  desc.data = desc.user = m.samples;
  desc.release = free;
  desc.strides = (btf_strides){pixel * m.count, pixel, abrdf * width, abrdf, sizeof(float)};
  assert_ok(btf_dataset_create(ctx, &desc, &m.ds));
  return m;
}

void material_release(material *m) {
  btf_dataset_release(m->ds);
  btf_dirset_release(m->set);
}

btf_status cmf_try_fit(btf_context *ctx, const material *m, const char *settings, const btf_job *job,
                       btf_model **out) {
  return suite_try_fit(ctx, "cmf", m->ds, settings, job, out);
}

btf_model *cmf_fit(btf_context *ctx, const material *m, const char *settings) {
  return suite_fit(ctx, "cmf", m->ds, settings);
}

double sample_count(const material *m) {
  return (double)m->count * m->count * m->channels * m->width * m->height;
}

double squared_error(const btf_model *model, const material *m) {
  double error = 0.0;
  size_t i = 0;
  for (uint32_t y = 0; y < m->height; y++)
    for (uint32_t x = 0; x < m->width; x++)
      for (uint32_t v = 0; v < m->count; v++)
        for (uint32_t l = 0; l < m->count; l++) {
          float out[64];
          btf_model_texel(model, 0, x, y, l, v, out);
          for (uint32_t c = 0; c < m->channels; c++, i++) {
            assert_true(isfinite(out[c]));
            const double d = (double)out[c] - (double)m->samples[i];
            error += d * d;
          }
        }
  return error;
}

double relative_error(const btf_model *model, const material *m) {
  const size_t n = (size_t)m->count * m->count * m->channels * m->width * m->height;
  double energy = 0.0;
  for (size_t i = 0; i < n; i++) energy += (double)m->samples[i] * (double)m->samples[i];
  return sqrt(squared_error(model, m) / energy);
}
