/* SPDX-License-Identifier: MIT */
/* crafted_model.h: FMF models of any size from random factors. Factorising data of 151 x 151 directions and 256 x 256
 * texels takes longer than everything a benchmark wants to know about its evaluation, and evaluation does not depend on
 * what the factors hold. So the codec is registered once more under another name, with a fit that hands random factors
 * to the same writer; everything from the payload on is the codec itself. */
#ifndef CRAFTED_MODEL_H
#define CRAFTED_MODEL_H

#include <btf/btf.h>

typedef struct crafted_size {
  const char *directions; /* as btf_dirset_create_named takes them */
  uint32_t width, height, channels, components;
} crafted_size;

/* Registers the codec; once for each context. */
btf_status crafted_register(btf_context *ctx);
/* storage and coding as the codec takes them. */
btf_status crafted_create(btf_context *ctx, const crafted_size *size, const char *storage, const char *coding,
                          btf_model **out);

#endif
