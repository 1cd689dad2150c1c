/* SPDX-License-Identifier: MIT */
/* view.c: principal components of the matrix of one view, read in blocks of texels. */
#include "pvpca.h"

#include <math.h>
#include <string.h>

#include <btf/btf_codec.h>

enum { GRAM_RUN = 512, LANES = 8 };

btf_status btfi_pvpca_progress(const btfi_pvpca_fit_job *f, double of_view) {
  return f->host->progress(f->job, f->done + f->step * of_view, "views");
}

/* ---- reading ---- */

/* Texels texel0 .. of a view as columns of X. A run of texels is a box only within a line or over whole
 * lines. */
static btf_status read_texels(const btfi_pvpca_fit_job *f, uint32_t view, uint64_t texel0, uint64_t texels) {
  const ptrdiff_t value = sizeof(float), rows = value * (ptrdiff_t)f->rows;
  const uint32_t width = f->layout.width, lights = f->layout.lights;
  const bool by_light = f->layout.color == PVPCA_COLOR_LIGHTS;
  btf_strides strides;
  float *dst = f->block;
  strides.x = rows * (ptrdiff_t)f->texel_columns;
  strides.y = strides.x * (ptrdiff_t)width;
  strides.light = by_light ? value * (ptrdiff_t)f->layout.channels : value;
  strides.channel = by_light ? value : rows;
  strides.view = 0;
  while (texels > 0) {
    const uint32_t y = (uint32_t)(texel0 / width), x = (uint32_t)(texel0 % width);
    btf_block block = {view, 1, 0, lights, x, y, width - x, 1};
    if (x == 0 && texels >= width)
      block.height = (uint32_t)(texels / width);
    else if (texels < block.width)
      block.width = (uint32_t)texels;
    const uint64_t done = (uint64_t)block.width * block.height;
    BTF_TRY(f->host->dataset_read(f->ds, &block, dst, &strides));
    dst += done * f->texel_columns * f->rows;
    texel0 += done;
    texels -= done;
  }
  return BTF_OK;
}

typedef struct centring {
  const btfi_pvpca_fit_job *f;
  uint64_t first, columns; /* of the view, in the block */
  double energy[PVPCA_PARTS], centred[PVPCA_PARTS];
} centring;

/* Takes one of PVPCA_PARTS ranges of columns, so that sums do not depend on which thread makes them. */
static void centre_part(void *job, uint32_t part, uint32_t thread) {
  centring *c = job;
  const btfi_pvpca_fit_job *f = c->f;
  const uint64_t m = f->rows, whole = m / LANES * LANES;
  const uint64_t first = c->columns * part / PVPCA_PARTS, last = c->columns * (part + 1) / PVPCA_PARTS;
  uint32_t *counts = f->counts != NULL ? f->counts + (size_t)thread * BTF_PEAK_BINS : NULL;
  double energy = 0.0, all_centred = 0.0;
  for (uint64_t column = first; column < last; column++) {
    float *x = f->block + column * m, mean = 0.0f;
    double sum[LANES] = {0.0}, square[LANES] = {0.0}, centred = 0.0;
    for (uint64_t i = 0; counts != NULL && i < m; i++) {
      if (x[i] > 0.0f) counts[btf_peak_bin(x[i])]++;
    }
    if (f->layout.has_mean) {
      double total = 0.0;
      for (uint64_t i = 0; i < whole; i += LANES)
        for (uint32_t k = 0; k < LANES; k++) sum[k] += (double)x[i + k];
      for (uint64_t i = whole; i < m; i++) total += (double)x[i];
      for (uint32_t k = 0; k < LANES; k++) total += sum[k];
      mean = (float)(total / (double)m);
      f->means[c->first + column] = mean;
      for (uint64_t i = 0; i < m; i++) x[i] -= mean;
    }
    for (uint64_t i = 0; i < whole; i += LANES)
      for (uint32_t k = 0; k < LANES; k++) square[k] += (double)x[i + k] * (double)x[i + k];
    for (uint64_t i = whole; i < m; i++) centred += (double)x[i] * (double)x[i];
    for (uint32_t k = 0; k < LANES; k++) centred += square[k];
    all_centred += centred;
    energy += centred + (double)m * mean * mean;
  }
  c->energy[part] = energy;
  c->centred[part] = all_centred;
}

