/* SPDX-License-Identifier: MIT */
/* Payloads that are wrong: every chunk missing, of another size, with wild numbers and flipped bits. The
 * loader is called through the codec's table with chunks in memory, below all checksums. */
#include "test_views.h"

#include "container/container.h"
#include "model/model.h"
#include "registry/registry.h"

static test_memory memory;

extern const btf_codec_vtbl btf_codec_pvpca;

enum { MAX_CHUNKS = 16 };

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

/* A copy of the chunk of exactly its size, so that a sanitizer sees reads beyond it. */
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

/* Loads, and if that works evaluates; returns the status. */
static btf_status try_load(btf_context *ctx, const btf_model *model, chunk_list *list) {
  btf_host host = *btfi_host();
  void *state = NULL;
  host.get = get_listed;
  const btf_status status = btf_codec_pvpca.load(&host, ctx, btf_codec_pvpca.format_write, &model->shape,
                                                 (btf_chunk_reader *)(void *)list, &state);
  if (status != BTF_OK) {
    assert_null(state);
    assert_true(btf_error_message()[0] != '\0');
    return status;
  }
  const btfi_pvpca_layout *layout = &((const btfi_pvpca_state *)state)->layout;
  for (uint32_t i = 0; i < 20; i++) {
    btf_query q = {
        {0}, {0}, {test_random(), test_random()}, 3.0f * test_random(), i % 4 == 0 ? BTF_QUERY_NEAREST : 0};
    float out[64];
    test_random_direction(q.light);
    test_random_direction(q.view);
    btf_codec_pvpca.eval(state, &q, out);
    /* The last value of every table, beyond which there is only the tail. */
    const uint32_t level = i % layout->levels;
    btf_codec_pvpca.texel(state, level, layout->level_width[level] - 1, layout->level_height[level] - 1,
                          layout->lights - 1, layout->views - 1, out);
  }
  btf_codec_pvpca.destroy(&host, ctx, state);
  return BTF_OK;
}

static unsigned char *find_chunk(const chunk_list *list, uint32_t tag) {
  for (uint32_t i = 0; i < list->count; i++)
    if (list->chunk[i].tag == tag) return list->chunk[i].data;
  fail_msg("chunk is missing");
  return NULL;
}

typedef void (*check_fn)(btf_context *ctx, const btf_model *model, chunk_list *list);

static void with_models(check_fn check) {
  const char *const settings[] = {"components=6 storage=f16", "components=6 storage=q8 mean=false",
                                  "components=1 storage=f32", "components=5 storage=f16 color=texels",
                                  "components=3 storage=q8 color=texels budget=adaptive"};
  for (size_t isa = 0; isa < 2; isa++) {
    btf_context *ctx = test_context_with(&memory, isa ? "scalar" : NULL, 1);
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", 6, 4, 3, true, BTF_WRAP_PERIODIC);
    for (size_t i = 0; i < 5; i++) {
      btf_model *model = pvpca_fit(ctx, &m, settings[i]);
      chunk_list list = list_chunks(model, ctx);
      assert_ok(try_load(ctx, model, &list));
      check(ctx, model, &list);
      assert_ok(try_load(ctx, model, &list));
      for (uint32_t k = 0; k < list.count; k++) free(list.chunk[k].data);
      btf_model_release(model);
    }
    material_release(&m);
    test_context_done(ctx, &memory);
  }
}

/* Missing, shortened by any number of bytes, or longer. */
static void check_sizes(btf_context *ctx, const btf_model *model, chunk_list *list) {
  for (uint32_t i = 0; i < list->count; i++) {
    const uint32_t tag = list->chunk[i].tag;
    const uint64_t size = list->chunk[i].size;
    unsigned char *data = list->chunk[i].data;
    list->chunk[i].tag = 0;
    assert_status(try_load(ctx, model, list), BTF_E_CORRUPT);
    list->chunk[i].tag = tag;
    for (uint64_t cut = 0; cut<size; cut += size> 200 ? size / 97 : 1) {
      list->chunk[i].data = copy_chunk(data, cut);
      list->chunk[i].size = cut;
      assert_status(try_load(ctx, model, list), BTF_E_CORRUPT);
      free(list->chunk[i].data);
    }
    list->chunk[i].data = calloc(1, size + 1);
    memcpy(list->chunk[i].data, data, size);
    list->chunk[i].size = size + 1;
    assert_status(try_load(ctx, model, list), BTF_E_CORRUPT);
    free(list->chunk[i].data);
    list->chunk[i].data = data;
    list->chunk[i].size = size;
  }
}

