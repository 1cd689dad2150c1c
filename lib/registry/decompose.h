/* SPDX-License-Identifier: MIT */
/* decompose.h: btf_host.svd_dataset. */
#ifndef BTFI_REGISTRY_DECOMPOSE_H
#define BTFI_REGISTRY_DECOMPOSE_H

#include "base/base.h"
#include <btf/btf_plugin.h>

btf_status btfi_decompose(btf_context *ctx, const btf_dataset *ds, const float *mean,
                          const btf_svd_desc *desc, const btf_job *job, double from, double to,
                          btf_svd_result *out);

#endif
