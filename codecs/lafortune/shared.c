/* SPDX-License-Identifier: MIT */
/* shared.c: what the fits of all texels share: terms, weights, and lobes to start from with their products.
 */
#include "lafortune.h"

#include <math.h>
#include <string.h>

#include "kernel.h"

/* ---- lobes to start from ---- */

/* Diagonals and exponents: mirrors from broad to sharp, more and less steep than the mirror direction, back
 * towards the light, darkening with both elevations, forward at grazing angles, and stretched along either
 * axis. */
static const float diagonal_start[LAF_CANDIDATES][4] = {
    {-1, -1, 1, 1},    {-1, -1, 1, 3},     {-1, -1, 1, 8},     {-1, -1, 1, 20},      {-1, -1, 1, 60},
    {-1, -1, 1, 200},  {-1, -1, 0.6f, 3},  {-1, -1, 0.6f, 15}, {-0.6f, -0.6f, 1, 5}, {-0.6f, -0.6f, 1, 25},
    {1, 1, 1, 2},      {1, 1, 1, 8},       {1, 1, 1, 40},      {0, 0, 1, 0.7f},      {0, 0, 1, 2},
    {0, 0, 1, 5},      {-1, -1, 0.1f, 2},  {-1, -1, 0.1f, 8},  {-1, -0.4f, 1, 6},    {-1, -0.4f, 1, 30},
    {-0.4f, -1, 1, 6}, {-0.4f, -1, 1, 30}, {-1, 1, 1, 6},      {1, -1, 1, 6}};

static void make_candidate(uint32_t kind, uint32_t i, float shape[LAF_MAX_SHAPE]) {
  static const float roughness[5] = {0.06f, 0.12f, 0.25f, 0.5f, 1.0f};
  memset(shape, 0, LAF_MAX_SHAPE * sizeof *shape);
  switch (kind) {
  case LAF_DIAGONAL:
    memcpy(shape, diagonal_start[i], 4 * sizeof *shape);
    break;
  case LAF_FULL:
    for (int k = 0; k < 3; k++) shape[4 * k] = diagonal_start[i][k];
    shape[9] = diagonal_start[i][3];
    break;
  case LAF_WARD:
    shape[0] = roughness[i % 5];
    shape[1] = roughness[i / 5];
    break;
  default:
    shape[0] = 0.7f * powf(1000.0f, (float)i / (LAF_CANDIDATES - 1));
    break;
  }
}

void btfi_lafortune_lobe_of(uint32_t kind, const float *shape, btfi_lafortune_lobe *out) {
  const uint32_t free_terms = btfi_lafortune_free_terms(kind);
  memset(out, 0, sizeof *out);
  out->kind = kind;
  out->terms = btfi_lafortune_term_count(kind);
  out->peak = 1.0f;
  if (kind == LAF_WARD) {
    for (uint32_t i = 0; i < 2; i++) out->coefficient[i] = -1.0f / (shape[i] * shape[i]);
    return;
  }
  out->coefficient[0] = 1.0f; /* of the kinds whose base has one term */
  for (uint32_t i = 0; i < free_terms; i++) out->coefficient[i] = shape[i];
  out->exponent = shape[free_terms];
}

/* v of the upper hemisphere that makes v . w largest, and that product. */
static double towards(const double w[3], double v[3]) {
  const double z = w[2] > 0.0 ? w[2] : 0.0, length = sqrt(w[0] * w[0] + w[1] * w[1] + z * z);
  if (!(length > 0.0)) return w[2]; /* straight down: the horizon would do, with 0 */
  v[0] = w[0] / length;
  v[1] = w[1] / length;
  v[2] = z / length;
  return length;
}

/* The largest base over all directions of the hemispheres, measured or not. For full matrices the best view
 * for a light and the best light for that view take turns. */
static double largest_base(const btfi_lafortune_lobe *lobe) {
  const float *c = lobe->coefficient;
  if (lobe->terms == 3) return fmax(fmax(fabs((double)c[0]), fabs((double)c[1])), (double)c[2]);
  static const double start[5][3] = {{0, 0, 1}, {1, 0, 0}, {0, 1, 0}, {0.6, 0.6, 0.529}, {-0.6, 0.6, 0.529}};
  double largest = 0.0;
  for (int s = 0; s < 5; s++) {
    double light[3] = {start[s][0], start[s][1], start[s][2]}, view[3] = {0, 0, 1}, w[3], base = 0.0;
    for (int turn = 0; turn < 6; turn++) {
      for (int i = 0; i < 3; i++)
        w[i] =
            (double)c[3 * i] * light[0] + (double)c[3 * i + 1] * light[1] + (double)c[3 * i + 2] * light[2];
      (void)towards(w, view);
      for (int i = 0; i < 3; i++)
        w[i] = (double)c[i] * view[0] + (double)c[3 + i] * view[1] + (double)c[6 + i] * view[2];
      base = towards(w, light);
    }
    largest = fmax(largest, base);
  }
  return largest;
}

bool btfi_lafortune_make_base(const btfi_lafortune_shared *shared, btfi_lafortune_lobe *lobe, float *base) {
  const float largest = shared->kernels->base(lobe, shared->term, shared->padded, base);
  if (lobe->kind == LAF_WARD) {
    lobe->peak = largest;
    return largest > -LAF_MOST_GROWTH;
  }
  lobe->peak = largest > 1e-30f ? largest : 1.0f; /* without light anywhere the columns are 0 */
  const double anywhere = btfi_lafortune_free_terms(lobe->kind) > 0 ? largest_base(lobe) : 1.0;
  return largest > 1e-30f &&
         (double)lobe->exponent * log(anywhere / (double)largest) < (double)LAF_MOST_GROWTH;
}

