/* SPDX-License-Identifier: MIT */
/* write.c: from coefficients to the tables of the payload. */
#include "lpca.h"

#include <math.h>
#include <string.h>

enum { STRIPES = 16 };

/* What stripes of an ABRDF's rows find out on their own. */
typedef struct lifting {
  btfi_lpca_writing *w;
  const float *inverse;   /* of the scale of each column */
  unsigned char *factors; /* of the cluster; NULL to find the error alone */
  uint64_t pairs;
  float largest[STRIPES][LPCA_MAX_COMPONENTS + 1];
  double error[STRIPES][LPCA_MAX_COMPONENTS + 1];
} lifting;

static void find_largest(void *job, uint32_t stripe, uint32_t thread) {
  lifting *l = job;
  const btfi_lpca_layout *layout = &l->w->layout;
  const uint32_t columns = layout->components + 1;
  const uint64_t rows = l->pairs * layout->channels;
  float *largest = l->largest[stripe];
  (void)thread;
  memset(largest, 0, sizeof l->largest[stripe]);
  for (uint64_t row = rows * stripe / STRIPES; row < rows * (stripe + 1) / STRIPES; row++)
    for (uint32_t j = 0; j < columns; j++)
      largest[j] = fmaxf(largest[j], fabsf(l->w->lifted[row * columns + j]));
}

/* Rounds the rows of some pairs and adds up squared errors; column 0 is the mean. */
static void store_rows(void *job, uint32_t stripe, uint32_t thread) {
  lifting *l = job;
  const btfi_lpca_layout *layout = &l->w->layout;
  const uint32_t columns = layout->components + 1;
  double *error = l->error[stripe];
  unsigned char unused[4];
  (void)thread;
  memset(error, 0, sizeof l->error[stripe]);
  for (uint64_t pair = l->pairs * stripe / STRIPES; pair < l->pairs * (stripe + 1) / STRIPES; pair++) {
    unsigned char *row = l->factors != NULL ? l->factors + pair * layout->row_bytes : NULL;
    for (uint32_t c = 0; c < layout->channels; c++) {
      const float *value = l->w->lifted + (pair * layout->channels + c) * columns;
      for (uint32_t j = 0; j < columns; j++) {
        unsigned char *dst = unused;
        const float scaled = value[j] * l->inverse[j];
        float stored;
        if (row != NULL)
          dst = j == 0 ? row + layout->mean_at + (size_t)c * layout->mean_bytes
                       : row + ((size_t)c * layout->stride + j - 1) * layout->factor_bytes;
        stored = j == 0 ? btfi_lpca_store_value(layout->storage, scaled, dst)
                        : btfi_lpca_store_factor(layout->storage, scaled, dst);
        error[j] += ((double)stored - (double)scaled) * ((double)stored - (double)scaled);
      }
    }
  }
}

static double sum_of(const lifting *l, uint32_t j) {
  double sum = 0.0;
  for (uint32_t stripe = 0; stripe < STRIPES; stripe++) sum += l->error[stripe][j];
  return sum;
}

/* The mean and the components of a cluster as ABRDFs, and what their rounding costs: the weights of principal
 * components neither correlate with each other nor have a mean, so that errors add up. */
