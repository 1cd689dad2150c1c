/* SPDX-License-Identifier: MIT */
/*
 * btf_base.h: version, status codes and the context.
 *
 * Four rules hold for the whole library:
 *  1. Objects are opaque, made by `_create`, `_open`, `_load` or `_fit`, dropped by `_release` or `_close`
 *     (NULL is fine), and immutable once made.
 *  2. A public struct is either FROZEN (it never changes) or starts with `struct_size` and only ever grows at
 *     its end. The library copies it on entry: a missing tail reads as zero, an unknown tail that is not zero
 *     is BTF_E_ABI. Set `struct_size` with the struct's _INIT macro or with sizeof.
 *  3. On failure every out-pointer is set to NULL and nothing leaks.
 *  4. Strings are UTF-8. A returned string lives as long as the object it came from.
 *
 * Thread words used in these headers:
 *   free       callable from any thread at any time;
 *   const      any number of threads may call it at once on one object;
 *   exclusive  one thread at a time for each object.
 */
#ifndef LIBBTF_BTF_BASE_H
#define LIBBTF_BTF_BASE_H

#include <stddef.h>
#include <stdint.h>

/** Version of these headers; btf_version() gives that of the library in use. */
#define LIBBTF_VERSION_MAJOR 0
#define LIBBTF_VERSION_MINOR 1
#define LIBBTF_VERSION_PATCH 0

/** Generation of the binary interface. It changes only when old programs would break. */
#define LIBBTF_ABI 1u

#if defined(_WIN32) || defined(LIBBTF_STATIC)
#define LIBBTF_API
#else
#define LIBBTF_API __attribute__((visibility("default")))
#endif
#if defined(__GNUC__)
#define LIBBTF_NODISCARD __attribute__((warn_unused_result))
#define LIBBTF_PRINTF(format_index, first) __attribute__((format(printf, format_index, first)))
#else
#define LIBBTF_NODISCARD
#define LIBBTF_PRINTF(format_index, first)
#endif

