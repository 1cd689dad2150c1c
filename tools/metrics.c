/* SPDX-License-Identifier: MIT */
/* metrics.c: sums over all samples of two sources. */
#include "metrics.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "sample_walk.h"

enum { lanes = 8 };

/* One thread's sums. */
typedef struct sums {
  double squared, reference_squared, relative, luma, blue, red, ssim;
  double largest;
  uint64_t different, ssim_images;
  double *texel_squared; /* for each texel */
  float *error;          /* one image */
  float *grey_a, *grey_b;
  double *scratch; /* of ssim_mean */
} sums;

typedef struct comparison {
  const sample_source *reference;
  double floor_of_relative; /* smaller references count as this in the relative error */
  float grey_scale;         /* 1 / peak */
  sums *threads;
  double *pair_squared; /* for each view and light */
  unsigned char *in_ssim;
} comparison;

static double sum_lanes(const double *lane) {
  double total = 0;
  for (int k = 0; k < lanes; k++) total += lane[k];
  return total;
}

/* Errors of one image and the sums over its values; returns the sum of squares. */
static double add_values(const comparison *m, sums *s, const float *a, const float *b, uint64_t n) {
  double squared[lanes] = {0}, reference[lanes] = {0}, relative[lanes] = {0};
  float *error = s->error;
  float largest = 0;
  const float least = (float)m->floor_of_relative;
  uint64_t different = 0, i = 0;
  double total;
  for (uint64_t k = 0; k < n; k++) {
    const float e = b[k] - a[k];
    const float size = fabsf(e);
    error[k] = e;
    different += a[k] != b[k];
    largest = size > largest ? size : largest;
  }
  for (; i + lanes <= n; i += lanes)
    for (int k = 0; k < lanes; k++) {
      const float e = error[i + (uint64_t)k], r = a[i + (uint64_t)k];
      const float size = fabsf(r);
      squared[k] += (double)e * e;
      reference[k] += (double)r * r;
      relative[k] += (double)(fabsf(e) / (size > least ? size : least));
    }
  for (; i < n; i++) {
    const float size = fabsf(a[i]);
    squared[0] += (double)error[i] * error[i];
    reference[0] += (double)a[i] * a[i];
    relative[0] += (double)(fabsf(error[i]) / (size > least ? size : least));
  }
  total = sum_lanes(squared);
  s->squared += total;
  s->reference_squared += sum_lanes(reference);
  s->relative += sum_lanes(relative);
  s->different += different;
  if (largest > s->largest) s->largest = largest;
  return total;
}

static void add_texels(sums *s, uint64_t texels, uint32_t channels) {
  for (uint64_t t = 0; t < texels; t++) {
    double squared = 0;
    for (uint32_t c = 0; c < channels; c++) {
      const double e = s->error[t * channels + c];
      squared += e * e;
    }
    s->texel_squared[t] += squared;
  }
}

/* JPEG's full-range BT.601 components, which are linear: those of the error are the errors of the components.
 */
static void add_colour(sums *s, uint64_t texels) {
  double luma = 0, blue = 0, red = 0;
  for (uint64_t t = 0; t < texels; t++) {
    const double r = s->error[3 * t], g = s->error[3 * t + 1], b = s->error[3 * t + 2];
    const double y = 0.299 * r + 0.587 * g + 0.114 * b;
    const double cb = (b - y) / 1.772, cr = (r - y) / 1.402;
    luma += y * y;
    blue += cb * cb;
    red += cr * cr;
  }
  s->luma += luma;
  s->blue += blue;
  s->red += red;
}

/* Luminance (Rec.709), or the mean of the channels, as a fraction of the peak clipped to 0..1. */
static void grey_image(const comparison *m, const float *values, float *grey) {
  const uint64_t texels = (uint64_t)m->reference->width * m->reference->height;
  const uint32_t channels = m->reference->channels;
  for (uint64_t t = 0; t < texels; t++) {
    const float *v = values + t * channels;
    float sum = 0;
    if (channels == 3) {
      sum = 0.2126f * v[0] + 0.7152f * v[1] + 0.0722f * v[2];
    } else {
      for (uint32_t c = 0; c < channels; c++) sum += v[c];
      sum /= (float)channels;
    }
    sum *= m->grey_scale;
    grey[t] = sum > 0 ? (sum < 1 ? sum : 1) : 0;
  }
}

