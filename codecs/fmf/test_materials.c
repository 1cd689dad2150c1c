/* SPDX-License-Identifier: MIT */
#include "test_materials.h"

#include "model/model.h"

static uint64_t random_state = 1;

float test_random(void) {
  random_state = random_state * 6364136223846793005u + 1442695040888963407u;
  return (float)(random_state >> 40) * (1.0f / (1 << 24));
}

void test_random_direction(float d[3]) {
  const float phi = 6.2831853f * test_random();
  d[2] = 0.02f + 0.98f * test_random();
  const float r = sqrtf(1.0f - d[2] * d[2]);
  d[0] = r * cosf(phi);
  d[1] = r * sinf(phi);
}

/* A texel of a bumpy glossy surface: slope, gloss, strength, albedo and tint. */
static float glossy(const float *t, const float *light, const float *view, uint32_t channel) {
  const float nx = (t[0] - 0.5f) * 0.6f, ny = (t[1] - 0.5f) * 0.6f,
              inverse = 1.0f / sqrtf(1.0f + nx * nx + ny * ny);
  float half[3], length = 0.0f;
  for (int k = 0; k < 3; k++) {
    half[k] = light[k] + view[k];
    length += half[k] * half[k];
  }
  const float cosine = fmaxf(0.0f, (nx * light[0] + ny * light[1] + light[2]) * inverse);
  const float along = fmaxf(0.0f, (nx * half[0] + ny * half[1] + half[2]) * inverse / sqrtf(length));
  return cosine * (0.3f + 0.2f * t[4] + 0.1f * (float)channel * t[5]) +
         powf(along, 10.0f + 30.0f * t[2]) * 0.8f * t[3];
}

static size_t sample_index(const material *m, uint32_t x, uint32_t y, uint32_t light, uint32_t view,
                           uint32_t channel) {
  const size_t texel = (size_t)y * m->width + x, pair = (size_t)view * m->count + light;
  const size_t texels = (size_t)m->width * m->height, pairs = (size_t)m->count * m->count;
  return m->image_major ? (pair * texels + texel) * m->channels + channel
                        : (texel * pairs + pair) * m->channels + channel;
}

float material_sample(const material *m, uint32_t x, uint32_t y, uint32_t light, uint32_t view,
                      uint32_t channel) {
  return m->samples[sample_index(m, x, y, light, view, channel)];
}

enum { TRAITS = 6, RANK = 5 };

static void fill_samples(material *m, int kind) {
  const float *xyz = btf_dirset_directions(m->directions);
  const size_t texels = (size_t)m->width * m->height, rows = (size_t)m->count * m->count * m->channels;
  float *traits = malloc(texels * TRAITS * sizeof *traits), *factor = malloc(rows * RANK * sizeof *factor);
  for (size_t i = 0; i < texels * TRAITS; i++) traits[i] = test_random();
  for (size_t i = 0; i < rows * RANK; i++) factor[i] = test_random() - 0.3f;
  for (uint32_t view = 0; view < m->count; view++) {
    for (uint32_t light = 0; light < m->count; light++) {
      for (size_t texel = 0; texel < texels; texel++) {
        const uint32_t x = (uint32_t)(texel % m->width), y = (uint32_t)(texel / m->width);
        const float *t = traits + texel * TRAITS;
        for (uint32_t c = 0; c < m->channels; c++) {
          const float *row = factor + (((size_t)view * m->count + light) * m->channels + c) * RANK;
          float value = 0.0f;
          if (kind == MATERIAL_GLOSSY) value = glossy(t, xyz + 3 * light, xyz + 3 * view, c);
          for (int k = 0; kind == MATERIAL_RANK_5 && k < RANK; k++) value += row[k] * t[k];
          if (kind == MATERIAL_CONSTANT) value = 0.1f + 0.07f * (float)c;
          if (kind == MATERIAL_TEXTURED_LAMBERT)
            value = (0.1f + 0.07f * (float)c) * (0.2f + t[0]) * xyz[3 * light + 2];
          m->samples[sample_index(m, x, y, light, view, c)] = value;
        }
      }
    }
  }
  free(traits);
  free(factor);
}

material material_create(btf_context *ctx, int kind, const char *directions, uint32_t width, uint32_t height,
                         uint32_t channels, bool image_major, uint32_t wrap) {
  material m = {.width = width, .height = height, .channels = channels, .image_major = image_major};
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  random_state = 1;
  if (strcmp(directions, "one") == 0) {
    const float up[3] = {0.0f, 0.0f, 1.0f};
    assert_ok(btf_dirset_create(ctx, up, 1, &m.directions));
  } else {
    assert_ok(btf_dirset_create_named(ctx, directions, &m.directions));
  }
  m.count = btf_dirset_count(m.directions);
  m.samples = malloc((size_t)m.count * m.count * channels * width * height * sizeof *m.samples);
  assert_non_null(m.samples);
  fill_samples(&m, kind);
  const ptrdiff_t value = sizeof(float), pixel = value * channels, image = pixel * width * height;
  const ptrdiff_t abrdf = pixel * m.count * m.count;
  desc.lights = desc.views = m.directions;
  desc.width = width;
  desc.height = height;
  desc.channels = channels;
  desc.wrap = wrap;
  desc.data = m.samples;
  desc.user = m.samples;
  desc.release = free;
  desc.quantity = kind == MATERIAL_TEXTURED_LAMBERT ? BTF_QUANTITY_BRDF_COS : BTF_QUANTITY_BRDF;
  if (image_major)
    desc.strides = (btf_strides){image * m.count, image, pixel * width, pixel, value};
  else
    desc.strides = (btf_strides){pixel * m.count, pixel, abrdf * width, abrdf, value};
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
  for (size_t i = 0; i < n; i++) energy += (double)m->samples[i] * m->samples[i];
  return energy;
}

btf_status fmf_try_fit(btf_context *ctx, const btf_dataset *ds, const char *settings, const btf_job *job,
                       btf_model **out) {
  return suite_try_fit(ctx, "fmf", ds, settings, job, out);
}

btf_model *fmf_fit(btf_context *ctx, const material *m, const char *settings) {
  return suite_fit(ctx, "fmf", m->ds, settings);
}

double fmf_squared_error(const btf_model *model, const material *m) {
  double error = 0.0;
  float out[64];
  for (uint32_t view = 0; view < m->count; view++)
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

const btfi_fmf_state *fmf_state(const btf_model *model) {
  return model->state;
}

btf_model *fmf_reload(const btf_model *model, btf_context *ctx) {
  const char *path = test_path("model.btfz");
  btf_model *loaded;
  assert_ok(btf_model_save(model, path, 0, NULL, NULL));
  assert_ok(btf_model_load(ctx, path, &loaded));
  return loaded;
}
