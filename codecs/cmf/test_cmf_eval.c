/* SPDX-License-Identifier: MIT */
/* Evaluation and loading: interpolation over index maps, batches, instruction sets, hostile payloads. */
#include "test_cmf_fits.h"

#include "container/container.h"
#include "registry/registry.h"

static test_memory memory;
extern const btf_codec_vtbl btf_codec_cmf;

/* ---- evaluation: INT02, INT03 ---- */

static btf_query query_of(float u, float v, float lod) {
  btf_query q = {{0}, {0}, {u, v}, lod, 0};
  cmf_draw_direction(q.light);
  cmf_draw_direction(q.view);
  return q;
}

/* Colours of whole texels are blended, of two levels as well: indices are never filtered. */
static void test_blends_texels(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, BUMPS, "grid:5x3", 8, 4, 3);
  for (size_t i = 0; i < CMF_CASES; i++) {
    btf_model *model = cmf_fit(ctx, &m, cmf_cases[i]);
    for (int n = 0; n < 60; n++) {
      const btf_query q = query_of(cmf_draw(), cmf_draw(), n % 2 ? 2.5f * cmf_draw() : 0.0f);
      btf_texel_set set;
      float got[3];
      double expected[3] = {0.0, 0.0, 0.0}, most = 0.0;
      btf_model_eval_as(model, &q, BTF_VALUE_STORED, got);
      btf_sampling_texels(q.uv, q.lod, 0, 8, 4, BTF_WRAP_PERIODIC, state_of(model)->levels, &set);
      for (uint32_t t = 0; t < set.count; t++) {
        btf_query at = q;
        float value[3];
        at.uv[0] = ((float)set.x[t] + 0.5f) / (float)btf_sampling_level_size(8, set.level[t]);
        at.uv[1] = ((float)set.y[t] + 0.5f) / (float)btf_sampling_level_size(4, set.level[t]);
        at.lod = (float)set.level[t];
        btf_model_eval_as(model, &at, BTF_VALUE_STORED, value);
        for (int c = 0; c < 3; c++) {
          expected[c] += (double)set.weight[t] * (double)value[c];
          most = fmax(most, fabs((double)value[c]));
        }
      }
      /* Eight products and sums of floats. */
      for (int c = 0; c < 3; c++) assert_near(got[c], expected[c], 1e-6 * most);
    }
    /* At the directions of the data, evaluation and decoding are the same. */
    const float *xyz = btf_dirset_directions(m.set);
    for (uint32_t l = 0; l < m.count; l++) {
      btf_query q = query_of(2.5f / 8.0f, 1.5f / 4.0f, 0.0f);
      float a[3], b[3];
      memcpy(q.light, xyz + 3 * l, sizeof q.light);
      memcpy(q.view, xyz + 3 * ((l + 4) % m.count), sizeof q.view);
      btf_model_eval_as(model, &q, BTF_VALUE_STORED, a);
      btf_model_texel(model, 0, 2, 1, l, (l + 4) % m.count, b);
      assert_memory_equal(a, b, sizeof a);
      q.flags = BTF_QUERY_NEAREST;
      btf_model_eval_as(model, &q, BTF_VALUE_STORED, a);
      assert_memory_equal(a, b, sizeof a);
    }
    btf_model_release(model);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

enum { QUERIES = 200 };

static void make_queries(btf_query *queries) {
  const float strange[] = {NAN, INFINITY, -INFINITY, 1e38f, -1e-42f, 0.0f, -1.0f};
  for (uint32_t n = 0; n < QUERIES; n++) {
    queries[n] =
        query_of(4.0f * cmf_draw() - 2.0f, 4.0f * cmf_draw() - 2.0f, n % 3 ? 0.0f : 6.0f * cmf_draw() - 1.0f);
    if (n % 4 == 1) memcpy(&queries[n], &queries[n - 1], 6 * sizeof(float));
    if (n % 9 == 5) ((float *)(void *)&queries[n])[n / 9 % 9] = strange[n / 9 % 7];
  }
}

static void eval_batch(const btf_model *model, const btf_query *queries, size_t count, uint32_t flags,
                       float **out) {
  static float columns[9][QUERIES];
  btf_batch batch = BTF_BATCH_INIT;
  batch.count = count;
  batch.flags = flags;
  for (size_t i = 0; i < count; i++)
    for (int k = 0; k < 9; k++) columns[k][i] = ((const float *)(const void *)&queries[i])[k];
  for (int k = 0; k < 3; k++) {
    batch.light[k] = columns[k];
    batch.view[k] = columns[3 + k];
  }
  batch.uv[0] = columns[6];
  batch.uv[1] = columns[7];
  batch.lod = columns[8];
  btf_model_eval_n(model, &batch, BTF_VALUE_STORED, out);
}

/* Batches equal single queries bit for bit, and all instruction sets agree with the scalar reference to
 * rounding. */
static void test_batches_and_instruction_sets(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  static float reference[QUERIES][8], columns[8][QUERIES];
  const char *const sets[] = {"scalar", "avx2", "avx512", "neon"};
  const uint32_t channels[CMF_CASES] = {3, 1, 5, 4, 2, 1, 2, 8};
  float *out[8];
  for (int c = 0; c < 8; c++) out[c] = columns[c];
  make_queries(queries);
  for (size_t i = 0; i < CMF_CASES; i++) {
    btf_context *ctx = test_context(&memory);
    material m = material_create(ctx, BUMPS, "grid:5x3", 7, 4, channels[i]);
    btf_model *fitted = cmf_fit(ctx, &m, cmf_cases[i]);
    const char *path = test_path("model.btfz");
    double most = 0.0;
    assert_ok(btf_model_save(fitted, path, 0, NULL, NULL));
    for (uint32_t c = 0; c < channels[i]; c++) most = fmax(most, (double)state_of(fitted)->global[c]);
    for (uint32_t k = 1; k < state_of(fitted)->scales; k++)
      for (uint32_t c = 0; c < channels[i]; c++)
        most *= c == 0 ? 1.0 + (double)state_of(fitted)->global[k * channels[i]] : 1.0;
    for (size_t isa = 0; isa < 4; isa++) {
      btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
      btf_context *other;
      btf_model *model;
      desc.isa = sets[isa];
      if (btf_context_create(&desc, &other) != BTF_OK) continue;
      assert_ok(btf_model_load(other, path, &model));
      for (uint32_t flags = 0; flags < 2; flags++) {
        for (size_t count = 0; count <= QUERIES; count = count < 12 ? count + 1 : count + 94) {
          eval_batch(model, queries, count, flags ? BTF_QUERY_NEAREST : 0, out);
          for (size_t n = 0; n < count; n++) {
            float single[8];
            queries[n].flags = flags ? BTF_QUERY_NEAREST : 0;
            btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, single);
            for (uint32_t c = 0; c < channels[i]; c++)
              assert_memory_equal(&single[c], &columns[c][n], sizeof(float));
          }
        }
      }
      for (size_t n = 0; n < QUERIES; n++) {
        float got[8];
        queries[n].flags = n % 3 == 2 ? BTF_QUERY_NEAREST : 0;
        btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, got);
        if (isa == 0) memcpy(reference[n], got, sizeof got);
        /* Factors are at most 1 and take 4 products and sums each, 8 factors and 8 texels at most: 48
         * roundings of 2^-24 of the largest possible value. */
        for (uint32_t c = 0; c < channels[i]; c++) {
          assert_true(isfinite(got[c]));
          assert_near(got[c], reference[n][c], most * 48.0 / 16777216.0);
        }
      }
      btf_model_release(model);
      btf_context_release(other);
    }
    btf_model_release(fitted);
    material_release(&m);
    test_context_done(ctx, &memory);
  }
}

