/* SPDX-License-Identifier: MIT */
/* test_clusters.h: data sets and fits for the suites of this codec, on those of fmf's. */
#ifndef LPCA_TEST_CLUSTERS_H
#define LPCA_TEST_CLUSTERS_H

/* Before cmocka, whose macro `fail` is in the way of the host table. */
#include "lpca.h"

#include "../fmf/test_materials.h"

#include "container/container.h"
#include "model/model.h"
#include "registry/registry.h"

/* Besides those of fmf: two materials with speckle woven into each other, and 6 glossy ones in checks. */
enum { MATERIAL_TWO_CLOTHS = 100, MATERIAL_CHECKS };

material material_of(btf_context *ctx, int kind, const char *directions, uint32_t width, uint32_t height);
/* Texel t is a random point of affine subspace t % clusters, of so many dimensions. */
material planted_material(btf_context *ctx, uint32_t width, uint32_t height, uint32_t clusters,
                          uint32_t dimensions);
/* Value of row (view, light, channel) of a texel. */
double material_row(const material *m, uint32_t texel, uint32_t row);

/* Options as "name=value name=value". */
btf_status lpca_try_fit(btf_context *ctx, const btf_dataset *ds, const char *settings, const btf_job *job,
                        btf_model **out);
btf_model *lpca_fit(btf_context *ctx, const material *m, const char *settings);
double model_squared_error(const btf_model *model, const material *m);
const btfi_lpca_state *lpca_state(const btf_model *model);
uint32_t lpca_label(const btfi_lpca_state *s, uint32_t level, uint32_t texel);

#endif
