/* SPDX-License-Identifier: MIT */
/* write.c: Suykens et al. 2003, section 5: codebooks and index maps, or tables with one entry for each texel,
 * and the scale maps. */
#include <math.h>

#include "fit.h"

/* ---- records of all texels ---- */

static bool stores_all(const btfi_cmf_fitting *f) {
  return f->store != NULL && f->capacity >= f->level_first[f->levels];
}

/* Factors all texels into the store; with a target, once for all sizes that are tried. */
static btf_status make_records(btfi_cmf_fitting *f, double from, double to) {
  const double total = (double)f->level_first[f->levels];
  const size_t scale_bytes = f->level_first[f->levels] * f->scales * f->channels * sizeof *f->scale;
  if (f->has_records) {
    memcpy(f->scale, f->kept_scale, scale_bytes);
    return BTF_OK;
  }
  f->to_store = true;
  for (uint32_t level = 0; level < f->levels; level++) {
    const uint64_t texels = btfi_cmf_level_texels(f, level);
    const btfi_cmf_choice all = {.count = texels, .texels = texels};
    f->store_first = f->level_first[level];
    BTF_TRY(btfi_cmf_factor_texels(f, level, &all, from + (to - from) * (double)f->level_first[level] / total,
                                   from + (to - from) * (double)f->level_first[level + 1] / total));
  }
  if (f->kept_scale == NULL) return BTF_OK;
  memcpy(f->kept_scale, f->scale, scale_bytes);
  f->has_records = true;
  return BTF_OK;
}

/* ---- without codebooks ---- */

/* Deals the records of a level out to the tables of its factors. */
static void copy_records(const btfi_cmf_fitting *f, uint32_t level, uint64_t map_bytes) {
  for (uint64_t t = 0; t < btfi_cmf_level_texels(f, level); t++) {
    const unsigned char *record = f->store + (f->level_first[level] + t) * f->record_bytes;
    for (uint32_t i = 0; i < f->factors; i++)
      memcpy(f->table[level][i] + t * map_bytes, record + i * map_bytes, map_bytes);
  }
}

static btf_status write_tables(btfi_cmf_fitting *f, double from, double to) {
  const uint64_t bytes = (uint64_t)f->map_values * btfi_cmf_value_bytes(f->storage);
  const double total = (double)f->level_first[f->levels];
  const bool has_records = stores_all(f) && f->store_kind == f->storage;
  if (has_records) BTF_TRY(make_records(f, from, to));
  f->to_store = false;
  for (uint32_t level = 0; level < f->levels; level++) {
    const uint64_t texels = btfi_cmf_level_texels(f, level);
    const btfi_cmf_choice all = {.count = texels, .texels = texels};
    for (uint32_t i = 0; i < f->factors; i++) {
      void *table;
      BTF_TRY(f->host->reserve(f->payload, CMF_TAG_MAPS, level * CMF_MAX_FACTORS + i, BTF_PAYLOAD_IN_PLACE,
                               texels * bytes, &table));
      f->table[level][i] = table;
    }
    if (has_records)
      copy_records(f, level, bytes);
    else
      BTF_TRY(btfi_cmf_factor_texels(f, level, &all,
                                     from + (to - from) * (double)f->level_first[level] / total,
                                     from + (to - from) * (double)f->level_first[level + 1] / total));
  }
  return BTF_OK;
}

/* ---- codebooks ---- */

/* One factor of a run of records, for the clustering; or of a sample of them. */
typedef struct factor_vectors {
  const btfi_cmf_fitting *f;
  uint32_t factor;
  uint64_t first;
  const uint32_t *sample; /* records, or NULL: all */
} factor_vectors;

static void read_vector(const void *user, uint64_t index, float *dst) {
  const factor_vectors *v = user;
  const btfi_cmf_fitting *f = v->f;
  const uint64_t record = v->first + (v->sample != NULL ? v->sample[index] : index);
  const uint64_t bytes = (uint64_t)f->map_values * btfi_cmf_value_bytes(f->store_kind);
  btfi_cmf_restore(f->store_kind, f->has_sign[v->factor],
                   f->store + record * f->record_bytes + v->factor * bytes, f->map_values, dst);
}

typedef struct codebooks {
  btfi_cmf_fitting *f;
  btfi_cmf_codebook book[CMF_MAX_FACTORS]; /* values as stored and decoded */
  uint32_t *index;                         /* factors x records of a run */
  unsigned char *table[CMF_MAX_LEVELS];    /* index maps of the payload */
  uint32_t index_bytes;
} codebooks;

/* Scales the entries to a largest magnitude of 1 and writes them; keeps what the payload's values decode to.
 */