static void add_up_counts(const btfi_pvpca_fit_job *f) {
  const uint32_t threads = f->host->thread_count(f->ctx);
  for (uint32_t t = 0; t < threads; t++)
    for (uint32_t bin = 0; bin < BTF_PEAK_BINS; bin++)
      f->histogram[bin] += f->counts[(size_t)t * BTF_PEAK_BINS + bin];
  memset(f->counts, 0, (size_t)threads * BTF_PEAK_BINS * sizeof *f->counts);
}

/* Reads a block and takes the mean of each column away; adds energies unless they are NULL. */
static btf_status read_centred(btfi_pvpca_fit_job *f, uint32_t view, uint64_t texel0, uint64_t texels,
                               double *energy, double *centred) {
  centring c = {.f = f, .first = texel0 * f->texel_columns, .columns = texels * f->texel_columns};
  uint32_t *const counts = f->counts;
  BTF_TRY(read_texels(f, view, texel0, texels));
  if (energy == NULL) f->counts = NULL;
  const btf_status status = f->host->parallel(f->ctx, PVPCA_PARTS, centre_part, &c);
  f->counts = counts;
  BTF_TRY(status);
  if (energy == NULL) return BTF_OK;
  for (uint32_t part = 0; part < PVPCA_PARTS; part++) {
    *energy += c.energy[part];
    *centred += c.centred[part];
  }
  if (counts != NULL) add_up_counts(f);
  return BTF_OK;
}

/* ---- eigenvectors ---- */

/* Powers of two of the largest magnitudes whose squares a float may sum as they are, as in host->gram. */
enum { GRAM_LEAST_EXPONENT = -40, GRAM_MOST_EXPONENT = 55 };

/* The power of two that brings the block near 1, or 0 if its squares are fine. */
static int block_exponent(const float *x, uint64_t n) {
  float largest = 0.0f;
  int exponent;
  for (uint64_t i = 0; i < n; i++) largest = fabsf(x[i]) > largest ? fabsf(x[i]) : largest;
  if (!(largest > 0.0f) || isinf(largest)) return 0;
  (void)frexpf(largest, &exponent);
  return exponent < GRAM_LEAST_EXPONENT || exponent > GRAM_MOST_EXPONENT ? exponent : 0;
}

/* Of columns: float sums over short runs of rows, in double beyond, as host->gram makes those of rows. */
static btf_status gram_of_columns(btfi_pvpca_fit_job *f) {
  const uint64_t squares = (uint64_t)f->side * f->side, values = f->rows * f->columns;
  const int exponent = block_exponent(f->block, values);
  const double unit = ldexp(1.0, 2 * exponent);
  /* The block holds all columns, and has no use for a copy: it is scaled back. */
  for (uint64_t i = 0; exponent != 0 && i < values; i++) f->block[i] = ldexpf(f->block[i], -exponent);
  for (uint64_t row = 0; row < f->rows; row += GRAM_RUN) {
    const uint64_t run = f->rows - row < GRAM_RUN ? f->rows - row : GRAM_RUN;
    const float *x = f->block + row;
    BTF_TRY(f->host->gemm(f->ctx, BTF_TRANSPOSE_B, f->side, f->side, run, 1.0f, x, f->rows, x, f->rows, 0.0f,
                          f->gram_part, f->side));
    for (uint64_t i = 0; i < squares; i++) f->gram[i] += unit * (double)f->gram_part[i];
  }
  for (uint64_t i = 0; exponent != 0 && i < values; i++) f->block[i] = ldexpf(f->block[i], exponent);
  return BTF_OK;
}

