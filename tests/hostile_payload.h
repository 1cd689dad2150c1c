/* SPDX-License-Identifier: MIT */
/*
 * hostile_payload.h: payloads that are wrong, below all checksums: the chunks of a model are copied, changed
 * and given to the codec's loader, which must refuse them or make a state that evaluates anywhere.
 */
#ifndef HOSTILE_PAYLOAD_H
#define HOSTILE_PAYLOAD_H

#include <btf/btf_plugin.h>

#include "btf_test.h"

enum { HOSTILE_CHUNKS = 64 };

typedef struct hostile_payload {
  const btf_codec_vtbl *codec;
  btf_context *ctx;
  const btf_model *model;
  struct {
    uint32_t tag, index;
    unsigned char *data; /* of exactly its size, so that a sanitizer sees reads beyond it */
    uint64_t size;
  } chunk[HOSTILE_CHUNKS];
  uint32_t count;
  uint64_t random;
} hostile_payload;

/* Calls check with the chunks of the model, which load before and after; releases the model. */
void hostile_with(btf_context *ctx, const btf_codec_vtbl *codec, btf_model *model,
                  void (*check)(hostile_payload *payload));
/* Loads, and if that works evaluates everywhere; returns the status. */
btf_status hostile_load(hostile_payload *payload);
/* Loads with the bytes at `at` of a chunk's data changed for that time. */
btf_status hostile_change(hostile_payload *payload, unsigned char *at, const void *bytes, size_t size);
/* Number of the first chunk of a tag, and what it holds. */
uint32_t hostile_find(const hostile_payload *payload, uint32_t tag);
unsigned char *hostile_data(const hostile_payload *payload, uint32_t tag);

/* ---- checks of any codec ---- */

/* Each chunk missing, shorter or longer: BTF_E_CORRUPT. */
void hostile_sizes(hostile_payload *payload);
/* Flipped bits anywhere: loads or is BTF_E_CORRUPT, or BTF_E_NOMEM where sizes to allocate are stored. */
void hostile_bits(hostile_payload *payload, uint32_t turns, int stores_sizes);

#endif
