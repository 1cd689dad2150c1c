/* SPDX-License-Identifier: MIT */
/* kernel_template.h: the vector kernels of one instruction set, included once for each. The including file
 * defines
 * - NAME(x): name of a function or table of this instruction set;
 * - TARGET: function attribute that enables its instructions;
 * - VECTOR, LANES, REGISTERS: a vector of floats, its length (4, 8 or 16), how many there are;
 * - ZERO, SET1, ADD, MUL, LOAD, STORE, and FMA(a, b, c) = a * b + c;
 * - READ_F16, READ_BF16, READ_Q8: LANES values at a byte address as floats;
 * - WORDS, LOAD_WORDS, LOW_BF16, HIGH_BF16: LANES 32-bit words, their low and high halves as floats;
 * - SUM4(a, b, c, d, out): sums over the lanes of four vectors to out[0 .. 3].
 *
 * Values of a row are taken two vectors at a time, then one. A pair of vectors of bf16 is one vector of
 * words, split into its even and its odd values: two instructions for twice LANES values. */

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

/* The dot product of one channel, its sum over the lanes still to be made. */
#define DEFINE_CHANNEL(storage, size)                                                                        \
  INLINE VECTOR NAME(channel_of_##storage)(const btfi_fmf_rows *rows, const uint32_t count, uint64_t at,     \
                                           const float *v, uint32_t padded, float *restrict keep) {          \
    enum { pair = 2 * LANES * (size) };                                                                      \
    WEIGHTS(rows);                                                                                           \
    VECTOR d0 = ZERO, d1 = ZERO;                                                                             \
    uint32_t i = 0;                                                                                          \
    for (; i + 2 * LANES <= padded; i += 2 * LANES, at += pair) {                                            \
      BLEND2(storage)                                                                                        \
      if (keep != NULL) {                                                                                    \
        STORE(keep + i, s0);                                                                                 \
        STORE(keep + i + LANES, s1);                                                                         \
      }                                                                                                      \
      d0 = FMA(s0, LOAD(v + i), d0);                                                                         \
      d1 = FMA(s1, LOAD(v + i + LANES), d1);                                                                 \
    }                                                                                                        \
    if (i < padded) {                                                                                        \
      BLEND1(storage)                                                                                        \
      if (keep != NULL) STORE(keep + i, s0);                                                                 \
      d0 = FMA(s0, LOAD(v + i), d0);                                                                         \
    }                                                                                                        \
    return ADD(d0, d1);                                                                                      \
  }

/* Three channels side by side, each as above: independent chains of additions, and rows are addressed once.
 */