btf_status btfi_pvpca_analyse(btfi_pvpca_fit_job *f, uint32_t view, float *vectors) {
  const uint32_t side = f->side;
  double energy = 0.0;
  f->centred[view] = 0.0;
  memset(f->gram, 0, (size_t)side * side * sizeof *f->gram);
  for (uint64_t texel = 0; texel < f->texels; texel += f->block_texels) {
    const uint64_t texels = f->texels - texel < f->block_texels ? f->texels - texel : f->block_texels;
    BTF_TRY(btfi_pvpca_progress(f, 0.5 * (double)texel / (double)f->texels));
    BTF_TRY(read_centred(f, view, texel, texels, &energy, &f->centred[view]));
    BTF_TRY(f->by_columns
                ? gram_of_columns(f)
                : f->host->gram(f->ctx, texels * f->texel_columns, side, f->block, f->rows, f->gram));
  }
  f->energy += energy;
  BTF_TRY(btfi_pvpca_progress(f, 0.5));
  BTF_TRY(f->host->symmetric_eigen(f->ctx, side, f->gram, f->eigenvalues));
  for (uint32_t i = 0; i < side; i++)
    for (uint32_t j = 0; j < f->keep; j++)
      vectors[(size_t)i * f->keep + j] = (float)f->gram[(size_t)j * side + i];
  return btfi_pvpca_progress(f, 0.6);
}

/* ---- eigen-textures ---- */

/* h = X^T g, as the eigenvectors are the weights. */
static btf_status project_rows(btfi_pvpca_fit_job *f, uint32_t view, const float *vectors, uint32_t terms,
                               bool in_block) {
  const uint32_t ld = f->layout.has_mean + terms;
  for (uint64_t texel = 0; texel < f->texels; texel += f->block_texels) {
    const uint64_t texels = f->texels - texel < f->block_texels ? f->texels - texel : f->block_texels;
    if (!in_block) {
      BTF_TRY(btfi_pvpca_progress(f, 0.6 + 0.2 * (double)texel / (double)f->texels));
      BTF_TRY(read_centred(f, view, texel, texels, NULL, NULL));
    }
    BTF_TRY(f->host->gemm(f->ctx, 0, texels * f->texel_columns, terms, f->rows, 1.0f, f->block, f->rows,
                          vectors, f->keep, 0.0f,
                          f->textures + texel * f->texel_columns * ld + f->layout.has_mean, ld));
  }
  for (uint64_t i = 0; i < f->rows; i++)
    memcpy(f->weights + i * terms, vectors + i * f->keep, terms * sizeof *vectors);
  return BTF_OK;
}

/* The eigenvectors are eigen-textures of length 1; their weights come by projection. */
static btf_status project_columns(btfi_pvpca_fit_job *f, uint32_t view, const float *vectors, uint32_t terms,
                                  bool in_block) {
  const uint32_t ld = f->layout.has_mean + terms;
  if (!in_block) BTF_TRY(read_centred(f, view, 0, f->texels, NULL, NULL));
  BTF_TRY(f->host->gemm(f->ctx, BTF_TRANSPOSE_A, f->rows, terms, f->columns, 1.0f, f->block, f->rows, vectors,
                        f->keep, 0.0f, f->weights, terms));
  for (uint32_t j = 0; j < terms; j++) {
    double square = 0.0;
    for (uint64_t i = 0; i < f->rows; i++) {
      const double g = (double)f->weights[i * terms + j];
      square += g * g;
    }
    const float norm = (float)sqrt(square), inverse = norm > PVPCA_SMALLEST ? 1.0f / norm : 0.0f;
    for (uint64_t i = 0; i < f->rows; i++) f->weights[i * terms + j] *= inverse;
    for (uint64_t i = 0; i < f->columns; i++)
      f->textures[i * ld + f->layout.has_mean + j] = vectors[i * f->keep + j] * norm;
  }
  return BTF_OK;
}

btf_status btfi_pvpca_project(btfi_pvpca_fit_job *f, uint32_t view, const float *vectors, uint32_t terms,
                              bool in_block) {
  const uint32_t ld = f->layout.has_mean + terms;
  BTF_TRY(f->by_columns ? project_columns(f, view, vectors, terms, in_block)
                        : project_rows(f, view, vectors, terms, in_block));
  for (uint64_t i = 0; f->layout.has_mean && i < f->columns; i++) f->textures[i * ld] = f->means[i];
  return btfi_pvpca_progress(f, 0.8);
}