static void test_sizes(void **unused) {
  (void)unused;
  with_models(check_sizes);
}

/* Wild values of every field of the header: refused, but for what changes nothing that is read: fewer levels,
 * and 0 flags where there is no mean. Another storage or color changes the sizes. */
static void check_header(btf_context *ctx, const btf_model *model, chunk_list *list) {
  const uint32_t wild[] = {0, 1, 2, 3, 7, 1025, 0x7fffffff, 0x80000000u, 0xffffffffu};
  unsigned char *head = find_chunk(list, PVPCA_TAG_HEAD), saved[PVPCA_HEAD_BYTES];
  memcpy(saved, head, sizeof saved);
  for (uint32_t field = 0; field < 6; field++)
    for (size_t i = 0; i < sizeof wild / sizeof *wild; i++) {
      if (memcmp(head + 4 * (size_t)field, &wild[i], 4) == 0) continue;
      memcpy(head + 4 * (size_t)field, &wild[i], 4);
      const int harmless = field == 2 && wild[i] < 4 && wild[i] > 0;
      const btf_status status = try_load(ctx, model, list);
      if (status != (harmless ? BTF_OK : BTF_E_CORRUPT))
        fail_msg("field %u = %u: status %d", field, wild[i], status);
      memcpy(head, saved, sizeof saved);
    }
  const double numbers[] = {NAN, INFINITY, -1.0};
  for (uint32_t field = 0; field < 2; field++)
    for (size_t i = 0; i < 3; i++) {
      memcpy(head + 24 + 8 * (size_t)field, &numbers[i], 8);
      assert_status(try_load(ctx, model, list), BTF_E_CORRUPT);
      memcpy(head, saved, sizeof saved);
    }
}

static void test_header(void **unused) {
  (void)unused;
  with_models(check_header);
}

/* Numbers of terms that do not fit the tables or exceed what scratch holds; scales that are not finite. */
static void check_numbers(btf_context *ctx, const btf_model *model, chunk_list *list) {
  unsigned char *const terms = find_chunk(list, PVPCA_TAG_TERMS), *const scale =
                                                                      find_chunk(list, PVPCA_TAG_SCALES);
  const uint32_t wild[] = {0, 4, 64, 65, 0x10000, 0x40000000, 0xffffffffu};
  const float wrong[] = {NAN, INFINITY, -INFINITY, -1.0f};
  unsigned char saved[4];
  for (uint32_t view = 0; view < 8; view += 7)
    for (size_t i = 0; i < sizeof wild / sizeof *wild; i++) {
      memcpy(saved, terms + 4 * (size_t)view, 4);
      if (memcmp(saved, &wild[i], 4) == 0) continue;
      memcpy(terms + 4 * (size_t)view, &wild[i], 4);
      assert_status(try_load(ctx, model, list), BTF_E_CORRUPT);
      memcpy(terms + 4 * (size_t)view, saved, 4);
    }
  memcpy(saved, scale, 4);
  for (size_t i = 0; i < 4; i++) {
    memcpy(scale, &wrong[i], 4);
    assert_status(try_load(ctx, model, list), BTF_E_CORRUPT);
  }
  memcpy(scale, saved, 4);
}

static void test_numbers(void **unused) {
  (void)unused;
  with_models(check_numbers);
}

/* Flipped bits anywhere: loads or is refused, and never reads or writes where it must not. */
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

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_sizes), cmocka_unit_test(test_header),
                                     cmocka_unit_test(test_numbers), cmocka_unit_test(test_bits)};
  return btf_run("pvpca_payload", tests);
}
