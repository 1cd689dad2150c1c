/* SPDX-License-Identifier: MIT */
#include "test_views.h"

#include "model/model.h"

btf_status pvpca_try_fit(btf_context *ctx, const btf_dataset *ds, const char *settings, const btf_job *job,
                         btf_model **out) {
  return suite_try_fit(ctx, "pvpca", ds, settings, job, out);
}

btf_model *pvpca_fit(btf_context *ctx, const material *m, const char *settings) {
  return suite_fit(ctx, "pvpca", m->ds, settings);
}

const btfi_pvpca_state *pvpca_state(const btf_model *model) {
  return model->state;
}

double pvpca_view_error(const btf_model *model, const material *m, uint32_t view) {
  double error = 0.0;
  float out[64];
  for (uint32_t light = 0; light < m->count; light++)
    for (uint32_t y = 0; y < m->height; y++)
      for (uint32_t x = 0; x < m->width; x++) {
        btf_model_texel(model, 0, x, y, light, view, out);
        for (uint32_t c = 0; c < m->channels; c++) {
          const double difference = (double)out[c] - material_sample(m, x, y, light, view, c);
          error += difference * difference;
        }
      }
  return error;
}

material relief_create(btf_context *ctx, const char *directions, uint32_t side, uint32_t channels) {
  material m =
      material_create(ctx, MATERIAL_CONSTANT, directions, side, side, channels, true, BTF_WRAP_PERIODIC);
  const float *xyz = btf_dirset_directions(m.directions);
  float *value = m.samples;
  for (uint32_t view = 0; view < m.count; view++) {
    const float *v = xyz + 3 * (size_t)view;
    for (uint32_t light = 0; light < m.count; light++) {
      const float *l = xyz + 3 * (size_t)light;
      for (uint32_t y = 0; y < side; y++)
        for (uint32_t x = 0; x < side; x++) {
          const float step = 6.2831853f / (float)side;
          const float px = (float)x * step - v[0] / (v[2] + 0.2f),
                      py = (float)y * step - v[1] / (v[2] + 0.2f);
          const float height = sinf(px) * sinf(2.0f * py) + 0.5f * cosf(3.0f * px + py);
          const float nx = 0.5f * cosf(px) * sinf(2.0f * py), ny = sinf(px) * cosf(2.0f * py);
          const float cosine = fmaxf(0.0f, l[2] - nx * l[0] - ny * l[1]);
          const float shadow = 0.5f + 0.4f * tanhf(3.0f * (height + 2.0f * l[2] - 1.0f));
          for (uint32_t c = 0; c < channels; c++)
            *value++ = cosine * shadow * (0.6f + 0.3f * sinf(height * 2.0f + (float)c)) +
                       0.2f * powf(fmaxf(0.0f, l[2] * v[2]), 4.0f) * (0.5f + 0.5f * sinf(px * 2.0f));
        }
    }
  }
  return m;
}
