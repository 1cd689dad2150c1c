/* SPDX-License-Identifier: MIT */
/* format.c: polynomial texture maps (`.ptm`) as data sets of one view, from straight above. */
#include "source/one_view.h"

enum { TERMS = 6 };

typedef struct ptm_file {
  one_view map;
  bool separate; /* a polynomial for each channel; otherwise one, and a colour */
  bool together; /* polynomial and colour of a texel are neighbours */
  double scale[TERMS], bias[TERMS];
  const unsigned char *texels;
} ptm_file;

ONE_VIEW_DIRECTIONS;
ONE_VIEW_TRANSFER;
static const btf_param_desc *const params[] = {&directions, &transfer, NULL};

static uint32_t probe(const btf_host *host, btf_context *ctx, const btf_probe *probe) {
  (void)host, (void)ctx;
  return !probe->is_folder && probe->head_size >= 8 && memcmp(probe->head, "PTM_1.", 6) == 0 ? 90 : 0;
}

/* ---- header ---- */

static btf_status fail_header(const source_file *file, cursor *c, const char *what) {
  return (file->host->fail)(file->ctx, cursor_left(c) == 0 ? BTF_E_TRUNCATED : BTF_E_CORRUPT,
                            "%s: its header has no sound %s", file->path, what);
}

static btf_status parse(ptm_file *ptm) {
  const source_file *file = &ptm->map.file;
  cursor c = {.file = file};
  char version[CURSOR_WORD_BYTES], kind[CURSOR_WORD_BYTES], word[CURSOR_WORD_BYTES];
  cursor_word(&c, version);
  cursor_word(&c, kind);
  if (strncmp(version, "PTM_1.", 6) != 0)
    return (file->host->fail)(file->ctx, BTF_E_NOT_BTF, "%s: is not a polynomial texture map", file->path);
  if (version[6] < '0' || version[6] > '2' || version[7] != '\0')
    return (file->host->fail)(file->ctx, BTF_E_UNSUPPORTED, "%s: is a PTM of another version than 1.0 to 1.2",
                              file->path);
  ptm->separate = strcmp(kind, "PTM_FORMAT_RGB") == 0;
  if (!ptm->separate && strcmp(kind, "PTM_FORMAT_LRGB") != 0)
    return cursor_left(&c) == 0
               ? fail_header(file, &c, "kind")
               : (file->host->fail)(
                     file->ctx, BTF_E_UNSUPPORTED,
                     "%s: is a PTM of the kind %.40s; PTM_FORMAT_RGB and PTM_FORMAT_LRGB are read",
                     file->path, kind);
  ptm->together = !ptm->separate && version[6] < '2';
  if (!cursor_count(&c, ONE_VIEW_MOST_SIDE, &ptm->map.width)) return fail_header(file, &c, "width");
  if (!cursor_count(&c, ONE_VIEW_MOST_SIDE, &ptm->map.height)) return fail_header(file, &c, "height");
  for (int i = 0; i < 2 * TERMS; i++) {
    cursor_word(&c, word);
    if (!(file->host->number)(word, i < TERMS ? &ptm->scale[i] : &ptm->bias[i - TERMS]))
      return fail_header(file, &c, i < TERMS ? "scale" : "bias");
  }
  cursor_line_end(&c);
  const uint64_t bytes = (uint64_t)ptm->map.width * ptm->map.height * (ptm->separate ? 3 * TERMS : TERMS + 3);
  if (c.ended || cursor_left(&c) != bytes)
    return (file->host->fail)(file->ctx, c.ended || cursor_left(&c) < bytes ? BTF_E_TRUNCATED : BTF_E_CORRUPT,
                              "%s: has %llu bytes of texels instead of %llu", file->path,
                              (unsigned long long)cursor_left(&c), (unsigned long long)bytes);
  ptm->texels = cursor_take(&c, bytes, 1);
  return BTF_OK;
}

/* ---- samples ---- */

static void weigh(const one_view *map, const double light[3], double *weights) {
  const double x = light[0], y = light[1];
  const double terms[TERMS] = {x * x, y * y, x * y, x, y, 1};
  (void)map;
  memcpy(weights, terms, sizeof terms);
}

static double polynomial(const ptm_file *ptm, const unsigned char *p, const double *weights) {
  double sum = 0;
  for (int i = 0; i < TERMS; i++) sum += weights[i] * ptm->scale[i] * (p[i] - ptm->bias[i]);
  return sum / 255;
}

/* The file's first row is the bottom one, as here. */
static void texel(const one_view *map, uint32_t x, uint32_t y, const double *weights, double out[3]) {
  const ptm_file *ptm = (const ptm_file *)map;
  const uint64_t count = (uint64_t)map->width * map->height, at = (uint64_t)y * map->width + x;
  const unsigned char *p = ptm->texels + at * (ptm->together ? TERMS + 3 : TERMS);
  const unsigned char *colour = ptm->together ? p + TERMS : ptm->texels + count * TERMS + at * 3;
  for (uint32_t c = 0; c < 3; c++)
    out[c] = ptm->separate ? polynomial(ptm, p + c * count * TERMS, weights)
                           : polynomial(ptm, p, weights) * colour[c] / 255;
}

static btf_status open_file(const btf_host *host, btf_context *ctx, const char *path,
                            const btf_options *options, btf_dataset **out) {
  one_view *map;
  BTF_TRY(one_view_open(host, ctx, path, sizeof(ptm_file), &map));
  ptm_file *ptm = (ptm_file *)map;
  const btf_status status = parse(ptm);
  if (status != BTF_OK) {
    one_view_close(map);
    return status;
  }
  map->weigh = weigh;
  map->texel = texel;
  return one_view_create(map, options, path, "rti-ptm", ptm->separate ? "RGB" : "LRGB", out);
}

const btf_format_vtbl btf_format_rti_ptm = {.struct_size = sizeof(btf_format_vtbl),
                                            .abi = LIBBTF_ABI,
                                            .id = "rti-ptm",
                                            .title = "PTM: polynomial texture maps, one view (LRGB and RGB)",
                                            .version = "1",
                                            .params = params,
                                            .probe = probe,
                                            .open = open_file};
