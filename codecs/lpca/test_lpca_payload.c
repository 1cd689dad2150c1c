/* SPDX-License-Identifier: MIT */
/* Payloads that are wrong: every chunk missing, of another size, with wild numbers, indices and flipped bits.
 * The loader is called through the codec's table with chunks in memory, below all checksums. */
#include "test_clusters.h"

static test_memory memory;

extern const btf_codec_vtbl btf_codec_lpca;

enum { MAX_CHUNKS = 24 };

/* Chunks to load from; stands where the loader expects a reader. */
typedef struct chunk_list {
  btf_context *ctx;
  struct {
    uint32_t tag, index;
    unsigned char *data;
    uint64_t size;
  } chunk[MAX_CHUNKS];
  uint32_t count;
} chunk_list;

static btf_status get_listed(btf_chunk_reader *reader, uint32_t tag, uint32_t index, const void **data,
                             uint64_t *size) {
  const chunk_list *list = (const chunk_list *)(const void *)reader;
  for (uint32_t i = 0; i < list->count; i++) {
    if (list->chunk[i].tag != tag || list->chunk[i].index != index) continue;
    *data = list->chunk[i].data;
    *size = list->chunk[i].size;
    return BTF_OK;
  }
  return (btfi_host()->fail)(list->ctx, BTF_E_CORRUPT, "no such chunk");
}

/* A copy of exactly the size, so that a sanitizer sees reads beyond it. */
static unsigned char *copy_chunk(const void *data, uint64_t size) {
  unsigned char *copy = NULL;
  assert_int_equal(posix_memalign((void **)&copy, 64, size > 0 ? size : 1), 0);
  memcpy(copy, data, size);
  return copy;
}

static chunk_list list_chunks(const btf_model *model, btf_context *ctx) {
  chunk_list list = {.ctx = ctx};
  for (uint32_t i = 0; i < btfi_payload_chunk_count(model->payload); i++) {
    btfi_chunk chunk;
    assert_ok(btfi_payload_chunk(model->payload, i, &chunk));
    assert_true(list.count < MAX_CHUNKS);
    list.chunk[list.count].tag = chunk.tag;
    list.chunk[list.count].index = chunk.index;
    list.chunk[list.count].size = chunk.size;
    list.chunk[list.count++].data = copy_chunk(chunk.data, chunk.size);
  }
  return list;
}

/* Loads, and if that works evaluates everywhere; returns the status. */
static btf_status try_load(btf_context *ctx, const btf_model *model, chunk_list *list) {
  btf_host host = *btfi_host();
  void *state = NULL;
  host.get = get_listed;
  const btf_status status = btf_codec_lpca.load(&host, ctx, btf_codec_lpca.format_write, &model->shape,
                                                (btf_chunk_reader *)(void *)list, &state);
  if (status != BTF_OK) {
    assert_null(state);
    assert_true(btf_error_message()[0] != '\0');
    return status;
  }
  const uint32_t directions = btf_dirset_count(model->shape.lights);
  float out[64];
  for (int i = 0; i < 20; i++) {
    btf_query q = {
        {0}, {0}, {test_random(), test_random()}, 3.0f * test_random(), i % 4 == 0 ? BTF_QUERY_NEAREST : 0};
    test_random_direction(q.light);
    test_random_direction(q.view);
    btf_codec_lpca.eval(state, &q, out);
  }
  for (uint32_t level = 0; level < btf_codec_lpca.levels(state); level++) {
    const uint32_t width = model->shape.width >> level ? model->shape.width >> level : 1,
                   height = model->shape.height >> level ? model->shape.height >> level : 1;
    for (uint32_t t = 0; t < width * height; t++)
      btf_codec_lpca.texel(state, level, t % width, t / width, directions - 1, directions - 1, out);
  }
  btf_codec_lpca.destroy(&host, ctx, state);
  return BTF_OK;
}

static uint32_t find_chunk(const chunk_list *list, uint32_t tag) {
  for (uint32_t i = 0; i < list->count; i++)
    if (list->chunk[i].tag == tag) return i;
  fail_msg("chunk is missing");
  return 0;
}

typedef void (*check_fn)(btf_context *ctx, const btf_model *model, chunk_list *list);

static void with_models(check_fn check) {
  const char *const settings[] = {"clusters=4 components=3",
                                  "clusters=4 components=9 storage=q8 packing=tight",
                                  "clusters=3 components=2 storage=f32 packing=tight"};
  for (size_t i = 0; i < 6; i++) {
    btf_context *ctx = test_context_with(&memory, i < 3 ? NULL : "scalar", 1);
    material m =
        material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", 6, 4, i % 2 ? 3 : 2, true, BTF_WRAP_PERIODIC);
    btf_model *model = lpca_fit(ctx, &m, settings[i % 3]);
    chunk_list list = list_chunks(model, ctx);
    assert_ok(try_load(ctx, model, &list));
    check(ctx, model, &list);
    assert_ok(try_load(ctx, model, &list));
    for (uint32_t k = 0; k < list.count; k++) free(list.chunk[k].data);
    btf_model_release(model);
    material_release(&m);
    test_context_done(ctx, &memory);
  }
}

