/* SPDX-License-Identifier: MIT */
/* btf.h: everything a host needs. Codec authors include <btf/btf_plugin.h> as well. */
#ifndef LIBBTF_BTF_H
#define LIBBTF_BTF_H
#include "btf_base.h"
#include "btf_dataset.h"
#include "btf_model.h"
#include "btf_format.h"
#include "btf_gpu.h"
#include "btf_io.h"
#endif
