/* SPDX-License-Identifier: MIT */
/* Evaluation. The codec gives the stored quantity of any query; here its domain and the value asked for are
 * applied, by the same arithmetic for one query and for many, so that both agree bit for bit. */
#include "model/model.h"

#include <float.h>
#include <math.h>
#include <string.h>

enum {
  MAX_CHANNELS = 64,
  BLOCK = 2048 /* queries handed to a codec at once: what was read and written is then still in the cache */
};

/* How a stored value becomes the value asked for. */
enum { AS_STORED, TIMES_COSINE, OVER_COSINE, NOTHING };

static int conversion(uint32_t quantity, int32_t value) {
  switch (value) {
  case BTF_VALUE_BRDF:
    return quantity == BTF_QUANTITY_BRDF_COS ? OVER_COSINE : AS_STORED;
  case BTF_VALUE_BRDF_COS:
    return quantity == BTF_QUANTITY_BRDF_COS ? AS_STORED : TIMES_COSINE;
  case BTF_VALUE_STORED:
    return AS_STORED;
  default:
    return NOTHING;
  }
}

static inline float factor_of(int kind, float cosine) {
  switch (kind) {
  case AS_STORED:
    return 1.0f;
  case TIMES_COSINE:
    return cosine;
  case OVER_COSINE:
    return 1.0f / (cosine > 0.02f ? cosine : 0.02f);
  default:
    return 0.0f;
  }
}

/* 0 for a finite x, NaN otherwise. */
static inline float defect(float x) {
  return 0.0f * x;
}

/* The factor where the query is inside the domain, else 0. */
static inline float domain(float factor, float light_z, float view_z, float defects) {
  return light_z > 0.0f && view_z > 0.0f && defects == 0.0f ? factor : 0.0f;
}

static inline float convert(float stored, float factor) {
  const float value = stored * factor;
  /* A comparison that is false for NaN; the factor is 0 outside the domain, where -0 shall not leak either.
   */
  return factor != 0.0f && fabsf(value) <= FLT_MAX ? value : 0.0f;
}

static inline int flags_known(uint32_t flags) {
  return (flags & ~(uint32_t)BTF_QUERY_NEAREST) == 0;
}

static float query_factor(const btf_query *q, int kind) {
  /* Summed in pairs, since one long chain of additions would take longer than all the rest. */
  const float light = defect(q->light[0]) + defect(q->light[1]),
              view = defect(q->view[0]) + defect(q->view[1]);
  const float heights = defect(q->light[2]) + defect(q->view[2]), uv = defect(q->uv[0]) + defect(q->uv[1]);
  const float defects = ((light + view) + (heights + uv)) + defect(q->lod);
  const float factor = flags_known(q->flags) ? factor_of(kind, q->light[2]) : 0.0f;
  return domain(factor, q->light[2], q->view[2], defects);
}

void btf_model_eval_as(const btf_model *model, const btf_query *query, int32_t value, float *out) {
  const float factor = query_factor(query, conversion(model->quantity, value));
  const uint32_t channels = model->channels;
  if (factor == 0.0f) {
    for (uint32_t c = 0; c < channels; c++) out[c] = 0.0f;
    return;
  }
  model->vtbl->eval(model->state, query, out);
  for (uint32_t c = 0; c < channels; c++) out[c] = convert(out[c], factor);
}

void btf_model_eval(const btf_model *model, const btf_query *query, float *out) {
  btf_model_eval_as(model, query, BTF_VALUE_BRDF, out);
}

/* ---- batches ---- */

static void batch_factors(const btf_batch *b, int kind, float *factor) {
  const float *lx = b->light[0], *ly = b->light[1], *lz = b->light[2];
  const float *vx = b->view[0], *vy = b->view[1], *vz = b->view[2];
  const float *u = b->uv[0], *v = b->uv[1], *lod = b->lod;
  const size_t n = b->count;
  for (size_t i = 0; i < n; i++) factor[i] = factor_of(kind, lz[i]);
  for (size_t i = 0; i < n; i++) {
    const float defects = defect(lx[i]) + defect(ly[i]) + defect(lz[i]) + defect(vx[i]) + defect(vy[i]) +
                          defect(vz[i]) + defect(u[i]) + defect(v[i]);
    factor[i] = domain(factor[i], lz[i], vz[i], defects);
  }
  if (lod != NULL)
    for (size_t i = 0; i < n; i++) factor[i] = defect(lod[i]) == 0.0f ? factor[i] : 0.0f;
}

/* For codecs without a batch evaluation of their own. */
static void eval_each(const btf_model *model, const btf_batch *b, float *const *out) {
  float values[MAX_CHANNELS];
  btf_query q;
  q.flags = b->flags;
  for (size_t i = 0; i < b->count; i++) {
    for (int k = 0; k < 3; k++) {
      q.light[k] = b->light[k][i];
      q.view[k] = b->view[k][i];
    }
    q.uv[0] = b->uv[0][i];
    q.uv[1] = b->uv[1][i];
    q.lod = b->lod != NULL ? b->lod[i] : 0.0f;
    model->vtbl->eval(model->state, &q, values);
    for (uint32_t c = 0; c < model->channels; c++) out[c][i] = values[c];
  }
}

