/* SPDX-License-Identifier: MIT */
/* audit_directions.c: what the means over texels say about directions: reciprocity, where the cosine is,
 * flicker. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "audit_parts.h"

/* Directions of the other set are the same within this cosine, 2 degrees. */
static const float same_direction = 0.99939083f;
/* Cosine in or out is told apart when one reciprocity error is this much smaller than the other. */
static const double clear_ratio = 0.7;
enum { LEAST_PAIRS = 20, INTEGRAL_POINTS = 65536 };

static const float *direction(const btf_dirset *set, uint32_t i) {
  return btf_dirset_directions(set) + 3 * (size_t)i;
}

static float dot(const float *a, const float *b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

void audit_light_weights(const sample_source *source, double *weights) {
  const bool with_cosine = source->quantity == BTF_QUANTITY_BRDF_COS;
  const double golden = 2.39996322972865332;
  memset(weights, 0, source->lights * sizeof *weights);
  for (uint32_t i = 0; i < INTEGRAL_POINTS; i++) {
    /* A spiral with equal steps of z has equal areas. */
    const double z = (i + 0.5) / INTEGRAL_POINTS, r = sqrt(1 - z * z);
    const float d[3] = {(float)(r * cos(golden * i)), (float)(r * sin(golden * i)), (float)z};
    btf_interp near;
    btf_dirset_locate(source->light_set, d, &near);
    for (int k = 0; k < 3; k++)
      weights[near.index[k]] +=
          near.weight[k] * (with_cosine ? 1 : z) * (2 * 3.14159265358979324 / INTEGRAL_POINTS);
  }
}

bool audit_exchanged(const sample_source *source, uint32_t light, uint32_t view, uint32_t *light_there,
                     uint32_t *view_there) {
  const float *l = direction(source->light_set, light), *v = direction(source->view_set, view);
  *light_there = btf_dirset_nearest(source->light_set, v);
  *view_there = btf_dirset_nearest(source->view_set, l);
  return dot(direction(source->light_set, *light_there), v) >= same_direction &&
         dot(direction(source->view_set, *view_there), l) >= same_direction;
}

static int ascending(const void *a, const void *b) {
  const double x = *(const double *)a, y = *(const double *)b;
  return x < y ? -1 : x > y;
}

/* NaN of none. */
static double median(double *values, size_t count) {
  if (count == 0) return (double)NAN;
  qsort(values, count, sizeof *values, ascending);
  return count % 2 != 0 ? values[count / 2] : 0.5 * (values[count / 2 - 1] + values[count / 2]);
}

/* ---- reciprocity ---- */

static void find_reciprocity(const sample_source *s, audit *a, double *stored, double *divided,
                             double *multiplied) {
  size_t count = 0;
  for (uint32_t v = 0; v < s->views; v++)
    for (uint32_t l = 0; l < s->lights; l++) {
      uint32_t light_there, view_there;
      if (!audit_exchanged(s, l, v, &light_there, &view_there)) continue;
      const double here = a->mean[(size_t)v * s->lights + l];
      const double there = a->mean[(size_t)view_there * s->lights + light_there];
      const float z_here = direction(s->light_set, l)[2], z_there = direction(s->light_set, light_there)[2];
      if (light_there == l && view_there == v) continue; /* its own partner */
      if (!(here > 0) || !(there > 0)) continue;
      const double ratio = log(here / there), cosines = log((double)z_here / (double)z_there);
      stored[count] = fabs(ratio);
      divided[count] = fabs(ratio - cosines);
      multiplied[count] = fabs(ratio + cosines);
      count++;
    }
  a->pairs = (uint32_t)count;
  a->reciprocity = median(stored, count);
  a->reciprocity_divided = median(divided, count);
  a->reciprocity_multiplied = median(multiplied, count);
}

static audit_cosine judge(const audit *a) {
  if (a->pairs < LEAST_PAIRS) return AUDIT_COSINE_UNKNOWN;
  if (a->reciprocity_divided < clear_ratio * a->reciprocity) return AUDIT_COSINE_INSIDE;
  if (a->reciprocity < clear_ratio * a->reciprocity_divided) return AUDIT_COSINE_OUTSIDE;
  return AUDIT_COSINE_UNKNOWN;
}

/* ---- flicker ---- */

/* From a to b, counter-clockwise around a triangle. */
typedef struct edge {
  uint32_t a, b;
} edge;

typedef struct axis {
  const btf_dirset *set;
  uint32_t count, others;  /* directions of this side and of the other */
  size_t step, other_step; /* in the table of means */
} axis;

static int by_ends(const void *p, const void *q) {
  const edge *x = p, *y = q;
  if (x->a != y->a) return x->a < y->a ? -1 : 1;
  return x->b < y->b ? -1 : x->b > y->b;
}

static edge *make_edges(const btf_dirset *set, size_t *count) {
  uint32_t triangles = 0;
  const uint32_t *corner = btf_dirset_triangles(set, &triangles);
  edge *edges = malloc((3 * (size_t)triangles + 1) * sizeof *edges);
  *count = 3 * (size_t)triangles;
  if (edges == NULL) return NULL;
  for (size_t t = 0; t < triangles; t++)
    for (size_t k = 0; k < 3; k++) edges[3 * t + k] = (edge){corner[3 * t + k], corner[3 * t + (k + 1) % 3]};
  qsort(edges, *count, sizeof *edges, by_ends);
  return edges;
}

/* Neighbours on all sides; at the border of the set they are on one side, and say nothing of a slope. */
static bool is_inside(const edge *edges, size_t count, const edge *first, size_t n) {
  for (size_t k = 0; k < n; k++) {
    const edge back = {first[k].b, first[k].a};
    if (bsearch(&back, edges, count, sizeof *edges, by_ends) == NULL) return false;
  }
  return n > 0;
}

/* The means without the cosine of the light, which bends steeply toward the horizon. */
static void without_cosine(const sample_source *s, const audit *a, double *out) {
  const bool inside = a->cosine == AUDIT_COSINE_INSIDE ||
                      (a->cosine == AUDIT_COSINE_UNKNOWN && s->quantity == BTF_QUANTITY_BRDF_COS);
  for (uint32_t v = 0; v < s->views; v++)
    for (uint32_t l = 0; l < s->lights; l++) {
      const size_t i = (size_t)v * s->lights + l;
      out[i] = inside ? a->mean[i] / (double)direction(s->light_set, l)[2] : a->mean[i];
    }
}

/* log of what a direction has more than the mean of its neighbours, seen with one direction of the other
 * side. */
static bool excess(const double *mean, const axis *x, const edge *first, size_t n, uint32_t other,
                   double *out) {
  const double here = mean[x->step * first->a + x->other_step * other];
  double sum = 0;
  if (!(here > 0)) return false;
  for (size_t k = 0; k < n; k++) {
    const double there = mean[x->step * first[k].b + x->other_step * other];
    if (!(there > 0)) return false;
    sum += log(there);
  }
  *out = log(here) - sum / (double)n;
  return true;
}

/* `values` has room for one of each direction of the other side, and of this side behind them. */
static int find_flicker(const double *mean, const axis *x, double *values, double *worst, double *usual,
                        uint32_t *worst_index) {
  size_t count, end, inside = 0;
  double *all = values + x->others;
  edge *edges = make_edges(x->set, &count);
  if (edges == NULL) return cli_out_of_memory();
  *worst = 0;
  *worst_index = 0;
  for (size_t begin = 0; begin < count; begin = end) {
    size_t found = 0;
    for (end = begin + 1; end < count && edges[end].a == edges[begin].a;) end++;
    if (!is_inside(edges, count, edges + begin, end - begin)) continue;
    for (uint32_t o = 0; o < x->others; o++)
      if (excess(mean, x, edges + begin, end - begin, o, &values[found])) found++;
    const double typical = fabs(median(values, found));
    all[inside++] = typical;
    if (!(typical > *worst)) continue;
    *worst = typical;
    *worst_index = edges[begin].a;
  }
  *usual = median(all, inside);
  free(edges);
  return EXIT_DONE;
}

int audit_directions(const sample_source *source, audit *a) {
  const size_t pairs = (size_t)source->views * source->lights;
  double *room = malloc((3 * pairs + source->lights + source->views) * sizeof *room);
  if (room == NULL) return cli_out_of_memory();
  find_reciprocity(source, a, room, room + pairs, room + 2 * pairs);
  a->cosine = judge(a);
  without_cosine(source, a, room + pairs);
  const axis lights = {source->light_set, source->lights, source->views, 1, source->lights};
  const axis views = {source->view_set, source->views, source->lights, source->lights, 1};
  int failed = find_flicker(room + pairs, &lights, room + 2 * pairs, &a->flicker_light,
                            &a->flicker_light_usual, &a->flicker_light_index);
  if (!failed)
    failed = find_flicker(room + pairs, &views, room + 2 * pairs, &a->flicker_view, &a->flicker_view_usual,
                          &a->flicker_view_index);
  free(room);
  return failed;
}