static btf_status store_codebook(codebooks *b, uint32_t factor) {
  btfi_cmf_fitting *f = b->f;
  btfi_cmf_codebook *book = &b->book[factor];
  const uint64_t values = (uint64_t)book->entries * f->map_values;
  void *maps;
  BTF_TRY(f->host->reserve(f->payload, CMF_TAG_MAPS, factor, BTF_PAYLOAD_IN_PLACE,
                           values * btfi_cmf_value_bytes(f->storage), &maps));
  for (uint64_t entry = 0; entry < (uint64_t)book->entries * f->channels; entry++) {
    float *value = book->values + entry / f->channels * f->map_values + entry % f->channels, most = 0.0f;
    for (uint32_t t = 0; t < f->map_values; t += f->channels) most = fmaxf(most, fabsf(value[t]));
    for (uint32_t t = 0; t < f->map_values && most > 0.0f; t += f->channels)
      value[t] = fminf(fmaxf(value[t] / most, -1.0f), 1.0f);
  }
  btfi_cmf_store(f->storage, f->has_sign[factor], book->values, values, maps);
  btfi_cmf_restore(f->storage, f->has_sign[factor], maps, values, book->values);
  return BTF_OK;
}

/* Trains on all records of a run, or the sample. */
static btf_status train(codebooks *b, uint64_t records, const uint32_t *sample, double from, double to) {
  btfi_cmf_fitting *f = b->f;
  uint32_t most = 1;
  for (uint32_t i = 0; i < f->factors; i++) {
    const factor_vectors user = {f, i, 0, sample};
    const btfi_cmf_vectors vectors = {records, f->map_values, read_vector, &user};
    const btfi_cmf_cluster_options options = {.method = f->clustering,
                                              .entries = f->entries,
                                              .seed = f->job->seed + i,
                                              .max_working_set = btfi_cmf_left(f)};
    BTF_TRY(btfi_cmf_cluster(f->host, f->ctx, &vectors, &options, f->job, from + (to - from) * i / f->factors,
                             from + (to - from) * (i + 1) / f->factors, "clustering", &b->book[i]));
    f->used += 4 * ((uint64_t)b->book[i].entries * f->map_values + records);
    BTF_TRY(store_codebook(b, i));
    if (b->book[i].entries > most) most = b->book[i].entries;
  }
  b->index_bytes = most <= 256 ? 1 : 2;
  for (uint32_t level = 0; level < f->levels; level++) {
    void *table;
    BTF_TRY(f->host->reserve(f->payload, CMF_TAG_INDEX, level, 0,
                             btfi_cmf_level_texels(f, level) * f->factors * b->index_bytes, &table));
    b->table[level] = table;
  }
  return BTF_OK;
}

/* A run of records and the texels they are of. */
typedef struct run {
  codebooks *b;
  uint64_t first_record, records, first_texel; /* texels counted over all levels */
} run;

/* <p, entry> / <entry, entry> of one channel. */
static double gain_of(const float *p, const float *entry, uint32_t values, uint32_t channels) {
  double product = 0.0, square = 0.0;
  for (uint32_t t = 0; t < values; t += channels) {
    product += (double)p[t] * (double)entry[t];
    square += (double)entry[t] * (double)entry[t];
  }
  return square > 0.0 ? fmax(product / square, 0.0) : 0.0;
}

/* An entry replaces a factor times the gain of least error, which goes into the scales. */
static void adjust_channel(const run *r, uint64_t record, uint32_t channel, float *map) {
  btfi_cmf_fitting *f = r->b->f;
  float *scale = f->scale + (r->first_texel + record) * f->scales * f->channels + channel;
  double of_first = 1.0, of_term = 1.0;
  for (uint32_t i = 0; i < f->factors; i++) {
    const factor_vectors user = {f, i, r->first_record, NULL};
    const uint32_t entry = r->b->index[i * r->records + record];
    read_vector(&user, record, map);
    const double gain = gain_of(map + channel, r->b->book[i].values + (size_t)entry * f->map_values + channel,
                                f->map_values, f->channels);
    of_term = f->geometry->factor[i].side == 0 ? gain : of_term * gain;
    if (i + 1 < f->factors && f->geometry->factor[i + 1].side != 0) continue;
    if (f->geometry->factor[i].term == 0) {
      of_first = of_term;
      scale[0] *= (float)of_first;
    } else {
      float *ratio = &scale[(size_t)f->term_scale[i] * f->channels];
      *ratio = of_first > 0.0 ? (float)fmin((double)*ratio * of_term / of_first, 1e6) : 0.0f;
    }
  }
}

