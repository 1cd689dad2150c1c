/* SPDX-License-Identifier: MIT */
/* target.c: the smallest model that meets a quality. Models of several sizes are written into memory, loaded,
 * and decoded against the data. */
#include <math.h>

#include "fit.h"

/* ---- payloads in memory ---- */

typedef struct chunk {
  uint32_t tag, index, flags;
  uint64_t size;
  void *data;
} chunk;

/* A payload, and the host table whose chunks are those. */
typedef struct trial {
  btf_host host;
  const btf_host *library;
  btf_context *ctx;
  chunk *chunk;
  uint32_t count, capacity;
} trial;

static btf_status reserve_chunk(btf_chunk_writer *w, uint32_t tag, uint32_t index, uint32_t flags,
                                uint64_t size, void **dst) {
  trial *t = (trial *)(void *)w;
  if (t->count == t->capacity) {
    const uint32_t capacity = 2 * t->capacity + 16;
    chunk *grown = t->library->alloc(t->ctx, capacity, sizeof *grown);
    if (grown == NULL) return BTF_E_NOMEM;
    if (t->count > 0) memcpy(grown, t->chunk, t->count * sizeof *grown);
    t->library->free(t->ctx, t->chunk);
    t->chunk = grown;
    t->capacity = capacity;
  }
  *dst = t->library->alloc(t->ctx, size, 1);
  if (*dst == NULL) return BTF_E_NOMEM;
  memset(*dst, 0, size);
  t->chunk[t->count++] = (chunk){tag, index, flags, size, *dst};
  return BTF_OK;
}

static btf_status put_chunk(btf_chunk_writer *w, uint32_t tag, uint32_t index, uint32_t flags,
                            const void *src, uint64_t size) {
  void *dst;
  BTF_TRY(reserve_chunk(w, tag, index, flags, size, &dst));
  memcpy(dst, src, size);
  return BTF_OK;
}

static btf_status get_chunk(btf_chunk_reader *r, uint32_t tag, uint32_t index, const void **data,
                            uint64_t *size) {
  const trial *t = (const trial *)(const void *)r;
  for (uint32_t i = 0; i < t->count; i++) {
    if (t->chunk[i].tag != tag || t->chunk[i].index != index) continue;
    *data = t->chunk[i].data;
    *size = t->chunk[i].size;
    return BTF_OK;
  }
  return t->library->fail(t->ctx, BTF_E_CORRUPT, "cmf: a chunk is missing");
}

static void trial_clear(trial *t) {
  for (uint32_t i = 0; i < t->count; i++) t->library->free(t->ctx, t->chunk[i].data);
  t->library->free(t->ctx, t->chunk);
  t->chunk = NULL;
  t->count = t->capacity = 0;
}

static void trial_init(trial *t, const btf_host *library, btf_context *ctx) {
  memset(t, 0, sizeof *t);
  memcpy(&t->host, library, library->struct_size < sizeof t->host ? library->struct_size : sizeof t->host);
  t->host.reserve = reserve_chunk;
  t->host.put = put_chunk;
  t->host.get = get_chunk;
  t->library = library;
  t->ctx = ctx;
}

/* ---- what is decoded ---- */

typedef struct measuring {
  const btfi_cmf_fitting *f;
  const void *state;
  double *error; /* squared, of each texel */
} measuring;

static void measure_texel(void *user, uint32_t level, uint32_t x, uint32_t y, const float *abrdf,
                          uint32_t thread) {
  const measuring *m = user;
  const uint32_t channels = m->f->channels;
  double sum = 0.0;
  (void)thread;
  for (uint32_t v = 0; v < m->f->views; v++)
    for (uint32_t l = 0; l < m->f->lights; l++) {
      float decoded[CMF_MAX_CHANNELS];
      btfi_cmf_texel(m->state, level, x, y, l, v, decoded);
      for (uint32_t c = 0; c < channels; c++) {
        const double d = (double)decoded[c] - (double)*abrdf++;
        sum += d * d;
      }
    }
  m->error[(uint64_t)y * m->f->width + x] = sum;
}

