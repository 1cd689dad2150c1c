/* SPDX-License-Identifier: MIT */
#include "base/context.h"

#include <string.h>

static void fill_limits(btf_limits *limits) {
  if (limits->max_memory == 0) limits->max_memory = (uint64_t)64 << 30;
  if (limits->max_chunk_bytes == 0) limits->max_chunk_bytes = (uint64_t)16 << 30;
  if (limits->max_chunks == 0) limits->max_chunks = 65536;
  if (limits->max_dimension == 0) limits->max_dimension = 65536;
  if (limits->max_directions == 0) limits->max_directions = 65536;
  if (limits->max_channels == 0 || limits->max_channels > 64) limits->max_channels = 64;
}

/* Checks the description and copies it to a context that is not allocated yet. */
static btf_status read_description(const btf_context_desc *user, btf_context *out) {
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  if (user)
    BTFI_TRY(btfi_copy_in(NULL, "btf_context_desc", &desc, sizeof desc, BTFI_SIZE_TO(btf_context_desc, isa),
                          user));
  if (desc.flags != 0)
    return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_context_desc: flags is %#x; expected 0",
                     (unsigned)desc.flags);
  if (desc.max_threads > BTFI_MAX_THREADS)
    return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_context_desc: max_threads is %u; expected at most %u",
                     (unsigned)desc.max_threads, BTFI_MAX_THREADS);

  out->allocator = btfi_default_allocator();
  if (desc.allocator) {
    if (!desc.allocator->alloc || !desc.allocator->free)
      return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_context_desc: the allocator needs both alloc and free");
    out->allocator = *desc.allocator;
  }
  if (desc.limits)
    BTFI_TRY(btfi_copy_in(NULL, "btf_limits", &out->limits, sizeof out->limits,
                          BTFI_SIZE_TO(btf_limits, max_channels), desc.limits));
  fill_limits(&out->limits);
  out->limits.struct_size = sizeof out->limits;

  if (!btfi_isa_cap(desc.isa, btfi_isa_of_machine(), &out->isa))
    return btfi_fail(NULL, BTF_E_INVALID_ARG,
                     "btf_context_desc: isa is \"%s\"; expected scalar, avx2, avx512 or neon", desc.isa);
  out->log = desc.log;
  out->log_user = desc.log_user;
  out->host_parallel = desc.parallel;
  out->host_parallel_user = desc.parallel_user;
  out->max_threads = desc.max_threads ? desc.max_threads : btfi_processor_count();
  return BTF_OK;
}

btf_status btf_context_create_abi(uint32_t abi, const btf_context_desc *desc, btf_context **out) {
  if (!out) return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_context_create: out is NULL");
  *out = NULL;
  if (abi != LIBBTF_ABI)
    return btfi_fail(NULL, BTF_E_ABI,
                     "btf_context_create: the program was built for ABI %u; this library has ABI %u",
                     (unsigned)abi, LIBBTF_ABI);
  btf_context draft;
  memset(&draft, 0, sizeof draft);
  BTFI_TRY(read_description(desc, &draft));

  btf_context *ctx = draft.allocator.alloc(draft.allocator.user, sizeof *ctx, 64);
  if (!ctx) return btfi_fail(NULL, BTF_E_NOMEM, "btf_context_create: no memory for a context");
  memset(ctx, 0, sizeof *ctx);
  ctx->allocator = draft.allocator;
  ctx->limits = draft.limits;
  ctx->log = draft.log;
  ctx->log_user = draft.log_user;
  ctx->host_parallel = draft.host_parallel;
  ctx->host_parallel_user = draft.host_parallel_user;
  ctx->max_threads = draft.max_threads;
  ctx->isa = draft.isa;
  atomic_init(&ctx->references, 1);
  atomic_init(&ctx->memory_now, 0);
  atomic_init(&ctx->memory_peak, 0);
  atomic_flag_clear(&ctx->threads_busy);

  const btf_status status = btfi_registry_attach(ctx);
  if (status != BTF_OK) {
    btf_context_release(ctx);
    return status;
  }
  *out = ctx;
  return BTF_OK;
}

void btfi_context_retain(btf_context *ctx) {
  atomic_fetch_add_explicit(&ctx->references, 1, memory_order_relaxed);
}

void btf_context_release(btf_context *ctx) {
  /* Acquire-release, so that the last owner sees what the others wrote before they let go. */
  if (!ctx || atomic_fetch_sub_explicit(&ctx->references, 1, memory_order_acq_rel) != 1) return;
  if (ctx->registry_destroy) ctx->registry_destroy(ctx, ctx->registry);
  btfi_pool_stop(ctx);
  const btf_allocator allocator = ctx->allocator;
  allocator.free(allocator.user, ctx, sizeof *ctx);
}

const char *btf_context_isa(const btf_context *ctx) {
  return btfi_isa_name(ctx->isa);
}

uint32_t btf_context_threads(const btf_context *ctx) {
  return ctx->max_threads;
}

uint32_t btfi_isa(const btf_context *ctx) {
  return ctx->isa;
}

void btf_context_memory(const btf_context *ctx, uint64_t *now, uint64_t *peak) {
  if (now) *now = atomic_load_explicit(&ctx->memory_now, memory_order_relaxed);
  if (peak) *peak = atomic_load_explicit(&ctx->memory_peak, memory_order_relaxed);
}

const btf_limits *btfi_limits(const btf_context *ctx) {
  return &ctx->limits;
}

void btfi_context_set_registry(btf_context *ctx, void *registry,
                               void (*destroy)(btf_context *ctx, void *registry)) {
  ctx->registry = registry;
  ctx->registry_destroy = destroy;
}

void *btfi_context_registry(const btf_context *ctx) {
  return ctx->registry;
}
