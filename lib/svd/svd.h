/* SPDX-License-Identifier: MIT */
/* svd.h: truncated SVD of a matrix that is read in blocks and need not fit in memory. */
#ifndef BTFI_SVD_H
#define BTFI_SVD_H

#include "base/base.h"
#include <btf/btf_plugin.h>

btf_status btfi_svd(btf_context *ctx, const btf_svd_desc *desc, const btf_job *job, double from, double to,
                    btf_svd_result *out);
/* The same for a caller who has another way: a working set that is too small is not told to the log. */
btf_status btfi_svd_try(btf_context *ctx, const btf_svd_desc *desc, const btf_job *job, double from,
                        double to, btf_svd_result *out);
void btfi_svd_free(btf_context *ctx, btf_svd_result *result);

#endif
