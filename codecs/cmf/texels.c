/* SPDX-License-Identifier: MIT */
/* texels.c: the ABRDFs of a level become normalised maps and scales. */
#include <math.h>

#include "fit.h"

uint64_t btfi_cmf_place(const btfi_cmf_choice *choice, uint64_t texel) {
  if (!choice->sampled)
    return texel >= choice->first && texel - choice->first < choice->count ? texel - choice->first
                                                                           : UINT64_MAX;
  /* Strata begin at floor(i * texels / count). */
  uint64_t stratum = texel * choice->count / choice->texels;
  while (stratum + 1 < choice->count && (stratum + 1) * choice->texels / choice->count <= texel) stratum++;
  const uint64_t begin = stratum * choice->texels / choice->count;
  const uint64_t end = (stratum + 1) * choice->texels / choice->count;
  uint64_t random = choice->seed + stratum;
  return begin + btf_random_u64(&random) % (end - begin) == texel ? stratum : UINT64_MAX;
}

typedef struct visit {
  btfi_cmf_fitting *f;
  const btfi_cmf_choice *choice;
  uint32_t level;
  uint64_t first, count; /* places that are collected, for the homomorphic method */
  bool reports;          /* errors are those of the finest level, each texel once: not of a sample of it */
} visit;

/* Parts of a thread's scratch. */
typedef struct parts {
  void *factor;
  float *maps, *turned, *half_way;
} parts;

static parts parts_of(const btfi_cmf_fitting *f, uint32_t thread) {
  unsigned char *base = f->scratch + thread * f->thread_bytes;
  const uint64_t maps = ((uint64_t)f->factors * f->map_values * sizeof(float) + 63) / 64 * 64;
  const uint64_t abrdf = ((uint64_t)f->pairs * f->channels * sizeof(float) + 63) / 64 * 64;
  parts p = {base, NULL, NULL, NULL};
  base += f->geometry->scratch_bytes;
  p.maps = (float *)(void *)base;
  p.turned = (float *)(void *)(base + maps);
  p.half_way = (float *)(void *)(base + maps + abrdf);
  return p;
}

/* Scales the values of one channel of a map to a largest magnitude of 1; returns what it was. */
static float normalise(float *map, uint32_t texels, uint32_t channels) {
  float most = 0.0f;
  for (uint32_t t = 0; t < texels; t++) most = fmaxf(most, fabsf(map[(size_t)t * channels]));
  if (!(most > 0.0f)) return 0.0f;
  for (uint32_t t = 0; t < texels; t++) {
    float *value = &map[(size_t)t * channels];
    const float scaled = *value / most;
    *value = scaled > 1.0f ? 1.0f : scaled < -1.0f ? -1.0f : scaled;
  }
  return most;
}

/* Suykens et al. 2003, section 5: all scales of the first terms are merged into one; those of a later term
 * stay relative to the first of its stage. */
static void normalise_texel(const btfi_cmf_fitting *f, float *maps, float *scale) {
  const uint32_t channels = f->channels;
  for (uint32_t c = 0; c < channels; c++) {
    double merged = 1.0, of_first = 1.0, of_term = 1.0;
    for (uint32_t i = 0; i < f->factors; i++) {
      const btfi_cmf_factor *factor = &f->geometry->factor[i];
      const double most =
          (double)normalise(maps + (size_t)i * f->map_values + c, f->geometry->map_texels, channels);
      of_term = factor->side == 0 ? most : of_term * most;
      const bool ends = i + 1 == f->factors || f->geometry->factor[i + 1].side == 0;
      if (!ends) continue;
      if (factor->term == 0) {
        of_first = of_term;
        merged *= of_first;
      } else {
        scale[f->term_scale[i] * channels + c] = of_first > 0.0 ? (float)fmin(of_term / of_first, 1e6) : 0.0f;
      }
    }
    scale[c] = (float)fmin(merged, (double)CMF_LARGEST_SCALE);
  }
}

/* Takes the maps of one texel, which are normalised in place, and the energy of what they stand for. */
static void take_maps(btfi_cmf_fitting *f, uint32_t level, uint64_t texel, uint64_t place, const float *abrdf,
                      float *maps) {
  for (uint32_t c = 0; c < f->channels && f->energy != NULL; c++) {
    double *energy = &f->energy[(f->level_first[level] + texel) * f->channels + c];
    *energy = 0.0;
    for (uint32_t p = 0; p < f->pairs; p++) {
      const double value = (double)abrdf[(size_t)p * f->channels + c];
      *energy += value * value;
    }
  }
  normalise_texel(f, maps, f->scale + (f->level_first[level] + texel) * f->scales * f->channels);
  const uint64_t bytes =
      (uint64_t)f->map_values * btfi_cmf_value_bytes(f->to_store ? f->store_kind : f->storage);
  for (uint32_t i = 0; i < f->factors; i++) {
    const float *map = maps + (size_t)i * f->map_values;
    if (f->to_store)
      btfi_cmf_store(f->store_kind, f->has_sign[i], map, f->map_values,
                     f->store + (f->store_first + place) * f->record_bytes + i * bytes);
    else
      btfi_cmf_store(f->storage, f->has_sign[i], map, f->map_values, f->table[level][i] + texel * bytes);
  }
}

/* The ABRDF turned, if that is asked for. */
static const float *turn(btfi_cmf_fitting *f, uint32_t level, uint64_t texel, const float *abrdf,
                         float *half_way, float *turned) {
  if (!f->rotate) return abrdf;
  const uint32_t angle = btfi_cmf_anisotropy(&f->rotation, f->channels, abrdf);
  f->angle[f->level_first[level] + texel] = (unsigned char)angle;
  if (angle == 0) return abrdf;
  btfi_cmf_rotate(&f->rotation, f->channels, angle, abrdf, half_way, turned);
  return turned;
}

