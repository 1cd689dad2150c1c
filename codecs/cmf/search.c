/* SPDX-License-Identifier: MIT */
/* search.c: exact nearest entries by way of matrix products. */
#include "search.h"

#include <math.h>

#include <btf/btf_codec.h>

enum {
  RUN = 512,        /* products that gemm may sum: what bounds its rounding whatever its order */
  STRIPE = 8,       /* rows of a task */
  COLUMN_RUN = 256, /* elements of a task that averages entries */
  LEAST_ROWS = 8,   /* of a block, however small the budget */
  BLOCK_FLOATS = 3 << 20
};

double btfi_cmf_distance(const float *a, const float *b, uint32_t length, double enough) {
  double sum = 0.0;
  for (uint32_t first = 0; first < length; first += 256) {
    const uint32_t n = length - first < 256 ? length - first : 256;
    double part[8] = {0};
    uint32_t i = 0;
    for (; i + 8 <= n; i += 8) {
      for (uint32_t j = 0; j < 8; j++) {
        const double d = (double)a[first + i + j] - (double)b[first + i + j];
        part[j] += d * d;
      }
    }
    for (; i < n; i++) {
      const double d = (double)a[first + i] - (double)b[first + i];
      part[0] += d * d;
    }
    sum += ((part[0] + part[1]) + (part[2] + part[3])) + ((part[4] + part[5]) + (part[6] + part[7]));
    if (sum > enough) break;
  }
  return sum;
}

static double squared_length(const float *a, uint32_t length) {
  double part[4] = {0};
  uint32_t i = 0;
  for (; i + 4 <= length; i += 4)
    for (uint32_t j = 0; j < 4; j++) part[j] += (double)a[i + j] * a[i + j];
  for (; i < length; i++) part[0] += (double)a[i] * a[i];
  return (part[0] + part[1]) + (part[2] + part[3]);
}

/* ---- memory ---- */

uint64_t btfi_cmf_search_bytes(uint32_t entries, uint32_t length, uint32_t rows) {
  return sizeof(float) * ((uint64_t)entries * (length + UINT64_C(3)) + length +
                          (uint64_t)rows * (2 * (uint64_t)length + entries));
}

void btfi_cmf_search_free(btfi_cmf_search *s) {
  if (s->host == NULL) return;
  float *const arrays[] = {s->origin, s->centred, s->lowest, s->highest,
                           s->slope,  s->raw,     s->block,  s->product};
  for (size_t i = 0; i < sizeof arrays / sizeof *arrays; i++) s->host->free(s->ctx, arrays[i]);
}

btf_status btfi_cmf_search_create(const btf_host *host, btf_context *ctx, const btfi_cmf_vectors *vectors,
                                  uint32_t entries, uint64_t max_working_set, uint64_t used,
                                  btfi_cmf_search *s) {
  const uint64_t length = vectors->length,
                 least = used + btfi_cmf_search_bytes(entries, vectors->length, LEAST_ROWS);
  const uint64_t row_bytes = sizeof(float) * (2 * length + entries);
  uint64_t rows;
  *s = (btfi_cmf_search){.host = host, .ctx = ctx, .vectors = vectors, .capacity = entries};
  if (least > max_working_set)
    return host->fail(
        ctx, BTF_E_LIMIT,
        "cmf: a codebook of %u entries of %u values for %llu vectors needs a working set of %llu bytes; "
        "%llu are allowed",
        entries, vectors->length, (unsigned long long)vectors->count, (unsigned long long)least,
        (unsigned long long)max_working_set);
  rows = LEAST_ROWS + (max_working_set - least) / row_bytes;
  if (rows > BLOCK_FLOATS / length) rows = BLOCK_FLOATS / length;
  if (rows > 2 * (uint64_t)BLOCK_FLOATS / entries) rows = 2 * (uint64_t)BLOCK_FLOATS / entries;
  if (rows > vectors->count) rows = vectors->count;
  if (rows > 4096) rows = 4096;
  s->rows = rows < LEAST_ROWS ? LEAST_ROWS : (uint32_t)rows;
  s->origin = host->alloc(ctx, length, sizeof *s->origin);
  s->centred = host->alloc(ctx, entries, length * sizeof *s->centred);
  s->lowest = host->alloc(ctx, entries, sizeof *s->lowest);
  s->highest = host->alloc(ctx, entries, sizeof *s->highest);
  s->slope = host->alloc(ctx, entries, sizeof *s->slope);
  s->raw = host->alloc(ctx, s->rows, length * sizeof *s->raw);
  s->block = host->alloc(ctx, s->rows, length * sizeof *s->block);
  s->product = host->alloc(ctx, s->rows, entries * sizeof *s->product);
  return s->origin != NULL && s->centred != NULL && s->lowest != NULL && s->highest != NULL &&
                 s->slope != NULL && s->raw != NULL && s->block != NULL && s->product != NULL
             ? BTF_OK
             : BTF_E_NOMEM;
}

