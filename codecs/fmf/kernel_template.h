/* SPDX-License-Identifier: MIT */
/* kernel_template.h: the vector kernels of one instruction set, included once for each. The including file
 * defines NAME(x)         name of a function or table of this instruction set TARGET          function
 * attribute that enables its instructions VECTOR, LANES   a vector of floats, and its length: 4, 8 or 16
 *   ZERO, SET1, ADD, MUL, LOAD, STORE, and FMA(a, b, c) = a * b + c
 *   READ_F16, READ_BF16, READ_Q8   LANES values at a byte address as floats
 *   WORDS, LOAD_WORDS, LOW_BF16, HIGH_BF16   LANES 32-bit words, and their low and high halves as floats
 *   SUM4(a, b, c, d, out)          sums over the lanes of four vectors to out[0 .. 3]
 *
 * Values of a row are taken four vectors at a time, then two, then one. A pair of vectors of bf16 is one
 * vector of words, split into its even and its odd values: two instructions for twice LANES values. */

#define INLINE static inline __attribute__((always_inline)) TARGET

#define READ1_F32(address) LOAD((const float *)(const void *)(address))
#define READ1_F16(address) READ_F16(address)
#define READ1_BF16(address) READ_BF16(address)
#define READ1_Q8(address) READ_Q8(address)
#define READ2_IN_ORDER(read, size, address, a, b)                                                            \
  const VECTOR a = read(address), b = read((address) + LANES * (size))
