/* SPDX-License-Identifier: MIT */
/*
 * btf_formats.h: the readers of measured data that come with libbtf, as a library of their own (libbtf::formats), so that
 * the core needs no image or archive libraries.
 */
#ifndef LIBBTF_BTF_FORMATS_H
#define LIBBTF_BTF_FORMATS_H

#include "btf_format.h"

#ifdef __cplusplus
extern "C" {
#endif

/** Registers the readers of this build in a context: all of them or none. Errors: BTF_E_PLUGIN (registered already),
 *  BTF_E_ABI, BTF_E_NOMEM. Threads: exclusive. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_formats_register(btf_context *ctx);

#ifdef __cplusplus
}
#endif
#endif
