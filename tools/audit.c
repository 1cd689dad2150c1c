/* SPDX-License-Identifier: MIT */
/* audit.c: one reading of all samples, a view at a time in each thread. */
#include "audit.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "audit_parts.h"
#include "parallel.h"

/* What one thread has seen. */
typedef struct auditor {
  float *block;
  float *low, *high; /* of each texel and channel, over directions */
  double *albedo;    /* of each texel for the present view */
  audit seen;
  uint32_t bad_texels;
  btf_status status;
  char message[512];
} auditor;

typedef struct audit_run_state {
  cli *c;
  const sample_source *source;
  const double *weights; /* of lights in the directional albedo of stored values */
  uint32_t block_lights;
  auditor *auditors;
  audit *result;
  bool interrupted;
} audit_run_state;

static bool earlier(const audit_place *a, const audit_place *b) {
  if (a->view != b->view) return a->view < b->view;
  if (a->light != b->light) return a->light < b->light;
  return a->y != b->y ? a->y < b->y : a->x < b->x;
}

/* ---- reading what may hold NaN ---- */

/* Reads texels of one picture. */
static btf_status read_texels(const sample_source *s, uint32_t view, uint32_t light, const btf_block *part,
                              float *picture) {
  const ptrdiff_t x = (ptrdiff_t)(s->channels * sizeof(float)), y = x * (ptrdiff_t)s->width;
  const btf_strides strides = {0, 0, y, x, sizeof(float)};
  float *dst = picture + ((size_t)part->y0 * s->width + part->x0) * s->channels;
  btf_block block = *part;
  block.view0 = view;
  block.light0 = light;
  return btf_dataset_read(s->dataset, &block, dst, &strides);
}

/* To tell the texels of all pictures apart would take hours where all are bad. */
enum { MOST_BAD_TEXELS = 1 << 16 };

/* Where they cannot be read halves of them, and a texel alone becomes NaN; so do all of a part once `bad` of
 * this thread are many. */
static btf_status read_part(const sample_source *s, uint32_t view, uint32_t light, const btf_block *part,
                            uint32_t *bad, float *picture) {
  const btf_status status = read_texels(s, view, light, part, picture);
  if (status != BTF_E_CORRUPT) return status;
  if ((part->width == 1 && part->height == 1) || *bad >= MOST_BAD_TEXELS) {
    for (uint32_t y = part->y0; y < part->y0 + part->height; y++) {
      float *dst = picture + ((size_t)y * s->width + part->x0) * s->channels;
      for (uint32_t i = 0; i < part->width * s->channels; i++) dst[i] = NAN;
    }
    if (*bad < MOST_BAD_TEXELS) ++*bad;
    return BTF_OK;
  }
  btf_block first = *part, second = *part;
  if (part->height > 1) {
    first.height = part->height / 2;
    second.y0 += first.height;
    second.height -= first.height;
  } else {
    first.width = part->width / 2;
    second.x0 += first.width;
    second.width -= first.width;
  }
  const btf_status halves = read_part(s, view, light, &first, bad, picture);
  return halves == BTF_OK ? read_part(s, view, light, &second, bad, picture) : halves;
}

/* A sample that is not finite is named by its place. What is said alike of two texels is of the picture,
 * which is damaged. */
static bool is_damaged(const sample_source *s, uint32_t view, uint32_t light, float *picture) {
  const btf_block corners[] = {{0, 1, 0, 1, 0, 0, 1, 1}, {0, 1, 0, 1, s->width - 1, s->height - 1, 1, 1}};
  char first[512];
  if (s->width == 1 && s->height == 1) return false;
  if (read_texels(s, view, light, &corners[0], picture) != BTF_E_CORRUPT) return false;
  snprintf(first, sizeof first, "%s", btf_error_message());
  return read_texels(s, view, light, &corners[1], picture) == BTF_E_CORRUPT &&
         strcmp(first, btf_error_message()) == 0;
}

static btf_status read_lights(const sample_source *s, uint32_t view, uint32_t light0, uint32_t lights,
                              uint32_t *bad, float *dst) {
  const btf_status status = sample_source_read(s, view, light0, lights, dst);
  if (status != BTF_E_CORRUPT || s->dataset == NULL) return status;
  const btf_block whole = {0, 1, 0, 1, 0, 0, s->width, s->height};
  for (uint32_t l = 0; l < lights; l++) {
    float *picture = dst + (size_t)l * sample_source_image_values(s);
    if (is_damaged(s, view, light0 + l, picture)) return BTF_E_CORRUPT;
    const btf_status one = read_part(s, view, light0 + l, &whole, bad, picture);
    if (one != BTF_OK) return one;
  }
  return BTF_OK;
}

/* ---- one picture ---- */

static void note(uint64_t *count, audit_place *first, const audit_place *place) {
  if (*count == 0 || earlier(place, first)) *first = *place;
  (*count)++;
}