/* The squared error of the finest level. */
static btf_status measure(btfi_cmf_fitting *f, trial *t, const btf_dataset_desc *desc, double from, double to,
                          double *out) {
  const btf_model_shape shape = {.lights = desc->lights,
                                 .views = desc->views,
                                 .width = f->width,
                                 .height = f->height,
                                 .channels = f->channels,
                                 .quantity = desc->quantity,
                                 .wrap = desc->wrap};
  const uint64_t texels = btfi_cmf_level_texels(f, 0);
  measuring m = {f, NULL, f->host->alloc(f->ctx, texels, sizeof *m.error)};
  void *state = NULL;
  if (m.error == NULL) return BTF_E_NOMEM;
  btf_status status =
      btfi_cmf_load(&t->host, f->ctx, CMF_FORMAT, &shape, (btf_chunk_reader *)(void *)t, &state);
  m.state = state;
  if (status == BTF_OK)
    status = f->host->visit_abrdfs(f->ctx, f->ds, 0, btfi_cmf_left(f), measure_texel, &m, f->job, from, to,
                                   "measuring");
  *out = 0.0;
  for (uint64_t i = 0; i < texels && status == BTF_OK; i++) *out += m.error[i];
  if (state != NULL) btfi_cmf_destroy(&t->host, f->ctx, state);
  f->host->free(f->ctx, m.error);
  return status;
}

/* ---- the search ---- */

typedef struct search {
  btfi_cmf_fitting *f;
  const btf_dataset_desc *desc;
  const btf_host *library;
  btf_chunk_writer *payload;
  btfi_cmf_stage *stage;                    /* that gets more terms; NULL if none can */
  uint32_t most_terms, most_entries, sizes; /* sizes: codebooks of 1, 2, 4, ... entries */
  trial now, best;                          /* best: the smallest codebook that meets the target */
  double error;                             /* least so far, and of which terms and entries */
  uint32_t terms, entries;
  double met_error; /* of the smallest that meets the target, and its entries */
  uint32_t met_entries;
} search;

/* Bytes of a payload, and what loading and measuring it take. */
static uint64_t trial_bytes(const btfi_cmf_fitting *f, uint64_t entries) {
  const uint64_t texels = f->level_first[f->levels], value = btfi_cmf_value_bytes(f->storage);
  const uint64_t maps = (entries > 0 ? entries : texels) * f->factors * f->map_values * value;
  const uint64_t indices = entries > 0 ? texels * f->factors * (entries > 256 ? 2 : 1) : 0;
  return maps + indices + texels * (f->scales * f->channels * value + (f->rotate ? 1 : 0)) +
         8 * f->level_first[1] + sizeof(btfi_cmf_state);
}

/* Writes a model with codebooks of `entries`, or maps of every texel's own, into s->now and measures it. */
static btf_status try_size(search *s, uint32_t entries, double from, double to, bool *meets) {
  btfi_cmf_fitting *f = s->f;
  const uint64_t used = f->used;
  const double written = from + 0.8 * (to - from);
  double error = INFINITY;
  trial_clear(&s->now);
  f->entries = entries;
  f->host = &s->now.host;
  f->payload = (btf_chunk_writer *)(void *)&s->now;
  if (entries == 0 && s->sizes > 0) f->used += trial_bytes(f, 0);
  btf_status status = btfi_cmf_write(f, from, written);
  if (status == BTF_OK) status = measure(f, &s->now, s->desc, written, to, &error);
  f->host = s->library;
  f->payload = s->payload;
  f->used = used;
  BTF_TRY(status);
  *meets = error <= f->target;
  if (*meets) {
    s->met_error = error;
    s->met_entries = entries;
  }
  if (error < s->error) {
    s->error = error;
    s->terms = s->stage != NULL ? s->stage->terms : 1;
    s->entries = entries;
  }
  return BTF_OK;
}

/* The smallest codebook that meets the target goes to s->best: between `low`, too small, and `high`, enough
 * or too many. */
static btf_status try_codebooks(search *s, double from, double to, bool *found) {
  int low = -1, high = (int)s->sizes;
  *found = false;
  while (high - low > 1) {
    const int middle = (low + high) / 2;
    const double half = from + 0.5 * (to - from);
    bool meets;
    BTF_TRY(try_size(s, 1u << middle, from, half, &meets));
    from = half;
    if (!meets) {
      low = middle;
      continue;
    }
    const trial smaller = s->now;
    s->now = s->best;
    s->best = smaller;
    high = middle;
    *found = true;
  }
  return BTF_OK;
}

/* Makes what all sizes with the present number of terms need, with room for trials; unless `fits` is NULL
 * only if the working set holds it. */
static btf_status prepare(search *s, double from, double to, bool *fits) {
  btfi_cmf_fitting *f = s->f;
  f->entries = s->most_entries;
  btfi_cmf_unprepare(f);
  BTF_TRY(btfi_cmf_prepare_geometry(f, s->desc, from, to));
  f->used += s->sizes > 0 ? 2 * trial_bytes(f, s->most_entries) : trial_bytes(f, 0);
  if (fits != NULL) {
    *fits = btfi_cmf_has_room(f);
    if (!*fits) return BTF_OK;
  }
  return btfi_cmf_make_room(f);
}

