/* SPDX-License-Identifier: MIT */
/* The payload of the codec FUZZ_CODEC: models of its rows of codec_cases.c are fitted once; the input takes
 * the chunks of one of them and changes bytes, numbers, sizes, names and the shape they are loaded for. */
#include "fuzz_payload.h"

#include <math.h>

#include "codec_cases.h"
#include "fuzz_codec.h"
#include "model/model.h"

enum { MOST_MODELS = 64, MOST_CHUNKS = 256, MOST_EDITS = 48, LARGEST_CHUNK = 1 << 20 };

/* Of the leak checker, where there is one. */
extern void __lsan_disable(void) __attribute__((weak));
extern void __lsan_enable(void) __attribute__((weak));

typedef struct chunk {
  uint32_t tag, index, flags;
  uint8_t *bytes;
  uint64_t size;
} chunk;

typedef struct payload {
  fuzz_shape shape;
  chunk chunks[MOST_CHUNKS];
  uint32_t count;
} payload;

static payload models[MOST_MODELS];
static uint32_t model_count;

static uint8_t *copy_of(const void *bytes, uint64_t size) {
  uint8_t *copy = malloc(size > 0 ? size : 1);
  fuzz_expect(copy != NULL);
  if (size > 0) memcpy(copy, bytes, size);
  return copy;
}

/* ---- models that are right ---- */

static void keep(const btf_model *model, uint32_t material, uint32_t channels) {
  const codec_material *m = &codec_materials[material];
  fuzz_expect(model_count < MOST_MODELS);
  payload *p = &models[model_count++];
  p->shape = (fuzz_shape){m->width, m->height, channels, m->quantity, m->wrap, m->lights, m->views};
  for (uint32_t i = 0; i < btfi_payload_chunk_count(model->payload) && i < MOST_CHUNKS; i++) {
    btfi_chunk c;
    fuzz_expect(btfi_payload_chunk(model->payload, i, &c) == BTF_OK);
    p->chunks[p->count++] = (chunk){c.tag, c.index, c.flags, copy_of(c.data, c.size), c.size};
  }
}

static void fit_all(void) {
  static const uint32_t materials[] = {MATERIAL_TINY, MATERIAL_TEXEL};
  btf_context *ctx = fuzz_context((uint64_t)1 << 30);
  for (size_t i = 0; i < codec_case_count; i++) {
    const codec_case *row = &codec_cases[i];
    if (strcmp(row->codec, FUZZ_CODEC) != 0) continue;
    for (size_t k = 0; k < sizeof materials / sizeof *materials; k++) {
      const uint32_t channels = codec_case_channels(row, k == 0 ? 3 : 1);
      const codec_dataset_recipe recipe = {materials[k], channels, SOURCE_RESIDENT, 0, 0.0f, 0.0f};
      btf_model *model;
      const btf_status status = codec_case_fit(ctx, row, &recipe, NULL, NULL, &model);
      if (status == BTF_E_UNSUPPORTED && row->unsupported & 1u << materials[k]) continue;
      fuzz_expect(status == BTF_OK);
      keep(model, materials[k], channels);
      btf_model_release(model);
    }
  }
  btf_context_release(ctx);
  fuzz_expect(model_count > 0); /* FUZZ_CODEC has no row */
}

/* ---- changes ---- */

/* Numbers that loaders get wrong, as 32 bits and as doubles. */
static const uint32_t words[SPECIALS] = {0,
                                         1,
                                         2,
                                         0xffffffffu,
                                         0x80000000u,
                                         0x7fffffffu,
                                         0x10000,
                                         0xffff,
                                         256,
                                         1u << 24,
                                         1u << 30,
                                         0x7fc00000u /* NaN */,
                                         0x7f800000u /* infinity */,
                                         0xff800000u,
                                         0x7f7fffffu /* largest */,
                                         0xbf800000u};
static const double doubles[SPECIALS] = {0.0,       -0.0, 1e-320, -1.0, 1e30, -1e300, 1.7e308,      INFINITY,
                                         -INFINITY, NAN,  1e-30,  0.5,  1e10, 1.0,    4294967296.0, 3.5e38};

static void put_word(chunk *c, uint64_t at, uint32_t word) {
  for (uint64_t i = 0; i < 4 && at + i < c->size; i++) c->bytes[at + i] = (uint8_t)(word >> (8 * i));
}

static uint32_t word_at(const chunk *c, uint64_t at) {
  uint32_t word = 0;
  for (uint64_t i = 0; i < 4 && at + i < c->size; i++) word |= (uint32_t)c->bytes[at + i] << (8 * i);
  return word;
}

static void resize(chunk *c, uint64_t size) {
  if (size > LARGEST_CHUNK) size = LARGEST_CHUNK;
  /* Of exactly this size, so that a sanitizer sees reads past the end. */
  uint8_t *bytes = calloc(size > 0 ? size : 1, 1);
  fuzz_expect(bytes != NULL);
  memcpy(bytes, c->bytes, size < c->size ? size : c->size);
  free(c->bytes);
  c->bytes = bytes;
  c->size = size;
}

