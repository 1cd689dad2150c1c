/* SPDX-License-Identifier: MIT */
#include "test_lobes.h"

#include "model/model.h"
#include "registry/registry.h"

static uint64_t random_state = 1;

double test_random(void) {
  random_state = random_state * 6364136223846793005u + 1442695040888963407u;
  return (double)(random_state >> 40) * (1.0 / (1 << 24));
}

void test_seed(uint64_t seed) {
  random_state = seed;
}

void test_random_direction(float d[3]) {
  const double phi = 6.2831853 * test_random(), z = 0.02 + 0.98 * test_random(), r = sqrt(1.0 - z * z);
  d[0] = (float)(r * cos(phi));
  d[1] = (float)(r * sin(phi));
  d[2] = (float)z;
}

/* ---- the models ---- */

double planted_lobe(uint32_t kind, const double *shape, const float *light, const float *view) {
  const double pi = 3.14159265358979323846;
  const double l[3] = {(double)light[0], (double)light[1], (double)light[2]},
               v[3] = {(double)view[0], (double)view[1], (double)view[2]};
  const double mirror = v[2] * l[2] - v[0] * l[0] - v[1] * l[1];
  const double half[3] = {l[0] + v[0], l[1] + v[1], l[2] + v[2]};
  const double length = sqrt(half[0] * half[0] + half[1] * half[1] + half[2] * half[2]);
  double base = 0.0;
  switch (kind) {
  case LAF_DIAGONAL:
    for (int i = 0; i < 3; i++) base += shape[i] * v[i] * l[i];
    return base > 0.0 ? pow(base, shape[3]) : 0.0;
  case LAF_FULL:
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) base += shape[3 * i + j] * v[i] * l[j];
    return base > 0.0 ? pow(base, shape[9]) : 0.0;
  case LAF_PHONG:
    return mirror > 0.0 ? pow(mirror, shape[0]) / fmax(l[2], 0.02) : 0.0;
  case LAF_BLINN_PHONG:
    return pow(half[2] / length, shape[0]) / fmax(l[2], 0.02);
  case LAF_WARD: {
    const double x = half[0] / half[2] / shape[0], y = half[1] / half[2] / shape[1];
    return exp(-(x * x + y * y)) / (4.0 * pi * shape[0] * shape[1] * sqrt(l[2] * v[2]));
  }
  default:
    return mirror > 0.0 ? (shape[0] + 2.0) / (2.0 * pi) * pow(mirror, shape[0]) : 0.0;
  }
}

double planted_value(const planted *p, uint32_t channel, const float *light, const float *view) {
  double value = p->albedo[0][channel];
  for (uint32_t j = 0; j < p->lobes; j++)
    value += p->albedo[1 + j][channel] * planted_lobe(p->kind, p->shape[j], light, view);
  return value;
}

/* ---- single ABRDFs ---- */

static btf_dirset *create_directions(btf_context *ctx, const char *name) {
  btf_dirset *set;
  if (strcmp(name, "one") == 0) {
    const float up[3] = {0.0f, 0.0f, 1.0f};
    assert_ok(btf_dirset_create(ctx, up, 1, &set));
  } else {
    assert_ok(btf_dirset_create_named(ctx, name, &set));
  }
  return set;
}

abrdf abrdf_create(btf_context *ctx, const char *directions, uint32_t channels) {
  abrdf a = {.channels = channels};
  a.directions = create_directions(ctx, directions);
  a.count = btf_dirset_count(a.directions);
  a.xyz = btf_dirset_directions(a.directions);
  a.values = malloc((size_t)a.count * a.count * channels * sizeof *a.values);
  assert_non_null(a.values);
  return a;
}

void abrdf_fill(abrdf *a, const planted *p, double noise) {
  for (uint32_t v = 0; v < a->count; v++)
    for (uint32_t l = 0; l < a->count; l++)
      for (uint32_t c = 0; c < a->channels; c++)
        a->values[((size_t)v * a->count + l) * a->channels + c] =
            (float)(planted_value(p, c, a->xyz + 3 * l, a->xyz + 3 * v) +
                    noise * (2.0 * test_random() - 1.0));
}

void abrdf_release(abrdf *a) {
  btf_dirset_release(a->directions);
  free(a->values);
}

fitter fitter_create(btf_context *ctx, const abrdf *a, uint32_t kind, uint32_t weights, uint32_t lobes,
                     uint32_t quantity) {
  fitter f = {.ctx = ctx};
  f.settings = (btfi_lafortune_settings){lobes, 3, 60, 1e-6};
  f.shared = calloc(1, sizeof *f.shared);
  assert_non_null(f.shared);
  assert_ok(btfi_lafortune_shared_create(btfi_host(), ctx, kind, quantity, weights, a->xyz, a->count, a->xyz,
                                         a->count, f.shared));
  assert_int_equal(posix_memalign(&f.memory, 64, btfi_lafortune_scratch_bytes(f.shared, lobes, a->channels)),
                   0);
  f.scratch = btfi_lafortune_scratch_init(f.memory, f.shared, lobes, a->channels);
  return f;
}