#ifdef __cplusplus
extern "C" {
#endif

/** Outcome of a call. Values are pinned and grouped in decades by cause. */
typedef int32_t btf_status;
enum {
  BTF_OK = 0,
  /* The caller broke the contract of the call. */
  BTF_E_INVALID_ARG = 1,
  BTF_E_STATE = 2,
  BTF_E_ABI = 3,
  /* The environment could not serve the call. */
  BTF_E_NOMEM = 10,
  BTF_E_IO = 11,
  BTF_E_LIMIT = 12, /**< a limit of btf_limits or of the job was hit */
  /* The file is wrong. */
  BTF_E_NOT_BTF = 20,   /**< not a file this library knows */
  BTF_E_CORRUPT = 21,   /**< known kind of file, damaged or contradictory */
  BTF_E_TRUNCATED = 22, /**< the file ends too early */
  /* The file is fine, this build is not enough for it. */
  BTF_E_NEWER = 30,
  BTF_E_UNKNOWN_CODEC = 31,
  BTF_E_UNSUPPORTED = 32,
  /* The work did not finish. */
  BTF_E_CANCELLED = 40,
  BTF_E_NUMERIC = 41,
  BTF_E_PLUGIN = 42
};

/** Name of a status, such as "BTF_E_CORRUPT"; static storage, never NULL. Threads: free. */
LIBBTF_API const char *btf_status_name(btf_status status);

/** One line about the last failure of a call made on this thread: what was wrong with which file or argument,
 *  and what was expected. "" when nothing failed yet. Valid until this thread's next libbtf call. Threads: free. */
LIBBTF_API const char *btf_error_message(void);

/** Version of the library in use: major << 16 | minor << 8 | patch. Threads: free. */
LIBBTF_API uint32_t btf_version(void);

/** Owner of allocator, log, limits, threads and codec registry. Every object keeps its context alive. */
typedef struct btf_context btf_context;

/** Memory source. FROZEN. Both functions must be callable from several threads. */
typedef struct btf_allocator {
  void *user;
  /** Returns `size` bytes aligned to `align` (a power of two, at most 64), or NULL. */
  void *(*alloc)(void *user, size_t size, size_t align);
  /** Frees what alloc returned for the same size. */
  void (*free)(void *user, void *ptr, size_t size);
} btf_allocator;

/** Log levels. */
enum { BTF_LOG_ERROR = 1, BTF_LOG_WARNING = 2, BTF_LOG_INFO = 3 };
/** Receives one line without newline, on the thread that failed or reports. Must not call the library. */
typedef void (*btf_log_fn)(void *user, int32_t level, btf_status code, const char *message);

/** One unit of parallel work: `index` in 0..count-1, `thread` in 0..max_threads-1 unique among running tasks. */
typedef void (*btf_task_fn)(void *job, uint32_t index, uint32_t thread);
/** Runs task(job, 0..count-1, thread) and returns when all are done: BTF_OK, or a status if it could not run
 *  them. Called by the library from the thread that entered it; never nested. */
typedef btf_status (*btf_parallel_fn)(void *user, uint32_t count, btf_task_fn task, void *job);

/** Bounds that protect against hostile or mistaken input. 0 = library default, all ones = no limit. */
typedef struct btf_limits {
  size_t struct_size;
  uint64_t max_memory;      /**< bytes the context may have allocated at once; default 64 GiB */
  uint64_t max_chunk_bytes; /**< size of one chunk of a container, unpacked; default 16 GiB */
  uint32_t max_chunks;      /**< chunks in one container; default 65536 */
  uint32_t max_dimension;   /**< texels along one side; default 65536 */
  uint32_t max_directions;  /**< directions in one set; default 65536 */
  uint32_t max_channels;    /**< default 64, which is also the most */
} btf_limits;
#define BTF_LIMITS_INIT                                                                                      \
  { sizeof(btf_limits), 0, 0, 0, 0, 0, 0 }

/** How a context behaves. All members may be zero. */
typedef struct btf_context_desc {
  size_t struct_size;
  const btf_allocator *allocator; /**< copied; NULL = the C library's */
  const btf_limits *limits;       /**< copied; NULL = defaults */
  btf_log_fn log;                 /**< NULL = silent */
  void *log_user;
  btf_parallel_fn parallel; /**< the host's thread pool; NULL = one built in, started on first use */
  void *parallel_user;
  uint32_t max_threads; /**< most threads at once, up to 1024; 0 = number of processors the process may use; also bounds `thread` of tasks */
  uint32_t flags;       /**< must be 0 */
  const char *isa;      /**< caps the vector instructions: "scalar", "avx2", "avx512", "neon"; NULL = the best */
} btf_context_desc;
#define BTF_CONTEXT_DESC_INIT                                                                                \
  { sizeof(btf_context_desc), NULL, NULL, NULL, NULL, NULL, NULL, 0, 0, NULL }

/** Creates a context with the built-in codecs registered. Call through the macro, which passes the header's ABI
 *  number so that a mismatch between header and library is an error and not a crash.
 *  Errors: BTF_E_ABI, BTF_E_INVALID_ARG (unknown isa, more than 1024 threads), BTF_E_NOMEM. Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_context_create_abi(uint32_t abi, const btf_context_desc *desc,
                                                              btf_context **out);
#define btf_context_create(desc, out) btf_context_create_abi(LIBBTF_ABI, (desc), (out))

/** Drops the caller's reference; the context goes when its last object goes. NULL is fine. Threads: exclusive. */
LIBBTF_API void btf_context_release(btf_context *ctx);

/** Instruction set the context's kernels use: "scalar", "avx2", "avx512" or "neon". Threads: const. */
LIBBTF_API const char *btf_context_isa(const btf_context *ctx);

/** Most threads the context works with at once: max_threads of its description, or what 0 stood for. Threads: const. */
LIBBTF_API uint32_t btf_context_threads(const btf_context *ctx);

/** Bytes the context holds now, and the most it held; either pointer may be NULL. Threads: const. */
LIBBTF_API void btf_context_memory(const btf_context *ctx, uint64_t *now, uint64_t *peak);

/** A call in progress; the library's own. */
typedef struct btf_running_job btf_running_job;
/** How one long call behaves. NULL = defaults. */
typedef struct btf_job {
  size_t struct_size;
  /** Called with a fraction in 0..1 and the name of the stage. Calls are serialised and at most about ten a
   *  second. A return other than 0 cancels: the call ends with BTF_E_CANCELLED. */
  int32_t (*progress)(void *user, double fraction, const char *stage);
  void *user;
  uint64_t max_working_set; /**< bytes a fit may hold beside its result; 0 = 1 GiB */
  uint64_t seed;            /**< seed of every random choice; the same seed gives the same result */
  btf_running_job *running; /**< NULL, or BTF_E_INVALID_ARG; set only in the job that a codec is handed (btf_plugin.h) */
} btf_job;
#define BTF_JOB_INIT                                                                                         \
  { sizeof(btf_job), NULL, NULL, 0, 0, NULL }

#ifdef __cplusplus
}
#endif
#endif