#define READ2_F32(address, a, b) READ2_IN_ORDER(READ1_F32, 4, address, a, b)
#define READ2_F16(address, a, b) READ2_IN_ORDER(READ1_F16, 2, address, a, b)
#define READ2_Q8(address, a, b) READ2_IN_ORDER(READ1_Q8, 1, address, a, b)
#define READ2_BF16(address, a, b)                                                                            \
  const WORDS words_##a = LOAD_WORDS(address);                                                               \
  const VECTOR a = LOW_BF16(words_##a), b = HIGH_BF16(words_##a)

/* Weights live in registers: `count` is a constant in every copy of a kernel, and the rows beyond it vanish.
 */
#define WEIGHTS(rows)                                                                                        \
  const VECTOR w0 = SET1((rows)->weight[0]), w1 = SET1((rows)->weight[count > 1 ? 1 : 0]),                   \
               w2 = SET1((rows)->weight[count > 2 ? 2 : 0]), w3 = SET1((rows)->weight[count > 3 ? 3 : 0]),   \
               w4 = SET1((rows)->weight[count > 4 ? 4 : 0]), w5 = SET1((rows)->weight[count > 5 ? 5 : 0]),   \
               w6 = SET1((rows)->weight[count > 6 ? 6 : 0]), w7 = SET1((rows)->weight[count > 7 ? 7 : 0]),   \
               w8 = SET1((rows)->weight[count > 8 ? 8 : 0])
#define EACH_ROW(step, storage)                                                                              \
  step(storage, 1) step(storage, 2) step(storage, 3) step(storage, 4) step(storage, 5) step(storage, 6)      \
      step(storage, 7) step(storage, 8)
#define ROW4(storage, r)                                                                                     \
  if (count > r) {                                                                                           \
    READ2_##storage(rows->row[r] + at, x0, x1);                                                              \
    READ2_##storage(rows->row[r] + at + pair, x2, x3);                                                       \
    s0 = FMA(w##r, x0, s0);                                                                                  \
    s1 = FMA(w##r, x1, s1);                                                                                  \
    s2 = FMA(w##r, x2, s2);                                                                                  \
    s3 = FMA(w##r, x3, s3);                                                                                  \
  }
#define ROW2(storage, r)                                                                                     \
  if (count > r) {                                                                                           \
    READ2_##storage(rows->row[r] + at, x0, x1);                                                              \
    s0 = FMA(w##r, x0, s0);                                                                                  \
    s1 = FMA(w##r, x1, s1);                                                                                  \
  }
#define ROW1(storage, r)                                                                                     \
  if (count > r) s0 = FMA(w##r, READ1_##storage(rows->row[r] + at), s0);

/* s0 .. s3 = the blend of the values from byte `at` on. */
#define BLEND4(storage)                                                                                      \
  READ2_##storage(rows->row[0] + at, f0, f1);                                                                \
  READ2_##storage(rows->row[0] + at + pair, f2, f3);                                                         \
  VECTOR s0 = MUL(w0, f0), s1 = MUL(w0, f1), s2 = MUL(w0, f2), s3 = MUL(w0, f3);                             \
  EACH_ROW(ROW4, storage)
#define BLEND2(storage)                                                                                      \
  READ2_##storage(rows->row[0] + at, f0, f1);                                                                \
  VECTOR s0 = MUL(w0, f0), s1 = MUL(w0, f1);                                                                 \
  EACH_ROW(ROW2, storage)
#define BLEND1(storage)                                                                                      \
  VECTOR s0 = MUL(w0, READ1_##storage(rows->row[0] + at));                                                   \
  EACH_ROW(ROW1, storage)

#define DEFINE_BLEND(storage, size)                                                                          \
  INLINE void NAME(blend_of_##storage)(const btfi_fmf_rows *rows, const uint32_t count, uint32_t padded,     \
                                       const float *scale, float *dst) {                                     \
    enum { pair = 2 * LANES * (size) };                                                                      \
    WEIGHTS(rows);                                                                                           \
    uint64_t at = 0;                                                                                         \
    uint32_t i = 0;                                                                                          \
    for (; i + 4 * LANES <= padded; i += 4 * LANES, at += 2 * pair) {                                        \
      BLEND4(storage)                                                                                        \
      STORE(dst + i, MUL(s0, LOAD(scale + i)));                                                              \
      STORE(dst + i + LANES, MUL(s1, LOAD(scale + i + LANES)));                                              \
      STORE(dst + i + 2 * LANES, MUL(s2, LOAD(scale + i + 2 * LANES)));                                      \
      STORE(dst + i + 3 * LANES, MUL(s3, LOAD(scale + i + 3 * LANES)));                                      \
    }                                                                                                        \
    if (i + 2 * LANES <= padded) {                                                                           \
      BLEND2(storage)                                                                                        \
      STORE(dst + i, MUL(s0, LOAD(scale + i)));                                                              \
      STORE(dst + i + LANES, MUL(s1, LOAD(scale + i + LANES)));                                              \
      i += 2 * LANES;                                                                                        \
      at += pair;                                                                                            \
    }                                                                                                        \
    if (i < padded) {                                                                                        \
      BLEND1(storage)                                                                                        \
      STORE(dst + i, MUL(s0, LOAD(scale + i)));                                                              \
    }                                                                                                        \
  }

/* Sums over the lanes are made for four channels together, in one way whatever their number. */
#define DEFINE_PROJECT(storage, size)                                                                        \
  INLINE void NAME(project_of_##storage)(const btfi_fmf_rows *rows, const uint32_t count,                    \
                                         uint64_t channel_bytes, uint32_t channels, const float *v,          \
                                         uint32_t padded, float *keep, float *out) {                         \
    enum { pair = 2 * LANES * (size) };                                                                      \
    uint64_t start = 0;                                                                                      \
    WEIGHTS(rows);                                                                                           \
    for (uint32_t first = 0; first < channels; first += 4) {                                                 \
      const uint32_t many = channels - first < 4 ? channels - first : 4;                                     \
      VECTOR sum[4] = {ZERO, ZERO, ZERO, ZERO};                                                              \
      float totals[4];                                                                                       \
      for (uint32_t c = 0; c < many; c++, start += channel_bytes) {                                          \
        VECTOR d0 = ZERO, d1 = ZERO, d2 = ZERO, d3 = ZERO;                                                   \
        uint64_t at = start;                                                                                 \
        uint32_t i = 0;                                                                                      \
        for (; i + 4 * LANES <= padded; i += 4 * LANES, at += 2 * pair) {                                    \
          BLEND4(storage)                                                                                    \
          if (keep != NULL) {                                                                                \
            STORE(keep + i, s0);                                                                             \
            STORE(keep + i + LANES, s1);                                                                     \
            STORE(keep + i + 2 * LANES, s2);                                                                 \
            STORE(keep + i + 3 * LANES, s3);                                                                 \
          }                                                                                                  \
          d0 = FMA(s0, LOAD(v + i), d0);                                                                     \
          d1 = FMA(s1, LOAD(v + i + LANES), d1);                                                             \
          d2 = FMA(s2, LOAD(v + i + 2 * LANES), d2);                                                         \
          d3 = FMA(s3, LOAD(v + i + 3 * LANES), d3);                                                         \
        }                                                                                                    \
        if (i + 2 * LANES <= padded) {                                                                       \
          BLEND2(storage)                                                                                    \
          if (keep != NULL) {                                                                                \
            STORE(keep + i, s0);                                                                             \
            STORE(keep + i + LANES, s1);                                                                     \
          }                                                                                                  \
          d0 = FMA(s0, LOAD(v + i), d0);                                                                     \
          d1 = FMA(s1, LOAD(v + i + LANES), d1);                                                             \
          i += 2 * LANES;                                                                                    \
          at += pair;                                                                                        \
        }                                                                                                    \
        if (i < padded) {                                                                                    \
          BLEND1(storage)                                                                                    \
          if (keep != NULL) STORE(keep + i, s0);                                                             \
          d2 = FMA(s0, LOAD(v + i), d2);                                                                     \
        }                                                                                                    \
        if (keep != NULL) keep += padded;                                                                    \
        sum[c] = ADD(ADD(d0, d1), ADD(d2, d3));                                                              \
      }                                                                                                      \
      SUM4(sum[0], sum[1], sum[2], sum[3], totals);                                                          \
      for (uint32_t c = 0; c < many; c++) out[first + c] = totals[c];                                        \
    }                                                                                                        \
  }

/* Turns the number of rows into a constant. */
#define EACH_COUNT(step, storage)                                                                            \
  step(storage, 1) step(storage, 2) step(storage, 3) step(storage, 4) step(storage, 5) step(storage, 6)      \
      step(storage, 7) step(storage, 8) step(storage, 9)
#define BLEND_CASE(storage, n)                                                                               \
  case n:                                                                                                    \
    NAME(blend_of_##storage)(rows, n, padded, scale, dst);                                                   \
    break;
#define PROJECT_CASE(storage, n)                                                                             \
  case n:                                                                                                    \
    NAME(project_of_##storage)(rows, n, channel_bytes, channels, v, padded, keep, out);                      \
    break;
#define DEFINE_KERNELS(storage, size)                                                                        \
  DEFINE_BLEND(storage, size)                                                                                \
  DEFINE_PROJECT(storage, size)                                                                              \
  TARGET static void NAME(blend_##storage)(const btfi_fmf_rows *rows, uint32_t padded, const float *scale,   \
                                           float *dst) {                                                     \
    switch (rows->count) {                                                                                   \
      EACH_COUNT(BLEND_CASE, storage)                                                                        \
    default:                                                                                                 \
      break;                                                                                                 \
    }                                                                                                        \
  }                                                                                                          \
  TARGET static void NAME(project_##storage)(const btfi_fmf_rows *rows, uint64_t channel_bytes,              \
                                             uint32_t channels, const float *v, uint32_t padded,             \
                                             float *keep, float *out) {                                      \
    switch (rows->count) {                                                                                   \
      EACH_COUNT(PROJECT_CASE, storage)                                                                      \
    default:                                                                                                 \
      break;                                                                                                 \
    }                                                                                                        \
  }

DEFINE_KERNELS(F32, 4)
DEFINE_KERNELS(F16, 2)
DEFINE_KERNELS(BF16, 2)
DEFINE_KERNELS(Q8, 1)

/* Adds in the order of the projection, so that both give the same bits. */
TARGET static void NAME(dot)(const float *kept, uint32_t channels, const float *v, uint32_t padded,
                             float *out) {
  for (uint32_t first = 0; first < channels; first += 4) {
    const uint32_t many = channels - first < 4 ? channels - first : 4;
    VECTOR sum[4] = {ZERO, ZERO, ZERO, ZERO};
    float totals[4];
    for (uint32_t c = 0; c < many; c++, kept += padded) {
      VECTOR d0 = ZERO, d1 = ZERO, d2 = ZERO, d3 = ZERO;
      uint32_t i = 0;
      for (; i + 4 * LANES <= padded; i += 4 * LANES) {
        d0 = FMA(LOAD(kept + i), LOAD(v + i), d0);
        d1 = FMA(LOAD(kept + i + LANES), LOAD(v + i + LANES), d1);
        d2 = FMA(LOAD(kept + i + 2 * LANES), LOAD(v + i + 2 * LANES), d2);
        d3 = FMA(LOAD(kept + i + 3 * LANES), LOAD(v + i + 3 * LANES), d3);
      }
      if (i + 2 * LANES <= padded) {
        d0 = FMA(LOAD(kept + i), LOAD(v + i), d0);
        d1 = FMA(LOAD(kept + i + LANES), LOAD(v + i + LANES), d1);
        i += 2 * LANES;
      }
      if (i < padded) d2 = FMA(LOAD(kept + i), LOAD(v + i), d2);
      sum[c] = ADD(ADD(d0, d1), ADD(d2, d3));
    }
    SUM4(sum[0], sum[1], sum[2], sum[3], totals);
    for (uint32_t c = 0; c < many; c++) out[first + c] = totals[c];
  }
}

static void NAME(permute)(uint32_t storage, uint32_t padded, const float *natural, float *out) {
  uint32_t i = 0;
  if (storage == FMF_BF16) {
    for (; i + 2 * LANES <= padded; i += 2 * LANES) {
      for (uint32_t lane = 0; lane < LANES; lane++) {
        out[i + lane] = natural[i + 2 * lane];
        out[i + LANES + lane] = natural[i + 2 * lane + 1];
      }
    }
  }
  for (; i < padded; i++) out[i] = natural[i];
}

const btfi_fmf_kernels NAME(btfi_fmf) = {
    {NAME(blend_F32), NAME(blend_F16), NAME(blend_BF16), NAME(blend_Q8)},
    {NAME(project_F32), NAME(project_F16), NAME(project_BF16), NAME(project_Q8)},
    NAME(dot),
    NAME(permute)};