/* ---- hostile payloads ---- */

enum { MAX_CHUNKS = 64 };

typedef struct chunk_list {
  btf_context *ctx;
  btfi_chunk chunk[MAX_CHUNKS];
  unsigned char *copy[MAX_CHUNKS]; /* of exactly the size, so that a sanitizer sees reads beyond it */
  uint32_t count;
} chunk_list;

static btf_status get_listed(btf_chunk_reader *reader, uint32_t tag, uint32_t index, const void **data,
                             uint64_t *size) {
  const chunk_list *list = (const chunk_list *)(const void *)reader;
  for (uint32_t i = 0; i < list->count; i++) {
    if (list->chunk[i].tag != tag || list->chunk[i].index != index) continue;
    *data = list->copy[i];
    *size = list->chunk[i].size;
    return BTF_OK;
  }
  return (btfi_host()->fail)(list->ctx, BTF_E_CORRUPT, "no such chunk");
}

static unsigned char *copy_of(const void *data, uint64_t size) {
  unsigned char *copy = NULL;
  assert_int_equal(posix_memalign((void **)&copy, 64, size > 0 ? size : 1), 0);
  memcpy(copy, data, size);
  return copy;
}

static btf_status try_load(btf_context *ctx, const btf_model *model, chunk_list *list) {
  btf_host host = *btfi_host();
  void *state = NULL;
  host.get = get_listed;
  const btf_status status = btf_codec_cmf.load(&host, ctx, btf_codec_cmf.format_write, &model->shape,
                                               (btf_chunk_reader *)(void *)list, &state);
  if (status != BTF_OK) {
    assert_int_equal(status, BTF_E_CORRUPT);
    assert_null(state);
    return status;
  }
  for (int i = 0; i < 12; i++) {
    btf_query q = query_of(cmf_draw(), cmf_draw(), 3.0f * cmf_draw());
    float out[64];
    q.flags = i % 4 == 0 ? BTF_QUERY_NEAREST : 0;
    btf_codec_cmf.eval(state, &q, out);
    for (uint32_t c = 0; c < model->shape.channels; c++) assert_true(isfinite(out[c]));
    btf_codec_cmf.texel(state, btf_codec_cmf.levels(state) - 1, 0, 0, 1, 2, out);
  }
  btf_codec_cmf.destroy(&host, ctx, state);
  return BTF_OK;
}

