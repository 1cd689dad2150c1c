/* SPDX-License-Identifier: MIT */
/* warp.c: evaluation. The half vector is taken through the distribution of visible normals, a warp of the
 * unit square for each first direction, to where the measured values are. */
#include "rgl/rgl.h"

static const double pi = 3.14159265358979323846;
/* Directions are floats: closer than this to the normal an azimuth is noise. */
static const double pole = 1e-6;

static double number(const unsigned char *data, uint64_t i) {
  return (double)btf_get_f32(data + 4 * i);
}

static double mix(double a, double b, double t) {
  return a + t * (b - a);
}

/* The nodes around a parameter, held at both ends; both are the same where there is one only. */
typedef struct span {
  uint32_t node[2];
  double weight[2];
} span;

static span find_span(const unsigned char *nodes, uint32_t count, double at) {
  uint32_t low = 0, high = count - 1;
  if (count == 1) return (span){{0, 0}, {1, 0}};
  while (high - low > 1) {
    const uint32_t middle = low + (high - low) / 2;
    if (number(nodes, middle) <= at)
      low = middle;
    else
      high = middle;
  }
  const double from = number(nodes, low), to = number(nodes, high);
  const double t = fmin(fmax((at - from) / (to - from), 0), 1);
  return (span){{low, high}, {1 - t, t}};
}

/* Place among rows or columns: the one before it and how far on. */
static uint32_t cell(double u, uint32_t count, double *fraction) {
  const double place = fmin(fmax(u, 0), 1) * (count - 1);
  const uint32_t before = place < count - 2 ? (uint32_t)place : count - 2;
  *fraction = place - before;
  return before;
}

static double bilinear(const rgl_grid *grid, uint64_t which, double x, double y) {
  double fx, fy;
  const uint32_t column = cell(x, grid->columns, &fx), row = cell(y, grid->rows, &fy);
  const uint64_t at = (which * grid->rows + row) * grid->columns + column;
  return mix(mix(number(grid->data, at), number(grid->data, at + 1), fx),
             mix(number(grid->data, at + grid->columns), number(grid->data, at + grid->columns + 1), fx), fy);
}

/* Weights of the four grids around the first direction. */
typedef struct slices {
  uint64_t index[4]; /* phi, theta */
  double weight[4];
} slices;

static slices find_slices(const rgl_brdf *brdf, double phi, double theta) {
  const span p = find_span(brdf->phis, brdf->phi_count, phi);
  const span t = find_span(brdf->thetas, brdf->theta_count, theta);
  slices s;
  for (int i = 0; i < 4; i++) {
    s.index[i] = (uint64_t)p.node[i >> 1] * brdf->theta_count + t.node[i & 1];
    s.weight[i] = p.weight[i >> 1] * t.weight[i & 1];
  }
  return s;
}

/* The share of the distribution in the rows below (x, y), and in its row to the left. */
static void warp(const rgl_brdf *brdf, const slices *s, const double u[2], double out[2]) {
  const rgl_grid *grid = &brdf->vndf;
  double fx, fy, below = 0, rows[2] = {0, 0}, left = 0;
  const uint32_t column = cell(u[0], grid->columns, &fx), row = cell(u[1], grid->rows, &fy);
  for (int i = 0; i < 4; i++) {
    if (!(s->weight[i] > 0)) continue;
    const double weight = s->weight[i] / brdf->totals[s->index[i]];
    const double *sums = brdf->row_sums + s->index[i] * grid->rows;
    for (uint32_t y = 0; y < row; y++) below += weight * 0.5 * (sums[y] + sums[y + 1]);
    for (uint32_t k = 0; k < 2; k++) {
      const unsigned char *line = grid->data + 4 * ((s->index[i] * grid->rows + row + k) * grid->columns);
      double sum = 0;
      for (uint32_t x = 0; x < column; x++) sum += 0.5 * (number(line, x) + number(line, x + 1));
      const double here = number(line, column), next = number(line, column + 1);
      sum += fx * (here + 0.5 * fx * (next - here));
      left += weight * (k ? fy : 1 - fy) * sum;
      rows[k] += weight * sums[row + k];
    }
  }
  const double whole = mix(rows[0], rows[1], fy);
  out[0] = whole > 0 ? left / whole : 0;
  out[1] = below + fy * (rows[0] + 0.5 * fy * (rows[1] - rows[0]));
}