static void take_record(void *job, uint32_t index, uint32_t thread) {
  const run *r = job;
  btfi_cmf_fitting *f = r->b->f;
  uint32_t level = 0;
  const uint64_t texel = r->first_texel + index;
  while (texel >= f->level_first[level + 1]) level++;
  unsigned char *to = r->b->table[level] + (texel - f->level_first[level]) * f->factors * r->b->index_bytes;
  for (uint32_t i = 0; i < f->factors; i++) {
    const uint32_t entry = r->b->index[i * r->records + index];
    to[i * r->b->index_bytes] = (unsigned char)entry;
    if (r->b->index_bytes == 2) to[2 * i + 1] = (unsigned char)(entry >> 8);
  }
  float *map = (float *)(void *)(f->scratch + thread * f->thread_bytes);
  for (uint32_t c = 0; c < f->channels; c++) adjust_channel(r, index, c, map);
}

/* Finds the entries of a run of records, unless training already did. */
static btf_status assign(codebooks *b, uint64_t first_record, uint64_t records, uint64_t first_texel,
                         bool trained, double from, double to) {
  btfi_cmf_fitting *f = b->f;
  run r = {b, first_record, records, first_texel};
  b->index = f->host->alloc(f->ctx, (uint64_t)f->factors * records, sizeof *b->index);
  if (b->index == NULL) return BTF_E_NOMEM;
  for (uint32_t i = 0; i < f->factors; i++) {
    const factor_vectors user = {f, i, first_record, NULL};
    const btfi_cmf_vectors vectors = {records, f->map_values, read_vector, &user};
    const uint64_t indices = 4 * (uint64_t)f->factors * records;
    if (trained) {
      memcpy(b->index + i * records, b->book[i].index, records * sizeof *b->index);
      continue;
    }
    BTF_TRY(btfi_cmf_assign(f->host, f->ctx, &vectors, b->book[i].values, b->book[i].entries,
                            btfi_cmf_left(f) > indices ? btfi_cmf_left(f) - indices : 1, f->job,
                            from + (to - from) * i / f->factors, from + (to - from) * (i + 1) / f->factors,
                            "clustering", b->index + i * records, NULL));
  }
  BTF_TRY(f->host->parallel(f->ctx, (uint32_t)records, take_record, &r));
  f->host->free(f->ctx, b->index);
  b->index = NULL;
  return BTF_OK;
}

/* All records fit: texels are factored once. */
static btf_status write_together(codebooks *b, double from, double to) {
  btfi_cmf_fitting *f = b->f;
  const uint64_t total = f->level_first[f->levels], samples = f->samples < total ? f->samples : total;
  const double factored = from + 0.7 * (to - from), trained = from + 0.9 * (to - from);
  uint32_t *sample = NULL;
  BTF_TRY(make_records(f, from, factored));
  if (samples < total) {
    const btfi_cmf_choice strata = {.sampled = true, .count = samples, .texels = total, .seed = f->job->seed};
    sample = f->host->alloc(f->ctx, samples, sizeof *sample);
    if (sample == NULL) return BTF_E_NOMEM;
    for (uint64_t t = 0; t < total; t++) {
      const uint64_t place = btfi_cmf_place(&strata, t);
      if (place != UINT64_MAX) sample[place] = (uint32_t)t;
    }
  }
  const btf_status status = train(b, samples, sample, factored, trained);
  f->host->free(f->ctx, sample);
  return status != BTF_OK ? status : assign(b, 0, total, 0, samples == total, trained, to);
}

/* They do not: a sample of the finest level makes the codebooks, then texels are factored and assigned in
 * runs. */
static btf_status write_apart(codebooks *b, double from, double to) {
  btfi_cmf_fitting *f = b->f;
  const uint64_t total = f->level_first[f->levels], finest = btfi_cmf_level_texels(f, 0);
  const double factored = from + 0.15 * (to - from), trained = from + 0.25 * (to - from);
  btfi_cmf_choice strata = {.sampled = true, .count = f->samples, .texels = finest, .seed = f->job->seed};
  if (strata.count > f->capacity) strata.count = f->capacity;
  if (strata.count > finest) strata.count = finest;
  f->to_store = true;
  f->store_first = 0;
  BTF_TRY(btfi_cmf_factor_texels(f, 0, &strata, from, factored));
  BTF_TRY(train(b, strata.count, NULL, factored, trained));
  for (uint32_t level = 0; level < f->levels; level++) {
    const uint64_t texels = btfi_cmf_level_texels(f, level);
    for (uint64_t first = 0; first < texels; first += f->capacity) {
      const btfi_cmf_choice part = {.first = first,
                                    .count = texels - first < f->capacity ? texels - first : f->capacity,
                                    .texels = texels};
      const double begin = trained + (to - trained) * (double)(f->level_first[level] + first) / (double)total;
      const double end =
          trained + (to - trained) * (double)(f->level_first[level] + first + part.count) / (double)total;
      BTF_TRY(btfi_cmf_factor_texels(f, level, &part, begin, begin + 0.9 * (end - begin)));
      BTF_TRY(
          assign(b, 0, part.count, f->level_first[level] + first, false, begin + 0.9 * (end - begin), end));
    }
  }
  return BTF_OK;
}

