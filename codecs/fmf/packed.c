/* SPDX-License-Identifier: MIT */
/* packed.c: U S and V S rounded to integers with one step per factor. An error of one step weighs the same
 * wherever it sits, since the other factor is orthonormal, so that one step spends the fewest bits for a
 * total error. Each column is predicted from its neighbours in direction, texture and colour, and what is
 * left is stored as planes of bytes, least significant first, for zstd to squeeze. */
#include "fmf.h"

#include <math.h>
#include <string.h>

/* How a value is predicted; `before` is the neighbour one step back along an axis. */
enum {
  PREDICT_NONE = 0,
  PREDICT_INNER = 1,   /* the value before along the inner axis */
  PREDICT_OUTER = 2,   /* the value before along the outer axis */
  PREDICT_MEAN = 3,    /* the mean of both */
  PREDICT_PLANE = 4,   /* the plane through both and the one diagonally before */
  PREDICT_MODES = 5,   /* those of a first channel */
  PREDICT_CHANNEL = 5, /* the channel before, times a gain */
  PREDICT_COLOUR = 6,  /* inner value plus the gain times the change of the channel before */
  PREDICT_CHANNEL_MODES = 7
};
enum { COLUMN_HEADER = 4, GAIN_ONE = 1024, SAMPLED_LINES = 16 };

typedef struct column_coding {
  uint32_t width; /* bytes a value */
  uint32_t first_mode, other_mode;
  int16_t gain[FMF_MAX_CHANNELS];
} column_coding;

static uint64_t header_bytes(const btfi_fmf_grid *grid) {
  return COLUMN_HEADER + 2 * (uint64_t)(grid->channels - 1);
}

static uint64_t grid_length(const btfi_fmf_grid *grid) {
  return (uint64_t)grid->channels * grid->inner * grid->outer;
}

/* Wraps like the integers of the file format do, whatever a hostile file holds. */
static int32_t wrap(int64_t value) {
  const uint32_t low = (uint32_t)(uint64_t)value;
  return low < 0x80000000u ? (int32_t)low : -(int32_t)(0xffffffffu - low) - 1;
}

static int64_t scaled(int16_t gain, int64_t value) {
  const int64_t product = gain * value + GAIN_ONE / 2;
  return product >= 0 ? product / GAIN_ONE : -((-product + GAIN_ONE - 1) / GAIN_ONE);
}

/* Prediction of the value at q, which is channel c of (outer o, inner i). */
static inline int32_t predict(uint32_t mode, const int32_t *q, const btfi_fmf_grid *grid, uint32_t o,
                              uint32_t i, uint32_t c, const int16_t *gain) {
  const size_t step = grid->channels, line = step * grid->inner;
  const bool has_inner = i > 0, has_outer = o > 0;
  switch (mode) {
  case PREDICT_INNER:
    return has_inner ? q[-(ptrdiff_t)step] : has_outer ? q[-(ptrdiff_t)line] : 0;
  case PREDICT_OUTER:
    return has_outer ? q[-(ptrdiff_t)line] : has_inner ? q[-(ptrdiff_t)step] : 0;
  case PREDICT_MEAN:
  case PREDICT_PLANE:
    if (has_inner && has_outer) {
      const int64_t inner = q[-(ptrdiff_t)step], outer = q[-(ptrdiff_t)line];
      if (mode == PREDICT_PLANE) return wrap(inner + outer - q[-(ptrdiff_t)(line + step)]);
      return wrap((inner + outer - (inner + outer < 0)) / 2);
    }
    return has_inner ? q[-(ptrdiff_t)step] : has_outer ? q[-(ptrdiff_t)line] : 0;
  case PREDICT_CHANNEL:
    return wrap(scaled(gain[c], q[-1]));
  case PREDICT_COLOUR:
    if (!has_inner) return wrap(scaled(gain[c], q[-1]));
    return wrap((int64_t)q[-(ptrdiff_t)step] + scaled(gain[c], (int64_t)q[-1] - q[-(ptrdiff_t)step - 1]));
  default:
    return 0;
  }
}

