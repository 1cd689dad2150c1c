/* SPDX-License-Identifier: MIT */
/* The payload of FMF: chunks made from the input go straight to the loader, with the sizes that the header
 * asks for, so that every input gets to what lies behind the check of sizes; some inputs are off by a few
 * bytes. */
#include "fuzz_payload.h"

#include "../../codecs/fmf/fmf.h"

enum { LARGEST_TABLE = 1 << 17 };

typedef struct recipe {
  fuzz_shape shape;
  uint32_t tame;   /* singular values, scales and steps are harmless */
  uint32_t faulty; /* 0, or the number of the chunk of a wrong size, from 1 */
  int32_t off;     /* by so many bytes */
  btfi_fmf_head head;
} recipe;

static void take_recipe(fuzz_bytes *in, recipe *r) {
  const uint32_t flags = fuzz_u8(in), fault = fuzz_u8(in);
  r->shape.width = 1 + fuzz_u8(in) % 12;
  r->shape.height = 1 + fuzz_u8(in) % 12;
  r->shape.channels = fuzz_u8(in);
  r->shape.channels = r->shape.channels >= 192 ? r->shape.channels % 64 + 1 : r->shape.channels % 4 + 1;
  const uint32_t sets = fuzz_u8(in);
  r->shape.lights = fuzz_set_names[sets % FUZZ_SETS];
  r->shape.views = fuzz_set_names[sets / FUZZ_SETS % FUZZ_SETS];
  r->shape.wrap = flags & 1;
  r->shape.quantity = flags & 2 ? BTF_QUANTITY_BRDF_COS : BTF_QUANTITY_BRDF;
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

/* 0 if tables are left out because they would be too large to make here. */
static int put_chunks(void *user, btf_chunk_writer *to, const btf_model_shape *shape, fuzz_bytes *in) {
  const recipe *r = user;
  writing writes = {.r = r, .in = in, .to = to}, *w = &writes;
  const uint32_t lights = btf_dirset_count(shape->lights), views = btf_dirset_count(shape->views);
  const uint64_t points[2] = {(uint64_t)lights * views, (uint64_t)shape->width * shape->height};
  btfi_fmf_layout layout;
  uint8_t head[FMF_HEAD_BYTES];
  w->noise = fuzz_u8(w->in) << 16;
  btfi_fmf_put_head(&r->head, head);
  put(w, FMF_TAG_HEAD, 0, head, sizeof head);
  put_sigma(w);
  if (r->head.coding == FMF_PLAIN) {
    if (r->head.columns > FMF_MAX_COLUMNS || r->head.storage >= FMF_STORAGES || r->head.levels > 8) return 0;
    if (!btfi_fmf_layout_of(shape, lights, views, r->head.storage, r->head.columns, r->head.levels,
                            &layout) ||
        layout.u_bytes > LARGEST_TABLE || layout.v_bytes[0] > LARGEST_TABLE)
      return 0;
    put_plain(w, &layout);
  } else {
    if ((points[0] * r->shape.channels + points[1]) * r->head.components > LARGEST_TABLE) return 0;
    put_packed(w, FMF_TAG_PACKED_U, r->shape.channels, points[0]);
    put_packed(w, FMF_TAG_PACKED_V, 1, points[1]);
  }
  return 1;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  fuzz_bytes in = {data, size};
  recipe r = {0};
  take_recipe(&in, &r);
  fuzz_payload_check("fmf", &r.shape, put_chunks, &r, in);
  return 0;
}