static btf_status lift_cluster(btfi_lpca_writing *w, uint32_t k, uint64_t members,
                               const double *weight_energy, unsigned char *factors, lifting *l) {
  const btfi_lpca_model *m = w->model;
  const uint32_t columns = w->layout.components + 1;
  const uint64_t rows = l->pairs * w->layout.channels;
  float *basis = w->center_basis, *scale = w->factor_scale + (size_t)k * columns;
  float inverse[LPCA_MAX_COMPONENTS + 1];
  if (k < w->refined_clusters) {
    const float *refined = w->refined + k * columns * rows;
    for (uint32_t j = 0; j < columns; j++)
      for (uint64_t row = 0; row < rows; row++) w->lifted[row * columns + j] = refined[j * rows + row];
  } else {
    memcpy(basis, m->basis + (size_t)k * columns * m->size, (size_t)columns * m->size * sizeof *basis);
    for (uint32_t d = 0; d < m->size; d++) basis[d] += w->center[d];
    BTF_TRY(w->host->gemm(w->ctx, BTF_TRANSPOSE_B, rows, columns, m->size, 1.0f, w->vectors, m->size, basis,
                          m->size, 0.0f, w->lifted, columns));
  }
  BTF_TRY(w->host->parallel(w->ctx, STRIPES, find_largest, l));
  for (uint32_t j = 0; j < columns; j++) {
    scale[j] = 0.0f;
    for (uint32_t stripe = 0; stripe < STRIPES; stripe++) scale[j] = fmaxf(scale[j], l->largest[stripe][j]);
    /* The inverse of a subnormal number may be infinite. */
    inverse[j] = scale[j] > 1e-30f ? 1.0f / scale[j] : 0.0f;
    if (inverse[j] == 0.0f) scale[j] = 0.0f;
  }
  l->inverse = inverse;
  l->factors = factors;
  BTF_TRY(w->host->parallel(w->ctx, STRIPES, store_rows, l));
  for (uint32_t j = 0; j < columns; j++)
    w->storage_error += sum_of(l, j) * (double)scale[j] * (double)scale[j] *
                        (j == 0 ? (double)members : weight_energy[j - 1]);
  return BTF_OK;
}

/* Of each cluster and component: the sum of squared weights of the finest level, and the largest weight of
 * all. */
static void measure_weights(btfi_lpca_writing *w, double *energy) {
  const uint32_t components = w->layout.components;
  memset(w->weight_scale, 0, (size_t)w->layout.clusters * components * sizeof *w->weight_scale);
  for (uint32_t level = 0; level < w->layout.levels; level++) {
    const uint64_t texels = (uint64_t)w->layout.level_width[level] * w->layout.level_height[level];
    if (w->level[level].label == NULL) continue;
    for (uint64_t i = 0; i < texels; i++) {
      const size_t at = (size_t)w->level[level].label[i] * components;
      for (uint32_t j = 0; j < components; j++) {
        const float weight = w->level[level].weights[i * components + j];
        if (level == 0) energy[at + j] += (double)weight * (double)weight;
        w->weight_scale[at + j] = fmaxf(w->weight_scale[at + j], fabsf(weight));
      }
    }
  }
}

/* Labels and weights of one level; with NULL the error alone. */
static void store_level(btfi_lpca_writing *w, uint32_t level, unsigned char *index, unsigned char *weights) {
  const btfi_lpca_layout *layout = &w->layout;
  const uint64_t texels = (uint64_t)layout->level_width[level] * layout->level_height[level];
  unsigned char unused[4];
  for (uint64_t i = 0; i < texels; i++) {
    const uint32_t label = w->level[level].label[i];
    if (index != NULL) {
      index[i * layout->index_bytes] = (unsigned char)label;
      if (layout->index_bytes == 2) index[2 * i + 1] = (unsigned char)(label >> 8);
    }
    for (uint32_t j = 0; j < layout->components; j++) {
      const float scale = w->weight_scale[(size_t)label * layout->components + j];
      const float scaled = scale > 0.0f ? w->level[level].weights[i * layout->components + j] / scale : 0.0f;
      unsigned char *dst =
          weights != NULL ? weights + i * layout->texel_bytes + (size_t)j * layout->weight_bytes : unused;
      const double error =
          ((double)btfi_lpca_store_value(layout->storage, scaled, dst) - (double)scaled) * (double)scale;
      if (level == 0) w->storage_error += error * error;
    }
  }
}

static btf_status write_head(btfi_lpca_writing *w) {
  unsigned char bytes[LPCA_HEAD_BYTES];
  const uint32_t words[] = {w->head.storage,    w->head.packing, w->head.clusters,
                            w->head.components, w->head.levels,  w->head.reserved};
  const double numbers[] = {w->head.squared_error, w->head.energy, w->head.outside};
  for (size_t i = 0; i < 6; i++) btf_put_u32(bytes + 4 * i, words[i]);
  for (size_t i = 0; i < 3; i++) btf_put_f64(bytes + 24 + 8 * i, numbers[i]);
  return w->host->put(w->payload, LPCA_TAG_HEAD, 0, 0, bytes, sizeof bytes);
}

