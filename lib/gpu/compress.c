/* SPDX-License-Identifier: MIT */
/* compress.c: tables as BC7 or BC6H. Summands become BC7, each component of a slice in the range that it has:
 * blends of what is stored are then blends of what is meant, and a component that is constant costs nothing.
 * Values whose relative error counts become BC6H, which holds three of them in a texel. */
#include "gpu/gpu.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include <btf/btf_half.h>

#include "gpu/block.h"

enum { NOTHING_LOST = 999 /* dB */ };

typedef struct plane_range {
  float low[4], high[4];
} plane_range;

typedef struct compression {
  btf_gpu_builder *b;
  const btfi_gpu_texture *from; /* the table's pages */
  const btfi_texel_format *format;
  const btfi_gpu_pages *old;
  btfi_gpu_pages new; /* of the textures `to` */
  btfi_gpu_texture *to;
  uint32_t texel, rows; /* rows of blocks in a slice, of all levels */
  plane_range *plane;   /* of each slice, over all levels */
  float *range;         /* two vec4 of each: low end and length */
  double *error;        /* squared, of each row and channel */
} compression;

/* ---- texels ---- */

static float finite_or_zero(float value) {
  return fabsf(value) <= 1e30f ? value : 0.0f;
}

static void read_texel(const compression *c, uint32_t level, uint32_t slice, uint32_t x, uint32_t y,
                       float out[4]) {
  const btfi_gpu_texture *t = &c->from[slice / c->old->page];
  const btfi_texel_format *f = c->format;
  const btf_gpu_level *l = &t->levels[level];
  const uint64_t at = ((uint64_t)(slice % c->old->page) * l->height + y) * l->width + x;
  const unsigned char *src = (const unsigned char *)l->data + at * f->channels * f->bytes;
  for (int i = 0; i < 4; i++, src += f->bytes) {
    uint16_t half;
    if (f->bytes == 1) {
      out[i] = f->is_signed ? fmaxf((float)(int8_t)*src / 127.0f, -1.0f) : (float)*src / 255.0f;
    } else if (f->bytes == 2) {
      memcpy(&half, src, sizeof half);
      out[i] = finite_or_zero(btf_half_to_float(half));
    } else {
      memcpy(&out[i], src, sizeof out[i]);
      out[i] = finite_or_zero(out[i]);
    }
  }
}

static uint32_t channels_of(const compression *c) {
  return c->new.packing == BTFI_GPU_RANGES ? 4 : 3;
}

static void find_range(void *job, uint32_t slice, uint32_t thread) {
  const compression *c = job;
  plane_range *r = &c->plane[slice];
  (void)thread;
  for (uint32_t level = 0; level < c->from->level_count; level++) {
    const btf_gpu_level *l = &c->from->levels[level];
    for (uint32_t y = 0; y < l->height; y++)
      for (uint32_t x = 0; x < l->width; x++) {
        float texel[4];
        read_texel(c, level, slice, x, y, texel);
        for (int i = 0; i < 4; i++) {
          const bool is_first = level + y + x == 0;
          r->low[i] = is_first ? texel[i] : fminf(r->low[i], texel[i]);
          r->high[i] = is_first ? texel[i] : fmaxf(r->high[i], texel[i]);
        }
      }
  }
}

/* ---- blocks ---- */

/* Texels x .. x + 3, y .. y + 3 of a slice; those outside repeat the last. */
static void gather(const compression *c, uint32_t slice, uint32_t level, uint32_t x, uint32_t y,
                   float out[BTFI_BLOCK_TEXELS][4]) {
  const btf_gpu_level *l = &c->from->levels[level];
  for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++) {
    const uint32_t tx = BTFI_MIN(x + i % BTFI_BLOCK_SIDE, l->width - 1),
                   ty = BTFI_MIN(y + i / BTFI_BLOCK_SIDE, l->height - 1);
    read_texel(c, level, slice, tx, ty, out[i]);
  }
}

static const float *range_of(const compression *c, uint32_t slice) {
  return c->range + (c->new.ranges > 1 ? 8 * (size_t)slice : 0);
}