/* Their columns; a lobe that must not be is 0. */
static void make_columns(btfi_lafortune_shared *shared, float *column, float *base, float *room) {
  const size_t ld = shared->padded;
  memcpy(column, shared->diffuse, ld * sizeof *column);
  for (uint32_t i = 0; i < shared->candidates; i++) {
    float *to = column + (1 + i) * ld;
    btfi_lafortune_lobe lobe;
    btfi_lafortune_lobe_of(shared->kind, shared->candidate[i], &lobe);
    memset(to, 0, ld * sizeof *to);
    if (!btfi_lafortune_make_base(shared, &lobe, base)) continue;
    for (uint32_t first = 0; first < shared->padded; first += LAF_CHUNK) {
      const uint32_t n = shared->padded - first < LAF_CHUNK ? shared->padded - first : LAF_CHUNK;
      shared->kernels->columns(&lobe, shared->term, shared->lobe, base, first, n, room);
      memcpy(to + first, room, n * sizeof *to);
    }
  }
}

void btfi_lafortune_add_dots(const btfi_lafortune_shared *shared, const float *a, uint32_t a_count,
                             const float *b, uint32_t b_count, bool upper, double *sums, size_t sums_ld) {
  for (uint32_t first = 0; first < shared->padded; first += LAF_CHUNK) {
    const uint32_t n = shared->padded - first < LAF_CHUNK ? shared->padded - first : LAF_CHUNK;
    shared->kernels->dots(a + first, shared->padded, a_count, b + first, shared->padded, b_count, n, upper,
                          sums, sums_ld);
  }
}

/* ---- samples ---- */

static uint32_t padded_of(uint32_t samples) {
  return (samples + 7u) & ~7u;
}

enum { ARRAYS_BESIDE_TERMS = 3 + 1 + LAF_CANDIDATES + 1 /* factors, weight, columns, a base */ };

uint64_t btfi_lafortune_shared_bytes(uint32_t kind, uint32_t samples) {
  return ((uint64_t)btfi_lafortune_term_count(kind) + ARRAYS_BESIDE_TERMS) * padded_of(samples) *
             sizeof(float) +
         (1 + LAF_MAX_SHAPE) * LAF_LD * sizeof(float);
}

btf_status btfi_lafortune_shared_create(const btf_host *host, btf_context *ctx, uint32_t kind,
                                        uint32_t quantity, uint32_t weights, const float *lights,
                                        uint32_t light_count, const float *views, uint32_t view_count,
                                        btfi_lafortune_shared *out) {
  memset(out, 0, sizeof *out);
  out->kind = kind;
  out->terms = btfi_lafortune_term_count(kind);
  out->samples = light_count * view_count;
  out->padded = padded_of(out->samples);
  out->relative = weights == LAF_LOG;
  out->candidates = LAF_CANDIDATES;
  out->kernels = btfi_lafortune_kernels_of(host->isa(ctx));
  out->memory = host->alloc(ctx, btfi_lafortune_shared_bytes(kind, out->samples), 1);
  if (out->memory == NULL) return BTF_E_NOMEM;
  const size_t ld = out->padded;
  float *term[LAF_MAX_TERMS], *next = out->memory;
  for (uint32_t k = 0; k < out->terms; k++, next += ld) out->term[k] = term[k] = next;
  float *const lobe = next, *const diffuse = lobe + ld, *const weight = diffuse + ld,
               *const base = weight + ld, *const column = base + ld,
               *const room = column + (1 + LAF_CANDIDATES) * ld;
  out->lobe = lobe;
  out->diffuse = diffuse;
  out->weight = weight;
  out->column = column;
  const bool times_cosine = quantity == BTF_QUANTITY_BRDF_COS;
  for (uint32_t i = 0; i < out->padded; i++) {
    /* Beyond the samples the last one again, so that it is no stranger to the largest base, of weight 0. */
    const uint32_t sample = i < out->samples ? i : out->samples - 1;
    const float *light = lights + 3 * (size_t)(sample % light_count),
                *view = views + 3 * (size_t)(sample / light_count);
    btfi_lafortune_terms terms;
    btfi_lafortune_terms_of(kind, times_cosine, light, view, &terms);
    const float root = i >= out->samples ? 0.0f : weights == LAF_COSINE && !times_cosine ? light[2] : 1.0f;
    for (uint32_t k = 0; k < out->terms; k++) term[k][i] = terms.term[k];
    lobe[i] = terms.lobe * root;
    diffuse[i] = terms.diffuse * root;
    weight[i] = root;
  }
  for (uint32_t i = 0; i < LAF_CANDIDATES; i++) make_candidate(kind, i, out->candidate[i]);
  make_columns(out, column, base, room);
  if (!out->relative)
    btfi_lafortune_add_dots(out, column, 1 + out->candidates, column, 1 + out->candidates, true, out->gram,
                            1 + LAF_CANDIDATES);
  return BTF_OK;
}

void btfi_lafortune_shared_free(const btf_host *host, btf_context *ctx, btfi_lafortune_shared *shared) {
  host->free(ctx, shared->memory);
  shared->memory = NULL;
}
