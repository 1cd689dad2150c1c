/* SPDX-License-Identifier: MIT */
/* Payloads that are wrong: missing and misshapen chunks, wild numbers, flipped bits. The loader is called
 * through the codec's table with chunks in memory, below all checksums. */
#include "test_lobes.h"

#include "container/container.h"
#include "model/model.h"
#include "registry/registry.h"

static test_memory memory;

extern const btf_codec_vtbl btf_codec_lafortune;

enum { MAX_CHUNKS = 8 };

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

/* Of exactly its size, so that a sanitizer sees reads beyond it. */
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

/* Loads, and if that works evaluates every texel; returns the status. */
static btf_status try_load(btf_context *ctx, const btf_model *model, chunk_list *list) {
  btf_host host = *btfi_host();
  void *state = NULL;
  host.get = get_listed;
  const btf_status status = btf_codec_lafortune.load(&host, ctx, btf_codec_lafortune.format_write,
                                                     &model->shape, (btf_chunk_reader *)(void *)list, &state);
  if (status != BTF_OK) {
    assert_null(state);
    assert_true(btf_error_message()[0] != '\0');
    return status;
  }
  float out[64];
  for (int i = 0; i < 10; i++) {
    btf_query q = {{0},
                   {0},
                   {(float)test_random(), (float)test_random()},
                   (float)(3.0 * test_random()),
                   i % 4 == 0 ? BTF_QUERY_NEAREST : 0};
    test_random_direction(q.light);
    test_random_direction(q.view);
    btf_codec_lafortune.eval(state, &q, out);
  }
  for (uint32_t t = 0; t < model->width * model->height; t++)
    btf_codec_lafortune.texel(state, 0, t % model->width, t / model->width, 1, 2, out);
  btf_codec_lafortune.texel(state, btf_codec_lafortune.levels(state) - 1, 0, 0, 1, 2, out);
  btf_codec_lafortune.destroy(&host, ctx, state);
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
  /* Records of 3 values and more, of both storages: the last ones lie nearer to the end than kernels read. */
  const struct {
    const char *settings;
    uint32_t channels;
  } cases[] = {{"", 3},
               {"kind=phong", 1},
               {"lobes=3 storage=f32", 3},
               {"kind=full storage=f32", 2},
               {"kind=ward", 3},
               {"color=channel", 3},
               {"lobes=1", 1},
               {"kind=lewis storage=f32", 1}};
  btf_context *ctx = test_context(&memory);
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    material m = material_create(ctx, plant_two_lobes, 0.0, "grid:3x2", 3, 2, cases[i].channels,
                                 BTF_QUANTITY_BRDF, BTF_WRAP_PERIODIC);
    btf_model *model = lafortune_fit(ctx, &m, cases[i].settings);
    chunk_list list = list_chunks(model, ctx);
    assert_ok(try_load(ctx, model, &list));
    check(ctx, model, &list);
    assert_ok(try_load(ctx, model, &list));
    for (uint32_t k = 0; k < list.count; k++) free(list.chunk[k].data);
    btf_model_release(model);
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

/* Missing, shorter by any number of bytes, or longer. */
static void check_sizes(btf_context *ctx, const btf_model *model, chunk_list *list) {
  for (uint32_t i = 0; i < list->count; i++) {
    const uint32_t tag = list->chunk[i].tag;
    const uint64_t size = list->chunk[i].size;
    unsigned char *data = list->chunk[i].data;
    list->chunk[i].tag = 0;
    assert_status(try_load(ctx, model, list), BTF_E_CORRUPT);
    list->chunk[i].tag = tag;
    for (uint64_t cut = 0; cut < size + 2; cut++) {
      if (cut == size) continue;
      unsigned char *other = calloc(1, cut + 1);
      memcpy(other, data, cut < size ? cut : size);
      list->chunk[i].data = other;
      list->chunk[i].size = cut;
      assert_status(try_load(ctx, model, list), BTF_E_CORRUPT);
      free(other);
    }
    list->chunk[i].data = data;
    list->chunk[i].size = size;
  }
}

static void test_sizes(void **unused) {
  (void)unused;
  with_models(check_sizes);
}

/* Wild values of every field of the header, scales and records. */
static void check_numbers(btf_context *ctx, const btf_model *model, chunk_list *list) {
  const uint32_t wild[] = {6, 33, 0x7fffffff, 0x80000000u, 0xffffffffu};
  const double numbers[] = {NAN, INFINITY, -1.0};
  const float scales[] = {NAN, INFINITY, -1.0f, 0.0f};
  unsigned char *head = list->chunk[find_chunk(list, LAF_TAG_HEAD)].data, saved[LAF_HEAD_BYTES];
  memcpy(saved, head, sizeof saved);
  for (uint32_t field = 0; field < 6; field++)
    for (size_t i = 0; i < sizeof wild / sizeof *wild; i++) {
      memcpy(head + 4 * field, &wild[i], 4);
      assert_status(try_load(ctx, model, list), BTF_E_CORRUPT);
      memcpy(head, saved, sizeof saved);
    }
  /* Legal values that do not go with the chunks. */
  for (uint32_t field = 0; field < 4; field++)
    for (uint32_t value = 0; value < 6; value++) {
      const uint32_t mine = head[4 * field];
      head[4 * field] = (unsigned char)value;
      const btf_status status = try_load(ctx, model, list);
      /* Phong, Blinn-Phong and Lewis have records of the same size, and colours do of one channel. */
      assert_true(status == BTF_E_CORRUPT ||
                  (status == BTF_OK && (value == mine || field == 0 || field == 2)));
      head[4 * field] = (unsigned char)mine;
    }
  for (uint32_t field = 0; field < 2; field++)
    for (size_t i = 0; i < 3; i++) {
      memcpy(head + 24 + 8 * field, &numbers[i], 8);
      assert_status(try_load(ctx, model, list), BTF_E_CORRUPT);
      memcpy(head, saved, sizeof saved);
    }
  unsigned char *scale = list->chunk[find_chunk(list, LAF_TAG_SCALE)].data;
  memcpy(saved, scale, 4);
  for (size_t i = 0; i < 4; i++) {
    memcpy(scale, &scales[i], 4);
    assert_status(try_load(ctx, model, list), BTF_E_CORRUPT);
  }
  memcpy(scale, saved, 4);
  const uint32_t texels = find_chunk(list, LAF_TAG_TEXELS);
  const uint64_t last = list->chunk[texels].size - 4;
  for (int end = 0; end < 2; end++) {
    unsigned char *value = list->chunk[texels].data + (end ? last : 0);
    memcpy(saved, value, 4);
    memset(value, 0xff, 4);
    assert_status(try_load(ctx, model, list), BTF_E_CORRUPT);
    memcpy(value, saved, 4);
  }
}

static void test_numbers(void **unused) {
  (void)unused;
  with_models(check_numbers);
}

/* Flipped bits anywhere: loads or is refused, and never reads or writes where it must not. */
static void check_bits(btf_context *ctx, const btf_model *model, chunk_list *list) {
  for (int turn = 0; turn < 300; turn++) {
    const uint32_t i = (uint32_t)turn % list->count;
    const uint64_t at = (uint64_t)(test_random() * (double)list->chunk[i].size);
    const unsigned char bit = (unsigned char)(1u << turn / 7 % 8);
    list->chunk[i].data[at] ^= bit;
    const btf_status status = try_load(ctx, model, list);
    assert_true(status == BTF_OK || status == BTF_E_CORRUPT);
    list->chunk[i].data[at] ^= bit;
  }
}

static void test_bits(void **unused) {
  (void)unused;
  with_models(check_bits);
}

/* A file, loaded as a copy and from a mapping, evaluates as the fresh fit does. */
static void test_files(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m =
      material_create(ctx, plant_two_lobes, 0.0, "grid:5x3", 5, 4, 3, BTF_QUANTITY_BRDF, BTF_WRAP_PERIODIC);
  btf_model *model = lafortune_fit(ctx, &m, ""), *loaded;
  const char *path = test_path("lobes.btfz");
  assert_ok(btf_model_save(model, path, 0, NULL, NULL));
  assert_ok(btf_model_load(ctx, path, &loaded));
  for (int i = 0; i < 200; i++) {
    btf_query q = {{0}, {0}, {(float)test_random(), (float)test_random()}, (float)(2.0 * test_random()), 0};
    float a[3], b[3];
    test_random_direction(q.light);
    test_random_direction(q.view);
    btf_model_eval(model, &q, a);
    btf_model_eval(loaded, &q, b);
    assert_memory_equal(a, b, sizeof a);
  }
  btf_model_release(loaded);
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_sizes), cmocka_unit_test(test_numbers),
                                     cmocka_unit_test(test_bits), cmocka_unit_test(test_files)};
  return btf_run("lafortune_payload", tests);
}