static double elevation(const double d[3]) {
  return atan2(hypot(d[0], d[1]), d[2]);
}

static double azimuth(const double d[3]) {
  return hypot(d[0], d[1]) < pole ? 0 : atan2(d[1], d[0]);
}

/* Signs that take the first direction to where the material was measured. */
static void reduce(const rgl_brdf *brdf, const double first[3], double sign[2]) {
  sign[0] = sign[1] = 1;
  if (brdf->symmetry == 4) {
    if (first[0] * cos(brdf->symmetry_middle) < 0) sign[0] = -1;
    if (first[1] * sin(brdf->symmetry_middle) < 0) sign[1] = -1;
  } else if (brdf->symmetry == 2 &&
             first[0] * cos(brdf->symmetry_middle) + first[1] * sin(brdf->symmetry_middle) < -1e-9) {
    sign[0] = sign[1] = -1;
  }
}

void rgl_eval(const one_texel *base, const double light[3], const double view[3], double *out) {
  const rgl_brdf *brdf = (const rgl_brdf *)base;
  double sign[2], place[2], factor = 1;
  reduce(brdf, view, sign);
  const double first[3] = {view[0] * sign[0], view[1] * sign[1], view[2]};
  double half[3] = {first[0] + light[0] * sign[0], first[1] + light[1] * sign[1], view[2] + light[2]};
  const double length = sqrt(half[0] * half[0] + half[1] * half[1] + half[2] * half[2]);
  for (int i = 0; i < 3; i++) half[i] /= length;
  const double theta = elevation(first), phi = azimuth(first);
  const bool isotropic = brdf->phi_count <= 2;
  const double turn = (azimuth(half) - (isotropic ? phi : 0) + pi) / (2 * pi);
  const double u[2] = {sqrt(elevation(half) * 2 / pi), turn - floor(turn)};
  const slices s = find_slices(brdf, phi, theta);
  warp(brdf, &s, u, place);
  if (brdf->jacobian)
    factor = bilinear(&brdf->ndf, 0, u[0], u[1]) /
             (4 * bilinear(&brdf->sigma, 0, sqrt(theta * 2 / pi), (phi + pi) / (2 * pi)));
  for (uint32_t c = 0; c < base->channels; c++) {
    double sum = 0;
    for (int i = 0; i < 4; i++)
      if (s.weight[i] > 0)
        sum += s.weight[i] * bilinear(&brdf->values, s.index[i] * brdf->bands + (uint64_t)c * brdf->step,
                                      place[0], place[1]);
    out[c] = sum * factor;
  }
}

btf_status rgl_prepare(rgl_brdf *brdf) {
  const source_file *file = &brdf->base.file;
  const rgl_grid *grid = &brdf->vndf;
  const uint64_t count = (uint64_t)brdf->phi_count * brdf->theta_count;
  brdf->row_sums = (file->host->alloc)(file->ctx, count * grid->rows, sizeof *brdf->row_sums);
  brdf->totals = (file->host->alloc)(file->ctx, count, sizeof *brdf->totals);
  if (brdf->row_sums == NULL || brdf->totals == NULL) return BTF_E_NOMEM;
  for (uint64_t s = 0; s < count; s++) {
    double total = 0, before = 0;
    for (uint32_t y = 0; y < grid->rows; y++) {
      const unsigned char *line = grid->data + 4 * ((s * grid->rows + y) * grid->columns);
      double sum = 0;
      for (uint32_t x = 0; x < grid->columns; x++) {
        const double value = number(line, x);
        if (!(value >= 0 && value < INFINITY))
          return (file->host->fail)(file->ctx, BTF_E_CORRUPT,
                                    "%s: the distribution of visible normals has a number that cannot be one",
                                    file->path);
        sum += x == 0 || x == grid->columns - 1 ? 0.5 * value : value;
      }
      brdf->row_sums[s * grid->rows + y] = sum;
      if (y > 0) total += 0.5 * (before + sum);
      before = sum;
    }
    if (!(total > 0))
      return (file->host->fail)(file->ctx, BTF_E_CORRUPT,
                                "%s: the distribution of visible normals is empty for a direction",
                                file->path);
    brdf->totals[s] = total;
  }
  return BTF_OK;
}
