/* SPDX-License-Identifier: MIT */
/* The payload of FMF: chunks made from the input go straight to the loader, with the sizes that the header
 * asks for, so that every input gets to what lies behind the check of sizes; some inputs are off by a few
 * bytes. What loads is evaluated with the kernels of each instruction set. */
#include "fuzz.h"

#include <math.h>

#include "container/container.h"
#include "model/model.h"
#include "registry/registry.h"

#include "../../codecs/fmf/fmf.h"

enum { SETS = 4, ISAS = 3, LARGEST_TABLE = 1 << 17, QUERIES = 10 };

static const char *const set_names[SETS] = {"grid:1x1", "grid:2x1", "grid:3x2", "grid:5x3"};
static const char *const isa_names[ISAS] = {"scalar", "avx2", "avx512"};

typedef struct machine {
  btf_context *ctx;
  btf_dirset *sets[SETS];
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
    for (int k = 0; k < SETS; k++)
      fuzz_expect(btf_dirset_create_named(machines[i].ctx, set_names[k], &machines[i].sets[k]) == BTF_OK);
  }
}

static btf_status never_read(void *user, const btf_block *block, void *dst, const btf_strides *strides) {
  (void)user, (void)block, (void)dst, (void)strides;
  return BTF_E_STATE;
}

typedef struct recipe {
  uint32_t width, height, channels, light_set, view_set, wrap, quantity;
  uint32_t tame;   /* singular values, scales and steps are harmless */
  uint32_t faulty; /* 0, or the number of the chunk of a wrong size, from 1 */
  int32_t off;     /* by so many bytes */
  btfi_fmf_head head;
} recipe;

static void take_recipe(fuzz_bytes *in, recipe *r) {
  const uint32_t flags = fuzz_u8(in), fault = fuzz_u8(in);
  r->width = 1 + fuzz_u8(in) % 12;
  r->height = 1 + fuzz_u8(in) % 12;
  r->channels = fuzz_u8(in);
  r->channels = r->channels >= 192 ? r->channels % 64 + 1 : r->channels % 4 + 1;
  const uint32_t sets = fuzz_u8(in);
  r->light_set = sets % SETS;
  r->view_set = sets / SETS % SETS;
  r->wrap = flags & 1;
  r->quantity = flags & 2 ? BTF_QUANTITY_BRDF_COS : BTF_QUANTITY_BRDF;
  r->tame = flags & 4;
  r->faulty = fault & 7;
  r->off = (int32_t)(fault >> 3) - 16;
  r->head.coding = flags >> 3 & 1;
  r->head.storage = flags >> 4 & 3;
  r->head.components = fuzz_u8(in);
  if (r->head.components < 224) r->head.components %= 24;
  if (flags & 64) r->head.components |= fuzz_u8(in) << 8;
  if (r->head.components == 0 && r->tame) r->head.components = 1;
  r->head.columns = r->head.coding == FMF_PLAIN ? r->head.components + fuzz_u8(in) : 0;
  r->head.levels = fuzz_u8(in);
  if (r->tame && (r->head.levels < 1 || r->head.levels > 6)) r->head.levels = 1;
  r->head.flags = flags >> 7;
  if (flags & 128 && !r->tame) { /* words that no writer makes */
    r->head.coding ^= fuzz_u8(in) >> 5;
    r->head.storage ^= fuzz_u8(in) >> 5;
    r->head.flags = fuzz_u8(in);
  }
  double *const numbers[] = {&r->head.step[0], &r->head.step[1], &r->head.squared_error, &r->head.energy,
                             &r->head.tolerated};
  for (int i = 0; i < 5; i++) {
    if (r->tame)
      *numbers[i] = (1.0 + fuzz_u8(in)) / 1024.0;
    else
      fuzz_take(in, numbers[i], sizeof(double));
  }
}

/* ---- chunks ---- */

typedef struct writing {
  const recipe *r;
  fuzz_bytes *in;
  btf_chunk_writer *to;
  uint32_t made;
  uint32_t noise;
} writing;

