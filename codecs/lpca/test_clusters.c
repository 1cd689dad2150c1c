/* SPDX-License-Identifier: MIT */
#include "test_clusters.h"

double material_row(const material *m, uint32_t texel, uint32_t row) {
  const uint32_t c = row % m->channels, pair = row / m->channels;
  return material_sample(m, texel % m->width, texel / m->width, pair % m->count, pair / m->count, c);
}

static void set_row(material *m, uint32_t texel, uint32_t row, float value) {
  const size_t texels = (size_t)m->width * m->height;
  m->samples[((size_t)(row / m->channels) * texels + texel) * m->channels + row % m->channels] = value;
}

/* A kind of its own for every `kind`: a lobe and a colour that vary from texel to texel in two ways. */
static float lobe(uint32_t kind, const float *traits, const float *light, const float *view,
                  uint32_t channel) {
  const float tilt = 0.3f * (float)(kind % 3) - 0.3f + 0.2f * traits[0],
              turn = 0.3f * (float)(kind / 3) - 0.2f;
  float cosine = light[2], along = 0.0f;
  const float axis[3] = {tilt, turn + 0.2f * traits[1], 1.0f};
  for (int i = 0; i < 3; i++) along += axis[i] * (light[i] + view[i]);
  along /= 2.2f;
  return cosine * (0.2f + 0.1f * (float)((kind + channel) % 3) + 0.2f * traits[2]) +
         powf(fmaxf(0.0f, along), 4.0f + 6.0f * (float)(kind % 4)) * (0.5f + 0.5f * traits[3]);
}

material material_of(btf_context *ctx, int kind, const char *directions, uint32_t width, uint32_t height) {
  material m = material_create(ctx, kind >= MATERIAL_TWO_CLOTHS ? MATERIAL_CONSTANT : kind, directions, width,
                               height, 3, true, BTF_WRAP_PERIODIC);
  const float *xyz = btf_dirset_directions(m.directions);
  if (kind < MATERIAL_TWO_CLOTHS) return m;
  for (uint32_t t = 0; t < width * height; t++) {
    const uint32_t x = t % width, y = t / width;
    const uint32_t of = kind == MATERIAL_CHECKS ? (x / 4 + 3 * (y / 4)) % 6 : (x + y) / 3 % 2;
    float traits[4];
    for (int i = 0; i < 4; i++) traits[i] = test_random();
    for (uint32_t row = 0; row < m.count * m.count * 3; row++) {
      const float *light = xyz + 3 * (row / 3 % m.count), *view = xyz + 3 * (row / 3 / m.count);
      set_row(&m, t, row,
              lobe(of, traits, light, view, row % 3) +
                  (kind == MATERIAL_TWO_CLOTHS ? 0.01f * test_random() : 0.0f));
    }
  }
  return m;
}

material planted_material(btf_context *ctx, uint32_t width, uint32_t height, uint32_t clusters,
                          uint32_t dimensions) {
  material m = material_create(ctx, MATERIAL_CONSTANT, "grid:4x2", width, height, 3, true, BTF_WRAP_PERIODIC);
  const uint32_t rows = m.count * m.count * 3;
  float *basis = malloc((size_t)clusters * (dimensions + 1) * rows * sizeof *basis);
  for (uint32_t i = 0; i < clusters * (dimensions + 1) * rows; i++) basis[i] = test_random() - 0.5f;
  for (uint32_t t = 0; t < width * height; t++) {
    const float *of = basis + (size_t)(t % clusters) * (dimensions + 1) * rows;
    float weight[16];
    for (uint32_t j = 0; j < dimensions; j++) weight[j] = 2.0f * test_random() - 1.0f;
    for (uint32_t row = 0; row < rows; row++) {
      float value = 2.0f + 2.0f * of[row];
      for (uint32_t j = 0; j < dimensions; j++) value += weight[j] * of[(j + 1) * rows + row];
      set_row(&m, t, row, value);
    }
  }
  free(basis);
  return m;
}

btf_status lpca_try_fit(btf_context *ctx, const btf_dataset *ds, const char *settings, const btf_job *job,
                        btf_model **out) {
  return suite_try_fit(ctx, "lpca", ds, settings, job, out);
}

btf_model *lpca_fit(btf_context *ctx, const material *m, const char *settings) {
  return suite_fit(ctx, "lpca", m->ds, settings);
}

double model_squared_error(const btf_model *model, const material *m) {
  return fmf_squared_error(model, m);
}

const btfi_lpca_state *lpca_state(const btf_model *model) {
  return model->state;
}

uint32_t lpca_label(const btfi_lpca_state *s, uint32_t level, uint32_t texel) {
  const unsigned char *index = s->index[level] + (size_t)texel * s->layout.index_bytes;
  return s->layout.index_bytes == 1 ? index[0] : index[0] | (uint32_t)index[1] << 8;
}
