/* SPDX-License-Identifier: MIT */
/* base.h: what every layer of the library stands on. Internal names begin with btfi_. */
#ifndef BTFI_BASE_H
#define BTFI_BASE_H

#include <stdarg.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>

#include <btf/btf_base.h>

#define BTFI_STRINGIFY_(x) #x
#define BTFI_STRINGIFY(x) BTFI_STRINGIFY_(x)
#define BTFI_MIN(a, b) ((a) < (b) ? (a) : (b))
#define BTFI_MAX(a, b) ((a) > (b) ? (a) : (b))

/* Goes to the caller with the status when the expression is not BTF_OK. */
#define BTFI_TRY(expression)                                                                                 \
  do {                                                                                                       \
    const btf_status btfi_try_status_ = (expression);                                                        \
    if (btfi_try_status_ != BTF_OK) return btfi_try_status_;                                                 \
  } while (0)

/* ---- failure and log (status.c) ---- */

/* Sets this thread's message, tells the context's log (ctx may be NULL) and returns code. Layers that only
 * pass a status on do not call it again. */
btf_status btfi_fail(btf_context *ctx, btf_status code, const char *format, ...) LIBBTF_PRINTF(3, 4);
void btfi_log(btf_context *ctx, int32_t level, const char *format, ...) LIBBTF_PRINTF(3, 4);

/* ---- memory (memory.c) ---- */

/* count * size bytes, 64-byte aligned, not zeroed, counted against the limit; NULL with the message set on
 * overflow, limit or exhaustion. Zero bytes give a valid pointer. btfi_alloc_status() tells NOMEM from LIMIT
 * of this thread's last. */
void *btfi_alloc(btf_context *ctx, uint64_t count, uint64_t size);
void *btfi_calloc(btf_context *ctx, uint64_t count, uint64_t size);
void btfi_free(btf_context *ctx, void *ptr);
btf_status btfi_alloc_status(void);
char *btfi_strdup(btf_context *ctx, const char *text);

/* Product and sum; false on overflow of 64 bits. */
static inline bool btfi_mul(uint64_t a, uint64_t b, uint64_t *out) {
  return !__builtin_mul_overflow(a, b, out);
}
static inline bool btfi_add(uint64_t a, uint64_t b, uint64_t *out) {
  return !__builtin_add_overflow(a, b, out);
}

/* ---- growable structs (memory.c) ---- */

/* Bytes of a struct up to the end of a member. With the last member that the first released version had, this
 * is the least size a caller may give; it stays when the struct grows. */
#define BTFI_SIZE_TO(type, member) (offsetof(type, member) + sizeof(((type *)0)->member))

/* Copies a caller's struct (whose first member is struct_size) to ours of `size` bytes. `minimum` is the size
 * of the first released version. */
btf_status btfi_copy_in(btf_context *ctx, const char *name, void *dst, size_t size, size_t minimum,
                        const void *src);
/* Copies ours back to the caller's, as far as it has room, keeping its struct_size. */
btf_status btfi_copy_out(btf_context *ctx, const char *name, void *dst, size_t minimum, const void *src,
                         size_t size);

/* ---- context (context.c) ---- */

void btfi_context_retain(btf_context *ctx);
const btf_limits *btfi_limits(const btf_context *ctx);
/* The registry hangs its list here and is told when the context goes. */
void btfi_context_set_registry(btf_context *ctx, void *registry,
                               void (*destroy)(btf_context *ctx, void *registry));
void *btfi_context_registry(const btf_context *ctx);
/* Set by the registry layer's constructor function; called at the end of btf_context_create. Declared here so
 * that base does not include the registry; defined there, and in tests that link lower layers only in
 * tests/no_registry.c. */
btf_status btfi_registry_attach(btf_context *ctx);

/* ---- threads (threads.c) ---- */

btf_status btfi_parallel(btf_context *ctx, uint32_t count, btf_task_fn task, void *job);
uint32_t btfi_thread_count(const btf_context *ctx);

/* ---- processor (cpu.c) ---- */

uint32_t btfi_isa(const btf_context *ctx); /* BTF_ISA_* of btf_plugin.h, capped by the context */
uint32_t btfi_isa_of_machine(void);

/* ---- jobs (job.c) ---- */

/* A job in use. `desc` is what codecs are handed, and copy: its `running` leads back here. */
typedef struct btf_running_job {
  btf_job desc;
  btf_context *ctx;
  int64_t last_report_ns;
  double last_fraction; /* of the last report, -1 before the first */
  char last_stage[64];  /* a copy, since a codec may name its stages in a buffer of its own */
  bool cancelled;
} btfi_job;
/* Copies the caller's job (NULL = defaults; max_working_set becomes 1 GiB when 0). `out` stays where it is as
 * long as it is used. */
