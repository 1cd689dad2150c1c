/* SPDX-License-Identifier: MIT */
/* model.h: inside of a model. */
#ifndef BTFI_MODEL_H
#define BTFI_MODEL_H

#include "base/base.h"
#include "registry/registry.h"
#include <btf/btf_model.h>

struct btf_model {
  /* hot members first: read by every evaluation */
  const btf_codec_vtbl *vtbl;
  void *state;
  uint32_t channels, quantity, width, height, levels;
  /* cold members */
  atomic_uint references;
  btf_context *ctx;
  btfi_payload *payload; /* NULL for the raw model */
  btf_dataset *dataset;  /* the raw model's source */
  btf_model_shape shape;
};

extern const btf_codec_vtbl btfi_raw_codec; /* evaluates a data set as it stands; not in the registry */

#endif
