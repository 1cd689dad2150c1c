/* SPDX-License-Identifier: MIT */
/* store.c: what storage does to a view's tables, and writing them. */
#include "pvpca.h"

#include <math.h>
#include <string.h>

#include <btf/btf_codec.h>

enum { COLUMNS = PVPCA_MAX_TERMS + 1 };

static float inverse_of(float largest) {
  return largest > PVPCA_SMALLEST ? 1.0f / largest : 0.0f;
}

/* ---- measuring ---- */

typedef struct measuring {
  const btfi_pvpca_fit_job *f;
  uint32_t columns, storage;
  double *square, *error; /* PVPCA_PARTS x columns each */
  float largest[PVPCA_PARTS][COLUMNS];
} measuring;

static void measure_part(void *job, uint32_t part, uint32_t thread) {
  measuring *m = job;
  const uint64_t first = m->f->columns * part / PVPCA_PARTS, last = m->f->columns * (part + 1) / PVPCA_PARTS;
  const uint32_t columns = m->columns;
  double square[COLUMNS] = {0.0};
  float largest[COLUMNS] = {0.0f};
  (void)thread;
  for (uint64_t i = first; i < last; i++) {
    const float *h = m->f->textures + i * columns;
    for (uint32_t j = 0; j < columns; j++) {
      const float magnitude = fabsf(h[j]);
      square[j] += (double)h[j] * (double)h[j];
      if (magnitude > largest[j]) largest[j] = magnitude;
    }
  }
  memcpy(m->square + (size_t)part * columns, square, columns * sizeof *square);
  memcpy(m->largest[part], largest, columns * sizeof *largest);
}

static void error_part(void *job, uint32_t part, uint32_t thread) {
  measuring *m = job;
  const uint64_t first = m->f->columns * part / PVPCA_PARTS, last = m->f->columns * (part + 1) / PVPCA_PARTS;
  const uint32_t columns = m->columns;
  double error[COLUMNS] = {0.0};
  (void)thread;
  for (uint64_t i = first; i < last; i++) {
    const float *h = m->f->textures + i * columns;
    for (uint32_t j = 0; j < columns; j++) {
      const float largest = m->f->largest[j];
      const double rounded = (double)btfi_pvpca_round(m->storage, h[j] * inverse_of(largest)) * largest;
      error[j] += (h[j] - rounded) * (h[j] - rounded);
    }
  }
  memcpy(m->error + (size_t)part * columns, error, columns * sizeof *error);
}

static float largest_weight(const btfi_pvpca_fit_job *f, uint32_t terms, uint32_t j) {
  float largest = 0.0f;
  for (uint64_t i = 0; i < f->rows; i++) largest = fmaxf(largest, fabsf(f->weights[i * terms + j]));
  return largest;
}

static double weight_error(const btfi_pvpca_fit_job *f, uint32_t terms, uint32_t j) {
  const uint32_t storage = btfi_pvpca_weight_storage(f->layout.storage);
  const float largest = largest_weight(f, terms, j);
  double error = 0.0;
  for (uint64_t i = 0; i < f->rows; i++) {
    const double g = (double)f->weights[i * terms + j];
    const double rounded = (double)btfi_pvpca_round(storage, (float)g * inverse_of(largest)) * largest;
    error += (g - rounded) * (g - rounded);
  }
  return error;
}

/* Weights of a view are orthonormal, its eigen-textures orthogonal, and the mean of the weights of a centred
 * matrix is 0: gains and errors of the terms add up. */
