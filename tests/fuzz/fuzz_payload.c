/* SPDX-License-Identifier: MIT */
#include "fuzz_payload.h"

#include <math.h>

#include "model/model.h"
#include "registry/registry.h"

#include <btf/btf_sampling.h>

enum { ISAS = 3, QUERIES = 10, MOST_SETS = 16 };

const char *const fuzz_set_names[FUZZ_SETS] = {"grid:1x1", "grid:2x1", "grid:3x2", "grid:5x3"};
static const char *const isa_names[ISAS] = {"scalar", "avx2", "avx512"};

typedef struct machine {
  btf_context *ctx;
  btf_dirset *sets[MOST_SETS];
  const char *set_names[MOST_SETS];
  uint32_t set_count;
} machine;

static machine machines[ISAS];

static void set_up(void) {
  for (int i = 0; i < ISAS; i++) {
    btf_limits limits = BTF_LIMITS_INIT;
    btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
    limits.max_memory = (uint64_t)64 << 20;
    desc.limits = &limits;
    desc.max_threads = 1;
    desc.isa = isa_names[i];
    fuzz_expect(btf_context_create(&desc, &machines[i].ctx) == BTF_OK);
  }
}

/* Sets are made once: their triangulation is not what is looked at here. */
static const btf_dirset *set_of(machine *m, const char *name) {
  for (uint32_t i = 0; i < m->set_count; i++)
    if (strcmp(m->set_names[i], name) == 0) return m->sets[i];
  fuzz_expect(m->set_count < MOST_SETS);
  m->set_names[m->set_count] = name;
  fuzz_expect(btf_dirset_create_named(m->ctx, name, &m->sets[m->set_count]) == BTF_OK);
  return m->sets[m->set_count++];
}

static btf_status never_read(void *user, const btf_block *block, void *dst, const btf_strides *strides) {
  (void)user, (void)block, (void)dst, (void)strides;
  return BTF_E_STATE;
}

/* ---- evaluation ---- */

/* Every texel of every level, with some pairs of directions. */
static void decode(const btf_model *model, const btf_model_info *info) {
  const uint32_t lights = btf_dirset_count(info->lights), views = btf_dirset_count(info->views);
  uint32_t pair = 0;
  float one[64];
  for (uint32_t level = 0; level < info->levels; level++)
    for (uint32_t y = 0; y < btf_sampling_level_size(info->height, level); y++)
      for (uint32_t x = 0; x < btf_sampling_level_size(info->width, level); x++) {
        for (int k = 0; k < 3; k++, pair += 7) {
          btf_model_texel(model, level, x, y, pair % lights, pair / lights % views, one);
          for (uint32_t c = 0; c < info->channels; c++) fuzz_expect(isfinite(one[c]));
        }
        btf_model_texel(model, level, x, y, lights - 1, views - 1, one);
        for (uint32_t c = 0; c < info->channels; c++) fuzz_expect(isfinite(one[c]));
      }
}