/* ---- entries ---- */

static void average_columns(void *job, uint32_t run, uint32_t thread) {
  const btfi_cmf_search *s = job;
  const uint32_t length = s->vectors->length, first = run * COLUMN_RUN;
  const uint32_t n = length - first < COLUMN_RUN ? length - first : COLUMN_RUN;
  double sum[COLUMN_RUN] = {0};
  (void)thread;
  for (uint32_t e = 0; e < s->entries; e++) {
    const float *value = s->values + (size_t)e * length + first;
    for (uint32_t i = 0; i < n; i++) sum[i] += (double)value[i];
  }
  for (uint32_t i = 0; i < n; i++) s->origin[first + i] = (float)(sum[i] / s->entries);
}

/* With u = 2^-24, x and c relative to the origin, |x - c|^2 - |x|^2 = |c|^2 - 2 x.c =: t. What is computed
 * differs
 * - by gemm, which sums RUN products at a time and then the runs: 2 (RUN + runs) u |x| |c|;
 * - by rounding x and c when the origin is subtracted, u of each element: 2 u (|x| + |c|)^2 <= 4 u (|x|^2 +
 * |c|^2);
 * - by rounding the sums of an end and of the limit: less than 4 u (|c|^2 + 2 |x| |c|) + u |c|^2;
 * - by products below the smallest float.
 * So the ends |c|^2 (1 -+ 13 u) - 2 x.c -+ |x| slope -+ 13 u |x|^2 hold t. */
static void prepare_entry(void *job, uint32_t e, uint32_t thread) {
  const btfi_cmf_search *s = job;
  const uint32_t length = s->vectors->length;
  const float *value = s->values + (size_t)e * length;
  float *centred = s->centred + (size_t)e * length;
  const double u = ldexp(1.0, -24);
  (void)thread;
  for (uint32_t i = 0; i < length; i++) centred[i] = value[i] - s->origin[i];
  const double square = squared_length(centred, length), tiny = ldexp((double)length, -140);
  const double runs = ceil((double)length / RUN);
  const int fits = square < 1e37; /* otherwise the entry is always measured */
  s->lowest[e] = fits ? (float)(square * (1.0 - 13.0 * u) - tiny) : -INFINITY;
  s->highest[e] = fits ? (float)(square * (1.0 + 13.0 * u) + tiny) : INFINITY;
  s->slope[e] = (float)(2.0 * (RUN + runs + 4.0) * u * sqrt(square));
}

btf_status btfi_cmf_search_prepare(btfi_cmf_search *s, const float *values, uint32_t entries) {
  s->values = values;
  s->entries = entries;
  BTF_TRY(s->host->parallel(s->ctx, (s->vectors->length + COLUMN_RUN - 1) / COLUMN_RUN, average_columns, s));
  return s->host->parallel(s->ctx, entries, prepare_entry, s);
}

/* ---- vectors ---- */

typedef struct search_block {
  const btfi_cmf_search *s;
  const uint32_t *ids;
  uint64_t first;
  uint32_t count;
  uint32_t *index;
  double *distance, *others;
} search_block;

static uint64_t id_of(const search_block *b, uint32_t row) {
  return b->ids != NULL ? b->ids[b->first + row] : b->first + row;
}

