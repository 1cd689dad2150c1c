/* SPDX-License-Identifier: MIT */
/* kernel_scalar.c: the reference of all kernels, in plain C with the C library's powers. */
#include "lafortune.h"

#include <math.h>
#include <string.h>

#include <btf/btf_half.h>

#include "kernel.h"

static float base_of(const btfi_lafortune_lobe *lobe, const float *const *term, uint32_t n, float *base) {
  float largest = -INFINITY;
  for (uint32_t i = 0; i < n; i++) {
    float sum = lobe->coefficient[0] * term[0][i];
    for (uint32_t k = 1; k < lobe->terms; k++) sum += lobe->coefficient[k] * term[k][i];
    base[i] = sum;
    if (sum > largest) largest = sum;
  }
  return largest;
}

static void power_columns(const btfi_lafortune_lobe *lobe, const float *const *term, const float *factor,
                          const float *base, uint32_t first, uint32_t n, float *columns) {
  const uint32_t coefficients = btfi_lafortune_free_terms(lobe->kind);
  for (uint32_t i = 0; i < n; i++) {
    const float a = base[first + i];
    const float exponent = a > 0.0f ? lobe->exponent * log2f(a / lobe->peak) : -INFINITY;
    const bool alive = exponent > LAF_SMALLEST_LOG;
    const float value = alive ? factor[first + i] * exp2f(exponent) : 0.0f;
    const float least = lobe->peak * LAF_SMALLEST_BASE;
    const float by_base = alive ? value * lobe->exponent / (a > least ? a : least) : 0.0f;
    columns[i] = value;
    for (uint32_t k = 0; k < coefficients; k++) columns[(k + 1) * LAF_LD + i] = by_base * term[k][first + i];
    columns[(coefficients + 1) * LAF_LD + i] = alive ? value * exponent * LAF_LN2 : 0.0f;
  }
}

static void ward_columns(const btfi_lafortune_lobe *lobe, const float *const *term, const float *factor,
                         const float *base, uint32_t first, uint32_t n, float *columns) {
  for (uint32_t i = 0; i < n; i++) {
    const float exponent = (base[first + i] - lobe->peak) * LAF_LOG2_E;
    const float value = exponent > LAF_SMALLEST_LOG ? factor[first + i] * exp2f(exponent) : 0.0f;
    columns[i] = value;
    for (uint32_t k = 0; k < 2; k++)
      columns[(k + 1) * LAF_LD + i] = value * (lobe->coefficient[k] * term[k][first + i]);
  }
}

static void columns_of(const btfi_lafortune_lobe *lobe, const float *const *term, const float *factor,
                       const float *base, uint32_t first, uint32_t n, float *columns) {
  if (lobe->kind == LAF_WARD)
    ward_columns(lobe, term, factor, base, first, n, columns);
  else
    power_columns(lobe, term, factor, base, first, n, columns);
}

static void dots(const float *a, size_t a_ld, uint32_t a_count, const float *b, size_t b_ld, uint32_t b_count,
                 uint32_t n, bool upper, double *sums, size_t sums_ld) {
  for (uint32_t i = 0; i < a_count; i++)
    for (uint32_t j = upper ? i : 0; j < b_count; j++) {
      double sum = 0.0;
      for (uint32_t s = 0; s < n; s++) sum += (double)a[i * a_ld + s] * (double)b[j * b_ld + s];
      sums[i * sums_ld + j] += sum;
    }
}

/* ---- evaluation ---- */

static float value_at(uint32_t storage, const unsigned char *record, uint32_t i) {
  float value;
  if (storage == LAF_F16) return btf_half_at(record, i);
  memcpy(&value, record + 4 * (size_t)i, sizeof value);
  return value;
}

static float lobe_value(const btfi_lafortune_layout *layout, const btfi_lafortune_terms *terms,
                        const unsigned char *shape) {
  float value[LAF_MAX_SHAPE], base = terms->term[0];
  for (uint32_t i = 0; i < layout->shape; i++) value[i] = value_at(layout->storage, shape, i);
  if (layout->kind == LAF_WARD) {
    const float x = value[0], y = value[1];
    return expf(-(terms->term[0] / (x * x) + terms->term[1] / (y * y))) * (LAF_WARD_NORM / (x * y));
  }
  const uint32_t coefficients = btfi_lafortune_free_terms(layout->kind);
  if (coefficients > 0) {
    base = value[0] * terms->term[0];
    for (uint32_t i = 1; i < coefficients; i++) base += value[i] * terms->term[i];
  }
  const float power = base > 0.0f ? powf(base, value[coefficients]) : 0.0f;
  return layout->kind == LAF_LEWIS ? power * ((value[coefficients] + 2.0f) * LAF_LEWIS_NORM) : power;
}

static void eval_taps(const btfi_lafortune_layout *layout, const btfi_lafortune_taps *taps, float *out) {
  const uint32_t channels = layout->group_channels;
  for (uint32_t g = 0; g < layout->groups; g++, out += channels) {
    const size_t start = (size_t)g * layout->group_values * layout->value_bytes;
    for (uint32_t t = 0; t < 4; t++) {
      const unsigned char *shape = taps->texel[t] + start;
      const unsigned char *albedo = shape + (size_t)layout->lobes * layout->shape * layout->value_bytes;
      if (taps->weight[t] == 0.0f) continue;
      for (uint32_t j = 0; j <= layout->lobes; j++) {
        float factor = taps->weight[t] * taps->terms.diffuse;
        if (j > 0) {
          factor = lobe_value(layout, &taps->terms, shape) * (taps->weight[t] * taps->terms.lobe);
          shape += (size_t)layout->shape * layout->value_bytes;
        }
        for (uint32_t c = 0; c < channels; c++)
          out[c] += factor * value_at(layout->storage, albedo, j * channels + c);
      }
    }
  }
}

static void eval(const btfi_lafortune_state *state, const btfi_lafortune_taps *taps, uint32_t count, bool add,
                 float *out) {
  const btfi_lafortune_layout *layout = &state->layout;
  for (uint32_t i = 0; i < count; i++, out += layout->channels) {
    if (!add) memset(out, 0, layout->channels * sizeof *out);
    eval_taps(layout, &taps[i], out);
  }
}

const btfi_lafortune_kernels btfi_lafortune_scalar = {base_of, columns_of, dots, eval};

const btfi_lafortune_kernels *btfi_lafortune_kernels_of(uint32_t isa) {
#if defined(__x86_64__)
  if (isa == BTF_ISA_AVX2 || isa == BTF_ISA_AVX512) return &btfi_lafortune_avx2;
#endif
  (void)isa;
  return &btfi_lafortune_scalar;
}