static void eval_block(const btf_model *model, const btf_batch *block, int kind, float *const *out) {
  float factor[BLOCK];
  if (model->vtbl->eval_n != NULL)
    model->vtbl->eval_n(model->state, block, out);
  else
    eval_each(model, block, out);
  batch_factors(block, kind, factor);
  for (uint32_t c = 0; c < model->channels; c++) {
    float *values = out[c];
    for (size_t i = 0; i < block->count; i++) values[i] = convert(values[i], factor[i]);
  }
}

/* The rules of btfi_copy_in, without its message: evaluation does not fail. */
static int batch_usable(const btf_batch *batch) {
  const size_t size = batch->struct_size;
  if (size < BTFI_SIZE_TO(btf_batch, reserved) || size > sizeof *batch + 4096) return 0;
  for (size_t i = sizeof *batch; i < size; i++)
    if (((const unsigned char *)batch)[i] != 0) return 0;
  for (int k = 0; k < 3; k++)
    if (batch->light[k] == NULL || batch->view[k] == NULL) return 0;
  return batch->uv[0] != NULL && batch->uv[1] != NULL && batch->reserved == 0;
}

void btf_model_eval_n(const btf_model *model, const btf_batch *batch, int32_t value, float *const *out) {
  const int kind = conversion(model->quantity, value);
  float *block_out[MAX_CHANNELS];
  if (!batch_usable(batch)) return;
  if (!flags_known(batch->flags)) {
    for (uint32_t c = 0; c < model->channels; c++)
      for (size_t i = 0; i < batch->count; i++) out[c][i] = 0.0f;
    return;
  }
  for (size_t first = 0; first < batch->count; first += BLOCK) {
    btf_batch block = BTF_BATCH_INIT;
    block.count = BTFI_MIN(batch->count - first, (size_t)BLOCK);
    for (int k = 0; k < 3; k++) {
      block.light[k] = batch->light[k] + first;
      block.view[k] = batch->view[k] + first;
    }
    block.uv[0] = batch->uv[0] + first;
    block.uv[1] = batch->uv[1] + first;
    block.lod = batch->lod != NULL ? batch->lod + first : NULL;
    block.flags = batch->flags;
    for (uint32_t c = 0; c < model->channels; c++) block_out[c] = out[c] + first;
    eval_block(model, &block, kind, block_out);
  }
}

/* ---- the rest ---- */

uint32_t btf_model_texel(const btf_model *model, uint32_t level, uint32_t x, uint32_t y, uint32_t light,
                         uint32_t view, float *out) {
  const uint32_t channels = model->channels;
  uint32_t defects = 0;
  const int inside = level < model->levels && x < BTFI_MAX(1u, model->width >> level) &&
                     y < BTFI_MAX(1u, model->height >> level) &&
                     light < btf_dirset_count(model->shape.lights) &&
                     view < btf_dirset_count(model->shape.views);
  if (!inside) {
    for (uint32_t c = 0; c < channels; c++) out[c] = 0.0f;
    return 0;
  }
  model->vtbl->texel(model->state, level, x, y, light, view, out);
  for (uint32_t c = 0; c < channels; c++) {
    defects += !isfinite(out[c]);
    out[c] = convert(out[c], 1.0f);
  }
  return defects;
}

float btf_model_lod(const btf_model *model, const float duvdx[2], const float duvdy[2]) {
  const float width = (float)model->width, height = (float)model->height;
  /* hypotf of an infinity and NaN is infinite. */
  if (isnan(duvdx[0]) || isnan(duvdx[1]) || isnan(duvdy[0]) || isnan(duvdy[1])) return 0.0f;
  const float along_x = hypotf(duvdx[0] * width, duvdx[1] * height);
  const float along_y = hypotf(duvdy[0] * width, duvdy[1] * height);
  const float last = (float)(model->levels - 1);
  /* False for the logarithm of 0. */
  const float lod = log2f(along_x > along_y ? along_x : along_y);
  if (!(lod > 0.0f)) return 0.0f;
  return lod < last ? lod : last;
}

static const float one_over_pi = 0.318309886183790672f;

float btf_model_pdf(const btf_model *model, const btf_query *query) {
  (void)model;
  return query_factor(query, AS_STORED) != 0.0f ? query->light[2] * one_over_pi : 0.0f;
}

float btf_model_sample(const btf_model *model, const btf_query *query, const float xi[3], float light[3],
                       float *weight) {
  const int drawable =
      xi[0] >= 0.0f && xi[0] < 1.0f && xi[1] >= 0.0f && xi[1] < 1.0f && xi[2] >= 0.0f && xi[2] < 1.0f;
  const float radius = sqrtf(drawable ? xi[0] : 0.0f),
              azimuth = 6.28318530717958648f * (drawable ? xi[1] : 0.0f);
  btf_query drawn = *query;
  float pdf;
  /* Cosine-weighted: uniform on the disc, lifted to the hemisphere. */
  drawn.light[0] = radius * cosf(azimuth);
  drawn.light[1] = radius * sinf(azimuth);
  drawn.light[2] = sqrtf(1.0f - (drawable ? xi[0] : 0.0f));
  pdf = drawable ? btf_model_pdf(model, &drawn) : 0.0f;
  memcpy(light, drawn.light, sizeof drawn.light);
  if (pdf == 0.0f) {
    for (uint32_t c = 0; c < model->channels; c++) weight[c] = 0.0f;
    return 0.0f;
  }
  btf_model_eval_as(model, &drawn, BTF_VALUE_BRDF, weight);
  for (uint32_t c = 0; c < model->channels; c++) weight[c] = convert(weight[c], drawn.light[2] / pdf);
  return pdf;
}