/* With one number of terms. Maps of every texel's own tell whether a codebook can do; where they would not
 * fit the working set, the codebooks are tried anyway. `fits_terms` as in prepare. */
static btf_status try_terms(search *s, double from, double to, bool *fits_terms, bool *met) {
  btfi_cmf_fitting *f = s->f;
  const double prepared = from + 0.05 * (to - from), owned = from + 0.6 * (to - from);
  bool own = true;
  *met = false;
  BTF_TRY(prepare(s, from, prepared, fits_terms));
  if (fits_terms != NULL && !*fits_terms) return BTF_OK;
  const bool fits = s->sizes == 0 || (f->capacity >= f->level_first[f->levels] &&
                                      btfi_cmf_left(f) >= trial_bytes(f, 0) + btfi_cmf_visit_bytes(f));
  if (fits) BTF_TRY(try_size(s, 0, prepared, owned, &own));
  if (own) BTF_TRY(try_codebooks(s, owned, to, met));
  *met = *met || (fits && own);
  return BTF_OK;
}

/* Writes what was found: a codebook that is there already, or else with the terms and entries of least
 * error. */
static btf_status write_result(search *s, bool met, double from, double to) {
  btfi_cmf_fitting *f = s->f;
  for (uint32_t i = 0; i < s->best.count; i++) {
    const chunk *c = &s->best.chunk[i];
    BTF_TRY(f->host->put(f->payload, c->tag, c->index, c->flags, c->data, c->size));
  }
  if (s->best.count > 0) return BTF_OK;
  trial_clear(&s->now);
  if (!met && s->stage != NULL && s->stage->terms != s->terms) {
    s->stage->terms = s->terms;
    BTF_TRY(prepare(s, from, from + 0.1 * (to - from), NULL));
  }
  f->entries = met ? 0 : s->entries;
  return btfi_cmf_write(f, from + 0.1 * (to - from), to);
}

/* The last stage that is no mean; terms are those of the method's. */
static btfi_cmf_stage *stage_of_terms(btfi_cmf_fitting *f) {
  if (f->settings.method == CMF_HOMOMORPHIC) return NULL;
  for (uint32_t i = f->settings.stage_count; i-- > 0;)
    if (!f->settings.stage[i].mean) return &f->settings.stage[i];
  return NULL;
}

static btf_status run(search *s, double from) {
  btfi_cmf_fitting *f = s->f;
  const double found = 0.93, samples = (double)f->level_first[1] * f->pairs * f->channels;
  const uint32_t first = s->stage != NULL ? s->stage->terms : 1;
  const uint32_t last = s->stage != NULL && s->most_terms > first ? s->most_terms : first;
  bool met = false;
  for (uint32_t terms = first; terms <= last && !met; terms++) {
    const double to = from + (found - from) / (last - terms + 1);
    if (s->stage != NULL) s->stage->terms = terms;
    bool fits = true;
    BTF_TRY(try_terms(s, from, to, terms > first ? &fits : NULL, &met));
    if (!fits) break;
    from = to;
  }
  if (!met)
    btf_warn_missed(f->host, f->ctx, "cmf", s->terms, "terms of the last stage", s->error, f->target, samples,
                    f->target_psnr);
  else
    f->host->log(f->ctx, BTF_LOG_INFO,
                 "cmf: codebooks of %u entries (0 = none) and %u terms decode to an rmse of %.6g",
                 s->met_entries, s->stage != NULL ? s->stage->terms : 1, sqrt(s->met_error / samples));
  return write_result(s, met, found, 0.99);
}

btf_status btfi_cmf_meet_target(btfi_cmf_fitting *f, const btf_dataset_desc *desc, uint32_t most_entries,
                                uint32_t most_terms, double from) {
  search *s = f->host->alloc(f->ctx, 1, sizeof *s);
  if (s == NULL) return BTF_E_NOMEM;
  memset(s, 0, sizeof *s);
  s->f = f;
  s->desc = desc;
  s->library = f->host;
  s->payload = f->payload;
  s->stage = stage_of_terms(f);
  s->most_terms = most_terms;
  s->error = INFINITY;
  /* As many entries as texels save nothing. */
  while (s->sizes < 17 && 1u << s->sizes <= most_entries && 1u << s->sizes < f->level_first[1]) s->sizes++;
  s->most_entries = s->sizes > 0 ? 1u << (s->sizes - 1) : 0;
  trial_init(&s->now, f->host, f->ctx);
  trial_init(&s->best, f->host, f->ctx);
  const btf_status status = run(s, from);
  trial_clear(&s->now);
  trial_clear(&s->best);
  f->host->free(f->ctx, s);
  return status;
}