static void read_stripe(void *job, uint32_t stripe, uint32_t thread) {
  const search_block *b = job;
  const btfi_cmf_search *s = b->s;
  const uint32_t length = s->vectors->length;
  (void)thread;
  for (uint32_t row = stripe * STRIPE; row < b->count && row < (stripe + 1) * STRIPE; row++) {
    float *raw = s->raw + (size_t)row * length, *centred = s->block + (size_t)row * length;
    s->vectors->read(s->vectors->user, id_of(b, row), raw);
    for (uint32_t i = 0; i < length; i++) centred[i] = raw[i] - s->origin[i];
  }
}

static void select_entry(const search_block *b, uint32_t row) {
  const btfi_cmf_search *s = b->s;
  const uint32_t length = s->vectors->length, entries = s->entries;
  const float *x = s->raw + (size_t)row * length;
  float *product = s->product + (size_t)row * entries;
  const double square = squared_length(s->block + (size_t)row * length, length), u = ldexp(1.0, -24);
  const float norm = (float)(sqrt(square) * (1.0 + 4.0 * u));
  /* Lower ends replace the products. Where products overflow, ends are not numbers or infinite, and all is
   * measured.
   */
  float limit = INFINITY;
  for (uint32_t e = 0; e < entries; e++) {
    const float twice = 2.0f * product[e], spread = norm * s->slope[e], high = s->highest[e] - twice + spread;
    product[e] = s->lowest[e] - twice - spread;
    if (high < limit) limit = high;
  }
  if (limit == -INFINITY) limit = INFINITY;
  limit += (float)(26.0 * u * square); /* of both ends */
  double best = INFINITY, second = INFINITY;
  float least_bound = INFINITY; /* of what was not measured */
  uint32_t nearest = 0;
  for (uint32_t e = 0; e < entries; e++) {
    if (product[e] > limit) {
      if (product[e] < least_bound) least_bound = product[e];
      continue;
    }
    const double d = btfi_cmf_distance(x, s->values + (size_t)e * length, length, second);
    if (d < best) {
      second = best;
      best = d;
      nearest = e;
    } else if (d < second) {
      second = d;
    }
  }
  const uint64_t id = id_of(b, row);
  b->index[id] = nearest;
  b->distance[id] = best;
  if (b->others != NULL) {
    const double bound = (double)least_bound + square * (1.0 - 16.0 * u);
    const double least = fmin(bound, second);
    b->others[id] = least > 0.0 ? sqrt(least) : 0.0;
  }
}

static void select_stripe(void *job, uint32_t stripe, uint32_t thread) {
  const search_block *b = job;
  (void)thread;
  for (uint32_t row = stripe * STRIPE; row < b->count && row < (stripe + 1) * STRIPE; row++)
    select_entry(b, row);
}

btf_status btfi_cmf_search_run(btfi_cmf_search *s, const uint32_t *ids, uint64_t count,
                               const btfi_cmf_search_report *report, uint32_t *index, double *distance,
                               double *others) {
  const uint32_t length = s->vectors->length;
  search_block b = {.s = s, .ids = ids, .index = index, .distance = distance, .others = others};
  for (b.first = 0; b.first < count; b.first += s->rows) {
    b.count = count - b.first < s->rows ? (uint32_t)(count - b.first) : s->rows;
    const uint32_t stripes = (b.count + STRIPE - 1) / STRIPE;
    BTF_TRY(s->host->progress(report->job,
                              report->from + (report->to - report->from) * (double)b.first / (double)count,
                              report->stage));
    BTF_TRY(s->host->parallel(s->ctx, stripes, read_stripe, &b));
    for (uint32_t k = 0; k < length; k += RUN)
      BTF_TRY(s->host->gemm(s->ctx, BTF_TRANSPOSE_B, b.count, s->entries, length - k < RUN ? length - k : RUN,
                            1.0f, s->block + k, length, s->centred + k, length, k == 0 ? 0.0f : 1.0f,
                            s->product, s->entries));
    BTF_TRY(s->host->parallel(s->ctx, stripes, select_stripe, &b));
  }
  return BTF_OK;
}