static uint32_t zigzag(int32_t value) {
  return value < 0 ? ((uint32_t)(-(value + 1)) << 1 | 1u) : (uint32_t)value << 1;
}

static int32_t unzigzag(uint32_t code) {
  const int32_t half = (int32_t)(code >> 1);
  return (code & 1u) != 0 ? -half - 1 : half;
}

/* ---- packing ---- */

typedef struct packing {
  const btfi_fmf_factors *factors;
  uint32_t side;
  const btfi_fmf_grid *grid;
  const double *weight;
  double step;
  uint64_t length;
  float *values; /* of each thread */
  int32_t *integers;
  column_coding *coding; /* of each component */
  uint64_t *start;
  unsigned char *bytes; /* NULL while the codings are chosen */
} packing;

static void quantise(const packing *p, uint32_t k, float *values, int32_t *q) {
  const double factor = (p->weight != NULL ? p->weight[k] : 1.0) / p->step;
  p->factors->column(p->factors->user, p->side, k, values);
  for (uint64_t i = 0; i < p->length; i++) {
    const double scaled_value = values[i] * factor;
    const double bounded = scaled_value > FMF_LARGEST_INTEGER    ? FMF_LARGEST_INTEGER
                           : scaled_value < -FMF_LARGEST_INTEGER ? -FMF_LARGEST_INTEGER
                                                                 : scaled_value;
    q[i] = (int32_t)(bounded < 0.0 ? bounded - 0.5 : bounded + 0.5);
  }
}

/* Least-squares gains between neighbouring channels. */
static void find_gains(const packing *p, const int32_t *q, int16_t *gain) {
  const uint32_t channels = p->grid->channels;
  gain[0] = 0;
  for (uint32_t c = 1; c < channels; c++) {
    double product = 0.0, square = 0.0;
    for (uint64_t i = c; i < p->length; i += channels) {
      product += (double)q[i] * q[i - 1];
      square += (double)q[i - 1] * q[i - 1];
    }
    const double best = square > 0.0 ? product / square * GAIN_ONE : 0.0;
    gain[c] = (int16_t)lrint(best > 32767.0 ? 32767.0 : best < -32767.0 ? -32767.0 : best);
  }
}

/* About the bits that one way of predicting takes, from a sample of the lines. */
static double cost_of(const packing *p, const int32_t *q, uint32_t mode, bool first_channel,
                      const int16_t *gain) {
  const btfi_fmf_grid *grid = p->grid;
  const uint32_t stride = grid->outer / SAMPLED_LINES + 1;
  double cost = 0.0;
  for (uint32_t o = stride / 2; o < grid->outer; o += stride) {
    for (uint32_t i = 0; i < grid->inner; i++) {
      const int32_t *at = q + ((size_t)o * grid->inner + i) * grid->channels;
      for (uint32_t c = first_channel ? 0 : 1; c < (first_channel ? 1 : grid->channels); c++) {
        const int32_t left = wrap((int64_t)at[c] - predict(mode, at + c, grid, o, i, c, gain));
        cost += log2f(1.0f + 2.0f * fabsf((float)left));
      }
    }
  }
  return cost;
}

static uint32_t best_mode(const packing *p, const int32_t *q, bool first_channel, const int16_t *gain) {
  const uint32_t modes = first_channel ? PREDICT_MODES : PREDICT_CHANNEL_MODES;
  uint32_t best = PREDICT_NONE;
  double least = cost_of(p, q, PREDICT_NONE, first_channel, gain);
  for (uint32_t mode = 1; mode < modes; mode++) {
    const double cost = cost_of(p, q, mode, first_channel, gain);
    if (cost < least) {
      least = cost;
      best = mode;
    }
  }
  return best;
}

