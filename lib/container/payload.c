/* SPDX-License-Identifier: MIT */
/* Payload chunks of one model: collected in memory by a fit, or read from a file on first use. */
#include "container/payload.h"

#include <stdio.h>
#include <string.h>

btf_status btfi_payload_new(btf_context *ctx, btfi_payload **out) {
  btfi_payload *p = btfi_calloc(ctx, 1, sizeof *p);
  *out = NULL;
  if (p == NULL) return btfi_alloc_status();
  if (pthread_mutex_init(&p->load_lock, NULL) != 0) {
    btfi_free(ctx, p);
    return btfi_fail(ctx, BTF_E_NOMEM, "payload: no resources for a lock");
  }
  atomic_init(&p->references, 1);
  p->ctx = ctx;
  p->writer.payload = p->reader.payload = p;
  btfi_context_retain(ctx);
  *out = p;
  return BTF_OK;
}

btf_status btfi_payload_create(btf_context *ctx, const btf_dataset *ds, const char *codec_id,
                               uint32_t codec_format, btfi_payload **out) {
  btf_status status = btfi_payload_new(ctx, out);
  if (status != BTF_OK) return status;
  status = btfi_model_header_from_dataset(ctx, ds, codec_id, codec_format, &(*out)->header);
  if (status != BTF_OK) {
    btfi_payload_release(*out);
    *out = NULL;
  }
  return status;
}

void btfi_payload_retain(btfi_payload *p) {
  atomic_fetch_add_explicit(&p->references, 1, memory_order_relaxed);
}

void btfi_payload_release(btfi_payload *p) {
  btf_context *ctx;
  if (p == NULL || atomic_fetch_sub_explicit(&p->references, 1, memory_order_acq_rel) != 1) return;
  ctx = p->ctx;
  for (uint32_t i = 0; i < p->count; i++)
    if (p->slots[i].owned) btfi_free(ctx, atomic_load_explicit(&p->slots[i].data, memory_order_relaxed));
  btfi_free(ctx, p->slots);
  btfi_free(ctx, p->order);
  btfi_model_header_free(ctx, &p->header);
  btfi_source_release(p->source);
  pthread_mutex_destroy(&p->load_lock);
  btfi_free(ctx, p);
  btf_context_release(ctx);
}

const btfi_model_header *btfi_payload_header(const btfi_payload *p) {
  return &p->header;
}
uint32_t btfi_payload_chunk_count(const btfi_payload *p) {
  return p->count;
}
const char *btfi_payload_source_name(const btfi_payload *p) {
  return p->source != NULL ? p->source->name : NULL;
}
uint64_t btfi_payload_stored_bytes(const btfi_payload *p) {
  return p->stored_bytes;
}
btf_chunk_writer *btfi_payload_writer(btfi_payload *p) {
  return &p->writer;
}
btf_chunk_reader *btfi_payload_reader(btfi_payload *p) {
  return &p->reader;
}
void btfi_payload_seal(btfi_payload *p) {
  p->sealed = true;
}

/* Position in `order` of a name, or where it would be inserted. */
static uint32_t search(const btfi_payload *p, uint32_t tag, uint32_t index, bool *found) {
  uint32_t low = 0, high = p->count;
  while (low < high) {
    const uint32_t middle = low + (high - low) / 2;
    const btfi_slot *slot = &p->slots[p->order[middle]];
    if (slot->tag < tag || (slot->tag == tag && slot->index < index))
      low = middle + 1;
    else
      high = middle;
  }
  *found = low < p->count && p->slots[p->order[low]].tag == tag && p->slots[p->order[low]].index == index;
  return low;
}

static btf_status grow(btfi_payload *p) {
  const uint32_t capacity = p->capacity != 0 ? 2 * p->capacity : 16;
  btfi_slot *slots = btfi_calloc(p->ctx, capacity, sizeof *slots);
  uint32_t *order;
  if (slots == NULL) return btfi_alloc_status();
  order = btfi_alloc(p->ctx, capacity, sizeof *order);
  if (order == NULL) {
    btfi_free(p->ctx, slots);
    return btfi_alloc_status();
  }
  if (p->count != 0) {
    memcpy(slots, p->slots, p->count * sizeof *slots);
    memcpy(order, p->order, p->count * sizeof *order);
  }
  btfi_free(p->ctx, p->slots);
  btfi_free(p->ctx, p->order);
  p->slots = slots;
  p->order = order;
  p->capacity = capacity;
  return BTF_OK;
}

static const char *slot_name(uint32_t tag, uint32_t index, char text[BTFI_NAME_SIZE]) {
  char fourcc[16];
  btfi_fourcc_text(tag, fourcc);
  snprintf(text, BTFI_NAME_SIZE, "payload chunk %s %u", fourcc, (unsigned)index);
  return text;
}

