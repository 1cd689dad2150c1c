/* SPDX-License-Identifier: MIT */
/* test_views.h: what the suites of this codec share; materials come from those of fmf. */
#ifndef PVPCA_TEST_VIEWS_H
#define PVPCA_TEST_VIEWS_H

#include "test_materials.h"

#include "pvpca.h"

btf_status pvpca_try_fit(btf_context *ctx, const btf_dataset *ds, const char *settings, const btf_job *job,
                         btf_model **out);
btf_model *pvpca_fit(btf_context *ctx, const material *m, const char *settings);
const btfi_pvpca_state *pvpca_state(const btf_model *model);
/* Squared error of the samples of one view, by decoding them. */
double pvpca_view_error(const btf_model *model, const material *m, uint32_t view);
/* A relief under a texture: what is seen at a texel moves with the view. */
material relief_create(btf_context *ctx, const char *directions, uint32_t side, uint32_t channels);

#endif
