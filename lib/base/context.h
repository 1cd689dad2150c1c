/* SPDX-License-Identifier: MIT */
/* context.h: the inside of a context, for this layer only. */
#ifndef BTFI_CONTEXT_H
#define BTFI_CONTEXT_H

#include "base/base.h"

#define BTFI_MAX_THREADS 1024u

typedef struct btfi_pool btfi_pool;

struct btf_context {
  btf_allocator allocator;
  btf_limits limits;
  btf_log_fn log;
  void *log_user;
  btf_parallel_fn host_parallel;
  void *host_parallel_user;
  uint32_t max_threads, isa;
  atomic_uint references;
  _Atomic uint64_t memory_now, memory_peak;
  /* Whoever sets it owns the threads until it is cleared; others run their tasks themselves. */
  atomic_flag threads_busy;
  btfi_pool *pool;
  void *registry;
  void (*registry_destroy)(btf_context *ctx, void *registry);
};

/* The C library's allocator in the shape of a btf_allocator. */
btf_allocator btfi_default_allocator(void);
/* Ends and joins the built-in threads. */
void btfi_pool_stop(btf_context *ctx);
/* Processors this process may run on, 1 to BTFI_MAX_THREADS. */
uint32_t btfi_processor_count(void);
/* Name of an instruction set, and the set a name caps `machine` to; false for an unknown name. */
const char *btfi_isa_name(uint32_t isa);
bool btfi_isa_cap(const char *name, uint32_t machine, uint32_t *out);

#endif