/* Missing, shortened, or longer. */
static void check_sizes(btf_context *ctx, const btf_model *model, chunk_list *list) {
  for (uint32_t i = 0; i < list->count; i++) {
    const uint32_t tag = list->chunk[i].tag;
    const uint64_t size = list->chunk[i].size;
    unsigned char *data = list->chunk[i].data;
    list->chunk[i].tag = 0;
    assert_status(try_load(ctx, model, list), BTF_E_CORRUPT);
    list->chunk[i].tag = tag;
    for (uint64_t at = 0; at <= 50; at++) {
      const uint64_t cut = at == 50 ? size + 1 : size * at / 50;
      list->chunk[i].data = calloc(1, cut + 1);
      memcpy(list->chunk[i].data, data, cut < size ? cut : size);
      list->chunk[i].size = cut;
      assert_status(try_load(ctx, model, list), BTF_E_CORRUPT);
      free(list->chunk[i].data);
    }
    list->chunk[i].data = data;
    list->chunk[i].size = size;
  }
}

static void test_sizes(void **unused) {
  (void)unused;
  with_models(check_sizes);
}

/* Wild values of every field of the header, of scales and of indices. */
static void check_numbers(btf_context *ctx, const btf_model *model, chunk_list *list) {
  const uint32_t wild[] = {0, 1, 5, 65, 1025, 0x7fffffff, 0x80000000u, 0xffffffffu};
  unsigned char *head = list->chunk[find_chunk(list, LPCA_TAG_HEAD)].data, saved[LPCA_HEAD_BYTES];
  memcpy(saved, head, sizeof saved);
  for (uint32_t field = 0; field < 6; field++)
    for (size_t i = 0; i < sizeof wild / sizeof *wild; i++) {
      if (memcmp(head + 4 * field, &wild[i], 4) == 0) continue;
      memcpy(head + 4 * field, &wild[i], 4);
      /* Fewer levels than there are chunks, and packings that differ in nothing. */
      const int harmless = (field == 4 && wild[i] == 1) || (field == 1 && wild[i] <= 1);
      const btf_status status = try_load(ctx, model, list);
      if (status != BTF_E_CORRUPT && !harmless) fail_msg("field %u = %u: status %d", field, wild[i], status);
      memcpy(head, saved, sizeof saved);
    }
  const double numbers[] = {NAN, INFINITY, -1.0};
  for (uint32_t i = 0; i < 9; i++) {
    memcpy(head + 24 + 8 * (i / 3), &numbers[i % 3], 8);
    assert_status(try_load(ctx, model, list), BTF_E_CORRUPT);
    memcpy(head, saved, sizeof saved);
  }
  const float scales[] = {NAN, INFINITY, -INFINITY};
  unsigned char *scale = list->chunk[find_chunk(list, LPCA_TAG_SCALES)].data;
  for (uint32_t i = 0; i < 6; i++) {
    memcpy(saved, scale + 4 * (i / 3), 4);
    memcpy(scale + 4 * (i / 3), &scales[i % 3], 4);
    assert_status(try_load(ctx, model, list), BTF_E_CORRUPT);
    memcpy(scale + 4 * (i / 3), saved, 4);
  }
  for (uint32_t i = 0; i < list->count; i++) {
    if (list->chunk[i].tag != LPCA_TAG_CLUSTERS) continue;
    unsigned char *last = list->chunk[i].data + list->chunk[i].size - 1, before = *last;
    *last = 4;
    assert_status(try_load(ctx, model, list), BTF_E_CORRUPT);
    assert_message_has("cluster 4 of");
    *last = before;
  }
}

static void test_numbers(void **unused) {
  (void)unused;
  with_models(check_numbers);
}

/* Flipped bits anywhere: loads or is refused, and never reads where it must not. */
static void check_bits(btf_context *ctx, const btf_model *model, chunk_list *list) {
  for (uint32_t turn = 0; turn < 300; turn++) {
    const uint32_t i = turn % list->count;
    const uint64_t at = (uint64_t)((double)test_random() * (double)list->chunk[i].size);
    const unsigned char bit = (unsigned char)(1u << turn / 7 % 8);
    list->chunk[i].data[at] ^= bit;
    const btf_status status = try_load(ctx, model, list);
    assert_true(status == BTF_OK || status == BTF_E_CORRUPT || status == BTF_E_NOMEM);
    list->chunk[i].data[at] ^= bit;
  }
}

static void test_bits(void **unused) {
  (void)unused;
  with_models(check_bits);
}

/* More clusters than a byte can count: two bytes for each texel, checked as well. */
static void test_wide_indices(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:3x1", 20, 16, 1, true, BTF_WRAP_PERIODIC);
  btf_model *model = lpca_fit(ctx, &m, "clusters=300 components=1 storage=f32");
  const btfi_lpca_state *s = lpca_state(model);
  assert_int_equal(s->layout.index_bytes, 2);
  assert_true(model_squared_error(model, &m) < 1e-3 * material_energy(&m));
  chunk_list list = list_chunks(model, ctx);
  unsigned char *index = list.chunk[find_chunk(&list, LPCA_TAG_CLUSTERS)].data;
  assert_ok(try_load(ctx, model, &list));
  index[1] = 2;
  assert_status(try_load(ctx, model, &list), BTF_E_CORRUPT);
  for (uint32_t k = 0; k < list.count; k++) free(list.chunk[k].data);
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_sizes), cmocka_unit_test(test_numbers),
                                     cmocka_unit_test(test_bits), cmocka_unit_test(test_wide_indices)};
  return btf_run("lpca_payload", tests);
}
