/* SPDX-License-Identifier: MIT */
#include "base/context.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

/* Room before each block for its size; a whole cache line, so that the block itself stays aligned to one. */
enum { prefix_size = 64 };
/* A struct that claims to be this much longer than ours has no sensible struct_size. */
enum { longest_unknown_tail = 4096 };

static _Thread_local btf_status last_alloc_status;

static void *default_alloc(void *user, size_t size, size_t align) {
  (void)user;
  return aligned_alloc(align, (size + align - 1) & ~(align - 1)); /* C11 wants a multiple */
}

static void default_free(void *user, void *ptr, size_t size) {
  (void)user;
  (void)size;
  free(ptr);
}

btf_allocator btfi_default_allocator(void) {
  const btf_allocator allocator = {NULL, default_alloc, default_free};
  return allocator;
}

/* Takes `size` bytes of the context's allowance. */
static bool reserve_memory(btf_context *ctx, uint64_t size) {
  const uint64_t limit = ctx->limits.max_memory;
  uint64_t now = atomic_load_explicit(&ctx->memory_now, memory_order_relaxed);
  do {
    if (now > limit || size > limit - now) return false;
  } while (!atomic_compare_exchange_weak_explicit(&ctx->memory_now, &now, now + size, memory_order_relaxed,
                                                  memory_order_relaxed));
  now += size;
  uint64_t peak = atomic_load_explicit(&ctx->memory_peak, memory_order_relaxed);
  while (peak < now && !atomic_compare_exchange_weak_explicit(&ctx->memory_peak, &peak, now,
                                                              memory_order_relaxed, memory_order_relaxed)) {
  }
  return true;
}

void *btfi_alloc(btf_context *ctx, uint64_t count, uint64_t size) {
  uint64_t bytes, total;
  /* Rounded to whole cache lines: aligned_alloc asks for it, and vector kernels may then read past the end.
   */
  if (!btfi_mul(count, size, &bytes) || !btfi_add(bytes, prefix_size + 63, &total) || total > PTRDIFF_MAX) {
    last_alloc_status = btfi_fail(
        ctx, BTF_E_LIMIT, "memory: %" PRIu64 " times %" PRIu64 " bytes asked for, more than can be addressed",
        count, size);
    return NULL;
  }
  total &= ~(uint64_t)63;
  if (!reserve_memory(ctx, total)) {
    last_alloc_status = btfi_fail(
        ctx, BTF_E_LIMIT,
        "memory: %" PRIu64 " bytes asked for with %" PRIu64 " in use; the context's limit is %" PRIu64, total,
        atomic_load_explicit(&ctx->memory_now, memory_order_relaxed), ctx->limits.max_memory);
    return NULL;
  }
  unsigned char *block = ctx->allocator.alloc(ctx->allocator.user, (size_t)total, 64);
  if (block && ((uintptr_t)block & 63u) != 0) {
    ctx->allocator.free(ctx->allocator.user, block, (size_t)total);
    block = NULL;
  }
  if (!block) {
    atomic_fetch_sub_explicit(&ctx->memory_now, total, memory_order_relaxed);
    last_alloc_status = btfi_fail(
        ctx, BTF_E_NOMEM, "memory: the allocator could not give %" PRIu64 " bytes aligned to 64", total);
    return NULL;
  }
  memcpy(block, &total, sizeof total);
  return block + prefix_size;
}

void *btfi_calloc(btf_context *ctx, uint64_t count, uint64_t size) {
  void *ptr = btfi_alloc(ctx, count, size);
  if (ptr) memset(ptr, 0, (size_t)(count * size));
  return ptr;
}

void btfi_free(btf_context *ctx, void *ptr) {
  uint64_t total;
  if (!ptr) return;
  unsigned char *block = (unsigned char *)ptr - prefix_size;
  memcpy(&total, block, sizeof total);
  atomic_fetch_sub_explicit(&ctx->memory_now, total, memory_order_relaxed);
  ctx->allocator.free(ctx->allocator.user, block, (size_t)total);
}

btf_status btfi_alloc_status(void) {
  return last_alloc_status ? last_alloc_status : BTF_E_NOMEM;
}

char *btfi_strdup(btf_context *ctx, const char *text) {
  const size_t size = strlen(text) + 1;
  char *copy = btfi_alloc(ctx, size, 1);
  if (copy) memcpy(copy, text, size);
  return copy;
}

btf_status btfi_copy_in(btf_context *ctx, const char *name, void *dst, size_t size, size_t minimum,
                        const void *src) {
  size_t given;
  if (!src)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: is NULL; expected a pointer to a filled struct", name);
  memcpy(&given, src, sizeof given);
  if (given < minimum || given > size + longest_unknown_tail)
    return btfi_fail(ctx, BTF_E_ABI, "%s: struct_size is %zu; expected at least %zu, as its _INIT macro sets",
                     name, given, minimum);
  for (size_t i = size; i < given; i++)
    if (((const unsigned char *)src)[i] != 0)
      return btfi_fail(ctx, BTF_E_ABI, "%s: byte %zu of %zu is set, but this library knows %zu bytes only",
                       name, i, given, size);
  memset(dst, 0, size);
  memcpy(dst, src, BTFI_MIN(given, size));
  memcpy(dst, &size, sizeof size);
  return BTF_OK;
}

btf_status btfi_copy_out(btf_context *ctx, const char *name, void *dst, size_t minimum, const void *src,
                         size_t size) {
  size_t room;
  if (!dst) return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: is NULL; expected a struct to fill", name);
  memcpy(&room, dst, sizeof room);
  if (room < minimum || room > size + longest_unknown_tail)
    return btfi_fail(ctx, BTF_E_ABI, "%s: struct_size is %zu; expected at least %zu, as its _INIT macro sets",
                     name, room, minimum);
  const size_t header = sizeof room, copied = BTFI_MIN(room, size);
  memcpy((unsigned char *)dst + header, (const unsigned char *)src + header, copied - header);
  if (room > size) memset((unsigned char *)dst + size, 0, room - size);
  return BTF_OK;
}