static btf_status compare_block(void *user, const sample_visit *visit) {
  comparison *m = user;
  const sample_source *r = m->reference;
  sums *s = &m->threads[visit->thread];
  const uint64_t texels = (uint64_t)r->width * r->height;
  for (uint32_t l = 0; l < visit->lights; l++) {
    const uint64_t pair = (uint64_t)visit->view * r->lights + visit->light0 + l;
    const float *a = visit->a + l * visit->image_values, *b = visit->b + l * visit->image_values;
    m->pair_squared[pair] = add_values(m, s, a, b, visit->image_values);
    if (m->pair_squared[pair] > 0) {
      add_texels(s, texels, r->channels);
      if (r->channels == 3) add_colour(s, texels);
    }
    if (!m->in_ssim[pair]) continue;
    grey_image(m, a, s->grey_a);
    grey_image(m, b, s->grey_b);
    s->ssim += ssim_mean(s->grey_a, s->grey_b, r->width, r->height, s->scratch);
    s->ssim_images++;
  }
  return BTF_OK;
}

/* Marks `count` pairs: multiples of a step near the golden section of their number, which visit each pair
 * once and spread evenly over views and lights. */
static uint64_t choose_images(unsigned char *in_ssim, uint64_t pairs, uint64_t count) {
  uint64_t step = (uint64_t)((double)pairs * 0.6180339887498949), at = 0;
  if (count >= pairs) {
    memset(in_ssim, 1, pairs);
    return pairs;
  }
  for (;; step++) {
    uint64_t a = pairs, b = step;
    while (b != 0) {
      const uint64_t rest = a % b;
      a = b;
      b = rest;
    }
    if (a == 1) break;
  }
  for (uint64_t i = 0; i < count; i++, at = (at + step) % pairs) in_ssim[at] = 1;
  return count;
}

static int make_room(comparison *m, uint32_t threads, uint64_t pairs) {
  const sample_source *r = m->reference;
  const size_t texels = (size_t)r->width * r->height;
  m->threads = calloc(threads, sizeof *m->threads);
  m->pair_squared = calloc((size_t)pairs, sizeof *m->pair_squared);
  m->in_ssim = calloc((size_t)pairs, 1);
  if (m->threads == NULL || m->pair_squared == NULL || m->in_ssim == NULL) return cli_out_of_memory();
  for (uint32_t t = 0; t < threads; t++) {
    sums *s = &m->threads[t];
    s->texel_squared = calloc(texels, sizeof *s->texel_squared);
    s->error = malloc(texels * r->channels * sizeof(float));
    s->grey_a = malloc(texels * sizeof(float));
    s->grey_b = malloc(texels * sizeof(float));
    s->scratch = malloc(ssim_scratch(r->width, r->height) * sizeof(double));
    if (s->texel_squared == NULL || s->error == NULL || s->grey_a == NULL || s->grey_b == NULL ||
        s->scratch == NULL)
      return cli_out_of_memory();
  }
  return EXIT_DONE;
}

static void drop_room(comparison *m, uint32_t threads) {
  for (uint32_t t = 0; m->threads != NULL && t < threads; t++) {
    free(m->threads[t].texel_squared);
    free(m->threads[t].error);
    free(m->threads[t].grey_a);
    free(m->threads[t].grey_b);
    free(m->threads[t].scratch);
  }
  free(m->threads);
  free(m->pair_squared);
  free(m->in_ssim);
}

/* Adds the sums of the other threads to those of the first. */
static void join_sums(comparison *m, uint32_t threads) {
  const uint64_t texels = (uint64_t)m->reference->width * m->reference->height;
  sums *s = &m->threads[0];
  for (uint32_t t = 1; t < threads; t++) {
    const sums *o = &m->threads[t];
    s->squared += o->squared;
    s->reference_squared += o->reference_squared;
    s->relative += o->relative;
    s->luma += o->luma;
    s->blue += o->blue;
    s->red += o->red;
    s->ssim += o->ssim;
    s->ssim_images += o->ssim_images;
    s->different += o->different;
    if (o->largest > s->largest) s->largest = o->largest;
    for (uint64_t i = 0; i < texels; i++) s->texel_squared[i] += o->texel_squared[i];
  }
}