static void change_shape(fuzz_shape *s, fuzz_bytes *in) {
  const uint32_t what = fuzz_u8(in), value = fuzz_u8(in);
  switch (what % 8) {
  case 0:
    s->width = 1 + value % 12;
    break;
  case 1:
    s->height = 1 + value % 12;
    break;
  case 2:
    s->channels = value >= 192 ? value % 64 + 1 : value % 4 + 1;
    break;
  case 3:
    s->quantity = value & 1 ? BTF_QUANTITY_BRDF_COS : BTF_QUANTITY_BRDF;
    break;
  case 4:
    s->wrap = value & 1;
    break;
  case 5:
    s->lights = fuzz_set_names[value % FUZZ_SETS];
    break;
  case 6:
    s->views = fuzz_set_names[value % FUZZ_SETS];
    break;
  default: { /* the same number of texels */
    const uint32_t width = s->width;
    s->width = s->height;
    s->height = width;
    break;
  }
  }
}

/* One change of one chunk; 0 when the input ends the changes. */
static int edit(payload *p, fuzz_bytes *in) {
  if (in->size == 0) return 0;
  const uint32_t kind = fuzz_u8(in) % EDITS;
  if (kind == EDIT_STOP) return 0;
  if (kind == EDIT_SHAPE) {
    change_shape(&p->shape, in);
    return 1;
  }
  if (p->count == 0) return 0;
  chunk *c = &p->chunks[fuzz_u8(in) % p->count];
  const uint64_t at = c->size > 0 ? fuzz_u16(in) % c->size : 0;
  switch (kind) {
  case EDIT_BYTE:
    if (c->size > 0) c->bytes[at] = (uint8_t)fuzz_u8(in);
    break;
  case EDIT_FLIP:
    if (c->size > 0) c->bytes[at] ^= (uint8_t)(1u << fuzz_u8(in) % 8);
    break;
  case EDIT_WORD:
    put_word(c, at & ~UINT64_C(3), fuzz_u16(in) | fuzz_u16(in) << 16);
    break;
  case EDIT_SPECIAL_WORD:
    put_word(c, at & ~UINT64_C(3), words[fuzz_u8(in) % SPECIALS]);
    break;
  case EDIT_SPECIAL_DOUBLE: {
    uint64_t bits;
    memcpy(&bits, &doubles[fuzz_u8(in) % SPECIALS], sizeof bits);
    put_word(c, at & ~UINT64_C(3), (uint32_t)bits);
    put_word(c, (at & ~UINT64_C(3)) + 4, (uint32_t)(bits >> 32));
    break;
  }
  case EDIT_NUDGE:
    put_word(c, at & ~UINT64_C(3), word_at(c, at & ~UINT64_C(3)) + (fuzz_u8(in) & 1 ? 1u : 0xffffffffu));
    break;
  case EDIT_RESIZE:
    resize(c, fuzz_u16(in));
    break;
  case EDIT_NUDGE_SIZE: {
    const uint64_t more = fuzz_u8(in);
    resize(c, more < 128 ? c->size + more + 1 : c->size > more - 127 ? c->size - (more - 127) : 0);
    break;
  }
  case EDIT_FILL: {
    const uint64_t length = fuzz_u16(in);
    const int value = (int)fuzz_u8(in);
    memset(c->bytes + at, value, length < c->size - at ? length : c->size - at);
    break;
  }
  case EDIT_DROP:
    free(c->bytes);
    *c = p->chunks[--p->count];
    break;
  case EDIT_SWAP: {
    chunk *other = &p->chunks[fuzz_u8(in) % p->count];
    const chunk mine = *c;
    c->bytes = other->bytes;
    c->size = other->size;
    other->bytes = mine.bytes;
    other->size = mine.size;
    break;
  }
  default:
    c->index = fuzz_u8(in);
    break;
  }
  return 1;
}

/* A name may be used once: chunks whose name is taken are left out. */
static int write_chunks(void *user, btf_chunk_writer *to, const btf_model_shape *shape, fuzz_bytes *in) {
  const payload *p = user;
  (void)shape, (void)in;
  for (uint32_t i = 0; i < p->count; i++) {
    const chunk *c = &p->chunks[i];
    const btf_status status = btfi_chunk_put(to, c->tag, c->index, c->flags, c->bytes, c->size);
    fuzz_expect(status == BTF_OK || status == BTF_E_INVALID_ARG || status == BTF_E_LIMIT);
  }
  return 1;
}

uint32_t fuzz_codec_chunks(uint32_t model) {
  return model < model_count ? models[model].count : 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  static payload p;
  fuzz_bytes in = {data, size};
  if (model_count == 0) {
    if (__lsan_disable) __lsan_disable(); /* the models stay */
    fit_all();
    if (__lsan_enable) __lsan_enable();
  }
  p = models[fuzz_u8(&in) % model_count];
  for (uint32_t i = 0; i < p.count; i++) p.chunks[i].bytes = copy_of(p.chunks[i].bytes, p.chunks[i].size);
  for (uint32_t i = 0; i < MOST_EDITS && edit(&p, &in); i++) continue;
  fuzz_payload_check(FUZZ_CODEC, &p.shape, write_chunks, &p, in);
  for (uint32_t i = 0; i < p.count; i++) free(p.chunks[i].bytes);
  return 0;
}
