/* SPDX-License-Identifier: MIT */
/* format.c: relight's folders as data sets of one view, from straight above. */
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include "source/hemisphere.h"

#include "rti_relight/relight.h"

ONE_VIEW_DIRECTIONS;
ONE_VIEW_TRANSFER;
static const btf_param_desc *const params[] = {&directions, &transfer, NULL};

/* ---- recognising ---- */

static const char info_name[] = "info.json";

static bool has(const unsigned char *text, size_t size, const char *word) {
  return memmem(text, size, word, strlen(word)) != NULL;
}

/* An object of JSON with three of the members; what follows the lights may lie beyond the first bytes. */
static bool looks_right(const unsigned char *text, size_t size) {
  size_t at = 0;
  while (at < size && is_blank(text[at])) at++;
  return at < size && text[at] == '{' && has(text, size, "\"colorspace\"") && has(text, size, "\"type\"") &&
         has(text, size, "\"width\"");
}

static uint32_t probe(const btf_host *host, btf_context *ctx, const btf_probe *probe) {
  unsigned char head[4096];
  struct stat about;
  (void)host, (void)ctx;
  if (!probe->is_folder) return looks_right(probe->head, probe->head_size) ? 80 : 0;
  const int folder = open(probe->path, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (folder < 0) return 0;
  const int file = openat(folder, info_name, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  close(folder);
  if (file < 0) return 0;
  ssize_t got = 0;
  if (fstat(file, &about) == 0 && S_ISREG(about.st_mode)) got = read(file, head, sizeof head);
  close(file);
  return got > 0 && looks_right(head, (size_t)got) ? 80 : 0;
}

/* ---- lights ---- */

static void weigh_formula(const one_view *map, const double light[3], double *weights) {
  const relight_file *r = (const relight_file *)map;
  const double x = light[0], y = light[1];
  const double terms[] = {1, x, y, x * x, x * y, y * y};
  if (r->type == RELIGHT_HSH)
    hemisphere_terms(light, weights);
  else
    memcpy(weights, terms, sizeof terms);
}

/* Adds a sample's basis, on the scale 0 to 1 of its planes. */
static void add_sample(const relight_file *r, uint32_t sample, double weight, double *weights) {
  for (uint32_t p = 0; p <= r->plane_count; p++) {
    const unsigned char *b = r->basis + ((uint64_t)p * r->samples + sample) * 3;
    for (int k = 0; k < 3; k++)
      weights[3 * p + k] += weight * (p == 0 ? b[k] / 255.0 : (b[k] - 127) / r->range[p - 1]);
  }
}

static double square_distance(const double *a, const double *b) {
  double sum = 0;
  for (int i = 0; i < 3; i++) sum += (a[i] - b[i]) * (a[i] - b[i]);
  return sum;
}

static void weigh_rbf(const one_view *map, const double light[3], double *weights) {
  const relight_file *r = (const relight_file *)map;
  const double smallest = 0.001;
  double nearest = INFINITY, sum = 0, kept = 0;
  for (uint32_t d = 0; d < r->samples; d++)
    nearest = fmin(nearest, square_distance(light, r->lights + 3 * (size_t)d));
    /* Relative to the nearest one, which changes no share and never makes all of them 0. */
#define BELL(d) exp((nearest - square_distance(light, r->lights + 3 * (size_t)(d))) / (r->sigma * r->sigma))
  for (uint32_t d = 0; d < r->samples; d++) sum += BELL(d);
  /* Of thousands of lights at one place none may have such a share. */
  const double least = 1 / sum > smallest ? smallest * sum : 0;
  for (uint32_t d = 0; d < r->samples; d++) {
    const double bell = BELL(d);
    if (bell > least) kept += bell;
  }
  for (uint32_t i = 0; i < 3 * (r->plane_count + 1); i++) weights[i] = 0;
  for (uint32_t d = 0; d < r->samples; d++) {
    const double bell = BELL(d);
    if (bell > least) add_sample(r, d, bell / kept, weights);
  }
#undef BELL
}

static void weigh_bilinear(const one_view *map, const double light[3], double *weights) {
  const relight_file *r = (const relight_file *)map;
  const double length = fabs(light[0]) + fabs(light[1]) + fabs(light[2]);
  const double place[2] = {(light[0] + light[1]) / length, (light[1] - light[0]) / length};
  uint32_t cell[2];
  double part[2];
  for (int i = 0; i < 2; i++) {
    const double at = fmin(fmax((place[i] + 1) / 2, 0), 1) * (r->resolution - 1);
    cell[i] = (uint32_t)at < r->resolution - 1 ? (uint32_t)at : r->resolution - 2;
    part[i] = at - cell[i];
  }
  for (uint32_t i = 0; i < 3 * (r->plane_count + 1); i++) weights[i] = 0;
  for (uint32_t i = 0; i < 4; i++) {
    const uint32_t x = i & 1, y = i >> 1;
    const double weight = (x != 0 ? part[0] : 1 - part[0]) * (y != 0 ? part[1] : 1 - part[1]);
    add_sample(r, cell[0] + x + (cell[1] + y) * r->resolution, weight, weights);
  }
}

/* ---- texels ---- */

static double plane_value(const relight_file *r, uint64_t at, uint32_t plane) {
  return (r->planes[plane / 3][at * 3 + plane % 3] / 255.0 - r->bias[plane]) * r->scale[plane];
}

static void texel_formula(const one_view *map, uint32_t x, uint32_t y, const double *weights, double out[3]) {
  const relight_file *r = (const relight_file *)map;
  const uint64_t at = (uint64_t)y * map->width + x;
  out[0] = out[1] = out[2] = 0;
  if (r->colour == RELIGHT_RGB) {
    for (uint32_t p = 0; p < r->plane_count; p++) out[p % 3] += weights[p / 3] * plane_value(r, at, p);
    return;
  }
  double sum = 0;
  for (uint32_t p = 3; p < r->plane_count; p++) sum += weights[p - 3] * plane_value(r, at, p);
  for (int k = 0; k < 3; k++) out[k] = r->planes[0][at * 3 + (uint32_t)k] / 255.0 * sum;
}

static void texel_basis(const one_view *map, uint32_t x, uint32_t y, const double *weights, double out[3]) {
  const relight_file *r = (const relight_file *)map;
  const uint64_t at = (uint64_t)y * map->width + x;
  for (int k = 0; k < 3; k++) out[k] = weights[k];
  if (r->colour == RELIGHT_MRGB) {
    for (uint32_t p = 0; p < r->plane_count; p++) {
      const double value = plane_value(r, at, p);
      for (int k = 0; k < 3; k++) out[k] += value * weights[3 * (p + 1) + k];
    }
    return;
  }
  for (uint32_t p = 0; p < r->plane_count; p++) {
    const uint32_t k = p < 3 * r->chroma ? p % 3 : 0;
    out[k] += plane_value(r, at, p) * weights[3 * (p + 1) + k];
  }
  const double orange = out[1], green = out[2], rest = out[0] - green / 2;
  out[1] = green + rest;
  out[2] = rest - orange / 2;
  out[0] = out[2] + orange;
}

/* ---- opening ---- */

static void drop(one_view *map) {
  relight_file *r = (relight_file *)map;
  const btf_host *host = map->file.host;
  for (uint32_t i = 0; i < RELIGHT_MOST_IMAGES; i++) (host->free)(map->file.ctx, r->planes[i]);
  (host->free)(map->file.ctx, r->lights);
  (host->free)(map->file.ctx, r->basis);
}

/* The path of info.json; the caller frees it. */
static char *info_path(const btf_host *host, btf_context *ctx, const char *path) {
  struct stat about;
  const bool folder = stat(path, &about) == 0 && S_ISDIR(about.st_mode);
  const size_t length = strlen(path);
  char *out = (host->alloc)(ctx, length + sizeof info_name + 1, 1);
  if (out == NULL) return NULL;
  memcpy(out, path, length + 1);
  if (folder) {
    if (length > 0 && path[length - 1] != '/') strcat(out, "/");
    strcat(out, info_name);
  }
  return out;
}

static btf_status open_file(const btf_host *host, btf_context *ctx, const char *path,
                            const btf_options *options, btf_dataset **out) {
  static const char *const kinds[4][4] = {{"ptm rgb", "ptm lrgb", "", ""},
                                          {"hsh rgb", "hsh lrgb", "", ""},
                                          {"", "", "rbf mrgb", "rbf mycc"},
                                          {"", "", "bilinear mrgb", "bilinear mycc"}};
  one_view *map;
  char *info = info_path(host, ctx, path);
  if (info == NULL) return BTF_E_NOMEM;
  btf_status status = one_view_open(host, ctx, info, sizeof(relight_file), &map);
  (host->free)(ctx, info);
  if (status != BTF_OK) return status;
  relight_file *r = (relight_file *)map;
  map->drop = drop;
  status = relight_read_info(r);
  if (status == BTF_OK) status = relight_read_planes(r);
  if (status != BTF_OK) {
    one_view_close(map);
    return status;
  }
  const bool formula = r->type == RELIGHT_PTM || r->type == RELIGHT_HSH;
  map->weigh = formula ? weigh_formula : r->type == RELIGHT_RBF ? weigh_rbf : weigh_bilinear;
  map->texel = formula ? texel_formula : texel_basis;
  return one_view_create(map, options, path, "rti-relight", kinds[r->type][r->colour], out);
}

const btf_format_vtbl btf_format_rti_relight = {
    .struct_size = sizeof(btf_format_vtbl),
    .abi = LIBBTF_ABI,
    .id = "rti-relight",
    .title = "relight: folders of info.json and planes, one view (ptm, hsh, rbf, bilinear)",
    .version = "1",
    .params = params,
    .probe = probe,
    .open = open_file};
