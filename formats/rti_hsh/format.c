/* SPDX-License-Identifier: MIT */
/* format.c: `.rti` files of hemispherical harmonics as data sets of one view, from straight above. */
#include "source/hemisphere.h"
#include "source/one_view.h"

enum { KIND_HSH = 3, COLOUR_SEPARATE = 2 };

typedef struct hsh_file {
  one_view map;
  uint32_t terms;
  double scale[HEMISPHERE_MOST_TERMS], bias[HEMISPHERE_MOST_TERMS];
  const unsigned char *texels;
} hsh_file;

ONE_VIEW_DIRECTIONS;
ONE_VIEW_TRANSFER;
static const btf_param_desc *const params[] = {&directions, &transfer, NULL};

static uint32_t probe(const btf_host *host, btf_context *ctx, const btf_probe *probe) {
  (void)host, (void)ctx;
  return !probe->is_folder && probe->head_size >= 8 && memcmp(probe->head, "#HSH", 4) == 0 ? 90 : 0;
}

/* ---- header ---- */

static btf_status fail_header(const source_file *file, cursor *c, const char *what) {
  return (file->host->fail)(file->ctx, cursor_left(c) == 0 ? BTF_E_TRUNCATED : BTF_E_CORRUPT,
                            "%s: its header has no sound %s", file->path, what);
}

static btf_status fail_unsupported(const source_file *file, const char *what) {
  return (file->host->fail)(file->ctx, BTF_E_UNSUPPORTED, "%s: is an RTI of %s", file->path, what);
}

/* Lines that begin with '#' are for people. */
static void skip_comments(cursor *c) {
  while (cursor_left(c) > 0 && c->file->data[c->at] == '#')
    while (cursor_left(c) > 0 && cursor_u8(c) != '\n') {
    }
}

/* Numbers of the binary part; the file is refused if one is not finite. */
static bool take_floats(cursor *c, uint32_t count, double *out) {
  for (uint32_t i = 0; i < count; i++) {
    out[i] = (double)cursor_f32(c);
    if (!isfinite(out[i])) return false;
  }
  return true;
}

static btf_status parse(hsh_file *hsh) {
  const source_file *file = &hsh->map.file;
  cursor c = {.file = file};
  uint32_t kind, bands, colour, size;
  if (file->size < 4 || memcmp(file->data, "#HSH", 4) != 0)
    return (file->host->fail)(file->ctx, BTF_E_NOT_BTF, "%s: is not an RTI of hemispherical harmonics",
                              file->path);
  skip_comments(&c);
  if (!cursor_count(&c, UINT32_MAX, &kind)) return fail_header(file, &c, "kind");
  if (kind != KIND_HSH) return fail_unsupported(file, "another kind than 3, hemispherical harmonics");
  if (!cursor_count(&c, ONE_VIEW_MOST_SIDE, &hsh->map.width)) return fail_header(file, &c, "width");
  if (!cursor_count(&c, ONE_VIEW_MOST_SIDE, &hsh->map.height)) return fail_header(file, &c, "height");
  if (!cursor_count(&c, UINT32_MAX, &bands)) return fail_header(file, &c, "number of colours");
  if (bands != 3) return fail_unsupported(file, "another number of colours than 3");
  if (!cursor_count(&c, UINT32_MAX, &hsh->terms)) return fail_header(file, &c, "number of terms");
  if (hsh->terms != 4 && hsh->terms != 9 && hsh->terms != 16)
    return fail_unsupported(file, "another number of terms than 4, 9 or 16");
  if (!cursor_count(&c, UINT32_MAX, &colour)) return fail_header(file, &c, "mode of colours");
  if (colour != COLOUR_SEPARATE) return fail_unsupported(file, "another mode than 2, terms for each colour");
  if (!cursor_count(&c, UINT32_MAX, &size)) return fail_header(file, &c, "size of a coefficient");
  if (size != 1) return fail_unsupported(file, "coefficients that are not single bytes");
  cursor_line_end(&c);
  if (!take_floats(&c, hsh->terms, hsh->scale) || !take_floats(&c, hsh->terms, hsh->bias))
    return (file->host->fail)(file->ctx, BTF_E_CORRUPT, "%s: a scale or bias is not finite", file->path);
  const uint64_t bytes = (uint64_t)hsh->map.width * hsh->map.height * 3 * hsh->terms;
  if (c.ended || cursor_left(&c) != bytes)
    return (file->host->fail)(file->ctx, c.ended || cursor_left(&c) < bytes ? BTF_E_TRUNCATED : BTF_E_CORRUPT,
                              "%s: has %llu bytes of texels instead of %llu", file->path,
                              (unsigned long long)cursor_left(&c), (unsigned long long)bytes);
  hsh->texels = cursor_take(&c, bytes, 1);
  return BTF_OK;
}

/* ---- samples ---- */

static void weigh(const one_view *map, const double light[3], double *weights) {
  (void)map;
  hemisphere_terms(light, weights);
}

/* The file's first row is the top one. */
static void texel(const one_view *map, uint32_t x, uint32_t y, const double *weights, double out[3]) {
  const hsh_file *hsh = (const hsh_file *)map;
  const unsigned char *p = hsh->texels + ((uint64_t)(map->height - 1 - y) * map->width + x) * 3 * hsh->terms;
  for (uint32_t c = 0; c < 3; c++, p += hsh->terms) {
    out[c] = 0;
    for (uint32_t i = 0; i < hsh->terms; i++)
      out[c] += weights[i] * (p[i] / 255.0 * hsh->scale[i] + hsh->bias[i]);
  }
}

static btf_status open_file(const btf_host *host, btf_context *ctx, const char *path,
                            const btf_options *options, btf_dataset **out) {
  one_view *map;
  BTF_TRY(one_view_open(host, ctx, path, sizeof(hsh_file), &map));
  const btf_status status = parse((hsh_file *)map);
  if (status != BTF_OK) {
    one_view_close(map);
    return status;
  }
  map->weigh = weigh;
  map->texel = texel;
  return one_view_create(map, options, path, "rti-hsh", NULL, out);
}

const btf_format_vtbl btf_format_rti_hsh = {.struct_size = sizeof(btf_format_vtbl),
                                            .abi = LIBBTF_ABI,
                                            .id = "rti-hsh",
                                            .title = "RTI: hemispherical harmonics, one view (.rti)",
                                            .version = "1",
                                            .params = params,
                                            .probe = probe,
                                            .open = open_file};