static void conclude(const comparison *m, uint64_t pairs, double peak, metrics *out) {
  const sample_source *r = m->reference;
  const sums *s = &m->threads[0];
  const uint64_t texels = (uint64_t)r->width * r->height;
  const double values = (double)pairs * (double)texels * r->channels;
  const double samples = (double)pairs * (double)texels;
  uint64_t worst_texel = 0, worst_pair = 0;
  for (uint64_t t = 1; t < texels; t++)
    if (s->texel_squared[t] > s->texel_squared[worst_texel]) worst_texel = t;
  for (uint64_t p = 1; p < pairs; p++)
    if (m->pair_squared[p] > m->pair_squared[worst_pair]) worst_pair = p;
  out->values = (uint64_t)values;
  out->different = s->different;
  out->peak = peak;
  out->rmse = sqrt(s->squared / values);
  out->relative_rmse = s->reference_squared > 0 ? sqrt(s->squared / s->reference_squared)
                       : s->squared > 0         ? INFINITY
                                                : 0;
  out->psnr = out->rmse > 0 ? 20 * log10(peak / out->rmse) : INFINITY;
  out->mean_relative_error = s->relative / values;
  out->largest_error = s->largest;
  out->ssim = s->ssim_images > 0 ? s->ssim / (double)s->ssim_images : NAN;
  out->ssim_images = s->ssim_images;
  out->has_colour = r->channels == 3;
  out->rmse_y = sqrt(s->luma / samples);
  out->rmse_cb = sqrt(s->blue / samples);
  out->rmse_cr = sqrt(s->red / samples);
  out->worst_x = (uint32_t)(worst_texel % r->width);
  out->worst_y = (uint32_t)(worst_texel / r->width);
  out->worst_texel_rmse = sqrt(s->texel_squared[worst_texel] / ((double)pairs * r->channels));
  out->worst_light = (uint32_t)(worst_pair % r->lights);
  out->worst_view = (uint32_t)(worst_pair / r->lights);
  out->worst_pair_rmse = sqrt(m->pair_squared[worst_pair] / ((double)texels * r->channels));
}

int metrics_compare(cli *c, const sample_source *reference, const sample_source *other, double peak,
                    uint64_t ssim_images, metrics *out) {
  const uint64_t pairs = (uint64_t)reference->views * reference->lights;
  comparison m = {0};
  sample_walk walk = {reference, other, compare_block, &m, "comparing", 0, 1};
  int failed;
  memset(out, 0, sizeof *out);
  m.reference = reference;
  /* A reference of 0 needs some floor; where the peak is 0 all references are 0, and so any will do. */
  m.floor_of_relative = peak > 0 ? 1e-3 * peak : 1e-30;
  m.grey_scale = peak > 0 ? (float)(1 / peak) : 1;
  failed = make_room(&m, c->threads, pairs);
  if (!failed) {
    choose_images(m.in_ssim, pairs, ssim_images);
    failed = sample_walk_run(c, &walk);
  }
  if (!failed) {
    join_sums(&m, c->threads);
    conclude(&m, pairs, peak, out);
  }
  drop_room(&m, c->threads);
  return failed;
}

static bool same_directions(const btf_dirset *a, const btf_dirset *b) {
  const uint32_t count = btf_dirset_count(a);
  const float *p = btf_dirset_directions(a), *q = btf_dirset_directions(b);
  if (btf_dirset_count(b) != count) return false;
  for (uint32_t i = 0; i < 3 * count; i++)
    if (fabsf(p[i] - q[i]) > 1e-5f) return false;
  return true;
}

const char *metrics_shape_difference(const sample_source *a, const sample_source *b) {
  if (a->width != b->width || a->height != b->height) return "the numbers of texels differ";
  if (a->channels != b->channels) return "the numbers of channels differ";
  if (!same_directions(a->light_set, b->light_set)) return "the light directions differ";
  if (!same_directions(a->view_set, b->view_set)) return "the view directions differ";
  if (a->quantity != b->quantity) return "one holds brdf, the other brdf_cos";
  return NULL;
}