btf_status btfi_pvpca_measure(btfi_pvpca_fit_job *f, uint32_t view, uint32_t terms) {
  const uint32_t columns = f->layout.has_mean + terms, mean = f->layout.has_mean;
  measuring m = {.f = f, .columns = columns, .storage = f->layout.storage, .square = f->part_sums};
  m.error = m.square + (size_t)PVPCA_PARTS * columns;
  memset(m.square, 0, 2 * (size_t)PVPCA_PARTS * columns * sizeof *m.square);
  BTF_TRY(f->host->parallel(f->ctx, PVPCA_PARTS, measure_part, &m));
  for (uint32_t j = 0; j < columns; j++) {
    f->largest[j] = 0.0f;
    for (uint32_t part = 0; part < PVPCA_PARTS; part++)
      f->largest[j] = fmaxf(f->largest[j], m.largest[part][j]);
  }
  if (f->layout.storage != PVPCA_F32) BTF_TRY(f->host->parallel(f->ctx, PVPCA_PARTS, error_part, &m));
  f->mean_error[view] = 0.0;
  for (uint32_t j = 0; j < columns; j++) {
    double square = 0.0, error = 0.0;
    for (uint32_t part = 0; part < PVPCA_PARTS; part++) {
      square += m.square[(size_t)part * columns + j];
      error += m.error[(size_t)part * columns + j];
    }
    if (j < mean) {
      f->mean_error[view] = error * (double)f->rows;
      continue;
    }
    if (f->layout.storage != PVPCA_F32) error += square * weight_error(f, terms, j - mean);
    f->candidates[(size_t)view * f->keep + j - mean] = (btfi_pvpca_candidate){square, error, view, j - mean};
  }
  return BTF_OK;
}

/* ---- writing ---- */

btf_status btfi_pvpca_reserve(btfi_pvpca_fit_job *f) {
  const btf_host *host = f->host;
  btfi_pvpca_layout *layout = &f->layout;
  void *chunk;
  if (!btfi_pvpca_layout_of(layout, f->view))
    return host->fail(f->ctx, BTF_E_LIMIT, "pvpca: the tables would not fit 64 bits");
  BTF_TRY(host->reserve(f->payload, PVPCA_TAG_TERMS, 0, 0, 4 * (uint64_t)layout->views, &chunk));
  for (uint32_t v = 0; v < layout->views; v++)
    btf_put_u32((unsigned char *)chunk + 4 * (size_t)v, f->view[v].terms);
  BTF_TRY(host->reserve(f->payload, PVPCA_TAG_SCALES, 0, 0, 4 * layout->scales, &chunk));
  f->scales = chunk;
  BTF_TRY(host->reserve(f->payload, PVPCA_TAG_WEIGHTS, 0, BTF_PAYLOAD_IN_PLACE, layout->g_bytes, &chunk));
  f->g = chunk;
  for (uint32_t level = 0; level < layout->levels; level++) {
    BTF_TRY(host->reserve(f->payload, PVPCA_TAG_TEXTURES, level, BTF_PAYLOAD_IN_PLACE, layout->h_bytes[level],
                          &chunk));
    f->h[level] = chunk;
  }
  return BTF_OK;
}

typedef struct storing {
  const float *src;
  unsigned char *dst;
  uint64_t rows; /* of `columns` values */
  uint32_t columns, storage;
  float inverse[COLUMNS];
} storing;

static void store_part(void *job, uint32_t part, uint32_t thread) {
  const storing *s = job;
  const uint64_t first = s->rows * part / PVPCA_PARTS, last = s->rows * (part + 1) / PVPCA_PARTS;
  const uint32_t columns = s->columns;
  const uint64_t bytes = (uint64_t)columns * btfi_pvpca_value_bytes(s->storage);
  float row[COLUMNS];
  (void)thread;
  for (uint64_t i = first; i < last; i++) {
    for (uint32_t j = 0; j < columns; j++) row[j] = s->src[i * columns + j] * s->inverse[j];
    btfi_pvpca_store(s->storage, row, columns, s->dst + i * bytes);
  }
}

/* NULL: columns are stored as they are. */
static void set_inverse(storing *s, const float *inverse) {
  for (uint32_t j = 0; j < s->columns; j++) s->inverse[j] = inverse != NULL ? inverse[j] : 1.0f;
}