static btf_status write_codebooks(btfi_cmf_fitting *f, double from, double to) {
  codebooks *b = f->host->alloc(f->ctx, 1, sizeof *b);
  if (b == NULL) return BTF_E_NOMEM;
  memset(b, 0, sizeof *b);
  b->f = f;
  const btf_status status = stores_all(f) ? write_together(b, from, to) : write_apart(b, from, to);
  for (uint32_t i = 0; i < f->factors; i++) btfi_cmf_codebook_free(f->host, f->ctx, &b->book[i]);
  f->host->free(f->ctx, b->index);
  f->host->free(f->ctx, b);
  return status;
}

/* ---- scales, angles and the header ---- */

static btf_status write_scales(btfi_cmf_fitting *f) {
  const uint32_t count = f->scales * f->channels;
  float most[CMF_MAX_SCALES * CMF_MAX_CHANNELS] = {0.0f};
  unsigned char *global;
  void *chunk;
  for (uint64_t t = 0; t < f->level_first[f->levels]; t++)
    for (uint32_t i = 0; i < count; i++) most[i] = fmaxf(most[i], f->scale[t * count + i]);
  for (uint32_t i = 0; i < f->channels; i++)
    if (!(most[i] < CMF_LARGEST_SCALE))
      return f->host->fail(
          f->ctx, BTF_E_NUMERIC,
          "cmf: the largest values of the factors multiply to more than %g; a larger lambda or "
          "log_floor, or smaller samples, would do",
          (double)CMF_LARGEST_SCALE);
  for (uint32_t i = 0; i < f->channels && f->energy != NULL; i++)
    most[i] = btfi_cmf_full_byte(f->level_first[f->levels], f->scale + i, count, f->energy + i, f->channels);
  BTF_TRY(f->host->reserve(f->payload, CMF_TAG_GLOBAL, 0, 0, 4 * (uint64_t)count, &chunk));
  global = chunk;
  for (uint32_t i = 0; i < count; i++) btf_put_f32(global + 4 * (size_t)i, most[i]);
  for (uint32_t level = 0; level < f->levels; level++) {
    const uint64_t texels = btfi_cmf_level_texels(f, level);
    float *scale = f->scale + f->level_first[level] * count;
    for (uint64_t i = 0; i < texels * count; i++)
      scale[i] = most[i % count] > 0.0f ? fminf(scale[i] / most[i % count], 1.0f) : 0.0f;
    BTF_TRY(f->host->reserve(f->payload, CMF_TAG_SCALE, level, BTF_PAYLOAD_IN_PLACE,
                             texels * count * btfi_cmf_value_bytes(f->storage), &chunk));
    btfi_cmf_store(f->storage, false, scale, texels * count, chunk);
    if (f->rotate)
      BTF_TRY(f->host->put(f->payload, CMF_TAG_ANGLE, level, 0, f->angle + f->level_first[level], texels));
  }
  return BTF_OK;
}

static btf_status write_head(const btfi_cmf_fitting *f) {
  unsigned char bytes[CMF_HEAD_BYTES];
  btfi_cmf_head head = {.storage = f->storage,
                        .edge = f->settings.edge,
                        .levels = f->levels,
                        .stages = f->settings.stage_count};
  head.flags = (f->entries > 0 ? CMF_FLAG_CODEBOOK : 0) | (f->rotate ? CMF_FLAG_ROTATED : 0) |
               (f->settings.method == CMF_SVD ? CMF_FLAG_SIGNED : 0) |
               (f->settings.map == CMF_CUBE ? CMF_FLAG_CUBE : 0);
  for (uint32_t s = 0; s < head.stages; s++) {
    const btfi_cmf_stage *stage = &f->settings.stage[s];
    head.stage[s].projection[0] = stage->pair->projection[0];
    head.stage[s].projection[1] = stage->mean ? (uint32_t)CMF_ONE : stage->pair->projection[1];
    head.stage[s].terms = stage->terms;
  }
  btfi_cmf_put_head(&head, bytes);
  return f->host->put(f->payload, CMF_TAG_HEAD, 0, 0, bytes, sizeof bytes);
}

btf_status btfi_cmf_write(btfi_cmf_fitting *f, double from, double to) {
  BTF_TRY(f->entries > 0 ? write_codebooks(f, from, to) : write_tables(f, from, to));
  BTF_TRY(write_scales(f));
  return write_head(f);
}
