/* SPDX-License-Identifier: MIT */
/* factors.c: the factorisations of DFMF, FMF and PVF. */
#include <stdio.h>

#include "bonn_btf/bonn_btf.h"

static btf_status corrupt_factor(const bonn_file *bonn, uint32_t i, const char *what, uint64_t got) {
  return (bonn->file.host->fail)(bonn->file.ctx, BTF_E_CORRUPT, "%s: factorisation %u: %llu %s",
                                 bonn->file.path, (unsigned)i, (unsigned long long)got, what);
}

static btf_status check_sizes(const bonn_file *bonn, uint32_t i, uint32_t scalar_size, uint32_t k,
                              uint64_t rows, uint64_t columns) {
  if (scalar_size != 2 && scalar_size != 4 && scalar_size != 8)
    return corrupt_factor(bonn, i, "bytes in a number; expected 2, 4 or 8", scalar_size);
  if (k < 1) return corrupt_factor(bonn, i, "components; expected at least 1", k);
  if (k > rows || k > columns)
    return corrupt_factor(bonn, i, "components are more than its matrix has rows or columns", k);
  return BTF_OK;
}

/* U of `rows` and S V of `columns`, as DFMF and FMF have them. `channels` of them are in a row of whichever
 * is the longer side. */
static btf_status read_matrix(bonn_file *bonn, cursor *c, uint32_t i, uint32_t channels) {
  bonn_factor *factor = &bonn->factors[i];
  const uint64_t angles = bonn->pairs;
  const uint64_t texels = (uint64_t)bonn->width * bonn->height;
  factor->scalar_size = cursor_u8(c);
  factor->k = cursor_u32(c);
  const uint64_t rows = cursor_u32(c), columns = cursor_u32(c);
  if (c->ended) return bonn_truncated(bonn, "the head of a factorisation");
  const bool normal = rows == channels * angles && columns == texels;
  factor->channels_by_texel = !normal;
  if (!normal && !(rows == channels * texels && columns == angles))
    return (bonn->file.host->fail)(
        bonn->file.ctx, BTF_E_CORRUPT,
        "%s: factorisation %u is of %llu x %llu values; expected %llu x %llu or %llu x %llu", bonn->file.path,
        (unsigned)i, (unsigned long long)rows, (unsigned long long)columns,
        (unsigned long long)(channels * angles), (unsigned long long)texels,
        (unsigned long long)(channels * texels), (unsigned long long)angles);
  BTF_TRY(check_sizes(bonn, i, factor->scalar_size, factor->k, rows, columns));
  const uint64_t row_bytes = (uint64_t)factor->k * factor->scalar_size;
  cursor_take(c, 1, row_bytes); /* singular values, which the right side has in it */
  const bonn_side left = {cursor_take(c, rows, row_bytes), NULL};
  const bonn_side right = {cursor_take(c, columns, row_bytes), NULL};
  if (c->ended) return bonn_truncated(bonn, "a factorisation");
  factor->angular = normal ? left : right;
  factor->texel = normal ? right : left;
  return BTF_OK;
}

static btf_status read_view(bonn_file *bonn, cursor *c, uint32_t view) {
  bonn_factor *factor = &bonn->factors[view];
  const uint64_t texels = (uint64_t)bonn->width * bonn->height;
  factor->scalar_size = cursor_u8(c);
  factor->k = cursor_u32(c);
  const uint64_t weights = cursor_u32(c), length = cursor_u32(c);
  if (c->ended) return bonn_truncated(bonn, "the head of a factorisation");
  const uint64_t lights = bonn->lights[view].count, by_light = bonn->channels * lights,
                 by_texel = bonn->channels * texels;
  const bool normal = length == by_light && weights == texels;
  factor->channels_by_texel = !normal;
  if (!normal && !(length == by_texel && weights == lights))
    return (bonn->file.host->fail)(
        bonn->file.ctx, BTF_E_CORRUPT,
        "%s: factorisation %u is of %llu x %llu values; expected %llu x %llu or %llu x %llu", bonn->file.path,
        (unsigned)view, (unsigned long long)length, (unsigned long long)weights, (unsigned long long)by_light,
        (unsigned long long)texels, (unsigned long long)by_texel, (unsigned long long)lights);
  BTF_TRY(check_sizes(bonn, view, factor->scalar_size, factor->k, length, weights));
  const uint64_t size = factor->scalar_size;
  cursor_take(c, factor->k, size); /* eigenvalues */
  const unsigned char *mean = cursor_take(c, length, size);
  const bonn_side long_side = {cursor_take(c, length, factor->k * size), mean};
  const bonn_side short_side = {cursor_take(c, weights, factor->k * size), NULL};
  if (c->ended) return bonn_truncated(bonn, "a factorisation");
  factor->angular = normal ? long_side : short_side;
  factor->texel = normal ? short_side : long_side;
  return BTF_OK;
}

static btf_status read_colour(bonn_file *bonn, cursor *c) {
  cursor_u32(c); /* the largest number of components */
  bonn->colour_model = cursor_u32(c);
  for (int i = 0; i < 3; i++) bonn->colour_mean[i] = cursor_f32(c);
  for (int i = 0; i < 9; i++) bonn->colour_matrix[i] = cursor_f32(c);
  if (c->ended) return bonn_truncated(bonn, "the colour model");
  return bonn_check_colour(bonn);
}

btf_status bonn_parse_factors(bonn_file *bonn, cursor *c) {
  const btf_host *host = bonn->file.host;
  uint32_t repeated = 0;
  if (bonn->family == BONN_DFMF) {
    BTF_TRY(read_colour(bonn, c));
    bonn->factor_count = bonn->channels;
  } else if (bonn->family == BONN_FMF) {
    repeated = cursor_u32(c);
    bonn->factor_count = 1;
  } else if (bonn->factor_count == 0) {
    cursor_u32(c);
    bonn->factor_count = cursor_u32(c);
    if (bonn->factor_count != bonn->view_count)
      return (host->fail)(bonn->file.ctx, BTF_E_CORRUPT, "%s: %u factorisations for %u views",
                          bonn->file.path, (unsigned)bonn->factor_count, (unsigned)bonn->view_count);
  }
  bonn->factors = (host->alloc)(bonn->file.ctx, bonn->factor_count, sizeof *bonn->factors);
  if (bonn->factors == NULL) return BTF_E_NOMEM;
  for (uint32_t i = 0; i < bonn->factor_count; i++)
    BTF_TRY(bonn->family == BONN_PVF
                ? read_view(bonn, c, i)
                : read_matrix(bonn, c, i, bonn->family == BONN_FMF ? bonn->channels : 1));
  if (bonn->family == BONN_FMF && repeated != bonn->factors[0].k)
    return (host->fail)(bonn->file.ctx, BTF_E_CORRUPT, "%s: %u components, yet factors of %u",
                        bonn->file.path, (unsigned)repeated, (unsigned)bonn->factors[0].k);
  if (cursor_left(c) != 0)
    return (host->fail)(bonn->file.ctx, BTF_E_CORRUPT, "%s: %llu bytes follow the last factorisation",
                        bonn->file.path, (unsigned long long)cursor_left(c));
  return BTF_OK;
}