void fitter_release(fitter *f) {
  btfi_lafortune_shared_free(btfi_host(), f->ctx, f->shared);
  free(f->shared);
  free(f->memory);
}

/* ---- data sets ---- */

static size_t sample_index(const material *m, uint32_t x, uint32_t y, uint32_t light, uint32_t view,
                           uint32_t channel) {
  return ((((size_t)y * m->width + x) * m->count + view) * m->count + light) * m->channels + channel;
}

float material_sample(const material *m, uint32_t x, uint32_t y, uint32_t light, uint32_t view,
                      uint32_t channel) {
  return m->samples[sample_index(m, x, y, light, view, channel)];
}

void plant_two_lobes(uint32_t x, uint32_t y, planted *out) {
  const double u = sin(0.7 * x) * 0.5 + 0.5, v = cos(0.9 * y) * 0.5 + 0.5;
  const planted p = {LAF_DIAGONAL,
                     2,
                     3,
                     {{-1.0, -0.9 - 0.1 * u, 1.0, 12.0 + 10.0 * v}, {0.4 * u, 0.4, 1.0, 1.5 + u}},
                     {{0.1 + 0.2 * u, 0.2, 0.3 * v + 0.05, 0.1, 0.1, 0.1, 0.1, 0.1},
                      {0.7, 0.6 - 0.2 * v, 0.4, 0.3, 0.2, 0.1, 0.1, 0.1},
                      {0.2, 0.3, 0.2 + 0.1 * u, 0.3, 0.2, 0.1, 0.1, 0.1}}};
  *out = p;
}

material material_create(btf_context *ctx, plant_fn plant, double noise, const char *directions,
                         uint32_t width, uint32_t height, uint32_t channels, uint32_t quantity,
                         uint32_t wrap) {
  material m = {.width = width, .height = height, .channels = channels};
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  m.directions = create_directions(ctx, directions);
  m.count = btf_dirset_count(m.directions);
  const float *xyz = btf_dirset_directions(m.directions);
  m.samples = malloc((size_t)m.count * m.count * channels * width * height * sizeof *m.samples);
  assert_non_null(m.samples);
  for (uint32_t y = 0; y < height; y++)
    for (uint32_t x = 0; x < width; x++) {
      planted p;
      plant(x, y, &p);
      for (uint32_t v = 0; v < m.count; v++)
        for (uint32_t l = 0; l < m.count; l++)
          for (uint32_t c = 0; c < channels; c++) {
            const double f =
                planted_value(&p, c % 8, xyz + 3 * l, xyz + 3 * v) + noise * (2.0 * test_random() - 1.0);
            m.samples[sample_index(&m, x, y, l, v, c)] =
                (float)(quantity == BTF_QUANTITY_BRDF_COS ? f * (double)xyz[3 * l + 2] : f);
          }
    }
  const ptrdiff_t value = sizeof(float), light = value * channels, view = light * m.count,
                  texel = view * m.count;
  desc.lights = desc.views = m.directions;
  desc.width = width;
  desc.height = height;
  desc.channels = channels;
  desc.quantity = quantity;
  desc.wrap = wrap;
  desc.data = desc.user = m.samples;
  desc.release = free;
  desc.strides = (btf_strides){view, light, texel * width, texel, value};
  assert_ok(btf_dataset_create(ctx, &desc, &m.ds));
  return m;
}

void material_release(material *m) {
  btf_dataset_release(m->ds);
  btf_dirset_release(m->directions);
}

double material_energy(const material *m) {
  const size_t n = (size_t)m->count * m->count * m->channels * m->width * m->height;
  double energy = 0.0;
  for (size_t i = 0; i < n; i++) energy += (double)m->samples[i] * (double)m->samples[i];
  return energy;
}

/* ---- fits ---- */

btf_status lafortune_try_fit(btf_context *ctx, const btf_dataset *ds, const char *settings,
                             const btf_job *job, btf_model **out) {
  return suite_try_fit(ctx, "lafortune", ds, settings, job, out);
}

btf_model *lafortune_fit(btf_context *ctx, const material *m, const char *settings) {
  return suite_fit(ctx, "lafortune", m->ds, settings);
}

double lafortune_squared_error(const btf_model *model, const material *m) {
  double error = 0.0;
  float out[64];
  for (uint32_t y = 0; y < m->height; y++)
    for (uint32_t x = 0; x < m->width; x++)
      for (uint32_t view = 0; view < m->count; view++)
        for (uint32_t light = 0; light < m->count; light++) {
          btf_model_texel(model, 0, x, y, light, view, out);
          for (uint32_t c = 0; c < m->channels; c++) {
            const double left = (double)out[c] - (double)material_sample(m, x, y, light, view, c);
            error += left * left;
          }
        }
  return error;
}

const btfi_lafortune_state *lafortune_state(const btf_model *model) {
  return model->state;
}