/* Encodes in the range of the slice; `out` gets what the shader will see. */
static void put_bc7(const compression *c, uint32_t slice, const float values[BTFI_BLOCK_TEXELS][4],
                    unsigned char *block, float out[BTFI_BLOCK_TEXELS][4]) {
  const float *low = range_of(c, slice), *length = low + 4;
  float texels[BTFI_BLOCK_TEXELS][4];
  unsigned char bytes[BTFI_BLOCK_TEXELS][4];
  uint32_t counts = 0;
  for (uint32_t k = 0; k < 4; k++) {
    if (length[k] > 0.0f) counts |= 1u << k;
    for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++)
      texels[i][k] =
          length[k] > 0.0f ? btfi_clamp((values[i][k] - low[k]) / length[k] * 255.0f, 0.0f, 255.0f) : 0.0f;
  }
  btfi_bc7_encode((const float(*)[4])texels, counts, block);
  btfi_bc7_decode(block, bytes);
  for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++)
    for (uint32_t k = 0; k < 4; k++) out[i][k] = low[k] + length[k] * (float)bytes[i][k] / 255.0f;
}

static void put_bc6h(const compression *c, const float values[BTFI_BLOCK_TEXELS][4], unsigned char *block,
                     float out[BTFI_BLOCK_TEXELS][4]) {
  const bool is_signed = c->texel == BTF_TEXEL_BC6H_SFLOAT;
  uint16_t halves[BTFI_BLOCK_TEXELS][3];
  for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++)
    for (uint32_t k = 0; k < 3; k++)
      halves[i][k] = btf_float_to_half(btfi_clamp(values[i][k], -65504.0f, 65504.0f));
  btfi_bc6h_encode((const uint16_t(*)[3])halves, is_signed, block);
  btfi_bc6h_decode(block, is_signed, halves);
  for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++)
    for (uint32_t k = 0; k < 3; k++) out[i][k] = btf_half_to_float(halves[i][k]);
}

/* Row `task` of blocks: all rows of all levels of the first slice, then of the next. */
static void put_row(void *job, uint32_t task, uint32_t thread) {
  const compression *c = job;
  const uint32_t slice = task / c->rows;
  const btfi_gpu_texture *to = &c->to[slice / c->new.page];
  uint32_t level = 0, row = task % c->rows;
  (void)thread;
  for (uint32_t rows; row >= (rows = (to->levels[level].height + 3) / 4); level++) row -= rows;
  const btf_gpu_level *l = &to->levels[level], *plain = &c->from->levels[level];
  const uint32_t across = (l->width + 3) / 4;
  unsigned char *block = to->data + ((const unsigned char *)l->data - to->data) +
                         l->size / l->depth * (slice % c->new.page) +
                         (uint64_t)row * across * BTFI_BLOCK_BYTES;
  double *error = &c->error[4 * (size_t)task];
  for (uint32_t bx = 0; bx < across; bx++, block += BTFI_BLOCK_BYTES) {
    float values[BTFI_BLOCK_TEXELS][4], shown[BTFI_BLOCK_TEXELS][4];
    gather(c, slice, level, 4 * bx, 4 * row, values);
    if (c->new.packing == BTFI_GPU_RANGES)
      put_bc7(c, slice, (const float(*)[4])values, block, shown);
    else
      put_bc6h(c, (const float(*)[4])values, block, shown);
    for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++) {
      if (4 * bx + i % 4 >= plain->width || 4 * row + i / 4 >= plain->height) continue;
      for (uint32_t k = 0; k < channels_of(c); k++) {
        const double difference = (double)shown[i][k] - (double)values[i][k];
        error[k] += difference * difference;
      }
    }
  }
}

/* ---- what to make of a table ---- */

static bool has_fourth(const compression *c) {
  for (uint32_t s = 0; s < c->old->slices; s++)
    if (c->plane[s].low[3] < 0.0f || c->plane[s].high[3] > 0.0f) return true;
  return false;
}

static bool has_negative(const compression *c) {
  for (uint32_t s = 0; s < c->old->slices; s++)
    for (int i = 0; i < 4; i++)
      if (c->plane[s].low[i] < 0.0f) return true;
  return false;
}

/* A range for each slice if the block of numbers has room for those of this table and one each for the
 * others. */
static uint32_t count_ranges(const btf_gpu_builder *b, uint32_t slices) {
  const uint32_t used = b->block_size + 32 * b->table_count;
  return used <= BTFI_GPU_BLOCK_BYTES && slices <= (BTFI_GPU_BLOCK_BYTES - used) / 32 ? slices : 1;
}

static void choose(compression *c) {
  if ((c->old->flags & BTF_GPU_WIDE) != 0 && c->format->is_float && !has_fourth(c)) {
    c->texel = has_negative(c) ? BTF_TEXEL_BC6H_SFLOAT : BTF_TEXEL_BC6H_UFLOAT;
    c->new.packing = BTFI_GPU_COLORS;
  } else {
    c->texel = BTF_TEXEL_BC7_UNORM;
    c->new.packing = BTFI_GPU_RANGES;
    c->new.ranges = count_ranges(c->b, c->old->slices);
  }
  c->new.page = BTFI_MIN(c->old->slices, c->b->target.max_layers);
  c->new.pages = (c->old->slices + c->new.page - 1) / c->new.page;
}