static btf_status write_scales(btfi_lpca_writing *w) {
  const uint32_t columns = w->layout.components + 1;
  void *data;
  BTF_TRY(
      w->host->reserve(w->payload, LPCA_TAG_SCALES, 0, 0, (uint64_t)w->layout.clusters * columns * 4, &data));
  unsigned char *dst = data;
  for (uint32_t k = 0; k < w->layout.clusters; k++)
    for (uint32_t j = 0; j < columns; j++, dst += 4) {
      float scale = w->factor_scale[(size_t)k * columns + j];
      if (j > 0) scale *= w->weight_scale[(size_t)k * w->layout.components + j - 1];
      if (!isfinite(scale))
        return w->host->fail(w->ctx, BTF_E_NUMERIC, "lpca: a component of cluster %u has values beyond float",
                             k);
      btf_put_f32(dst, scale);
    }
  return BTF_OK;
}

static btf_status write_all(btfi_lpca_writing *w, bool tables, double *energy, lifting *l) {
  const btfi_lpca_layout *layout = &w->layout;
  void *factors = NULL;
  l->w = w;
  l->pairs = (uint64_t)layout->views * layout->lights;
  w->storage_error = 0.0;
  memset(energy, 0, (size_t)layout->clusters * layout->components * sizeof *energy);
  measure_weights(w, energy);
  if (tables)
    BTF_TRY(w->host->reserve(w->payload, LPCA_TAG_FACTORS, 0, BTF_PAYLOAD_IN_PLACE, layout->factors_bytes,
                             &factors));
  for (uint32_t k = 0; k < layout->clusters; k++)
    BTF_TRY(lift_cluster(w, k, w->model->start[k + 1] - w->model->start[k],
                         energy + (size_t)k * layout->components,
                         tables ? (unsigned char *)factors + k * layout->cluster_bytes : NULL, l));
  for (uint32_t level = 0; level < (tables ? layout->levels : 1); level++) {
    void *index = NULL, *weights = NULL;
    if (tables) {
      BTF_TRY(w->host->reserve(w->payload, LPCA_TAG_CLUSTERS, level, BTF_PAYLOAD_IN_PLACE,
                               layout->index_table_bytes[level], &index));
      BTF_TRY(w->host->reserve(w->payload, LPCA_TAG_WEIGHTS, level, BTF_PAYLOAD_IN_PLACE,
                               layout->weight_table_bytes[level], &weights));
    }
    store_level(w, level, index, weights);
  }
  if (!tables) return BTF_OK;
  w->head.squared_error += w->storage_error;
  BTF_TRY(write_head(w));
  return write_scales(w);
}

uint64_t btfi_lpca_write_bytes(uint64_t rows, uint32_t clusters, uint32_t components, uint32_t size) {
  const uint64_t columns = (uint64_t)components + 1;
  return (rows + size) * columns * sizeof(float) + clusters * columns * (sizeof(double) + 2 * sizeof(float)) +
         sizeof(lifting);
}

btf_status btfi_lpca_write(btfi_lpca_writing *w, bool tables) {
  const uint64_t columns = (uint64_t)w->layout.components + 1, clusters = w->layout.clusters;
  const uint64_t rows = (uint64_t)w->layout.views * w->layout.lights * w->layout.channels;
  const btf_host *host = w->host;
  double *energy = host->alloc(w->ctx, clusters * columns, sizeof *energy);
  lifting *l = host->alloc(w->ctx, 1, sizeof *l);
  btf_status status = BTF_E_NOMEM;
  w->lifted = host->alloc(w->ctx, rows * columns, sizeof *w->lifted);
  w->factor_scale = host->alloc(w->ctx, clusters * columns, sizeof *w->factor_scale);
  w->weight_scale = host->alloc(w->ctx, clusters * columns, sizeof *w->weight_scale);
  w->center_basis = host->alloc(w->ctx, columns * w->model->size, sizeof *w->center_basis);
  if (energy != NULL && l != NULL && w->lifted != NULL && w->factor_scale != NULL &&
      w->weight_scale != NULL && w->center_basis != NULL)
    status = write_all(w, tables, energy, l);
  host->free(w->ctx, energy);
  host->free(w->ctx, l);
  host->free(w->ctx, w->lifted);
  host->free(w->ctx, w->factor_scale);
  host->free(w->ctx, w->weight_scale);
  host->free(w->ctx, w->center_basis);
  w->center_basis = NULL;
  return status;
}
