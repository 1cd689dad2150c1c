/* SPDX-License-Identifier: MIT */
/* homomorphic.h: homomorphic factorisation (docs/codecs/cmf.md; Suykens et al. 2003, section 4.3).
 *
 * log f(l, v) = sum over maps j of P~_j(p_j(l, v)) in the least squares sense, smoothed by lambda times the
 * Laplacian of each map. The normal matrix depends on the sampling alone: it is factored once for all texels
 * (section 4.4). */
#ifndef BTFI_CMF_HOMOMORPHIC_H
#define BTFI_CMF_HOMOMORPHIC_H

#include <stddef.h>
#include <stdint.h>

#include <btf/btf_plugin.h>

enum { CMF_HF_MAX_MAPS = 8 };

/* Where each pair of a light and a view falls into the maps. Only read by btfi_cmf_hf_create, which copies
 * it. */
typedef struct btfi_cmf_hf_geometry {
  uint32_t pairs, maps, width, height; /* maps of width x height texels */
  uint32_t wrap;                       /* 1: columns 0 and width - 1 are neighbours (azimuths) */
  const uint32_t *texel;               /* pairs x maps x 4: y * width + x in the map */
  const float *weight;                 /* pairs x maps x 4: bilinear weights, finite, of sum 1 */
  const uint8_t *use_pair;             /* pairs: 0 leaves a pair out (below the horizon, ...); NULL = all */
  const uint8_t *use_texel; /* maps x width x height: 0 for texels that no evaluation reads; NULL = all.
                               Texels with a weight are unknowns in any case. */
} btfi_cmf_hf_geometry;

typedef struct btfi_cmf_hf btfi_cmf_hf;

/* lambda > 0. BTF_E_LIMIT names the budget that would do (8 bytes times the square of the unknowns, and some
 * more). */
btf_status btfi_cmf_hf_create(const btf_host *host, btf_context *ctx, const btfi_cmf_hf_geometry *geometry,
                              double lambda, uint64_t max_working_set, btfi_cmf_hf **out);
void btfi_cmf_hf_free(const btf_host *host, btf_context *ctx, btfi_cmf_hf *hf);
/* Texels that are map unknowns. */
uint32_t btfi_cmf_hf_unknowns(const btfi_cmf_hf *hf);
/* Bytes that btfi_cmf_hf_solve allocates for that many texels at once. */
uint64_t btfi_cmf_hf_solve_bytes(const btf_host *host, btf_context *ctx, uint64_t unknowns, uint32_t texels,
                                 uint32_t channels);

/* Factors texels whose value of pair p and channel c is f[texel * f_step + p * channels + c] into
 * maps[texel * maps_step + (j * width * height + y * width + x) * channels + c] > 0. Values below `floor`
 * times the largest of their ABRDF count as that; a channel that is 0 or negative throughout has maps of 0,
 * as have texels of maps that are no unknowns. Some dozens of texels at once are best; call it outside of
 * tasks. */
btf_status btfi_cmf_hf_solve(const btf_host *host, btf_context *ctx, const btfi_cmf_hf *hf, uint32_t texels,
                             uint32_t channels, const float *f, uint64_t f_step, double floor, float *maps,
                             uint64_t maps_step);

#endif