static void evaluate(const btf_model *model, fuzz_bytes *in) {
  static const float some[QUERIES][9] = {
      {0.3f, 0.7f, 0.0f, 0.6f, 0.8f, 0.6f, 0.0f, 0.8f, 0.0f},
      {-7.1f, 1e9f, 0.0f, 0.6f, 0.8f, 0.6f, 0.0f, 0.8f, 2.5f},
      {0.999f, 0.001f, -0.5f, 0.5f, 0.7f, 0.1f, 0.9f, 0.4f, 40.0f},
      {0.5f, 0.5f, NAN, 0.0f, 1.0f, 0.0f, 0.0f, 1.0f, 0.0f},
      {INFINITY, NAN, 0.0f, 0.0f, INFINITY, 0.0f, NAN, 1.0f, -INFINITY},
      {0.0f, 1.0f, 0.0f, 0.0f, 1.0f, 0.0f, 0.0f, 1.0f, 0.5f},
  };
  static const uint32_t flags[] = {0, BTF_QUERY_NEAREST};
  float arrays[9][QUERIES], results[64][QUERIES], one[64];
  float *out[64];
  btf_model_info info = BTF_MODEL_INFO_INIT;
  btf_batch batch = BTF_BATCH_INIT;
  fuzz_expect(btf_model_describe(model, &info) == BTF_OK);
  for (int q = 0; q < QUERIES; q++) {
    float coordinates[9];
    memcpy(coordinates, some[q], sizeof coordinates);
    if (q >= 6 && in->size > 0) fuzz_take(in, coordinates, sizeof coordinates);
    for (int k = 0; k < 9; k++) arrays[k][q] = coordinates[k];
  }
  for (int k = 0; k < 2; k++) batch.uv[k] = arrays[k];
  for (int k = 0; k < 3; k++) batch.light[k] = arrays[2 + k];
  for (int k = 0; k < 3; k++) batch.view[k] = arrays[5 + k];
  batch.lod = arrays[8];
  batch.count = QUERIES;
  for (uint32_t c = 0; c < info.channels; c++) out[c] = results[c];
  for (size_t f = 0; f < sizeof flags / sizeof *flags; f++) {
    batch.flags = flags[f];
    btf_model_eval_n(model, &batch, BTF_VALUE_STORED, out);
    for (int q = 0; q < QUERIES; q++) {
      btf_query query = {.lod = arrays[8][q], .flags = flags[f]};
      for (int k = 0; k < 2; k++) query.uv[k] = arrays[k][q];
      for (int k = 0; k < 3; k++) query.light[k] = arrays[2 + k][q];
      for (int k = 0; k < 3; k++) query.view[k] = arrays[5 + k][q];
      btf_model_eval_as(model, &query, BTF_VALUE_STORED, one);
      for (uint32_t c = 0; c < info.channels; c++) {
        fuzz_expect(isfinite(one[c]));
        fuzz_expect(memcmp(&one[c], &results[c][q], sizeof(float)) == 0);
      }
    }
  }
  decode(model, &info);
}

/* ---- loading ---- */

static void load(machine *m, const char *id, const fuzz_shape *s, fuzz_write_fn write, void *user,
                 fuzz_bytes in) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  const btf_codec *codec = btf_codec_find(m->ctx, id);
  btfi_payload *payload;
  btf_dataset *ds;
  btf_model *model;
  uint64_t before, after;
  fuzz_expect(codec != NULL);
  desc.lights = set_of(m, s->lights);
  desc.views = set_of(m, s->views);
  desc.width = s->width;
  desc.height = s->height;
  desc.channels = s->channels;
  desc.wrap = s->wrap;
  desc.quantity = s->quantity;
  desc.read = never_read;
  btf_context_memory(m->ctx, &before, NULL);
  fuzz_expect(btf_dataset_create(m->ctx, &desc, &ds) == BTF_OK);
  fuzz_expect(btfi_payload_create(m->ctx, ds, id, btfi_codec_vtbl(codec)->format_write, &payload) == BTF_OK);
  const btf_model_shape shape = {desc.lights, desc.views,  s->width, s->height,
                                 s->channels, s->quantity, s->wrap,  0};
  const int complete = write(user, btfi_payload_writer(payload), &shape, &in);
  btfi_payload_seal(payload);
  const btf_status status = btfi_model_from_payload(codec, payload, &model);
  fuzz_expect(status == BTF_OK || status / 10 == 2 || status == BTF_E_NOMEM || status == BTF_E_LIMIT);
  fuzz_expect(complete || status != BTF_OK);
  if (status == BTF_OK) evaluate(model, &in);
  btf_model_release(model);
  btfi_payload_release(payload);
  btf_dataset_release(ds);
  btf_context_memory(m->ctx, &after, NULL);
  fuzz_expect(before == after);
}

void fuzz_payload_check(const char *codec, const fuzz_shape *shape, fuzz_write_fn write, void *user,
                        fuzz_bytes in) {
  if (machines[0].ctx == NULL) set_up();
  for (int i = 0; i < ISAS; i++)
    if (i == 0 || strcmp(btf_context_isa(machines[i].ctx), btf_context_isa(machines[i - 1].ctx)) != 0)
      load(&machines[i], codec, shape, write, user, in);
}
