/* SPDX-License-Identifier: MIT */
/* cluster.c: codebooks of vectors by one of the methods, within a memory budget. */
#include "cluster_parts.h"

#include <math.h>
#include <string.h>

#include <btf/btf_codec.h>

static btf_status check_vectors(const btf_host *host, btf_context *ctx, const btfi_cmf_vectors *vectors,
                                uint32_t entries) {
  if (vectors->count < 1 || vectors->count > UINT32_MAX || vectors->length < 1 ||
      vectors->length > CMF_MAX_VECTOR || entries < 1 || entries > CMF_MAX_ENTRIES)
    return host->fail(
        ctx, BTF_E_LIMIT,
        "cmf: a codebook of %u entries for %llu vectors of %u values; at most %u for %u of %u are possible",
        entries, (unsigned long long)vectors->count, vectors->length, CMF_MAX_ENTRIES, UINT32_MAX,
        CMF_MAX_VECTOR);
  return BTF_OK;
}

void btfi_cmf_codebook_free(const btf_host *host, btf_context *ctx, btfi_cmf_codebook *codebook) {
  host->free(ctx, codebook->values);
  host->free(ctx, codebook->index);
  host->free(ctx, codebook->history);
  memset(codebook, 0, sizeof *codebook);
}

btf_status btfi_cmf_assign(const btf_host *host, btf_context *ctx, const btfi_cmf_vectors *vectors,
                           const float *values, uint32_t entries, uint64_t max_working_set,
                           const btf_job *job, double from, double to, const char *stage, uint32_t *index,
                           double *distance) {
  const btfi_cmf_search_report report = {job, from, to, stage};
  btfi_cmf_search search;
  double *made = NULL;
  btf_status status = check_vectors(host, ctx, vectors, entries);
  if (status != BTF_OK) return status;
  if (max_working_set == 0) max_working_set = UINT64_C(1) << 30;
  if (distance == NULL) {
    distance = made = host->alloc(ctx, vectors->count, sizeof *made);
    if (made == NULL) return BTF_E_NOMEM;
  }
  status = btfi_cmf_search_create(host, ctx, vectors, entries, max_working_set,
                                  made != NULL ? vectors->count * sizeof *made : 0, &search);
  if (status == BTF_OK) status = btfi_cmf_search_prepare(&search, values, entries);
  if (status == BTF_OK)
    status = btfi_cmf_search_run(&search, NULL, vectors->count, &report, index, distance, NULL);
  btfi_cmf_search_free(&search);
  host->free(ctx, made);
  return status;
}

/* Drops entries that no vector has. */
static btf_status drop_unused(btfi_cmf_clustering *c) {
  btfi_cmf_codebook *out = c->out;
  const size_t length = out->length;
  uint32_t used = 0, *place = c->host->alloc(c->ctx, out->entries, sizeof *place);
  if (place == NULL) return BTF_E_NOMEM;
  memset(place, 0, out->entries * sizeof *place);
  for (uint64_t v = 0; v < c->vectors->count; v++) place[out->index[v]] = 1;
  for (uint32_t e = 0; e < out->entries; e++) {
    if (!place[e]) continue;
    if (used < e) memcpy(out->values + used * length, out->values + e * length, length * sizeof *out->values);
    place[e] = used++;
  }
  for (uint64_t v = 0; v < c->vectors->count; v++) out->index[v] = place[out->index[v]];
  out->entries = used;
  c->host->free(c->ctx, place);
  return BTF_OK;
}

static btf_status run_tree(btfi_cmf_clustering *c) {
  btfi_cmf_codebook *out = c->out;
  const btfi_cmf_search_report report = {c->job, c->from + 0.8 * (c->to - c->from), c->to, c->stage};
  BTF_TRY(btfi_cmf_tree(c));
  BTF_TRY(btfi_cmf_search_prepare(&c->search, out->values, out->entries));
  BTF_TRY(btfi_cmf_search_run(&c->search, NULL, c->vectors->count, &report, out->index, c->distance, NULL));
  out->inertia = btfi_cmf_inertia(c->distance, c->vectors->count);
  return BTF_OK;
}

