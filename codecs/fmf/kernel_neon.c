/* SPDX-License-Identifier: MIT */
/* kernel_neon.c: Advanced SIMD of arm64. */
#include "fmf.h"

#if defined(__aarch64__)
#include <arm_neon.h>

#define NAME(x) x##_neon
#define TARGET
#define VECTOR float32x4_t
#define LANES 4
#define REGISTERS 32
#define ZERO vdupq_n_f32(0.0f)
#define SET1(x) vdupq_n_f32(x)
#define ADD(a, b) vaddq_f32((a), (b))
#define MUL(a, b) vmulq_f32((a), (b))
#define FMA(a, b, c) vfmaq_f32((c), (a), (b))
#define LOAD(p) vld1q_f32(p)
#define STORE(p, a) vst1q_f32((p), (a))
#define READ_F16(p) vcvt_f32_f16(vreinterpret_f16_u8(vld1_u8(p)))
#define READ_Q8(p) read_q8(p)
#define READ_BF16(p) vreinterpretq_f32_u32(vshll_n_u16(vreinterpret_u16_u8(vld1_u8(p)), 16))
#define WORDS uint32x4_t
#define LOAD_WORDS(p) vreinterpretq_u32_u8(vld1q_u8(p))
#define LOW_BF16(words) vreinterpretq_f32_u32(vshlq_n_u32((words), 16))
#define HIGH_BF16(words) vreinterpretq_f32_u32(vandq_u32((words), vdupq_n_u32(0xffff0000u)))
#define SUM4(a, b, c, d, out) vst1q_f32((out), vpaddq_f32(vpaddq_f32((a), (b)), vpaddq_f32((c), (d))))

static inline float32x4_t read_q8(const unsigned char *address) {
  const int8x8_t bytes =
      vreinterpret_s8_u32(vld1_lane_u32((const uint32_t *)(const void *)address, vdup_n_u32(0), 0));
  return vcvtq_f32_s32(vmovl_s16(vget_low_s16(vmovl_s8(bytes))));
}

#include "kernel_template.h"
#else
typedef int btfi_fmf_no_neon;
#endif