/* Interfaces want a first level of whole blocks: a table that is not is padded, and then not filtered by the
 * sampler. */
static bool fits(const compression *c) {
  const btf_gpu_builder *b = c->b;
  const uint32_t side = BTFI_MAX(c->from->width, c->from->height);
  const uint32_t textures = b->texture_count - c->old->pages + c->new.pages;
  return (side + 3) / 4 * 4 <= b->target.max_2d &&
         textures <= BTFI_MIN(b->target.max_textures, (uint32_t)BTFI_GPU_TEXTURES) &&
         (c->new.pages == 1 || (c->old->flags & BTF_GPU_STACK) == 0);
}

static uint64_t bytes_of(const btfi_gpu_texture *textures, uint32_t count) {
  uint64_t bytes = 0;
  for (uint32_t i = 0; i < count; i++)
    for (uint32_t l = 0; l < textures[i].level_count; l++) bytes += textures[i].levels[l].size;
  return bytes;
}

static btf_status make_pages(compression *c) {
  for (uint32_t p = 0; p < c->new.pages; p++) {
    btfi_gpu_texture *t = &c->to[p];
    *t = *c->from;
    t->levels = NULL;
    t->data = NULL;
    btfi_gpu_page_name(&c->new, p, t->name);
    t->dimension = c->old->slices > 1 ? BTF_TEXTURE_2D_ARRAY : BTF_TEXTURE_2D;
    t->texel = c->texel;
    t->width = (t->width + 3) & ~3u;
    t->height = (t->height + 3) & ~3u;
    t->filtered = t->filtered && t->width == c->from->width && t->height == c->from->height;
    t->slices = BTFI_MIN(c->new.page, c->old->slices - p * c->new.page);
    BTFI_TRY(btfi_gpu_texture_allocate(c->b->ctx, t));
  }
  c->rows = 0;
  for (uint32_t l = 0; l < c->to->level_count; l++) c->rows += (c->to->levels[l].height + 3) / 4;
  return BTF_OK;
}

/* ---- ranges ---- */

static void set_range(float *range, const plane_range *r) {
  for (int i = 0; i < 4; i++) {
    range[i] = r->low[i];
    range[4 + i] = r->high[i] - r->low[i];
  }
}

static btf_status put_ranges(compression *c) {
  char name[BTFI_GPU_NAME];
  plane_range all = c->plane[0];
  if (c->new.packing != BTFI_GPU_RANGES) return BTF_OK;
  c->range = btfi_calloc(c->b->ctx, c->new.ranges, 8 * sizeof *c->range);
  if (c->range == NULL) return btfi_alloc_status();
  for (uint32_t s = 0; s < c->old->slices; s++) {
    if (c->new.ranges > 1) set_range(c->range + 8 * (size_t)s, &c->plane[s]);
    for (int i = 0; i < 4; i++) {
      all.low[i] = fminf(all.low[i], c->plane[s].low[i]);
      all.high[i] = fmaxf(all.high[i], c->plane[s].high[i]);
    }
  }
  if (c->new.ranges == 1) set_range(c->range, &all);
  snprintf(name, sizeof name, "btf_range%u", (unsigned)(c->old - c->b->table));
  return btfi_gpu_uniform(c->b, name, BTF_UNIFORM_VEC4, 2 * c->new.ranges, c->range);
}

/* ---- what it costs ---- */

/* Sums over the rows in their order, so that threads do not matter. */
static double plane_error(const compression *c, uint32_t slice, uint32_t channel) {
  double sum = 0.0;
  for (uint32_t r = 0; r < c->rows; r++) sum += c->error[4 * ((size_t)slice * c->rows + r) + channel];
  return sum;
}

static double decibels(double mean_error) {
  return mean_error > 0.0 ? fmin(-10.0 * log10(mean_error), NOTHING_LOST) : NOTHING_LOST;
}

