/* SPDX-License-Identifier: MIT */
/* svd_material.h: a large analytic material, written to a data-set folder once and kept. */
#ifndef BENCH_SVD_MATERIAL_H
#define BENCH_SVD_MATERIAL_H

#include <btf/btf.h>

enum {
  MATERIAL_SMOOTH, /* relief, gloss and colour that vary over the texture */
  MATERIAL_RARE, /* and a few texels with reflection of their own, and direction pairs with strong highlights
                  */
  MATERIAL_NOISY /* and the noise of a measurement on top */
};
btf_status material_write(btf_context *ctx, const char *folder, int kind, uint32_t size,
                          const char *directions);

#endif
