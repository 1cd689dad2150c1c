/* SPDX-License-Identifier: MIT */
/* products.c: the factorisations of a file as sums of products of angular and texel vectors. What the file
 * has apart becomes components of its own: each stored channel of DFMF, the mean of a view of PVF, the mean
 * colour, and where channels are with the texels, each channel. */
#include "bonn_btf/bonn_btf.h"

/* A component of ours in the file. */
typedef struct origin {
  const bonn_factor *factor; /* NULL: the mean colour, for all texels */
  uint32_t stored;           /* channel, of DFMF */
  uint32_t k;                /* factor->k: the mean of a view */
  uint32_t channel;          /* the one it is for where channels are with the texels */
} origin;

static uint64_t components_of(const bonn_file *bonn, uint32_t product) {
  uint64_t sum = 0;
  if (bonn->family == BONN_DFMF) {
    for (uint32_t i = 0; i < bonn->factor_count; i++) sum += bonn->factors[i].k;
    return sum + (bonn_colour_has_mean(bonn) ? 1 : 0);
  }
  const bonn_factor *factor = &bonn->factors[product];
  return ((uint64_t)factor->k + (bonn->family == BONN_PVF ? 1 : 0)) *
         (factor->channels_by_texel ? bonn->channels : 1);
}

static origin origin_of(const bonn_file *bonn, uint32_t product, uint32_t component) {
  if (bonn->family == BONN_DFMF) {
    for (uint32_t i = 0; i < bonn->factor_count; i++) {
      if (component < bonn->factors[i].k) return (origin){&bonn->factors[i], i, component, 0};
      component -= bonn->factors[i].k;
    }
    return (origin){NULL, 0, 0, 0};
  }
  const bonn_factor *factor = &bonn->factors[product];
  if (!factor->channels_by_texel) return (origin){factor, 0, component, 0};
  return (origin){factor, 0, component / bonn->channels, component % bonn->channels};
}

/* A value of a row of one side, or of the mean that stands beside it. */
static float value_at(const origin *o, const bonn_side *side, uint64_t row) {
  const uint32_t size = o->factor->scalar_size, k = o->factor->k;
  if (o->k < k) return bonn_scalar(side->rows + (row * k + o->k) * size, size);
  return side->mean != NULL ? bonn_scalar(side->mean + row * size, size) : 1;
}

static void angular_column(const bonn_file *bonn, const origin *o, uint64_t pairs, float *dst) {
  const uint32_t channels = bonn->channels;
  float weight[64];
  for (uint32_t c = 0; c < channels; c++) {
    if (o->factor == NULL) weight[c] = bonn->colour_mean[c];
    if (o->factor != NULL && bonn->family == BONN_DFMF)
      (void)bonn_colour_weight(bonn, o->stored, c, &weight[c]);
    if (o->factor != NULL && bonn->family != BONN_DFMF) weight[c] = c == o->channel;
  }
  const bool by_row = o->factor != NULL && bonn->family != BONN_DFMF && !o->factor->channels_by_texel;
  for (uint64_t i = 0; i < pairs; i++) {
    const float shared = o->factor == NULL ? 1 : by_row ? 0 : value_at(o, &o->factor->angular, i);
    for (uint32_t c = 0; c < channels; c++)
      dst[i * channels + c] =
          by_row ? value_at(o, &o->factor->angular, i * channels + c) : weight[c] * shared;
  }
}

static void texel_column(const bonn_file *bonn, const origin *o, float *dst) {
  const bool by_texel = o->factor != NULL && o->factor->channels_by_texel && bonn->family != BONN_DFMF;
  for (uint32_t y = 0; y < bonn->height; y++)
    for (uint32_t x = 0; x < bonn->width; x++, dst++) {
      const uint64_t texel =
          (uint64_t)(bonn->height - 1 - y) * bonn->width + x; /* its first row is the top */
      *dst = o->factor == NULL
                 ? 1
                 : value_at(o, &o->factor->texel, by_texel ? texel * bonn->channels + o->channel : texel);
    }
}

static void column(const void *user, uint32_t product, uint32_t side, uint32_t k, float *dst) {
  const bonn_file *bonn = user;
  const origin o = origin_of(bonn, product, k);
  if (side == BTF_SIDE_TEXEL)
    texel_column(bonn, &o, dst);
  else
    angular_column(bonn, &o, bonn->family == BONN_PVF ? bonn->lights[0].count : bonn->pairs, dst);
}

/* Whether halves hold the vectors, colours undone. */
static bool are_halves(const bonn_file *bonn) {
  for (uint32_t i = 0; i < bonn->factor_count; i++)
    if (bonn->factors[i].scalar_size != 2) return false;
  for (uint32_t s = 0; bonn->family == BONN_DFMF && s < bonn->channels; s++)
    for (uint32_t c = 0; c < bonn->channels; c++) {
      float weight = 0;
      (void)bonn_colour_weight(bonn, s, c, &weight);
      if (weight != 0 && fabsf(weight) != 1) return false;
    }
  return !bonn_colour_has_mean(bonn);
}

btf_status bonn_products_prepare(bonn_file *bonn) {
  const btf_host *host = bonn->file.host;
  const uint32_t products = bonn->family == BONN_PVF ? bonn->view_count : 1;
  if (bonn->family == BONN_BDI) return BTF_OK;
  bonn->components = (host->alloc)(bonn->file.ctx, products, sizeof *bonn->components);
  if (bonn->components == NULL) return BTF_E_NOMEM;
  for (uint32_t i = 0; i < products; i++) {
    const uint64_t components = components_of(bonn, i);
    bonn->components[i] = components < UINT32_MAX ? (uint32_t)components : UINT32_MAX;
  }
  return BTF_OK;
}

btf_status bonn_products(void *user, btf_factors *out) {
  const bonn_file *bonn = user;
  const btf_host *host = bonn->file.host;
  float weight;
  if (bonn->family == BONN_BDI)
    return (host->source_error)(BTF_E_UNSUPPORTED, "%s: holds samples (BDI) and no factors", bonn->file.path);
  if (bonn->dynamic_range != 0)
    return (host->source_error)(BTF_E_UNSUPPORTED, "%s: its factors are those of logarithms of the samples",
                                bonn->file.path);
  if (!bonn_colour_weight(bonn, 0, 0, &weight))
    return (host->source_error)(BTF_E_UNSUPPORTED,
                                "%s: its factors are those of colours whose model %u is not linear",
                                bonn->file.path, (unsigned)bonn->colour_model);
  out->products = bonn->family == BONN_PVF ? bonn->view_count : 1;
  out->value_bytes = are_halves(bonn) ? 2 : 4;
  out->components = bonn->components;
  out->column = column;
  out->user = bonn;
  return BTF_OK;
}