btf_status btfi_pvpca_store_weights(btfi_pvpca_fit_job *f, uint32_t v, const float *inverse) {
  const btfi_pvpca_view *view = &f->view[v];
  storing s = {.src = f->weights,
               .dst = f->g + view->g_start,
               .rows = f->rows,
               .columns = view->terms,
               .storage = btfi_pvpca_weight_storage(f->layout.storage)};
  set_inverse(&s, inverse);
  return f->host->parallel(f->ctx, PVPCA_PARTS, store_part, &s);
}

btf_status btfi_pvpca_store_textures(btfi_pvpca_fit_job *f, uint32_t v, const float *inverse) {
  const btfi_pvpca_layout *layout = &f->layout;
  const btfi_pvpca_view *view = &f->view[v];
  const uint32_t texel_values = layout->h_channels * view->columns;
  for (uint32_t level = 0; level < layout->levels; level++) {
    storing s = {.src = level == 0 ? f->textures : f->level,
                 .dst = f->h[level] + layout->level_texels[level] * view->h_before,
                 .rows = layout->level_texels[level] * layout->h_channels,
                 .columns = view->columns,
                 .storage = layout->storage};
    set_inverse(&s, inverse);
    if (level > 0)
      BTF_TRY(f->host->mip_filter(f->ctx, f->textures, texel_values, layout->width, layout->height,
                                  texel_values, level, f->level, texel_values));
    BTF_TRY(f->host->parallel(f->ctx, PVPCA_PARTS, store_part, &s));
  }
  return BTF_OK;
}

static btf_status write_weights(btfi_pvpca_fit_job *f, uint32_t v) {
  const btfi_pvpca_view *view = &f->view[v];
  const uint32_t mean = f->layout.has_mean;
  unsigned char *scales = f->scales + 4 * view->scale_start;
  float inverse[COLUMNS];
  for (uint32_t j = 0; j < view->columns; j++) {
    const float weight = j < mean ? 1.0f : largest_weight(f, view->terms, j - mean);
    const float scale = f->largest[j] > PVPCA_SMALLEST ? f->largest[j] * weight : 0.0f;
    if (!isfinite(scale))
      return f->host->fail(f->ctx, BTF_E_NUMERIC, "pvpca: samples are too large for single precision");
    btf_put_f32(scales + 4 * (size_t)j, scale);
    if (j >= mean) inverse[j - mean] = inverse_of(weight);
  }
  return btfi_pvpca_store_weights(f, v, inverse);
}

btf_status btfi_pvpca_write_view(btfi_pvpca_fit_job *f, uint32_t v) {
  const btfi_pvpca_view *view = &f->view[v];
  float inverse[COLUMNS];
  double error = f->centred[v] + f->mean_error[v];
  BTF_TRY(write_weights(f, v));
  if (view->columns == 0) {
    f->squared_error += error;
    return BTF_OK;
  }
  for (uint32_t j = 0; j < view->columns; j++) inverse[j] = inverse_of(f->largest[j]);
  BTF_TRY(btfi_pvpca_store_textures(f, v, inverse));
  for (uint32_t j = 0; j < view->terms; j++) {
    const btfi_pvpca_candidate *term = &f->candidates[(size_t)v * f->keep + j];
    error += term->error - term->gain;
  }
  f->squared_error += fmax(error, 0.0);
  return BTF_OK;
}

btf_status btfi_pvpca_write_head(const btfi_pvpca_fit_job *f) {
  unsigned char head[PVPCA_HEAD_BYTES] = {0};
  const btfi_pvpca_layout *layout = &f->layout;
  btf_put_u32(head, layout->color);
  btf_put_u32(head + 4, layout->storage);
  btf_put_u32(head + 8, layout->levels);
  btf_put_u32(head + 12, layout->has_mean ? PVPCA_FLAG_MEAN : 0);
  btf_put_u32(head + 16, layout->terms);
  btf_put_f64(head + 24, f->squared_error);
  btf_put_f64(head + 32, f->energy);
  return f->host->put(f->payload, PVPCA_TAG_HEAD, 0, 0, head, sizeof head);
}