/* Bytes of the input as far as they go, then noise or zeros that the input chooses. */
static void fill(writing *w, uint8_t *dst, uint64_t size, uint64_t most_taken) {
  uint64_t taken = w->in->size;
  if (taken > most_taken) taken = most_taken;
  if (taken > size) taken = size;
  fuzz_take(w->in, dst, (size_t)taken);
  for (uint64_t i = taken; i < size; i++) {
    w->noise = w->noise * 1664525u + 1013904223u;
    dst[i] = w->noise & 1 ? (uint8_t)(w->noise >> 24) : 0;
  }
}

static void put(writing *w, uint32_t tag, uint32_t index, const void *data, uint64_t size) {
  uint64_t stored = size;
  if (++w->made == w->r->faulty && w->r->off != 0)
    stored = w->r->off < 0 && size < (uint64_t)-w->r->off ? 0 : size + (uint64_t)(int64_t)w->r->off;
  uint8_t *copy = calloc(stored > 0 ? stored : 1, 1);
  fuzz_expect(copy != NULL);
  memcpy(copy, data, stored < size ? stored : size);
  fuzz_expect(btfi_chunk_put(w->to, tag, index, 0, copy, stored) == BTF_OK);
  free(copy);
}

static void put_filled(writing *w, uint32_t tag, uint32_t index, uint64_t size, uint64_t most_taken) {
  uint8_t *bytes = malloc(size > 0 ? size : 1);
  fuzz_expect(bytes != NULL);
  fill(w, bytes, size, most_taken);
  put(w, tag, index, bytes, size);
  free(bytes);
}

static void put_sigma(writing *w) {
  const uint32_t n = w->r->head.components;
  uint8_t *bytes = malloc(8 * (size_t)n + 1);
  fuzz_expect(bytes != NULL);
  if (w->r->tame) {
    for (uint32_t k = 0; k < n; k++) {
      const double sigma = 1.0 + (double)fuzz_u8(w->in) / 16.0;
      btfi_fmf_put_sigma(&sigma, 1, bytes + 8 * (size_t)k);
    }
  } else {
    fill(w, bytes, 8 * (uint64_t)n, 64);
  }
  put(w, FMF_TAG_SIGMA, 0, bytes, 8 * (uint64_t)n);
  free(bytes);
}

static void put_plain(writing *w, const btfi_fmf_layout *layout) {
  const btfi_fmf_head *head = &w->r->head;
  static btfi_fmf_plan plan;
  uint8_t bytes[FMF_COLUMN_BYTES * FMF_MAX_COLUMNS];
  plan.columns = head->columns;
  for (uint32_t i = 0; i < head->columns; i++) {
    btfi_fmf_column *column = &plan.column[i];
    const uint32_t rest = w->in->size > 0 ? fuzz_u8(w->in) : 0;
    column->component = w->r->tame ? i % head->components : i % (head->components + 1);
    column->rest[0] = rest & 1;
    column->rest[1] = rest >> 1 & 1;
    for (int side = 0; side < 2; side++) {
      column->scale[side] = (float)(rest >> 2) / 8.0f;
      if (!w->r->tame && rest & 4) fuzz_take(w->in, &column->scale[side], sizeof(float));
    }
  }
  btfi_fmf_put_columns(&plan, bytes);
  put(w, FMF_TAG_COLUMNS, 0, bytes, (uint64_t)FMF_COLUMN_BYTES * head->columns);
  put_filled(w, FMF_TAG_U, 0, layout->u_bytes, 128);
  for (uint32_t level = 0; level < layout->levels; level++)
    put_filled(w, FMF_TAG_V, level, layout->v_bytes[level], 128);
}

