/* SPDX-License-Identifier: MIT */
/* write.c: the payload of a fit. */
#include "laplacian.h"

#include <btf/btf_half.h>

static void put_value(uint32_t storage, float value, unsigned char *table, uint64_t byte) {
  if (storage == LAPLACIAN_F32) {
    btf_put_f32(table + byte, value);
    return;
  }
  const uint16_t half = btf_float_to_half(value);
  table[byte] = (unsigned char)(half & 0xff);
  table[byte + 1] = (unsigned char)(half >> 8);
}

/* A column of the tables: one component, or the table of the means with constant weights. */
static void put_column(const btfi_laplacian_fitting *f, const btfi_laplacian_layout *layout, uint32_t k,
                       uint32_t c, uint32_t j, uint32_t value, unsigned char *eigen, unsigned char *weights) {
  const uint64_t texels = (uint64_t)f->source.grid.width[k] * f->source.grid.height[k];
  const btfi_laplacian_factors *factors = &f->factors[k][c];
  const uint64_t at = (uint64_t)(layout->first[k] + value) * layout->value_bytes,
                 weight_at = (uint64_t)value * layout->value_bytes;
  const bool mean = j >= f->head.count[k][c];
  for (uint64_t pair = 0; pair < f->source.pairs; pair++) {
    float entry = 0.0f;
    if (!mean)
      entry = factors->eigen[j * f->source.pairs + pair];
    else if (f->mean_scale[c] > 0.0f)
      entry = f->mean[3 * pair + c] / f->mean_scale[c];
    put_value(f->head.storage, entry, eigen, pair * layout->row_bytes + at);
  }
  for (uint64_t t = 0; t < texels; t++)
    put_value(f->head.storage, mean ? 1.0f : factors->weights[j * texels + t], weights,
              t * layout->texel_bytes[k] + weight_at);
}

static btf_status write_level(const btfi_laplacian_fitting *f, const btfi_laplacian_layout *layout,
                              uint32_t k, unsigned char *eigen, unsigned char *scales) {
  const uint32_t means = f->head.mean == LAPLACIAN_TABLE && k + 1 == f->head.levels ? 1 : 0;
  uint32_t value = 0;
  void *weights;
  BTF_TRY(f->host->reserve(f->payload, LAPLACIAN_TAG_WEIGHTS, k, BTF_PAYLOAD_IN_PLACE,
                           layout->weight_bytes[k], &weights));
  for (uint32_t c = 0; c < 3; c++)
    for (uint32_t j = 0; j < f->head.count[k][c] + means; j++, value++) {
      const bool mean = j >= f->head.count[k][c];
      put_column(f, layout, k, c, j, value, eigen, weights);
      btf_put_f32(scales + 4 * (size_t)(layout->first[k] + value),
                  mean ? f->mean_scale[c] : f->factors[k][c].scale[j]);
    }
  return BTF_OK;
}

btfi_laplacian_head btfi_laplacian_stored_head(const btfi_laplacian_fitting *f) {
  btfi_laplacian_head head = f->head;
  for (uint32_t c = 0; c < 3 && head.mean == LAPLACIAN_TABLE; c++) head.count[head.levels - 1][c]++;
  return head;
}

btf_status btfi_laplacian_write(btfi_laplacian_fitting *f) {
  const btfi_laplacian_head head = btfi_laplacian_stored_head(f);
  btfi_laplacian_layout layout;
  unsigned char bytes[LAPLACIAN_HEAD_BYTES];
  void *levels, *scales, *eigen;
  if (!btfi_laplacian_layout_of(&head, &f->source.grid, f->source.lights, f->source.views, &layout))
    return f->host->fail(f->ctx, BTF_E_LIMIT, "laplacian: the tables would not fit 64 bits");
  btfi_laplacian_put_head(&head, bytes);
  BTF_TRY(f->host->put(f->payload, LAPLACIAN_TAG_HEAD, 0, 0, bytes, sizeof bytes));
  BTF_TRY(f->host->reserve(f->payload, LAPLACIAN_TAG_LEVELS, 0, 0,
                           (uint64_t)LAPLACIAN_LEVEL_BYTES * head.levels, &levels));
  for (uint32_t k = 0; k < head.levels; k++)
    btfi_laplacian_put_level(&head, k, (unsigned char *)levels + (size_t)LAPLACIAN_LEVEL_BYTES * k);
  BTF_TRY(f->host->reserve(f->payload, LAPLACIAN_TAG_SCALES, 0, 0, 4 * (uint64_t)layout.first[head.levels],
                           &scales));
  BTF_TRY(
      f->host->reserve(f->payload, LAPLACIAN_TAG_EIGEN, 0, BTF_PAYLOAD_IN_PLACE, layout.eigen_bytes, &eigen));
  for (uint32_t k = 0; k < head.levels; k++) BTF_TRY(write_level(f, &layout, k, eigen, scales));
  return BTF_OK;
}