/* Calls for every value what is left of it after prediction. */
static uint32_t largest_rest(const packing *p, const column_coding *coding, const int32_t *q,
                             uint32_t *codes) {
  const btfi_fmf_grid *grid = p->grid;
  uint32_t largest = 0;
  size_t m = 0;
  for (uint32_t o = 0; o < grid->outer; o++) {
    for (uint32_t i = 0; i < grid->inner; i++) {
      for (uint32_t c = 0; c < grid->channels; c++, m++) {
        const uint32_t mode = c == 0 ? coding->first_mode : coding->other_mode;
        const uint32_t code = zigzag(wrap((int64_t)q[m] - predict(mode, q + m, grid, o, i, c, coding->gain)));
        if (codes != NULL) codes[m] = code;
        largest |= code;
      }
    }
  }
  return largest;
}

static void choose_coding(void *job, uint32_t k, uint32_t thread) {
  packing *p = job;
  int32_t *q = p->integers + thread * p->length;
  column_coding *coding = &p->coding[k];
  quantise(p, k, p->values + thread * p->length, q);
  find_gains(p, q, coding->gain);
  coding->first_mode = best_mode(p, q, true, coding->gain);
  coding->other_mode = p->grid->channels > 1 ? best_mode(p, q, false, coding->gain) : PREDICT_NONE;
  const uint32_t largest = largest_rest(p, coding, q, NULL);
  coding->width = 1;
  while (coding->width < 4 && largest >> 8 * coding->width != 0) coding->width++;
}

static void write_column(void *job, uint32_t k, uint32_t thread) {
  packing *p = job;
  int32_t *q = p->integers + thread * p->length;
  uint32_t *codes = (uint32_t *)(void *)(p->values + thread * p->length);
  const column_coding *coding = &p->coding[k];
  unsigned char *header = p->bytes + k * header_bytes(p->grid), *plane = p->bytes + p->start[k];
  quantise(p, k, p->values + thread * p->length, q);
  header[0] = (unsigned char)coding->width;
  header[1] = (unsigned char)coding->first_mode;
  header[2] = (unsigned char)coding->other_mode;
  header[3] = 0;
  for (uint32_t c = 1; c < p->grid->channels; c++) {
    header[COLUMN_HEADER + 2 * c - 2] = (unsigned char)((uint16_t)coding->gain[c] & 0xffu);
    header[COLUMN_HEADER + 2 * c - 1] = (unsigned char)((uint16_t)coding->gain[c] >> 8);
  }
  (void)largest_rest(p, coding, q, codes);
  for (uint32_t byte = 0; byte < coding->width; byte++, plane += p->length)
    for (uint64_t i = 0; i < p->length; i++) plane[i] = (unsigned char)(codes[i] >> 8 * byte);
}

btf_status btfi_fmf_pack(const btf_host *host, btf_context *ctx, const btfi_fmf_factors *factors,
                         uint32_t side, const btfi_fmf_grid *grid, const double *weight, double step,
                         btf_chunk_writer *writer, uint32_t tag) {
  const uint32_t threads = host->thread_count(ctx);
  packing p = {factors, side, grid, weight, step, factors->length[side], NULL, NULL, NULL, NULL, NULL};
  btf_status status = BTF_E_NOMEM;
  uint64_t size = header_bytes(grid) * factors->components;
  void *bytes = NULL;
  p.values = host->alloc(ctx, p.length * threads, sizeof *p.values);
  p.integers = host->alloc(ctx, p.length * threads, sizeof *p.integers);
  p.coding = host->alloc(ctx, factors->components, sizeof *p.coding);
  p.start = host->alloc(ctx, factors->components, sizeof *p.start);
  if (p.values != NULL && p.integers != NULL && p.coding != NULL && p.start != NULL)
    status = host->parallel(ctx, factors->components, choose_coding, &p);
  if (status == BTF_OK) {
    for (uint32_t k = 0; k < factors->components; k++) {
      p.start[k] = size;
      size += p.coding[k].width * p.length;
    }
    status = host->reserve(writer, tag, 0, 0, size, &bytes);
  }
  if (status == BTF_OK) {
    p.bytes = bytes;
    status = host->parallel(ctx, factors->components, write_column, &p);
  }
  host->free(ctx, p.values);
  host->free(ctx, p.integers);
  host->free(ctx, p.coding);
  host->free(ctx, p.start);
  return status;
}