static void put_packed(writing *w, uint32_t tag, uint32_t channels, uint64_t points) {
  const uint64_t header = 4 + 2 * (uint64_t)(channels - 1), length = points * channels;
  const uint32_t n = w->r->head.components;
  uint64_t size = header * n;
  uint8_t *bytes = malloc(size + 4 * length * n + 1);
  fuzz_expect(bytes != NULL);
  for (uint32_t k = 0; k < n; k++) {
    uint8_t *column = bytes + header * k;
    fill(w, column, header, header);
    column[0] = (uint8_t)(1 + column[0] % 4);
    if (w->r->tame || column[1] < 128) column[1] %= 5;
    if (w->r->tame || column[2] < 128) column[2] = channels > 1 ? column[2] % 7 : 0;
    column[3] = 0;
    size += column[0] * length;
  }
  fill(w, bytes + header * n, size - header * n, 256);
  put(w, tag, 0, bytes, size);
  free(bytes);
}

/* False if tables are left out because they would be too large to make here. */
static bool put_chunks(writing *w, const btf_model_shape *shape) {
  const recipe *r = w->r;
  const uint32_t lights = btf_dirset_count(shape->lights), views = btf_dirset_count(shape->views);
  const uint64_t points[2] = {(uint64_t)lights * views, (uint64_t)shape->width * shape->height};
  btfi_fmf_layout layout;
  uint8_t head[FMF_HEAD_BYTES];
  w->noise = fuzz_u8(w->in) << 16;
  btfi_fmf_put_head(&r->head, head);
  put(w, FMF_TAG_HEAD, 0, head, sizeof head);
  put_sigma(w);
  if (r->head.coding == FMF_PLAIN) {
    if (r->head.columns > FMF_MAX_COLUMNS || r->head.storage >= FMF_STORAGES || r->head.levels > 8)
      return false;
    if (!btfi_fmf_layout_of(shape, lights, views, r->head.storage, r->head.columns, r->head.levels,
                            &layout) ||
        layout.u_bytes > LARGEST_TABLE || layout.v_bytes[0] > LARGEST_TABLE)
      return false;
    put_plain(w, &layout);
  } else {
    if ((points[0] * r->channels + points[1]) * r->head.components > LARGEST_TABLE) return false;
    put_packed(w, FMF_TAG_PACKED_U, r->channels, points[0]);
    put_packed(w, FMF_TAG_PACKED_V, 1, points[1]);
  }
  return true;
}

/* ---- evaluation ---- */

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
  for (uint32_t level = 0; level < info.levels; level++) {
    const uint32_t width = info.width >> level, height = info.height >> level;
    btf_model_texel(model, level, width > 0 ? width - 1 : 0, height > 0 ? height - 1 : 0,
                    btf_dirset_count(info.lights) - 1, btf_dirset_count(info.views) - 1, one);
    for (uint32_t c = 0; c < info.channels; c++) fuzz_expect(isfinite(one[c]));
  }
}

static void load(machine *m, const recipe *r, fuzz_bytes in) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  const btf_codec *codec = btf_codec_find(m->ctx, "fmf");
  btfi_payload *payload;
  btf_dataset *ds;
  btf_model *model;
  uint64_t before, after;
  btf_context_memory(m->ctx, &before, NULL);
  desc.lights = m->sets[r->light_set];
  desc.views = m->sets[r->view_set];
  desc.width = r->width;
  desc.height = r->height;
  desc.channels = r->channels;
  desc.wrap = r->wrap;
  desc.quantity = r->quantity;
  desc.read = never_read;
  fuzz_expect(btf_dataset_create(m->ctx, &desc, &ds) == BTF_OK);
  fuzz_expect(btfi_payload_create(m->ctx, ds, "fmf", 1, &payload) == BTF_OK);
  const btf_model_shape shape = {desc.lights, desc.views,  r->width, r->height,
                                 r->channels, r->quantity, r->wrap,  0};
  writing w = {.r = r, .in = &in, .to = btfi_payload_writer(payload)};
  const bool complete = put_chunks(&w, &shape);
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

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  fuzz_bytes in = {data, size};
  recipe r = {0};
  if (machines[0].ctx == NULL) set_up();
  take_recipe(&in, &r);
  for (int i = 0; i < ISAS; i++)
    if (i == 0 || strcmp(btf_context_isa(machines[i].ctx), btf_context_isa(machines[i - 1].ctx)) != 0)
      load(&machines[i], &r, in);
  return 0;
}