static void note_extremes(audit *a, float value, float cosine, uint32_t view) {
  if (value < a->least) a->least = value;
  if (value > a->most) {
    a->most = value;
    a->at_most = a->most_views = 0;
    a->most_low = a->most_high = cosine;
  }
  if (value != a->most) return;
  a->most_low = fminf(a->most_low, cosine);
  a->most_high = fmaxf(a->most_high, cosine);
  if (a->most_views == 0 || a->most_in_view != view) a->most_views++;
  a->most_in_view = view;
  a->at_most++;
}

static void audit_picture(const audit_run_state *s, auditor *w, uint32_t view, uint32_t light,
                          const float *picture) {
  const sample_source *source = s->source;
  const uint64_t texels = (uint64_t)source->width * source->height;
  const float cosine = btf_dirset_directions(source->light_set)[3 * light + 2];
  double sum = 0;
  uint64_t finite = 0;
  bool black = true;
  for (uint64_t t = 0; t < texels; t++) {
    const audit_place place = {(uint32_t)(t % source->width), (uint32_t)(t / source->width), light, view};
    double of_texel = 0;
    for (uint32_t c = 0; c < source->channels; c++) {
      const float value = picture[t * source->channels + c];
      if (!isfinite(value)) {
        note(&w->seen.not_finite, &w->seen.first_not_finite, &place);
        black = false;
        continue;
      }
      if (value < 0) note(&w->seen.negative, &w->seen.first_negative, &place);
      if (value != 0) black = false;
      note_extremes(&w->seen, value, cosine, view);
      const uint64_t k = t * source->channels + c;
      if (value < w->low[k]) w->low[k] = value;
      if (value > w->high[k]) w->high[k] = value;
      of_texel += value;
      finite++;
    }
    sum += of_texel;
    w->albedo[t] += s->weights[light] * of_texel / source->channels;
  }
  s->result->mean[(size_t)view * source->lights + light] = finite > 0 ? sum / (double)finite : (double)NAN;
  if (black) {
    const audit_place place = {0, 0, light, view};
    if (w->seen.missing == 0 || earlier(&place, &w->seen.first_missing)) w->seen.first_missing = place;
    w->seen.missing++;
  }
}

static void end_view(const audit_run_state *s, auditor *w, uint32_t view) {
  const uint64_t texels = (uint64_t)s->source->width * s->source->height;
  double sum = 0;
  for (uint64_t t = 0; t < texels; t++) {
    sum += w->albedo[t];
    if (!(w->albedo[t] > w->seen.worst_albedo)) continue;
    w->seen.worst_albedo = w->albedo[t];
    w->seen.worst_texel =
        (audit_place){(uint32_t)(t % s->source->width), (uint32_t)(t / s->source->width), 0, view};
  }
  if (sum / (double)texels > w->seen.albedo) {
    w->seen.albedo = sum / (double)texels;
    w->seen.albedo_view = view;
  }
}

static bool audit_view(void *user, uint64_t index, uint32_t thread) {
  audit_run_state *s = user;
  auditor *w = &s->auditors[thread];
  const sample_source *source = s->source;
  const uint64_t image_values = sample_source_image_values(source);
  const uint32_t view = (uint32_t)index;
  memset(w->albedo, 0, (size_t)source->width * source->height * sizeof *w->albedo);
  for (uint32_t light0 = 0; light0 < source->lights; light0 += s->block_lights) {
    const uint32_t left = source->lights - light0, lights = left < s->block_lights ? left : s->block_lights;
    w->status = read_lights(source, view, light0, lights, &w->bad_texels, w->block);
    if (w->status != BTF_OK) {
      snprintf(w->message, sizeof w->message, "%s", btf_error_message());
      return false;
    }
    for (uint32_t l = 0; l < lights; l++) audit_picture(s, w, view, light0 + l, w->block + l * image_values);
    if (thread == 0 &&
        cli_progress(s->c, ((double)view + (double)light0 / source->lights) / source->views, "checking")) {
      s->interrupted = true;
      return false;
    }
  }
  end_view(s, w, view);
  return true;
}

/* ---- all together ---- */

static void merge(audit *all, const audit *part) {
  if (part->not_finite > 0 &&
      (all->not_finite == 0 || earlier(&part->first_not_finite, &all->first_not_finite)))
    all->first_not_finite = part->first_not_finite;
  if (part->negative > 0 && (all->negative == 0 || earlier(&part->first_negative, &all->first_negative)))
    all->first_negative = part->first_negative;
  if (part->missing > 0 && (all->missing == 0 || earlier(&part->first_missing, &all->first_missing)))
    all->first_missing = part->first_missing;
  all->not_finite += part->not_finite;
  all->negative += part->negative;
  all->missing += part->missing;
  all->least = fmin(all->least, part->least);
  if (part->most == all->most) {
    all->at_most += part->at_most;
    all->most_views += part->most_views;
    all->most_low = fminf(all->most_low, part->most_low);
    all->most_high = fmaxf(all->most_high, part->most_high);
  } else if (part->most > all->most) {
    all->at_most = part->at_most;
    all->most_views = part->most_views;
    all->most_low = part->most_low;
    all->most_high = part->most_high;
  }
  all->most = fmax(all->most, part->most);
  if (part->albedo > all->albedo || (part->albedo == all->albedo && part->albedo_view < all->albedo_view)) {
    all->albedo = part->albedo;
    all->albedo_view = part->albedo_view;
  }
  if (part->worst_albedo > all->worst_albedo) {
    all->worst_albedo = part->worst_albedo;
    all->worst_texel = part->worst_texel;
  }
}