#define ROW2_OF_3(storage, r)                                                                                \
  if (count > r) {                                                                                           \
    const unsigned char *row = rows->row[r] + at;                                                            \
    READ2_##storage(row, x0, x1);                                                                            \
    READ2_##storage(row + channel_bytes, y0, y1);                                                            \
    READ2_##storage(row + 2 * channel_bytes, z0, z1);                                                        \
    s0 = FMA(w##r, x0, s0);                                                                                  \
    s1 = FMA(w##r, x1, s1);                                                                                  \
    t0 = FMA(w##r, y0, t0);                                                                                  \
    t1 = FMA(w##r, y1, t1);                                                                                  \
    u0 = FMA(w##r, z0, u0);                                                                                  \
    u1 = FMA(w##r, z1, u1);                                                                                  \
  }
#define ROW1_OF_3(storage, r)                                                                                \
  if (count > r) {                                                                                           \
    const unsigned char *row = rows->row[r] + at;                                                            \
    s0 = FMA(w##r, READ1_##storage(row), s0);                                                                \
    t0 = FMA(w##r, READ1_##storage(row + channel_bytes), t0);                                                \
    u0 = FMA(w##r, READ1_##storage(row + 2 * channel_bytes), u0);                                            \
  }
#define DEFINE_THREE(storage, size)                                                                          \
  INLINE void NAME(three_of_##storage)(const btfi_fmf_rows *rows, const uint32_t count, uint64_t at,         \
                                       uint64_t channel_bytes, const float *v, uint32_t padded,              \
                                       float *restrict keep, VECTOR *sum) {                                  \
    enum { pair = 2 * LANES * (size) };                                                                      \
    WEIGHTS(rows);                                                                                           \
    VECTOR d0 = ZERO, d1 = ZERO, e0 = ZERO, e1 = ZERO, f0 = ZERO, f1 = ZERO;                                 \
    uint32_t i = 0;                                                                                          \
    for (; i + 2 * LANES <= padded; i += 2 * LANES, at += pair) {                                            \
      const unsigned char *first = rows->row[0] + at;                                                        \
      READ2_##storage(first, a0, a1);                                                                        \
      READ2_##storage(first + channel_bytes, b0, b1);                                                        \
      READ2_##storage(first + 2 * channel_bytes, c0, c1);                                                    \
      VECTOR s0 = MUL(w0, a0), s1 = MUL(w0, a1), t0 = MUL(w0, b0), t1 = MUL(w0, b1), u0 = MUL(w0, c0),       \
             u1 = MUL(w0, c1);                                                                               \
      EACH_ROW(ROW2_OF_3, storage)                                                                           \
      if (keep != NULL) {                                                                                    \
        STORE(keep + i, s0);                                                                                 \
        STORE(keep + i + LANES, s1);                                                                         \
        STORE(keep + padded + i, t0);                                                                        \
        STORE(keep + padded + i + LANES, t1);                                                                \
        STORE(keep + 2 * padded + i, u0);                                                                    \
        STORE(keep + 2 * padded + i + LANES, u1);                                                            \
      }                                                                                                      \
      const VECTOR v0 = LOAD(v + i), v1 = LOAD(v + i + LANES);                                               \
      d0 = FMA(s0, v0, d0);                                                                                  \
      d1 = FMA(s1, v1, d1);                                                                                  \
      e0 = FMA(t0, v0, e0);                                                                                  \
      e1 = FMA(t1, v1, e1);                                                                                  \
      f0 = FMA(u0, v0, f0);                                                                                  \
      f1 = FMA(u1, v1, f1);                                                                                  \
    }                                                                                                        \
    if (i < padded) {                                                                                        \
      const unsigned char *first = rows->row[0] + at;                                                        \
      VECTOR s0 = MUL(w0, READ1_##storage(first)), t0 = MUL(w0, READ1_##storage(first + channel_bytes)),     \
             u0 = MUL(w0, READ1_##storage(first + 2 * channel_bytes));                                       \
      EACH_ROW(ROW1_OF_3, storage)                                                                           \
      if (keep != NULL) {                                                                                    \
        STORE(keep + i, s0);                                                                                 \
        STORE(keep + padded + i, t0);                                                                        \
        STORE(keep + 2 * padded + i, u0);                                                                    \
      }                                                                                                      \
      const VECTOR v0 = LOAD(v + i);                                                                         \
      d0 = FMA(s0, v0, d0);                                                                                  \
      e0 = FMA(t0, v0, e0);                                                                                  \
      f0 = FMA(u0, v0, f0);                                                                                  \
    }                                                                                                        \
    sum[0] = ADD(d0, d1);                                                                                    \
    sum[1] = ADD(e0, e1);                                                                                    \
    sum[2] = ADD(f0, f1);                                                                                    \
  }

/* Sums over the lanes are made for four channels together, in one way whatever their number. */
#define DEFINE_PROJECT(storage, size)                                                                        \
  DEFINE_CHANNEL(storage, size)                                                                              \
  DEFINE_THREE(storage, size)                                                                                \
  INLINE void NAME(project_of_##storage)(const btfi_fmf_rows *rows, const uint32_t count,                    \
                                         uint64_t channel_bytes, uint32_t channels, const float *v,          \
                                         uint32_t padded, float *keep, float *out) {                         \
    uint64_t at = 0;                                                                                         \
    for (uint32_t first = 0; first < channels; first += 4) {                                                 \
      const uint32_t many = channels - first < 4 ? channels - first : 4;                                     \
      VECTOR sum[4] = {ZERO, ZERO, ZERO, ZERO};                                                              \
      float totals[4];                                                                                       \
      if (REGISTERS >= 32 && many == 3) {                                                                    \
        NAME(three_of_##storage)(rows, count, at, channel_bytes, v, padded, keep, sum);                      \
      } else {                                                                                               \
        for (uint32_t c = 0; c < many; c++, at += channel_bytes) {                                           \
          sum[c] = NAME(channel_of_##storage)(rows, count, at, v, padded, keep);                             \
          if (keep != NULL) keep += padded;                                                                  \
        }                                                                                                    \
      }                                                                                                      \
      SUM4(sum[0], sum[1], sum[2], sum[3], totals);                                                          \
      for (uint32_t c = 0; c < many; c++) out[first + c] = totals[c];                                        \
    }                                                                                                        \
  }

/* One row of each: what blend and project make of rows of weight 1, without the way through memory. */
#define DEFINE_SAMPLE(storage, size)                                                                         \
  INLINE void NAME(sample_of_##storage)(const unsigned char *u, uint64_t channel_bytes, const uint32_t many, \
                                        const unsigned char *v, uint32_t padded, const float *scale,         \
                                        float *totals) {                                                     \
    enum { pair = 2 * LANES * (size) };                                                                      \
    VECTOR even[4] = {ZERO, ZERO, ZERO, ZERO}, odd[4] = {ZERO, ZERO, ZERO, ZERO};                            \
    uint32_t i = 0;                                                                                          \
    for (; i + 2 * LANES <= padded; i += 2 * LANES, u += pair, v += pair) {                                  \
      READ2_##storage(v, x0, x1);                                                                            \
      const VECTOR v0 = MUL(x0, LOAD(scale + i)), v1 = MUL(x1, LOAD(scale + i + LANES));                     \
      for (uint32_t c = 0; c < many; c++) {                                                                  \
        READ2_##storage(u + c * channel_bytes, y0, y1);                                                      \
        even[c] = FMA(y0, v0, even[c]);                                                                      \
        odd[c] = FMA(y1, v1, odd[c]);                                                                        \
      }                                                                                                      \
    }                                                                                                        \
    if (i < padded) {                                                                                        \
      const VECTOR v0 = MUL(READ1_##storage(v), LOAD(scale + i));                                            \
      for (uint32_t c = 0; c < many; c++)                                                                    \
        even[c] = FMA(READ1_##storage(u + c * channel_bytes), v0, even[c]);                                  \
    }                                                                                                        \
    SUM4(ADD(even[0], odd[0]), ADD(even[1], odd[1]), ADD(even[2], odd[2]), ADD(even[3], odd[3]), totals);    \
  }                                                                                                          \
  TARGET static void NAME(sample_##storage)(const unsigned char *u, uint64_t channel_bytes,                  \
                                            uint32_t channels, const unsigned char *v, uint32_t padded,      \
                                            const float *scale, float *out) {                                \
    float totals[4];                                                                                         \
    for (; channels > 4; channels -= 4, u += 4 * channel_bytes, out += 4)                                    \
      NAME(sample_of_##storage)(u, channel_bytes, 4, v, padded, scale, out);                                 \
    if (channels == 3) {                                                                                     \
      NAME(sample_of_##storage)(u, channel_bytes, 3, v, padded, scale, totals);                              \
    } else {                                                                                                 \
      for (uint32_t c = 0; c < channels; c++, u += channel_bytes) {                                          \
        float alone[4];                                                                                      \
        NAME(sample_of_##storage)(u, channel_bytes, 1, v, padded, scale, alone);                             \
        totals[c] = alone[0];                                                                                \
      }                                                                                                      \
    }                                                                                                        \
    for (uint32_t c = 0; c < channels; c++) out[c] = totals[c];                                              \
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
  DEFINE_SAMPLE(storage, size)                                                                               \
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
      VECTOR d0 = ZERO, d1 = ZERO;
      uint32_t i = 0;
      for (; i + 2 * LANES <= padded; i += 2 * LANES) {
        d0 = FMA(LOAD(kept + i), LOAD(v + i), d0);
        d1 = FMA(LOAD(kept + i + LANES), LOAD(v + i + LANES), d1);
      }
      if (i < padded) d0 = FMA(LOAD(kept + i), LOAD(v + i), d0);
      sum[c] = ADD(d0, d1);
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
    {NAME(sample_F32), NAME(sample_F16), NAME(sample_BF16), NAME(sample_Q8)},
    NAME(dot),
    NAME(permute)};