btf_status btfi_job_begin(btf_context *ctx, const btf_job *user, btfi_job *out);
/* BTF_OK or BTF_E_CANCELLED (sticky). `job` is NULL or the desc of a btfi_job or a copy of it. Thins reports
 * out to ten a second, but passes on fraction 0, fraction 1 and every new stage. One thread. */
btf_status btfi_progress(const btf_job *job, double fraction, const char *stage);
int64_t btfi_now_ns(void);

/* ---- random numbers (random.h idiom): xoshiro256** seeded by splitmix64 ---- */

typedef struct btfi_random {
  uint64_t s[4];
} btfi_random;
void btfi_random_seed(btfi_random *r, uint64_t seed);
uint64_t btfi_random_u64(btfi_random *r);
float btfi_random_float(btfi_random *r); /* [0, 1) */
float btfi_random_normal(btfi_random *r);
uint64_t btfi_random_below(btfi_random *r, uint64_t n); /* unbiased, n > 0 */

/* ---- checksum (xxh64.c) ---- */

typedef struct btfi_xxh64 {
  uint64_t lane[4], total, seed;
  unsigned char pending[32];
  uint32_t pending_size;
} btfi_xxh64;
void btfi_xxh64_init(btfi_xxh64 *state, uint64_t seed);
void btfi_xxh64_update(btfi_xxh64 *state, const void *data, size_t size);
uint64_t btfi_xxh64_digest(const btfi_xxh64 *state);
uint64_t btfi_xxh64_of(const void *data, size_t size);

/* ---- little-endian access with a bound (bytes.c) ---- */

/* A cursor over `size` bytes; reads past the end return 0 and set `overrun`. */
typedef struct btfi_cursor {
  const unsigned char *data;
  uint64_t size, position;
  bool overrun;
} btfi_cursor;
uint32_t btfi_get_u32(btfi_cursor *c);
uint64_t btfi_get_u64(btfi_cursor *c);
float btfi_get_f32(btfi_cursor *c);
double btfi_get_f64(btfi_cursor *c);
const void *btfi_get_bytes(btfi_cursor *c, uint64_t n); /* NULL when too few are left */

/* A growing byte buffer; the first failure sticks and is returned by btfi_buffer_status. */
typedef struct btfi_buffer {
  btf_context *ctx;
  unsigned char *data;
  uint64_t size, capacity;
  btf_status status;
} btfi_buffer;
void btfi_buffer_init(btfi_buffer *b, btf_context *ctx);
void btfi_buffer_free(btfi_buffer *b);
btf_status btfi_buffer_status(const btfi_buffer *b);
void btfi_put_bytes(btfi_buffer *b, const void *src, uint64_t n);
void btfi_put_u8(btfi_buffer *b, uint8_t v);
void btfi_put_u32(btfi_buffer *b, uint32_t v);
void btfi_put_u64(btfi_buffer *b, uint64_t v);
void btfi_put_f32(btfi_buffer *b, float v);
void btfi_put_f64(btfi_buffer *b, double v);
void btfi_put_text(btfi_buffer *b, const char *format, ...) LIBBTF_PRINTF(2, 3); /* no NUL; in the C locale */
void btfi_put_text_of(btfi_buffer *b, const char *format, va_list arguments) LIBBTF_PRINTF(2, 0);

/* Bytes of the valid UTF-8 sequence at the start of the text, 0 if there is none. */
uint32_t btfi_utf8_length(const void *text, uint64_t size);

/* ---- JSON (json.c) ---- */

typedef struct btf_json btfi_json;
enum {
  BTFI_JSON_NULL,
  BTFI_JSON_BOOL,
  BTFI_JSON_NUMBER,
  BTFI_JSON_STRING,
  BTFI_JSON_ARRAY,
  BTFI_JSON_OBJECT
};
/* Parses a whole document (RFC 8259, UTF-8, at most 64 levels deep, duplicate keys refused). One line with
 * line and column on failure, BTF_E_CORRUPT, prefixed with `name`. */
btf_status btfi_json_parse(btf_context *ctx, const char *name, const char *text, uint64_t size,
                           btfi_json **out);
void btfi_json_free(btfi_json *root);
int btfi_json_type(const btfi_json *v);
uint64_t btfi_json_length(const btfi_json *v); /* of an array or object, else 0 */
const btfi_json *btfi_json_at(const btfi_json *v,
                              uint64_t i);          /* NULL out of range; constant time for arrays */
const char *btfi_json_key(const btfi_json *member); /* NULL unless in an object; and with NUL inside */
const btfi_json *btfi_json_get(const btfi_json *object, const char *key); /* NULL if absent */
double btfi_json_number(const btfi_json *v);                              /* 0 unless a number */
const char *btfi_json_string(const btfi_json *v); /* NULL unless a string without NUL inside */
bool btfi_json_bool(const btfi_json *v);
/* Appends a JSON string literal with escapes. */
void btfi_json_put_string(btfi_buffer *b, const char *text);

#endif
