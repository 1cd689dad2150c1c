/* SPDX-License-Identifier: MIT */
#include "bench_queries.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* A generator of its own keeps the queries the same everywhere. */
static double next_random(uint64_t *state) {
  *state = *state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
  return (double)(*state >> 11) / 9007199254740992.0;
}

/* Uniform over the hemisphere down to 80 degrees from the normal, where measurements end. */
static void random_direction(uint64_t *state, float out[3]) {
  const double z = 1 - next_random(state) * (1 - 0.1736), phi = 6.283185307179586 * next_random(state);
  const double r = sqrt(1 - z * z);
  out[0] = (float)(r * cos(phi));
  out[1] = (float)(r * sin(phi));
  out[2] = (float)z;
}

static void toward(double x, double y, double z, float out[3]) {
  const double length = sqrt(x * x + y * y + z * z);
  out[0] = (float)(x / length);
  out[1] = (float)(y / length);
  out[2] = (float)(z / length);
}

static void fill_query(int order, uint32_t i, const btf_model_info *model, uint64_t *state, btf_query *q) {
  /* Neighbouring pixels of a plane of 128 x 128 pixels, one for each texel, under a lamp and an eye at finite
   * distance. */
  const double px = i % 128, py = i / 128;
  const double x = px / 128 - 0.5, y = py / 128 - 0.5;
  memset(q, 0, sizeof *q);
  if (order == BENCH_RANDOM) {
    random_direction(state, q->light);
    random_direction(state, q->view);
    q->uv[0] = (float)next_random(state);
    q->uv[1] = (float)next_random(state);
    return;
  }
  q->uv[0] = (float)((px + 0.3) / model->width);
  q->uv[1] = (float)((py + 0.7) / model->height);
  toward(0.6 - x, 0.3 - y, 0.9, q->light);
  toward(-0.5 - x, 0.8 - y, 1.1, q->view);
  if (order == BENCH_SHARED) {
    toward(0.6, 0.3, 0.9, q->light);
    toward(-0.5, 0.8, 1.1, q->view);
  }
}

bool bench_queries_create(int order, const btf_model_info *model, bench_queries *out) {
  uint64_t state = 1;
  memset(out, 0, sizeof *out);
  out->single = malloc(sizeof *out->single * BENCH_QUERIES);
  out->coordinates = malloc(sizeof(float) * 8 * BENCH_QUERIES);
  out->results = malloc(sizeof(float) * BENCH_BATCH * model->channels);
  out->result_rows = malloc(sizeof(float *) * model->channels);
  if (out->single == NULL || out->coordinates == NULL || out->results == NULL || out->result_rows == NULL)
    return false;
  for (uint32_t c = 0; c < model->channels; c++) out->result_rows[c] = out->results + (size_t)c * BENCH_BATCH;
  for (uint32_t i = 0; i < BENCH_QUERIES; i++) {
    btf_query *q = &out->single[i];
    fill_query(order, i, model, &state, q);
    for (uint32_t k = 0; k < 3; k++) {
      out->coordinates[k * BENCH_QUERIES + i] = q->light[k];
      out->coordinates[(3 + k) * BENCH_QUERIES + i] = q->view[k];
    }
    for (uint32_t k = 0; k < 2; k++) out->coordinates[(6 + k) * BENCH_QUERIES + i] = q->uv[k];
  }
  return true;
}

void bench_queries_free(bench_queries *q) {
  free(q->single);
  free(q->coordinates);
  free(q->results);
  free(q->result_rows);
  memset(q, 0, sizeof *q);
}

void bench_queries_single(const bench_queries *q, const btf_model *model, uint32_t flags) {
  for (uint32_t i = 0; i < BENCH_QUERIES; i++) {
    btf_query query = q->single[i];
    query.flags = flags;
    btf_model_eval(model, &query, q->results);
  }
}

void bench_queries_batch(const bench_queries *q, const btf_model *model, uint32_t flags) {
  for (uint32_t i = 0; i < BENCH_QUERIES; i += BENCH_BATCH) {
    btf_batch batch = BTF_BATCH_INIT;
    batch.count = BENCH_BATCH;
    batch.flags = flags;
    for (uint32_t k = 0; k < 3; k++) {
      batch.light[k] = q->coordinates + (size_t)k * BENCH_QUERIES + i;
      batch.view[k] = q->coordinates + (size_t)(3 + k) * BENCH_QUERIES + i;
    }
    for (uint32_t k = 0; k < 2; k++) batch.uv[k] = q->coordinates + (size_t)(6 + k) * BENCH_QUERIES + i;
    btf_model_eval_n(model, &batch, BTF_VALUE_BRDF, q->result_rows);
  }
}
