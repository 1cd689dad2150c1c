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

/* Evaluates a data set as it stands (raw_codec.c); not in the registry. Its load is NULL: the state is made
 * by btfi_raw_state, which retains the data set or holds what it needs of it; `job` is NULL or the desc of a
 * btfi_job. */
extern const btf_codec_vtbl btfi_raw_codec;
btf_status btfi_raw_state(const btf_dataset *ds, const btf_job *job, void **state);

/* Loads the payload with the codec; the model retains it. */
btf_status btfi_model_from_payload(const btf_codec *codec, btfi_payload *payload, btf_model **out);

#endif