/* Where a thread reports to; `unused` takes what is not reported. */
static btfi_cmf_report *report_of(const visit *v, uint32_t thread, btfi_cmf_report *unused) {
  return v->reports ? &v->f->report[thread] : unused;
}

static void visit_texel(void *user, uint32_t level, uint32_t x, uint32_t y, const float *abrdf,
                        uint32_t thread) {
  const visit *v = user;
  btfi_cmf_fitting *f = v->f;
  const uint64_t texel = (uint64_t)y * btf_sampling_level_size(f->width, level) + x;
  const uint64_t place = btfi_cmf_place(v->choice, texel);
  if (place == UINT64_MAX) return;
  const parts p = parts_of(f, thread);
  if (f->hf != NULL) {
    if (place < v->first || place - v->first >= v->count) return;
    const size_t length = (size_t)f->pairs * f->channels;
    const float *turned = turn(f, level, texel, abrdf, p.half_way, p.turned);
    memcpy(f->collected + (place - v->first) * length, turned, length * sizeof *turned);
    return;
  }
  const float *turned = turn(f, level, texel, abrdf, p.half_way, p.turned);
  btfi_cmf_report unused = {0};
  btfi_cmf_factor_abrdf(f->geometry, f->channels, turned, p.factor, p.maps, report_of(v, thread, &unused));
  take_maps(f, level, texel, place, turned, p.maps);
}

/* ---- the homomorphic method: ABRDFs are collected and solved for together ---- */

typedef struct solved {
  visit *v;
  const uint64_t *texel; /* of each place collected */
  uint64_t first;        /* of this batch, among the collected */
  float *maps;
} solved;

static void take_solved(void *job, uint32_t index, uint32_t thread) {
  const solved *s = job;
  btfi_cmf_fitting *f = s->v->f;
  const uint64_t place = s->first + index, texel = s->texel[place];
  float *maps = s->maps + (size_t)index * f->factors * f->map_values;
  const float *abrdf = f->collected + place * f->pairs * f->channels;
  if (s->v->reports)
    btfi_cmf_measure(f->geometry, f->channels, abrdf, parts_of(f, thread).factor, maps, &f->report[thread]);
  take_maps(f, s->v->level, texel, s->v->first + place, abrdf, maps);
}

static btf_status solve_collected(visit *v, const uint64_t *texel, float *maps, double from, double to) {
  btfi_cmf_fitting *f = v->f;
  const uint64_t length = (uint64_t)f->pairs * f->channels;
  for (uint64_t first = 0; first < v->count; first += CMF_SOLVE_TOGETHER) {
    const uint32_t count =
        v->count - first < CMF_SOLVE_TOGETHER ? (uint32_t)(v->count - first) : CMF_SOLVE_TOGETHER;
    solved batch = {v, texel, first, maps};
    BTF_TRY(btfi_cmf_hf_solve(f->host, f->ctx, f->hf, count, f->channels, f->collected + first * length,
                              length, f->floor, maps, (uint64_t)f->factors * f->map_values));
    BTF_TRY(f->host->parallel(f->ctx, count, take_solved, &batch));
    BTF_TRY(f->host->progress(f->job, from + (to - from) * (double)first / (double)v->count, "factoring"));
  }
  return BTF_OK;
}

static btf_status solve_texels(visit *v, uint64_t *texel, float *maps, double from, double to) {
  btfi_cmf_fitting *f = v->f;
  const uint64_t places = v->choice->count;
  for (v->first = 0; v->first < places; v->first += f->collect) {
    v->count = places - v->first < f->collect ? places - v->first : f->collect;
    const double begin = from + (to - from) * (double)v->first / (double)places;
    const double end = from + (to - from) * (double)(v->first + v->count) / (double)places;
    for (uint64_t t = 0; t < v->choice->texels; t++) {
      const uint64_t place = btfi_cmf_place(v->choice, t);
      if (place != UINT64_MAX && place >= v->first && place - v->first < v->count)
        texel[place - v->first] = t;
    }
    BTF_TRY(f->host->visit_abrdfs(f->ctx, f->ds, v->level, btfi_cmf_left(f), visit_texel, v, f->job, begin,
                                  begin + 0.2 * (end - begin), "reading"));
    BTF_TRY(solve_collected(v, texel, maps, begin + 0.2 * (end - begin), end));
  }
  return BTF_OK;
}

btf_status btfi_cmf_factor_texels(btfi_cmf_fitting *f, uint32_t level, const btfi_cmf_choice *choice,
                                  double from, double to) {
  visit v = {f, choice, level, 0, choice->count, level == 0 && !choice->sampled};
  if (v.reports && choice->first == 0) memset(f->report, 0, f->threads * sizeof *f->report);
  if (f->hf == NULL)
    return f->host->visit_abrdfs(f->ctx, f->ds, level, btfi_cmf_left(f), visit_texel, &v, f->job, from, to,
                                 "factoring");
  uint64_t *texel = f->host->alloc(f->ctx, f->collect, sizeof *texel);
  float *maps =
      f->host->alloc(f->ctx, CMF_SOLVE_TOGETHER, (uint64_t)f->factors * f->map_values * sizeof *maps);
  btf_status status = texel != NULL && maps != NULL ? BTF_OK : BTF_E_NOMEM;
  if (status == BTF_OK) status = solve_texels(&v, texel, maps, from, to);
  f->host->free(f->ctx, texel);
  f->host->free(f->ctx, maps);
  return status;
}
