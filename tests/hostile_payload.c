/* SPDX-License-Identifier: MIT */
#include "hostile_payload.h"

#include <btf/btf_sampling.h>

#include "container/container.h"
#include "model/model.h"
#include "registry/registry.h"

static float draw(hostile_payload *p) {
  p->random = p->random * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
  return (float)(p->random >> 40) * (1.0f / 16777216.0f);
}

static void draw_direction(hostile_payload *p, float d[3]) {
  const float turn = 6.2831853f * draw(p), z = 0.02f + 0.98f * draw(p), r = sqrtf(1.0f - z * z);
  d[0] = r * cosf(turn);
  d[1] = r * sinf(turn);
  d[2] = z;
}

/* ---- chunks ---- */

static unsigned char *copy_chunk(const void *data, uint64_t size, uint64_t kept) {
  unsigned char *copy = NULL;
  assert_int_equal(posix_memalign((void **)&copy, 64, size > 0 ? size : 1), 0);
  memset(copy, 0, size);
  memcpy(copy, data, kept);
  return copy;
}

/* Stands where the host's own is; the reader is the payload. */
static btf_status get_listed(btf_chunk_reader *reader, uint32_t tag, uint32_t index, const void **data,
                             uint64_t *size) {
  const hostile_payload *p = (const hostile_payload *)(const void *)reader;
  for (uint32_t i = 0; i < p->count; i++) {
    if (p->chunk[i].tag != tag || p->chunk[i].index != index) continue;
    *data = p->chunk[i].data;
    *size = p->chunk[i].size;
    return BTF_OK;
  }
  return (btfi_host()->fail)(p->ctx, BTF_E_CORRUPT, "no such chunk");
}

uint32_t hostile_find(const hostile_payload *p, uint32_t tag) {
  for (uint32_t i = 0; i < p->count; i++)
    if (p->chunk[i].tag == tag) return i;
  fail_msg("chunk is missing");
  return 0;
}

unsigned char *hostile_data(const hostile_payload *p, uint32_t tag) {
  return p->chunk[hostile_find(p, tag)].data;
}

/* ---- loading ---- */

static void expect_finite(const float *out, uint32_t channels) {
  for (uint32_t c = 0; c < channels; c++) assert_true(isfinite(out[c]));
}

static void evaluate_everywhere(hostile_payload *p, const void *state) {
  const btf_model_shape *shape = &p->model->shape;
  const uint32_t lights = btf_dirset_count(shape->lights), views = btf_dirset_count(shape->views);
  float out[64];
  assert_true(shape->channels <= 64);
  for (int i = 0; i < 20; i++) {
    btf_query q = {{0}, {0}, {draw(p), draw(p)}, 3.0f * draw(p), i % 4 == 0 ? BTF_QUERY_NEAREST : 0};
    draw_direction(p, q.light);
    draw_direction(p, q.view);
    p->codec->eval(state, &q, out);
    expect_finite(out, shape->channels);
  }
  /* All texels, the last ones of tables among them, and the first and last rows of directions. */
  for (uint32_t level = 0; level < p->codec->levels(state); level++) {
    const uint32_t width = btf_sampling_level_size(shape->width, level),
                   height = btf_sampling_level_size(shape->height, level);
    for (uint32_t t = 0; t < width * height; t++) {
      p->codec->texel(state, level, t % width, t / width, lights - 1, views - 1, out);
      expect_finite(out, shape->channels);
      p->codec->texel(state, level, t % width, t / width, 0, 0, out);
      expect_finite(out, shape->channels);
    }
  }
}

btf_status hostile_load(hostile_payload *p) {
  btf_host host = *btfi_host();
  void *state = NULL;
  host.get = get_listed;
  const btf_status status = p->codec->load(&host, p->ctx, p->codec->format_write, &p->model->shape,
                                           (btf_chunk_reader *)(void *)p, &state);
  if (status != BTF_OK) {
    assert_null(state);
    assert_true(btf_error_message()[0] != '\0');
    return status;
  }
  evaluate_everywhere(p, state);
  p->codec->destroy(&host, p->ctx, state);
  return BTF_OK;
}

btf_status hostile_change(hostile_payload *p, unsigned char *at, const void *bytes, size_t size) {
  unsigned char saved[64];
  assert_true(size <= sizeof saved);
  memcpy(saved, at, size);
  memcpy(at, bytes, size);
  const btf_status status = hostile_load(p);
  memcpy(at, saved, size);
  return status;
}

void hostile_with(btf_context *ctx, const btf_codec_vtbl *codec, btf_model *model,
                  void (*check)(hostile_payload *payload)) {
  hostile_payload p = {.codec = codec, .ctx = ctx, .model = model, .random = 1};
  p.count = btfi_payload_chunk_count(model->payload);
  assert_in_range(p.count, 1, HOSTILE_CHUNKS);
  for (uint32_t i = 0; i < p.count; i++) {
    btfi_chunk chunk;
    assert_ok(btfi_payload_chunk(model->payload, i, &chunk));
    p.chunk[i].tag = chunk.tag;
    p.chunk[i].index = chunk.index;
    p.chunk[i].size = chunk.size;
    p.chunk[i].data = copy_chunk(chunk.data, chunk.size, chunk.size);
  }
  assert_ok(hostile_load(&p));
  check(&p);
  assert_ok(hostile_load(&p));
  for (uint32_t i = 0; i < p.count; i++) free(p.chunk[i].data);
  btf_model_release(model);
}

/* ---- checks ---- */

static void expect_size_refused(hostile_payload *p, uint32_t i, uint64_t size) {
  unsigned char *const data = p->chunk[i].data;
  const uint64_t whole = p->chunk[i].size;
  p->chunk[i].data = copy_chunk(data, size, size < whole ? size : whole);
  p->chunk[i].size = size;
  assert_status(hostile_load(p), BTF_E_CORRUPT);
  free(p->chunk[i].data);
  p->chunk[i].data = data;
  p->chunk[i].size = whole;
}

void hostile_sizes(hostile_payload *p) {
  for (uint32_t i = 0; i < p->count; i++) {
    const uint32_t tag = p->chunk[i].tag;
    const uint64_t size = p->chunk[i].size, step = size > 1024 ? size / 97 : 1;
    p->chunk[i].tag = 0;
    assert_status(hostile_load(p), BTF_E_CORRUPT);
    p->chunk[i].tag = tag;
    for (uint64_t cut = 0; cut < size; cut += step) expect_size_refused(p, i, cut);
    if (size > 0) expect_size_refused(p, i, size - 1);
    expect_size_refused(p, i, size + 1);
  }
}

void hostile_bits(hostile_payload *p, uint32_t turns, int stores_sizes) {
  for (uint32_t turn = 0; turn < turns; turn++) {
    const uint32_t i = turn % p->count;
    const uint64_t at = (uint64_t)((double)draw(p) * (double)p->chunk[i].size);
    const unsigned char bit = (unsigned char)(1u << turn / 7 % 8);
    if (p->chunk[i].size == 0) continue;
    p->chunk[i].data[at] ^= bit;
    const btf_status status = hostile_load(p);
    assert_true(status == BTF_OK || status == BTF_E_CORRUPT || (stores_sizes && status == BTF_E_NOMEM));
    p->chunk[i].data[at] ^= bit;
  }
}