static void test_hostile_payloads(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, BUMPS, "grid:4x2", 4, 3, 3);
  for (size_t k = 0; k < CMF_CASES; k++) {
    char settings[160];
    snprintf(settings, sizeof settings, "%s resolution=6 edge=16 levels=2", cmf_cases[k]);
    btf_model *model = cmf_fit(ctx, &m, settings);
    chunk_list list = {.ctx = ctx, .count = btfi_payload_chunk_count(model->payload)};
    assert_true(list.count <= MAX_CHUNKS);
    for (uint32_t i = 0; i < list.count; i++) {
      assert_ok(btfi_payload_chunk(model->payload, i, &list.chunk[i]));
      list.copy[i] = copy_of(list.chunk[i].data, list.chunk[i].size);
    }
    assert_ok(try_load(ctx, model, &list));
    for (uint32_t i = 0; i < list.count; i++) {
      const btfi_chunk whole = list.chunk[i];
      unsigned char *copy = list.copy[i];
      list.chunk[i].tag = 0;
      assert_status(try_load(ctx, model, &list), BTF_E_CORRUPT);
      list.chunk[i].tag = whole.tag;
      const uint64_t sizes[] = {0, 1, whole.size / 2 + 1, whole.size - 1, whole.size + 1};
      for (size_t n = 0; n < 5; n++) {
        if (sizes[n] == whole.size) continue;
        list.copy[i] = calloc(1, sizes[n] + 1);
        list.chunk[i].size = sizes[n];
        memcpy(list.copy[i], copy, sizes[n] < whole.size ? sizes[n] : whole.size);
        assert_status(try_load(ctx, model, &list), BTF_E_CORRUPT);
        free(list.copy[i]);
      }
      list.copy[i] = copy;
      list.chunk[i] = whole;
      /* Any single changed byte is refused or harmless. */
      for (uint64_t at = 0; at<whole.size; at += whole.size> 200 ? whole.size / 23 + 1 : 1) {
        const unsigned char was = copy[at], wild[] = {0xff, 0x7f, 0x80, (unsigned char)(was ^ 1)};
        for (size_t n = 0; n < 4; n++) {
          copy[at] = wild[n];
          (void)try_load(ctx, model, &list);
        }
        copy[at] = was;
      }
    }
    assert_ok(try_load(ctx, model, &list));
    for (uint32_t i = 0; i < list.count; i++) free(list.copy[i]);
    btf_model_release(model);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_blends_texels),
      cmocka_unit_test(test_batches_and_instruction_sets),
      cmocka_unit_test(test_hostile_payloads),
  };
  return btf_run("cmf_eval", tests);
}