/* ---- unpacking ---- */

btf_status btfi_fmf_unpack(const btf_host *host, btf_context *ctx, const char *name, const void *data,
                           uint64_t size, const btfi_fmf_grid *grid, uint32_t components, uint64_t *start) {
  const unsigned char *bytes = data;
  const uint64_t length = grid_length(grid), header = header_bytes(grid);
  uint64_t expected = header * components;
  if (size < expected)
    return host->fail(ctx, BTF_E_CORRUPT, "fmf: chunk %s has %llu bytes, its column headers alone need %llu",
                      name, (unsigned long long)size, (unsigned long long)expected);
  for (uint32_t k = 0; k < components; k++) {
    const unsigned char *column = bytes + k * header;
    uint64_t planes;
    if (column[0] < 1 || column[0] > 4 || column[1] >= PREDICT_MODES || column[3] != 0 ||
        column[2] >= (grid->channels > 1 ? PREDICT_CHANNEL_MODES : 1))
      return host->fail(ctx, BTF_E_CORRUPT, "fmf: chunk %s: column %u has an impossible header", name, k);
    start[k] = expected;
    if (__builtin_mul_overflow(length, (uint64_t)column[0], &planes) ||
        __builtin_add_overflow(expected, planes, &expected) || expected > size)
      return host->fail(ctx, BTF_E_CORRUPT, "fmf: chunk %s ends inside column %u", name, k);
  }
  if (expected != size)
    return host->fail(ctx, BTF_E_CORRUPT, "fmf: chunk %s has %llu bytes instead of %llu", name,
                      (unsigned long long)size, (unsigned long long)expected);
  return BTF_OK;
}

void btfi_fmf_packed_column(const void *packed, uint32_t side, uint32_t k, float *dst) {
  const btfi_fmf_packed *p = packed;
  const btfi_fmf_grid *grid = &p->grid[side];
  const uint64_t length = grid_length(grid);
  const unsigned char *header = p->data[side] + k * header_bytes(grid),
                      *plane = p->data[side] + p->start[side][k];
  const double factor = side == FMF_SIDE_U ? p->step[side] / p->sigma[k] : p->step[side];
  int32_t *q = (int32_t *)(void *)dst; /* the integers stand where their floats will */
  int16_t gain[FMF_MAX_CHANNELS] = {0};
  size_t m = 0;
  for (uint32_t c = 1; c < grid->channels; c++) {
    const uint32_t low = header[COLUMN_HEADER + 2 * c - 2], high = header[COLUMN_HEADER + 2 * c - 1];
    gain[c] = (int16_t)((int32_t)((low | high << 8) ^ 0x8000u) - 0x8000);
  }
  for (uint32_t o = 0; o < grid->outer; o++) {
    for (uint32_t i = 0; i < grid->inner; i++) {
      for (uint32_t c = 0; c < grid->channels; c++, m++) {
        uint32_t code = 0;
        for (uint32_t byte = 0; byte < header[0]; byte++)
          code |= (uint32_t)plane[byte * length + m] << 8 * byte;
        q[m] = wrap((int64_t)unzigzag(code) + predict(header[c == 0 ? 1 : 2], q + m, grid, o, i, c, gain));
      }
    }
  }
  for (uint64_t i = 0; i < length; i++) {
    const int32_t integer = q[i];
    dst[i] = (float)(integer * factor);
  }
}