btf_status btfi_payload_add(btfi_payload *p, uint32_t tag, uint32_t index, uint32_t flags, btfi_slot **out) {
  char name[BTFI_NAME_SIZE];
  bool found;
  uint32_t at = search(p, tag, index, &found);
  *out = NULL;
  if (found)
    return btfi_fail(p->ctx, BTF_E_INVALID_ARG, "%s: a tag and index may be used once in a model",
                     slot_name(tag, index, name));
  if (p->count >= btfi_limits(p->ctx)->max_chunks)
    return btfi_fail(p->ctx, BTF_E_LIMIT, "%s: the limit of %u chunks is reached",
                     slot_name(tag, index, name), (unsigned)btfi_limits(p->ctx)->max_chunks);
  if (p->count == p->capacity) BTFI_TRY(grow(p));
  memmove(p->order + at + 1, p->order + at, (p->count - at) * sizeof *p->order);
  p->order[at] = p->count;
  *out = &p->slots[p->count++];
  memset(*out, 0, sizeof **out);
  (*out)->tag = tag;
  (*out)->index = index;
  (*out)->flags = flags;
  return BTF_OK;
}

btf_status btfi_chunk_reserve(btf_chunk_writer *w, uint32_t tag, uint32_t index, uint32_t flags,
                              uint64_t size, void **dst) {
  char name[BTFI_NAME_SIZE];
  btfi_payload *p = w->payload;
  btfi_slot *slot;
  void *memory;
  *dst = NULL;
  if (p->sealed)
    return btfi_fail(p->ctx, BTF_E_STATE, "%s: the model is finished", slot_name(tag, index, name));
  if ((flags & ~(uint32_t)BTF_PAYLOAD_IN_PLACE) != 0)
    return btfi_fail(p->ctx, BTF_E_INVALID_ARG, "%s: unknown flags 0x%x", slot_name(tag, index, name),
                     (unsigned)flags);
  if (size > btfi_limits(p->ctx)->max_chunk_bytes)
    return btfi_fail(p->ctx, BTF_E_LIMIT, "%s: %llu bytes are over the limit of %llu",
                     slot_name(tag, index, name), (unsigned long long)size,
                     (unsigned long long)btfi_limits(p->ctx)->max_chunk_bytes);
  memory = btfi_calloc(p->ctx, size, 1);
  if (memory == NULL) return btfi_alloc_status();
  {
    const btf_status status = btfi_payload_add(p, tag, index, flags, &slot);
    if (status != BTF_OK) {
      btfi_free(p->ctx, memory);
      return status;
    }
  }
  slot->owned = true;
  slot->size = size;
  atomic_store_explicit(&slot->data, memory, memory_order_release);
  *dst = memory;
  return BTF_OK;
}

btf_status btfi_chunk_put(btf_chunk_writer *w, uint32_t tag, uint32_t index, uint32_t flags, const void *src,
                          uint64_t size) {
  void *dst;
  BTFI_TRY(btfi_chunk_reserve(w, tag, index, flags, size, &dst));
  if (size != 0) memcpy(dst, src, (size_t)size);
  return BTF_OK;
}

void btfi_chunk_set_zstd_level(btf_chunk_writer *w, int32_t level) {
  w->payload->zstd_level = level;
}

btf_status btfi_payload_chunk(btfi_payload *p, uint32_t i, btfi_chunk *out) {
  btfi_slot *slot;
  void *data;
  memset(out, 0, sizeof *out);
  if (i >= p->count)
    return btfi_fail(p->ctx, BTF_E_INVALID_ARG, "payload: there is no chunk %u", (unsigned)i);
  slot = &p->slots[i];
  data = atomic_load_explicit(&slot->data, memory_order_acquire);
  if (data == NULL) {
    btf_status status = BTF_OK;
    pthread_mutex_lock(&p->load_lock);
    data = atomic_load_explicit(&slot->data, memory_order_relaxed);
    if (data == NULL) {
      const void *read = NULL;
      status = btfi_chunk_read(p->source, &slot->entry, p->source->trust, &read, &slot->owned);
      data = (void *)(uintptr_t)read; /* nobody writes to a sealed payload */
      if (status == BTF_OK) atomic_store_explicit(&slot->data, data, memory_order_release);
    }
    pthread_mutex_unlock(&p->load_lock);
    BTFI_TRY(status);
  }
  out->tag = slot->tag;
  out->index = slot->index;
  out->flags = slot->flags;
  out->data = data;
  out->size = slot->size;
  return BTF_OK;
}

btf_status btfi_chunk_get(btf_chunk_reader *r, uint32_t tag, uint32_t index, const void **data,
                          uint64_t *size) {
  char name[BTFI_NAME_SIZE];
  btfi_payload *p = r->payload;
  btfi_chunk chunk;
  bool found;
  const uint32_t at = search(p, tag, index, &found);
  *data = NULL;
  *size = 0;
  if (!found)
    return btfi_fail(p->ctx, BTF_E_CORRUPT, "%s%s%s: missing in the model",
                     p->source != NULL ? p->source->name : "", p->source != NULL ? ": " : "",
                     slot_name(tag, index, name));
  BTFI_TRY(btfi_payload_chunk(p, p->order[at], &chunk));
  *data = chunk.data;
  *size = chunk.size;
  return BTF_OK;
}

int32_t btfi_chunk_has(const btf_chunk_reader *r, uint32_t tag, uint32_t index) {
  bool found;
  search(r->payload, tag, index, &found);
  return found ? 1 : 0;
}
