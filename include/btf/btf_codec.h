/* SPDX-License-Identifier: MIT */
/*
 * btf_codec.h: what nearly every codec writes in the same way, inline: status passing, parameter
 * descriptions, little-endian fields of a payload, directions of a batch, the peak of a material, repeatable
 * random numbers. btf_plugin.h has the interface itself.
 */
#ifndef LIBBTF_BTF_CODEC_H
#define LIBBTF_BTF_CODEC_H

#include <math.h>
#include <string.h>

#include "btf_plugin.h"

/** Returns the status of an expression to the caller unless it is BTF_OK. */
#define BTF_TRY(expression)                                                                                  \
  do {                                                                                                       \
    const btf_status btf_try_status_ = (expression);                                                         \
    if (btf_try_status_ != BTF_OK) return btf_try_status_;                                                   \
  } while (0)

/** Defines the description `id` of the parameter of that name. `choices` is a NULL-terminated list or NULL.
 */
#define BTF_PARAM(id, type, summary, unit, default_text, choices, minimum, maximum)                          \
  static const btf_param_desc id = {                                                                         \
      sizeof(btf_param_desc), #id, summary, unit, default_text, choices, minimum, maximum, (type), 0}

/* ---- little-endian fields ---- */

static inline void btf_put_u32(unsigned char *dst, uint32_t value) {
  for (int i = 0; i < 4; i++) dst[i] = (unsigned char)(value >> (8 * i));
}

static inline uint32_t btf_get_u32(const unsigned char *src) {
  return (uint32_t)src[0] | (uint32_t)src[1] << 8 | (uint32_t)src[2] << 16 | (uint32_t)src[3] << 24;
}

/** The bits of a float. */
static inline uint32_t btf_bits_f32(float value) {
  uint32_t bits;
  memcpy(&bits, &value, sizeof bits);
  return bits;
}

static inline void btf_put_f32(unsigned char *dst, float value) {
  btf_put_u32(dst, btf_bits_f32(value));
}

static inline float btf_get_f32(const unsigned char *src) {
  const uint32_t bits = btf_get_u32(src);
  float value;
  memcpy(&value, &bits, sizeof value);
  return value;
}

static inline void btf_put_f64(unsigned char *dst, double value) {
  uint64_t bits;
  memcpy(&bits, &value, sizeof bits);
  btf_put_u32(dst, (uint32_t)bits);
  btf_put_u32(dst + 4, (uint32_t)(bits >> 32));
}

static inline double btf_get_f64(const unsigned char *src) {
  const uint64_t bits = (uint64_t)btf_get_u32(src) | (uint64_t)btf_get_u32(src + 4) << 32;
  double value;
  memcpy(&value, &bits, sizeof value);
  return value;
}

/** Fetches a chunk that must have exactly `size` bytes; BTF_E_CORRUPT names it and both sizes. */
static inline btf_status btf_get_chunk(const btf_host *host, btf_context *ctx, btf_chunk_reader *payload,
                                       const char *codec, uint32_t tag, uint32_t index, uint64_t size,
                                       const void **data) {
  uint64_t found;
  BTF_TRY(host->get(payload, tag, index, data, &found));
  if (found != size) /* In parentheses, since some test libraries have a macro of that name. */
    return (host->fail)(ctx, BTF_E_CORRUPT, "%s: chunk %c%c%c%c %u has %llu bytes instead of %llu", codec,
                        (int)(tag & 0x7f), (int)(tag >> 8 & 0x7f), (int)(tag >> 16 & 0x7f),
                        (int)(tag >> 24 & 0x7f), index, (unsigned long long)found, (unsigned long long)size);
  return BTF_OK;
}

/* ---- directions of a batch ---- */

enum { BTF_RUN_DIRECTIONS = 64 /* most directions that are located together */ };

/** Locates `count` directions from `first` on, 1 to BTF_RUN_DIRECTIONS, each run of equal ones once:
 * out[run[i]] is where direction first + i lies. Equal means of the same bits. */
static inline void btf_locate_runs(const btf_host *host, const btf_dirset *set,
                                   const float *const direction[3], size_t first, uint32_t count,
                                   uint8_t *run, btf_interp *out) {
  const float *const x = direction[0] + first, *const y = direction[1] + first,
                     *const z = direction[2] + first;
  uint32_t differs[BTF_RUN_DIRECTIONS], runs = 1;
  differs[0] = 0;
  run[0] = 0;
  for (uint32_t i = 1; i < count; i++) /* on its own, so that it becomes vector code */
    differs[i] = (btf_bits_f32(x[i]) ^ btf_bits_f32(x[i - 1])) |
                 (btf_bits_f32(y[i]) ^ btf_bits_f32(y[i - 1])) |
                 (btf_bits_f32(z[i]) ^ btf_bits_f32(z[i - 1]));
  for (uint32_t i = 1; i < count; i++) {
    runs += differs[i] != 0;
    run[i] = (uint8_t)(runs - 1);
  }
  if (runs == count) {
    host->dirset_locate_n(set, count, x, y, z, out);
    return;
  }
  float xyz[3][BTF_RUN_DIRECTIONS];
  for (uint32_t i = 0; i < count; i++) {
    xyz[0][run[i]] = x[i];
    xyz[1][run[i]] = y[i];
    xyz[2][run[i]] = z[i];
  }
  host->dirset_locate_n(set, runs, xyz[0], xyz[1], xyz[2], out);
}

/* ---- the peak of a material ---- */

/** A histogram of positive floats by their upper bits: bins of 2^-10 relative width. */
enum { BTF_PEAK_SHIFT = 13, BTF_PEAK_BINS = 0x7f800000 >> BTF_PEAK_SHIFT };

/** The bin of a positive, finite sample. */
static inline uint32_t btf_peak_bin(float sample) {
  return btf_bits_f32(sample) >> BTF_PEAK_SHIFT;
}

/** The 99.9th percentile of `samples` samples, from below: the lower edge of its bin, 0 if fewer than one in
 * a thousand are positive. */
static inline double btf_peak_of(const uint64_t *histogram, uint64_t samples) {
  uint64_t above = 0;
  for (uint32_t bin = BTF_PEAK_BINS; bin-- > 0;) {
    above += histogram[bin];
    if (above > samples / 1000) {
      const uint32_t bits = bin << BTF_PEAK_SHIFT;
      float edge;
      memcpy(&edge, &bits, sizeof edge);
      return (double)edge;
    }
  }
  return 0.0;
}

/* ---- targets ---- */

/** Warns that a fit misses the error it was asked for, in the words it was asked in: `psnr` is what the
 * target stands for, 0 if it is an rmse. `error` and `target` are sums of squares over `samples` samples. The
 * line begins with the codec, a count and what is counted: "fmf: 2 components reach ...". */
static inline void btf_warn_missed(const btf_host *host, btf_context *ctx, const char *codec, uint32_t count,
                                   const char *counted, double error, double target, double samples,
                                   double psnr) {
  if (psnr > 0.0)
    host->log(ctx, BTF_LOG_WARNING, "%s: %u %s reach a psnr of %.2f dB; %.6g dB was asked for", codec, count,
              counted, psnr + 10.0 * log10(target / error), psnr);
  else
    host->log(ctx, BTF_LOG_WARNING, "%s: %u %s reach an rmse of %.6g; %.6g was asked for", codec, count,
              counted, sqrt(error / samples), sqrt(target / samples));
}

/** Warns that a model is far from the data: `relative` is the root of the squared error over the squared
 * data. The line is "CODEC: a relative error of 0.5: ADVICE". Nothing is said up to `most`. */
static inline void btf_warn_unfit(const btf_host *host, btf_context *ctx, const char *codec, double relative,
                                  double most, const char *advice) {
  if (relative > most)
    host->log(ctx, BTF_LOG_WARNING, "%s: a relative error of %.3g: %s", codec, relative, advice);
}

/* ---- random numbers (splitmix64): the same seed gives the same choices everywhere ---- */

static inline uint64_t btf_random_u64(uint64_t *state) {
  uint64_t z = *state += UINT64_C(0x9e3779b97f4a7c15);
  z = (z ^ z >> 30) * UINT64_C(0xbf58476d1ce4e5b9);
  z = (z ^ z >> 27) * UINT64_C(0x94d049bb133111eb);
  return z ^ z >> 31;
}

/** Uniform in [0, 1). */
static inline double btf_random_unit(uint64_t *state) {
  return (double)(btf_random_u64(state) >> 11) * (1.0 / 9007199254740992.0);
}

#endif