/* Adds to the sums of all tables; the textures get the figure of this one. */
static void weigh(const compression *c, double *sum, double *count) {
  double texels = 0.0, error = 0.0, planes = 0.0;
  for (uint32_t l = 0; l < c->from->level_count; l++)
    texels += (double)c->from->levels[l].width * c->from->levels[l].height;
  for (uint32_t slice = 0; slice < c->old->slices; slice++)
    for (uint32_t k = 0; k < channels_of(c); k++) {
      const plane_range *r = &c->plane[slice];
      const double peak = fmax(fabs((double)r->low[k]), fabs((double)r->high[k]));
      if (!(peak > 0.0)) continue;
      error += plane_error(c, slice, k) / (texels * peak * peak);
      planes += 1.0;
    }
  for (uint32_t p = 0; p < c->new.pages; p++)
    c->to[p].psnr_db = decibels(planes > 0.0 ? error / planes : 0.0);
  *sum += error;
  *count += planes;
}

/* ---- a table ---- */

/* The new textures in place of the old ones. */
static void replace_pages(compression *c, uint32_t number) {
  btf_gpu_builder *b = c->b;
  const uint32_t first = c->old->first, old = c->old->pages, after = first + old;
  b->cost.saved_bytes += (double)bytes_of(c->from, old) - (double)bytes_of(c->to, c->new.pages);
  for (uint32_t p = 0; p < old; p++) btfi_gpu_texture_free(b->ctx, &b->texture[first + p]);
  memmove(&b->texture[first + c->new.pages], &b->texture[after],
          (b->texture_count - after) * sizeof *b->texture);
  memcpy(&b->texture[first], c->to, c->new.pages * sizeof *c->to);
  memset(c->to, 0, c->new.pages * sizeof *c->to);
  b->texture_count = b->texture_count - old + c->new.pages;
  for (uint32_t i = number + 1; i < b->table_count; i++)
    b->table[i].first = b->table[i].first - old + c->new.pages;
  b->table[number] = c->new;
}

static btf_status compress_table(compression *c, double *sum, double *count) {
  btf_context *ctx = c->b->ctx;
  uint64_t tasks;
  c->plane = btfi_calloc(ctx, c->old->slices, sizeof *c->plane);
  if (c->plane == NULL) return btfi_alloc_status();
  BTFI_TRY(btfi_parallel(ctx, c->old->slices, find_range, c));
  choose(c);
  if (!fits(c)) return BTF_OK;
  BTFI_TRY(make_pages(c));
  if (bytes_of(c->to, c->new.pages) + 32 * (uint64_t)c->new.ranges >= bytes_of(c->from, c->old->pages))
    return BTF_OK;
  if (!btfi_mul(c->old->slices, c->rows, &tasks) || tasks > UINT32_MAX / 2)
    return btfi_fail(ctx, BTF_E_LIMIT, "GPU export: %s has too many blocks", c->old->name);
  c->error = btfi_calloc(ctx, tasks, 4 * sizeof *c->error);
  if (c->error == NULL) return btfi_alloc_status();
  BTFI_TRY(put_ranges(c));
  BTFI_TRY(btfi_parallel(ctx, (uint32_t)tasks, put_row, c));
  weigh(c, sum, count);
  replace_pages(c, (uint32_t)(c->old - c->b->table));
  return BTF_OK;
}

static btf_status consider_table(btf_gpu_builder *b, uint32_t number, double *sum, double *count) {
  btfi_gpu_pages *t = &b->table[number];
  compression c = {.b = b, .from = &b->texture[t->first], .old = t, .new = *t};
  if ((t->flags & BTF_GPU_SMOOTH) == 0) return BTF_OK;
  c.format = btfi_texel_format_of(c.from->texel);
  if (c.format->channels != 4) return BTF_OK;
  c.to = btfi_calloc(b->ctx, BTFI_GPU_TEXTURES, sizeof *c.to);
  if (c.to == NULL) return btfi_alloc_status();
  const btf_status status = compress_table(&c, sum, count);
  for (uint32_t p = 0; p < BTFI_GPU_TEXTURES; p++) btfi_gpu_texture_free(b->ctx, &c.to[p]);
  btfi_free(b->ctx, c.to);
  btfi_free(b->ctx, c.plane);
  btfi_free(b->ctx, c.range);
  btfi_free(b->ctx, c.error);
  return status;
}

btf_status btfi_gpu_compress(btf_gpu_builder *b) {
  double sum = 0.0, count = 0.0;
  bool any = false;
  for (uint32_t i = 0; i < b->table_count; i++) BTFI_TRY(consider_table(b, i, &sum, &count));
  for (uint32_t i = 0; i < b->table_count; i++) any = any || b->table[i].packing != BTFI_GPU_PLAIN;
  if (any) b->cost.psnr_db = decibels(count > 0.0 ? sum / count : 0.0);
  return BTF_OK;
}
