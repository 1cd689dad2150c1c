/* SPDX-License-Identifier: MIT */
/* payload.h: inside of a payload, private to this layer. */
#ifndef BTFI_PAYLOAD_H
#define BTFI_PAYLOAD_H

#include "container/container.h"
#include "container/format.h"

#include <pthread.h>

struct btf_chunk_writer {
  btfi_payload *payload;
};
struct btf_chunk_reader {
  btfi_payload *payload;
};

/* One chunk; `data` is published with release order once it is there. */
typedef struct btfi_slot {
  uint32_t tag, index, flags; /* BTF_PAYLOAD_* */
  bool owned;
  uint64_t size;
  _Atomic(void *) data;
  btfi_entry entry; /* of the file it comes from */
} btfi_slot;

struct btfi_payload {
  atomic_uint references;
  btf_context *ctx;
  btfi_model_header header;
  btfi_slot *slots; /* in the order of writing */
  uint32_t *order;  /* slots by (tag, index) */
  uint32_t count, capacity;
  int32_t zstd_level;
  bool sealed;
  btfi_source *source; /* NULL for a payload in memory */
  uint64_t stored_bytes;
  pthread_mutex_t load_lock;
  btf_chunk_writer writer;
  btf_chunk_reader reader;
};

/* An empty payload without a header. */
btf_status btfi_payload_new(btf_context *ctx, btfi_payload **out);
/* Makes room for one more chunk of a name not used yet and returns it with tag, index and flags set. */
btf_status btfi_payload_add(btfi_payload *p, uint32_t tag, uint32_t index, uint32_t flags, btfi_slot **out);

/* ---- model_header.c ---- */

btf_status btfi_model_header_from_dataset(btf_context *ctx, const btf_dataset *ds, const char *codec_id,
                                          uint32_t codec_format, btfi_model_header *out);
/* What a MODL chunk says about other chunks. */
typedef struct btfi_model_links {
  uint32_t light_set, view_set; /* numbers of DIRS chunks */
  uint32_t payload_chunks;
} btfi_model_links;
void btfi_model_header_encode(const btfi_model_header *h, const btfi_model_links *links, btfi_buffer *out);
/* Parses a MODL chunk. The direction sets are looked up in `sets`. Fields of `out` are freed by _free in any
 * case. */
btf_status btfi_model_header_decode(btf_context *ctx, const char *name, const void *data, uint64_t size,
                                    btf_dirset *const *sets, uint32_t set_count, btfi_model_header *out,
                                    btfi_model_links *links);
/* Copies texts that a data set has beside those of the header. */
btf_status btfi_model_header_take_notes(btf_context *ctx, const char *const *notes, btfi_model_header *h);
void btfi_model_header_free(btf_context *ctx, btfi_model_header *h);
/* Bytes of a MODL chunk at which the numbers of the light and the view set stand. */
enum { BTFI_MODEL_LIGHT_SET = 28, BTFI_MODEL_VIEW_SET = 32 };

#endif