static btf_status run(btfi_cmf_clustering *c, const uint32_t *start, uint64_t used) {
  const btf_host *host = c->host;
  btfi_cmf_codebook *out = c->out;
  BTF_TRY(btfi_cmf_search_create(host, c->ctx, c->vectors, c->entries, c->options->max_working_set, used,
                                 &c->search));
  out->length = c->vectors->length;
  out->values = host->alloc(c->ctx, c->entries, out->length * sizeof *out->values);
  out->index = host->alloc(c->ctx, c->vectors->count, sizeof *out->index);
  out->history = host->alloc(c->ctx, c->options->max_iterations, sizeof *out->history);
  c->distance = host->alloc(c->ctx, c->vectors->count, sizeof *c->distance);
  if (out->values == NULL || out->index == NULL || out->history == NULL || c->distance == NULL)
    return BTF_E_NOMEM;
  if (c->options->method != CMF_KMEANS) {
    BTF_TRY(run_tree(c));
  } else if (start != NULL) {
    memcpy(out->index, start, c->vectors->count * sizeof *start);
    BTF_TRY(btfi_cmf_lloyd(c, c->from));
  } else {
    const double from = c->from + 0.3 * (c->to - c->from);
    BTF_TRY(btfi_cmf_start(c, from));
    BTF_TRY(btfi_cmf_lloyd(c, from));
  }
  return drop_unused(c);
}

static void set_defaults(btfi_cmf_cluster_options *options, uint64_t count) {
  if (options->max_iterations == 0) options->max_iterations = 100;
  if (options->tolerance == 0.0) options->tolerance = 1e-4;
  if (options->max_working_set == 0) options->max_working_set = UINT64_C(1) << 30;
  if (options->entries > count) options->entries = (uint32_t)count;
}

uint64_t btfi_cmf_cluster_bytes(const btfi_cmf_cluster_options *options, int started, uint64_t count,
                                uint32_t length, uint32_t threads) {
  const btfi_cmf_codebook *out;
  btfi_cmf_cluster_options set = *options;
  set_defaults(&set, count);
  uint64_t own;
  if (set.method == CMF_KMEANS) {
    const uint64_t start = started ? 0 : btfi_cmf_start_bytes(count, length, set.entries, threads);
    own = btfi_cmf_lloyd_bytes(count, length, set.entries, threads);
    if (own < start) own = start;
  } else {
    own = btfi_cmf_tree_bytes(count, length, set.entries, threads);
  }
  return own + count * (sizeof *out->index + sizeof(double)) +
         (uint64_t)set.entries * length * sizeof *out->values +
         (uint64_t)set.max_iterations * sizeof *out->history + (uint64_t)set.entries * sizeof(uint32_t);
}

btf_status btfi_cmf_cluster_from(const btf_host *host, btf_context *ctx, const btfi_cmf_vectors *vectors,
                                 const btfi_cmf_cluster_options *options, const uint32_t *start,
                                 const btf_job *job, double from, double to, const char *stage,
                                 btfi_cmf_codebook *out) {
  btfi_cmf_cluster_options set = *options;
  btfi_cmf_clustering c = {.host = host,
                           .ctx = ctx,
                           .vectors = vectors,
                           .options = &set,
                           .job = job,
                           .from = from,
                           .to = to,
                           .stage = stage,
                           .out = out};
  memset(out, 0, sizeof *out);
  BTF_TRY(check_vectors(host, ctx, vectors, set.entries));
  set_defaults(&set, vectors->count);
  c.entries = set.entries;
  const btf_status status = run(
      &c, start,
      btfi_cmf_cluster_bytes(&set, start != NULL, vectors->count, vectors->length, host->thread_count(ctx)));
  btfi_cmf_search_free(&c.search);
  host->free(ctx, c.distance);
  if (status != BTF_OK) btfi_cmf_codebook_free(host, ctx, out);
  return status;
}

btf_status btfi_cmf_cluster(const btf_host *host, btf_context *ctx, const btfi_cmf_vectors *vectors,
                            const btfi_cmf_cluster_options *options, const btf_job *job, double from,
                            double to, const char *stage, btfi_cmf_codebook *out) {
  return btfi_cmf_cluster_from(host, ctx, vectors, options, NULL, job, from, to, stage, out);
}