/* The range of a texel's channel over all directions; false if it has none. */
static bool range(const audit_run_state *s, uint64_t k, float *low, float *high) {
  *low = s->auditors[0].low[k];
  *high = s->auditors[0].high[k];
  for (uint32_t t = 1; t < s->c->threads; t++) {
    *low = fminf(*low, s->auditors[t].low[k]);
    *high = fmaxf(*high, s->auditors[t].high[k]);
  }
  return *high >= *low;
}

static void find_dead(const audit_run_state *s) {
  const sample_source *source = s->source;
  const bool matte =
      s->result->most_views == source->views && s->result->most_high - s->result->most_low < 1e-3f;
  const uint64_t texels = (uint64_t)source->width * source->height;
  for (uint64_t t = 0; t < texels; t++) {
    bool varies = false;
    for (uint32_t c = 0; c < source->channels; c++) {
      float low, high;
      if (!range(s, t * source->channels + c, &low, &high)) continue;
      if (high > low) varies = true;
      /* What varies by rounding alone is not cut off. */
      if (!matte && 0.99f * high > low && high == (float)s->result->most) s->result->cut_off = true;
    }
    if (!varies && s->result->dead++ == 0)
      s->result->first_dead =
          (audit_place){(uint32_t)(t % source->width), (uint32_t)(t / source->width), 0, 0};
  }
}

/* A lobe that falls between lights weighs too much when it meets one. */
static void find_albedo_but_one(const audit_run_state *s, audit *a) {
  for (uint32_t v = 0; v < s->source->views; v++) {
    double sum = 0, largest = 0;
    for (uint32_t l = 0; l < s->source->lights; l++) {
      const double part = s->weights[l] * a->mean[(size_t)v * s->source->lights + l];
      if (!(part > 0)) continue;
      sum += part;
      largest = fmax(largest, part);
    }
    a->albedo_but_one = fmax(a->albedo_but_one, sum - largest);
  }
}

static int prepare(audit_run_state *s) {
  const size_t texels = (size_t)s->source->width * s->source->height, values = texels * s->source->channels;
  for (uint32_t k = 0; k < s->c->threads; k++) {
    auditor *w = &s->auditors[k];
    w->block = malloc((size_t)sample_source_image_values(s->source) * s->block_lights * sizeof(float));
    w->low = malloc(values * sizeof(float));
    w->high = malloc(values * sizeof(float));
    w->albedo = malloc(texels * sizeof(double));
    if (w->block == NULL || w->low == NULL || w->high == NULL || w->albedo == NULL)
      return cli_out_of_memory();
    for (size_t t = 0; t < values; t++) {
      w->low[t] = INFINITY;
      w->high[t] = -INFINITY;
    }
    w->seen = (audit){.least = (double)INFINITY, .most = -(double)INFINITY};
  }
  return EXIT_DONE;
}

static int read_all(audit_run_state *s) {
  int failed = prepare(s);
  if (failed) return failed;
  const bool done = parallel_for(s->c->threads, s->source->views, audit_view, s);
  cli_progress_done(s->c);
  if (done) return EXIT_DONE;
  for (uint32_t k = 0; k < s->c->threads; k++)
    if (s->auditors[k].status != BTF_OK)
      return cli_fail(cli_exit_of(s->auditors[k].status), "%s", s->auditors[k].message);
  return cli_fail_interrupted();
}

int audit_run(cli *c, const sample_source *source, audit *out) {
  audit_run_state s = {.c = c, .source = source, .result = out};
  double *weights = malloc(source->lights * sizeof *weights);
  *out = (audit){.least = (double)INFINITY, .most = -(double)INFINITY};
  out->mean = malloc((size_t)source->views * source->lights * sizeof *out->mean);
  out->values = (uint64_t)source->views * source->lights * sample_source_image_values(source);
  s.auditors = calloc(c->threads, sizeof *s.auditors);
  s.block_lights = sample_source_block_lights(source);
  s.weights = weights;
  int failed = weights != NULL && out->mean != NULL && s.auditors != NULL ? EXIT_DONE : cli_out_of_memory();
  if (!failed) {
    audit_light_weights(source, weights);
    failed = read_all(&s);
  }
  if (!failed) {
    for (uint32_t k = 0; k < c->threads; k++) merge(out, &s.auditors[k].seen);
    find_dead(&s);
    find_albedo_but_one(&s, out);
    failed = audit_directions(source, out);
  }
  for (uint32_t k = 0; s.auditors != NULL && k < c->threads; k++) {
    free(s.auditors[k].block);
    free(s.auditors[k].low);
    free(s.auditors[k].high);
    free(s.auditors[k].albedo);
  }
  free(s.auditors);
  free(weights);
  if (failed) audit_free(out);
  return failed;
}

void audit_free(audit *result) {
  free(result->mean);
  result->mean = NULL;
}
